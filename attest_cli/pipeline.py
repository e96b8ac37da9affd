"""The run, in order: one short function per command. This page is the architecture."""

from __future__ import annotations

import ctypes
import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from . import __version__, assess, tables
from .errors import AttestError
from .estimate import Estimate, Progress, estimate, silent
from .filters import named
from .locate import Vehicle, locate
from .nodes.noise import find_noise
from .nodes.observations import observe
from .position import Position
from .prepare import prepare
from .readers import read as read_file
from .readers.result import read_result
from .records import Array, Log, Recording, Result, Segmentation, Warn
from .report import Report, write_pages
from .report.build import Run, build
from .segment import find_segments
from .settings import Effective, Settings
from .smoothers import backward_estimate
from .track import full_rate
from .world import find_world
from .writers import write_track
from .writers.files import atomic_write, check_output, write_csv_rows, write_table
from .writers.folder import result_folder
from .writers.logs import write_recording

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, KEPT_BYTES = -1, -3, 1 << 30  # malloc.h
FRAMES = {"enu": "ENU world, FLU body", "ned": "NED world, FRD body"}
LOG_SUFFIXES = (".csv", ".mcap", ".parquet")
DETECTOR_STEP_S = 0.1  # the statistic is drawn at this step


def keep_memory() -> None:
    """Ask the C library to keep freed arrays for the next ones: page faults cost a tenth of a long log's time."""
    with suppress(OSError, AttributeError):  # not glibc
        libc = ctypes.CDLL(None)
        libc.mallopt(M_MMAP_THRESHOLD, KEPT_BYTES)
        libc.mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)


def read(paths: Sequence[Path], settings: Settings) -> tuple[tuple[Recording, ...], Log]:
    """Read the files of one drive: as found, and in SI on one time base."""
    recordings = tuple(read_file(path, settings) for path in paths)
    return recordings, prepare(recordings, settings)


def smooth(
    paths: Sequence[Path], effective: Effective, output: Path, *, overwrite: bool = False, progress: Progress = silent
) -> dict[str, Any]:
    """Run the main job and write the result folder; return ``report.json``."""
    settings = effective.settings
    keep_memory()
    with result_folder(output, overwrite=overwrite, inputs=paths) as folder:
        progress("reading", 0.0)
        recordings, log = read(paths, settings)
        progress("finding stops", 0.2)
        segmentation = find_segments(log, settings)
        est = estimate(log, segmentation, settings, progress)
        progress("position", 0.6)
        q = full_rate(est.nodes, est.smoothed, log.imu.t)
        place, vehicle, warnings = locate(log, segmentation, est, q, settings)
        run, track = _assemble(paths, recordings, log, effective, segmentation, est, q, place, vehicle, warnings)
        progress("writing", 0.7)
        return _write(folder, run, track, settings, progress)


def _assemble(
    paths: Sequence[Path], recordings: tuple[Recording, ...], log: Log, effective: Effective,
    segmentation: Segmentation, est: Estimate, q: Array, place: Position | None, vehicle: Vehicle,
    warnings: Sequence[Warn],
) -> tuple[Run, tables.Track]:  # fmt: skip
    """Bring everything into body axes, judge it, and prepare the track."""
    settings = effective.settings
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
    turned = {name: p.turned(vehicle.q_bv, vehicle.sigma) for name, p in passes.items()}
    told = (*log.warnings, *segmentation.warnings, *est.warnings, *warnings)
    run = Run(
        tuple(paths), recordings, log, effective, est.world, est.noise, segmentation, est.forward, est.smoothed, turned,
        assess.separation(passes["forward"], passes["backward"]), place, vehicle.told, rows, advice, told,
        settings.smoothing.smoother,
    )  # fmt: skip
    track = tables.Track(log, q, est.smoothed, place, segmentation, vehicle.q_bv, vehicle.sigma, settings.world.frame)
    return run, track


def _write(folder: Path, run: Run, track: tables.Track, settings: Settings, progress: Progress) -> dict[str, Any]:
    """Write every file of the result; the report comes last."""
    report = build(run)
    metadata = _metadata(run, report)
    for name in settings.output.formats:
        write_track(track, metadata, folder / f"track.{name}", name)
    t = run.forward.t
    relative = run.forward.heading == "relative"
    metadata |= {"frame": FRAMES["enu"]}  # the pages are drawn from these
    nodes = tables.pass_columns(run.log, t, run.passes, run.separation, run.position, run.segmentation, relative)
    write_table(nodes, folder / "passes.parquet", metadata)
    write_table(
        tables.innovation_columns(run.forward.innovations, t, run.segmentation),
        folder / "innovations.parquet",
        metadata,
    )
    write_csv_rows(_padded(run.segments), folder / "segments.csv")
    _write_report(folder, report)
    progress("drawing", 0.8)
    pages = write_pages(read_result(folder), folder, settings.output.theme)
    progress("done", 1.0)
    return _write_report(folder, {**report, "pages": pages})


def _metadata(run: Run, report: Mapping[str, Any]) -> dict[str, str]:
    frame = run.effective.settings.world.frame
    return {
        "attest_version": report["attest_version"],
        "frame": FRAMES[frame],
        "quaternion": "Hamilton, body to world, w x y z",
        "angles": "fixed axes x, y, z (REP-103), degrees",
        "sigma": "one standard deviation; attitude about the world's axes",
        "heading": report["heading"],
        "body_axes": report["body"]["axes"],
        "q_body_sensor": json.dumps(report["body"]["q_body_sensor"]) + (" (FLU)" if frame == "ned" else ""),
        "t0_ns": str(run.log.t0_ns),
        "sources": ", ".join(f"{f['name']} sha256:{f['sha256']}" for f in report["input"]["files"]),
    }


def _padded(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Give every row the columns of all."""
    names = list(dict.fromkeys(key for row in rows for key in row))
    names.append(names.pop(names.index("checks")))
    return [{name: row.get(name) for name in names} for row in rows]


def _write_report(folder: Path, report: Mapping[str, Any]) -> dict[str, Any]:
    """Write the report, checked against its model (and so its schema); what is not a number becomes null."""
    checked = Report.model_validate(report).model_dump(mode="json")
    with atomic_write(folder / "report.json") as temporary:
        temporary.write_text(
            json.dumps(checked, indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8"
        )
    return checked


def redraw(folder: Path, theme: str | None, progress: Progress = silent) -> list[Path]:
    """Draw the pages of a result again, from the folder alone."""
    result = read_result(folder)
    progress("drawing", 0.2)
    pages = write_pages(result, folder, theme)
    _write_report(folder, {**result.report, "pages": pages})
    return [folder / "report" / page["file"] for page in pages]


def segments(
    paths: Sequence[Path], effective: Effective, output: Path | None, overwrite: bool = False
) -> dict[str, Any]:
    """Find stops and motions only; draw the stop detector's page where ``output`` names a file."""
    if output is not None:
        check_output(output, overwrite=overwrite, inputs=paths)
    settings = effective.settings
    _, log = read(paths, settings)
    found = find_segments(log, settings)
    rows = [
        {
            "index": s.index, "kind": "motion" if s.motion else "stop", "start_s": s.start, "end_s": s.end,
            "duration_s": s.end - s.start, "used_start_s": s.used_start, "used_end_s": s.used_end,
        }
        for s in found.segments
    ]  # fmt: skip
    detector = {"enter": found.enter, "leave": found.leave, "margin": found.margin, "source": found.source}
    told = [asdict(w) for w in (*log.warnings, *found.warnings)]
    if output is not None:
        _draw_detector(log, found, rows, detector, effective, output)
    return {"segments": rows, "warnings": told, "detector": detector}


def _draw_detector(
    log: Log,
    found: Segmentation,
    rows: list[dict[str, Any]],
    detector: Mapping[str, Any],
    effective: Effective,
    output: Path,
) -> None:
    """Draw the page of the stop detector alone."""
    from .figures.stops import draw

    t = np.arange(log.imu.t[0], log.imu.t[-1], DETECTOR_STEP_S)
    span = float(log.imu.t[-1] - log.imu.t[0])
    report = {
        "attest_version": __version__, "settings": effective.table(), "gaps": log.gaps.tolist(),
        "input": {"files": [{"name": p.name} for p in log.sources], "duration_s": span, "samples": len(log.imu.t)},
        "statistics": {"detector": dict(detector), "stops": len(found.stops), "motions": len(found.motions)},
    }  # fmt: skip
    passes = {"t_s": t, "stop_statistic": np.interp(t, log.imu.t, found.statistic)}
    page = draw(Result(output.parent, report, passes, {}, tuple(rows)), effective.settings.output.theme)
    if page is not None:
        with atomic_write(output) as temporary:
            temporary.write_bytes(page.png())


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
    used, cfg = {f.channel: role for role, f in log.fixes.items()}, settings.smoothing
    seconds = float(log.imu.t[-1] - log.imu.t[0])
    return {
        "log": {"files": [p.name for p in paths], "duration_s": seconds, "samples": len(log.imu.t)},
        "channels": [
            {"name": c.name, "type": c.kind, "rows": len(c.stamps_ns), "used as": used.get(c.name, c.role or "nothing")}
            for r in recordings for c in r.channels
        ],
        "segments": {"stops": len(found.stops), "motions": len(found.motions), "found by": found.source},
        "measurements": counts,
        "frame": {"world": settings.world.frame, "body": settings.body.axes},
        "methods": {"filter": named(cfg.filter), "smoother": cfg.smoother, "position": cfg.position},
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


def _toml(tables_: Mapping[str, Mapping[str, Any]]) -> str:
    """Spell a config of plain values."""
    lines = []
    for name, values in tables_.items():
        lines.append(f"[{name}]")
        lines += [f"{key} = {json.dumps(list(v) if isinstance(v, tuple) else v)}" for key, v in values.items()]
        lines.append("")
    return "\n".join(lines)
