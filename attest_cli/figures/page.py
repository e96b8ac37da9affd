"""The small canvas room: a page in inches, panels that map data to it, and what is drawn, kept in order until ``png``.

Origin top left, sizes in inches, type and line widths in points. Colours are names of ``style.THEMES`` or ``#RRGGBB``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ..records import Array, Bools
from . import reduce, style
from .ticks import Ticks

Align = Literal["left", "middle", "right"]
Kind = Literal["circle", "square", "cross", "heavy-cross", "up", "down"]
Box = tuple[float, float, float, float]  # left, top, width, height
Limits = tuple[float, float]
DASHED, DOTTED = (4.0, 2.5), (1.0, 1.6)
AXIS_PT = 0.5


@dataclass(frozen=True, slots=True)
class Shape:
    """Lines (``fill`` empty) or filled outlines: runs of points (n, 2) in inches, clipped to a box."""

    runs: tuple[Array, ...]
    colour: str
    width: float = 0.0
    fill: bool = False
    dash: tuple[float, ...] = ()
    clip: Box | None = None


@dataclass(frozen=True, slots=True)
class Marks:
    """One kind of marker at places (n, 2) in inches; ``size``, ``width`` in points; empty colours are not drawn."""

    centres: Array
    kind: Kind
    size: float
    fill: str
    edge: str
    width: float


@dataclass(frozen=True, slots=True)
class Text:
    """One line of text on its baseline."""

    x: float
    y: float
    text: str
    size: float
    colour: str
    bold: bool
    align: Align
    halo: bool


class Page:
    """A page of known size. Nothing is rasterised before ``png``.

    Parameters
    ----------
    height : float
        Inches; the width is ``style.WIDTH_IN``.
    theme : str
        ``light`` or ``dark``.
    title, alt : str
        The finding, and what a reader hears who does not see the picture.
    """

    def __init__(self, height: float, theme: str, title: str, alt: str = "") -> None:
        self.width = style.WIDTH_IN
        self.height = height
        self.colours = style.THEMES[theme]
        self.title = title
        self.alt = alt or title
        self.items: list[Shape | Marks] = []
        self.texts: list[Text] = []
        self.panels: list[Panel] = []

    def colour(self, name: str) -> str:
        """Hex of a colour name; a hex passes."""
        return name if name.startswith("#") else self.colours[name]

    def panel(self, box: Box, x: Limits, y: Limits, *, log: bool = False) -> Panel:
        """A panel with its data limits."""
        made = Panel(self, box, x, y, log=log)
        self.panels.append(made)
        return made

    def text(
        self, x: float, y: float, text: str, *, size: float = style.LABEL, colour: str = "text", bold: bool = False,
        align: Align = "left", halo: bool = False,
    ) -> None:  # fmt: skip
        """Write one line on the baseline ``y``; ``halo`` keeps it readable where it crosses a line."""
        if text:
            self.texts.append(Text(x, y, text, size, colour, bold, align, halo))

    def line(
        self, points: Sequence[tuple[float, float]], colour: str = "mute", width: float = AXIS_PT,
        dash: tuple[float, ...] = (),
    ) -> None:  # fmt: skip
        """A line through points in inches."""
        self.items.append(Shape((np.asarray(points, dtype=np.float64),), colour, width, dash=dash))

    def rectangle(self, box: Box, colour: str) -> None:
        """A filled rectangle."""
        self.items.append(Shape((_corners(box),), colour, fill=True))

    def marks(
        self, centres: ArrayLike, kind: Kind, size: float, *, fill: str = "", edge: str = "", width: float = 0.0
    ) -> None:
        """Markers at places in inches."""
        places = np.asarray(centres, dtype=np.float64).reshape(-1, 2)
        if places.size:
            self.items.append(Marks(places, kind, size, fill, edge, width))

    def png(self) -> bytes:
        """The page as an opaque PNG of at most 256 colours, without time or software metadata."""
        from .canvas import rasterise

        return rasterise(self)


class Panel:
    """A box on the page with data limits; every method draws data given in data units."""

    def __init__(self, page: Page, box: Box, x: Limits, y: Limits, *, log: bool = False) -> None:
        self.page = page
        self.left, self.top, self.width, self.height = box
        self.box = box
        self.x_limits, self.y_limits, self.log = x, y, log

    @property
    def right(self) -> float:
        """Right edge in inches."""
        return self.left + self.width

    @property
    def bottom(self) -> float:
        """Lower edge in inches."""
        return self.top + self.height

    @property
    def columns(self) -> int:
        """Pixel columns of the panel."""
        return max(1, round(self.width * style.DPI))

    def x(self, value: ArrayLike) -> Array:
        """Data to inches from the left."""
        low, high = self.x_limits
        return np.asarray(self.left + (np.asarray(value, dtype=np.float64) - low) * (self.width / (high - low)))

    def y(self, value: ArrayLike) -> Array:
        """Data to inches from the top, held within a few panel heights so that no coordinate runs away."""
        data, (low, high) = np.asarray(value, dtype=np.float64), self.y_limits
        if self.log:
            data, low, high = np.log10(np.maximum(data, 1e-300)), np.log10(low), np.log10(high)
        share = np.clip((data - low) / (high - low), -40.0, 41.0)
        return np.asarray(self.bottom - share * self.height)

    def inside(self, y: ArrayLike) -> Bools:
        """True where a value lies within the limits."""
        values = np.asarray(y, dtype=np.float64)
        return np.asarray((values >= self.y_limits[0]) & (values <= self.y_limits[1]))

    def shade(self, intervals: Iterable[tuple[float, float]], colour: str = "stop") -> None:
        """Full-height fields behind everything."""
        low, high = self.x_limits
        for start, end in intervals:
            left, right = (float(self.x(v)) for v in (max(start, low), min(end, high)))
            if right > left:
                self.page.rectangle((left, self.top, max(right - left, 1.0 / style.DPI), self.height), colour)

    def series(
        self, t: Array, y: Array, breaks: Bools, colour: str = "ink", width: float = 1.1, dash: tuple[float, ...] = ()
    ) -> None:
        """A line of many samples, parted at gaps and NaN, reduced to minimum and maximum per pixel column."""
        runs: list[Array] = []
        for piece in reduce.pieces(np.isfinite(y) & (y > 0.0 if self.log else np.isfinite(y)), breaks):
            if piece.stop - piece.start == 1:
                if self.inside(y[piece]).all():
                    self.points(t[piece], y[piece], "circle", 1.6 * width, fill=colour)
                continue
            tr, yr = reduce.envelope(t[piece], y[piece], *self.x_limits, self.columns)
            runs.append(np.column_stack((self.x(tr), self.y(yr))))
        if runs:
            self.page.items.append(Shape(tuple(runs), colour, width, dash=dash, clip=self.box))

    def band(self, t: Array, lower: Array, upper: Array, breaks: Bools, colour: str = "band") -> None:
        """A filled band between two edges, parted at gaps and NaN."""
        runs = []
        for piece in reduce.pieces(np.isfinite(lower) & np.isfinite(upper), breaks):
            tr, low, high = reduce.band_envelope(t[piece], lower[piece], upper[piece], *self.x_limits, self.columns)
            across, down = self.x(tr), self.y(low)
            edge = np.column_stack((np.r_[across, across[::-1]], np.r_[self.y(high), down[::-1]]))
            runs.append(edge)
        if runs:
            self.page.items.append(Shape(tuple(runs), colour, fill=True, clip=self.box))

    def polygon(self, x: ArrayLike, y: ArrayLike, colour: str, *, edge: float = 0.0) -> None:
        """A filled outline in data units; with ``edge`` points wide it is drawn as a line instead."""
        points = np.column_stack((self.x(x), self.y(y)))
        self.page.items.append(Shape((points,), colour, edge, fill=edge == 0.0, clip=self.box))

    def points(
        self, x: ArrayLike, y: ArrayLike, kind: Kind = "circle", size: float = 2.6, *, fill: str = "", edge: str = "",
        width: float = 0.0,
    ) -> None:  # fmt: skip
        """Markers in data units, drawn where they are (no clip)."""
        self.page.marks(np.column_stack((self.x(x), self.y(y))), kind, size, fill=fill, edge=edge, width=width)

    def across(self, value: float, colour: str = "mute", width: float = AXIS_PT, dash: tuple[float, ...] = ()) -> None:
        """A horizontal line over the whole panel."""
        at = float(self.y(value))
        self.page.line([(self.left, at), (self.right, at)], colour, width, dash)

    def label(
        self, x: float, y: float, text: str, *, colour: str = "text", size: float = style.LABEL, bold: bool = False,
        align: Align = "left", halo: bool = False, shift: tuple[float, float] = (0.0, 0.0),
    ) -> None:  # fmt: skip
        """Text at data coordinates, shifted by inches."""
        at = (float(self.x(x)) + shift[0], float(self.y(y)) + shift[1])
        self.page.text(*at, text, size=size, colour=colour, bold=bold, align=align, halo=halo)

    def grid(self, at: Iterable[float]) -> None:
        """Horizontal grid lines."""
        for value in at:
            self.across(value, "grid")

    def y_axis(
        self, ticks: Ticks, *, side: Literal["left", "right"] = "left", line: bool = True, inset: float = 0.0
    ) -> None:
        """Ticks and their labels beside the panel; ``line`` draws the axis, ``inset`` keeps labels off its ends."""
        edge, out = (self.left, -1.0) if side == "left" else (self.right, 1.0)
        if line:
            self.page.line([(edge, self.top), (edge, self.bottom)])
        for value, words in zip(*ticks, strict=True):
            at = float(self.y(value))
            if line:
                self.page.line([(edge + out * 0.04, at), (edge, at)])
            gap = out * (0.07 if line else 0.04)
            at = min(max(at, self.top + inset), self.bottom - inset)
            align: Align = "right" if side == "left" else "left"
            self.page.text(edge + gap, at + middle(style.TICK), words, size=style.TICK, colour="mute", align=align)

    def x_axis(self, ticks: Ticks, label: str = "") -> None:
        """Axis line, ticks, tick labels and the axis label under the panel."""
        self.page.line([(self.left, self.bottom), (self.right, self.bottom)])
        for value, words in zip(*ticks, strict=True):
            at = float(self.x(value))
            self.page.line([(at, self.bottom), (at, self.bottom + 0.04)])
            self.page.text(at, self.bottom + 0.155, words, size=style.TICK, colour="mute", align="middle")
        centre = self.left + 0.5 * self.width
        self.page.text(centre, self.bottom + 0.315, label, size=style.LABEL, align="middle")

    def above(self, labels: Iterable[tuple[float, str]], lift: float = 0.07, size: float = style.NUMBER) -> None:
        """Small words above the panel, centred at data x; earlier ones win where two would touch."""
        taken: list[tuple[float, float]] = []
        for x, words in labels:
            half = 0.5 * style.text_width(words, size) + 0.03
            centre = min(max(float(self.x(x)), self.left - 0.1 + half), self.right + 0.1 - half)
            if all(centre + half < a or centre - half > b for a, b in taken):
                taken.append((centre - half, centre + half))
                self.page.text(centre, self.top - lift, words, size=size, colour="mute", align="middle")


def middle(size: float) -> float:
    """Distance in inches from the middle of the digits to the baseline."""
    return 0.325 * size * style.font_files()[2] / 72.0


def _corners(box: Box) -> Array:
    left, top, width, height = box
    across, down = (left, left + width), (top, top + height)
    return np.array([(across[0], down[0]), (across[1], down[0]), (across[1], down[1]), (across[0], down[1])])
