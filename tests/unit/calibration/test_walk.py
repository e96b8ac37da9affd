from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.fft import dst
from support import still

from attest_cli.calibration.rest import Blocks, cut, means
from attest_cli.calibration.walk import Walk, best, build_walk, likely_walk, walk_interval

PERIOD = 0.1
PIECES = [still.piece(23, PERIOD), still.piece(11, PERIOD, 6.0, 1), still.piece(30, PERIOD, 8.05, 2)]


def sample_covariances(blocks: Blocks, edges: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """White and walk covariance of the block means, from the samples one by one (N = K = 1)."""
    t = np.concatenate([p.t for p in PIECES])
    M = np.zeros((len(blocks.t), len(t)))
    row = start = 0
    for edge in edges:
        for a, b in itertools.pairwise(edge):
            M[row, start + a : start + b] = 1.0 / (b - a)
            row += 1
        start += int(edge[-1])
    return M @ M.T / PERIOD, M @ np.minimum.outer(t - t[0], t - t[0]) @ M.T


def dense(parts: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    return np.diag(parts[0]) + np.diag(parts[1], 1) + np.diag(parts[1], -1)


@pytest.mark.parametrize("length", [PERIOD, 0.4, 1.0, 2.5])
@pytest.mark.parametrize("level", [True, False])
def test_the_tridiagonal_covariance_is_that_of_the_samples(length: float, level: bool) -> None:
    blocks, edges = cut(PIECES, length)
    white, walk = sample_covariances(blocks, edges)
    D = np.diff(np.eye(len(blocks.t)), axis=0)
    if level:
        D = np.vstack([np.eye(len(blocks.t))[:1], D])
    made = build_walk(blocks, level=level)
    np.testing.assert_allclose(dense(made.white), D @ white @ D.T, atol=1e-12)
    np.testing.assert_allclose(dense(made.walk), D @ walk @ D.T, atol=1e-12)


def test_differences_between_stops_are_left_out_on_demand() -> None:
    blocks, edges = cut(PIECES, 0.4)
    white, walk = sample_covariances(blocks, edges)
    D = np.diff(np.eye(len(blocks.t)), axis=0)[np.diff(blocks.stop) == 0]
    made = build_walk(blocks, level=False, across=False)
    np.testing.assert_allclose(dense(made.white), D @ white @ D.T, atol=1e-12)
    np.testing.assert_allclose(dense(made.walk), D @ walk @ D.T, atol=1e-12)
    z = np.random.default_rng(0).normal(size=len(blocks.t))
    np.testing.assert_allclose(made.differences(z), D @ z)


def by_hand(walk: Walk, ratio: float, z: np.ndarray, X: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """-2 ln L, coefficients and their covariance with dense matrices."""
    V = dense(walk.white) + ratio * dense(walk.walk)
    V_inv = np.linalg.inv(V)
    cov = np.linalg.inv(X.T @ V_inv @ X)
    beta = cov @ X.T @ V_inv @ z
    r = z - X @ beta
    variance = r @ V_inv @ r / len(z)
    return len(z) * np.log(variance) + np.linalg.slogdet(V)[1], beta, cov * variance


@pytest.mark.parametrize("ratio", [0.0, 1e-3, 0.3])
def test_generalised_least_squares_and_its_score(ratio: float) -> None:
    blocks, _ = cut(PIECES, 0.4)
    walk = build_walk(blocks, level=True)
    z = np.random.default_rng(2).normal(size=len(blocks.t))
    X = walk.differences(np.stack([np.ones_like(blocks.t), blocks.t], axis=1))
    fit = walk.fit(ratio, walk.differences(z), X)
    value, beta, cov = by_hand(walk, ratio, walk.differences(z), X)
    assert fit.value == pytest.approx(value, rel=1e-12)
    np.testing.assert_allclose(fit.beta, beta, rtol=1e-9)
    np.testing.assert_allclose(fit.cov, cov, rtol=1e-9)
    if ratio:
        h = 1e-5
        values = [by_hand(walk, ratio * np.exp(x), walk.differences(z), X)[0] for x in (h, -h)]
        assert fit.score == pytest.approx((values[0] - values[1]) / (2 * h), rel=1e-6, abs=1e-8)


def test_single_samples_without_gaps_have_the_likelihood_of_the_dst() -> None:
    rng = np.random.default_rng(3)
    rate = still.walking(rng, 4000, PERIOD, 0.01, 2e-3)
    blocks, _ = cut([still.piece(4000, PERIOD)], PERIOD)
    walk = build_walk(blocks, level=False)
    z = walk.differences(rate)
    y = dst(z, type=1, norm="ortho")
    for K in (0.0, 5e-4, 2e-3):
        fit = walk.fit((K / 0.01) ** 2, z)
        eigenvalues = (
            2.0 * (1.0 - np.cos(np.pi * np.arange(1, 4000) / 4000)) / PERIOD + fit.ratio * PERIOD
        )  # of V with N = 1
        variance = np.mean(y**2 / eigenvalues)
        assert fit.value == pytest.approx(3999 * np.log(variance) + np.log(eigenvalues).sum(), rel=1e-12)
        assert pytest.approx(np.sqrt(variance), rel=1e-12) == fit.N


def test_no_random_walk_is_found_in_white_noise_that_has_less_than_it_should() -> None:
    z = np.random.default_rng(0).normal(size=2000)
    low = np.fft.rfft(z)
    low[:200] *= 0.3  # less power at low frequencies: a walk could only add
    blocks, _ = cut([still.piece(2000, PERIOD)], PERIOD)
    walk = build_walk(blocks, level=False)
    rows = walk.differences(np.fft.irfft(low, 2000))
    found = best(walk, rows)
    assert found.ratio == 0.0
    low_K, high_K = walk_interval(walk, rows, found)
    assert low_K == 0.0
    assert 0.0 < high_K < np.inf
    mean, sigma = likely_walk(walk, rows, found)
    assert 0.0 < mean < high_K
    assert 0.0 < sigma < high_K


def test_the_interval_is_where_the_likelihood_says() -> None:
    rate = still.walking(np.random.default_rng(5), 4000, PERIOD, 0.01, 2e-3)
    blocks, edges = cut([still.piece(4000, PERIOD)], 0.4)
    walk = build_walk(blocks, level=False)
    z = walk.differences(means([rate], edges))
    found = best(walk, z)
    assert found.score == pytest.approx(0.0, abs=1e-6)
    for K in walk_interval(walk, z, found):
        ratios = np.geomspace(found.ratio / 30, found.ratio * 30, 4001)
        fits = [walk.fit(r, z) for r in ratios]
        near = min(fits, key=lambda f: abs(f.walk - K))
        assert near.value - found.value == pytest.approx(3.84, abs=0.05)
