"""The analytic drive: smooth stops and motions over rough terrain, with true vibration, exact at any instant."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from ..records import Array, Bools

Complex = NDArray[np.complex128]
GRAVITY_M_S2 = 9.80665
BLOCK = 8192  # instants at a time, so that the intermediate arrays stay in the cache
RAMP_S = 1.0  # every motion starts and ends with a ramp of this length


@dataclass(frozen=True, slots=True)
class Kinematics:
    """The true motion at ``t`` (n,): ``q_nb`` (n, 4) wxyz, rates and specific force in body axes.

    ``speed`` is that of the wheels: along body x, without the vibration.
    """

    t: Array
    q_nb: Array
    R_nb: Array
    rate_b: Array
    force_b: Array
    position_n: Array
    velocity_n: Array
    speed: Array
    moving: Bools


@dataclass(frozen=True, slots=True)
class Timeline:
    """Motions ``[start, end]`` (m, 2) in s, between the stops of a drive of ``duration`` s."""

    motions: Array
    duration: float

    @property
    def stops(self) -> Array:
        """Stops (m + 1, 2): true edges in s, the complement of the motions."""
        edges = np.concatenate([[0.0], self.motions.ravel(), [self.duration]])
        return edges.reshape(-1, 2)

    def progress(self, t: Array) -> tuple[Array, Array, Array, Array]:
        r"""Window of the motions at ``t``: integral, value and two derivatives; exactly 0 at rest.

        $w = S((t-a)/T) + S((e-t)/T) - 1$ with the smoothstep $S(x) = x^3(10 - 15x + 6x^2)$ and ramps of $T$ s.
        """
        start, end = self.motions.T
        before = np.concatenate([[0.0], np.cumsum(end - start - RAMP_S)])
        k = np.clip(np.searchsorted(start, t, side="right") - 1, 0, None)
        inside = np.clip(t, start[k], end[k])
        x = np.clip((inside - start[k]) / RAMP_S, 0.0, 1.0)
        y = np.clip((end[k] - inside) / RAMP_S, 0.0, 1.0)
        plateau = np.maximum(inside - start[k] - RAMP_S, 0.0)
        integral = before[k] + plateau + RAMP_S * (_step_integral(x) - ((1.0 - y) - (0.5 - _step_integral(y))))
        value = _step(x) + _step(y) - 1.0
        slope = (_step_slope(x) - _step_slope(y)) / RAMP_S
        bend = (_step_bend(x) + _step_bend(y)) / RAMP_S**2
        return integral, value, slope, bend

    def moving(self, t: Array) -> Bools:
        """True strictly inside a motion."""
        start, end = self.motions.T
        k = np.clip(np.searchsorted(start, t, side="right") - 1, 0, None)
        return np.asarray((t > start[k]) & (t < end[k]))


def _step(x: Array) -> Array:
    return np.asarray(x**3 * (10.0 + x * (6.0 * x - 15.0)))


def _step_integral(x: Array) -> Array:
    return np.asarray(x**4 * (2.5 + x * (x - 3.0)))


def _step_slope(x: Array) -> Array:
    return np.asarray(30.0 * x**2 * (1.0 - x) ** 2)


def _step_bend(x: Array) -> Array:
    return np.asarray(60.0 * x * (1.0 - x) * (1.0 - 2.0 * x))


@dataclass(frozen=True, slots=True)
class Waves:
    """A sum of sinusoids per column: ``amplitude``, ``pulsation``, ``phase`` (waves, columns)."""

    amplitude: Array
    pulsation: Array
    phase: Array

    def at(self, x: Array) -> tuple[Array, Array, Array]:
        """Value and two derivatives at ``x`` (n,), each (n, columns)."""
        value, slope, bend = (np.zeros((x.size, self.amplitude.shape[1])) for _ in range(3))
        for a, k, phase in zip(self.amplitude, self.pulsation, self.phase, strict=True):
            angle = x[:, None] * k + phase
            sine = a * np.sin(angle)
            value += sine
            slope += k * a * np.cos(angle)
            bend -= k**2 * sine
        return value, slope, bend


@dataclass(frozen=True, slots=True)
class Route:
    r"""The way over the terrain as a function of a length parameter $u$, with $p = x + iy$ in closed form:

    $p'(u) = e^{iau}\,(1 + \sum_j c_j e^{i(k_j u + \phi_j)})$, $\sum c_j < 1$, so that the heading never jumps.
    ``terrain`` columns: height (m) and roll (rad).
    """

    bend: float
    swing: Array
    pulsation: Array
    phase: Array
    terrain: Waves

    def plane(self, u: Array) -> tuple[Complex, Complex, Complex, Array]:
        """Position, its two derivatives by ``u``, and the heading (rad, continuous)."""
        weights = np.concatenate([[1.0 + 0j], self.swing * np.exp(1j * self.phase)])
        pulsations = self.bend + np.concatenate([[0.0], self.pulsation])
        position, first, second = (np.zeros(u.size, complex) for _ in range(3))
        for weight, k in zip(weights, pulsations, strict=True):
            wave = weight * np.exp(1j * k * u)
            position += (wave - weight) / (1j * k)
            first += wave
            second += 1j * k * wave
        return position, first, second, self.bend * u + np.angle(first * np.exp(-1j * self.bend * u))


@dataclass(frozen=True, slots=True)
class Drive:
    """A timeline, a route at ``speed`` m/s, and what shakes: ``shake`` rad, ``bounce`` m, at rest ``idle`` m."""

    timeline: Timeline
    route: Route
    speed: float
    shake: Waves
    bounce: Waves
    idle: Waves | None = None

    def at(self, t: Array) -> Kinematics:
        """The true motion at the instants ``t`` (n,) s."""
        blocks = [self._block(part) for part in np.array_split(t, t.size // BLOCK + 1)]
        return Kinematics(*(np.concatenate([getattr(b, f.name) for b in blocks]) for f in fields(Kinematics)))

    def _block(self, t: Array) -> Kinematics:
        integral, window, window_slope, window_bend = self.timeline.progress(t)
        windows = (window[:, None], window_slope[:, None], window_bend[:, None])
        u, u_dot, u_ddot = (self.speed * part for part in (integral, window, window_slope))
        p, p_u, p_uu, heading = self.route.plane(u)
        (height, roll), (height_u, roll_u), (height_uu, _) = (part.T for part in self.route.terrain.at(u))
        level = np.abs(p_u)
        length = np.hypot(level, height_u)

        level_u = (p_u.conj() * p_uu).real / level
        pitch_u = -(height_uu * level - height_u * level_u) / length**2
        angles = np.column_stack([roll, -np.arctan2(height_u, level), heading])
        rates = u_dot[:, None] * np.column_stack([roll_u, pitch_u, (p_uu / p_u).imag])
        shaken, shaken_rate, _ = windowed(self.shake.at(t), windows)
        R_nb, q_nb, rate_b = attitude(angles + shaken, rates + shaken_rate)

        bounced = windowed(self.bounce.at(t), windows)
        if self.idle is not None:
            at_rest = (1.0 - windows[0], -windows[1], -windows[2])
            bounced = tuple(a + b for a, b in zip(bounced, windowed(self.idle.at(t), at_rest), strict=True))
        first = np.column_stack([p_u.real, p_u.imag, height_u])
        second = np.column_stack([p_uu.real, p_uu.imag, height_uu])
        acceleration = u_ddot[:, None] * first + u_dot[:, None] ** 2 * second + bounced[2]
        reaction = acceleration + np.array([0.0, 0.0, GRAVITY_M_S2])
        return Kinematics(
            t=t,
            q_nb=q_nb,
            R_nb=R_nb,
            rate_b=rate_b,
            force_b=np.einsum("nji,nj->ni", R_nb, reaction),
            position_n=np.column_stack([p.real, p.imag, height]) + bounced[0],
            velocity_n=u_dot[:, None] * first + bounced[1],
            speed=u_dot * length,
            moving=self.timeline.moving(t),
        )


def windowed(wave: tuple[Array, ...], window: tuple[Array, ...]) -> tuple[Array, ...]:
    """Product of two functions given as (value, first, second derivative)."""
    (s, ds, dds), (w, dw, ddw) = wave, window
    return w * s, dw * s + w * ds, ddw * s + 2.0 * dw * ds + w * dds


def attitude(angles: Array, angle_rates: Array) -> tuple[Array, Array, Array]:
    r"""Attitude and body rates of roll, pitch, yaw about the fixed axes x, y, z (REP-103).

    $R_{nb} = R_z(\psi)R_y(\theta)R_x(\phi)$,
    $\omega_b = (\dot\phi - \dot\psi s_\theta,\ \dot\theta c_\phi + \dot\psi s_\phi c_\theta,$
    $\dot\psi c_\phi c_\theta - \dot\theta s_\phi)$.

    Parameters
    ----------
    angles, angle_rates : (n, 3)
        Roll, pitch, yaw in rad and their derivatives in rad/s.

    Returns
    -------
    R_nb (n, 3, 3), q_nb (n, 4) wxyz continuous where the angles are, rate_b (n, 3) rad/s.
    """
    (sr, sp, sy), (cr, cp, cy) = np.sin(angles).T, np.cos(angles).T
    R_nb = np.stack(
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr,
         sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr,
         -sp, cp * sr, cp * cr], axis=1).reshape(-1, 3, 3)  # fmt: skip
    (hr, hp, hy), (kr, kp, ky) = np.sin(angles / 2).T, np.cos(angles / 2).T
    q_nb = np.column_stack(
        [kr * kp * ky + hr * hp * hy, hr * kp * ky - kr * hp * hy,
         kr * hp * ky + hr * kp * hy, kr * kp * hy - hr * hp * ky])  # fmt: skip
    roll_rate, pitch_rate, yaw_rate = angle_rates.T
    rate_b = np.column_stack(
        [roll_rate - yaw_rate * sp, pitch_rate * cr + yaw_rate * sr * cp, yaw_rate * cr * cp - pitch_rate * sr]
    )
    return R_nb, q_nb, rate_b
