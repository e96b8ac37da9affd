"""Where wheels and accelerometer contradict each other for a while: wheels that slip, or a counter that hangs."""

from __future__ import annotations

import numpy as np

from ..maths import rotation
from ..records import Array, Fixes, Imu, Segmentation

STEP_S, STEPS = 0.2, 15  # attitude is taken once a step, speeds are compared over so many
SURE, LEAST_M_S = 8.0, 0.8  # of what is usual of the drive; m/s, beyond tilt, bias and shocks
HOLE_S = 1.0  # between measurements of the wheels: they say nothing there
LATE_S = 0.3  # by which stamps of the wheels may still be off
MAD = 1.4826


def slips(
    imu: Imu, q: Array, segmentation: Segmentation, odometry: Fixes, forward_b: Array, gravity: float
) -> tuple[Array, float]:
    r"""Return the spans (k, 2), s, in which the wheels are not believed, and by how much they were off at most, m/s.

    Along the forward axis :math:`u_b` of a vehicle that does not slide

    .. math:: e=s(t+T)-s(t)-\int u_b\cdot(f_b-R_{nb}^T g_n)\,dt

    is what tilt, bias, noise and stamps make of it; more than eight times what is usual of the drive is a slip. From
    the first to the last of a motion the wheels do not count.

    Parameters
    ----------
    q : (n, 4) attitude of the IMU at its samples
    gravity : m/s^2
    """
    starts, misses, most = [], [], 0.0
    for s in segmentation.motions:
        edges = np.arange(s.start, s.end, STEP_S)
        rows = np.searchsorted(imu.t, edges)
        if len(edges) <= STEPS or rows[-1] >= len(imu.t):
            continue
        summed = np.append(0.0, np.cumsum(imu.accel_b[rows[0] : rows[-1]] @ forward_b))
        felt = np.diff(summed[rows - rows[0]]) / np.maximum(np.diff(rows), 1)
        tilt = rotation.matrix(q[(rows[:-1] + rows[1:]) // 2])[:, 2] @ forward_b
        felt = (felt - gravity * tilt) * STEP_S
        change = np.diff(np.interp(edges, odometry.t, odometry.values[:, 0]))
        next_ = np.clip(np.searchsorted(odometry.t, edges[1:]), 1, len(odometry.t) - 1)
        known = (np.diff(rows) > 0) & (odometry.t[next_] - odometry.t[next_ - 1] < HOLE_S)
        each = np.where(known, change - felt, 0.0)
        missed, late = (np.lib.stride_tricks.sliding_window_view(x, STEPS) for x in (each, np.abs(felt)))
        off = np.abs(missed.sum(axis=1))
        starts.append(edges[:-STEPS])
        misses.append(np.maximum(off - LATE_S / STEP_S * late.max(axis=1), 0.0))
        most = max(most, float(off[np.argmax(misses[-1])]))
    if not misses:
        return np.zeros((0, 2)), 0.0
    every = np.concatenate(misses)
    least = max(LEAST_M_S, SURE * MAD * float(np.median(every)))
    wrong = [at[miss > least] for at, miss in zip(starts, misses, strict=True)]
    spans = [(at[0], at[-1] + STEPS * STEP_S) for at in wrong if len(at)]
    return np.array(spans).reshape(-1, 2), most
