"""Fixed-interval maximum a posteriori estimate: re-linearise about the smoothed trajectory and solve again."""

from __future__ import annotations

import numpy as np

from ..filters.alignment import Start
from ..maths import block_tridiagonal, kalman, rotation
from ..nodes import Nodes
from ..records import Array, Bools, Smoothed

CONVERGED = 1e-3  # of a sigma: the largest change of any state in the last pass


def refine(
    nodes: Nodes, start: Start, smoothed: Smoothed, used: set[tuple[int, str]] | None, passes: int, fixed: bool
) -> Smoothed:
    r"""Iterate Gauss-Newton on the whole log.

    .. math:: u_k=f(\bar x_k)\ominus\bar x_{k+1},\quad d_{k+1}=\Phi_kd_k+u_k+w_k,\quad z_k-h(\bar x_k)=H_kd_k+v_k

    with the prior :math:`d_0\sim(-J_re_0,J_rP_0J_r^T)`, :math:`e_0=\bar x_0\ominus\hat x_0`; then
    :math:`\bar x\leftarrow\bar x\oplus d`.

    Parameters
    ----------
    nodes, start : as for the filter
    smoothed : trajectory to begin with
    used : (node, role) of the measurements the filter's gate kept; None uses all
    passes : at most this many
    fixed : make all passes; else stop when no state moves by more than 1e-3 sigma

    Notes
    -----
    Each pass is one block-tridiagonal solve with all marginal covariances. Source: the note, section 5.
    """
    q, bias, P, cross, made = smoothed.q, smoothed.bias, smoothed.P, smoothed.cross, 0
    for made in range(1, passes + 1):
        diagonal, upper, right = _normal_equations(nodes, start, q, bias, used)
        d, P, cross = block_tridiagonal.solve(diagonal, upper, right)
        q = rotation.normalise(rotation.multiply(q, rotation.exp_quaternion(d[:, :3])))
        bias = bias + d[:, 3:]
        sigma = np.sqrt(np.einsum("kii->ki", P))
        if not fixed and float(np.max(np.abs(d) / sigma)) < CONVERGED:
            break
    return Smoothed(smoothed.t, q, bias, kalman.symmetric(P), cross, made)


def _normal_equations(
    nodes: Nodes, start: Start, q: Array, bias: Array, used: set[tuple[int, str]] | None
) -> tuple[Array, Array, Array]:
    """Return diagonal blocks, upper blocks and right-hand side of the least-squares problem about the trajectory."""
    inc, n = nodes.increments, len(nodes.t)
    turns, Phi = inc.at(bias[:-1], 0, n - 1)
    u = np.empty((n - 1, 6))
    u[:, :3] = rotation.log_quaternion(rotation.multiply(rotation.conjugate(q[1:]), rotation.multiply(q[:-1], turns)))
    u[:, 3:] = bias[:-1] - bias[1:]
    weight = kalman.symmetric(np.linalg.inv(inc.Q))
    PhiW = Phi.swapaxes(1, 2) @ weight
    diagonal, right = np.zeros((n, 6, 6)), np.zeros((n, 6))
    diagonal[:-1] += PhiW @ Phi
    diagonal[1:] += weight
    right[:-1] -= np.einsum("kij,kj->ki", PhiW, u)
    right[1:] += np.einsum("kij,kj->ki", weight, u)
    _add_prior(diagonal, right, start, q[0], bias[0])
    for node, group in zip(nodes.measured.tolist(), nodes.measurements, strict=True):
        for m in group:
            if used is not None and (node, m.role) not in used:
                continue
            r, H = m.linearise(q[node], bias[node])
            HtW = np.linalg.solve(m.noise, H).T
            diagonal[node] += HtW @ H
            right[node] += HtW @ r
    return kalman.symmetric(diagonal), -PhiW, right


def _add_prior(diagonal: Array, right: Array, start: Start, q: Array, bias: Array) -> None:
    e = np.concatenate([rotation.log_quaternion(rotation.multiply(rotation.conjugate(start.q), q)), bias - start.bias])
    J = np.eye(6)
    J[:3, :3] = rotation.right_jacobian(e[:3])
    weight = kalman.symmetric(np.linalg.inv(J @ start.P @ J.T))
    diagonal[0] += weight
    right[0] -= weight @ J @ e


def kept(used: Bools, node: Array, role: Array) -> set[tuple[int, str]]:
    """Return the (node, role) pairs of the innovations the gate let through."""
    return {(int(k), str(r)) for k, r, ok in zip(node, role, used, strict=True) if ok}
