"""What benchmarks/fuzz.py found: files that once ended in a traceback are read, or refused in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from attest_cli.commands.console import plain
from attest_cli.errors import AttestError
from attest_cli.prepare import prepare
from attest_cli.readers import read
from attest_cli.settings import Settings

CORPUS = sorted(path for path in (Path(__file__).parent / "corpus").iterdir() if path.is_file())


@pytest.mark.filterwarnings(
    "ignore::RuntimeWarning"
)  # the command line ignores them too: numbers of no meaning overflow
@pytest.mark.parametrize("path", CORPUS, ids=lambda path: path.name)
def test_a_found_case_is_read_or_refused(path: Path) -> None:
    try:
        prepare([read(path, Settings())], Settings())
    except AttestError as fault:
        line = plain(str(fault))
    else:
        line = ""
    assert "\n" not in line


def test_there_is_a_corpus() -> None:
    assert len(CORPUS) >= 5
