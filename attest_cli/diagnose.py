"""What is wrong with a log, and what is not: every warning of a run in its place, and what was measured where none is.

Nothing is judged here that a run does not judge: a check without a warning shows the number behind it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from .errors import AttestError
from .estimate import Progress, silent
from .filters.choice import choose as choose_filter
from .mounting import up_at_stops
from .nodes.observations import at_stop
from .nodes.sun import sun_angles
from .pipeline import appraise, emptied
from .prepare import choose, prepare
from .readers import read as read_file
from .records import Array, Channel, Fixes, Ints, Log, Recording, Segmentation, Warn, World
from .report.build import Run, build
from .segment import find_segments
from .settings import Effective, Settings
from .world import find_world

OK, WARNING, FAULT = "ok", "warning", "fault"
UNGUARDED = frozenset({"csv", "bag", "db3", "ulog"})
MESSAGES = frozenset({"mcap", "bag", "db3"})  # formats whose messages have a stamp and a time of logging
SENSORS = ("sun", "compass", "magnetometer", "orientation", "odometry", "gps", "gps_velocity", "position", "height")
GROUPS = ("file", "stamps", "values", "units", "mounting", *SENSORS, "stops", "verdict")
PLACES = (
    ("damaged-* cut-* write-ahead-log logger-dropouts decimated-imu", "file", "whole"),
    ("ragged-rows text-cells thousands-separators no-such-column no-text-log rows-without-time", "file", "table"),
    ("several-channels file-not-used channel-empty receiver-speed imu-half-missing", "file", "roles"),
    ("time-unit-guessed stamps-rounded rows-counted zero-stamps zero-header-stamps", "stamps", "resolution"),
    ("rows-out-of-order duplicate-rows batched-stamps", "stamps", "order"),
    ("imu-gap", "stamps", "gaps"),
    ("clock-* no-overlap outside-imu-span accel-late", "stamps", "clocks"),
    ("imu-not-finite", "values", "finite"),
    ("stale-repeats imu-held *stuck* *frozen*", "values", "repeats"),
    ("*-clipped", "values", "range"),
    ("gyro-interval", "stamps", "samples"),
    ("gyro-coarse", "values", "resolution"),
    ("*spikes imu-zero-rows", "values", "spikes"),
    ("accel-scale accel-bias", "units", "gravity"),
    ("gyro-against-* gyro-scale separation", "units", "gyro"),
    ("unit-*", "units", "stated"),
    ("imu-upside-down mounting-*", "mounting", "axes"),
    ("no-stop tilt-from-motion stop-margin", "stops", "found"),
    ("stop-advice", "stops", "advice"),
    ("stop-* *-gravity *-zero_rate", "stops", "stillness"),
    ("sun-reference", "sun", "reference"),
    ("magnetometer-uncalibrated no-magnetic-reference field-reference", "magnetometer", "reference"),
    ("calibration-* gyro-noise-* gyro-bias *bias-* no-bias", "verdict", "noise"),
    ("bound-*", "verdict", "bounds"),
    ("data", "stamps", "rate"),
    ("no-heading north-not-shown not-* no-absolute position", "verdict", "estimate"),
)
"""Codes of warnings and checks -> group and check; of others the name of a sensor in them is the group, else it is the
last."""

SIGMAS = {
    "gravity": "[imu] accel_bias_sigma",
    "zero_rate": "[imu] gyro_noise_density",
    **{role: f"[{role}] sigma_deg" for role in ("sun", "compass", "magnetometer", "orientation")},
}
"""Sensor -> the setting that says how far it can be trusted."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One line: where it belongs, ``ok``, ``warning`` or ``fault``, what was found, and what mends it."""

    group: str
    check: str
    verdict: str
    found: str
    mends: str = ""
    refused: bool = False


def diagnose(paths: Sequence[Path], effective: Effective, progress: Progress = silent) -> list[Finding]:
    """Run every check on the logs of one drive; what refuses is a finding too, and what can still be checked is.

    Returns
    -------
    list of Finding
        In the order of ``GROUPS``. A check that was made and found nothing shows what it measured.
    """
    settings = effective.settings
    told: list[Finding] = []
    recordings = [r for r in (_read(path, settings, told) for path in paths) if r is not None]
    measured = list(_of_files(recordings, settings))
    progress("checking values", 0.3)
    try:
        log = prepare(recordings, settings) if recordings else None
        told += map(_warned, log.warnings if log is not None else ())
    except AttestError as fault:
        told += [_warned(w) for r in recordings for w in r.warnings]
        told.append(_refused("values", fault))
        log = None
    if log is not None:
        measured += _of_values(log, settings)
        recordings = [emptied(recording, log) for recording in recordings]
        _estimated([r.source for r in recordings], recordings, log, effective, told, measured, progress)
    progress("done", 1.0)
    return _in_order(told, measured)


def _read(path: Path, settings: Settings, told: list[Finding]) -> Recording | None:
    try:
        return read_file(path, settings)
    except AttestError as fault:
        told.append(_refused("file", fault))
        return None


def _estimated(
    paths: Sequence[Path], recordings: Sequence[Recording], log: Log, effective: Effective, told: list[Finding],
    measured: list[Finding], progress: Progress,
) -> None:  # fmt: skip
    """Find the stops, smooth, and hear what the run says about itself."""
    settings = effective.settings
    try:
        segmentation = find_segments(log, settings)
        told += map(_warned, segmentation.warnings)
        measured += _of_stops(log, segmentation, find_world(log, settings), settings)
        name, why = choose_filter(log, segmentation, settings)
        measured.append(Finding("verdict", "filter", OK, f"{name}: {why}"))
        run, _ = appraise(paths, tuple(recordings), log, segmentation, effective, progress)
    except AttestError as fault:
        told.append(_refused("verdict", fault))
        return
    early = {*log.warnings, *segmentation.warnings}
    explained = [_warned(w) for w in early.difference(run.warnings)]  # by what the run found
    told[:] = [f for f in told if f not in explained]
    told += [_warned(w) for w in run.warnings if w not in early]
    _judged(run, told, measured)


def _judged(run: Run, told: list[Finding], measured: list[Finding]) -> None:
    """Take the checks of the report that are no warnings of the log, and how sure the attitude is."""
    report = build(run)
    codes = {w["code"] for w in report["warnings"]}
    for check in report["checks"]:
        kind, _, role = check["name"].partition("-")
        if check["name"] in codes:
            continue
        if check["status"] == "PASS":
            measured.append(Finding(*_place(check["name"]), OK, f"{check['fact']}: {check['detail']}"))
            continue
        mends = SIGMAS.get(role, check["detail"]) if kind in {"innovations", "rejected"} else check["detail"]
        found = check["fact"] if mends == check["detail"] else f"{check['fact']}: {check['detail']}"
        told.append(Finding(*_place(check["name"]), FAULT if check["status"] == "FAIL" else WARNING, found, mends))
    found, body = report["statistics"], report["body"]
    measured.append(Finding("mounting", "vehicle", OK, f"{body['axes']} axes: {body['how']}"))
    sigmas = f"heading {found['sigma_heading_max_deg']:.2g} deg, tilt {found['sigma_tilt_max_deg']:.2g} deg at most"
    measured.append(Finding("verdict", "sigma", OK, f"{report['heading']} heading; {sigmas}"))


def _in_order(told: Iterable[Finding], measured: Iterable[Finding]) -> list[Finding]:
    """Sort by group; a number stands only where nothing speaks against it."""
    spoken = list(dict.fromkeys(told))
    taken = {(f.group, f.check) for f in spoken}
    every = [*spoken, *(f for f in measured if (f.group, f.check) not in taken)]
    return sorted(every, key=lambda f: GROUPS.index(f.group))


def _place(code: str) -> tuple[str, str]:
    for patterns, group, check in PLACES:
        if any(fnmatchcase(code, pattern) for pattern in patterns.split()):
            return group, check
    words = code.split("-")
    for role in SENSORS:
        if role in words:
            return role, {"innovations": "noise", "rejected": "outliers", "no": "reference"}.get(words[0], "measured")
    return "verdict", code


def _warned(warn: Warn) -> Finding:
    return Finding(*_place(warn.code), FAULT if warn.lost or warn.fatal else WARNING, warn.message, warn.hint)


def _refused(group: str, fault: AttestError) -> Finding:
    return Finding(group, "refused", FAULT, fault.message, fault.hint, refused=True)


def _of_files(recordings: Sequence[Recording], settings: Settings) -> Iterator[Finding]:
    """Tell what each file holds, and how the stamps of each channel in use run."""
    for r in recordings:
        sums = "the format has no checksums" if r.format in UNGUARDED else "no checksum fails"
        yield Finding("file", "whole", OK, f"{r.source.name}: {r.format}, {r.rows} rows, {sums}")
    try:
        cast = choose(recordings, settings).channels
    except AttestError:
        channels = [channel for r in recordings for channel in r.channels if channel.stamps_ns.size]
    else:
        channels = list({channel.name: channel for channel in cast.values()}.values())
        roles = ", ".join(f"{role} {channel.name}" for role, channel in cast.items())
        yield Finding("file", "roles", OK, roles)
    logged = _logged(recordings, settings)
    for channel in channels:
        yield Finding("stamps", channel.name, OK, _stamps(channel, logged.get(channel.name), settings))


def _logged(recordings: Sequence[Recording], settings: Settings) -> Mapping[str, Ints]:
    """Return, per channel of messages, when they were logged: the same files read by that clock."""
    if settings.time.source != "header":
        return {}
    by_log = settings.model_copy(update={"time": settings.time.model_copy(update={"source": "log"})})
    again = (read_file(r.source, by_log) for r in recordings if r.format in MESSAGES)
    return {channel.name: channel.stamps_ns for r in again for channel in r.channels}


def _stamps(channel: Channel, logged_ns: Ints | None, settings: Settings) -> str:
    """Tell rate, steps back, gaps, and how far the stamps stand from the time of logging."""
    steps = np.diff(channel.stamps_ns) * 1e-9
    if not steps.size:
        return "a single stamp"
    ahead = steps[steps > 0.0]
    period = float(np.median(ahead)) if ahead.size else np.nan
    gaps = int(np.count_nonzero(steps > max(settings.time.max_gap_s, 5.0 * period)))
    text = (
        f"{channel.stamps_ns.size} rows, {1.0 / period:.4g} Hz, {np.count_nonzero(steps == 0.0)} repeats, "
        f"{np.count_nonzero(steps < 0.0)} steps back, {gaps} gaps, longest step {steps.max():.3g} s"
    )
    if logged_ns is None or logged_ns.size != channel.stamps_ns.size:
        return text
    late = (logged_ns - channel.stamps_ns) * 1e-9
    return f"{text}; logged {np.median(late):.3g} s ({late.min():.3g} to {late.max():.3g}) after its stamp"


def _of_values(log: Log, settings: Settings) -> Iterator[Finding]:
    """Tell what prepared values are like where no warning spoke of them."""
    t, gyro, accel = log.imu.t, np.abs(log.imu.gyro_b), np.abs(log.imu.accel_b)
    kept = log.coverage
    steps = np.diff(t)
    yield Finding("stamps", "resolution", OK, f"smallest step {steps.min():.3g} s, median {np.median(steps):.3g} s")
    yield Finding("stamps", "order", OK, "no disorder, no repeats")
    yield Finding("stamps", "gaps", OK, f"none over {settings.time.max_gap_s:g} s in the IMU")
    yield Finding("stamps", "clocks", OK, "all channels in use run beside the IMU")
    yield Finding("values", "finite", OK, f"{kept['rows_used']:.0f} of {kept['rows_in']:.0f} IMU rows used")
    equal = ~np.any(np.diff(log.imu.gyro_b, axis=0), axis=1) & ~np.any(np.diff(log.imu.accel_b, axis=0), axis=1)
    runs = np.diff(np.flatnonzero(np.concatenate([[True], ~equal, [True]])))
    yield Finding("values", "repeats", OK, f"at most {runs.max()} equal IMU rows in a row")
    yield Finding(
        "values", "range", OK, f"gyro up to {gyro.max():.3g} rad/s, specific force to {accel.max():.3g} m/s^2"
    )
    yield Finding("values", "spikes", OK, "no sample stands alone")
    yield Finding("units", "stated", OK, "stated, or as physics has them")
    for role, fixes in log.fixes.items():
        if role in SENSORS:
            first, last = fixes.t[0], fixes.t[-1]
            text = f"{len(fixes.t)} measurements of {fixes.channel} from {first:.1f} to {last:.1f} s"
            yield Finding(role, "measured", OK, text)


def _of_stops(log: Log, segmentation: Segmentation, world: World, settings: Settings) -> Iterator[Finding]:
    """Tell what the stops show: how many, gravity, which way is up, and the angles of the reference directions."""
    stops = segmentation.stops
    seconds = sum(s.end - s.start for s in stops)
    yield Finding("stops", "found", OK, f"{len(stops)} stops, {seconds:.0f} s in all, by {segmentation.source}")
    still = at_stop(log.imu.t, segmentation)
    norm = float(np.median(np.linalg.norm(log.imu.accel_b[still if still.any() else slice(None)], axis=1)))
    place = "at stops" if still.any() else "in motion"
    yield Finding("units", "gravity", OK, f"specific force {place} {norm:.4g} m/s^2, gravity {world.gravity:.4g}")
    if not stops:
        return
    up = up_at_stops(segmentation, log.imu)
    lean = float(np.degrees(np.arccos(np.clip(up[2], -1.0, 1.0))))
    yield Finding("mounting", "axes", OK, f"z axis {lean:.1f} deg from up at the stops")
    if "sun" in log.fixes and world.sun_n is not None:
        yield _sun(log, segmentation, log.fixes["sun"], world.sun_n, settings)
    if "magnetometer" in log.fixes:
        yield Finding("magnetometer", "reference", OK, _field(log, segmentation, log.fixes["magnetometer"], world))


def _sun(log: Log, segmentation: Segmentation, fixes: Fixes, sun_n: Array, settings: Settings) -> Finding:
    """Tell the angle of the sun from up at the stops beside that of its reference."""
    angles = sun_angles(fixes, log, segmentation, sun_n, settings)
    if not len(angles):
        return Finding("sun", "reference", OK, "not seen at a stop")
    found, given = np.degrees(np.median(angles, axis=0))
    return Finding("sun", "reference", OK, f"{found:.1f} deg from up at the stops, its reference {given:.1f} deg")


def _field(log: Log, segmentation: Segmentation, fixes: Fixes, world: World) -> str:
    """Tell the size of the magnetic field and its angle from up beside those of the reference."""
    size = np.linalg.norm(fixes.values, axis=1)
    varies = float(np.percentile(size, 97.5) - np.percentile(size, 2.5)) / float(np.median(size))
    text = f"{1e6 * np.median(size):.3g} uT, varies by {100.0 * varies:.2g} %"
    still = at_stop(fixes.t, segmentation)
    if still.any():
        text += f", {_angle(fixes.values[still], _up(log, fixes.t[still])):.1f} deg from up"
    if world.field_n is None:
        return f"{text}; no reference"
    given = _angle(world.field_n[None], np.eye(3)[2:])
    return f"{text}; reference {1e6 * np.linalg.norm(world.field_n):.3g} uT, {given:.1f} deg"


def _up(log: Log, t: Array) -> Array:
    """Return the specific force (m, 3) at times ``t``, which points up at a stop."""
    return np.stack([np.interp(t, log.imu.t, axis) for axis in log.imu.accel_b.T], axis=1)


def _angle(a: Array, b: Array) -> float:
    """Return the median angle between rows, deg."""
    cosine = np.sum(a * b, axis=1) / (np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1))
    return float(np.degrees(np.median(np.arccos(np.clip(cosine, -1.0, 1.0)))))
