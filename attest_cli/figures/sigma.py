"""Page 4, sigma: what smoothing gains over each pass, and when a stop would have been due."""

from __future__ import annotations

import math

import numpy as np

from ..records import Array, Result
from . import style, ticks
from .drive import Drive, Part, real
from .frame import beyond, new_page, overlap, row_name, segment_numbers, struck, text_box, time_axis, time_panel
from .page import DASHED, Align, Page, Panel
from .words import clock, percent, two_digits

PASSES = ("backward", "forward", "smoothed")
DECADES = 5.0  # a log axis never reaches further below its top
VAGUE_DEG = 10.0  # nothing stays below a sigma as large


def draw(result: Result, theme: str = "light") -> Page | None:
    """The page; None where no sigma is known."""
    drive = Drive(result)
    tilt = {which: drive.tilt_sigma(which) for which in PASSES}
    heading = {which: drive.column(f"{which}_sigma_att_z_deg") for which in PASSES}
    if not any(np.isfinite(v).any() for v in (*tilt.values(), *heading.values())):
        return None
    both = "attitude σ of the three passes" if drive.two_passes else "attitude σ of the forward and the smoothed pass"
    page = new_page(
        drive, theme, 5.6, _titles(drive), [drive.span, both + _never_above(drive, tilt, heading)],
        f"Tilt and heading σ over {drive.span} on log axes.", _status(drive),
    )  # fmt: skip
    asked = _asked(drive)
    for k, (name, found) in enumerate((("tilt", tilt), ("heading", heading))):
        panel = (_worst_row if drive.long else _row)(
            page, drive, k, found, _threshold(drive) if name in asked else math.nan
        )
        notes = [*(["σ since", "start"] if name == "heading" and drive.relative else ["σ"]), "log axis"]
        row_name(page, panel, name, *notes, *(["worst of", "each motion"] if drive.long else []))
        if k == 0:
            segment_numbers(page, drive, panel)
        if name == asked[-1] and not drive.long:
            _advice(panel, drive, list((tilt if name == "tilt" else heading).values()))
    time_axis(panel)
    return page


def _threshold(drive: Drive) -> float:
    return real((drive.report.get("advice") or {}).get("threshold_deg"))


def _asked(drive: Drive) -> tuple[str, ...]:
    """Panels that the stop threshold speaks of."""
    axis = str((drive.report.get("advice") or {}).get("axis") or "")
    return (axis,) if axis in ("tilt", "heading") else ("tilt", "heading")


def _status(drive: Drive) -> str:
    """WARN where even the smoothed sigma passes the threshold; FAIL where a check failed."""
    if drive.failed:
        return "FAIL"
    return "WARN" if any(_most(drive, name) > _threshold(drive) for name in _asked(drive)) else "PASS"


def _sigma(drive: Drive, which: str, name: str) -> Array:
    """Sigma of tilt or heading of one pass."""
    return drive.tilt_sigma(which) if name == "tilt" else drive.column(f"{which}_sigma_att_z_deg")


def _most(drive: Drive, name: str) -> float:
    """Largest smoothed sigma of the report and of every node; nan where none is known."""
    known = np.append(_sigma(drive, "smoothed", name), drive.stat(f"sigma_{name}_max_deg"))
    known = known[np.isfinite(known)]
    return float(known.max()) if known.size else math.nan


def share_over(drive: Drive, name: str, threshold: float) -> float:
    """Share of the time in which the forward sigma, past its start, is above a threshold; nan without one."""
    values, step = _sigma(drive, "forward", name), np.diff(drive.t, append=drive.t[-1:])
    step = np.where(np.isfinite(values) & ~drive.breaks, step, 0.0)
    if not (math.isfinite(threshold) and step.sum() > 0.0):
        return math.nan
    return float(step[drive.settled("forward") & (values > threshold)].sum() / step.sum())


def _titles(drive: Drive) -> list[str]:
    """What smoothing keeps, and what the forward pass alone would do."""
    threshold = _threshold(drive)
    name = "tilt" if (drive.relative and drive.tilts) or _asked(drive) == ("tilt",) else "heading"
    share = share_over(drive, _asked(drive)[0] if len(_asked(drive)) == 1 else name, threshold)
    most = _most(drive, name)
    if most == 0.0:
        return ["Smoothed σ is zero all along"]
    if not math.isfinite(most):
        return ["Smoothed σ is not known"]
    kept = "stays below" if most <= VAGUE_DEG else "reaches"
    below = f"{name} σ {kept} {two_digits(most, up=True)}°"
    if drive.failed:
        return [f"Claimed {below}, but a check failed"]
    head = f"smoothing keeps {below.replace('stays ', '')}" if drive.two_passes and most <= VAGUE_DEG else below
    head = head[0].upper() + head[1:] if drive.stops else f"No stop found: {head}"
    if not drive.two_passes:
        return [head]
    if share > 0.0:
        other = _asked(drive)[0] if len(_asked(drive)) == 1 and _asked(drive) != (name,) else ""
        who = f"forward {other} σ" if other else "forward alone"
        return [f"{head}; {who} exceeds {threshold:g}° for {percent(share)} of the log", head]
    forward = drive.column("forward_sigma_att_z_deg") if name == "heading" else drive.tilt_sigma("forward")
    forward = forward[np.isfinite(forward) & drive.settled("forward")]
    reach = float(forward.max()) if forward.size else math.nan
    if math.isfinite(reach):
        return [f"{head}; forward alone reaches {two_digits(reach)}°", head]
    return [head]


def _never_above(drive: Drive, tilt: dict[str, Array], heading: dict[str, Array]) -> str:
    """The sentence that smoothing never loses, where it is true of every node drawn."""
    if not drive.two_passes:
        return ""
    for found in (tilt, heading):
        other = np.fmin(found["forward"], found["backward"])
        known = np.isfinite(found["smoothed"]) & np.isfinite(other)
        if not (found["smoothed"][known] <= other[known] * 1.01 + 1e-9).all():
            return ""
    return "; the smoothed σ is never above either pass"


def limits(drive: Drive, found: dict[str, Array], threshold: float) -> tuple[float, float]:
    """Log limits that hold the whole smoothed line, and 98.5 % of each pass outside its transients."""
    kept = {which: v[np.isfinite(v) & (v > 0.0) & drive.settled(which)] for which, v in found.items()}
    reach = [float(np.quantile(v, 0.985)) for v in kept.values() if v.size]
    return _span(kept["smoothed"], reach, threshold)


def _span(smoothed: Array, reach: list[float], threshold: float) -> tuple[float, float]:
    """Limits around every smoothed value and the threshold, and around ``reach`` within ``DECADES`` of the lowest."""
    must = [*(f(smoothed) for f in (np.min, np.max) if smoothed.size), *([threshold] if threshold > 0.0 else [])]
    must = must or reach or [0.2]
    low, high = float(min(must)), float(max(must))
    high = max(high, min(max(reach, default=high), low * 10.0**DECADES))
    return low / 1.4, max(high * 1.35, low * 3.0)


def _row(page: Page, drive: Drive, k: int, found: dict[str, Array], threshold: float) -> Panel:
    """One row of lines: the three passes over time."""
    panel = _log_panel(page, drive, k, limits(drive, found, threshold))
    for which in PASSES:
        ink = which == "smoothed"
        panel.series(drive.t, found[which], drive.breaks, "ink" if ink else which, 1.4 if ink else 0.9)
    _threshold_line(panel, threshold)
    passes = {w: np.where(drive.settled(w), found[w], np.nan) for w in ("forward", "backward")}
    beyond(panel, drive.t, passes, panel.y_limits[1], list(found.values()))
    if not any((v > 0.0).any() for v in found.values()):
        page.text(
            panel.left + 2.95, panel.top + 0.95, "σ = 0: nothing to draw on a log axis", colour="mute", align="middle"
        )
    else:
        _names(panel, drive, found, threshold)
    return panel


def _worst_row(page: Page, drive: Drive, k: int, found: dict[str, Array], threshold: float) -> Panel:
    """One row of a log with many motions: the worst sigma of each motion, one dot per pass."""
    worst = {which: worst_of_motions(drive, values) for which, values in found.items()}
    reach = [float(v[v > 0.0].max()) for v in worst.values() if (v > 0.0).any()]
    panel = _log_panel(page, drive, k, _span(worst["smoothed"][worst["smoothed"] > 0.0], reach, threshold))
    middles = np.array([0.5 * (p.start + p.end) for p in drive.motions])
    for which, values in worst.items():
        seen = values > 0.0
        panel.points(
            middles[seen],
            values[seen],
            "circle",
            4.0 if which == "backward" else 2.6,
            fill="ink" if which == "smoothed" else which,
        )
    _threshold_line(panel, threshold)
    _margin_names(panel, found, threshold)
    return panel


def worst_of_motions(drive: Drive, values: Array) -> Array:
    """Largest value in each motion; nan where none is known."""
    rows = [values[drive.during(p.start, p.end)] for p in drive.motions]
    return np.array([float(np.max(r, initial=0.0, where=np.isfinite(r))) or math.nan for r in rows])


def _log_panel(page: Page, drive: Drive, k: int, y: tuple[float, float]) -> Panel:
    panel = time_panel(page, drive, (1.05, 1.12 + 2.02 * k, 5.90, 1.82), y, log=True)
    at = ticks.log(*panel.y_limits, 8, "°")
    panel.grid(at[0])
    panel.y_axis(at)
    return panel


def _threshold_line(panel: Panel, threshold: float) -> None:
    """The dashed line at which a stop is advised, named at the right."""
    page = panel.page
    if math.isfinite(threshold) and threshold > 0.0:
        panel.across(threshold, "limit", 0.8, DASHED)
        at_y = float(panel.y(threshold))
        page.text(panel.right + 0.06, at_y + 0.02, "stop advised", size=style.TICK, colour="limit")
        page.text(panel.right + 0.06, at_y + 0.145, f"at σ = {threshold:g}°", size=style.NOTE, colour="limit")


def _names(panel: Panel, drive: Drive, found: dict[str, Array], threshold: float) -> None:
    """Names beside the lines of the longest motion where it is wide enough, else in the margin."""
    whole = [p for p in drive.motions if not any(a < p.end and b > p.start for a, b in drive.gaps)]
    longest = max(whole, key=lambda p: p.length, default=None)
    if longest is None or float(panel.x(longest.end) - panel.x(longest.start)) < 1.25 or not drive.two_passes:
        _margin_names(panel, found, threshold)
        return
    places: tuple[tuple[str, float, Align], ...] = (
        ("backward", 0.09, "left"),
        ("forward", -0.11, "right"),
        ("smoothed", 0.0, "middle"),
    )
    lines = [*found.values(), np.full(drive.t.size, threshold)]
    named = [_name(panel, drive, longest, found[which], which, at, align) for which, at, align in places]
    boxes = [text_box(which, style.LABEL, *place) for (which, _, _), place in zip(places, named, strict=True) if place]
    if any(struck(panel, drive.t, lines, box) for box in boxes):
        _margin_names(panel, found, threshold)
        return
    for (which, _, _), place in zip(places, named, strict=True):
        if place:
            x, y, align = place
            bold = which == "smoothed"
            page_colour = "ink" if bold else which
            panel.page.text(x, y, which, colour=page_colour, bold=bold, align=align, halo=True)


def _margin_names(panel: Panel, found: dict[str, Array], threshold: float) -> None:
    """Names of the passes in the right margin, clear of the threshold's name."""
    drawn = [w for w in ("forward", "backward", "smoothed") if (found[w] > 0.0).any()]
    low = math.isfinite(threshold) and float(panel.y(threshold)) < panel.top + 0.7
    y = panel.bottom - 0.17 * len(drawn) if low else panel.top + 0.1
    for k, which in enumerate(drawn):
        ink = which == "smoothed"
        colour = "ink" if ink else which
        panel.page.text(panel.right + 0.06, y + 0.17 * k, which, size=style.TICK, colour=colour, bold=ink)


def _name(
    panel: Panel, drive: Drive, part: Part, values: Array, which: str, inset: float, align: Align
) -> tuple[float, float, Align] | None:
    """Place of one name, just clear of its line over the width of the word; None where the pass knows nothing."""
    width = style.text_width(which, style.LABEL, bold=which == "smoothed")
    centre = 0.5 * float(panel.x(part.start) + panel.x(part.end))
    x = {"left": float(panel.x(part.start)), "right": float(panel.x(part.end)), "middle": centre}[align] + inset
    left = x - {"left": 0.0, "right": width, "middle": 0.5 * width}[align]
    across = panel.x(drive.t)
    under = values[(across > left) & (across < left + width) & (values > 0.0)]
    if not under.size:
        return None
    y = float(panel.y(under.min())) + 0.15 if which == "smoothed" else float(panel.y(under.max())) - 0.05
    return x, min(max(y, panel.top + 0.08), panel.bottom - 0.04), align


def _advice(panel: Panel, drive: Drive, lines: list[Array]) -> None:
    """A triangle where the forward sigma passes the threshold, with the time since the motion began where it has room.

    ``lines``: the three passes of the panel, which no word may strike.
    """
    threshold = _threshold(drive)
    due = [(p.start, p.value("stop_advised_after_s")) for p in drive.motions]
    due = [(start, after) for start, after in due if math.isfinite(after) and math.isfinite(threshold)]
    if not due:
        return
    panel.points([a + b for a, b in due], [threshold] * len(due), "down", 4.5, fill="limit")
    marks = [float(panel.x(a + b)) for a, b in due]
    taken = [(x - 0.04, float(panel.y(threshold)) - 0.04, x + 0.04, float(panel.y(threshold)) + 0.04) for x in marks]
    for start, after in sorted(due, key=lambda item: item[1])[:8]:
        x, y, words = float(panel.x(start + after)), float(panel.y(threshold)), f"after {clock(after)}"
        places: list[tuple[float, float, Align]] = [
            (x, y - 0.085, "middle"), (x - 0.06, y - 0.03, "right"), (x + 0.06, y - 0.03, "left"),
            (x, y + 0.15, "middle"), (x - 0.06, y + 0.11, "right"), (x + 0.06, y + 0.11, "left"),
        ]  # fmt: skip
        for place in places:
            box = text_box(words, style.NOTE, *place)
            inside = box[0] >= panel.left and box[2] <= panel.right
            if inside and not struck(panel, drive.t, lines, box) and not any(overlap(box, other) for other in taken):
                taken.append(box)
                at_x, at_y, align = place
                panel.page.text(at_x, at_y, words, size=style.NOTE, colour="limit", align=align, halo=True)
                break
