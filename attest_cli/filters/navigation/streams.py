"""Velocity over ground and height, sampled for the nodes: slow sensors have nodes of their own, fast ones do not."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...nodes import Nodes
from ...records import Array, Bools, Fixes, Imu, Ints
from .. import Drive
from .aids import Height, Velocity
from .states import State

FASTEST_HZ = 5.0  # a slower sensor's stamps are nodes; a faster one is interpolated to the nodes there are
LONGEST_HOLE_S = 1.0  # but not across a hole of this
TURN_S, SPEEDING_S = 0.1, 1.0  # rate and acceleration at a stamp are means over this
VELOCITY_SIGMA = 0.1  # m/s, where nothing is stated
LEAST_SPAN_S = 1e-3
LEAST_SIGMA = 1e-3  # m/s: no receiver is better, whatever it states
DATUM_M, DRIFT_M, DRIFT_S = 100.0, 1.0, 600.0  # where a height counts from; weather


def own_nodes(fixes: Fixes) -> bool:
    """Return whether the stamps of a sensor are nodes."""
    return len(fixes.t) < 2 or float(np.median(np.diff(fixes.t))) >= 1.0 / FASTEST_HZ


def clock_of(role: str, fixes: Mapping[str, Fixes]) -> str:
    """Return the role whose stamps are as late: velocities come from the receiver of the fixes, if there are any."""
    return "gps" if role == "gps_velocity" and "gps" in fixes else role


def velocity_of(drive: Drive, nodes: Nodes, bias: Array, arm: Array) -> Velocity:
    """Return the velocities of the receiver. ``bias`` (n, 3) of the gyro at the nodes, ``arm`` (3,) of the antenna."""
    fixes, imu, stated = drive.log.fixes["gps_velocity"], drive.log.imu, drive.settings.gps.velocity_sigma_m_s
    sigma = np.full(fixes.values.shape, stated or VELOCITY_SIGMA)
    if fixes.sigma is not None and stated is None:
        sigma = np.maximum(np.where(np.isfinite(fixes.sigma), fixes.sigma, VELOCITY_SIGMA), LEAST_SIGMA)
    node, at, share = _placed(fixes, nodes)
    values, sigma = (_between(table, at, share) for table in (fixes.values, sigma))
    t = nodes.t[node]
    ends = (np.searchsorted(nodes.t, t + s).clip(0, len(nodes.t) - 1) for s in (-0.5 * SPEEDING_S, 0.5 * SPEEDING_S))
    around = np.stack(list(ends), axis=1)
    span = np.maximum(nodes.t[around[:, 1]] - nodes.t[around[:, 0]], LEAST_SPAN_S)
    return Velocity(
        node, t, values, sigma * _thinned(fixes, nodes), _rate(imu, t) - bias[node], arm, around, span,
        clock_of("gps_velocity", drive.log.fixes),
    )  # fmt: skip


def height_of(drive: Drive, nodes: Nodes) -> tuple[Height, list[State]]:
    """Return the heights, counted from the first, and the states that take up where they count from and weather."""
    fixes = drive.log.fixes["height"]
    node, at, share = _placed(fixes, nodes)
    values = _between(fixes.values - fixes.values[0], at, share)
    sigma = np.full(values.shape, drive.settings.height.sigma_m * _thinned(fixes, nodes))
    return Height(node, nodes.t[node], values, sigma), [
        State("height datum", 1, DATUM_M), State("height drift", 1, DRIFT_M, DRIFT_S),
    ]  # fmt: skip


def _placed(fixes: Fixes, nodes: Nodes) -> tuple[Ints, Ints, Array]:
    """Return the nodes (k,) of a sensor, and for each the sample before it and the share of the next one."""
    if own_nodes(fixes):
        at = np.flatnonzero((fixes.t >= nodes.t[0]) & (fixes.t <= nodes.t[-1]))
        node = np.clip(np.searchsorted(nodes.t, fixes.t[at]), 1, len(nodes.t) - 1)
        node = np.where(fixes.t[at] - nodes.t[node - 1] < nodes.t[node] - fixes.t[at], node - 1, node)
        return node, at, np.zeros(len(at))
    at = np.clip(np.searchsorted(fixes.t, nodes.t, side="right") - 1, 0, len(fixes.t) - 2)
    span = fixes.t[at + 1] - fixes.t[at]
    inside: Bools = (nodes.t >= fixes.t[0]) & (nodes.t <= fixes.t[-1]) & (span < LONGEST_HOLE_S) & (span > 0.0)
    node = np.flatnonzero(inside)
    return node, at[node], (nodes.t[node] - fixes.t[at[node]]) / span[node]


def _between(values: Array, at: Ints, share: Array) -> Array:
    """Return values (k, d) between samples ``at`` and the next; those of a sample of its own where the share is 0."""
    after = np.minimum(at + 1, len(values) - 1)
    between = values[at] + share[:, None] * (values[after] - values[at])
    return np.where(share[:, None] > 0.0, between, values[at])


def _thinned(fixes: Fixes, nodes: Nodes) -> float:
    r"""Return the factor on sigma, :math:`\sqrt{T_s/T_n}`, of a sensor that several nodes read the same samples of."""
    if own_nodes(fixes):
        return 1.0
    return float(np.sqrt(max(1.0, np.median(np.diff(fixes.t)) / max(float(np.median(np.diff(nodes.t))), 1e-3))))


def _rate(imu: Imu, t: Array) -> Array:
    """Return the mean (k, 3) of the gyro over ``TURN_S`` about each time."""
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(imu.gyro_b, axis=0)])
    lo = np.searchsorted(imu.t, t - 0.5 * TURN_S, side="left").clip(0, len(imu.t) - 1)
    hi = np.maximum(np.searchsorted(imu.t, t + 0.5 * TURN_S, side="right"), lo + 1)
    return np.asarray((total[hi] - total[lo]) / (hi - lo)[:, None])
