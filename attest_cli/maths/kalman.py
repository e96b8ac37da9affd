r"""Kalman algebra on a chain of error states, free of any sensor: update, and what every smoother needs.

A forward filter leaves a *chain*: with ``e_k`` the error about the predicted and ``d_k`` about the updated estimate,

.. math:: e_{k+1}=\Phi_k d_k+w_k,\quad w_k\sim N(0,Q_k),\qquad e_k=\Delta x_k\oplus d_k\simeq\Delta x_k+J_k^{-1}d_k,

where the first ``rotations`` states compose as rotation vectors and :math:`J_k=\mathrm{blkdiag}(J_r(\Delta
x_\theta),I)` (a plain Euclidean filter has ``rotations = 0`` and ``J = I``). In these coordinates the run is exactly
linear and Gaussian, so RTS and Fraser-Potter agree to rounding also after iterated updates.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from . import rotation

Array = NDArray[np.float64]
Linearise = Callable[[Array], tuple[Array, Array]]  # d -> residual (m,), Jacobian (m, s)
CONVERGED = 1e-16
LONG_STEP = 0.3  # rad: shorter steps of an update are taken as they are
MOST_HALVINGS = 6
BLOCK = 4096  # nodes handled together


@dataclass(frozen=True, slots=True)
class Chain:
    """What a forward filter leaves behind (n nodes, s states).

    ``P_pred``, ``P`` (n, s, s) before and after the updates; ``Phi``, ``Q`` (n - 1, s, s) from node k to k + 1;
    ``dx`` (n, s) corrections applied at the nodes; ``info`` (n, s, s) and ``vec`` (n, s) the measurement information
    ``H' R^-1 H`` and ``H' R^-1 r`` about the updated estimate; ``rotations`` leading states that are a rotation vector.
    """

    P_pred: Array
    P: Array
    Phi: Array
    Q: Array
    dx: Array
    info: Array
    vec: Array
    rotations: int

    def reset_jacobians(self, at: slice | NDArray[np.int64] = slice(None)) -> tuple[Array, Array]:
        """Return ``J`` and its inverse (k, s, s), ``d = J (e - dx)`` to first order, of some nodes."""
        dx = self.dx[at]
        n, s = dx.shape
        J, J_inv = np.tile(np.eye(s), (n, 1, 1)), np.tile(np.eye(s), (n, 1, 1))
        if self.rotations:
            r = slice(0, self.rotations)
            J[:, r, r] = rotation.right_jacobian(dx[:, r])
            J_inv[:, r, r] = rotation.inverse_right_jacobian(dx[:, r])
        return J, J_inv


@dataclass(frozen=True, slots=True)
class Errors:
    """Smoothed errors about the filter's updated estimates: mean ``d`` (n, s), covariance ``P`` (n, s, s), and the
    lag-one covariance ``cross`` (n - 1, s, s) = Cov(d_k, d_{k+1}).
    """

    d: Array
    P: Array
    cross: Array


@dataclass(frozen=True, slots=True)
class Update:
    """Outcome of a measurement update: ``dx`` (s,), ``P`` (s, s) about the updated estimate, ``info``, ``vec`` as in
    :class:`Chain`, innovation ``nu`` (m,) and its covariance ``S`` (m, m), both at the final linearisation.
    """

    dx: Array
    P: Array
    info: Array
    vec: Array
    nu: Array
    S: Array


def symmetric(P: NDArray[np.floating]) -> Array:
    """Return ``(P + P') / 2``."""
    return np.asarray(0.5 * (P + P.swapaxes(-1, -2)), dtype=np.float64)


def iterated_update(P: Array, linearise: Linearise, R: Array, rotations: int, max_iterations: int = 8) -> Update:
    r"""Update with the maximum a posteriori estimate: Gauss-Newton on the update, Joseph form, reset Jacobian.

    .. math:: d_{i+1}=K_i(r_i+H_iJ_id_i),\qquad K_i=PH^T(HPH^T+R)^{-1},

    with :math:`H=H_iJ_i` and :math:`J_i=\mathrm{blkdiag}(J_r(d_{i,\theta}),I)`.

    Parameters
    ----------
    P : (s, s) prior covariance
    linearise : ``d -> (r, H)``, residual (m,) and Jacobian (m, s) at the prior estimate corrected by ``d``
    R : (m, m) measurement noise
    rotations : leading states that compose as a rotation vector
    max_iterations : 1 gives the plain extended filter

    Notes
    -----
    Ends when the next step would be below 1e-16: convergence is quadratic. Source: paper eqs 25-30 in the form of
    the project's note, section 3.
    """
    s = P.shape[0]
    d, J = np.zeros(s), np.eye(s)
    r, local = linearise(d)
    for _ in range(max_iterations):
        H = local @ J
        PHt = P @ H.T
        S = H @ PHt + R
        nu = r + H @ d
        step = PHt @ np.linalg.solve(S, nu) - d
        if max_iterations > 1:
            step = _damped(P, linearise, R, d, r, step, rotations)
        d = d + step
        if rotations:
            J[:rotations, :rotations] = rotation.right_jacobian(d[:rotations])
        if max_iterations > 1:
            r, local = linearise(d)
        if float(np.abs(step).max()) ** 2 < CONVERGED:  # the next step would be of this size
            break
    K = np.linalg.solve(S, PHt.T).T
    A = np.eye(s) - K @ H
    P_post = J @ (A @ P @ A.T + K @ R @ K.T) @ J.T
    H_d = np.linalg.solve(J.T, H.T).T  # Jacobian to errors about the updated estimate
    weighted = np.linalg.solve(R, np.column_stack([H_d, nu - H @ d]))
    return Update(d, symmetric(P_post), symmetric(H_d.T @ weighted[:, :s]), H_d.T @ weighted[:, s], nu, S)


def _damped(
    P: Array, linearise: Linearise, R: Array, d: Array, r: Array, step: Array, rotations: int
) -> Array:  # fmt: skip
    """Halve a step of more than ``LONG_STEP`` rad until the posterior's cost falls: far out linearisation misleads."""
    if float(np.linalg.norm(step[:rotations])) < LONG_STEP:
        return step

    def cost(at: Array, residual: Array) -> float:
        return float(at @ np.linalg.solve(P, at) + residual @ np.linalg.solve(R, residual))

    now = cost(d, r)
    step = step * min(1.0, np.pi / 2 / float(np.linalg.norm(step[:rotations])))
    for _ in range(MOST_HALVINGS):
        if cost(d + step, linearise(d + step)[0]) <= now:
            break
        step = 0.5 * step
    return step


def rts(chain: Chain) -> Errors:
    r"""Rauch-Tung-Striebel: :math:`d_k=C_k e_{k+1}`, :math:`C_k=P_k\Phi_k^TP_{k+1|k}^{-1}`,
    :math:`P^s_k=P_k+C_k(P^e_{k+1}-P_{k+1|k})C_k^T` with :math:`P^e=J^{-1}P^sJ^{-T}`.
    """
    C = gains(chain)
    _, J_inv = chain.reset_jacobians()
    d, P = np.zeros_like(chain.dx), chain.P.copy()
    moved = np.any(chain.dx != 0.0, axis=1)
    for k in range(len(C) - 1, -1, -1):
        e, Pe = d[k + 1], P[k + 1]
        if moved[k + 1]:
            e = chain.dx[k + 1] + J_inv[k + 1] @ e
            Pe = J_inv[k + 1] @ Pe @ J_inv[k + 1].T
        d[k] = C[k] @ e
        P_k = chain.P[k] + C[k] @ (Pe - chain.P_pred[k + 1]) @ C[k].T
        P[k] = 0.5 * (P_k + P_k.T)
    return Errors(d, P, cross(chain, P))


def information(chain: Chain) -> tuple[Array, Array]:
    r"""Backward information filter: ``Y`` (n, s, s), ``y`` (n, s) of all measurements *after* node k, about ``d_k``.

    Per node, backwards: absorb :math:`(H^TR^{-1}H,H^TR^{-1}r)`, move to the predicted estimate
    :math:`Y\leftarrow J^TYJ,\ y\leftarrow J^Ty+Y\Delta x`, step back :math:`Y\leftarrow\Phi^T(I+YQ)^{-1}Y\Phi`, with
    ``Phi`` and ``Q`` composed over each stretch without measurements, so that all its nodes are solved in one batch.
    Source: Fraser & Potter 1969, in the note's form 4(b); neither ``Y`` nor ``P`` is inverted.
    """
    n, s = chain.dx.shape
    Y, y = np.zeros((n, s, s)), np.zeros((n, s))
    ends = np.unique(np.concatenate([[0], np.flatnonzero(np.any(chain.info != 0.0, axis=(1, 2)))]))
    all_Phi, all_Q = _composed(chain, ends)
    J, _ = chain.reset_jacobians(ends)
    eye, one = np.eye(s), np.empty((s, s + 1))
    for first, last, J_last in zip(ends[-2::-1].tolist(), ends[:0:-1].tolist(), J[:0:-1], strict=True):
        Y_last, y_last = Y[last] + chain.info[last], y[last] + chain.vec[last]
        if chain.rotations:
            Y_last, y_last = J_last.T @ Y_last @ J_last, J_last.T @ y_last
            Y_last = 0.5 * (Y_last + Y_last.T)
        y_last = y_last + Y_last @ chain.dx[last]
        if last - first == 1:  # a filter that measures at every sample: no batch, fewer calls
            Phi, Q = all_Phi[first], all_Q[first]
            one[:, :s], one[:, s] = Y_last @ Phi, y_last
            back = Phi.T @ np.linalg.solve(eye + Y_last @ Q, one)
            Y[first], y[first] = 0.5 * (back[:, :s] + back[:, :s].T), back[:, s]
            continue
        Phi, Q = all_Phi[first:last], all_Q[first:last]
        right = np.concatenate([Y_last @ Phi, np.tile(y_last[:, None], (last - first, 1, 1))], axis=2)
        back = Phi.swapaxes(1, 2) @ np.linalg.solve(eye + Y_last @ Q, right)
        Y[first:last], y[first:last] = symmetric(back[:, :, :s]), back[:, :, s]
    return Y, y


def _composed(chain: Chain, ends: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return ``Phi`` and ``Q`` (ends[-1], s, s) from each node to the end of its stretch between ``ends``, all
    stretches at once.
    """
    s = chain.dx.shape[1]
    Phi, Q = np.empty((ends[-1], s, s)), np.empty((ends[-1], s, s))
    length = np.diff(ends)
    order = np.argsort(-length, kind="stable")  # long stretches first: the active ones are always a prefix
    last, length = ends[1:][order], length[order]
    P, N = np.tile(np.eye(s), (len(last), 1, 1)), np.zeros((len(last), s, s))
    for k in range(int(length.max(initial=0))):
        active = int(np.searchsorted(-length, -k, side="left"))
        at = last[:active] - 1 - k
        P, N = P[:active], N[:active]
        N = N + P @ chain.Q[at] @ P.swapaxes(1, 2)
        P = P @ chain.Phi[at]
        Phi[at], Q[at] = P, N
    return Phi, Q


def fuse(chain: Chain, Y: Array, y: Array) -> Errors:
    """Fuse forward posterior and backward information (paper eq 40): ``P_s = (P^-1 + Y)^-1``, ``d = P_s y``.

    With ``P = L L'``: ``P_s = L (I + L' Y L)^-1 L'``, symmetric and positive whatever the conditioning.
    """
    P, eye = np.empty_like(chain.P), np.eye(chain.P.shape[1])
    for rows in blocks(len(P)):
        L = np.linalg.cholesky(chain.P[rows])
        L_t = L.swapaxes(1, 2)
        P[rows] = symmetric(L @ np.linalg.solve(eye + symmetric(L_t @ Y[rows] @ L), L_t))
    return Errors(np.einsum("kij,kj->ki", P, y), P, cross(chain, P))


def blocks(n: int) -> Iterator[slice]:
    """Yield the nodes ``0 .. n``, some thousand at a time: what is made on the way is as large as they are."""
    return (slice(lo, min(lo + BLOCK, n)) for lo in range(0, n, BLOCK))


def gains(chain: Chain, rows: slice = slice(None)) -> Array:
    """Return the smoother gains ``C`` (k, s, s) = ``P Phi' P_pred^-1`` of some intervals."""
    PhiP = chain.Phi[rows] @ chain.P[:-1][rows]
    return np.asarray(np.linalg.solve(chain.P_pred[1:][rows], PhiP).swapaxes(1, 2))


def cross(chain: Chain, P: Array) -> Array:
    """Return Cov(d_k, d_{k+1}) (n - 1, s, s) = ``C_k J^-1 P_{k+1}``: the error left after node k + 1 is known.

    ``P`` (n, s, s): smoothed covariances, or the filter's own for the filter's own errors.
    """
    out = np.empty_like(P[1:])
    for rows in blocks(len(out)):
        later = slice(rows.start + 1, rows.stop + 1)
        out[rows] = gains(chain, rows) @ chain.reset_jacobians(later)[1] @ P[later]
    return out
