"""Parquet logs: only the columns in use are read, page checksums are verified."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ..errors import AttestError
from ..records import Array, Bools, Ints, Recording, Warn
from ..settings import Settings
from . import stamps
from .arrow import numbers
from .tables import Layout, check_size, layout_of, recording_of


def read(path: Path, settings: Settings) -> Recording:  # noqa: ARG001 (every reader has this signature)
    """Read a Parquet table into channels; see ``readers.read``."""
    try:
        file = pq.ParquetFile(path, page_checksum_verification=True)
        schema = file.schema_arrow
        layout = layout_of(path, schema.names, [_stated_unit(schema.field(i)) for i in range(len(schema.names))])
        used = [layout.time, *layout.columns]
        check_size(path, file.metadata.num_rows, len(used))
        time = file.read([layout.time.name]).column(layout.time.name)
        if len(time) == 0:
            raise AttestError(f"{path}: the table has no rows", "was the recording empty?")
        values = {  # one by one: all at once would be held twice
            column.index: _floats(path, column.name, file.read([column.name]).column(column.name))
            for column in layout.columns
        }
    except (pa.ArrowException, OSError) as error:
        reason = str(error).splitlines()[0]
        raise AttestError(
            f"{path}: damaged Parquet: {reason}", "copy it again; a damaged page cannot be mended"
        ) from None
    return recording_of(path, "parquet", layout, values, lambda imu_rows: _stamps(path, layout, time, imu_rows))


def _stated_unit(field: pa.Field) -> str:
    """Return the unit in the metadata of the field, empty where there is none."""
    metadata = field.metadata or {}
    return str((metadata.get(b"unit") or metadata.get(b"units") or b"").decode("utf-8", "replace"))


def _floats(path: Path, name: str, column: pa.ChunkedArray) -> Array:
    """Return a column as float64 with NaN where it is null."""
    try:
        cast = column if pa.types.is_floating(column.type) else column.cast(pa.float64())
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as error:
        raise AttestError(f"{path}: column {name!r} holds no numbers: {str(error).splitlines()[0]}") from None
    return np.asarray(numbers(cast), dtype=np.float64)


def _stamps(
    path: Path, layout: Layout, column: pa.ChunkedArray, imu_rows: Bools
) -> tuple[Ints, Array, tuple[Warn, ...]]:
    kind, unit = column.type, layout.time.unit
    if pa.types.is_string(kind) or pa.types.is_large_string(kind):
        column = stamps.parse_dates(column, path)
        kind = column.type
    if pa.types.is_timestamp(kind):
        return (*stamps.from_dates(column), ())
    if not (pa.types.is_integer(kind) or pa.types.is_floating(kind)):
        raise AttestError(f"{path}: the time column {layout.time.name!r} is of type {kind}", stamps.WAY_OUT)
    counts = numbers(column)
    told: tuple[Warn, ...] = ()
    if unit not in stamps.DIGITS:
        rows = imu_rows if np.any(imu_rows) else ~imu_rows
        unit, told = stamps.guess_unit(np.asarray(counts[rows], np.float64), imu=bool(np.any(imu_rows)), path=path)
    return (*stamps.from_numbers(counts, unit), told)
