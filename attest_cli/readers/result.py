"""Result folder -> ``Result``: all that pages and comparisons are drawn from, no raw log needed."""

from __future__ import annotations

import csv
import json
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from ..errors import AttestError
from ..records import Result
from .arrow import is_number, numbers

AGAIN = "run attest smooth again"
TEXT_COLUMNS = frozenset({"kind", "checks", "sensor"})

PASSES = (
    *("timestamp_ns", "t_s", "segment", "moving", "stop_statistic"),
    *(
        f"{name}_{what}"
        for name in ("forward", "backward", "smoothed")
        for what in (
            *(f"q_{part}" for part in "wxyz"),
            *("roll_deg", "pitch_deg", "yaw_deg", "covariance"),
            *(f"sigma_att_{axis}_deg" for axis in "xyz"),
            *(f"gyro_bias_{axis}_rad_s" for axis in "xyz"),
            *(f"sigma_gyro_bias_{axis}_rad_s" for axis in "xyz"),
        )
    ),
    *(f"smoothed_sigma_{angle}_deg" for angle in ("roll", "pitch", "yaw")),
    *(f"{name}_{axis}_deg" for name in ("separation", "sigma_separation") for axis in "xyz"),
    *(f"{name}_{axis}_m" for name in ("position", "sigma_position") for axis in "xyz"),
    *("position_cov_xy_m2", "velocity_x_m_s", "velocity_y_m_s", "velocity_z_m_s"),
)
INNOVATIONS = ("sensor", "t_s", "segment", "dof", "nis", "used", "z0", "z1", "z2")
SEGMENTS = ("index", "kind", "start_ns", "end_ns", "start_s", "end_s", "duration_s", "checks")
"""Columns without which nothing can be drawn."""


def read_result(folder: Path) -> Result:
    """Read ``report.json``, ``passes.parquet``, ``innovations.parquet`` and ``segments.csv``.

    Raises
    ------
    AttestError
        If the folder or one of the files is missing, damaged, or not what attest writes.
    """
    if not folder.is_dir():
        raise AttestError(f"{folder}: no such result folder", "name the folder that attest smooth wrote")
    return Result(
        folder=folder,
        report=_report(folder / "report.json"),
        passes=_columns(folder / "passes.parquet", PASSES),
        innovations=_columns(folder / "innovations.parquet", INNOVATIONS),
        segments=_segments(folder / "segments.csv"),
    )


def _report(path: Path) -> Mapping[str, Any]:
    try:
        report = json.loads(_text(path))
    except (ValueError, RecursionError) as error:
        raise AttestError(f"{path}: damaged: {error}", AGAIN) from None
    if not isinstance(report, dict):
        raise AttestError(f"{path}: holds no report", AGAIN)
    return report


def _columns(path: Path, needed: Sequence[str]) -> Mapping[str, NDArray[Any]]:
    """Return the columns of a Parquet file; lists of fixed size become (n, k)."""
    if not path.is_file():
        raise AttestError(f"{path}: missing from the result", AGAIN)
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:  # read_table would import pandas
            table = file.read(use_threads=False)  # small
    except (pa.ArrowException, OSError) as error:
        raise AttestError(f"{path}: damaged: {str(error).splitlines()[0]}", AGAIN) from None
    _require(path, needed, table.column_names)
    columns = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        if pa.types.is_fixed_size_list(column.type) and is_number(column.type.value_type):
            size = column.type.list_size
            flat = [chunk.values.slice(chunk.offset * size, len(chunk) * size) for chunk in column.chunks]
            columns[name] = numbers(pa.chunked_array(flat, column.type.value_type)).reshape(-1, size)
        elif pa.types.is_string(column.type):
            columns[name] = np.array(column.to_pylist(), dtype=np.str_)
        else:
            columns[name] = numbers(column) if is_number(column.type) else np.empty(0, dtype=np.object_)
        if column.null_count or columns[name].dtype.kind not in ("U" if name in TEXT_COLUMNS else "iufb"):
            raise AttestError(f"{path}: column {name} holds blanks or {column.type}: not as attest writes it", AGAIN)
    return columns


def _require(path: Path, needed: Sequence[str], names: Collection[str]) -> None:
    missing = [name for name in needed if name not in names]
    if missing:
        more = f" (and {len(missing) - 1} more)" if len(missing) > 1 else ""
        raise AttestError(f"{path}: damaged: no column {missing[0]}{more}", AGAIN)


def _segments(path: Path) -> tuple[Mapping[str, Any], ...]:
    table = csv.DictReader(_text(path).splitlines())
    rows = list(table)
    _require(path, SEGMENTS, table.fieldnames or ())
    if any(None in row or None in row.values() for row in rows):
        raise AttestError(f"{path}: damaged: rows of different lengths", AGAIN)
    segments = tuple({name: _value(path, name, cell) for name, cell in row.items()} for row in rows)
    for row in segments:
        if row["kind"] not in {"stop", "motion"} or any(row[name] is None for name in SEGMENTS[:-1]):
            raise AttestError(f"{path}: damaged: segment {row['index']} lacks its kind or its times", AGAIN)
    return segments


def _value(path: Path, name: str, cell: str) -> Any:
    """Parse a cell: number, text where it belongs, or None where it is blank."""
    if not cell:
        return None
    if name in TEXT_COLUMNS:
        return cell[1:] if cell.startswith(("'=", "'+", "'-", "'@")) else cell
    for kind in (int, float):
        try:
            return kind(cell)
        except ValueError:
            continue
    raise AttestError(f"{path}: damaged: {name} is {cell[:40]!r}, not a number", AGAIN)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise AttestError(f"{path}: missing from the result", AGAIN) from None
    except (OSError, UnicodeDecodeError) as error:
        raise AttestError(f"{path}: cannot be read: {error}", AGAIN) from None
