"""Back to full rate: attitude, bias and sigma at every IMU sample from the smoothed nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .maths import rotation
from .maths.propagation import run_steps
from .nodes import Nodes
from .records import Array, Smoothed


@dataclass(frozen=True, slots=True)
class Attitude:
    """Per IMU sample: ``q`` (n, 4) continuous in sign, ``bias`` (n, 3) rad/s, variances about world axes (n, 3) rad^2
    and of the bias (n, 3).
    """

    q: Array
    bias: Array
    variance_n: Array
    bias_variance: Array


def world_variance(q: Array, P: Array) -> Array:
    """Return the attitude covariance (n, 3, 3) about world axes, rad^2: ``R P_theta R'``."""
    R = rotation.matrix(q)
    return np.asarray(R @ P[:, :3, :3] @ R.swapaxes(1, 2))


def full_rate(nodes: Nodes, smoothed: Smoothed, t: Array) -> Attitude:
    """Propagate every interval from its smoothed node with the smoothed bias and spread the defect at its far end
    evenly.

    Parameters
    ----------
    t : (n,) times of the IMU samples, s

    Notes
    -----
    The defect is what the smoother gave to gyro noise; a bridge of constant rate is its most likely course. Sigmas are
    interpolated linearly in variance: between nodes 0.1 s apart they are smooth.
    """
    q, variance = np.empty((len(t), 4)), world_variance(smoothed.q, smoothed.P)
    q[0] = smoothed.q[0]
    if len(t) > 1:
        bias = 0.5 * (smoothed.bias[1:] + smoothed.bias[:-1])
        held = nodes.frozen | nodes.gap
        bias[held] = 0.0  # steps of held intervals carry no rate
        run = run_steps(nodes.steps, smoothed.q[:-1], bias)
        ends = run[nodes.steps.first[1:] - 1]
        defect_b = rotation.log_quaternion(rotation.multiply(rotation.conjugate(ends), smoothed.q[1:]))
        defect_n = np.einsum("kij,kj->ki", rotation.matrix(ends), defect_b)
        owner = np.repeat(np.arange(len(ends)), nodes.steps.count)[nodes.sample_step]
        share = np.clip((t[1:] - nodes.t[owner]) / np.diff(nodes.t)[owner], 0.0, 1.0)
        bridge = rotation.exp_quaternion(defect_n[owner] * share[:, None])
        q[1:] = rotation.multiply(bridge, run[nodes.sample_step])
    q = rotation.continuous(rotation.normalise(q))
    return Attitude(
        q,
        _interpolate(t, smoothed.t, smoothed.bias),
        _interpolate(t, smoothed.t, np.einsum("kii->ki", variance)),
        _interpolate(t, smoothed.t, np.einsum("kii->ki", smoothed.P)[:, 3:]),
    )


def _interpolate(t: Array, nodes_t: Array, values: Array) -> Array:
    return np.stack([np.interp(t, nodes_t, values[:, i]) for i in range(values.shape[1])], axis=1)
