"""Whether the gyro closes from the gravity of one stop to that of the next, and where not, what would make it close."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..maths import rotation
from ..maths.axes import changed, in_words, signed_permutations
from ..maths.consistency import upper_quantile
from ..nodes.noise import Noise, motion_density, reference_bias, stop_ranges
from ..records import Array, Log, Segmentation, Warn
from . import Drive

STEP_S = 0.04  # turns are summed over this
LONGEST_S, MOST = 1200.0, 20  # motions that are tried: length, number
FEWEST = 2  # one motion closes with other axes by chance
OPEN_RAD = np.radians(0.25), np.radians(1.5)  # what opens less may be the accelerometer; where noise explains it
CLOSES, ALONE, EQUAL = 0.25, 0.4, 1.05  # misfit over that of the gyro as it is; over that of the next best axes; a tie
MOST_TIED = 4  # axes that close alike: of more none is told from the rest, as where each motion ends as it began
GROSS, LOST_SCALE = 0.02, 0.2  # scale error from which a track is of no use
SCALES = np.linspace(0.4, 2.5, 211)  # a clock of half or twice the rate is within
OTHER_UNIT, LARGEST_BIAS = (3.0, 30.0), 2.0  # of an accelerometer axis, its factor; m/s^2: more is another fault
LESS = 0.5  # of what an accelerometer's fault leaves: a gyro bias in motion that leaves less is the better reason
GROSS_BIAS = 0.2  # m/s^2; a gyro turned 1.2 deg against the accelerometer would look the same, and is as rare
SEEN, LEVEL = 0.2, 2.0  # of what a bias shows in the axis that shows it best; level over plumb: plumb, it tilts nothing
SURE = 5.0  # sigma from which a bias or a rest contradicts
# that noise opens so much, in which an assumed scale error is counted all along; that it leaves so much
CHANCE, USUAL = 5e-4, 0.01
EXPLAINED = 1e-5  # chance that noise, however large, is explained so wholly
LEAST_CHANGE = 0.02  # m/s^2: 2 mg, what an accelerometer drifts in a day
CALM_S, SHAKES = 4.0, 1.5  # of a rest that is no stop; times the noise at the stops
HINT = "put signs, order and units right in the driver, or with --columns; [imu] mounting turns both together"
ACCEL_HINT = "calibrate it, or state [imu] accel_bias_sigma: tilt is off by as much, and its sigma does not hold"


@dataclass(frozen=True, slots=True)
class Motion:
    """From one stop to the next: the gyro's ``turns`` (m, 3) rad without its bias, specific force ``before`` and
    ``after`` (3,) m/s^2; it takes ``span`` s, the stops at its ends ``stood`` (2,) s.
    """

    span: float
    stood: Array
    turns: Array
    before: Array
    after: Array

    def misfit(self, back: Array) -> float:
        """Return by how much a rotation (3, 3) misses the direction of gravity at the end, squared."""
        before, after = (force / np.linalg.norm(force) for force in (self.before, self.after))
        return float(np.sum((back @ before - after) ** 2))

    def back(self, axes: Array) -> Array:
        """Return the rotation (3, 3) from body axes before to those after, by the gyro with its axes changed."""
        return np.asarray(rotation.matrix(_whole(rotation.exp_quaternion(self.turns @ axes.T)))[0].T)

    def variance(self, noise: Noise) -> float:
        """Return the variance, rad^2, of the angle about one axis by which gravity is missed: of the gyro's noise, its
        walk, and the noise of a bias between those of two stops.
        """
        a_second = max(1, round(len(self.turns) / self.span))  # a slow IMU has less than one sample a step
        seconds = np.add.reduceat(self.turns, np.arange(0, len(self.turns), a_second))
        own = self.span * float(motion_density(noise, seconds).mean()) + noise.n_w * self.span**3 / 3.0
        return own + noise.n_r * float(np.sum(1.0 / self.stood)) * (0.5 * self.span) ** 2

    def drifted(self) -> Array:
        """Return what specific force after the motion is off, m/s^2, for a bias of the gyro in motion (3, 3), rad/s."""
        q = rotation.chain(rotation.exp_quaternion(self.turns))
        to_end = rotation.matrix(rotation.multiply(rotation.conjugate(q[-1:]), q))
        return np.asarray(rotation.skew(self.after) @ to_end.mean(axis=0) * self.span)


def motions(log: Log, segmentation: Segmentation, calm: Sequence[tuple[int, int]] = ()) -> list[Motion]:
    """Return the motions between two stops, or rests that are ``calm``, without a gap; each rest as its samples."""
    t, out = log.imu.t, list[Motion]()
    for (a0, a1), (b0, b1) in pairwise(sorted([*stop_ranges(log, segmentation), *calm])):
        inside = (log.gaps[:, 0] < t[b0]) & (log.gaps[:, 1] > t[a1 - 1]) if len(log.gaps) else np.array([])
        if min(a1 - a0, b1 - b0) < 10 or inside.any() or t[b0] - t[a1] > LONGEST_S or len(out) == MOST:
            continue
        at, rate = t[a1 - 1 : b0 + 1], log.imu.gyro_b[a1 - 1 : b0 + 1]
        each = rate[1:] + rate[:-1]
        each *= 0.5 * np.diff(at)[:, None]
        first = np.flatnonzero(np.diff(np.floor((at[1:] - at[0]) / STEP_S), prepend=-1.0))
        edges = at[np.append(first, len(at) - 1)]
        bias = reference_bias(log, segmentation, 0.5 * (edges[1:] + edges[:-1]))  # linear from stop to stop
        turns = np.add.reduceat(each, first, axis=0) - bias * np.diff(edges)[:, None]
        forces = (log.imu.accel_b[lo:hi].mean(axis=0) for lo, hi in ((a0, a1), (b0, b1)))
        stood = np.array([t[a1 - 1] - t[a0], t[b1 - 1] - t[b0]])
        out.append(Motion(float(at[-1] - at[0]), stood, turns, *forces))
    return out


def doubts(drive: Drive, *, raised: bool) -> list[Warn]:
    """Say what would make gyro and accelerometer close where they do not: other axes of the gyro, another scale of it,
    another scale of an axis of the accelerometer, or a bias of that.

    ``raised``: the gyro's noise does not explain that. Then gravity's size is asked too.
    """
    log, segmentation, noise = drive.log, drive.segmentation, drive.noise
    told = {warn.code for warn in (*log.warnings, *segmentation.warnings)}
    disputed = _disputed(log, segmentation, noise) if "stop-bias" in told else []
    found = motions(log, segmentation)
    if disputed or len(found) < FEWEST:
        return disputed
    turned = [motion.back(np.eye(3)) for motion in found]
    same, lost = _opening(found, turned), "imu-rows-missing" in told
    causes = _axes(found, same) or _scale(found, same, lost) if same > OPEN_RAD[0 if raised else 1] else []
    if lost:  # which does not close either
        return causes
    if not causes and (raised or len(found) > FEWEST):
        causes = _accelerometer(found, turned, noise, drive.settings.imu.accel_bias_sigma)
    return causes or (_sizes(found, drive) if raised else [])


def _axes(found: Sequence[Motion], same: float) -> list[Warn]:
    """Say which other axes of the gyro close."""
    openings = np.array([_opening(found, [m.back(axes) for m in found]) for axes in signed_permutations()])
    best = openings.min()
    tied = openings <= EQUAL * best
    alone = best < ALONE * openings[~tied].min(initial=np.inf) and np.count_nonzero(tied) <= MOST_TIED
    if best >= CLOSES * same or not alone:
        return []
    axes = min((signed_permutations()[k] for k in np.flatnonzero(tied)), key=changed)
    message = f"gyro and accelerometer contradict each other by {np.degrees(same):.2g} deg from stop to stop"
    return [Warn("gyro-against-accel", f"{message}: {in_words(axes)}", HINT, fatal=True)]


def _scale(found: Sequence[Motion], same: float, lost: bool) -> list[Warn]:
    """Say which other scale of the gyro closes; where rows are ``lost``, one that they do not explain."""
    scaled = np.array([_opening(found, [m.back(scale * np.eye(3)) for m in found]) for scale in SCALES])
    k = int(np.argmin(scaled))
    if scaled[k] >= CLOSES * same or not 0 < k < len(SCALES) - 1:
        return []
    if lost and (abs(SCALES[k] - 1.0) < LOST_SCALE or not _wholly((scaled[k] / same) ** 2, 2 * len(found), 1)):
        return []
    message = f"the gyro closes from stop to stop with {SCALES[k]:.2f} times its rate, not as it is"
    hint = "calibrate its scale: where it turns much, sigma does not hold"
    if abs(SCALES[k] - 1.0) > LOST_SCALE:
        hint = "check the rate of the clock (--sample-rate), and the unit and range of the gyro"
    return [Warn("gyro-scale", message, hint, fatal=abs(SCALES[k] - 1.0) > GROSS)]


def _accelerometer(found: Sequence[Motion], turned: Sequence[Array], noise: Noise, bias_sigma: float) -> list[Warn]:
    r"""Say which axis of the accelerometer closes with another scale :math:`1+s`, or which bias :math:`c` of it does
    that is beyond its sigma; on level ground a gyro turned by :math:`|c|/g` against it closes alike.

    .. math:: f_2-Rf_1=(I-R)c,\qquad f_2-Rf_1=-s\,(e_if_{2i}-R\,e_if_{1i})

    Specific force is compared with its size: of that the gyro says nothing. All is in sigma of the gyro's noise.
    """
    weights = [1.0 / np.sqrt(m.variance(noise) * (m.after @ m.after)) for m in found]
    each = list(zip(found, turned, weights, strict=True))
    off = np.concatenate([(m.after - R @ m.before) * weight for m, R, weight in each])
    causes: list[tuple[str, Array]] = [
        (axis, np.concatenate([(R[:, i] * m.before[i] - np.eye(3)[i] * m.after[i]) * weight
                               for m, R, weight in each])[:, None])
        for i, axis in enumerate("xyz")
    ]  # fmt: skip
    causes.append(("", np.concatenate([(np.eye(3) - R) * weight for _, R, weight in each])))
    for axis, columns in causes:
        x, _, unknowns, _ = np.linalg.lstsq(columns, off, rcond=SEEN)
        left = off - columns @ x
        if not _closes(left, off, int(unknowns)):
            continue
        drift = np.concatenate([motion.drifted() * weight for motion, _, weight in each])
        by_gyro = off - drift @ np.linalg.lstsq(drift, off, rcond=SEEN)[0]  # of a bias that only motion shows
        if np.linalg.norm(by_gyro) < LESS * np.linalg.norm(left):
            continue
        if axis and OTHER_UNIT[0] < 1.0 + x[0] < OTHER_UNIT[1]:
            message = f"the accelerometer's {axis} axis closes from stop to stop with {1.0 + x[0]:.2g} times its value"
            hint = "is it in another unit than the others? mend it in the driver, or with --columns"
            return [Warn("accel-scale", message, hint, fatal=True)]
        if not axis and _tilts(x, found, bias_sigma):
            said, size = ", ".join(f"{value:.2f}" for value in x), float(np.linalg.norm(x))
            turned_deg = np.degrees(size / np.linalg.norm(found[0].before))
            message = f"accelerometer and gyro close from stop to stop with an accelerometer bias of {said} m/s^2"
            message += f" (or a gyro turned {turned_deg:.1f} deg against it, or one whose bias changes in motion)"
            return [Warn("accel-bias", message, ACCEL_HINT, fatal=size > GROSS_BIAS)]
    return []


def _closes(left: Array, off: Array, unknowns: int) -> bool:
    """Whether so many ``unknowns`` explain motions that were ``off``, in sigma: what is gained is no noise, what is
    ``left`` is; or, where noise is not what it is said to be, hardly anything is left.
    """
    remains, before = float(left @ left), float(off @ off)
    angles = len(off) // 3 * 2  # the size of specific force has none
    if remains < CLOSES**2 * before:
        return _wholly(remains / before, angles, unknowns) or before > upper_quantile(angles, CHANCE)
    noise = upper_quantile(max(angles - unknowns, 1), USUAL)
    return remains < noise and before - remains > upper_quantile(max(unknowns, 1), CHANCE)


def _wholly(share: float, angles: int, unknowns: int) -> bool:
    r"""Whether so many ``unknowns`` leave so small a ``share`` of the squares of ``angles`` as noise of no size does.

    Of noise :math:`u` unknowns leave a share of :math:`a` angles that has the beta distribution
    :math:`B(\frac{a-u}2,\frac u2)`: below a small :math:`r` by a chance of :math:`r^{(a-u)/2}/(\frac{a-u}2B)`.
    """
    p, q = 0.5 * (angles - unknowns), 0.5 * unknowns
    if p <= 0.0 or q <= 0.0:
        return p > 0.0
    log_beta = math.lgamma(p) + math.lgamma(q) - math.lgamma(p + q)
    return p * math.log(max(share, 1e-300)) - math.log(p) - log_beta < math.log(EXPLAINED)


def _sizes(found: Sequence[Motion], drive: Drive) -> list[Warn]:
    """Say where the size of gravity changes from stop to stop, more than bias and noise of the accelerometer allow: no
    gyro does that.
    """
    imu, density, worst = drive.settings.imu, drive.noise.accel_density, 0.0
    for motion in found:
        sizes = [float(np.linalg.norm(force)) for force in (motion.before, motion.after)]
        leant = float(np.linalg.norm(motion.after / sizes[1] - motion.before / sizes[0]))
        sigma = np.hypot(imu.accel_bias_sigma * leant, density + imu.accel_random_walk * motion.span**0.5)
        change = abs(sizes[1] - sizes[0])
        worst = max(worst, change if change > max(SURE * sigma, LEAST_CHANGE) else 0.0)
    if worst == 0.0:
        return []
    message = f"gravity changes by {worst:.2g} m/s^2 from stop to stop, which is the accelerometer's fault"
    return [Warn("accel-bias", message, ACCEL_HINT, fatal=True)]


def _tilts(bias: Array, found: Sequence[Motion], sigma: float) -> bool:
    """Whether a bias is one that tilts, beyond its sigma, and small enough to be one."""
    up = np.sum([motion.before for motion in found], axis=0)
    plumb = float(bias @ up / np.linalg.norm(up))
    level = float(np.sqrt(max(float(bias @ bias) - plumb**2, 0.0)))
    return max(SURE * sigma, LEVEL * abs(plumb)) < level < LARGEST_BIAS


def _disputed(log: Log, segmentation: Segmentation, noise: Noise) -> list[Warn]:
    """Say where the gyro, with the bias of the stops, misses gravity in a rest that contradicts that bias."""
    calm = list(_calm(log, segmentation))
    worst = 0.0
    for motion in motions(log, segmentation, calm) if calm else []:
        off = float(np.sqrt(motion.misfit(motion.back(np.eye(3)))))
        worst = max(worst, off if off > max(OPEN_RAD[0], SURE * np.sqrt(motion.variance(noise))) else 0.0)
    if worst == 0.0:
        return []
    message = f"gyro and accelerometer contradict each other by {np.degrees(worst):.2g} deg at a rest"
    hint = "the gyro's bias has jumped, or an axis of it is dead: sigma does not hold"
    return [Warn("gyro-bias", f"{message} whose gyro contradicts that of the stops", hint, fatal=True)]


def _calm(log: Log, segmentation: Segmentation) -> Iterator[tuple[int, int]]:
    """Yield the samples ``[lo, hi)`` of the last rest in each motion, as quiet about its mean as the stops."""
    t, imu = log.imu.t, log.imu

    def shaken(lo: int, hi: int) -> Array:
        return np.array([np.mean(np.var(values[lo:hi], axis=0)) for values in (imu.gyro_b, imu.accel_b)])

    stops = [shaken(lo, hi) for lo, hi in stop_ranges(log, segmentation) if hi - lo >= 10]
    limit = SHAKES**2 * np.median(stops, axis=0) if stops else np.zeros(2)
    for s in segmentation.motions:
        edges = np.searchsorted(t, np.arange(s.start, s.end, CALM_S))
        quiet = [(a, b) for a, b in pairwise(edges.tolist()) if b - a >= 10 and (shaken(a, b) < limit).all()]
        yield from quiet[-1:]


def _whole(q: Array) -> Array:
    """Return the product (1, 4) of unit quaternions (n, 4), by halves: only the whole is asked for."""
    while len(q) > 1:
        even = len(q) // 2 * 2
        q = np.concatenate([rotation.multiply(q[:even:2], q[1:even:2]), q[even:]])
    return rotation.normalise(q)


def _opening(found: Sequence[Motion], turned: Sequence[Array]) -> float:
    """Return the RMS angle, rad, by which rotations ``turned`` miss gravity."""
    return float(np.sqrt(np.mean([motion.misfit(R) for motion, R in zip(found, turned, strict=True)])))
