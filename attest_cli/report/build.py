"""``report.json`` from the pieces of a run: every number, warning and check that the pages and the summary show."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..assess import Pass
from ..estimate import Estimate
from ..maths.consistency import FEW, agree, lasting, mean_nis, noise_status, rejection_status
from ..position import Position
from ..records import BOUNDS, Array, Innovations, Log, Recording, Segmentation, Warn
from ..settings import Effective

FIRST_EPOCH_NS = 946_684_800 * 10**9  # clocks before 2000 count from a start of their own
SENSOR_NAMES = {
    "gravity": "accelerometer at stops",
    "accelerometer": "accelerometer",
    "sun": "sun sensor",
    "compass": "compass",
    "magnetometer": "magnetometer",
    "orientation": "orientation",
    "gps": "GPS",
    "gps_velocity": "GPS velocity",
    "position": "position fixes",
    "height": "height",
}
POSITIONS = {"gps", "gps_velocity", "position"}
REFUSED = {"odometry-contradicts", "odometry-not-used"}  # warnings
HEADING_SENSORS = {"compass", "orientation", "sun"}
BY_NIS = {"smaller": "are better than", "fits": "fit", "larger": "are worse than"}


@dataclass(frozen=True, slots=True)
class Run:
    """All pieces of one run, as the pipeline made them."""

    paths: tuple[Path, ...]
    recordings: tuple[Recording, ...]
    log: Log
    effective: Effective
    segmentation: Segmentation
    est: Estimate
    passes: Mapping[str, Pass]
    separation: tuple[Array, Array]
    position: Position | None
    body: Mapping[str, Any]
    segments: Sequence[Mapping[str, Any]]
    advice: Mapping[str, Any]
    warnings: tuple[Warn, ...]


def build(run: Run) -> dict[str, Any]:
    """Return the report without its pages."""
    statistics = _statistics(run)
    checks = _checks(run, statistics)
    verdict = _verdict(run, checks)
    if verdict == "FAIL" and any(c["status"] == "FAIL" for c in checks):  # its sigma does not hold
        statistics["position_usable"] = False
    return {
        "attest_version": __version__,
        "created_utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "verdict": verdict,
        "input": _input(run),
        "channels": _channels(run),
        "coverage": _coverage(run.log),
        "settings": _settings(run),
        "methods": {
            "filter": run.est.filter,
            "smoother": run.effective.settings.smoothing.smoother,
            "iterations": run.est.smoothed.passes,
            "position": run.position.method if run.position else "none",
            "not_estimated": list(run.est.forward.absent),
        },
        "heading": run.est.forward.heading,
        "body": dict(run.body),
        "statistics": statistics,
        "advice": {k: run.advice[k] for k in ("threshold_deg", "axis", "lines")},
        "warnings": [asdict(w) for w in run.warnings],
        "checks": sorted(checks, key=lambda c: ("FAIL", "WARN", "PASS").index(c["status"])),
        "gaps": [[float(a), float(b)] for a, b in run.log.gaps],
        "shown": [asdict(shown) for shown in run.est.shown],
        "pages": [],
        "history": [
            *(f"{r.source.name}: {note.strip()}" for r in run.recordings for note in r.notes),
            *run.log.history,
            *run.est.world.notes,
        ],
    }


def _input(run: Run) -> dict[str, Any]:
    t, t0 = run.log.imu.t, run.log.t0_ns
    found = run.est.forward.innovations
    used = set(found.role[found.used].tolist())
    sensors = [name for role, name in SENSOR_NAMES.items() if role in used]
    if "gravity" in used and not run.segmentation.stops:
        sensors = [s.replace("accelerometer at stops", "accelerometer over long windows") for s in sensors]
    if "odometry" in used or (run.position is not None and run.position.method == "odometry"):
        sensors.append("odometry")
    start = datetime.fromtimestamp(t0 * 1e-9, UTC).isoformat(timespec="milliseconds") if t0 > FIRST_EPOCH_NS else None
    return {
        "files": [_file(path, rec) for path, rec in zip(run.paths, run.recordings, strict=True)],
        "start_utc": start,
        "duration_s": float(t[-1] - t[0]),
        "samples": len(t),
        "rate_hz": _rate(t) if len(t) > 1 else None,
        "sensors": sensors,
    }


def _coverage(log: Log) -> dict[str, Any]:
    found = dict(log.coverage)
    share = found["seconds_used"] / found["seconds_in"] if found["seconds_in"] > 0 else 1.0
    rows = {key: int(value) for key, value in found.items() if key.startswith("rows")}
    return {**found, **rows, "share": float(min(share, 1.0))}


def _file(path: Path, recording: Recording) -> dict[str, Any]:
    with path.open("rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    return {
        "name": path.name,
        "path": str(path),
        "bytes": path.stat().st_size,
        "sha256": digest,
        "format": recording.format,
    }


def _channels(run: Run) -> list[dict[str, Any]]:
    used = {f.channel: role for role, f in run.log.fixes.items()}
    rows = []
    for c in (c for r in run.recordings for c in r.channels):
        span = float(c.stamps_ns[-1] - c.stamps_ns[0]) * 1e-9 if len(c.stamps_ns) > 1 else 0.0
        rows.append(
            {
                "name": c.name,
                "kind": c.kind,
                "role": c.role if c.role in {"imu", "gyro", "accel"} else used.get(c.name, ""),
                "rows": len(c.stamps_ns),
                "rate_hz": (len(c.stamps_ns) - 1) / span if span > 0 else None,
                "unit_note": ", ".join(sorted({u for u in c.units.values() if u})),
            }
        )
    return rows


def _settings(run: Run) -> dict[str, Any]:
    """Effective values: what the settings leave open stands with what the log gave."""
    out = run.effective.table()
    figures = {
        "gyro_noise_density": run.est.noise.gyro_density,
        "gyro_random_walk": run.est.noise.gyro_walk,
        "accel_noise_density": run.est.noise.accel_density,
        "gyro_scale_sigma": run.est.noise.gyro_scale,
    }
    for key, value in figures.items():
        if run.est.noise.sources[key] != "settings":
            out[f"imu.{key}"] = {"value": value, "source": run.est.noise.sources[key]}
    return out


def _rate(t: Array) -> float:
    return float(1.0 / np.median(np.diff(t)))


def _median(values: Array, t: Array) -> float:
    """Return the median over time of what is known at the nodes ``t``: they stand closer here than there."""
    width, known = np.diff(t), np.isfinite(values)
    weight = np.append(width, 0.0) + np.append(0.0, width)
    order = np.argsort(values[known])
    share = np.cumsum(weight[known][order])
    return float(values[known][order][np.searchsorted(share, 0.5 * share[-1])])


def _statistics(run: Run) -> dict[str, Any]:
    t, sigma = run.est.smoothed.t, np.degrees(run.passes["smoothed"].sigma_n)
    heading, tilt = sigma[:, 2], np.hypot(sigma[:, 0], sigma[:, 1])
    forward_heading = np.degrees(run.passes["forward"].sigma_n[:, 2])
    if run.est.moving.any():  # not while the filter finds its feet at the first stop
        forward_heading = forward_heading[run.est.moving]
    apart = _apart(run)
    dt = np.diff(run.log.imu.t)
    bias = np.degrees(run.est.smoothed.bias)
    s = run.segmentation
    return {
        "sigma_heading_median_deg": _median(heading, t),
        "sigma_heading_max_deg": float(np.nanmax(heading)),
        "sigma_tilt_median_deg": _median(tilt, t),
        "sigma_tilt_max_deg": float(np.nanmax(tilt)),
        "forward_sigma_heading_max_deg": float(np.max(forward_heading)),
        **_position_numbers(run.position, t, run.log),
        "motions": len(s.motions),
        "stops": len(s.stops),
        "separation_checks": len(apart),
        "separation_inside_2sigma": int(np.sum(np.abs(apart) <= 2.0)) if apart else 0,
        "innovations": _innovations(run.est.forward.innovations),
        "forward_over_threshold_share": run.advice["share_over"],
        "longest_smoothed_drive_s": run.advice["longest_s"],
        "gyro_bias_drift_deg_s": float(np.max(np.ptp(bias, axis=0))),
        "gap_count": len(run.log.gaps),
        "jitter_ms": float(1e3 * np.percentile(np.abs(dt - np.median(dt)), 95)) if len(dt) else None,
        "detector": {"enter": s.enter, "leave": s.leave, "margin": s.margin, "source": s.source},
    }


def _apart(run: Run) -> list[float]:
    """Return the separations, in sigmas, that say something: those of heading only where it is measured."""
    axes = "xy" if run.est.forward.heading == "relative" else "xyz"
    found = [r[f"separation_{axis}_sigma"] for r in run.segments if r["kind"] == "motion" for axis in axes]
    return [value for value in found if value is not None]


def _position_numbers(position: Position | None, t: Array, log: Log) -> dict[str, Any]:
    if position is None:
        return {"position_usable": False}
    sigma = np.sqrt(np.einsum("kii->k", position.P[:, :2, :2]))
    if not np.isfinite(sigma).any():
        return {"position_usable": False}
    return {
        "position_sigma_median_m": _median(sigma, t),
        "position_sigma_max_m": float(np.nanmax(sigma)),
        "distance_m": float(sum(position.distance.values())),
        "position_usable": position.usable or _as_its_fixes(position, float(np.nanmax(sigma)), log),
    }


def _as_its_fixes(position: Position, sigma: float, log: Log) -> bool:
    """Return whether a place is known as well all along as a fix of the log is: on a short drive no share of its way
    can be asked for.
    """
    known = [f.sigma for role in ("gps", "position") if (f := log.fixes.get(role)) is not None and f.sigma is not None]
    level = [float(np.sqrt(2.0) * np.nanmedian(each[:, :2])) for each in known]  # of both axes, as ``sigma`` is
    return position.method == "navigation" and sigma <= max(level, default=0.0)


def _innovations(found: Innovations) -> dict[str, Any]:
    out = {}
    for role in dict.fromkeys(found.role.tolist()):
        mine = found.role == role
        used = mine & found.used
        out[role] = {
            "count": int(mine.sum()),
            "used": int(used.sum()),
            "rejected": int((mine & ~found.used).sum()),
            "mean_nis": float(found.nis[used].mean()) if used.any() else None,
            "dof": int(found.dof[mine][0]),
        }
    return out


def _check(name: str, good: bool, fact: str, detail: str, *, fatal: bool = False) -> dict[str, Any]:
    """``fatal``: the sigma does not hold."""
    return {"name": name, "status": "FAIL" if fatal else "PASS" if good else "WARN", "fact": fact, "detail": detail}


def _checks(run: Run, statistics: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the lines of "What to know": warnings of the log first, then what the run found out about itself."""
    lines = [_check(w.code, False, _sentence(w.message), w.hint, fatal=w.fatal) for w in run.warnings]
    lines += _separation_check(_apart(run), statistics) + _innovation_checks(run.est.forward.innovations)
    others = (_position_check(run, statistics), _advice_check(run), _data_check(run, statistics["jitter_ms"]))
    lines += [check for check in others if check is not None]
    return lines


def _degrees(dof: int) -> str:
    return "1 degree of freedom" if dof == 1 else f"{dof} degrees of freedom"


def _sentence(message: str) -> str:
    """Begin with a capital, unless with the name of a file."""
    return message if ":" in message.split(" ", maxsplit=1)[0] else message[:1].upper() + message[1:]


def _separation_check(apart: Sequence[float], s: Mapping[str, Any]) -> list[dict[str, Any]]:
    if not apart:
        return []
    good = agree(apart)
    fact = "Forward and backward agree" if good else "Forward and backward disagree"
    detail = f"{s['separation_inside_2sigma']} of {s['separation_checks']} segment checks inside 2σ"
    return [_check("separation", good, fact, detail)]


def _innovation_checks(found: Innovations) -> list[dict[str, Any]]:
    lines = []
    for role, s in _innovations(found).items():
        if role in BOUNDS:
            lines += _bound_check(role, s)
            continue
        name = SENSOR_NAMES[role] if role.startswith("gps") else role.replace("_", " ")
        if s["rejected"] > (role == "zero_rate"):  # one may be the edge of a stop
            status = rejection_status(s["rejected"], s["count"])
            fact = f"{s['rejected']} of {s['count']} {name} measurements rejected"
            fatal = status == "FAIL" or (role == "gravity" and status == "WARN")  # it is never an outlier
            detail = "they contradict the rest of the log: its sigma does not hold" if fatal else "see the innovations"
            lines.append(_check(f"rejected-{role}", status == "PASS", fact, detail, fatal=fatal))
        if s["used"] < FEW:
            continue
        judged = s["mean_nis"], s["used"], s["dof"]
        status = noise_status(*judged)
        fact = f"{name[0].upper()}{name[1:]} innovations {BY_NIS[mean_nis(*judged)]} their noise"
        detail = f"mean NIS {s['mean_nis']:.2g} for {_degrees(s['dof'])}"
        lines.append(_check(f"innovations-{role}", status == "PASS", fact, detail, fatal=status == "FAIL"))
        if role in HEADING_SENSORS:
            lines += _lasting_check(role, found, s["dof"])
    return lines


def _bound_check(role: str, s: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Say whether the motion keeps to what is assumed of it; how far inside, says nothing."""
    judged = [rejection_status(s["rejected"], s["count"])]
    judged += [noise_status(s["mean_nis"], s["used"], s["dof"])] if s["used"] >= FEW else []
    status = max(judged, key=("PASS", "WARN", "FAIL").index)
    does = "keeps to" if status == "PASS" else "goes beyond"
    detail = f"{s['rejected']} of {s['count']} times by far; [navigation] motion says what moves"
    return [_check(f"bound-{role}", status == "PASS", f"The motion {does} the bound on its {role}", detail,
                   fatal=status == "FAIL")]  # fmt: skip


def _lasting_check(role: str, found: Innovations, dof: int) -> list[dict[str, Any]]:
    """Say where a sensor's error lasts from reading to reading: the smoother takes them for independent."""
    square, sums = lasting(found.z[(found.role == role) & found.used, :dof])
    status = noise_status(square, sums, dof, few=1)
    if status == "PASS":
        return []
    fact = f"{role.capitalize()} errors last: its readings are not independent"
    detail = f"ten together are off by {np.sqrt(square / dof):.1f} sigma; state a wider sigma_deg under [{role}]"
    return [_check(f"lasting-{role}", False, fact, detail, fatal=status == "FAIL")]


def _position_check(run: Run, s: Mapping[str, Any]) -> dict[str, Any] | None:
    """Say that a position is not usable; a warning where the log has what should hold it."""
    if run.position is None or not run.segmentation.motions or "position_sigma_max_m" not in s or s["position_usable"]:
        return None
    reach = f"its sigma reaches {s['position_sigma_max_m']:.0f} m"
    if run.position.method == "odometry" or POSITIONS & run.log.fixes.keys():
        return _check("position", False, "Position is not usable", f"{reach}, more than 10 % of the distance")
    if REFUSED & {warn.code for warn in run.warnings}:
        return _check("position", False, "Position is not usable: its odometry was refused", f"{reach}; see above why")
    return _check("position", True, "Position is not usable: no sensor aids it", f"{reach}; odometry would hold it")


def _advice_check(run: Run) -> dict[str, Any] | None:
    lines, threshold, share = run.advice["lines"], run.advice["threshold_deg"], run.advice["share_over"]
    if not run.segmentation.stops or not run.segmentation.motions:
        return None
    if share <= 0.0:
        longest = run.advice["longest_s"]
        detail = f"the smoothed middle of a drive of {longest / 60:.0f} min would still be below it" if longest else ""
        return _check("stop-advice", True, f"Stops were often enough for {threshold:g}°", detail)
    below = bool(run.advice["smoothed_below"])
    fact = f"Forward sigma passes {threshold:g}° for {100 * share:.0f} % of the drive"
    detail = (
        "smoothing stays below it" if below else lines[0] if lines else f"{run.advice['axis']} needs a better sensor"
    )
    return _check("stop-advice", below, fact, detail)


def _data_check(run: Run, jitter_ms: float | None) -> dict[str, Any] | None:
    if run.log.warnings or len(run.log.gaps):
        return None
    told = f"rate {_rate(run.log.imu.t):.1f} Hz, jitter {jitter_ms:.2f} ms"
    return _check("data", True, "No gaps, duplicates or disorder", told)


def _verdict(run: Run, checks: Sequence[Mapping[str, Any]]) -> str:
    """FAIL where a check is fatal or the gate is passed, WARN where one is not clean."""
    if any(c["status"] == "FAIL" for c in checks):
        return "FAIL"
    limit = run.effective.settings.gate.max_sigma_attitude_deg
    if limit is not None and np.degrees(np.nanmax(run.passes["smoothed"].sigma_n)) > limit:
        return "FAIL"
    return "PASS" if all(c["status"] == "PASS" for c in checks) else "WARN"
