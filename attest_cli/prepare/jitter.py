"""Stamps that scatter about those of an even sensor: what the attitude does not know for it."""

from __future__ import annotations

import numpy as np

from ..records import Array, Bools
from .lost import SAMPLED, around, changes

SINGLE = 0.5  # of a period: steps so near to it lost nothing
LEAST = 0.01  # of a period: what scatters less turns next to nothing
SMOOTH, FOLLOWS = 0.7, 0.5  # times the change beside a step, where values are smooth; share that goes with its length
SURE = 2.0  # sigma of that share


def jittered(t: Array, gyro: Array) -> Array | None:
    r"""Return the noise density (n,), rad/s/sqrt(Hz), of samples whose stamps scatter by :math:`\sigma_\epsilon`.

    A stamp that is late by :math:`\epsilon_k` gives :math:`\epsilon_k(\omega_{k+1}-\omega_{k-1})/2` too much: where the
    sensor shakes, the angle walks at random. Steps scatter by :math:`\sqrt2\,\sigma_\epsilon`. None where stamps are
    even, or where the values (n, 3) change with the length of the step: then the samples themselves scatter.
    """
    step = np.diff(t)
    period = float(np.partition(step, step.size // 2)[step.size // 2])  # one that occurs: not between steps in pairs
    single = np.abs(step / period - 1.0) < SINGLE
    sigma = float(np.std(step[single])) / np.sqrt(2.0)
    if sigma < LEAST * period or _follows(step / period, single, gyro):
        return None
    square = np.zeros(len(t))
    for x in gyro.T:  # the axis that shakes most
        np.maximum(square[1:-1], (0.5 * (x[2:] - x[:-2])) ** 2, out=square[1:-1])
    return np.asarray(sigma * np.sqrt(around(t, t, square, np.ones(len(t))) / period))


def _follows(step: Array, single: Bools, gyro: Array) -> bool:
    """Tell whether smooth values change the more the longer the step, where steps scatter."""
    scatters = single[:-2] & single[1:-1] & single[2:] & (np.abs(step[1:-1] - 1.0) > LEAST)
    rows = np.flatnonzero(scatters)[:SAMPLED]
    if not rows.size:
        return False
    first = int(rows[0])
    times, weight, rows = changes(np.diff(gyro[first : rows[-1] + 4], axis=0), rows - first)
    total = float(weight.sum())
    if not total:
        return False
    length = step[first + rows + 1]
    usual, longer = float(times @ weight) / total, length - float(length @ weight) / total
    spread = float(np.sum(weight * longer**2))
    if usual < SMOOTH or spread == 0.0:
        return False
    slope = float(np.sum(weight * longer * times)) / spread
    wide = float(np.linalg.norm(weight * longer * (times - usual - slope * longer))) / spread
    return slope - SURE * wide > FOLLOWS * usual
