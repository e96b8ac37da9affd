"""Page 6, plan: the track from above with its ellipses, the stops, and the height."""

from __future__ import annotations

import math

import numpy as np

from ..records import Result
from . import plan_view, style, ticks
from .drive import Drive, Part
from .frame import RIGHT, new_page, padded, row_name, time_axis, time_panel
from .page import Page
from .words import number, sigma_decimals, two_digits

MOST_ROWS = 14
COLUMNS = (6.2, 6.7, 7.18, RIGHT)


def draw(result: Result, theme: str = "light") -> Page | None:
    """The page; None without a position that may be drawn."""
    drive = Drive(result)
    if not plan_view.usable(drive):
        return None
    page = new_page(
        drive, theme, 6.9, titles(drive), [drive.span, driven(drive), plan_view.axes_words(drive)],
        f"Plan view with 95 % ellipses and {len(drive.stops)} stops, and height over {drive.span}.",
        "FAIL" if drive.failed else "PASS",
    )  # fmt: skip
    plan_view.draw_plan(page, drive, (0.45, 0.98, 4.55, 4.15))
    _key(page, drive)
    _table(page, drive)
    _height(page, drive)
    return page


def titles(drive: Drive) -> list[str]:
    """How well the position is known, in the middle and at worst."""
    median, worst = drive.stat("position_sigma_median_m"), drive.stat("position_sigma_max_m")
    if drive.failed and math.isfinite(median):
        return [f"Position σ of {two_digits(median)} m does not hold: a check failed"]
    head = f"Position known to {two_digits(median)} m" if math.isfinite(median) else "Position of unknown σ"
    if math.isfinite(worst) and worst > 1.5 * median:
        return [f"{head}, and to {two_digits(worst)} m at worst"]
    return [f"{head} all along" if math.isfinite(worst) else head]


def driven(drive: Drive) -> str:
    """``357 m driven``."""
    distance = drive.stat("distance_m")
    return f"{number(distance, 0 if distance >= 10.0 else 1)} m driven" if math.isfinite(distance) else ""


def _key(page: Page, drive: Drive) -> None:
    """What is drawn, right of the plan."""
    page.text(5.35, 1.08, "smoothed", bold=True)
    page.text(5.35, 1.24, "95 % ellipses along the track", size=style.TICK, colour="mute")
    if drive.stops:
        page.marks([(5.4, 1.385)], "square", 5.5, fill="stop", edge="ink", width=0.7)
        page.text(5.5, 1.42, "stop, numbered by segment", size=style.TICK)


def _rows(drive: Drive) -> list[Part]:
    """Stops of the table: all, or those with the largest sigma, in time order."""
    known = [p for p in drive.stops if math.isfinite(p.value("position_x_m"))]
    worst = sorted(known, key=lambda p: -np.nan_to_num(p.value("sigma_position_m")))[:MOST_ROWS]
    return sorted(worst, key=lambda p: p.index)


def _table(page: Page, drive: Drive) -> None:
    """Where each stop was, to the digit that its sigma supports."""
    found = _rows(drive)
    if not found:
        return
    names = ("x, m", "y, m", "z, m") if drive.relative else ("east, m", "north, m", "up, m")
    sigmas = [p.value("sigma_position_m") for p in found]
    known = [s for s in sigmas if math.isfinite(s) and s > 0.0]
    decimals = min(sigma_decimals(min(known), 1), 3) if known else 1
    y = 1.82
    page.text(5.35, y, "Stop", size=style.TABLE, colour="mute")
    for right, name in zip(COLUMNS, (*names, "σ, m"), strict=True):
        page.text(right, y, name, size=style.TABLE, colour="mute", align="right")
    for part, sigma in zip(found, sigmas, strict=True):
        y += 0.17
        page.text(5.37, y, str(part.index), size=style.TICK, bold=True)
        cells = [number(part.value(f"position_{a}_m"), decimals) for a in "xyz"]
        for right, cell in zip(COLUMNS, cells, strict=False):
            page.text(right, y, cell, size=style.TICK, align="right")
        page.text(RIGHT, y, two_digits(sigma), size=style.TICK, colour="mute", align="right")
    left_out = len([p for p in drive.stops if math.isfinite(p.value("position_x_m"))]) - len(found)
    if left_out:
        words = f"the {len(found)} with the largest σ; {number(left_out)} more in segments.csv"
        page.text(5.35, y + 0.2, words, size=style.NOTE, colour="mute")


def _height(page: Page, drive: Drive) -> None:
    """Height above the start with +-2 sigma."""
    height, sigma = drive.column("position_z_m"), drive.column("sigma_position_z_m")
    known = np.flatnonzero(np.isfinite(height))
    if not known.size:
        return
    reach = np.nan_to_num(2.0 * sigma[known])
    low = min(float(np.quantile(height[known] - reach, 0.01)), float(height[known].min()))
    high = max(float(np.quantile(height[known] + reach, 0.99)), float(height[known].max()))
    low, high = padded(low, high, 0.1)
    panel = time_panel(page, drive, (1.05, 5.4, 6.65, 0.95), (low, high))
    at = ticks.linear(low, high, 4)
    panel.grid(at[0])
    panel.band(drive.t, height - 2.0 * sigma, height + 2.0 * sigma, drive.breaks)
    panel.series(drive.t, height, drive.breaks, "ink", 1.2)
    panel.y_axis(at)
    time_axis(panel)
    row_name(page, panel, "height", "m, band ±2σ")
