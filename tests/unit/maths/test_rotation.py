"""Rotations against exact series, scipy and differences."""

from __future__ import annotations

from fractions import Fraction
from math import factorial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from attest_cli.maths import rotation

Array = NDArray[np.float64]
TURN = st.lists(st.floats(-1.8, 1.8), min_size=3, max_size=3).map(np.array)  # norm below pi
ANGLES = [0.0, 1e-300, 1e-12, 1e-8, 1e-4, 1e-2, 0.1, 0.2999, 0.3, 0.3001, 0.5, 1.0, 2.0, 3.0, 3.1, 5.0, 6.2]


def taylor(x: float, first: int) -> float:
    """``sum_k (-1)^k x^2k / (2k + first)!`` in exact arithmetic."""
    x2, total = Fraction(x) ** 2, Fraction(0)
    for k in range(30):
        total += (-1) ** k * x2**k / factorial(2 * k + first)
    return float(total)


def random_quaternions(rng: np.random.Generator, n: int) -> Array:
    return rotation.normalise(rng.normal(size=(n, 4)))


@pytest.mark.parametrize("x", ANGLES)
def test_ratios_of_sine_and_cosine_are_those_of_the_exact_series(x: float) -> None:
    found = rotation.sine_ratios(np.array([x * x]))
    for ratio, first in zip(found, (1, 2, 3), strict=True):
        assert ratio[0] == pytest.approx(taylor(x, first), rel=2e-14, abs=0.0)


@given(TURN)
def test_log_undoes_exp(v: Array) -> None:
    assert np.allclose(rotation.log_quaternion(rotation.exp_quaternion(v)), v, rtol=0, atol=2e-15)


@pytest.mark.parametrize("size", [1e-200, 1e-13, 1e-9, 1e-5])
def test_small_turns_keep_all_their_digits(size: float) -> None:
    v = size * np.array([0.3, -0.5, 0.8])
    assert np.allclose(rotation.log_quaternion(rotation.exp_quaternion(v)), v, rtol=1e-14, atol=0)


@pytest.mark.parametrize("short", [0.0, 1e-12, 1e-6])
def test_turns_close_to_half_a_circle(short: float) -> None:
    axis = np.array([2.0, -1.0, 2.0]) / 3
    v = (np.pi - short) * axis
    back = rotation.log_quaternion(rotation.exp_quaternion(v))
    assert min(np.abs(back - v).max(), np.abs(back + v).max()) < 1e-15 + (0 if short else 4e-15)
    assert np.linalg.norm(back) <= np.pi + 1e-15


def test_both_signs_of_a_quaternion_are_one_rotation(rng: np.random.Generator) -> None:
    q = random_quaternions(rng, 50)
    assert np.array_equal(rotation.log_quaternion(q), rotation.log_quaternion(-q))
    assert np.allclose(rotation.matrix(q), rotation.matrix(-q), atol=1e-16)


def test_matrix_product_and_inverse_are_scipys(rng: np.random.Generator) -> None:
    p, q = random_quaternions(rng, 200), random_quaternions(rng, 200)
    P, Q = Rotation.from_quat(p, scalar_first=True), Rotation.from_quat(q, scalar_first=True)
    assert np.allclose(rotation.matrix(p), P.as_matrix(), atol=1e-15)
    assert np.allclose(rotation.matrix(rotation.multiply(p, q)), (P * Q).as_matrix(), atol=1e-15)
    assert np.allclose(rotation.matrix(rotation.conjugate(p)), P.inv().as_matrix(), atol=1e-15)
    v = rng.normal(size=(200, 3))
    assert np.allclose(np.einsum("kij,kj->ki", rotation.skew(v), p[:, 1:]), np.cross(v, p[:, 1:]), atol=1e-15)


def test_from_matrix_undoes_matrix_also_at_half_turns(rng: np.random.Generator) -> None:
    q = np.concatenate(
        [random_quaternions(rng, 200), np.eye(4), rotation.normalise(np.array([[0.0, 1, -1, 0], [1e-9, 3, 2, 1]]))]
    )
    back = rotation.from_matrix(rotation.matrix(q))
    assert np.all(back[:, 0] >= 0.0)
    assert np.allclose(np.abs(np.sum(back * q, axis=1)), 1.0, atol=1e-15)
    assert np.allclose(rotation.matrix(back), rotation.matrix(q), atol=2e-15)


def test_roll_pitch_yaw_are_scipys_fixed_axes(rng: np.random.Generator) -> None:
    q = random_quaternions(rng, 500)
    wanted = Rotation.from_quat(q, scalar_first=True).as_euler("xyz")
    assert np.allclose(rotation.roll_pitch_yaw(q), wanted, atol=1e-11)


def test_a_yaw_of_ninety_degrees_faces_north() -> None:
    q = rotation.exp_quaternion(np.array([0.0, 0.0, np.pi / 2]))
    assert np.allclose(rotation.roll_pitch_yaw(q), [0.0, 0.0, np.pi / 2], atol=1e-15)
    assert np.allclose(rotation.matrix(q) @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-15)


@pytest.mark.parametrize("size", [1e-9, 1e-3, 0.29, 0.31, 1.5, 3.0])
def test_right_jacobian_is_the_derivative_of_exp(rng: np.random.Generator, size: float) -> None:
    v = rng.normal(size=3)
    v *= size / np.linalg.norm(v)
    h = 1e-5
    inverse = rotation.conjugate(rotation.exp_quaternion(v))
    columns = []
    for axis in np.eye(3):
        ahead, behind = (
            rotation.log_quaternion(rotation.multiply(inverse, rotation.exp_quaternion(v + s * h * axis)))
            for s in (1, -1)
        )
        columns.append((ahead - behind) / (2 * h))
    assert np.allclose(rotation.right_jacobian(v), np.column_stack(columns), rtol=0, atol=1e-9)


@pytest.mark.parametrize("size", [0.0, 1e-9, 0.0099, 0.0101, 0.3, 2.0, 3.14, 6.0])
def test_inverse_right_jacobian_is_the_inverse(rng: np.random.Generator, size: float) -> None:
    v = rng.normal(size=3)
    v *= size / np.linalg.norm(v)
    assert np.allclose(rotation.right_jacobian(v) @ rotation.inverse_right_jacobian(v), np.eye(3), rtol=0, atol=2e-12)


def test_right_jacobian_is_the_mean_of_the_turns_back(rng: np.random.Generator) -> None:
    v = rng.normal(size=3)
    nodes, weights = np.polynomial.legendre.leggauss(20)
    mean = sum(
        0.5 * w * rotation.matrix(rotation.exp_quaternion(-0.5 * (x + 1) * v))
        for x, w in zip(nodes, weights, strict=True)
    )
    assert np.allclose(rotation.right_jacobian(v), mean, atol=1e-14)


def test_chain_is_the_running_product(rng: np.random.Generator) -> None:
    turns, start = random_quaternions(rng, 30), random_quaternions(rng, 1)[0]
    now, wanted = Rotation.from_quat(start, scalar_first=True), []
    for turn in turns:
        now *= Rotation.from_quat(turn, scalar_first=True)
        wanted.append(now.as_matrix())
    assert np.allclose(rotation.matrix(rotation.chain(turns, start)), wanted, atol=1e-14)
    assert np.allclose(rotation.chain(turns)[0], turns[0], atol=1e-15)


def test_continuous_removes_jumps_of_sign_and_keeps_the_rotation(rng: np.random.Generator) -> None:
    smooth = rotation.chain(np.tile(rotation.exp_quaternion(np.array([0.0, 0.02, 0.1])), (200, 1)))
    signs = rng.choice([-1.0, 1.0], 200)
    found = rotation.continuous(smooth * signs[:, None])
    assert np.all(np.sum(found[1:] * found[:-1], axis=1) > 0.99)
    assert found[0, 0] >= 0.0
    assert np.array_equal(np.abs(found), np.abs(smooth))
    assert found[:, 0].min() < -0.9  # it goes round once more instead of jumping back


@given(st.floats(-1e3, 1e3))
def test_wrap_leaves_the_angle_on_the_circle(angle: float) -> None:
    found = float(rotation.wrap(np.array(angle)))
    assert -np.pi <= found < np.pi
    assert np.cos(found - angle) == pytest.approx(1.0, abs=1e-12)
    assert np.sin(found - angle) == pytest.approx(0.0, abs=1e-12)


def test_unwrapped_takes_the_nearest_of_all_whole_turns(rng: np.random.Generator) -> None:
    course = np.cumsum(rng.uniform(-3.1, 3.1, 500)) + 0.3
    wrapped = rotation.wrap(course)
    assert np.max(np.abs(np.diff(wrapped))) > 4.0
    assert rotation.unwrapped(wrapped) == pytest.approx(np.unwrap(wrapped), abs=1e-10)
    assert rotation.unwrapped(wrapped[:1]) == wrapped[:1]


def test_long_arrays_give_what_their_rows_give() -> None:
    rng = np.random.default_rng(8)
    n = 2 * rotation.ROWS + 17
    p, q = (rotation.normalise(rng.normal(size=(n, 4))) for _ in range(2))
    v = rng.normal(size=(n, 3))
    cases = [
        (rotation.multiply, (p, q)), (rotation.multiply, (p, q[0])), (rotation.multiply, (p[:1], q)),
        (rotation.rotate, (p, v)), (rotation.rotate, (p[0], v)), (rotation.cross, (v, v[::-1])),
        (rotation.matrix, (p,)), (rotation.log_quaternion, (p,)), (rotation.exp_quaternion, (v,)),
        (rotation.exp_quaternion, (1e-3 * v,)), (rotation.roll_pitch_yaw, (p,)), (rotation.normalise, (p,)),
    ]  # fmt: skip
    for function, arrays in cases:
        whole = function(*arrays)
        for k in (0, rotation.ROWS - 1, rotation.ROWS, n - 1):
            row = function(*(a[k : k + 1] if len(a) == n else a for a in arrays))
            assert np.allclose(whole[k], row[0], rtol=0, atol=1e-15), function.__name__
    stacked = rotation.matrix(p.reshape(1, n, 4))
    assert np.allclose(stacked[0], rotation.matrix(p), rtol=0, atol=1e-15)


def test_products_broadcast_like_any_other(rng: np.random.Generator) -> None:
    """Many trials of many attitudes against one of each."""
    p = rotation.normalise(rng.normal(size=(3, 5, 4)))
    q = rotation.normalise(rng.normal(size=(5, 4)))
    each = np.stack([rotation.multiply(trial, q) for trial in p])
    assert rotation.multiply(p, q) == pytest.approx(each)
    assert rotation.multiply(q, p) == pytest.approx(np.stack([rotation.multiply(q, trial) for trial in p]))
