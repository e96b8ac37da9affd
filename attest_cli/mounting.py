"""How the IMU sits in the vehicle, from the drive itself: smoothed attitude, specific force and wheel speed must
agree.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .maths import rotation
from .records import Array, Fixes, Imu, Ints, Segmentation

WINDOW_S = 1.0  # speed is compared over windows of this length
LAGS_S = np.round(np.arange(-1.0, 1.001, 0.05), 3)  # odometry stamps against IMU stamps
CERTAIN_DEG = 5.0  # forward axis: sigma below which it is believed
LEAST_WINDOWS = 20
SMOOTH_WINDOWS = 5  # windows on either side whose mean is taken away
SIGNIFICANT = 100.0  # drop of the weighted misfit that a lag must bring: ten sigma, for windows are not independent
NEAR_DEG = 10.0  # axes that agree to this are taken as equal


@dataclass(frozen=True, slots=True)
class Mounting:
    """``q_bv`` (4,) vehicle (FLU) to IMU axes, sigma of the forward axis, ``lag`` s that odometry stamps are late,
    and how it was found.
    """

    q_bv: Array
    sigma_deg: float
    lag: float
    how: str


def forward_speed(odometry: Fixes) -> Array:
    """Return the forward speed (m,), m/s."""
    return np.asarray(odometry.values[:, 0])


def find_mounting(imu: Imu, q: Array, segmentation: Segmentation, odometry: Fixes, gravity: float) -> Mounting | None:
    r"""Find the vehicle's axes in the IMU's, or None where the drive does not show them.

    With the forward axis :math:`u_b` and wheel speed :math:`s`, over every window in motion

    .. math:: \left(R_{nb}(t_1)s_1-R_{nb}(t_0)s_0\right)u_b=\int_{t_0}^{t_1}(R_{nb}f-g)\,dt,

    linear in :math:`u_b`: least squares, at the lag of the odometry's stamps with the smallest misfit. Up is the mean
    gravity of the stops, made orthogonal to forward.

    Parameters
    ----------
    q : (n, 4) smoothed attitude of the IMU at its samples
    gravity : m/s^2
    """
    if not segmentation.stops:
        return None
    up = np.sum([imu.accel_b[s.first : s.last].mean(axis=0) for s in segmentation.stops], axis=0)
    up /= np.linalg.norm(up)
    edges, owner = _windows(imu, segmentation)
    if len(edges) < LEAST_WINDOWS:
        return None
    R = rotation.matrix(q)
    a_n = np.einsum("kij,kj->ki", R, imu.accel_b) - np.array([0.0, 0.0, gravity])
    dt = np.diff(imu.t)
    gained = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (a_n[1:] + a_n[:-1]) * dt[:, None], axis=0)])
    wanted = _high_pass(gained[edges[:, 1]] - gained[edges[:, 0]], owner).reshape(-1)
    fits = [_fit(R, imu.t, edges, owner, odometry, wanted, float(lag)) for lag in LAGS_S]
    zero = fits[len(LAGS_S) // 2]
    best = min(range(len(fits)), key=lambda i: fits[i][1])
    lag = float(LAGS_S[best])
    if (zero[1] - fits[best][1]) / (fits[best][1] / len(wanted)) < SIGNIFICANT or abs(lag) == LAGS_S[-1]:
        best, lag = len(LAGS_S) // 2, 0.0
    u, _, sigma = fits[best]
    size = float(np.linalg.norm(u))
    if not 0.5 < size < 2.0 or np.degrees(sigma / size) > CERTAIN_DEG:
        return None
    forward = u / size
    left = np.cross(up, forward)
    if np.linalg.norm(left) < 0.5:
        return None
    left /= np.linalg.norm(left)
    R_bv = np.column_stack([forward, left, np.cross(forward, left)])
    return Mounting(
        rotation.from_matrix(R_bv), float(np.degrees(sigma / size)), lag, "gravity at stops and wheel speed"
    )


def _windows(imu: Imu, segmentation: Segmentation) -> tuple[Ints, Ints]:
    """Return first and last sample (k, 2) of the windows that lie within one motion, and the motion's index (k,)."""
    rows, owner = [], []
    for s in segmentation.motions:
        cuts = np.searchsorted(imu.t, np.arange(s.start, s.end, WINDOW_S))
        pairs = [(a, b) for a, b in pairwise(cuts.tolist()) if b > a and b < len(imu.t)]
        rows += pairs
        owner += [s.index] * len(pairs)
    return np.array(rows, dtype=np.int64).reshape(-1, 2), np.array(owner, dtype=np.int64)


def _high_pass(values: Array, owner: Ints) -> Array:
    """Take away the mean of the windows around (k, ...), motion by motion: what a slowly wrong tilt makes of
    gravity.
    """
    out = np.empty_like(values)
    for index in np.unique(owner):
        mine = np.flatnonzero(owner == index)
        total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values[mine], axis=0)])
        k = np.arange(len(mine))
        lo, hi = np.maximum(k - SMOOTH_WINDOWS, 0), np.minimum(k + SMOOTH_WINDOWS + 1, len(mine))
        count = (hi - lo).reshape(-1, *[1] * (values.ndim - 1))
        out[mine] = values[mine] - (total[hi] - total[lo]) / count
    return out


def _fit(
    R: Array, t: Array, edges: Ints, owner: Ints, odometry: Fixes, wanted: Array, lag: float
) -> tuple[Array, float, float]:
    """Return forward axis (3,), misfit and the largest sigma of the axis, for one lag."""
    first, last = edges.T
    speed = np.interp(t, odometry.t - lag, forward_speed(odometry))
    gain = R[last] * speed[last, None, None] - R[first] * speed[first, None, None]
    A = _high_pass(gain, owner).reshape(-1, 3)
    normal = A.T @ A
    if np.linalg.cond(normal) > 1e12:
        return np.zeros(3), np.inf, np.inf
    u = np.asarray(np.linalg.solve(normal, A.T @ wanted), dtype=np.float64)
    misfit = float(np.sum((A @ u - wanted) ** 2))
    covariance = np.linalg.inv(normal) * misfit / max(len(wanted) - 3, 1)
    return u, misfit, float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))


def axes_agree(q_bv: Array) -> bool:
    """Return whether vehicle and IMU axes are the same within 10 deg."""
    return bool(np.degrees(np.linalg.norm(rotation.log_quaternion(q_bv))) < NEAR_DEG)
