"""The warming gyro: exact heading, the bias of the paper, courses and stops as stated."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.signals import accel_of, assert_variance, gyro_bias_of, gyro_of, stack

from attest_cli.errors import AttestError
from attest_cli.prepare import prepare
from attest_cli.segment import find_segments
from attest_cli.settings import Settings
from attest_cli.simulate import GyrostarOptions, Simulation, simulate_gyrostar
from attest_cli.simulate.drive import GRAVITY_M_S2
from attest_cli.simulate.gyrostar import COURSES, GYRO_NOISE_RAD_S, SHARE, Course, gyro_bias

PERIOD = 0.03


def heading(simulation: Simulation) -> np.ndarray:
    q = stack(simulation.truth, "q_w", "q_x", "q_y", "q_z")
    return np.unwrap(Rotation.from_quat(q, scalar_first=True).as_euler("ZYX")[:, 0])


def clean_rate(simulation: Simulation) -> np.ndarray:
    """Measured rate without bias and noise: that of the same seed on a course at rest has both."""
    return gyro_of(simulation) - gyro_of(simulate_gyrostar(at_rest(simulation)))


def at_rest(simulation: Simulation) -> GyrostarOptions:
    return GyrostarOptions(seed=5, course="static", duration_s=simulation.truth["t_s"].size * PERIOD)


@pytest.mark.parametrize("course", COURSES)
@pytest.mark.parametrize("stops", [False, True])
def test_the_trapezoid_of_the_clean_gyro_is_the_true_heading(course: Course, stops: bool) -> None:
    simulation = simulate_gyrostar(GyrostarOptions(seed=5, course=course, stops=stops))
    assert simulation.truth["t_s"].size == 20_000
    rate = clean_rate(simulation)
    np.testing.assert_allclose(rate[:, :2], 0.0, atol=1e-15)
    summed = np.concatenate([[0.0], np.cumsum((rate[1:, 2] + rate[:-1, 2]) / 2 * PERIOD)])
    np.testing.assert_allclose(summed, heading(simulation), atol=1e-10 if course == "platform" else 1e-4)
    assert np.ptp(heading(simulation)) > 0.2 or course == "static"


def test_the_bias_is_that_of_the_paper_and_integrates_to_its_error() -> None:
    simulation = simulate_gyrostar(GyrostarOptions(seed=1))
    t, bias = simulation.truth["t_s"], np.degrees(gyro_bias_of(simulation))
    np.testing.assert_allclose(bias[:, 2], 0.153 * (1 - np.exp(-t / 338.4)) - 0.264, rtol=1e-12)
    np.testing.assert_allclose(bias / bias[:, 2:], np.tile(SHARE, (t.size, 1)), rtol=1e-12)
    assert np.sum(bias[:, 2]) * PERIOD == pytest.approx(-109.6, abs=0.1)


def test_scatter_and_random_walk_are_those_asked_for() -> None:
    found = [gyro_bias(GyrostarOptions(seed=seed, scatter=0.15), np.zeros(1))[1] for seed in range(300)]
    nominal = np.array([math.radians(0.153), math.radians(-0.264), 338.4])
    assert_variance(np.array(found) / nominal - 1.0, 0.15)
    t = PERIOD * np.arange(20_000)
    walked, plain = (gyro_bias(GyrostarOptions(random_walk_deg_s=walk), t)[0] for walk in (5e-4, 0.0))
    assert_variance(np.diff(walked - plain, axis=0), math.radians(5e-4) * math.sqrt(PERIOD))
    np.testing.assert_allclose(walked[0], plain[0])


def test_noise_is_as_stated_and_the_imu_is_level() -> None:
    simulation = simulate_gyrostar(GyrostarOptions(seed=2, course="static"))
    assert_variance(gyro_of(simulation) - gyro_bias_of(simulation), GYRO_NOISE_RAD_S)
    assert_variance(accel_of(simulation) - [0.0, 0.0, GRAVITY_M_S2], 0.02)
    assert not simulation.truth["moving"].any()
    assert simulation.stops.tolist() == [[0.0, pytest.approx(599.97)]]
    truck = simulate_gyrostar(GyrostarOptions(seed=2))
    shaking = np.where(truck.truth["moving"], 0.3, 0.02)[:, None]
    assert_variance(accel_of(truck) - [0.0, 0.0, GRAVITY_M_S2], shaking)


def test_the_truck_turns_gently_and_straight_pieces_lie_between() -> None:
    turning = np.degrees(np.gradient(heading(simulate_gyrostar(GyrostarOptions(seed=4, duration_s=3600.0))), PERIOD))
    edges = np.flatnonzero(np.diff((np.abs(turning) > 1e-9).astype(int)))
    turns, straights = np.diff(edges)[0::2] * PERIOD, np.diff(edges)[1::2] * PERIOD
    assert 150 < turns.size < 230  # 21.5 s each on average
    assert 5.5 < turns.min() < turns.max() < 20.2
    assert 1.8 < straights.min() < straights.max() < 15.2
    peaks = [np.abs(turning[a:b]).max() for a, b in zip(edges[0::2], edges[1::2], strict=False)]
    assert_variance(np.array(peaks) * np.random.default_rng(0).choice([-1, 1], len(peaks)), 4.5)


def test_the_platform_steps_between_the_stated_rates() -> None:
    simulation = simulate_gyrostar(GyrostarOptions(seed=4, course="platform", duration_s=3600.0))
    rate = np.degrees(np.diff(heading(simulation)) / PERIOD)
    moving = np.abs(rate) > 1e-6
    levels = np.abs(rate[moving & (np.abs(np.gradient(rate)) < 1e-9)])
    assert levels.min() >= 5.0
    assert levels.max() <= 30.0
    assert 0.2 < np.mean(~moving) < 0.5
    assert len(np.unique(np.round(levels, 6))) > 150


@pytest.mark.parametrize("course", ["truck", "platform"])
def test_the_stops_of_each_minute_are_found(course: Course) -> None:
    simulation = simulate_gyrostar(GyrostarOptions(seed=6, course=course, stops=True))
    settings = Settings.model_validate(simulation.settings)
    found = np.array([[s.start, s.end] for s in find_segments(prepare([simulation.log], settings), settings).stops])
    for minute in range(10):
        at_rest = np.array([60.0 * minute, 60.0 * minute + 10.0])
        assert np.any((found[:, 0] < at_rest[0] + 0.8) & (found[:, 1] > at_rest[1] - 0.8))
    assert not simulation.truth["moving"][np.mod(simulation.truth["t_s"], 60.0) < 9.99].any()
    if course == "truck":
        np.testing.assert_allclose(found, simulation.stops, atol=0.8)


def test_a_seed_fixes_every_bit() -> None:
    one, again = (simulate_gyrostar(GyrostarOptions(seed=7)) for _ in range(2))
    assert gyro_of(one).tobytes() == gyro_of(again).tobytes()
    assert accel_of(one).tobytes() == accel_of(again).tobytes()
    other = simulate_gyrostar(GyrostarOptions(seed=8))
    assert np.abs(heading(one) - heading(other)).max() > 0.1


@pytest.mark.parametrize(
    ("option", "value"),
    [("course", "boat"), ("scatter", -0.1), ("scatter", 0.5), ("random_walk_deg_s", math.nan), ("duration_s", 0.0)],
)
def test_options_out_of_reach_are_refused(option: str, value: Any) -> None:
    with pytest.raises(AttestError, match="choose"):
        GyrostarOptions(**{option: value})
