"""Dates and times of day as people and spreadsheets write them -> int64 nanoseconds."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from ..errors import AttestError
from ..records import Array, Bools, Ints
from .dialect import TIME
from .stamps import DAY_NS, HOUR_NS, MINUTE_NS, SECOND_NS, from_dates
from .tables import WRITTEN

MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
YEARS = (1970, 2115)
DATES_OUT = "write dates as 2026-06-01; for a log, day_first = true (or false) under [table] of attest.toml"
WAY_OUT = "write times as 2026-06-01T10:00:00.000Z, or as seconds"

_ISO = re.compile(r"\s*\d{4}-\d\d-\d\d([T ].*)?")
_COMPACT = re.compile(r"^\s*(\d{4})(\d\d)(\d\d)[T ](\d\d):?(\d\d):?(\d\d)")
_NEAR = 24  # rows out of order across midnight (the hour) step forward by all but this part of a day (an hour)


def kind_of(cell: str) -> str:
    """Tell how a cell is written, one of ``WRITTEN``; empty where it is no date and no time of day."""
    match = TIME.match(cell)
    if match is None:
        return WRITTEN[0] if _ISO.fullmatch(cell) or _COMPACT.match(cell) else ""
    return WRITTEN[0] if match["a"] else WRITTEN[1] if match["second"] else ""


def parse(path: Path, name: str, column: pa.ChunkedArray, *, day_first: bool | None = None) -> tuple[Ints, Array]:
    """Read text as ns since 1970, or since midnight of the first day where there is no date; and where it is valid.

    Parameters
    ----------
    name : str
        Of the column, for messages.
    column : (n,) strings
        ISO 8601 with or without zone (none is UTC), ``20260601T100000``, ``1.6.2026 10:00:00``,
        ``06/13/2026 10:00:00 AM``, ``01-Jun-2026 10:00:00``, ``10:00:00.123``, ``05:12.3`` (minutes and seconds).
        Times without a date that step back by more than half a day (hour) have passed midnight (the hour); minutes
        from 60 on are those of a stopwatch.
    day_first : bool, optional
        Whether the day stands before the month in ``01/06/2026``; None: where a number above 12 tells it.

    Raises
    ------
    AttestError
        If the first cell is no time, has no seconds, or its date can be read in two ways.
    """
    first = next((cell.as_py() for cell in column if cell.is_valid and cell.as_py().strip()), "")
    if _COMPACT.match(first):
        column = pc.replace_substring_regex(column, _COMPACT.pattern, r"\1-\2-\3T\4:\5:\6")
        first = _COMPACT.sub(r"\1-\2-\3T\4:\5:\6", first)
    for zone in ("UTC", None) if _ISO.fullmatch(first) else ():  # fast
        try:
            return from_dates(pc.cast(column, pa.timestamp("ns", zone)))
        except pa.ArrowInvalid:
            continue
    parts = _Parts(column)
    _refuse_unclear(path, name, first)
    ns, valid = _of_day(parts)
    ns -= _zone_ns(path, name, parts)
    if not parts.dated.any():
        with_hours, minutes = parts.number("hour", -1).max() >= 0, parts.number("minute").max()
        if with_hours or minutes < 60:
            ns[valid] = _unwrapped(ns[valid], DAY_NS if with_hours else HOUR_NS)
        return ns, np.where(valid, 1.0, np.nan)
    days, known = _days(path, name, parts, day_first)
    valid &= known
    return np.where(valid, ns + days * DAY_NS, 0), np.where(valid, 1.0, np.nan)


class _Parts:
    """The parts of each cell as text (n,); empty where the cell is none, or does not have it."""

    def __init__(self, column: pa.ChunkedArray) -> None:
        found = pc.extract_regex(column, pattern=TIME.pattern)
        self._found = found.combine_chunks() if isinstance(found, pa.ChunkedArray) else found
        self.clock: Bools = self._has("second")
        self.dated: Bools = self._has("a")

    def text(self, key: str) -> Any:
        return pc.fill_null(pc.struct_field(self._found, key), "")

    def _has(self, key: str) -> Bools:
        return np.asarray(pc.not_equal(self.text(key), ""), dtype=np.bool_)

    def number(self, key: str, absent: int = 0) -> Ints:
        text = self.text(key)
        digits = pc.if_else(pc.utf8_is_digit(text), text, pa.scalar(str(absent)))
        return np.asarray(pc.cast(digits, pa.int64()), dtype=np.int64)


def _refuse_unclear(path: Path, name: str, first: str) -> None:
    """Refuse a first cell that is no time, and times of hours and minutes only."""
    match = TIME.match(first)
    if match is None or not (match["a"] or match["second"]):
        raise AttestError(f"{path}: the time column {name!r} cannot be read: {first[:40]!r} is no time", WAY_OUT)
    if match["second"] and not match["hour"] and (match["a"] or match["half"] or not match["fraction"]):
        message = f"{path}: the time column {name!r} has hours and minutes only, the first cell is {first[:40]!r}"
        raise AttestError(message, "a spreadsheet shows times so: format its cells as hh:mm:ss.000, and export again")


def _of_day(parts: _Parts) -> tuple[Ints, Bools]:
    """Return ns since midnight, and where they are those of a clock."""
    hour, minute, second = (parts.number(key) for key in ("hour", "minute", "second"))
    half = pc.utf8_lower(parts.text("half"))
    noon, twelve = (np.asarray(pc.equal(half, mark), dtype=np.bool_) for mark in ("p", "a"))
    elapsed = (parts.number("hour", -1) < 0) & ~parts.dated & np.asarray(pc.equal(half, ""), dtype=np.bool_)
    valid = (hour < 24) & ((minute < 60) | elapsed) & (second <= 60) & (parts.clock | parts.dated)
    valid &= ~(noon | twelve) | ((hour >= 1) & (hour <= 12))
    hour = np.where(noon | twelve, hour % 12 + 12 * noon, hour)
    digits = pc.utf8_rpad(pc.utf8_slice_codeunits(parts.text("fraction"), 0, 9), 9, "0")
    fraction = np.asarray(pc.cast(digits, pa.int64()), dtype=np.int64)
    return hour * HOUR_NS + minute * MINUTE_NS + second * SECOND_NS + fraction, valid


def _zone_ns(path: Path, name: str, parts: _Parts) -> Ints:
    """Return how far the zone of each cell is ahead of UTC; some with and others without are refused."""
    zones = pc.dictionary_encode(pc.filter(parts.text("zone"), pa.array(parts.clock)))
    found = zones.dictionary.to_pylist()
    if len(found) > 1 and "" in found:
        raise AttestError(f"{path}: the time column {name!r} has times with a zone, and without", WAY_OUT)
    offsets = np.zeros(len(found) + 1, dtype=np.int64)
    for k, zone in enumerate(found):
        if zone[:1] in {"+", "-"}:
            digits = zone[1:].replace(":", "").ljust(4, "0")
            size = int(digits[:2]) * HOUR_NS + int(digits[2:]) * MINUTE_NS
            offsets[k] = -size if zone[0] == "-" else size
    out = np.zeros(parts.clock.size, dtype=np.int64)
    out[parts.clock] = offsets[np.asarray(zones.indices, dtype=np.int64)]
    return out


def _days(path: Path, name: str, parts: _Parts, day_first: bool | None) -> tuple[Ints, Bools]:
    """Return days since 1970, and where they are those of a calendar."""
    a, b, c = (parts.number(key) for key in "abc")
    word = pc.utf8_slice_codeunits(pc.utf8_lower(parts.text("b")), 0, 3)
    named = np.asarray(pc.fill_null(pc.index_in(word, pa.array(MONTHS)), -1), dtype=np.int64) + 1
    b = np.where(named > 0, named, b)
    lengths = {key: np.asarray(pc.utf8_length(parts.text(key)), dtype=np.int64) for key in "ac"}
    year_first = parts.dated & ((a > 31) | (lengths["a"] > 2))
    swapped = parts.dated & ~year_first & (named == 0)  # day or month first
    if day_first is None:
        _refuse_short_years(path, name, parts, swapped & (lengths["a"] == 2) & (lengths["c"] == 2) & (b <= 12))
    if swapped.any() and not _is_day_first(path, name, parts, a, b, swapped, day_first):
        a, b = np.where(swapped, b, a), np.where(swapped, a, b)
    year, day = np.where(year_first, a, c), np.where(year_first, c, a)
    short = np.where(year_first, lengths["a"], lengths["c"]) <= 2
    year = np.where(short, year + 2000, year)
    valid = parts.dated & (year >= YEARS[0]) & (year <= YEARS[1]) & (b >= 1) & (b <= 12) & (day >= 1)
    months = np.where(valid, (year - 1970) * 12 + b - 1, 0)
    first = months.astype("datetime64[M]").astype("datetime64[D]").astype(np.int64)
    after = (months + 1).astype("datetime64[M]").astype("datetime64[D]").astype(np.int64)
    valid &= first + day <= after
    return np.where(valid, first + day - 1, 0), valid


def _refuse_short_years(path: Path, name: str, parts: _Parts, rows: Bools) -> None:
    """Refuse dates such as 26-06-13, of which the first part and the last could be the year, in every row."""
    days = parts.number("c")
    points = np.asarray(pc.equal(parts.text("mark"), "."), dtype=np.bool_)
    if rows.any() and np.all((rows & ~points & (days >= 1) & (days <= 31)) | ~parts.dated):
        a, mark, b, c = (pc.filter(parts.text(key), pa.array(rows))[0].as_py() for key in ("a", "mark", "b", "c"))
        message = f"{path}: year first or last? The time column {name!r} begins with {a}{mark}{b}{mark}{c}"
        raise AttestError(message, f"{DATES_OUT} also says that the year is last")


def _is_day_first(path: Path, name: str, parts: _Parts, a: Ints, b: Ints, rows: Bools, day_first: bool | None) -> bool:
    """Tell whether the day stands before the month: as said, by points between them, by a number above 12."""
    if day_first is not None:
        return day_first
    if np.all(np.asarray(pc.equal(pc.filter(parts.text("mark"), pa.array(rows)), "."))):
        return True
    if np.all(a[rows] <= 12) and np.all(b[rows] <= 12):
        cells = (f"{x}/{y}/{z}" for x, y, z in zip(*(parts.text(key).to_pylist() for key in "abc"), strict=True) if x)
        message = f"{path}: day or month first? The time column {name!r} begins with {next(cells)}"
        raise AttestError(message, f"{DATES_OUT} says it")
    return bool(np.any(a[rows] > 12))


def _unwrapped(ns: Ints, period: int) -> Ints:
    """Add a day (or an hour) where the clock began again; rows out of order across it keep theirs, a pause stays."""
    steps = np.diff(ns, prepend=ns[:1])
    turns = np.where((steps < 0) | (period - steps < period // _NEAR), -np.rint(steps / period), 0.0).astype(np.int64)
    return ns + period * np.cumsum(turns)
