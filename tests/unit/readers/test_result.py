"""A result folder is read back as it was written, and a damaged one is refused by the name of the file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from numpy.typing import NDArray

from attest_cli.errors import AttestError
from attest_cli.readers.result import INNOVATIONS, PASSES, read_result
from attest_cli.writers.files import write_csv_rows, write_table

TIMES = {"start_ns": 0, "end_ns": 7, "start_s": 12.5, "end_s": 20.0, "duration_s": 7.5}
SEGMENTS: list[dict[str, Any]] = [
    {"index": 1, "kind": "stop", **TIMES, "closing_velocity_m_s": None, "checks": "ok"},
    {"index": 2, "kind": "motion", **TIMES, "closing_velocity_m_s": 0.1 + 0.2, "checks": "=separation"},
]
PASS_COLUMNS: dict[str, NDArray[Any]] = {
    **{name: np.array([0.5, 1.5]) for name in PASSES},
    "timestamp_ns": np.array([1, 2]),
    **{f"{name}_covariance": np.arange(42.0).reshape(2, 21) for name in ("forward", "backward", "smoothed")},
    "moving": np.array([True, False]),
}
INNOVATION_COLUMNS: dict[str, NDArray[Any]] = {
    **{name: np.array([1.0, np.nan]) for name in INNOVATIONS},
    "sensor": np.array(["sun", "gravity"]),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "report.json").write_text(json.dumps({"verdict": "PASS", "checks": []}))
    write_table(PASS_COLUMNS, tmp_path / "passes.parquet")
    write_table(INNOVATION_COLUMNS, tmp_path / "innovations.parquet")
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


@pytest.mark.parametrize(
    ("name", "columns", "says"),
    [
        ("passes", {"t_s": PASS_COLUMNS["t_s"]}, r"no column timestamp_ns \(and 73 more\)"),
        ("passes", PASS_COLUMNS | {"t_s": np.array(["a", "b"])}, "t_s holds blanks or string"),
        ("innovations", INNOVATION_COLUMNS | {"sensor": np.array([1, 2])}, "sensor holds blanks or int64"),
        ("innovations", {k: v for k, v in INNOVATION_COLUMNS.items() if k != "nis"}, "no column nis"),
    ],
)
def test_a_table_of_another_shape_is_refused(
    folder: Path, name: str, columns: dict[str, NDArray[Any]], says: str
) -> None:
    write_table(columns, folder / f"{name}.parquet")
    with pytest.raises(AttestError, match=rf"{name}\.parquet: .*{says}") as refused:
        read_result(folder)
    assert refused.value.hint == "run attest smooth again"


def test_a_blank_among_the_numbers_is_refused(folder: Path) -> None:
    table = pq.read_table(folder / "passes.parquet")
    place = table.column_names.index("segment")
    pq.write_table(table.set_column(place, "segment", pa.array([1, None])), folder / "passes.parquet")
    with pytest.raises(AttestError, match="segment holds blanks"):
        read_result(folder)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"start_s": "soon"}, "start_s is 'soon', not a number"),
        ({"closing_velocity_m_s": "fast"}, "closing_velocity_m_s is 'fast', not a number"),
        ({"kind": "pause"}, "segment 1 lacks its kind or its times"),
        ({"end_s": None}, "segment 1 lacks its kind or its times"),
    ],
)
def test_segments_of_another_shape_are_refused(folder: Path, change: dict[str, Any], says: str) -> None:
    write_csv_rows([SEGMENTS[0] | change], folder / "segments.csv")
    with pytest.raises(AttestError, match=rf"segments\.csv: damaged: {says}"):
        read_result(folder)
    write_csv_rows([{"index": 1, "kind": "stop"}], folder / "segments.csv")
    with pytest.raises(AttestError, match=r"segments\.csv: damaged: no column start_ns \(and 5 more\)"):
        read_result(folder)


def test_no_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(AttestError, match="no such result folder"):
        read_result(tmp_path / "absent")
