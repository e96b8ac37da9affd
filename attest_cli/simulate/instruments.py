"""What the sensors make of the true motion: biases, noise, mountings, rates. One function per channel."""

from __future__ import annotations

import math

import numpy as np

from ..records import Array, Channel, Ints
from .drive import Kinematics

WGS84_A_M = 6378137.0
WGS84_E2 = 6.69437999014e-3


def random_walk(rng: np.random.Generator, n: int, period: float, sigma: float, density: float) -> Array:
    """Bias (n, 3): N(0, sigma) per axis at the start, then a random walk of ``density`` (unit/s/sqrt(Hz))."""
    steps = rng.normal(0.0, density * math.sqrt(period), (n, 3))
    steps[0] = rng.normal(0.0, sigma, 3)
    return np.cumsum(steps, axis=0)


def imu(stamps: Ints, clean: Kinematics, gyro_error: Array, accel_error: Array) -> Channel:
    """Gyro (rad/s) and specific force (m/s^2), sampled at the stamps; errors (n, 3) are bias plus noise."""
    gyro, accel = clean.rate_b + gyro_error, clean.force_b + accel_error
    values = {f"gyro_{axis}": gyro[:, k] for k, axis in enumerate("xyz")}
    values |= {f"accel_{axis}": accel[:, k] for k, axis in enumerate("xyz")}
    units = {name: "rad/s" if name.startswith("gyro") else "m/s^2" for name in values}
    return Channel("/imu/data", "sensor_msgs/msg/Imu", "imu", stamps, values, units, "base_link")


def sun(
    rng: np.random.Generator, stamps: Ints, clean: Kinematics, direction_n: Array, R_bs: Array, sigma_rad: float
) -> Channel:
    """Two-dimensional sun sensor: components of the direction across the boresight (sensor z)."""
    seen = np.einsum("ji,nkj,k->ni", R_bs, clean.R_nb, direction_n)
    seen = seen[:, :2] + rng.normal(0.0, sigma_rad, (stamps.size, 2))
    values = {"sun_x": seen[:, 0], "sun_y": seen[:, 1]}
    return Channel("/sun", "geometry_msgs/msg/Vector3Stamped", "sun", stamps, values, dict.fromkeys(values, ""), "sun")


def compass(rng: np.random.Generator, stamps: Ints, clean: Kinematics, sigma_deg: float) -> Channel:
    """Heading of body x in degrees, clockwise from true north, in [0, 360)."""
    heading = np.degrees(np.arctan2(clean.R_nb[:, 0, 0], clean.R_nb[:, 1, 0]))
    values = {"compass_deg": np.mod(heading + rng.normal(0.0, sigma_deg, stamps.size), 360.0)}
    return Channel("/compass", "geometry_msgs/msg/Vector3Stamped", "compass", stamps, values, {"compass_deg": "deg"})


def odometry(
    rng: np.random.Generator, stamps: Ints, clean: Kinematics, scale: float, sigma: float, lateral_sigma: float
) -> Channel:
    """Wheel odometry: velocity in body axes (m/s), forward with a scale error, nothing sideways or up but noise."""
    velocity = rng.normal(0.0, [sigma, lateral_sigma, lateral_sigma], (stamps.size, 3))
    velocity[:, 0] += clean.speed * (1.0 + scale)
    values = {f"velocity_{axis}": velocity[:, k] for k, axis in enumerate("xyz")}
    units = dict.fromkeys(values, "m/s")
    return Channel("/odom", "nav_msgs/msg/Odometry", "odometry", stamps, values, units, "base_link")


def magnetometer(
    rng: np.random.Generator, stamps: Ints, clean: Kinematics, field_n_ut: Array, sigma_ut: float
) -> Channel:
    """Magnetic field in body axes, microtesla."""
    field = np.einsum("nji,j->ni", clean.R_nb, field_n_ut) + rng.normal(0.0, sigma_ut, (stamps.size, 3))
    values = {f"mag_{axis}": field[:, k] for k, axis in enumerate("xyz")}
    kind = "sensor_msgs/msg/MagneticField"
    return Channel("/imu/mag", kind, "magnetometer", stamps, values, dict.fromkeys(values, "uT"), "base_link")


def gps(
    rng: np.random.Generator, stamps: Ints, clean: Kinematics, origin: tuple[float, float, float], sigma_m: float
) -> Channel:
    """Fixes around ``origin`` (deg, deg, m), by the radii of curvature there (curvature: < 1 mm within 100 m)."""
    latitude, longitude, altitude = math.radians(origin[0]), math.radians(origin[1]), origin[2]
    root = math.sqrt(1.0 - WGS84_E2 * math.sin(latitude) ** 2)
    meridian, normal = WGS84_A_M * (1.0 - WGS84_E2) / root**3, WGS84_A_M / root
    east, north, up = (clean.position_n + rng.normal(0.0, sigma_m, (stamps.size, 3))).T
    values = {
        "latitude": np.degrees(latitude + north / (meridian + altitude)),
        "longitude": np.degrees(longitude + east / ((normal + altitude) * math.cos(latitude))),
        "altitude": altitude + up,
        "gps_sigma_m": np.full(stamps.size, sigma_m),
    }
    units = {"latitude": "deg", "longitude": "deg", "altitude": "m", "gps_sigma_m": "m"}
    return Channel("/fix", "sensor_msgs/msg/NavSatFix", "gps", stamps, values, units, "gps")
