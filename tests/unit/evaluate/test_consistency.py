"""NEES and coverage on errors drawn from what is claimed, and on claims that are wrong by two."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import chdtri
from scipy.stats import binom, norm

from attest_cli.evaluate.consistency import BAND, CLAIMED, band_width, coverage, holds, independent, nees

N = 4000
OUTSIDE = 1e-4


def covariances(rng: np.random.Generator, k: int, n: int = N) -> np.ndarray:
    a = rng.normal(size=(n, k, k))
    return np.asarray(a @ a.swapaxes(1, 2) + 0.1 * np.eye(k))


def errors(rng: np.random.Generator, P: np.ndarray) -> np.ndarray:
    return np.einsum("nij,nj->ni", np.linalg.cholesky(P), rng.normal(size=P.shape[:2]))


def inside(share: float, p: float, n: int = N) -> bool:
    low, high = binom.ppf([OUTSIDE / 2, 1 - OUTSIDE / 2], n, p) / n
    return bool(low <= share <= high)


@pytest.mark.parametrize("k", [1, 2, 3])
def test_nees_of_honest_claims_is_its_degrees_of_freedom(rng: np.random.Generator, k: int) -> None:
    P = covariances(rng, k)
    found = nees(errors(rng, P), P)
    low, high = chdtri(k * N, 1 - OUTSIDE / 2) / N, chdtri(k * N, OUTSIDE / 2) / N
    assert low < found.mean < high
    assert inside(found.inside, BAND)
    assert (found.dof, found.count) == (k, N)


@pytest.mark.parametrize("factor", [0.25, 4.0])
def test_a_claim_wrong_by_four_is_seen(rng: np.random.Generator, factor: float) -> None:
    P = covariances(rng, 3)
    found = nees(errors(rng, P), factor * P)
    assert found.mean == pytest.approx(3.0 / factor, rel=0.1)
    assert not inside(found.inside, BAND)


def test_what_is_not_known_is_left_out(rng: np.random.Generator) -> None:
    P = covariances(rng, 3)
    P[:100] = np.nan
    P[100:150, 0, :] = P[100:150, :, 0] = 0.0  # sigma zero
    P[150:200] = np.ones((3, 3))  # singular
    assert nees(errors(rng, covariances(rng, 3)), P).count == N - 200
    nothing = nees(np.zeros((5, 3)), np.zeros((5, 3, 3)))
    assert nothing.count == 0
    assert np.isnan(nothing.mean)


def test_coverage_of_honest_claims_is_gaussian(rng: np.random.Generator) -> None:
    sigma = rng.uniform(0.1, 3.0, N)
    found = coverage(sigma * rng.normal(size=N), sigma)
    assert found is not None
    for share, k in zip(found.sigma, (1, 2, 3), strict=True):
        assert inside(share, float(norm.cdf(k) - norm.cdf(-k)))
    assert inside(found.band, BAND)
    for share, level in zip(found.found, CLAIMED, strict=True):
        assert inside(float(share), float(level))
    assert holds(found)
    assert found.independent > 0.7 * N


def test_a_sigma_half_as_large_as_it_should_be_does_not_hold(rng: np.random.Generator) -> None:
    found = coverage(rng.normal(size=N), np.full(N, 0.5))
    assert found is not None
    assert not holds(found)
    assert found.band == pytest.approx(norm.cdf(0.98) - norm.cdf(-0.98), abs=0.03)
    wide = coverage(rng.normal(size=N), np.full(N, 2.0))
    assert wide is not None
    assert holds(wide)


def test_no_sigma_no_coverage() -> None:
    assert coverage(np.ones(5), np.full(5, np.nan)) is None
    assert coverage(np.ones(5), np.zeros(5)) is None


def test_the_band_is_that_of_a_gaussian() -> None:
    assert band_width() == pytest.approx(norm.ppf(0.975), abs=1e-9)


def test_a_constant_error_is_one_error() -> None:
    assert independent(np.full(N, 1.7)) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("a", [0.9, 0.99])
def test_memory_counts_as_bartlett_says(a: float) -> None:
    """Of a first-order process n (1 - a^2) / (1 + a^2) squares are independent."""
    found = []
    for seed in range(20):
        white = np.random.default_rng(seed).normal(size=20_000)
        series = np.empty_like(white)
        series[0] = white[0]
        for k in range(1, white.size):
            series[k] = a * series[k - 1] + np.sqrt(1 - a**2) * white[k]
        found.append(independent(series))
    assert float(np.mean(found)) == pytest.approx(20_000 * (1 - a**2) / (1 + a**2), rel=0.15)


def test_few_independent_errors_are_not_condemned() -> None:
    """One constant heading error of 1.7 sigma lies outside its band nowhere or everywhere: it is one draw."""
    found = coverage(np.full(N, 2.2), np.ones(N))
    assert found is not None
    assert found.band == 0.0
    assert holds(found)
    far = coverage(np.full(N, 3.5), np.ones(N))
    assert far is not None
    assert not holds(far)
