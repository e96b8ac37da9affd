"""Lines of many samples, reduced per pixel column without losing what can be seen; gaps, turns and wraps."""

from __future__ import annotations

import numpy as np

from ..records import Array, Bools, Ints

WILD = 10.0


def wrap_deg(angle: Array) -> Array:
    """Angle in degrees folded to [-180, 180)."""
    return np.asarray((angle + 180.0) % 360.0 - 180.0, dtype=np.float64)


def unwrap_deg(angle: Array) -> Array:
    """Angle without jumps, shifted by whole turns so that its first value lies in (-180, 180]; NaN stays NaN."""
    out = np.array(angle, dtype=np.float64)
    known = np.isfinite(out)
    if not known.any():
        return out
    smooth = np.unwrap(out[known], period=360.0)
    turns = np.ceil((smooth[0] - 180.0) / 360.0)
    out[known] = smooth - 360.0 * turns
    return out


def break_after(t: Array, gaps: Array) -> Bools:
    """True at i where a line must not run from sample i to i + 1: over a gap of the log.

    ``t`` (n,) and ``gaps`` (g, 2) in s. The spacing itself tells nothing: nodes stand closer in motion than at stops.
    """
    breaks = np.zeros(t.size, dtype=np.bool_)
    for start, end in gaps:
        breaks[:-1] |= (t[:-1] < end - 1e-9) & (t[1:] > start + 1e-9) & (np.diff(t) >= 0.5 * (end - start))
    return breaks


def pieces(known: Bools, breaks: Bools) -> list[slice]:
    """Runs of samples that are known and not parted by a break."""
    if not known.any():
        return []
    starts = known.copy()
    starts[1:] &= ~known[:-1] | breaks[:-1]
    ends = known.copy()
    ends[:-1] &= ~known[1:] | breaks[:-1]
    first, last = np.flatnonzero(starts), np.flatnonzero(ends)
    return [slice(int(a), int(b) + 1) for a, b in zip(first, last, strict=True)]


def _columns(t: Array, start: float, end: float, count: int) -> tuple[Ints, Ints]:
    """Column of each sample, and the index where each occupied column begins."""
    column = ((t - start) * (count / max(end - start, 1e-12))).astype(np.int64)
    begins = np.flatnonzero(np.concatenate(([True], np.diff(column) != 0)))
    return column, begins.astype(np.int64)


def envelope(t: Array, y: Array, start: float, end: float, columns: int) -> tuple[Array, Array]:
    """Minimum and maximum of each pixel column at their own times, in time order; first and last sample stay.

    ``t`` (n,) non-decreasing, ``y`` (n,) finite; ``start``, ``end`` are the limits of the panel. A picture of the
    result equals a picture of all samples.
    """
    if t.size <= 2 * columns:
        return t, y
    _, begins = _columns(t, start, end, columns)
    run = np.repeat(np.arange(begins.size), np.diff(np.append(begins, t.size)))
    keep = [np.array([0, t.size - 1])]
    for extreme in (np.minimum.reduceat(y, begins), np.maximum.reduceat(y, begins)):
        hits = np.flatnonzero(y == extreme[run])
        keep.append(hits[np.concatenate(([True], np.diff(run[hits]) != 0))])  # the first hit of each column
    index = np.unique(np.concatenate(keep))
    return t[index], y[index]


def band_envelope(
    t: Array, lower: Array, upper: Array, start: float, end: float, columns: int
) -> tuple[Array, Array, Array]:
    """A band per pixel column: minimum of the lower and maximum of the upper edge, at the middle of the column."""
    if t.size <= 2 * columns:
        return t, lower, upper
    _, begins = _columns(t, start, end, columns)
    ends = np.append(begins[1:], t.size) - 1
    middle = 0.5 * (t[begins] + t[ends])
    middle[0], middle[-1] = t[0], t[-1]
    return middle, np.minimum.reduceat(lower, begins), np.maximum.reduceat(upper, begins)


def column_mean(t: Array, y: Array, start: float, end: float, columns: int) -> tuple[Array, Array]:
    """Mean time and mean value of each occupied column."""
    if t.size == 0:
        return t, y
    _, begins = _columns(t, start, end, columns)
    counts = np.diff(np.append(begins, t.size))
    return np.add.reduceat(t, begins) / counts, np.add.reduceat(y, begins) / counts


def is_dense(t: Array, y: Array, start: float, end: float, columns: int, height: float) -> bool:
    """True where more than half of the columns are filled over more than half of the panel's ``height``."""
    if t.size <= 2 * columns:
        return False
    _, begins = _columns(t, start, end, columns)
    reach = np.maximum.reduceat(y, begins) - np.minimum.reduceat(y, begins)
    return bool(np.mean(reach > 0.5 * height) > 0.5)


def robust_limit(differences: list[Array], sigma: Array, moving: Bools, share: float = 0.985) -> float:
    """Half height of a difference panel: the larger ``share`` quantile in motion of 2.2 sigma and of the differences.

    Nodes with a sigma ``WILD`` times its median in motion (after a gap, at a singular angle) do not count; nan without.
    """
    where = moving if moving.any() else np.ones_like(moving)
    known = sigma[where & np.isfinite(sigma)]
    if known.size:
        where = where & ~(sigma > WILD * np.median(known))
        known = sigma[where & np.isfinite(sigma)]
    found = [float(2.2 * np.quantile(known, share))] if known.size else []
    values = np.concatenate([np.abs(d[where & np.isfinite(d)]) for d in differences]) if differences else np.empty(0)
    if values.size:
        found.append(float(np.quantile(values, share)))
    return max(found, default=float("nan"))
