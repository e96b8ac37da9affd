"""A result folder is read back as it was written, and a damaged one is refused by the name of the file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from attest_cli.errors import AttestError
from attest_cli.readers.result import read_result
from attest_cli.writers.files import write_csv_rows, write_table

SEGMENTS = [
    {"index": 1, "kind": "stop", "start_s": 0.0, "closing_velocity_m_s": None, "checks": "ok"},
    {"index": 2, "kind": "motion", "start_s": 12.5, "closing_velocity_m_s": 0.1 + 0.2, "checks": "=separation"},
]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "report.json").write_text(json.dumps({"verdict": "PASS", "checks": []}))
    passes = {
        "timestamp_ns": np.array([1, 2]),
        "smoothed_covariance": np.arange(42.0).reshape(2, 21),
        "moving": np.array([True, False]),
    }
    write_table(passes, tmp_path / "passes.parquet")
    write_table(
        {"sensor": np.array(["sun", "gravity"]), "nis": np.array([1.0, np.nan])}, tmp_path / "innovations.parquet"
    )
    write_csv_rows(SEGMENTS, tmp_path / "segments.csv")
    return tmp_path


def test_what_was_written_is_read(folder: Path) -> None:
    result = read_result(folder)
    assert result.report["verdict"] == "PASS"
    assert result.passes["smoothed_covariance"].shape == (2, 21)
    assert result.passes["smoothed_covariance"][1, 20] == 41.0
    assert result.passes["moving"].tolist() == [True, False]
    assert result.innovations["sensor"].tolist() == ["sun", "gravity"]
    assert np.isnan(result.innovations["nis"][1])
    assert list(result.segments) == SEGMENTS  # numbers are numbers, blank is None, text loses its guard


@pytest.mark.parametrize("name", ["report.json", "passes.parquet", "innovations.parquet", "segments.csv"])
def test_a_missing_file_is_named(folder: Path, name: str) -> None:
    (folder / name).unlink()
    with pytest.raises(AttestError, match=f"{name}: missing"):
        read_result(folder)


@pytest.mark.parametrize("name", ["report.json", "passes.parquet", "innovations.parquet", "segments.csv"])
def test_a_cut_file_is_refused(folder: Path, name: str) -> None:
    data = (folder / name).read_bytes()
    (folder / name).write_bytes(data[: -(len(data) // 3)])
    with pytest.raises(AttestError, match=f"{name}: damaged"):
        read_result(folder)


def test_no_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(AttestError, match="no such result folder"):
        read_result(tmp_path / "absent")
