"""Whether gyro and accelerometer speak of the same axes: the gyro must turn gravity as the accelerometer sees it turn.

Gravity shows turns about level axes only: of a gyro's turns about the vertical it tells as much as the drive leans.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..maths.axes import in_words, signed_permutations
from ..records import Array, Warn
from .units import AGREEMENT, Turns, turns

SURE, CLEARLY = (6.0, 2.5), (0.8, 0.5)  # sigma of the difference, and share of the misfit, of either of which pairs
SCALES, FAR_SCALES = (0.5, 2.0), (0.15, 4.0)  # of a gyro with other axes; beyond it is another unit, or another clock
SCALED = 0.6  # share of the turning of gravity that another scale must explain
WINDOWS_S = (0.5, 0.15)  # for what drives, and for what is waved about
MOST = 4000  # turns of a log
FEW = 12  # turns that show nothing
HINT = "[imu] mounting cannot mend one of the two: put signs and order right in the driver, or with --columns"


@dataclass(frozen=True, slots=True)
class Fit:
    """How well turned axes explain the turning of gravity: ``axes`` (3, 3) signed permutation of the gyro's, ``scale``
    on it with ``sigma``, ``misfit`` (k,) square per turn.
    """

    axes: Array
    scale: float
    sigma: float
    misfit: Array


def doubts(name: str, t: Array, gyro: Array, accel: Array) -> list[Warn]:
    r"""Say where gyro (rad/s) and accelerometer (m/s^2), both (n, 3) at ``t`` (n,) s, have not the same axes.

    Of the 48 signed permutations :math:`P` of the gyro's axes, the one with the least misfit of

    .. math:: \Delta u_k=-s\,(P\theta_k)\times u_k+\Delta t_k\,c\times u_k

    with scale :math:`s` and bias :math:`c`, is believed where its misfit is smaller by six sigma of the difference and
    by a fifth, or by half. Where the axes agree, so must the scale, to a factor of four. Nothing is said where no axes
    explain what the accelerometer sees, as in a log whose accelerations hide gravity.
    """
    found = [_fits(_some(turns(t, gyro, accel, window_s))) for window_s in WINDOWS_S]
    fits, total = min(found, key=lambda pair: _left(pair[0], pair[1]))
    if _left(fits, total) > 1.0 - AGREEMENT:
        return []
    same, best = fits[0], min(fits, key=lambda fit: float(fit.misfit.sum()))
    less = same.misfit - best.misfit
    sigmas = less.sum() / max(float(np.std(less)) * np.sqrt(len(less)), 1e-12)
    share = best.misfit.sum() / same.misfit.sum()
    if best is not same and any(sigmas > s and share < c for s, c in zip(SURE, CLEARLY, strict=True)):
        message = f"{name}: gyro and accelerometer do not turn together: {in_words(best.axes)}"
        return [Warn("gyro-against-accel", message, HINT, fatal=True)]
    explained = 1.0 - float(same.misfit.sum()) / total
    if best is same and explained > SCALED and not FAR_SCALES[0] < same.scale < FAR_SCALES[1]:
        message = f"{name}: gravity turns {same.scale:.2g} times as far as the gyro says"
        hint = "check the unit of the gyro, and the unit and rate of the clock"
        return [Warn("gyro-scale", message, hint, fatal=True)]
    return []


def _some(seen: Turns) -> Turns:
    """Return turns from all over a long log, as many as are needed."""
    every = slice(None, None, -(-len(seen.step) // MOST) or 1)
    return Turns(seen.step[every], seen.angle[every], seen.up[every], seen.seen[every])


def _fits(seen: Turns) -> tuple[list[Fit], float]:
    """Return the fit of the axes as they are, those of all others with a likely scale, and the square of what is seen;
    none where too little turns.
    """
    if len(seen.step) < FEW:
        return [], 0.0
    others = [fit for axes in signed_permutations() if SCALES[0] < (fit := _fit(seen, axes)).scale < SCALES[1]]
    return [_fit(seen, np.eye(3)), *others], float(np.sum(seen.seen**2))


def _left(fits: list[Fit], total: float) -> float:
    """Return the share of the turning of gravity that the best axes leave unexplained."""
    return min((float(fit.misfit.sum()) for fit in fits), default=np.inf) / total if total > 0.0 else np.inf


def _fit(seen: Turns, axes: Array) -> Fit:
    """Fit scale and bias of one permutation by least squares."""
    turned = -np.cross(seen.angle @ axes.T, seen.up)
    slow = seen.step[:, None, None] * np.cross(np.eye(3)[None], seen.up[:, None])  # (k, bias, axis)
    A = np.concatenate([turned[:, None], slow], axis=1).transpose(0, 2, 1).reshape(-1, 4)
    wanted = seen.seen.reshape(-1)
    normal = A.T @ A + 1e-12 * np.eye(4)
    x = np.linalg.solve(normal, A.T @ wanted)
    if x[0] < 0.0:  # a gyro does not turn backwards: other axes may
        x = np.append(0.0, np.linalg.solve(normal[1:, 1:], A[:, 1:].T @ wanted))
    misfit = np.sum((wanted - A @ x).reshape(-1, 3) ** 2, axis=1)
    variance = float(misfit.sum()) / max(2 * len(misfit) - 4, 1) * np.linalg.inv(normal)[0, 0]
    return Fit(axes, float(x[0]), float(np.sqrt(variance)), misfit)
