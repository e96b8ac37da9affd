"""From a segmented log to the estimate: forward filter, smoother, full rate, mounting, position."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from . import filters
from .filters.alignment import Start, align
from .maths import rotation
from .maths.consistency import upper_quantile
from .nodes import Nodes, build_nodes
from .nodes.noise import Noise, find_noise
from .nodes.observations import observe
from .records import FilterRun, Log, Segmentation, Smoothed, Warn, World
from .settings import Settings
from .smoothers import SMOOTHERS, gauss_newton
from .world import find_world

Progress = Callable[[str, float], None]
AUTO_PASSES = 12
MOST_RAISES = 6  # of the gyro's noise in motion
LEAST_RAISE = 1.1
FEW_MOTIONS = 4
BENT_SHARE = 1e-3  # of the nodes
DOUBTFUL_SHARE = 0.02  # of the measurements refused: the trajectory may be the one at fault
UNKNOWN_RAD = 0.7  # an attitude worse than this over a motion is not known at all
SURE = 1e-4  # chance of a misfit taken as proof


def silent(stage: str, share: float) -> None:
    """Show no progress."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """What the filters made of a log: the world and noise they assumed, the nodes, the passes over them."""

    world: World
    noise: Noise
    nodes: Nodes
    forward: FilterRun
    smoothed: Smoothed
    warnings: tuple[Warn, ...]


def estimate(log: Log, segmentation: Segmentation, settings: Settings, progress: Progress = silent) -> Estimate:
    """Run the forward filter and the smoother over a log.

    Nodes, alignment, forward, backward, Gauss-Newton where it pays; a log without a stop twice, for its accelerometer
    windows are turned by a gyro whose bias the first round finds.
    """
    found = _estimate(log, segmentation, settings, progress)
    if segmentation.stops:
        return found
    return _estimate(log, replace(segmentation, bias_b=found.smoothed.bias.mean(axis=0)), settings, progress)


def _estimate(log: Log, segmentation: Segmentation, settings: Settings, progress: Progress) -> Estimate:
    world, noise = find_world(log, settings), find_noise(log, segmentation, settings)
    observations, warnings = observe(log, segmentation, world, noise, settings)
    nodes = build_nodes(log, segmentation, observations, noise, settings)
    start = align(nodes, settings.imu.gyro_bias_sigma, magnetic=world.field_n is None)
    progress("forward filter", 0.3)
    run_filter = filters.load(settings.smoothing.filter)
    nodes, forward, raised = consistent_run(run_filter, nodes, start, settings.smoothing.gate_probability)
    if raised > 1.0:
        noise = replace(noise, gyro_density=noise.gyro_density * np.sqrt(raised))
        message = f"the gyro drifts {np.sqrt(raised):.3g} times its noise in motion: sigma raised to fit"
        hint = "the gyro's scale or vibration is beyond its noise at rest; state it in [imu]"
        warnings.append(Warn("gyro-noise-raised", message, hint))
    forward = replace(forward, heading=_heading(forward))
    progress("smoothing", 0.5)
    smoothed = smooth_run(nodes, start, forward, settings)
    if not smoothed.settled:
        hint = "compare --iterations 20; a log whose heading or tilt is hardly known may have two answers"
        warnings.append(Warn("not-settled", f"the estimate still moves after {smoothed.passes} passes", hint))
    return Estimate(world, noise, nodes, forward, smoothed, (*warnings, *_heading_warnings(forward)))


def consistent_run(
    run_filter: filters.Filter, nodes: Nodes, start: Start, gate: float
) -> tuple[Nodes, FilterRun, float]:
    """Run the filter; where gravity at the stops says that the gyro drifts more in motion than its noise allows, raise
    the gyro's variance until it fits. Return nodes and run, and the factor.

    Gravity at a stop that follows a motion is the one measurement that cannot be an outlier: rejecting it would keep a
    wrong attitude with a small sigma. Its mean NIS over the motions is the factor.
    """
    forward, raised = run_filter(nodes, start, gate), 1.0
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
        forward = run_filter(nodes, start, gate)
    return nodes, forward, raised


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


def _heading(forward: FilterRun) -> str:
    """Return the kind of heading: relative where every measurement of it was refused."""
    found = forward.innovations
    seen = set(found.role[found.used].tolist())
    return forward.heading if seen & {"sun", "compass", "magnetometer", "orientation"} else "relative"


def _heading_warnings(forward: FilterRun) -> tuple[Warn, ...]:
    if forward.heading == "relative":
        return (
            Warn("no-heading", "no heading sensor: yaw is relative to the start",
                 "add a compass, a sun sensor or a magnetometer"),
        )  # fmt: skip
    return ()
