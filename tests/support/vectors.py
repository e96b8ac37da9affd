"""The reference vectors of Roumeliotis et al. 1999 (``tests/vectors/roumeliotis``), as the core's own records.

Their quaternions are stored (x, y, z, w); the same four numbers are the Hamilton quaternion body to navigation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from attest_cli.filters import indirect
from attest_cli.filters.alignment import Start
from attest_cli.maths import rotation
from attest_cli.maths.propagation import Increments, Samples, preintegrate, transition
from attest_cli.nodes import Nodes
from attest_cli.nodes.noise import Noise
from attest_cli.records import FilterRun
from attest_cli.sensors import Direction, Measurement
from attest_cli.sensors.zero_rate import ZeroRate

Array = NDArray[np.float64]
Vectors = Mapping[str, NDArray[Any]]
FOLDER = Path(__file__).resolve().parents[1] / "vectors" / "roumeliotis"
FROZEN = 1e-14  # rad^2/s: attitude noise of a frozen stop in v7


def load(name: str) -> dict[str, NDArray[Any]]:
    """One file of vectors."""
    with np.load(FOLDER / f"{name}.npz") as file:
        return dict(file)


def wxyz(q: Array) -> Array:
    """Scalar first."""
    return q[..., [3, 0, 1, 2]]


@dataclass(frozen=True)
class Vector6:
    """The log of v6: nodes at every sample, sun and gravity at every second of the stops; ``frozen`` as in v7."""

    data: Vectors
    nodes: Nodes
    start: Start


def vector6(frozen: bool = False) -> Vector6:
    """Wire v6, with the attitude frozen at stops and zero rate (v7, iekfF) or without either."""
    v = load("v6_run")
    t, n = v["t"], len(v["t"])
    still = np.zeros(n - 1, dtype=np.bool_)
    moving = np.ones(n, dtype=np.bool_)
    for first, last in v["stops"]:
        moving[first:last] = False
        still[first : last - 1] = frozen
    at = np.flatnonzero(v["meas_index"] >= 0)
    samples = Samples(t, v["gyro"], t, np.arange(n), still)
    noise = Noise(float(np.sqrt(v["Nr"])), float(np.sqrt(v["Nw"])), 1.0, {})
    none = np.zeros(n - 1, dtype=np.bool_)
    groups = tuple(_group(v, int(k), frozen) for k in at)
    nodes = Nodes(
        t=t, moving=moving, frozen=still, gap=none, samples=samples, measured=at,
        increments=_increments(samples, np.zeros((n - 1, 3)), still, v), measurements=groups,
        density=np.full(n - 1, noise.n_r), noise=noise,
    )  # fmt: skip
    return Vector6(v, nodes, Start(wxyz(v["q0"]), v["b0"], v["P0"], "absolute", False))


def _group(v: Vectors, node: int, frozen: bool) -> tuple[Measurement, ...]:
    j, t = int(v["meas_index"][node]), float(v["t"][node])
    sun = Direction(v["pI"], v["T_SB"], "plane")
    up = Direction(v["gI"], np.eye(3), "full")
    group = [
        Measurement("sun", sun, node, t, v["sun"][j][None], float(v["sig_sun"]) ** 2 * np.eye(2)),
        Measurement("gravity", up, node, t, v["grav"][j][None], float(v["sig_grav"]) ** 2 * np.eye(3)),
    ]
    if frozen:
        z = v["zaru"][j]
        group.append(Measurement("zero_rate", ZeroRate(), node, t, z[None, :3], z[3] ** 2 * np.eye(3)))
    return tuple(group)


def _increments(samples: Samples, bias: Array, still: NDArray[np.bool_], v: Vectors) -> Increments:
    """Preintegrate; ``Phi`` and ``Q`` of a step are those of its mean rate, as the vectors have them."""
    rate, dt = 0.5 * (samples.rate[1:] + samples.rate[:-1]) - bias, np.diff(samples.t)
    Phi, Q = transition(rate, dt, float(v["Nr"]), float(v["Nw"]))
    inc = preintegrate(samples, bias, float(v["Nr"]), float(v["Nw"]))
    inc = replace(inc, Phi=Phi, Q=Q, psi=-Phi[:, :3, 3:])
    span = inc.span[still, None, None] * np.eye(3)
    inc.dq[still], inc.psi[still], inc.Phi[still], inc.Q[still] = [1.0, 0.0, 0.0, 0.0], 0.0, np.eye(6), 0.0
    inc.Q[still, :3, :3], inc.Q[still, 3:, 3:] = FROZEN * span, float(v["Nw"]) * span
    return inc


def run_exact(case: Vector6, passes: int = 3) -> FilterRun:
    """Run the filter with the IMU preintegrated at its own bias estimate, as a per-sample filter does."""
    nodes = case.nodes
    run = indirect.run(nodes, case.start, gate_probability=1.0)
    for _ in range(passes):
        increments = _increments(nodes.samples, run.bias[:-1].copy(), nodes.frozen, case.data)
        run = indirect.run(replace(nodes, increments=increments), case.start, gate_probability=1.0)
    return run


def apart(q: Array, bias: Array, P: Array, q_ref: Array, bias_ref: Array, P_ref: Array) -> tuple[float, float, float]:
    """Return the largest differences in attitude and bias, in sigma, and of covariance elements over their sigmas."""
    sigma = np.sqrt(np.einsum("kii->ki", P_ref))
    turn = rotation.log_quaternion(rotation.multiply(rotation.conjugate(wxyz(q_ref)), q))
    scale = sigma[:, :, None] * sigma[:, None, :]
    return (
        float(np.abs(turn / sigma[:, :3]).max()),
        float(np.abs((bias - bias_ref) / sigma[:, 3:]).max()),
        float(np.abs((P - P_ref) / scale).max()),
    )
