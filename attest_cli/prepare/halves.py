"""Whether gyro and accelerometer of different channels share a clock: both begin and cease to shake together."""

from __future__ import annotations

import numpy as np

from ..maths.consistency import MAD
from ..records import Array, Bools, Ints, Warn

STEP_S, LEAST_SAMPLES, LASTS = 0.05, 4, 9  # of the level of shaking; in a step; steps that a change has to last
REST, LIVELY, BETWEEN = 0.03, 0.7, 0.4  # quantiles of the level; where it counts as shaking
LOUD = 2.0  # by so much more, in its logarithm, it shakes in motion
REACH_S, LATE_S = 2.0, 0.15  # delays that are looked for; least that is told
FEW, PAIRED = 2, 0.7  # beginnings, and ends; share of the edges that have a fellow
SCATTER = 0.4  # of the delay


def doubts(names: tuple[str, str], t: Array, gyro: Array, accel: Array) -> list[Warn]:
    """Say by how much the accelerometer is late against the gyro, where beginnings and ends of motion agree on it.

    A vehicle that pulls away before it turns moves beginnings and ends apart; a clock moves both alike.

    Parameters
    ----------
    names : of the channels of gyro and accelerometer
    t, gyro, accel : (n,), (n, 3) samples, joined by their stamps
    """
    step = max(STEP_S, LEAST_SAMPLES * float(np.median(np.diff(t))))
    first = np.searchsorted(t, np.arange(t[0], t[-1], step))
    first = first[np.flatnonzero(np.diff(first, prepend=-1))]
    shaking = [_shaking(values, first) for values in (gyro, accel)]
    if shaking[0] is None or shaking[1] is None:
        return []
    at = t[first]
    edges = [np.flatnonzero(np.diff(on.astype(np.int8))) for on in shaking if on is not None]
    ways = [on[k + 1] for on, k in zip(shaking, edges, strict=True) if on is not None]
    late, begins = _pairs([at[k] for k in edges], ways)
    if len(late) < PAIRED * max(len(edges[0]), 1) or min(begins.sum(), (~begins).sum()) < FEW:
        return []
    delay = float(np.median(late))
    each = [float(np.median(late[which])) for which in (begins, ~begins)]
    scatter = MAD * float(np.median(np.abs(late - delay)))
    if abs(delay) < LATE_S or min(each) * max(each) <= 0.0 or scatter > SCATTER * abs(delay):
        return []
    if min(map(abs, each)) < 0.5 * abs(delay):
        return []
    word = "late" if delay > 0.0 else "early"
    message = f"{names[1]} is {abs(delay):.2f} s {word} against {names[0]}: rests begin and end at other times there"
    hint = "put both on one clock; velocity and position are wrong by the delay, and tilt where it turns"
    return [Warn("accel-late", message, hint, fatal=True)]


def _shaking(values: Array, first: Ints) -> Bools | None:
    """Return where a sensor shakes (k,), by the changes from sample to sample; None where it never rests."""
    change = np.sum(np.diff(values, axis=0, prepend=values[:1]) ** 2, axis=1)
    level = np.log(np.maximum(np.add.reduceat(change, first) / np.diff(first, append=len(values)), 1e-18))
    low, high = np.quantile(level, (REST, LIVELY))
    if high - low < LOUD:
        return None
    on = (level > low + BETWEEN * (high - low)).astype(float)
    lasting: Bools = np.convolve(on, np.ones(LASTS), "same") > 0.5 * LASTS
    return lasting


def _pairs(at: list[Array], begins: list[Bools]) -> tuple[Array, Bools]:
    """Return by how much the edges of the second come late after those of the first (k,), and which are beginnings."""
    late, which = [np.empty(0)], [np.empty(0, dtype=np.bool_)]
    for way in (True, False):
        when, alike = (np.append(x[b == way], np.inf) for x, b in zip(at, begins, strict=True))
        after = np.searchsorted(alike, when[:-1])
        apart = np.stack([alike[after], alike[np.maximum(after - 1, 0)]]) - when[:-1]
        nearest = np.where(np.abs(apart[0]) < np.abs(apart[1]), *apart)
        near = nearest[np.abs(nearest) < REACH_S]
        late.append(near)
        which.append(np.full(near.size, way))
    return np.concatenate(late), np.concatenate(which)
