"""The time of a text table: one column, or whole seconds and the rest in two, dates, or a counter with a rate."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from ..errors import AttestError
from ..records import Array, Bools, Ints, Warn
from . import stamps
from .columns import Column
from .dialect import Dialect
from .tables import COUNT_HINT, MAX_BAD_SHARE, WRITTEN, Layout
from .text_numbers import plain
from .written_times import parse

Stamps = tuple[Ints, Array, tuple[Warn, ...]]

_POWER = r"^\s*[-+]?\d+(?:\.(?P<digits>\d*))?[eE]\+?(?P<power>\d\d?\d?)\s*$"
_LARGE = 9  # a power of ten from which a number is a date
_KEPT = 4.0  # a sample's period in units of the last digit, below which a stamp means nothing
_EXACT_NS = 1_000
_SAMPLED = 1_000  # rows that show whether stamps are powers of ten


def stamps_of(
    path: Path, dialect: Dialect, layout: Layout, table: pa.Table, imu_rows: Bools, day_first: bool | None = None
) -> Stamps:
    """Return stamps (n,) ns, where they are valid (1.0 or NaN), and what should be known.

    Raises
    ------
    AttestError
        If there is no readable stamp, the unit cannot be told, or the digits that count are lost.
    """
    if layout.rate_hz is not None:
        found, valid = _counted(layout, table, layout.rate_hz)
        if layout.time.index >= 0 or layout.rate_hz != dialect.rate_hz:
            return found, valid, ()
        message = (
            f"{path.name}: neither time nor counter: rows are counted at {dialect.rate_hz:g} Hz, as the preamble says"
        )
        return found, valid, (Warn("rows-counted", message, "a lost row cannot be seen so: log time or a counter too"),)
    if layout.time.unit in WRITTEN:
        column, *day = (table.column(str(c.index)) for c in (layout.time, layout.date) if c)
        column = pc.binary_join_element_wise(day[0], column, " ") if day else column
        found, valid = parse(path, layout.time.name, column, day_first=day_first)
        time, told = layout.time, tuple[Warn, ...]()
    else:
        time, column, found, valid, told = _numbers(path, dialect, layout, table, imu_rows)
    refuse_unreadable(path, time.name, column, valid)
    return found, valid, told


def refuse_unreadable(path: Path, name: str, column: pa.ChunkedArray, valid: Array) -> None:
    """Refuse a time column of text (n,) where no stamp, or too few, are ``valid``."""
    wrong = pc.filter(column, pa.array(np.isnan(valid) & np.asarray(pc.is_valid(column), dtype=np.bool_)))
    if np.all(np.isnan(valid)) or (len(wrong) > MAX_BAD_SHARE * valid.size and len(wrong) > 1):
        first = f" in {len(wrong)} of {valid.size} rows, the first: {wrong[0].as_py()[:40]!r}" if len(wrong) else ""
        hint = f'write a number or ISO 8601, or map another one: --columns "NAME=time [s]"; {COUNT_HINT}'
        raise AttestError(f"{path}: the time column {name!r} holds no readable time{first}", hint)


def _numbers(
    path: Path, dialect: Dialect, layout: Layout, table: pa.Table, imu_rows: Bools
) -> tuple[Column, pa.ChunkedArray, Ints, Array, tuple[Warn, ...]]:
    """Read times that are numbers; return the column they stand in, and its text, too."""
    text, told = {}, tuple[Warn, ...]()
    for c in layout.times:
        text[c.index], grouped = plain(path, c.name, table.column(str(c.index)), dialect.decimal)
        told += grouped
    time = layout.time
    if layout.recorder is not None and _all_zero(text[time.index]):
        time = layout.recorder
        message = f"{path.name}: {layout.time.name!r} is zero in every row; {time.name!r} is used"
        told += (Warn("zero-stamps", message, "let the driver fill in header.stamp"),)
    column, unit = text[time.index], time.unit
    if unit not in stamps.DIGITS:
        rows = imu_rows if np.any(imu_rows) else ~imu_rows
        values = _floats(column)
        days = stamps.in_days(values[rows], unit, imu=bool(np.any(imu_rows)), path=path)
        if days is not None:
            factor, since, guessed = days
            return time, column, *stamps.from_days(values * factor, since), (*told, *guessed)
        unit, guessed = stamps.guess_unit(values[rows], imu=bool(np.any(imu_rows)), path=path)
        told += guessed
    found, valid = stamps.from_text(column, unit, path)
    if layout.seconds is not None and time is layout.time and int(np.max(found, initial=0)) < 1_000_000_000:
        whole, known = stamps.from_text(text[layout.seconds.index], "s", path)
        found, valid = found + whole, valid + 0.0 * known
    told += _rounded(path, column, found[~np.isnan(valid)], 10 ** stamps.DIGITS[unit])
    return time, column, found, valid, told


def _floats(column: pa.ChunkedArray) -> Array:
    """Read text as floats, NaN where it is no number."""
    number = pc.match_substring_regex(column, stamps.NUMBER)
    text = pc.utf8_trim_whitespace(pc.if_else(number, column, pa.scalar(None, pa.string())))
    return np.asarray(pc.cast(text, pa.float64()).to_numpy(), np.float64)


def _all_zero(column: pa.ChunkedArray) -> bool:
    values = _floats(column)
    return bool(values.size) and not np.any(values[np.isfinite(values)])


def _counted(layout: Layout, table: pa.Table, rate_hz: float) -> tuple[Ints, Array]:
    """Make time of a counter, or of the row where there is none: a lost sample shows in a counter only."""
    if layout.time.index < 0:
        count = np.arange(table.num_rows, dtype=np.float64)
    else:
        count = unwrapped(_floats(table.column(str(layout.time.index))))
    return at_rate(count, rate_hz)


def at_rate(count: Array, rate_hz: float) -> tuple[Ints, Array]:
    """Return stamps (n,) ns of a counter at ``rate_hz`` per second, and where they are valid (1.0 or NaN)."""
    with np.errstate(over="ignore"):  # a damaged cell
        ns = count * (1e9 / rate_hz)
    good = np.abs(ns) < 2.0**63
    return np.rint(np.where(good, ns, 0.0)).astype(np.int64), np.where(good, 1.0, np.nan)


def unwrapped(count: Array) -> Array:
    """Undo the wraps of a counter of 8, 16 or 32 bits: steps back by more than half of its range."""
    known = np.isfinite(count)
    steps = np.diff(count[known])
    if not np.any(steps < 0):
        return count
    largest = float(count[known].max())
    modulus = next((m for m in (2.0**8, 2.0**16, 2.0**32) if largest < m), None)
    if modulus is None:
        return count
    wraps = np.cumsum(np.append(0.0, steps < -0.5 * modulus))
    whole = count.copy()
    whole[known] += wraps * modulus
    return whole


def _rounded(path: Path, column: pa.ChunkedArray, found: Ints, unit_ns: int) -> tuple[Warn, ...]:
    """Say that large stamps were written as powers of ten, as spreadsheets do; refuse where too little is left."""
    if not pc.any(pc.match_substring(column.slice(0, _SAMPLED), "E", ignore_case=True)).as_py():
        return ()
    parts = pc.extract_regex(column, pattern=_POWER).combine_chunks().drop_null()
    if not len(parts):
        return ()
    power = np.asarray(pc.cast(pc.struct_field(parts, "power"), pa.int64()))
    digits = np.asarray(pc.utf8_length(pc.struct_field(parts, "digits")))
    if int(power.max()) < _LARGE:
        return ()
    last_ns = float(unit_ns) * 10.0 ** float(np.min((power - digits)[power >= _LARGE]))
    steps = np.diff(np.sort(found))
    span = float(found.max() - found.min())
    period = span / max(found.size - 1, 1)
    lost = f"{path.name}: stamps such as {column[0].as_py()!r} are rounded to {last_ns * 1e-9:g} s"
    if last_ns * _KEPT > period or np.count_nonzero(steps) < 0.5 * steps.size:
        message = f"{path}: {lost.partition(': ')[2]}: the stamps have no resolution"
        raise AttestError(message, "a spreadsheet has cut them: export the log again, with all digits of the time")
    if last_ns < _EXACT_NS:
        return ()
    return (Warn("stamps-rounded", lost, "a spreadsheet keeps 15 digits: use the log as it was recorded"),)
