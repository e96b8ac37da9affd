"""Page 1, overview: what is known, how well, and what to know before using it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..records import Result
from . import lists, plan_view, rows, style
from .drive import Drive
from .frame import LEFT, RIGHT, gap_words, new_page, time_axis
from .page import Page, middle
from .separation import checks_inside, status_of
from .words import clean, duration, number, percent, two_digits

BOX_LEFT, BOX_WIDTH = 1.05, 5.90
HEADING_LOST_DEG, TILT_LOST_DEG = 60.0, 30.0  # from here on a sigma is no knowledge
ANGLES = ("roll", "pitch", "yaw")


def draw(result: Result, theme: str = "light") -> Page | None:
    """The overview; None where there is not one node."""
    drive = Drive(result)
    if not drive.t.size:
        return None
    brief = drive.short and not drive.long
    top = 1.07 if brief else 1.88
    end = top + 3 * rows.PAIR + 2 * rows.AFTER
    bottom = _bottom(drive, end + 0.31, brief=brief)
    height = bottom.end + 0.4 if bottom else end + 0.66
    verdict = str(drive.report.get("verdict") or "")
    page = new_page(drive, theme, height, titles(drive), _notes(drive), _alt(drive), verdict, word=bool(verdict))
    if not brief:
        _key_numbers(page, drive)
        (_share_line if drive.long else _segment_line)(page, drive)
    _angle_rows(page, drive, top, brief=brief)
    if bottom:
        bottom.draw(page, drive)
    return page


def titles(drive: Drive) -> list[str]:
    """The finding in words, longest first; where a check failed, that and no sigma."""
    broken = failure(drive)
    if broken:
        tail = "" if "σ" in broken or "sigma" in broken else ": the sigma does not hold"
        return [broken + tail, broken]
    heading, tilt = drive.stat("sigma_heading_median_deg"), drive.stat("sigma_tilt_median_deg")
    known: list[str] = []
    lost: list[str] = []
    north = "magnetic heading" if drive.heading == "magnetic" else "heading"
    if not drive.relative:
        _sort(known, lost, north, heading, HEADING_LOST_DEG)
    if drive.tilts:
        _sort(known, lost, "tilt", tilt, TILT_LOST_DEG)
    else:
        _sort(known, lost, "relative heading", heading, HEADING_LOST_DEG)
        lost.append("roll and pitch taken as level")
    if plan_view.usable(drive) and math.isfinite(drive.stat("position_sigma_median_m")):
        known.append(f"position to {two_digits(drive.stat('position_sigma_median_m'))} m")
    grown = drive.stat("sigma_heading_max_deg")
    datum = ["heading is relative only"] if drive.relative and drive.tilts else []
    tails = ["; ".join(datum + lost)]
    if drive.relative and math.isfinite(grown) and grown < HEADING_LOST_DEG:
        grows = f"its σ grows to {two_digits(grown)}°"
        tails.insert(0, "; ".join([", ".join([*datum, grows]), *lost]))
    head = "No stop found: " if not drive.stops else ""
    body = ", ".join([known[0].replace(" to ", " known to ", 1), *known[1:]]) if known else "attitude not known"
    found = [head + (body if head else body[0].upper() + body[1:]) + (f"; {t}" if t else "") for t in tails]
    return [*found, *([head + ", ".join(known)] if known and head else [])]


def failure(drive: Drive) -> str:
    """The fact of the first check that failed; empty where none did."""
    failed = [c for c in drive.report.get("checks") or [] if c.get("status") == "FAIL"]
    fact = clean(failed[0].get("fact") or failed[0].get("name") or "", 120) if failed else ""
    return fact[:1].upper() + fact[1:]


def _sort(known: list[str], lost: list[str], name: str, sigma: float, limit: float) -> None:
    if 0.0 < sigma < limit:
        known.append(f"{name} to {two_digits(sigma)}°")
    else:
        lost.append(f"{name} not known" if sigma != 0.0 else f"σ of {name} is zero")


def _notes(drive: Drive) -> list[str]:
    """Subtitle: date, length, samples, sensors."""
    source = drive.report.get("input") or {}
    samples, rate = source.get("samples"), source.get("rate_hz")
    sensors = [clean(s, 40) for s in source.get("sensors") or []]
    unseen = "heading is not estimated" if "heading" in drive.not_estimated else "no heading sensor"
    missing = [*([unseen] if drive.relative else []), *([] if drive.tilts else ["the vehicle counts as level"])]
    missing += [] if np.isfinite(drive.column("position_x_m")).any() else ["no position"]
    counted_samples = f"{number(samples)} samples" if samples is not None else ""
    return [
        drive.start_date,
        drive.span,
        f"{counted_samples} at {_rate(float(rate))} Hz" if counted_samples and rate else counted_samples,
        ", ".join(sensors) + ("; " if sensors and missing else "") + ", ".join(missing),
    ]


def _rate(rate: float) -> str:
    return number(rate, 0 if abs(rate - round(rate)) < 0.005 * rate else 1)


def _alt(drive: Drive) -> str:
    values = ", ".join(f"{words} {value}" for value, words, _ in key_numbers(drive))
    return f"Roll, pitch and yaw over {drive.span} with both passes against the smoothed one; {values}."


def key_numbers(drive: Drive) -> list[tuple[str, str, str]]:
    """Value, words and colour of the five to seven numbers under the title."""
    heading, tilt = drive.stat("sigma_heading_median_deg"), drive.stat("sigma_tilt_median_deg")
    out = [(f"{two_digits(heading)}°", "heading σ, median", "text")] if not (drive.relative and drive.tilts) else []
    out += [(f"{two_digits(tilt)}°", "tilt σ, median", "text")] if drive.tilts else []
    if drive.relative:
        out.append(("none", "absolute heading", "warn"))
    if plan_view.usable(drive):
        out.append((f"{two_digits(drive.stat('position_sigma_median_m'))} m", "position σ, median", "text"))
    out.append((f"{number(len(drive.motions))} | {number(len(drive.stops))}", "motions | stops", "text"))
    inside, checks = checks_inside(drive)
    agree = "text" if not checks or status_of(drive) == "PASS" else "warn"
    if checks > 99:
        out.append((percent(inside / checks), "of checks in 2σ", agree))
    elif checks:
        out.append((f"{inside} of {checks}", "separations in 2σ", agree))
    share = (drive.report.get("coverage") or {}).get("share")
    if share is not None:
        out.append((percent(float(share)), "of the log estimated", "text"))
    found = [str(c.get("status")) for c in drive.report.get("checks") or []]
    failed, warned = found.count("FAIL"), len(found) - found.count("FAIL") - found.count("PASS")
    if failed:
        return [*out, (f"{number(failed)} | {number(warned)}", "failed | warnings", "fail")]
    return [*out, (number(warned), "warning" if warned == 1 else "warnings", "text")]


def _key_numbers(page: Page, drive: Drive) -> None:
    found = key_numbers(drive)
    step = min(1.28, 6.39 / max(len(found) - 1, 1))
    for k, (value, words, colour) in enumerate(found):
        x = LEFT + k * step
        page.text(x, 1.13, value, size=style.KEY, bold=True, colour=colour)
        page.text(x, 1.31, words, size=style.NOTE + 0.2, colour="mute")


def _segment_line(page: Page, drive: Drive) -> None:
    """Stops as sand fields with the number above, motions as bars with the number inside."""
    line = page.panel((BOX_LEFT, 1.59, BOX_WIDTH, 0.22), drive.limits, (0.0, 1.0))
    line.shade([(p.start, p.end) for p in drive.stops])
    bar = page.panel((BOX_LEFT, 1.655, BOX_WIDTH, 0.09), drive.limits, (0.0, 1.0))
    bar.shade([(p.start, p.end) for p in drive.motions], "gap")
    bar.shade([(a, b) for a, b in drive.gaps], "paper")
    for part in drive.motions:
        wide = float(bar.x(part.end) - bar.x(part.start))
        if wide > style.text_width(str(part.index), style.NOTE, bold=True) + 0.05:
            bar.label(
                0.5 * (part.start + part.end), 0.5, str(part.index), size=style.NOTE, bold=True, align="middle",
                shift=(0.0, middle(style.NOTE)),
            )  # fmt: skip
    page.text(BOX_LEFT - 0.08, 1.7 + middle(style.NOTE), "segment", size=style.NOTE, colour="mute", align="right")
    line.above([(0.5 * (p.start + p.end), str(p.index)) for p in sorted(drive.stops, key=lambda p: -p.length)], 0.04)


def _share_line(page: Page, drive: Drive) -> None:
    """Share of motion per column, from sand to grey, where motions are too many to be told apart."""
    line = page.panel((BOX_LEFT, 1.55, BOX_WIDTH, 0.2), drive.limits, (0.0, 1.0))
    low, high = drive.limits
    edges = np.linspace(low, high, line.columns // 2 + 1)
    knots = np.array([v for p in drive.motions for v in (p.start, p.end)])
    driven = np.cumsum([v for p in drive.motions for v in (0.0, p.length)])
    share = np.diff(np.interp(edges, knots, driven)) / (edges[1] - edges[0])
    level = np.rint(8.0 * np.clip(share, 0.0, 1.0)).astype(int)
    starts = np.concatenate(([0], np.flatnonzero(np.diff(level)) + 1))
    ends = np.append(starts[1:], level.size)
    for a, b in zip(starts.tolist(), ends.tolist(), strict=True):
        colour = style.mix(page.colour("stop"), page.colour("measurement"), level[a] / 8.0)
        line.shade([(float(edges[a]), float(edges[b]))], colour)
    line.shade([(a, b) for a, b in drive.gaps], "paper")
    page.text(BOX_LEFT - 0.08, 1.65 + middle(style.NOTE), "moving", size=style.NOTE, colour="mute", align="right")
    page.text(line.right + 0.08, 1.65 + middle(style.NOTE), "share of time", size=style.NOTE, colour="mute")
    longest = max(drive.stops, key=lambda p: p.length, default=None)
    words = f"stop {duration(longest.length)}" if longest else ""
    if longest and float(line.x(longest.end) - line.x(longest.start)) > style.text_width(words, style.NOTE) + 0.06:
        at = (0.5 * (longest.start + longest.end), 0.5)
        line.label(*at, words, size=style.NOTE, colour="mute", align="middle", shift=(0.0, middle(style.NOTE)))


def _angle_rows(page: Page, drive: Drive, top: float, *, brief: bool) -> None:
    for k, name in enumerate(ANGLES):
        y = top + k * (rows.PAIR + rows.AFTER)
        strip = rows.angle_strip(page, drive, (BOX_LEFT, y, BOX_WIDTH, rows.STRIP), name)
        if k == 0:
            strip.above([*gap_words(drive), *(_named_parts(drive) if brief else [])], 0.035 if not brief else 0.06)
        box = (BOX_LEFT, y + rows.STRIP + rows.WITHIN, BOX_WIDTH, rows.DIFFERENCE)
        if drive.long and drive.relative and name == "yaw":
            last = rows.since_start_strip(page, drive, box)
        elif drive.long and checks_inside(drive)[1]:
            last = rows.separation_strip(page, drive, box, k)
        else:
            last = rows.difference_strip(page, drive, box, name)
    time_axis(last)


def _named_parts(drive: Drive) -> list[tuple[float, str]]:
    """``2 motion``: number and word of each segment, the longest first."""
    parts = sorted(drive.parts, key=lambda p: -p.length)
    return [(0.5 * (p.start + p.end), f"{p.index} {'motion' if p.motion else 'stop'}") for p in parts]


@dataclass(frozen=True, slots=True)
class Bottom:
    """What stands under the angles: plan or table at the left, what to know at the right."""

    top: float
    end: float
    facts: list[lists.Fact]
    plan: bool
    table: bool

    def draw(self, page: Page, drive: Drive) -> None:
        """Both halves."""
        head = self.top + 0.35
        if self.plan:
            page.text(LEFT, head, "Plan view", size=style.ROW, bold=True)
            x = LEFT + style.text_width("Plan view", style.ROW, bold=True) + 0.1
            axes = f"{plan_view.axes_words(drive)} · 95 % ellipses · stops by segment number"
            page.text(x, head, axes, size=style.NOTE, colour="mute")
            plan_view.draw_plan(page, drive, (LEFT, head + 0.12, 4.2, self.end - head - 0.12))
        else:
            at = lists.weakest(page, drive, LEFT, head) if self.table else head
            page.text(LEFT, at, lists.why_no_track(drive), size=style.NOTE, colour="mute")
        if self.facts:
            lists.what_to_know(page, self.facts, 4.95, head)


def _bottom(drive: Drive, top: float, *, brief: bool) -> Bottom | None:
    """Layout under the angles; a short log without warning and without track has none."""
    checks = list(drive.report.get("checks") or [])
    plan = plan_view.usable(drive)
    facts = lists.facts(checks, RIGHT - 5.15)
    if brief and not plan and not any(c.get("status") != "PASS" for c in checks):
        return None
    table = len(drive.motions) > 1 or bool(drive.motions and not brief)
    left = 3.0 if plan else (0.35 + lists.weakest_height(drive) if table else 0.4)
    right = lists.height(facts)
    return Bottom(top, top + 0.35 + max(left, right if facts else 0.0), facts, plan, table)
