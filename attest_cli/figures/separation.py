"""Page 2, separation: forward minus backward against the sigma that both covariances predict."""

from __future__ import annotations

import math

import numpy as np

from ..maths.consistency import agree
from ..records import Result
from . import reduce, style, ticks
from .drive import AXES, Drive, Part
from .frame import beyond, new_page, row_name, segment_numbers, time_axis, time_panel
from .page import Page, Panel
from .words import listed, number, two_digits

INSIDE = 2.0
DOTS = 3.5
WIDE_DEG, DOUBTFUL_DEG, TIMES = 20.0, 5.0, 10.0  # 2 sigma too wide to compare: always; if so many smoothed sigma


def every_check(drive: Drive) -> list[tuple[Part, str, float]]:
    """All checks: motion, axis, separation in sigma."""
    every = [(p, a, p.value(f"separation_{a}_sigma")) for p in drive.motions for a in AXES]
    return [item for item in every if math.isfinite(item[2])]


def checks_of(drive: Drive) -> list[tuple[Part, str, float]]:
    """The checks that can fail: those where both passes together are certain enough to be compared."""
    return [item for item in every_check(drive) if predicted(drive, item[0], item[1]) <= _widest(drive, *item[:2])]


def predicted(drive: Drive, part: Part, axis: str) -> float:
    """Predicted 2 sigma in degrees at the check of a motion; 0 where it is not in the result."""
    return float(np.nan_to_num(2.0 * _at_check(drive, part, f"sigma_separation_{axis}_deg")))


def _widest(drive: Drive, part: Part, axis: str) -> float:
    """Above this predicted 2 sigma agreement tells nothing."""
    smoothed = _at_check(drive, part, f"smoothed_sigma_att_{axis}_deg")
    return min(WIDE_DEG, max(DOUBTFUL_DEG, TIMES * smoothed)) if math.isfinite(smoothed) else WIDE_DEG


def _at_check(drive: Drive, part: Part, name: str) -> float:
    at = part.value("separation_s")
    k = int(np.searchsorted(drive.t, at - 1e-6))
    return float(drive.column(name)[k]) if math.isfinite(at) and k < drive.t.size else math.nan


def checks_inside(drive: Drive) -> tuple[int, int]:
    """How many checks lie inside 2 sigma, and how many there are."""
    found = checks_of(drive)
    return sum(abs(v) <= INSIDE for _, _, v in found), len(found)


def status_of(drive: Drive) -> str:
    """PASS where the separations are those of two sigmas that hold; WARN where none can fail."""
    found = checks_of(drive)
    if not found and every_check(drive):
        return "WARN"
    return "PASS" if agree([v for _, _, v in found]) else "WARN"


def draw(result: Result, theme: str = "light") -> Page | None:
    """The page; None without a backward pass or without a stop."""
    drive = Drive(result)
    known = any(np.isfinite(drive.column(f"separation_{a}_deg")).any() for a in AXES)
    if not drive.stops or not known:
        return None
    inside, checks = checks_inside(drive)
    page = new_page(
        drive, theme, 5.3, _titles(drive, inside, checks),
        [drive.span, "attitude separation, forward minus backward, against the σ predicted from both covariances"],
        _alt(drive), status_of(drive) if every_check(drive) else "",
    )  # fmt: skip
    for k, axis in enumerate(AXES):
        panel = _row(page, drive, k, axis)
        if k == 0:
            page.text(panel.left, panel.top - 0.22, "separation, degrees", size=style.TICK, colour="mute")
            page.text(panel.left + 1.05, panel.top - 0.22, "grey ±1σ, ±2σ predicted", size=style.TICK, colour="mute")
            segment_numbers(page, drive, panel)
        if k == 2:
            time_axis(panel)
        if every_check(drive):
            _dots(page, drive, k, axis)
    return page


def _titles(drive: Drive, inside: int, checks: int) -> list[str]:
    every = every_check(drive)
    if not every:
        return ["Forward and backward pass overlap, but no motion gives a check"]
    if not checks:
        least = two_digits(min(predicted(drive, part, axis) for part, axis, _ in every))
        return [f"Passes are too uncertain to be compared: predicted ±2σ of ±{least}° and more"]
    if status_of(drive) == "PASS":
        agree = f"Forward and backward passes agree: {inside} of {checks} segment checks inside 2σ"
        doubtful = [f"{agree}, {len(every) - checks} too uncertain"] if len(every) > checks else []
        return [*doubtful, agree]
    part, axis, worst = max(checks_of(drive), key=lambda item: abs(item[2]))
    name = "heading" if axis == "z" else axis
    far = f"{two_digits(abs(worst))}σ"
    return [
        f"Forward and backward passes disagree: {checks - inside} of {checks} checks outside 2σ, up to {far}",
        f"Passes disagree: {checks - inside} of {checks} checks outside 2σ, segment {part.index} {name} by {far}",
        f"Passes disagree: {checks - inside} of {checks} checks outside 2σ",
    ]


def _alt(drive: Drive) -> str:
    outside = [(p, a, v) for p, a, v in checks_of(drive) if abs(v) > INSIDE]
    outside = sorted(outside, key=lambda item: -abs(item[2]))[:3]
    words = [
        f"segment {p.index} {'heading' if a == 'z' else a} is outside at {two_digits(abs(v))}σ" for p, a, v in outside
    ]
    return f"Three time series of separation with predicted bands over {drive.span}" + (
        f"; {listed(words)}." if words else "; no check is outside."
    )


def _row(page: Page, drive: Drive, k: int, axis: str) -> Panel:
    """One world axis over time: the bands of the prediction and the separation."""
    values = drive.column(f"separation_{axis}_deg")
    sigma = drive.column(f"sigma_separation_{axis}_deg")
    settled = drive.after_start & drive.before_end
    shown = np.where(settled & drive.moving, sigma, np.nan)
    limit = reduce.robust_limit([np.where(settled, values, np.nan)], shown, drive.moving)
    if not np.isfinite(limit):  # known at the ends only
        limit = reduce.robust_limit([values], sigma, drive.moving | True)
    limit = ticks.rounded_up(limit)
    panel = time_panel(page, drive, (0.95, 1.12 + 1.26 * k, 5.35, 1.10), (-limit, limit))
    panel.band(drive.t, -2.0 * sigma, 2.0 * sigma, drive.breaks, "band2")
    panel.band(drive.t, -sigma, sigma, drive.breaks, "band1")
    panel.across(0.0)
    panel.series(drive.t, values, drive.breaks, "ink", 1.0)
    beyond(panel, drive.t, {"ink": np.where(settled, values, np.nan)}, limit)
    if np.isfinite(values).any():
        panel.y_axis(ticks.symmetric(limit))
    else:
        centre = panel.left + 0.5 * panel.width
        page.text(centre, panel.top + 0.5, "never known to both passes", colour="mute", align="middle", halo=True)
    row_name(page, panel, axis, drive.directions[k])
    return panel


def _dots(page: Page, drive: Drive, k: int, axis: str) -> None:
    """One value per motion at the right, in sigma; outliers as crosses at their value or at the edge.

    Checks that are too uncertain to fail stand as open circles.
    """
    top = 1.12 + 1.26 * k
    every = [(p.index, v) for p, a, v in every_check(drive) if a == axis]
    found = [(p.index, v) for p, a, v in checks_of(drive) if a == axis]
    numbers = [p.index for p in drive.motions] or [0]
    panel = page.panel((6.52, top, 0.95, 1.10), (min(numbers) - 1.2, max(numbers) + 1.2), (-DOTS, DOTS))
    low, high = panel.x_limits
    panel.polygon([low, high, high, low], [-2, -2, 2, 2], "band2")
    panel.polygon([low, high, high, low], [-1, -1, 1, 1], "band1")
    panel.across(0.0)
    panel.y_axis(([-2.0, 0.0, 2.0], ["−2σ", "0", "+2σ"]), side="right", line=False)
    inside = [(n, v) for n, v in found if abs(v) <= INSIDE]
    if inside:
        size = 4.2 if len(numbers) < 20 else 2.6
        panel.points([n for n, _ in inside], [v for _, v in inside], "circle", size, fill="ink")
    doubtful = [item for item in every if item not in found]
    if doubtful:
        shown = [max(-DOTS, min(DOTS, v)) for _, v in doubtful]
        panel.points([n for n, _ in doubtful], shown, "circle", 4.2, edge="measurement", width=0.7)
    for n, v in found:
        if abs(v) > INSIDE:
            panel.points([n], [max(-DOTS, min(DOTS, v))], "heavy-cross", 4.2, fill="limit")
    if not every:
        page.text(panel.left + 0.475, top + 0.59, "no check", size=style.NOTE, colour="mute", align="middle", halo=True)
    if k == 0:
        page.text(7.7, 1.05, "one value per segment, in σ", size=style.NUMBER, colour="mute", align="right")
    if k == 2:
        at = numbers if len(numbers) <= 8 else numbers[:: -(-len(numbers) // (6 if numbers[-1] < 100 else 4))]
        for n in at:
            page.text(float(panel.x(n)), top + 1.255, number(n), size=style.TICK, colour="mute", align="middle")
        page.text(panel.left + 0.475, top + 1.415, "motion segment", align="middle")
