"""Two IMUs in one channel are refused, turned by however much; vibration, spikes and hum of one IMU are not."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from attest_cli.errors import AttestError
from attest_cli.maths import rotation
from attest_cli.prepare import interleaved

Array = NDArray[np.float64]
T = np.arange(8000) * 0.01


def driven(seed: int = 1, noise: float = 0.003) -> Array:
    """Return gyro and accelerometer (n, 6) of a vehicle that rests, and turns mostly about z."""
    moving = np.clip(3.0 * np.sin(2 * np.pi * T / 40.0), 0.0, 1.0)[:, None]
    rate = moving * np.array([0.03, 0.05, 0.3]) * np.sin(2 * np.pi * T[:, None] * np.array([0.31, 0.23, 0.1]))
    force = moving * np.array([0.5, 0.6, 0.3]) * np.sin(2 * np.pi * T[:, None] * np.array([0.2, 0.15, 3.1]))
    force += [0.1, -0.2, 9.8]
    return np.hstack([rate, force]) + np.random.default_rng(seed).normal(0.0, noise, (len(T), 6))


def turned(table: Array, axis: int, degrees: float) -> Array:
    R = rotation.matrix(rotation.exp_quaternion(np.radians(degrees) * np.eye(3)[axis]))
    return np.hstack([table[:, :3] @ R.T, table[:, 3:] @ R.T])


def in_turn(one: Array, other: Array, second: NDArray[np.bool_]) -> Array:
    return np.where(second[:, None], other, one)


@pytest.mark.parametrize(("axis", "degrees"), [(0, 90.0), (2, 90.0), (1, 180.0), (0, 120.0), (2, 60.0)])
def test_rows_of_two_imus_in_turn_are_refused(axis: int, degrees: float) -> None:
    second = np.arange(len(T)) % 2 == 1
    other = turned(driven(2), axis, degrees) + 0.01
    with pytest.raises(AttestError, match="two IMUs"):
        interleaved.refuse("log.csv: imu", in_turn(driven(), other, second), 0.01)
    keep = np.random.default_rng(3).random(len(T)) > 0.0003  # rows are lost: the order changes
    with pytest.raises(AttestError, match="two IMUs"):
        interleaved.refuse("log.csv: imu", in_turn(driven(), other, second)[keep], 0.01)


@pytest.mark.parametrize("hz", [0.5, 2.0, 4.0, 6.0])
@pytest.mark.parametrize("rows", [450, 700, 8000])
def test_a_shaken_imu_of_which_few_samples_make_a_turn_is_one(hz: float, rows: int) -> None:
    shaken = np.sin(2 * np.pi * hz * 2.0 * T[:, None] + np.arange(6)) * [1.0, 0.7, 0.5, 3.0, 2.0, 1.0]
    interleaved.refuse("log.csv: imu", (driven() + shaken)[:rows], 0.02)  # the same at half the rate


@pytest.mark.parametrize("hz", [49.9, 49.3, 47.0, 25.0, 33.3, 33.33, 16.6])
@pytest.mark.parametrize("where", ["always", "in motion"])
def test_vibration_near_half_the_rate_is_of_one_imu(hz: float, where: str) -> None:
    table = driven()
    moving = np.ones(len(T)) if where == "always" else np.clip(3.0 * np.sin(2 * np.pi * T / 40.0), 0.0, 1.0)
    hum = moving * np.cos(2 * np.pi * hz * T + 0.3)
    interleaved.refuse("log.csv: imu", table + hum[:, None] * np.array([0.05, 0.02, 0.1, 0.3, 0.5, 1.0]), 0.01)


@pytest.mark.parametrize("size", [5.0, 1e3, 1e11])
def test_spikes_lone_or_many_and_coarse_values_are_of_one_imu(size: float) -> None:
    for share in (1, 40, 400):
        table = driven()
        table[np.random.default_rng(share).choice(len(T), share, replace=False), 2] = size
        interleaved.refuse("log.csv: imu", table, 0.01)
    interleaved.refuse("log.csv: imu", np.rint(driven() / 0.05) * 0.05, 0.01)
    interleaved.refuse("log.csv: imu", np.zeros((len(T), 6)), 0.01)
    interleaved.refuse("log.csv: imu", np.random.default_rng(4).normal(size=(len(T), 6)), 0.01)
    interleaved.refuse("log.csv: imu", driven()[:100], 0.01)


def test_other_biases_alone_are_not_refused() -> None:
    second = np.arange(len(T)) % 2 == 1
    interleaved.refuse("log.csv: imu", in_turn(driven(), driven(2) + 0.02, second), 0.01)


def leaning(seed: int = 1, noise: float = 0.003) -> Array:
    """Return gyro and accelerometer (n, 6) of a vehicle that leans this way and that, and is pushed a little."""
    lean = 0.1 * np.sin(T[:, None] * [0.7, 0.45, 0.1] + [0.0, 1.0, 0.0])
    q = rotation.exp_quaternion(lean)
    rate = rotation.log_quaternion(rotation.multiply(rotation.conjugate(q[:-1]), q[1:])) / 0.01
    force = rotation.rotate(rotation.conjugate(q), np.array([0.0, 0.0, 9.8]))
    force += 0.3 * np.sin(T[:, None] * [1.0, 0.7, 9.0])
    table = np.hstack([np.vstack([rate, rate[-1:]]), force])
    return np.asarray(table + np.random.default_rng(seed).normal(0.0, noise, table.shape))


@pytest.mark.parametrize("unit", [1.0, 180.0 / np.pi])
def test_two_imus_opposite_about_the_vertical_are_refused_and_one_that_hums_is_not(unit: float) -> None:
    second, scale = np.arange(len(T)) % 2 == 1, np.repeat([unit, 1.0], 3)
    with pytest.raises(AttestError, match="every second row"):
        interleaved.refuse("log.csv: imu", in_turn(leaning(), turned(leaning(2), 2, 180.0), second) * scale, 0.01)
    interleaved.refuse("log.csv: imu", leaning() * scale, 0.01)
    for phase in (0.0, 1.57):
        hum = np.cos(2 * np.pi * 49.3 * T[:, None] + [0.3, 0.9, 1.0, *([0.3 + phase] * 3)])
        interleaved.refuse("log.csv: imu", (leaning() + hum * [0.05, 0.02, 0.1, 0.3, 0.5, 1.0]) * scale, 0.01)
