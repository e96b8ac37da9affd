"""Linear Gaussian chains small enough for the dense answer: the joint posterior of all states at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from attest_cli.maths import rotation
from attest_cli.maths.kalman import Chain, iterated_update

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Problem:
    """``x_{k+1} = Phi x + w``, ``z = H x + v`` at the nodes where ``measured``; prior N(mean, P0)."""

    mean: Array
    P0: Array
    Phi: Array
    Q: Array
    H: Array
    R: Array
    z: Array
    measured: NDArray[np.bool_]


def spd(rng: np.random.Generator, s: int, scale: float = 1.0) -> Array:
    """A well-conditioned covariance."""
    a = rng.normal(size=(s, s))
    return np.asarray(scale * (a @ a.T / s + 0.3 * np.eye(s)))


def random_problem(rng: np.random.Generator, n: int = 12, s: int = 6, m: int = 2, prior: float = 4.0) -> Problem:
    """A drawn truth with its measurements, about two nodes in three measured."""
    Phi = np.eye(s) + 0.3 * rng.normal(size=(n - 1, s, s)) / np.sqrt(s)
    Q = np.stack([spd(rng, s, 0.2) for _ in range(n - 1)])
    H, R = rng.normal(size=(n, m, s)), np.stack([spd(rng, m, 0.5) for _ in range(n)])
    mean, P0 = rng.normal(size=s), spd(rng, s, prior)
    x = [rng.multivariate_normal(mean, P0)]
    for k in range(n - 1):
        x.append(rng.multivariate_normal(Phi[k] @ x[-1], Q[k]))
    z = np.stack([rng.multivariate_normal(H[k] @ x[k], R[k]) for k in range(n)])
    measured = rng.random(n) < 0.67
    measured[[0, n // 2]] = True
    return Problem(mean, P0, Phi, Q, H, R, z, measured)


def forward(p: Problem) -> tuple[Array, Chain]:
    """Kalman filter with the core's update: updated estimates (n, s) and the chain they leave."""
    n, s = len(p.H), len(p.mean)
    x, P_pred, P = np.empty((n, s)), np.empty((n, s, s)), np.empty((n, s, s))
    dx, info, vec = np.zeros((n, s)), np.zeros((n, s, s)), np.zeros((n, s))
    x[0], P_pred[0] = p.mean, p.P0
    for k in range(n):
        if k:
            x[k] = p.Phi[k - 1] @ x[k - 1]
            now = p.Phi[k - 1] @ P[k - 1] @ p.Phi[k - 1].T + p.Q[k - 1]
            P_pred[k] = 0.5 * (now + now.T)
        P[k] = P_pred[k]
        if p.measured[k]:
            z, H, predicted = p.z[k], p.H[k], x[k].copy()
            update = iterated_update(P[k], lambda d, z=z, H=H, x=predicted: (z - H @ (x + d), H), p.R[k], 0)  # type: ignore[misc]
            dx[k], P[k], info[k], vec[k] = update.dx, update.P, update.info, update.vec
            x[k] = x[k] + update.dx
    return x, Chain(P_pred, P, p.Phi, p.Q, dx, info, vec, 0)


def dense(p: Problem) -> tuple[Array, Array]:
    """Joint posterior of all states: mean (n, s) and covariance (n, s, n, s), by conditioning the joint Gaussian."""
    n, s = len(p.H), len(p.mean)
    mean, joint = [p.mean], np.zeros((n, s, n, s))
    joint[0, :, 0] = p.P0
    for k in range(n - 1):
        mean.append(p.Phi[k] @ mean[-1])
        for j in range(k + 1):
            joint[k + 1, :, j] = p.Phi[k] @ joint[k, :, j]
            joint[j, :, k + 1] = joint[k + 1, :, j].T
        joint[k + 1, :, k + 1] = p.Phi[k] @ joint[k, :, k] @ p.Phi[k].T + p.Q[k]
    big, rows = joint.reshape(n * s, n * s), np.flatnonzero(p.measured)
    m = p.H.shape[1]
    H, R = np.zeros((len(rows) * m, n * s)), np.zeros((len(rows) * m, len(rows) * m))
    for i, k in enumerate(rows):
        H[i * m : (i + 1) * m, k * s : (k + 1) * s] = p.H[k]
        R[i * m : (i + 1) * m, i * m : (i + 1) * m] = p.R[k]
    prior = np.concatenate(mean)
    K = np.linalg.solve(H @ big @ H.T + R, H @ big).T
    posterior = big - K @ H @ big
    return (prior + K @ (p.z[rows].ravel() - H @ prior)).reshape(n, s), posterior.reshape(n, s, n, s)


def turning_chain(rng: np.random.Generator, n: int = 10) -> tuple[Chain, Problem]:
    r"""A chain of six states whose first three are a rotation vector, with resets ``J`` far from the identity.

    In its own coordinates it is linear: :math:`d_{k+1}=J_{k+1}(\Phi_kd_k+w_k-\Delta x_{k+1})`. The problem returned
    with it holds the innovations ``z`` about the predicted estimates.
    """
    s, m = 6, 2
    Phi = np.eye(s) + 0.2 * rng.normal(size=(n - 1, s, s)) / np.sqrt(s)
    Q = np.stack([spd(rng, s, 0.05) for _ in range(n - 1)])
    H, R, z = rng.normal(size=(n, m, s)), np.stack([spd(rng, m, 0.3) for _ in range(n)]), rng.normal(size=(n, m))
    P_pred, P = np.empty((n, s, s)), np.empty((n, s, s))
    dx, info, vec = np.zeros((n, s)), np.zeros((n, s, s)), np.zeros((n, s))
    P_pred[0] = spd(rng, s, 0.3)
    for k in range(n):
        if k:
            P_pred[k] = Phi[k - 1] @ P[k - 1] @ Phi[k - 1].T + Q[k - 1]
        S = H[k] @ P_pred[k] @ H[k].T + R[k]
        K = P_pred[k] @ H[k].T @ np.linalg.inv(S)
        dx[k] = K @ z[k]  # z is the innovation about the predicted estimate
        J = np.eye(s)
        J[:3, :3] = rotation.right_jacobian(dx[k, :3])
        P[k] = J @ (np.eye(s) - K @ H[k]) @ P_pred[k] @ J.T
        P[k] = 0.5 * (P[k] + P[k].T)
        H_d = H[k] @ np.linalg.inv(J)
        info[k] = H_d.T @ np.linalg.solve(R[k], H_d)
        vec[k] = H_d.T @ np.linalg.solve(R[k], z[k] - H[k] @ dx[k])
    problem = Problem(np.zeros(s), P_pred[0], Phi, Q, H, R, z, np.ones(n, dtype=np.bool_))
    return Chain(P_pred, P, Phi, Q, dx, info, vec, 3), problem


def dense_turning(chain: Chain, p: Problem) -> tuple[Array, Array]:
    """Joint posterior of the ``d_k`` of a turning chain: information matrix of all of them, inverted."""
    n, s = chain.dx.shape
    J, J_inv = (np.tile(np.eye(s), (n, 1, 1)) for _ in range(2))
    J[:, :3, :3] = rotation.right_jacobian(chain.dx[:, :3])
    J_inv = np.linalg.inv(J)
    A, b = np.zeros((n, s, n, s)), np.zeros((n, s))

    def add(rows: dict[int, Array], offset: Array, noise: Array) -> None:
        """Add ``|sum rows d - offset|^2`` weighted by the noise."""
        W = np.linalg.inv(noise)
        for i, a in rows.items():
            b[i] += a.T @ W @ offset
            for j, c in rows.items():
                A[i, :, j] += a.T @ W @ c

    add({0: J_inv[0]}, -chain.dx[0], p.P0)  # e_0 = dx_0 + J^-1 d_0 has mean zero
    for k in range(n):
        add({k: p.H[k] @ J_inv[k]}, p.z[k] - p.H[k] @ chain.dx[k], p.R[k])
        if k:
            add({k: J_inv[k], k - 1: -p.Phi[k - 1]}, -chain.dx[k], p.Q[k - 1])
    cov = np.linalg.inv(A.reshape(n * s, n * s))
    return (cov @ b.ravel()).reshape(n, s), cov.reshape(n, s, n, s)
