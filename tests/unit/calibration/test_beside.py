"""The random walk beside a fitted curve: the restricted likelihood against its dense form."""

from __future__ import annotations

import numpy as np
import pytest
from support import still

from attest_cli.calibration.beside import _restricted, walk_beside
from attest_cli.calibration.rest import cut, means
from attest_cli.calibration.walk import build_walk
from attest_cli.maths.bias import gradient

EXPONENTIAL = (0.153, -0.264, 338.4)


def drive(seed: int, K: float = 5e-4) -> tuple[object, np.ndarray, np.ndarray]:
    made = still.stops(np.random.default_rng(seed), "exponential + walk", K=K)
    blocks, edges = cut(made.pieces, 2.0)
    return blocks, means(made.rates, edges), gradient("exponential", EXPONENTIAL, blocks.t)


@pytest.mark.parametrize("ratio", [0.0, 1e-4, 1e-2])
def test_the_restricted_likelihood_is_that_of_the_dense_covariance(ratio: float) -> None:
    blocks, z, X = drive(1)
    walk = build_walk(blocks, level=True)
    dz, dX = walk.differences(z), walk.differences(X)
    V = sum(
        k * (np.diag(d) + np.diag(off, 1) + np.diag(off, -1)) for k, (d, off) in ((1.0, walk.white), (ratio, walk.walk))
    )
    n, p = dX.shape
    W = np.linalg.inv(V)
    normal = dX.T @ W @ dX
    r = dz - dX @ np.linalg.solve(normal, dX.T @ W @ dz)
    variance = float(r @ W @ r) / (n - p)
    value = (n - p) * np.log(variance) + np.linalg.slogdet(V)[1] + np.linalg.slogdet(normal)[1]
    assert _restricted(walk, ratio, dz, dX) == pytest.approx((value, np.sqrt(variance)), rel=1e-8)


def test_what_the_curve_can_explain_changes_nothing() -> None:
    blocks, z, X = drive(2)
    assert walk_beside(blocks, z + X @ [0.3, -0.2, 1e-3], X) == pytest.approx(walk_beside(blocks, z, X), rel=1e-6)


def test_a_walk_is_found_at_its_strength_though_a_curve_took_its_slow_part() -> None:
    found = [walk_beside(*drive(seed)) for seed in range(8)]
    # about 29 gaps less 3 parameters: K known to 1 / sqrt(2 26) = 14 % a drive; the mean of 8 within 4 sigma
    assert np.mean(found) == pytest.approx(5e-4, rel=4 * 0.14 / np.sqrt(8))


def test_a_walk_that_is_not_there_is_not_taken_for_none() -> None:
    blocks, z, X = drive(3, K=0.0)
    assert 0.0 < walk_beside(blocks, z, X) < 2e-4
