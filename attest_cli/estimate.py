"""From a segmented log to the estimate: forward filter, smoother, full rate, mounting, position."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from . import filters
from .assess import Pass
from .filters.alignment import Start
from .filters.choice import choose
from .filters.lag import find_lags
from .filters.stamps import read_as
from .maths import kalman, rotation
from .maths.kalman import Chain
from .memory import give_back
from .nodes import Nodes
from .nodes.noise import Noise, find_noise
from .records import Array, Bools, FilterRun, Fixes, Ints, Log, Segmentation, Shown, Smoothed, Warn, World
from .settings import Settings
from .settings.quantities import MOST_PASSES
from .smoothers import SMOOTHERS, backward_estimate, gauss_newton, thinned
from .track import full_rate
from .wheels import Judged
from .world import find_world

Progress = Callable[[str, float], None]
AUTO_PASSES = 12
LAG_ROUNDS = 2  # a sensor that is seconds late has bent the attitude that it is held against
BENT_SHARE = 1e-3  # of the nodes
WRONG_MOVES = 1.0  # sigmas that a last pass moves: its sigma does not hold
DOUBTFUL_SHARE = 0.02  # of the measurements refused: the trajectory may be the one at fault


def silent(stage: str, share: float) -> None:
    """Show no progress."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """What the filters made of a log.

    ``world`` and ``noise`` they assumed; the ``forward`` run without its matrices; at the m nodes that are told of:
    ``smoothed``, the three ``passes``, ``moving``, and the ``errors`` that a position counts on; ``q`` (n, 4) the
    smoothed attitude at the IMU samples; the ``filter`` used, what it has ``shown`` of the sensors, and which
    ``odometry`` it believed, if it was asked.
    """

    world: World
    noise: Noise
    forward: FilterRun
    smoothed: Smoothed
    errors: Smoothed
    passes: Mapping[str, Pass]
    moving: Bools
    q: Array
    warnings: tuple[Warn, ...]
    filter: str
    shown: tuple[Shown, ...]
    odometry: Judged | None = None


def estimate(log: Log, segmentation: Segmentation, settings: Settings, progress: Progress = silent) -> Estimate:
    """Run the forward filter and the smoother over a log.

    Forward, backward, Gauss-Newton where it pays; a log without a stop twice, for its accelerometer windows are turned
    by a gyro whose bias the first round finds.
    """
    name, _ = choose(log, segmentation, settings)
    settings = settings.model_copy(update={"smoothing": settings.smoothing.model_copy(update={"filter": name})})
    settings, of_stamps = read_as(log, settings)
    found, smoothed = _solve(log, segmentation, settings, progress)
    if not segmentation.stops and found.nodes is not None:
        again = replace(segmentation, bias_b=smoothed.bias.mean(axis=0))
        found, smoothed = _solve(log, again, settings, progress)
    world = find_world(log, settings)
    lags = dict[str, float]()
    for _ in range(LAG_ROUNDS):
        more = find_lags(log, smoothed, world, settings)
        if not more:
            break
        lags |= {role: lags.get(role, 0.0) + lag for role, lag in more.items()}
        log = replace(log, fixes={role: _earlier(fixes, more.get(role, 0.0)) for role, fixes in log.fixes.items()})
        found, smoothed = _solve(log, segmentation, settings, progress)
    forward, errors, smoothed = _passes(found.run, smoothed, settings)
    samples = None if found.nodes is None else found.nodes.samples
    found = replace(found, run=_lean(found.run), nodes=None, start=None)
    told = _told(found, forward, smoothed, errors, world, settings, over_nodes=samples is not None)
    told = replace(told, warnings=(*told.warnings, *of_stamps, *(_late(*item) for item in lags.items())))
    if samples is None:
        return replace(told, q=rotation.continuous(smoothed.q))
    del found, forward, errors, smoothed  # full rate is long enough
    give_back()
    return replace(told, q=full_rate(samples, told.smoothed))


def _earlier(fixes: Fixes, lag: float) -> Fixes:
    return replace(fixes, t=fixes.t - lag) if lag else fixes


def _late(role: str, lag: float) -> Warn:
    word = "late" if lag > 0 else "early"
    return Warn(f"{role}-late", f"{role} is {abs(lag):.2f} s {word} against the gyro: corrected")


def _solve(
    log: Log, segmentation: Segmentation, settings: Settings, progress: Progress
) -> tuple[filters.Forward, Smoothed]:
    """Run the filter forward and the smoother over its run."""
    progress("forward filter", 0.3)
    noise = find_noise(log, segmentation, settings)
    drive = filters.Drive(log, segmentation, find_world(log, settings), noise, settings)
    found = filters.load(settings.smoothing.filter)(drive)
    progress("smoothing", 0.5)
    if found.nodes is not None and found.start is not None:
        return found, smooth_run(found.nodes, found.start, found.run, settings)
    return found, SMOOTHERS[settings.smoothing.smoother](found.run)


def _passes(run: FilterRun, smoothed: Smoothed, settings: Settings) -> tuple[Smoothed, Smoothed, Smoothed]:
    """Return the forward pass, the errors that a position counts on, and the smoothed pass with its backward
    information: all that is made of the run's steps.
    """
    # the literal procedure counts the past twice: the exact covariance is no larger a claim
    errors = SMOOTHERS["two-filter"](run) if settings.smoothing.smoother == "paper" else smoothed
    information = smoothed.information or kalman.information(run.chain)
    return SMOOTHERS["none"](run), errors, replace(smoothed, information=information)


def _told(
    found: filters.Forward, forward: Smoothed, smoothed: Smoothed, errors: Smoothed, world: World, settings: Settings,
    *, over_nodes: bool,
) -> Estimate:  # fmt: skip
    """Bring the passes to the nodes that are told of, and say what the filter left open."""
    run, cfg = found.run, settings.smoothing
    rows = slice(None) if over_nodes else _rows(run, cfg.node_spacing_s)
    passes = {
        "forward": Pass(forward.q[rows], forward.bias[rows], forward.P[rows]),
        "backward": Pass(*(values[rows] for values in backward_estimate(run, smoothed.information))),
    }
    smoothed = replace(smoothed, information=None) if over_nodes else thinned(smoothed, _rows(run, cfg.node_spacing_s))
    passes["smoothed"] = Pass(smoothed.q, smoothed.bias, smoothed.P)
    warnings = (*found.warnings, *_warnings(run, smoothed, settings, over_nodes=over_nodes))
    return Estimate(
        world, found.noise, _lean(run, told=True), smoothed,
        errors if over_nodes and cfg.smoother == "paper" else smoothed, passes, run.moving[rows], np.empty((0, 4)),
        warnings, cfg.filter, found.shown, found.odometry,
    )  # fmt: skip


def _lean(run: FilterRun, *, told: bool = False) -> FilterRun:
    """Return the run without the matrices of its steps, and of its nodes once they are told of: a long log has many."""
    chain = run.chain
    none = np.empty((0, *chain.P.shape[1:]))
    chain = Chain(none, none if told else chain.P, none, none, chain.dx, none, none[:, 0], chain.rotations)
    run = replace(run, chain=chain, increments=None)
    return replace(run, read=None, beforehand=None) if told else run


def _rows(run: FilterRun, spacing: float) -> Ints:
    """Return the samples that are told of: at most ``spacing`` apart, and both sides of every stop's edges."""
    edges = np.flatnonzero(np.diff(run.moving.astype(np.int8)))
    slots = np.floor((run.t - run.t[0]) / spacing + 1e-6)
    first = np.flatnonzero(np.diff(slots, prepend=-1.0))
    return np.unique(np.concatenate([first, edges, edges + 1, [len(run.t) - 1]]))


def _warnings(run: FilterRun, smoothed: Smoothed, settings: Settings, *, over_nodes: bool) -> list[Warn]:
    """Return what the user should know of the estimate."""
    told, cfg = [], settings.smoothing
    if not smoothed.settled:
        more = min(2 * smoothed.passes, MOST_PASSES)
        ways = [f"--iterations {more}"] * (more > smoothed.passes) + ["--filter indirect"] * (cfg.filter != "indirect")
        hint = f"compare {' or '.join(ways)}; " * bool(ways)
        hint += "a log whose heading or tilt is hardly known may have two answers"
        message = f"the estimate still moves after {smoothed.passes} passes"
        told.append(Warn("not-settled", message, hint, fatal=smoothed.moves > WRONG_MOVES))
    if run.absent:
        told.append(
            Warn("not-estimated", f"{cfg.filter} does not estimate {' and '.join(run.absent)}",
                 "what stands there is dead reckoning or level, with its sigma; --filter indirect estimates all")
        )  # fmt: skip
    elif run.heading == "relative":
        hint = "add a compass, a sun sensor or a magnetometer"
        told.append(Warn("no-heading", "no heading sensor: yaw is relative to the start", hint))
    if not over_nodes and cfg.iterations != "auto":
        told.append(Warn("no-iterations", f"--iterations has no meaning with --filter {cfg.filter}: not used"))
    return told


def smooth_run(nodes: Nodes, start: Start, forward: FilterRun, settings: Settings) -> Smoothed:
    """Smooth a forward run; then Gauss-Newton passes where asked for, or (auto) where a linearisation may have been
    poor.
    """
    cfg = settings.smoothing
    smoothed = SMOOTHERS[cfg.smoother](forward)
    if cfg.smoother not in {"two-filter", "rts"}:
        return smoothed
    passes = (AUTO_PASSES if doubtful(forward, smoothed) else 0) if cfg.iterations == "auto" else int(cfg.iterations)
    if passes == 0:
        return smoothed
    again = nodes.rebuild(smoothed.bias)
    smoothed = replace(smoothed, P=forward.chain.P[:0], cross=forward.chain.P[:0])  # every pass makes its own
    return gauss_newton.refine(
        again, start, smoothed, forward.innovations, passes, cfg.gate_probability, fixed=cfg.iterations != "auto"
    )


def doubtful(forward: FilterRun, smoothed: Smoothed) -> bool:
    """Return whether the linearisation about the forward pass may have bent the result.

    It may where the log starts in motion, where many measurements were refused, or where the smoother moved nodes so
    far that turn times tilt, the second-order term, passes their sigma.
    """
    refused = float(np.mean(~forward.innovations.used)) if len(forward.innovations.used) else 0.0
    moved_b = rotation.log_quaternion(rotation.multiply(rotation.conjugate(forward.q), smoothed.q))
    tilt = np.linalg.norm(rotation.rotate(forward.q, moved_b)[:, :2], axis=1)
    least = np.sqrt(np.einsum("kii->ki", smoothed.P[:, :3, :3]).min(axis=1))
    bent = 0.5 * np.linalg.norm(moved_b, axis=1) * tilt > least
    return forward.start_in_motion or refused > DOUBTFUL_SHARE or float(np.mean(bent)) > BENT_SHARE
