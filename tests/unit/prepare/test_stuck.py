"""Stuck axes: told from rest, from coarse sensors, from clipping and from simulations without noise."""

from __future__ import annotations

import numpy as np
import pytest

from attest_cli.prepare.stuck import dead, stuck, told_coarse, told_numb, told_unlike

T = np.arange(4000) / 100.0


def values(rng: np.random.Generator) -> np.ndarray:
    return np.sin(T[:, None] * [0.5, 0.7, 0.9]) + rng.normal(0.0, 0.01, (4000, 3))


def test_a_held_value_is_stuck_from_its_first_repeat(rng: np.random.Generator) -> None:
    x = values(rng)
    x[1000:1100, 1] = x[1000, 1]
    found = stuck(T, x)
    assert np.flatnonzero(found[1]).tolist() == list(range(1001, 1100))
    assert not found[0].any()
    assert not found[2].any()


@pytest.mark.parametrize("end", [2600, 4000])
def test_a_value_held_at_rest_is_stuck(end: int, rng: np.random.Generator) -> None:
    x = np.where(T[:, None] < 24.0, values(rng), rng.normal(0.0, 1e-4, (4000, 3)))  # far below a usual step
    x[2500:end, 2] = x[2500, 2]
    found = stuck(T, x)
    assert np.flatnonzero(found[2]).tolist() == list(range(2501, end))
    assert not found[0].any()


@pytest.mark.parametrize("seed", range(3))
def test_noise_is_never_stuck(seed: int) -> None:
    assert not np.any(stuck(T, values(np.random.default_rng(seed))))


def test_a_few_repeats_are_a_slower_sensor() -> None:
    x = values(np.random.default_rng(1))[np.arange(4000) // 5 * 5]
    assert not np.any(stuck(T, x))


@pytest.mark.parametrize("step", [0.02, 0.05])
def test_a_coarse_sensor_at_rest_is_not_stuck(step: float, rng: np.random.Generator) -> None:
    x = np.where(T[:, None] > 20.0, values(rng), rng.normal(0.0, 0.001, (4000, 3)))  # and moves off with a jerk
    assert not np.any(stuck(T, np.round(x / step) * step))


def test_a_simulation_without_noise_comes_to_rest() -> None:
    ramp = np.clip((T - 10.0) / 5.0, 0.0, 1.0)
    x = np.outer(np.sin(T) * ramp**3 * (10.0 + ramp * (6.0 * ramp - 15.0)), np.ones(3))
    assert not np.any(stuck(T, x))


def test_the_end_of_the_range_is_not_stuck(rng: np.random.Generator) -> None:
    assert not np.any(stuck(T, np.clip(values(rng), -0.9, 0.9)))


def test_a_constant_column_is_dead_beside_others() -> None:
    assert dead(np.array([[0.0, 1.0], [0.0, 2.0]])).tolist() == [True, False]
    assert not dead(np.ones((2, 3))).any()


def test_a_rounded_gyro_is_told(rng: np.random.Generator) -> None:
    gyro = values(rng)
    assert told_coarse("log", gyro) == []
    assert [w.code for w in told_coarse("log", np.round(gyro, 2))] == ["gyro-coarse"]


def shaken(seed: int = 3, rows: int = 12000) -> tuple[np.ndarray, np.ndarray]:
    """Times and a gyro (n, 3) at rest and in motion by turns: noise, and what shakes all axes twenty times as much."""
    rng = np.random.default_rng(seed)
    t = np.arange(rows) * 0.01
    gyro = rng.normal(0.0, 1e-3, (rows, 3))
    gyro[t % 20.0 > 8.0] *= 20.0
    return t, gyro


class TestAnAxisThatHoldsNothingButNoise:
    NAMES = ("gyro_x", "gyro_y", "gyro_z")

    @pytest.mark.parametrize("axis", [0, 2])
    @pytest.mark.parametrize("level", [1e-4, 1e-3, 5e-3])
    def test_is_named_with_its_time(self, axis: int, level: float) -> None:
        t, gyro = shaken()
        gyro[5000:, axis] = np.random.default_rng(1).normal(0.3, level, len(t) - 5000)
        (warning,) = told_numb("log", self.NAMES, t, gyro)
        assert (warning.code, warning.fatal) == ("imu-stuck", True)
        assert f"nothing but noise in {self.NAMES[axis]} from 50 s on" in warning.message

    def test_none_is_told_of_sound_axes_and_of_what_may_be_the_motion(self) -> None:
        t, gyro = shaken()
        assert not told_numb("log", self.NAMES, t, gyro)
        back, never, all_calm, short = (gyro.copy() for _ in range(4))
        back[3000:9000, 2] /= 20.0  # it measures again: the motion was smooth
        never[:, 2] = np.random.default_rng(1).normal(0.0, 1e-3, len(t))  # from the start: level ground
        all_calm[5000:] = np.random.default_rng(2).normal(0.0, 1e-3, (len(t) - 5000, 3))  # it stands
        short[-300:, 2] /= 20.0
        for other in (back, never, all_calm, short):
            assert not told_numb("log", self.NAMES, t, other)


class TestAnAxisInAnotherUnit:
    NAMES = ("gyro_x", "gyro_y", "gyro_z")

    @pytest.mark.parametrize("axis", [0, 2])
    @pytest.mark.parametrize("times", [57.29578, 1 / 57.29578, 40.0])
    def test_is_named(self, axis: int, times: float) -> None:
        _, gyro = shaken()
        gyro[:, axis] *= times
        (warning,) = told_unlike("log", self.NAMES, gyro)
        assert (warning.code, warning.fatal) == ("unit-contradicted", times > 1.0)  # a better sensor is no fault
        assert f"{self.NAMES[axis]} is" in warning.message

    def test_none_is_told_of_axes_that_differ_as_axes_do(self) -> None:
        _, gyro = shaken()
        lively, still, noisy, each, rounded, few = (gyro.copy() for _ in range(6))
        lively[:, 2] = np.where(np.abs(gyro[:, 0]) > 4e-3, 57.0, 1.0) * gyro[:, 2]  # of the motion, not of the axis
        still[gyro.std(axis=1) > 4e-3, 2] /= 20.0
        noisy[:, 1] *= 10.0
        each *= np.array([1.0, 7.0, 57.0])  # no two are alike
        rounded = np.round(rounded * np.array([1.0, 1.0, 57.0]), 2)
        smooth = np.outer(np.sin(np.arange(len(gyro)) * 0.01), [1.0, 1.0, 57.0])  # a simulation without noise
        for other in (gyro, lively, still, noisy, each, rounded, smooth, (few * np.array([1.0, 1.0, 57.0]))[:500]):
            assert told_unlike("log", self.NAMES, other) == []
