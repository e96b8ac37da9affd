"""The run, in order: one short function per command. This page is the architecture."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from . import assess, mounting, position, tables
from .errors import AttestError
from .filters import indirect
from .filters.alignment import Start, align
from .maths import rotation
from .mounting import Mounting
from .nodes import Nodes, build_nodes
from .nodes.noise import Noise, find_noise
from .nodes.observations import observe
from .position import Position
from .prepare import prepare
from .readers import read as read_file
from .readers.result import read_result
from .records import FilterRun, Log, Recording, Segmentation, Smoothed, Warn, World
from .report import write_pages
from .report.build import Run, build
from .segment import find_segments
from .settings import Effective, Settings
from .smoothers import SMOOTHERS, backward_estimate, gauss_newton
from .track import Attitude, full_rate
from .world import find_world
from .writers import write_track
from .writers.files import atomic_write, check_output, write_csv_rows, write_table
from .writers.folder import result_folder
from .writers.logs import write_recording

Progress = Callable[[str, float], None]
AUTO_PASSES = 6
IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


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


def read(paths: Sequence[Path], settings: Settings) -> tuple[tuple[Recording, ...], Log]:
    """Read the files of one drive: as found, and in SI on one time base."""
    recordings = tuple(read_file(path, settings) for path in paths)
    return recordings, prepare(recordings, settings)


def estimate(log: Log, segmentation: Segmentation, settings: Settings, progress: Progress = silent) -> Estimate:
    """Run the forward filter and the smoother over a log: nodes, alignment, forward, backward, Gauss-Newton where it pays."""
    world, noise = find_world(log, settings), find_noise(log, segmentation, settings)
    observations, warnings = observe(log, segmentation, world, noise, settings)
    nodes = build_nodes(log, segmentation, observations, noise, settings)
    start = align(nodes, settings.imu.gyro_bias_sigma, magnetic=world.field_n is None)
    progress("forward filter", 0.3)
    forward = indirect.run(nodes, start, settings.smoothing.gate_probability)
    progress("smoothing", 0.5)
    smoothed = smooth_run(nodes, start, forward, settings)
    return Estimate(world, noise, nodes, forward, smoothed, tuple(warnings) + _heading_warnings(forward))


def smooth_run(nodes: Nodes, start: Start, forward: FilterRun, settings: Settings) -> Smoothed:
    """Smooth a forward run; then Gauss-Newton passes where asked for, or (auto) where a linearisation may have been poor."""
    cfg = settings.smoothing
    smoothed = SMOOTHERS[cfg.smoother](forward)
    if cfg.smoother not in {"two-filter", "rts"}:
        return smoothed
    rejected = float(np.mean(~forward.innovations.used)) if len(forward.innovations.used) else 0.0
    doubtful = forward.start_in_motion or rejected > gauss_newton.DOUBTFUL_SHARE
    passes = (AUTO_PASSES if doubtful else 0) if cfg.iterations == "auto" else int(cfg.iterations)
    if passes == 0:
        return smoothed
    again = nodes.rebuild(smoothed.bias)
    return gauss_newton.refine(again, start, smoothed, forward.innovations, passes, cfg.gate_probability, fixed=cfg.iterations != "auto")


def _heading_warnings(forward: FilterRun) -> tuple[Warn, ...]:
    if forward.heading == "relative":
        return (
            Warn("no-heading", "no heading sensor: yaw is relative to the start",
                 "add a compass, a sun sensor or a magnetometer"),
        )  # fmt: skip
    return ()


def locate(log: Log, segmentation: Segmentation, est: Estimate, attitude: Attitude, settings: Settings) -> tuple[Position | None, Mounting | None, list[Warn]]:
    """Find how the IMU sits in the vehicle, where odometry shows it, and integrate the position."""
    odometry, mode = log.fixes.get("odometry"), settings.smoothing.position
    warnings: list[Warn] = []
    seat = None
    if odometry is not None and settings.imu.mounting == "auto":
        seat = mounting.find_mounting(log.imu, attitude.q, segmentation, odometry, est.world.gravity)
        if seat is not None and mounting.axes_agree(seat.q_bv):
            seat = Mounting(IDENTITY, seat.sigma_deg, seat.lag, "IMU and vehicle axes agree")
    if mode == "none":
        return None, seat, warnings
    if mode == "odometry" and odometry is None:
        raise AttestError(f"{log.sources[0].name}: position from odometry, but the log has none", "use --position auto")
    if odometry is not None and mode in {"auto", "odometry"}:
        if seat is None and not _upright(segmentation, log):
            warnings.append(
                Warn("odometry-not-used", "odometry not used: the drive does not show how the IMU sits in the vehicle",
                     "give [imu] mounting")
            )  # fmt: skip
        else:
            lag = seat.lag if seat else 0.0
            shifted = type(odometry)(odometry.role, odometry.channel, odometry.t - lag, odometry.values, odometry.sigma)
            if lag:
                warnings.append(Warn("odometry-late", f"odometry stamps are {abs(lag):.2f} s {'late' if lag > 0 else 'early'} against the IMU: corrected"))
            q_bv = seat.q_bv if seat else IDENTITY
            return position.odometry_position(log.imu, attitude.q, q_bv, est.smoothed, segmentation, shifted, settings), seat, warnings
    if not segmentation.stops:
        return None, seat, warnings
    literal = mode == "literal"
    found = position.inertial_position(
        log.imu, attitude.q, est.nodes, est.smoothed, segmentation, settings, est.world.gravity, literal
    )
    return found, seat, warnings


def _upright(segmentation: Segmentation, log: Log) -> bool:
    """Return whether gravity at the stops lies along the IMU's z axis, within 30 deg: then its x axis is taken as forward."""
    if not segmentation.stops:
        return False
    up = np.mean([log.imu.accel_b[s.first : s.last].mean(axis=0) for s in segmentation.stops], axis=0)
    return bool(up[2] > np.cos(np.radians(30.0)) * np.linalg.norm(up))


def body_axes(seat: Mounting | None, settings: Settings) -> tuple[np.ndarray[Any, np.dtype[np.float64]], dict[str, Any]]:
    """Return the turn from the track's body axes to the IMU's, and how the report tells it (``q_body_sensor``)."""
    given = settings.imu.mounting
    if given != "auto":
        return IDENTITY, {"axes": "vehicle", "q_body_sensor": list(given), "how": "mounting of the settings"}
    if settings.body.axes == "vehicle" and seat is None:
        raise AttestError("the drive does not show the vehicle's axes", "give [imu] mounting, or use --body imu")
    if settings.body.axes == "imu" or seat is None:
        return IDENTITY, {"axes": "imu", "q_body_sensor": IDENTITY.tolist(), "how": "axes of the IMU"}
    return seat.q_bv, {"axes": "vehicle", "q_body_sensor": rotation.conjugate(seat.q_bv).tolist(), "how": seat.how}


def smooth(
    paths: Sequence[Path], effective: Effective, output: Path, *, overwrite: bool = False, progress: Progress = silent
) -> dict[str, Any]:
    """Run the main job and write the result folder; return ``report.json``."""
    settings = effective.settings
    with result_folder(output, overwrite=overwrite, inputs=paths) as folder:
        progress("reading", 0.0)
        recordings, log = read(paths, settings)
        progress("finding stops", 0.2)
        segmentation = find_segments(log, settings)
        est = estimate(log, segmentation, settings, progress)
        progress("position", 0.6)
        attitude = full_rate(est.nodes, est.smoothed, log.imu.t)
        place, seat, warnings = locate(log, segmentation, est, attitude, settings)
        run, columns = _assemble(paths, recordings, log, effective, segmentation, est, attitude, place, seat, warnings)
        progress("writing", 0.7)
        return _write(folder, run, columns, settings, progress)


def _assemble(
    paths: Sequence[Path], recordings: tuple[Recording, ...], log: Log, effective: Effective, segmentation: Segmentation,
    est: Estimate, attitude: Attitude, place: Position | None, seat: Mounting | None, warnings: Sequence[Warn],
) -> tuple[Run, tables.Columns]:  # fmt: skip
    """Bring everything into body axes, judge it, and make the columns of the track."""
    settings = effective.settings
    q_bv, body = body_axes(seat, settings)
    backward = backward_estimate(est.forward, est.smoothed.information)
    passes = {
        "forward": assess.Pass(est.forward.q, est.forward.bias, est.forward.chain.P),
        "backward": assess.Pass(*backward),
        "smoothed": assess.Pass(est.smoothed.q, est.smoothed.bias, est.smoothed.P),
    }
    threshold = settings.smoothing.stop_threshold_deg
    t = est.nodes.t
    relative = est.forward.heading == "relative"
    rows = assess.segment_table(log, segmentation, t, passes, place, est.noise, threshold, relative)
    advice = assess.stop_advice(est.forward, est.smoothed, segmentation, est.noise, threshold)
    turned = {name: p.turned(q_bv) for name, p in passes.items()}
    told = (*log.warnings, *segmentation.warnings, *est.warnings, *warnings)
    run = Run(
        tuple(paths), recordings, log, effective, est.world, est.noise, segmentation, est.forward, est.smoothed, turned,
        place, seat, body, rows, advice, told, settings.smoothing.smoother,
    )  # fmt: skip
    R = rotation.matrix(q_bv)
    in_body = Attitude(
        rotation.continuous(rotation.multiply(attitude.q, q_bv)), attitude.bias @ R, attitude.variance_n,
        np.abs(attitude.bias_variance @ R**2),
    )  # fmt: skip
    return run, tables.track_columns(log, in_body, t, place, segmentation, settings.world.frame, None)


def _write(folder: Path, run: Run, columns: tables.Columns, settings: Settings, progress: Progress) -> dict[str, Any]:
    """Write every file of the result; the report comes last."""
    report = build(run)
    metadata = _metadata(run, report)
    for name in settings.output.formats:
        write_track(columns, metadata, folder / f"track.{name}", name)
    t = run.forward.t
    relative = run.forward.heading == "relative"
    nodes = tables.pass_columns(run.log, t, run.passes, run.position, run.segmentation, relative)
    write_table(nodes, folder / "passes.parquet", metadata)
    write_table(tables.innovation_columns(run.forward.innovations, t, run.segmentation), folder / "innovations.parquet", metadata)
    write_csv_rows(_padded(run.segments), folder / "segments.csv")
    _write_report(folder, report)
    progress("drawing", 0.8)
    report["pages"] = write_pages(read_result(folder), folder, settings.output.theme)
    _write_report(folder, report)
    progress("done", 1.0)
    return report


def _metadata(run: Run, report: Mapping[str, Any]) -> dict[str, str]:
    frame = run.effective.settings.world.frame
    return {
        "attest_version": report["attest_version"],
        "frame": "ENU world, FLU body" if frame == "enu" else "NED world, FRD body",
        "quaternion": "Hamilton, body to world, w x y z",
        "angles": "fixed axes x, y, z (REP-103), degrees",
        "sigma": "one standard deviation; attitude about the world's axes",
        "heading": report["heading"],
        "body_axes": report["body"]["axes"],
        "q_body_sensor": json.dumps(report["body"]["q_body_sensor"]),
        "t0_ns": str(run.log.t0_ns),
        "sources": ", ".join(f"{f['name']} sha256:{f['sha256']}" for f in report["input"]["files"]),
    }


def _padded(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Give every row the columns of all."""
    names = list(dict.fromkeys(key for row in rows for key in row))
    names.append(names.pop(names.index("checks")))
    return [{name: row.get(name) for name in names} for row in rows]


def _json(report: Mapping[str, Any]) -> str:
    def clean(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {str(k): clean(v) for k, v in value.items()}
        if isinstance(value, list | tuple):
            return [clean(v) for v in value]
        if isinstance(value, float | np.floating):
            return float(value) if np.isfinite(value) else None
        return value.item() if isinstance(value, np.generic) else value

    return json.dumps(clean(report), indent=1, ensure_ascii=False) + "\n"


def _write_report(folder: Path, report: Mapping[str, Any]) -> None:
    with atomic_write(folder / "report.json") as temporary:
        temporary.write_text(_json(report), encoding="utf-8")


def redraw(folder: Path, theme: str, progress: Progress = silent) -> list[Path]:
    """Draw the pages of a result again, from the folder alone."""
    result = read_result(folder)
    progress("drawing", 0.2)
    pages = write_pages(result, folder, theme)
    _write_report(folder, {**result.report, "pages": pages})
    return [folder / "report" / page["file"] for page in pages]


def segments(paths: Sequence[Path], effective: Effective, output: Path | None, overwrite: bool = False) -> dict[str, Any]:
    """Find stops and motions only; draw the stop detector's page where ``output`` names a file."""
    _, log = read(paths, effective.settings)
    found = find_segments(log, effective.settings)
    noise = find_noise(log, found, effective.settings)
    rows = [
        {
            "index": s.index, "kind": "motion" if s.motion else "stop", "start_s": s.start, "end_s": s.end,
            "duration_s": s.end - s.start, "used_start_s": s.used_start, "used_end_s": s.used_end,
        }
        for s in found.segments
    ]  # fmt: skip
    told = [{"code": w.code, "message": w.message, "hint": w.hint, "lost": w.lost} for w in (*log.warnings, *found.warnings)]
    detector = {"enter": found.enter, "leave": found.leave, "margin": found.margin, "source": found.source,
                "gyro_noise_density": noise.gyro_density, "accel_noise_density": noise.accel_density}  # fmt: skip
    return {"segments": rows, "warnings": told, "detector": detector}


def plan(paths: Sequence[Path], effective: Effective) -> dict[str, Any]:
    """Say what a run would do (``--dry-run``): channels, segments, sensors, methods. Writes nothing."""
    settings = effective.settings
    recordings, log = read(paths, settings)
    found = find_segments(log, settings)
    world, noise = find_world(log, settings), find_noise(log, found, settings)
    observations, warnings = observe(log, found, world, noise, settings)
    counts: dict[str, int] = {}
    for o in observations:
        counts[o.role] = counts.get(o.role, 0) + 1
    used = {f.channel: role for role, f in log.fixes.items()}
    return {
        "log": {"files": ", ".join(p.name for p in paths), "duration_s": round(float(log.imu.t[-1]), 3), "samples": len(log.imu.t)},
        "channels": [
            {"name": c.name, "type": c.kind, "rows": len(c.stamps_ns), "used as": used.get(c.name, c.role or "not used")}
            for r in recordings for c in r.channels
        ],
        "segments": {"stops": len(found.stops), "motions": len(found.motions), "found by": found.source},
        "measurements": counts,
        "frame": {"world": settings.world.frame, "body": settings.body.axes},
        "methods": {"filter": "indirect", "smoother": settings.smoothing.smoother, "position": settings.smoothing.position},
        "warnings": [w.message for w in (*log.warnings, *found.warnings, *warnings)],
    }  # fmt: skip


def simulate(scenario: str, output: Path, options: Mapping[str, Any], overwrite: bool = False) -> list[Path]:
    """Simulate a drive; write the log, its truth, and the ``attest.toml`` that goes with it.

    ``output`` with a suffix names one log; without one, the log is written in all three formats.
    """
    from .simulate import SCENARIOS, RoverOptions

    if scenario not in SCENARIOS:
        raise AttestError(f"no scenario {scenario!r}", f"choose one of {', '.join(SCENARIOS)}")
    logs = [output] if output.suffix in LOG_SUFFIXES else [output.with_name(output.name + s) for s in LOG_SUFFIXES]
    truth, config = logs[0].with_suffix(".truth.parquet"), logs[0].parent / "attest.toml"
    for path in (*logs, truth, config):
        check_output(path, overwrite=overwrite)
    made = SCENARIOS[scenario](RoverOptions(**options))
    logs[0].parent.mkdir(parents=True, exist_ok=True)
    for path in logs:
        write_recording(made.log, path)
    write_table(dict(made.truth), truth, {"scenario": scenario, **{k: str(v) for k, v in options.items()}})
    with atomic_write(config) as temporary:
        temporary.write_text(_toml(made.settings), encoding="utf-8")
    return [*logs, truth, config]


LOG_SUFFIXES = (".csv", ".mcap", ".parquet")


def _toml(tables_: Mapping[str, Mapping[str, Any]]) -> str:
    """Spell a config of plain values."""
    lines = []
    for name, values in tables_.items():
        lines.append(f"[{name}]")
        lines += [f"{key} = {json.dumps(list(v) if isinstance(v, tuple) else v)}" for key, v in values.items()]
        lines.append("")
    return "\n".join(lines)
