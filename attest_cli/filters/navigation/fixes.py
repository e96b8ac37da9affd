"""Positions for the navigation smoother: in local axes, at their nodes, without those that cannot be."""

from __future__ import annotations

import numpy as np

from ...nodes import Nodes
from ...records import Array, Bools, Warn
from ...settings import GPS_SIGMA_M, POSITION_SIGMA_M
from .. import Drive
from .aids import Place, drifts
from .states import State

LEAST_SIGMA_M = 1e-3  # no receiver is better, whatever it states
FAST_M_S = 100.0  # a vehicle is hardly faster
ON_NODE_S = 2e-3  # a fix that lies further from every node is left out
OUTLIER_FIXES, OUTLIER_SIGMAS = 5, 30.0  # a fix is held against the median of so many
PLACE_DRIFT, PLACE_DRIFT_S = 0.2, 60.0  # coloured error of fixes: share of their sigma, correlation time
DRIFT_RATE, DRIFT_RATE_S = 0.01, 5.0  # and its rate, share per second: receivers smooth what they show
STATED_RATE = 0.1  # of that, to begin with, where their sigma is stated: it holds most of their error
LAG_SIGMA_S = 0.1  # how late the stamps of fixes may be
APART_S = 0.049  # fixes that come faster are thinned: each is a node


def epochs_of(drive: Drive) -> Array:
    """Return the times of fixes that are to be nodes."""
    kept = []
    for role in ("gps", "position"):
        t = drive.log.fixes[role].t if role in drive.log.fixes else np.zeros(0)
        if len(t) > 1 and float(np.median(np.diff(t))) < APART_S:
            slot = np.floor((t - t[0]) / APART_S)
            t = t[np.concatenate([[True], np.diff(slot) > 0.0])]
        kept.append(t)
    return np.concatenate(kept)


def place_of(drive: Drive, nodes: Nodes, role: str, arm: Array) -> Place:
    """Return the fixes at their nodes, metres east, north and up of the first one."""
    fixes = drive.log.fixes[role]
    node = np.clip(np.searchsorted(nodes.t, fixes.t), 1, len(nodes.t) - 1)
    node = np.where(fixes.t - nodes.t[node - 1] < nodes.t[node] - fixes.t, node - 1, node)
    can_be, place, sigma = possible(drive, role)
    use = can_be & (np.abs(nodes.t[node] - fixes.t) < ON_NODE_S)
    return Place(node[use], fixes.t[use], place[use], sigma[use], arm, role)


def place_states(drive: Drive, place: Place) -> list[State]:
    """Return the states that fixes call for: their coloured error, its rate, and how late they are."""
    stated = "sigma_m" in getattr(drive.settings, place.role).model_fields_set
    rate = DRIFT_RATE * (STATED_RATE if stated else 1.0)
    states, usual = [], float(np.nanmedian(place.sigma))
    for name, axes in drifts(place.role):
        size = axes.stop - axes.start
        states.append(State(name, size, PLACE_DRIFT * usual, PLACE_DRIFT_S))
        states.append(State(f"{name} rate", size, rate * usual, DRIFT_RATE_S, name))
    return [*states, State(f"{place.role} lag", 1, LAG_SIGMA_S)]


def possible(drive: Drive, role: str) -> tuple[Bools, Array, Array]:
    """Return which fixes can be, and all of them in metres east, north and up of the first of these, with their sigma.

    A fix as far off the median of its neighbours as no vehicle goes (0, 0 before the receiver knew its place) would
    bend everything before a weight could be found.
    """
    fixes = drive.log.fixes[role]
    known: Bools = np.asarray(np.isfinite(fixes.values[:, :2]).all(axis=1))
    told = getattr(drive.settings, role).sigma_m
    default = told or (POSITION_SIGMA_M if role == "position" else GPS_SIGMA_M)
    sigma = np.full((len(known), 3), default)
    if fixes.sigma is not None and not told:
        sigma = np.where(np.isfinite(fixes.sigma), np.maximum(fixes.sigma, LEAST_SIGMA_M), default)
    if not known.any():
        return known, np.full((len(known), 3), np.nan), sigma
    middle = np.median(fixes.values[known], axis=0)
    place = fixes.values if role == "position" else _local(fixes.values, (middle[0], middle[1], _height(fixes.values)))
    at = np.flatnonzero(known)
    begin = np.clip(np.arange(len(at)) - OUTLIER_FIXES // 2, 0, max(0, len(at) - OUTLIER_FIXES))
    around = begin[:, None] + np.arange(min(OUTLIER_FIXES, len(at)))
    off = np.linalg.norm(place[at, :2] - np.median(place[at][around][:, :, :2], axis=1), axis=1)
    reach = FAST_M_S * (fixes.t[at][around[:, -1]] - fixes.t[at][around[:, 0]])
    known[at] = off < reach + OUTLIER_SIGMAS * np.nanmedian(sigma[at, :2], axis=1)
    first = place[known][0] if known.any() else place[at[0]]
    origin = np.where(np.isfinite(first), first, 0.0)
    if known.any() and np.isfinite(place[known, 2]).any():
        origin[2] = place[known, 2][np.isfinite(place[known, 2])][0]
    return known, place - origin, sigma


def far_off(drive: Drive, role: str) -> list[Warn]:
    """Say how many fixes cannot be."""
    count = int(np.isfinite(drive.log.fixes[role].values[:, :2]).all(axis=1).sum() - possible(drive, role)[0].sum())
    return [Warn(f"{role}-outliers", f"{count} fixes of {role} are far from all others: not used")] if count else []


def origin_of(drive: Drive) -> tuple[float, float, float] | None:
    """Return where the position counts from: the first fix that can be, rad, rad, m."""
    if "gps" not in drive.log.fixes:
        return None
    values = drive.log.fixes["gps"].values[possible(drive, "gps")[0]]
    return (float(values[0, 0]), float(values[0, 1]), _height(values)) if len(values) else None


def _height(fixes: Array) -> float:
    """Return the first height that is known, else zero."""
    known = np.isfinite(fixes[:, 2])
    return float(fixes[known, 2][0]) if known.any() else 0.0


def _local(fixes: Array, origin: tuple[float, float, float]) -> Array:
    """Return (k, 3) east, north, up in metres of ``origin``; both in rad, rad, m above the ellipsoid (WGS 84)."""
    from pymap3d import geodetic2enu

    height = np.where(np.isfinite(fixes[:, 2]), fixes[:, 2], origin[2])
    enu = geodetic2enu(fixes[:, 0], fixes[:, 1], height, *origin, deg=False)
    out = np.stack([np.asarray(part, dtype=np.float64) for part in enu], axis=1)
    out[~np.isfinite(fixes[:, 2]), 2] = np.nan
    return out
