"""Where ticks stand and what they say: linear, signed, log 1-2-5 and time."""

from __future__ import annotations

import math

from .words import clock, number

Ticks = tuple[list[float], list[str]]

_STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)
_ANGLE_STEPS = (1.0, 2.0, 5.0, 10.0, 15.0, 30.0, 45.0, 90.0, 180.0, 360.0, 720.0, 1440.0)
_TIME_STEPS = (
    0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 180, 300, 600, 900, 1200, 1800,
    3600, 7200, 10800, 14400, 21600, 43200, 86400, 172800, 432000, 864000, 1728000, 4320000, 8640000,
)  # fmt: skip
_SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
HOURS_FROM_S = 4 * 3600.0


def decimals_of(step: float) -> int:
    """Decimals needed to write multiples of ``step`` exactly (0 for whole steps, at most 12)."""
    for decimals in range(12):
        if abs(round(step, decimals) - step) < 1e-6 * abs(step):
            return decimals
    return 12


def nice_step(span: float, most: int) -> float:
    """Smallest step of 1, 2, 2.5, 5 times a power of ten that gives at most ``most`` intervals in ``span``."""
    if not span > 0.0 or not math.isfinite(span):
        return 1.0
    power = 10.0 ** math.floor(math.log10(span / most))
    return next(power * s for s in _STEPS if power * s * most >= span * (1.0 - 1e-9))


def _multiples(low: float, high: float, step: float) -> list[float]:
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [k * step for k in range(first, last + 1)]


def linear(low: float, high: float, most: int = 4, unit: str = "", *, sign: bool = False) -> Ticks:
    """Ticks at multiples of a nice step inside [low, high]."""
    step = nice_step(high - low, most)
    decimals = decimals_of(step)
    at = _multiples(low, high, step)
    return at, [number(v, decimals, sign=sign) + unit for v in at]


def angle(low: float, high: float, most: int = 3) -> Ticks:
    """Ticks of an angle in degrees: multiples of 5, 10, 15, 30, 45, 90 where the span allows."""
    span = high - low
    if span < 2.0:
        return linear(low, high, most, "°")
    step = next((s for s in _ANGLE_STEPS if len(_multiples(low, high, s)) <= most), _ANGLE_STEPS[-1])
    at = _multiples(low, high, step)
    return at, [number(v) + "°" for v in at]


def rounded_up(value: float) -> float:
    """The value rounded up to two significant digits; 1 for zero or nothing."""
    if not value > 0.0 or not math.isfinite(value):
        return 1.0
    power = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / power - 1e-9) * power


def symmetric(limit: float, unit: str = "") -> Ticks:
    """Three ticks: minus, 0, plus, at the largest 1, 2, 2.5, 5 inside the limit."""
    power = 10.0 ** math.floor(math.log10(limit))
    step = max(power * s for s in _STEPS if power * s <= limit * (1.0 + 1e-9))
    decimals = decimals_of(step)
    return [-step, 0.0, step], [number(-step, decimals) + unit, "0", number(step, decimals, sign=True) + unit]


def log(low: float, high: float, most: int = 8, unit: str = "") -> Ticks:
    """1-2-5 ticks with plain numbers (powers of ten from 100 000 on); decades where 1-2-5 are more than ``most``.

    Limits with less than two such ticks between them get linear ones.
    """
    powers = range(math.floor(math.log10(low)) - 1, math.ceil(math.log10(high)) + 1)
    inside = [(m, p) for p in powers for m in (1, 2, 5) if low * 0.999 <= m * 10.0**p <= high * 1.001]
    if len(inside) < 2:
        return linear(low, high, 4, unit)
    if len(inside) > most:
        inside = [(m, p) for m, p in inside if m == 1]
    inside = inside[:: -(-len(inside) // most)]
    return [m * 10.0**p for m, p in inside], [_plain(m, p) + unit for m, p in inside]


def _plain(mantissa: int, power: int) -> str:
    if power < 5:
        return number(mantissa * 10.0**power, max(0, -power))
    return ("" if mantissa == 1 else f"{mantissa}×") + "10" + str(power).translate(_SUPERSCRIPTS)


def time(start: float, end: float, most: int = 8) -> Ticks:
    """Ticks of time since start: ``min:s`` under four hours, hours above."""
    span = max(end - start, 1e-3)
    hours = span >= HOURS_FROM_S
    most = most + most // 2 if hours else most  # short words leave room for more
    step = next((s for s in _TIME_STEPS if span / s <= most), 3600.0 * nice_step(span / 3600.0, most))
    at = _multiples(start, end, step)
    if hours:
        decimals = decimals_of(step / 3600.0)
        return at, [number(v / 3600.0, decimals) for v in at]
    decimals = decimals_of(step) if step < 1 else 0
    return at, [clock(v, decimals, hours=end >= HOURS_FROM_S) for v in at]


def time_label(start: float, end: float) -> str:
    """The words under a time axis."""
    if end - start >= HOURS_FROM_S:
        return "time since start, h"
    return "time since start, h:min:s" if end >= HOURS_FROM_S else "time since start, min:s"
