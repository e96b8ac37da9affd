"""The adjoint smoother against Rauch-Tung-Striebel, and the likelihood without a kept run."""

from __future__ import annotations

import numpy as np
import pytest

from attest_cli.maths import adjoint, kalman, sequential


def run(
    seed: int, n: int = 60, s: int = 8, m: int = 3, q: float = 1.0, noise: float = 1.0
) -> tuple[sequential.Pass, float]:  # fmt: skip
    """A random linear model whose last three states are constants, measured at half of its steps; variances times ``q``
    and ``noise``.
    """
    rng = np.random.default_rng(seed)
    Phi = np.tile(np.eye(s), (n, 1, 1))
    Phi[:, : s - 3] += 0.2 * rng.standard_normal((n, s - 3, s))
    Q = np.zeros((n, s, s))
    Q[:, range(s - 3), range(s - 3)] = q * rng.uniform(0.01, 0.1, (n, s - 3))
    H, r, seen = rng.standard_normal((n, m, s)), rng.standard_normal((n, m)), rng.random(n) < 0.5
    P0 = np.diag(10.0 ** rng.uniform(-1, 4, s))

    def predict(k: int, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return Phi[k] @ x, Phi[k], Q[k]

    def observe(k: int, x: np.ndarray, _: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        return (r[k] - H[k] @ x, H[k], noise * np.eye(m)) if seen[k] else None

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


@pytest.mark.parametrize("seed", range(3))
def test_seen_less_expected_is_the_slope_of_the_likelihood(seed: int) -> None:
    """To the logarithm of the variance of what drives the motion, and of what is measured."""
    found, _ = run(seed)
    back, step = adjoint.adjoints(found), 1e-4
    slopes = [
        (run(seed, **{name: np.exp(step)})[1] - run(seed, **{name: np.exp(-step)})[1]) / (2.0 * step)
        for name in ("q", "noise")
    ]
    shock, Shock, Q = back.shock[1:], back.Shock[1:], found.chain.Q
    moved = np.einsum("ki,kij,kj->", shock, Q, shock) - np.einsum("kij,kji->", Q, Shock)
    assert 0.5 * moved == pytest.approx(slopes[0], rel=1e-5)
    u, D = adjoint.misfits(found, back)
    seen = np.isfinite(found.nu[:, 0])
    assert 0.5 * float(np.sum(u[seen] ** 2 - D[seen])) == pytest.approx(slopes[1], rel=1e-5)
