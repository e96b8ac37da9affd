r"""Motion between nodes: the trajectory, and the log linearised about it.

.. math:: d_{k+1}=\Phi_kd_k+u_k+w_k,\qquad u_k=f(\bar x_k)\ominus\bar x_{k+1}

with errors :math:`[\delta\theta_b,\delta v_n,\delta p_n,\delta b_g,\delta b_a,\ldots]` about a trajectory
:math:`\bar x`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...maths import rotation, strapdown
from ...maths.propagation import Steps
from ...nodes import Nodes
from ...records import Array, Bools, Imu, Ints
from . import colours
from .states import Layout

FROZEN = 1e-14  # rad^2/s: keeps the covariance of a held attitude regular
BLIND_M_S2 = 3.0  # how hard a vehicle may accelerate in a hole of the IMU


@dataclass(frozen=True, slots=True)
class Trajectory:
    """States at the nodes: ``q`` (n, 4), ``x`` (n, s) all others at their places (the first three are unused: zero)."""

    q: Array
    x: Array

    def moved(self, d: Array) -> Trajectory:
        """Return the trajectory with the errors ``d`` (n, s) taken in."""
        q = rotation.normalise(rotation.multiply(self.q, rotation.exp_quaternion(d[:, :3])))
        x = self.x + d
        x[:, :3] = 0.0
        return Trajectory(q, x)

    @property
    def v(self) -> Array:
        """Velocity (n, 3), navigation axes, m/s."""
        return self.x[:, 3:6]

    @property
    def p(self) -> Array:
        """Position (n, 3), navigation axes, m."""
        return self.x[:, 6:9]


@dataclass(frozen=True, slots=True)
class Inertial:
    """The IMU between nodes: ``steps`` (rates, not held at stops), ``force0``, ``force1`` (s, 3) on the same grid,
    ``frozen`` and ``gap`` (n - 1,), spectral densities ``gyro`` and ``accel`` (n - 1,), walks, gravity; the ``slope``
    by which an error of heading moves velocity, of the force: less than 1 where noise is much of the force.
    """

    steps: Steps
    force0: Array
    force1: Array
    frozen: Bools
    gap: Bools
    gyro: Array
    accel: Array
    gyro_walk: float
    accel_walk: float
    gravity: float
    slope: float = 1.0


@dataclass(frozen=True, slots=True)
class Linear:
    """The motion linearised: ``Phi``, ``Q`` (n - 1, s, s), ``u`` (n - 1, s); the preintegrated ``motion``."""

    Phi: Array
    Q: Array
    u: Array
    motion: strapdown.Motion


def linearise(inertial: Inertial, layout: Layout, at: Trajectory, *, smoothed: bool = True) -> Linear:
    r"""Preintegrate with the trajectory's own sensor errors and linearise about it.

    What is left of the motion, :math:`u_k`, is taken in the axes of the body, so its slope to the attitude is that of
    the motion which the trajectory makes, :math:`R_k^T(v_{k+1}-v_k-gT)` for the force, and no noise of the IMU feigns
    a turn that shows scale or heading. A trajectory that is not ``smoothed`` yet makes none: force and rate then are
    those of the IMU.
    """
    corrected, force0, force1 = _corrected(inertial, layout, at)
    measured = strapdown.preintegrate(corrected, force0, force1)
    held = inertial.frozen | inertial.gap
    measured.q_bg[held], measured.v_bg[held], measured.p_bg[held] = 0.0, 0.0, 0.0
    m, s = len(measured.span), layout.size
    R, wander = rotation.matrix(at.q[:-1]), colours.indices(layout)
    Phi, Q = np.tile(np.eye(s), (m, 1, 1)), np.zeros((m, s, s))
    Phi[:, wander[:, None], wander] = fading = colours.fading(layout, measured.span)
    u = _defect(inertial, at, measured, wander, fading)
    motion = _made(measured, at, R, u if smoothed else np.zeros_like(u))
    Phi[:, :15, :15] = strapdown.transition(R, motion)
    _levelled(Phi, R[:, 2], inertial.slope)
    if "gyro scale" in layout:  # acts as a bias of scale times the mean rate
        for row, slope in ((0, motion.q_bg), (3, R @ motion.v_bg), (6, R @ motion.p_bg)):
            product = np.einsum("kij,kl->kijl", slope, motion.rate).reshape(m, 3, 9)
            Phi[:, row : row + 3, layout.parts["gyro scale"]] = product
    if "accelerometer scale" in layout:
        for row, slope in ((3, R @ motion.v_ba), (6, R @ motion.p_ba)):
            Phi[:, row : row + 3, layout.parts["accelerometer scale"]] = slope * motion.force[:, None, :]
    Q[:, :15, :15] = _core_noise(inertial, R, measured)
    Q[:, wander[:, None], wander] = colours.driving(layout, measured.span)
    found = Linear(Phi, Q, u, measured)
    _open_gaps(inertial, measured, at, found)
    return found


def renoised(lin: Linear, inertial: Inertial, layout: Layout, at: Trajectory) -> Linear:
    """Return the same motion with the noise of another ``inertial`` and ``layout``, and its correlation times."""
    Phi, Q, u = lin.Phi.copy(), lin.Q.copy(), lin.u.copy()
    open_ = ~inertial.gap
    Q[open_, :15, :15] = _core_noise(inertial, rotation.matrix(at.q[:-1]), lin.motion)[open_]
    wander = colours.indices(layout)
    among = (slice(None), wander[:, None], wander)
    Phi[among], Q[among] = colours.fading(layout, lin.motion.span), colours.driving(layout, lin.motion.span)
    u[:, wander] += np.einsum("kij,kj->ki", Phi[among] - lin.Phi[among], at.x[:-1, wander])
    return replace(lin, Phi=Phi, Q=Q, u=u)


def inertial_noise(inertial: Inertial, at: Trajectory, motion: strapdown.Motion) -> Array:
    """Return the noise (n - 1, 15, 15) of the IMU alone, none where it is not heard."""
    return _core_noise(inertial, rotation.matrix(at.q[:-1]), motion) * ~inertial.gap[:, None, None]


def _core_noise(inertial: Inertial, R: Array, motion: strapdown.Motion) -> Array:
    gyro = np.where(inertial.frozen | inertial.gap, FROZEN, inertial.gyro)
    return strapdown.noise(R, motion, gyro, inertial.accel, inertial.gyro_walk, inertial.accel_walk)


def _corrected(inertial: Inertial, layout: Layout, at: Trajectory) -> tuple[Steps, Array, Array]:
    """Return rates and forces with the trajectory's sensor errors removed; held intervals do not turn."""
    steps = inertial.steps
    owner = np.repeat(np.arange(len(inertial.frozen)), steps.count)
    middle = 0.5 * (at.x[1:] + at.x[:-1])
    bg, ba = middle[:, layout.parts["gyro bias"]][owner], middle[:, layout.parts["accelerometer bias"]][owner]
    rate0, rate1 = steps.rate0 - bg, steps.rate1 - bg
    force0, force1 = inertial.force0 - ba, inertial.force1 - ba
    if "gyro scale" in layout:
        M = middle[:, layout.parts["gyro scale"]].mean(axis=0).reshape(3, 3)
        rate0, rate1 = rate0 - steps.rate0 @ M.T, rate1 - steps.rate1 @ M.T
    if "accelerometer scale" in layout:
        k = middle[:, layout.parts["accelerometer scale"]].mean(axis=0)
        force0, force1 = force0 - inertial.force0 * k, force1 - inertial.force1 * k
    held = (inertial.frozen | inertial.gap)[owner]
    rate0[held], rate1[held] = 0.0, 0.0
    return replace(steps, rate0=rate0, rate1=rate1), force0, force1


def _defect(inertial: Inertial, at: Trajectory, motion: strapdown.Motion, wander: Ints, fading: Array) -> Array:
    """Return what the trajectory lacks to be the motion (n - 1, s)."""
    down, T = np.array([0.0, 0.0, -inertial.gravity]), motion.span[:, None]
    ahead = at.x[:-1].copy()
    ahead[:, 3:6] = at.v[:-1] + down * T + rotation.rotate(at.q[:-1], motion.dv)
    ahead[:, 6:9] = at.p[:-1] + at.v[:-1] * T + 0.5 * down * T**2 + rotation.rotate(at.q[:-1], motion.dp)
    ahead[:, wander] = np.einsum("kij,kj->ki", fading, at.x[:-1, wander])
    u = ahead - at.x[1:]
    turned = rotation.multiply(at.q[:-1], motion.dq)
    u[:, :3] = rotation.log_quaternion(rotation.multiply(rotation.conjugate(at.q[1:]), turned))
    return u


def _made(motion: strapdown.Motion, at: Trajectory, R: Array, u: Array) -> strapdown.Motion:
    """Return the motion that a trajectory makes: without what it lacks, ``u``."""
    T, dq = motion.span[:, None], rotation.multiply(rotation.conjugate(at.q[:-1]), at.q[1:])
    dv, dp = (np.einsum("kji,kj->ki", R, u[:, i : i + 3]) for i in (3, 6))
    back = rotation.matrix(rotation.exp_quaternion(u[:, :3]))
    return replace(
        motion, dq=dq, q_bg=back @ motion.q_bg, dv=motion.dv - dv, dp=motion.dp - dp,
        rate=motion.rate - u[:, :3] / T, force=motion.force - dv / T,
    )  # fmt: skip


def _levelled(Phi: Array, up: Array, slope: float) -> None:
    """Let an error of heading move velocity and position by ``slope`` only; ``up`` (n - 1, 3), body axes."""
    if slope < 1.0:
        moved = np.einsum("kij,kj->ki", Phi[:, 3:9, :3], up)
        Phi[:, 3:9, :3] -= (1.0 - slope) * moved[:, :, None] * up[:, None, :]


def _open_gaps(inertial: Inertial, motion: strapdown.Motion, at: Trajectory, lin: Linear) -> None:
    """Let attitude, velocity and position go over the holes of the IMU: there is no force, not even gravity."""
    gap = np.flatnonzero(inertial.gap)
    T, eye = motion.span[gap], np.eye(3)
    lin.Phi[gap, :9, :], lin.Q[gap, :9, :], lin.Q[gap, :, :9] = 0.0, 0.0, 0.0
    lin.Phi[gap, :9, :9] = np.eye(9)
    lin.Phi[gap, 6:9, 3:6] = T[:, None, None] * eye
    for part, sigma in ((0, np.minimum(T, np.pi)), (3, BLIND_M_S2 * T), (6, 0.5 * BLIND_M_S2 * T**2)):
        lin.Q[gap, part : part + 3, part : part + 3] = (sigma**2 + 1e-8)[:, None, None] * eye
    turn = rotation.multiply(rotation.conjugate(at.q[gap + 1]), at.q[gap])
    lin.u[gap, :3] = rotation.log_quaternion(turn)
    lin.u[gap, 3:6] = at.v[gap] - at.v[gap + 1]
    lin.u[gap, 6:9] = at.p[gap] + at.v[gap] * T[:, None] - at.p[gap + 1]


def inertial_of(
    nodes: Nodes, imu: Imu, densities: tuple[Array, Array], walks: tuple[float, float], gravity: float
) -> Inertial:
    """Return the IMU on the grid of its samples and the nodes; forces are linear between samples."""
    grid = np.unique(np.concatenate([imu.t, nodes.t]))
    force = np.stack([np.interp(grid, imu.t, imu.accel_b[:, i]) for i in range(3)], axis=1)
    return Inertial(
        nodes.steps,
        force[:-1],
        force[1:],
        nodes.frozen,
        nodes.gap,
        densities[0],
        densities[1],
        walks[0],
        walks[1],
        gravity,
    )
