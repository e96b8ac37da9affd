from __future__ import annotations

import numpy as np
from support import still

from attest_cli.calibration.rest import cut
from attest_cli.calibration.smooth import follow_walk


def test_the_walk_and_the_coefficients_have_the_posterior_of_all_blocks_at_once() -> None:
    rng = np.random.default_rng(0)
    pieces = [still.piece(40, 0.1), still.piece(25, 0.1, 11.0, 1), still.piece(30, 0.1, 20.0, 2)]
    blocks, _ = cut(pieces, 0.5)
    n = len(blocks.t)
    J = np.stack([np.ones(n), blocks.t / 10.0], axis=1)
    residual = rng.normal(size=n)
    N, K = 0.3, 0.2
    found = follow_walk(blocks, residual, J, 100.0 * np.eye(2), N, K)
    H = np.hstack([np.tril(np.ones((n, n)))[:, 1:], J])  # steps of the walk between blocks, and coefficients
    information = H.T @ np.diag(blocks.span / N**2) @ H
    information += np.diag(np.append(1.0 / (K**2 * np.diff(blocks.t)), [0.0, 0.0]))
    P = np.linalg.inv(information)
    np.testing.assert_allclose(found.mean, H @ P @ H.T @ (residual * blocks.span / N**2), atol=1e-3)
    np.testing.assert_allclose(found.sigma, np.sqrt(np.einsum("ij,jk,ik->i", H, P, H)), rtol=1e-3)


def test_innovations_are_white_and_of_unit_variance_where_the_model_is_right() -> None:
    rng = np.random.default_rng(1)
    rate = still.walking(rng, 20_000, 0.1, 0.01, 1e-3)
    blocks, edges = cut([still.piece(len(rate), 0.1)], 2.0)
    z = np.add.reduceat(rate, edges[0][:-1]) / blocks.count
    found = follow_walk(blocks, z - z.mean(), np.ones((len(z), 1)), np.eye(1), 0.01, 1e-3)
    later = found.innovations[1:]
    assert abs(np.var(later) - 1.0) < 4.0 * np.sqrt(2.0 / len(later))
    assert abs(np.mean(later[1:] * later[:-1])) < 4.0 / np.sqrt(len(later))
