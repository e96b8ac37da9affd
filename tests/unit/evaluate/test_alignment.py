"""Constant rotations on both sides and rigid alignment of points: found exactly, or refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.tracks import Motion, noisy, random_rotation, turned

from attest_cli.errors import AttestError
from attest_cli.evaluate.alignment import IDENTITY, fit_points, fit_rotations, nearest_rotation
from attest_cli.maths import rotation

T = np.arange(0.0, 30.0, 0.05)
ONES = np.ones(T.size)


def apart(p: np.ndarray, q: np.ndarray) -> float:
    return float(np.linalg.norm(rotation.log_quaternion(rotation.multiply(rotation.conjugate(p), q))))


def about_vertical(angle: float) -> np.ndarray:
    return np.array([np.cos(0.5 * angle), 0.0, 0.0, np.sin(0.5 * angle)])


@pytest.mark.parametrize("world", ["none", "yaw", "full"])
@pytest.mark.parametrize("body", [False, True])
@pytest.mark.parametrize("seed", range(12))
def test_rotations_that_were_put_in_are_found(world: str, body: bool, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q_world = {"none": IDENTITY, "yaw": about_vertical(rng.uniform(-np.pi, np.pi)), "full": random_rotation(rng)}[world]
    q_body = random_rotation(rng) if body else IDENTITY
    q_ref = Motion(seed).q(T)
    found = fit_rotations(turned(q_ref, q_world, q_body), q_ref, ONES, world, body=body)
    assert apart(found[0], q_world) < 1e-12
    assert apart(found[1], q_body) < 1e-12


def test_it_is_the_least_squares_solution(rng: np.random.Generator) -> None:
    q_ref = Motion(2).q(T)
    q_est = noisy(turned(q_ref, about_vertical(1.0), random_rotation(rng)), 0.02, rng)
    weight = rng.uniform(0.5, 2.0, T.size)
    q_world, q_body = fit_rotations(q_est, q_ref, weight, "yaw", body=True)

    def cost(step: np.ndarray) -> float:
        moved = turned(q_ref, rotation.multiply(about_vertical(step[0]), q_world),
                       rotation.multiply(q_body, rotation.exp_quaternion(step[1:])))  # fmt: skip
        residual = rotation.log_quaternion(rotation.multiply(rotation.conjugate(q_est), moved))
        return float(np.sum(weight * np.sum(residual**2, axis=1)))

    least = cost(np.zeros(4))
    for k in range(4):
        for sign in (-1e-4, 1e-4):
            assert cost(sign * np.eye(4)[k]) > least


def test_a_motion_that_only_turns_about_the_vertical_cannot_tell_both_sides_apart() -> None:
    q_ref = np.stack([about_vertical(a) for a in np.sin(T)])
    with pytest.raises(AttestError, match="cannot tell"):
        fit_rotations(q_ref, q_ref, ONES, "yaw", body=True)
    assert apart(fit_rotations(q_ref, q_ref, ONES, "none", body=True)[1], IDENTITY) < 1e-14


def test_weights_count(rng: np.random.Generator) -> None:
    q_ref = Motion().q(T)
    first, second = about_vertical(0.3), about_vertical(-0.2)
    q_est = np.where((T < 15.0)[:, None], rotation.multiply(first, q_ref), rotation.multiply(second, q_ref))
    found, _ = fit_rotations(q_est, q_ref, np.where(T < 15.0, 1.0, 1e-12), "yaw", body=False)
    assert apart(found, first) < 1e-9


def test_points_are_aligned_as_scipy_aligns_them(rng: np.random.Generator) -> None:
    p_ref = Motion().p(T)
    p_est = rotation.rotate(random_rotation(rng), p_ref) + rng.normal(0.0, 0.1, p_ref.shape) + [4.0, 5.0, -6.0]
    q, shift = fit_points(p_est, p_ref, "full")
    oracle, _ = Rotation.align_vectors(p_est - p_est.mean(axis=0), p_ref - p_ref.mean(axis=0))
    assert apart(q, oracle.as_quat(scalar_first=True)) < 1e-12
    np.testing.assert_allclose(rotation.rotate(q, p_ref).mean(axis=0) + shift, p_est.mean(axis=0), atol=1e-12)


def test_points_are_turned_about_the_vertical_alone(rng: np.random.Generator) -> None:
    p_ref = Motion().p(T)
    p_est = rotation.rotate(about_vertical(2.5), p_ref) + np.array([4.0, 5.0, -6.0])
    q, shift = fit_points(p_est, p_ref, "yaw")
    assert apart(q, about_vertical(2.5)) < 1e-13
    np.testing.assert_allclose(shift, [4.0, 5.0, -6.0], atol=1e-12)
    assert fit_points(p_est, p_ref, "none")[0].tolist() == IDENTITY.tolist()


def test_points_on_a_line_leave_a_full_turn_open() -> None:
    line = T[:, None] * [1.0, 2.0, 3.0]
    with pytest.raises(AttestError, match="one line"):
        fit_points(line, line, "full")
    assert apart(fit_points(line, line, "yaw")[0], IDENTITY) < 1e-12


def test_the_nearest_rotation_is_never_a_mirror(rng: np.random.Generator) -> None:
    for _ in range(50):
        R = nearest_rotation(rng.normal(size=(3, 3)))
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(R) == pytest.approx(1.0)
