"""A user at the command line: attest run in this process on real files, and what came of it."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

TESTS = str(Path(__file__).resolve().parents[1])
if TESTS not in sys.path:
    sys.path.append(TESTS)

from journeys.odd_logs import Drive, sample_drive  # noqa: E402

from attest_cli.__main__ import run  # noqa: E402


@dataclass(frozen=True)
class Outcome:
    """Exit code and words of one command."""

    code: int
    out: str
    err: str

    def refused(self, *words: str, code: int = 1) -> None:
        """The one plain line of a refusal: its exit code, nothing on stdout, no traceback, and these words in it."""
        assert self.code == code, self
        assert self.out == ""
        assert self.err.startswith("attest: ")
        assert self.err.count("\n") == 1, self.err
        assert "defect in attest" not in self.err
        assert "Traceback" not in self.err
        assert self.err.isprintable() or self.err[:-1].isprintable(), self.err
        for word in words:
            assert word in self.err, self.err


@dataclass(frozen=True)
class Smoothed:
    """A smooth that came to its end: its words, its folder and its report."""

    outcome: Outcome
    folder: Path
    report: dict[str, Any]

    @property
    def codes(self) -> set[str]:
        """Codes of all warnings."""
        return {warning["code"] for warning in self.report["warnings"]}


@pytest.fixture
def attest(capsys: pytest.CaptureFixture[str]) -> Callable[..., Outcome]:
    """Run one command line in this process."""

    def command(*arguments: object) -> Outcome:
        capsys.readouterr()
        code = run([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        return Outcome(code, out, err)

    return command


@pytest.fixture
def smooth(attest: Callable[..., Outcome], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Smoothed]:
    """Smooth logs into a folder of this test, drawn only by request; no word to people holds a control character."""

    def command(
        *arguments: object, codes: tuple[int, ...] = (0,), output: str = "result", draw: bool = False
    ) -> Smoothed:
        folder = tmp_path / output
        if not draw:
            monkeypatch.setattr("attest_cli.pipeline.write_pages", lambda *_: [])
        outcome = attest("smooth", *arguments, "-o", folder)
        assert outcome.code in codes, outcome.err
        for line in outcome.err.splitlines():
            assert line.isprintable() or all(c.isprintable() or c in "\u00a0\u2009\u202f" for c in line), repr(line)
        left = [path.name for path in folder.parent.rglob("*") if ".tmp" in path.name]
        assert not left
        return Smoothed(outcome, folder, json.loads((folder / "report.json").read_text(encoding="utf-8")))

    return command


@pytest.fixture(scope="session")
def _runs() -> dict[bytes, Smoothed]:
    """What was smoothed already, by the content of the drive."""
    return {}


@pytest.fixture
def smooth_once(
    smooth: Callable[..., Smoothed], tmp_path: Path, _runs: dict[bytes, Smoothed]
) -> Callable[[Drive], Smoothed]:
    """Smooth a drive with its config alone; tests that judge the same drive share the run. Only to be read."""

    def command(drive: Drive) -> Smoothed:
        key = drive.digest()
        if key not in _runs:
            _runs[key] = smooth(drive.write(tmp_path))
        return _runs[key]

    return command


@pytest.fixture(scope="session")
def samples(root: Path) -> Path:
    """The shipped logs."""
    return root / "sample_logs"


@pytest.fixture(scope="session")
def whole(samples: Path) -> Drive:
    """The shipped drive with its truth, in memory."""
    return sample_drive(samples)
