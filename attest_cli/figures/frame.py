"""What every page has: title, subtitle, footer, time panels with stops shaded, segment numbers, row names."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from .. import __version__
from ..records import Array
from . import style, ticks
from .drive import Drive
from .page import Align, Box, Kind, Limits, Page, Panel, middle
from .words import clean, cut, duration, first_fit, short_duration, two_digits

LEFT, RIGHT = 0.45, 7.70
MARKER: dict[str, tuple[Kind, str]] = {
    "PASS": ("circle", "pass"),
    "WARN": ("up", "warn"),
    "FAIL": ("heavy-cross", "fail"),
}
SEGMENT_ROW = 0.07  # segment numbers stand this far above the panel


def new_page(
    drive: Drive, theme: str, height: float, titles: Sequence[str], notes: Sequence[str], alt: str, status: str = "",
    *, word: bool = False,
) -> Page:  # fmt: skip
    """A page with its title, subtitle and footer.

    Parameters
    ----------
    titles : sequence of str
        The finding, longest wording first; the first that fits is taken.
    notes : sequence of str
        Parts of the subtitle after the file name; the last ones go where they do not fit.
    alt : str
        What is drawn and the key numbers; the title is put before it.
    status : str
        PASS, WARN, FAIL for a marker; empty for none. ``word`` writes it at the right as well.
    """
    room = RIGHT - LEFT - (0.27 if status else 0.0) - (0.6 if word else 0.0)
    title = first_fit(t for t in titles if t is titles[-1] or style.text_width(t, style.TITLE, bold=True) <= room)
    while style.text_width(title, style.TITLE, bold=True) > room:
        title = cut(title, len(title.rstrip("…")) - 1)
    page = Page(height, theme, title, f"{title}. {alt}" if alt else title)
    if status:
        mark(page, 0.55, 0.36, status, 9.0)
        page.text(0.72, 0.42, title, size=style.TITLE, bold=True)
    else:
        page.text(LEFT, 0.42, title, size=style.TITLE, bold=True)
    if word:
        page.text(
            RIGHT,
            0.42,
            status,
            size=style.TITLE,
            bold=True,
            colour=MARKER.get(status, MARKER["WARN"])[1],
            align="right",
        )
    page.text(LEFT, 0.68, subtitle(drive, notes), size=style.LABEL, colour="mute")
    page.text(RIGHT, height - 0.12, footer(drive), size=style.FOOTER, colour="mute", align="right")
    return page


def subtitle(drive: Drive, notes: Sequence[str]) -> str:
    """File name and notes in one line that fits: the name is cut first, then the date goes, then the last notes."""
    parts = [p for p in notes if p]
    while True:
        for longest in (60, 40, 28):
            line = " · ".join([p for p in (cut(drive.file_name, longest),) if p] + parts)
            if style.text_width(line, style.LABEL) <= RIGHT - LEFT or (not parts and longest == 28):
                return line
        parts.pop(0 if parts[0] == drive.start_date else -1)


def footer(drive: Drive) -> str:
    """Version, file, checksum and smoother: enough to find the run again."""
    files = (drive.report.get("input") or {}).get("files") or [{}]
    sha = clean(files[0].get("sha256") or "", 64)
    method, smoother = drive.method
    backward = "no smoother" if smoother == "none" else f"{smoother} smoother" if smoother else ""
    known = [
        f"attest {clean(drive.report.get('attest_version') or __version__, 20)}",
        cut(drive.file_name, 40),
        f"sha256 {sha[:4]}…{sha[-2:]}" if sha else "",
        ", ".join(part for part in (method and f"{method} filter", backward) if part),
    ]
    return " · ".join(part for part in known if part)


def mark(page: Page, x: float, y: float, status: str, size: float) -> None:
    """The marker of a verdict: shape and colour."""
    kind, colour = MARKER.get(status, MARKER["WARN"])
    page.marks([(x, y)], kind, size * (0.72 if kind == "heavy-cross" else 1.0), fill=colour)


def time_panel(page: Page, drive: Drive, box: Box, y: Limits, *, log: bool = False) -> Panel:
    """A panel over the time of the log with stops and gaps shaded."""
    panel = page.panel(box, drive.limits, y, log=log)
    panel.shade([(p.start, p.end) for p in drive.wide_stops(box[2])])
    panel.shade([(a, b) for a, b in drive.gaps], "gap")
    return panel


def time_axis(panel: Panel, *, label: bool = True) -> None:
    """Time ticks under a panel."""
    low, high = panel.x_limits
    panel.x_axis(ticks.time(low, high), ticks.time_label(low, high) if label else "")


def gap_words(drive: Drive) -> list[tuple[float, str]]:
    """``gap 29 min`` at the middle of each gap, longest first."""
    longest = sorted(drive.gaps.tolist(), key=lambda g: g[0] - g[1])
    return [
        (0.5 * (a + b), f"gap {duration(round(b - a)) if b - a < 600.0 else short_duration(b - a)}")
        for a, b in longest[:5]
    ]


def segment_numbers(page: Page, drive: Drive, panel: Panel) -> None:
    """Numbers of the stops above a panel (gaps first, longer stops first), with the word at the left."""
    words = gap_words(drive)
    if not drive.long:
        words += [(0.5 * (p.start + p.end), str(p.index)) for p in sorted(drive.stops, key=lambda p: -p.length)]
        if drive.stops:
            page.text(
                panel.left - 0.08, panel.top - SEGMENT_ROW, "segment", size=style.NUMBER, colour="mute", align="right"
            )
    panel.above(words, SEGMENT_ROW)


def row_name(page: Page, panel: Panel, name: str, *notes: str, x: float = 0.20, y: float | None = None) -> None:
    """Name of a row at the left with its notes under it, centred on the panel."""
    at = panel.top + 0.5 * panel.height + 0.04 - 0.065 * len(notes) if y is None else y
    page.text(x, at, name, size=style.ROW, bold=True)
    for k, note in enumerate(notes):
        page.text(x, at + 0.165 + 0.125 * k, note, size=style.NOTE, colour="mute")


def struck(panel: Panel, t: Array, lines: Iterable[Array], box: Box) -> int:
    """How many pieces of lines over time cross a box (left, top, right, bottom in inches)."""
    left, top, right, bottom = box
    low, high = panel.x_limits
    ends = [low + (x - panel.left) * (high - low) / panel.width for x in (left, right)]
    rows = slice(max(0, int(np.searchsorted(t, ends[0])) - 1), int(np.searchsorted(t, ends[1])) + 1)
    count = 0
    for values in lines:
        y = panel.y(values[rows])
        count += int(np.sum((np.fmin(y[:-1], y[1:]) <= bottom) & (np.fmax(y[:-1], y[1:]) >= top)))
    return count


def text_box(words: str, size: float, x: float, y: float, align: Align) -> Box:
    """What a line of digits covers: left, top, right, bottom in inches, with a little air."""
    width = style.text_width(words, size)
    left = x - {"left": 0.0, "middle": 0.5, "right": 1.0}[align] * width
    return left - 0.015, y - 2.0 * middle(size) - 0.02, left + width + 0.015, y + 0.02


def beyond(
    panel: Panel, t: Array, lines: Mapping[str, Array], limit: float, drawn: Sequence[Array] | None = None
) -> None:
    """One triangle per line (colour -> degrees) and side where it leaves the panel, with its largest value.

    The value stands where it strikes the fewest lines of ``drawn`` (``lines`` where not given) and no other value.
    """
    taken: list[Box] = []
    for side in (1.0, -1.0):
        found = []
        for colour, values in lines.items():
            reach = np.where(np.isfinite(values), side * values, -np.inf)
            if reach.size and float(reach.max()) > limit:
                found.append((float(panel.x(t[int(reach.argmax())])), colour, side * float(reach.max())))
        found.sort()
        edge = panel.top + 0.035 if side > 0 else panel.bottom - 0.035
        taken += [(x - 0.04, edge - 0.04, x + 0.04, edge + 0.04) for x, _, _ in found]
        for x, colour, value in found:
            panel.page.marks([(x, edge)], "up" if side > 0 else "down", 4.5, fill=colour)
            words = f"{two_digits(value)}°"
            places = _beside(panel, words, x, edge + (0.04 if side > 0 else 0.02), side)
            boxes = [text_box(words, style.NOTE, *place) for place in places]
            lines_in = drawn if drawn is not None else list(lines.values())
            strikes = [struck(panel, t, lines_in, box) + 1000 * sum(overlap(box, o) for o in taken) for box in boxes]
            best = strikes.index(min(strikes))
            taken.append(boxes[best])
            at_x, at_y, align = places[best]
            panel.page.text(at_x, at_y, words, size=style.NOTE, colour=colour, align=align, halo=True)


def _beside(panel: Panel, words: str, x: float, y: float, side: float) -> list[tuple[float, float, Align]]:
    """Places for a word right or left of a triangle at the edge, then further into the panel."""
    width = style.text_width(words, style.NOTE) + 0.055
    found: list[tuple[float, float, Align]] = []
    for row in range(4):
        down = y + side * 0.1 * row
        found += [(x + 0.055, down, "left")] if x + width < panel.right else []
        found += [(x - 0.055, down, "right")] if x - width > panel.left else []
    return found


def overlap(a: Box, b: Box) -> bool:
    """True where two boxes (left, top, right, bottom) share a place."""
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def padded(low: float, high: float, share: float = 0.06) -> Limits:
    """Limits with a margin; never empty, never nan."""
    if not (math.isfinite(low) and math.isfinite(high)):
        return -1.0, 1.0
    if high - low <= 1e-12 * max(abs(low), abs(high), 1e-12):
        pad = 0.1 * abs(low) or 1.0
        return low - pad, high + pad
    return low - share * (high - low), high + share * (high - low)
