"""Spikes: what stands alone is found; what vibrates, turns fast or rings is not."""

from __future__ import annotations

import numpy as np
import pytest

from attest_cli.prepare.spikes import ACCEL_FLOOR, AROUND, GYRO_BURST, spikes


def still(n: int = 2000, seed: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).normal((0.0, 0.0, 9.8), 0.05, (n, 3))


@pytest.mark.parametrize("rows", [[0], [1], [1999], [1000], [500, 501], [500, 502], [3, 40, 900]])
@pytest.mark.parametrize("size", [25.0, -1e9])
def test_spikes_are_found_and_nothing_else(rows: list[int], size: float) -> None:
    values = still()
    values[rows, 1] += size
    assert np.flatnonzero(spikes(values, ACCEL_FLOOR)).tolist() == rows


def test_outliers_in_a_fifth_of_the_rows_are_found_with_a_wide_median() -> None:
    values, rng = still(), np.random.default_rng(5)
    off = rng.random(len(values)) < 0.2
    values[off] += rng.uniform(5.0, 20.0, (np.count_nonzero(off), 3))
    found = spikes(values, 1.0, AROUND)
    assert np.count_nonzero(found & off) > 0.8 * np.count_nonzero(off)
    assert not np.any(found & ~off)


def test_a_sample_below_the_floor_is_left() -> None:
    values = still()
    values[1000, 0] += 15.0
    assert not spikes(values, ACCEL_FLOOR).any()


def test_a_shock_that_rings_is_no_spike() -> None:
    values, t = still(), np.arange(40)
    for start in range(100, 1900, 97):
        values[start : start + 40, 2] += 150.0 * np.exp(-t / 3.0) * np.cos(2.0 * t)
    assert not spikes(values, ACCEL_FLOOR).any()


@pytest.mark.parametrize("sigma", [3.0, 30.0])
def test_rough_ground_is_no_spike(sigma: float) -> None:
    values = np.random.default_rng(4).standard_t(4, (50_000, 3)) * sigma
    assert not spikes(values, ACCEL_FLOOR).any()


def test_a_step_stays() -> None:
    values = still(400)
    values[200:] += 80.0
    assert not spikes(values, ACCEL_FLOOR).any()


@pytest.mark.parametrize("n", [0, 1, 8])
def test_a_log_too_short_has_none(n: int) -> None:
    assert spikes(np.full((n, 3), 1e9), 1.0).tolist() == [False] * n


@pytest.mark.parametrize("rows", [[700], [700, 701], [700, 701, 702], [700, 701, 702, 703]])
def test_a_burst_is_found_by_a_wider_median_and_a_knock_is_none(rows: list[int]) -> None:
    rate, t = np.random.default_rng(6).normal(0.0, 0.002, (2000, 1)), np.arange(2000)
    knock = 3.0 * np.exp(-(((t - 1500) / 3.0) ** 2))[:, None]
    assert not spikes(rate + knock, GYRO_BURST, AROUND).any()
    rate[rows] += 5.0
    assert np.flatnonzero(spikes(rate, GYRO_BURST, AROUND)).tolist() == rows
