"""Smoothers: a forward run in, the estimate from all measurements out. One backward core (``maths.kalman``) serves
every filter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..maths import kalman, rotation
from ..records import Array, FilterRun, Ints, Smoothed
from . import paper

__all__ = ["SMOOTHERS", "backward_estimate", "thinned"]

SINGULAR = 1e-9  # least eigenvalue, of information scaled to a diagonal of ones, that still has an inverse
LOST = 1e6  # rad^2: a heading less known than this leaves no digits to the tilt beside it
FAR_RAD = np.pi / 6  # a backward pass this far from the forward one is not described by errors about it


def two_filter(run: FilterRun) -> Smoothed:
    """Fuse the forward pass with the backward information filter (Fraser & Potter 1969): the default."""
    information = kalman.information(run.chain)
    return replace(apply(run, kalman.fuse(run.chain, *information)), information=information)


def rts(run: FilterRun) -> Smoothed:
    """Rauch-Tung-Striebel: the same optimum by another recursion."""
    return apply(run, kalman.rts(run.chain))


def none(run: FilterRun) -> Smoothed:
    """The forward pass itself."""
    P = run.chain.P
    return apply(run, kalman.Errors(np.zeros_like(run.chain.dx), P, kalman.cross(run.chain, P)))


SMOOTHERS: dict[str, Callable[[FilterRun], Smoothed]] = {
    "two-filter": two_filter,
    "rts": rts,
    "paper": lambda run: apply(run, paper.errors(run)),
    "none": none,
}


def apply(run: FilterRun, errors: kalman.Errors) -> Smoothed:
    """Correct the forward estimate by the smoothed errors; covariances move to the tangent of the corrected
    attitude. A chain of other states is read by its own filter.
    """
    if run.read is not None:
        return run.read(errors)
    n = len(run.t)
    q = rotation.multiply(run.q, rotation.exp_quaternion(errors.d[:, :3]))
    P, cross = np.empty((n, 6, 6)), np.empty((n - 1, 6, 6))
    for rows in kalman.blocks(n):
        G = np.tile(np.eye(6), (min(rows.stop + 1, n) - rows.start, 1, 1))
        G[:, :3, :3] = rotation.right_jacobian(errors.d[rows.start : rows.stop + 1, :3])
        own = G[: rows.stop - rows.start]
        P[rows] = kalman.symmetric(own @ errors.P[rows] @ own.swapaxes(1, 2))
        cross[rows] = G[:-1] @ errors.cross[rows] @ G[1:].swapaxes(1, 2)
    return Smoothed(run.t, rotation.normalise(q), run.bias + errors.d[:, 3:], P, cross)


def backward_estimate(
    run: FilterRun, information: tuple[Array, Array] | None = None, weakest: float = 1.0
) -> tuple[Array, Array, Array]:
    """Return the backward pass as an estimate of its own: ``q`` (n, 4), ``bias`` (n, 3), ``P`` (n, 6, 6).

    It holds the measurements after each node only, and what was known of constants beforehand.

    NaN where its attitude (without a heading sensor: its tilt) is not known to ``weakest`` rad, or so far from the
    forward pass (30 deg) that errors about that pass do not describe it.
    Without a heading sensor it borrows the forward heading, so that its tilt can be shown.
    """
    Y, y = information or kalman.information(run.chain)
    relative = run.heading == "relative"
    if relative and run.read is None:
        up_b = rotation.matrix(run.q)[:, 2, :]
        known = np.einsum("ki,kij,kj->k", up_b, run.chain.P[:, :3, :3], up_b)
        Y = Y.copy()
        Y[:, :3, :3] += np.einsum("ki,kj->kij", up_b, up_b) / known[:, None, None]
    if run.beforehand is not None:
        Y, y = Y + run.beforehand[0], y + run.beforehand[1]
    d, P, known = np.zeros_like(run.chain.dx), run.chain.P.copy(), np.zeros(len(Y), dtype=np.bool_)
    for rows in kalman.blocks(len(Y)):
        size = np.sqrt(np.maximum(np.einsum("kii->ki", Y[rows]), 1e-300))  # makes rad and rad/s comparable
        known[rows] = np.linalg.eigvalsh(Y[rows] / (size[:, :, None] * size[:, None, :]))[:, 0] > SINGULAR
        at = rows.start + np.flatnonzero(known[rows])
        P[at] = kalman.symmetric(np.linalg.inv(Y[at]))
        d[at] = np.einsum("kij,kj->ki", P[at], y[at])
    found = apply(run, kalman.Errors(d, P, np.zeros_like(P[1:])))
    apart = 2.0 * np.arccos(np.clip(np.abs(np.sum(found.q * run.q, axis=1)), 0.0, 1.0))
    spread = np.einsum("kii->k", found.P[:, :3, :3])
    unknown = ~known | (apart >= FAR_RAD) | ~(spread < LOST)
    if relative:
        up_b = rotation.matrix(found.q)[:, 2, :]
        spread -= np.einsum("ki,kij,kj->k", up_b, found.P[:, :3, :3], up_b)
    unknown |= spread >= weakest**2
    for values in (found.q, found.bias, found.P):
        values[unknown] = np.nan
    return found.q, found.bias, found.P


def thinned(smoothed: Smoothed, rows: Ints) -> Smoothed:
    r"""Return the smoothed pass at some of its nodes, ``rows`` ascending.

    The lag-one covariance across the nodes left out follows from the chain of errors:
    :math:`\mathrm{Cov}(d_k,d_{k+m})=\mathrm{Cov}(d_k,d_{k+1})\prod_j P_{k+j}^{-1}\mathrm{Cov}(d_{k+j},d_{k+j+1})`.
    """
    cross, length = smoothed.cross[rows[:-1]].copy(), np.diff(rows)
    for j in range(1, int(length.max(initial=0))):
        more = np.flatnonzero(length > j)
        at = rows[more] + j
        cross[more] = cross[more] @ np.linalg.solve(smoothed.P[at], smoothed.cross[at])
    return replace(
        smoothed, t=smoothed.t[rows], q=smoothed.q[rows], bias=smoothed.bias[rows], P=smoothed.P[rows], cross=cross,
        information=None,
    )  # fmt: skip
