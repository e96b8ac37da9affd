"""From the statistic of stillness to numbered segments, and what there is to doubt about them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..records import Array, Bools, Ints, Log, Segment, Segmentation, Warn
from ..settings import Settings
from .aids import inside_stops, read_stops, stops_that_move, wheels_turn
from .stillness import (
    ACCEL_DRIFT,
    BIAS_WALK,
    GYRO_DRIFT,
    LONE_STOP_S,
    Quiet,
    Thresholds,
    Windows,
    agreeing,
    at_rest,
    gap_edges,
    hysteresis,
    quiet_intervals,
    sensor_noise,
    stop_statistic,
    stretches,
    thresholds,
    window_moments,
)

FAST, FASTEST_RAD_S = 20.0, 0.2  # of the largest bias that is believed: where nothing else is quiet, one is asked about
SENSOR = {"gyro_noise_density": "gyro", "accel_noise_density": "accelerometer"}
AS_UNIT = 0.1  # how near a ratio of noise is to that of deg/s and rad/s
LOUD = 3.0  # times the noise that is stated: no window of the log is as calm
JUMP = math.radians(0.5)  # rad/s: a bias that jumps by more leaves the motion before it too wide open
RARE = 0.1  # share of the log below which stops are doubted when the noise is not stated


def find_segments(log: Log, settings: Settings) -> Segmentation:
    r"""Split a drive into stops and motions.

    The statistic of a window of $W$ samples is the greater of
    $T = \overline{|f - \bar f|^2}/\sigma_a^2 + \overline{|\omega - b|^2}/\sigma_\omega^2$ (MV + ARE with bias) and
    $\kappa\,|\bar\omega - b|^2$, where $\kappa$ gives both the same threshold.
    A stop is where it stays below ``leave`` and somewhere falls below ``enter``.

    Parameters
    ----------
    log : Log
        SI units, any axes; ``log.gaps`` split segments.
    settings : Settings
        ``stops``, and the noise in ``imu``; noise that is not given comes from the log itself.

    Raises
    ------
    AttestError
        If ``settings.stops.file`` cannot be used.

    Notes
    -----
    Beyond Skog 2010 (T, with a bias found blind): the second term, quiet intervals that must agree on the bias, a bias
    that may drift, hysteresis both ways in time.
    """
    imu, stops = log.imu, settings.stops
    edges = gap_edges(imu.t, log.gaps)
    windows = window_moments(imu, edges, stops.window_s)
    turning = wheels_turn(log.fixes.get("odometry") if stops.use_odometry else None, windows.t)
    sigmas = sensor_noise(windows, imu.t, settings)
    limits = thresholds(windows, sigmas, settings)
    found = quiet_intervals(windows, sigmas, limits.enter, turning, settings)
    walk = 3.0 * (settings.imu.gyro_random_walk or BIAS_WALK)
    quiet = agreeing(found, sigmas[0] ** 2 / windows.width + GYRO_DRIFT**2, walk)
    agreed, quiet = quiet, at_rest(found, quiet, math.hypot(sigmas[1] / math.sqrt(windows.width), ACCEL_DRIFT))
    by_hop = stop_statistic(windows, sigmas, limits, quiet, walk)
    statistic = np.repeat(by_hop.astype(np.float32), np.diff(windows.first))
    if stops.file is not None:
        still = inside_stops(imu.t, read_stops(stops.file, float(imu.t[0]), float(imu.t[-1])))
    else:
        calm = hysteresis(by_hop, limits, windows.run) & ~turning
        still = tidy(np.repeat(calm, np.diff(windows.first)), imu.t, edges, stops.min_stop_s, stops.min_motion_s)
    margin = margin_of(statistic, still, limits.enter)
    stated = settings.imu.gyro_noise_density is not None and settings.imu.accel_noise_density is not None
    if stops.file is None and not stated and still.mean() < RARE and margin < stops.leave_factor:
        still[:] = False  # the noise was taken from the motion itself, of which these are the calmest moments
        margin = math.nan
    segments = as_segments(still, imu.t, edges, stops.window_s / 2)
    loud = {} if still.any() else louder(windows, imu.t, settings)
    told = doubts(still, limits, margin, found, quiet, loud) + jumps(agreed, quiet)
    if not found.start.size:
        factor = max(FAST, FASTEST_RAD_S / settings.imu.gyro_bias_sigma)
        told += fast(quiet_intervals(windows, sigmas, limits.enter, turning, settings, factor))
    return Segmentation(
        segments=segments,
        statistic=statistic,
        enter=limits.enter,
        leave=limits.leave,
        bias_b=still.astype(float) @ imu.gyro_b / np.count_nonzero(still) if still.any() else np.zeros(3),
        margin=margin,
        source="file" if stops.file is not None else "odometry" if turning.any() else "imu",
        warnings=told if stops.file is None else stops_that_move(imu, segments),
    )


def fast(wide: Quiet) -> tuple[Warn, ...]:
    """Say where a log without a quiet interval has one whose rate is beyond what a bias may be."""
    long = wide.end - wide.start >= LONE_STOP_S
    if not long.any():
        return ()
    k = int(np.argmax(np.where(long, wide.blocks, 0.0)))
    rate, span = np.degrees(np.linalg.norm(wide.rate[k])), f"from {wide.start[k]:.0f} to {wide.end[k]:.0f} s"
    message = f"{span} nothing changes but the gyro reads {rate:.1f} deg/s: a bias beyond imu.gyro_bias_sigma?"
    return (Warn("gyro-bias", message, "state imu.gyro_bias_sigma as large as the bias may be"),)


def jumps(agreed: Quiet, quiet: Quiet) -> tuple[Warn, ...]:
    """Say by how much the gyro's bias jumps, where a rest that gravity proves has another."""
    lone = np.flatnonzero(~np.isin(quiet.start, agreed.start))
    if not lone.size:
        return ()
    known = 0.5 * (agreed.start + agreed.end)
    when = 0.5 * (quiet.start + quiet.end)[lone]
    usual = np.stack([np.interp(when, known, agreed.rate[:, i]) for i in range(3)], axis=1)
    off = np.linalg.norm(quiet.rate[lone] - usual, axis=1)
    message = (
        f"the gyro's bias jumps: by {np.degrees(off.max()):.2g} deg/s at the rest from {quiet.start[lone[0]]:.0f} s"
    )
    hint = "when it jumps is not known: in the motion before, the attitude is less certain than its sigma"
    return (Warn("gyro-bias", message, hint, fatal=bool(off.max() > JUMP)),)


def margin_of(statistic: NDArray[np.float32], still: Bools, enter: float) -> float:
    """5 % quantile of the statistic in motion over the threshold; nan without motion or without a stop."""
    return float(np.quantile(statistic[~still], 0.05)) / enter if still.any() and not still.all() else math.nan


def tidy(still: Bools, t: Array, edges: Ints, min_stop_s: float, min_motion_s: float) -> Bools:
    """Fill motions shorter than ``min_motion_s`` between stops, then drop stops shorter than ``min_stop_s``."""
    still = still.copy()
    for value, shortest in ((False, min_motion_s), (True, min_stop_s)):
        bounds = stretches(still, edges)
        for first, last in itertools.pairwise(bounds):
            inner = value or (first not in edges and last not in edges)
            if still[first] == value and inner and t[last - 1] - t[first] < shortest:
                still[first:last] = not value
    return still


def as_segments(still: Bools, t: Array, edges: Ints, shrink_s: float) -> tuple[Segment, ...]:
    """Segments that cover all samples: stops odd, motions even; they meet at a sample, or end at a gap."""
    bounds, segments, index = stretches(still, edges), list[Segment](), 0
    at_gap = np.isin(bounds, edges)
    for k, (first, last) in enumerate(itertools.pairwise(bounds)):
        motion = not still[first]
        index += 1 if (index + 1) % 2 == (0 if motion else 1) else 2
        start, end = float(t[first]), float(t[last - 1] if at_gap[k + 1] else t[last])
        shrink = 0.0 if motion else min(shrink_s, (end - start) / 4)
        segments.append(Segment(index, motion, start, end, int(first), int(last), start + shrink, end - shrink))
    return tuple(segments)


def louder(windows: Windows, t: Array, settings: Settings) -> dict[str, float]:
    """Return by how much even the calmest windows are noisier than is stated, per density; those that are."""
    stated = sensor_noise(windows, t, settings)
    free = dict.fromkeys(SENSOR)
    seen = sensor_noise(windows, t, settings.model_copy(update={"imu": settings.imu.model_copy(update=free)}))
    times = {name: own / wanted for name, own, wanted in zip(free, seen, stated, strict=True)}
    return {name: by for name, by in times.items() if by > LOUD}


def too_loud(loud: Mapping[str, float], by_hand: str) -> list[Warn]:
    """Say that nothing is as calm as stated, and where it is by what deg/s taken for rad/s make of a rest."""
    said = " and ".join(
        f"the {SENSOR[name]} is {by:.3g} times as noisy as [imu] {name} states" for name, by in loud.items()
    )
    fact = f"no stop found in this log: at its calmest {said}"
    told = [Warn("no-stop", fact, f"mend what is stated; if something shook while it rested, {by_hand}")]
    if abs(loud.get("gyro_noise_density", 0.0) * np.radians(1.0) - 1.0) < AS_UNIT:
        fact = "the gyro is as much noisier than stated as deg/s are more than rad/s: is one of them in deg/s?"
        told.append(Warn("unit-doubted", fact, "state the gyro's unit in the header, and its noise in rad/s"))
    return told


def doubts(
    still: Bools, limits: Thresholds, margin: float, found: Quiet, quiet: Quiet,
    loud: Mapping[str, float] | None = None,
) -> tuple[Warn, ...]:  # fmt: skip
    """What the user should know about the stops that were found; ``loud``: by how much nothing is as calm as stated."""
    by_hand = "give the stops by hand with --stops FILE"
    warnings = []
    if not still.any() and loud:
        warnings += too_loud(loud, by_hand)
    elif not still.any():
        warnings.append(Warn("no-stop", "no stop found in this log", f"if the vehicle did rest, {by_hand}"))
    elif margin < limits.leave / limits.enter:
        fact = f"stops and motion are hard to tell apart: the calmest motion is {margin:.1f} times the stop threshold"
        warnings.append(Warn("stop-margin", fact, f"check them; wheel odometry helps, or {by_hand}"))
    if still.any() and limits.enter > 1.01 * limits.noise:
        times = f"{limits.enter / limits.noise:.{0 if limits.enter > 10 * limits.noise else 1}f}"
        fact = f"the sensors shake at the stops (engine, wind?): the stop threshold is {times} times the noise"
        warnings.append(Warn("stop-shakes", fact, f"if nothing shook, state the noise under [imu], or {by_hand}"))
    other = ~np.isin(found.start, quiet.start) & (found.end - found.start >= LONE_STOP_S)
    if quiet.start.size == 1 and found.start.size > 1:
        fact = "only one quiet interval supports the gyro's bias, others contradict it"
        warnings.append(Warn("stop-bias", fact, f"a smooth turn can look like a stop: check, or {by_hand}"))
    elif quiet.start.size and other.any():
        count, total = np.count_nonzero(other), found.start.size
        fact = f"{count} of {total} quiet intervals contradict the gyro's bias of the others: taken as motion"
        hint = f"a smooth turn looks like a stop, but so does a stop after the bias has moved: check, or {by_hand}"
        warnings.append(Warn("stop-bias", fact, hint))
    return tuple(warnings)
