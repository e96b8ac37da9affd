"""Fixes that leap and stay there: a tracker that lost its target, a frame that was set anew."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...records import Array, Imu, Warn
from .aids import Place
from .start import HOLE, path_felt, second
from .states import State

LEAST, MOST = 20, 5  # fixes to know what is usual; leaps of which more are no leaps but scatter
USUAL, TIMES, SIGMAS = 0.95, 3.0, 3.0  # quantile of what looks like a leap; times that, and sigmas of a fix, of one
ONCE = 0.35  # of a leap: what may be left around it; one bad fix leaves half of it before and after


@dataclass(frozen=True, slots=True)
class Jump:
    """From fix number ``row`` on all fixes are off by ``by`` (3,), m, known to ``sigma``, m."""

    row: int
    by: Array
    sigma: float


def jumps(imu: Imu, t: Array, q: Array, place: Place, gravity: float) -> list[Jump]:
    r"""Return the leaps of fixes.

    The change of the mean velocity between three fixes, seen less felt, :math:`e_k`, is free of position and velocity;
    a leap ``J`` between fixes k and k + 1, ``h`` apart, is in two of them:

    .. math:: e_k=J/h+w_k,\quad e_{k+1}=-J/h+w_{k+1},\quad \hat J=\tfrac h2(e_k-e_{k+1})

    A move that is felt in another heading leaves the same, so what is felt to move as far is no leap.

    Parameters
    ----------
    t, q : (n,), (n, 4) nodes and their attitude; its heading need not be known
    gravity : m/s^2
    """
    rows = np.flatnonzero((place.t > t[0]) & (place.t < t[-1]) & (np.diff(place.t, prepend=-np.inf) > 0.0))
    if len(rows) < LEAST:
        return []
    when, path = place.t[rows], path_felt(imu, t, q, gravity)
    felt = np.stack([np.interp(when, imu.t, path[:, i]) for i in range(3)], axis=1)
    turned = second(when, felt)
    e = np.nan_to_num(second(when, place.place_n[rows]) - turned)
    h = np.diff(when)[1:-1]
    moved = 0.5 * h * np.linalg.norm(turned[:-1] - turned[1:], axis=1)
    by = 0.5 * h[:, None] * (e[:-1] - e[1:])
    left = 0.5 * h * np.linalg.norm(e[:-1] + e[1:], axis=1)
    beside = np.concatenate([[0.0], np.linalg.norm(e, axis=1), [0.0]])
    around = h * np.maximum(beside[:-3], beside[3:])
    size, gap = np.linalg.norm(by, axis=1), np.diff(when)
    longest = np.maximum(np.maximum(gap[:-2], gap[1:-1]), gap[2:])
    usual = float(np.quantile(size, USUAL))
    leaps = size > max(TIMES * usual, SIGMAS * float(np.nanmedian(place.sigma[:, :2])))
    once = np.maximum(np.maximum(left, around), moved) < ONCE * size
    found = np.flatnonzero(leaps & once & (longest < HOLE * np.median(gap)))
    return [Jump(int(rows[k + 2]), by[k], usual) for k in found] if len(found) <= MOST else []


def mended(place: Place, found: Sequence[Jump]) -> Place:
    """Return the fixes without their leaps: all in the frame of the first; what is left of each is a state."""
    place_n = place.place_n.copy()
    for jump in found:
        place_n[jump.row :] -= jump.by
    return replace(place, place_n=place_n, leaps=tuple(jump.row for jump in found))


def jump_states(place: Place, found: Sequence[Jump]) -> list[State]:
    """Return the states that take up what is left of the leaps."""
    sigma = np.repeat([jump.sigma for jump in found], 3)
    return [State(f"{place.role} jump", len(sigma), sigma)] if found else []


def doubts(place: Place, found: Sequence[Jump]) -> list[Warn]:
    """Say when fixes leapt, and how far."""
    if not found:
        return []
    first, more = found[0], f", and {len(found) - 1} times more" if len(found) > 1 else ""
    size = float(np.linalg.norm(first.by))
    stays = " and stays there" if len(found) == 1 else ""
    message = f"{place.role} leaps by {size:.2g} m at {place.t[first.row]:.1f} s{stays}{more}: taken out"
    hint = "did it lose its target, or was its frame set anew? places count in the frame of the first fixes"
    return [Warn(f"{place.role}-jump", message, hint)]
