"""Rows of the overview: an angle once, under it each pass minus the smoothed one; or one separation per motion."""

from __future__ import annotations

import math

import numpy as np

from ..records import Array
from . import reduce, style, ticks
from .drive import AXES, Drive
from .frame import beyond, padded, row_name, time_panel
from .page import Box, Page, Panel
from .separation import checks_of
from .words import two_digits

STRIP, DIFFERENCE, WITHIN, AFTER = 0.55, 0.78, 0.06, 0.15
PAIR = STRIP + WITHIN + DIFFERENCE
INSET = 0.035  # labels of a strip stay this far from its ends, clear of those of the next
TURNS_FROM = 3.0
DOT_LIMIT = 3.6  # a panel of separations in sigma reaches this far


def angle_strip(page: Page, drive: Drive, box: Box, name: str) -> Panel:
    """The smoothed angle over time; as mean and min-max field where the line would fill the panel."""
    angle = drive.angle("smoothed", name)
    known = angle[np.isfinite(angle)]
    low, high = (float(known.min()), float(known.max())) if known.size else (math.nan, math.nan)
    turns = high - low > TURNS_FROM * 360.0
    if turns:
        angle, low, high = angle / 360.0, low / 360.0, high / 360.0
    low, high = padded(*(_least_span(low, high, 0.2)))
    panel = time_panel(page, drive, box, (low, high))
    at = ticks.linear(low, high, 3) if turns else ticks.angle(low, high, 4 if name == "yaw" else 3)
    panel.grid(at[0])
    panel.y_axis(at, inset=INSET)
    dense = known.size > 0 and ((drive.long and name != "yaw") or _dense(panel, drive, angle, high - low))
    if dense:
        _mean_and_reach(panel, drive, angle)
    else:
        panel.series(drive.t, angle, drive.breaks, "ink", 0.9 if drive.short else 0.7)
    datum = ["relative"] if name == "yaw" and drive.relative else []
    row_name(
        page, panel, name, *(["turns"] if turns else []), *datum, *(["mean", "min–max"] if dense else ["smoothed"])
    )
    return panel


def _least_span(low: float, high: float, least: float) -> tuple[float, float]:
    """Limits at least this far apart, so that noise of a resting log is not blown up."""
    short = max(0.0, least - (high - low))
    return low - 0.5 * short, high + 0.5 * short


def _dense(panel: Panel, drive: Drive, y: Array, height: float) -> bool:
    known = np.isfinite(y) & (drive.moving | ~drive.moving.any())
    return reduce.is_dense(drive.t[known], y[known], *panel.x_limits, panel.columns, height)


def _mean_and_reach(panel: Panel, drive: Drive, y: Array) -> None:
    """Min-max field with the mean of every third column over it."""
    panel.band(drive.t, y, y, drive.breaks, "band")
    for piece in reduce.pieces(np.isfinite(y), drive.breaks):
        t, mean = reduce.column_mean(drive.t[piece], y[piece], *panel.x_limits, panel.columns // 3)
        panel.series(t, mean, np.zeros(t.size, dtype=np.bool_), "ink", 0.7)


def difference_strip(page: Page, drive: Drive, box: Box, name: str) -> Panel:
    """Forward and backward minus smoothed around zero, on the band of +-2 sigma of the smoothed angle."""
    sigma = drive.column(f"smoothed_sigma_{name}_deg")
    passes = {which: drive.difference(which, name) for which in ("forward", "backward")}
    settled = [np.where(drive.settled(which), d, np.nan) for which, d in passes.items()]
    limit = ticks.rounded_up(reduce.robust_limit(settled, sigma, drive.moving))
    panel = time_panel(page, drive, box, (-limit, limit))
    panel.band(drive.t, -2.0 * sigma, 2.0 * sigma, drive.breaks, "band")
    for which, values in passes.items():
        panel.series(drive.t, values, drive.breaks, which, 0.9)
    panel.across(0.0, "ink", 0.9)
    panel.y_axis(ticks.symmetric(limit, "°"), inset=INSET)
    beyond(panel, drive.t, dict(zip(passes, settled, strict=True)), limit, [*passes.values(), 0.0 * drive.t])
    row_name(page, panel, "", "minus", "smoothed", y=panel.top + 0.18)
    drawn = [which for which, values in passes.items() if np.isfinite(values).any()]
    _key(page, panel, drawn, relative=name == "yaw" and drive.relative)
    return panel


def _key(page: Page, panel: Panel, drawn: list[str], *, relative: bool) -> None:
    """Words at the right in the colour of what they name."""
    at = panel.top + 0.5 * panel.height + 0.035
    page.text(panel.right + 0.08, at, "±2σ since start" if relative else "smoothed ±2σ", colour="mute")
    for which in drawn:
        page.text(panel.right + 0.08, at + (0.225 if which == "backward" else -0.225), which, colour=which)


def separation_strip(page: Page, drive: Drive, box: Box, axis: int) -> Panel:
    """One dot per motion: forward minus backward about a world axis, in sigma of the prediction."""
    panel = page.panel(box, drive.limits, (-DOT_LIMIT, DOT_LIMIT))
    panel.polygon([*drive.limits, *drive.limits[::-1]], [-2, -2, 2, 2], "band2")
    panel.polygon([*drive.limits, *drive.limits[::-1]], [-1, -1, 1, 1], "band1")
    panel.shade([(p.start, p.end) for p in drive.wide_stops(box[2])])
    panel.shade([(a, b) for a, b in drive.gaps], "gap")
    panel.across(0.0)
    panel.y_axis(([-2.0, 0.0, 2.0], ["−2σ", "0", "+2σ"]))
    name = AXES[axis]
    checks = [(p.value("separation_s"), p.value(f"separation_{name}_sigma"), p.index) for p in drive.motions]
    known = [(t, v, k) for t, v, k in checks if math.isfinite(t) and math.isfinite(v)]
    able = {p.index for p, a, _ in checks_of(drive) if a == name}
    doubtful = [(t, max(-DOT_LIMIT, min(DOT_LIMIT, v))) for t, v, k in known if k not in able]
    if doubtful:
        panel.points([t for t, _ in doubtful], [v for _, v in doubtful], "circle", 2.4, edge="measurement", width=0.5)
    known = [item for item in known if item[2] in able]
    inside = [(t, v) for t, v, _ in known if abs(v) <= 2.0]
    if inside:
        panel.points([t for t, _ in inside], [v for _, v in inside], "circle", 2.6, fill="ink")
    _outliers(panel, [item for item in known if abs(item[1]) > 2.0])
    row_name(page, panel, "", "forward −", "backward", y=panel.top + 0.18)
    at = panel.top + 0.5 * panel.height
    words = f"about {name}, {drive.directions[axis]}" if axis < 2 else "heading"
    page.text(panel.right + 0.08, at, words, size=style.NOTE, colour="mute")
    page.text(panel.right + 0.08, at + 0.125, "one dot a motion", size=style.NOTE, colour="mute")
    return panel


def _outliers(panel: Panel, found: list[tuple[float, float, int]]) -> None:
    """Checks outside 2 sigma; the three largest are named, none closer than 60 px to another name."""
    if not found:
        return
    reach = DOT_LIMIT - 0.35
    t, v = [item[0] for item in found], [max(-reach, min(reach, item[1])) for item in found]
    panel.points(t, v, "heavy-cross", 3.6, fill="limit")
    named: list[float] = []
    for at, value, index in sorted(found, key=lambda item: -abs(item[1])):
        x = float(panel.x(at))
        if len(named) == 3 or any(abs(x - other) < 0.95 for other in named):
            continue
        named.append(x)
        left = x > panel.right - 0.9
        panel.label(
            at, max(-reach, min(reach, value)), f"segment {index}, {two_digits(value)}σ", colour="limit",
            size=style.NOTE, align="right" if left else "left", shift=(-0.06 if left else 0.06, 0.035), halo=True,
        )  # fmt: skip


def since_start_strip(page: Page, drive: Drive, box: Box) -> Panel:
    """The band of +-2 sigma of a heading that nothing in the log holds."""
    sigma = drive.column("smoothed_sigma_att_z_deg")
    known = sigma[np.isfinite(sigma)]
    limit = ticks.rounded_up(2.2 * float(np.quantile(known, 0.995)) if known.size else math.nan)
    panel = time_panel(page, drive, box, (-limit, limit))
    panel.band(drive.t, -2.0 * sigma, 2.0 * sigma, drive.breaks, "band")
    panel.across(0.0, "ink", 0.9)
    panel.y_axis(ticks.symmetric(limit, "°"), inset=INSET)
    row_name(page, panel, "", "σ", y=panel.top + 0.22)
    page.text(panel.right + 0.08, panel.top + 0.5 * panel.height + 0.035, "±2σ since start", colour="mute")
    return panel
