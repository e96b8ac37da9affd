"""Back to full rate: the attitude at every IMU sample from the smoothed nodes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from .maths import rotation
from .maths.propagation import run_steps
from .nodes import Nodes
from .records import Array, Smoothed

BLOCK_STEPS = 1 << 17  # samples handled together


def world_variance(q: Array, P: Array) -> Array:
    """Return the attitude covariance (n, 3, 3) about world axes, rad^2: ``R P_theta R'``."""
    R = rotation.matrix(q)
    return np.asarray(R @ P[:, :3, :3] @ R.swapaxes(1, 2))


def full_rate(nodes: Nodes, smoothed: Smoothed, t: Array) -> Array:
    """Return the attitude (n, 4) at the IMU samples: every interval propagated from its smoothed node with the smoothed
    bias, the defect at its far end spread evenly.

    Parameters
    ----------
    t : (n,) times of the IMU samples, s

    Notes
    -----
    The defect is what the smoother gave to gyro noise; a bridge of constant rate is its most likely course.
    """
    q = np.empty((len(t), 4))
    q[0] = smoothed.q[0]
    bias = 0.5 * (smoothed.bias[1:] + smoothed.bias[:-1])
    bias[nodes.frozen | nodes.gap] = 0.0  # steps of held intervals carry no rate
    first = nodes.steps.first
    cuts = [*np.unique(np.searchsorted(first, np.arange(0, first[-1], BLOCK_STEPS))).tolist(), len(first) - 1]
    for lo, hi in pairwise(cuts):
        rows = slice(*np.searchsorted(nodes.sample_step, [first[lo], first[hi]]).tolist())
        q[1:][rows] = _bridged(nodes, smoothed, bias, t[1:][rows], rows, lo, hi)
    q *= rotation.signs(q)[:, None]  # in place: a long log has hundreds of megabytes of it
    return q


def _bridged(nodes: Nodes, smoothed: Smoothed, bias: Array, t: Array, rows: slice, lo: int, hi: int) -> Array:
    """Return the attitude at the samples ``rows`` (times ``t``) in the intervals ``lo .. hi``."""
    steps = nodes.steps.part(lo, hi)
    run = run_steps(steps, smoothed.q[lo:hi], bias[lo:hi])
    ends = run[steps.first[1:] - 1]
    defect_b = rotation.log_quaternion(rotation.multiply(rotation.conjugate(ends), smoothed.q[lo + 1 : hi + 1]))
    defect_n = rotation.rotate(ends, defect_b)
    at = nodes.sample_step[rows] - nodes.steps.first[lo]
    owner = np.repeat(np.arange(hi - lo), steps.count)[at]
    share = np.clip((t - nodes.t[lo + owner]) / np.diff(nodes.t)[lo + owner], 0.0, 1.0)
    return rotation.normalise(rotation.multiply(rotation.exp_quaternion(defect_n[owner] * share[:, None]), run[at]))
