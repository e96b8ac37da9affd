"""The reducer keeps what can be seen, splits at gaps, and never scales to what it should not."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from attest_cli.figures import reduce


def spiky(n: int = 50_000) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    y = rng.standard_normal(n)
    y[rng.integers(0, n, 20)] *= 50.0
    return np.sort(rng.uniform(0.0, 100.0, n)), y


def test_envelope_keeps_minimum_and_maximum_of_every_column():
    t, y = spiky()
    tr, yr = reduce.envelope(t, y, 0.0, 100.0, 700)
    assert tr.size <= 2 * 700 + 2
    assert (np.diff(tr) >= 0).all()
    column, kept = (t * 7.0).astype(int), (tr * 7.0).astype(int)
    for k in range(0, 700, 13):
        assert yr[kept == k].min() == y[column == k].min()
        assert yr[kept == k].max() == y[column == k].max()


def test_envelope_points_are_samples_at_their_own_times():
    t, y = spiky()
    tr, yr = reduce.envelope(t, y, 0.0, 100.0, 700)
    index = np.searchsorted(t, tr)
    assert_array_equal(t[index], tr)
    assert_array_equal(y[index], yr)
    assert (tr[0], tr[-1]) == (t[0], t[-1])


def test_few_samples_are_left_alone():
    t, y = np.arange(10.0), np.arange(10.0) ** 2
    assert_array_equal(reduce.envelope(t, y, 0.0, 9.0, 944)[1], y)


def test_band_is_never_narrower_than_its_samples():
    t, y = spiky()
    tr, low, high = reduce.band_envelope(t, y - 1.0, y + 1.0, 0.0, 100.0, 500)
    assert tr.size == low.size == high.size <= 501
    assert low.min() == y.min() - 1.0
    assert high.max() == y.max() + 1.0


def test_column_mean_is_the_mean():
    t = np.arange(1000.0)
    at, mean = reduce.column_mean(t, t**2, 0.0, 1000.0, 10)
    np.testing.assert_allclose(mean, [np.mean(t[k * 100 : k * 100 + 100] ** 2) for k in range(10)])
    np.testing.assert_allclose(at, 49.5 + 100.0 * np.arange(10))


def test_pieces_split_at_nan_and_at_breaks():
    known = np.array([True, True, False, True, True, True, False, True])
    breaks = np.zeros(8, dtype=bool)
    breaks[4] = True
    assert reduce.pieces(known, breaks) == [slice(0, 2), slice(3, 5), slice(5, 6), slice(7, 8)]
    assert reduce.pieces(np.zeros(3, dtype=bool), breaks[:3]) == []


def test_a_gap_of_the_log_is_a_break():
    t = np.concatenate((np.arange(0.0, 10.0, 0.1), np.arange(30.0, 40.0, 0.1)))
    assert np.flatnonzero(reduce.break_after(t, np.array([[9.9, 30.0]]))).tolist() == [99]
    assert np.flatnonzero(reduce.break_after(t, np.array([[9.95, 29.99], [50.0, 60.0]]))).tolist() == [99]


def test_wide_nodes_at_a_stop_are_no_break():
    t = np.concatenate((np.arange(0.0, 10.0, 0.1), np.arange(10.0, 40.0, 1.0), np.arange(40.0, 50.0, 0.1)))
    assert not reduce.break_after(t, np.empty((0, 2))).any()


@pytest.mark.parametrize(("first", "expected"), [(179.0, 179.0), (181.0, -179.0), (-180.0, 180.0), (725.0, 5.0)])
def test_unwrapped_yaw_starts_within_half_a_turn(first, expected):
    yaw = np.array([first, np.nan, first + 170.0, first + 340.0 - 720.0])
    out = reduce.unwrap_deg(yaw)
    np.testing.assert_allclose(out[[0, 2, 3]] - expected, [0.0, 170.0, 340.0], atol=1e-9)
    assert np.isnan(out[1])


def test_differences_are_folded_before_anything_else():
    np.testing.assert_allclose(reduce.wrap_deg(np.array([359.0, -190.0, 720.5])), [-1.0, 170.0, 0.5])


def test_limit_ignores_what_happens_outside_motion():
    moving = np.ones(1000, dtype=bool)
    moving[:50] = False
    difference = np.full(1000, 0.2)
    difference[:50] = 90.0
    limit = reduce.robust_limit([difference], np.full(1000, 0.05), moving)
    assert limit == pytest.approx(0.2)
    assert reduce.robust_limit([difference], np.full(1000, 0.3), moving) == pytest.approx(0.66)
    assert np.isnan(reduce.robust_limit([], np.full(3, np.nan), moving[:3]))


def test_dense_tells_a_filled_panel_from_a_line():
    t = np.linspace(0.0, 100.0, 100_000)
    assert reduce.is_dense(t, np.sin(3000.0 * t), 0.0, 100.0, 500, 2.5)
    assert not reduce.is_dense(t, np.sin(t), 0.0, 100.0, 500, 2.5)
