"""The per-sample filter loop against the joint Gaussian of the whole record."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import multivariate_normal

from attest_cli.maths import kalman, sequential

Array = NDArray[np.float64]
N, S, M = 7, 3, 2
SKIPPED = 3


class Linear:
    """A small linear model with a known input, one sample without a measurement, and its dense joint solution."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.x0, self.P0 = rng.normal(size=S), self.spd(rng, S)
        self.Phi = np.eye(S) + 0.3 * rng.normal(size=(N - 1, S, S))
        self.Q = np.array([self.spd(rng, S) for _ in range(N - 1)])
        self.u = rng.normal(size=(N - 1, S))
        self.H = rng.normal(size=(N, M, S))
        self.R = np.array([self.spd(rng, M) for _ in range(N)])
        self.z = rng.normal(size=(N, M))

    @staticmethod
    def spd(rng: np.random.Generator, n: int) -> Array:
        A = rng.normal(size=(n, n))
        return np.asarray(A @ A.T + 0.1 * np.eye(n))

    def run(self) -> sequential.Pass:
        def predict(k: int, x: Array) -> tuple[Array, Array, Array]:
            return self.Phi[k] @ x + self.u[k], self.Phi[k], self.Q[k]

        def observe(k: int, x: Array, P: Array) -> tuple[Array, Array, Array] | None:
            return None if k == SKIPPED else (self.z[k] - self.H[k] @ x, self.H[k], self.R[k])

        return sequential.run(N, self.x0, self.P0, M, predict, observe)

    def joint(self) -> tuple[Array, Array, Array, Array]:
        """Prior mean and covariance of all states, and of all measurements given them: the dense oracle."""
        mean, cov = np.zeros(N * S), np.zeros((N * S, N * S))
        mean[:S], cov[:S, :S] = self.x0, self.P0
        for k in range(N - 1):
            a, b = slice(k * S, (k + 1) * S), slice((k + 1) * S, (k + 2) * S)
            mean[b] = self.Phi[k] @ mean[a] + self.u[k]
            cov[b, : b.start] = self.Phi[k] @ cov[a, : b.start]
            cov[: b.start, b] = cov[b, : b.start].T
            cov[b, b] = self.Phi[k] @ cov[a, a] @ self.Phi[k].T + self.Q[k]
        seen = [k for k in range(N) if k != SKIPPED]
        G, R = np.zeros((len(seen) * M, N * S)), np.zeros((len(seen) * M, len(seen) * M))
        for i, k in enumerate(seen):
            G[i * M : (i + 1) * M, k * S : (k + 1) * S] = self.H[k]
            R[i * M : (i + 1) * M, i * M : (i + 1) * M] = self.R[k]
        return mean, cov, G, R


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_filter_and_both_smoothers_are_the_joint_gaussian(seed: int) -> None:
    model = Linear(seed)
    found = model.run()
    mean, cov, G, R = model.joint()
    z = np.delete(model.z, SKIPPED, axis=0).ravel()
    gain = cov @ G.T @ np.linalg.inv(G @ cov @ G.T + R)
    x, P = mean + gain @ (z - G @ mean), cov - gain @ G @ cov
    for errors in (kalman.rts(found.chain), kalman.fuse(found.chain, *kalman.information(found.chain))):
        assert np.allclose(found.x + errors.d, x.reshape(N, S), rtol=1e-9, atol=1e-9)
        for k in range(N):
            assert np.allclose(errors.P[k], P[k * S : (k + 1) * S, k * S : (k + 1) * S], rtol=1e-8, atol=1e-10)
        for k in range(N - 1):
            lag = P[k * S : (k + 1) * S, (k + 1) * S : (k + 2) * S]
            assert np.allclose(errors.cross[k], lag, rtol=1e-8, atol=1e-10)
    assert np.allclose(found.x[-1], x[-S:])  # the filter's end is the smoother's


@pytest.mark.parametrize("seed", [3, 4])
def test_log_likelihood_is_that_of_all_measurements_at_once(seed: int) -> None:
    model = Linear(seed)
    mean, cov, G, R = model.joint()
    dense = multivariate_normal(G @ mean, G @ cov @ G.T + R).logpdf(np.delete(model.z, SKIPPED, axis=0).ravel())
    assert model.run().log_likelihood() == pytest.approx(dense, rel=1e-10)


def test_a_correction_of_its_own_is_what_the_chain_remembers() -> None:
    model = Linear(5)

    def half(k: int, x: Array, dx: Array, K: Array) -> Array:
        return x + 0.5 * dx

    def predict(k: int, x: Array) -> tuple[Array, Array, Array]:
        return x, np.eye(S), model.Q[k]

    found = sequential.run(
        N, model.x0, model.P0, M, predict, lambda k, x, _: (model.z[k] - model.H[k] @ x, model.H[k], model.R[k]), half
    )
    assert np.allclose(found.chain.dx, found.x - found.x_pred)
    full = found.chain.P_pred[0] @ model.H[0].T @ np.linalg.solve(found.S[0], found.nu[0])
    assert np.allclose(found.chain.dx[0], 0.5 * full)
