"""Calibration against many drawn truths: estimates as good as they can be, intervals that hold as often as they say.

Limits are binomial or chi-square at 99.99 %.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom, chi2
from support import still

from attest_cli.calibration import bias
from attest_cli.calibration.allan import allan_deviation
from attest_cli.calibration.bias import choose, fit_models
from attest_cli.calibration.noise import fit_noise
from attest_cli.calibration.records import NoiseFit
from attest_cli.calibration.rest import Blocks, cut, means
from attest_cli.calibration.walk import build_walk
from attest_cli.calibration.whiteness import judge_whiteness

Array = NDArray[np.float64]
SEEDS = 120
RARE = 1e-4


def often_enough(held: int, of: int, rate: float) -> bool:
    """Whether ``held`` of ``of`` agrees with ``rate``, both ways."""
    return bool(binom.ppf(RARE / 2, of, rate) <= held <= binom.ppf(1.0 - RARE / 2, of, rate))


def hold(found: list[NoiseFit], N: float, K: float) -> tuple[int, int]:
    in_N = sum(f.N_interval[0] <= N <= f.N_interval[1] for f in found)
    in_K = sum(f.K_interval is not None and f.K_interval[0] <= K <= f.K_interval[1] for f in found)
    return in_N, in_K


def test_two_hours_give_the_densities() -> None:
    found = []
    for seed in range(8):
        rate = still.walking(np.random.default_rng([seed, 20]), 144_000, 0.05, 0.01, 2e-4)
        found.append(fit_noise([still.piece(len(rate), 0.05)], [rate], 1, across=True))
    N, K = np.array([f.N for f in found]), np.array([f.K for f in found], dtype=float)
    print(f"N {np.std(N / 0.01 - 1):.2%} largest {np.abs(N / 0.01 - 1).max():.2%}, K {np.std(K / 2e-4 - 1):.1%}")
    assert np.abs(N / 0.01 - 1.0).max() < 0.01
    assert np.abs(K / 2e-4 - 1.0).max() < 0.35


@pytest.mark.parametrize("K", [3e-3, 4e-4, 0.0], ids=["seen", "hardly seen", "none"])
def test_intervals_of_a_static_record_hold_as_often_as_they_say(K: float) -> None:
    found = []
    for seed in range(SEEDS):
        rate = still.walking(np.random.default_rng([seed, 21, round(1e5 * K)]), 3000, 0.1, 0.01, K)
        found.append(fit_noise([still.piece(3000, 0.1)], [rate], 1, across=True))
    in_N, in_K = hold(found, 0.01, K)
    print(f"K {K}: 95 % intervals hold N {in_N / SEEDS:.1%}, K {in_K / SEEDS:.1%}")
    assert often_enough(in_N, SEEDS, 0.95)
    if K:
        assert often_enough(in_K, SEEDS, 0.95)
    else:  # at the bound of what can be, half of the interval's misses cannot happen
        assert often_enough(in_K, SEEDS, 0.975)
        assert often_enough(sum(f.K is None for f in found), SEEDS, 0.975)


def test_intervals_of_a_drive_hold_as_often_as_they_say() -> None:
    found = []
    for seed in range(SEEDS):
        drive = still.stops(np.random.default_rng([seed, 22]), "random walk", minutes=20.0, hz=10.0)
        found.append(fit_noise(drive.pieces, drive.rates, 1, across=True))
    in_N, in_K = hold(found, 0.01, 5e-4)
    print(f"drive: 95 % intervals hold N {in_N / SEEDS:.1%}, K {in_K / SEEDS:.1%}")
    assert often_enough(in_N, SEEDS, 0.95)
    assert often_enough(in_K, SEEDS, 0.95)


def test_the_band_of_the_allan_deviation_holds_as_often_as_it_says() -> None:
    m = np.array([1, 10, 100, 400])
    held = np.zeros(len(m), dtype=int)
    truth = np.sqrt(0.01**2 / (0.1 * m) + (1e-3) ** 2 * 0.1 * (2.0 * m**2 + 1.0) / (6.0 * m))  # sums over samples
    for seed in range(SEEDS):
        rng = np.random.default_rng([seed, 23])
        pieces = [still.walking(rng, n, 0.1, 0.01, 1e-3) for n in (1500, 700)]
        found = allan_deviation(pieces, 0.1, m, (1e-3 / 0.01) ** 2)
        held += (found.low <= truth) & (truth <= found.high)
    print(f"Allan band holds {held / SEEDS}")
    for count in held:
        assert often_enough(int(count), SEEDS, 0.95)


def exponential(blocks: Blocks, z: Array) -> bias._Trial:
    """The exponential alone."""
    trial, why = bias._fit_exponential(build_walk(blocks, level=True), blocks, z)
    assert trial is not None, why
    return trial


def test_parameters_of_the_exponential_scatter_as_their_covariance_says() -> None:
    total, n = 0.0, 100
    for seed in range(n):
        rng = np.random.default_rng([seed, 24])
        t = 0.5 * np.arange(4000)
        rate = still.warm_up(t, 0.05, 0.1, 300.0) + rng.normal(0.0, 0.02, len(t))
        blocks, edges = cut([still.piece(len(t), 0.5)], 10.0)
        found = exponential(blocks, means([rate], edges))
        error = found.values - [0.05, 0.1, 300.0]
        total += float(error @ np.linalg.solve(found.fit.cov, error))
    print(f"NEES of C1, C2, T: {total / n:.2f} of 3")
    low, high = (float(chi2.ppf(q, 3 * n)) for q in (RARE / 2, 1.0 - RARE / 2))
    assert low < total < 1.1 * high  # T is not quite Gaussian


@pytest.mark.parametrize(("true", "right"), [("random walk", "random-walk"), ("exponential", "exponential")])
def test_a_drive_gets_its_bias_with_a_sigma_that_holds(true: str, right: str) -> None:
    squares, chosen, n = [], 0, 12
    for seed in range(n):
        drive = still.stops(np.random.default_rng([seed, 25]), true, hz=10.0)
        blocks, edges = cut(drive.pieces, 1.0)
        models, _ = fit_models(blocks, means(drive.rates, edges))
        name = choose(models, static=False)
        chosen += name == right
        model = models[name].model
        squares.append(np.mean(((model.fitted - np.interp(blocks.t, drive.t, drive.bias)) / model.sigma) ** 2))
    print(f"{true}: {right} chosen {chosen} of {n}, error over sigma {np.sqrt(np.mean(squares)):.2f}")
    assert chosen >= 0.9 * n
    assert 0.6 < np.sqrt(np.mean(squares)) < 1.3


def test_the_residual_of_the_right_model_is_white_and_of_a_wrong_one_is_not() -> None:
    right = wrong = raw = 0
    n = 60
    for seed in range(n):
        rng = np.random.default_rng([seed, 26])
        t = 0.1 * np.arange(18_000)
        rate = still.warm_up(t, 0.1, 0.2, 400.0) + rng.normal(0.0, 0.05, len(t))
        blocks, edges = cut([still.piece(len(t), 0.1)], 6.0)
        z = means([rate], edges)
        right += judge_whiteness([z - exponential(blocks, z).curve], 6.0).white
        wrong += judge_whiteness([z - z.mean()], 6.0).white
        raw += judge_whiteness([rate], 0.1).white
    print(f"white: exponential {right} of {n}, constant {wrong}, raw samples {raw}")
    assert right >= 0.9 * n
    assert wrong == 0
    assert raw == 0
