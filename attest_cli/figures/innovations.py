"""Page 5, innovations, one page per sensor: are the measurements as far off as their sigma says, and independent?"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..maths import consistency
from ..records import BOUNDS, Array, Bools, Ints, Result
from . import reduce, style, ticks
from .drive import Drive
from .frame import new_page, row_name
from .page import AXIS_PT, DASHED, Kind, Page, Panel
from .words import clean, cut, number, percent

LEAST = 5  # measurements of a sensor that make a page
EDGE = 5.0  # the panel of innovations reaches this many sigma
MOST_POINTS = 1500  # more measurements are drawn as a field
LAGS = 25
NAMES = {"zero_rate": "zero rate", "sun": "sun sensor"}
BRIEF = {"accelerometer": "accel.", "sun": "sun", "magnetometer": "magnetic", "orientation": "attitude"}


@dataclass(frozen=True, slots=True)
class Found:
    """Measurements of one sensor in time order: ``z`` (m, k) in predicted sigma, nan beyond the degrees of freedom."""

    name: str
    z: Array
    nis: Array
    used: Bools
    segment: Ints
    dof: int

    @property
    def mean_nis(self) -> float:
        """Mean NIS of what was used."""
        known = self.nis[self.used & np.isfinite(self.nis)]
        return float(known.mean()) if known.size else math.nan

    @property
    def rejected(self) -> int:
        """How many were not used."""
        return int((~self.used).sum())


def sensors(result: Result) -> list[str]:
    """Sensors with enough measurements for a page, in the order of the file; what is only assumed is no sensor."""
    names = np.asarray(result.innovations.get("sensor", np.empty(0, dtype=object))).astype(str)
    kinds, first, counts = np.unique(names, return_index=True, return_counts=True)
    order = np.argsort(first)
    return [str(kinds[k]) for k in order if counts[k] >= LEAST and kinds[k] not in BOUNDS]


def found(result: Result, sensor: str) -> Found:
    """The measurements of one sensor; only those with its usual degrees of freedom."""
    table = result.innovations
    dofs = np.asarray(table["dof"], dtype=np.int64)
    rows = np.asarray(table["sensor"]).astype(str) == sensor
    dof = int(np.bincount(dofs[rows]).argmax())
    rows &= dofs == dof
    z = np.column_stack([np.asarray(table[f"z{k}"], dtype=np.float64)[rows] for k in range(3)])
    return Found(
        sensor, z[:, : min(dof, 3)], np.asarray(table["nis"], dtype=np.float64)[rows],
        np.asarray(table["used"], dtype=np.bool_)[rows], np.asarray(table["segment"], dtype=np.int64)[rows], dof,
    )  # fmt: skip


def draw(result: Result, theme: str = "light", sensor: str = "") -> Page | None:
    """The page of one sensor (the first with enough measurements where none is named)."""
    names = sensors(result)
    if not names or (sensor and sensor not in names):
        return None
    drive, data = Drive(result), found(result, sensor or names[0])
    parts = f"{data.dof} component" + ("s" if data.dof > 1 else "")
    page = new_page(
        drive, theme, 5.6, titles(data),
        [drive.span, f"{plain(data.name)}, {parts} · innovations before use, divided by predicted σ"],
        f"Innovations over measurement number, histogram of NIS and autocorrelation; {data.rejected} of "
        f"{data.nis.size} rejected.", status(data),
    )  # fmt: skip
    _scatter(page, drive, data)
    _histogram(page, data)
    _autocorrelation(page, data)
    return page


def plain(name: str) -> str:
    """Sensor name in words."""
    return NAMES.get(name, clean(name.replace("_", " "), 30))


def share_inside(data: Found) -> float:
    """Share of the used measurements with a NIS inside the 95 % interval of chi-square; nan without any."""
    nis = data.nis[data.used & np.isfinite(data.nis)]
    low, high = (consistency.upper_quantile(data.dof, p) for p in (0.975, 0.025))
    return float(np.mean((nis >= low) & (nis <= high))) if nis.size else math.nan


def share_fits(data: Found) -> bool:
    """False where that share is more than 5 points and more than 4 binomial standard deviations from 95 %."""
    count = int((data.used & np.isfinite(data.nis)).sum())
    allowed = max(0.05, 4.0 * math.sqrt(0.95 * 0.05 / max(count, 1)))
    return bool(abs(share_inside(data) - 0.95) <= allowed)


def status(data: Found) -> str:
    """The worse verdict, on what was rejected and on the mean NIS of the rest, by the rule of the report."""
    count, used = data.nis.size, int((data.used & np.isfinite(data.nis)).sum())
    found = (
        consistency.rejection_status(data.rejected, count), consistency.noise_status(data.mean_nis, used, data.dof)
    )  # fmt: skip
    return "FAIL" if not used or "FAIL" in found else "WARN" if "WARN" in found else "PASS"


def titles(data: Found) -> list[str]:
    """The finding, longest first."""
    name = plain(data.name)
    head = name[0].upper() + name[1:]
    count, gone = number(data.nis.size), number(data.rejected)
    if not data.used.any():
        return [f"{head}: all {count} measurements rejected"]
    mean = number(data.mean_nis, 2)
    degrees = f"{data.dof} degree" + ("s" if data.dof > 1 else "") + " of freedom"
    if data.rejected > 0.1 * data.nis.size:
        return [f"{head}: {gone} of {count} measurements rejected; mean NIS of the rest {mean} for {data.dof} dof"]
    tail = f", {gone} of {count} rejected" if data.rejected else ""
    fit = consistency.mean_nis(data.mean_nis, int((data.used & np.isfinite(data.nis)).sum()), data.dof)
    if fit != "fits":
        kind = f"are {fit} than claimed"
    elif not share_fits(data):
        within = f"{percent(share_inside(data))} inside the 95 % interval"
        return [f"{head} innovations: {within}, mean NIS {mean} for {data.dof} dof", f"{head} innovations: {within}"]
    else:
        kind = "are consistent"
    return [
        f"{head} innovations {kind}: mean NIS {mean} for {degrees}{tail}",
        f"{head} innovations {kind}: mean NIS {mean} for {data.dof} dof{tail}",
        f"{head} innovations {kind}: mean NIS {mean} for {data.dof} dof",
        f"{head}: mean NIS {mean} for {data.dof} dof",
    ]


def looks(components: int) -> list[tuple[str, str, str]]:
    """Name, fill and edge colour of each component: ink and open for two, the axis colours for three."""
    if components == 1:
        return [("", "ink", "")]
    if components == 2:
        return [("x", "ink", ""), ("y", "paper", "measurement")]
    return [("x", "x", ""), ("y", "y", ""), ("z", "z", "")]


def _scatter(page: Page, drive: Drive, data: Found) -> None:
    """Innovations over measurement number, stops shaded, rejected at the edge."""
    count = data.nis.size
    panel = page.panel((0.95, 1.12, 6.75, 1.25), (-0.5, count - 0.5), (-EDGE, EDGE))
    _stops(page, panel, data.segment, {part.index for part in drive.stops})
    panel.polygon([-0.5, count - 0.5, count - 0.5, -0.5], [-2, -2, 2, 2], "band2")
    panel.across(0.0)
    panel.y_axis(([-4.0, -2.0, 0.0, 2.0, 4.0], ["−4", "−2", "0", "+2", "+4"]))
    panel.x_axis(ticks.linear(0.0, max(count - 1.0, 1.0), 7), "measurement number")
    at = np.arange(count, dtype=np.float64)
    kinds = looks(data.z.shape[1])
    if count <= MOST_POINTS:
        for k, (_, fill, edge) in enumerate(kinds):
            seen = data.used & np.isfinite(data.z[:, k])
            shown = np.clip(data.z[seen, k], -EDGE, EDGE)
            size = 2.6 if count <= 500 else 1.8
            panel.points(at[seen], shown, "circle", size, fill=fill, edge=edge, width=0.5 if edge else 0.0)
    else:
        _field(panel, data, at)
    _rejected(panel, data, at)
    row_name(page, panel, BRIEF.get(data.name, cut(plain(data.name), 9)), "in σ", y=panel.top + 0.29)
    _key(page, panel, data, kinds, dense=count > MOST_POINTS)


def _stops(page: Page, panel: Panel, segment: Ints, stops: set[int]) -> None:
    """Stops shaded with their number above and a line between two that touch; none where they are too many."""
    starts = np.concatenate(([0], np.flatnonzero(np.diff(segment)) + 1)).astype(int)
    ends = np.append(starts[1:], segment.size)
    runs = [(a, b) for a, b in zip(starts.tolist(), ends.tolist(), strict=True) if int(segment[a]) in stops]
    if not runs or len(runs) > 60:
        return
    panel.shade([(a - 0.5, b - 0.5) for a, b in runs])
    for (_, before), (after, _) in pairwise(runs):
        if before == after:
            x = float(panel.x(after - 0.5))
            page.line([(x, panel.top), (x, panel.bottom)], "paper", 1.2)
    wide = sorted(runs, key=lambda s: s[0] - s[1])
    panel.above([(0.5 * (a + b) - 0.5, str(int(segment[a]))) for a, b in wide])
    page.text(panel.left - 0.08, panel.top - 0.07, "segment", size=style.NUMBER, colour="mute", align="right")


def _field(panel: Panel, data: Found, at: Array) -> None:
    """Too many to tell apart: the reach of all components per column, and their mean."""
    low = np.where(data.used, np.nanmin(np.nan_to_num(data.z, nan=np.inf), axis=1), np.nan)
    high = np.where(data.used, np.nanmax(np.nan_to_num(data.z, nan=-np.inf), axis=1), np.nan)
    known = np.isfinite(low) & np.isfinite(high)
    if not known.any():
        return
    panel.band(at[known], low[known], high[known], np.zeros(int(known.sum()), dtype=np.bool_), "band1")
    for limit in (-2.0, 2.0):
        panel.across(limit, "mute", AXIS_PT, DASHED)
    x, mean = reduce.column_mean(at[known], 0.5 * (low + high)[known], *panel.x_limits, panel.columns // 4)
    panel.series(x, mean, np.zeros(x.size, dtype=np.bool_), "ink", 0.7)


def _rejected(panel: Panel, data: Found, at: Array) -> None:
    """Rejected measurements at the edge on their side, the largest with their size."""
    gone = np.flatnonzero(~data.used)
    if not gone.size:
        return
    z = np.nan_to_num(data.z[gone])
    worst = z[np.arange(gone.size), np.abs(z).argmax(axis=1)]
    size = np.maximum(np.abs(worst), np.sqrt(np.maximum(np.nan_to_num(data.nis[gone]), 0.0)))
    edge = np.where(worst < 0.0, -4.4, 4.4)
    if gone.size > 400:  # a row of crosses is a row of crosses
        _, firsts = np.unique(np.floor(panel.x(at[gone]) * 25.0), return_index=True)
        panel.points(at[gone][firsts], edge[firsts], "cross", 4.5, edge="limit", width=1.1)
    else:
        panel.points(at[gone], edge, "cross", 4.5, edge="limit", width=1.1)
    taken: list[float] = []
    for k in np.argsort(-size, kind="stable")[:200].tolist():
        x = float(panel.x(at[gone[k]]))
        if all(abs(x - other) > 0.45 for other in taken) and len(taken) < 10:
            taken.append(x)
            panel.label(
                float(at[gone[k]]), float(edge[k]), f"{number(size[k])}σ", colour="limit", size=style.NOTE, halo=True,
                align="middle", shift=(0.0, 0.155 if edge[k] > 0.0 else -0.07),
            )  # fmt: skip


def _key(page: Page, panel: Panel, data: Found, kinds: list[tuple[str, str, str]], *, dense: bool) -> None:
    """What the markers are, under the row name."""
    y = panel.top + 0.62
    if dense:
        for words in ("min–max", "and mean"):
            page.text(0.2, y, words, size=style.NOTE, colour="mute")
            y += 0.13
    elif len(kinds) > 1:
        for name, fill, edge in kinds:
            page.marks([(0.245, y - 0.035)], "circle", 4.0, fill=fill, edge=edge, width=0.6 if edge else 0.0)
            page.text(0.345, y, name, size=style.NOTE, colour=edge or fill)
            y += 0.135
    if data.rejected:
        page.marks([(0.245, y - 0.035)], "cross", 4.5, edge="limit", width=1.1)
        page.text(0.345, y, "rejected", size=style.NOTE, colour="limit")


def _histogram(page: Page, data: Found) -> None:
    """NIS of what was used, against chi-square."""
    top = 3.02
    _head(page, 0.95, "NIS", f"used measurements against χ², {data.dof} degrees of freedom" if data.dof > 1 else
          "used measurements against χ², 1 degree of freedom")  # fmt: skip
    nis = data.nis[data.used & np.isfinite(data.nis)]
    low, high = consistency.upper_quantile(data.dof, 0.975), consistency.upper_quantile(data.dof, 0.025)
    last = float(math.ceil(max(2.0 * high / 1.3, 6.0)))
    width = last / 20.0
    counts = np.histogram(np.minimum(nis, last - 1e-9), bins=20, range=(0.0, last))[0].astype(np.float64)
    grid = np.linspace(1e-6, last, 200)
    expected = nis.size * width * consistency.density(grid, data.dof)
    tallest = max(float(counts.max()), float(expected[grid > 0.5 * width].max(initial=0.0)), 1.0) * 1.18
    panel = page.panel((0.95, top, 3.3, 1.83), (0.0, last), (0.0, tallest))
    at = ticks.linear(0.0, tallest, 5)
    whole = [(v, w) for v, w in zip(*at, strict=True) if v == round(v)]
    at = ([v for v, _ in whole], [number(v) for v, _ in whole])
    panel.grid(at[0][1:])
    edges = np.repeat(np.linspace(0.0, last, 21), 2)
    panel.polygon(edges, np.concatenate(([0.0], np.repeat(counts, 2), [0.0])), "band")
    if nis.size:
        panel.series(grid, expected, np.zeros(grid.size, dtype=np.bool_), "ink", 1.2)
        _inside(panel, share_inside(data), low, high)
    else:
        page.text(panel.left + 1.65, top + 0.95, "no measurement was used", colour="mute", align="middle")
    panel.y_axis(at)
    panel.x_axis(ticks.linear(0.0, last, 5), "NIS, last bar with all beyond" if (nis > last).any() else "NIS")
    page.text(0.2, top + 0.95, "count", size=style.NOTE, colour="mute")


def _inside(panel: Panel, share: float, low: float, high: float) -> None:
    """The 95 % interval and the share found in it; a lower end on the axis has no name."""
    for value, words, align in ((low, "2.5 %", "left"), (high, "97.5 %", "middle")):
        x = float(panel.x(value))
        if x - panel.left < 0.03:
            continue
        panel.page.line([(x, panel.top + 0.12), (x, panel.bottom)], "mute", 0.6, (4.0, 2.0))
        panel.page.text(
            x + (0.03 if align == "left" else 0.0), panel.top + 0.09, words, size=style.NOTE, colour="mute",
            align="left" if align == "left" else "middle", halo=True,
        )  # fmt: skip
    x = panel.right - 0.05
    panel.page.text(x, panel.top + 0.78, f"{percent(share)} inside", align="right", halo=True)
    panel.page.text(x, panel.top + 0.93, "(95 % expected)", align="right", halo=True)


def _head(page: Page, x: float, name: str, note: str) -> None:
    page.text(x, 2.89, name, size=style.ROW, bold=True)
    page.text(x + style.text_width(name, style.ROW, bold=True) + 0.1, 2.89, note, size=style.NOTE, colour="mute")


def autocorrelation(z: Array, lags: int) -> Array:
    """Normalised autocorrelation of a series about its mean at lags 1 to ``lags``; zeros for a constant."""
    centred = z - z.mean()
    power = float(centred @ centred)
    if power == 0.0:
        return np.zeros(lags)
    return np.array([float(centred[k:] @ centred[:-k]) / power for k in range(1, lags + 1)])


def _autocorrelation(page: Page, data: Found) -> None:
    """Stems per component with the band of white noise."""
    _head(page, 4.95, "Autocorrelation", "grey: 95 % band of white noise")
    z = [column[data.used & np.isfinite(column)] for column in data.z.T]
    count = min((c.size for c in z), default=0)
    lags = min(LAGS, count // 2 - 1)
    if lags < 2:
        page.text(6.3, 3.97, "too few used measurements", colour="mute", align="middle")
        return
    found_z = [autocorrelation(column, lags) for column in z]
    limit = max(0.35, 1.15 * max(float(np.abs(c).max()) for c in found_z), 1.3 * 1.96 / math.sqrt(count))
    panel = page.panel((5.1, 3.02, 2.6, 1.83), (0.3, lags + 0.7), (-limit, limit))
    band = 1.96 / math.sqrt(count)
    panel.polygon([0.3, lags + 0.7, lags + 0.7, 0.3], [-band, -band, band, band], "band2")
    panel.across(0.0)
    kinds = looks(len(found_z))
    shift = min(0.3, 0.6 / len(found_z))
    for k, (values, (_, fill, edge)) in enumerate(zip(found_z, kinds, strict=True)):
        at = np.arange(1.0, lags + 1.0) + shift * (k - 0.5 * (len(kinds) - 1))
        colour = edge or fill
        for x, v in zip(at.tolist(), values.tolist(), strict=True):
            page.line([(float(panel.x(x)), float(panel.y(0.0))), (float(panel.x(x)), float(panel.y(v)))], colour, 0.9)
        kind: Kind = "circle"
        panel.points(at, values, kind, 2.4, fill=colour)
    panel.y_axis(ticks.linear(-limit, limit, 5, sign=True))
    lag_ticks = [float(v) for v in (1, *range(5, lags + 1, 5))] if lags >= 8 else [float(v) for v in range(1, lags + 1)]
    panel.x_axis((lag_ticks, [number(v) for v in lag_ticks]), "lag, measurements")
