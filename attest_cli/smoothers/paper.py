"""The literal procedure of Roumeliotis et al. 1999, sections 4.3-4.4, for comparison: its covariance counts the past
twice.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ..errors import AttestError
from ..maths import kalman, rotation
from ..records import Array, Bools, FilterRun


def errors(run: FilterRun) -> kalman.Errors:
    r"""Run the backward filter over each stretch without measurements and fuse it with the forward one (eqs 39-40).

    .. math:: q_b(k{-}1)=q_b(k)\,\Delta q(b_b)^{-1},\quad P_b(k{-}1)=\Phi^{-1}(P_b(k)+Q)\Phi^{-T}

    It starts from the forward posterior at the last node of the stop that closes a motion and fuses over that motion;
    at stops the forward value stands. Prior and past are in both filters: the states are nearly optimal, the bias
    sigma is too small by up to sqrt(2) (erratum 16 of the note).
    """
    chain, increments = run.chain, run.increments
    if increments is None:
        raise AttestError("the paper's smoother runs over the nodes of the indirect filter only", "use --smoother rts")
    d, P = np.zeros_like(chain.dx), chain.P.copy()
    for first, last, close in _motions(run.moving):
        q_b, bias_b, P_b = run.q[close], run.bias[close], chain.P[close]
        for k in range(close - 1, first - 1, -1):
            turn, Phi = increments.at(bias_b[None], k, k + 1)
            q_b = rotation.multiply(q_b, rotation.conjugate(turn[0]))
            back = np.linalg.inv(Phi[0])
            P_b = kalman.symmetric(back @ (P_b + chain.Q[k]) @ back.T)
            if k <= last:
                d[k], P[k] = _fuse(run, k, q_b, bias_b, P_b)
    return kalman.Errors(d, P, kalman.cross(chain, P))


def _motions(moving: Bools) -> list[tuple[int, int, int]]:
    """Return first and last node of every motion that a stop closes, and the last node of that stop."""
    edges = np.flatnonzero(np.diff(moving.astype(np.int8))) + 1
    runs = list(pairwise([0, *edges.tolist(), len(moving)]))
    return [(a, b - 1, runs[i + 1][1] - 1) for i, (a, b) in enumerate(runs[:-1]) if moving[a]]


def _fuse(run: FilterRun, k: int, q_b: Array, bias_b: Array, P_b: Array) -> tuple[Array, Array]:
    """Fuse about the forward attitude: ``P = Pf - Pf (Pf + Pb)^-1 Pf``, ``d = P Pb^-1 [Log(q_f^-1 q_b); b_b -
    b_f]``.
    """
    P_f = run.chain.P[k]
    P = kalman.symmetric(P_f - P_f @ np.linalg.solve(P_f + P_b, P_f))
    apart = np.concatenate(
        [rotation.log_quaternion(rotation.multiply(rotation.conjugate(run.q[k]), q_b)), bias_b - run.bias[k]]
    )
    return P @ np.linalg.solve(P_b, apart), P
