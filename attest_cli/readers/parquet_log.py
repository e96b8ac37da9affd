"""Parquet logs: only the columns in use are read, page checksums are verified."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from ..errors import AttestError
from ..records import COLUMNS, Array, Bools, Ints, Recording, Warn
from ..settings import Settings
from . import stamps
from .arrow import is_number, numbers
from .columns import Column
from .tables import WRITTEN, Layout, check_size, layout_of, recording_of
from .text_stamps import Stamps, at_rate, refuse_unreadable, unwrapped
from .written_times import kind_of, parse

NS_PER_S = 1_000_000_000


def read(path: Path, settings: Settings) -> Recording:
    """Read a Parquet table into channels; see ``readers.read``."""
    try:
        file = pq.ParquetFile(path, page_checksum_verification=True)
        schema = file.schema_arrow
        names = _named(path, schema.names, settings.table.columns)
        units = [_stated_unit(schema.field(i)) for i in range(len(names))]
        rate, recorder = settings.table.sample_rate_hz, settings.time.source != "header"
        layout = layout_of(path, names, units, settings.table, rate_hz=rate, recorder=recorder)
        rows = file.metadata.num_rows
        check_size(path, rows, len(layout.times) + len(layout.columns))
        if rows == 0:
            raise AttestError(f"{path}: the table has no rows", "was the recording empty?")
        day = settings.table.day_first
        times = {c.index: _column(file, schema, c.index) for c in layout.times}
        values = _values(path, file, schema, layout)
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        reason = str(error).splitlines()[0]
        raise AttestError(
            f"{path}: damaged Parquet: {reason}", "copy it again; a damaged page cannot be mended"
        ) from None
    return recording_of(path, "parquet", layout, values, lambda imu_rows: stamps_of(path, layout, times, imu_rows, day))


class Columns(Mapping[int, Array]):
    """Columns (n,) by their index in the table; of one that is mostly blank only its values are kept, and spread over
    its rows when they are asked for.
    """

    def __init__(self) -> None:
        self._whole: dict[int, Array] = {}
        self._few: dict[int, tuple[int, Ints, Array]] = {}  # rows of the table, rows with a value, values

    def keep(self, index: int, column: Array) -> None:
        """Keep a column."""
        known = np.flatnonzero(~np.isnan(column))
        if 2 * known.size > column.size:
            self._whole[index] = column
            return
        alike = (rows for _, rows, _ in self._few.values() if np.array_equal(rows, known))  # those of one sensor
        self._few[index] = (column.size, next(alike, known), column[known])

    def __getitem__(self, index: int) -> Array:
        if index in self._whole:
            return self._whole[index]
        size, rows, values = self._few[index]
        out = np.full(size, np.nan)
        out[rows] = values
        return out

    def __iter__(self) -> Iterator[int]:
        return iter((*self._whole, *self._few))

    def __len__(self) -> int:
        return len(self._whole) + len(self._few)


def _values(path: Path, file: pq.ParquetFile, schema: pa.Schema, layout: Layout) -> Columns:
    """Read the columns in use, one by one: all at once would be held twice; those of the IMU side by side in a table,
    as they are used.
    """
    rows, inertial = file.metadata.num_rows, COLUMNS["imu"]
    tables = {c.instance: np.empty((rows, len(inertial))) for c in layout.columns if c.canonical in inertial}
    values = Columns()
    for c in layout.columns:
        found = _floats(path, c.name, _column(file, schema, c.index))
        if c.canonical in inertial:
            place = tables[c.instance][:, inertial.index(c.canonical)]
            place[:] = found
            found = place
        values.keep(c.index, found)
    return values


def _named(path: Path, names: Sequence[str], wanted: Sequence[str]) -> list[str]:
    """Put the names of the settings, where there are any, in place of all those of the file."""
    if wanted and len(wanted) != len(names):
        message = f"{path}: {len(wanted)} columns are named, but the table has {len(names)}"
        raise AttestError(message, 'name all of them with --columns, "-" for one that is not used')
    return list(wanted or names)


def _column(file: pq.ParquetFile, schema: pa.Schema, index: int) -> pa.ChunkedArray:
    column = file.read([schema.names[index]]).column(0)
    if len(column) != file.metadata.num_rows:
        raise pa.ArrowInvalid(f"column {index + 1} has {len(column)} of {file.metadata.num_rows} rows")
    return column


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


def stamps_of(
    path: Path, layout: Layout, times: Mapping[int, pa.ChunkedArray], imu_rows: Bools, day_first: bool | None = None
) -> Stamps:
    """Return the time of the rows; whole seconds in a column of their own are added to a time within the second."""
    if layout.rate_hz is not None:
        counter = times.get(layout.time.index)
        count = np.arange(imu_rows.size) if counter is None else unwrapped(_floats(path, layout.time.name, counter))
        return (*at_rate(count.astype(np.float64), layout.rate_hz), ())
    time, told = layout.time, tuple[Warn, ...]()
    if layout.recorder is not None and _all_zero(times[time.index]):
        time = layout.recorder
        message = f"{path.name}: {layout.time.name!r} is zero in every row; {time.name!r} is used"
        told = (Warn("zero-stamps", message, "let the driver fill in header.stamp"),)
    found, valid, guessed = _of_column(path, time, _dated(layout, time, times), imu_rows, day_first)
    if layout.seconds is not None and time is layout.time and int(np.max(found, initial=0)) < NS_PER_S:
        whole, known, _ = _of_column(path, layout.seconds, times[layout.seconds.index], imu_rows, day_first)
        found, valid = found + whole, valid + 0.0 * known
    return found, valid, (*told, *guessed)


def _dated(layout: Layout, time: Column, times: Mapping[int, pa.ChunkedArray]) -> pa.ChunkedArray:
    """Return a column of times; those of a day that are text behind their date."""
    column, texts = times[time.index], (pa.types.is_string, pa.types.is_large_string, pa.types.is_time)
    if time is not layout.time or layout.date is None or not any(is_kind(column.type) for is_kind in texts):
        return column
    text = column.cast(pa.string())
    first = next((cell.as_py() for cell in text if cell.is_valid), "")
    date = times[layout.date.index]
    return pc.binary_join_element_wise(date.cast(pa.string()), text, " ") if kind_of(first) == WRITTEN[1] else column


def _all_zero(column: pa.ChunkedArray) -> bool:
    return is_number(column.type) and not np.any(np.nan_to_num(numbers(column)))


def _of_column(path: Path, time: Column, column: pa.ChunkedArray, imu_rows: Bools, day_first: bool | None) -> Stamps:
    kind, unit = column.type, time.unit
    if pa.types.is_time(kind):
        column = column.cast(pa.string())
    if pa.types.is_string(column.type) or pa.types.is_large_string(kind):
        text = column.cast(pa.string())
        found, valid = parse(path, time.name, text, day_first=day_first)
        refuse_unreadable(path, time.name, text, valid)
        return found, valid, ()
    if pa.types.is_timestamp(kind):
        return (*stamps.from_dates(column), ())
    if not (pa.types.is_integer(kind) or pa.types.is_floating(kind)):
        raise AttestError(f"{path}: the time column {time.name!r} is of type {kind}", stamps.WAY_OUT)
    counts = numbers(column)
    told: tuple[Warn, ...] = ()
    if unit not in stamps.DIGITS:
        rows = imu_rows if np.any(imu_rows) else ~imu_rows
        days = stamps.in_days(np.asarray(counts[rows], np.float64), unit, imu=bool(np.any(imu_rows)), path=path)
        if days is not None:
            return (*stamps.from_days(np.asarray(counts, np.float64) * days[0], days[1]), days[2])
        unit, told = stamps.guess_unit(np.asarray(counts[rows], np.float64), imu=bool(np.any(imu_rows)), path=path)
    return (*stamps.from_numbers(counts, unit), told)
