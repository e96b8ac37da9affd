"""Kalman algebra against the dense joint Gaussian, scipy's optimum and the reference vectors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import least_squares
from support.linear import Problem, dense, dense_turning, forward, random_problem, spd, turning_chain
from support.vectors import load, wxyz

from attest_cli.maths import kalman, rotation
from attest_cli.maths.kalman import Chain, Errors
from attest_cli.sensors import Direction, Measurement

Array = NDArray[np.float64]
SEEDS = range(6)


def smoothers(chain: Chain) -> tuple[Errors, Errors]:
    return kalman.fuse(chain, *kalman.information(chain)), kalman.rts(chain)


def sigmas(P: Array) -> Array:
    return np.sqrt(np.einsum("kii->ki", P))


def covariance_error(found: Array, wanted: Array, left: Array, right: Array) -> float:
    """Largest difference of covariance elements over the sigmas they belong to."""
    return float(np.abs((found - wanted) / (left[:, :, None] * right[:, None, :])).max())


def correlation_eigenvalues(P: Array, scale: Array) -> Array:
    """Eigenvalues of ``P`` (n, s, s) after scaling by the sigmas ``scale`` (n, s)."""
    return np.linalg.eigvalsh(P / (scale[:, :, None] * scale[:, None, :]))


@pytest.fixture(params=SEEDS)
def problem(request: pytest.FixtureRequest) -> Problem:
    rng = np.random.default_rng([7, request.param])
    return random_problem(rng, n=int(rng.integers(6, 16)), s=int(rng.integers(2, 7)))


def test_smoothers_agree_on_a_linear_problem(problem: Problem) -> None:
    _, chain = forward(problem)
    two, one = smoothers(chain)
    sigma = sigmas(one.P)
    assert np.abs((two.d - one.d) / sigma).max() < 1e-8
    assert covariance_error(two.P, one.P, sigma, sigma) < 1e-8
    assert covariance_error(two.cross, one.cross, sigma[:-1], sigma[1:]) < 1e-8


@pytest.mark.parametrize("which", [0, 1], ids=["two-filter", "rts"])
def test_smoothers_are_the_dense_posterior(problem: Problem, which: int) -> None:
    x, chain = forward(problem)
    mean, posterior = dense(problem)
    found = smoothers(chain)[which]
    n = len(x)
    P = np.stack([posterior[k, :, k] for k in range(n)])
    cross = np.stack([posterior[k, :, k + 1] for k in range(n - 1)])
    sigma = sigmas(P)
    assert np.abs((x + found.d - mean) / sigma).max() < 1e-6
    assert covariance_error(found.P, P, sigma, sigma) < 1e-6
    assert covariance_error(found.cross, cross, sigma[:-1], sigma[1:]) < 1e-6


@pytest.mark.parametrize("seed", SEEDS)
def test_smoothers_are_the_dense_posterior_after_large_resets(seed: int) -> None:
    chain, problem = turning_chain(np.random.default_rng([8, seed]))
    assert np.linalg.norm(chain.dx[:, :3], axis=1).max() > 0.5  # the resets are no formality here
    mean, posterior = dense_turning(chain, problem)
    n = len(mean)
    P = np.stack([posterior[k, :, k] for k in range(n)])
    cross = np.stack([posterior[k, :, k + 1] for k in range(n - 1)])
    sigma = sigmas(P)
    for found in smoothers(chain):
        assert np.abs((found.d - mean) / sigma).max() < 1e-6
        assert covariance_error(found.P, P, sigma, sigma) < 1e-6
        assert covariance_error(found.cross, cross, sigma[:-1], sigma[1:]) < 1e-6
    two, one = smoothers(chain)
    assert np.abs((two.d - one.d) / sigma).max() < 1e-8
    assert covariance_error(two.P, one.P, sigma, sigma) < 1e-8


def test_jacobians_of_the_resets_are_inverses_and_trivial_without_rotations() -> None:
    chain, _ = turning_chain(np.random.default_rng(2))
    J, J_inv = chain.reset_jacobians()
    assert np.allclose(J @ J_inv, np.eye(6), atol=1e-13)
    assert np.abs(J - np.eye(6)).max() > 0.1
    plain, _ = replace(chain, rotations=0).reset_jacobians()
    assert np.array_equal(plain, np.tile(np.eye(6), (len(plain), 1, 1)))


def test_smoothed_covariance_is_below_the_forward_one(problem: Problem) -> None:
    _, chain = forward(problem)
    for found in smoothers(chain):
        assert correlation_eigenvalues(chain.P - found.P, sigmas(chain.P)).min() > -1e-10
        assert correlation_eigenvalues(chain.P - found.P, sigmas(chain.P)).max() > 0.01  # and somewhere truly below


def test_covariances_are_symmetric_and_positive_definite(problem: Problem) -> None:
    _, chain = forward(problem)
    for P in (chain.P_pred, chain.P, *(found.P for found in smoothers(chain))):
        assert np.array_equal(P, P.swapaxes(1, 2))
        assert correlation_eigenvalues(P, sigmas(P)).min() > 0.0
        np.linalg.cholesky(P)


def test_smoothed_is_filtered_at_the_last_node(problem: Problem) -> None:
    _, chain = forward(problem)
    for found in smoothers(chain):
        assert np.array_equal(found.d[-1], np.zeros(chain.dx.shape[1]))
        assert np.allclose(found.P[-1], chain.P[-1], rtol=0, atol=1e-15 * np.abs(chain.P[-1]).max())


def test_time_reversal_with_a_diffuse_prior() -> None:
    p = random_problem(np.random.default_rng(4), n=10, s=4, m=3)
    inverse = np.linalg.inv(p.Phi)
    diffuse = 1e8 * np.eye(4)
    ahead = replace(p, P0=diffuse, mean=np.zeros(4))
    behind = Problem(
        np.zeros(4), diffuse, inverse[::-1], (inverse @ p.Q @ inverse.swapaxes(1, 2))[::-1], p.H[::-1], p.R[::-1],
        p.z[::-1], p.measured[::-1],
    )  # fmt: skip
    for which in (0, 1):
        results = []
        for problem in (ahead, behind):
            x, chain = forward(problem)
            found = smoothers(chain)[which]
            results.append((x + found.d, found.P))
        (x_ahead, P_ahead), (x_behind, P_behind) = results[0], (results[1][0][::-1], results[1][1][::-1])
        sigma = sigmas(P_ahead)
        assert np.abs((x_ahead - x_behind) / sigma).max() < 1e-5
        assert covariance_error(P_ahead, P_behind, sigma, sigma) < 1e-5


@given(st.integers(0, 2**32 - 1))
def test_a_measurement_more_never_raises_a_covariance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p = random_problem(rng, n=6, s=3)
    fewer = replace(p, measured=p.measured & (rng.random(6) < 0.5))
    (_, more_chain), (_, fewer_chain) = forward(p), forward(fewer)
    more, less = kalman.rts(more_chain).P, kalman.rts(fewer_chain).P
    assert correlation_eigenvalues(less - more, sigmas(less)).min() > -1e-10
    assert correlation_eigenvalues(fewer_chain.P - more_chain.P, sigmas(fewer_chain.P)).min() > -1e-10


def test_without_later_measurements_there_is_nothing_to_smooth() -> None:
    p = random_problem(np.random.default_rng(5), n=8)
    measured = np.zeros(8, dtype=np.bool_)
    measured[:2] = True
    _, chain = forward(replace(p, measured=measured))
    Y, y = kalman.information(chain)
    assert not Y[1:].any()
    assert not y[1:].any()
    for found in smoothers(chain):
        assert np.abs(found.d[1:]).max() < 1e-12
        assert np.allclose(found.P[1:], chain.P[1:], rtol=1e-12)


def test_linear_update_is_the_textbook_one(rng: np.random.Generator) -> None:
    P, R, H, r = spd(rng, 5), spd(rng, 3), rng.normal(size=(3, 5)), rng.normal(size=3)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    for rounds in (1, 8):
        found = kalman.iterated_update(P, lambda d: (r - H @ d, H), R, 0, rounds)
        assert np.allclose(found.dx, K @ r, atol=1e-13)
        assert np.allclose(found.P, P - K @ H @ P, atol=1e-13)
        assert np.allclose(found.nu, r, atol=1e-13)
        assert np.allclose(found.S, H @ P @ H.T + R, atol=1e-13)
        assert np.allclose(found.info, H.T @ np.linalg.solve(R, H), atol=1e-12)
        assert np.allclose(found.vec, H.T @ np.linalg.solve(R, r - H @ found.dx), atol=1e-12)


class Vector3:
    """The update of v3: sun in the plane and gravity, 0.24 rad away."""

    def __init__(self) -> None:
        v = self.v = load("v3_update")
        self.group = (
            Measurement("sun", Direction(v["pI"], v["T_SB"], "plane"), 0, 0.0, v["sun"][None], np.eye(2)),
            Measurement("gravity", Direction(v["gI"], np.eye(3), "full"), 0, 0.0, v["grav"][None], np.eye(3)),
        )
        self.R = np.diag(v["R"])
        self.q = wxyz(v["q"])

    def linearise(self, d: Array) -> tuple[Array, Array]:
        R_nb = rotation.matrix(rotation.multiply(self.q, rotation.exp_quaternion(d[:3])))
        pairs = [m.linearise(R_nb, self.v["b"] + d[3:]) for m in self.group]
        return np.concatenate([r for r, _ in pairs]), np.concatenate([H for _, H in pairs])

    def update(self, rounds: int) -> kalman.Update:
        return kalman.iterated_update(self.v["P"], self.linearise, self.R, 3, rounds)


def test_first_linearisation_is_vector_v3() -> None:
    case = Vector3()
    r, H = case.linearise(np.zeros(6))
    assert np.allclose(r, case.v["z"], atol=1e-14)
    assert np.allclose(H, case.v["H"], atol=1e-14)


def test_iterated_update_is_vector_v3() -> None:
    case, v = Vector3(), load("v3_update")
    found = case.update(8)
    sigma = np.sqrt(np.diag(v["iek_P"]))
    assert np.abs((found.dx - v["iek_dx"]) / sigma).max() < 1e-8
    assert np.abs((found.P - v["iek_P"]) / np.outer(sigma, sigma)).max() < 1e-8
    q = rotation.multiply(case.q, rotation.exp_quaternion(found.dx[:3]))
    assert np.abs(q - wxyz(v["iek_q"])).max() < 1e-8 * sigma[:3].min()
    assert np.abs((v["b"] + found.dx[3:] - v["iek_b"]) / sigma[3:]).max() < 1e-8


def test_plain_update_is_vector_v3() -> None:
    case, v = Vector3(), load("v3_update")
    found = case.update(1)
    sigma = np.sqrt(np.diag(v["ekf_P"]))
    assert np.abs((found.dx - v["ekf_dx"]) / sigma).max() < 1e-8
    back = np.eye(6)  # the vector's plain filter has no reset
    back[:3, :3] = rotation.inverse_right_jacobian(found.dx[:3])
    assert np.abs((back @ found.P @ back.T - v["ekf_P"]) / np.outer(sigma, sigma)).max() < 1e-8
    assert float(found.nu @ np.linalg.solve(found.S, found.nu)) == pytest.approx(float(v["nis"]), rel=1e-10)


def test_iterated_update_is_the_maximum_a_posteriori_of_scipy() -> None:
    case = Vector3()
    root = np.linalg.inv(np.linalg.cholesky(case.v["P"]))
    white = 1.0 / np.sqrt(np.diag(case.R))
    optimum = least_squares(
        lambda d: np.concatenate([root @ d, white * case.linearise(d)[0]]), np.zeros(6),
        xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale=np.sqrt(np.diag(case.v["P"])),
    )  # fmt: skip
    found = case.update(8)
    assert np.abs((found.dx - optimum.x) / np.sqrt(np.diag(found.P))).max() < 1e-5  # differences limit scipy's gradient
    J = np.eye(6)
    J[:3, :3] = rotation.right_jacobian(found.dx[:3])
    assert np.allclose(found.P, J @ np.linalg.inv(optimum.jac.T @ optimum.jac) @ J.T, rtol=0, atol=1e-5 * found.P.max())


def test_information_of_an_update_gives_its_posterior_back() -> None:
    """Prior about the updated estimate plus ``info``, ``vec``: the posterior, with mean zero."""
    case = Vector3()
    found = case.update(8)
    J = np.eye(6)
    J[:3, :3] = rotation.right_jacobian(found.dx[:3])
    prior = np.linalg.inv(J @ case.v["P"] @ J.T)
    sigma = np.sqrt(np.diag(found.P))
    assert np.abs((np.linalg.inv(prior + found.info) - found.P) / np.outer(sigma, sigma)).max() < 1e-8
    assert np.abs(found.P @ (found.vec - prior @ J @ found.dx) / sigma).max() < 1e-8
