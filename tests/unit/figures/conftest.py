"""A small seeded builder of results: consistent passes by construction, and every odd log by an option."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from attest_cli.records import Result

# stop, motion, stop, ... in seconds; a 21 min rover drive
ROVER = (30.0, 180.0, 15.0, 242.0, 12.0, 120.0, 20.0, 300.0, 15.0, 90.0, 12.0, 208.0, 40.0)
SHORT = (15.0, 90.0, 12.0)
DEG = math.pi / 180.0


@dataclass
class Spec:
    durations: Sequence[float] = ROVER
    seed: int = 7
    step: float = 0.1
    starts_with_stop: bool = True
    heading: str = "absolute"
    backward: bool = True
    gap: tuple[float, float] | None = None
    zero_sigma: bool = False
    position: str = "good"  # good, unusable, none
    rejected: float = 0.03
    name: str = "rover_0077.mcap"
    frame: str = "enu"
    growth: float = 1.0  # factor on the gyro noise that the passes claim
    checks: Sequence[dict[str, str]] = field(default_factory=tuple)


Make = Callable[..., Result]


@pytest.fixture(scope="session")
def make() -> Make:
    cache: dict[str, Result] = {}

    def build(**options: Any) -> Result:
        key = repr(sorted(options.items()))
        if key not in cache:
            cache[key] = make_result(Spec(**options))
        return cache[key]

    return build


def make_result(spec: Spec) -> Result:
    """Build a result folder's content as the contract of the columns says."""
    rng = np.random.default_rng(spec.seed)
    edges = np.concatenate(([0.0], np.cumsum(spec.durations)))
    n = max(1, round(edges[-1] / spec.step) + 1)
    t = np.linspace(0.0, edges[-1], n) if n > 1 else np.zeros(1)
    if spec.gap:
        t = t[(t < spec.gap[0]) | (t > spec.gap[1])]
    part = np.clip(np.searchsorted(edges, t, side="right") - 1, 0, len(spec.durations) - 1)
    offset = 0 if spec.starts_with_stop else 1
    moving = (part + offset) % 2 == 1
    passes: dict[str, np.ndarray] = {
        "timestamp_ns": (t * 1e9).astype(np.int64),
        "t_s": t,
        "segment": (part + 1 + offset).astype(np.int32),
        "moving": moving,
    }
    smooth_motion(passes, t, moving, rng)
    add_passes(passes, t, moving, edges, part, spec, rng)
    add_bias(passes, t, moving, edges, part, spec, rng)
    add_position(passes, t, moving, spec, rng)
    statistic = np.where(
        moving, 4000.0 * np.exp(0.6 * slow(rng, n, 12)[: t.size]), 6.0 + 0.3 * rng.standard_normal(t.size)
    )
    passes["stop_statistic"] = np.convolve(np.pad(statistic, 4, mode="edge"), np.ones(9) / 9.0, mode="valid")
    segments = make_segments(passes, t, edges, offset, spec)
    innovations = make_innovations(t, moving, passes["segment"], spec, rng)
    return Result(Path("x.attest"), make_report(passes, segments, innovations, t, spec), passes, innovations, segments)


def slow(rng: np.random.Generator, n: int, width: int) -> np.ndarray:
    """Smooth noise of about unit spread."""
    knots = rng.standard_normal(n // width + 3)
    return np.interp(np.arange(n), np.arange(knots.size) * width, knots)


def smooth_motion(passes: dict[str, np.ndarray], t: np.ndarray, moving: np.ndarray, rng: np.random.Generator) -> None:
    for name, spread in (("roll", 4.5), ("pitch", 4.5), ("yaw", 0.0)):
        held = np.maximum.accumulate(np.where(moving, np.arange(t.size), 0))
        values = spread * slow(rng, t.size, 30)
        if name == "yaw":
            values = 70.0 + np.cumsum(4.0 * slow(rng, t.size, 150) * 0.1 * moving)
        passes[f"smoothed_{name}_deg"] = values[held] if name != "yaw" else values


def add_passes(
    passes: dict[str, np.ndarray], t: np.ndarray, moving: np.ndarray, edges: np.ndarray, part: np.ndarray, spec: Spec,
    rng: np.random.Generator,
) -> None:  # fmt: skip
    """Errors drawn from the claimed sigma: a walk and a ramp since the last stop, merged by their weights."""
    since = np.where(moving, t - edges[part], 0.0)
    left = np.where(moving, edges[part + 1] - t, 0.0)
    still = {"x": 0.03, "y": 0.03, "z": 0.16}
    for axis, angle in (("x", "roll"), ("y", "pitch"), ("z", "yaw")):
        sigma, error = {}, {}
        for which, age, transient in (("forward", since, t - t[0]), ("backward", left, t[-1] - t)):
            rate = 0.006 * rng.standard_normal(len(edges))[part]
            claimed = np.sqrt(
                still[axis] ** 2 + (0.006 * age) ** 2 + 2e-4 * age + (3.0 * np.exp(-transient / 1.5)) ** 2
            )
            walk = np.cumsum(rng.standard_normal(t.size)) * math.sqrt(2e-4 * spec.step)
            walk -= walk[
                np.clip(np.searchsorted(t, edges[part] if which == "forward" else edges[part + 1]), 0, t.size - 1)
            ]
            error[which] = rate * age + np.where(moving, walk, 0.0) + 0.3 * still[axis] * slow(rng, t.size, 9)
            error[which] = error[which] + 3.0 * np.exp(-transient / 1.5) * rng.standard_normal()
            sigma[which] = claimed * spec.growth
        if spec.zero_sigma:
            sigma = {k: np.zeros_like(v) for k, v in sigma.items()}
            error = {k: np.zeros_like(v) for k, v in error.items()}
        weight = {k: 1.0 / np.maximum(v, 1e-12) ** 2 for k, v in sigma.items()}
        total = weight["forward"] + weight["backward"] if spec.backward else weight["forward"]
        merged = sum(weight[k] * error[k] for k in weight if spec.backward or k == "forward") / total
        smoothed = np.zeros_like(t) if spec.zero_sigma else 1.0 / np.sqrt(total)
        if axis == "z" and spec.heading == "relative":
            smoothed = 0.9 * np.sqrt(t / 3600.0 + 1e-4)
            sigma = {k: np.hypot(v, smoothed) for k, v in sigma.items()}
        if not spec.backward:
            error["backward"] = sigma["backward"] = np.full_like(t, np.nan)
        for which in ("forward", "backward"):
            passes[f"{which}_{angle}_deg"] = passes[f"smoothed_{angle}_deg"] + error[which] - merged
            passes[f"{which}_sigma_att_{axis}_deg"] = sigma[which]
        passes[f"smoothed_sigma_att_{axis}_deg"] = smoothed
        passes[f"smoothed_sigma_{angle}_deg"] = smoothed
        passes[f"separation_{axis}_deg"] = error["forward"] - error["backward"]
        passes[f"sigma_separation_{axis}_deg"] = np.hypot(sigma["forward"], sigma["backward"])


def add_bias(
    passes: dict[str, np.ndarray], t: np.ndarray, moving: np.ndarray, edges: np.ndarray, part: np.ndarray, spec: Spec,
    rng: np.random.Generator,
) -> None:  # fmt: skip
    begin, end = np.clip(np.searchsorted(t, [edges[part], edges[part + 1]]), 0, t.size - 1)
    for k, axis in enumerate("xyz"):
        truth = (-0.19 + 0.06 * k - 0.04 * np.exp(-t / 420.0)) * DEG
        sigma = (
            0.002
            * DEG
            * (1.0 + 2.0 * moving * np.sin(math.pi * np.clip((t - edges[part]) / np.diff(edges)[part], 0, 1)))
        )
        passes[f"smoothed_gyro_bias_{axis}_rad_s"] = truth + 0.0005 * DEG * slow(rng, t.size, 300)
        passes[f"smoothed_sigma_gyro_bias_{axis}_rad_s"] = 0.0 * sigma if spec.zero_sigma else sigma
        for which, held in (("forward", begin), ("backward", end)):
            values = truth[held] + 0.2 * DEG * np.exp(-(t - t[0] if which == "forward" else t[-1] - t) / 2.0)
            known = which == "forward" or spec.backward
            passes[f"{which}_gyro_bias_{axis}_rad_s"] = values if known else np.full_like(t, np.nan)
            passes[f"{which}_sigma_gyro_bias_{axis}_rad_s"] = np.full_like(t, 0.004 * DEG if known else np.nan)


def add_position(
    passes: dict[str, np.ndarray], t: np.ndarray, moving: np.ndarray, spec: Spec, rng: np.random.Generator
) -> None:
    nothing = np.full_like(t, np.nan)
    if spec.position == "none":
        for name in ("position_x_m", "position_y_m", "position_z_m", "sigma_position_x_m", "sigma_position_y_m"):
            passes[name] = nothing
        passes["sigma_position_z_m"] = passes["position_cov_xy_m2"] = nothing
        return
    yaw = np.radians(passes["smoothed_yaw_deg"])
    step = 0.3 * np.diff(t, prepend=t[0]) * moving
    passes["position_x_m"], passes["position_y_m"] = np.cumsum(step * np.cos(yaw)), np.cumsum(step * np.sin(yaw))
    passes["position_z_m"] = 0.4 * slow(rng, t.size, 600)
    sigma = 0.4 + (3.0 if spec.position == "good" else 900.0) * np.exp(
        -(((t - 0.4 * t[-1]) / (0.05 * t[-1] + 1.0)) ** 2)
    )
    passes["sigma_position_x_m"], passes["sigma_position_y_m"] = sigma, 0.7 * sigma
    passes["sigma_position_z_m"], passes["position_cov_xy_m2"] = 0.3 + 0.0 * sigma, 0.3 * sigma**2


def make_segments(
    passes: dict[str, np.ndarray], t: np.ndarray, edges: np.ndarray, offset: int, spec: Spec
) -> tuple[dict[str, Any], ...]:
    out = []
    for k in range(len(edges) - 1):
        start, end, motion = float(edges[k]), float(edges[k + 1]), (k + offset) % 2 == 1
        rows = (t >= start) & (t <= end)
        row: dict[str, Any] = {
            "index": k + 1 + offset, "kind": "motion" if motion else "stop", "start_ns": int(start * 1e9),
            "end_ns": int(end * 1e9), "start_s": start, "end_s": end, "duration_s": end - start,
            "used_start_s": start + (0.0 if motion else 0.5), "used_end_s": end - (0.0 if motion else 0.5),
        }  # fmt: skip
        if motion and rows.any():
            fill_motion(row, passes, t, rows, spec)
        elif rows.any():
            for axis in "xyz":
                row[f"gyro_mean_{axis}_rad_s"] = float(np.mean(passes[f"smoothed_gyro_bias_{axis}_rad_s"][rows]))
                row[f"gyro_mean_sigma_{axis}_rad_s"] = 0.0 if spec.zero_sigma else 0.0015 * DEG
                if spec.position != "none":
                    row[f"position_{axis}_m"] = float(passes[f"position_{axis}_m"][rows][0])
                    row["sigma_position_m"] = float(passes["sigma_position_x_m"][rows][0])
        out.append(row)
    return tuple(out)


def fill_motion(
    row: dict[str, Any], passes: dict[str, np.ndarray], t: np.ndarray, rows: np.ndarray, spec: Spec
) -> None:
    att = {w: np.max([passes[f"{w}_sigma_att_{a}_deg"][rows] for a in "xyz"]) for w in ("forward", "smoothed")}
    row["sigma_attitude_forward_deg"], row["sigma_attitude_smoothed_deg"] = (
        float(att["forward"]),
        float(att["smoothed"]),
    )
    row["sigma_tilt_smoothed_deg"] = float(
        np.max(np.hypot(*(passes[f"smoothed_sigma_att_{a}_deg"][rows] for a in "xy")))
    )
    over = np.flatnonzero(passes["forward_sigma_att_z_deg"][rows] > 1.0)
    row["stop_advised_after_s"] = float(t[rows][over[0]] - row["start_s"]) if over.size else ""
    if spec.backward and not spec.zero_sigma:
        k = int(np.argmin(np.abs(t - 0.5 * (row["start_s"] + row["end_s"]))))
        row["separation_s"] = float(t[k])
        for axis in "xyz" if spec.heading != "relative" else "xy":
            row[f"separation_{axis}_sigma"] = float(
                passes[f"separation_{axis}_deg"][k] / passes[f"sigma_separation_{axis}_deg"][k]
            )


def make_innovations(
    t: np.ndarray, moving: np.ndarray, segment: np.ndarray, spec: Spec, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """One sun and one gravity measurement per second at stops; zero rate five times as often."""
    rows: list[tuple[Any, ...]] = []
    at_stop = np.flatnonzero(~moving)
    for sensor, dof, every in (("gravity", 3, 10), ("sun", 2, 10), ("zero_rate", 3, 2)):
        if sensor == "sun" and spec.heading == "relative":
            continue
        for k in at_stop[::every].tolist():
            z = rng.standard_normal(3)
            used = bool(rng.random() >= spec.rejected) or (sensor == "zero_rate" and spec.rejected < 1.0)
            z = z if used else z * 7.0
            z[dof:] = np.nan
            rows.append((sensor, float(t[k]), int(segment[k]), dof, float(np.nansum(z**2)), used, *z))
    names = ("sensor", "t_s", "segment", "dof", "nis", "used", "z0", "z1", "z2")
    columns = list(zip(*rows, strict=True)) if rows else [()] * len(names)
    kinds = (object, float, np.int32, np.int32, float, bool, float, float, float)
    return {name: np.array(c, dtype=k) for name, c, k in zip(names, columns, kinds, strict=True)}


def make_report(
    passes: dict[str, np.ndarray], segments: tuple[dict[str, Any], ...], innovations: dict[str, np.ndarray],
    t: np.ndarray, spec: Spec,
) -> dict[str, Any]:  # fmt: skip
    tilt = np.hypot(passes["smoothed_sigma_att_x_deg"], passes["smoothed_sigma_att_y_deg"])
    heading = passes["smoothed_sigma_att_z_deg"]
    motions = sum(s["kind"] == "motion" for s in segments)
    duration = float(t[-1] - t[0]) if t.size else 0.0
    separations = [v for s in segments for a in "xyz" if isinstance(v := s.get(f"separation_{a}_sigma"), float)]
    counts = {
        str(s): {"count": int((innovations["sensor"] == s).sum()), "dof": 3}
        for s in set(innovations["sensor"].tolist())
    }
    statistics: dict[str, Any] = {
        "sigma_heading_median_deg": float(np.median(heading)), "sigma_heading_max_deg": float(heading.max()),
        "sigma_tilt_median_deg": float(np.median(tilt)), "sigma_tilt_max_deg": float(tilt.max()),
        "forward_sigma_heading_max_deg": float(passes["forward_sigma_att_z_deg"].max()),
        "motions": motions, "stops": len(segments) - motions, "separation_checks": len(separations),
        "separation_inside_2sigma": sum(abs(v) <= 2 for v in separations), "innovations": counts,
        "forward_over_threshold_share": float(np.mean(passes["forward_sigma_att_z_deg"] > 1.0)),
        "gyro_bias_drift_deg_s": 0.0 if spec.zero_sigma else 0.039, "position_usable": spec.position == "good",
        "gap_count": int(spec.gap is not None), "jitter_ms": 0.02, "distance_m": 357.0 if motions else 0.0,
        "detector": {
            "enter": 12.0, "leave": 24.0, "margin": 174.0 if 0 < motions < len(segments) else math.nan, "source": "imu",
        },
    }  # fmt: skip
    if spec.position != "none":
        sigma = passes["sigma_position_x_m"]
        statistics |= {"position_sigma_median_m": float(np.median(sigma)), "position_sigma_max_m": float(sigma.max())}
    checks = list(spec.checks) or default_checks(spec)
    return {
        "attest_version": "0.1.0", "verdict": "WARN" if any(c["status"] == "WARN" for c in checks) else "PASS",
        "input": {
            "files": [{"name": spec.name, "path": spec.name, "bytes": 1, "sha256": "3f9a" + "0" * 58 + "c1"}],
            "start_utc": "2026-11-21T14:03:12Z", "duration_s": duration, "samples": t.size * 10, "rate_hz": 100.0,
            "sensors": [*(["sun sensor"] if spec.heading != "relative" else []), "accelerometer at stops"],
        },
        "coverage": {"rows_in": t.size * 10, "rows_used": t.size * 10, "share": 1.0 if not spec.gap else 0.98},
        "settings": {"stops.window_s": {"value": 1.0}, "world.frame": {"value": spec.frame}}, "statistics": statistics,
        "methods": {"smoother": "two-filter" if spec.backward else "none"}, "heading": spec.heading,
        "advice": {"threshold_deg": 1.0, "axis": "tilt" if spec.heading == "relative" else "heading", "lines": []},
        "warnings": [], "checks": checks, "gaps": [list(spec.gap)] if spec.gap else [], "pages": [], "history": [],
    }  # fmt: skip


def default_checks(spec: Spec) -> list[dict[str, str]]:
    out = []
    if spec.gap:
        length = round((spec.gap[1] - spec.gap[0]) / 60.0)
        out.append({"status": "WARN", "fact": f"Gap of {length} min", "detail": "attitude restarted at the next stop"})
    if spec.heading == "relative":
        fact = "No heading sensor: yaw is relative to the start"
        out.append({"status": "WARN", "fact": fact, "detail": "add a compass, sun sensor or GPS course"})
    out.append({"status": "PASS", "fact": "Forward and backward agree", "detail": "17 of 18 segment checks inside 2σ"})
    out.append({"status": "PASS", "fact": "Innovations are white", "detail": "mean NIS 5.1 for 5 degrees of freedom"})
    out.append({"status": "PASS", "fact": "No duplicates or saturation", "detail": "rate 100.0 Hz, jitter 0.02 ms"})
    return [{"name": f"check {k}", **c} for k, c in enumerate(out)]


def day() -> tuple[float, ...]:
    """24 h: 77 motions between stops, one stop of 5 h."""
    rng = np.random.default_rng(24)
    out: list[float] = []
    for k in range(77):
        out += [float(rng.uniform(20.0, 120.0)), float(rng.uniform(300.0, 1400.0))]
        if k == 38:
            out[-2] = 19000.0
    out.append(60.0)
    return tuple(v * 86400.0 / sum(out) if v < 19000.0 else v for v in out)


@pytest.fixture(scope="session")
def long_durations() -> tuple[float, ...]:
    return day()
