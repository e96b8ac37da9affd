r"""Preintegration of velocity and position between nodes (Forster et al. 2017, in closed sums over the samples).

Relative motion of an interval, in the body axes of its start: :math:`\Delta R,\ \Delta v=\int R f`,
:math:`\Delta p=\iint R f`, so that :math:`v'=v+gT+R\,\Delta v`, :math:`p'=p+vT+\tfrac12gT^2+R\,\Delta p`. No loop runs
over samples but the one that composes rotations: Jacobians follow from cumulative sums, since
:math:`R_t\Psi_t=\int_0^tR_s\,ds`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from . import rotation
from .propagation import Steps, run_steps

Array = NDArray[np.float64]
IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True, slots=True)
class Motion:
    """Preintegrated intervals (m of them): ``dq`` (m, 4), ``dv``, ``dp`` (m, 3) at the rates and forces they were made
    of; ``span`` (m,) s; derivatives to a gyro bias ``q_bg`` (attitude, about the end's body axes), ``v_bg``, ``p_bg``
    and to an accelerometer bias ``v_ba``, ``p_ba`` (m, 3, 3); mean ``rate`` and ``force`` (m, 3) in body axes.
    """

    dq: Array
    dv: Array
    dp: Array
    span: Array
    q_bg: Array
    v_bg: Array
    p_bg: Array
    v_ba: Array
    p_ba: Array
    rate: Array
    force: Array


def preintegrate(steps: Steps, force0: Array, force1: Array) -> Motion:
    r"""Preintegrate rates and specific forces that are linear within each step.

    .. math:: \Delta v=\sum\tfrac{dt}2(g_0+g_1),\quad \Delta p=\sum v_0dt+\tfrac{dt^2}6(2g_0+g_1),\quad g=R_tf,

    .. math:: \partial\Delta v/\partial b_g=\int[g\times]N\,dt,\quad \partial\Delta v/\partial b_a=-N_T,\quad
        N_t=\int_0^tR_s\,ds

    Parameters
    ----------
    steps : rates with the bias removed, rad/s, grouped by interval
    force0, force1 : (s, 3) specific force at the start and the end of each step, bias removed, m/s^2
    """
    m = len(steps.first) - 1
    owner, dt = np.repeat(np.arange(m), steps.count), steps.dt[:, None]
    starts = steps.first[:-1]
    q1 = run_steps(steps, np.tile(IDENTITY, (m, 1)), np.zeros((m, 3)))
    q0 = np.concatenate([q1[:1], q1[:-1]])
    q0[starts] = IDENTITY
    R0, R1 = rotation.matrix(q0), rotation.matrix(q1)
    g0, g1 = np.einsum("kij,kj->ki", R0, force0), np.einsum("kij,kj->ki", R1, force1)
    gain_v = 0.5 * dt * (g0 + g1)
    v0 = _before(gain_v, starts, owner)
    gain_p = dt * v0 + dt**2 / 6.0 * (2.0 * g0 + g1)
    gain_N = 0.5 * dt[:, :, None] * (R0 + R1)
    N0 = _before(gain_N, starts, owner)
    slope0, slope1 = _crossed(g0, N0), _crossed(g1, N0 + gain_N)
    gain_vb = 0.5 * dt[:, :, None] * (slope0 + slope1)
    gain_pb = dt[:, :, None] * _before(gain_vb, starts, owner) + dt[:, :, None] ** 2 / 6.0 * (2.0 * slope0 + slope1)
    gain_pa = dt[:, :, None] * N0 + dt[:, :, None] ** 2 / 6.0 * (2.0 * R0 + R1)

    def total(x: Array) -> Array:
        return np.add.reduceat(x, starts, axis=0)

    N, ends = total(gain_N), steps.first[1:] - 1
    span = total(steps.dt)
    R_end = R1[ends]
    return Motion(
        q1[ends], total(gain_v), total(gain_p), span, -R_end.swapaxes(1, 2) @ N, total(gain_vb), total(gain_pb), -N,
        -total(gain_pa), total(0.5 * dt * (steps.rate0 + steps.rate1)) / span[:, None],
        total(0.5 * dt * (force0 + force1)) / span[:, None],
    )  # fmt: skip


def _before(gain: Array, starts: NDArray[np.int64], owner: NDArray[np.int64]) -> Array:
    """Return the sum of the gains of the steps before each, within its interval."""
    summed = np.cumsum(gain, axis=0) - gain
    return np.asarray(summed - summed[starts][owner])


def _crossed(v: Array, M: Array) -> Array:
    """Return ``[v x] M`` (n, 3, 3)."""
    return np.cross(v[:, None, :], M.swapaxes(1, 2)).swapaxes(1, 2)


def transition(R: Array, motion: Motion) -> Array:
    r"""Return :math:`\Phi` (m, 15, 15) of the errors ``[dtheta_b, dv_n, dp_n, dbg, dba]`` over each interval.

    Parameters
    ----------
    R : (m, 3, 3) attitude, body to navigation, at the start of each interval
    """
    m, eye = len(R), np.eye(3)
    Phi = np.tile(np.eye(15), (m, 1, 1))
    Phi[:, 0:3, 0:3] = rotation.matrix(motion.dq).swapaxes(1, 2)
    Phi[:, 0:3, 9:12] = motion.q_bg
    Phi[:, 3:6, 0:3] = -R @ rotation.skew(motion.dv)
    Phi[:, 3:6, 9:12], Phi[:, 3:6, 12:15] = R @ motion.v_bg, R @ motion.v_ba
    Phi[:, 6:9, 0:3] = -R @ rotation.skew(motion.dp)
    Phi[:, 6:9, 3:6] = motion.span[:, None, None] * eye
    Phi[:, 6:9, 9:12], Phi[:, 6:9, 12:15] = R @ motion.p_bg, R @ motion.p_ba
    return Phi


def noise(R: Array, motion: Motion, gyro: Array, accel: Array, gyro_walk: float, accel_walk: float) -> Array:
    r"""Return ``Q`` (m, 15, 15) of white gyro and accelerometer noise and walking biases.

    With the force :math:`\bar g` constant over the interval, gyro noise reaches the velocity as
    :math:`-[\bar g\times](T-s)` and the position as :math:`-[\bar g\times](T-s)^2/2`; bias walks reach attitude and
    velocity to first order.

    Parameters
    ----------
    R : (m, 3, 3) attitude at the start of each interval
    gyro, accel : (m,) spectral densities, (rad/s)^2/Hz and (m/s^2)^2/Hz
    gyro_walk, accel_walk : densities of the bias walks, (rad/s^2)^2/Hz and (m/s^3)^2/Hz
    """
    T, eye = motion.span[:, None, None], np.eye(3)
    n_r, n_a = gyro[:, None, None], accel[:, None, None]
    turn = rotation.matrix(motion.dq).swapaxes(1, 2)
    G = -R @ rotation.skew(motion.dv / motion.span[:, None])  # the interval's start axes to the world's
    GG = G @ G.swapaxes(1, 2)
    Q = np.zeros((len(R), 15, 15))
    Q[:, 0:3, 0:3] = (n_r * T + gyro_walk * T**3 / 3.0) * eye
    Q[:, 3:6, 3:6] = (n_a * T + accel_walk * T**3 / 3.0) * eye + n_r * T**3 / 3.0 * GG
    Q[:, 6:9, 6:9] = n_a * T**3 / 3.0 * eye + n_r * T**5 / 20.0 * GG
    Q[:, 9:12, 9:12], Q[:, 12:15, 12:15] = gyro_walk * T * eye, accel_walk * T * eye
    R_end = R @ rotation.matrix(motion.dq)
    blocks = {
        (0, 3): n_r * T**2 / 2.0 * turn @ G.swapaxes(1, 2),
        (0, 6): n_r * T**3 / 6.0 * turn @ G.swapaxes(1, 2),
        (3, 6): n_a * T**2 / 2.0 * eye + n_r * T**4 / 8.0 * GG,
        (0, 9): -gyro_walk * T**2 / 2.0 * eye,
        (3, 12): -accel_walk * T**2 / 2.0 * R_end,
    }
    for (i, j), block in blocks.items():
        Q[:, i : i + 3, j : j + 3] = block
        Q[:, j : j + 3, i : i + 3] = block.swapaxes(1, 2)
    return Q
