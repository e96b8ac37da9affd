"""What stamps that scatter cost: the noise of a shaking sensor whose samples are even covers it."""

from __future__ import annotations

import numpy as np
import pytest

from attest_cli.prepare.jitter import jittered


def shaking(t: np.ndarray, rng: np.random.Generator, fastest_hz: float) -> np.ndarray:
    return 0.3 * np.sin(2 * np.pi * rng.uniform(0.2, fastest_hz, 3) * t[:, None] + rng.uniform(0.0, 6.0, 3))


def test_even_stamps_cost_nothing(rng: np.random.Generator) -> None:
    t = np.arange(6000) / 50.0
    assert jittered(t, shaking(t, rng, 15.0)) is None
    assert jittered(np.delete(t, np.r_[100:6000:60]), shaking(t, rng, 15.0)[:5901]) is None


@pytest.mark.parametrize("sigma", [1e-3, 3e-3])
@pytest.mark.parametrize("fastest_hz", [2.0, 15.0])
def test_the_density_covers_the_walk_of_the_angle(sigma: float, fastest_hz: float, rng: np.random.Generator) -> None:
    t, errors, claimed = np.arange(3000) / 50.0, [], []
    for _ in range(40):
        gyro = shaking(t, rng, fastest_hz)
        late = t + rng.normal(0.0, sigma, len(t))
        density = jittered(late, gyro)
        assert density is not None
        errors.append(np.trapezoid(gyro, late, axis=0) - np.trapezoid(gyro, t, axis=0))
        claimed.append(np.mean(density**2) * t[-1])
    assert 0.3 < np.mean(np.square(errors)) / np.mean(claimed) < 1.1  # the axis that shakes most is claimed for all


def test_samples_that_scatter_themselves_cost_nothing(rng: np.random.Generator) -> None:
    t = np.sort(np.arange(6000) / 100.0 + rng.normal(0.0, 1e-3, 6000))
    assert jittered(t, shaking(t, rng, 2.0) + rng.normal(0.0, 1e-4, (6000, 3))) is None


@pytest.mark.parametrize("rate", [100.0, 128.0])
def test_stamps_that_scatter_late_in_a_long_log_are_judged_there(rate: float, rng: np.random.Generator) -> None:
    even = np.arange(210_000) / rate
    late = even[-1] + np.cumsum(1.0 / rate + rng.uniform(-0.2, 0.2, 30_000) / rate)
    t = np.concatenate([even, late])
    assert jittered(t, shaking(np.arange(len(t)) / rate, rng, 2.0)) is not None


@pytest.mark.parametrize("steps", [(0.001, 0.009), (0.001, 0.001, 0.001, 0.037)])
def test_steps_of_two_sizes_are_no_scatter(steps: tuple[float, ...], rng: np.random.Generator) -> None:
    t = np.append(0.0, np.cumsum(np.tile(steps, 400)))
    assert jittered(t, rng.normal(0.0, 1e-3, (len(t), 3))) is None
