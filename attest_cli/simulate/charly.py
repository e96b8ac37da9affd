"""Scenario ``charly`` (Vaganay, Aldon, Fournier 1993, section 7): one wheel over a plank, a half turn, and back."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import AttestError
from ..records import Array, Bools, Channel, Ints
from . import instruments
from .drive import GRAVITY_M_S2, Kinematics, attitude
from .shapes import Plateaus
from .simulation import Simulation, integral, random_stream, recording, seconds, stamps_of, truth_columns

RUN_S, REPEAT_S = 47.0, 60.0  # the paper's run; where it is repeated, it begins again each minute
PERIOD_NS = 10_000_000  # "the attitude estimation to be updated every 10 ms", odometry with it
SPEED_M_S, LENGTH_M, RAMP_S = 0.3, 5.0, 1.0
STRAIGHTS_S, TURN_S = (4.0, 27.0), (22.0, 26.0)
PLANKS_S = ((7.0, 12.0, -1.0), (32.0, 37.0, 1.0))  # on, off, sign of the roll: right wheel first, then the left one
PLANK_M, TREAD_M, EDGE_S = 0.02, 0.648, 0.35
ROLL_RAD = math.atan2(PLANK_M, TREAD_M)  # 1.768 deg
PITCH_RAD, PITCH_S = math.radians(0.8), 1.5
LEVER_ARM_M = (-0.15, 0.05, 0.30)
GYRO_NOISE_RAD_S = math.radians(0.10)  # per sample
GYRO_BIAS_RAD_S = np.radians([-5.0, 0.0, 0.0]) / 60  # roll, pitch, yaw
GYRO_BIAS_SIGMA_RAD_S = np.radians([0.4, 3.0, 3.0]) / 60
VIBRATION_M_S2, ACCEL_NOISE_M_S2, ACCEL_BIAS_M_S2 = 0.25, 0.03, 0.02  # moving and standing, per sample
SHOCK_M_S2, SHOCK_SAMPLES, SHOCK_DECAY, SHOCKS = 0.9, 12, 4.0, 14  # and two at each edge of a plank
TICK_M = 2e-4


@dataclass(frozen=True)
class CharlyOptions:
    """Options of ``simulate_charly``. After a minute the run begins again; ``turn_deg``: between its two straights."""

    seed: int = 0
    duration_s: float = RUN_S
    turn_deg: float = 180.0

    def __post_init__(self) -> None:
        if not 1.0 <= self.duration_s <= 86_400.0:
            raise AttestError(f"a run of {self.duration_s:g} s", "choose 1 to 86400 s")
        if not abs(self.turn_deg) <= 360.0:
            raise AttestError(f"a turn of {self.turn_deg:g} deg", "choose -360 to 360 deg")


def simulate_charly(options: CharlyOptions) -> Simulation:
    """Simulate the plank run: IMU and wheel encoder at 100 Hz, truth of the vehicle's reference point.

    The accelerometer sits ``LEVER_ARM_M`` from that point; shocks and vibration are errors of the accelerometer, not
    motion. The odometer counts ticks: speed is ticks since the sample before, over the period.
    """
    run = CharlyRun.of(options)
    stamps = stamps_of(options.duration_s, PERIOD_NS)
    clean = run.at(seconds(stamps))
    n, seed = stamps.size, options.seed

    rng = random_stream(seed, "charly bias")
    gyro_bias = np.tile(rng.normal(GYRO_BIAS_RAD_S, GYRO_BIAS_SIGMA_RAD_S), (n, 1))
    accel_bias = np.tile(rng.normal(0.0, ACCEL_BIAS_M_S2, 3), (n, 1))
    gyro_noise = random_stream(seed, "charly gyro noise").normal(0.0, GYRO_NOISE_RAD_S, (n, 3))
    shaking = np.where(clean.moving, VIBRATION_M_S2, ACCEL_NOISE_M_S2)[:, None]
    accel_noise = shaking * random_stream(seed, "charly accel noise").normal(size=(n, 3)) + shocks(options, clean)
    imu = instruments.imu(stamps, clean, gyro_bias + gyro_noise, accel_bias + accel_noise)

    return Simulation(
        log=recording("charly", [imu, _encoder(seed, stamps, run)]),
        truth=truth_columns(stamps, clean, gyro_bias, accel_bias),
        stops=run.stops(options.duration_s),
        settings=_settings(),
    )


@dataclass(frozen=True, slots=True)
class CharlyRun:
    """The true run: forward speed, roll, pitch and yaw rate as plateaus; the reference point moves along body x."""

    speed: Plateaus
    roll: Plateaus
    pitch: Plateaus
    yaw_rate: Plateaus

    @classmethod
    def of(cls, options: CharlyOptions) -> CharlyRun:
        """Lay the paper's run out once, or each minute in a longer one."""
        begins = REPEAT_S * np.arange(math.ceil(options.duration_s / REPEAT_S))

        def each(rows: Iterable[tuple[float, float, float, float]]) -> Plateaus:
            rows = list(rows)
            return Plateaus.of((b + start, b + end, edge, height) for b in begins for start, end, edge, height in rows)

        straight, turn = LENGTH_M / SPEED_M_S + RAMP_S, TURN_S[1] - TURN_S[0]
        bumps = [(at, sign * PITCH_RAD) for on, off, _ in PLANKS_S for at, sign in ((on, -1.0), (off, 1.0))]
        return cls(
            speed=each((start, start + straight, RAMP_S, SPEED_M_S) for start in STRAIGHTS_S),
            roll=each((on, off + EDGE_S, EDGE_S, sign * ROLL_RAD) for on, off, sign in PLANKS_S),
            pitch=each((at, at + PITCH_S, PITCH_S / 2, height) for at, height in bumps),
            yaw_rate=each([(*TURN_S, turn / 2, math.radians(options.turn_deg) / (turn / 2))]),
        )

    def angles(self, t: Array) -> tuple[Array, Array, Array]:
        """Roll, pitch, yaw (n, 3) rad with two derivatives."""
        (_, roll, roll_1, roll_2), (_, pitch, pitch_1, pitch_2) = self.roll.at(t), self.pitch.at(t)
        yaw, yaw_1, yaw_2, _ = self.yaw_rate.at(t)
        return (
            np.column_stack([roll, pitch, yaw]),
            np.column_stack([roll_1, pitch_1, yaw_1]),
            np.column_stack([roll_2, pitch_2, yaw_2]),
        )

    def velocity(self, t: Array) -> Array:
        """Velocity of the reference point (n, 3) in navigation axes: along body x."""
        angles, rates, _ = self.angles(t)
        return np.asarray(attitude(angles, rates)[0][:, :, 0] * self.speed.at(t)[1][:, None])

    def at(self, t: Array) -> Kinematics:
        r"""The true motion at ``t`` (n,) s, increasing by 10 ms or so; the specific force is that at the lever arm $d$.

        $f = \dot V_x e_x + \omega\times V_x e_x + \dot\omega\times d + \omega\times(\omega\times d) + R^T g\,e_z$,
        eq (10) of the paper with all its components. Position is counted from ``t[0]``.
        """
        angles, rates, accelerations = self.angles(t)
        R_nb, q_nb, rate_b = attitude(angles, rates)
        turning = angular_acceleration(angles, rates, accelerations)
        _, speed, speed_rate, _ = self.speed.at(t)
        along, arm = np.array([1.0, 0.0, 0.0]), np.array(LEVER_ARM_M)
        moved = speed_rate[:, None] * along + np.cross(rate_b, speed[:, None] * along)
        levered = np.cross(turning, arm) + np.cross(rate_b, np.cross(rate_b, arm))
        return Kinematics(
            t=t,
            q_nb=q_nb,
            R_nb=R_nb,
            rate_b=rate_b,
            force_b=moved + levered + GRAVITY_M_S2 * R_nb[:, 2, :],
            position_n=integral(self.velocity, t),
            velocity_n=R_nb[:, :, 0] * speed[:, None],
            speed=speed,
            moving=self._moving(t),
        )

    def _motions(self) -> Array:
        """Spans (m, 2) of straights and turns, in order of time."""
        spans = [np.column_stack([part.start, part.end]) for part in (self.speed, self.yaw_rate)]
        together = np.concatenate(spans)
        return np.asarray(together[np.argsort(together[:, 0])])

    def _moving(self, t: Array) -> Bools:
        start, end = self._motions().T
        k = np.maximum(np.searchsorted(start, t, side="right") - 1, 0)
        return np.asarray((t > start[k]) & (t < end[k]))

    def stops(self, duration: float) -> Array:
        """True stops (k, 2) in s."""
        edges = np.concatenate([[0.0], self._motions().ravel(), [np.inf]]).clip(max=duration).reshape(-1, 2)
        return np.asarray(edges[edges[:, 1] > edges[:, 0]])


def angular_acceleration(angles: Array, rates: Array, accelerations: Array) -> Array:
    r"""Derivative of the body rates of ``drive.attitude`` by the angles' second derivatives, (n, 3) rad/s^2.

    $\dot\omega_b = (\ddot\phi - \ddot\psi s_\theta - \dot\psi\dot\theta c_\theta,$
    $\ddot\theta c_\phi - \dot\theta\dot\phi s_\phi + \ddot\psi s_\phi c_\theta
    + \dot\psi(\dot\phi c_\phi c_\theta - \dot\theta s_\phi s_\theta),$
    $\ddot\psi c_\phi c_\theta - \dot\psi(\dot\phi s_\phi c_\theta + \dot\theta c_\phi s_\theta)
    - \ddot\theta s_\phi - \dot\theta\dot\phi c_\phi)$.
    """
    (sr, sp, _), (cr, cp, _) = np.sin(angles).T, np.cos(angles).T
    roll, pitch, yaw = rates.T
    roll_2, pitch_2, yaw_2 = accelerations.T
    about_x = roll_2 - yaw_2 * sp - yaw * pitch * cp
    about_y = pitch_2 * cr - pitch * roll * sr + yaw_2 * sr * cp + yaw * (roll * cr * cp - pitch * sr * sp)
    about_z = yaw_2 * cr * cp - yaw * (roll * sr * cp + pitch * cr * sp) - pitch_2 * sr - pitch * roll * cr
    return np.column_stack([about_x, about_y, about_z])


def shocks(options: CharlyOptions, clean: Kinematics) -> Array:
    """Shocks on x and y (n, 3) in m/s^2: as a wheel meets and clears each edge of a plank, and anywhere in motion."""
    rng = random_stream(options.seed, "charly shocks")
    total = np.zeros((clean.t.size, 3))
    shape = np.exp(-np.arange(SHOCK_SAMPLES) / SHOCK_DECAY)
    edges = [at + delay for on, off, _ in PLANKS_S for at in (on, off) for delay in (0.0, EDGE_S)]
    straight = LENGTH_M / SPEED_M_S + RAMP_S
    for begin in REPEAT_S * np.arange(math.ceil(options.duration_s / REPEAT_S)):
        anywhere = rng.choice(STRAIGHTS_S, SHOCKS) + rng.uniform(0.0, straight, SHOCKS)
        at = begin + np.concatenate([edges, anywhere])
        peaks = rng.normal(0.0, SHOCK_M_S2, (at.size, 2))
        for first, peak in zip(np.searchsorted(clean.t, at), peaks, strict=True):
            part = total[first : first + SHOCK_SAMPLES, :2]
            part += shape[: len(part), None] * peak
    return total


def _encoder(seed: int, stamps: Ints, run: CharlyRun) -> Channel:
    """Forward speed from whole ticks since the sample before, the wheel starting anywhere between two ticks."""
    phase = random_stream(seed, "charly encoder").uniform()
    ticks = np.floor(run.speed.at(seconds(stamps))[0] / TICK_M + phase)
    speed = np.diff(ticks, prepend=ticks[:1]) * TICK_M / (PERIOD_NS * 1e-9)
    values, units = {"speed": speed}, {"speed": "m/s"}
    return Channel("/odom", "nav_msgs/msg/Odometry", "odometry", stamps, values, units, "base_link")


def _settings() -> dict[str, dict[str, Any]]:
    """The ``attest.toml`` of the log: stated noise, and where the accelerometer sits."""
    root = math.sqrt(PERIOD_NS * 1e-9)
    return {
        "imu": {
            "mounting": [1.0, 0.0, 0.0, 0.0],
            "gyro_noise_density": GYRO_NOISE_RAD_S * root,
            "gyro_scale_sigma": 0.0,  # the simulated gyro has none
            "gyro_random_walk": 1e-6,  # it has none, but a setting must be positive
            "accel_noise_density": ACCEL_NOISE_M_S2 * root,
            "gyro_bias_sigma": math.radians(5.0) / 60,
            "accel_bias_sigma": ACCEL_BIAS_M_S2,
        },
        "odometry": {
            "sigma_m_s": TICK_M / (PERIOD_NS * 1e-9) / math.sqrt(6.0),  # of the difference of two roundings
            "lateral_sigma_m_s": 0.005,
            "scale_sigma": 0.001,
        },
        "tilt_ekf": {"lever_arm_m": list(LEVER_ARM_M)},
    }
