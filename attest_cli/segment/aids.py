"""What tells stops besides the IMU: wheel odometry, and a list by hand."""

from __future__ import annotations

import csv
import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..errors import AttestError
from ..records import Array, Bools, Fixes, Imu, Segment, Warn
from .stillness import CHI2_3, stretches

STILL_M_S = 0.02  # wheels slower than this are not surely turning, however good the odometry
MOVES_RAD, MOVES_S, SHOWN = np.radians(2.0), 20.0, 3  # a hand-made edge is a little off; at a time; stops told
HOLE = 5.0  # periods: nobody knows what turned in so long a step
ODOMETRY_WINDOW_S, ODOMETRY_LAG_S = 2.0, 0.5


def wheels_turn(odometry: Fixes | None, t: Array) -> Bools:
    """Where wheel odometry is sure of motion, at the instants ``t``: its mean speed stands out of its own noise.

    Spans of motion are shortened by the lag that odometry may have; where it is silent nothing is said.
    """
    turning = np.zeros(t.size, bool)
    if odometry is None or odometry.t.size < 3:
        return turning
    values = odometry.values[:, np.isfinite(odometry.values).any(axis=0)]
    known = np.isfinite(values)
    filled = np.where(known, values, 0.0)
    half = ODOMETRY_WINDOW_S / 2
    low, high = (np.searchsorted(odometry.t, odometry.t + side * half) for side in (-1, 1))

    def over_window(x: Array) -> Array:
        total = np.concatenate([np.zeros((1, x.shape[1])), np.cumsum(x, axis=0)])
        return np.asarray(total[high] - total[low])

    count = np.maximum(over_window(known.astype(float)), 1.0)
    noise = np.nanmedian(np.abs(np.diff(values, axis=0)), axis=0) / 0.954  # robust: of differences of white noise
    variance = noise**2 / count + STILL_M_S**2 / CHI2_3
    sure = np.sum((over_window(filled) / count) ** 2 / variance, axis=1) > CHI2_3
    sure &= high - low >= 3
    bounds = stretches(sure, np.array([0, sure.size, *(np.flatnonzero(np.diff(odometry.t) > half) + 1)]))
    for first, last in itertools.pairwise(bounds):
        if sure[first]:
            begin, end = odometry.t[first] + half + ODOMETRY_LAG_S, odometry.t[last - 1] - half - ODOMETRY_LAG_S
            turning |= (t >= begin) & (t <= end)
    return turning


def inside_stops(t: Array, stops: list[tuple[float, float]]) -> Bools:
    """Samples within the given stops."""
    still = np.zeros(t.size, bool)
    for start, end in stops:
        still[np.searchsorted(t, start) : np.searchsorted(t, end, side="right")] = True
    return still


def stops_that_move(imu: Imu, segments: Sequence[Segment]) -> tuple[Warn, ...]:
    """Say which of the stops given by hand turn, by the integral of the gyro about its own usual rate there: a bias,
    or an engine that shakes, turns nothing.
    """
    told, stops = list[str](), [s for s in segments if not s.motion]
    for s in stops:
        angle = _turn(imu, np.append(np.arange(s.used_start, s.used_end, MOVES_S), s.used_end))
        if angle > MOVES_RAD:
            told.append(f"{s.start:.1f} to {s.end:.1f} s (by {np.degrees(angle):.0f} deg)")
    if not told:
        return ()
    more = f" and {len(told) - SHOWN} more" if len(told) > SHOWN else ""
    fact = f"{len(told)} of the {len(stops)} stops given by hand turn: {', '.join(told[:SHOWN])}{more}"
    return (Warn("stop-moves", fact, "mend the file of --stops: are its times seconds of this log?", fatal=True),)


def _turn(imu: Imu, edges: Array) -> float:
    """Return the largest turn, rad, between two edges (k,) s, in which a bias hardly walks; none is known in a hole."""
    worst = 0.0
    for lo, hi in itertools.pairwise(np.searchsorted(imu.t, edges).tolist()):
        if hi - lo < 3:
            continue
        rate = imu.gyro_b[lo:hi] - np.median(imu.gyro_b[lo:hi], axis=0)
        step = np.diff(imu.t[lo:hi])
        step[step > HOLE * np.median(step)] = 0.0
        turned = np.cumsum(0.5 * (rate[1:] + rate[:-1]) * step[:, None], axis=0)
        worst = max(worst, float(np.linalg.norm(np.ptp(turned, axis=0))))
    return worst


def read_stops(path: Path, begin: float, end: float) -> list[tuple[float, float]]:
    """Stops given by hand: a CSV with the columns ``start_s`` and ``end_s``, in seconds of the log's time.

    Raises
    ------
    AttestError
        If the file cannot be read, a number is missing, or stops overlap or lie outside the log.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            rows = list(csv.DictReader(stream, skipinitialspace=True))
    except OSError as fault:
        raise AttestError(f"{path}: {fault.strerror}", "--stops names a CSV with start_s, end_s") from None
    except (UnicodeDecodeError, csv.Error) as fault:
        raise AttestError(f"{path}: not a CSV file: {fault}", "--stops names a CSV with start_s, end_s") from None
    if not rows:
        raise AttestError(f"{path}: no stops in it", "write a line start_s,end_s and one line for each stop")
    stops = []
    for number, row in enumerate(rows, start=2):
        try:
            start, stop = float(row["start_s"]), float(row["end_s"])
        except KeyError as fault:
            raise AttestError(f"{path}: no column {fault}", "the first line should be start_s,end_s") from None
        except (TypeError, ValueError):
            raise AttestError(f"{path}: line {number} is not two numbers", "give seconds, such as 12.5,20") from None
        if not begin <= max(start, begin) < min(stop, end):  # also false for nan
            span = f"the log spans {begin:.2f} to {end:.2f} s"
            raise AttestError(f"{path}: line {number}: no stop from {start:g} to {stop:g} s", span)
        stops.append((start, stop))
    stops.sort()
    for (_, before), (after, _) in itertools.pairwise(stops):
        if after <= before:
            raise AttestError(f"{path}: the stops at {before:g} and {after:g} s overlap", "join them to one line")
    return stops
