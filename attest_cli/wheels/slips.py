"""Where wheels and accelerometer contradict each other for a while: wheels that slip, or a counter that hangs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..maths import rotation
from ..records import Array, Fixes, Imu, Ints, Segment, Segmentation
from .holes import longest_hole

STEP_S, STEPS = 0.2, 15  # attitude is taken once a step, speeds are compared over so many
SURE, LEAST_M_S = 8.0, 0.8  # of what is usual of the drive; m/s, beyond tilt, bias and shocks
USUAL, USUAL_SIGMA = 0.25, 0.3186  # quantile that most slips do not reach, and what it is of a normal error's sigma
LATE_S = 0.3  # by which stamps of the wheels may still be off
BACK = 0.5  # of the threshold: speeds that came so near to each other again agree


@dataclass(frozen=True, slots=True)
class Compared:
    """A motion in steps: ``edges`` (k + 1,) s, by how much more the wheels changed in ``each`` (k,), m/s, how far off
    (w,) the windows of ``STEPS`` steps are, and how far beyond what late stamps explain (w,).
    """

    edges: Array
    each: Array
    off: Array
    beyond: Array


def slips(
    imu: Imu, q: Array, segmentation: Segmentation, odometry: Fixes, forward_b: Array, gravity: float
) -> tuple[Array, float]:
    r"""Return the spans (k, 2), s, in which the wheels are not believed, and by how much they were off at most, m/s.

    Along the forward axis :math:`u_b` of a vehicle that does not slide

    .. math:: e=s(t+T)-s(t)-\int u_b\cdot(f_b-R_{nb}^T g_n)\,dt

    is what tilt, bias, noise and stamps make of it; more than eight times what is usual of the drive is a slip. It
    lasts until the speeds came together again, or to the last contradiction of the motion where they never do.

    Parameters
    ----------
    q : (n, 4) attitude of the IMU at its samples
    gravity : m/s^2
    """
    found = (_compared(imu, q, s, odometry, forward_b, gravity) for s in segmentation.motions)
    motions = [motion for motion in found if motion is not None]
    if not motions:
        return np.zeros((0, 2)), 0.0
    usual = float(np.quantile(np.concatenate([motion.beyond for motion in motions]), USUAL)) / USUAL_SIGMA
    least = max(LEAST_M_S, SURE * usual)
    spans = [span for motion in motions for span in _spans(motion, least)]
    most = max(float(motion.off[np.argmax(motion.beyond)]) for motion in motions)
    return np.array(spans).reshape(-1, 2), most


def _compared(imu: Imu, q: Array, s: Segment, odometry: Fixes, forward_b: Array, gravity: float) -> Compared | None:
    """Hold the wheels against the accelerometer over one motion; None where it is too short."""
    edges = np.arange(s.start, s.end, STEP_S)
    rows = np.searchsorted(imu.t, edges)
    if len(edges) <= STEPS or rows[-1] >= len(imu.t):
        return None
    summed = np.append(0.0, np.cumsum(imu.accel_b[rows[0] : rows[-1]] @ forward_b))
    felt = np.diff(summed[rows - rows[0]]) / np.maximum(np.diff(rows), 1)
    tilt = rotation.matrix(q[(rows[:-1] + rows[1:]) // 2])[:, 2] @ forward_b
    felt = (felt - gravity * tilt) * STEP_S
    change = np.diff(np.interp(edges, odometry.t, odometry.values[:, 0]))
    next_ = np.clip(np.searchsorted(odometry.t, edges[1:]), 1, len(odometry.t) - 1)
    heard = odometry.t[next_] - odometry.t[next_ - 1] < longest_hole(odometry.t)
    each = np.where((np.diff(rows) > 0) & heard, change - felt, 0.0)
    missed, late = (np.lib.stride_tricks.sliding_window_view(x, STEPS) for x in (each, np.abs(felt)))
    off = np.abs(missed.sum(axis=1))
    return Compared(edges, each, off, np.maximum(off - LATE_S / STEP_S * late.max(axis=1), 0.0))


def _spans(motion: Compared, least: float) -> list[tuple[float, float]]:
    """Return from when to when the wheels slip: windows that overlap are one contradiction, and after it they are as
    far off as it left them.
    """
    wrong: Ints = np.flatnonzero(motion.beyond > least)
    groups = [g for g in np.split(wrong, np.flatnonzero(np.diff(wrong) > STEPS) + 1) if len(g)]
    out: list[tuple[float, float]] = []
    apart, since = 0.0, 0.0
    for k, group in enumerate(groups):
        first, last = int(group[0]), int(group[-1]) + STEPS
        since = since if apart else float(motion.edges[first])
        apart += float(motion.each[first:last].sum())
        if abs(apart) < BACK * least or k == len(groups) - 1:
            out.append((since, float(motion.edges[last])))
            apart = 0.0
    return out
