"""Constant rotations and shifts between two tracks: a reference on another datum, or fixed to other body axes."""

from __future__ import annotations

import numpy as np

from ..errors import AttestError
from ..maths import rotation
from ..records import Array

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
ROUNDS = 50
SETTLED = 1e-13  # rad
TELL_APART = 1e-4  # least mean square sine between what the world side and the body side turn
AXES = {"none": 0, "yaw": 1, "full": 3}
"""How many world axes (the last ones) an alignment may turn about."""


def fit_rotations(q_est: Array, q_ref: Array, weight: Array, world: str, *, body: bool) -> tuple[Array, Array]:
    r"""Return the constant rotations ``q_world``, ``q_body`` (4,) that bring the reference nearest to the estimate.

    .. math:: \min\sum_i w_i\,|\mathrm{Log}(\bar q_{est,i}\,q_{world}\,q_{ref,i}\,q_{body})|^2

    Parameters
    ----------
    q_est, q_ref : (n, 4)
    weight : (n,)
    world : none, yaw (about the vertical) or full
    body : also fit a rotation on the body's side

    Raises
    ------
    AttestError
        If both sides are wanted and the motion cannot tell them apart.

    Notes
    -----
    Gauss-Newton from a closed-form start; residual turned to the body: :math:`r + R_i^\top\delta_{world} +
    \delta_{body}`, ``R_i`` of the turned reference.
    """
    q_world, q_body = _start(q_est, q_ref, weight, world, body=body)
    free = AXES[world]
    columns = [*range(3 - free, 3), *(range(3, 6) if body else ())]
    if not columns:
        return q_world, q_body
    for _ in range(ROUNDS):
        turned = rotation.multiply(rotation.multiply(q_world, q_ref), q_body)
        residual = rotation.log_quaternion(rotation.multiply(rotation.conjugate(q_est), turned))
        seen = np.concatenate(
            [rotation.matrix(turned).swapaxes(1, 2), np.broadcast_to(np.eye(3), (len(turned), 3, 3))], axis=2
        )[:, :, columns]
        normal = np.einsum("n,nki,nkj->ij", weight, seen, seen) / weight.sum()
        if free and body and np.linalg.eigvalsh(normal)[0] < TELL_APART:
            raise AttestError(
                "the motion cannot tell a constant rotation of the body from one of the world: it hardly turns",
                "leave out --align-body, or use --align none with it",
            )
        step = np.zeros(6)
        step[columns] = -np.linalg.solve(normal, np.einsum("n,nki,nk->i", weight, seen, residual) / weight.sum())
        q_world = rotation.normalise(rotation.multiply(rotation.exp_quaternion(step[:3]), q_world))
        q_body = rotation.normalise(rotation.multiply(q_body, rotation.exp_quaternion(step[3:])))
        if np.abs(step).max() < SETTLED:
            break
    return q_world, q_body


def _start(q_est: Array, q_ref: Array, weight: Array, world: str, *, body: bool) -> tuple[Array, Array]:
    """Return rotations near the best ones: chordal means, both sides from the leading singular vectors of ``sum R_est
    (x) R_ref``.
    """
    if not body:
        return _mean(rotation.multiply(q_est, rotation.conjugate(q_ref)), weight, world), IDENTITY
    q_world = IDENTITY
    if world != "none":
        R_est, R_ref = rotation.matrix(q_est), rotation.matrix(q_ref)
        K = np.einsum("n,nad,nbc->abcd", weight, R_est, R_ref).reshape(9, 9)
        u, _, _ = np.linalg.svd(K)
        leading = u[:, 0].reshape(3, 3)
        near = nearest_rotation(leading * np.sign(np.linalg.det(leading)))
        q_world = _mean(rotation.from_matrix(near)[None], np.ones(1), world)
    turned = rotation.multiply(q_world, q_ref)
    return q_world, _mean(rotation.multiply(rotation.conjugate(turned), q_est), weight, "full")


def _mean(q: Array, weight: Array, world: str) -> Array:
    """Return the chordal mean (4,) of rotations (n, 4), about the vertical alone where ``world`` says so."""
    if world == "none":
        return IDENTITY
    R = np.einsum("n,nij->ij", weight, rotation.matrix(q))
    if world == "yaw":
        half = 0.5 * np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])
        return np.array([np.cos(half), 0.0, 0.0, np.sin(half)])
    return rotation.from_matrix(nearest_rotation(R))


def nearest_rotation(m: Array) -> Array:
    """Return the rotation matrix (3, 3) nearest to ``m`` in the Frobenius norm (Kabsch)."""
    u, _, vt = np.linalg.svd(m)
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u) * np.linalg.det(vt)]) @ vt)


def fit_points(p_est: Array, p_ref: Array, world: str) -> tuple[Array, Array]:
    r"""Return ``q`` (4,) and ``shift`` (3,) with the least :math:`\sum|R\,p_{ref}+shift-p_{est}|^2`.

    ``world``: none (nothing is moved), yaw (turn about the vertical, and shift), full (SE(3)).

    Raises
    ------
    AttestError
        If the points lie on one line, so that a full rotation about it stays open.

    Notes
    -----
    Umeyama, IEEE PAMI 13(4), 1991, eqs 40-42 without scale.
    """
    if world == "none":
        return IDENTITY, np.zeros(3)
    centre_est, centre_ref = p_est.mean(axis=0), p_ref.mean(axis=0)
    cross = (p_est - centre_est).T @ (p_ref - centre_ref)
    if world == "full":
        sizes = np.linalg.svd(cross, compute_uv=False)
        if sizes[1] <= 1e-9 * sizes[0]:
            raise AttestError("the positions lie on one line: a full alignment is open about it", "use --align yaw")
        q = rotation.from_matrix(nearest_rotation(cross))
    else:
        half = 0.5 * np.arctan2(cross[1, 0] - cross[0, 1], cross[0, 0] + cross[1, 1])
        q = np.array([np.cos(half), 0.0, 0.0, np.sin(half)])
    return q, np.asarray(centre_est - rotation.rotate(q, centre_ref))
