"""The indirect (error-state) Kalman filter of Roumeliotis et al. 1999, run over nodes.

Symbols: state ``q_nb``, gyro bias ``b``; error ``[dtheta_b, dbias]``; ``P``, ``Phi``, ``Q``, ``H``, ``R``, ``K`` as
in eqs 20-30.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..maths import rotation
from ..maths.consistency import upper_quantile
from ..maths.kalman import Chain, Update, iterated_update
from ..nodes import Nodes
from ..records import Array, FilterRun, Innovations
from ..sensors import Measurement
from .alignment import Start


def run(nodes: Nodes, start: Start, gate_probability: float = 0.9999, max_iterations: int = 8) -> FilterRun:
    """Run the filter forward over the nodes.

    Parameters
    ----------
    nodes : epochs, preintegrated IMU, measurements
    start : estimate before the first measurement
    gate_probability : share of good measurements the chi-square gate lets through; 1 switches it off
    max_iterations : of an update; 1 gives the paper's plain filter

    Notes
    -----
    Between two nodes with measurements the bias estimate does not change, so attitude and ``Phi`` of the whole
    stretch are made in one batch; the covariance recursion ``P = Phi P Phi' + Q`` (eq 22) is the only loop.
    """
    n, inc = len(nodes.t), nodes.increments
    P_pred, P = np.empty((n, 6, 6)), np.empty((n, 6, 6))
    q, bias = np.empty((n, 4)), np.empty((n, 3))
    dx, info, vec = np.zeros((n, 6)), np.zeros((n, 6, 6)), np.zeros((n, 6))
    Phi = np.empty_like(inc.Phi)
    log: list[tuple[Measurement, float, bool, Array]] = []
    q[0], bias[0], P_pred[0], P[0] = start.q, start.bias, start.P, start.P
    stops = [*zip(nodes.measured.tolist(), nodes.measurements, strict=True)]
    if not stops or stops[-1][0] != n - 1:
        stops.append((n - 1, ()))
    k = 0
    for node, group in stops:
        if node > k:
            turns, Phi[k:node] = inc.at(bias[k], k, node)
            q[k + 1 : node + 1] = rotation.chain(turns, q[k])
            bias[k + 1 : node + 1] = bias[k]
            _predict(P, Phi, inc.Q, k, node)
            P_pred[k + 1 : node + 1] = P[k + 1 : node + 1]
            k = node
        if group:
            update = _update(P[k], q[k], bias[k], group, gate_probability, max_iterations, log)
            if update is not None:
                dx[k], P[k], info[k], vec[k] = update.dx, update.P, update.info, update.vec
                q[k] = rotation.multiply(q[k], rotation.exp_quaternion(update.dx[:3]))
                bias[k] = bias[k] + update.dx[3:]
    chain = Chain(P_pred, P, Phi, inc.Q, dx, info, vec, 3)
    return FilterRun(nodes.t, q, bias, chain, inc, _innovations(log), nodes.moving, start.heading, start.in_motion)


def _predict(P: Array, Phi: Array, Q: Array, first: int, last: int) -> None:
    """Fill ``P[first + 1 .. last]`` from ``P[first]``."""
    now = P[first]
    for k in range(first, last):
        now = Phi[k] @ now @ Phi[k].T + Q[k]
        now = 0.5 * (now + now.T)
        P[k + 1] = now


def _update(
    P: Array, q: Array, bias: Array, group: Sequence[Measurement], gate: float, iterations: int,
    log: list[tuple[Measurement, float, bool, Array]],
) -> Update | None:  # fmt: skip
    """Update with all measurements of a node at once; while one misses its gate, leave the worst out and try again."""
    kept = list(group)
    outside: list[tuple[Measurement, float, bool, Array]] = []
    while kept:
        update = _solve(P, q, bias, kept, iterations)
        parts = _by_measurement(update, kept)
        excess = [
            nis / upper_quantile(m.sensor.dof, 1.0 - gate) if gate < 1.0 else 0.0
            for m, (nis, _) in zip(kept, parts, strict=True)
        ]
        worst = int(np.argmax(excess))
        if excess[worst] <= 1.0:
            log.extend((m, nis, True, z) for m, (nis, z) in zip(kept, parts, strict=True))
            log.extend(outside)
            return update
        outside.append((kept[worst], parts[worst][0], False, parts[worst][1]))
        del kept[worst]
    log.extend(outside)
    return None


def _solve(P: Array, q: Array, bias: Array, group: Sequence[Measurement], iterations: int) -> Update:
    rows = sum(m.sensor.dof for m in group)
    R = np.zeros((rows, rows))
    at = 0
    for m in group:
        d = m.sensor.dof
        R[at : at + d, at : at + d] = m.noise
        at += d

    def linearise(d: Array) -> tuple[Array, Array]:
        R_nb = rotation.turned_matrix(q, d[:3])
        pairs = [m.linearise(R_nb, bias + d[3:]) for m in group]
        if len(pairs) == 1:
            return pairs[0]
        return np.concatenate([r for r, _ in pairs]), np.concatenate([H for _, H in pairs])

    return iterated_update(P, linearise, R, 3, iterations)


def _by_measurement(update: Update, group: Sequence[Measurement]) -> list[tuple[float, Array]]:
    """Split an update's innovation into NIS and normalised innovations of each measurement."""
    out, at = [], 0
    for m in group:
        rows = slice(at, at + m.sensor.dof)
        nu, S = update.nu[rows], update.S[rows, rows]
        out.append((float(nu @ np.linalg.solve(S, nu)), nu / np.sqrt(np.diag(S))))
        at = rows.stop
    return out


def _innovations(log: Sequence[tuple[Measurement, float, bool, Array]]) -> Innovations:
    z = np.full((len(log), 3), np.nan)
    for i, (_, _, _, values) in enumerate(log):
        z[i, : len(values)] = values
    return Innovations(
        np.array([m.role for m, *_ in log], dtype=np.str_),
        np.array([m.t for m, *_ in log]),
        np.array([m.node for m, *_ in log], dtype=np.int64),
        np.array([m.sensor.dof for m, *_ in log], dtype=np.int64),
        np.array([nis for _, nis, _, _ in log]),
        np.array([used for _, _, used, _ in log], dtype=np.bool_),
        z,
    )
