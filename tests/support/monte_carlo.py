"""Many short runs whose errors are exactly those the filter assumes: rates held over a step, white noise, two sights.

The motion is the same in all runs; start, biases, gyro noise and measurements are drawn anew. What remains between
theory and result is the filter's own algebra, so chi-square bands hold at every node.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from attest_cli.filters.alignment import Start
from attest_cli.maths import rotation
from attest_cli.maths.propagation import Samples, preintegrate
from attest_cli.nodes import Nodes
from attest_cli.nodes.noise import Noise
from attest_cli.sensors import Direction, Measurement
from attest_cli.sensors.direction import tangent_basis

Array = NDArray[np.float64]
SPAN_S, STEP_S, NODE_STEPS, FIX_NODES = 8.0, 0.2, 2, 2  # steps to a node, nodes to a pair of measurements
GYRO, WALK = 1e-2, 1e-2  # rad/s/sqrt(Hz), rad/s^2/sqrt(Hz): as much between two fixes as a fix is noisy
START_RAD, BIAS_RAD_S, SIGHT_RAD = 0.02, 0.02, 0.01
SUN_N = np.array([0.6, -0.48, 0.64])
UP_N = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Case:
    """One run: what a filter gets, and the truth at its nodes."""

    nodes: Nodes
    start: Start
    q: Array
    bias: Array


def draw(rng: np.random.Generator, Q: float = 1.0, R: float = 1.0) -> Case:
    """Draw a run; the filter is told ``Q`` and ``R`` times the true variances of gyro and measurements."""
    gyro, walk, sight = np.sqrt(Q) * GYRO, np.sqrt(Q) * WALK, np.sqrt(R) * SIGHT_RAD
    n = round(SPAN_S / STEP_S)
    t = STEP_S * np.arange(n + 1)
    rate = np.stack([0.2 * np.sin(0.9 * t), 0.15 * np.cos(0.6 * t), 0.1 + 0.2 * np.sin(0.4 * t)], axis=1)[:-1]
    bias = np.cumsum(rng.normal(0.0, WALK * np.sqrt(STEP_S), (n + 1, 3)), axis=0) + rng.normal(0.0, BIAS_RAD_S, 3)
    q0 = rotation.exp_quaternion(np.array([0.1, -0.2, 0.7]))
    truth = np.concatenate([q0[None], rotation.chain(rotation.exp_quaternion(rate * STEP_S), q0)])
    between = 0.5 * (bias[1:] + bias[:-1])
    gyro_b = rate + between + rng.normal(0.0, GYRO / np.sqrt(STEP_S), (n, 3))
    first = np.arange(0, n + 1, NODE_STEPS)
    m = len(first) - 1
    at = np.arange(FIX_NODES, m + 1, FIX_NODES)
    groups = tuple(_pair(rng, rotation.matrix(truth[first[k]]), int(k), float(t[first[k]]), sight) for k in at)
    none = np.zeros(m, dtype=np.bool_)
    samples = Samples(t, np.concatenate([gyro_b[:1], gyro_b]), t[first], first, none, linear=False)
    nodes = Nodes(
        t=t[first], moving=np.ones(m + 1, dtype=np.bool_), frozen=none, gap=none, samples=samples,
        increments=preintegrate(samples, np.zeros((m, 3)), gyro**2, walk**2), measured=at, measurements=groups,
        density=np.full(m, gyro**2), noise=Noise(gyro, walk, 1.0, {}),
    )  # fmt: skip
    error = rng.normal(0.0, START_RAD, 3)
    start = rotation.multiply(q0, rotation.conjugate(rotation.exp_quaternion(error)))
    P0 = np.diag([START_RAD**2] * 3 + [BIAS_RAD_S**2] * 3)
    return Case(nodes, Start(start, np.zeros(3), P0, "absolute", False), truth[first], bias[first])


def _pair(rng: np.random.Generator, R_nb: Array, node: int, t: float, told: float) -> tuple[Measurement, ...]:
    """Sun and gravity seen with white noise across them."""
    group = []
    for role, p in (("sun", SUN_N), ("gravity", UP_N)):
        seen = R_nb.T @ p
        z = seen + rng.normal(0.0, SIGHT_RAD, 2) @ tangent_basis(seen[None])[0]
        group.append(Measurement(role, Direction(p), node, t, z[None], told**2 * np.eye(2)))
    return tuple(group)


def band(dof: int, outside: float = 1e-4) -> tuple[float, float]:
    """Interval of a chi-square variable of ``dof`` degrees over ``dof``, but for a share ``outside``."""
    return float(chdtri(dof, 1.0 - outside / 2)) / dof, float(chdtri(dof, outside / 2)) / dof
