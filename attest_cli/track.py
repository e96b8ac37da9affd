"""Back to full rate: the attitude at every IMU sample from the smoothed nodes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from .maths import rotation
from .maths.propagation import Samples, bridged
from .records import Array, Smoothed

BLOCK_ROWS = 1 << 17  # samples handled together


def world_variance(q: Array, P: Array) -> Array:
    """Return the attitude covariance (n, 3, 3) about world axes, rad^2: ``R P_theta R'``."""
    R = rotation.matrix(q)
    return np.asarray(R @ P[:, :3, :3] @ R.swapaxes(1, 2))


def full_rate(samples: Samples, smoothed: Smoothed) -> Array:
    """Return the attitude (n, 4) at the IMU samples: every interval propagated from its smoothed node with the smoothed
    bias, the defect at its far end spread evenly.

    Parameters
    ----------
    samples : the gyro between the nodes of ``smoothed``

    Notes
    -----
    The defect is what the smoother gave to gyro noise; a bridge of constant rate is its most likely course.
    """
    q = np.empty((len(samples.t), 4))
    q[-1] = smoothed.q[-1]
    bias = 0.5 * (smoothed.bias[1:] + smoothed.bias[:-1])
    bias[samples.held] = 0.0  # steps of held intervals carry no rate
    first = samples.first
    cuts = [*np.unique(np.searchsorted(first, np.arange(0, first[-1], BLOCK_ROWS))).tolist(), len(first) - 1]
    for lo, hi in pairwise(cuts):
        _bridge(q[first[lo] : first[hi]], samples, smoothed, bias, lo, hi)
    for a in range(0, len(q), BLOCK_ROWS):
        part = q[max(a - 1, 0) : a + BLOCK_ROWS]  # with the row before, whose sign is settled
        sign = rotation.signs(part)
        part[1:] *= (sign if a == 0 else sign * sign[0])[1:, None]
        part[0] *= sign[0] if a == 0 else 1.0
    return q


def _bridge(out: Array, samples: Samples, smoothed: Smoothed, bias: Array, lo: int, hi: int) -> None:
    """Fill in the attitude at the samples of the intervals ``lo .. hi``."""
    first = samples.first[lo : hi + 1] - samples.first[lo]
    q = smoothed.q[lo : hi + 1]
    for rows, run in bridged(samples, np.arange(lo, hi), q[:-1], q[1:], bias[lo:hi]):
        at = first[rows][:, None] + np.arange(len(run))
        inside = at < first[rows + 1][:, None]
        out[at[inside]] = run.swapaxes(0, 1)[inside]
