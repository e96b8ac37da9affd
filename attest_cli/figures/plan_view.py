"""The track seen from above: equal scales by arithmetic, ellipses, stops with their numbers, scale bar, arrow north."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..records import Array
from . import reduce, style, ticks
from .drive import Drive, Part
from .page import Box, Page, Panel, Shape, middle
from .words import number

CHI_95 = 2.448  # sqrt of the 95 % quantile of chi-square with two degrees of freedom
ELLIPSE_S, ELLIPSE_SHARE = 10.0, 0.03
MOST_SQUARES = 40
LEAST_TRACK_M = 0.5


@dataclass(frozen=True, slots=True)
class Plan:
    """Level track in metres, to the right and up on the page."""

    right: Array
    up: Array
    sigma_right: Array
    sigma_up: Array
    covariance: Array


def plan_of(drive: Drive) -> Plan:
    """The level track, east to the right and north up the page."""
    names = ("position_x_m", "position_y_m", "sigma_position_x_m", "sigma_position_y_m")
    right, up, sigma_right, sigma_up = (drive.column(name) for name in names)
    return Plan(right, up, sigma_right, sigma_up, drive.column("position_cov_xy_m2"))


def usable(drive: Drive) -> bool:
    """True where a track may be drawn: positions are there and not worse than the distance they tell of."""
    stated = (drive.report.get("statistics") or {}).get("position_usable")
    there = np.isfinite(drive.column("position_x_m")) & np.isfinite(drive.column("position_y_m"))
    return bool(stated is not False and there.any() and moved(drive))


def moved(drive: Drive) -> bool:
    """True where the track leaves its first point by more than half a metre and three of its median sigmas."""
    plan = plan_of(drive)
    known = np.flatnonzero(np.isfinite(plan.right + plan.up))
    if not known.size:
        return False
    far = np.hypot(plan.right[known] - plan.right[known[0]], plan.up[known] - plan.up[known[0]]).max()
    sigma = np.hypot(plan.sigma_right, plan.sigma_up)[known]
    sigma = sigma[np.isfinite(sigma)]
    return bool(far > max(LEAST_TRACK_M, 3.0 * float(np.median(sigma)) if sigma.size else 0.0))


def axes_words(drive: Drive) -> str:
    """What the axes of the plan are."""
    if any(warning["code"] == "north-not-shown" for warning in drive.report.get("warnings", [])):
        return "m, axes of the fixes"  # which gave the place, if not the heading
    if drive.relative:
        return "m, turned by an unknown heading"
    return "ENU, m"


def draw_plan(page: Page, drive: Drive, box: Box) -> Panel:
    """Draw the track into a box; the right 0.45 in hold the arrow, the lower 0.3 in the scale bar."""
    plan = plan_of(drive)
    left, top, width, height = box
    panel = _equal(page, plan, (left, top, width - 0.45, height - 0.3))
    _ellipses(page, panel, drive, plan)
    for piece in reduce.pieces(np.isfinite(plan.right) & np.isfinite(plan.up), drive.breaks):
        points = _thinned(np.column_stack((panel.x(plan.right[piece]), panel.y(plan.up[piece]))))
        page.items.append(Shape((points,), "ink", 1.2))
    _squares(page, panel, drive, plan)
    _scale_bar(page, panel, left + width, top + height)
    if not drive.relative:
        x = left + width - 0.12
        page.text(x, top + 0.1, "N mag" if drive.heading == "magnetic" else "N", size=style.TICK, align="middle")
        page.line([(x, top + 0.48), (x, top + 0.2)], "text", 0.9)
        page.marks([(x, top + 0.19)], "up", 5.0, fill="text")
    return panel


def _equal(page: Page, plan: Plan, box: Box) -> Panel:
    """A panel in which a metre is as long up as across, the track in its middle."""
    _, _, width, height = box
    reach = [_reach(plan.right, plan.sigma_right), _reach(plan.up, plan.sigma_up)]
    spans = [b - a for a, b in reach]
    per_inch = max(spans[0] / (width - 0.2), spans[1] / (height - 0.2), 0.02)
    centre = [0.5 * (a + b) for a, b in reach]
    half = (0.5 * per_inch * width, 0.5 * per_inch * height)
    return page.panel(box, (centre[0] - half[0], centre[0] + half[0]), (centre[1] - half[1], centre[1] + half[1]))


def _reach(values: Array, sigma: Array) -> tuple[float, float]:
    """Lowest and highest value with its ellipse; an ellipse far larger than the track does not shrink the track."""
    known = np.isfinite(values)
    low, high = float(values[known].min()), float(values[known].max())
    spread = CHI_95 * np.nan_to_num(sigma[known])
    most = 0.35 * (high - low) + float(np.median(spread))
    return max(float((values[known] - spread).min()), low - most), min(
        float((values[known] + spread).max()), high + most
    )


def _thinned(points: Array) -> Array:
    """Points of a line in inches at least half a pixel apart along it; first and last stay."""
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    keep = np.concatenate(([True], np.diff(np.floor(along * (2.0 * style.DPI))) > 0))
    keep[-1] = True
    return np.asarray(points[keep])


def ellipse_nodes(drive: Drive, plan: Plan, width_m: float) -> list[int]:
    """Nodes for an ellipse: ten seconds and 3 % of the panel's width apart."""
    chosen: list[int] = []
    known = np.flatnonzero(np.isfinite(plan.right + plan.up + plan.sigma_right + plan.sigma_up))
    _, firsts = np.unique(np.floor(drive.t[known] / ELLIPSE_S), return_index=True)
    last = (math.inf, math.inf)
    for k in known[firsts].tolist():
        here = (float(plan.right[k]), float(plan.up[k]))
        if math.dist(here, last) >= ELLIPSE_SHARE * width_m:
            chosen.append(k)
            last = here
    return chosen


def _ellipses(page: Page, panel: Panel, drive: Drive, plan: Plan) -> None:
    turn = np.linspace(0.0, 2.0 * math.pi, 41)
    circle = CHI_95 * np.column_stack((np.cos(turn), np.sin(turn)))
    k = ellipse_nodes(drive, plan, panel.x_limits[1] - panel.x_limits[0])
    if not k:
        return
    cross = np.nan_to_num(plan.covariance[k])
    level = np.array([[plan.sigma_right[k] ** 2, cross], [cross, plan.sigma_up[k] ** 2]])
    values, axes = np.linalg.eigh(level.transpose(2, 0, 1))
    rings = circle * np.sqrt(np.maximum(values, 0.0))[:, None, :] @ axes.swapaxes(1, 2)
    across, down = panel.x(plan.right[k, None] + rings[..., 0]), panel.y(plan.up[k, None] + rings[..., 1])
    places = np.stack((across, down), axis=-1)
    page.items.append(Shape(tuple(places), "measurement", 0.35, clip=panel.box))


def stop_places(drive: Drive, plan: Plan) -> list[tuple[Part, float, float]]:
    """Where each stop is on the plan: the node in its middle."""
    places = []
    for part in drive.stops:
        k = int(np.argmin(np.abs(drive.t - 0.5 * (part.start + part.end)))) if drive.t.size else 0
        if drive.t.size and math.isfinite(plan.right[k] + plan.up[k]):
            places.append((part, float(plan.right[k]), float(plan.up[k])))
    return places


def _squares(page: Page, panel: Panel, drive: Drive, plan: Plan) -> None:
    """A square with its number at each stop; stops at one place share a square and stand beside it."""
    groups: list[tuple[float, float, list[str]]] = []
    for part, right, up in stop_places(drive, plan):
        x, y = float(panel.x(right)), float(panel.y(up))
        near = next((g for g in groups if abs(g[0] - x) < 0.13 and abs(g[1] - y) < 0.11), None)
        if near is not None:
            near[2].append(str(part.index))
        else:
            groups.append((x, y, [str(part.index)]))
    if len(groups) > MOST_SQUARES:
        page.marks([(x, y) for x, y, _ in groups], "square", 3.0, fill="stop", edge="ink", width=0.5)
        return
    for x, y, names in groups:
        page.marks([(x, y)], "square", 7.0 + 2.4 * (len(names[0]) > 2), fill="stop", edge="ink", width=0.7)
        page.text(x, y + middle(6.0), names[0], size=6.0, align="middle")
        if len(names) > 1:
            rest = ", ".join(names[1:4]) + (" …" if len(names) > 4 else "")
            page.text(x + 0.08, y + middle(6.0), rest, size=6.0, halo=True)


def _scale_bar(page: Page, panel: Panel, right: float, bottom: float) -> None:
    """A bar of 1, 2, 2.5 or 5 times a power of ten metres, at most 1.1 in long, with its length."""
    per_inch = (panel.x_limits[1] - panel.x_limits[0]) / panel.width
    length = ticks.symmetric(1.1 * per_inch)[0][2]
    words = f"{number(length / 1000.0, ticks.decimals_of(length / 1000.0))} km" if length >= 1000.0 else ""
    words = words or f"{number(length, ticks.decimals_of(length))} m"
    size = length / per_inch
    page.line([(right - 0.05 - size, bottom - 0.05), (right - 0.05, bottom - 0.05)], "text", 1.3)
    page.text(right - 0.05 - 0.5 * size, bottom - 0.1, words, align="middle")
