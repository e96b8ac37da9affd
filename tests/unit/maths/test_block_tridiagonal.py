"""Odd-even reduction against the dense inverse."""

from __future__ import annotations

import numpy as np
import pytest
from support.linear import spd

from attest_cli.maths import block_tridiagonal


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 6, 7, 8, 9, 16, 17, 31])
@pytest.mark.parametrize("s", [1, 6])
def test_solution_and_covariances_are_those_of_the_dense_inverse(rng: np.random.Generator, n: int, s: int) -> None:
    A = np.zeros((n, s, n, s))
    for k in range(n):
        A[k, :, k] += spd(rng, s)
        if k:  # a positive definite link between neighbours
            link = rng.normal(size=(2 * s, 2 * s))
            block = link @ link.T / s
            A[k - 1, :, k - 1] += block[:s, :s]
            A[k, :, k] += block[s:, s:]
            A[k - 1, :, k] += block[:s, s:]
            A[k, :, k - 1] += block[s:, :s]
    right = rng.normal(size=(n, s))
    flat = A.reshape(n * s, n * s)
    inverse = np.linalg.inv(flat).reshape(n, s, n, s)
    diagonal = np.stack([A[k, :, k] for k in range(n)])
    upper = np.stack([A[k, :, k + 1] for k in range(n - 1)]) if n > 1 else np.zeros((0, s, s))
    kept = diagonal.copy(), upper.copy(), right.copy()

    x, covariance, cross = block_tridiagonal.solve(diagonal, upper, right)

    scale = np.abs(inverse).max()
    assert np.allclose(x.ravel(), np.linalg.solve(flat, right.ravel()), rtol=0, atol=1e-11 * np.abs(x).max())
    assert np.abs(covariance - [inverse[k, :, k] for k in range(n)]).max() < 1e-12 * scale
    assert cross.shape == (n - 1, s, s)
    assert all(np.abs(cross[k] - inverse[k, :, k + 1]).max() < 1e-12 * scale for k in range(n - 1))
    assert np.array_equal(covariance, covariance.swapaxes(1, 2))
    for before, after in zip(kept, (diagonal, upper, right), strict=True):
        assert np.array_equal(before, after)  # the inputs are left alone
