"""What aids the inertial navigation: rows ``r = H d + v`` at the nodes, linearised about a trajectory."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ...maths import rotation
from ...records import Array, Bools, Ints
from ...sensors import Measurement
from .model import Trajectory
from .states import Layout

CALM_S = 2.0
LEAST_SIGMA = 1e-3  # m, m/s: what is found of fixes and wheels; less is all coloured, and covariances turn singular
STUDENT = 4.0  # degrees of freedom of the weights: outliers do not bend the track
UNSEEN = 1.16  # mean variance of Student's t over that of the factors found of it, of six errors (Monte Carlo)


@dataclass(frozen=True, slots=True)
class Rows:
    """Measurements of one sensor: at ``node`` (k,), at ``t`` (k,): residual ``r`` (k, d), Jacobian ``H`` (k, d, s),
    ``sigma`` (k, d), wider by ``shared`` (k,) than each lies off, where neighbours share their error.
    """

    node: Ints
    t: Array
    r: Array
    H: Array
    sigma: Array
    shared: Array | None = None

    @property
    def weight(self) -> Array:
        """Weights (k,) by Student's t: how far a row lies off is judged by the error that it has, not by what is added
        because its neighbours have the same.
        """
        return student(self.r, self.sigma if self.shared is None else self.sigma / self.shared[:, None])

    def within(self, first: int, last: int) -> Rows:
        """Return those at nodes ``[first, last)``, whose numbers then begin at zero."""
        cut = self.where((self.node >= first) & (self.node < last))
        return replace(cut, node=cut.node - first)

    def where(self, use: Bools) -> Rows:
        """Return some of them."""
        shared = None if self.shared is None else self.shared[use]
        return Rows(self.node[use], self.t[use], self.r[use], self.H[use], self.sigma[use], shared)


class Aid(Protocol):
    """One sensor."""

    @property
    def role(self) -> str:
        """Name among the innovations."""
        ...

    @property
    def robust(self) -> bool:
        """Whether its rows are weighted by Student's t."""
        ...

    def rows(self, layout: Layout, at: Trajectory) -> Rows:
        """Return its rows about a trajectory."""
        ...


def student(r: Array, sigma: Array) -> Array:
    r"""Return the weights (k,) :math:`(\nu+d)/(\nu+|r/\sigma|^2)`, at most 1: a far residual counts less."""
    return np.asarray(np.minimum(1.0, (STUDENT + r.shape[1]) / (STUDENT + np.sum((r / sigma) ** 2, axis=1))))


def blank(layout: Layout, k: int, d: int) -> Array:
    """Return an empty Jacobian (k, d, s)."""
    return np.zeros((k, d, layout.size))


@dataclass(frozen=True, slots=True)
class Bound:
    """A state vector that stays about zero: velocity at a stop; weak bounds on the speed and place of a motion."""

    role: str
    part: str
    node: Ints
    t: Array
    sigma: Array  # (k,)
    robust: bool = False

    def rows(self, layout: Layout, at: Trajectory) -> Rows:
        """Return ``0 - x``."""
        part = layout.parts[self.part]
        H = blank(layout, len(self.node), part.stop - part.start)
        H[:, :, part] = np.eye(part.stop - part.start)
        return Rows(self.node, self.t, -at.x[self.node, part], H, np.repeat(self.sigma[:, None], H.shape[1], axis=1))


@dataclass(frozen=True, slots=True)
class ZeroRate:
    r"""Mean rates (k, 3) of a gyro that stands still: :math:`\bar\omega=b+v`."""

    node: Ints
    t: Array
    rate: Array
    sigma: Array
    role: str = "zero_rate"
    robust: bool = False

    def rows(self, layout: Layout, at: Trajectory) -> Rows:
        """Return what the bias does not explain."""
        part = layout.parts["gyro bias"]
        H = blank(layout, len(self.node), 3)
        H[:, :, part] = np.eye(3)
        return Rows(self.node, self.t, self.rate - at.x[self.node, part], H, np.repeat(self.sigma[:, None], 3, axis=1))


@dataclass(frozen=True, slots=True)
class Seen:
    """Measurements of attitude as the indirect filter takes them: sun, compass, orientation; one role each. Where its
    offset is a state, a sensor sees the attitude turned about the vertical by that.
    """

    role: str
    measurements: tuple[Measurement, ...]
    robust: bool = True

    def rows(self, layout: Layout, at: Trajectory) -> Rows:
        """Return the residuals of each, whitened."""
        node = np.array([m.node for m in self.measurements], dtype=np.int64)
        R = rotation.matrix(at.q[node])
        up, offset = R[:, 2], layout.parts.get(f"{self.role} offset")
        if offset is not None:
            R = rotation.matrix(rotation.exp_quaternion(at.x[node][:, offset] * [0.0, 0.0, 1.0])) @ R
        d = self.measurements[0].sensor.dof
        r, H = np.zeros((len(node), d)), blank(layout, len(node), d)
        for k, m in enumerate(self.measurements):
            residual, slope = m.linearise(R[k], at.x[node[k], 9:12])
            white = np.linalg.inv(np.linalg.cholesky(m.noise))
            r[k], H[k, :, :3], H[k, :, 9:12] = white @ residual, white @ slope[:, :3], white @ slope[:, 3:]
            if offset is not None:
                H[k, :, offset.start] = H[k, :, :3] @ up[k]
        return Rows(node, np.array([m.t for m in self.measurements]), r, H, np.ones_like(r))


@dataclass(frozen=True, slots=True)
class Magnetometer:
    r"""The field in navigation axes, of which only the turn about the vertical is taken as attitude.

    .. math:: R(m-h)=F+o\,[\text{moving}]+v

    ``field_b`` (k, 3) means at the nodes; earth field ``F`` (horizontal, vertical) towards ``azimuth``, or clockwise
    off it by an offset that is a state: the heading reads as much counter-clockwise; hard iron ``h``; the motion offset
    ``o`` leaves the datum of heading to the stops. ``sigma`` (k,), of which neighbours share their error by the factor
    ``shared`` (k,). Tesla.
    """

    node: Ints
    t: Array
    field_b: Array
    moving: Bools
    azimuth: float
    sigma: Array
    shared: Array
    role: str = "magnetometer"
    robust: bool = True

    def rows(self, layout: Layout, at: Trajectory) -> Rows:
        """Return the residuals in navigation axes."""
        R, x = rotation.matrix(at.q[self.node]), at.x[self.node]
        h, F, o = (layout.parts[name] for name in ("hard iron", "earth field", "motion offset"))
        offset, azimuth = layout.parts.get("magnetometer offset"), np.full(len(x), self.azimuth)
        if offset is not None:
            azimuth -= x[:, offset.start]
        basis = np.zeros((len(x), 3, 2))
        basis[:, 0, 0], basis[:, 1, 0], basis[:, 2, 1] = np.cos(azimuth), np.sin(azimuth), 1.0
        field_n = np.einsum("kij,kj->ki", R, self.field_b - x[:, h])
        earth_n = np.einsum("kij,kj->ki", basis, x[:, F])
        r = field_n - earth_n - np.where(self.moving[:, None], x[:, o], 0.0)
        H = blank(layout, len(self.node), 3)
        across = np.stack([field_n[:, 1], -field_n[:, 0], np.zeros(len(r))], axis=1)
        H[:, :, :3] = across[:, :, None] * R[:, 2][:, None, :]
        H[:, :, h], H[:, :, F] = R, basis
        H[:, :, o] = self.moving[:, None, None] * np.eye(3)
        if offset is not None:
            H[:, 0, offset.start], H[:, 1, offset.start] = earth_n[:, 1], -earth_n[:, 0]
        return Rows(self.node, self.t, r, H, np.repeat(self.sigma[:, None], 3, axis=1), self.shared)


def drifts(role: str) -> tuple[tuple[str, slice], ...]:
    """Return the groups of the coloured error of fixes and their axes: level and up, where no satellite is below."""
    return (f"{role} drift", slice(0, 2)), (f"{role} drift up", slice(2, 3))


@dataclass(frozen=True, slots=True)
class Place:
    r"""Positions (k, 3) in navigation axes: :math:`z=p+Rl+c-v\,\tau+v`, NaN = not measured.

    ``l`` lever arm of the antenna, ``c`` its coloured error, :math:`\tau` how late its stamps are; each where it is a
    state. From the fixes numbered ``leaps`` on they are off by a constant more.
    """

    node: Ints
    t: Array
    place_n: Array
    sigma: Array  # (k, 3)
    lever_b: Array
    role: str = "gps"
    robust: bool = True
    leaps: tuple[int, ...] = ()

    def rows(self, layout: Layout, at: Trajectory) -> Rows:
        """Return measured minus predicted place."""
        R, x = rotation.matrix(at.q[self.node]), at.x[self.node]
        H = blank(layout, len(self.node), 3)
        arm = np.tile(self.lever_b, (len(R), 1))
        predicted = at.p[self.node].copy()
        H[:, :, 6:9] = np.eye(3)
        if f"{self.role} lever arm" in layout:
            part = layout.parts[f"{self.role} lever arm"]
            arm = arm + x[:, part]
            H[:, :, part] = R
        predicted += np.einsum("kij,kj->ki", R, arm)
        H[:, :, :3] = -R @ rotation.skew(arm)
        for name, axes in drifts(self.role):
            if name in layout:
                part = layout.parts[name]
                predicted[:, axes] += x[:, part]
                H[:, axes, part] = np.eye(part.stop - part.start)
        for k, first in enumerate(self.leaps):
            begin = layout.parts[f"{self.role} jump"].start + 3 * k
            predicted[first:] += x[first:, begin : begin + 3]
            H[first:, :, begin : begin + 3] = np.eye(3)
        if f"{self.role} lag" in layout:
            part, v = layout.parts[f"{self.role} lag"], at.v[self.node]
            predicted -= v * x[:, part]
            H[:, :, part], H[:, :, 3:6] = -v[:, :, None], -x[:, part, None] * np.eye(3)
        return _known(Rows(self.node, self.t, self.place_n - predicted, H, self.sigma))

    def scaled(self, factor: float) -> Place:
        """Return the aid with its sigma times ``factor``."""
        return replace(self, sigma=scaled_sigma(self.sigma, factor))


@dataclass(frozen=True, slots=True)
class Velocity:
    r"""Velocities (k, 3) of an antenna, navigation axes: :math:`z=v+R(\omega\times l)-a\,\tau+v`, NaN = not measured.

    Lever arm and how late it is are those of the fixes from the same receiver, where there are any; the acceleration
    is the mean between the nodes ``around`` (k, 2), ``span`` (k,) s apart: vibration is shorter than any lag.
    """

    node: Ints
    t: Array
    velocity_n: Array
    sigma: Array  # (k, 3)
    rate_b: Array  # (k, 3) rad/s
    lever_b: Array
    around: Ints
    span: Array
    clock: str  # whose lag counts
    role: str = "gps_velocity"
    robust: bool = True

    def rows(self, layout: Layout, at: Trajectory) -> Rows:
        """Return measured minus predicted velocity."""
        R, x = rotation.matrix(at.q[self.node]), at.x[self.node]
        H = blank(layout, len(self.node), 3)
        arm = np.tile(self.lever_b, (len(R), 1))
        if "gps lever arm" in layout:
            part = layout.parts["gps lever arm"]
            arm = arm + x[:, part]
            H[:, :, part] = R @ rotation.skew(self.rate_b)
        swing = np.cross(self.rate_b, arm)
        predicted = at.v[self.node] + np.einsum("kij,kj->ki", R, swing)
        H[:, :, :3], H[:, :, 3:6] = -R @ rotation.skew(swing), np.eye(3)
        if f"{self.clock} lag" in layout:
            part = layout.parts[f"{self.clock} lag"]
            a = (at.v[self.around[:, 1]] - at.v[self.around[:, 0]]) / self.span[:, None]
            predicted -= a * x[:, part]
            H[:, :, part] = -a[:, :, None]
        return _known(Rows(self.node, self.t, self.velocity_n - predicted, H, self.sigma))


@dataclass(frozen=True, slots=True)
class Height:
    r"""Heights (k, 1) of a barometer or an altimeter: :math:`z=p_z+h_0+c+v`, datum :math:`h_0`, slow error ``c``."""

    node: Ints
    t: Array
    height: Array
    sigma: Array  # (k, 1)
    role: str = "height"
    robust: bool = True

    def rows(self, layout: Layout, at: Trajectory) -> Rows:
        """Return measured minus predicted height."""
        states = [layout.parts[name].stop - 1 for name in ("position", "height datum", "height drift")]
        H = blank(layout, len(self.node), 1)
        H[:, 0, states] = 1.0
        r = self.height - at.x[self.node][:, states].sum(axis=1, keepdims=True)
        return Rows(self.node, self.t, r, H, self.sigma)


@dataclass(frozen=True, slots=True)
class Wheels:
    r"""Velocity in vehicle axes (k, 3) from wheels; sideways and up it is the non-holonomic constraint.

    .. math:: z=v_v+\bar v_x(s,\,-\mu_z,\,\mu_y)^T+\text{slip},\quad v_v=C_{vb}(R^Tv+\omega\times l)

    Scale ``s`` and the mounting's pitch and yaw ``mu`` act on the calm forward speed, its mean over two seconds: the
    IMU feels the body bounce, the wheels do not, and a scale fitted to that would be too small. A vehicle that goes
    forward does not show the mounting's roll.
    """

    node: Ints
    t: Array
    velocity_v: Array
    sigma: Array  # (k, 3)
    R_vb: Array
    seat_sigma: Array  # (2,) rad, how well pitch and yaw of R_vb are known
    rate_b: Array  # (k, 3) rad/s
    lever_b: Array  # (3,) m, from the IMU to where the wheels' velocity is that of the vehicle
    role: str = "odometry"
    robust: bool = True

    def rows(self, layout: Layout, at: Trajectory) -> Rows:
        """Return measured minus predicted velocity."""
        R, x = rotation.matrix(at.q[self.node]), at.x[self.node]
        v_b, arm = np.einsum("kji,kj->ki", R, at.v[self.node]), np.tile(self.lever_b, (len(R), 1))
        if "odometry lever arm" in layout:
            arm = arm + x[:, layout.parts["odometry lever arm"]]
        v_v = (v_b + np.cross(self.rate_b, arm)) @ self.R_vb.T
        calm = _calm(v_v[:, 0], self.t)
        scale, seat, slip = (layout.parts[f"odometry {name}"] for name in ("scale", "mounting", "slip"))
        bent = np.stack([x[:, scale.start], -x[:, seat.start + 1], x[:, seat.start]], axis=1)
        predicted = v_v + calm[:, None] * bent + x[:, slip]
        H = blank(layout, len(R), 3)
        to_v = self.R_vb + bent[:, :, None] * self.R_vb[0]  # an error of attitude or velocity is calm: seen twice
        H[:, :, :3], H[:, :, 3:6] = to_v @ rotation.skew(v_b), to_v @ R.swapaxes(1, 2)
        H[:, 0, scale.start] = H[:, 2, seat.start] = calm
        H[:, 1, seat.start + 1] = -calm
        H[:, :, slip] = np.eye(3)
        if "odometry lever arm" in layout:
            H[:, :, layout.parts["odometry lever arm"]] = to_v @ rotation.skew(self.rate_b)
        return _known(Rows(self.node, self.t, self.velocity_v - predicted, H, self.sigma))

    def scaled(self, factor: float) -> Wheels:
        """Return the aid with its sigma times ``factor``."""
        return replace(self, sigma=scaled_sigma(self.sigma, factor))


def scaled_sigma(sigma: Array, factor: float) -> Array:
    """Return ``sigma`` times ``factor``, not made smaller than any sensor's."""
    return np.maximum(np.minimum(sigma, LEAST_SIGMA), sigma * factor)


def _calm(v: Array, t: Array) -> Array:
    """Return the mean of ``v`` (k,) over ``CALM_S`` around each time."""
    total = np.concatenate([[0.0], np.cumsum(v)])
    lo = np.searchsorted(t, t - 0.5 * CALM_S, side="left")
    hi = np.searchsorted(t, t + 0.5 * CALM_S, side="right")
    return np.asarray((total[hi] - total[lo]) / (hi - lo))


def _known(rows: Rows) -> Rows:
    """Take out what was not measured (NaN): a row of zeros says nothing."""
    missing = ~np.isfinite(rows.r)
    rows.r[missing] = 0.0
    rows.H[missing] = 0.0
    return rows
