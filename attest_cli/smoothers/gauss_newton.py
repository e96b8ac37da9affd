"""Fixed-interval maximum a posteriori estimate: re-linearise about the smoothed trajectory and solve again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..filters.alignment import Start
from ..maths import block_tridiagonal, kalman, rotation
from ..maths.consistency import upper_quantile
from ..maths.propagation import Increments
from ..nodes import Nodes
from ..records import Array, Innovations, Smoothed

UNGATED = 3  # passes that use every measurement, where the log starts in motion
FAR_RAD = 0.05  # defects beyond this (gaps) turn the linearisation; the others are gyro noise
CONVERGED = 1e-3  # of a sigma: the largest change of any state in the last pass

Kept = set[tuple[int, str]]  # (node, role) of the measurements in use


def refine(
    nodes: Nodes, start: Start, smoothed: Smoothed, innovations: Innovations | None, passes: int, gate: float = 0.9999,
    fixed: bool = True,
) -> Smoothed:  # fmt: skip
    r"""Iterate Gauss-Newton on the whole log.

    .. math:: u_k=f(\bar x_k)\ominus\bar x_{k+1},\quad d_{k+1}=\Phi_kd_k+u_k+w_k,\quad z_k-h(\bar x_k)=H_kd_k+v_k

    with the prior :math:`d_0\sim(-J_re_0,J_rP_0J_r^T)`, :math:`e_0=\bar x_0\ominus\hat x_0`; then
    :math:`\bar x\leftarrow\bar x\oplus d`.

    Parameters
    ----------
    nodes, start : as for the filter
    smoothed : trajectory to begin with
    innovations : of the forward filter, whose gate decides in the first pass; later ones gate on the smoothed
    trajectory.
        None: every measurement counts in every pass
    passes : at most this many
    fixed : make all passes; else stop when no state moves by more than 1e-3 sigma

    Notes
    -----
    Each pass is one block-tridiagonal solve with all marginal covariances. Source: the note, section 5.
    """
    q, bias, P, cross = smoothed.q, smoothed.bias, smoothed.P, smoothed.cross
    made, settled = 0, False
    free = UNGATED if start.in_motion else 0  # a wrong start must not refuse the measurements that would right it
    kept = None if innovations is None or free else _kept(innovations)
    while made < passes:
        made += 1
        P = cross = np.empty(0)  # made again: room for what it is made of
        d, P, cross = block_tridiagonal.solve(*_normal_equations(nodes, start, q, bias, kept))
        q = rotation.normalise(rotation.multiply(q, rotation.exp_quaternion(d[:, :3])))
        bias = bias + d[:, 3:]
        again = None if innovations is None or made < free else _gated(nodes, q, bias, P, gate)
        settled = float(np.max(np.abs(d) / np.sqrt(np.einsum("kii->ki", P)))) < CONVERGED and again == kept
        kept = again
        if settled and not fixed:
            break
    return replace(smoothed, q=q, bias=bias, P=P, cross=cross, passes=made, settled=settled or fixed)


def _kept(found: Innovations) -> Kept:
    return {(int(k), str(r)) for k, r, ok in zip(found.node, found.role, found.used, strict=True) if ok}


def _gated(nodes: Nodes, q: Array, bias: Array, P: Array, gate: float) -> Kept:
    """Return the measurements that fit the smoothed trajectory: ``r' (R + H P H')^-1 r`` inside the chi-square gate."""
    kept = set()
    for node, group in zip(nodes.measured.tolist(), nodes.measurements, strict=True):
        R_nb = rotation.matrix(q[node])
        for m in group:
            r, H = m.linearise(R_nb, bias[node])
            nis = float(r @ np.linalg.solve(m.noise + H @ P[node] @ H.T, r))
            if gate >= 1.0 or nis <= upper_quantile(m.sensor.dof, 1.0 - gate):
                kept.add((node, m.role))
    return kept


def _normal_equations(
    nodes: Nodes, start: Start, q: Array, bias: Array, kept: Kept | None
) -> tuple[Array, Array, Array]:
    """Return diagonal blocks, upper blocks and right-hand side of the least-squares problem about the trajectory."""
    n = len(nodes.t)
    diagonal, upper, right = np.zeros((n, 6, 6)), np.empty((n - 1, 6, 6)), np.zeros((n, 6))
    for rows in kalman.blocks(n - 1):
        _add_motion(diagonal, upper, right, nodes.increments, q, bias, rows)
    _add_prior(diagonal, right, start, q[0], bias[0])
    for node, group in zip(nodes.measured.tolist(), nodes.measurements, strict=True):
        R_nb = rotation.matrix(q[node])
        for m in group:
            if kept is not None and (node, m.role) not in kept:
                continue
            r, H = m.linearise(R_nb, bias[node])
            HtW = np.linalg.solve(m.noise, H).T
            diagonal[node] += HtW @ H
            right[node] += HtW @ r
    for rows in kalman.blocks(n):
        diagonal[rows] = kalman.symmetric(diagonal[rows])
    return diagonal, upper, right


def _add_motion(
    diagonal: Array, upper: Array, right: Array, increments: Increments, q: Array, bias: Array, rows: slice
) -> None:
    """Add what the gyro says of some intervals."""
    later = slice(rows.start + 1, rows.stop + 1)
    turns, Phi = increments.at(bias[rows], rows.start, rows.stop)
    u = np.empty((len(Phi), 6))
    u[:, :3] = rotation.log_quaternion(
        rotation.multiply(rotation.conjugate(q[later]), rotation.multiply(q[rows], turns))
    )
    u[:, 3:] = bias[rows] - bias[later]
    ahead = np.tile(np.eye(6), (len(u), 1, 1))  # derivative of u to the later error
    far = np.flatnonzero(np.linalg.norm(u[:, :3], axis=1) > FAR_RAD)
    ahead[far, :3, :3] = rotation.inverse_right_jacobian(-u[far, :3])
    Phi[far, :3] = rotation.inverse_right_jacobian(u[far, :3]) @ Phi[far, :3]
    weight = kalman.symmetric(np.linalg.inv(increments.Q[rows]))
    PhiW, aheadW = Phi.swapaxes(1, 2) @ weight, ahead.swapaxes(1, 2) @ weight
    diagonal[rows] += PhiW @ Phi
    diagonal[later] += aheadW @ ahead
    right[rows] -= np.einsum("kij,kj->ki", PhiW, u)
    right[later] += np.einsum("kij,kj->ki", aheadW, u)
    upper[rows] = -PhiW @ ahead


def _add_prior(diagonal: Array, right: Array, start: Start, q: Array, bias: Array) -> None:
    e = np.concatenate([rotation.log_quaternion(rotation.multiply(rotation.conjugate(start.q), q)), bias - start.bias])
    J = np.eye(6)
    J[:3, :3] = rotation.right_jacobian(e[:3])
    weight = kalman.symmetric(np.linalg.inv(J @ start.P @ J.T))
    diagonal[0] += weight
    right[0] -= weight @ J @ e
