"""The fixed-interval estimate: forward, backward, linearised again about the result, until it settles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...maths import adjoint, kalman, rotation, sequential
from ...records import Array, Bools, Innovations, Ints, Smoothed
from .aids import Aid, Rows
from .model import Inertial, Linear, Trajectory, linearise
from .states import Layout

SPARED = 0.05  # weight below which a measurement counts as refused
DATUM = 1e-4  # rad: how well a mean heading is taken as known
SETTLED, STILL_MOVES = 0.1, 0.3  # of a sigma, any state: when to stop; what the last pass may move
ROUNDED = 1e-8  # of a filtered variance: what is left of it when all but that is known is rounded off
SHRINKS, LEAST_SHARE = 0.5, 0.1  # a step back that is so much smaller is taken whole; least share of another


@dataclass(frozen=True, slots=True)
class Stack:
    """The rows of all aids, whitened and weighted: ``r`` (n, m), ``H`` (n, m, s), zero where there is none;
    ``places``: per aid its rows, their first place in the stack, and their weights.
    """

    r: Array
    H: Array
    places: tuple[tuple[Aid, Rows, Ints, Array], ...]


def stack(aids: Sequence[Aid], layout: Layout, at: Trajectory) -> Stack:
    """Put the rows of all aids on the nodes."""
    slopes, every = layout.slopes(), [(aid, aid.rows(layout, at)) for aid in aids]
    if np.any(slopes != 1.0):
        every = [(aid, replace(rows, H=rows.H * slopes)) for aid, rows in every]
    return pile(every, len(at.q), layout.size)


def pile(placed: Sequence[tuple[Aid, Rows]], n: int, size: int) -> Stack:
    """Put rows on ``n`` nodes, as close as they go."""
    used = np.zeros(n, dtype=np.int64)
    places = []
    for aid, rows in placed:
        first = used[rows.node].copy()
        np.add.at(used, rows.node, rows.r.shape[1])
        places.append((aid, rows, first, rows.weight if aid.robust else np.ones(len(rows.r))))
    m = max(1, int(used.max(initial=0)))
    r, H = np.zeros((n, m)), np.zeros((n, m, size))
    for _, rows, first, weight in places:
        scale = np.sqrt(weight)[:, None] / rows.sigma
        for j in range(rows.r.shape[1]):
            r[rows.node, first + j] = scale[:, j] * rows.r[:, j]
            H[rows.node, first + j] = scale[:, j, None] * rows.H[:, j]
    return Stack(r, H, tuple(places))


def forward(prior: Array, lin: Linear, rows: Stack, first: Array) -> sequential.Pass:
    """Run the filter over the errors about a trajectory. ``prior`` (s, s) covariance, ``first`` (s,) mean at node 0."""
    n, m = rows.r.shape
    return sequential.run(n, first, prior, m, *_model(lin, rows))


def log_likelihood(prior: Array, lin: Linear, rows: Stack) -> float:
    """Return the log-likelihood of the innovations of :func:`forward`."""
    return sequential.log_likelihood(len(rows.r), np.zeros(len(prior)), prior, *_model(lin, rows)) - whitening(rows)


def whitening(rows: Stack) -> float:
    """Return what the log-likelihood of whitened rows has more than that of the measurements."""
    return sum(float(np.sum(np.log(r.sigma) - 0.5 * np.log(w)[:, None])) for _, r, _, w in rows.places)


def _model(lin: Linear, rows: Stack) -> tuple[sequential.Predict, sequential.Observe]:
    """Return motion and measurements as the forward loop takes them."""
    eye = np.eye(rows.r.shape[1])
    measured = np.any(rows.H != 0.0, axis=(1, 2))

    def predict(k: int, d: Array) -> tuple[Array, Array, Array]:
        return lin.Phi[k] @ d + lin.u[k], lin.Phi[k], lin.Q[k]

    def observe(k: int, d: Array, _: Array) -> tuple[Array, Array, Array] | None:
        return (rows.r[k] - rows.H[k] @ d, rows.H[k], eye) if measured[k] else None

    return predict, observe


@dataclass(frozen=True, slots=True)
class Weighted:
    """An aid whose weights (k,) do not change."""

    aid: Aid
    weight: Array
    robust: bool = False

    @property
    def role(self) -> str:
        """Name among the innovations."""
        return self.aid.role

    def rows(self, layout: Layout, at: Trajectory) -> Rows:
        """Return its rows with the weights in their sigma."""
        rows = self.aid.rows(layout, at)
        return replace(rows, sigma=rows.sigma / np.sqrt(self.weight)[:, None])


@dataclass(frozen=True, slots=True)
class Solution:
    """The last pass: the trajectory ``at`` it is linear about, the forward ``found``, smoothed ``errors`` about the
    forward pass, the rows used, and by how many sigmas the last of ``passes`` still moved a state.
    """

    at: Trajectory
    found: sequential.Pass
    errors: kalman.Errors
    rows: Stack
    passes: int
    move: float

    @property
    def settled(self) -> bool:
        """Whether the last pass moved hardly anything."""
        return self.move < STILL_MOVES

    @property
    def smoothed(self) -> Trajectory:
        """The smoothed trajectory."""
        return self.at.moved(self.found.x + self.errors.d)

    @property
    def cost(self) -> float:
        r"""What the log costs at its optimum, :math:`-2\log L` but for what no state changes: the squares of the
        innovations over what is expected.
        """
        seen = np.isfinite(self.found.nu[:, 0])
        nu = self.found.nu[seen]
        return float(np.sum(nu * np.linalg.solve(self.found.S[seen], nu[:, :, None])[:, :, 0]))

    @property
    def weighted(self) -> tuple[Aid, ...]:
        """The aids whose weights stay as they are: costs can be compared then."""
        return tuple(Weighted(aid, weight) for aid, _, _, weight in self.rows.places)


def solve(
    layout: Layout, prior: tuple[Trajectory, Array], inertial: Inertial, aids: Sequence[Aid], at: Trajectory,
    most: int, tune: object = None,
) -> Solution:  # fmt: skip
    r"""Iterate forward and backward passes, Gauss-Newton steps :math:`d_k`, until no state moves.

    Where a weak direction, the heading within a long motion, is bent more by the noise of thousands of residuals than
    it is held, a whole step goes too far, the next one back and further still. So from the first step on that goes back
    and hardly shrinks, a share :math:`\omega_k` of each is taken: Aitken's relaxation (Irons and Tuck 1969),

    .. math:: \omega_{k+1}=-\omega_k\frac{d_k^TW(d_{k+1}-d_k)}{(d_{k+1}-d_k)^TW(d_{k+1}-d_k)},\qquad
        W=\mathrm{diag}(\sigma^{-2})

    Parameters
    ----------
    prior : state at the first node (a trajectory of one) and its covariance (s, s)
    at : trajectory to begin with
    most : passes at most
    tune : ``(aids, layout, trajectory) -> aids``: noise of the aids from the residuals of the last pass
    """
    passes, sigma, before, share = 0, None, None, 1.0
    while True:
        passes += 1
        lin = linearise(inertial, layout, at, smoothed=passes > 1)
        rows = stack(aids, layout, at)
        first, P0 = _prior(prior, at)
        found = forward(P0, lin, rows, first)
        d = found.x + adjoint.mean(found)
        if sigma is None:
            smoothed, filtered = (np.einsum("kii->ki", P) for P in (adjoint.smooth(found).P, found.chain.P))
            sigma = np.sqrt(np.maximum(smoothed, ROUNDED * filtered) + 1e-300)
        step = d / sigma
        move = float(np.max(np.abs(step)))
        if passes >= most or (passes > 1 and move < SETTLED):
            return Solution(at, found, adjoint.smooth(found), rows, passes, move)
        share = share if before is None else _share(before, step, share)
        at, before = at.moved(share * d), step
        if callable(tune):
            aids = tune(aids, layout, at)


def _share(before: Array, step: Array, share: float) -> float:
    """Return how much of a step is taken after ``share`` of the one ``before``."""
    along, size, turn = float(np.sum(before * step)), float(np.sum(before**2)), float(np.sum((step - before) ** 2))
    if share == 1.0 and (along >= 0.0 or np.sum(step**2) < SHRINKS**2 * size):
        return 1.0
    least = share if along >= 0.0 else LEAST_SHARE
    return float(np.clip(share * (size - along) / turn, least, 1.0)) if along < size else 1.0


def _prior(prior: tuple[Trajectory, Array], at: Trajectory) -> tuple[Array, Array]:
    """Return mean and covariance of the first node's error about the trajectory."""
    start, P = prior
    first = start.x[0] - at.x[0]
    first[:3] = rotation.log_quaternion(rotation.multiply(rotation.conjugate(at.q[:1]), start.q[:1]))[0]
    J = np.eye(len(first))
    J[:3, :3] = rotation.inverse_right_jacobian(first[:3][None])[0]
    return first, kalman.symmetric(J @ P @ J.T)


def relative_heading(found: Solution, t: Array, moving: Bools) -> Array:
    r"""Return the variance (n,) rad^2 of the heading if its mean over the motion were known.

    One more state sums the heading's error, :math:`I_{k+1}=I_k+w_k\,e_z^TR_k\delta\theta_k`; at the end it is measured
    as zero.
    """
    run, chain = found.found, found.found.chain
    n, s = chain.dx.shape
    up = rotation.matrix(found.smoothed.q)[:, 2]
    weight = np.diff(t) * moving[1:]
    weight /= max(float(weight.sum()), 1e-9)
    Phi, Q = (np.zeros((n - 1, s + 1, s + 1)) for _ in range(2))
    Phi[:, :s, :s], Q[:, :s, :s] = chain.Phi, chain.Q
    Phi[:, s, :3], Phi[:, s, s] = weight[:, None] * up[:-1], 1.0
    P0 = np.zeros((s + 1, s + 1))
    P0[:s, :s], P0[s, s] = chain.P_pred[0], DATUM**2
    H = np.zeros((n, run.H.shape[1] + 1, s + 1))
    H[:, :-1, :s], H[-1, -1, s] = run.H, 1.0 / DATUM
    measured, eye, zero = np.any(H != 0.0, axis=(1, 2)), np.eye(H.shape[1]), np.zeros(H.shape[1])
    again = sequential.run(
        n, np.zeros(s + 1), P0, H.shape[1], lambda k, x: (x, Phi[k], Q[k]),
        lambda k, *_: (zero, H[k], eye) if measured[k] else None,
    )  # fmt: skip
    P = adjoint.smooth(again).P[:, :3, :3]
    return np.asarray(np.einsum("ki,kij,kj->k", up, P, up))


def read(
    found: Solution, t: Array, bias: slice, relative: Array | None, errors: kalman.Errors
) -> Smoothed:  # fmt: skip
    """Return attitude, gyro bias, velocity and position of the forward pass corrected by ``errors``."""
    d = found.found.x + errors.d
    moved, passes, settled = found.at.moved(d), found.passes, found.settled
    T = np.zeros((len(t), 6, d.shape[1]))
    T[:, :3, :3] = rotation.right_jacobian(d[:, :3])
    T[:, 3:, bias] = np.eye(3)
    P = kalman.symmetric(T @ errors.P @ T.swapaxes(1, 2))
    cross = T[:-1] @ errors.cross @ T[1:].swapaxes(1, 2)
    return Smoothed(
        t,
        moved.q,
        moved.x[:, bias],
        P,
        cross,
        passes=passes,
        settled=settled,
        moves=found.move,
        v=moved.v,
        p=moved.p,
        P_vp=errors.P[:, 3:9, 3:9],
        heading_relative=relative,
    )


def innovations(found: sequential.Pass, rows: Stack) -> Innovations:
    """Return one row per measurement of every aid."""
    role, t, node, dof, nis, z, used = [], [], [], [], [], [], []
    for aid, part, first, weight in rows.places:
        k, d = part.node, part.r.shape[1]
        at = first[:, None] + np.arange(d)
        nu, S = found.nu[k[:, None], at], found.S[k[:, None, None], at[:, :, None], at[:, None, :]]
        role.append(np.full(len(k), aid.role))
        t.append(part.t)
        node.append(k)
        dof.append(np.full(len(k), d))
        nis.append(np.einsum("ki,ki->k", nu, np.linalg.solve(S, nu[:, :, None])[:, :, 0]))
        values = np.full((len(k), 3), np.nan)
        values[:, :d] = nu / np.sqrt(np.einsum("kii->ki", S))
        z.append(values)
        used.append(weight > SPARED)
    return Innovations(
        np.concatenate(role), np.concatenate(t), np.concatenate(node), np.concatenate(dof), np.concatenate(nis),
        np.concatenate(used), np.concatenate(z),
    )  # fmt: skip


__all__ = ["Solution", "innovations", "read", "replace", "solve", "stack"]
