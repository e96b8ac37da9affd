"""A unit that changes within a log, told by the gyro's noise at rest."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from attest_cli.errors import AttestError
from attest_cli.prepare.unit_change import refuse

Array = NDArray[np.float64]
T = np.arange(0.0, 120.0, 0.01)
DEG = float(np.degrees(1.0))


def drive(motions: tuple[tuple[float, float], ...] = ((20.0, 50.0), (70.0, 100.0))) -> tuple[Array, Array]:
    """A gyro and an accelerometer that shake where they move."""
    rng = np.random.default_rng(7)
    moving = np.logical_or.reduce([T < 0.0, *((a < T) & (b > T) for a, b in motions)])[:, None]
    waves = np.sin(2.0 * np.pi * np.outer(T, [3.0, 4.1, 5.3]))
    gyro = rng.normal(0.004, 0.001, (len(T), 3)) + moving * waves
    return gyro, rng.normal([0.0, 0.0, 9.8], 0.02, (len(T), 3)) + moving * rng.normal(0.0, 1.0, (len(T), 3))


@pytest.mark.parametrize("factor", [DEG, 1.0 / DEG])
@pytest.mark.parametrize("when", [35.0, 60.0, 110.0])
def test_a_change_is_refused_with_its_place(factor: float, when: float) -> None:
    gyro, accel = drive()
    gyro[when < T] *= factor
    with pytest.raises(AttestError, match="unit changes between") as told:
        refuse("imu", T, gyro, accel)
    first, last = (float(x) for x in str(told.value).split("between ")[1].split(" s,")[0].split(" and "))
    assert first <= when <= last + 0.2
    assert last - first < 31.0


@pytest.mark.parametrize("factor", [1.0, 5.0, 200.0])
def test_other_noise_is_no_other_unit(factor: float) -> None:
    gyro, accel = drive()
    gyro[T > 60.0] *= factor
    refuse("imu", T, gyro, accel)


@pytest.mark.parametrize("motions", [((0.0, 60.0),), ((60.0, 120.0),), ((0.0, 120.0),), ()])
def test_motion_is_no_other_unit(motions: tuple[tuple[float, float], ...]) -> None:
    gyro, accel = drive(motions)
    gyro *= np.where(np.abs(gyro) > 0.02, 0.057, 1.0)  # so that it moves as much as the other unit would
    refuse("imu", T, gyro, accel)


def test_a_smooth_turn_of_a_calm_vehicle_is_no_other_unit() -> None:
    gyro, accel = drive(())
    gyro += (T > 60.0)[:, None] * 0.5 * np.sin(2.0 * np.pi * np.outer(T, [2.0, 2.1, 2.2]))
    refuse("imu", T, gyro, accel)


def test_a_sensor_that_is_rounded_at_rest_or_short_tells_nothing() -> None:
    gyro, accel = drive(())
    refuse("imu", T, np.round(gyro, 1), accel)
    refuse("imu", T[:20], gyro[:20], accel[:20])


@pytest.mark.parametrize("factor", [DEG, 1.0])
def test_a_coarse_accelerometer_tells_rest_too(factor: float) -> None:
    gyro, accel = drive()
    gyro[T > 60.0] *= factor
    coarse = np.round(accel, 1)  # some windows are constant, others flicker
    if factor == 1.0:
        refuse("imu", T, gyro, coarse)
        refuse("imu", T, gyro, np.full_like(coarse, 9.8))
        return
    with pytest.raises(AttestError, match="unit changes between"):
        refuse("imu", T, gyro, coarse)
