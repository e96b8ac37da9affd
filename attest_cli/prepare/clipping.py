"""Clipping: runs of samples at the end of a sensor's range, what the drive did there, and how little is known of it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..records import Array, Bools, Ints, Warn
from ..settings.models import EARTH_GRAVITY_M_S2

BAND = 0.02  # of the largest value: plateaus of calibrated axes are not quite level
KINK = 10.0  # a plateau's edges are so many times steeper than its own samples; those of a smooth peak 2 to 3 times
LEVEL = 0.75  # of those edges: how far all of its samples may lie apart
LEAST_RUN, LONE_RUN, LONG_RUN = 3, 5, 10  # samples of a plateau; of one that stands alone in its log, and wanders
LONE_LEVEL = 0.1  # as LEVEL, of one that stands alone: of noise five samples lie that near by a far smaller chance
LONGEST_S = 3.0  # what stays longer is a sensor that is stuck
GYRO_FLOOR, ACCEL_FLOOR = 1.7, 15.0  # rad/s, m/s^2: below the range of any common sensor (100 deg/s, 1.5 g)
PILED, TINY, PILE, BELOW = 1e-3, 1e-12, 3.0, 3.0  # of the level; rounding; times as many as in so many sigma below
TIGHT, LEAST_PILE, TURNS = 0.1, 10, 0.1  # of the noise; samples; share of the steps that turn back, if there is noise
NORMAL = 0.6745 * 6.0**0.5  # median of second differences of white noise of one
BRIDGED_S = 1.0  # what happened in a longer run is not to be told from its sides
ANCHORS, MOST = 3, 2.5  # samples on either side that the spline passes; of the level, how far it may reach
APART = 3.0  # periods: nothing is drawn across a hole
SHARE = 0.5  # of what a spline adds to the level: its error, all run long
REST, OFTEN = 1.1, 0.05  # times gravity: an end of the range in which rest itself is clipped; share of the samples
GYRO_DENSITY, ACCEL_DENSITY = (0.1, 0.3), (0.3, 30.0)  # rad/s/sqrt(Hz), m/s^2/sqrt(Hz): least and most of a sample


@dataclass(frozen=True, slots=True)
class Clipped:
    """Rows (n,) of one axis that stand at an end of its range, ``level`` in its unit, signed; the longest run of it."""

    axis: int
    level: float
    rows: Bools
    longest_s: float

    @property
    def runs(self) -> list[tuple[int, int]]:
        """The runs ``[first, last)``, in time order."""
        return _runs(self.rows)


def clipped(t: Array, values: Array, floor: float) -> list[Clipped]:
    r"""Find the ends of the range that a sensor ran into, one for each axis and sign.

    A plateau is a run of at least three samples within 2 % of the log's largest value whose edges are ten times
    steeper than the median step on it (or one count): a smooth peak of the same height has edges 2 to 3 times
    steeper. Two plateaus, or one that is level or long, tell a range; below ``floor`` there is none. Once it is known,
    every sample that reaches the lowest plateau counts. Where many samples are ``piled`` up, no floor is asked for.

    Parameters
    ----------
    t : (n,) s
    values : (n, 3) in sensor axes, rad/s or m/s^2
    floor : the least level that is taken for the end of a range
    """
    found = []
    for axis, sign in ((axis, sign) for axis in range(values.shape[1]) for sign in (1.0, -1.0)):
        y = sign * values[:, axis]
        level = float(y.max(initial=0.0))
        at_end = piled(y)
        if at_end.any():
            found.append(_clipped(t, axis, sign * level, at_end))
            continue
        if level < floor:
            continue
        seen = np.unique(y[y > 0.5 * level])
        counts = np.diff(seen)
        count = float(np.min(counts[counts > 1e-6 * level], initial=level))
        runs = [(a, b) for a, b in _runs(y >= (1.0 - BAND) * level) if b - a >= LEAST_RUN]
        flat = [run for a, b in runs if (run := _plateau(y, a, b, count)) is not None]
        flat = [(a, b) for a, b in flat if t[b - 1] - t[a] < LONGEST_S]
        if len(flat) > 1 or any(_alone(y, a, b) for a, b in flat):
            least = min(float(y[a:b].min()) for a, b in flat)
            found.append(_clipped(t, axis, sign * level, y >= least))
    return found


def piled(y: Array) -> Bools:
    """Tell the rows (n,) of one axis that stand at the upper end of its range, where that is often so, in any unit.

    The noise ends there: within a tenth of it there are two runs of five samples, and three times as many samples as in
    the three sigma below. A rate that is held has its noise, and a log without noise tells nothing.
    """
    none = np.zeros(len(y), dtype=np.bool_)
    level = float(y.max(initial=0.0))
    near = y >= (1.0 - PILED) * level
    if level <= 0.0 or not LEAST_PILE <= np.count_nonzero(near) < len(y) - LEAST_PILE:
        return none
    step = np.diff(y)
    free = ~(near[2:] | near[1:-1] | near[:-2])
    if not free.any() or np.mean(step[1:][free] * step[:-1][free] < 0.0) < TURNS:
        return none
    noise = float(np.median(np.abs(np.diff(step)[free]))) / NORMAL
    counts = np.diff(np.unique(y[y > 0.5 * level]))
    count = float(np.min(counts[counts > 1e-6 * level], initial=level))
    middle = float(np.median(y[near]))
    rows = y >= min(2.0 * middle - level, (1.0 - TINY) * level)
    below = np.count_nonzero(y >= middle - BELOW * max(noise, count)) - np.count_nonzero(rows)
    long = sum(b - a >= LONE_RUN for a, b in _runs(rows))
    quiet = level - middle < TIGHT * noise
    return rows if quiet and long > 1 and np.count_nonzero(rows) > PILE * below else none


def repaired(t: Array, values: Array, ends: list[Clipped], bounds: tuple[float, float]) -> tuple[Array, Array]:
    r"""Return the values (n, 3) with a cubic spline over every clipped run, and their noise density (n,), 0 elsewhere.

    The spline passes three unclipped samples on either side; it stays between what was recorded and 2.5 times the
    level. Its error lasts as long as the run: half of what it adds, :math:`\sigma=\tfrac12\max(x-x_0)\sqrt T`, as the
    density of white noise that is as large at the end of the run, within ``bounds``. Where no spline can be drawn the
    value stays.
    """
    from scipy.interpolate import CubicSpline

    out, density = values.copy(), np.zeros(len(t))
    period = float(np.median(np.diff(t)))
    for end in ends:
        y = np.sign(end.level) * values[:, end.axis]
        free, level = np.flatnonzero(~end.rows), abs(end.level)
        for a, b in end.runs:
            place, span = int(np.searchsorted(free, a)), (b - a) * period
            anchors = free[max(place - ANCHORS, 0) : place + ANCHORS]
            added = (MOST - 1.0) * level
            if t[b - 1] - t[a] <= BRIDGED_S and _close(t, anchors, a, b, period):
                drawn = CubicSpline(t[anchors], y[anchors])(t[a:b])
                drawn = np.clip(drawn, y[a:b], MOST * level)
                out[a:b, end.axis] = np.sign(end.level) * drawn
                added = float(np.max(drawn - y[a:b]))
            density[a:b] = np.hypot(density[a:b], max(SHARE * added * np.sqrt(span), bounds[0]))
    return out, np.where(density > 0.0, np.clip(density, *bounds), 0.0)


def told(name: str, sensor: str, ends: list[Clipped], unit: str) -> Warn:
    """Say which axes are clipped at which level, how often, and what was done."""
    parts = [f"{'xyz'[e.axis]} at {e.level:.4g} {unit} ({np.count_nonzero(e.rows)} samples)" for e in ends]
    rest = sensor != "gyro" and any(
        abs(e.level) < REST * EARTH_GRAVITY_M_S2 and np.count_nonzero(e.rows) > OFTEN * e.rows.size for e in ends
    )
    fatal = rest or (sensor == "gyro" and any(e.longest_s > BRIDGED_S for e in ends))
    if rest:
        hint = "its range ends at gravity: which way is up is not known there; take a wider range of the sensor"
    elif fatal:
        hint = f"for over {BRIDGED_S:g} s at a time: how far it turned is not known; take a wider range of the sensor"
    elif sensor == "gyro":
        hint = "a spline stands in for these samples, with a larger sigma; a wider range of the sensor would not clip"
    else:
        hint = "these samples count less; a wider range of the sensor, or softer mounts, would not clip"
    return Warn(f"{sensor}-clipped", f"{name}: {sensor} clipped: {', '.join(parts)}", hint, fatal=fatal)


def _clipped(t: Array, axis: int, level: float, rows: Bools) -> Clipped:
    return Clipped(axis, level, rows, max(float(t[b - 1] - t[a]) for a, b in _runs(rows)))


def _plateau(y: Array, a: int, b: int, count: float) -> tuple[int, int] | None:
    """Return the part of a run that is level, if both of its edges are steep."""
    if a == 0 or b == len(y):
        return None
    step = np.diff(y[a - 1 : b + 1])
    inner = np.abs(step[2:-2]) if b - a > LEAST_RUN else np.abs(step[1:-1])
    steep = KINK * max(float(np.median(inner)), count)
    if step[1] > steep:
        a += 1
    if -step[-2] > steep:
        b -= 1
    edges = y[a] - y[a - 1], y[b - 1] - y[b]
    level = np.ptp(y[a:b]) < LEVEL * min(edges)
    return (a, b) if min(edges) > steep and level and b - a >= LEAST_RUN else None


def _alone(y: Array, a: int, b: int) -> bool:
    """Whether one plateau tells a range: it is long, or far more level than five samples of noise are."""
    edges = min(y[a] - y[a - 1], y[b - 1] - y[b])
    return b - a >= LONG_RUN or (b - a >= LONE_RUN and float(np.ptp(y[a:b])) < LONE_LEVEL * edges)


def _close(t: Array, anchors: Ints, a: int, b: int, period: float) -> bool:
    """Tell whether three samples on either side lie next to a run, without a hole."""
    before, after = anchors[anchors < a], anchors[anchors >= b]
    if len(before) < ANCHORS or len(after) < ANCHORS:
        return False
    rows = np.concatenate([before, np.arange(a, b), after])
    return all(t[k] - t[j] < APART * (k - j) * period for j, k in pairwise(rows.tolist())) and bool(
        a - before[0] <= 2 * ANCHORS and after[-1] - b < 2 * ANCHORS
    )


def _runs(rows: Bools) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], rows, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
