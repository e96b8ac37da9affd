"""Where the filter starts: level by gravity, carry the attitude along the gyro, turn to the first heading the log
gives.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..errors import AttestError
from ..maths import rotation
from ..maths.kalman import symmetric
from ..nodes import Nodes
from ..records import Array
from ..sensors import Direction, Measurement
from ..sensors.heading import BodyHeading, FieldHeading
from ..sensors.orientation import Orientation

PRIOR_FACTOR = 10.0  # prior sigma over the alignment's own: its measurements are used again by the filter
WINDOW_FACTOR = 2.0  # without a stop: its windows are vague, and a wide-open tilt lets headings claim to know it
LEAST_PRIOR = np.radians(2.0)
MOST_PRIOR = np.radians(60.0)
BIAS_DRIFT = 5e-4  # rad/s: how fast the start is lost where no stop knows the bias
LEAST_BIAS_PRIOR = 1e-4  # rad/s
SHORT_STOP_S = 3.0  # the stop that knows the bias lasts at least about this
STANDING_S = 3.0  # a log that stands within its first seconds starts at a stop
DATUM = 1e-4  # rad: heading that is zero by definition
HEADING_SPAN_S = 20.0  # headings this long after the first one are averaged


@dataclass(frozen=True, slots=True)
class Start:
    """Estimate before the first measurement: ``q`` (4,), ``bias`` (3,), ``P`` (6, 6) in body axes; kind of heading."""

    q: Array
    bias: Array
    P: Array
    heading: str
    in_motion: bool


def align(nodes: Nodes, bias_sigma: float, magnetic: bool) -> Start:
    """Find the start attitude from the log's own measurements.

    Parameters
    ----------
    nodes : with at least one gravity or orientation measurement
    bias_sigma : prior of the gyro bias, rad/s
    magnetic : a magnetometer's heading counts from magnetic north (its reference is not known)

    Notes
    -----
    The prior is ten times wider than the alignment (at least 2 deg), so that measurements used for both count once.
    """
    flat = [m for group in nodes.measurements for m in group]
    whole = [m for m in flat if isinstance(m.sensor, Orientation)]
    level = [m for m in flat if m.role == "gravity"]
    if not whole and not level:
        raise AttestError("no measurement gives the attitude at the start", "the log needs a stop or an orientation")
    dead = rotation.chain(nodes.increments.dq, np.array([1.0, 0.0, 0.0, 0.0]))
    dead = np.concatenate([[[1.0, 0.0, 0.0, 0.0]], dead])  # node 0 -> node k
    from_orientation = bool(whole) and (not level or whole[0].t <= level[0].t)
    if from_orientation:
        first = whole[0]
        q0 = rotation.multiply(first.values[0], rotation.conjugate(dead[first.node]))
        heading, sigma, age = "absolute", float(np.sqrt(first.noise[0, 0])), first.t - nodes.t[0]
    else:
        anchor = level[0]
        up_b = anchor.values[0] if anchor.turn is None else anchor.turn[0] @ anchor.values[0]
        q0 = rotation.multiply(_level(up_b), rotation.conjugate(dead[anchor.node]))
        turn, heading, sigma, when = _heading_offset(flat, dead, q0, magnetic)
        q0 = rotation.multiply(rotation.exp_quaternion(np.array([0.0, 0.0, turn])), q0)
        age = max(anchor.t, when) - nodes.t[0]
    in_motion = bool(nodes.moving[nodes.t <= nodes.t[0] + STANDING_S].all())
    tilt0 = sigma if from_orientation else float(np.sqrt(level[0].noise[0, 0]))
    bias_prior, carried = _carried(nodes, age, bias_sigma) if in_motion else (bias_sigma, 0.0)
    factor = WINDOW_FACTOR if nodes.moving.all() else PRIOR_FACTOR
    prior = [float(np.clip(factor * np.hypot(s, carried), LEAST_PRIOR, MOST_PRIOR)) for s in (tilt0, sigma)]
    yaw = DATUM if heading == "relative" else prior[1]
    P = np.zeros((6, 6))
    R = rotation.matrix(q0)
    P[:3, :3] = symmetric(R.T @ np.diag([prior[0] ** 2, prior[0] ** 2, yaw**2]) @ R)
    P[3:, 3:] = bias_prior**2 * np.eye(3)
    bias = nodes.increments.bias_ref[0] if len(nodes.increments.bias_ref) else np.zeros(3)
    return Start(q0, bias, P, heading, in_motion)


def _carried(nodes: Nodes, age: float, bias_sigma: float) -> tuple[float, float]:
    """Return the prior of the bias and what the attitude lost on the way back over ``age`` s from the first stop.

    A wide bias prior would open the attitude to tens of degrees before the first stop, where linearised heading updates
    claim to know the tilt.
    """
    if nodes.moving.all():
        return bias_sigma, BIAS_DRIFT * age
    noise = nodes.noise
    known = noise.gyro_density / np.sqrt(SHORT_STOP_S) + noise.gyro_walk * np.sqrt(age)
    white = float(np.sqrt(nodes.density[nodes.t[1:] <= nodes.t[0] + age].mean() * age)) if age > 0.0 else 0.0
    return min(bias_sigma, max(PRIOR_FACTOR * known, LEAST_BIAS_PRIOR)), float(np.hypot(known * age, white))


def _level(up_b: Array) -> Array:
    """Return the attitude of smallest turn that takes ``up_b`` to the vertical."""
    axis = np.cross(up_b, [0.0, 0.0, 1.0])
    sine, cosine = float(np.linalg.norm(axis)), float(up_b[2])
    if sine < 1e-9:
        return np.array([1.0, 0.0, 0.0, 0.0]) if cosine > 0 else np.array([0.0, 1.0, 0.0, 0.0])
    return rotation.exp_quaternion(axis / sine * np.arctan2(sine, cosine))


def _heading_offset(
    measurements: Iterable[Measurement], dead: Array, q0: Array, magnetic: bool
) -> tuple[float, str, float, float]:
    """Return the turn about the vertical, the kind of heading, its sigma and the time it is from.

    The first sensor in order of trust (orientation, sun, compass, magnetometer) decides; its readings of 20 s are
    averaged.
    """
    found: dict[str, list[tuple[float, float, float]]] = {}
    for m in measurements:
        R = rotation.matrix(rotation.multiply(q0, dead[m.node]))
        offset = _offset(m, R)
        if offset is not None:
            found.setdefault(m.role, []).append((m.t, offset, float(np.sqrt(m.noise[0, 0]))))
    for role in ("orientation", "sun", "compass", "magnetometer"):
        if role in found:
            rows = [r for r in found[role] if r[0] <= found[role][0][0] + HEADING_SPAN_S]
            angle = np.array([r[1] for r in rows])
            mean = float(np.arctan2(np.sin(angle).mean(), np.cos(angle).mean()))
            sigma = rows[0][2] / (1.0 if role == "magnetometer" else np.sqrt(len(rows)))
            return mean, "magnetic" if magnetic and role == "magnetometer" else "absolute", sigma, rows[-1][0]
    return 0.0, "relative", DATUM, 0.0


def _offset(m: Measurement, R: Array) -> float | None:
    """Return the turn about the vertical that this measurement asks of the level attitude ``R``; None if it says
    nothing.
    """
    if m.role == "gravity":
        return None
    if isinstance(m.sensor, Direction):
        v = m.values[0]
        if len(v) == 2:
            v = np.array([v[0], v[1], np.sqrt(max(0.0, 1.0 - v[0] ** 2 - v[1] ** 2))])
        seen = R @ m.sensor.R_sb.T @ v
        wanted = m.sensor.reference_n
        return float(np.arctan2(wanted[1], wanted[0]) - np.arctan2(seen[1], seen[0]))
    if isinstance(m.sensor, BodyHeading | FieldHeading):
        r, _ = m.sensor.linearise(R[None], np.zeros(3), m.values[:1])
        return float(r[0, 0])
    if isinstance(m.sensor, Orientation):
        Z = rotation.matrix(m.values[0]) @ R.T
        return float(np.arctan2(Z[1, 0] - Z[0, 1], Z[0, 0] + Z[1, 1]))
    return None
