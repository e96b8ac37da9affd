"""The run, in order: one short function per command. This page is the architecture."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from . import __version__, assess, tables
from .errors import AttestError
from .estimate import Estimate, Progress, estimate, silent
from .filters.choice import choose as choose_filter
from .locate import IDENTITY, Vehicle, locate
from .memory import give_back, keep_memory
from .nodes.noise import CALIBRATION, contradictions, find_noise
from .nodes.observations import observe
from .position import Position
from .prepare import choose, prepare
from .prepare.axes import foremost
from .prepare.groups import files_used, whole_logs
from .readers import read as read_file
from .readers.result import read_result
from .records import Imu, Log, Recording, Result, Segmentation, Warn
from .report import Report, write_pages
from .report.build import Run, build
from .segment import find_segments
from .settings import Effective, Settings
from .world import find_world
from .writers import write_track
from .writers.files import atomic_write, check_output, write_csv_rows, write_table
from .writers.folder import result_folder

FRAMES = {"enu": "ENU world, FLU body", "ned": "NED world, FRD body"}
EVALUATION, EVALUATION_PAGE = "evaluation.json", "09-evaluate.png"
CALIBRATED = ("imu", "gyro", "accel", "temperature", "magnetometer")  # roles that a calibration reads
LOG_SUFFIXES = (".csv", ".mcap", ".parquet")
DETECTOR_STEP_S = 0.1  # the statistic is drawn at this step


def read(paths: Sequence[Path], settings: Settings) -> tuple[tuple[Recording, ...], Log]:
    """Read the files of one drive: as found, and in SI on one time base."""
    recordings = tuple(read_file(path, settings) for path in paths)
    give_back()
    log = prepare(recordings, settings, spent=True)
    return tuple(emptied(recording, log) for recording in recordings), log


def smooth(
    paths: Sequence[Path], effective: Effective, output: Path, *, overwrite: bool = False, progress: Progress = silent
) -> dict[str, Any]:
    """Run the main job and write the result folder; return ``report.json``."""
    settings = effective.settings
    keep_memory()
    with result_folder(output, overwrite=overwrite, inputs=paths) as folder:
        report = _write(folder, *_worked_out(paths, effective, progress), settings, progress)
        progress("drawing", 0.8)  # from the files: nothing at full rate is left
        pages = write_pages(read_result(folder), folder, settings.output.theme)
        progress("done", 1.0)
        return _write_report(folder, {**report, "pages": pages})


def _worked_out(paths: Sequence[Path], effective: Effective, progress: Progress) -> tuple[Run, tables.Track]:
    """Read, find the stops and estimate: all but writing."""
    settings = effective.settings
    progress("reading", 0.0)
    recordings, log = read(paths, settings)
    give_back()
    progress("finding stops", 0.2)
    return appraise(paths, recordings, log, find_segments(log, settings), effective, progress)


def appraise(
    paths: Sequence[Path], recordings: tuple[Recording, ...], log: Log, segmentation: Segmentation,
    effective: Effective, progress: Progress = silent,
) -> tuple[Run, tables.Track]:  # fmt: skip
    """Estimate attitude and position of a segmented log, and bring together all that is told of them."""
    effective = informed(effective, log)
    settings = effective.settings
    est = estimate(log, segmentation, settings, progress)
    give_back()
    progress("position", 0.6)
    place, vehicle, warnings = locate(log, segmentation, est, settings)
    warnings += contradictions(log, segmentation, find_noise(log, segmentation, settings), settings)
    log, est = _as_recorded(log, est)
    return _assemble(paths, recordings, log, effective, segmentation, est, place, vehicle, warnings)


def emptied(recording: Recording, log: Log) -> Recording:
    """Return a recording without its values: what is told of its channels needs stamps and units only."""
    channels = (
        replace(c, values={}, stamps_ns=log.stamps_ns if np.array_equal(c.stamps_ns, log.stamps_ns) else c.stamps_ns)
        for c in recording.channels  # one array of equal stamps is enough
    )
    return replace(recording, channels=tuple(channels))


def informed(effective: Effective, log: Log) -> Effective:
    """Take the sigmas of a calibration for settings that nobody gave."""
    known = {} if log.calibrated is None else log.calibrated.sigmas
    return effective.informed({f"imu.{name}": value for name, value in known.items()}, CALIBRATION)


def _as_recorded(log: Log, est: Estimate) -> tuple[Log, Estimate]:
    """Put the bias that a calibration took out of the gyro back into the log and into every bias that is told."""
    if log.calibrated is None:
        return log, est
    out = log.calibrated.at(est.smoothed.t)
    imu = replace(log.imu, gyro_b=log.imu.gyro_b + log.calibrated.at(log.imu.t))
    passes = {name: replace(p, bias=p.bias + out) for name, p in est.passes.items()}
    smoothed = replace(est.smoothed, bias=est.smoothed.bias + out)
    return replace(log, imu=imu), replace(est, smoothed=smoothed, passes=passes)


def _assemble(
    paths: Sequence[Path], recordings: tuple[Recording, ...], log: Log, effective: Effective,
    segmentation: Segmentation, est: Estimate, place: Position | None, vehicle: Vehicle,
    warnings: Sequence[Warn],
) -> tuple[Run, tables.Track]:  # fmt: skip
    """Bring everything into body axes, judge it, and prepare the track."""
    settings = effective.settings
    threshold = settings.smoothing.stop_threshold_deg
    t, passes = est.smoothed.t, est.passes
    relative = est.forward.heading == "relative"
    rows = assess.segment_table(log, segmentation, t, passes, place, est.noise, threshold, relative)
    advice = assess.stop_advice(t, est.moving, passes, segmentation, est.noise, threshold, est.forward.datum)
    as_it_is = np.array_equal(vehicle.q_bv, IDENTITY) and not vehicle.sigma.any()
    turned = passes if as_it_is else {name: p.turned(vehicle.q_bv, vehicle.sigma) for name, p in passes.items()}
    log = _without_signals(log)  # of the IMU nothing but its times is told
    told = foremost((*log.warnings, *segmentation.warnings, *est.warnings, *warnings))
    run = Run(
        tuple(paths), recordings, log, effective, segmentation, est, turned,
        assess.separation(passes["forward"], passes["backward"]), place, vehicle.told, rows, advice, told,
    )  # fmt: skip
    track = tables.Track(
        log, est.q, est.smoothed, place, segmentation, vehicle.q_bv, vehicle.sigma, settings.world.frame
    )
    return run, track


def _without_signals(log: Log) -> Log:
    """Return a log that does not hold the signals of its IMU."""
    nothing = np.broadcast_to(np.nan, log.imu.gyro_b.shape)
    return replace(log, imu=Imu(log.imu.t, nothing, nothing))


def _write(folder: Path, run: Run, track: tables.Track, settings: Settings, progress: Progress) -> dict[str, Any]:
    """Write every file of the result but the pages; return the report as built."""
    progress("writing", 0.7)
    report = build(run)
    metadata = _metadata(run, report)
    for name in settings.output.formats:
        write_track(track, metadata, folder / f"track.{name}", name)
    t, forward = run.est.smoothed.t, run.est.forward
    relative = forward.heading == "relative"
    metadata |= {"frame": FRAMES["enu"]}  # the pages are drawn from these
    nodes = tables.pass_columns(run.log, t, run.passes, run.separation, run.position, run.segmentation, relative)
    write_table(nodes, folder / "passes.parquet", metadata)
    write_table(
        tables.innovation_columns(forward.innovations, forward.t, run.segmentation),
        folder / "innovations.parquet",
        metadata,
    )
    write_csv_rows(_padded(run.segments), folder / "segments.csv")
    _write_report(folder, report)
    return report


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
    statistics = {"detector": dict(detector), "stops": len(found.stops), "motions": len(found.motions)}
    report = {**_head(log, effective), "statistics": statistics}
    passes = {"t_s": t, "stop_statistic": np.interp(t, log.imu.t, found.statistic)}
    page = draw(Result(output.parent, report, passes, {}, tuple(rows)), effective.settings.output.theme)
    if page is not None:
        with atomic_write(output) as temporary:
            temporary.write_bytes(page.png())


def _head(log: Log, effective: Effective) -> dict[str, Any]:
    """Say what the head of a page tells of a log."""
    files = [{"name": path.name} for path in log.sources]
    known = {"files": files, "duration_s": float(log.imu.t[-1] - log.imu.t[0]), "samples": len(log.imu.t)}
    return {
        "attest_version": __version__, "settings": effective.table(), "gaps": log.gaps.tolist(), "input": known
    }  # fmt: skip


def calibrate(
    paths: Sequence[Path], effective: Effective, output: Path, *, model: str = "auto", overwrite: bool = False,
    progress: Progress = silent,
) -> dict[str, Any]:  # fmt: skip
    """Calibrate the IMU of logs from what stands still in them; write the folder, return what was found.

    ``effective`` names neither mounting nor calibration: the file is of the sensor's own axes, and of it as it is.
    """
    from .calibration.calibrate import calibrate as fit
    from .figures.calibrate_bias import NAME, draw, status
    from .writers.calibration import describe, write_calibration, write_kalibr
    from .writers.folder import CALIBRATION as LAST

    settings = effective.settings
    with result_folder(output, overwrite=overwrite, inputs=paths, last=LAST) as folder:
        progress("reading", 0.0)
        groups = whole_logs([read_file(path, settings) for path in paths], settings)
        logs = [prepare(recordings, settings) for recordings in groups]
        progress("finding stops", 0.3)
        rests = [(log, find_segments(log, settings)) for log in logs]
        progress("fitting", 0.5)
        found = fit(*rests[0], settings, rests[1:], model)
        channels = choose(groups[0], settings).channels
        used = [path for recordings in groups for path in files_used(recordings, settings, CALIBRATED)]
        file = describe(found, used, next(channels[role].name for role in ("imu", "gyro") if role in channels))
        progress("drawing", 0.8)
        head = _head(logs[0], effective)
        head["input"] |= {
            "files": [source.model_dump() for source in file.source.files], "duration_s": found.duration,
            "samples": sum(len(log.imu.t) for log in logs),
        }  # fmt: skip
        page = draw(found, Result(output, head, {"t_s": np.array([])}, {}, ()), settings.output.theme)
        with atomic_write(folder / NAME) as temporary:
            temporary.write_bytes(page.png())
        write_kalibr(file, folder / "imu.yaml")
        write_calibration(file, folder / LAST)
        progress("done", 1.0)
    told = tuple(dict.fromkeys(w for log, segmentation in rests for w in (*log.warnings, *segmentation.warnings)))
    return {"file": file, "title": page.title, "status": status(found), "warnings": told}


def plan(paths: Sequence[Path], effective: Effective) -> dict[str, Any]:
    """Say what a run would do (``--dry-run``): channels, segments, sensors, methods. Writes nothing."""
    settings = effective.settings
    recordings, log = read(paths, settings)
    found = find_segments(log, settings)
    settings = informed(effective, log).settings
    world, noise = find_world(log, settings), find_noise(log, found, settings)
    observations, warnings = observe(log, found, world, noise, settings)
    counts: dict[str, int] = {}
    for o in observations:
        counts[o.role] = counts.get(o.role, 0) + 1
    used, cfg = {f.channel: role for role, f in log.fixes.items()}, settings.smoothing
    name, why = choose_filter(log, found, settings)
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
        "methods": {"filter": name, "why": why, "smoother": cfg.smoother, "position": cfg.position},
        "warnings": [w.message for w in (*log.warnings, *found.warnings, *warnings)],
        "lost": any(w.lost for w in log.warnings),
    }  # fmt: skip


def evaluate(
    result: Path, reference: Path, options: Mapping[str, Any], output: Path | None = None, *,
    channel: str | None = None, theme: str | None = None, overwrite: bool = False,
) -> dict[str, Any]:  # fmt: skip
    """Judge a result by a reference; write ``evaluation.json`` and its page into ``output``, by default beside it.

    ``options``: fields of ``evaluate.Options``; ``channel``: of a reference in MCAP.
    """
    from .evaluate import Options, claims
    from .evaluate import evaluate as judge
    from .figures.evaluate import draw
    from .readers.reference import read_judged, read_poses
    from .report.evaluation import told, tracked

    drive, poses = read_judged(result)
    if "smoothed_covariance" in drive.passes:
        poses = replace(poses, claims=claims.of_passes(drive.passes, poses.claims))
    by = read_poses(reference, channel)
    folder = output or (result if result.is_dir() else result.parent)
    for name in (EVALUATION_PAGE, EVALUATION):
        check_output(folder / name, overwrite=overwrite, inputs=(result, reference))
    found = judge(poses, by, Options(**options))
    page = draw(found, drive, by.source, theme or "light")
    track = result / poses.source if result.is_dir() else result
    content = told(found, {
        "created_utc": datetime.now(UTC).isoformat(timespec="seconds"), "result": tracked(track, poses),
        "reference": tracked(reference, by), "page": {"file": EVALUATION_PAGE, "title": page.title, "alt": page.alt},
    })  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
    with atomic_write(folder / EVALUATION) as temporary:  # both are new, or neither
        temporary.write_text(f"{text}\n", encoding="utf-8")
        with atomic_write(folder / EVALUATION_PAGE) as drawn:
            drawn.write_bytes(page.png())
    return content


def simulate(scenario: str, output: Path, options: Mapping[str, Any], overwrite: bool = False) -> list[Path]:
    """Simulate a drive; write the log, its truth, and the ``attest.toml`` that goes with it.

    ``output`` with a suffix names one log; without one, the log is written in all three formats.
    """
    from .simulate import SCENARIOS

    if scenario not in SCENARIOS:
        raise AttestError(f"no scenario {scenario!r}", f"choose one of {', '.join(SCENARIOS)}")
    logs = [output] if output.suffix in LOG_SUFFIXES else [output.with_name(output.name + s) for s in LOG_SUFFIXES]
    truth, config = logs[0].with_suffix(".truth.parquet"), logs[0].parent / "attest.toml"
    for path in (*logs, truth, config):
        check_output(path, overwrite=overwrite)
    from .writers.logs import write_recording

    options_of, run = SCENARIOS[scenario]
    made = run(options_of(**options))
    logs[0].parent.mkdir(parents=True, exist_ok=True)
    fresh = [path for path in (*logs, truth, config) if not path.exists()]
    try:
        for path in logs:
            write_recording(made.log, path)
        write_table(dict(made.truth), truth, {"scenario": scenario, **{k: str(v) for k, v in options.items()}})
        with atomic_write(config) as temporary:
            temporary.write_text(_toml(made.settings), encoding="utf-8")
    except BaseException:  # an interrupt leaves no part of the set either
        for path in fresh:
            path.unlink(missing_ok=True)
        raise
    return [*logs, truth, config]


def _toml(tables_: Mapping[str, Mapping[str, Any]]) -> str:
    """Spell a config of plain values."""
    lines = []
    for name, values in tables_.items():
        lines.append(f"[{name}]")
        lines += [f"{key} = {json.dumps(list(v) if isinstance(v, tuple) else v)}" for key, v in values.items()]
        lines.append("")
    return "\n".join(lines)
