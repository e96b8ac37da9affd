"""Stamps in order, against the fault matrix: swapped, repeated, batched, stepping back, coarse, with holes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from attest_cli.errors import AttestError
from attest_cli.prepare.clock import gaps, in_order

MS = 1_000_000
T0 = 1_780_308_000_000_000_000


def values(n: int) -> np.ndarray:
    return np.arange(n, dtype=np.float64)[:, None] + np.array([[0.0, 0.5]])


def clean(n: int = 100) -> np.ndarray:
    return T0 + np.arange(n, dtype=np.int64) * 10 * MS


def test_a_clean_clock_is_left_alone() -> None:
    ordered = in_order("log", clean(), values(100), T0)
    np.testing.assert_array_equal(ordered.rows, np.arange(100))
    np.testing.assert_array_equal(ordered.stamps_ns, clean())
    assert ordered.warnings == ()


@given(st.lists(st.integers(0, 98), max_size=8, unique=True))
def test_swapped_rows_equal_the_sorted_log(swaps: list[int]) -> None:
    order = np.arange(100)
    for k in swaps:
        order[[k, k + 1]] = order[[k + 1, k]]
    ordered = in_order("log", clean()[order], values(100)[order], T0)
    np.testing.assert_array_equal(ordered.stamps_ns, clean())
    np.testing.assert_array_equal(values(100)[order][ordered.rows], values(100))
    assert [w.code for w in ordered.warnings] == (
        [] if np.array_equal(order, np.arange(100)) else ["rows-out-of-order"]
    )


def test_rows_late_against_the_maximum_so_far_are_counted() -> None:
    stamps_ns = T0 + np.array([10, 5, 6, 11]) * MS
    (warning,) = in_order("log", stamps_ns, values(4), T0).warnings
    assert "2 rows" in warning.message


def test_repeats_of_stamp_and_values_are_dropped_and_counted() -> None:
    rows = np.sort(np.concatenate([np.arange(100), [7, 7, 50]]))
    ordered = in_order("log", clean()[rows], values(100)[rows], T0)
    np.testing.assert_array_equal(ordered.stamps_ns, clean())
    (warning,) = ordered.warnings
    assert warning.code == "duplicate-rows"
    assert "3 rows" in warning.message


@pytest.mark.parametrize("apart_ns", [1, 1000, 100_000, 1_000_000])
def test_an_imu_published_twice_is_read_once(apart_ns: int) -> None:
    stamps_ns = (clean()[:, None] + [0, apart_ns]).ravel()
    ordered = in_order("log", stamps_ns, np.repeat(values(100), 2, axis=0), T0)
    np.testing.assert_array_equal(ordered.stamps_ns, clean())
    (warning,) = ordered.warnings
    assert warning.code == "duplicate-rows"
    assert "100 rows" in warning.message
    late = np.r_[:40, 42, 43, 40, 41, 44:200]  # the same, of a log with rows to sort
    sorted_first = in_order("log", stamps_ns[late], np.repeat(values(100), 2, axis=0)[late], T0)
    np.testing.assert_array_equal(sorted_first.stamps_ns, clean())


def test_equal_values_a_step_apart_or_other_values_just_after_are_measured() -> None:
    held = np.repeat(values(50), 2, axis=0)  # a slow sensor, logged at twice its rate
    assert in_order("log", clean(), held, T0).warnings == ()
    pairs = (clean(50)[:, None] + [0, 1000]).ravel()
    assert in_order("log", pairs, values(100), T0).warnings == ()
    few = clean() + np.where(np.arange(100) == 40, -9 * MS, 0)  # one late thread, at rest
    still = values(100)
    still[40] = still[39]
    assert in_order("log", few, still, T0).warnings == ()


def test_a_usb_batch_is_spread_over_its_interval() -> None:
    arrivals = np.repeat(T0 + (1 + np.arange(25)) * 40 * MS, 4)  # four samples at 100 Hz arrive together
    ordered = in_order("log", arrivals, values(100), T0)
    np.testing.assert_array_equal(ordered.rows, np.arange(100))  # never dropped
    np.testing.assert_array_equal(ordered.stamps_ns, T0 + (1 + np.arange(100)) * 10 * MS)
    assert [w.code for w in ordered.warnings] == ["batched-stamps"]


@pytest.mark.parametrize("steps_ms", [(1, 1, 1, 37), (1, 19), (2, 2, 2, 2, 2, 2, 2, 2, 2, 62)])
def test_a_burst_with_stamps_of_its_own_is_spread_over_its_interval(steps_ms: tuple[int, ...]) -> None:
    size, period = len(steps_ms), sum(steps_ms) // len(steps_ms) * MS
    arrived = T0 + np.cumsum(np.tile(steps_ms, 60)) * MS
    ordered = in_order("log", arrived, values(60 * size), T0)
    assert [w.code for w in ordered.warnings] == ["batched-stamps"]
    inner = np.diff(ordered.stamps_ns)[size:-size]
    assert np.abs(inner - period).max() <= 2 * MS
    pausing = (arrived - T0)[:, None] * np.array(
        [1e-7, 2e-7]
    )  # the sensor itself samples so: it changes over the pause
    assert in_order("log", arrived, pausing, T0).warnings == ()


@pytest.mark.parametrize("pause_ms", [600, 30_000])
def test_a_log_that_is_paused_has_no_bursts(pause_ms: int) -> None:
    stamps = T0 + np.cumsum(np.tile([5] * 80 + [pause_ms], 30)) * MS
    assert in_order("log", stamps, values(len(stamps)), T0).warnings == ()


def test_one_sample_with_the_stamp_of_its_neighbour_goes_where_the_hole_is() -> None:
    stamps_ns = clean()
    stamps_ns[41] = stamps_ns[40]
    ordered = in_order("log", stamps_ns, values(100), T0)
    np.testing.assert_allclose(ordered.stamps_ns - T0, np.arange(100) * 10 * MS, atol=1.1 * MS)
    assert np.all(np.diff(ordered.stamps_ns) > 0)


@given(st.lists(st.integers(0, 30), min_size=60, max_size=120))
def test_whatever_is_not_refused_increases_strictly(steps: list[int]) -> None:
    stamps_ns = T0 + np.cumsum(np.array(steps, dtype=np.int64)) * MS
    try:
        ordered = in_order("log", stamps_ns, values(len(steps)), T0)
    except AttestError:
        assert np.unique(stamps_ns).size * 1.5 < stamps_ns.size
        return
    assert np.all(np.diff(ordered.stamps_ns) > 0)
    assert ordered.stamps_ns.size == len(steps)


@pytest.mark.parametrize("back_s", [0.6, 10.0, 4294.967296])
def test_a_clock_that_steps_back_is_refused_with_time_and_size(back_s: float) -> None:
    stamps_ns = clean(1000)
    stamps_ns[600:] -= round(back_s * 1e9)
    with pytest.raises(AttestError, match=f"steps back by {back_s - 0.01:.3f} s at 5.990 s") as refused:
        in_order("log", stamps_ns, values(1000), T0)
    assert "--end" in refused.value.hint


def test_a_slow_sensor_may_share_stamps_and_come_late() -> None:
    stamps_ns = T0 + np.array([0, 5000, 5000, 10_000, 7000]) * MS
    ordered = in_order("log", stamps_ns, values(5), T0, strict=False)
    np.testing.assert_array_equal(ordered.stamps_ns, np.sort(stamps_ns))
    assert [w.code for w in ordered.warnings] == ["rows-out-of-order"]


@pytest.mark.parametrize(
    "seconds",
    [
        np.float64(np.float32(1.78e9 + np.arange(2000) * 0.1)),
        np.array([float(f"{s:.6g}") for s in 1.78e9 + np.arange(2000) * 0.1]),
        np.full(2000, 5.0),
    ],
)
def test_stamps_without_resolution_are_refused(seconds: np.ndarray) -> None:
    stamps_ns = np.rint(seconds * 1e9).astype(np.int64)
    with pytest.raises(AttestError, match=r"\d+ distinct stamps in 2000 rows"):
        in_order("log", stamps_ns, values(2000), int(stamps_ns[0]))


def test_holes_are_longer_than_the_limit_and_than_five_periods() -> None:
    stamps_ns = np.delete(clean(1000), np.r_[100:140, 500:580])  # holes of 0.41 and 0.81 s
    assert ((gaps(stamps_ns, 0.5) - T0) // MS).tolist() == [[4990, 5800]]
    slow = T0 + np.arange(100, dtype=np.int64) * 1000 * MS
    assert gaps(slow, 0.5).size == 0
    assert gaps(slow[:1], 0.5).shape == (0, 2)


@pytest.mark.parametrize("damaged", [0, 10**18, -5])
def test_single_stamps_far_from_the_others_are_dropped_and_told(damaged: int) -> None:
    stamps = 1_717_232_400_000_000_000 + np.arange(2000, dtype=np.int64) * 10_000_000
    values = np.random.default_rng(1).normal(size=(2000, 6))
    rows = [3, 500, 501, 502, 1500, 1999]
    bad = stamps.copy()
    bad[rows] = damaged
    found = in_order("log.csv: imu", bad, values, int(stamps[0]))
    keep = np.setdiff1d(np.arange(2000), rows)
    np.testing.assert_array_equal(found.rows, keep)
    np.testing.assert_array_equal(found.stamps_ns, stamps[keep])
    assert [w.code for w in found.warnings] == ["rows-without-time"]
    assert "6 of 2000 rows" in found.warnings[0].message


def test_a_clock_that_steps_back_is_refused_as_before() -> None:
    stamps = np.arange(2000, dtype=np.int64) * 10_000_000
    stamps[1000:] -= 5_000_000_000
    with pytest.raises(AttestError, match="steps back"):
        in_order("log.csv: imu", stamps, np.zeros((2000, 6)), 0)
