"""Dead reckoning with wheel odometry."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from ..maths import rotation
from ..maths.kalman import symmetric
from ..records import Array, Bools, Fixes, Imu, Segmentation, Smoothed
from ..settings import Settings
from ..wheels import longest_hole, sigma_of
from .chain import blocks, markov
from .course import Position, around, row_blocks, running, survey, usable

CORRELATION_S = 1.0  # wheel slip lasts about this long
STILL_M_S = 2e-3  # a vehicle that drives is faster
LEAST_SPEED_M_S = 0.1
NO_GAPS = np.zeros((0, 2))


def odometry_position(
    imu: Imu, q: Array, q_bv: Array, smoothed: Smoothed, segmentation: Segmentation, odometry: Fixes,
    settings: Settings, gaps: Array = NO_GAPS,
) -> Position:  # fmt: skip
    r"""Dead reckoning: :math:`\dot p_n=R_{nb}R_{bv}v_v`.

    Error: :math:`\dot{\delta p}=-[v_n\times]\delta\theta_n+v_n\,\delta s+n`; ``delta s`` one scale error for the log,
    ``n`` slip with a correlation time of a second and the sigma of the wheels. Sideways and vertical speed count as
    zero where the log does not give them. Where the odometry is silent or the IMU has a gap, the position stands still
    and its sigma grows by the rms speed of the drive times the time.

    Parameters
    ----------
    q : (n, 4) attitude of the IMU at its samples
    q_bv : (4,) vehicle to IMU axes
    gaps : (g, 2) holes of the IMU, s
    """
    cfg, t, motions = settings.odometry, smoothed.t, segmentation.motions
    silent = silences(odometry, imu.t, segmentation)
    blind = np.concatenate([gaps, silent])
    still = _still(imu.t, segmentation)
    course = partial(_driven, imu.t, q, q_bv, odometry, still, blind, silent)
    p, v, lengths = survey(course, imu.t, t, [(m.first, m.last) for m in motions])
    step = np.diff(p, axis=0)
    middle, known = 0.5 * (t[1:] + t[:-1]), sigma_of(odometry, cfg)
    sigma = np.stack([np.interp(middle, odometry.t, column) for column in known.T], axis=1)
    moving = np.linalg.norm(step, axis=1) > 1e-9
    slip = 2.0 * CORRELATION_S * sigma**2 * (np.diff(t) * moving)[:, None]
    unseen = _blind_variance(t, blind, _speed(imu.t, odometry, still) if len(blind) else 0.0)

    def noise(rows: slice) -> Array:
        R = rotation.matrix(rotation.multiply(smoothed.q[rows], q_bv))
        slipped: Array = (R * slip[rows, None, :]) @ R.swapaxes(1, 2)
        return slipped + unseen[rows, None, None] * np.eye(3)

    P = _covariance(smoothed, step, noise, cfg.scale_sigma)
    distance = dict(zip((m.index for m in motions), lengths.tolist(), strict=True))
    return Position(p, v, P, {}, distance, usable(P, distance), "odometry", course)


def _driven(
    t: Array, q: Array, q_bv: Array, odometry: Fixes, still: Bools, blind: Array, silent: Array
) -> Iterator[tuple[Array, Array]]:
    """Yield position and velocity at the samples ``t``, block by block."""
    R_bv, touched = rotation.matrix(q_bv).T, _touched(t, blind)
    place, last = np.zeros(3), np.zeros((0, 3))
    for rows in row_blocks(len(t)):
        v = rotation.rotate(q[rows], _vehicle_speed(t[rows], odometry, still[rows]) @ R_bv)
        joined, first = np.concatenate([last, v]), rows.start - len(last)  # with the step into the block
        moved = 0.5 * (joined[1:] + joined[:-1]) * np.diff(t[first : rows.stop])[:, None]
        moved[touched[first : rows.stop - 1]] = 0.0
        p = running(place, moved)[len(last) :]
        place, last = p[-1], v[-1:].copy()
        for start, end in silent:
            v[(t[rows] > start) & (t[rows] < end)] = np.nan
        yield p, v


def _vehicle_speed(t: Array, odometry: Fixes, still: Bools) -> Array:
    """Return the velocity (k, 3) in vehicle axes at times ``t``, zero where the vehicle is known to stand."""
    rows = around(odometry.t, t)
    known = np.nan_to_num(odometry.values[rows, :3])
    v = np.stack([np.interp(t, odometry.t[rows], column) for column in known.T], axis=1)
    v[still] = 0.0
    return v


def _speed(t: Array, odometry: Fixes, still: Bools) -> float:
    """Return the rms speed at the samples ``t`` in which the vehicle moves."""
    square, count = 0.0, 0
    for rows in row_blocks(len(t)):
        v = _vehicle_speed(t[rows], odometry, still[rows])
        fast = np.einsum("ki,ki->k", v, v)
        fast = fast[fast > STILL_M_S**2]
        square, count = square + float(fast.sum()), count + fast.size
    return max(LEAST_SPEED_M_S, float(np.sqrt(square / count))) if count else LEAST_SPEED_M_S


def _still(t: Array, segmentation: Segmentation) -> Bools:
    out = np.zeros(len(t), dtype=np.bool_)
    for s in segmentation.stops:
        out[np.searchsorted(t, s.used_start) : np.searchsorted(t, s.used_end, side="right")] = True
    return out


def silences(odometry: Fixes, span: Array, segmentation: Segmentation) -> Array:
    """Return the spans (k, 2) of motion in which the odometry says nothing; at a stop the speed is known without it."""
    t = odometry.t
    limit = longest_hole(t)
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


def _covariance(smoothed: Smoothed, step: Array, noise: Callable[[slice], Array], scale_sigma: float) -> Array:
    r"""Return the covariance (n, 3, 3) of a position that adds :math:`a_k=h_k(\theta_k+\theta_{k+1})`, slip and scale.

    With :math:`X_k=\mathrm{Cov}(\delta_k,p_k)`: :math:`X_{k+1}=F_kX_k+(F_kP_k+P_{k+1})E^Th_k^T`, where ``E`` picks the
    attitude; that is the only recursion, all else is a running sum. ``noise`` gives (k, 3, 3) of intervals.
    """
    path = np.concatenate([np.zeros((1, 3)), np.cumsum(step, axis=0)])
    out: Array = scale_sigma**2 * np.einsum("ki,kj->kij", path, path)
    now, total = np.zeros((6, 3)), np.zeros(9)
    for lo, hi in blocks(0, len(step)):
        chain, half_T = markov(smoothed, lo, hi), (-0.5 * rotation.skew(step[lo:hi])).swapaxes(1, 2)
        FP = chain.F @ chain.P[:-1]
        source = (FP + chain.P[1:])[:, :, :3] @ half_T
        X = np.empty((hi - lo, 6, 3))
        for k in range(hi - lo):
            X[k] = now
            now = chain.F[k] @ now + source[k]
        with_step = (X + chain.F @ X)[:, :3].swapaxes(1, 2) @ half_T
        spread = (chain.P[:-1] + chain.P[1:] + FP + FP.swapaxes(1, 2))[:, :3, :3]
        grown = with_step + with_step.swapaxes(1, 2) + half_T.swapaxes(1, 2) @ spread @ half_T + noise(slice(lo, hi))
        sums = running(total, grown.reshape(-1, 9))
        out[lo + 1 : hi + 1] = symmetric(out[lo + 1 : hi + 1] + sums[1:].reshape(-1, 3, 3))
        total = sums[-1]
    return out
