"""Preintegrated velocity and position against fine integration, finite differences and Monte Carlo."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from attest_cli.maths import rotation, strapdown
from attest_cli.maths.propagation import Steps

Array = NDArray[np.float64]
DT, PER, M = 0.005, 20, 6
T = np.arange(M * PER + 1) * DT
RATE = np.stack([np.sin(2 * T), 2 * np.cos(3 * T), 1 + 0.5 * np.sin(T)], axis=1)
FORCE = np.stack([np.sin(4 * T), np.cos(T), 9.8 + 0.3 * np.sin(7 * T)], axis=1)
FIRST = np.arange(0, M * PER + 1, PER)


def made(
    bg: Array | None = None, ba: Array | None = None, rate: Array = RATE, force: Array = FORCE
) -> strapdown.Motion:
    bg = np.zeros(3) if bg is None else bg
    ba = np.zeros(3) if ba is None else ba
    steps = Steps(np.full(len(T) - 1, DT), rate[:-1] - bg, rate[1:] - bg, FIRST)
    return strapdown.preintegrate(steps, force[:-1] - ba, force[1:] - ba)


def test_motion_is_that_of_fine_integration() -> None:
    """Oracle: the same analytic signals, integrated in steps a hundred times finer."""
    fine = np.linspace(0.0, PER * DT, PER * 100 + 1)
    w = np.stack([np.sin(2 * fine), 2 * np.cos(3 * fine), 1 + 0.5 * np.sin(fine)], axis=1)
    f = np.stack([np.sin(4 * fine), np.cos(fine), 9.8 + 0.3 * np.sin(7 * fine)], axis=1)
    steps = Steps(np.diff(fine), w[:-1], w[1:], np.array([0, len(fine) - 1]))
    exact, coarse = strapdown.preintegrate(steps, f[:-1], f[1:]), made()
    assert np.allclose(coarse.dv[0], exact.dv[0], atol=2e-5)  # second order: 5 ms steps, 10 m/s^2, 2 rad/s
    assert np.allclose(coarse.dp[0], exact.dp[0], atol=1e-6)
    assert coarse.span[0] == pytest.approx(PER * DT)


def test_a_standing_imu_feels_gravity_only() -> None:
    still = made(rate=np.zeros_like(RATE), force=np.tile([0.0, 0.0, 9.8], (len(T), 1)))
    span = PER * DT
    assert np.allclose(still.dq, [1.0, 0.0, 0.0, 0.0])
    assert np.allclose(still.dv, [0.0, 0.0, 9.8 * span])
    assert np.allclose(still.dp, [0.0, 0.0, 9.8 * span**2 / 2])
    assert np.allclose(still.v_ba, -span * np.eye(3))
    assert np.allclose(still.p_ba, -(span**2) / 2 * np.eye(3))


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_derivatives_are_those_of_finite_differences(axis: int) -> None:
    step = 1e-5
    base, moved = made(), np.zeros(3)
    moved[axis] = step
    by_gyro, by_accel = made(bg=moved), made(ba=moved)
    turn = rotation.log_quaternion(rotation.multiply(rotation.conjugate(base.dq), by_gyro.dq)) / step
    assert np.allclose(turn, base.q_bg[:, :, axis], atol=3e-6)
    assert np.allclose((by_gyro.dv - base.dv) / step, base.v_bg[:, :, axis], atol=3e-6)
    assert np.allclose((by_gyro.dp - base.dp) / step, base.p_bg[:, :, axis], atol=3e-7)
    assert np.allclose((by_accel.dv - base.dv) / step, base.v_ba[:, :, axis], atol=1e-8)
    assert np.allclose((by_accel.dp - base.dp) / step, base.p_ba[:, :, axis], atol=1e-8)


def step_on(q: Array, v: Array, p: Array, motion: strapdown.Motion) -> tuple[Array, Array, Array]:
    """Carry a state over the first interval."""
    g, span = np.array([0.0, 0.0, -9.8]), motion.span[0]
    R = rotation.matrix(q)
    return (
        rotation.multiply(q, motion.dq[0]),
        v + g * span + R @ motion.dv[0],
        p + v * span + 0.5 * g * span**2 + R @ motion.dp[0],
    )


@pytest.mark.parametrize("column", range(15))
def test_transition_is_the_derivative_of_the_motion(column: int) -> None:
    q = rotation.exp_quaternion(np.array([0.3, -0.7, 1.1]))
    v, p, d = np.array([1.0, -2.0, 0.5]), np.array([3.0, 4.0, -1.0]), np.zeros(15)
    d[column] = 1e-6
    base = made()
    Phi = strapdown.transition(rotation.matrix(q)[None].repeat(M, axis=0), base)[0]
    q0, v0, p0 = step_on(q, v, p, base)
    q1, v1, p1 = step_on(
        rotation.multiply(q, rotation.exp_quaternion(d[:3])), v + d[3:6], p + d[6:9], made(d[9:12], d[12:15])
    )
    moved = np.concatenate([rotation.log_quaternion(rotation.multiply(rotation.conjugate(q0), q1)), v1 - v0, p1 - p0])
    assert np.allclose(moved / 1e-6, Phi[:9, column], atol=2e-5)


def test_noise_is_that_of_a_thousand_noisy_imus() -> None:
    """White noise on every sample (as means over a step, so exactly white), errors gathered over one interval."""
    rng, runs, n_r, n_a = np.random.default_rng(1), 1500, 0.02**2, 0.1**2
    R = rotation.matrix(rotation.exp_quaternion(np.array([0.2, 0.4, -0.5])))
    rate, force = np.tile([0.4, -0.2, 0.6], (PER, 1)), np.tile([0.5, 1.0, 9.6], (PER, 1))
    steps = Steps(np.full(PER, DT), rate, rate, np.array([0, PER]))
    clean = strapdown.preintegrate(steps, force, force)
    errors = np.empty((runs, 9))
    for k in range(runs):
        w = rate + rng.normal(0.0, np.sqrt(n_r / DT), (PER, 3))
        f = force + rng.normal(0.0, np.sqrt(n_a / DT), (PER, 3))
        noisy = strapdown.preintegrate(Steps(steps.dt, w, w, steps.first), f, f)
        turn = rotation.log_quaternion(rotation.multiply(rotation.conjugate(noisy.dq[0]), clean.dq[0]))
        errors[k] = np.concatenate([turn, R @ (clean.dv[0] - noisy.dv[0]), R @ (clean.dp[0] - noisy.dp[0])])
    Q = strapdown.noise(R[None], clean, np.array([n_r]), np.array([n_a]), 1e-12, 1e-12)[0, :9, :9]
    whitened = np.linalg.solve(np.linalg.cholesky(Q), errors.T)
    found = whitened @ whitened.T / runs
    assert np.allclose(found, np.eye(9), atol=4.5 * np.sqrt(2.0 / runs))  # 99.99 % of 45 entries, and the sums' step
