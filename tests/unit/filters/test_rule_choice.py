"""The choice of the acceleration noise: white, coloured and sparse accelerations of known make."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from attest_cli.filters.acceleration import Rule
from attest_cli.filters.rule_choice import (
    CAUTION,
    GRID,
    GYRO_GRID,
    Carried,
    Choice,
    choose,
    constant,
    frames,
    levelled,
    rough,
    rules_to_try,
    vertical,
)
from attest_cli.maths import rotation

Array = NDArray[np.float64]
T, N = 0.005, 24_000
GYRO = 1e-6  # (rad/s)^2/Hz
QUIET = 1e-7  # 1/Hz
OUTSIDE = 1e-4  # share of good runs that a statistical limit refuses


def level(side: Array, seed: int, gyro: float = GYRO, still: int = 0) -> Carried:
    """A body that is level but for its gyro's drift, with sideways accelerations (n, 2), a share of g."""
    rng = np.random.default_rng([seed, 99])
    drift = np.cumsum(rng.normal(0.0, np.sqrt(gyro * T), (N, 2)), axis=0)
    noise = rng.normal(0.0, np.sqrt(QUIET / T), (N, 3))
    force = np.column_stack([drift + side, np.ones(N)]) + noise
    at_rest = np.arange(N) < still
    return Carried(np.tile([1.0, 0, 0, 0], (N, 1)), force, T, at_rest, np.full(N - 1, GYRO * T), GYRO, QUIET)


def chosen(c: Carried) -> Choice:
    return choose(c, rules_to_try(c), constant(c, rough(c)))


def white(density: float, seed: int) -> Array:
    return np.random.default_rng(seed).normal(0.0, np.sqrt(density / T), (N, 2))


@pytest.mark.parametrize("density", [3e-6, 3e-4])
def test_white_accelerations_are_found_for_what_they_are(density: float) -> None:
    c = level(white(density, 1), 1)
    rules, before = [Rule("constant", np.nan)], constant(c, rough(c))
    found = choose(c, rules, before, GYRO_GRID[:1])
    windows = 2 * N * T / found.span / 1.06  # two components each; neighbours share a sixth
    low, high = chi2.ppf([OUTSIDE / 2, 1 - OUTSIDE / 2], windows) / windows
    told, true = found.rule.density, density + QUIET
    print(f"density {told / true:.2f} of the true one, band {low:.2f} to {high:.2f}")
    cautious = chi2.ppf(CAUTION, windows) / windows  # the quantile told
    assert low < told / true < high * cautious * GRID
    assert choose(c, rules, before).gyro < 2.0


def test_accelerations_that_are_given_back_count_for_little() -> None:
    """A velocity that stays bounded: the samples' spread is that of a density a hundred times larger."""
    velocity = white(1e-6, 2) * T
    side = np.diff(velocity, axis=0, prepend=0.0) / T * 20.0
    c = level(side, 2)
    found = chosen(c)
    spread = float(np.var(side)) * T
    print(f"{found.rule}; spread of the samples alone {spread:.2g}")
    assert found.rule.kind == "constant"
    assert found.rule.density < 0.02 * spread


def test_sparse_impulses_are_left_out() -> None:
    rng = np.random.default_rng(3)
    side = np.zeros((N, 2))
    for first in rng.integers(0, N - 5, 120):
        side[first : first + 5] += rng.normal(0.0, 1.0, 2)
    c = level(side, 3)
    found, plain = chosen(c), choose(c, [Rule("constant", np.nan)], constant(c, rough(c)))
    print(found.rule, f"sigma {found.sigma / plain.sigma:.2f} of the constant rule's")
    assert found.rule.kind != "constant"
    assert found.sigma < 0.5 * plain.sigma
    assert (found.density[np.abs(side).max(axis=1) > 0.5] > 10 * found.rule.density).all()


@pytest.mark.parametrize("times", [1.0, 9.0])
def test_a_gyro_noisier_than_told_is_seen(times: float) -> None:
    c = level(white(1e-5, 4), 4, gyro=times * GYRO)
    found = choose(c, [Rule("constant", np.nan)], constant(c, rough(c)))
    print(f"factor {found.gyro:.2f}")
    assert found.gyro == pytest.approx(times, rel=0.5)


def test_what_is_stated_stays() -> None:
    c = level(white(1e-5, 5), 5)
    rules = [Rule("switching", 4e-6, 0.3, 0.1)]
    found = choose(c, rules, constant(c, rough(c)), GYRO_GRID[:1])
    assert found.rule == rules[0]
    assert found.gyro == 1.0


def test_at_stops_the_accelerometer_counts_in_full() -> None:
    c = level(white(1e-3, 6), 6, still=4000)
    found = chosen(c)
    assert (found.density[:4000] == QUIET).all()
    cells, _, P = vertical(c, found)
    assert P[cells.first < 3000].max() < 0.05 * P[cells.first > 8000].min()


@pytest.mark.parametrize("seconds", [0.2, 1.0, 3.0])
def test_a_record_too_short_to_judge_is_told_cautiously(seconds: float) -> None:
    n = round(seconds / T)
    c = level(white(1e-4, 7), 7)
    short = Carried(c.q[:n], c.force_n[:n], T, c.still[:n], c.walk[: n - 1], GYRO, QUIET)
    found = choose(short, rules_to_try(short), constant(short, rough(short)))
    assert np.isfinite(found.density).all()
    assert found.rule.density > 1e-4  # as if what was seen could last a second


def test_frames_follow_the_gyro_and_begin_anew_after_a_gap() -> None:
    rng = np.random.default_rng(8)
    turns = rng.normal(0.0, 0.02, (400, 3))
    q = frames(turns)
    assert q[0].tolist() == [1.0, 0.0, 0.0, 0.0]
    steps = rotation.log_quaternion(rotation.multiply(rotation.conjugate(q[:-1]), q[1:]))
    assert np.abs(steps - turns).max() < 1e-12
    up_0 = np.tile([0.6, -0.64, 0.48], (401, 1))
    up_0[200:] = [-0.36, 0.48, 0.8]  # turned over in the hole
    y = rotation.rotate(rotation.conjugate(q), up_0)
    gap = np.arange(400) == 199
    found = levelled(q, y, gap)
    assert np.abs(rotation.rotate(found, y) - [0.0, 0.0, 1.0]).max() < 1e-9
    assert np.abs(rotation.rotate(levelled(q, y, np.zeros(400, np.bool_)), y) - [0.0, 0.0, 1.0]).max() > 0.1
