"""Scenario ``rover`` (Roumeliotis 1999): a slow rover on rough ground that stops now and then to look at the sun."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from ..errors import AttestError
from ..records import Array, Channel, Ints
from . import instruments
from .drive import RAMP_S, Drive, Kinematics, Route, Timeline, Waves, attitude
from .simulation import Simulation, random_stream, recording, seconds, stamps_of, truth_columns

Variant = Literal["nominal", "slow", "slow-no-vibration", "idle-engine", "biased", "noisy"]
VARIANTS: tuple[Variant, ...] = ("nominal", "slow", "slow-no-vibration", "idle-engine", "biased", "noisy")

GYRO_NOISE, GYRO_WALK, GYRO_BIAS = 1.5e-4, 5e-6, 5e-3  # rad/s/sqrt(Hz), rad/s^2/sqrt(Hz), rad/s
ACCEL_NOISE, ACCEL_WALK, ACCEL_BIAS = 0.02 / math.sqrt(100.0), 1e-4, 0.02  # 0.02 m/s^2 per sample at 100 Hz
SHAKE_RAD_S, BOUNCE_M_S2, IDLE_M_S2 = 0.04, 0.5, 0.05  # rms per axis
SPEED_M_S, SLOW_M_S, WEAK = 0.3, 0.05, 0.03  # mean speeds; share of the vibration left in "slow"
SUN_ELEVATION_DEG, SUN_AZIMUTH_DEG, SUN_SIGMA_DEG = 40.0, 135.0, 0.5
SUN_MOUNT_DEG = (0.0, 15.0, 30.0)  # roll, pitch, yaw of the sensor in the body: its boresight leans 15 degrees from up
COMPASS_SIGMA_DEG = 3.0
ODOMETRY_SIGMA, ODOMETRY_LATERAL, ODOMETRY_SCALE = 0.03, 0.05, 0.01
FIELD_UT, FIELD_SIGMA_UT = (0.9, 21.0, -43.0), 0.3
ORIGIN, GPS_SIGMA_M = (46.5, 6.6, 400.0), 1.0


@dataclass(frozen=True)
class RoverOptions:
    """Options of ``simulate_rover``. With ``duration_s`` the drive lasts exactly that long."""

    seed: int = 0
    duration_s: float | None = None
    rate_hz: float = 100.0
    motions: int | None = None  # 2 where no duration is given
    motion_s: tuple[float, float] = (60.0, 300.0)
    stop_s: tuple[float, float] = (10.0, 20.0)
    scenario: Literal["S1", "S2"] = "S1"
    variant: Variant = "nominal"
    sun: bool = True
    sun_always: bool = False  # False: at stops only
    compass: bool = False
    odometry: bool = False
    gps: bool = False
    magnetometer: bool = False
    sun_hz: float = 1.0
    compass_hz: float = 1.0
    odometry_hz: float = 10.0
    gps_hz: float = 0.2
    magnetometer_hz: float = 50.0

    def __post_init__(self) -> None:
        if self.variant not in VARIANTS:
            raise AttestError(f"unknown variant {self.variant!r}", f"choose one of {', '.join(VARIANTS)}")
        if self.scenario not in ("S1", "S2"):
            raise AttestError(f"unknown scenario {self.scenario!r}", "choose S1 or S2")
        if not 1.0 <= self.rate_hz <= 10_000.0:
            raise AttestError(f"IMU rate of {self.rate_hz:g} Hz", "choose 1 to 10000 Hz")


def simulate_rover(options: RoverOptions) -> Simulation:
    """Simulate a rover's drive: analytic truth, point samples of rate and specific force, seeded errors.

    Raises
    ------
    AttestError
        If the stops leave no room for a motion in ``duration_s``.
    """
    drive = rover_drive(options)
    period_ns = round(1e9 / options.rate_hz)
    period = period_ns * 1e-9
    stamps = stamps_of(drive.timeline.duration, period_ns)
    n = stamps.size
    clean = drive.at(seconds(stamps))

    gyro_sigma, accel_sigma, loud = bias_sigmas(options)
    accel_walk = ACCEL_WALK if accel_sigma else 0.0
    gyro_bias = instruments.random_walk(_rng(options, "gyro bias"), n, period, gyro_sigma, GYRO_WALK)
    accel_bias = instruments.random_walk(_rng(options, "accel bias"), n, period, accel_sigma, accel_walk)
    scale = loud / math.sqrt(period)
    gyro_noise = _rng(options, "gyro noise").normal(0.0, GYRO_NOISE * scale, (n, 3))
    accel_noise = _rng(options, "accel noise").normal(0.0, ACCEL_NOISE * scale, (n, 3))
    channels = [instruments.imu(stamps, clean, gyro_bias + gyro_noise, accel_bias + accel_noise)]
    channels += _aiding_channels(options, drive, stamps)

    return Simulation(
        log=recording("rover", channels),
        truth=truth_columns(stamps, clean, gyro_bias, accel_bias),
        stops=drive.timeline.stops,
        settings=rover_settings(options),
    )


def bias_sigmas(options: RoverOptions) -> tuple[float, float, float]:
    """Sigma of the gyro's and the accelerometer's initial bias, and the factor on the noise that is not stated."""
    if options.variant == "biased":
        return 0.02, 0.2, 1.0
    return GYRO_BIAS, ACCEL_BIAS if options.scenario == "S2" else 0.0, 2.0 if options.variant == "noisy" else 1.0


def rover_drive(options: RoverOptions) -> Drive:
    """The true drive: depends on the seed, the timeline options and the variant, not on rates or sensors."""
    speed, share = SPEED_M_S, 1.0
    if options.variant.startswith("slow"):
        speed, share = SLOW_M_S, WEAK if options.variant == "slow" else 0.0
    rng = _rng(options, "vibration")
    return Drive(
        timeline=_timeline(_rng(options, "timeline"), options),
        route=_route(_rng(options, "route")),
        speed=speed,
        shake=_vibration(rng, share * SHAKE_RAD_S, order=1),
        bounce=_vibration(rng, share * BOUNCE_M_S2, order=2),
        idle=_vibration(rng, IDLE_M_S2, order=2) if options.variant == "idle-engine" else None,
    )


def _rng(options: RoverOptions, stream: str) -> np.random.Generator:
    """One stream per purpose, so that an option more does not change the rest of the log."""
    return random_stream(options.seed, stream)


def _timeline(rng: np.random.Generator, options: RoverOptions) -> Timeline:
    count = options.motions
    if count is None:
        cycle = sum(options.motion_s) / 2 + sum(options.stop_s) / 2
        count = 2 if options.duration_s is None else max(1, int(options.duration_s / cycle))
    stops, motions = rng.uniform(*options.stop_s, count + 1), rng.uniform(*options.motion_s, count)
    if options.duration_s is not None:
        room = options.duration_s - stops.sum()
        if room < 3.0 * RAMP_S * count:
            raise AttestError(
                f"a drive of {options.duration_s:g} s leaves no room for {count} motion(s) between stops",
                "choose a longer duration or shorter stops",
            )
        motions *= room / motions.sum()
    lengths = np.empty(2 * count + 1)
    lengths[0::2], lengths[1::2] = stops, motions
    edges = np.cumsum(lengths)
    duration = float(edges[-1]) if options.duration_s is None else options.duration_s
    return Timeline(edges[:-1].reshape(-1, 2), duration)


def _route(rng: np.random.Generator) -> Route:
    """Heading swings of up to 19 degrees about a slow turn; slopes that add up to a tilt of about 18 degrees."""
    lengths = np.array([2.5, 4.0, 7.0, 13.0])[:, None] * rng.uniform(0.8, 1.25, (4, 2))
    pulsation = 2.0 * np.pi / lengths
    amplitude = np.array([0.05, math.radians(3.0)]) * np.array([0.8, 1.0, 1.0, 1.2])[:, None]
    amplitude[:, 0] /= pulsation[:, 0]  # given as a slope
    terrain = Waves(amplitude, pulsation, rng.uniform(0.0, 2.0 * np.pi, (4, 2)))
    turns = 2.0 * np.pi / (np.array([4.0, 9.0, 21.0]) * rng.uniform(0.8, 1.25, 3))
    return Route(
        bend=rng.choice([-1.0, 1.0]) * rng.uniform(0.02, 0.12),
        swing=np.array([0.09, 0.12, 0.12]),
        pulsation=turns * rng.choice([-1.0, 1.0], 3),
        phase=rng.uniform(0.0, 2.0 * np.pi, 3),
        terrain=terrain,
    )


def _vibration(rng: np.random.Generator, rms: float, order: int, waves: int = 6) -> Waves:
    """Sinusoids of 3-20 Hz on three axes, no frequency twice, whose ``order``-th derivative has this rms."""
    slots = np.linspace(3.0, 20.0, 3 * waves + 1)
    frequency = rng.permutation(slots[:-1] + rng.uniform(0.0, 1.0, 3 * waves) * np.diff(slots)).reshape(waves, 3)
    pulsation = 2.0 * np.pi * frequency
    return Waves(rms * math.sqrt(2.0 / waves) / pulsation**order, pulsation, rng.uniform(0.0, 2.0 * np.pi, (waves, 3)))


def _aiding_channels(options: RoverOptions, drive: Drive, stamps: Ints) -> list[Channel]:
    def sample(rate_hz: float, at_stops_only: bool = False) -> tuple[Ints, Kinematics]:
        step = max(1, round(options.rate_hz / rate_hz))  # on the IMU's stamps, so that one table needs no extra rows
        clean = drive.at(seconds(stamps[::step]))
        if not at_stops_only:
            return stamps[::step], clean
        return stamps[::step][~clean.moving], drive.at(clean.t[~clean.moving])

    channels = []
    if options.sun:
        when, clean = sample(options.sun_hz, at_stops_only=not options.sun_always)
        R_bs, sigma = sun_mounting()[0], math.radians(SUN_SIGMA_DEG)
        channels.append(instruments.sun(_rng(options, "sun"), when, clean, np.array(sun_direction()), R_bs, sigma))
    if options.compass:
        channels.append(instruments.compass(_rng(options, "compass"), *sample(options.compass_hz), COMPASS_SIGMA_DEG))
    if options.odometry:
        rng = _rng(options, "odometry")
        scale = ODOMETRY_SCALE * rng.choice([-1.0, 1.0])
        measured = sample(options.odometry_hz)
        channels.append(instruments.odometry(rng, *measured, scale, ODOMETRY_SIGMA, ODOMETRY_LATERAL))
    if options.gps:
        channels.append(instruments.gps(_rng(options, "gps"), *sample(options.gps_hz), ORIGIN, GPS_SIGMA_M))
    if options.magnetometer:
        measured = sample(options.magnetometer_hz)
        rng = _rng(options, "magnetometer")
        channels.append(instruments.magnetometer(rng, *measured, np.array(FIELD_UT), FIELD_SIGMA_UT))
    return channels


def sun_direction() -> tuple[float, float, float]:
    """Unit vector to the sun in world axes (east, north, up)."""
    elevation, azimuth = math.radians(SUN_ELEVATION_DEG), math.radians(SUN_AZIMUTH_DEG)
    return (
        math.cos(elevation) * math.sin(azimuth),
        math.cos(elevation) * math.cos(azimuth),
        math.sin(elevation),
    )


def sun_mounting() -> tuple[Array, list[float]]:
    """Mounting of the sun sensor, body from sensor: matrix and quaternion (w, x, y, z)."""
    R_bs, q_bs, _ = attitude(np.radians([SUN_MOUNT_DEG]), np.zeros((1, 3)))
    return R_bs[0], [float(part) for part in q_bs[0]]


def rover_settings(options: RoverOptions) -> dict[str, dict[str, Any]]:
    """The ``attest.toml`` of the log: directions, mountings and the stated noise."""
    world: dict[str, Any] = {}
    settings: dict[str, dict[str, Any]] = {
        "world": world,
        "imu": {
            "mounting": [1.0, 0.0, 0.0, 0.0],
            "gyro_noise_density": GYRO_NOISE,
            "gyro_scale_sigma": 0.0,  # the simulated gyro has none
            "gyro_random_walk": GYRO_WALK,
            "accel_noise_density": ACCEL_NOISE,
            "accel_bias_sigma": bias_sigmas(options)[1] or 1e-6,  # S1 has none, but a setting must be positive
        },
    }
    if options.sun:
        world["sun_direction"] = list(sun_direction())
        settings["sun"] = {"sigma_deg": SUN_SIGMA_DEG, "mounting": sun_mounting()[1], "components": 2}
    if options.magnetometer:
        world["magnetic_field_ut"] = list(FIELD_UT)
    if options.gps:
        world |= dict(zip(("latitude_deg", "longitude_deg", "altitude_m"), ORIGIN, strict=True))
        settings["gps"] = {"sigma_m": GPS_SIGMA_M}
    if options.compass:
        settings["compass"] = {"sigma_deg": COMPASS_SIGMA_DEG}
    if options.odometry:
        settings["odometry"] = {
            "sigma_m_s": ODOMETRY_SIGMA,
            "lateral_sigma_m_s": ODOMETRY_LATERAL,
            "scale_sigma": 0.01,
        }
    return settings
