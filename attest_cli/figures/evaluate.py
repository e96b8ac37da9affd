"""Page 9, evaluate: the error of a result against a reference, over the band that the result claims."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..evaluate.consistency import CLAIMED, band_width
from ..evaluate.records import Evaluation, Judgement
from ..records import Array, Result
from . import reduce, style, ticks
from .drive import AXES, Drive
from .frame import beyond, new_page, row_name, segment_numbers, time_axis, time_panel
from .lists import wrapped
from .page import Page, Panel
from .words import THIN, clean, number, percent, sigma_decimals, two_digits

HEIGHT = 5.3
LEFT, WIDTH, TOP, ROW, STEP = 0.95, 4.75, 1.125, 1.09, 1.257
BESIDE, SIDE, SIDE_WIDTH = 5.78, 6.60, 1.18
COVERAGE = (6.62, 1.13, 1.10, 1.09)
TABLE_TOP, NOTES_TOP, NOTES_END, COLUMNS = 2.96, 4.22, 5.02, (7.32, 7.78)
ROUNDING = 1e-7  # deg, m
MARGIN = 1.12  # of a panel over the largest of band and error


@dataclass(frozen=True, slots=True)
class Shown:
    """What is drawn: attitude in degrees, or position in metres where there is no attitude."""

    judged: Judgement
    scale: float
    unit: str
    names: tuple[str, str, str]
    columns: tuple[tuple[str, str], tuple[str, str]]  # head and statistic of the table


def draw(found: Evaluation, result: Result, reference: str, theme: str = "light") -> Page:
    """Draw the page.

    Parameters
    ----------
    found : Evaluation
    result : Result
        What a header says of a log, and its segments; ``t_s`` of its passes counts from the same start.
    reference : str
        Name of the reference.
    """
    drive = Drive(result)
    shown = _shown(found, drive)
    where = ", in motion" if found.options.moving_only else ""
    what = "result" if drive.method[1] in {"", "none"} else "smoothed"
    page = new_page(
        drive, theme, HEIGHT, titles(found),
        [drive.span, f"{what} minus reference in world axes{where}; reference {clean(reference, 40)}",
         f"{number(shown.judged.association.used)} samples"],
        _alt(found, shown), found.verdict or "",
    )  # fmt: skip
    unit = "degrees" if shown.unit == "°" else "m"
    page.text(LEFT, 0.86, f"error, {unit}", colour="mute")
    if shown.judged.series.sigma is not None:
        page.text(LEFT + 0.85, 0.86, "grey: 95 % band claimed", colour="mute")
    limits = _limits(shown)
    for k in range(3):
        panel = _row(page, drive, shown, k, limits[k])
        if k == 0:
            segment_numbers(page, drive, panel)
    time_axis(panel)
    _coverage(page, shown)
    _table(page, found, shown)
    _notes(page, found, shown)
    return page


def _shown(found: Evaluation, drive: Drive) -> Shown:
    if found.attitude is not None:
        table = (("tilt", "inclination"), ("heading", "heading"))
        return Shown(found.attitude, float(np.degrees(1.0)), "°", drive.directions, table)
    assert found.position is not None
    return Shown(found.position, 1.0, " m", ("east", "north", "up"), (("level", "horizontal"), ("height", "vertical")))


def size(value: float) -> str:
    """An error with two significant digits; rounding is zero."""
    return two_digits(value if abs(value) >= ROUNDING else 0.0)


def titles(found: Evaluation) -> list[str]:
    """The finding, longest first."""
    if found.attitude is not None:
        heading, tilt = (size(float(np.degrees(found.attitude.stats[k].rms))) for k in ("heading", "inclination"))
        head = f"Heading error {heading}° rms, tilt {tilt}°"
    else:
        assert found.position is not None
        level, height = (size(found.position.stats[k].rms) for k in ("horizontal", "vertical"))
        head = f"Position error {level} m rms level, {height} m in height"
    share = found.band_share
    if share is None:
        return [f"{head}; no sigma to hold it against", head]
    return [
        f"{head}; {percent(share)} of errors lie in the 95{THIN}% band",
        f"{head}; {percent(share)} in the 95{THIN}% band",
        head,
    ]


def _alt(found: Evaluation, shown: Shown) -> str:
    shares = ", ".join(f"{axis} {percent(c.band)}" for axis, c in shown.judged.coverage.items() if axis in AXES)
    inside = f" Inside the 95 % band: {shares}." if shares else ""
    kind = "Attitude" if found.attitude is not None else "Position"
    return f"{kind} error about three world axes over time, with coverage and a table.{inside}"


def _limits(shown: Shown) -> list[float]:
    """Half heights of the panels: the same for both level axes."""
    series, out = shown.judged.series, []
    moving = np.ones(len(series.t), dtype=np.bool_)
    for k in range(3):
        error = series.error[:, k] * shown.scale
        sigma = np.full_like(error, np.nan) if series.sigma is None else series.sigma[:, k] * shown.scale
        out.append(reduce.robust_limit([MARGIN * error], sigma, moving, share=0.99))
    level = max(out[:2])
    return [ticks.rounded_up(v) for v in (level, level, out[2])]


def _row(page: Page, drive: Drive, shown: Shown, k: int, limit: float) -> Panel:
    """One axis: its error over the claimed band, and at the right how large and how often inside."""
    series = shown.judged.series
    t = series.t + (drive.t[0] if drive.t.size else 0.0)
    panel = time_panel(page, drive, (LEFT, TOP + STEP * k, WIDTH, ROW), (-limit, limit))
    error = series.error[:, k] * shown.scale
    if series.sigma is not None:
        band = band_width() * series.sigma[:, k] * shown.scale
        panel.band(t, -band, band, series.breaks)
    panel.series(t, error, series.breaks, "truth", 0.9)
    panel.across(0.0, "ink", 0.5)
    panel.y_axis(ticks.symmetric(limit))
    _leaving(panel, t, error, limit, shown)
    row_name(page, panel, AXES[k], shown.names[k])
    _beside(page, panel, shown, AXES[k])
    return panel


def _leaving(panel: Panel, t: Array, error: Array, limit: float, shown: Shown) -> None:
    """A triangle where the error leaves the panel."""
    if shown.unit == "°":
        beyond(panel, t, {"truth": error}, limit)


def _beside(page: Page, panel: Panel, shown: Shown, axis: str) -> None:
    at = panel.top + 0.47
    page.text(BESIDE, at, f"{size(shown.judged.stats[axis].rms * shown.scale)}{shown.unit}", size=11.0, bold=True)
    page.text(BESIDE, at + 0.15, "rms", size=style.TICK, colour="mute")
    found = shown.judged.coverage.get(axis)
    if found is not None:
        page.text(BESIDE, at + 0.30, f"{percent(found.band)} in band", size=style.TICK, colour="mute")


def _coverage(page: Page, shown: Shown) -> None:
    """Share found inside the band of every claimed level; on the diagonal the sigma is as large as the error."""
    page.text(SIDE, 1.04, "Coverage", size=style.ROW, bold=True)
    curves = {axis: shown.judged.coverage[axis] for axis in AXES if axis in shown.judged.coverage}
    if not curves:
        page.text(SIDE, 1.30, "the track claims no sigma", colour="mute")
        return
    panel = page.panel(COVERAGE, (0.0, 1.0), (0.0, 1.0))
    none = np.zeros(2, dtype=np.bool_)
    panel.series(np.array([0.0, 1.0]), np.array([0.0, 1.0]), none, "gap", 0.7)
    claimed = np.concatenate([[0.0], CLAIMED])
    for axis, found in curves.items():
        share = np.concatenate([[0.0], found.found])
        panel.series(claimed, share, np.zeros(claimed.size, dtype=np.bool_), axis, 1.2)
    panel.y_axis(([0.0, 0.5, 1.0], ["0", "50", "100 %"]))
    panel.x_axis(([0.0, 0.5, 1.0], ["0", "50", "100 %"]), "claimed")
    page.text(panel.left + 0.05, panel.top + 0.12, "found", halo=True)
    for k, axis in enumerate(curves):
        at = panel.right - 0.40 + 0.15 * k, panel.bottom - 0.08
        page.text(*at, axis, size=style.ROW, colour=axis, bold=True, halo=True)


def _table(page: Page, found: Evaluation, shown: Shown) -> None:
    head = "Error over all motion" if found.options.moving_only else "Error over all samples"
    page.text(SIDE, TABLE_TOP, head, size=9.0, bold=True)
    y = TABLE_TOP + 0.19
    for (name, _), right in zip(shown.columns, COLUMNS, strict=True):
        page.text(right, y, name, size=style.TABLE, colour="mute", align="right")
    for name, field in (("rms", "rms"), ("median", "median"), ("95 %", "p95"), ("max", "max")):
        y += 0.18
        page.text(SIDE, y, name, size=style.TICK, colour="mute")
        for (_, key), right in zip(shown.columns, COLUMNS, strict=True):
            value = getattr(shown.judged.stats[key], field) * shown.scale
            page.text(right, y, f"{size(value)}{shown.unit}", size=style.TICK, align="right")


def _notes(page: Page, found: Evaluation, shown: Shown) -> None:
    """What the reference is worth, the clocks, what was aligned, and the position beside an attitude."""
    y = NOTES_TOP
    for words in notes(found, shown):
        lines = wrapped(words, SIDE_WIDTH, style.NOTE, most=3)
        if y + 0.115 * (len(lines) - 1) > NOTES_END:
            break
        for line in lines:
            page.text(SIDE, y, line, size=style.NOTE, colour="mute")
            y += 0.115
        y += 0.035


def notes(found: Evaluation, shown: Shown) -> list[str]:
    """The muted lines under the table."""
    told, frames = [], found.frames
    if found.position is not None and shown.judged is not found.position:
        told.append(f"Position {size(found.position.stats['absolute'].rms)} m rms")
    if found.scatter is not None and np.isfinite(found.scatter) and shown.unit == "°":
        told.append(f"Reference scatters at most {size(float(np.degrees(found.scatter)))}° a sample")
    told.append(offset_words(found))
    body = "; body axes fitted" if frames.body else ""
    if frames.mode == "full":
        told.append(f"Reference turned to fit{body}")
    elif frames.mode == "yaw":
        q = frames.q_world if found.attitude is not None or frames.q_position is None else frames.q_position
        yaw = float(reduce.wrap_deg(np.degrees(2.0 * np.arctan2(q[3], q[0]))))
        told.append(f"Reference turned by {number(yaw, 2)}° in yaw{body}")
    elif body:
        told.append("Body axes of the reference fitted")
    return told


def offset_words(found: Evaluation) -> str:
    """The time offset, its sigma, and whether it was taken out."""
    if found.offset is None:
        return "No time offset found" if found.applied == 0.0 else f"Time offset {number(found.applied, 4)} s as given"
    sigma = max(found.offset.sigma, 1e-9) * 1e3
    value = number(found.offset.seconds * 1e3, min(sigma_decimals(sigma), 4))
    words = f"Time offset fitted: {value}{THIN}±{THIN}{two_digits(sigma)} ms"
    if found.applied == 0.0:
        return f"{words}, not applied"
    return words if abs(found.applied - found.offset.seconds) < 1e-12 else f"{words}; {found.applied:g} s applied"
