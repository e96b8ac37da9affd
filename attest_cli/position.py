r"""Position from the smoothed attitude: inertial between stops, or wheel odometry; with the sigma that the attitude
leaves.

The smoothed attitude error is a Gauss-Markov chain over the nodes: with the lag-one covariance of the smoother,
:math:`\delta_{k+1}=F_k\delta_k+\eta_k`, :math:`F_k=\mathrm{Cov}(\delta_{k+1},\delta_k)P_k^{-1}`. Position and
velocity are linear in it, so their covariance follows exactly by adding them to the state.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .maths import rotation
from .maths.kalman import symmetric
from .records import Array, Bools, Fixes, Imu, Segment, Segmentation, Smoothed
from .settings import Settings

ODOMETRY_CORRELATION_S = 1.0  # wheel slip lasts about this long
STILL_M_S = 2e-3  # how still a stop is
ACCEL_WALK = 1e-4  # m/s^2/sqrt(s): how an accelerometer's bias walks
LONGEST_SILENCE_S = 1.0  # odometry is bridged over this
LEAST_SPEED_M_S = 0.1
BLOCK_ROWS = 1 << 16  # samples handled together
NO_GAPS = np.zeros((0, 2))
PROOF = 1.92  # log likelihood ratio of 95 % for one parameter
UNUSABLE_SHARE = 0.1  # of the distance: a position worse than this is not worth its name


@dataclass(frozen=True, slots=True)
class Position:
    """``p``, ``v`` (n, 3) at the IMU samples, m and m/s; ``P`` (nodes, 3, 3) m^2; per motion (by segment index) closing
    velocity m/s and distance m; ``usable``: sigma stays below 10 % of the distance. NaN where nothing is known.
    """

    p: Array
    v: Array
    P: Array
    closing: Mapping[int, float]
    distance: Mapping[int, float]
    usable: bool
    method: str


@dataclass(frozen=True, slots=True)
class Markov:
    """Smoothed errors ``[dtheta_n, dbias]`` over nodes: ``P`` (n, 6, 6), ``F``, ``W`` (n - 1, 6, 6)."""

    P: Array
    F: Array
    W: Array


def markov(smoothed: Smoothed) -> Markov:
    """Return the error chain with attitude errors about world axes."""
    n = len(smoothed.t)
    T = np.tile(np.eye(6), (n, 1, 1))
    T[:, :3, :3] = rotation.matrix(smoothed.q)
    P = symmetric(T @ smoothed.P @ T.swapaxes(1, 2))
    cross = T[:-1] @ smoothed.cross @ T[1:].swapaxes(1, 2)
    F = np.asarray(np.linalg.solve(P[:-1], cross).swapaxes(1, 2), dtype=np.float64)
    W = symmetric(P[1:] - F @ P[:-1] @ F.swapaxes(1, 2))
    return Markov(P, F, W)


def navigated(t: Array, smoothed: Smoothed, segmentation: Segmentation) -> Position:
    """Return velocity and position of a filter that estimates them, at the IMU samples ``t`` (n,): cubic between nodes.

    Nodes are a tenth of a second apart: what a cubic through place and speed leaves out is the jerk between them.
    """
    assert smoothed.p is not None
    assert smoothed.v is not None
    assert smoothed.P_vp is not None
    right = np.clip(np.searchsorted(smoothed.t, t), 1, len(smoothed.t) - 1)
    left, T = right - 1, (smoothed.t[right] - smoothed.t[right - 1])[:, None]
    s = np.clip((t[:, None] - smoothed.t[left, None]) / T, 0.0, 1.0)
    p0, p1, v0, v1 = smoothed.p[left], smoothed.p[right], smoothed.v[left], smoothed.v[right]
    p = p0 + s**2 * (3 - 2 * s) * (p1 - p0) + s * (1 - s) * T * ((1 - s) * v0 - s * v1)
    P = smoothed.P_vp[:, 3:, 3:]
    distance = {m.index: _length(p[m.first : m.last]) for m in segmentation.motions}
    return Position(p, v0 + s * (v1 - v0), P, {}, distance, _usable(P, distance), "navigation")


def odometry_position(
    imu: Imu, q: Array, q_bv: Array, smoothed: Smoothed, segmentation: Segmentation, odometry: Fixes,
    settings: Settings, gaps: Array = NO_GAPS,
) -> Position:  # fmt: skip
    r"""Dead reckoning: :math:`\dot p_n=R_{nb}R_{bv}v_v`.

    Error: :math:`\dot{\delta p}=-[v_n\times]\delta\theta_n+v_n\,\delta s+n`; ``delta s`` one scale error for the log,
    ``n`` slip with a correlation time of a second. Sideways and vertical speed count as zero where the log does not
    give them. Where the odometry is silent or the IMU has a gap, the position stands still and its sigma grows by the
    rms speed of the drive times the time.

    Parameters
    ----------
    q : (n, 4) attitude of the IMU at its samples
    q_bv : (4,) vehicle to IMU axes
    gaps : (g, 2) holes of the IMU, s
    """
    cfg, t = settings.odometry, smoothed.t
    silent = silences(odometry, imu.t, segmentation)
    blind = np.concatenate([gaps, silent])
    p, v_n, speed = _driven(imu.t, q, q_bv, segmentation, odometry, blind)
    for start, end in silent:
        v_n[(imu.t > start) & (imu.t < end)] = np.nan
    step = np.diff(np.stack([np.interp(t, imu.t, p[:, i]) for i in range(3)], axis=1), axis=0)
    slip = 2.0 * ODOMETRY_CORRELATION_S * np.array([cfg.sigma_m_s, cfg.lateral_sigma_m_s, cfg.lateral_sigma_m_s]) ** 2
    R_nodes = rotation.matrix(rotation.multiply(smoothed.q, q_bv))[:-1]
    moving = np.linalg.norm(step, axis=1) > 1e-9
    noise = (R_nodes * slip) @ R_nodes.swapaxes(1, 2) * (np.diff(t) * moving)[:, None, None]
    noise += _blind_variance(t, blind, speed)[:, None, None] * np.eye(3)
    P = _odometry_covariance(markov(smoothed), step, noise, cfg.scale_sigma)
    distance = {s.index: _length(p[s.first : s.last]) for s in segmentation.motions}
    return Position(p, v_n, P, {}, distance, _usable(P, distance), "odometry")


def _driven(
    t: Array, q: Array, q_bv: Array, segmentation: Segmentation, odometry: Fixes, blind: Array
) -> tuple[Array, Array, float]:
    """Return position and velocity (n, 3) at the samples ``t``, and the rms speed while moving; block by block."""
    R_bv, still, touched = rotation.matrix(q_bv).T, np.zeros(len(t), dtype=np.bool_), _touched(t, blind)
    for s in segmentation.stops:
        still[np.searchsorted(t, s.used_start) : np.searchsorted(t, s.used_end, side="right")] = True
    p, v_n, square, count = np.zeros((len(t), 3)), np.empty((len(t), 3)), 0.0, 0
    known = np.nan_to_num(odometry.values[:, :3])
    for lo in range(0, len(t), BLOCK_ROWS):
        rows = slice(lo, lo + BLOCK_ROWS)
        v_v = np.stack([np.interp(t[rows], odometry.t, known[:, i]) for i in range(3)], axis=1)
        v_v[still[rows]] = 0.0
        fast = np.einsum("ki,ki->k", v_v, v_v)
        fast = fast[fast > STILL_M_S**2]
        square, count = square + float(fast.sum()), count + fast.size
        v_n[rows] = rotation.rotate(q[rows], v_v @ R_bv)
        first = max(lo - 1, 0)  # the step into the block
        v = v_n[first : rows.stop]
        moved = 0.5 * (v[1:] + v[:-1]) * np.diff(t[first : rows.stop])[:, None]
        moved[touched[first : rows.stop - 1]] = 0.0
        p[first + 1 : rows.stop] = p[first] + np.cumsum(moved, axis=0)
    return p, v_n, max(LEAST_SPEED_M_S, float(np.sqrt(square / count))) if count else LEAST_SPEED_M_S


def silences(odometry: Fixes, span: Array, segmentation: Segmentation) -> Array:
    """Return the spans (k, 2) of motion in which the odometry says nothing; at a stop the speed is known without it."""
    t = odometry.t
    limit = max(LONGEST_SILENCE_S, 5.0 * float(np.median(np.diff(t)))) if len(t) > 1 else LONGEST_SILENCE_S
    stops = [np.arange(s.start, s.end + 0.5 * limit, 0.5 * limit) for s in segmentation.stops]
    known = np.clip(np.sort(np.concatenate([t, *stops])), span[0], span[-1])
    edges = np.concatenate([[span[0]], known, [span[-1]]])
    long = np.flatnonzero(np.diff(edges) > limit)
    return np.stack([edges[long], edges[long + 1]], axis=1)


def _touched(t: Array, spans: Array) -> Bools:
    """Return which intervals between consecutive times overlap one of the spans."""
    out = np.zeros(len(t) - 1, dtype=np.bool_)
    for start, end in spans:
        out[max(0, int(np.searchsorted(t, start, side="right")) - 1) : int(np.searchsorted(t, end, side="left"))] = True
    return out


def _blind_variance(t: Array, spans: Array, speed: float) -> Array:
    """Return the variance (m,) that intervals of ``t`` (m + 1,) inside spans without any speed add: ``(speed
    length)^2`` each.
    """
    out = np.zeros(len(t) - 1)
    for start, end in spans:
        inside = np.maximum(np.minimum(t[1:], end) - np.maximum(t[:-1], start), 0.0)
        out += speed**2 * (end - start) * inside
    return out


def _odometry_covariance(chain: Markov, step: Array, noise: Array, scale_sigma: float) -> Array:
    r"""Return the covariance (n, 3, 3) of a position that adds :math:`a_k=h_k(\theta_k+\theta_{k+1})`, slip and scale.

    With :math:`X_k=\mathrm{Cov}(\delta_k,p_k)`: :math:`X_{k+1}=F_kX_k+(F_kP_k+P_{k+1})E^Th_k^T`, where ``E`` picks the
    attitude; that is the only recursion, all else is a running sum.
    """
    n = len(chain.P)
    half_T = (-0.5 * rotation.skew(step)).swapaxes(1, 2)
    FP = chain.F @ chain.P[:-1]
    source = (FP + chain.P[1:])[:, :, :3] @ half_T
    X = np.zeros((n, 6, 3))
    for k in range(n - 1):
        X[k + 1] = chain.F[k] @ X[k] + source[k]
    with_step = (X[:-1] + chain.F @ X[:-1])[:, :3].swapaxes(1, 2) @ half_T
    spread = (chain.P[:-1] + chain.P[1:] + FP + FP.swapaxes(1, 2))[:, :3, :3]
    grown = with_step + with_step.swapaxes(1, 2) + half_T.swapaxes(1, 2) @ spread @ half_T + noise
    path = np.concatenate([np.zeros((1, 3)), np.cumsum(step, axis=0)])
    out = scale_sigma**2 * np.einsum("ki,kj->kij", path, path)
    out[1:] += np.cumsum(grown, axis=0)
    return symmetric(out)


def inertial_position(
    imu: Imu, q: Array, smoothed: Smoothed, segmentation: Segmentation, settings: Settings, gravity: float,
    accel_density: float, gaps: Array = NO_GAPS, literal: bool = False,
) -> Position:  # fmt: skip
    r"""Integrate the specific force over every motion, from rest to rest.

    Strapdown: :math:`a=R_{nb}f-g`, trapezoid in velocity, its integral in position; then the whole motion is
    conditioned on the zero velocity at its end: :math:`x_k\leftarrow x_k-\Sigma_k\Lambda_k^TS^{-1}v(T)`, where
    :math:`\mathrm{Cov}(x_k,v(T))=\Sigma_k\Lambda_k^T` follows from the error chain. ``literal``: eqs 41-44 (with their
    index corrected) and the linear removal :math:`v-\frac{t-t_0}{T}v(T)`, :math:`p-\frac{(t-t_0)^2}{2T}v(T)`.
    In motion the accelerometer is noisier than at rest (shaking): by as much as the velocities v(T) ask for.

    Notes
    -----
    Errors of different motions count as independent. A motion without a stop before it, or with a gap in it, has no
    velocity to start from: NaN there, and after a gap.
    """
    chain, legs = markov(smoothed), _legs(segmentation, gaps)

    def integrate(density: float) -> tuple[Position, list[Closing]]:
        return _integrated(imu, q, smoothed.t, chain, legs, settings, gravity, density, literal)

    found, closings = integrate(accel_density)
    shaking = _shaking(closings)
    return integrate(float(np.hypot(accel_density, shaking)))[0] if shaking > 0.0 else found


Closing = tuple[Array, Array, float]
"""Velocity (3,) left at the end of a motion, its predicted covariance (3, 3), length of the motion, s."""


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


def _integrated(
    imu: Imu, q: Array, t: Array, chain: Markov, legs: list[tuple[Segment, Segment | None, Segment | None]],
    settings: Settings, gravity: float, accel_density: float, literal: bool,
) -> tuple[Position, list[Closing]]:  # fmt: skip
    """Return the position over all legs, and the velocities that were left at their ends."""
    n, closings = len(imu.t), list[Closing]()
    p, v, P = np.full((n, 3), np.nan), np.full((n, 3), np.nan), np.full((len(t), 3, 3), np.nan)
    closing: dict[int, float] = {}
    distance: dict[int, float] = {}
    here, spread = np.zeros(3), np.zeros((3, 3))
    for stop, motion, following in legs:
        first = stop.used_start if np.isfinite(p[:, 0]).any() else stop.start
        last = stop.used_end if motion is not None else stop.end
        rows, at = _inside(imu.t, first, last), _inside(t, first, last)
        p[rows], v[rows], P[at] = here, 0.0, spread
        if motion is None:
            continue
        end = following.used_start if following is not None else motion.end
        rows, at = _inside(imu.t, stop.used_end, end), _inside(t, stop.used_end, end)
        leg = _leg(imu, q, rows, gravity, literal)
        S, A = _leg_covariance(chain, leg, at, t, accel_density, settings)
        dv, dp, C = _close(leg, S, A, t[at], following is not None, literal)
        v[rows] = leg.v + _at(imu.t[rows], t[at], dv)
        p[rows] = here + leg.p + _at(imu.t[rows], t[at], dp)
        P[at] = spread + C
        distance[motion.index] = _length(p[rows])
        if following is not None:
            closing[motion.index] = float(np.linalg.norm(leg.v[-1]))
            closings.append((leg.v[-1], S[-1, 6:9, 6:9] + STILL_M_S**2 * np.eye(3), float(leg.t[-1] - leg.t[0])))
        here, spread = p[rows.stop - 1].copy(), P[at.stop - 1].copy()
    found = Position(p, v, P, closing, distance, _usable(P, distance), "literal" if literal else "strapdown")
    return found, closings


def _legs(segmentation: Segmentation, gaps: Array) -> list[tuple[Segment, Segment | None, Segment | None]]:
    """Return each stop with the motion after it and the stop that closes it, from the first stop on, up to a gap."""
    segments = segmentation.segments
    out: list[tuple[Segment, Segment | None, Segment | None]] = []
    k = next((i for i, s in enumerate(segments) if not s.motion), len(segments))
    while k < len(segments):
        motion = segments[k + 1] if k + 1 < len(segments) else None
        closing = segments[k + 2] if k + 2 < len(segments) else None
        until = closing.used_start if closing is not None else motion.end if motion is not None else segments[k].end
        holed = bool(np.any((gaps[:, 1] > segments[k].used_start) & (gaps[:, 0] < until)))
        broken = holed or (closing is not None and closing.motion)
        if motion is None or not motion.motion or broken:
            out.append((segments[k], None, None))
            break
        out.append((segments[k], motion, closing))
        k += 2
    return out


@dataclass(frozen=True, slots=True)
class Leg:
    """One motion integrated from rest: ``v``, ``p``, ``f_n`` (m, 3) at its samples ``t``."""

    t: Array
    v: Array
    p: Array
    f_n: Array
    R: Array


def _leg(imu: Imu, q: Array, rows: slice, gravity: float, literal: bool) -> Leg:
    t, R = imu.t[rows], rotation.matrix(q[rows])
    f_n = np.einsum("kij,kj->ki", R, imu.accel_b[rows])
    a = f_n - np.array([0.0, 0.0, gravity])
    dt = np.diff(t)[:, None]
    zero = np.zeros((1, 3))
    if literal:
        v = np.concatenate([zero, np.cumsum(a[:-1] * dt, axis=0)])
        p = np.concatenate([zero, np.cumsum(v[:-1] * dt + 0.5 * a[:-1] * dt**2, axis=0)])
    else:
        v = np.concatenate([zero, np.cumsum(0.5 * (a[1:] + a[:-1]) * dt, axis=0)])
        p = np.concatenate([zero, np.cumsum(v[:-1] * dt + dt**2 / 6 * (2 * a[:-1] + a[1:]), axis=0)])
    return Leg(t, v, p, f_n, R)


def _leg_covariance(
    chain: Markov, leg: Leg, at: slice, t_all: Array, accel_density: float, settings: Settings
) -> tuple[Array, Array]:
    """Covariances (m, 15, 15) of ``[dtheta_n, dbias, dv, dp, dba]`` at the nodes of a leg and its transitions (m - 1,
    15, 15).
    """
    t = t_all[at]
    m = len(t)
    mean_f = np.stack([_means(leg.t, leg.f_n[:, i], t) for i in range(3)], axis=1)
    R = np.stack([_means(leg.t, leg.R[:, i, j], t) for i in range(3) for j in range(3)], axis=1).reshape(-1, 3, 3)
    G, tau = -rotation.skew(mean_f), np.diff(t)
    S, A = np.zeros((m, 15, 15)), np.tile(np.eye(15), (m - 1, 1, 1))
    S[0, :6, :6] = chain.P[at.start]
    S[0, 6:9, 6:9] = STILL_M_S**2 * np.eye(3)
    S[0, 12:, 12:] = settings.imu.accel_bias_sigma**2 * np.eye(3)
    F, W = chain.F[at.start : at.stop - 1], chain.W[at.start : at.stop - 1]
    half = 0.5 * tau[:, None, None] * G
    A[:, :6, :6] = F
    A[:, 6:9, :6] = half @ F[:, :3]
    A[:, 6:9, :3] += half
    A[:, 6:9, 12:] = -tau[:, None, None] * R
    A[:, 9:12] += 0.5 * tau[:, None, None] * A[:, 6:9]
    A[:, 9:12, 6:9] = tau[:, None, None] * np.eye(3)
    B = np.zeros((m - 1, 15, 6))
    B[:, :6] = np.eye(6)
    B[:, 6:9, :3], B[:, 9:12, :3] = half, 0.5 * tau[:, None, None] * half
    noise = B @ W @ B.swapaxes(1, 2)
    noise[:, 6:9, 6:9] += accel_density**2 * tau[:, None, None] * np.eye(3)
    noise[:, 12:, 12:] = ACCEL_WALK**2 * tau[:, None, None] * np.eye(3)
    for k in range(m - 1):
        now = A[k] @ S[k] @ A[k].T + noise[k]
        S[k + 1] = 0.5 * (now + now.T)
    return S, A


def _close(leg: Leg, S: Array, A: Array, t: Array, closed: bool, literal: bool) -> tuple[Array, Array, Array]:
    """Return corrections of velocity and position (m, 3) at the nodes, and the position covariance (m, 3, 3) after
    them.
    """
    m = len(t)
    if not closed:
        return np.zeros((m, 3)), np.zeros((m, 3)), S[:, 9:12, 9:12]
    adjoint = np.zeros((m, 3, 15))
    adjoint[-1, :, 6:9] = np.eye(3)
    for k in range(m - 2, -1, -1):
        adjoint[k] = adjoint[k + 1] @ A[k]
    M = S[:, 6:12] @ adjoint.swapaxes(1, 2)  # Cov([dv, dp]_k, dv_T)
    end = S[-1, 6:9, 6:9] + STILL_M_S**2 * np.eye(3)
    if literal:
        share = (t - t[0]) / (t[-1] - t[0])
        K = np.concatenate(
            [share[:, None, None] * np.eye(3), (0.5 * share * (t - t[0]))[:, None, None] * np.eye(3)], axis=1
        )
    else:
        K = np.linalg.solve(end, M.swapaxes(1, 2)).swapaxes(1, 2)
    KM = K @ M.swapaxes(1, 2)
    covariance = symmetric(S[:, 6:12, 6:12] - KM - KM.swapaxes(1, 2) + K @ end @ K.swapaxes(1, 2))
    correction = -np.einsum("kij,j->ki", K, leg.v[-1])
    return correction[:, :3], correction[:, 3:], covariance[:, 3:, 3:]


def _inside(t: Array, start: float, end: float) -> slice:
    return slice(int(np.searchsorted(t, start - 1e-9)), int(np.searchsorted(t, end + 1e-9, side="right")))


def _at(t: Array, nodes_t: Array, values: Array) -> Array:
    return np.stack([np.interp(t, nodes_t, values[:, i]) for i in range(values.shape[1])], axis=1)


def _means(t: Array, values: Array, edges: Array) -> Array:
    """Return the means of a sampled signal between consecutive edges (trapezoid of its integral)."""
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t))])
    return np.asarray(np.diff(np.interp(edges, t, integral)) / np.diff(edges))


def _length(p: Array) -> float:
    """Return the length of the line through points ``p`` (n, 3)."""
    step = np.diff(p, axis=0)
    return float(np.sum(np.sqrt(np.einsum("ki,ki->k", step, step))))


def _usable(P: Array, distance: Mapping[int, float]) -> bool:
    """Return whether the largest horizontal sigma stays below a tenth of the distance driven."""
    total = sum(distance.values())
    horizontal = np.sqrt(np.nanmax(P[:, 0, 0] + P[:, 1, 1])) if np.isfinite(P).any() else np.inf
    return bool(horizontal <= UNUSABLE_SHARE * total)
