"""The written-out chi-square against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from attest_cli.maths import consistency


@pytest.mark.parametrize("dof", [1, 2, 3, 4, 5, 6, 33, 600, 1197, 10_800])
def test_density_and_tails(dof: int) -> None:
    x = dof * np.array([0.5, 0.9, 1.0, 1.1, 1.5])
    np.testing.assert_allclose(consistency.density(x, dof), chi2.pdf(x, dof), rtol=1e-9)
    np.testing.assert_allclose([consistency.survival(v, dof) for v in x], chi2.sf(x, dof), rtol=1e-9)


@pytest.mark.parametrize("dof", [1, 2, 3, 6, 7, 597, 1197, 10_800])
@pytest.mark.parametrize("probability", [1 - 5e-5, 0.975, 0.5, 0.025, 1e-4, 1e-6])
def test_upper_quantile(dof: int, probability: float) -> None:
    assert consistency.upper_quantile(dof, probability) == pytest.approx(chi2.isf(probability, dof), rel=1e-8)


def test_an_error_that_lasts_stands_out_of_white_noise() -> None:
    """However wide the stated sigma: a wander of half a sigma is three of ten readings together."""
    rng = np.random.default_rng(1)
    white = rng.normal(size=(400, 2))
    square, sums = consistency.lasting(white)
    assert sums == 40
    assert consistency.noise_status(square, sums, 2) == "PASS"
    drifting = 0.3 * white + np.linspace(-1.0, 1.0, 400)[:, None]
    square, sums = consistency.lasting(drifting)
    assert square > 4.0
    assert consistency.noise_status(square, sums, 2) != "PASS"
    assert consistency.lasting(white[:9]) == (0.0, 0)


def test_passes_agree_as_chance_has_it(rng: np.random.Generator) -> None:
    assert all(consistency.agree(rng.normal(size=n)) for n in (1, 2, 4, 9, 200) for _ in range(500))
    assert consistency.agree([])
    assert consistency.agree(1.1 * rng.normal(size=4000))  # sure, and of no consequence
    assert not consistency.agree([2.1, 0.3, -6.0, 0.1])
    for n, far in ((6, 5.6), (18, 6.8), (60, 9.0)):  # of all others nothing is to be said
        assert not consistency.agree([far, *np.sign(rng.normal(size=n - 1))])
    assert not consistency.agree(2.0 * rng.normal(size=40))
