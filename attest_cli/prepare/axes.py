"""Whether gyro and accelerometer speak of the same axes: the gyro must turn gravity as the accelerometer sees it turn.

Gravity shows turns about level axes only: of a gyro's turns about the vertical it tells as much as the drive leans.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..maths.axes import axes_in_words, in_words, signed_permutations
from ..maths.rotation import cross
from ..records import Array, Fixes, Imu, Warn
from .units import AGREEMENT, Turns, turns

SURE, CLEARLY = (6.0, 2.5), (0.8, 0.5)  # sigma of the difference, and share of the misfit, of either of which pairs
SCALES, FAR_SCALES = (0.5, 2.0), (0.15, 4.0)  # of a gyro with other axes; beyond it is another unit, or another clock
SCALED = 0.6  # share of the turning of gravity that another scale must explain
WINDOWS_S = (0.5, 0.15)  # for what drives, and for what is waved about
MOST, LONGEST_S = 4000, 1800.0  # turns of a log; of it that a field is compared over
FEW = 12  # turns that show nothing
ACCEL, FIELD = "gyro-against-accel", "gyro-against-field"  # codes of warnings
NEAR = 1e-6  # of what is seen: misfits nearer to the least are worked out turn by turn
HINT = "[imu] mounting cannot mend one of the two: put signs and order right in the driver, or with --columns"


@dataclass(frozen=True, slots=True)
class Fit:
    """How well turned axes explain the turning of gravity: ``axes`` (3, 3) signed permutation of the gyro's, ``scale``
    on it, ``misfit`` (k,) square per turn.
    """

    axes: Array
    scale: float
    misfit: Array


def doubts(name: str, t: Array, gyro: Array, accel: Array) -> list[Warn]:
    r"""Say where gyro (rad/s) and accelerometer (m/s^2), both (n, 3) at ``t`` (n,) s, have not the same axes.

    Of the 48 signed permutations :math:`P` of the gyro's axes, the one with the least misfit of

    .. math:: \Delta u_k=-s\,(P\theta_k)\times u_k+\Delta t_k\,c\times u_k

    with scale :math:`s` and bias :math:`c`, is believed where its misfit is smaller by six sigma of the difference and
    by a fifth, or by half. Where the axes agree, so must the scale, to a factor of four. Nothing is said where no axes
    explain what the accelerometer sees, as in a log whose accelerations hide gravity.
    """
    compared = _compared(t, gyro, accel)
    if compared is None:
        return []
    same, best, total = compared
    if best is not same:
        message = f"{name}: gyro and accelerometer do not turn together: {in_words(best.axes)}"
        return [Warn(ACCEL, message, HINT, fatal=True)]
    return _far_scaled(f"{name}: gravity", same, total)


def _far_scaled(what: str, same: Fit, total: float) -> list[Warn]:
    """Say where a vector turns as the gyro does, but far more or less."""
    explained = 1.0 - float(same.misfit.sum()) / total
    if explained < SCALED or FAR_SCALES[0] < same.scale < FAR_SCALES[1]:
        return []
    message = f"{what} turns {same.scale:.2g} times as far as the gyro says"
    hint = "check the unit of the gyro, and the unit and rate of the clock"
    return [Warn("gyro-scale", message, hint, fatal=True)]


def foremost(told: Sequence[Warn]) -> tuple[Warn, ...]:
    """Return what is told without what another fault of axes explains: of two readings of gyro against accelerometer
    the last, which a whole motion shows; the field's, where that blames the gyro; and noise of the gyro that comes of
    it, of its scale, or of a sun or an orientation that contradicts gravity; and such a sun, where gravity is at fault.
    """
    if {"accel-bias", "accel-scale", "mounting-contradicted"} & {warn.code for warn in told}:
        told = [warn for warn in told if warn.code != "sun-reference"]
    causes = [warn for warn in told if warn.code in {"sun-reference", "orientation-order", "gyro-scale"}]
    if causes:
        sure = any(warn.fatal for warn in causes)
        told = [warn for warn in told if warn.code != "gyro-noise-raised" or (warn.fatal and not sure)]
    mine = [warn for warn in told if warn.code == ACCEL and warn.fatal]
    if not mine:
        return tuple(told)
    explained = {FIELD, "gyro-noise-raised"} if "the gyro" in mine[-1].message else {"gyro-noise-raised"}
    return tuple(w for w in told if w is mine[-1] or (w.code not in explained and w not in mine))


def of_field(field: Fixes, imu: Imu, *, others: bool = False) -> list[Warn]:
    """Say where a magnetometer has not the axes of the gyro, or turns far more: the field must turn as gravity does in
    :func:`doubts`.

    ``others``: the log has other IMUs, to which it may belong.
    """
    rows = slice(*np.searchsorted(imu.t, [field.t[0], min(field.t[-1], field.t[0] + LONGEST_S)]).tolist())
    t = imu.t[rows]
    if len(field.t) < 2 or not len(t):
        return []
    vector = np.stack([np.interp(t, field.t, column) for column in field.values.T], axis=1)
    compared = _compared(t, imu.gyro_b[rows], vector)
    if compared is None:
        return []
    if compared[1] is compared[0]:
        return _far_scaled(f"{field.channel}: the magnetic field", compared[0], compared[2])
    names = axes_in_words(compared[1].axes.T)
    message = f"{field.channel}: magnetometer and gyro do not turn together: they would, were its x, y, z its {names}"
    hint = "or all three the other way round: put them right in the driver, or with --columns"
    if others:
        hint = "is it fixed to the other IMU? --map takes that: imu=..., or gyro=... and accel=..."
    return [Warn(FIELD, message, hint, fatal=True)]


def _compared(t: Array, gyro: Array, vector: Array) -> tuple[Fit, Fit, float] | None:
    """Return the fit of the axes as they are, that which is to be believed, and the square of what is seen; None where
    no axes explain how the vector turns.
    """
    found = [_fits(_some(turns(t, gyro, vector, window_s)[0])) for window_s in WINDOWS_S]
    fits, total = min(found, key=lambda pair: _left(pair[0], pair[1]))
    if _left(fits, total) > 1.0 - AGREEMENT:
        return None
    same, best = fits[0], min(fits, key=lambda fit: float(fit.misfit.sum()))
    less = same.misfit - best.misfit
    sigmas = less.sum() / max(float(np.std(less)) * np.sqrt(len(less)), 1e-12)
    share = best.misfit.sum() / same.misfit.sum()
    sure = any(sigmas > s and share < c for s, c in zip(SURE, CLEARLY, strict=True))
    return same, best if sure else same, total


def _some(seen: Turns) -> Turns:
    """Return turns from all over a long log, as many as are needed."""
    every = slice(None, None, -(-len(seen.step) // MOST) or 1)
    return Turns(seen.step[every], seen.angle[every], seen.up[every], seen.seen[every])


def _fits(seen: Turns) -> tuple[list[Fit], float]:
    r"""Return the fit of the axes as they are, that of the best others with a likely scale, and the square of what is
    seen; none where too little turns.

    All permutations share the products of nine columns :math:`\theta_j\,u\times e_i` and three of the bias.
    """
    if len(seen.step) < FEW:
        return [], 0.0
    every, unit, rows = np.array(signed_permutations()), np.eye(3)[:, None], len(seen.step)
    columns = np.concatenate([
        (cross(seen.up, unit)[:, None] * seen.angle.T[None, :, :, None]).reshape(9, rows, 3),
        cross(unit, seen.up) * seen.step[:, None],
    ]).reshape(12, -1)  # fmt: skip
    wanted = seen.seen.reshape(-1)
    gram, seen_by, total = columns @ columns.T, columns @ wanted, float(wanted @ wanted)
    mixed = np.zeros((len(every), 4, 12))  # scale and bias of each permutation on the columns
    mixed[:, 0, :9], mixed[:, 1:, 9:] = every.reshape(-1, 9), np.eye(3)
    x = _solved(mixed @ gram @ mixed.transpose(0, 2, 1), mixed @ seen_by)
    weights = np.einsum("pij,pi->pj", mixed, x)
    left = total - 2.0 * weights @ seen_by + np.einsum("pi,ij,pj->p", weights, gram, weights)
    likely = (x[:, 0] > SCALES[0]) & (x[:, 0] < SCALES[1])
    best = np.flatnonzero(likely & (left <= left[likely].min(initial=np.inf) + NEAR * total))
    same = np.flatnonzero((every == np.eye(3)).all(axis=(1, 2)))
    return [
        Fit(every[k], float(x[k, 0]), np.sum((wanted - weights[k] @ columns).reshape(-1, 3) ** 2, axis=1))
        for k in [*same.tolist(), *best.tolist()]
    ], total


def _left(fits: list[Fit], total: float) -> float:
    """Return the share of the turning of gravity that the best axes leave unexplained."""
    return min((float(fit.misfit.sum()) for fit in fits), default=np.inf) / total if total > 0.0 else np.inf


def _solved(normal: Array, wanted: Array) -> Array:
    """Return scale and bias (p, 4) of each permutation by least squares."""
    normal = normal + 1e-12 * np.eye(4)
    x = np.linalg.solve(normal, wanted[..., None])[..., 0]
    still = np.linalg.solve(normal[:, 1:, 1:], wanted[:, 1:, None])[..., 0]
    back = x[:, 0] < 0.0  # a gyro does not turn backwards: other axes may
    x[back] = np.concatenate([np.zeros((len(x), 1)), still], axis=1)[back]
    return np.asarray(x)
