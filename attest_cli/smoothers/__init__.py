"""Smoothers: a forward run in, the estimate from all measurements out. One backward core (``maths.kalman``) serves
every filter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..maths import kalman, rotation
from ..records import Array, FilterRun, Smoothed
from . import paper

__all__ = ["SMOOTHERS", "backward_estimate"]


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
    attitude.
    """
    G = np.tile(np.eye(6), (len(run.t), 1, 1))
    G[:, :3, :3] = rotation.right_jacobian(errors.d[:, :3])
    q = rotation.multiply(run.q, rotation.exp_quaternion(errors.d[:, :3]))
    P = kalman.symmetric(G @ errors.P @ G.swapaxes(1, 2))
    cross = G[:-1] @ errors.cross @ G[1:].swapaxes(1, 2)
    return Smoothed(run.t, rotation.normalise(q), run.bias + errors.d[:, 3:], P, cross)


def backward_estimate(
    run: FilterRun, information: tuple[Array, Array] | None = None, weakest: float = 1.0
) -> tuple[Array, Array, Array]:
    """Return the backward pass as an estimate of its own: ``q`` (n, 4), ``bias`` (n, 3), ``P`` (n, 6, 6).

    It holds the measurements after each node only. NaN where its attitude is not known to ``weakest`` rad in every
    axis, or so far from the forward pass (30 deg) that errors about that pass do not describe it. Without a heading
    sensor it borrows the forward heading, so that its tilt can be shown.
    """
    Y, y = information or kalman.information(run.chain)
    if run.heading == "relative":
        up_b = rotation.matrix(run.q)[:, 2, :]
        known = np.einsum("ki,kij,kj->k", up_b, run.chain.P[:, :3, :3], up_b)
        Y = Y.copy()
        Y[:, :3, :3] += np.einsum("ki,kj->kij", up_b, up_b) / known[:, None, None]
    n = len(run.t)
    q, bias, P = np.full((n, 4), np.nan), np.full((n, 3), np.nan), np.full((n, 6, 6), np.nan)
    scale = np.array([1.0, 1.0, 1.0, 1e-2, 1e-2, 1e-2])  # rad and rad/s to comparable numbers
    eigenvalues = np.linalg.eigvalsh(Y * scale[:, None] * scale)
    known = np.flatnonzero(eigenvalues[:, 0] > 1e-9 * np.maximum(eigenvalues[:, -1], 1.0))
    if len(known):
        inverse = kalman.symmetric(np.linalg.inv(Y[known]))
        d = np.einsum("kij,kj->ki", inverse, y[known])
        good = (inverse[:, 0, 0] + inverse[:, 1, 1] + inverse[:, 2, 2] < weakest**2) & (
            np.linalg.norm(d[:, :3], axis=1) < np.pi / 6
        )
        known, inverse, d = known[good], inverse[good], d[good]
        q[known] = rotation.multiply(run.q[known], rotation.exp_quaternion(d[:, :3]))
        bias[known], P[known] = run.bias[known] + d[:, 3:], inverse
    return q, bias, P
