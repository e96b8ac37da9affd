"""The indirect (error-state) Kalman filter of Roumeliotis et al. 1999, run over nodes.

Symbols: state ``q_nb``, gyro bias ``b``; error ``[dtheta_b, dbias]``; ``P``, ``Phi``, ``Q``, ``H``, ``R``, ``K`` as
in eqs 20-30.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..maths import rotation
from ..maths.consistency import upper_quantile
from ..maths.kalman import Chain, Update, iterated_update
from ..nodes import Nodes, build_nodes, mean_rate
from ..nodes.noise import motion_density, reference_bias
from ..nodes.observations import Observation, observe
from ..records import Array, FilterRun, Innovations, Warn
from ..sensors import Measurement
from . import Drive, Forward, closure, scale
from .alignment import Start, align
from .wheeled import verticals

MOST_RAISES = 6  # of the gyro's noise in motion
LEAST_RAISE = 1.1
ABSURD = 10.0  # times its noise: no gyro drifts so in motion, it contradicts the accelerometer
ACCELEROMETER = {"accel-bias", "accel-scale"}  # causes that are none of the gyro
FEW_MOTIONS = 4
FAR = 30.0  # NIS that is larger counts as this
UNKNOWN_RAD = 0.7  # an attitude worse than this over a motion is not known at all
SURE = 1e-4  # chance of a misfit taken as proof


@dataclass(frozen=True, slots=True)
class Begun:
    """A drive on nodes, where its filter starts, and what it makes of them with the noise as it stands."""

    drive: Drive
    nodes: Nodes
    start: Start
    run: FilterRun
    warnings: tuple[Warn, ...]


def forward(drive: Drive, epochs: Array | None = None) -> Forward:
    """Put the drive on nodes (``epochs`` are nodes too; None: coarser ones will do), align, and run forward with a gyro
    whose scale and noise the drive does not contradict.
    """
    gate = drive.settings.smoothing.gate_probability
    begun = _begin(drive, epochs)
    nodes, found, raised = consistent_run(begun.nodes, begun.start, gate, begun.run)
    causes = closure.doubts(drive, raised=raised > 1.0)
    asked = epochs is None and not _spared(causes)  # navigation has states for it
    better, told = _scaled(begun) if asked else (None, ())
    if better is not None:
        mends = better.log is not drive.log
        again = _begin(better, None) if mends else _with_noise(begun, better, gate)
        solved = consistent_run(again.nodes, again.start, gate, again.run)
        if solved[2] <= (1.0 if mends else raised) and (not mends or _refused(again.run) <= _refused(begun.run)):
            begun, (nodes, found, raised) = replace(again, warnings=(*again.warnings, *told)), solved
            causes = closure.doubts(better, raised=raised > 1.0)
    if epochs is None and begun.drive.noise.gyro_scale > 0.0 and _heading(found) == "relative":
        stated = begun.drive.settings.imu.gyro_scale_sigma is not None
        nodes = _turning(nodes, found, 0.0 if stated else scale.AS_IT_COMES)
        found = run(nodes, begun.start, gate)
    noise, warnings = begun.drive.noise, [*begun.warnings]
    if raised > 1.0:
        noise = replace(noise, gyro_density=noise.gyro_density * np.sqrt(raised))
        warnings += [] if _spared(causes) else [_told_raised(float(np.sqrt(raised)))]
    warnings += causes
    return Forward(replace(found, heading=_heading(found)), noise, nodes, begun.start, tuple(warnings))


def _begin(drive: Drive, epochs: Array | None, more: Sequence[Observation] = ()) -> Begun:
    """Put a drive on nodes, with ``more`` observations than its sensors make by themselves, align and run forward."""
    settings = drive.settings
    observations, warnings = observe(drive.log, drive.segmentation, drive.world, drive.noise, settings)
    observations = sorted([*observations, *more], key=lambda o: o.t) if more else observations
    nodes = build_nodes(drive.log, drive.segmentation, observations, drive.noise, settings, epochs)
    start = align(nodes, settings.imu.gyro_bias_sigma, magnetic=drive.world.field_n is None)
    return Begun(drive, nodes, start, run(nodes, start, settings.smoothing.gate_probability), tuple(warnings))


def _scaled(begun: Begun) -> tuple[Drive | None, tuple[Warn, ...]]:
    """Return the drive with another scale of the gyro, or noise for it, where its sensors show one; told where sure.

    Where they do not show it well, the wheels are asked for the vertical in motion.
    """
    drive, more = begun.drive, list[Observation]()
    exact = _exact(begun)
    evidence = scale.learn(exact.nodes, exact.run)
    if evidence.common()[1] > scale.VAGUE and (more := verticals(drive, exact.nodes, exact.run)):
        exact = _exact(_begin(drive, None, more))
        evidence = scale.learn(exact.nodes, exact.run)

    def explains(candidate: Drive, sigmas: float) -> bool:
        """Whether the sensors miss less of it."""
        return _less_left(exact.run, _exact(_begin(candidate, None, more)).run, sigmas)

    if evidence.differ(drive.noise.gyro_scale):
        axes, sigmas = _axes(drive, evidence, more)
        found, told = scale.mended_axes(drive, axes, sigmas)
        if np.abs(axes - np.eye(3)).max() < scale.LARGEST_OF_AXES and explains(found, scale.EXPLAINS):
            return found, told
    better, told = scale.mended(drive, *evidence.common())
    if better is not None:
        return (better, told) if better.log is drive.log or explains(better, scale.SURE) else (None, ())
    if not scale.ALIKE & drive.log.fixes.keys():
        return None, ()
    error, sigma = scale.learn(exact.nodes, exact.run, scale.ASKED | scale.ALIKE).common()
    better, told = scale.doubted(drive, evidence.common(), (error, sigma))
    return (better, told) if better is not None and explains(scale.without(drive, error), error / sigma) else (None, ())


def _axes(drive: Drive, evidence: scale.Evidence, more: Sequence[Observation]) -> tuple[Array, Array]:
    """Return the axes (3, 3) of the gyro, :math:`I+M`, that the drive shows, and their sigma."""
    total, sigma = np.eye(3), np.eye(3)
    for k in range(scale.ROUNDS):
        if k:
            exact = _exact(_begin(scale.without(drive, total - np.eye(3)), None, more))
            evidence = scale.learn(exact.nodes, exact.run)
        M, sigma = evidence.each()
        total = (np.eye(3) + M) @ total
    return np.asarray(np.linalg.inv(total)), sigma


def _exact(begun: Begun) -> Begun:
    """Return the drive as if its gyro had no scale error: a run whose innovations show one. It takes all gravity, which
    cannot be an outlier, and of other sensors what was not refused.
    """
    drive, found = begun.drive, begun.run.innovations
    gravity, nodes = found.role == "gravity", begun.nodes
    bad = ~gravity & ~found.used
    others = set(zip(found.role[bad].tolist(), found.t[bad].tolist(), strict=True))
    if others:
        nodes = nodes.only([[m for m in group if (m.role, m.t) not in others] for group in nodes.measurements])
    if drive.noise.gyro_scale > 0.0:
        exact = replace(drive, noise=replace(drive.noise, gyro_scale=0.0))
        return _with_noise(replace(begun, nodes=nodes), exact, 1.0)
    if others or np.any(gravity & ~found.used):
        return replace(begun, nodes=nodes, run=run(nodes, begun.start, 1.0))
    return begun


def _with_noise(begun: Begun, drive: Drive, gate: float) -> Begun:
    """Run again with other noise of the gyro in motion, and all else as it is."""
    nodes = begun.nodes
    middle = 0.5 * (nodes.t[1:] + nodes.t[:-1])
    rate = mean_rate(drive.log.imu, middle) - reference_bias(drive.log, drive.segmentation, middle)
    nodes = nodes.denser(motion_density(drive.noise, rate) - motion_density(nodes.noise, rate))
    nodes = replace(nodes, noise=drive.noise)
    return replace(begun, drive=drive, nodes=nodes, run=run(nodes, begun.start, gate))


def _turning(nodes: Nodes, found: FilterRun, least: float) -> Nodes:
    r"""Return the nodes with what a scale error makes of a heading that no sensor sees: it grows with the turn
    :math:`\psi` since the start, for which no white noise stands; of an error of at ``least`` so much

    .. math:: \sigma^2(t)=s^2\max_{t'\le t}\psi^2(t')
    """
    up = rotation.matrix(found.q[1:])[:, 2]
    turned = np.einsum("ki,ki->k", up, rotation.log_quaternion(nodes.increments.dq))
    variance = (max(nodes.noise.gyro_scale, least) * np.maximum.accumulate(np.abs(np.cumsum(turned)))) ** 2
    return nodes.losing(np.diff(variance, prepend=0.0)[:, None, None] * (up[:, :, None] * up[:, None, :]))


def _refused(found: FilterRun) -> float:
    """Return the share of measurements other than gravity that were refused."""
    others = found.innovations.role != "gravity"
    return float(np.mean(~found.innovations.used[others])) if others.any() else 0.0


def _less_left(before: FilterRun, after: FilterRun, sigmas: float) -> bool:
    """Whether a scale error of so many ``sigmas`` that is taken out leaves less to explain, of all sensors."""
    left = [float(np.minimum(run.innovations.nis, FAR).sum()) for run in (before, after)]
    return left[1] < left[0] - 0.5 * sigmas**2


def _spared(causes: Sequence[Warn]) -> bool:
    """Whether it is surely the accelerometer that is at fault, not the gyro."""
    return any(warn.fatal and warn.code in ACCELEROMETER for warn in causes)


def _told_raised(times: float) -> Warn:
    """Say by how much the gyro's noise was raised, and what may be the matter."""
    message = f"the gyro drifts {times:.3g} times its noise in motion: sigma raised to fit"
    hint = "the gyro's scale or vibration is beyond its noise at rest; state it in [imu]"
    if times > ABSURD:
        hint = "check axes, signs and units of both, the accelerometer's bias, and whether the gyro's changes in motion"
    return Warn("gyro-noise-raised", message, hint, fatal=times > ABSURD)


def _heading(found: FilterRun) -> str:
    """Return the kind of heading: relative where every measurement of it was refused."""
    seen = set(found.innovations.role[found.innovations.used].tolist())
    return found.heading if seen & {"sun", "compass", "magnetometer", "orientation"} else "relative"


def consistent_run(
    nodes: Nodes, start: Start, gate: float, forward: FilterRun | None = None
) -> tuple[Nodes, FilterRun, float]:
    """Run the filter, unless it has been (``forward``); where gravity at the stops says that the gyro drifts more in
    motion than its noise allows, raise the gyro's variance until it fits. Return nodes and run, and the factor.

    Gravity at a stop that follows a motion is the one measurement that cannot be an outlier: rejecting it would keep a
    wrong attitude with a small sigma. Its mean NIS over the motions is the factor.
    """
    forward, raised = forward or run(nodes, start, gate), 1.0
    for _ in range(MOST_RAISES):
        found = forward.innovations
        at_stops = (found.role == "gravity") & ~nodes.moving[found.node]
        after = at_stops & (found.t > found.t[at_stops].min(initial=np.inf))
        nis = np.sort(found.nis[after])[: -1 if after.sum() >= FEW_MOTIONS else None]  # one odd stop proves nothing
        freedom = 2 * len(nis)
        if freedom == 0 or nis.sum() <= upper_quantile(freedom, SURE):
            break
        factor = min(float(nis.sum()) / freedom, UNKNOWN_RAD**2 / nodes.motion_variance())
        if factor < LEAST_RAISE:
            break
        nodes, raised = nodes.raised(factor), raised * factor
        forward = run(nodes, start, gate)
    return nodes, forward, raised


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
