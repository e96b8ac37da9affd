"""Measurements of absolute and aiding sensors in the units of ``records.Fixes``; what cannot be used is counted."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..maths import rotation
from ..records import COLUMNS, Array, Bools, Channel, Fixes, Ints, Warn
from ..settings import GPS_SIGMA_M, Settings
from ..settings.units import unit
from . import places, units
from .clock import in_order, seconds
from .lost import LARGEST
from .spikes import AROUND, spikes

STALE_RUN = 3
"""More equal values in a row than this are repeats of an old measurement."""

HELD_RUN, HELD_QUANTILE, HELD_TIMES, HELD_SHARE = 20, 0.95, 5.0, 0.3
"""Rows of one speed of wheels that are many, and against what is usual of the log; the most of them that may hang."""

LONGEST_SUN = 1.05  # two components of a unit vector, with their noise
JUMPS, USUAL_STEP = 3.0, 0.95  # times the quantile of the steps of a tracker: what stood still does not leap so far
DRIVING_M_S, SIDEWAYS, NOISY = 0.1, 3.0, 6.0
SPIKE = 0.1  # of the field: what is less hardly turns a heading
CHECKED_FOR_REPEATS = frozenset({"sun", "orientation", "gps", "gps_velocity"})


@dataclass(frozen=True, slots=True)
class Span:
    """The IMU's time: ``t0_ns``, first and last stamp, and by how much a fix may miss it without a word."""

    t0_ns: int
    start_ns: int
    end_ns: int
    slack_s: float


Values = tuple[Array, Array | None]  # (m, d) in the units of Fixes, sigma (m, k) or None


def fixes_of(role: str, channel: Channel, span: Span, settings: Settings, warnings: list[Warn]) -> Fixes | None:
    """Make the fixes of one sensor, or None where nothing of it lies in the IMU's time.

    Parameters
    ----------
    role : str
        Any of ``records.ROLES`` but imu, gyro, accel.
    """
    channel, beyond = _within_measure(channel)
    values, sigma = CONVERTERS[role](channel, settings, warnings)
    good = _usable(role, values)
    bad = int(np.count_nonzero(~good))
    if bad:
        message = f"{bad} of {good.size} measurements of {channel.name} ({role}) dropped: {_why(role)}"
        warnings.append(Warn(f"{role}-dropped", f"{message}, or {beyond}" if beyond else message))
    elif beyond:
        message = f"cells of {channel.name} ({role}) count as blank: {beyond}"
        warnings.append(Warn(f"{role}-out-of-range", message, "lost bytes make such numbers"))
    stamps_ns, values, sigma = channel.stamps_ns[good], values[good], None if sigma is None else sigma[good]
    ordered = in_order(channel.name, stamps_ns, values, span.t0_ns, strict=False)
    warnings.extend(ordered.warnings)
    stamps_ns, values = ordered.stamps_ns, values[ordered.rows]
    sigma = None if sigma is None else sigma[ordered.rows]
    inside = _inside(role, channel.name, stamps_ns, span, settings, warnings)
    if not np.any(inside):
        return None
    if role in CHECKED_FOR_REPEATS:
        inside &= _fresh(role, channel.name, values, warnings)
    if role == "magnetometer":
        inside &= _calm(channel.name, values, warnings)
    if role == "position":
        inside &= _following(channel.name, values, warnings)
    if role == "odometry":
        inside &= _turning(channel.name, stamps_ns, values, warnings)
    t = seconds(stamps_ns[inside], span.t0_ns)
    sigma = None if sigma is None or not np.any(np.isfinite(sigma[inside])) else sigma[inside]
    return Fixes(role, channel.name, t, values[inside], sigma)


def _inside(role: str, name: str, stamps_ns: Ints, span: Span, settings: Settings, warnings: list[Warn]) -> Bools:
    """Tell the fixes within the IMU's span; say where none is, or where some are left out that no window cut off."""
    inside: Bools = (stamps_ns >= span.start_ns) & (stamps_ns <= span.end_ns)
    windowed = settings.time.start_s is not None or settings.time.end_s is not None
    if not stamps_ns.size:
        return inside
    if not np.any(inside):
        first, last = ((int(stamps_ns[k]) - span.start_ns) * 1e-9 for k in (0, -1))
        imu_s = (span.end_ns - span.start_ns) * 1e-9
        spans = f"{first:.1f} to {last:.1f} s after the IMU's start, the IMU 0 to {imu_s:.1f} s"
        message = f"{name} ({role}) spans {spans}: not used"
        warnings.append(
            Warn("no-overlap", message, "" if windowed else "on different clocks? --time log takes the recorder's")
        )
        return inside
    slack = int(span.slack_s * 1e9)
    far = int(np.count_nonzero((stamps_ns < span.start_ns - slack) | (stamps_ns > span.end_ns + slack)))
    if far and not windowed:
        message = f"{far} of {stamps_ns.size} measurements of {name} ({role}) dropped: outside the IMU's time"
        warnings.append(Warn("outside-imu-span", message))
    return inside


def _within_measure(channel: Channel) -> tuple[Channel, str]:
    """Blank damaged numbers, whose squares overflow; say which."""
    wrong = {name: rows for name, v in channel.values.items() if np.any(rows := np.abs(v) > LARGEST)}
    values = {name: np.where(wrong[name], np.nan, v) if name in wrong else v for name, v in channel.values.items()}
    told = ", ".join(f"{np.count_nonzero(rows)} of {name}" for name, rows in wrong.items())
    return (replace(channel, values=values), f"beyond any measure: {told}") if wrong else (channel, "")


def _usable(role: str, values: Array) -> Bools:
    """Tell the rows that hold a measurement; zero vectors and quaternions are none."""
    needed = {"odometry": 1, "gps": 2, "gps_velocity": 2, "position": 2}.get(role, values.shape[1])
    usable: Bools = np.all(np.isfinite(values[:, :needed]), axis=1)
    return usable & (np.abs(values[:, 0]) <= np.pi / 2) if role == "gps" else usable


def _why(role: str) -> str:
    reasons = {"sun": "zero or not finite", "orientation": "zero or not finite", "gps": "no fix, or no such place"}
    return reasons.get(role, "not finite")


def _fresh(role: str, name: str, values: Array, warnings: list[Warn]) -> Bools:
    """Tell measurements from exact repeats in long runs: a sensor that repeats itself has not measured."""
    starts = np.append(np.True_, np.any(values[1:] != values[:-1], axis=1))
    runs = np.diff(np.append(np.flatnonzero(starts), starts.size))
    fresh: Bools = starts | ~np.repeat(runs > STALE_RUN, runs)
    if role == "gps_velocity":
        fresh |= ~np.any(values, axis=1)  # a receiver that stands still may say so
    stale = int(np.count_nonzero(~fresh))
    if stale:
        what = f"{stale} of {len(values)} measurements of {name} ({role})"
        message = f"{what} dropped: exact repeats, up to {runs.max()} in a row"
        warnings.append(
            Warn("stale-repeats", message, "a repeat is no new measurement; leave blank what was not measured")
        )
    return fresh


def _following(name: str, values: Array, warnings: list[Warn]) -> Bools:
    """Tell positions from one held in place of those that follow: it stands still to the last bit, and then leaps."""
    step = np.append(0.0, np.linalg.norm(np.nan_to_num(np.diff(values, axis=0)), axis=1))
    starts = np.flatnonzero(step != 0.0) if step.any() else np.zeros(0, dtype=np.int64)
    if not len(starts):
        return np.ones(len(values), dtype=np.bool_)
    first = np.append(0, starts)
    runs, leaps = np.diff(np.append(first, len(values))), np.append(step[starts], 0.0)
    far = JUMPS * float(np.quantile(step[starts], USUAL_STEP))
    held = (runs > STALE_RUN) & (leaps > far)
    stale: Bools = np.repeat(held, runs)
    stale[first] = held & (step[first] > far)  # where it leapt there too, as to 0, 0, 0, it never was there
    if stale.any():
        message = f"{np.count_nonzero(stale)} of {len(values)} measurements of {name} (position) dropped"
        most = int(runs[held].max())
        hint = "the tracker lost its sight? leave blank what was not measured"
        message = f"{message}: exact repeats, up to {most} in a row, and then a leap"
        warnings.append(Warn("stale-repeats", message, hint))
    return ~stale


def _calm(name: str, values: Array, warnings: list[Warn]) -> Bools:
    """Tell measurements of the field from spikes: a mean over a stop would take them in."""
    usual = float(np.median(np.linalg.norm(values, axis=1)))
    rows = spikes(values, SPIKE * usual, AROUND)
    if rows.any():
        message = f"{np.count_nonzero(rows)} of {rows.size} measurements of {name} (magnetometer) dropped: spikes"
        warnings.append(Warn("magnetometer-spikes", message, "what is left is used; is it near a switched current?"))
    return ~rows


def _turning(name: str, stamps_ns: Ints, values: Array, warnings: list[Warn]) -> Bools:
    """Tell measurements of wheels from one speed held for long, where speeds else change: a counter that hangs, or
    wheels that spin. Wheels that stand may say so.
    """
    held = np.append(np.False_, np.all((values[1:] == values[:-1]) | np.isnan(values[1:]), axis=1))
    starts = np.flatnonzero(~held)
    runs = np.diff(np.append(starts, held.size))
    rolling = np.abs(values[starts, 0]) > DRIVING_M_S
    usual = float(np.quantile(runs[rolling], HELD_QUANTILE)) if rolling.any() else 0.0
    hangs = rolling & (runs > max(HELD_RUN, HELD_TIMES * usual))
    hangs &= runs[hangs].sum() < HELD_SHARE * runs[rolling].sum()  # else it is how these wheels are told
    stuck: Bools = np.repeat(hangs, runs)
    if stuck.any():
        last = starts[hangs] + runs[hangs] - 1
        seconds_held = float(np.max(stamps_ns[last] - stamps_ns[starts[hangs]])) * 1e-9
        message = f"{np.count_nonzero(stuck)} of {stuck.size} measurements of {name} (odometry) dropped"
        hint = "does the counter hang, or do the wheels spin?"
        warnings.append(
            Warn("odometry-stuck", f"{message}: one speed, to the last bit, for up to {seconds_held:.1f} s", hint)
        )
    return ~stuck


def _columns(channel: Channel, names: tuple[str, ...], target: str) -> Array:
    return units.in_si(channel, names, target).values


def _sun(channel: Channel, settings: Settings, warnings: list[Warn]) -> Values:
    names = tuple(
        name for name in COLUMNS["sun"] if name in channel.values and np.any(np.isfinite(channel.values[name]))
    )
    values = (
        np.stack([channel.values[name] for name in names], axis=1) if names else np.empty((channel.stamps_ns.size, 0))
    )
    norms = np.linalg.norm(values, axis=1, keepdims=True)
    if len(names) == 3:
        values = values / np.where(norms > 0.0, norms, np.nan)
        return (values[:, :2] if settings.sun.components == 2 else values), None
    long = norms > LONGEST_SUN
    if np.any(long):
        count = f"{np.count_nonzero(long)} of {norms.size}"
        message = f"{count} directions of {channel.name} (sun) are longer than 1: dropped"
        warnings.append(Warn("sun-not-unit", message, "two components are those of a unit vector"))
    return np.where((norms > 0.0) & ~long, values, np.nan), None


def _magnetometer(channel: Channel, settings: Settings, warnings: list[Warn]) -> Values:
    values = units.magnetometer(channel, COLUMNS["magnetometer"], warnings)
    values = np.where(np.any(values != 0.0, axis=1)[:, None], values, np.nan)
    if settings.imu.mounting != "auto":  # it sits in the same box as the IMU
        values = values @ rotation.matrix(np.array(settings.imu.mounting)).T
    return values, None


def _compass(channel: Channel, settings: Settings, warnings: list[Warn]) -> Values:  # noqa: ARG001 (converters share a signature)
    heading = channel.values["compass_deg"]
    finite = heading[np.isfinite(heading)]
    stated = channel.units.get("compass_deg", "")
    if not stated and finite.size > 1 and np.ptp(finite) > 0.0 and np.abs(finite).max() <= 2.0 * np.pi:
        largest = np.abs(finite).max()
        message = f"channel {channel.name}: compass states no unit, its largest value is {largest:.3f}: taken as rad"
        warnings.append(Warn("unit-guessed", message, "state the unit in the header"))
        return heading[:, None], None
    return heading[:, None] * unit(stated or "deg")[0], None


def _orientation(channel: Channel, settings: Settings, warnings: list[Warn]) -> Values:  # noqa: ARG001
    """Body to world; what an IMU says of its own case (``#orientation``) is turned by its mounting."""
    q = np.stack([channel.values[name] for name in COLUMNS["orientation"]], axis=1)
    norms = np.linalg.norm(q, axis=1, keepdims=True)
    q = q / np.where(norms > 0.0, norms, np.nan)
    if settings.imu.mounting != "auto" and channel.name.endswith("#orientation"):
        q = rotation.multiply(q, rotation.conjugate(np.array(settings.imu.mounting)))
    return q, None


def _odometry(channel: Channel, settings: Settings, warnings: list[Warn]) -> Values:  # noqa: ARG001
    names = tuple(name for name in COLUMNS["odometry"] if name in channel.values) or ("speed",)
    values = np.full((channel.stamps_ns.size, 3), np.nan)
    values[:, : len(names)] = _columns(channel, names, "m/s")
    forward, aside = (np.abs(values[:, k][np.isfinite(values[:, :2]).all(axis=1)]) for k in (0, 1))
    noise = sum(float(np.median(np.abs(np.diff(speed)))) for speed in (forward, aside)) if forward.size > 1 else 0.0
    driving = forward + aside > max(DRIVING_M_S, NOISY * noise)
    if driving.any() and np.median(aside[driving]) > SIDEWAYS * np.median(forward[driving]):
        message = f"channel {channel.name}: the odometry moves sideways, hardly forward"
        warnings.append(Warn("odometry-sideways", message, "velocity_x is forward: are the axes those of the body?"))
    sigma = np.full((channel.stamps_ns.size, 3), np.nan)
    for k, axis in enumerate("xyz"):
        if f"velocity_sigma_{axis}" in channel.values:
            sigma[:, k] = _columns(channel, (f"velocity_sigma_{axis}",), "m/s")[:, 0]
    return values, sigma


def _usual(channel: Channel, name: str) -> float:
    """Return the median of a column, 0 where there is none."""
    values = channel.values.get(name, np.zeros(0))
    return float(np.median(values[np.isfinite(values)])) if np.isfinite(values).any() else 0.0


def _gps(channel: Channel, settings: Settings, warnings: list[Warn]) -> Values:
    degrees = places.degrees(channel, warnings)
    warnings += places.doubts(channel, degrees, settings.world)
    warnings += places.coarse(channel, degrees, settings.gps.sigma_m or _usual(channel, "gps_sigma_m") or GPS_SIGMA_M)
    place = np.radians(degrees)
    has_height = "altitude" in channel.values
    height = _columns(channel, ("altitude",), "m") if has_height else np.full((channel.stamps_ns.size, 1), np.nan)
    if "gps_sigma_m" not in channel.values:
        return np.concatenate([place, height], axis=1), None
    level, up = (_stated(channel.values.get(name, np.zeros(1))) for name in ("gps_sigma_m", "gps_sigma_up_m"))
    sigma = np.stack([level, level, np.where(np.isfinite(up), up, level)], axis=1)
    return np.concatenate([place, height], axis=1), sigma


def _stated(sigma: Array) -> Array:
    """Return sigmas, NaN where they are zero or negative: so receivers say that they know none."""
    return np.where(sigma > 0.0, sigma, np.nan)


def _gps_velocity(channel: Channel, settings: Settings, warnings: list[Warn]) -> Values:  # noqa: ARG001
    """East, north, up; a receiver may state down instead, and one sigma for all axes."""
    values = np.full((channel.stamps_ns.size, 3), np.nan)
    values[:, :2] = _columns(channel, COLUMNS["gps_velocity"][:2], "m/s")
    for name, sign in (("velocity_down", -1.0), ("velocity_up", 1.0)):
        if name in channel.values:
            values[:, 2:] = sign * _columns(channel, (name,), "m/s")
    if "velocity_sigma" not in channel.values:
        return values, None
    return values, np.repeat(_stated(_columns(channel, ("velocity_sigma",), "m/s")), 3, axis=1)


def _height(channel: Channel, settings: Settings, warnings: list[Warn]) -> Values:  # noqa: ARG001
    return _columns(channel, COLUMNS["height"], "m"), None


def _position(channel: Channel, settings: Settings, warnings: list[Warn]) -> Values:  # noqa: ARG001
    values = np.full((channel.stamps_ns.size, 3), np.nan)
    names = tuple(name for name in COLUMNS["position"] if name in channel.values)
    values[:, : len(names)] = _columns(channel, names, "m")
    return values, None


def _temperature(channel: Channel, settings: Settings, warnings: list[Warn]) -> Values:  # noqa: ARG001
    kelvin = channel.units.get("temperature_c", "") == "K"
    return channel.values["temperature_c"][:, None] - (273.15 if kelvin else 0.0), None


CONVERTERS: Mapping[str, Callable[[Channel, Settings, list[Warn]], Values]] = {
    "sun": _sun,
    "magnetometer": _magnetometer,
    "compass": _compass,
    "orientation": _orientation,
    "odometry": _odometry,
    "gps": _gps,
    "gps_velocity": _gps_velocity,
    "position": _position,
    "height": _height,
    "temperature": _temperature,
}
"""Role -> function from a channel to values and sigmas in the units of ``Fixes``."""
