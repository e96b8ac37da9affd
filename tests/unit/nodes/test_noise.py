"""Noise from the log's own stops."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from support.drives import simulated

from attest_cli.nodes.noise import (
    ASSUMED_ACCEL_DENSITY,
    ASSUMED_GYRO_DENSITY,
    ASSUMED_GYRO_WALK,
    ASSUMED_SCALE,
    Noise,
    bias_walk,
    density,
    find_noise,
    motion_density,
    reference_bias,
)
from attest_cli.records import Segmentation
from attest_cli.simulate import RoverOptions
from attest_cli.simulate.rover import ACCEL_NOISE, GYRO_NOISE

Array = NDArray[np.float64]


def test_density_of_white_noise_at_any_rate(rng: np.random.Generator) -> None:
    for dt in (0.005, 0.02):
        blocks = [(1e-3 / np.sqrt(dt) * rng.normal(size=(round(60 / dt), 3)) + 5.0, dt) for _ in range(3)]
        assert density(blocks) == pytest.approx(1e-3, rel=0.1)


def test_a_low_pass_does_not_hide_noise(rng: np.random.Generator) -> None:
    dt, n = 0.005, 24000
    white = 1e-3 / np.sqrt(dt) * rng.normal(size=(n + 40, 3))
    filtered = np.stack([np.convolve(white[:, i], np.ones(20) / 20, "valid") for i in range(3)], axis=1)
    assert density([(filtered, dt)]) == pytest.approx(1e-3, rel=0.2)
    per_sample = np.sqrt(np.mean(np.diff(filtered, axis=0) ** 2) / 2 * dt)
    assert per_sample < 3e-4  # what one sample alone would have said


def test_too_little_rest_says_nothing() -> None:
    assert density([]) is None
    assert density([(np.ones((5, 3)), 0.01)]) is None
    assert density([(np.ones((500, 3)), 0.01)]) is None  # a sensor without noise is a broken one


def test_bias_walk_of_a_walk(rng: np.random.Generator) -> None:
    walk, n_r = 1e-4, 1e-8
    times = np.arange(200) * 100.0
    spans = np.full(200, 10.0)
    means = np.cumsum(walk * 10.0 * rng.normal(size=(200, 3)), axis=0) + np.sqrt(n_r / 10.0) * rng.normal(size=(200, 3))
    assert bias_walk(means, times, spans, n_r) == pytest.approx(walk, rel=0.15)
    assert bias_walk(means[:1], times[:1], spans[:1], n_r) == pytest.approx(ASSUMED_GYRO_WALK)
    still = np.sqrt(n_r / 10.0) * rng.normal(size=(200, 3))
    assert bias_walk(still, times, spans, n_r) < 0.5 * ASSUMED_GYRO_WALK


def test_noise_of_a_drive_is_the_simulators() -> None:
    over = {"gyro_noise_density": None, "gyro_random_walk": None, "accel_noise_density": None}
    work = simulated(RoverOptions(seed=31, motions=4, motion_s=(20.0, 30.0)), imu=over)
    assert work.noise.gyro_density == pytest.approx(GYRO_NOISE, rel=0.15)
    assert work.noise.accel_density == pytest.approx(ACCEL_NOISE, rel=0.15)
    assert work.noise.sources["gyro_noise_density"] == "log's stops"
    assert work.noise.n_r == work.noise.gyro_density**2
    assert work.noise.n_w == work.noise.gyro_walk**2


@pytest.mark.parametrize(("stated", "scale", "source"), [(None, ASSUMED_SCALE, "assumed"), (0.0, 0.0, "settings")])
def test_a_stated_density_is_no_word_on_the_scale(stated: float | None, scale: float, source: str) -> None:
    work = simulated(RoverOptions(seed=31, motions=1, motion_s=(20.0, 30.0)), imu={"gyro_scale_sigma": stated})
    assert work.noise.sources["gyro_noise_density"] == "settings"
    assert (work.noise.gyro_scale, work.noise.sources["gyro_scale_sigma"]) == (scale, source)


def test_settings_come_first_and_assumptions_last() -> None:
    work = simulated(
        RoverOptions(seed=31, motions=1, motion_s=(20.0, 30.0)),
        imu={"gyro_noise_density": 7e-4, "accel_noise_density": None},
    )
    assert work.noise.gyro_density == 7e-4
    assert work.noise.sources["gyro_noise_density"] == "settings"
    s = work.segmentation
    nothing = Segmentation(s.motions, s.statistic, s.enter, s.leave, s.bias_b, s.margin, s.source)
    imu = work.settings.imu.model_copy(update={"gyro_noise_density": None, "gyro_random_walk": None})
    found = find_noise(work.log, nothing, work.settings.model_copy(update={"imu": imu}))
    assert (found.gyro_density, found.gyro_walk, found.accel_density) == (
        ASSUMED_GYRO_DENSITY,
        ASSUMED_GYRO_WALK,
        ASSUMED_ACCEL_DENSITY,
    )
    assert set(found.sources.values()) >= {"assumed"}


def test_reference_bias_lies_between_the_stops() -> None:
    work = simulated(RoverOptions(seed=32, motions=2, motion_s=(30.0, 40.0)))
    t = work.log.imu.t
    at = np.linspace(t[0], t[-1], 50)
    true = np.stack([np.interp(at, t, work.gyro_bias[:, i]) for i in range(3)], axis=1)
    assert np.abs(reference_bias(work.log, work.segmentation, at) - true).max() < 4 * GYRO_NOISE / np.sqrt(9.0) + 2e-4
    s = work.segmentation
    blind = Segmentation(s.motions, s.statistic, s.enter, s.leave, s.bias_b, s.margin, s.source)
    assert np.array_equal(reference_bias(work.log, blind, at), np.tile(s.bias_b, (50, 1)))


def test_a_scale_error_counts_as_noise_of_the_rate() -> None:
    noise = Noise(1e-3, 1e-5, 1e-3, {}, gyro_scale=0.01)
    rate = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -2.0]])
    found = motion_density(noise, rate)
    assert found[0] == noise.n_r
    assert (found[2] - noise.n_r) == pytest.approx(4 * (found[1] - noise.n_r))
    assert np.all(motion_density(Noise(1e-3, 1e-5, 1e-3, {}), rate) == noise.n_r)
