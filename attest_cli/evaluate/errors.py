"""Errors of attitude (BROAD's definitions) and of position (absolute and relative), and their statistics."""

from __future__ import annotations

import numpy as np

from ..maths import rotation
from ..maths.consistency import MAD
from ..records import Array, Bools, Ints
from .association import period
from .records import Stats

PATH_TOLERANCE = 0.1  # a piece of path counts where its length is that asked for to this share


def total(q_est: Array, q_ref: Array) -> Array:
    r"""Return the whole angle (n,) between attitudes (n, 4): :math:`2\arccos|e_w|`, ``e = q_est conj(q_ref)``.

    Source: Laidig et al., BROAD, Data 6(7):72, 2021. Written with atan2, which keeps small angles exact.
    """
    e = rotation.multiply(q_est, rotation.conjugate(q_ref))
    return np.asarray(2.0 * np.arctan2(np.linalg.norm(e[..., 1:], axis=-1), np.abs(e[..., 0])))


def attitude(q_est: Array, q_ref: Array) -> Array:
    r"""Return the error (n, 3) about world axes, rad: two of tilt and, third, heading.

    .. math:: e=q_{est}\,\bar q_{ref}=q_{tilt}\,q_{heading},\quad \text{heading}=2\operatorname{atan}(e_z/e_w),\
        \text{inclination}=2\arccos\sqrt{e_w^2+e_z^2}

    The tilt's rotation vector has no component about the vertical, so its norm is the inclination error. To first
    order the three are the rotation vector of ``e``, whose covariance a track claims. Definitions: BROAD.
    """
    e = rotation.multiply(q_est, rotation.conjugate(q_ref))
    e = np.where(e[..., :1] < 0.0, -e, e)
    heading = 2.0 * np.arctan2(e[..., 3], e[..., 0])
    turn = np.zeros_like(e)
    level = np.hypot(e[..., 0], e[..., 3])
    upright = level > 0.0  # upside down there is no heading
    turn[..., 0] = np.where(upright, e[..., 0] / np.where(upright, level, 1.0), 1.0)
    turn[..., 3] = np.where(upright, e[..., 3] / np.where(upright, level, 1.0), 0.0)
    tilt = rotation.log_quaternion(rotation.multiply(e, rotation.conjugate(turn)))
    return np.stack([tilt[..., 0], tilt[..., 1], rotation.wrap(heading)], axis=-1)


def inclination(error: Array) -> Array:
    """Return the inclination error (n,) of ``attitude``'s errors (n, 3), rad."""
    return np.asarray(np.hypot(error[..., 0], error[..., 1]))


def circular_mean(angle: Array, weight: Array | None = None) -> float:
    """Return the mean direction of angles (n,), rad."""
    w = np.ones_like(angle) if weight is None else weight
    return float(np.arctan2(np.sum(w * np.sin(angle)), np.sum(w * np.cos(angle))))


def statistics(values: Array) -> Stats:
    """Return rms, median, 95 % quantile and maximum of the absolute values."""
    size = np.abs(values)
    if size.size == 0:
        return Stats(*(float("nan"),) * 4, 0)
    return Stats(
        float(np.sqrt(np.mean(size**2))), float(np.median(size)), float(np.quantile(size, 0.95)), float(size.max()),
        int(size.size),
    )  # fmt: skip


def pairs_by_time(t: Array, span: float) -> tuple[Ints, Ints]:
    """Return starts and ends of all pairs ``span`` s apart, to half a step at most; from every sample that has one."""
    if t.size < 2:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    target = t + span
    after = np.clip(np.searchsorted(t, target), 1, t.size - 1)
    end = np.where(target - t[after - 1] < t[after] - target, after - 1, after)
    start = np.arange(t.size)
    good = (end > start) & (np.abs(t[end] - target) <= 0.5 * period(t) * (1.0 + 1e-6))
    return start[good], end[good]


def pairs_by_path(p_ref: Array, span: float) -> tuple[Ints, Ints]:
    """Return starts and ends of all pieces of the reference's path ``span`` m long, to ``PATH_TOLERANCE``.

    From every sample the end nearest to ``span`` along the path (n, 3), the first of equals: evo's ``all_pairs`` in
    metres.
    """
    path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p_ref, axis=0), axis=1))])
    start = np.arange(path.size - 1)
    target = path[:-1] + span
    after = np.clip(np.searchsorted(path, target), start + 1, path.size - 1)
    before = np.clip(after - 1, start + 1, path.size - 1)
    before = np.maximum(np.searchsorted(path, path[before]), start + 1)  # standing still: the first of equals
    end = np.where(np.abs(path[before] - target) <= np.abs(path[after] - target), before, after)
    good = np.abs(path[end] - target) <= PATH_TOLERANCE * span
    return start[good], end[good]


def relative_position(
    start: Ints, end: Ints, p_est: Array, p_ref: Array, q_est: Array | None = None, q_ref: Array | None = None
) -> Array:
    r"""Return the error (m,) of the displacement from ``start`` to ``end``, m, as seen from the body at the start.

    .. math:: |R_{est,i}^\top(p_{est,j}-p_{est,i})-R_{ref,i}^\top(p_{ref,j}-p_{ref,i})|

    Without attitudes: of the displacement in the (aligned) world. Source: Sturm et al., IROS 2012, eqs 2-5; the
    translation part of evo's RPE.
    """
    moved_est, moved_ref = p_est[end] - p_est[start], p_ref[end] - p_ref[start]
    if q_est is not None and q_ref is not None:
        moved_est = rotation.rotate(rotation.conjugate(q_est[start]), moved_est)
        moved_ref = rotation.rotate(rotation.conjugate(q_ref[start]), moved_ref)
    return np.asarray(np.linalg.norm(moved_est - moved_ref, axis=1))


def scatter(error: Array, breaks: Bools) -> float:
    r"""Return the noise of a series of errors (n, 3) from sample to sample, per axis: its second difference over
    :math:`\sqrt6`, by the median absolute deviation. A smooth result's error scatters as its reference does.
    """
    if len(error) < 3:
        return float("nan")
    whole = ~(breaks[:-2] | breaks[1:-1])
    second = np.diff(error, n=2, axis=0)[whole]
    return float(MAD * np.median(np.abs(second)) / np.sqrt(6.0)) if second.size else float("nan")
