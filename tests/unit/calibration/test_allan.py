from __future__ import annotations

import numpy as np
import pytest
from support import still

from attest_cli.calibration.allan import allan_deviation, averaging_times, equivalent_dof


def test_the_reference_vector_and_allantools() -> None:
    v = still.vectors("allan")
    found = allan_deviation([v["rate"]], 1.0 / float(v["fs"]), v["m"].astype(np.int64))
    np.testing.assert_allclose(found.deviation, v["adev"], rtol=1e-12)
    np.testing.assert_allclose(found.deviation, v["adev_allantools"], rtol=1e-12)
    np.testing.assert_allclose(found.tau, v["tau"], rtol=1e-12)
    np.testing.assert_array_equal(found.n, v["n"])


def test_terms_are_pooled_over_pieces_and_none_crosses_a_gap() -> None:
    rng = np.random.default_rng(0)
    pieces = [rng.normal(size=n) + level for n, level in ((40, 0.0), (7, 50.0), (25, -20.0))]
    m = np.array([1, 3, 10])
    found = allan_deviation(pieces, 0.5, m)
    for k, width in enumerate(m):
        squares = [
            (x[i + width : i + 2 * width].mean() - x[i : i + width].mean()) ** 2
            for x in pieces
            for i in range(len(x) - 2 * width + 1)
        ]
        assert found.n[k] == len(squares)
        assert found.deviation[k] == pytest.approx(np.sqrt(np.mean(squares) / 2.0), rel=1e-10)


@pytest.mark.parametrize(
    ("lengths", "m", "K"), [((60,), 4, 0.0), ((60,), 15, 0.3), ((40, 25, 33), 6, 0.1), ((50,), 25, 1.0)]
)
def test_degrees_of_freedom_are_those_of_the_quadratic_form(lengths: tuple[int, ...], m: int, K: float) -> None:
    mean = square = 0.0
    for n in lengths:  # a term is c' x; of Gaussian x, E = tr C and var = 2 tr C C of the terms' covariance C
        terms = n - 2 * m + 1
        c = np.zeros((terms, n))
        for i in range(terms):
            c[i, i : i + m], c[i, i + m : i + 2 * m] = -1.0 / m, 1.0 / m
        x = np.eye(n) + K**2 * np.minimum.outer(np.arange(n), np.arange(n))  # unit steps
        C = c @ x @ c.T
        mean, square = mean + np.trace(C), square + np.trace(C @ C)
    found = equivalent_dof(np.array([n - 2 * m + 1 for n in lengths]), m, (K * m) ** 2)
    assert found == pytest.approx(mean**2 / square, rel=1e-9 if K == 0.0 else 0.01)  # the walk in continuous time


def test_the_band_is_wider_where_less_is_known() -> None:
    found = allan_deviation([still.walking(np.random.default_rng(1), 2000, 0.01, 0.01, 0.0)], 0.01)
    assert np.all(found.low < found.deviation)
    assert np.all(found.deviation < found.high)
    assert found.high[-1] / found.deviation[-1] > 3.0 * found.high[0] / found.deviation[0]


def test_averaging_times_are_log_spaced_up_to_half_the_record() -> None:
    m = averaging_times(10_000)
    assert m[0] == 1
    assert m[-1] == 5000
    assert np.all(np.diff(m) > 0)
    assert averaging_times(2).tolist() == [1]
