r"""The smoother of Bryson and Frazier in its modified form: no covariance is inverted, constant states do no harm.

With the adjoint :math:`\hat\lambda_k` of all measurements after k and its covariance :math:`\hat\Lambda_k`,

.. math:: \tilde\lambda=(I-KH)^T\hat\lambda-H^TS^{-1}\nu,\quad
    \tilde\Lambda=(I-KH)^T\hat\Lambda(I-KH)+H^TS^{-1}H,\qquad
    \hat\lambda_{k}=\Phi_k^T\tilde\lambda_{k+1},\quad\hat\Lambda_{k}=\Phi_k^T\tilde\Lambda_{k+1}\Phi_k

the smoothed errors about the updated estimates are :math:`d=-P\hat\lambda`, :math:`P^s=P-P\hat\Lambda P`.
Source: Bierman 1973, "Fixed interval smoothing with discrete measurements".
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .kalman import Errors, symmetric
from .sequential import Pass

Array = NDArray[np.float64]


def mean(run: Pass) -> Array:
    """Return the smoothed errors (n, s) about the updated estimates: a small part of what their covariances cost."""
    HtS = _weighted(run)
    chain, measured = run.chain, np.isfinite(run.nu[:, 0])
    v = np.einsum("kim,km->ki", HtS, np.nan_to_num(run.nu))
    back, lam = np.zeros_like(chain.dx), np.zeros(chain.dx.shape[1])
    for k in range(len(back) - 1, 0, -1):
        if measured[k]:
            lam = lam - HtS[k] @ (run.H[k] @ (chain.P_pred[k] @ lam)) - v[k]
        lam = lam @ chain.Phi[k - 1]
        back[k - 1] = lam
    return np.asarray(-np.einsum("kij,kj->ki", chain.P, back))


def smooth(run: Pass) -> Errors:
    """Return smoothed errors with their covariances, and those from node to node, of a run of Euclidean states."""
    chain, HtS, measured = run.chain, _weighted(run), np.isfinite(run.nu[:, 0])
    assert chain.rotations == 0
    n, s = chain.dx.shape
    Lam, before, now = np.zeros((n, s, s)), np.zeros((n - 1, s, s)), np.zeros((s, s))
    eye = np.eye(s)
    for k in range(n - 1, 0, -1):
        if measured[k]:
            seen = HtS[k] @ run.H[k]
            kept = eye - seen @ chain.P_pred[k]
            now = kept @ now @ kept.T + seen
        before[k - 1] = now
        now = chain.Phi[k - 1].T @ now @ chain.Phi[k - 1]
        now = 0.5 * (now + now.T)
        Lam[k - 1] = now
    P = symmetric(chain.P - chain.P @ Lam @ chain.P)
    ahead = chain.P[:-1] @ chain.Phi.swapaxes(1, 2)
    return Errors(mean(run), P, np.asarray(ahead - ahead @ before @ chain.P_pred[1:]))


def _weighted(run: Pass) -> Array:
    """Return :math:`H^TS^{-1}` (n, s, m)."""
    return np.asarray(np.linalg.solve(run.S, run.H).swapaxes(1, 2))
