"""Pictures of the pages in ``docs``: panels one below the other, in the colours of attest's own pages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import fontManager, get_font
from numpy.typing import NDArray

from attest_cli.figures.style import THEMES, font_files

Array = NDArray[np.float64]
INK = THEMES["light"]
WIDTH_IN, PANEL_IN, DPI = 8.0, 2.3, 130


@dataclass
class Panel:
    """One panel: what is on its axes, its title, the range of y; lines are drawn in the order they are given."""

    label: str
    title: str
    limits: tuple[float, float] | None = None
    log: bool = False
    marks: list[Callable[[Axes], object]] = field(default_factory=list)

    def line(self, x: Array, y: Array, name: str, colour: str, width: float = 1.0) -> None:
        """Add a line."""
        self.marks.append(lambda axes: axes.plot(x, y, color=colour, lw=width, label=name))

    def band(self, x: Array, half: Array, name: str, colour: str) -> None:
        """Add a band about zero."""
        self.marks.append(lambda axes: axes.fill_between(x, -half, half, color=colour, lw=0.0, label=name))

    def spans(self, edges: Array, colour: str, name: str = "") -> None:
        """Shade spans (k, 2) of x."""
        for k, (start, end) in enumerate(edges):
            self.marks.append(
                lambda axes, a=start, b=end, n=name if k == 0 else "": axes.axvspan(a, b, color=colour, lw=0.0, label=n)
            )

    def draw(self, axes: Axes) -> None:
        """Draw everything."""
        for mark in self.marks:
            mark(axes)
        axes.set_ylabel(self.label)
        axes.set_title(self.title, loc="left", fontsize=10, color=INK["text"])
        if self.limits is not None:
            axes.set_ylim(*self.limits)
        if self.log:
            axes.set_yscale("log")
        axes.margins(x=0.0)
        axes.grid(color=INK["grid"], lw=0.6)
        axes.set_axisbelow(True)
        axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, fontsize=9)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)


def drawn(path: Path, panels: Sequence[Panel], x_label: str, title: str) -> None:
    """Draw the panels one below the other and write the PNG."""
    import matplotlib as mpl

    regular, _, _ = font_files()
    fontManager.addfont(regular)
    with mpl.rc_context({"font.family": get_font(regular).family_name, "font.size": 9.5}):
        figure = Figure(figsize=(WIDTH_IN, 0.6 + PANEL_IN * len(panels)), layout="constrained", dpi=DPI)
        FigureCanvasAgg(figure)
        axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for panel, at in zip(panels, axes, strict=True):
            panel.draw(at)
        axes[-1].set_xlabel(x_label)
        figure.suptitle(title, x=0.01, ha="left", fontsize=12, color=INK["text"])
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, facecolor=INK["paper"], metadata={"Software": None})
