"""The navigation smoother: attitude, velocity, position and sensor errors together, from every sensor of the log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from ...maths import kalman, rotation
from ...nodes import Nodes
from ...records import Array, FilterRun, Warn
from .. import Drive, Forward, indirect
from . import solve
from .aids import Place, Wheels
from .identify import identify
from .model import Inertial
from .problem import Problem, assemble

AUTO_PASSES = 3
ROUNDS = 4  # of finding how late the fixes are
LEAST_LAG_S = 2e-3
LAG_SURE = 3.0  # sigmas from which a lag is believed
SAFE_GYRO, SAFE_ACCEL = 3e-2, 0.3  # rad/s/sqrt(Hz), m/s^2/sqrt(Hz): noise to begin with, from which it is found


def forward(drive: Drive) -> Forward:
    """Begin with the indirect filter's attitude, find the noise and the clocks, then iterate over all states."""
    lags: dict[str, float] = {}
    factors: Mapping[str, float] = {}
    for _ in range(ROUNDS):
        late = _shifted(drive, lags)
        begun = indirect.forward(late, _epochs(late))
        q, bias = _smoothed(begun.run)
        problem = assemble(late, _nodes(begun), q, bias, begun.run.heading)
        problem, factors = _with_noise(drive, problem, factors)
        found = _solved(drive, problem)
        more = _lags(problem, found)
        if not more:
            break
        lags = {role: lags.get(role, 0.0) + more.get(role, 0.0) for role in {*lags, *more}}
    told = [*begun.warnings, *problem.warnings, *(_late(role, lag) for role, lag in sorted(lags.items()))]
    run = _run(begun.run, _nodes(begun), problem, found)
    return Forward(run, begun.noise, _scaled(_nodes(begun), problem, found), None, tuple(told))


def _nodes(begun: Forward) -> Nodes:
    assert begun.nodes is not None  # the indirect filter runs over nodes
    return begun.nodes


def _epochs(drive: Drive) -> Array:
    """Return the times of the fixes: they are nodes."""
    return np.concatenate([np.zeros(0), *(f.t for role, f in drive.log.fixes.items() if role in {"gps", "position"})])


def _shifted(drive: Drive, lags: Mapping[str, float]) -> Drive:
    """Return the drive with its fixes on the clock of the IMU."""
    fixes = {role: replace(f, t=f.t - lags.get(role, 0.0)) for role, f in drive.log.fixes.items()}
    return replace(drive, log=replace(drive.log, fixes=fixes))


def _with_noise(drive: Drive, problem: Problem, factors: Mapping[str, float]) -> tuple[Problem, Mapping[str, float]]:
    """Return the problem with the noise that its own fixes and wheels show, found once."""
    aiding = [a for a in problem.aids if isinstance(a, Place | Wheels)]
    if not aiding:
        return problem, factors
    stated = drive.settings.imu.gyro_noise_density is not None
    inertial, free = problem.inertial, [a.role for a in aiding if not _stated(drive, a.role)]
    if not stated:
        free = ["gyro", "accelerometer", *free]
        inertial = replace(
            inertial, gyro=np.maximum(inertial.gyro, SAFE_GYRO**2), accel=np.maximum(inertial.accel, SAFE_ACCEL**2)
        )
    if not free:
        return problem, factors
    aids = tuple(replace(a, robust=False) if isinstance(a, Place | Wheels) else a for a in problem.aids)
    at = problem.at
    if not factors:
        first = solve.solve(problem.layout, problem.prior, inertial, aids, at, AUTO_PASSES, problem.tune)
        factors = identify(problem.layout, problem.prior[1], inertial, aids, first.smoothed, free)
        at = first.smoothed
    aids = tuple(a.scaled(factors.get(a.role, 1.0)) if isinstance(a, Place | Wheels) else a for a in problem.aids)
    return replace(problem, inertial=_floored(inertial, problem.inertial, factors), at=at, aids=aids), factors


def _floored(begun: Inertial, least: Inertial, factors: Mapping[str, float]) -> Inertial:
    """Return the IMU with the densities found, never below those at rest."""
    gyro, accel = factors.get("gyro", 1.0), factors.get("accelerometer", 1.0)
    return replace(
        begun,
        gyro=np.maximum(begun.gyro * gyro**2, least.gyro.min()),
        accel=np.maximum(begun.accel * accel**2, least.accel.min()),
    )


def _stated(drive: Drive, role: str) -> bool:
    """Return whether the user stated the noise of this aid."""
    return {"gps": "sigma_m" in drive.settings.gps.model_fields_set,
            "odometry": "sigma_m_s" in drive.settings.odometry.model_fields_set}.get(role, False)  # fmt: skip


def _solved(drive: Drive, problem: Problem) -> solve.Solution:
    wanted = drive.settings.smoothing.iterations
    most = AUTO_PASSES if wanted == "auto" else int(wanted)
    return solve.solve(problem.layout, problem.prior, problem.inertial, problem.aids, problem.at, most, problem.tune)


def _lags(problem: Problem, found: solve.Solution) -> dict[str, float]:
    """Return how late fixes still are, s, where that is sure."""
    out = {}
    for name, part in problem.layout.parts.items():
        if name.endswith(" lag"):
            at = part.start
            lag, sigma = float(found.smoothed.x[0, at]), float(np.sqrt(found.errors.P[0, at, at]))
            if abs(lag) > max(LEAST_LAG_S, LAG_SURE * sigma):
                out[name.removesuffix(" lag")] = lag
    return out


def _late(role: str, lag: float) -> Warn:
    word = "late" if lag > 0 else "early"
    return Warn(f"{role}-late", f"{role} is {abs(lag):.3f} s {word} against the IMU: corrected")


def _smoothed(run: FilterRun) -> tuple[Array, Array]:
    """Return the smoothed attitude (n, 4) and gyro bias (n, 3) of the indirect filter."""
    d = kalman.rts(run.chain).d
    return rotation.normalise(rotation.multiply(run.q, rotation.exp_quaternion(d[:, :3]))), run.bias + d[:, 3:]


def _run(begun: FilterRun, nodes: Nodes, problem: Problem, found: solve.Solution) -> FilterRun:
    """Return the last pass as a filter run that every smoother reads."""
    bias = problem.layout.parts["gyro bias"]
    at = found.at.moved(found.found.x)
    placed = any(isinstance(a, Place) for a in problem.aids)
    return FilterRun(
        nodes.t, at.q, at.x[:, bias], found.found.chain, None, solve.innovations(found.found, found.rows), nodes.moving,
        "absolute" if placed and begun.heading == "relative" else begun.heading, begun.start_in_motion,
        partial(solve.read, found, nodes.t, bias),
    )  # fmt: skip


def _scaled(nodes: Nodes, problem: Problem, found: solve.Solution) -> Nodes:
    """Return the nodes with the gyro's scale taken out of their steps, from which full rate is made."""
    if "gyro scale" not in problem.layout:
        return nodes
    M = found.smoothed.x[:, problem.layout.parts["gyro scale"]].mean(axis=0).reshape(3, 3)
    steps = nodes.steps
    return replace(
        nodes, steps=replace(steps, rate0=steps.rate0 - steps.rate0 @ M.T, rate1=steps.rate1 - steps.rate1 @ M.T)
    )
