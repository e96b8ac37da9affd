"""Coloured errors against the differential equation that they stand for."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_lyapunov

from attest_cli.filters.navigation import colours
from attest_cli.filters.navigation.states import CORE, Layout, State, layout

DRIFT, RATE = State("gps drift", 3, 0.7, 60.0), State("gps drift rate", 3, 0.3, 5.0, "gps drift")


def form(*states: State) -> Layout:
    return layout([*(State(name, 3, 1.0) for name in CORE), *states])


def equation() -> tuple[np.ndarray, np.ndarray]:
    """Return what the drifts and their rates do, ``A`` (6, 6), and the density of what drives them."""
    A, eye = np.zeros((6, 6)), np.eye(3)
    A[:3, :3], A[:3, 3:], A[3:, 3:] = -eye / 60.0, eye, -eye / 5.0
    return A, np.diag([2.0 * 0.7**2 / 60.0] * 3 + [2.0 * 0.3**2 / 5.0] * 3)


@pytest.mark.parametrize("span", [1e-3, 0.1, 2.0, 40.0])
def test_a_drift_with_a_rate_goes_on_as_its_equation(span: float) -> None:
    A, _ = equation()
    found = colours.fading(form(DRIFT, RATE), np.array([0.5, span]))[1]
    np.testing.assert_allclose(found, expm(A * span), atol=1e-12)


def test_it_stays_where_its_equation_keeps_it() -> None:
    A, density = equation()
    made = form(DRIFT, RATE)
    P = colours.steady(np.diag(made.prior()), made)
    np.testing.assert_allclose(P[15:, 15:], solve_continuous_lyapunov(A, -density), rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(P[:15, :15], np.eye(15))


@pytest.mark.parametrize("span", [1e-3, 0.1, 2.0])
def test_its_noise_is_the_integral_of_what_drives_it(span: float) -> None:
    A, density = equation()
    at = (np.arange(400) + 0.5) * span / 400
    summed = sum(expm(A * s) @ density @ expm(A * s).T for s in at) * span / 400
    found = colours.driving(form(DRIFT, RATE), np.array([span]))[0]
    np.testing.assert_allclose(found, summed, rtol=1e-4, atol=1e-12)
    assert np.linalg.eigvalsh(found).min() > 0.0


def test_a_plain_error_is_a_gauss_markov_one_and_none_is_none() -> None:
    made = form(State("height drift", 1, 2.0, 600.0))
    kept = np.exp(-30.0 / 600.0)
    np.testing.assert_allclose(colours.fading(made, np.array([30.0])), [[[kept]]])
    np.testing.assert_allclose(colours.driving(made, np.array([30.0])), [[[4.0 * (1.0 - kept**2)]]])
    assert colours.driving(form(), np.ones(2)).shape == (2, 0, 0)


def test_where_it_is_loose_more_drives_it_and_its_rate() -> None:
    span, factors = np.array([0.1, 0.3, 2.0]), np.array([1.0, 9.0, 4.0])
    usual = colours.driving(form(DRIFT, RATE), span)
    made = form(DRIFT, RATE).loosened({"gps drift": factors, "gps drift rate": factors})
    np.testing.assert_allclose(colours.driving(made, span), usual * factors[:, None, None], rtol=1e-12)
    part = made.scaled({"gps drift": 2.0}).within(slice(1, 2))
    np.testing.assert_allclose(colours.driving(part, span[1:2])[0, 3:, 3:], 9.0 * usual[1, 3:, 3:], rtol=1e-12)
