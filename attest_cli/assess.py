"""What a run says about itself: separation of the passes, checks per segment, stop advice."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from .maths import rotation
from .nodes.noise import Noise, stop_ranges
from .position import Position
from .records import Array, Bools, Log, Segment, Segmentation
from .track import world_variance

VAGUE_RAD = np.radians(10.0)  # passes less sure than this of their difference cannot be compared
LONGEST_S = 86400.0  # the advice looks this far ahead
SOON_S = 5.0  # a stop advised this soon after the last, or before the next, tells nobody anything


@dataclass(frozen=True, eq=False)
class Pass:
    """One pass over the nodes: ``q`` (n, 4), ``bias`` (n, 3), ``P`` (n, 6, 6); NaN where it knows nothing."""

    q: Array
    bias: Array
    P: Array

    def turned(self, q_bv: Array, sigma: Array) -> Pass:
        """Return the same pass in body axes ``v``, themselves known to ``sigma`` (3,) rad: ``q_nv = q_nb q_bv``."""
        R = rotation.matrix(q_bv)
        T = np.zeros((6, 6))
        T[:3, :3] = T[3:, 3:] = R.T
        P = T @ self.P @ T.T
        P[:, :3, :3] += np.diag(sigma**2)
        return Pass(rotation.multiply(self.q, q_bv), self.bias @ R, P)

    @cached_property
    def sigma_n(self) -> Array:
        """The attitude sigmas (n, 3) about world axes, rad."""
        return np.asarray(np.sqrt(np.einsum("kii->ki", world_variance(self.q, self.P))))


def separation(forward: Pass, backward: Pass) -> tuple[Array, Array]:
    """Return forward minus backward attitude (n, 3) about world axes, rad, and its predicted sigma ``sqrt(Pf +
    Pb)``.
    """
    apart_b = rotation.log_quaternion(rotation.multiply(rotation.conjugate(backward.q), forward.q))
    apart_n = np.einsum("kij,kj->ki", rotation.matrix(backward.q), apart_b)
    return apart_n, np.hypot(forward.sigma_n, backward.sigma_n)


def segment_checks(
    t: Array, forward: Pass, backward: Pass, segmentation: Segmentation
) -> dict[int, tuple[float, Array]]:
    """Return, per motion, the time where both passes are equally sure and their separation there in sigmas (3,).

    NaN where the passes are too vague to be compared.
    """
    apart, sigma = separation(forward, backward)
    f, b = (np.sum(p.sigma_n**2, axis=1) for p in (forward, backward))
    found = {}
    for s in segmentation.motions:
        part = _inside(t, s.start, s.end)
        rows = part.start + np.flatnonzero(np.isfinite(b[part]))
        if len(rows):
            k = rows[np.argmin(np.abs(np.log(f[rows] / b[rows])))]
            comparable = np.where(sigma[k] < VAGUE_RAD, apart[k] / sigma[k], np.nan)
            found[s.index] = (float(t[k]), comparable)
    return found


def _inside(t: Array, start: float, end: float) -> slice:
    """Return the nodes of a span, its ends among them."""
    return slice(int(np.searchsorted(t, start)), int(np.searchsorted(t, end, side="right")))


def segment_table(
    log: Log, segmentation: Segmentation, t: Array, passes: Mapping[str, Pass], position: Position | None, noise: Noise,
    threshold_deg: float, relative: bool,
) -> list[dict[str, Any]]:  # fmt: skip
    """Return one row per segment with the columns of ``segments.csv``; None where a column does not apply.

    ``relative``: heading counts from the start, so its separation says nothing.
    """
    checks = segment_checks(t, passes["forward"], passes["backward"], segmentation)
    if relative:
        checks = {i: (when, np.array([x, y, np.nan])) for i, (when, (x, y, _)) in checks.items()}
    sigma = {name: np.degrees(p.sigma_n) for name, p in passes.items()}
    ranges = dict(zip((s.index for s in segmentation.stops), stop_ranges(log, segmentation), strict=True))
    worst = {name: found.max(axis=1) for name, found in sigma.items()}
    rows = []
    for s in segmentation.segments:
        at = _inside(t, s.start - 1e-6, s.end + 1e-6)
        row: dict[str, Any] = {
            "index": s.index,
            "kind": "motion" if s.motion else "stop",
            "start_ns": int(log.t0_ns + round(s.start * 1e9)),
            "end_ns": int(log.t0_ns + round(s.end * 1e9)),
            "start_s": s.start,
            "end_s": s.end,
            "duration_s": s.end - s.start,
            "used_start_s": s.used_start,
            "used_end_s": s.used_end,
            "sigma_attitude_forward_deg": _most(worst["forward"][at]),
            "sigma_attitude_smoothed_deg": _most(worst["smoothed"][at]),
            "sigma_tilt_smoothed_deg": _most(np.hypot(*sigma["smoothed"][at, :2].T)),
        }
        row |= _motion_columns(s, checks, t, worst["forward"], position, threshold_deg) if s.motion else {}
        row |= _stop_columns(log, s, ranges[s.index], t, position, noise) if not s.motion else {}
        rows.append(row)
    return rows


def _motion_columns(
    s: Segment,
    checks: Mapping[int, tuple[float, Array]],
    t: Array,
    worst: Array,
    position: Position | None,
    threshold_deg: float,
) -> dict[str, Any]:
    rows = _inside(t, s.start, s.end)
    over = rows.start + np.flatnonzero(worst[rows] > threshold_deg)
    when, apart = checks.get(s.index, (None, np.full(3, np.nan)))
    wrong = [name for name, value in zip("xyz", apart, strict=True) if abs(value) > 3.0]
    after = float(t[over[0]] - s.start) if len(over) else math.nan
    return {
        "closing_velocity_m_s": position.closing.get(s.index) if position else None,
        "distance_m": position.distance.get(s.index) if position else None,
        **{f"separation_{axis}_sigma": _value(v) for axis, v in zip("xyz", apart, strict=True)},
        "separation_s": when,
        "stop_advised_after_s": after if _worth_a_stop(after, s) else None,
        "checks": f"separation {' '.join(wrong)}" if wrong else "ok",
    }


def _stop_columns(
    log: Log, s: Segment, samples: tuple[int, int], t: Array, position: Position | None, noise: Noise
) -> dict[str, Any]:
    lo, hi = samples
    row: dict[str, Any] = {"checks": "ok"}
    if hi - lo >= 3:
        mean = log.imu.gyro_b[lo:hi].mean(axis=0)
        sigma = noise.gyro_density / np.sqrt(max(s.used_end - s.used_start, 1e-3))
        row |= {f"gyro_mean_{a}_rad_s": float(m) for a, m in zip("xyz", mean, strict=True)}
        row |= {f"gyro_mean_sigma_{a}_rad_s": float(sigma) for a in "xyz"}
    if position is not None and hi > lo:
        middle = log.imu.t[(lo + hi) // 2]
        later = int(np.searchsorted(t, middle))
        k = min(max(later - 1, 0), min(later, len(t) - 1), key=lambda node: abs(t[node] - middle))
        row |= {f"position_{a}_m": _value(v) for a, v in zip("xyz", position.p[k], strict=True)}
        row["sigma_position_m"] = _value(np.sqrt(np.trace(position.P[k]))) if np.isfinite(position.P[k]).all() else None
    return row


def _most(values: Array) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.max()) if len(known) else None


def _value(number: float) -> float | None:
    return float(number) if np.isfinite(number) else None


def drive_sigma(P: Array, n_r: float, n_w: float, t: Array) -> Array:
    r"""Return the forward attitude sigma (m,), rad, a time ``t`` (m,) s after a stop left covariance ``P`` (6, 6).

    .. math:: \sigma^2(t)=\lambda_{max}(P_{\theta\theta}-(P_{\theta b}+P_{b\theta})t+P_{bb}t^2)+N_rt+N_wt^3/3
    """
    coupled = P[:3, 3:] + P[3:, :3]
    grown = P[:3, :3] - coupled * t[:, None, None] + P[3:, 3:] * t[:, None, None] ** 2
    return np.sqrt(np.linalg.eigvalsh(grown)[:, -1] + n_r * t + n_w * t**3 / 3)


def longest_drive(
    t: Array, forward: Pass, segmentation: Segmentation, noise: Noise, threshold: float, datum: Array | None = None
) -> float | None:  # fmt: skip
    """Return the longest drive, s, whose smoothed middle stays below ``threshold``, rad, between stops as good as
    this log's. ``datum`` (n,): variance of heading, rad^2, that is one draw for all of the log.

    Half-way both passes are equally sure, so the smoothed variance is half the forward one at half the time.
    """
    ends = [int(np.searchsorted(t, s.used_end)) for s in segmentation.stops]
    if not ends:
        return None
    rows = np.minimum(ends, len(t) - 1)
    P = forward.P[rows].copy()
    if datum is not None:
        up = rotation.matrix(forward.q[rows])[:, 2]
        known = np.einsum("ki,kij,kj->k", up, P[:, :3, :3], up)
        P[:, :3, :3] -= np.minimum(datum[rows], known)[:, None, None] * up[:, :, None] * up[:, None, :]
    P = np.median(P, axis=0)
    lengths = np.geomspace(1.0, LONGEST_S, 400)
    below = drive_sigma(P, noise.n_r, noise.n_w, 0.5 * lengths) / np.sqrt(2.0) < threshold
    return float(lengths[np.flatnonzero(below)[-1]]) if below.any() else 0.0


def stop_advice(
    t: Array, moving: Bools, passes: Mapping[str, Pass], segmentation: Segmentation, noise: Noise, threshold_deg: float,
    datum: Array | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Return where the rover should have stopped (the paper's flow chart): which axis, which motions, how long a
    drive may be. What is one draw for all of the log, ``datum`` (n,) of the forward pass, rad^2, no stop mends.
    """
    sigma = np.degrees(_without(passes["forward"].sigma_n, datum))
    smoothed = np.degrees(_without(passes["smoothed"].sigma_n, None if datum is None else datum[-1:]))
    over = moving & (sigma.max(axis=1) > threshold_deg)
    heading = bool(np.any(over & (sigma[:, 2] >= sigma[:, :2].max(axis=1))))
    longest = longest_drive(t, passes["forward"], segmentation, noise, np.radians(threshold_deg), datum)
    lines = []
    for stop, motion in pairwise(segmentation.segments):
        if stop.motion or not motion.motion:
            continue  # where no stop stands before, none can be advised
        driven, stood = _inside(t, motion.start, motion.end), _inside(t, stop.used_start, stop.used_end)
        late = t[driven][over[driven]] - motion.start
        if not len(late) or not _worth_a_stop(float(late[0]), motion):
            continue
        if stood.start < stood.stop and sigma[stood.stop - 1].max() < threshold_deg:
            lines.append(f"segment {motion.index}: stop {_clock(late[0])} after it began")
    return {
        "threshold_deg": threshold_deg,
        "axis": "heading" if heading or not over.any() else "tilt",
        "lines": lines,
        "share_over": float(_share(t, over) / max(_share(t, moving), 1e-9)),
        "longest_s": longest,
        "smoothed_below": bool(np.all(smoothed <= threshold_deg)),
    }


def _without(sigma_n: Array, datum: Array | None) -> Array:
    """Return sigmas (n, 3) whose last, of heading, is without that of its datum."""
    if datum is None:
        return sigma_n
    return np.column_stack([sigma_n[:, :2], np.sqrt(np.maximum(sigma_n[:, 2] ** 2 - datum, 0.0))])


def _worth_a_stop(after: float, motion: Segment) -> bool:
    """Whether a stop ``after`` s of a motion is neither just after the last nor just before the next."""
    return SOON_S < after < motion.end - motion.start - SOON_S


def _share(t: Array, where: Bools) -> float:
    return float(np.sum(np.diff(t) * (where[1:] & where[:-1]))) if len(t) > 1 else 0.0


def _clock(seconds: float) -> str:
    whole = round(seconds)
    return f"{whole // 60}:{whole % 60:02d}"
