"""BROAD's attitude errors, their statistics, relative positions."""

from __future__ import annotations

import numpy as np
import pytest
from support.tracks import Motion, noisy, random_rotation

from attest_cli.evaluate import errors
from attest_cli.maths import rotation

T = np.arange(0.0, 20.0, 0.02)


def pairs(rng: np.random.Generator, count: int = 400) -> tuple[np.ndarray, np.ndarray]:
    return (np.stack([random_rotation(rng) for _ in range(count)]) for _ in range(2))  # type: ignore[return-value]


def test_the_errors_are_broads_by_the_letter(rng: np.random.Generator) -> None:
    q_est, q_ref = pairs(rng)
    e = rotation.multiply(q_est, rotation.conjugate(q_ref))
    found = errors.attitude(q_est, q_ref)
    np.testing.assert_allclose(errors.total(q_est, q_ref), 2 * np.arccos(np.abs(e[:, 0])), atol=1e-7)
    np.testing.assert_allclose(errors.inclination(found), 2 * np.arccos(np.hypot(e[:, 0], e[:, 3])), atol=1e-7)
    np.testing.assert_allclose(np.abs(found[:, 2]), 2 * np.abs(np.arctan(e[:, 3] / e[:, 0])), atol=1e-12)


def test_the_sign_of_a_quaternion_does_not_matter(rng: np.random.Generator) -> None:
    q_est, q_ref = pairs(rng)
    np.testing.assert_allclose(errors.attitude(-q_est, q_ref), errors.attitude(q_est, q_ref), atol=1e-12)


def test_small_errors_are_the_rotation_vector_about_world_axes(rng: np.random.Generator) -> None:
    q_ref, v = Motion().q(T), rng.normal(0.0, 1e-4, (T.size, 3))
    found = errors.attitude(rotation.multiply(rotation.exp_quaternion(v), q_ref), q_ref)
    np.testing.assert_allclose(found, v, atol=5e-8)  # second order in 1e-4


def test_a_turn_of_the_world_is_heading_and_a_tilt_is_not(rng: np.random.Generator) -> None:
    q = Motion().q(T)
    half = 0.5 * np.radians(120.0)
    yaw = np.array([np.cos(half), 0.0, 0.0, np.sin(half)])
    found = errors.attitude(rotation.multiply(yaw, q), q)
    np.testing.assert_allclose(np.degrees(found), [[0.0, 0.0, 120.0]] * T.size, atol=1e-12)
    tilt = rotation.exp_quaternion(np.array([0.3, -0.4, 0.0]))
    np.testing.assert_allclose(errors.attitude(rotation.multiply(tilt, q), q), [[0.3, -0.4, 0.0]] * T.size, atol=1e-14)


def test_upside_down_is_finite() -> None:
    found = errors.attitude(np.array([[0.0, 1.0, 0.0, 0.0]]), np.array([[1.0, 0.0, 0.0, 0.0]]))
    assert np.isfinite(found).all()
    assert errors.inclination(found)[0] == pytest.approx(np.pi)


def test_statistics_are_those_of_the_absolute_values() -> None:
    found = errors.statistics(np.array([-4.0, 0.0, 3.0]))
    assert (found.median, found.max, found.count) == (3.0, 4.0, 3)
    assert found.rms == pytest.approx(5.0 / np.sqrt(3.0))
    assert found.p95 == pytest.approx(np.quantile([4.0, 0.0, 3.0], 0.95))
    assert errors.statistics(np.empty(0)).count == 0


def test_the_mean_heading_error_is_circular() -> None:
    angle = np.radians(np.array([175.0, -175.0, 179.0, -179.0]))
    assert abs(np.degrees(errors.circular_mean(angle))) == pytest.approx(180.0)


def test_pairs_by_time_are_the_nearest_and_none_is_too_far() -> None:
    t = np.concatenate([np.arange(0.0, 1.0, 0.1), np.arange(5.0, 6.0, 0.1)])
    start, end = errors.pairs_by_time(t, 0.3)
    np.testing.assert_allclose(t[end] - t[start], 0.3, atol=1e-9)
    assert start.size == 14  # seven in each half
    assert errors.pairs_by_time(t, 100.0)[0].size == 0
    assert errors.pairs_by_time(t[:1], 1.0)[0].size == 0


def test_a_displacement_seen_from_the_body_knows_no_world(rng: np.random.Generator) -> None:
    motion, q_world = Motion(), random_rotation(rng)
    p, q = motion.p(T), motion.q(T)
    start, end = errors.pairs_by_time(T, 1.0)
    moved, turned = rotation.rotate(q_world, p) + np.array([3.0, -2.0, 9.0]), rotation.multiply(q_world, q)
    assert errors.relative_position(start, end, moved, p, turned, q).max() < 1e-13
    assert errors.relative_position(start, end, p + np.array([1.0, 2.0, 3.0]), p).max() < 1e-13


def test_scatter_is_the_white_part_of_an_error(rng: np.random.Generator) -> None:
    q = Motion().q(T)
    slow = rotation.exp_quaternion(0.01 * np.sin(0.3 * T)[:, None] * [1.0, 0.0, 1.0])
    error = errors.attitude(rotation.multiply(slow, noisy(q, 2e-4, rng)), q)
    assert errors.scatter(error, np.zeros(T.size, dtype=np.bool_)) == pytest.approx(2e-4, rel=0.05)
