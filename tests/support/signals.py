"""What tests of simulated signals share: columns as arrays, integration by Gauss points, bands of variances."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

from attest_cli.records import Channel
from attest_cli.simulate import Simulation
from attest_cli.simulate.drive import Kinematics

Floats = NDArray[np.float64]


def channel(simulation: Simulation, role: str) -> Channel:
    """The channel of a role."""
    return next(c for c in simulation.log.channels if c.role == role)


def stack(source: Any, *names: str) -> Floats:
    """Columns side by side."""
    return np.column_stack([source[name] for name in names])


def gyro_of(simulation: Simulation) -> Floats:
    """Measured rates (n, 3)."""
    return stack(channel(simulation, "imu").values, "gyro_x", "gyro_y", "gyro_z")


def accel_of(simulation: Simulation) -> Floats:
    """Measured specific force (n, 3)."""
    return stack(channel(simulation, "imu").values, "accel_x", "accel_y", "accel_z")


def gyro_bias_of(simulation: Simulation) -> Floats:
    """True gyro bias (n, 3)."""
    return stack(simulation.truth, *(f"gyro_bias_{axis}_rad_s" for axis in "xyz"))


def assert_variance(errors: Floats, sigma: float | Floats) -> None:
    """Chi-square band of 99.99 % on the sum of squares, and a mean that fits."""
    z = np.ravel(errors / sigma)
    low, high = chdtri(z.size, 1.0 - 5e-5), chdtri(z.size, 5e-5)
    assert low < np.sum(z**2) < high
    assert abs(z.mean()) < 4.0 / math.sqrt(z.size)


def gauss_points(start: float, step: float, count: int) -> tuple[Floats, Floats]:
    """Two Gauss-Legendre points per step."""
    middle = np.asarray(start + step * (np.arange(count) + 0.5), dtype=np.float64)
    return middle - step * math.sqrt(3) / 6, middle + step * math.sqrt(3) / 6


def attitude_error(at: Callable[[Floats], Kinematics], begin: float, end: float, step: float) -> float:
    """Fourth-order Magnus integration of the clean rate from ``begin`` to ``end``, against the truth (rad)."""
    first, second = gauss_points(begin, step, round((end - begin) / step))
    one, two = at(first).rate_b, at(second).rate_b
    turns = step / 2 * (one + two) + math.sqrt(3) / 12 * step**2 * np.cross(one, two)
    R = np.eye(3)
    for turn in Rotation.from_rotvec(turns).as_matrix():
        R = R @ turn
    ends = at(np.array([begin, end])).R_nb
    return float(Rotation.from_matrix((ends[0] @ R).T @ ends[1]).magnitude())
