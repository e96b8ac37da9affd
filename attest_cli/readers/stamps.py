"""Time columns -> int64 nanoseconds, exactly: decimals are read as decimals, never through a float."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from ..errors import AttestError
from ..records import LATEST_NS, Array, Ints, Warn

DIGITS = {"s": 9, "ms": 6, "us": 3, "ns": 0}
"""Unit of time -> decimals down to the nanosecond."""

EPOCH_S = (6.3e8, 4.1e9)  # 1990 to 2100: seconds that are a date
PERIOD_S = (1e-4, 1.0)  # periods an IMU can have
OTHER_PERIOD_S = (1e-3, 3600.0)  # periods other sensors can have
LONGEST_STEP_S = 90.0  # a sensor without a unit of time that steps by more counts no seconds
SECOND_NS, MINUTE_NS, HOUR_NS, DAY_NS = 10**9, 60 * 10**9, 3600 * 10**9, 86_400 * 10**9
LONG_UNITS_S = {"min": MINUTE_NS / SECOND_NS, "h": HOUR_NS / SECOND_NS, "d": DAY_NS / SECOND_NS}
SERIAL_DAYS = {25_569: (25_569.0, 8e4), 719_529: (719_529.0, 7.7e5)}
"""Days from the origin of a spreadsheet's or Matlab's calendar to 1970 -> days that are a date in it."""
SHORTEST_S = {True: PERIOD_S[0], False: 4e-4}  # of an IMU or not: shorter steps are none in seconds
HOURS_PERIOD_S = {True: 2e-3, False: 0.05}  # of an IMU or not: shorter ones are no sensor's, if hours are counted
NUMBER = r"^\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*$"
"""Text that is a stamp."""

WAY_OUT = (
    'name the unit in the header: "timestamp_ns", "time [ms]", "t_us", "t [h]"; for a text log also with --time-unit'
)


def guess_unit(raw: Array, *, imu: bool, path: Path) -> tuple[str, tuple[Warn, ...]]:
    """Infer the unit of a time column that states none, from its magnitude and, for an IMU, from its median step.

    Seconds need no warning (``interface.md``: ``timestamp``, ``time``, ``t`` in s); any other unit is said.

    Raises
    ------
    AttestError
        If none or more than one unit fits.
    """
    finite = raw[np.isfinite(raw)]
    steps = np.diff(finite)
    step = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
    if _on_a_clock(finite, steps):
        message = f"{path}: the time column counts hours, minutes and seconds in one number (hhmmss), not seconds"
        raise AttestError(message, 'write times as 10:00:45.000; if they are seconds, name the column "time [s]"')
    dated = _fitting(float(np.median(finite)), EPOCH_S) if finite.size else []
    if imu:
        found = _fitting(step, PERIOD_S)
        found = [unit for unit in found if unit in dated] or found
        if "s" in found and not np.all(finite == np.floor(finite)):  # fractions of a plain `t` are seconds
            found = ["s"]
        if len(found) != 1:  # stamps without resolution are refused later, by name
            found = dated or (found if step else ["s"])
    else:
        found = dated or (["s"] if step < LONGEST_STEP_S else _fitting(step, OTHER_PERIOD_S))
    if len(found) != 1:
        fits = " and ".join(found) or "no unit"
        raise AttestError(f"{path}: the unit of time cannot be told: a median step of {step:g} fits {fits}", WAY_OUT)
    if found[0] == "s":
        return "s", ()
    message = f"{path.name}: the time column states no unit; read as {found[0]} by its step of {step:g}"
    return found[0], (Warn("time-unit-guessed", message, WAY_OUT),)


def in_days(raw: Array, unit: str, *, imu: bool, path: Path) -> tuple[float, int, tuple[Warn, ...]] | None:
    """Tell whether a time column counts days (hours, minutes): as it states, or days of a calendar by date and steps.

    Returns
    -------
    its unit in days, the days before 1970 from which it counts (0: nobody knows), and what should be known; or None

    Raises
    ------
    AttestError
        If no unit is stated and only such long ones fit the steps, but it could be more than days.
    """
    finite = raw[np.isfinite(raw)]
    steps = np.diff(finite)
    step = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
    if unit in LONG_UNITS_S and finite.size and unit != "d":
        return LONG_UNITS_S[unit] / LONG_UNITS_S["d"], 0, ()
    low, high = PERIOD_S if imu else OTHER_PERIOD_S
    fits = [name for name, size in LONG_UNITS_S.items() if 0.0 < step < SHORTEST_S[imu] and low <= step * size <= high]
    if not finite.size or not (fits or unit == "d"):
        return None
    middle = float(np.median(finite))
    since = next((days for days, (least, most) in SERIAL_DAYS.items() if least < middle < most), 0)
    if unit == "d" and not since:
        return 1.0, 0, ()
    if unit != "d" and not (since and "d" in fits and step * LONG_UNITS_S["h"] < HOURS_PERIOD_S[imu]):
        some = " and ".join(fits)
        raise AttestError(f"{path}: the unit of time cannot be told: a median step of {step:g} fits {some}", WAY_OUT)
    first = np.datetime64(round((float(finite[0]) - since) * LONG_UNITS_S["d"]), "s")
    date = f"as spreadsheets count days; it begins on {first}".replace("T", " at ")
    stated, hint = f"states no unit; read as d by its step of {step:g}", WAY_OUT
    if unit == "d":
        stated, hint = "is in d", "write times as 2026-06-01T10:00:00.000Z, if that is not their date"
    message = f"{path.name}: the time column {stated}, {date}"
    return 1.0, since, (Warn("time-unit-guessed", message, hint),)


def from_days(values: Array, since: int) -> tuple[Ints, Array]:
    """Scale days to ns since 1970, which is ``since`` days after their origin."""
    valid = np.abs(values - since) < LATEST_NS / DAY_NS
    safe = np.where(valid, values, since)
    whole = np.floor(safe)
    ns = np.rint((safe - whole) * DAY_NS).astype(np.int64)
    return (whole.astype(np.int64) - since) * DAY_NS + ns, np.where(valid, 1.0, np.nan)


def taken_unit(warnings: Iterable[Warn]) -> str | None:
    """Return the unit of time that ``guess_unit`` has told of."""
    told = next((warning.message for warning in warnings if warning.code == "time-unit-guessed"), "")
    return told.partition("read as ")[2].partition(" ")[0] or None


def from_text(column: pa.ChunkedArray, unit: str, path: Path) -> tuple[Ints, Array]:
    """Read decimal text as ns, exact to the last digit that 1 ns allows. Also where it is valid, as 1.0 or NaN."""
    digits = DIGITS[unit]
    try:
        decimal = pc.cast(column, pa.decimal128(38, digits))
    except pa.ArrowInvalid:  # digits below 1 ns, or text that is no number
        pattern = r"^(\s*[-+]?\d+)$" if digits == 0 else rf"^(\s*[-+]?\d*\.?\d{{0,{digits}}})\d*$"
        number = pc.match_substring_regex(column, NUMBER)
        column = pc.utf8_trim_whitespace(pc.if_else(number, column, pa.scalar(None, pa.string())))
        column = pc.replace_substring_regex(column, pattern=pattern, replacement=r"\1")
        try:
            decimal = pc.cast(column, pa.decimal128(38, digits))
        except pa.ArrowInvalid as error:
            raise AttestError(f"{path}: the time column cannot be read: {_first_line(error)}", WAY_OUT) from None
    whole = decimal.combine_chunks() if isinstance(decimal, pa.ChunkedArray) else decimal
    return _low_words(whole, column, path)


def from_numbers(values: Array | Ints, unit: str) -> tuple[Ints, Array]:
    """Scale numbers to ns: integers exactly, floats to their own resolution."""
    factor = 10 ** DIGITS[unit]
    latest = LATEST_NS // factor
    valid = (values < latest) & ((values > -latest) | (values.dtype.kind == "u"))
    if values.dtype.kind in "iu":
        return np.where(valid, values, 0).astype(np.int64) * factor, np.where(valid, 1.0, np.nan)
    safe = np.where(valid, values, 0.0)
    whole = np.floor(safe)
    stamps = whole.astype(np.int64) * factor + np.rint((safe - whole) * factor).astype(np.int64)
    return stamps, np.where(valid, 1.0, np.nan)


def from_dates(column: pa.ChunkedArray) -> tuple[Ints, Array]:
    """Read Arrow timestamps as ns since the epoch; a missing zone is UTC."""
    counts = pc.cast(column, pa.int64())
    found, valid = from_numbers(np.asarray(pc.fill_null(counts, 0), dtype=np.int64), column.type.unit)
    return found, np.where(np.asarray(pc.is_valid(counts)), valid, np.nan)


def _low_words(decimal: pa.Array, column: pa.ChunkedArray, path: Path) -> tuple[Ints, Array]:
    """Take the low 64 bits of 128-bit decimals that count nanoseconds."""
    words = np.frombuffer(decimal.buffers()[1], np.int64).reshape(-1, 2)[decimal.offset : decimal.offset + len(decimal)]
    valid = np.asarray(pc.is_valid(decimal), dtype=bool)
    low, high = words[:, 0], words[:, 1]
    wrong = np.flatnonzero(((high != low >> 63) | (low >= LATEST_NS) | (low <= -LATEST_NS)) & valid)
    if wrong.size:
        first = column[int(wrong[0])].as_py()
        message = f"{path}: stamps beyond the year 2116 in the time column, the first: {str(first)[:40]!r}"
        raise AttestError(message, "is its unit right? Dates are written as 2026-06-01T10:00:00.000Z")
    return np.where(valid, low, 0), np.where(valid, 1.0, np.nan)


def _on_a_clock(finite: Array, steps: Array) -> bool:
    """Tell whether numbers are ``hhmmss``: none ends in 60 to 99, which a count of seconds would pass through."""
    if not finite.size or finite.min() < 0.0 or finite.max() >= 240_000.0:
        return False
    if np.any(finite % 100.0 >= 60.0) or np.any(finite // 100.0 % 100.0 >= 60.0):
        return False
    turns = np.diff(finite // 100.0) > 0.0
    within = steps[~turns & (steps > 0.0)]
    usual = float(np.median(within)) if within.size else np.inf
    jumps = np.append(steps[turns] - 40.0, steps[turns] - 4040.0)  # at a minute, at an hour; a pause is of any length
    return usual < 20.0 and bool(np.any((jumps > 0.0) & (jumps < 5.0 * usual)))  # slower sensors may step over them


def _fitting(value: float, limits: tuple[float, float]) -> list[str]:
    """Return the units in which a value lies within limits in s."""
    return [unit for unit, digits in DIGITS.items() if limits[0] <= value * 10.0 ** (digits - 9) <= limits[1]]


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0]
