"""What a lost sample costs: the noise of the samples beside it covers what the bridge over it misses."""

from __future__ import annotations

import numpy as np
import pytest

from attest_cli.prepare.clock import in_order
from attest_cli.prepare.lost import bridged, missing, without_sentinels


def shaking(rng: np.random.Generator, n: int = 20_000) -> tuple[np.ndarray, np.ndarray]:
    t = np.arange(n) / 50.0
    return t, 0.05 * np.sin(2 * np.pi * rng.uniform(3.0, 15.0, 3) * t[:, None] + rng.uniform(0.0, 6.0, 3))


def test_nothing_lost_is_nothing_said(rng: np.random.Generator) -> None:
    t, gyro = shaking(rng)
    assert bridged(t, gyro, 0.5) is None
    assert bridged(t + rng.normal(0.0, 1e-3, len(t)), gyro, 0.5) is None


def test_the_density_is_that_of_the_error(rng: np.random.Generator) -> None:
    t, gyro = shaking(rng)
    for lost in (1, 3):
        keep = np.ones(len(t), dtype=bool)
        at = np.arange(50, len(t) - 50, 100)
        for k in range(lost):
            keep[at + k] = False
        density = bridged(t[keep], gyro[keep], 0.5)
        assert density is not None
        inner = sum(gyro[at + k] for k in range(lost))
        error = (inner - 0.5 * lost * (gyro[at - 1] + gyro[at + lost])) / 50.0  # rad, of each hole
        before = np.searchsorted(t[keep], t[at - 1])
        claimed = density[before] ** 2 * ((lost + 1) / 50.0 + 1 / 50.0)
        assert 0.7 < np.mean(error**2) / np.mean(claimed) < 1.4
        assert np.count_nonzero(density) == 2 * len(at)


def test_longer_holes_are_gaps(rng: np.random.Generator) -> None:
    t, gyro = shaking(rng, 1000)
    keep = (t < 5.0) | (t > 6.0)
    assert bridged(t[keep], gyro[keep], 0.5) is None


def test_the_share_of_lost_samples_is_that_taken_away(rng: np.random.Generator) -> None:
    stamps_ns = np.arange(20_000) * 10_000_000
    for share in (0.02, 0.1, 0.3):
        keep = rng.random(len(stamps_ns)) > share
        assert abs(missing(stamps_ns[keep], 0.5) - share) < 0.02
    assert missing(np.delete(stamps_ns, np.r_[500:900]), 0.5) == 0.0  # a gap


@pytest.mark.parametrize("tick_ms", [1.0, 4.0, 10.0, 15.625])
@pytest.mark.parametrize("rate", [50, 104, 200, 333, 416])
def test_stamps_rounded_to_ticks_have_lost_nothing(rate: int, tick_ms: float, rng: np.random.Generator) -> None:
    for jitter in (0.0, 0.3):
        t = np.sort(np.arange(3000) / rate + rng.normal(0.0, jitter / rate, 3000))
        for rounded in (np.round, np.floor):
            stamps_ns = np.rint(rounded(t * 1e3 / tick_ms) * tick_ms * 1e6).astype(np.int64)
            found = in_order("log", stamps_ns, rng.normal(size=(3000, 1)), 0)
            assert missing(found.stamps_ns, 0.5) < 0.01


@pytest.mark.parametrize(("rate", "tick_ms"), [(104, 1.0), (119, 1.0), (208, 1.0), (256, 2.0), (100, 10.0)])
def test_samples_lost_between_ticks_are_seen(rate: int, tick_ms: float, rng: np.random.Generator) -> None:
    t = np.arange(12_000)[rng.random(12_000) > 0.05] / rate
    stamps_ns = np.rint(np.round(t * 1e3 / tick_ms) * tick_ms * 1e6).astype(np.int64)
    assert 0.015 < missing(stamps_ns, 0.5) < 0.06


def stamped(t: np.ndarray, tick_s: float) -> np.ndarray:
    return np.rint((np.floor(t / tick_s + 1e-9) * tick_s if tick_s else t) * 1e9).astype(np.int64)


@pytest.mark.parametrize("rate", [25, 50, 100, 104, 119, 200, 256, 333, 400])
@pytest.mark.parametrize("tick_s", [0.0, 0.001, 0.004, 0.008, 0.01, 0.016])
def test_lost_samples_are_counted_and_none_where_none_is_lost(rate: int, tick_s: float) -> None:
    rng, n = np.random.default_rng(5), 8000
    lost = {f"{share:.0%}": rng.random(n) < share for share in (0.01, 0.03, 0.1, 0.3, 0.4)}
    in_turn = {f"every {k}.": np.arange(n) % k == 2 for k in (3, 10)}
    burst = {"bursts": (np.convolve(rng.random(n) < 0.02, np.ones(5)) > 0)[:n]}
    for jitter in (0.0, 0.03, 0.1):
        t = np.sort(1.0 + (np.arange(n) + rng.normal(0.0, jitter, n)) / rate)
        clean = in_order("log", stamped(t, tick_s), rng.normal(size=(n, 1)), 0).stamps_ns
        assert missing(clean, 1.0) < 0.008
        if tick_s * rate > 0.48 - jitter:  # single and double steps run into each other
            continue
        turns = in_turn if jitter < 0.1 or not tick_s else {}  # then they are not seen to be in turn
        for name, gone in (lost | turns | burst).items():
            share = float(gone.mean())
            assert abs(missing(stamped(t[~gone], tick_s), 1.0) - share) < share / 3.0 + 0.002, (jitter, name)


def smooth(t: np.ndarray, rng: np.random.Generator, noise: float = 1e-3) -> np.ndarray:
    w, phase = rng.uniform(0.6, 12.0, (2, 5, 1, 3))  # up to 2 Hz
    return 0.3 * np.sum(np.sin(w * t[:, None] + phase), axis=0) + rng.normal(0.0, noise, (len(t), 3))


@pytest.mark.parametrize(("rate", "tick_s"), [(125, 0.008), (125, 0.004), (100, 0.0), (50, 0.0), (25, 0.01)])
def test_a_sample_lost_in_turn_shows_in_smooth_values(rate: int, tick_s: float, rng: np.random.Generator) -> None:
    t = 1.0 + np.arange(8000)[np.arange(8000) % 5 != 2] / rate  # stamps as of 4/5 of the rate, on ticks
    assert missing(stamped(t, tick_s), 1.0) < 0.01
    assert missing(stamped(t, tick_s), 1.0, 0, rng.normal(size=(len(t), 3))) < 0.01
    assert missing(stamped(t, tick_s), 1.0, 0, smooth(t, rng)) == pytest.approx(0.2, abs=0.01)


@pytest.mark.parametrize(("rate", "tick_s"), [(100, 0.008), (104, 0.008), (91, 0.01), (200, 0.004)])
def test_ticks_of_most_of_a_period_hide_no_loss_in_smooth_values(
    rate: int, tick_s: float, rng: np.random.Generator
) -> None:
    t = 1.0 + np.arange(12_000) / rate
    assert missing(stamped(t, tick_s), 1.0, 0, smooth(t, rng)) < 0.004
    for share in (0.03, 0.1):
        t = 1.0 + np.arange(12_000)[rng.random(12_000) > share] / rate
        assert missing(stamped(t, tick_s), 1.0) > 1.5 * share
        assert 0.4 * share < missing(stamped(t, tick_s), 1.0, 0, smooth(t, rng)) < 1.2 * share


@pytest.mark.parametrize("sigma", [3e-4, 1e-3, 3e-3])
def test_a_poor_clock_of_an_even_sensor_has_lost_nothing(sigma: float, rng: np.random.Generator) -> None:
    t = 1.0 + np.arange(12_000) / 100.0
    values = smooth(t, rng)
    late = np.sort(t + rng.normal(0.0, sigma, len(t)))
    i = np.arange(len(t))
    for stamps in (
        late,
        1.0 + i // 8 * 0.08 + i % 8 * 0.001,
        1.0 + i // 4 * 0.04 + np.array([0, 1, 3, 4])[i % 4] * 1e-3,
    ):
        assert missing(stamped(stamps, 0.0), 1.0, 0, values) < 0.01


@pytest.mark.parametrize("first", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("rates", [(100.0, 50.0), (50.0, 100.0), (200.0, 50.0), (100.0, 80.0)])
def test_another_rate_is_no_loss(first: float, rates: tuple[float, float], rng: np.random.Generator) -> None:
    steps = np.repeat(1.0 / np.array(rates), [round(10_000 * first), round(10_000 * (1.0 - first))])
    t = np.cumsum(steps)
    assert missing(stamped(t, 0.0), 1.0) < 0.005
    assert 0.066 < missing(stamped(t[rng.random(len(t)) > 0.1], 0.0), 1.0) < 0.12


def test_steps_of_no_even_clock_and_bursts_are_no_loss(rng: np.random.Generator) -> None:
    assert missing(stamped(np.cumsum(rng.uniform(0.004, 0.016, 12_000)), 0.0), 1.0) < 0.005
    i = np.arange(12_000)
    for size, step in ((10, 0.001), (8, 0.0005), (4, 0.002)):
        assert missing(stamped(i // size * size * 0.01 + i % size * step, 0.0), 1.0) < 0.005


def test_a_log_of_many_rates_ends(rng: np.random.Generator) -> None:
    steps = np.repeat(0.001 * rng.integers(1, 200, 400), 25)
    assert 0.0 <= missing(stamped(np.cumsum(steps), 0.0), 1.0) < 1.0


def test_a_clock_that_is_late_has_lost_nothing(rng: np.random.Generator) -> None:
    stamps_ns = np.arange(20_000) * 10_000_000
    late = rng.random(len(stamps_ns)) < 0.1
    assert missing(np.sort(stamps_ns + late * 9_000_000), 0.5) < 0.01
    assert missing(np.sort(stamps_ns + rng.normal(0.0, 3e6, len(stamps_ns)).astype(np.int64)), 0.5) < 0.01


def test_numbers_are_not_sentinels_where_they_are_measured(rng: np.random.Generator) -> None:
    values = rng.normal(0.0, 300.0, (1000, 3))
    values[::20, 0] = 999.0  # a range that ends there
    same, said = without_sentinels(values)
    assert same is values
    assert said == ""
    values = rng.normal(0.0, 0.1, (1000, 3))
    values[500, 1] = 9999.0  # once: a spike
    assert without_sentinels(values)[0] is values
