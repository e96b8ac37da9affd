r"""The smoothed attitude error over the nodes: a Gauss-Markov chain.

With the lag-one covariance of the smoother, :math:`\delta_{k+1}=F_k\delta_k+\eta_k`,
:math:`F_k=\mathrm{Cov}(\delta_{k+1},\delta_k)P_k^{-1}`. Position and velocity are linear in it, so their covariance
follows exactly by adding them to the state.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..maths import rotation
from ..maths.kalman import symmetric
from ..records import Array, Smoothed

BLOCK_NODES = 1 << 12  # nodes handled together: a long log has many


@dataclass(frozen=True, slots=True)
class Markov:
    """Smoothed errors ``[dtheta_n, dbias]`` over nodes: ``P`` (n, 6, 6), ``F``, ``W`` (n - 1, 6, 6)."""

    P: Array
    F: Array
    W: Array


def markov(smoothed: Smoothed, first: int = 0, last: int | None = None) -> Markov:
    """Return the error chain of the nodes ``first .. last`` with attitude errors about world axes."""
    last = len(smoothed.t) - 1 if last is None else last
    T = np.tile(np.eye(6), (last + 1 - first, 1, 1))
    T[:, :3, :3] = rotation.matrix(smoothed.q[first : last + 1])
    P = symmetric(T @ smoothed.P[first : last + 1] @ T.swapaxes(1, 2))
    cross = T[:-1] @ smoothed.cross[first:last] @ T[1:].swapaxes(1, 2)
    F = np.asarray(np.linalg.solve(P[:-1], cross).swapaxes(1, 2), dtype=np.float64)
    W = symmetric(P[1:] - F @ P[:-1] @ F.swapaxes(1, 2))
    return Markov(P, F, W)


def blocks(first: int, last: int) -> Iterator[tuple[int, int]]:
    """Yield first and last node of stretches that share out ``first .. last``: each begins where one ended."""
    for lo in range(first, last, BLOCK_NODES):
        yield lo, min(lo + BLOCK_NODES, last)
