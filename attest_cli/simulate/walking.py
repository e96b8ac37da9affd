"""Scenario ``walking`` (Rehbinder and Hu): a legged robot, its trunk swinging and its feet hitting the ground."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from ..errors import AttestError
from ..records import Array
from . import instruments
from .drive import GRAVITY_M_S2, Kinematics, Timeline, Waves, attitude, windowed
from .shapes import Kicks, Plateaus
from .simulation import Simulation, integral, random_stream, recording, seconds, stamps_of, truth_columns

Case = Literal["A", "B", "C"]
CASES: tuple[Case, ...] = ("A", "B", "C")

PERIOD_NS = 5_000_000
STAND_S, WALK_S, STILL_S = 5.0, 12.0, 6.0
ROLL_RAD, PITCH_RAD = math.radians(4.0), math.radians(3.0)
STEP_HZ, STRIDE_HZ = 2.5, 1.25
SLOW_RAD, SLOW_SPREAD_RAD = np.radians([[4.0], [2.0]]), math.radians(2.0)  # slow components of 4-6 and 2-4 deg
YAW_RATE_RAD_S = 0.3
BOUNCE_M_S2, SWAY_M_S2 = 0.10 * GRAVITY_M_S2, 0.05 * GRAVITY_M_S2
KICK_S, RECOVERY_S, FOOTFALL_M_S2 = 0.025, 0.15, 1.5 * GRAVITY_M_S2
FOOTFALL_UP, FOOTFALL_ASIDE = (1.0, 0.3), 0.4  # of it: mean and sigma of the size, sigma along each level axis
IMPULSE_M_S2 = 1.5 * GRAVITY_M_S2
START_M_S2, START_S = 0.08 * GRAVITY_M_S2, 2.5
CURVE_M_S2, CURVE_S, EDGE_S = 0.05 * GRAVITY_M_S2, 3.0, 0.25
GYRO_NOISE, GYRO_WALK = math.radians(0.05), math.radians(0.003)  # rad/s/sqrt(Hz), rad/s^2/sqrt(Hz)
ACCEL_NOISE_M_S2 = 0.01 * GRAVITY_M_S2  # per sample


@dataclass(frozen=True)
class WalkingOptions:
    """Options of ``simulate_walking``: A trot, B stop-and-go, C sparse impulses; the bias is that of each gyro axis."""

    seed: int = 0
    case: Case = "A"
    bias_deg_s: float = 0.05
    duration_s: float = 120.0

    def __post_init__(self) -> None:
        if self.case not in CASES:
            raise AttestError(f"unknown case {self.case!r}", f"choose one of {', '.join(CASES)}")
        if not 0.0 <= self.bias_deg_s <= 100.0:
            raise AttestError(f"a gyro bias of {self.bias_deg_s:g} deg/s", "choose 0 to 100 deg/s")
        if not 1.0 <= self.duration_s <= 86_400.0:
            raise AttestError(f"a walk of {self.duration_s:g} s", "choose 1 to 86400 s")


def simulate_walking(options: WalkingOptions) -> Simulation:
    """Simulate a walk: an IMU at 200 Hz on the trunk, 5 s standing first, truth of the IMU's place.

    The robot of A and C turns at a steady 0.3 rad/s and goes nowhere: every footfall of A lifts it a little, the
    impulses of C are never given back, so that its speed walks at random. B walks at 1.8 m/s; its curves turn it.
    """
    walk = Walk.of(options)
    stamps = stamps_of(options.duration_s, PERIOD_NS)
    clean = walk.at(seconds(stamps))
    n, period, seed = stamps.size, PERIOD_NS * 1e-9, options.seed

    start = math.radians(options.bias_deg_s) * random_stream(seed, "walking bias").choice([-1.0, 1.0], 3)
    walked = instruments.random_walk(random_stream(seed, "walking bias walk"), n, period, 0.0, GYRO_WALK)
    gyro_noise = random_stream(seed, "walking gyro noise").normal(0.0, GYRO_NOISE / math.sqrt(period), (n, 3))
    accel_noise = random_stream(seed, "walking accel noise").normal(0.0, ACCEL_NOISE_M_S2, (n, 3))
    gyro_bias = start + walked
    return Simulation(
        log=recording("walking", [instruments.imu(stamps, clean, gyro_bias + gyro_noise, accel_noise)]),
        truth=truth_columns(stamps, clean, gyro_bias, np.zeros((n, 3))),
        stops=walk.stops(options.duration_s),
        settings=_settings(options),
    )


@dataclass(frozen=True, slots=True)
class Walk:
    r"""The true walk: its velocity is $R_z(\psi)\,u$, with $u$ in level axes that turn with the yaw, plus the kicks'.

    ``swing``: roll, pitch and yaw (rad); ``gait``: velocity of bounce and sway (m/s); ``drive``: forward acceleration;
    ``turn``: yaw rate.
    """

    timeline: Timeline
    swing: Waves
    gait: Waves
    kicks: tuple[Kicks, ...]
    drive: Plateaus
    turn: Plateaus

    @classmethod
    def of(cls, options: WalkingOptions) -> Walk:
        """Lay out the walk of a case."""
        timeline = _timeline(options)
        rng = random_stream(options.seed, "walking gait")
        quiet = 0.0 if options.case == "C" else 1.0
        pulsation = 2 * np.pi * np.array([[STRIDE_HZ, STRIDE_HZ, STEP_HZ]])  # no fore-and-aft sway
        return cls(
            timeline=timeline,
            swing=_swing(rng),
            gait=Waves(quiet * np.array([[0.0, SWAY_M_S2, BOUNCE_M_S2]]) / pulsation, pulsation, _phase(rng, (1, 3))),
            kicks=_kicks(random_stream(options.seed, "walking kicks"), timeline, options.case),
            drive=Plateaus.of(_starts(timeline) if options.case == "B" else []),
            turn=Plateaus.of(_turns(timeline, options.case)),
        )

    def angles(self, t: Array) -> tuple[Array, Array]:
        """Roll, pitch, yaw (n, 3) rad and their derivatives."""
        swung, rates, _ = windowed(self.swing.at(t), self._windows(t))
        turned, turn_rate, _, _ = self.turn.at(t)
        up = np.array([0.0, 0.0, 1.0])
        return swung + turned[:, None] * up, rates + turn_rate[:, None] * up

    def velocity(self, t: Array) -> Array:
        """Velocity (n, 3) in navigation axes."""
        return self._translation(t)[0]

    def at(self, t: Array) -> Kinematics:
        """The true motion at ``t`` (n,) s, increasing by a few ms; position is counted from ``t[0]``."""
        angles, rates = self.angles(t)
        R_nb, q_nb, rate_b = attitude(angles, rates)
        velocity, acceleration, forward = self._translation(t)
        reaction = acceleration + np.array([0.0, 0.0, GRAVITY_M_S2])
        return Kinematics(
            t=t,
            q_nb=q_nb,
            R_nb=R_nb,
            rate_b=rate_b,
            force_b=np.einsum("nji,nj->ni", R_nb, reaction),
            position_n=integral(self.velocity, t),
            velocity_n=velocity,
            speed=forward,
            moving=self.timeline.moving(t),
        )

    def stops(self, duration: float) -> Array:
        """True stops (k, 2) in s."""
        edges = self.timeline.stops.clip(max=duration)
        return np.asarray(edges[edges[:, 1] > edges[:, 0]])

    def _windows(self, t: Array) -> tuple[Array, Array, Array]:
        _, window, slope, bend = self.timeline.progress(t)
        return window[:, None], slope[:, None], bend[:, None]

    def _translation(self, t: Array) -> tuple[Array, Array, Array]:
        """Velocity and acceleration in navigation axes, and the forward speed."""
        u, u_dot, _ = windowed(self.gait.at(t), self._windows(t))
        forward, pushed, _, _ = self.drive.at(t)
        along, up = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
        u, u_dot = u + forward[:, None] * along, u_dot + pushed[:, None] * along
        angles, rates = self.angles(t)
        R_nl = attitude(angles * up, rates * up)[0]
        velocity = np.einsum("nij,nj->ni", R_nl, u)
        acceleration = np.einsum("nij,nj->ni", R_nl, u_dot + np.cross(rates * up, u))
        for kicks in self.kicks:
            gained, force = kicks.at(t)
            velocity, acceleration = velocity + gained, acceleration + force
        return velocity * self.timeline.moving(t)[:, None], acceleration, u[:, 0]


def _phase(rng: np.random.Generator, shape: tuple[int, int]) -> Array:
    return rng.uniform(0.0, 2 * np.pi, shape)


def _timeline(options: WalkingOptions) -> Timeline:
    """One walk to the end, or 12 s of walking and 6 s still by turns."""
    if options.case != "B":
        return Timeline(np.array([[STAND_S, STAND_S + options.duration_s + 2.0]]), options.duration_s)
    begins = np.arange(STAND_S, max(options.duration_s, STAND_S + 1.0), WALK_S + STILL_S)
    return Timeline(np.column_stack([begins, begins + WALK_S]), options.duration_s)


def _swing(rng: np.random.Generator) -> Waves:
    """Roll and pitch of the gait, and two slow components of each; yaw has none."""
    slow = 2 * np.pi * np.array([[0.05], [0.15]]) * rng.uniform(1.0, 2.0, (2, 2))
    lean = SLOW_RAD + SLOW_SPREAD_RAD * rng.uniform(size=(2, 2))
    pulsation = np.concatenate([2 * np.pi * np.array([[STRIDE_HZ, STEP_HZ]]), slow])
    amplitude = np.concatenate([[[ROLL_RAD, PITCH_RAD]], lean])
    still = np.zeros((3, 1))
    return Waves(np.hstack([amplitude, still]), np.hstack([pulsation, still]), _phase(rng, (3, 3)))


def _starts(timeline: Timeline) -> list[tuple[float, float, float, float]]:
    """Forward acceleration at the start and at the end of each walk."""
    spans = [((a, a + START_S), (e - START_S, e)) for a, e in timeline.motions]
    return [(*at, EDGE_S, sign * START_M_S2) for pair in spans for at, sign in zip(pair, (1.0, -1.0), strict=True)]


def _turns(timeline: Timeline, case: Case) -> list[tuple[float, float, float, float]]:
    """Yaw rate: steady, or in case B a curve amid each walk whose sideways acceleration at its speed is the stated."""
    if case != "B":
        return [(a, e, 1.0, YAW_RATE_RAD_S) for a, e in timeline.motions]
    rate = CURVE_M_S2 / (START_M_S2 * (START_S - EDGE_S))
    return [((a + e - CURVE_S) / 2, (a + e + CURVE_S) / 2, EDGE_S, rate) for a, e in timeline.motions]


def _kicks(rng: np.random.Generator, timeline: Timeline, case: Case) -> tuple[Kicks, ...]:
    """Footfalls, given back before the next; in case C one impulse per axis within each second, not given back."""
    if case == "C":
        seconds_ = np.arange(STAND_S, max(timeline.duration, STAND_S + 1.0))
        starts = seconds_ + rng.uniform(0.0, 1.0 - KICK_S, (3, seconds_.size))
        peaks = rng.normal(0.0, IMPULSE_M_S2, (3, seconds_.size))
        return tuple(Kicks(s, p[:, None] * axis, KICK_S) for s, p, axis in zip(starts, peaks, np.eye(3), strict=True))
    steps = np.concatenate([np.arange(a + 1 / STEP_HZ, e - 1 / STEP_HZ, 1 / STEP_HZ) for a, e in timeline.motions])
    up, aside = np.abs(rng.normal(*FOOTFALL_UP, (steps.size, 1))), rng.normal(0.0, FOOTFALL_ASIDE, (steps.size, 2))
    return (Kicks(steps, FOOTFALL_M_S2 * np.hstack([aside, up]), KICK_S, RECOVERY_S),)


def _settings(options: WalkingOptions) -> dict[str, dict[str, Any]]:
    """The ``attest.toml`` of the log: the stated noise."""
    return {
        "imu": {
            "mounting": [1.0, 0.0, 0.0, 0.0],
            "gyro_noise_density": GYRO_NOISE,
            "gyro_scale_sigma": 0.0,  # the simulated gyro has none
            "gyro_random_walk": GYRO_WALK,
            "accel_noise_density": ACCEL_NOISE_M_S2 * math.sqrt(PERIOD_NS * 1e-9),
            "gyro_bias_sigma": math.radians(max(options.bias_deg_s, 0.01)),
            "accel_bias_sigma": 1e-6,  # it has none, but a setting must be positive
        },
    }
