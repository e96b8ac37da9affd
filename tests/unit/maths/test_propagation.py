"""Propagation against 50-digit vectors, sequential products, differences and an analytic motion."""

from __future__ import annotations

from fractions import Fraction
from math import factorial

import numpy as np
import pytest
from numpy.typing import NDArray
from support.vectors import load, wxyz

from attest_cli.maths import propagation, rotation
from attest_cli.maths.propagation import Samples, Steps, bridged, preintegrate, run_steps, transition
from attest_cli.simulate.drive import attitude

Array = NDArray[np.float64]
N_R, N_W = 2.25e-8, 2.5e-11


def block_error(found: Array, wanted: Array) -> float:
    """Largest error of the 3x3 blocks of (n, 6, 6), each over its own largest element."""
    worst = 0.0
    for i in (slice(0, 3), slice(3, 6)):
        for j in (slice(0, 3), slice(3, 6)):
            error = np.abs(found[:, i, j] - wanted[:, i, j]).max(axis=(1, 2))
            scale = np.abs(wanted[:, i, j]).max(axis=(1, 2))
            worst = max(worst, float(np.max(error / np.where(scale > 0, scale, 1.0))))
    return worst


def random_steps(rng: np.random.Generator, counts: list[int], held: bool = False) -> Steps:
    first = np.concatenate([[0], np.cumsum(counts)])
    rate0, rate1 = rng.normal(size=(first[-1], 3)), rng.normal(size=(first[-1], 3))
    return Steps(rng.uniform(0.005, 0.02, first[-1]), rate0, rate0.copy() if held else rate1, first)


def test_single_steps_are_vector_v1() -> None:
    v = load("v1_quat_step")
    turn = rotation.exp_quaternion(propagation.step_vectors(v["w0"], v["w1"], v["dt"]))
    found = rotation.multiply(wxyz(v["q0"]), turn)
    assert np.abs(found - wxyz(v["magnus4"])).max() < 1e-12


def test_fourth_order_step_beats_the_mean_rate_for_a_linear_rate() -> None:
    v = load("v1_quat_step")
    truth = wxyz(v["truth_linear_rate"])
    mean = rotation.exp_quaternion(0.5 * (v["w0"] + v["w1"]) * v["dt"][:, None])
    fourth = rotation.exp_quaternion(propagation.step_vectors(v["w0"], v["w1"], v["dt"]))
    error = [
        np.linalg.norm(
            rotation.log_quaternion(rotation.multiply(rotation.conjugate(truth), rotation.multiply(wxyz(v["q0"]), q))),
            axis=1,
        )
        for q in (mean, fourth)
    ]
    curved = error[0] > 1e-10
    assert curved.sum() >= 2
    assert np.all(error[1][curved] < 0.1 * error[0][curved])


def test_transition_is_vector_v2() -> None:
    v = load("v2_transition")
    dt = np.broadcast_to(v["dt"], len(v["w"]))
    Phi, Q = transition(v["w"], dt, float(v["Nr"]), float(v["Nw"]))
    assert block_error(Phi, v["Phi"]) < 1e-12
    assert block_error(Q, v["Q"]) < 1e-12
    assert block_error(Phi @ v["P0"] @ Phi.swapaxes(1, 2) + Q, v["P1"]) < 1e-12
    assert np.array_equal(Q, Q.swapaxes(1, 2))


def test_backward_transition_of_v2_is_the_forward_one_at_the_opposite_rate() -> None:
    v = load("v2_transition")
    dt = np.broadcast_to(v["dt"], len(v["w"]))
    Phi, Q = transition(-v["w"], dt, float(v["Nr"]), float(v["Nw"]))
    flip = np.diag([1.0, 1.0, 1.0, -1.0, -1.0, -1.0])  # time runs backwards, and so does what a bias does
    assert block_error(flip @ Phi @ flip, v["Phi_b"]) < 1e-12
    assert block_error(flip @ Q @ flip, v["Q_b"]) < 1e-12


@pytest.mark.parametrize("x", [0.0, 1e-8, 1e-3, 0.1, 0.2999, 0.3001, 1.0, 3.0])
def test_noise_ratios_are_those_of_the_exact_series(x: float) -> None:
    x2 = Fraction(x) ** 2
    d = float(sum((-1) ** k * x2**k / factorial(2 * k + 4) for k in range(25)))
    e = float(2 * sum((-1) ** k * x2**k / factorial(2 * k + 5) for k in range(25)))
    found = propagation._noise_ratios(np.array([x * x]))
    assert found[0][0] == pytest.approx(d, rel=1e-11)
    assert found[1][0] == pytest.approx(e, rel=1e-11)


@pytest.mark.parametrize("held", [True, False])
def test_preintegration_is_the_product_of_its_steps(rng: np.random.Generator, held: bool) -> None:
    counts = [3, 1, 0, 7, 5]
    steps = random_steps(rng, counts, held)
    bias = 0.1 * rng.normal(size=(len(counts), 3))
    found = preintegrate(steps, bias, N_R, N_W)
    for i, count in enumerate(counts):
        q, Phi, Q = np.array([1.0, 0.0, 0.0, 0.0]), np.eye(6), np.zeros((6, 6))
        for j in range(steps.first[i], steps.first[i] + count):
            w0, w1, dt = steps.rate0[j] - bias[i], steps.rate1[j] - bias[i], steps.dt[j]
            turn = 0.5 * (w0 + w1) * dt + dt**2 / 12 * np.cross(w0, w1)
            q = rotation.multiply(q, rotation.exp_quaternion(turn))
            A, q_step = transition(turn[None] / dt, np.array([dt]), N_R, N_W)
            Phi, Q = A[0] @ Phi, A[0] @ Q @ A[0].T + q_step[0]
        assert np.allclose(found.dq[i], q, rtol=0, atol=1e-14)
        assert np.allclose(found.Phi[i, :, :3], Phi[:, :3], rtol=0, atol=1e-14)
        assert np.allclose(found.Phi[i], Phi, rtol=0, atol=2e-6)
        assert block_error(found.Q[i : i + 1], Q[None]) < 1e-2
        assert np.array_equal(found.psi[i], -found.Phi[i, :3, 3:])
        assert found.span[i] == pytest.approx(steps.dt[steps.first[i] : steps.first[i + 1]].sum(), abs=1e-15)


def test_more_intervals_than_a_block_change_nothing(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    steps = random_steps(rng, [int(c) for c in rng.integers(0, 6, 50)])
    bias = rng.normal(size=(50, 3))
    whole = preintegrate(steps, bias, N_R, N_W)
    monkeypatch.setattr(propagation, "BLOCK", 7)
    parts = preintegrate(steps, bias, N_R, N_W)
    for name in ("dq", "psi", "Phi", "Q", "span"):
        assert np.allclose(getattr(whole, name), getattr(parts, name), rtol=1e-12, atol=1e-19)


def bias_derivative(steps: Steps, bias: Array) -> Array:
    """Central differences of ``Log(dq(bias)^-1 dq(bias + db))`` (m, 3, 3)."""
    h, at, columns = 1e-4, preintegrate(steps, bias, N_R, N_W).dq, []
    for axis in np.eye(3):
        ahead, behind = (
            rotation.log_quaternion(
                rotation.multiply(rotation.conjugate(at), preintegrate(steps, bias + s * h * axis, N_R, N_W).dq)
            )
            for s in (1, -1)
        )
        columns.append((ahead - behind) / (2 * h))
    return np.stack(columns, axis=2)


def test_bias_jacobian_is_the_derivative_for_held_rates(rng: np.random.Generator) -> None:
    steps, bias = random_steps(rng, [4, 9, 10], held=True), 0.1 * rng.normal(size=(3, 3))
    assert np.allclose(-preintegrate(steps, bias, N_R, N_W).psi, bias_derivative(steps, bias), rtol=0, atol=2e-6)


def test_bias_jacobian_leaves_out_no_more_than_the_coning_within_a_step() -> None:
    t = np.arange(0, 1.01, 0.01)
    rate = np.stack([0.3 * np.sin(20 * t), 0.2 * np.cos(15 * t), 0.1 + 0.2 * np.sin(9 * t)], axis=1)
    steps = Steps(np.diff(t), rate[:-1], rate[1:], np.arange(0, 101, 10))
    bias = np.zeros((10, 3))
    psi = preintegrate(steps, bias, N_R, N_W).psi
    coning = np.max(np.abs(np.diff(rate, axis=0))) * 0.01**2 / 12 * 10  # |dt^2/12 (w1 - w0)| over ten steps
    assert np.abs(-psi - bias_derivative(steps, bias)).max() < 3 * coning


def test_increments_at_another_bias_are_right_to_second_order(rng: np.random.Generator) -> None:
    steps, ref = random_steps(rng, [10, 10, 10], held=True), np.zeros((3, 3))
    inc, errors = preintegrate(steps, ref, N_R, N_W), []
    direction = rng.normal(size=(3, 3))
    for size in (0.2, 0.1):
        bias = size * direction
        exact = preintegrate(steps, bias, N_R, N_W)
        dq, Phi = inc.at(bias, 0, 3)
        errors.append(np.abs(rotation.log_quaternion(rotation.multiply(rotation.conjugate(exact.dq), dq))).max())
        assert np.allclose(Phi[:, :3, :3], rotation.matrix(dq).swapaxes(1, 2), atol=1e-14)
    assert np.log2(errors[0] / errors[1]) > 1.9
    dq, Phi = inc.at(ref, 0, 3)
    assert np.allclose(dq, inc.dq, atol=1e-16)
    assert np.allclose(Phi, inc.Phi, atol=1e-15)


def motion_that_ends_turning(t: Array) -> tuple[Array, Array]:
    """Attitude and body rate of a minute over waves, turning when it ends."""
    w = np.array([0.7, 0.9, 0.13])
    a = np.array([0.3, 0.2, 1.5])
    angles = a * np.sin(t[:, None] * w + [0.2, 1.1, 0.4]) + np.outer(t, [0.0, 0.0, 0.05])
    rates = a * w * np.cos(t[:, None] * w + [0.2, 1.1, 0.4]) + [0.0, 0.0, 0.05]
    _, q, rate_b = attitude(angles, rates)
    return q, rate_b


def refinement_error(rate_hz: float) -> float:
    """Attitude error after 60 s, deg, by preintegration over intervals of 0.1 s and by steps at full rate."""
    t = np.arange(round(60 * rate_hz) + 1) / rate_hz
    q, rate = motion_that_ends_turning(t)
    per = round(rate_hz / 10)
    steps = Steps(np.diff(t), rate[:-1], rate[1:], np.arange(0, len(t), per))
    m = len(steps.first) - 1
    nodes = np.concatenate([q[:1], rotation.chain(preintegrate(steps, np.zeros((m, 3)), 0.0, 0.0).dq, q[0])])
    full = run_steps(steps, nodes[:-1], np.zeros((m, 3)))
    assert np.allclose(np.abs(np.sum(full[steps.first[1:] - 1] * nodes[1:], axis=1)), 1.0, atol=1e-14)
    error = rotation.log_quaternion(rotation.multiply(rotation.conjugate(q[-1]), nodes[-1]))
    return float(np.degrees(np.linalg.norm(error)))


@pytest.mark.parametrize("linear", [True, False])
def test_samples_between_nodes_are_the_steps_of_the_merged_grid(rng: np.random.Generator, linear: bool) -> None:
    t = np.cumsum(rng.uniform(0.005, 0.015, 400))
    rate = 0.5 * rng.normal(size=(400, 3))
    inner = np.sort(np.concatenate([rng.uniform(t[0], t[-1], 20), t[rng.choice(np.arange(1, 399), 10)]]))
    nodes = np.concatenate([t[:1], inner, t[-1:]])
    held = rng.random(len(nodes) - 1) < 0.2
    samples = Samples(t, rate, nodes, np.searchsorted(t, nodes), held, linear)
    grid = np.unique(np.concatenate([t, nodes]))
    at = np.stack([np.interp(grid, t, rate[:, i]) for i in range(3)], axis=1)
    rate0, rate1 = (at[:-1], at[1:]) if linear else (rate[np.searchsorted(t, grid[1:])],) * 2
    first = np.searchsorted(grid, nodes)
    moving = np.repeat(~held, np.diff(first))[:, None]
    steps, bias = Steps(np.diff(grid), rate0 * moving, rate1 * moving, first), 0.1 * rng.normal(size=(len(held), 3))
    bias[held] = 0.0
    found, wanted = preintegrate(samples, bias, N_R, N_W), preintegrate(steps, bias, N_R, N_W)
    for name, most in (("dq", 1e-13), ("psi", 1e-7), ("Phi", 1e-7), ("span", 1e-13)):
        assert np.allclose(getattr(found, name), getattr(wanted, name), rtol=0, atol=most)
    assert block_error(found.Q, wanted.Q) < 2e-3


def test_a_bridge_begins_and_ends_where_it_should(rng: np.random.Generator) -> None:
    steps = random_steps(rng, [4, 9, 2])
    q, q_end = rotation.normalise(rng.normal(size=(3, 4))), rotation.normalise(rng.normal(size=(3, 4)))
    bias, done = np.zeros((3, 3)), set()
    for rows, run in bridged(steps, np.arange(3), q, q_end, bias):
        assert np.allclose(np.abs(np.sum(run[-1] * q_end[rows], axis=1)), 1.0, atol=1e-12)
        first = propagation.step_vectors(*(x[steps.first[rows]] for x in (steps.rate0, steps.rate1, steps.dt)))
        near = rotation.multiply(q[rows], rotation.exp_quaternion(first))
        done |= set(rows.tolist())
        assert np.abs(np.linalg.norm(run, axis=2) - 1.0).max() < 1e-13
        assert np.all(np.abs(np.sum(run[0] * near, axis=1)) > 0.4)
    assert done == {0, 1, 2}


def test_finer_steps_are_better_by_the_square_of_the_rate() -> None:
    errors = np.array([refinement_error(rate) for rate in (50.0, 100.0, 200.0)])
    print("attitude error after 60 s at 50, 100, 200 Hz, deg:", errors)
    assert errors[1] < 1e-3
    assert np.all(np.log2(errors[:-1] / errors[1:]) >= 1.9)
    assert errors[2] > 1e-9  # rounding is not what is measured here


def test_run_steps_takes_every_interval_from_its_own_start(rng: np.random.Generator) -> None:
    counts = [4, 0, 2, 6]
    steps = random_steps(rng, counts)
    start = rotation.normalise(rng.normal(size=(4, 4)))
    bias = rng.normal(size=(4, 3))
    found = run_steps(steps, start, bias)
    for i, count in enumerate(counts):
        q = start[i]
        for j in range(steps.first[i], steps.first[i] + count):
            v = propagation.step_vectors(
                steps.rate0[j : j + 1] - bias[i], steps.rate1[j : j + 1] - bias[i], steps.dt[j : j + 1]
            )
            q = rotation.multiply(q, rotation.exp_quaternion(v[0]))
            assert np.allclose(found[j], q, atol=1e-14)


def test_held_intervals_are_left_out_and_change_no_other(rng: np.random.Generator) -> None:
    steps, bias = random_steps(rng, [3, 8, 0, 5, 2]), rng.normal(size=(5, 3))
    held = np.array([False, True, False, True, False])
    whole, found = preintegrate(steps, bias, N_R, N_W), preintegrate(steps, bias, N_R, N_W, held)
    for name in ("dq", "psi", "Phi", "Q"):
        assert np.allclose(getattr(found, name)[~held], getattr(whole, name)[~held], rtol=1e-12, atol=1e-19)
    assert np.array_equal(found.span, whole.span)
    assert np.array_equal(found.dq[held], [[1.0, 0.0, 0.0, 0.0]] * 2)
    assert not found.psi[held].any()
