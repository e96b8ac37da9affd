"""Result folder -> ``Result``: all that pages and comparisons are drawn from, no raw log needed."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from ..errors import AttestError
from ..records import Result

AGAIN = "run attest smooth again"
TEXT_COLUMNS = frozenset({"kind", "checks"})


def read_result(folder: Path) -> Result:
    """Read ``report.json``, ``passes.parquet``, ``innovations.parquet`` and ``segments.csv``.

    Raises
    ------
    AttestError
        If the folder or one of the files is missing or damaged.
    """
    if not folder.is_dir():
        raise AttestError(f"{folder}: no such result folder", "name the folder that attest smooth wrote")
    return Result(
        folder=folder,
        report=_report(folder / "report.json"),
        passes=_columns(folder / "passes.parquet"),
        innovations=_columns(folder / "innovations.parquet"),
        segments=_segments(folder / "segments.csv"),
    )


def _report(path: Path) -> Mapping[str, Any]:
    try:
        report = json.loads(_text(path))
    except ValueError as error:
        raise AttestError(f"{path}: damaged: {error}", AGAIN) from None
    if not isinstance(report, dict):
        raise AttestError(f"{path}: holds no report", AGAIN)
    return report


def _columns(path: Path) -> Mapping[str, NDArray[Any]]:
    """Return the columns of a Parquet file; lists of fixed size become (n, k)."""
    if not path.is_file():
        raise AttestError(f"{path}: missing from the result", AGAIN)
    try:
        table = pq.read_table(path, page_checksum_verification=True)
    except (pa.ArrowException, OSError) as error:
        raise AttestError(f"{path}: damaged: {str(error).splitlines()[0]}", AGAIN) from None
    columns = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        if pa.types.is_fixed_size_list(column.type):
            flat = column.combine_chunks().flatten().to_numpy(zero_copy_only=False)
            columns[name] = flat.reshape(-1, column.type.list_size)
        elif pa.types.is_string(column.type):
            columns[name] = np.array(column.to_pylist(), dtype=np.str_)
        else:
            columns[name] = column.to_numpy()
    return columns


def _segments(path: Path) -> tuple[Mapping[str, Any], ...]:
    rows = list(csv.DictReader(_text(path).splitlines()))
    if any(None in row or None in row.values() for row in rows):
        raise AttestError(f"{path}: damaged: rows of different lengths", AGAIN)
    return tuple({name: _value(name, cell) for name, cell in row.items()} for row in rows)


def _value(name: str, cell: str) -> Any:
    """Parse a cell: number, text, or None where it is blank."""
    if cell == "":
        return None
    if name in TEXT_COLUMNS:
        return cell[1:] if cell.startswith(("'=", "'+", "'-", "'@")) else cell
    for kind in (int, float):
        try:
            return kind(cell)
        except ValueError:
            continue
    return cell


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise AttestError(f"{path}: missing from the result", AGAIN) from None
    except (OSError, UnicodeDecodeError) as error:
        raise AttestError(f"{path}: cannot be read: {error}", AGAIN) from None
