"""Two tracks at common times: exact at samples, slerp between them, nothing beyond them or across a gap."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp
from support.tracks import Motion

from attest_cli.evaluate.association import GAP_PERIODS, attitudes, held, look_up, period, vectors

T = np.arange(0.0, 2.0, 0.01)


def test_a_samples_own_time_gives_the_sample() -> None:
    motion = Motion()
    found = look_up(T, T)
    assert found.rows.tolist() == list(range(T.size))
    assert (found.outside, found.gaps) == (0, 0)
    np.testing.assert_allclose(attitudes(motion.q(T), found), motion.q(T), rtol=0.0, atol=1e-15)
    assert np.array_equal(vectors(motion.p(T), found), motion.p(T))


def test_between_samples_it_is_scipys_slerp_and_numpys_interp() -> None:
    motion, at = Motion(), np.random.default_rng(3).uniform(T[0], T[-1], 500)
    found = look_up(at, T)
    expected = Slerp(T, Rotation.from_quat(motion.q(T), scalar_first=True))(at)
    apart = Rotation.from_quat(attitudes(motion.q(T), found), scalar_first=True).inv() * expected
    assert apart.magnitude().max() < 1e-14
    linear = np.stack([np.interp(at, T, column) for column in motion.p(T).T], axis=1)
    np.testing.assert_allclose(vectors(motion.p(T), found), linear, rtol=0.0, atol=1e-14)


def test_the_short_way_is_taken_whatever_the_sign_of_a_quaternion() -> None:
    q = Motion().q(T)
    q[::2] *= -1.0
    at = T[:-1] + 0.005
    there, here = attitudes(q, look_up(at, T)), attitudes(Motion().q(T), look_up(at, T))
    np.testing.assert_allclose(np.abs(np.sum(there * here, axis=1)), 1.0, rtol=0.0, atol=1e-14)


def test_nothing_is_extrapolated_and_what_is_outside_is_counted() -> None:
    found = look_up(np.array([-0.5, -1e-9, 0.0, T[-1], T[-1] + 1e-9, 9.0]), T)
    assert found.rows.tolist() == [2, 3]
    assert found.outside == 4


def test_gaps_are_left_out_and_counted_but_not_their_edges() -> None:
    t = np.concatenate([T[T < 0.5], T[T > 1.0]])
    found = look_up(T, t)
    missing = np.setdiff1d(np.arange(T.size), found.rows)
    assert np.array_equal(T[missing], T[(T >= 0.5) & (T <= 1.0)])
    assert found.gaps == missing.size
    assert period(t) == pytest.approx(0.01)


@pytest.mark.parametrize(("lost", "found"), [(2, True), (3, False)])
def test_a_gap_is_more_than_three_periods(lost: int, found: bool) -> None:
    t = np.delete(T, range(50, 50 + lost))
    assert (lost + 1 <= GAP_PERIODS) == found
    assert (look_up(np.array([T[50] + 0.001]), t).rows.size == 1) == found


def test_motion_is_held_from_the_sample_before() -> None:
    moving = T >= 1.0
    assert held(moving, look_up(np.array([0.995, 1.0, 1.005]), T)).tolist() == [False, True, True]


def test_a_track_of_one_sample_is_found_at_its_time_only() -> None:
    assert look_up(np.array([0.0, 1.0, 2.0]), np.array([1.0])).rows.tolist() == [1]
    assert look_up(np.array([0.0, 1.0]), np.empty(0)).outside == 2
