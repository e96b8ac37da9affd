"""The cases of benchmarks/fuzz.py: the same again by number, each another, a few of them read or refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from support import mutations

from attest_cli.errors import AttestError
from attest_cli.readers import read
from attest_cli.settings import Settings

SUFFIX = {"csv": ".csv", "parquet": ".parquet", "mcap": ".mcap", "ulog": ".ulg"}


@pytest.mark.parametrize("reader", SUFFIX)
def test_cases_follow_from_their_number_and_end_well(reader: str, tmp_path: Path) -> None:
    if reader == "ulog":
        pytest.importorskip("pyulog", reason="the extra [ulog] is not installed")
    whole = mutations.seeds(reader, tmp_path / "whole")
    path = tmp_path / f"case{SUFFIX[reader]}"
    refused = 0
    for seed in whole:
        path.write_bytes(seed)
        try:
            read(path, Settings())
        except AttestError:
            refused += 1
    assert refused <= (reader == "csv")  # one of them asks for --columns
    made = [mutations.case(reader, whole, 5, k) for k in range(12)]
    assert made == [mutations.case(reader, whole, 5, k) for k in range(12)]
    assert len(set(made)) > 9
    for data in made:
        path.write_bytes(data)
        try:
            read(path, Settings())
        except AttestError as fault:
            assert str(path.name) in str(fault)  # noqa: PT017 (either end is fine)
