"""Gyro and accelerometer that do not speak of the same axes, told by the turning of gravity."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from attest_cli.maths import rotation
from attest_cli.maths.axes import signed_permutations
from attest_cli.prepare.axes import doubts, foremost, of_field
from attest_cli.records import Fixes, Imu, Warn

Array = NDArray[np.float64]


def drive(rng: np.random.Generator, noise: float = 0.05) -> tuple[Array, Array, Array]:
    """A box that leans about all axes for a minute: t, gyro, specific force."""
    t = np.arange(3000) / 50.0
    pulsation, phase = rng.uniform(0.3, 0.9, 3), rng.uniform(0.0, 6.0, 3)
    gyro = 0.25 * np.sin(t[:, None] * pulsation + phase)
    q = rotation.chain(rotation.exp_quaternion(np.vstack([np.zeros(3), 0.5 * (gyro[1:] + gyro[:-1]) / 50.0])))
    accel = rotation.matrix(q)[:, 2] * 9.81 + rng.normal(0.0, noise, (3000, 3))
    return t, gyro + rng.normal(0.0, 1e-3, (3000, 3)) + 0.01, accel


@pytest.mark.parametrize("seed", range(5))
def test_axes_that_agree_are_silent(seed: int) -> None:
    assert doubts("log", *drive(np.random.default_rng(seed))) == []


@pytest.mark.parametrize("axes", signed_permutations()[1::5])
def test_any_other_axes_are_told_and_named(axes: Array, rng: np.random.Generator) -> None:
    t, gyro, accel = drive(rng)
    (told,) = doubts("log", t, gyro @ axes, accel)  # axes @ mended gyro is the gyro
    assert told.code == "gyro-against-accel"
    assert told.fatal


@pytest.mark.parametrize("factor", [0.1, 12.0])
def test_a_clock_of_another_rate_is_told(factor: float, rng: np.random.Generator) -> None:
    t, gyro, accel = drive(rng)
    (told,) = doubts("log", t, gyro / factor, accel)
    assert told.code == "gyro-scale"


def test_accelerations_that_hide_gravity_tell_nothing(rng: np.random.Generator) -> None:
    t, gyro, accel = drive(rng)
    pushed = accel + 3.0 * np.sin(t[:, None] * np.array([2.0, 3.1, 2.6]))
    assert doubts("log", t, -gyro, pushed) == []


@pytest.mark.parametrize("axes", signed_permutations()[::7])
def test_a_magnetometer_with_other_axes_is_told(axes: Array, rng: np.random.Generator) -> None:
    """Of all 48, only the axes of the gyro, or all three reversed, are silent: the sign of a field does not show."""
    t, gyro, down = drive(rng)
    field = Fixes("magnetometer", "mag", t[::5] + 0.003, (0.005 * down[::5] + 1e-6) @ axes.T)
    told = of_field(field, Imu(t, gyro, down))
    if np.array_equal(np.abs(axes), np.eye(3)) and abs(np.trace(axes)) == 3.0:
        assert told == []
    else:
        assert [(warn.code, warn.fatal) for warn in told] == [("gyro-against-field", True)]


def test_of_two_readings_of_one_fault_the_one_that_explains_is_kept() -> None:
    early = Warn(
        "gyro-against-accel", "do not turn together: were the accelerometer's x, y, z its x, -y, z", fatal=True
    )
    late = Warn("gyro-against-accel", "contradict each other: were the gyro's x, y, z its -x, y, z", fatal=True)
    field = Warn("gyro-against-field", "magnetometer and gyro do not turn together", fatal=True)
    noise, other = Warn("gyro-noise-raised", "drifts 29 times its noise", fatal=True), Warn("gap", "a gap")
    assert foremost((early, field, other, noise, late)) == (other, late)
    assert foremost((late, field, other, noise, early)) == (field, other, early)
    assert foremost((field, noise, other)) == (field, noise, other)


def test_a_sun_or_an_orientation_that_contradicts_gravity_explains_noise_of_the_gyro() -> None:
    noise, loud = (Warn("gyro-noise-raised", "drifts", fatal=fatal) for fatal in (False, True))
    sun, order = Warn("sun-reference", "stands elsewhere"), Warn("orientation-order", "x, y, z, w", fatal=True)
    assert foremost((sun, noise)) == (sun,)
    assert foremost((sun, loud)) == (sun, loud)
    assert foremost((order, loud)) == (order,)
    bias = Warn("accel-bias", "closes with a bias")
    assert foremost((sun, bias)) == (bias,)
    scale = Warn("gyro-scale", "closes with 0.5 times its rate", fatal=True)
    assert foremost((loud, scale)) == (scale,)
    assert foremost((loud,)) == (loud,)


def test_beside_another_imu_it_is_asked_whether_the_magnetometer_is_fixed_to_that(rng: np.random.Generator) -> None:
    t, gyro, down = drive(rng)
    field = Fixes("magnetometer", "mag", t[::5], 0.005 * down[::5, [1, 0, 2]] * [-1.0, 1.0, 1.0])
    alone, beside = (of_field(field, Imu(t, gyro, down), others=others)[0].hint for others in (False, True))
    assert "--columns" in alone
    assert "other IMU" in beside


@pytest.mark.parametrize(("times", "told"), [(1.0, []), (3.0, []), (57.3, ["gyro-scale"]), (0.1, ["gyro-scale"])])
def test_a_field_that_turns_far_more_than_the_gyro_says_tells_its_unit(
    times: float, told: list[str], rng: np.random.Generator
) -> None:
    t, gyro, down = drive(rng)
    field = Fixes("magnetometer", "mag", t[::5], 0.005 * down[::5])
    assert [w.code for w in of_field(field, Imu(t, gyro / times, down))] == told
