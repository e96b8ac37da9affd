"""A random walk seen in noise: the tridiagonal smoother and the likelihood against the Kalman filter of maths."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from attest_cli.maths import kalman, local_level, sequential

Array = NDArray[np.float64]
N = 60


def record(seed: int) -> tuple[Array, Array, Array]:
    """Measurements (n, 2), their noise (n,) over three decades, steps of the walk (n - 1,)."""
    rng = np.random.default_rng(seed)
    Q, R = 10.0 ** rng.uniform(-4, -2, N - 1), 10.0 ** rng.uniform(-4, -1, N)
    walk = np.cumsum(np.concatenate([[0.0], rng.normal(0.0, np.sqrt(Q))]))
    return walk[:, None] + rng.normal(0.0, np.sqrt(R), (2, N)).T, R, Q


def filtered(z: Array, R: Array, Q: Array) -> sequential.Pass:
    """The general filter; its first measurement is its prior, as likelihoods here are given the first one."""
    eye = np.eye(2)
    return sequential.run(
        N, z[0], R[0] * eye, 2,
        lambda k, x: (x, eye, Q[k] * eye),
        lambda k, x, _P: (z[k] - x, eye, R[k] * eye) if k else None,
    )  # fmt: skip


@pytest.mark.parametrize("seed", [1, 2])
def test_smoother_is_rts(seed: int) -> None:
    z, R, Q = record(seed)
    forward = filtered(z, R, Q)
    errors = kalman.rts(forward.chain)
    mean, variance = local_level.smooth(z, 1.0 / R, Q)
    assert np.abs(mean - forward.x - errors.d).max() < 1e-12
    assert np.abs(variance / errors.P[:, 0, 0] - 1.0).max() < 1e-10
    assert np.abs(variance / errors.P[:, 1, 1] - 1.0).max() < 1e-10


def test_smoother_bridges_what_was_not_measured() -> None:
    z, R, Q = record(3)
    information = 1.0 / R
    information[20:30] = 0.0
    z[20:30] = np.nan_to_num(np.inf)  # never looked at but for its finite zero weight
    z[20:30] = 7.0
    mean, variance = local_level.smooth(z, information, Q)
    share = np.cumsum(Q[19:30])[:-1] / Q[19:30].sum()
    assert np.abs(mean[20:30] - (1 - share[:, None]) * mean[19] - share[:, None] * mean[30]).max() < 1e-12
    assert variance[25] > max(variance[19], variance[30])


@pytest.mark.parametrize("scale", [1.0, 0.2, 30.0])
def test_likelihood_of_any_scale_is_the_filters(scale: float) -> None:
    z, R, Q = record(4)
    squares, logs = local_level.misfit(z, R, Q)
    found = -0.5 * (squares / scale + 2.0 * logs + 2.0 * (N - 1) * np.log(2 * np.pi * scale))
    assert found == pytest.approx(filtered(z, scale * R, scale * Q).log_likelihood(), rel=1e-12)


def test_many_models_at_once_are_one_by_one() -> None:
    z, R, Q = record(5)
    noise = np.array([0.1, 1.0, 10.0])
    squares, logs = local_level.misfit(z[:, None, None], R[:, None, None] * noise, Q[:, None, None] * np.ones((2, 1)))
    for i, factor in enumerate(noise):
        one = local_level.misfit(z, factor * R, Q)
        assert squares[1, i] == pytest.approx(one[0], rel=1e-12)
        assert logs[0, i] == pytest.approx(one[1], rel=1e-12)
