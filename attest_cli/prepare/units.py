"""Values of channels in SI: by the unit that is stated, held against physics; by physics alone where none is stated."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..errors import AttestError
from ..records import Array, Channel, Warn
from ..settings.units import unit
from . import unit_change
from .unit_change import DEGREES

SI: Mapping[str, str] = {"gyro": "rad/s", "accel": "m/s^2", "mag": "T"}
"""Quantity -> its SI unit, assumed where none is stated and physics does not object."""

ACCEL_UNITS = ("m/s^2", "g", "mg", "cm/s^2")
MAG_UNITS = ("uT", "T", "Gauss", "mGauss", "nT")
FIELD_T = (1e-5, 1.5e-4)  # fields met on Earth's surface, with the iron of a vehicle
UNIT_FIELD_T = 5e-5  # what a normalised field is scaled to: its direction is all it holds
FASTEST_GYRO = 35.0  # rad/s: 2000 deg/s, the widest range of common gyros
FASTEST_STATED = 70.0  # rad/s: 4000 deg/s, what no common gyro reaches where it is stated
FAST_LEVEL, LEVEL = 3.0, 0.1  # rad/s: what drives on the level turns slower; rad: that is level
FASTEST_DEG_S = 4000.0  # what no common gyro reaches: above it values are raw counts
GYRO_UNITS = ("mdeg/s", "mrad/s", "rpm")  # what a gyro is rarely in: never taken, only named
GYRO_COUNTS = (
    131.072,
    65.536,
    32.768,
    16.384,
    8.192,
    114.286,
    57.143,
    28.571,
    14.286,
)  # per deg/s: 16 bits of usual ranges
SCALE_OFF = 0.07  # share of gravity: no accelerometer that was ever calibrated is so far off
CALM_SHARE = 0.1  # of the windows
MOST_GRAVITY = 4.0  # times gravity: above it the steady part has another unit, not another scale

WINDOW_S = 0.5  # over which the specific force is averaged to show gravity
LARGEST_TURN = 0.5  # rad: above it a window is too long for the comparison
MIN_WINDOWS = 4
AGREEMENT = 0.4  # share of the turning of gravity explained, from which the gyro's unit is told
CONVINCED = 0.6  # the same, from which values are converted to another unit than stated or usual
FEW_STEPS = 20  # between windows


@dataclass(frozen=True, slots=True)
class Quantity:
    """Columns of a channel in SI: ``values`` (n, k); ``stated``: the unit in the file, empty if none."""

    values: Array
    stated: str


def in_si(channel: Channel, names: Sequence[str], target: str) -> Quantity:
    """Convert columns to SI by their stated units; a column without one has that of its neighbours.

    Raises
    ------
    AttestError
        If a unit is not known, or measures something else than ``target``.
    """
    stated = Counter(name for key in names if (name := channel.units.get(key, "")))
    usual = stated.most_common(1)[0][0] if stated else ""
    _, wanted = unit(target)
    columns = []
    for key in names:
        name = channel.units.get(key, "") or usual or target
        try:
            factor, dimensions = unit(name)
        except ValueError:
            raise AttestError(
                f"channel {channel.name}: unit {name!r} of {key} is not known", f"give it in {target}"
            ) from None
        if dimensions != wanted:
            raise AttestError(
                f"channel {channel.name}: {key} is in {name}, which cannot be: {target} expected", "mend the header"
            )
        columns.append(channel.values[key] if factor == 1.0 else channel.values[key] * factor)
    return Quantity(np.stack(columns, axis=1), usual)


def accelerometer(channel: Channel, names: Sequence[str], t: Array, gravity: float, warnings: list[Warn]) -> Array:
    """Return specific force, m/s^2 (n, 3). What stays when it is averaged must be gravity: that tells a wrong unit.

    Raises
    ------
    AttestError
        If gravity is missing from the values: then no attitude can be had from them.
    """
    quantity = in_si(channel, names, SI["accel"])
    still, calm = _steady_norms(t, quantity.values)
    if 0.5 < still / gravity < 2.0:
        if abs(calm / gravity - 1.0) > SCALE_OFF:
            message = f"channel {channel.name}: the accelerometer at its calmest shows {calm:.2f} m/s^2"
            hint = "check its scale; elsewhere than on Earth, state world.gravity_m_s2"
            warnings.append(Warn("accel-scale", f"{message}, gravity is {gravity:.2f}", hint))
        return quantity.values
    here = unit(quantity.stated or SI["accel"])[0]
    ratios = {name: ratio for name in ACCEL_UNITS if 0.8 < still * (ratio := unit(name)[0] / here) / gravity < 1.25}
    if ratios:  # mg and cm/s^2 are 2 % apart
        name = min(ratios, key=lambda name: abs(calm * ratios[name] / gravity - 1.0))
        fact = f"its steady part is {_digits(still / here)}"
        warnings.append(_told(channel, "accelerometer", quantity.stated, name, fact))
        return quantity.values * ratios[name]
    if still < 0.3 * gravity:
        message = f"channel {channel.name}: no gravity in the accelerometer: its steady part is {still:.2f} m/s^2"
        raise AttestError(message, "record the raw specific force (linear acceleration without gravity shows no tilt)")
    said = f"is {_digits(still / here)} {quantity.stated or '(no unit)'}, gravity is {gravity:.2f} m/s^2"
    message = f"channel {channel.name}: the steady part of the accelerometer {said}"
    if still > MOST_GRAVITY * gravity:
        raise AttestError(
            f"{message}: raw counts, or another unit?",
            f"convert counts to g; state a unit in the header{_state(channel)}",
        )
    warnings.append(Warn("accel-scale", message, "check its unit and calibration"))
    return quantity.values


def gyroscope(channel: Channel, names: Sequence[str], t: Array, accel: Array, warnings: list[Warn]) -> Array:
    """Return angular rate, rad/s (n, 3). The turning of gravity in the accelerometer tells degrees from radians.

    Parameters
    ----------
    t : (n,) s, ``accel`` (n, 3) m/s^2 at the gyro's samples

    Raises
    ------
    AttestError
        If the unit changes within the log, cannot be told where it must be, or is one of raw counts.
    """
    quantity = in_si(channel, names, SI["gyro"])
    taken = quantity.stated or SI["gyro"]
    other = "rad/s" if taken == "deg/s" else "deg/s"
    ratio = unit(other)[0] / unit(taken)[0]
    found = turns(t, quantity.values, accel, scales=(1.0, ratio))
    as_taken, as_other = map(_agreement, found)
    _refuse_change(channel, found[0 if ratio > 1.0 else 1])
    unit_change.refuse(channel.name, t, quantity.values, accel)
    if as_other > max(CONVINCED, as_taken):
        fact = f"the turning of gravity agrees with {other} ({as_other:.0%} of it explained)"
        warnings.append(_told(channel, "gyro", quantity.stated, other, fact))
        return quantity.values * ratio
    if -AGREEMENT <= as_taken < AGREEMENT:
        return _untold(channel, quantity, t, accel, warnings, halfway=as_other if as_other > AGREEMENT else 0.0)
    return quantity.values


def _untold(
    channel: Channel, quantity: Quantity, t: Array, accel: Array, warnings: list[Warn], halfway: float = 0.0
) -> Array:
    """Return the rates of a gyro whose unit the turning of gravity does not tell: as stated, unless that cannot be.

    Raises
    ------
    AttestError
        If radians and degrees are as likely: beside an accelerometer in g a gyro is often in deg/s, whatever is stated.
    """
    stated = quantity.stated
    in_g = any(_says_g(warning, channel) for warning in warnings) or halfway > 0.0
    usual = float(np.quantile(np.abs(quantity.values), 0.99))
    if stated and (stated != SI["gyro"] or not (in_g or usual > FASTEST_STATED)):
        if stated == SI["gyro"] and usual > FAST_LEVEL and _leans(t, accel) < LEVEL:
            fact = f"turns at up to {_digits(usual)} rad/s on the level, {_digits(usual * 9.549)} times a minute"
            hint = f"state the unit in the header{_state(channel)}"
            warnings.append(Warn("unit-doubted", f"channel {channel.name}: the gyro {fact}: or is it in deg/s?", hint))
        return quantity.values
    if not stated:
        _refuse_counts(channel, t, quantity.values, accel)
    fastest = float(np.max(np.abs(quantity.values), initial=0.0))
    if in_g and fastest <= FASTEST_GYRO:
        why = f"deg/s explains {halfway:.0%} of the turning of gravity" if halfway else "beside g"
        message = f"channel {channel.name}: rad/s or deg/s? The gyro's largest value is {_digits(fastest)}, {why}"
        raise AttestError(message, f"state the unit in the header{_state(channel)}")
    name = "deg/s" if fastest > FASTEST_GYRO else "rad/s"
    if stated and usual > FASTEST_DEG_S:
        fact = f"but {_digits(usual)} is no rate in it, nor in deg/s"
        raise AttestError(f"channel {channel.name}: gyro stated in {stated}, {fact}", _fitting(channel, usual))
    warnings.append(_told(channel, "gyro", stated, name, f"its largest value is {_digits(fastest)}"))
    return quantity.values * unit(name)[0]


def _leans(t: Array, accel: Array) -> float:
    """Return by how much the steady part of the specific force leans about its mean, rad, RMS."""
    edges = _windows(t)
    up = np.add.reduceat(accel, edges[:-1], axis=0)
    up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-12)
    return float(np.sqrt(np.mean(np.sum((up - up.mean(axis=0)) ** 2, axis=1))))


def _says_g(warning: Warn, channel: Channel) -> bool:
    """Tell whether a warning says that the accelerometer beside a gyro was found to be in g."""
    beside = warning.message.startswith(f"channel {channel.name}: accelerometer") or (
        channel.role == "gyro" and ": accelerometer" in warning.message
    )
    return beside and warning.message.endswith(("taken as g", "taken as mg"))


def _refuse_counts(channel: Channel, t: Array, gyro: Array, accel: Array) -> None:
    """Refuse raw counts of a gyro, or a rare unit: faster than any in deg/s, or so they agree with gravity."""
    usual = float(np.quantile(np.abs(gyro), 0.99))
    scales = [unit("deg/s")[0] / c for c in GYRO_COUNTS] + [unit(name)[0] for name in GYRO_UNITS]
    agreements = turning(t, gyro, accel, scales)
    count = len(GYRO_COUNTS)
    (agreed, scale), (rarely, name) = (
        max(zip(agreements[:count], GYRO_COUNTS, strict=True)), max(zip(agreements[count:], GYRO_UNITS, strict=True))
    )  # fmt: skip
    if rarely > max(CONVINCED, agreed):
        message = f"channel {channel.name}: the gyro states no unit, and the turning of gravity agrees with {name}"
        raise AttestError(message, f"state {name} in the header{_state(channel)}")
    if agreed < AGREEMENT and usual < FASTEST_DEG_S:
        return
    fact = f"they agree with {scale:g} per deg/s" if agreed > AGREEMENT else f"{_digits(usual)} is no rate in deg/s"
    raise AttestError(f"channel {channel.name}: the gyro holds raw counts: {fact}", _fitting(channel, usual))


def _fitting(channel: Channel, usual: float) -> str:
    """Say what a gyro whose rates reach ``usual`` could be in."""
    fit = [name for name in GYRO_UNITS if usual * unit(name)[0] < FASTEST_GYRO]
    other = f"; if they are in {' or '.join(fit)}, state that in the header{_state(channel)}" if fit else ""
    return f"convert them to rad/s or deg/s{other}"


def _refuse_change(channel: Channel, found: Turns) -> None:
    r"""Refuse a gyro whose unit changes within the log: two parts that gravity's turning scales differently.

    Of all places to cut, that with the least :math:`\sum|\Delta u-k\,\Delta u_{gyro}|^2`, with a scale k on each side.
    """
    expected = -np.cross(found.angle, found.up)
    pairs = ((found.seen, found.seen), (found.seen, expected), (expected, expected))
    sums = np.cumsum([np.sum(x * y, axis=1) for x, y in pairs], axis=1)
    if sums.shape[1] < 2 * FEW_STEPS:
        return
    cuts = slice(FEW_STEPS - 1, -FEW_STEPS)
    before, after = sums[:, cuts], sums[:, -1:] - sums[:, cuts]
    explained = [part[1] ** 2 / np.maximum(part[2], 1e-300) for part in (before, after)]
    cut = int(np.argmax(explained[0] + explained[1]))
    (seen, cross, square), shares = np.stack([before[:, cut], after[:, cut]], axis=1), [e[cut] for e in explained]
    if np.any(square == 0.0) or np.any(cross == 0.0) or np.any(shares < AGREEMENT * seen):
        return
    first, second = np.abs(cross / square)
    if DEGREES[0] < max(first, second) / min(first, second) < DEGREES[1]:
        when = float(found.at[cut + FEW_STEPS])
        message = f"channel {channel.name}: the gyro's unit changes at about {when:.0f} s"
        message += f", where gravity's turning asks for {_digits(second / first)} times the scale"
        raise AttestError(message, f"smooth one part, with --end {when:.0f} or --start {when:.0f}, or mend the log")


def magnetometer(channel: Channel, names: Sequence[str], warnings: list[Warn]) -> Array:
    """Return the magnetic field, tesla (m, 3); a normalised one is scaled to 50 uT."""
    quantity = in_si(channel, names, SI["mag"])
    norms = np.linalg.norm(quantity.values, axis=1)
    norms = norms[np.isfinite(norms) & (norms > 0.0)]
    if not norms.size or (quantity.stated and FIELD_T[0] < np.median(norms) < FIELD_T[1]):
        return quantity.values
    median, here = float(np.median(norms)), unit(quantity.stated or SI["mag"])[0]
    fact = f"its median norm is {_digits(median / here)}"
    if abs(median / here - 1.0) < 0.1 and float(np.std(norms)) < 0.1 * median:
        told = _told(channel, "magnetometer", quantity.stated, "a normalised field", fact)
        warnings.append(replace(told, code="magnetometer-normalised"))
        return quantity.values * (UNIT_FIELD_T / here)
    for name in MAG_UNITS:
        ratio = unit(name)[0] / here
        if FIELD_T[0] < median * ratio < FIELD_T[1]:
            warnings.append(_told(channel, "magnetometer", quantity.stated, name, fact))
            return quantity.values * ratio
    return quantity.values if quantity.stated else quantity.values * 1e-6


@dataclass(frozen=True, slots=True)
class Turns:
    """Steps between windows: ``step`` (k,) s, the gyro's ``angle``, gravity's direction ``up`` half-way and by how much
    it was ``seen`` to change, all (k, 3); where they end, ``at`` (k,) s.
    """

    step: Array
    angle: Array
    up: Array
    seen: Array
    at: Array = field(default_factory=lambda: np.empty(0))


@np.errstate(over="ignore", invalid="ignore")  # a value of 1e300 is a spike, and falls out later
def turns(
    t: Array, gyro: Array, accel: Array, window_s: float = WINDOW_S, scales: Sequence[float] = (1.0,)
) -> list[Turns]:
    """Average gyro and specific force over windows; for each scale (of the gyro, to rad/s) keep small steps near
    gravity.
    """
    edges = _windows(t, window_s)
    if edges.size < MIN_WINDOWS:
        return [Turns(np.empty(0), *np.empty((3, 0, 3))) for _ in scales]
    counts = np.diff(edges)[:, None]
    force, rate = (np.add.reduceat(values, edges[:-1], axis=0) / counts for values in (accel, gyro))
    middle = np.add.reduceat(t, edges[:-1]) / counts[:, 0]
    norms = np.linalg.norm(force, axis=1)
    u = force / np.where(norms > 0.0, norms, 1.0)[:, None]
    seen, step = np.diff(u, axis=0), np.diff(middle)
    near = np.abs(norms / np.median(norms) - 1.0) < 0.1
    level = near[1:] & near[:-1] & (step < 2.0 * window_s)
    found = []
    for scale in scales:
        angle = 0.5 * scale * (rate[1:] + rate[:-1]) * step[:, None]
        good = level & (np.linalg.norm(angle, axis=1) < LARGEST_TURN)
        found.append(Turns(step[good], angle[good], 0.5 * (u[1:] + u[:-1])[good], seen[good], middle[1:][good]))
    return found


def turning(t: Array, gyro: Array, accel: Array, scales: Sequence[float] = (1.0,)) -> list[float]:
    r"""Compare the gyro (times each of ``scales``: rad/s) with the turning of the specific force's direction u.

    Between windows that turn by less than half a radian, :math:`\Delta u = -\theta \times u` with the gyro's angle
    :math:`\theta`. Returns the agreement: the share of :math:`\Delta u` that this explains, negative if reversed;
    0 where nothing turns or gravity does not stand out. A wrong scale explains little: 1/57 of it, or nothing.
    """
    return [_agreement(found) for found in turns(t, gyro, accel, scales=scales)]


def _agreement(found: Turns) -> float:
    """Return the share of the turning of gravity that the gyro explains."""
    seen, expected = found.seen, -np.cross(found.angle, found.up)
    total = float(np.sum(seen**2))
    if len(seen) < MIN_WINDOWS or total == 0.0:
        return 0.0
    explained = 1.0 - float(np.sum((seen - expected) ** 2)) / total
    against = 1.0 - float(np.sum((seen + expected) ** 2)) / total
    return max(explained, 0.0) if explained >= against else -max(against, 0.0)


@np.errstate(over="ignore", invalid="ignore")
def _steady_norms(t: Array, accel: Array) -> tuple[float, float]:
    """Return the median norm of the specific force averaged over windows, where vibration averages out and gravity
    stays, and that over the tenth of the windows that vary least: at rest, where there is any.
    """
    edges = _windows(t)
    counts = np.diff(edges)
    means = np.add.reduceat(accel, edges[:-1], axis=0) / counts[:, None]
    squares = np.add.reduceat(np.einsum("ij,ij->i", accel, accel), edges[:-1]) / counts
    full = counts >= 0.5 * np.median(counts)  # one sample alone is always calm
    spread, norms = (squares - np.sum(means**2, axis=1))[full], np.linalg.norm(means[full], axis=1)
    calm = np.argsort(spread)[: int(CALM_SHARE * (len(spread) - 1)) + 1]
    return float(np.median(norms)), float(np.median(norms[calm]))


def _windows(t: Array, window_s: float = WINDOW_S) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Return the first sample of each window and the end, in a log that may have gaps."""
    number = t - t[0]
    number /= window_s
    np.floor(number, out=number)  # in place: a long log has many
    starts = np.flatnonzero(number[1:] != number[:-1]) + 1
    return np.concatenate([[0], starts, [t.size]])


def _digits(value: float) -> str:
    """Four digits, never as a power of ten."""
    return str(np.format_float_positional(value, 4, fractional=False, trim="-"))


def _told(channel: Channel, what: str, stated: str, taken: str, fact: str) -> Warn:
    if stated:
        message = f"channel {channel.name}: {what} stated in {stated}, but {fact}: taken as {taken}"
        return Warn("unit-contradicted", message, f"mend the unit in the header{_state(channel)}")
    message = f"channel {channel.name}: {what} states no unit, {fact}: taken as {taken}"
    return Warn("unit-guessed", message, f"state the unit in the header{_state(channel)}")


def _state(channel: Channel) -> str:
    """How a unit is stated for a table without touching it."""
    return ', or with --columns "OLD=NAME [UNIT]"' if channel.kind == "columns" else ""
