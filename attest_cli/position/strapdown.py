"""Position from the specific force, from rest to rest."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from ..maths import rotation
from ..maths.kalman import symmetric
from ..nodes.noise import added_density
from ..records import Array, Imu, Segment, Segmentation, Smoothed
from ..settings import Settings
from .chain import blocks, markov
from .course import Position, cut, row_blocks, running, sampled, survey, usable

STILL_M_S = 2e-3  # how still a stop is
ACCEL_WALK = 1e-4  # m/s^2/sqrt(s): how an accelerometer's bias walks
NO_GAPS = np.zeros((0, 2))
PROOF = 1.92  # log likelihood ratio of 95 % for one parameter

Closing = tuple[Array, Array, float]
"""Velocity (3,) left at the end of a motion, its predicted covariance (3, 3), length of the motion, s."""


@dataclass(frozen=True, slots=True)
class Strapdown:
    """What is integrated: specific force ``accel_b`` (n, 3) at ``t`` (n,), attitude ``q`` (n, 4), gravity; ``literal``:
    by the paper's Euler steps.
    """

    t: Array
    accel_b: Array
    q: Array
    gravity: float
    literal: bool

    def run(self, rows: slice) -> Iterator[tuple[slice, Array, Array, Array, Array]]:
        """Yield rows, velocity, position, specific force (k, 3) in navigation axes and attitude (k, 3, 3) from rest on,
        block by block; each begins with the row at which the one before ended.
        """
        v, p, down = np.zeros((1, 3)), np.zeros((1, 3)), np.array([0.0, 0.0, self.gravity])
        for own in cut(rows.start, rows.stop):
            here = slice(max(own.start - 1, rows.start), own.stop)
            R = rotation.matrix(self.q[here])
            f_n = np.einsum("kij,kj->ki", R, self.accel_b[here])
            a, dt = f_n - down, np.diff(self.t[here])[:, None]
            if self.literal:
                v = running(v[-1], a[:-1] * dt)
                p = running(p[-1], v[:-1] * dt + 0.5 * a[:-1] * dt**2)
            else:
                v = running(v[-1], 0.5 * (a[1:] + a[:-1]) * dt)
                p = running(p[-1], v[:-1] * dt + dt**2 / 6 * (2 * a[:-1] + a[1:]))
            yield here, v, p, f_n, R


@dataclass(slots=True)
class Leg:
    """A stop (samples ``stop``, nodes ``rest``) and the ``motion`` after it (``rows``, ``at``), if there is one;
    ``closed`` by another stop. Between the nodes of the motion mean ``force`` (m - 1, 3) and ``R`` (m - 1, 3, 3);
    velocity and place ``end`` (2, 3), from rest on.
    """

    stop: slice
    rest: slice
    rows: slice
    at: slice
    motion: Segment | None
    closed: bool
    force: Array = field(default_factory=lambda: np.empty((0, 3)))
    R: Array = field(default_factory=lambda: np.empty((0, 3, 3)))
    end: Array = field(default_factory=lambda: np.zeros((2, 3)))


@dataclass(frozen=True, slots=True)
class Part:
    """A leg as it is told: it begins ``here`` (3,), ``dv``, ``dp`` (m, 3) at its nodes are added."""

    leg: Leg
    here: Array
    dv: Array
    dp: Array


def inertial_position(
    imu: Imu, q: Array, smoothed: Smoothed, segmentation: Segmentation, settings: Settings, gravity: float,
    accel_density: float, gaps: Array = NO_GAPS, literal: bool = False,
) -> Position:  # fmt: skip
    r"""Integrate the specific force over every motion, from rest to rest.

    Strapdown: :math:`a=R_{nb}f-g`, trapezoid in velocity, its integral in position; then the whole motion is
    conditioned on the zero velocity at its end: :math:`x_k\leftarrow x_k-\Sigma_k\Lambda_k^TS^{-1}v(T)`, where
    :math:`\mathrm{Cov}(x_k,v(T))=\Sigma_k\Lambda_k^T` follows from the error chain. ``literal``: eqs 41-44 (with their
    index corrected) and the linear removal :math:`v-\frac{t-t_0}{T}v(T)`, :math:`p-\frac{(t-t_0)^2}{2T}v(T)`.
    In motion the accelerometer is noisier than at rest (shaking): by as much as the velocities v(T) ask for. So it is
    where its samples are clipped or lost.

    Notes
    -----
    Errors of different motions count as independent. A motion without a stop before it, or with a gap in it, has no
    velocity to start from: NaN there, and after a gap.
    """
    strapdown = Strapdown(imu.t, imu.accel_b, q, gravity, literal)
    legs = _legs(imu.t, smoothed.t, segmentation, gaps)
    for leg in legs:
        if leg.motion is not None:
            leg.force, leg.R, leg.end = _means(strapdown, leg.rows, smoothed.t[leg.at])
    noise = accel_density**2 + added_density(imu.t, imu.accel_added, smoothed.t)
    P, parts, closings = _solved(strapdown, smoothed, legs, settings, noise)
    shaking = _shaking(closings)
    if shaking > 0.0:
        P, parts, _ = _solved(strapdown, smoothed, legs, settings, noise + shaking**2)

    def course() -> Iterator[tuple[Array, Array]]:
        return _course(strapdown, parts, smoothed.t)

    moved = [(leg, leg.motion) for leg in legs if leg.motion is not None]
    p, v, lengths = survey(course, imu.t, smoothed.t, [(leg.rows.start, leg.rows.stop) for leg, _ in moved])
    distance = {motion.index: float(length) for (_, motion), length in zip(moved, lengths, strict=True)}
    closing = {motion.index: float(np.linalg.norm(leg.end[0])) for leg, motion in moved if leg.closed}
    method = "literal" if literal else "strapdown"
    return Position(p, v, P, closing, distance, usable(P, distance), method, course)


def _shaking(closings: list[Closing]) -> float:
    """Return the density, m/s^2/sqrt(Hz), that the closing velocities ask for beside the noise at rest (maximum
    likelihood); 0 unless they contradict that alone (likelihood ratio, 95 %).
    """
    if not closings:
        return 0.0
    q = np.concatenate([[0.0], np.geomspace(1e-10, 1.0, 201)])  # spectral density, m^2/s^3
    likelihood = np.zeros(len(q))
    for velocity, predicted, length in closings:
        values, axes = np.linalg.eigh(predicted)
        S = np.maximum(values, 0.0) + q[:, None] * length
        likelihood -= 0.5 * np.sum((velocity @ axes) ** 2 / S + np.log(S), axis=1)
    best = int(np.argmax(likelihood))
    return float(np.sqrt(q[best])) if likelihood[best] - likelihood[0] > PROOF else 0.0


def _legs(t: Array, nodes: Array, segmentation: Segmentation, gaps: Array) -> list[Leg]:
    """Return each stop with the motion after it, from the first stop on, up to a gap."""
    segments, out = segmentation.segments, list[Leg]()
    k = next((i for i, s in enumerate(segments) if not s.motion), len(segments))
    while k < len(segments):
        stop, motion, closing = (segments[i] if i < len(segments) else None for i in (k, k + 1, k + 2))
        assert stop is not None
        until = closing.used_start if closing is not None else motion.end if motion is not None else stop.end
        holed = bool(np.any((gaps[:, 1] > stop.used_start) & (gaps[:, 0] < until)))
        start = stop.used_start if out else stop.start
        if motion is None or not motion.motion or holed or (closing is not None and closing.motion):
            still = _inside(t, start, stop.end)
            out.append(Leg(still, _inside(nodes, start, stop.end), slice(0, 0), slice(0, 0), None, closed=False))
            break
        still, rows = _inside(t, start, stop.used_end), _inside(t, stop.used_end, until)
        at = _inside(nodes, stop.used_end, until)
        out.append(Leg(still, _inside(nodes, start, stop.used_end), rows, at, motion, closed=closing is not None))
        k += 2
    return out


def _means(strapdown: Strapdown, rows: slice, nodes: Array) -> tuple[Array, Array, Array]:
    """Return mean force (m - 1, 3) and attitude (m - 1, 3, 3) between nodes (trapezoids); velocity and place at the end
    (2, 3).
    """
    t, end = strapdown.t, np.zeros((2, 3))

    def integrals() -> Iterator[tuple[Array, Array]]:
        total = np.zeros(12)
        for here, v, p, f_n, R in strapdown.run(rows):
            signal = np.concatenate([f_n, R.reshape(-1, 9)], axis=1)
            sums = running(total, 0.5 * (signal[1:] + signal[:-1]) * np.diff(t[here])[:, None])
            total, end[:] = sums[-1], (v[-1], p[-1])
            yield t[here], sums

    means = np.diff(sampled(integrals(), nodes), axis=0) / np.diff(nodes)[:, None]
    return means[:, :3], means[:, 3:].reshape(-1, 3, 3), end


def _solved(
    strapdown: Strapdown, smoothed: Smoothed, legs: list[Leg], settings: Settings, white: Array
) -> tuple[Array, list[Part], list[Closing]]:
    """Return the covariance at the nodes, the legs as they are told, and the velocities left at their ends; ``white``
    (n - 1,) is the spectral density of the force between the nodes, m^2/s^3.
    """
    t, nodes = strapdown.t, smoothed.t
    P, spread, here = np.full((len(nodes), 3, 3), np.nan), np.zeros((3, 3)), np.zeros(3)
    parts, closings = list[Part](), list[Closing]()
    for leg in legs:
        P[leg.rest] = spread
        if leg.motion is None:
            parts.append(Part(leg, here, np.empty((0, 3)), np.empty((0, 3))))
            continue
        dv, dp, C, S = _closed(leg, smoothed, settings, white, strapdown.literal)
        parts.append(Part(leg, here, dv, dp))
        P[leg.at] = spread + C
        last = leg.rows.stop - 1
        here, spread = here + leg.end[1] + _at(t[last : last + 1], nodes[leg.at], dp)[0], P[leg.at.stop - 1].copy()
        if leg.closed:
            length = float(t[last] - t[leg.rows.start])
            closings.append((leg.end[0], S[6:9, 6:9] + STILL_M_S**2 * np.eye(3), length))
    return P, parts, closings


def _told(strapdown: Strapdown, part: Part, nodes: Array) -> Iterator[tuple[slice, Array, Array]]:
    """Yield rows, position and velocity of a motion, corrected; block by block without the row they share."""
    t, leg = strapdown.t, part.leg
    for here, v, p, _, _ in strapdown.run(leg.rows):
        skip = int(here.start > leg.rows.start)
        rows = slice(here.start + skip, here.stop)
        dp, dv = (_at(t[rows], nodes[leg.at], values) for values in (part.dp, part.dv))
        yield rows, part.here + p[skip:] + dp, v[skip:] + dv


def _course(strapdown: Strapdown, parts: list[Part], nodes: Array) -> Iterator[tuple[Array, Array]]:
    """Yield position and velocity at the samples, block by block; NaN where no leg is."""

    def pieces() -> Iterator[tuple[slice, Array, Array]]:
        for part in parts:
            for rows in cut(part.leg.stop.start, part.leg.stop.stop):
                yield rows, part.here, np.zeros(3)
            yield from _told(strapdown, part, nodes)

    todo = pieces()
    piece = next(todo, None)
    for rows in row_blocks(len(strapdown.t)):
        p, v = (np.full((rows.stop - rows.start, 3), np.nan) for _ in range(2))
        while piece is not None and piece[0].start < rows.stop:
            inside = slice(piece[0].start - rows.start, piece[0].stop - rows.start)
            p[inside], v[inside] = piece[1], piece[2]
            piece = next(todo, None)
        yield p, v


def _model(leg: Leg, smoothed: Smoothed, lo: int, hi: int, white: Array) -> tuple[Array, Array, Array]:
    """Return the transitions and their noise (k, 15, 15) of ``[dtheta_n, dbias, dv, dp, dba]`` between the nodes ``lo
    .. hi`` of a leg, and the covariance (6, 6) of attitude and bias at the first.
    """
    own, chain = slice(lo - leg.at.start, hi - leg.at.start), markov(smoothed, lo, hi)
    tau = np.diff(smoothed.t[lo : hi + 1])[:, None, None]
    half = -0.5 * tau * rotation.skew(leg.force[own])
    A = np.tile(np.eye(15), (hi - lo, 1, 1))
    A[:, :6, :6] = chain.F
    A[:, 6:9, :6] = half @ chain.F[:, :3]
    A[:, 6:9, :3] += half
    A[:, 6:9, 12:] = -tau * leg.R[own]
    A[:, 9:12] += 0.5 * tau * A[:, 6:9]
    A[:, 9:12, 6:9] = tau * np.eye(3)
    B = np.zeros((hi - lo, 15, 6))
    B[:, :6] = np.eye(6)
    B[:, 6:9, :3], B[:, 9:12, :3] = half, 0.5 * tau * half
    noise = B @ chain.W @ B.swapaxes(1, 2)
    noise[:, 6:9, 6:9] += white[lo:hi, None, None] * tau * np.eye(3)
    noise[:, 12:, 12:] = ACCEL_WALK**2 * tau * np.eye(3)
    return A, noise, chain.P[0]


def _closed(
    leg: Leg, smoothed: Smoothed, settings: Settings, white: Array, literal: bool
) -> tuple[Array, Array, Array, Array]:
    """Return corrections of velocity and position (m, 3) at the nodes of a leg, the position covariance (m, 3, 3) after
    them, and the covariance (15, 15) before them at its end.
    """
    first, last = leg.at.start, leg.at.stop - 1
    m, stretches = last - first + 1, list(blocks(first, last))
    S, vp = np.zeros((15, 15)), np.empty((m, 6, 15))
    A = np.empty((0, 15, 15))
    for lo, hi in stretches:
        A, noise, P = _model(leg, smoothed, lo, hi, white)
        if lo == first:
            S[:6, :6], S[6:9, 6:9] = P, STILL_M_S**2 * np.eye(3)
            S[12:, 12:] = settings.imu.accel_bias_sigma**2 * np.eye(3)
            vp[0] = S[6:12]
        for k in range(hi - lo):
            S = A[k] @ S @ A[k].T + noise[k]
            S = 0.5 * (S + S.T)
            vp[lo + k + 1 - first] = S[6:12]
    if not leg.closed:
        return np.zeros((m, 3)), np.zeros((m, 3)), vp[:, 3:, 9:12], S
    end, t = S[6:9, 6:9] + STILL_M_S**2 * np.eye(3), smoothed.t[leg.at]
    correction, C = np.empty((m, 6)), np.empty((m, 3, 3))
    after = np.zeros((3, 15))
    after[:, 6:9] = np.eye(3)
    for number, (lo, hi) in enumerate(reversed(stretches)):
        if number:  # of the last stretch they are still here
            A = _model(leg, smoothed, lo, hi, white)[0]
        adjoint = np.empty((hi - lo + 1, 3, 15))
        adjoint[-1] = after
        for k in range(hi - lo - 1, -1, -1):
            adjoint[k] = adjoint[k + 1] @ A[k]
        after, own = adjoint[0], slice(lo - first, hi - first + 1)
        M = vp[own] @ adjoint.swapaxes(1, 2)  # Cov([dv, dp]_k, dv_T)
        K = _removal(t[own] - t[0], t[-1] - t[0]) if literal else _gain(M, end)
        KM = K @ M.swapaxes(1, 2)
        C[own] = symmetric(vp[own, :, 6:12] - KM - KM.swapaxes(1, 2) + K @ end @ K.swapaxes(1, 2))[:, 3:, 3:]
        correction[own] = -np.einsum("kij,j->ki", K, leg.end[0])
    return correction[:, :3], correction[:, 3:], C, S


def _gain(M: Array, end: Array) -> Array:
    return np.asarray(np.linalg.solve(end, M.swapaxes(1, 2)).swapaxes(1, 2))


def _removal(since: Array, length: float) -> Array:
    """Return the paper's linear removal of the closing velocity (m, 6, 3)."""
    share = (since / length)[:, None, None] * np.eye(3)
    return np.concatenate([share, 0.5 * since[:, None, None] * share], axis=1)


def _inside(t: Array, start: float, end: float) -> slice:
    return slice(int(np.searchsorted(t, start - 1e-9)), int(np.searchsorted(t, end + 1e-9, side="right")))


def _at(t: Array, nodes_t: Array, values: Array) -> Array:
    return np.stack([np.interp(t, nodes_t, values[:, i]) for i in range(values.shape[1])], axis=1)
