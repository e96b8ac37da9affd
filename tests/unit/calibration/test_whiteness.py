from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, chi2
from support import still

from attest_cli.calibration.whiteness import judge_whiteness, lagged_products


def test_the_reference_vector() -> None:
    v = still.vectors("barshan_lm")
    found = judge_whiteness([v["resid"]], 0.3)
    assert len(found.rho) == int(v["M"])
    np.testing.assert_allclose(found.rho, v["rho"], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.band, 1.96 / np.sqrt(6000))
    assert found.inside == pytest.approx(float(v["frac_in"]))
    assert found.ljung_box == pytest.approx(float(v["Q_lb"]), rel=1e-9)
    assert found.probability == pytest.approx(float(v["p_lb"]), rel=1e-8)
    assert found.white
    raw = judge_whiteness([v["e"]], 0.3)
    assert raw.inside == float(v["raw_frac_in"])
    assert raw.ljung_box == pytest.approx(float(v["raw_Q"]), rel=1e-9)
    assert not raw.white


def test_lags_cross_no_gap() -> None:
    rng = np.random.default_rng(0)
    pieces = [rng.normal(size=n) for n in (40, 25, 90)]
    found = judge_whiteness(pieces, 1.0)
    assert len(found.rho) == 90 // 4
    centred = [x - np.concatenate(pieces).mean() for x in pieces]
    variance = np.mean(np.concatenate(centred) ** 2)
    statistic = 0.0
    for k in range(1, len(found.rho) + 1):
        long = [x for x in centred if len(x) >= 4 * k]
        N, pairs = sum(len(x) for x in long), sum(len(x) - k for x in long)
        rho = sum(float(x[:-k] @ x[k:]) for x in long) / (variance * N)
        assert found.rho[k - 1] == pytest.approx(rho, abs=1e-12)
        assert found.band[k - 1] == pytest.approx(1.96 / np.sqrt(N))
        statistic += N * (N + 2) * rho**2 / pairs
    assert found.ljung_box == pytest.approx(statistic)
    assert found.probability == pytest.approx(chi2.sf(statistic, len(found.rho)))


def test_lagged_products_are_the_sums() -> None:
    x = np.random.default_rng(1).normal(size=37)
    np.testing.assert_allclose(lagged_products(x, 9), [x[:-k] @ x[k:] for k in range(1, 10)], atol=1e-12)


def test_too_little_to_judge_is_said_by_no_lags() -> None:
    assert judge_whiteness([np.array([1.0, -1.0, 1.0])], 1.0).rho.size == 0
    assert not judge_whiteness([np.zeros(100)], 1.0).white


def test_white_noise_passes_as_often_as_stated_and_a_slow_one_does_not() -> None:
    passed = slow = 0
    for seed in range(200):
        x = np.random.default_rng([seed, 5]).normal(size=400)
        passed += judge_whiteness([x[:250], x[250:]], 1.0).white
        slow += judge_whiteness([x + 2.0 * np.sin(np.arange(400) / 100.0)], 1.0).white
    assert passed >= binom.ppf(1e-4, 200, 0.98)  # each test fails 1 % of white noise at most
    assert slow == 0
