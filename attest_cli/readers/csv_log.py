"""CSV logs: dialect, header and units row are told from the first lines, the numbers are read by Arrow."""

from __future__ import annotations

import io
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pv

from ..errors import AttestError
from ..records import Recording, Warn
from ..settings import Settings
from .columns import Column, recognise
from .dialect import BLANKS, NUMBER, Dialect, cells_of, decimal_of, head_lines, layout, sniff
from .stamps import taken_unit
from .tables import MAX_BAD_SHARE, WRITTEN, Layout, check_size, layout_of, recording_of
from .text_numbers import plain
from .text_stamps import stamps_of
from .written_times import kind_of

__all__ = ["BLANKS", "columns_of", "read", "sniff"]

MOST_TYPES = 50
"""Types of rows that are counted one by one, where no columns are named for them."""


@dataclass(frozen=True, slots=True)
class _Text:
    """A table in a file, or in the rows of one type of it."""

    path: Path
    dialect: Dialect
    layout: Layout
    rows: bytes | None = None

    def source(self) -> Any:
        """Return what Arrow reads: the file, or bytes where rows or blanks had to be sorted out."""
        if self.rows is not None:
            return io.BytesIO(self.rows)
        if self.dialect.delimiter != " ":
            return self.path
        lines = self.path.read_bytes().replace(b"\t", b" ").splitlines()  # blanks in a row are one delimiter
        return io.BytesIO(b"\n".join(b" ".join(line.split()) for line in lines) + b"\n")


def read(path: Path, settings: Settings) -> Recording:
    """Read a text table into channels; see ``readers.read``."""
    if settings.table.rows:
        return _read_types(path, settings)
    return _recording(path, sniff(path, settings.table), settings)


def columns_of(path: Path, dialect: Dialect, settings: Settings) -> Layout:
    """Return which columns of a text table are what."""
    rate, recorder = settings.table.sample_rate_hz or dialect.rate_hz, settings.time.source != "header"
    return layout_of(path, dialect.names, dialect.units, settings.table, rate_hz=rate, recorder=recorder)


def timed(layout: Layout, table: pa.Table) -> Layout:
    """Say in the layout whether its times are written as such, and take the date only where it belongs to them."""

    def kind(column: Column | None) -> str:
        cells = table.column(str(column.index)) if column is not None else ()
        return kind_of(next((cell.as_py() for cell in cells if cell.is_valid and cell.as_py().strip()), ""))

    written = kind(layout.time) if layout.rate_hz is None else ""
    if not written:
        return replace(layout, date=None)
    if written == WRITTEN[1] and kind(layout.date) == WRITTEN[0]:
        return replace(layout, time=replace(layout.time, unit=WRITTEN[0]))
    return replace(layout, time=replace(layout.time, unit=written), date=None)


def _recording(path: Path, dialect: Dialect, settings: Settings, rows: bytes | None = None) -> Recording:
    layout = columns_of(path, dialect, settings)
    text = _Text(path, dialect, layout, rows)
    bad: list[tuple[int | None, str]] = []
    columns, told = _table(text, bad)
    check_size(path, columns.num_rows, columns.num_columns)
    if columns.num_rows == 0:
        raise AttestError(f"{path}: the table has no rows", "was the recording empty?")
    if len(bad) > MAX_BAD_SHARE * (columns.num_rows + len(bad)) and len(bad) > 1:
        message = f"{path}: {len(bad)} rows have not the {len(dialect.names)} cells of the header: {bad[0][1][:60]!r}"
        raise AttestError(message, "make it one table with one header; --columns names rows of several types")
    layout = timed(layout, columns)
    if bad:
        cells = f"{len(dialect.names)} cells, the first: {bad[0][1][:60]!r}"
        message = f"{path.name}: {len(bad)} rows skipped that have not {cells}"
        told = (*told, Warn("ragged-rows", message, "mend or delete these lines"))
    values = {c.index: np.asarray(columns.column(str(c.index)).to_numpy(), np.float64) for c in layout.columns}
    found = recording_of(
        path,
        "csv",
        layout,
        values,
        lambda imu_rows: stamps_of(path, dialect, layout, columns, imu_rows, settings.table.day_first),
        told,
    )
    return replace(found, notes=(dialect.told, *found.notes))


def _read_types(path: Path, settings: Settings) -> Recording:
    """Read rows of several types, each with columns of its own, as one recording."""
    table = settings.table
    delimiter, head = layout(path, head_lines(path), table)
    mark = table.decimal or decimal_of(path, [cells for _, cells in head])
    parts = []
    left: dict[str, int] = {}
    rows = _sorted_out(path, delimiter, settings, left)
    for kind, names in sorted(table.rows.items(), key=lambda item: not _inertial(item[1])):
        if not rows[kind]:
            raise AttestError(f"{path}: no row of type {kind!r}", f"there are {', '.join(sorted(left)[:8]) or 'none'}")
        first = cells_of(rows[kind][0], delimiter)
        if len(first) != len(names):
            message = f"{path}: {len(names)} columns are named for rows of type {kind!r}, which have {len(first)} cells"
            raise AttestError(message, 'name all of them, "-" for one that is not used')
        told = f"rows of type {kind!r}: {', '.join(names)}"
        dialect = Dialect(delimiter, mark, 0, list(names), [""] * len(names), first, None, told)
        parts.append((kind, _recording(path, dialect, settings, "\n".join([*rows[kind], ""]).encode())))
        guessed = taken_unit(parts[-1][1].warnings)
        if guessed and not settings.table.time_unit:  # one clock stamps all rows; the IMU's steps tell its unit best
            table = table.model_copy(update={"time_unit": guessed})
            settings = settings.model_copy(update={"table": table})
    taken = [channel.name for _, part in parts for channel in part.channels]
    channels = tuple(
        replace(channel, name=f"{kind}/{channel.name}") if taken.count(channel.name) > 1 else channel
        for kind, part in parts
        for channel in part.channels
    )
    other = {f"rows {kind}": f"{count} rows" for kind, count in sorted(left.items())}
    warnings = tuple(dict.fromkeys(warning for _, part in parts for warning in part.warnings))
    notes = tuple(note for _, part in parts for note in part.notes)
    missing = {column: warning for _, part in parts for column, warning in part.missing.items()}
    return Recording(path, "csv", channels, sum(part.rows for _, part in parts), other, warnings, notes, missing)


def _inertial(names: Sequence[str]) -> bool:
    """Tell whether columns hold a gyro or an accelerometer."""
    known = {column.canonical[:-2] for name in names if (column := recognise(0, name)) is not None}
    return bool(known & {"gyro", "accel"})


def _sorted_out(path: Path, delimiter: str, settings: Settings, left: dict[str, int]) -> dict[str, list[str]]:
    """Sort lines by their type; ``left`` counts those of types that no columns are named for."""
    places = {}
    for kind, names in settings.table.rows.items():
        if "type" not in names:
            raise AttestError(f"{path}: which column of rows {kind!r} holds the type?", 'name that column "type"')
        places[kind] = names.index("type")
    rows: dict[str, list[str]] = {kind: [] for kind in places}
    with path.open(encoding="utf-8-sig", errors="replace") as stream:
        for line in stream:
            cells = [cell.strip() for cell in cells_of(line.rstrip("\r\n"), delimiter)]
            mine = [kind for kind, place in places.items() if len(cells) > place and cells[place] == kind]
            if mine:
                rows[mine[0]].append(line.rstrip("\r\n"))
            elif cells:
                name = cells[min(places.values())] if len(cells) > min(places.values()) else cells[0]
                name = name[:20] if name[:20] in left or len(left) < MOST_TYPES else "of other types"
                left[name] = left.get(name, 0) + 1
    return rows


def _table(text: _Text, bad: list[tuple[int | None, str]]) -> tuple[pa.Table, tuple[Warn, ...]]:
    """Read the columns in use as float64, time as text; cells of text become blank and are counted."""
    try:
        return _arrow(text, bad, pa.float64()), ()
    except pa.ArrowInvalid:
        bad.clear()
    path = text.path
    try:
        table = _arrow(text, bad, pa.string())
    except (pa.ArrowInvalid, OSError) as error:
        raise AttestError(
            f"{path}: cannot be read: {str(error).splitlines()[0]}", "is it one table in UTF-8?"
        ) from None
    told: list[Warn] = []
    for column in text.layout.columns:
        cells, grouped = plain(path, column.name, table.column(str(column.index)), text.dialect.decimal)
        told += grouped
        number = pc.fill_null(pc.match_substring_regex(cells, rf"(?i)^({NUMBER.pattern})$"), fill_value=False)
        number = pc.and_(number, pc.invert(pc.fill_null(pc.match_substring(cells, ","), fill_value=False)))
        wrong = pc.filter(table.column(str(column.index)), pc.and_(pc.is_valid(cells), pc.invert(number)))
        if len(wrong) > MAX_BAD_SHARE * table.num_rows and len(wrong) > 1:
            message = (
                f"{path}: column {column.name!r} holds text in {len(wrong)} rows, the first: {wrong[0].as_py()[:40]!r}"
            )
            raise AttestError(message, "only numbers and blanks can stand there")
        if len(wrong):
            some = f"{len(wrong)} cells of {column.name!r}"
            message = f"{path.name}: {some} are no numbers and count as blank: {wrong[0].as_py()[:40]!r}"
            told.append(Warn("text-cells", message, "mend these cells"))
        numbers = pc.cast(
            pc.utf8_trim_whitespace(pc.if_else(number, cells, pa.scalar(None, pa.string()))), pa.float64()
        )
        table = table.set_column(table.schema.get_field_index(str(column.index)), str(column.index), numbers)
    return table, tuple(told)


def _arrow(text: _Text, bad: list[tuple[int | None, str]], kind: pa.DataType) -> pa.Table:
    """Let Arrow read the columns in use; rows with a wrong number of cells are noted in ``bad``."""

    def skip(row: Any) -> str:
        if not row.text.lstrip().startswith(("#", "//", "%")):
            bad.append((row.number, row.text))
        return "skip"

    dialect = text.dialect
    numbers = [str(column.index) for column in text.layout.columns]
    times = [str(column.index) for column in text.layout.times]
    parsing = pv.ParseOptions(delimiter=dialect.delimiter, invalid_row_handler=skip)
    converting = pv.ConvertOptions(
        include_columns=[*times, *numbers],
        column_types={**dict.fromkeys(times, pa.string()), **dict.fromkeys(numbers, kind)},
        null_values=BLANKS,
        strings_can_be_null=True,
        decimal_point=dialect.decimal,
    )
    names = [str(k) for k in range(len(dialect.names))]
    reading = pv.ReadOptions(skip_rows=dialect.skip, column_names=names)
    with _undecoded() as seen:
        try:
            return pv.read_csv(text.source(), reading, parsing, converting)
        except pa.ArrowInvalid:
            if not seen:
                raise
    bad.clear()
    reading.encoding = "latin1"
    return pv.read_csv(text.source(), reading, parsing, converting)


@contextmanager
def _undecoded() -> Iterator[list[BaseException]]:
    """Collect the rows that Arrow could not hand to ``skip`` as text: it tells nobody but the interpreter."""
    seen: list[BaseException] = []
    usual = sys.unraisablehook

    def notice(event: Any) -> None:
        if isinstance(event.exc_value, UnicodeDecodeError):
            seen.append(event.exc_value)
        else:
            usual(event)

    sys.unraisablehook = notice
    try:
        yield seen
    finally:
        sys.unraisablehook = usual
