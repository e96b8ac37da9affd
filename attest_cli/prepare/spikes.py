"""Spikes: single samples far out of their neighbours, and of all that noise, vibration and shocks do around them."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..maths.consistency import MAD
from ..records import Array, Bools

WIDTH, AROUND = 5, 9  # samples of the median, and of what else happens there
FACTOR = 50.0  # of the robust sigma of what the median leaves
ALONE = 30.0  # times the neighbours: hammer blows on an IMU at rest ring, and reach 19
ACCEL_FLOOR = 20.0  # m/s^2: less can be a pothole
GYRO_FLOOR, GYRO_BURST = 1.0, 2.0  # rad/s, of a sample or two, of up to four: less can be a knock
SAMPLED = 20_000  # rows that tell the sigma


def spikes(values: Array, floor: float, width: int = WIDTH) -> Bools:
    r"""Tell the rows (n,) of which a column of ``values`` (n, k) is a spike.

    A spike is where :math:`|x - m| > \max(50\,\hat\sigma, \text{floor}, 30\,r)`: :math:`m` is the median of ``width``
    samples, :math:`\hat\sigma = 1.4826\,\mathrm{med}|x - m|`, and :math:`r` the distance to :math:`m` that all of the
    eight neighbours but one keep: a shock rings, a spike stands alone (or with one other). Where they are many, nine
    samples and all neighbours but three.
    """
    found = np.zeros(len(values), dtype=np.bool_)
    if len(values) < AROUND:
        return found
    for x in np.ascontiguousarray(values.T):
        if np.ptp(x) <= floor:
            continue
        around = sliding_window_view(np.pad(x, AROUND // 2, mode="reflect"), AROUND)
        inner = slice((AROUND - width) // 2, (AROUND + width) // 2)
        sample = slice(None, None, -(-x.size // SAMPLED))
        usual = MAD * np.median(np.abs(x[sample] - np.median(around[sample, inner], axis=1)))
        limit = max(floor, FACTOR * float(usual))

        jump = np.abs(np.diff(x)) > limit  # three of five are that far off, so a direct neighbour is: look only there
        near = np.append(jump, False) | np.insert(jump, 0, False)
        if width > WIDTH:  # or its neighbour
            near |= np.append(near[1:], False) | np.insert(near[:-1], 0, False)
        rows = np.flatnonzero(near)
        middle = np.median(around[rows, inner], axis=1)
        apart = np.abs(around[rows] - middle[:, None])
        beside = np.sort(np.delete(apart, AROUND // 2, axis=1), axis=1)
        found[rows[apart[:, AROUND // 2] > np.maximum(limit, ALONE * beside[:, -(width // 2)])]] = True
    return found
