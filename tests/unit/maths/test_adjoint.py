"""The adjoint smoother against Rauch-Tung-Striebel, and the likelihood without a kept run."""

from __future__ import annotations

import numpy as np
import pytest

from attest_cli.maths import adjoint, kalman, sequential


def run(seed: int, n: int = 60, s: int = 8, m: int = 3) -> tuple[sequential.Pass, float]:
    """A random linear model whose last three states are constants, measured at half of its steps."""
    rng = np.random.default_rng(seed)
    Phi = np.tile(np.eye(s), (n, 1, 1))
    Phi[:, : s - 3] += 0.2 * rng.standard_normal((n, s - 3, s))
    Q = np.zeros((n, s, s))
    Q[:, range(s - 3), range(s - 3)] = rng.uniform(0.01, 0.1, (n, s - 3))
    H, r, seen = rng.standard_normal((n, m, s)), rng.standard_normal((n, m)), rng.random(n) < 0.5
    P0 = np.diag(10.0 ** rng.uniform(-1, 4, s))

    def predict(k: int, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return Phi[k] @ x, Phi[k], Q[k]

    def observe(k: int, x: np.ndarray, _: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        return (r[k] - H[k] @ x, H[k], np.eye(m)) if seen[k] else None

    found = sequential.run(n, np.zeros(s), P0, m, predict, observe)
    return found, sequential.log_likelihood(n, np.zeros(s), P0, predict, observe)


@pytest.mark.parametrize("seed", range(5))
def test_it_is_the_same_smoother(seed: int) -> None:
    found, _ = run(seed)
    one, other = adjoint.smooth(found), kalman.rts(found.chain)
    sigma = np.sqrt(np.einsum("kii->ki", other.P))
    assert np.abs((one.d - other.d) / sigma).max() < 1e-6
    assert np.abs((one.P - other.P) / (sigma[:, :, None] * sigma[:, None])).max() < 1e-6
    assert np.abs((one.cross - other.cross) / (sigma[:-1, :, None] * sigma[1:, None])).max() < 1e-6
    assert (adjoint.mean(found) == one.d).all()


def test_the_likelihood_needs_no_kept_run() -> None:
    found, value = run(9)
    assert value == pytest.approx(found.log_likelihood(), rel=1e-12)
