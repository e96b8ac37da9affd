r"""The smoother of Bryson and Frazier in its modified form: no covariance is inverted, constant states do no harm.

With the adjoint :math:`\hat\lambda_k` of all measurements after k and its covariance :math:`\hat\Lambda_k`,

.. math:: \tilde\lambda=(I-KH)^T\hat\lambda-H^TS^{-1}\nu,\quad
    \tilde\Lambda=(I-KH)^T\hat\Lambda(I-KH)+H^TS^{-1}H,\qquad
    \hat\lambda_{k}=\Phi_k^T\tilde\lambda_{k+1},\quad\hat\Lambda_{k}=\Phi_k^T\tilde\Lambda_{k+1}\Phi_k

the smoothed errors about the updated estimates are :math:`d=-P\hat\lambda`, :math:`P^s=P-P\hat\Lambda P`.
Source: Bierman 1973, "Fixed interval smoothing with discrete measurements".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .kalman import Errors, symmetric
from .sequential import Pass

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Adjoints:
    """What all measurements after a node say of its errors: ``lam`` (n, s), covariance ``Lam`` (n, s, s); ``shock`` and
    ``Shock`` the same with its own measurement, zero at the first node.
    """

    lam: Array
    Lam: Array
    shock: Array
    Shock: Array


def adjoints(run: Pass) -> Adjoints:
    r"""Return the adjoints of a run.

    A disturbance :math:`w\sim N(0,Q)` on the way to a node has, given all measurements, the mean
    :math:`-Q\tilde\lambda` and the covariance :math:`Q-Q\tilde\Lambda Q`.
    """
    HtS = _weighted(run)
    (shock, lam), (Shock, Lam) = _adjoints(run, HtS), _covariances(run, HtS)
    return Adjoints(lam, Lam, shock, Shock)


def misfits(run: Pass, back: Adjoints) -> tuple[Array, Array]:
    r"""Return what is left of each measurement :math:`v\sim N(0,I)`, given all others too, and its variance: (n, m).

    .. math:: u=S^{-1}\nu+K^T\hat\lambda,\quad D=\mathrm{diag}(S^{-1}+K^T\hat\Lambda K),\qquad
        E[v]=u,\quad\mathrm{Var}[v]=1-D
    """
    PHt = run.chain.P_pred @ run.H.swapaxes(1, 2)
    inverse = np.linalg.inv(run.S)
    K = PHt @ inverse
    u = np.einsum("kij,kj->ki", inverse, np.nan_to_num(run.nu)) + np.einsum("kim,ki->km", K, back.lam)
    return u, np.einsum("kmm->km", inverse) + np.einsum("kim,kij,kjm->km", K, back.Lam, K, optimize=True)


def mean(run: Pass) -> Array:
    """Return the smoothed errors (n, s) about the updated estimates: a small part of what their covariances cost."""
    after = _adjoints(run, _weighted(run))[1]
    return np.asarray(-np.einsum("kij,kj->ki", run.chain.P, after))


def smooth(run: Pass) -> Errors:
    """Return smoothed errors with their covariances, and those from node to node, of a run of Euclidean states."""
    chain = run.chain
    assert chain.rotations == 0
    before, Lam = _covariances(run, _weighted(run))
    P = symmetric(chain.P - chain.P @ Lam @ chain.P)
    ahead = chain.P[:-1] @ chain.Phi.swapaxes(1, 2)
    return Errors(mean(run), P, np.asarray(ahead - ahead @ before[1:] @ chain.P_pred[1:]))


def _adjoints(run: Pass, HtS: Array) -> tuple[Array, Array]:
    """Return the adjoints (n, s) with the measurement of each node, and without."""
    chain, measured = run.chain, np.isfinite(run.nu[:, 0])
    v = np.einsum("kim,km->ki", HtS, np.nan_to_num(run.nu))
    before, after, lam = np.zeros_like(chain.dx), np.zeros_like(chain.dx), np.zeros(chain.dx.shape[1])
    for k in range(len(after) - 1, 0, -1):
        if measured[k]:
            lam = lam - HtS[k] @ (run.H[k] @ (chain.P_pred[k] @ lam)) - v[k]
        before[k] = lam
        lam = lam @ chain.Phi[k - 1]
        after[k - 1] = lam
    return before, after


def _covariances(run: Pass, HtS: Array) -> tuple[Array, Array]:
    """Return the covariances (n, s, s) of the adjoints with the measurement of each node, and without."""
    chain, measured = run.chain, np.isfinite(run.nu[:, 0])
    n, s = chain.dx.shape
    before, after, now, eye = np.zeros((n, s, s)), np.zeros((n, s, s)), np.zeros((s, s)), np.eye(s)
    for k in range(n - 1, 0, -1):
        if measured[k]:
            seen = HtS[k] @ run.H[k]
            kept = eye - seen @ chain.P_pred[k]
            now = kept @ now @ kept.T + seen
        before[k] = now
        now = chain.Phi[k - 1].T @ now @ chain.Phi[k - 1]
        now = 0.5 * (now + now.T)
        after[k - 1] = now
    return before, after


def _weighted(run: Pass) -> Array:
    """Return :math:`H^TS^{-1}` (n, s, m)."""
    return np.asarray(np.linalg.solve(run.S, run.H).swapaxes(1, 2))
