"""Page 3, gyro bias: what each pass believes, beside the mean rate of each stop."""

from __future__ import annotations

import math

import numpy as np

from ..records import Array, Result
from . import style, ticks
from .drive import AXES, Drive
from .frame import new_page, padded, row_name, segment_numbers, time_axis, time_panel
from .page import Page, Panel
from .words import short_duration, two_digits

TO_DEG = 180.0 / math.pi
STEADY, STEADY_DEG_S = 0.1, 1e-6  # a drift below this share of its sigma, or this rate, is none


def draw(result: Result, theme: str = "light") -> Page | None:
    """The page; None where no pass estimates a gyro bias."""
    drive = Drive(result)
    if "gyro bias" in drive.not_estimated or not any(
        np.isfinite(drive.column(f"smoothed_gyro_bias_{a}_rad_s")).any() for a in AXES
    ):
        return None
    means = " · points: mean rate at each stop with 2σ bar" if _stop_means(drive, "x")[0].size else ""
    who = "gyro bias of the three passes" if drive.two_passes else "gyro bias of the forward and the smoothed pass"
    page = new_page(
        drive, theme, 5.6, _titles(drive), [drive.span, who + means, "no truth is used"],
        f"Gyro bias about three body axes over {drive.span} from the forward, backward and smoothed pass.",
    )  # fmt: skip
    for k, axis in enumerate(AXES):
        panel = _row(page, drive, k, axis)
        if k == 0:
            page.text(panel.left, panel.top - 0.22, "gyro bias, °/s", size=style.TICK, colour="mute")
            segment_numbers(page, drive, panel)
            _key(page, drive, panel)
    time_axis(panel)
    return page


def _titles(drive: Drive) -> list[str]:
    """Drift against its own sigma: a drift that the sigma hides is none."""
    span = short_duration(drive.duration_s)
    drift = drive.stat("gyro_bias_drift_deg_s")
    sigmas = [drive.column(f"smoothed_sigma_gyro_bias_{a}_rad_s") * TO_DEG for a in AXES]
    known = np.concatenate([s[np.isfinite(s)] for s in sigmas])
    twice = 2.0 * float(np.median(known)) if known.size else math.nan
    if not math.isfinite(drift):
        return [f"Gyro bias over {span}"]
    if drift < max(STEADY * twice / 2.0 if math.isfinite(twice) else 0.0, STEADY_DEG_S):
        return [
            f"Gyro bias is constant over {span}" + (f", 2σ {two_digits(twice)} °/s" if twice > 0.0 else ""),
            "Gyro bias is constant",
        ]
    if math.isfinite(twice) and drift <= twice:
        return [
            f"Gyro bias moves {two_digits(drift)} °/s in {span}, no more than its 2σ of {two_digits(twice)} °/s",
            f"Gyro bias is steady within its 2σ of {two_digits(twice)} °/s",
        ]
    return [f"Gyro bias drifts {two_digits(drift)} °/s in {span}"]


def _stop_means(drive: Drive, axis: str) -> tuple[Array, Array, Array]:
    """Time, mean and sigma in deg/s of each stop's mean rate."""
    rows = [
        (0.5 * (p.start + p.end), p.value(f"gyro_mean_{axis}_rad_s"), p.value(f"gyro_mean_sigma_{axis}_rad_s"))
        for p in drive.stops
    ]
    known = np.array([r for r in rows if math.isfinite(r[1])], dtype=np.float64).reshape(-1, 3)
    return known[:, 0], known[:, 1] * TO_DEG, np.nan_to_num(known[:, 2]) * TO_DEG


def limits(drive: Drive, axis: str) -> tuple[float, float]:
    """Limits from the stops and the smoothed band only: the passes may leave the panel."""
    smoothed = drive.column(f"smoothed_gyro_bias_{axis}_rad_s") * TO_DEG
    sigma = np.nan_to_num(drive.column(f"smoothed_sigma_gyro_bias_{axis}_rad_s")) * TO_DEG
    _, mean, spread = _stop_means(drive, axis)
    known = np.isfinite(smoothed)
    low, high = smoothed[known] - 2.0 * sigma[known], smoothed[known] + 2.0 * sigma[known]
    values = [*(mean - 2.0 * spread), *(mean + 2.0 * spread)]
    if known.any():
        values += [float(np.quantile(low, 0.015)), float(np.quantile(high, 0.985))]
        values += [float(smoothed[known].min()), float(smoothed[known].max())]
    return padded(min(values, default=math.nan), max(values, default=math.nan), 0.08)


def _row(page: Page, drive: Drive, k: int, axis: str) -> Panel:
    low, high = limits(drive, axis)
    panel = time_panel(page, drive, (0.95, 1.12 + 1.34 * k, 6.05, 1.19), (low, high))
    smoothed = drive.column(f"smoothed_gyro_bias_{axis}_rad_s") * TO_DEG
    sigma = drive.column(f"smoothed_sigma_gyro_bias_{axis}_rad_s") * TO_DEG
    at = ticks.linear(low, high, 4)
    panel.grid(at[0])
    panel.band(drive.t, smoothed - 2.0 * sigma, smoothed + 2.0 * sigma, drive.breaks)
    for which in ("forward", "backward"):
        panel.series(drive.t, drive.column(f"{which}_gyro_bias_{axis}_rad_s") * TO_DEG, drive.breaks, which, 0.8)
    panel.series(drive.t, smoothed, drive.breaks, "ink", 1.4)
    panel.y_axis(at)
    _means(panel, drive, axis)
    row_name(page, panel, axis)
    return panel


def _means(panel: Panel, drive: Drive, axis: str) -> None:
    """Stop means as open circles with bars of 2 sigma; small where there are many."""
    t, mean, spread = _stop_means(drive, axis)
    for at, value, two in zip(t.tolist(), mean.tolist(), (2.0 * spread).tolist(), strict=True):
        x = float(panel.x(at))
        panel.page.line([(x, float(panel.y(value - two))), (x, float(panel.y(value + two)))], "measurement", 0.9)
    panel.points(t, mean, "circle", 3.6 if t.size <= 40 else 2.4, fill="paper", edge="measurement", width=0.9)


def _key(page: Page, drive: Drive, panel: Panel) -> None:
    """The one key column, right of the first panel."""
    words = [
        ("forward", "forward"),
        ("backward", "backward"),
        ("smoothed ±2σ", "ink"),
        ("stop mean ±2σ", "measurement"),
    ]
    if not drive.two_passes:
        words.pop(1)
    if not _stop_means(drive, "x")[0].size:
        words.pop()
    for k, (word, colour) in enumerate(words):
        bold = colour == "ink"
        page.text(panel.right + 0.06, panel.top + 0.1 + 0.17 * k, word, size=style.TICK, colour=colour, bold=bold)
