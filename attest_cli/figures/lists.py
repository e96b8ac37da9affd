"""The two lists under the overview: what to know, and the motions where the estimate is weakest."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import style
from .drive import AXES, HOUR_CLOCK_S, Drive, Part
from .frame import mark
from .page import Page
from .words import THIN, clean, clock, number, two_digits

MOST_FACTS, MOST_ROWS = 6, 5
LINE, NOTE_LINE, GAP = 0.15, 0.14, 0.14
_NUMBER_BLANK = re.compile(r"(?<=\d) (?=(?:m?s|min|h|k?m|k?Hz|deg|rad|g|µT|°|%|σ)(?:\W|$))")
_RANK = {"FAIL": 0, "WARN": 1, "PASS": 2}


@dataclass(frozen=True, slots=True)
class Fact:
    """A line of "What to know", wrapped: one or two lines of fact, muted lines of detail."""

    status: str
    lines: tuple[str, ...]
    details: tuple[str, ...]

    @property
    def height(self) -> float:
        """Height in inches with the gap below."""
        return LINE * len(self.lines) + NOTE_LINE * len(self.details) + GAP


def facts(checks: Sequence[Mapping[str, Any]], width: float) -> list[Fact]:
    """At most six checks, the worst first, wrapped to a width in inches; the last line says how many were left."""
    ordered = sorted(checks, key=lambda c: _RANK.get(str(c.get("status")), 1))
    shown = ordered if len(ordered) <= MOST_FACTS else ordered[: MOST_FACTS - 1]
    out = [
        Fact(
            str(c.get("status")),
            wrapped(clean(c.get("fact") or c.get("name") or "", 120), width, style.LABEL),
            wrapped(clean(c.get("detail") or "", 120), width, style.NOTE),
        )
        for c in shown
    ]
    if len(shown) < len(ordered):
        rest = ordered[len(shown) :]
        open_ones = sum(c.get("status") != "PASS" for c in rest)
        detail = f"{open_ones} of them open; all in report.json" if open_ones else "all passed; see report.json"
        out.append(Fact("WARN" if open_ones else "PASS", (f"{len(rest)} more checks",), (detail,)))
    return out


def wrapped(text: str, width: float, size: float, most: int = 2) -> tuple[str, ...]:
    """Text in at most ``most`` lines of a width in inches; what does not fit ends in an ellipsis."""
    lines: list[str] = []
    words = _NUMBER_BLANK.sub(THIN, text).split(" ")
    while words and len(lines) < most:
        taken = 1
        while taken < len(words) and style.text_width(" ".join(words[: taken + 1]), size) <= width:
            taken += 1
        line, words = " ".join(words[:taken]), words[taken:]
        last = len(lines) == most - 1
        if (last and words) or style.text_width(line, size) > width:
            while line and style.text_width(line + "…", size) > width:
                line = line[:-1].rstrip()
            line += "…"
        lines.append(line)
    return tuple(lines)


def height(found: Sequence[Fact]) -> float:
    """Height of the list in inches."""
    return 0.29 + sum(f.height for f in found)


def what_to_know(page: Page, found: Sequence[Fact], x: float, y: float) -> None:
    """Draw the list with its head on the baseline ``y``."""
    page.text(x, y, "What to know", size=style.ROW, bold=True)
    y += 0.29
    for fact in found:
        mark(page, x + 0.06, y - 0.045, fact.status, 6.0)
        for line in fact.lines:
            page.text(x + 0.2, y, line)
            y += LINE
        for line in fact.details:
            page.text(x + 0.2, y, line, size=style.NOTE, colour="mute")
            y += NOTE_LINE
        y += GAP


def weakest_of(drive: Drive) -> list[Part]:
    """The motions with the largest smoothed sigma of tilt or heading."""
    worst = {p.index: max(sigmas_of(drive, p)) for p in drive.motions}
    known = [p for p in drive.motions if worst[p.index] > 0.0]
    return sorted(known, key=lambda p: -worst[p.index])[:MOST_ROWS]


def sigmas_of(drive: Drive, part: Part) -> list[float]:
    """Worst smoothed sigma of what ``_angles`` names, in a segment; 0 where nothing is known."""
    rows = drive.during(part.start, part.end)
    of = {"tilt": drive.tilt_sigma("smoothed", rows), "heading": drive.column("smoothed_sigma_att_z_deg")[rows]}
    found = [of[name] for name in _angles(drive)]
    return [float(np.max(values, initial=0.0, where=np.isfinite(values))) for values in found]


def _angles(drive: Drive) -> list[str]:
    """Tilt, and heading where something tells north or nothing else is estimated."""
    return [*(["tilt"] if drive.tilts else []), *([] if drive.relative and drive.tilts else ["heading"])]


def weakest_height(drive: Drive) -> float:
    """Height of the table in inches."""
    return 0.22 + 0.17 * (len(weakest_of(drive)) + 1)


def weakest(page: Page, drive: Drive, x: float, y: float) -> float:
    """Draw the table of the weakest motions with its head on ``y``; returns the baseline under it."""
    heads = ["start", "length", *(f"{name} σ" for name in _angles(drive)), "separation"]
    rights = [x + 1.05 + 0.78 * k for k in range(len(heads))]
    page.text(x, y, "Weakest motions", size=style.ROW, bold=True)
    note = "smoothed σ at worst; separation of the passes"
    page.text(
        x + style.text_width("Weakest motions", style.ROW, bold=True) + 0.1, y, note, size=style.NOTE, colour="mute"
    )
    y += 0.22
    page.text(x, y, "segment", size=style.TABLE, colour="mute")
    for head, right in zip(heads, rights, strict=True):
        page.text(right, y, head, size=style.TABLE, colour="mute", align="right")
    for part in weakest_of(drive):
        y += 0.17
        page.text(x, y, str(part.index), size=style.TICK, bold=True)
        for cell, right in zip(_cells(drive, part), rights, strict=True):
            page.text(right, y, cell, size=style.TICK, align="right")
    return y + 0.25


def _cells(drive: Drive, part: Part) -> list[str]:
    apart = [abs(part.value(f"separation_{a}_sigma")) for a in AXES]
    apart = [v for v in apart if math.isfinite(v)]
    return [
        clock(part.start, hours=drive.limits[1] >= HOUR_CLOCK_S),
        clock(part.length),
        *(f"{two_digits(sigma)}°" for sigma in sigmas_of(drive, part)),
        f"{number(max(apart), 1)}σ" if apart else "–",
    ]


def why_no_track(drive: Drive) -> str:
    """The sentence in place of a plan."""
    sigma, distance = drive.stat("position_sigma_max_m"), drive.stat("distance_m")
    if (drive.report.get("statistics") or {}).get("position_usable") is False and math.isfinite(sigma):
        driven = f" over {number(distance)} m driven" if math.isfinite(distance) and distance >= 1.0 else ""
        return f"No track is drawn: position σ reaches {two_digits(sigma)} m{driven}"
    if np.isfinite(drive.column("position_x_m")).any():
        return "No track is drawn: the vehicle never moved more than 3σ and 0.5 m"
    return "No track is drawn: the log gives no position"
