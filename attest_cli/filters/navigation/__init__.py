"""The navigation smoother: attitude, velocity, position and sensor errors together, from every sensor of the log."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ...maths.kalman import Errors
from ...nodes import Nodes
from ...records import FilterRun, Smoothed, Warn
from ...settings import Settings
from .. import Drive, Forward, scale
from . import axes, frame, offsets, solve
from .aids import Place
from .north import counted
from .problem import Problem
from .rounds import Navigated, known_offsets, left_lags, navigate
from .shown import shown

SCATTERED = 3.0  # times the sigma of fixes
WORSE_GYRO, WORST_GYRO = 5e-3, 2e-2  # rad/s/sqrt(Hz): twenty times that of a phone, 70 deg/sqrt(h)
NO_WEATHER_M = 6.0  # of height in ten minutes: 0.7 hPa
FAR_WORSE = 10.0  # times its noise at rest
CONTRADICTED = 4.0  # mean square of innovations over what is expected


def forward(drive: Drive) -> Forward:
    """Solve the drive and return its last forward pass, from which every smoother goes back."""
    done, axes_told = _with_own_axes(drive)
    wanders = _wanders(done)
    if wanders:
        done, axes_told = _with_own_axes(replace(drive, settings=_as_rover(drive.settings)))
    left = left_lags(done) | frame.far_lags(drive.log, done)
    late = [_late(role, lag) for role, lag in sorted(done.learnt.lags.items()) if role not in left]
    late += [_too_late(role, lag) for role, lag in sorted(left.items())]
    doubts = frame.of_receiver(drive)
    known = known_offsets(drive, done)
    doubts += [] if left or doubts else frame.contradicted(drive.log, done, drive.world.gravity)
    doubts += [] if left or doubts else offsets.doubts(known, _shower(done))
    scattered = list(_scattered(drive, done))
    doubts += [] if left or doubts else _noisy(done, explained=bool(scattered))
    doubts += [*scattered, *_wandering(done)]
    told = (*wanders, *axes_told, *done.begun.warnings, *done.problem.warnings, *late, *doubts)
    nodes = _scaled(done.nodes, done.problem, done.found)
    return Forward(_run(done, known), done.begun.noise, nodes, None, told, shown(done), done.learnt.odometry)


def _wanders(done: Navigated) -> tuple[Warn, ...]:
    """Say whether a log that was taken for hand-held goes further than a room: then its stops contradict the bound."""
    roles = {a.role for a in done.problem.aids}
    if not {"place", "zero_velocity"} <= roles:
        return ()
    found = solve.innovations(done.found.found, done.found.rows)
    stops, place = (found.nis[found.role == role] / 3.0 for role in ("zero_velocity", "place"))
    if not len(stops) or max(float(np.mean(stops)), float(np.mean(place))) < CONTRADICTED:
        return ()
    return (Warn("not-in-one-place", "the log goes further than a hand would: its place is left free",
                 "[navigation] motion says what it is; --filter indirect is often as good"),)  # fmt: skip


def _with_own_axes(drive: Drive) -> tuple[Navigated, tuple[Warn, ...]]:
    """Return the drive solved; without the errors of the gyro's scale and axes, and what they are, where it contradicts
    what is assumed of them, and they leave less to explain.
    """
    done = navigate(drive)
    if not axes.contradicted(drive.log, done):
        return done, ()
    better = axes.mended(drive, navigate(axes.widened(drive, axes.WIDE)))
    again = navigate(better[0]) if better is not None else done
    if better is None or axes.misfit(again) >= axes.misfit(done):
        return done, ()
    return again, (scale.told_axes(*better[1:]),)


def _as_rover(settings: Settings) -> Settings:
    return settings.model_copy(update={"navigation": settings.navigation.model_copy(update={"motion": "rover"})})


def _late(role: str, lag: float) -> Warn:
    word = "late" if lag > 0 else "early"
    return Warn(f"{role}-late", f"{role} is {abs(lag):.3f} s {word} against the IMU: corrected")


def _too_late(role: str, lag: float) -> Warn:
    word = "late" if lag > 0 else "early"
    message = f"{role} is {abs(lag):.1f} s or more {word} against the IMU: more than is corrected"
    return Warn(f"{role}-late", message, "mend its clock: leap seconds, a time zone, a delay of the link?", fatal=True)


def _scattered(drive: Drive, done: Navigated) -> Iterator[Warn]:
    """Say which fixes scatter, or wander, far more than the log says of them, or than is usual of a receiver."""
    colours = {state.name: state for state in done.problem.layout.coloured()}
    for place in (aid for aid in done.problem.aids if isinstance(aid, Place)):
        stated = "sigma_m" in getattr(drive.settings, place.role).model_fields_set
        if place.role != "gps" and drive.log.fixes[place.role].sigma is None and not stated:
            continue  # nobody knows what it should be
        found = float(np.nanmedian(place.sigma[:, :2]))
        expected = found / done.learnt.factors.get(place.role, 1.0)
        found = float(np.hypot(found, np.max(colours[f"{place.role} drift"].sigma)))
        if found > SCATTERED * expected:
            message = (
                f"{place.role} scatters by {found:.2g} m, where {expected:.2g} m were expected: its sigma is widened"
            )
            hint = f"outliers, a jump, reflections? [{place.role}] sigma_m states it"
            yield Warn(f"{place.role}-scatters", message, hint)


def _wandering(done: Navigated) -> Iterator[Warn]:
    """Say where a height wanders as no weather makes it: it does not count then, whatever the reason."""
    for state in (state for state in done.problem.layout.coloured() if state.name == "height drift"):
        found = float(np.max(state.sigma))
        if found > NO_WEATHER_M:
            message = f"height wanders by {found:.2g} m against the fixes: it hardly counts"
            yield Warn("height-wanders", message, "is its sign, unit or clock wrong, or is it that of a lift, or wind?")


def _noisy(done: Navigated, *, explained: bool) -> Iterator[Warn]:
    """Say where the drive fits only a gyro that is worse than any: then something contradicts it; no failure where
    fixes that scatter explain it.
    """
    if "gyro" not in done.learnt.factors:
        return
    found = float(np.sqrt(np.median(done.problem.inertial.gyro)))
    times = found / max(done.begun.noise.gyro_density, 1e-9)
    if found > WORSE_GYRO and times > FAR_WORSE:
        message = f"all sensors together fit only a gyro {times:.0f} times as noisy in motion as at rest"
        hint = "something contradicts it: a clock, an axis, a sign or a unit, of the gyro or of what aids it"
        yield Warn("gyro-noise-in-motion", message, hint, fatal=found > WORST_GYRO and not explained)


def _shower(done: Navigated) -> str:
    """Return the sensor whose way shows the heading."""
    return next((aid.role for aid in done.problem.aids if isinstance(aid, Place)), "gps_velocity")


def _run(done: Navigated, known: list[offsets.Offset]) -> FilterRun:
    """Return the last pass as a filter run that every smoother reads."""
    begun, found, nodes = done.begun.run, done.found, done.nodes
    bias = done.problem.layout.parts["gyro bias"]
    at = found.at.moved(found.found.x)
    mean_known = "earth field" in done.problem.layout and bool(nodes.moving.any())
    relative = solve.relative_heading(found, nodes.t, nodes.moving) if mean_known else None

    def read(errors: Errors) -> Smoothed:
        errors = offsets.settled(at.x, errors, known)
        return counted(solve.read(found, nodes.t, bias, relative, errors), done.problem.north)

    return FilterRun(
        nodes.t, at.q, at.x[:, bias], found.found.chain, None, solve.innovations(found.found, found.rows), nodes.moving,
        done.problem.heading, begun.start_in_motion,
        read, beforehand=offsets.beforehand(at.x, known), datum=offsets.datum(found.found.chain.P, at.q, known),
    )  # fmt: skip


def _scaled(nodes: Nodes, problem: Problem, found: solve.Solution) -> Nodes:
    """Return the nodes with the gyro's scale taken out of their samples, from which full rate is made."""
    if "gyro scale" not in problem.layout:
        return nodes
    M = found.smoothed.x[:, problem.layout.parts["gyro scale"]].mean(axis=0).reshape(3, 3)
    samples = nodes.samples
    return replace(nodes, samples=replace(samples, rate=samples.rate - samples.rate @ M.T))
