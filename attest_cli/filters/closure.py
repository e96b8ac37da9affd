"""Whether the gyro closes from the gravity of one stop to that of the next, and where not, what would make it close."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..maths import rotation
from ..maths.axes import changed, in_words, signed_permutations
from ..nodes.noise import reference_bias, stop_ranges
from ..records import Array, Log, Segmentation, Warn

STEP_S = 0.04  # turns are summed over this
LONGEST_S, MOST = 1200.0, 20  # motions that are tried: length, number
FEWEST = 2  # one motion closes with other axes by chance
OPEN_RAD = np.radians(0.25), np.radians(1.5)  # what opens less may be the accelerometer; where noise explains it
CLOSES, ALONE, EQUAL = 0.25, 0.4, 1.05  # misfit over that of the gyro as it is; over that of the next best axes; a tie
GROSS = 0.02  # scale error from which a track is of no use
SCALES = np.linspace(0.5, 2.0, 151)
HINT = "put signs, order and units right in the driver, or with --columns; [imu] mounting turns both together"


@dataclass(frozen=True, slots=True)
class Motion:
    """From one stop to the next: the gyro's ``turns`` (m, 3) rad without its bias, gravity ``before`` and ``after``
    (3,).
    """

    turns: Array
    before: Array
    after: Array

    def misfit(self, axes: Array) -> float:
        """Return by how much the gyro, its axes changed, misses gravity at the end, squared."""
        q = _whole(rotation.exp_quaternion(self.turns @ axes.T))
        expected = rotation.rotate(rotation.conjugate(q), self.before[None])[0]
        return float(np.sum((expected - self.after) ** 2))


def motions(log: Log, segmentation: Segmentation) -> list[Motion]:
    """Return the motions between two stops without a gap."""
    t, out = log.imu.t, list[Motion]()
    both = [*zip(segmentation.stops, stop_ranges(log, segmentation), strict=True)]
    for (one, (a0, a1)), (two, (b0, b1)) in pairwise(both):
        inside = (log.gaps[:, 0] < two.used_start) & (log.gaps[:, 1] > one.used_end) if len(log.gaps) else np.array([])
        if min(a1 - a0, b1 - b0) < 10 or inside.any() or t[b0] - t[a1] > LONGEST_S or len(out) == MOST:
            continue
        at, rate = t[a1 - 1 : b0 + 1], log.imu.gyro_b[a1 - 1 : b0 + 1]
        each = rate[1:] + rate[:-1]
        each *= 0.5 * np.diff(at)[:, None]
        first = np.flatnonzero(np.diff(np.floor((at[1:] - at[0]) / STEP_S), prepend=-1.0))
        edges = at[np.append(first, len(at) - 1)]
        bias = reference_bias(log, segmentation, 0.5 * (edges[1:] + edges[:-1]))  # linear from stop to stop
        turns = np.add.reduceat(each, first, axis=0) - bias * np.diff(edges)[:, None]
        ups = [log.imu.accel_b[lo:hi].mean(axis=0) for lo, hi in ((a0, a1), (b0, b1))]
        before, after = (up / np.linalg.norm(up) for up in ups)
        out.append(Motion(turns, before, after))
    return out


def doubts(log: Log, segmentation: Segmentation, *, raised: bool) -> list[Warn]:
    """Say which other axes, or which other scale of the gyro, would make it close where it does not.

    ``raised``: its noise does not explain that.
    """
    found = motions(log, segmentation)
    if len(found) < FEWEST:
        return []
    same = _opening(found, np.eye(3))
    if same < OPEN_RAD[0 if raised else 1]:
        return []
    openings = np.array([_opening(found, axes) for axes in signed_permutations()])
    best = openings.min()
    tied = openings <= EQUAL * best
    if best < CLOSES * same and best < ALONE * openings[~tied].min(initial=np.inf):
        axes = min((signed_permutations()[k] for k in np.flatnonzero(tied)), key=changed)
        message = f"gyro and accelerometer contradict each other by {np.degrees(same):.2g} deg from stop to stop"
        return [Warn("gyro-against-accel", f"{message}: {in_words(axes)}", HINT, fatal=True)]
    scaled = np.array([_opening(found, scale * np.eye(3)) for scale in SCALES])
    k = int(np.argmin(scaled))
    if scaled[k] < CLOSES * same and 0 < k < len(SCALES) - 1:
        message = f"the gyro closes from stop to stop with {SCALES[k]:.2f} times its rate, not as it is"
        hint = "calibrate its scale: where it turns much, sigma does not hold"
        return [Warn("gyro-scale", message, hint, fatal=abs(SCALES[k] - 1.0) > GROSS)]
    return []


def _whole(q: Array) -> Array:
    """Return the product (1, 4) of unit quaternions (n, 4), by halves: only the whole is asked for."""
    while len(q) > 1:
        even = len(q) // 2 * 2
        q = np.concatenate([rotation.multiply(q[:even:2], q[1:even:2]), q[even:]])
    return rotation.normalise(q)


def _opening(found: Sequence[Motion], axes: Array) -> float:
    """Return the RMS angle, rad, by which the gyro misses gravity."""
    return float(np.sqrt(np.mean([motion.misfit(axes) for motion in found])))
