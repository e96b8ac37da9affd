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
from ...records import Array, Bools, Imu
from . import colours
from .states import Layout

FAR_RAD = 0.01  # defects beyond this turn the linearisation
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
    ``frozen`` and ``gap`` (n - 1,), spectral densities ``gyro`` and ``accel`` (n - 1,), walks, gravity.
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


@dataclass(frozen=True, slots=True)
class Linear:
    """The motion linearised: ``Phi``, ``Q`` (n - 1, s, s), ``u`` (n - 1, s); the preintegrated ``motion``."""

    Phi: Array
    Q: Array
    u: Array
    motion: strapdown.Motion


def linearise(inertial: Inertial, layout: Layout, at: Trajectory) -> Linear:
    """Preintegrate with the trajectory's own sensor errors and linearise about it."""
    corrected, force0, force1 = _corrected(inertial, layout, at)
    motion = strapdown.preintegrate(corrected, force0, force1)
    held = inertial.frozen | inertial.gap
    motion.q_bg[held], motion.v_bg[held], motion.p_bg[held] = 0.0, 0.0, 0.0
    m, s = len(motion.span), layout.size
    R = rotation.matrix(at.q[:-1])
    Phi, Q = np.tile(np.eye(s), (m, 1, 1)), np.zeros((m, s, s))
    Phi[:, :15, :15] = strapdown.transition(R, motion)
    Q[:, :15, :15] = _core_noise(inertial, R, motion)
    if "gyro scale" in layout:  # acts as a bias of scale times the mean rate
        for row, slope in ((0, motion.q_bg), (3, R @ motion.v_bg), (6, R @ motion.p_bg)):
            product = np.einsum("kij,kl->kijl", slope, motion.rate).reshape(m, 3, 9)
            Phi[:, row : row + 3, layout.parts["gyro scale"]] = product
    if "accelerometer scale" in layout:
        for row, slope in ((3, R @ motion.v_ba), (6, R @ motion.p_ba)):
            Phi[:, row : row + 3, layout.parts["accelerometer scale"]] = slope * motion.force[:, None, :]
    wander = colours.indices(layout)
    Phi[:, wander[:, None], wander] = colours.fading(layout, motion.span)
    Q[:, wander[:, None], wander] = colours.driving(layout, motion.span)
    u = _defect(inertial, layout, at, motion, Phi)
    found = Linear(Phi, Q, u, motion)
    _open_gaps(inertial, motion, at, found)
    return found


def renoised(lin: Linear, inertial: Inertial, layout: Layout, at: Trajectory) -> Linear:
    """Return the same motion with the noise of another ``inertial`` and ``layout``."""
    Q = lin.Q.copy()
    open_ = ~inertial.gap
    Q[open_, :15, :15] = _core_noise(inertial, rotation.matrix(at.q[:-1]), lin.motion)[open_]
    wander = colours.indices(layout)
    Q[:, wander[:, None], wander] = colours.driving(layout, lin.motion.span)
    return replace(lin, Q=Q)


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


def _defect(inertial: Inertial, layout: Layout, at: Trajectory, motion: strapdown.Motion, Phi: Array) -> Array:
    """Return what the trajectory lacks to be the motion (n - 1, s); turn ``Phi`` where the attitude lacks much."""
    down, T = np.array([0.0, 0.0, -inertial.gravity]), motion.span[:, None]
    ahead = at.x[:-1].copy()
    ahead[:, 3:6] = at.v[:-1] + down * T + rotation.rotate(at.q[:-1], motion.dv)
    ahead[:, 6:9] = at.p[:-1] + at.v[:-1] * T + 0.5 * down * T**2 + rotation.rotate(at.q[:-1], motion.dp)
    wander = colours.indices(layout)
    ahead[:, wander] = np.einsum("kij,kj->ki", Phi[:, wander[:, None], wander], at.x[:-1, wander])
    u = ahead - at.x[1:]
    turned = rotation.multiply(at.q[:-1], motion.dq)
    u[:, :3] = rotation.log_quaternion(rotation.multiply(rotation.conjugate(at.q[1:]), turned))
    far = np.flatnonzero(np.linalg.norm(u[:, :3], axis=1) > FAR_RAD)
    Phi[far, :3] = rotation.inverse_right_jacobian(u[far, :3]) @ Phi[far, :3]
    return u


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
