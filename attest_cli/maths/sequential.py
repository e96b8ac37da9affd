r"""The forward loop of every filter that updates at each sample: it leaves a chain that any smoother can run back.

States are Euclidean (``rotations = 0``), so :math:`x_k=\hat x_{k|k-1}+\Delta x_k` and ``Chain.dx`` holds the
corrections as they were made, linear or not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .kalman import Chain, symmetric

Array = NDArray[np.float64]
LOG_2PI = float(np.log(2.0 * np.pi))
Predict = Callable[[int, Array], tuple[Array, Array, Array]]
"""``k, x_k`` -> predicted ``x_{k+1}`` (s,), ``Phi`` (s, s), ``Q`` (s, s) of the interval k -> k + 1."""
Observe = Callable[[int, Array, Array], tuple[Array, Array, Array] | None]
"""``k, x, P`` predicted -> residual (m,), Jacobian (m, s), noise (m, m); None: nothing measured at k."""
Correct = Callable[[int, Array, Array, Array], Array]
"""``k, x`` predicted, ``dx = K nu``, ``K`` -> updated state (s,), where it is not ``x + dx``."""


@dataclass(frozen=True, slots=True)
class Pass:
    """A forward pass over n samples: predicted and updated states ``x_pred``, ``x`` (n, s), the ``chain`` for the
    smoothers, innovations ``nu`` (n, m; NaN where nothing was measured), their covariances ``S`` (n, m, m) and
    Jacobians ``H`` (n, m, s).
    """

    x_pred: Array
    x: Array
    chain: Chain
    nu: Array
    S: Array
    H: Array

    def log_likelihood(self) -> float:
        r"""Return :math:`-\frac12\sum_k(\nu_k^TS_k^{-1}\nu_k+\log|2\pi S_k|)` over what was measured."""
        seen = np.isfinite(self.nu[:, 0])
        nu, S = self.nu[seen], self.S[seen]
        nis = np.einsum("ki,ki->k", nu, np.linalg.solve(S, nu[:, :, None])[:, :, 0])
        return float(-0.5 * np.sum(nis + np.linalg.slogdet(2.0 * np.pi * S)[1]))


def run(
    n: int, x0: Array, P0: Array, rows: int, predict: Predict, observe: Observe, correct: Correct | None = None
) -> Pass:
    r"""Predict and update at every sample (extended Kalman filter, Joseph form).

    .. math:: K=PH^T(HPH^T+R)^{-1},\quad P\leftarrow(I-KH)P(I-KH)^T+KRK^T

    Parameters
    ----------
    n : samples
    x0, P0 : (s,), (s, s) estimate before the first sample's measurement
    rows : m, measurements per sample
    predict, observe, correct : the model; ``correct`` where an update is no sum (normalised, rotated)

    Notes
    -----
    Measurement information for the smoothers is made in one batch afterwards, about the updated estimate:
    :math:`H^TR^{-1}H,\ H^TR^{-1}(\nu-H\Delta x)`.
    """
    s = len(x0)
    x_pred, x, dx = np.empty((n, s)), np.empty((n, s)), np.zeros((n, s))
    P_pred, P = np.empty((n, s, s)), np.empty((n, s, s))
    Phi, Q = np.empty((n - 1, s, s)), np.empty((n - 1, s, s))
    nu, H = np.full((n, rows), np.nan), np.zeros((n, rows, s))
    S, R = np.tile(np.eye(rows), (n, 1, 1)), np.tile(np.eye(rows), (n, 1, 1))
    for k, step in enumerate(_steps(n, x0, P0, predict, observe, correct)):
        if step.moved is not None:
            Phi[k - 1], Q[k - 1] = step.moved
        x_pred[k], P_pred[k], x[k], P[k] = step.x_pred, step.P_pred, step.x, step.P
        if step.seen is not None:
            (nu[k], H[k], R[k]), S[k] = step.seen, step.S
            dx[k] = step.x - step.x_pred
    chain = Chain(P_pred, P, Phi, Q, dx, *_information(nu, H, R, dx), 0)
    return Pass(x_pred, x, chain, nu, S, H)


def log_likelihood(n: int, x0: Array, P0: Array, predict: Predict, observe: Observe) -> float:
    """Return what :meth:`Pass.log_likelihood` would of the same run, without keeping it."""
    total = 0.0
    for step in _steps(n, x0, P0, predict, observe, None):
        if step.seen is not None:
            L = np.linalg.cholesky(step.S)
            z: Array = np.linalg.solve(L, step.seen[0])
            total += float(z @ z) + 2.0 * float(np.log(L.diagonal()).sum()) + len(z) * LOG_2PI
    return -0.5 * total


class Step(NamedTuple):
    """One sample of the loop: ``Phi``, ``Q`` that led to it, estimates before and after what was ``seen``."""

    moved: tuple[Array, Array] | None
    x_pred: Array
    P_pred: Array
    seen: tuple[Array, Array, Array] | None
    S: Array
    x: Array
    P: Array


def _steps(
    n: int, x0: Array, P0: Array, predict: Predict, observe: Observe, correct: Correct | None
) -> Iterator[Step]:  # fmt: skip
    """Run the loop."""
    from scipy.linalg.lapack import dposv

    eye, now, cov, moved, S = np.eye(len(x0)), x0, P0, None, P0
    for k in range(n):
        if k:
            now, Phi, Q = predict(k - 1, now)
            cov, moved = Phi @ cov @ Phi.T + Q, (Phi, Q)
        x_pred, P_pred = now, cov
        seen = observe(k, now, cov)
        if seen is not None:
            nu, H, R = seen
            PHt = cov @ H.T
            S = H @ PHt + R
            _, gain, failed = dposv(S, PHt.T)  # numpy's solve takes five times as long for a few rows
            K = (gain if failed == 0 else np.linalg.solve(S, PHt.T)).T
            step = K @ nu
            A = eye - K @ H
            cov = A @ cov @ A.T + K @ R @ K.T
            cov = 0.5 * (cov + cov.T)
            now = now + step if correct is None else correct(k, now, step, np.asarray(K))
        yield Step(moved, x_pred, P_pred, seen, S, now, cov)


def _information(nu: Array, H: Array, R: Array, dx: Array) -> tuple[Array, Array]:
    """Return measurement information and vector about the updated estimates; zero where nothing was measured."""
    residual = np.nan_to_num(nu) - np.einsum("kij,kj->ki", H, dx)
    weighted = np.linalg.solve(R, np.concatenate([H, residual[:, :, None]], axis=2))
    Ht = H.swapaxes(1, 2)
    return symmetric(Ht @ weighted[:, :, :-1]), np.asarray((Ht @ weighted[:, :, -1:])[:, :, 0])
