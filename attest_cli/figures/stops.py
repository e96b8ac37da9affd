"""Page 7, stop detector: the statistic against its thresholds, and each stop at close range."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..records import Array, Bools, Result
from . import style, ticks
from .drive import HOUR_CLOCK_S, Drive, Part, real
from .frame import LEFT, RIGHT, new_page, row_name, segment_numbers, time_axis, time_panel
from .page import DASHED, DOTTED, Page, Panel
from .words import clock, counted, duration, number, two_digits

AROUND_S = 5.0
PER_ROW, MOST = 7, 14
CLEAR_MARGIN = 3.0  # motion closer to the threshold than this is told


def draw(result: Result, theme: str = "light") -> Page | None:
    """The page; None where the statistic is not in the result."""
    drive = Drive(result)
    statistic = drive.column("stop_statistic")
    if not (statistic > 0.0).any():
        return None
    shown = closest(drive)
    lines = -(-len(shown) // PER_ROW)
    height = 5.3 + 1.15 * (lines - 1) if lines else 4.1
    window = real(drive.setting("stops.window_s"))
    words = "stop statistic in units of sensor noise" + (f", {window:g} s window" if math.isfinite(window) else "")
    page = new_page(
        drive, theme, height, titles(drive), [drive.span, words],
        f"Stop statistic over {drive.span} on a log axis with both thresholds, and {len(shown)} stops at close range.",
        _status(drive),
    )  # fmt: skip
    panel = _overall(page, drive, statistic)
    _marginal(page, drive, panel, statistic)
    _each(page, drive, panel, statistic, shown)
    return page


def _detector(drive: Drive) -> dict[str, Any]:
    return dict((drive.report.get("statistics") or {}).get("detector") or {})


def _status(drive: Drive) -> str:
    margin = real(_detector(drive).get("margin"))
    return "WARN" if not drive.stops or margin < CLEAR_MARGIN else "PASS"


def titles(drive: Drive) -> list[str]:
    """How many stops, and how far motion stands from the threshold."""
    detector = _detector(drive)
    margin, source = real(detector.get("margin")), str(detector.get("source") or "imu")
    if not drive.stops:
        statistic, enter = drive.column("stop_statistic"), real(detector.get("enter"))
        known = statistic[statistic > 0.0]
        least_of = float(known.min())  # rounded down, so that "above" stays true
        words = number(math.floor(least_of)) if least_of >= 10.0 else number(math.floor(10.0 * least_of) / 10.0, 1)
        tail = f"; the statistic stays above {words}" if least_of > enter else ""
        return [f"No stop found{tail}"]
    if not drive.motions:
        return [
            "The whole log is one stop" if len(drive.stops) == 1 else f"{counted(len(drive.stops), 'stop')}, no motion"
        ]
    given = {"file": "given by file", "odometry": "found with odometry"}.get(source, "found")
    head = f"{counted(len(drive.stops), 'stop')} {given}"
    if not math.isfinite(margin):
        return [head]
    if margin < 1.0:
        return [f"{head}, but 5 % of motion lies below {two_digits(margin)} of the threshold", head]
    times = number(margin) if margin >= 10.0 else number(margin, 1)
    only = "; motion stands" if margin >= CLEAR_MARGIN else ", but motion stands only"
    return [f"{head}{only} {times} times above the threshold", head]


def _overall(page: Page, drive: Drive, statistic: Array) -> Panel:
    """The statistic over the whole log with the thresholds named at the right."""
    known = statistic[statistic > 0.0]
    levels = [v for v in (real(_detector(drive).get(k)) for k in ("enter", "leave")) if v > 0.0]
    low = min(float(np.quantile(known, 0.001)), *levels) if levels else float(np.quantile(known, 0.001))
    high = max(float(known.max()), *levels) if levels else float(known.max())
    low, high = max(low, high * 1e-8) / 1.6, high * 1.5
    panel = time_panel(page, drive, (1.05, 1.12, 5.5, 2.1), (low, high), log=True)
    at = ticks.log(low, high, 7)
    panel.grid(at[0])
    panel.series(drive.t, statistic, drive.breaks, "ink", 0.5 if drive.long else 0.8)
    panel.y_axis(at)
    time_axis(panel)
    segment_numbers(page, drive, panel)
    row_name(page, panel, "stop", "statistic", "log axis")
    _thresholds(panel, drive, named=True)
    return panel


def _thresholds(panel: Panel, drive: Drive, *, named: bool = False) -> None:
    """Enter dashed, leave dotted; names never closer than a line to each other."""
    detector = _detector(drive)
    enter, leave = real(detector.get("enter")), real(detector.get("leave"))
    if enter > 0.0:
        panel.across(enter, "limit", 0.8, DASHED)
    if leave > 0.0 and named:
        panel.across(leave, "limit", 0.8, DOTTED)
    if not named:
        return
    places = [float(panel.y(v)) + 0.035 if v > 0.0 else math.nan for v in (leave, enter)]
    if abs(places[1] - places[0]) < 0.15:
        middle_of = 0.5 * (places[0] + places[1])
        places = [middle_of - 0.075, middle_of + 0.075]
    for y, words in zip(places, ("leave stop", "enter stop"), strict=True):
        if math.isfinite(y):
            panel.page.text(RIGHT, y, words, size=style.TICK, colour="limit", align="right")


def _marginal(page: Page, drive: Drive, panel: Panel, statistic: Array) -> None:
    """For how long stop and motion show each value, sharing the axis of the statistic; each to its own height."""
    side = page.panel((6.64, panel.top, 0.42, panel.height), (0.0, 1.0), panel.y_limits, log=True)
    edges = np.geomspace(*panel.y_limits, 61)
    known = statistic > 0.0
    step = np.where(drive.breaks, 0.0, np.diff(drive.t, append=drive.t[-1:]))
    for moving, colour, name in ((True, "band", "motion"), (False, "stop", "stop")):
        rows = known & (drive.moving == moving)
        values = statistic[rows]
        counts = np.histogram(values, bins=edges, weights=step[rows])[0]
        if not counts.max(initial=0.0) > 0.0:
            continue
        share = np.concatenate(([0.0], np.repeat(counts / counts.max(), 2), [0.0]))
        outline = (share, np.repeat(edges, 2))
        side.polygon(*outline, colour)
        if not moving:
            side.polygon(*outline, "mute", edge=0.5)
        at = float(side.y(float(np.median(values))))
        if not moving:
            at = _clear_of(at, panel, drive)
        page.text(RIGHT, at + 0.035, name, size=style.TICK, colour="mute" if not moving else "text", align="right")
    page.line([(side.left, side.top), (side.left, side.bottom)])


def _clear_of(at: float, panel: Panel, drive: Drive) -> float:
    """Height of the word "stop", moved down where the name of a threshold stands."""
    enter = real(_detector(drive).get("enter"))
    if enter > 0.0:
        at = max(at, float(panel.y(enter)) + 0.2) if at > float(panel.y(enter)) - 0.25 else at
    return min(at, panel.bottom + 0.12)


def closest(drive: Drive) -> list[Part]:
    """Stops to show at close range: all, or the shortest and those nearest to the threshold, in time order."""
    if len(drive.stops) <= MOST:
        return list(drive.stops)
    shortest = sorted(drive.stops, key=lambda p: p.length)[: MOST // 2]
    statistic = drive.column("stop_statistic")
    rest = [p for p in drive.stops if p not in shortest]
    weakest = sorted(rest, key=lambda p: -_highest(statistic, _during(drive, p)))[: MOST - len(shortest)]
    return sorted(shortest + weakest, key=lambda p: p.index)


def _during(drive: Drive, part: Part) -> Bools:
    start, end = _used(part)
    return np.asarray((drive.t >= start) & (drive.t <= end))


def _highest(values: Array, rows: Bools) -> float:
    known = values[rows & np.isfinite(values)]
    return float(known.max()) if known.size else 0.0


def _used(part: Part) -> tuple[float, float]:
    start, end = part.value("used_start_s"), part.value("used_end_s")
    return (start if math.isfinite(start) else part.start), (end if math.isfinite(end) else part.end)


def _each(page: Page, drive: Drive, panel: Panel, statistic: Array, shown: list[Part]) -> None:
    """One small panel per stop, five seconds either side, on the shared log axis."""
    if not shown:
        return
    page.text(
        LEFT, 3.86, "Each stop" if len(shown) == len(drive.stops) else "Critical stops", size=style.ROW, bold=True
    )
    x = LEFT + style.text_width(
        "Critical stops" if len(shown) < len(drive.stops) else "Each stop", style.ROW, bold=True
    )
    note = "statistic from 5 s before to 5 s after; shaded: used as stop"
    if len(shown) < len(drive.stops):
        note = f"the {len(shown)} shortest and closest to the threshold of {number(len(drive.stops))}, 5 s either side"
    page.text(x + 0.1, 3.86, note, size=style.NOTE, colour="mute")
    step = (RIGHT - LEFT + 0.12) / PER_ROW
    for k, part in enumerate(shown):
        box = (LEFT + step * (k % PER_ROW), 3.98 + 1.15 * (k // PER_ROW), step - 0.12, 0.78)
        small = page.panel(box, (part.start - AROUND_S, part.end + AROUND_S), panel.y_limits, log=True)
        small.shade([_used(part)])
        near = np.asarray((drive.t >= small.x_limits[0]) & (drive.t <= small.x_limits[1]))
        small.series(drive.t[near], statistic[near], drive.breaks[near], "ink", 0.9)
        _thresholds(small, drive)
        _ends(drive, part, small)
        page.text(
            box[0] + 0.5 * box[2], box[1] + 0.12, f"{part.index} · {duration(round(part.length, 1))}", size=style.NOTE,
            align="middle",
        )  # fmt: skip


def _ends(drive: Drive, part: Part, small: Panel) -> None:
    """Start and end of a stop under its panel, held within it; the start alone where both have no room."""
    small.x_axis(([part.start, part.end], ["", ""]))
    free = small.left - 0.001
    for at in (part.start, part.end):
        words = clock(at, hours=drive.limits[1] >= HOUR_CLOCK_S)
        half = 0.5 * style.text_width(words, style.TICK)
        x = min(max(float(small.x(at)), small.left + half), small.right - half)
        if x - half >= free:
            small.page.text(x, small.bottom + 0.155, words, size=style.TICK, colour="mute", align="middle")
            free = x + half + 0.05
