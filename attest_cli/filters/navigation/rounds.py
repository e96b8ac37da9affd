"""From a drive to its navigation: begin with the indirect filter, find noise, clocks and lever arms, then iterate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ...maths import rotation
from ...nodes import Nodes
from ...records import Array
from ...settings import Settings
from ...wheels import Judged
from .. import Drive, Forward, indirect
from ..wheeled import believed, smoothed
from . import colours, components, feigned, solve
from .aids import Place, Wheels
from .feigned import SURE
from .fixes import epochs_of
from .identify import identify, scaled_inertial, stretch, widened
from .model import Inertial, Trajectory
from .offsets import Offset, offsets, wider
from .problem import Problem, assemble, node_spacing
from .states import Layout
from .streams import clock_of, own_nodes

FIRST_PASSES, AUTO_PASSES = 5, 9
ROUNDS = 4  # of finding how late the fixes are, and where their antenna is
LEAST_LAG_S, MOST_LAG_S = 2e-3, 1.0  # a receiver may be late by as much
STEEP = 0.9  # slope of a state that noise feigns little of
SHOWN = 0.5  # of its prior sigma: what a drive must leave of an axis of a lever arm that it shows
SAFE_GYRO, SAFE_ACCEL = 3e-2, 0.3  # rad/s/sqrt(Hz), m/s^2/sqrt(Hz): noise to begin with, from which it is found


@dataclass(frozen=True, slots=True)
class Learnt:
    """What earlier rounds found: ``lags`` s, ``arms`` that are no states (any more), ``factors`` on noise, ``jumps`` of
    fixes, which ``odometry`` is believed, how far heading sensors are ``off``, rad, ``slopes`` of states that noise
    feigns.
    """

    lags: Mapping[str, float] = field(default_factory=dict)
    arms: Mapping[str, Array] = field(default_factory=dict)
    factors: Mapping[str, float] = field(default_factory=dict)
    jumps: components.Jumps = field(default_factory=dict)
    odometry: Judged | None = None
    off: Mapping[str, float] = field(default_factory=dict)
    slopes: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Clock:
    """How late fixes still are: ``lag``, s, whether that is ``sure``, and the ``slope`` of the state."""

    lag: float
    sure: bool
    slope: float


@dataclass(frozen=True, slots=True)
class Navigated:
    """A drive solved: where it ``begun``, its ``nodes``, the ``problem``, the solution ``found``, what was ``learnt``,
    and what is left of its ``clocks``.
    """

    begun: Forward
    nodes: Nodes
    problem: Problem
    found: solve.Solution
    learnt: Learnt
    clocks: Mapping[str, Clock] = field(default_factory=dict)


def navigate(drive: Drive) -> Navigated:
    """Solve a drive: its nodes lie also at fixes whose values are not known."""
    learnt = Learnt(arms=_stated_arms(drive))
    done = _round(drive, learnt, None)
    for _ in range(ROUNDS - 1):
        lags = _lags(done.clocks, done.learnt.lags)
        slopes = {f"{role} lag": c.slope for role, c in done.clocks.items() if role not in lags and c.slope < STEEP}
        slopes = {name: slope for name, slope in slopes.items() if name not in done.learnt.slopes}
        arms = {} if lags else _hidden_arms(done.problem, done.found)  # a lag hides them
        off = wider(known_offsets(drive, done))
        if not (lags or arms or off or slopes):
            break
        learnt = done.learnt
        total = {role: learnt.lags.get(role, 0.0) + lags.get(role, 0.0) for role in {*learnt.lags, *lags}}
        learnt = replace(learnt, lags=total, arms={**learnt.arms, **arms}, off={**learnt.off, **off},
                         slopes={**learnt.slopes, **slopes})  # fmt: skip
        done = _round(drive, learnt, done)
    return done


def known_offsets(drive: Drive, done: Navigated) -> list[Offset]:
    """Return what the fixes show of the heading sensors."""
    return list(offsets(drive.settings, done.problem.layout, done.problem.prior[1], done.found))


def _round(drive: Drive, learnt: Learnt, before: Navigated | None) -> Navigated:
    """Solve a drive with what was learnt, from where the round ``before`` ended."""
    late = replace(shifted(drive, learnt.lags), settings=_spaced(drive))
    begun = indirect.forward(late, _epochs(late))
    nodes = begun.nodes
    assert nodes is not None  # the indirect filter runs over nodes
    q, bias = smoothed(begun.run)
    learnt = learnt if learnt.odometry is not None else replace(learnt, odometry=believed(drive, nodes, q, bias))
    problem = assemble(late, nodes, q, bias, begun.run.heading, learnt.arms, learnt.odometry, learnt.off)
    if before is not None:
        problem = replace(problem, at=_resumed(before, problem.layout, nodes.t))
    problem, learnt = _with_noise(drive, problem, learnt, begin=before is None)
    found = _solved(drive, problem)
    if begun.run.heading == "relative" and problem.heading == "absolute":
        problem, found = _headed(drive, problem, found)
    done = Navigated(begun, nodes, problem, found, learnt)
    return replace(done, clocks=_clocks(done))


def _headed(drive: Drive, problem: Problem, found: solve.Solution) -> tuple[Problem, solve.Solution]:
    """Return problem and solution with what the fixes really show of the heading."""
    survey = feigned.surveyed(problem, found)
    if survey is None:
        return problem, found
    problem, sigma = survey
    found = _solved(drive, problem)
    if problem.heading == "absolute":
        problem = feigned.kept(problem, found, sigma)
        found = _solved(drive, problem)
    return problem, found


def _spaced(drive: Drive) -> Settings:
    """Return the settings with the nodes as close as the motion asks."""
    smoothing = drive.settings.smoothing.model_copy(update={"node_spacing_s": node_spacing(drive)})
    return drive.settings.model_copy(update={"smoothing": smoothing})


def _epochs(drive: Drive) -> Array:
    """Return the times of the fixes: they are nodes."""
    slow = [f.t for role, f in drive.log.fixes.items() if role in {"gps_velocity", "height"} and own_nodes(f)]
    return np.concatenate([epochs_of(drive), *slow])


def shifted(drive: Drive, lags: Mapping[str, float]) -> Drive:
    """Return the drive with its fixes on the clock of the IMU."""
    had = drive.log.fixes
    fixes = {role: replace(f, t=f.t - lags.get(clock_of(role, had), 0.0)) for role, f in had.items()}
    return replace(drive, log=replace(drive.log, fixes=fixes))


def _resumed(before: Navigated, form: Layout, t: Array) -> Trajectory:
    """Return an earlier round's trajectory at other nodes, and in another layout."""
    old, layout, at = before.nodes.t, before.problem.layout, before.found.smoothed
    left = np.clip(np.searchsorted(old, t, side="right") - 1, 0, len(old) - 2)
    share = ((t - old[left]) / (old[left + 1] - old[left]))[:, None]
    turn = rotation.log_quaternion(rotation.multiply(rotation.conjugate(at.q[left]), at.q[left + 1]))
    q = rotation.normalise(rotation.multiply(at.q[left], rotation.exp_quaternion(share * turn)))
    x = np.zeros((len(t), form.size))
    for name, part in form.parts.items():
        if name in layout:
            held = at.x[:, layout.parts[name]]
            x[:, part] = held[left] + share * (held[left + 1] - held[left])
    return Trajectory(q, x)


def _with_noise(drive: Drive, problem: Problem, learnt: Learnt, *, begin: bool) -> tuple[Problem, Learnt]:
    """Return the problem with the noise that its own fixes and wheels show, found once; at the beginning, where the
    trajectory is far off, with all fixes at full weight.
    """
    aiding = [a for a in problem.aids if isinstance(a, Place | Wheels)]
    if not aiding:
        return problem, learnt
    inertial, free = problem.inertial, [a.role for a in aiding if not _stated(drive, a.role)]
    free += [c.name for c in problem.layout.coloured()]  # nobody states these
    if drive.settings.imu.accel_noise_density is None:
        free, inertial = ["accelerometer", *free], replace(inertial, accel=_lively(problem))
    if drive.settings.imu.gyro_noise_density is None:
        free, inertial = ["gyro", *free], replace(inertial, gyro=np.maximum(inertial.gyro, SAFE_GYRO**2))
    at = problem.at
    if begin:
        aids = tuple(replace(a, robust=False) if isinstance(a, Place | Wheels) else a for a in problem.aids)
        at = solve.solve(problem.layout, problem.prior, inertial, aids, at, FIRST_PASSES, problem.tune).smoothed
        learnt = _judged(replace(problem, inertial=inertial, aids=aids, at=at), learnt, free)
    factors = learnt.factors
    aids = tuple(a.scaled(factors.get(a.role, 1.0)) if isinstance(a, Place | Wheels) else a for a in problem.aids)
    form, (start, P0) = problem.layout.scaled(factors).sloped(learnt.slopes), problem.prior
    form = form.loosened(components.loose(aids, learnt.jumps, learnt.lags, len(problem.at.q)))
    return replace(
        problem, layout=form, prior=(start, colours.steady(P0, form)),
        inertial=_floored(inertial, problem, factors), aids=aids, at=at,
    ), learnt  # fmt: skip


def _lively(problem: Problem) -> Array:
    """Return the density of the accelerometer to begin with: a rest is no measure of what shakes in motion."""
    accel = problem.inertial.accel
    return np.asarray(np.where(accel > problem.rest_accel, np.maximum(accel, SAFE_ACCEL**2), accel))


def _judged(problem: Problem, learnt: Learnt, free: Sequence[str]) -> Learnt:
    """Return also the factors on the noise of ``free``, and the jumps of the fixes: a few great ones would count as
    noise of all sensors.
    """
    form, P0, inertial, aids, at = problem.layout, problem.prior[1], problem.inertial, problem.aids, problem.at
    rough, n = identify(form, P0, inertial, aids, at, free), len(at.q)
    factors, jumps = components.refined(stretch(form, P0, inertial, aids, at, n), aids, rough)
    form = form.loosened(components.loose(aids, jumps, {}, n))
    return replace(learnt, factors=widened(form, P0, inertial, aids, at, factors), jumps=jumps)


def _floored(begun: Inertial, problem: Problem, factors: Mapping[str, float]) -> Inertial:
    """Return the IMU with the densities found, never below those of ``problem``: vibration and tilt that rocks are no
    white noise, and look small from one fix to the next. Of the accelerometer hidden fixes show how much it is; without
    fixes nothing does.
    """
    found, least = scaled_inertial(begun, factors), problem.inertial
    accel = problem.rest_accel if any(isinstance(a, Place) for a in problem.aids) else least.accel
    return replace(found, gyro=np.maximum(found.gyro, least.gyro), accel=np.maximum(found.accel, accel))


def _stated(drive: Drive, role: str) -> bool:
    """Return whether the user stated the noise of this aid."""
    key = "sigma_m_s" if role == "odometry" else "sigma_m"
    return key in getattr(drive.settings, role).model_fields_set


def _stated_arms(drive: Drive) -> dict[str, Array]:
    """Return the lever arms (3,) that the user stated, m, body axes."""
    arms = {role: getattr(drive.settings, role).lever_arm_m for role in ("gps", "position", "odometry")}
    return {role: np.array(arm) for role, arm in arms.items() if arm != "auto"}


def _solved(drive: Drive, problem: Problem) -> solve.Solution:
    wanted = drive.settings.smoothing.iterations
    most = AUTO_PASSES if wanted == "auto" else int(wanted)
    return solve.solve(problem.layout, problem.prior, problem.inertial, problem.aids, problem.at, most, problem.tune)


def _clocks(done: Navigated) -> dict[str, Clock]:
    """Return the clocks of fixes that matter: those that seem late, and all where noise feigns much of the heading."""
    problem, found, out = done.problem, done.found, {}
    for name, part in problem.layout.parts.items():
        if name.endswith(" lag"):
            lag, sigma = float(found.smoothed.x[0, part.start]), float(np.sqrt(found.errors.P[0, part, part].item()))
            if problem.inertial.slope < 1.0 or abs(lag) > max(LEAST_LAG_S, SURE * sigma):
                role, doubt = name.removesuffix(" lag"), feigned.constant(problem, found, name)
                on = lag * done.learnt.lags.get(role, 0.0) > 0.0  # the way that was borne out: costs are flat far off
                sure = abs(lag) > LEAST_LAG_S and doubt.claimed > SURE and (on or doubt.borne_out > SURE)
                out[role] = Clock(lag, sure, doubt.slope)
    return out


def _lags(clocks: Mapping[str, Clock], known: Mapping[str, float]) -> dict[str, float]:
    """Return how late fixes still are, s, where that is sure, and can be."""
    return {r: c.lag for r, c in clocks.items() if c.sure and abs(known.get(r, 0.0) + c.lag) < MOST_LAG_S}


def left_lags(done: Navigated) -> dict[str, float]:
    """Return how late, s, fixes would be that are later than a receiver can be: they were not moved by that."""
    whole = {role: done.learnt.lags.get(role, 0.0) + clock.lag for role, clock in done.clocks.items() if clock.sure}
    return {role: lag for role, lag in whole.items() if abs(lag) >= MOST_LAG_S}


def _hidden_arms(problem: Problem, found: solve.Solution) -> dict[str, Array]:
    """Return the lever arms that the drive does not show: they are no states then, and zero."""
    out = {}
    for state in problem.layout.states:
        if state.name.endswith(" lever arm"):
            part = problem.layout.parts[state.name]
            arm, sigma = found.smoothed.x[0, part], np.sqrt(np.diagonal(found.errors.P[0])[part])
            if not np.any((np.abs(arm) > SURE * sigma) & (sigma < SHOWN * np.asarray(state.sigma))):
                out[state.name.removesuffix(" lever arm")] = np.zeros(3)
    return out


def smoothed_begin(done: Navigated) -> tuple[Array, Array]:
    """Return the attitude (n, 4) and gyro bias (n, 3) that the drive began with: no fix is in them."""
    return smoothed(done.begun.run)
