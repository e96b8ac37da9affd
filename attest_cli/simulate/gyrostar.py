"""Scenario ``gyrostar`` (Barshan and Durrant-Whyte 1994): a cheap gyro, warming up, on a truck or a turntable."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from ..errors import AttestError
from ..records import Array, Bools
from . import instruments
from .drive import GRAVITY_M_S2, Kinematics, attitude
from .shapes import Plateaus
from .simulation import Simulation, random_stream, recording, seconds, stamps_of, truth_columns

Course = Literal["truck", "platform", "static"]
COURSES: tuple[Course, ...] = ("truck", "platform", "static")

PERIOD_NS = 30_000_000
C1_RAD_S, C2_RAD_S, T_S = math.radians(0.153), math.radians(-0.264), 338.4
SHARE = (0.6, -0.8, 1.0)  # of C1 and C2 on x, y, z: the paper has z alone
GYRO_NOISE_RAD_S = math.radians(0.2)  # per sample
STOP_S, CYCLE_S = 10.0, 60.0
TURN_S, STRAIGHT_S, PEAK_RAD_S = (6.0, 20.0), (2.0, 15.0), math.radians(4.5)
STEP_S, LEVEL_RAD_S = (3.0, 15.0), (math.radians(5.0), math.radians(30.0))
ACCEL_NOISE_M_S2, VIBRATION_M_S2 = 0.02, 0.3  # per sample: at rest, and on a truck that drives


@dataclass(frozen=True)
class GyrostarOptions:
    """Options of ``simulate_gyrostar``.

    ``scatter``: relative 1-sigma spread of C1, C2 and T; ``random_walk_deg_s``: of the bias, deg/s/sqrt(s); ``stops``:
    10 s at rest at the start of each minute instead of at the start alone.
    """

    seed: int = 0
    course: Course = "truck"
    duration_s: float = 600.0
    scatter: float = 0.0
    random_walk_deg_s: float = 0.0
    stops: bool = False

    def __post_init__(self) -> None:
        if self.course not in COURSES:
            raise AttestError(f"unknown course {self.course!r}", f"choose one of {', '.join(COURSES)}")
        if not 1.0 <= self.duration_s <= 86_400.0:
            raise AttestError(f"a log of {self.duration_s:g} s", "choose 1 to 86400 s")
        if not 0.0 <= self.scatter <= 0.3:
            raise AttestError(f"a scatter of {self.scatter:g}", "choose 0 to 0.3, such as 0.15 for 15 %")
        if not 0.0 <= self.random_walk_deg_s <= 1.0:
            raise AttestError(f"a random walk of {self.random_walk_deg_s:g} deg/s", "choose 0 to 1, such as 5e-4")


def simulate_gyrostar(options: GyrostarOptions) -> Simulation:
    """Simulate the gyro about a vertical axis, with the IMU that a log needs around it: level, turning on the spot."""
    stamps = stamps_of(options.duration_s, PERIOD_NS)
    t, n, seed = seconds(stamps), stamps.size, options.seed
    spans = _driving(options)
    clean = _turning(t, _course(options, spans), _within(t, spans) & (options.course == "truck"))

    bias, _ = gyro_bias(options, t)
    gyro_noise = random_stream(seed, "gyrostar gyro noise").normal(0.0, GYRO_NOISE_RAD_S, (n, 3))
    shaking = np.where(clean.moving & (options.course == "truck"), VIBRATION_M_S2, ACCEL_NOISE_M_S2)[:, None]
    accel_noise = shaking * random_stream(seed, "gyrostar accel noise").normal(size=(n, 3))
    return Simulation(
        log=recording("gyrostar", [instruments.imu(stamps, clean, bias + gyro_noise, accel_noise)]),
        truth=truth_columns(stamps, clean, bias, np.zeros((n, 3))),
        stops=_rests(t, clean.moving),
        settings=_settings(),
    )


def gyro_bias(options: GyrostarOptions, t: Array) -> tuple[Array, tuple[float, float, float]]:
    r"""True bias (n, 3) rad/s at ``t`` (n,) s, and C1, C2 (rad/s), T (s) of the z axis of this gyro.

    $\epsilon = C_1(1 - e^{-t/T}) + C_2$ plus a random walk; eq (1) of the paper.
    """
    spread = 1.0 + options.scatter * random_stream(options.seed, "gyrostar scatter").normal(size=3)
    c1, c2, T = (float(part) for part in spread * [C1_RAD_S, C2_RAD_S, T_S])
    walk = random_stream(options.seed, "gyrostar walk")
    walked = instruments.random_walk(walk, t.size, PERIOD_NS * 1e-9, 0.0, math.radians(options.random_walk_deg_s))
    return (c2 - c1 * np.expm1(-t / T))[:, None] * SHARE + walked, (c1, c2, T)


def _driving(options: GyrostarOptions) -> Array:
    """Spans (m, 2) in which the course runs: after each stop."""
    if options.course == "static":
        return np.empty((0, 2))
    minutes = CYCLE_S * np.arange(math.ceil(options.duration_s / CYCLE_S)) if options.stops else np.zeros(1)
    ends = np.append(minutes[1:], options.duration_s)
    spans = np.column_stack([minutes + STOP_S, ends])
    return np.asarray(spans[spans[:, 1] > spans[:, 0]])


def _course(options: GyrostarOptions, spans: Array) -> Plateaus:
    """Yaw rate: turns between straights, or steps; a piece that meets a stop is cut short."""
    rng = random_stream(options.seed, "gyrostar course")
    period = PERIOD_NS * 1e-9
    rows: list[tuple[float, float, float, float]] = []
    for begin, last in spans:
        end = begin
        while end < last:
            if options.course == "truck":
                start = end + rng.uniform(*STRAIGHT_S)
                end = start + rng.uniform(*TURN_S)
                peak, stop = rng.normal(0.0, PEAK_RAD_S), min(end, last)
                if stop - start > 1.0:
                    rows.append((start, stop, (stop - start) / 2, peak))
            else:
                start, end = end, end + rng.uniform(*STEP_S)
                level = rng.choice([-1.0, 0.0, 1.0]) * rng.uniform(*LEVEL_RAD_S)
                # a step lies midway between two samples, so that the trapezoid of the samples is the true angle
                edges = [period * (math.ceil(round(at / period, 6)) - 0.5) for at in (start, min(end, last))]
                rows.append((edges[0], edges[1], 0.0, level))
    return Plateaus.of(rows)


def _turning(t: Array, course: Plateaus, driving: Bools) -> Kinematics:
    """Turn on the spot: exact heading, level, no acceleration."""
    heading, rate, _, _ = course.at(t)
    up = np.array([0.0, 0.0, 1.0])
    R_nb, q_nb, rate_b = attitude(heading[:, None] * up, rate[:, None] * up)
    still = np.zeros((t.size, 3))
    return Kinematics(
        t=t,
        q_nb=q_nb,
        R_nb=R_nb,
        rate_b=rate_b,
        force_b=np.tile(GRAVITY_M_S2 * up, (t.size, 1)),
        position_n=still,
        velocity_n=still,
        speed=still[:, 0],
        moving=driving | (rate != 0.0),
    )


def _within(t: Array, spans: Array) -> Bools:
    inside = np.zeros(t.size, bool)
    for start, end in spans:
        inside |= (t > start) & (t < end)
    return inside


def _rests(t: Array, moving: Bools) -> Array:
    """Spans (k, 2) of samples at rest."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], moving, [True]])))
    first, last = edges.reshape(-1, 2).T
    return np.column_stack([t[first], t[last - 1]])


def _settings() -> dict[str, dict[str, Any]]:
    """The ``attest.toml`` of the log: the stated noise. How the bias walks or warms up is for a calibration to find."""
    root = math.sqrt(PERIOD_NS * 1e-9)
    return {
        "imu": {
            "mounting": [1.0, 0.0, 0.0, 0.0],
            "gyro_noise_density": GYRO_NOISE_RAD_S * root,
            "gyro_scale_sigma": 0.0,  # the simulated gyro has none
            "accel_noise_density": ACCEL_NOISE_M_S2 * root,
            "gyro_bias_sigma": abs(C2_RAD_S),
            "accel_bias_sigma": 1e-6,  # it has none, but a setting must be positive
        },
    }
