"""How the IMU sits in the vehicle, from the drive itself: smoothed attitude, specific force and wheel speed must
agree.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .maths import rotation
from .maths.consistency import MAD
from .records import Array, Bools, Fixes, Imu, Ints, Segmentation

BLOCK_S = 1.0  # velocities are compared as means over this: wheel noise in the regressor would shorten the fit
MOST_LAG_S, COARSE_LAG_S = 1.0, 0.2  # odometry stamps against IMU stamps
CERTAIN_DEG = 5.0  # forward axis: sigma below which it is believed
LEAST_BLOCKS = 20
ENOUGH_S = 900.0  # of motion
UNSEEN_SLOPE = np.radians(3.0)  # slope of the ground where fewer than three stops show it
LEAST_SLOPE = np.radians(0.2)
SMOOTH_BLOCKS = 5  # blocks on either side whose mean is taken away
SIGNIFICANT = 100.0  # drop of the weighted misfit that a lag must bring: ten sigma, for blocks are not independent
LEAST_PERIODS = 1.5  # of the odometry: a lag of one sample is not told from how it is made
NEAR_DEG = 3.0  # axes that agree to this, or to three sigma, are taken as equal
UPRIGHT_DEG = 30.0  # gravity this near to the IMU's z axis: its x axis is taken as forward
MOST_PARTS, REFITS, FAR_OFF = 16, 3, 5.0  # of a drive, to find slips; times the median misfit: a block of a slip
UNLIKE, UNLIKE_SIGMAS = 0.5, 6.0  # the same where no axis is sure; blocks are not independent
WRONG_SCALE = 0.25  # wheel speed this far from what the accelerometer shows contradicts it


@dataclass(frozen=True, slots=True)
class Mounting:
    """How the IMU sits, seen by the drive.

    ``q_bv`` (4,) vehicle (FLU) to IMU axes; ``sigma`` (3,) of that attitude about vehicle axes, rad (roll from the
    slope of the ground at the stops); ``scale`` and ``scale_sigma`` of the specific force against the wheel speed (1
    when both are right); ``lag`` s that odometry stamps are late; ``how`` it was found.
    """

    q_bv: Array
    sigma: Array
    scale: float
    scale_sigma: float
    lag: float
    how: str

    @property
    def certain(self) -> bool:
        """Whether the forward axis is known well enough to be used."""
        return bool(np.degrees(self.sigma[2]) <= CERTAIN_DEG)

    @property
    def contradicted(self) -> bool:
        """Whether the wheel speed is wrong in size or sign by more than its calibration can be."""
        return abs(self.scale - 1.0) > max(WRONG_SCALE, 4.0 * self.scale_sigma)

    @property
    def unlike(self) -> bool:
        """Whether wheels and accelerometer surely do not speed up together, along whatever axis."""
        return 1.0 - self.scale > max(UNLIKE, UNLIKE_SIGMAS * self.scale_sigma)


def find_mounting(imu: Imu, q: Array, segmentation: Segmentation, odometry: Fixes, gravity: float) -> Mounting | None:
    r"""Find the vehicle's axes in the IMU's, or None where the drive does not show them at all.

    With the forward axis :math:`u_b` and wheel speed :math:`s`, between the means over neighbouring blocks of a motion

    .. math:: \left(\overline{R_{nb}s}_{k+1}-\overline{R_{nb}s}_k\right)u_b=\bar v_{k+1}-\bar v_k,\qquad
        v=\int(R_{nb}f-g)\,dt,

    linear in :math:`u_b`: least squares, at the lag of the odometry's stamps with the smallest misfit. Up is the mean
    gravity of the stops, made orthogonal to forward.

    Parameters
    ----------
    q : (n, 4) smoothed attitude of the IMU at its samples
    gravity : m/s^2
    """
    at = np.flatnonzero((odometry.t > imu.t[0] + 1.0) & (odometry.t < _enough(segmentation, imu.t[-1] - 1.0)))
    t, near = odometry.t[at], np.clip(np.searchsorted(imu.t, odometry.t[at]), 0, len(imu.t) - 1)
    block, owner = _blocks(t, segmentation)
    if not segmentation.stops or len(owner) < LEAST_BLOCKS:
        return None
    until = int(near[-1]) + 1
    a_n = rotation.rotate(q[:until], imu.accel_b[:until]) - np.array([0.0, 0.0, gravity])
    steps = 0.5 * (a_n[1:] + a_n[:-1]) * np.diff(imu.t[:until])[:, None]
    speed_n = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])[near]
    wanted = _high_pass(_change(_means(speed_n, block), owner), owner)
    R, noise = rotation.matrix(q[near]), _noise(t, odometry.values[at, 0], block)

    def regressor(lag: float) -> Array:
        s = np.interp(t, odometry.t - lag, odometry.values[:, 0])
        return _high_pass(_change(_means(R * s[:, None, None], block), owner), owner)

    def fit(lag: float, rows: Bools) -> tuple[Array, float, Array]:
        return _fit(regressor(lag)[rows], wanted[rows], noise)

    # whole periods only: between samples interpolation quietens the wheels, which would look like a better lag
    period = float(np.median(np.diff(odometry.t)))
    sound = rows = _sound(regressor(0.0), wanted, noise)
    for _ in range(2):  # what late wheels make of hard turns and starts looks like a slip until they are in time
        lag = _best_lag(fit, rows, period)
        rows = rows | _sound(regressor(lag), wanted, noise)
    begun, best = fit(0.0, rows), fit(lag, rows)
    told = LEAST_PERIODS * period < abs(lag) < MOST_LAG_S - COARSE_LAG_S
    if told and (begun[1] - best[1]) / (best[1] / (3 * np.count_nonzero(rows))) > SIGNIFICANT:
        u, _, covariance = best
    else:
        (u, _, covariance), lag = fit(0.0, sound), 0.0
    return _seat(imu, segmentation, u, covariance, round(lag, 2))


def _best_lag(fit: Callable[[float, Bools], tuple[Array, float, Array]], rows: Bools, period: float) -> float:
    """Return the lag, s, a multiple of ``period``, that leaves the smallest misfit of ``rows``: coarse, then fine."""
    reach, coarse = int(MOST_LAG_S / period), max(1, round(COARSE_LAG_S / period))
    near = min(range(-reach, reach + 1, coarse), key=lambda k: fit(k * period, rows)[1])
    return period * min(range(near - coarse + 1, near + coarse), key=lambda k: fit(k * period, rows)[1])


def _seat(imu: Imu, segmentation: Segmentation, u: Array, covariance: Array, lag: float) -> Mounting | None:
    """Complete the forward axis with gravity at the stops."""
    size = float(np.linalg.norm(u))
    if not np.isfinite(size) or size < 1e-3:
        return None
    ups = np.array([imu.accel_b[s.first : s.last].mean(axis=0) for s in segmentation.stops])
    ups /= np.linalg.norm(ups, axis=1, keepdims=True)
    up = ups.mean(axis=0)
    forward = u / size
    left = np.cross(up, forward)
    if np.linalg.norm(left) < 0.5:
        return None
    left /= np.linalg.norm(left)
    R_bv = np.column_stack([forward, left, np.cross(forward, left)])
    axis = np.sqrt(np.diag(R_bv.T @ covariance @ R_bv)) / size  # of the forward axis, along vehicle axes
    slope = float(np.std(ups @ left)) / np.sqrt(len(ups)) if len(ups) > 2 else UNSEEN_SLOPE
    sigma = np.array([max(slope, LEAST_SLOPE), axis[2], axis[1]])
    roll, yaw = np.degrees(sigma[0]), np.degrees(sigma[2])
    stops = "1 stop" if len(ups) == 1 else f"{len(ups)} stops"
    how = f"gravity at {stops} and wheel speed: roll to {roll:.1f}°, forward to {yaw:.1f}°"
    return Mounting(rotation.from_matrix(R_bv), sigma, size, float(np.sqrt(forward @ covariance @ forward)), lag, how)


def _enough(segmentation: Segmentation, end: float) -> float:
    """Return the time by which the log has moved long enough to tell, at most ``end``."""
    moved = np.cumsum([s.end - s.start for s in segmentation.motions])
    long = np.flatnonzero(moved > ENOUGH_S)
    if not len(long):
        return end
    last = segmentation.motions[int(long[0])]
    return min(end, last.end, last.start + ENOUGH_S)


def _blocks(t: Array, segmentation: Segmentation) -> tuple[Ints, Ints]:
    """Return the block of each odometry stamp (-1: none) and the motion of each block; blocks fill whole seconds of
    motions.
    """
    block = np.full(len(t), -1, dtype=np.int64)
    owner: list[int] = []
    for s in segmentation.motions:
        count = int((s.end - s.start) / BLOCK_S)
        for rows in (
            slice(*np.searchsorted(t, [s.start + k * BLOCK_S, s.start + (k + 1) * BLOCK_S])) for k in range(count)
        ):
            if rows.stop - rows.start >= 2:
                block[rows] = len(owner)
                owner.append(s.index)
    return block, np.array(owner, dtype=np.int64)


def _means(values: Array, block: Ints) -> Array:
    """Return the means (blocks, ...) of samples by block."""
    kept = block >= 0
    first = np.flatnonzero(np.diff(block[kept], prepend=-1))
    count = np.diff(np.append(first, kept.sum())).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(np.add.reduceat(values[kept], first, axis=0) / count)


def _change(means: Array, owner: Ints) -> Array:
    """Return the change from each block to the next of the same motion; zero after the last."""
    out = np.zeros_like(means)
    same = np.flatnonzero(owner[1:] == owner[:-1])
    out[same] = means[same + 1] - means[same]
    return out


def _high_pass(values: Array, owner: Ints) -> Array:
    """Take away the mean of the blocks around (k, ...), motion by motion: what a slowly wrong tilt makes of gravity."""
    out = np.empty_like(values)
    for index in np.unique(owner):
        mine = np.flatnonzero(owner == index)
        total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values[mine], axis=0)])
        k = np.arange(len(mine))
        lo, hi = np.maximum(k - SMOOTH_BLOCKS, 0), np.minimum(k + SMOOTH_BLOCKS + 1, len(mine))
        count = (hi - lo).reshape(-1, *[1] * (values.ndim - 1))
        out[mine] = values[mine] - (total[hi] - total[lo]) / count
    return out


def _noise(t: Array, speed: Array, block: Ints) -> float:
    """Return the variance that the noise of the wheels adds to a change between block means, m^2/s^2.

    White noise of a sample from its second differences (their variance is six times it), robustly.
    """
    use = (block[:-2] >= 0) & (block[:-2] == block[2:])
    if not use.any():
        return 0.0
    second = np.abs(speed[2:] - 2.0 * speed[1:-1] + speed[:-2])[use]
    per_block = BLOCK_S / float(np.median(np.diff(t)))
    return 2.0 * (MAD * float(np.median(second))) ** 2 / 6.0 / max(per_block, 1.0)


def _sound(regressor: Array, wanted: Array, noise: float) -> Bools:
    """Return which blocks (k,) are not those of slipping wheels, as far as most of the drive agrees.

    A slip has far more weight in a least-squares fit than the drive itself, whose speed hardly changes. So every part
    of the drive is asked for the axis, and the one believed that leaves the smallest median of misfits over all of it
    (Rousseeuw 1984); what lies far off it is left out.
    """

    def misfits(rows: slice | Bools) -> Array:
        u = _fit(regressor[rows], wanted[rows], noise)[0]
        return np.asarray(np.linalg.norm(regressor @ u - wanted, axis=1))

    n = len(wanted)
    parts = max(1, min(MOST_PARTS, n // LEAST_BLOCKS))
    edges = np.linspace(0, n, parts + 1).astype(np.int64)
    found = (misfits(slice(lo, hi)) for lo, hi in itertools.pairwise(edges))
    misfit = min(found, key=lambda off: float(np.median(off)))
    for _ in range(REFITS):
        misfit = misfits(misfit <= FAR_OFF * np.median(misfit))
    return np.asarray(misfit <= FAR_OFF * np.median(misfit))


def _fit(regressor: Array, wanted: Array, noise: float) -> tuple[Array, float, Array]:
    """Return forward axis (3,), misfit and covariance (3, 3) of the least squares; ``noise`` of the wheels in the
    regressor, which would shorten the axis, is taken out of the normal equations.
    """
    A, wanted = regressor.reshape(-1, 3), wanted.reshape(-1)
    normal = A.T @ A
    normal -= min(noise * len(regressor), 0.5 * float(np.trace(normal)) / 3.0) * np.eye(3)
    if not np.isfinite(normal).all() or np.linalg.cond(normal) > 1e12:
        return np.zeros(3), np.inf, np.full((3, 3), np.inf)
    u = np.asarray(np.linalg.solve(normal, A.T @ wanted), dtype=np.float64)
    misfit = float(np.sum((A @ u - wanted) ** 2))
    return u, misfit, np.linalg.inv(normal) * misfit / max(len(wanted) - 3, 1)


def axes_agree(seat: Mounting) -> bool:
    """Return whether vehicle and IMU axes may be the same: within 3 deg, or three sigma of what the drive shows."""
    turn = np.abs(rotation.log_quaternion(seat.q_bv))
    return bool(np.all(turn < np.maximum(np.radians(NEAR_DEG), 3.0 * seat.sigma)))


def up_at_stops(segmentation: Segmentation, imu: Imu) -> Array:
    """Return the unit mean of the specific force at the stops (3,): where up is in the IMU's axes."""
    up = np.mean([imu.accel_b[s.first : s.last].mean(axis=0) for s in segmentation.stops], axis=0)
    return np.asarray(up / np.linalg.norm(up))


def upright(segmentation: Segmentation, imu: Imu) -> bool:
    """Return whether gravity at the stops lies along the IMU's z axis: then its x axis is taken as forward."""
    return bool(segmentation.stops) and bool(up_at_stops(segmentation, imu)[2] > np.cos(np.radians(UPRIGHT_DEG)))
