"""Stamps put in order: swapped rows sorted, repeats dropped, batches spread, holes found. All on int64 ns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..errors import AttestError
from ..records import Array, Bools, Ints, Warn
from .epochs import HOUR_S, whole_hours
from .lost import changes

STEP_BACK_NS = 500_000_000
"""A larger step back is another clock, not rows in a wrong order."""

AROUND, FEW_DAMAGED = 7, 0.02  # rows that tell when one was; share of those that are far from them
REVERSED = 0.9  # of the rows are each before the one above it: a log that begins at its end
LONGEST_BATCH_NS = 500_000_000
SHARED = 1.5
"""Stamps further apart than the batch, shared by more rows than this on average, have no resolution."""
TWIN, MANY_TWINS = 0.01, 0.25
"""Of the usual step: so near a row of the same values is a repeat. As near as the second, where that share repeats."""
IN_BURST, BURST, PAUSED = 0.45, 0.5, 0.5  # share of steps; of their mean, which those within bursts stay below; of time
FEW_BURSTS, OF_ITSELF = 50, 2.0  # too few to tell; times the change within a burst: over a pause of the sensor's own
STAMP_EACH = "let the driver stamp every sample"
MANY_SHARED = 20.0
"""The same before repeated rows are dropped, each of which is held against all others of its stamp."""


@dataclass(frozen=True, slots=True)
class Ordered:
    """Rows in order of time: ``rows`` (m,) of the input, ``stamps_ns`` (m,) strictly increasing."""

    rows: Ints
    stamps_ns: Ints
    warnings: tuple[Warn, ...]


def in_order(name: str, stamps_ns: Ints, values: Array, t0_ns: int, *, strict: bool = True) -> Ordered:
    """Sort rows by time and drop repeats.

    Parameters
    ----------
    name : str
        File and channel, for messages.
    stamps_ns : (n,) int64, as found; ``values`` (n, k)
    strict : bool
        As an IMU needs it: refuse a clock that steps back by more than 0.5 s, and spread rows that share a stamp, so
        that the stamps increase strictly. Else such steps are sorted together, and measurements may share a stamp.

    Raises
    ------
    AttestError
        If the clock steps back, or the stamps have no resolution.
    """
    warnings: list[Warn] = []
    rows = np.arange(stamps_ns.size, dtype=np.int64)
    if np.all(stamps_ns[1:] > stamps_ns[:-1]):
        keep = _no_twins(stamps_ns, values, rows) if strict else None
        if keep is None or keep.all():
            arrived = _of_bursts(stamps_ns, values) if strict else None
            if arrived is None:
                return Ordered(rows, stamps_ns, ())
            evenly, spread = _spread(arrived)
            message = f"{name}: {spread} rows came in bursts: spread over the interval of their burst"
            return Ordered(rows, evenly, (Warn("batched-stamps", message, STAMP_EACH),))
        return Ordered(rows[keep], stamps_ns[keep], (_told_repeats(name, int(np.count_nonzero(~keep))),))
    latest = np.maximum.accumulate(stamps_ns)
    back = latest - stamps_ns  # against the maximum so far: 10, 5, 6, 11 has two rows out of order
    if np.any(back):
        worst = int(np.argmax(back))
        if strict and back[worst] > STEP_BACK_NS:
            near = _near(stamps_ns)
            if not near.all():
                return _without(name, stamps_ns, values, t0_ns, near)
            _refuse_step(name, stamps_ns, latest, back, t0_ns)
        rows = np.argsort(stamps_ns, kind="stable").astype(np.int64)
        late = f"{np.count_nonzero(back)} rows out of order, by {back[worst] * 1e-9:.3f} s at most"
        warnings.append(Warn("rows-out-of-order", f"{name}: {late}: sorted"))
    _refuse_coarse(name, stamps_ns[rows], MANY_SHARED)
    rows = rows[_not_repeated(stamps_ns, values, rows)]
    rows = rows[_no_twins(stamps_ns, values, rows)] if strict else rows
    as_found = rows.size == stamps_ns.size and not np.any(back)
    found = stamps_ns if as_found else stamps_ns[rows]  # no second copy of the stamps of a long log
    _refuse_coarse(name, found)
    if rows.size < stamps_ns.size:
        warnings.append(_told_repeats(name, stamps_ns.size - rows.size))
    ordered, spread = _spread(found) if strict else (found, 0)
    if spread:
        message = f"{name}: {spread} rows share their stamp with others: spread over the interval of their batch"
        warnings.append(Warn("batched-stamps", message, STAMP_EACH))
    return Ordered(rows, ordered, tuple(warnings))


def seconds(stamps_ns: Ints, t0_ns: int) -> Array:
    """Return seconds since ``t0_ns``; subtracted as integers first."""
    return np.asarray((stamps_ns - t0_ns) * 1e-9, dtype=np.float64)


def gaps(stamps_ns: Ints, max_gap_s: float, periods: float = 5.0) -> Ints:
    """Return start and end (g, 2), ns, of holes longer than ``max_gap_s`` and than ``periods`` median periods."""
    steps = np.diff(stamps_ns)
    if not steps.size:
        return np.empty((0, 2), dtype=np.int64)
    limit = max(max_gap_s * 1e9, periods * float(np.median(steps)))
    holes = np.flatnonzero(steps > limit)
    return np.stack([stamps_ns[holes], stamps_ns[holes + 1]], axis=1)


def _near(stamps_ns: Ints) -> Bools:
    """Tell the stamps that are near those around them; all where many are not, as two clocks in turn would be."""
    if stamps_ns.size < AROUND:
        return np.ones(stamps_ns.size, dtype=np.bool_)
    around = sliding_window_view(np.pad(stamps_ns, AROUND // 2, mode="reflect"), AROUND)
    near: Bools = np.abs(stamps_ns - np.partition(around, AROUND // 2, axis=1)[:, AROUND // 2]) <= STEP_BACK_NS
    return near if np.count_nonzero(~near) < FEW_DAMAGED * near.size else np.ones_like(near)


def _without(name: str, stamps_ns: Ints, values: Array, t0_ns: int, near: Bools) -> Ordered:
    """Put the rows in order that are near in time to those around them, and say so."""
    found, rows = in_order(name, stamps_ns[near], values[near], t0_ns), np.flatnonzero(near)
    count = near.size - rows.size
    message = f"{name}: {count} of {near.size} rows dropped: their stamps are far from those around them"
    told = Warn("rows-without-time", message, "zero, or damaged: does the driver stamp every sample?")
    return Ordered(rows[found.rows], found.stamps_ns, (told, *found.warnings))


def _refuse_step(name: str, stamps_ns: Ints, latest: Ints, back: Ints, t0_ns: int) -> None:
    if np.count_nonzero(np.diff(stamps_ns) < 0) > REVERSED * back.size:
        raise AttestError(f"{name}: the rows are in reverse order, the latest first", "sort them by their stamps")
    row = int(np.argmax(back > STEP_BACK_NS))
    when, size = (int(latest[row]) - t0_ns) // 1_000_000 * 1e-3, int(back[row]) * 1e-9
    hours = whole_hours(-size, float(np.median(np.diff(stamps_ns))) * 1e-9)
    exact = f", by {hours * HOUR_S:.0f} s but for a sample: summer time or another zone" if hours else ""
    message = f"{name}: the clock steps back by {size:.3f} s at {when:.3f} s (row {row + 1}){exact}"
    raise AttestError(message, f"cut the log there, or take the part before it with --end {when:.3f}")


def _refuse_coarse(name: str, stamps_ns: Ints, shared: float = SHARED) -> None:
    """Refuse stamps without resolution: float32 seconds since 1970 step by 128 s."""
    steps = np.diff(stamps_ns)
    distinct = 1 + int(np.count_nonzero(steps))
    if stamps_ns.size > shared * distinct and (distinct == 1 or np.median(steps[steps > 0]) > LONGEST_BATCH_NS):
        message = f"{name}: {distinct} distinct stamps in {stamps_ns.size} rows: the stamps have no resolution"
        raise AttestError(message, "write stamps as int64 ns, or seconds with all their digits (float32 has too few)")


def _not_repeated(stamps_ns: Ints, values: Array, rows: Ints) -> Bools:
    """Tell which of the ``rows``, in stamp order, differ from all others of the same stamp."""
    keep, stamps = np.ones(rows.size, dtype=bool), stamps_ns[rows]
    same = np.append(np.diff(stamps) == 0, np.False_)
    shared = np.flatnonzero(same | np.append(np.False_, same[:-1]))
    if shared.size:
        table = np.ascontiguousarray(values[rows[shared]] + 0.0)  # of two zeros the sign does not count
        bits = np.column_stack([stamps[shared], table.view(np.int64)])
        _, first = np.unique(bits.view(np.dtype((np.void, bits.shape[1] * bits.itemsize))), return_index=True)
        keep[np.delete(shared, first)] = False
    return keep


def _no_twins(stamps_ns: Ints, values: Array, rows: Ints) -> Bools:
    """Tell which of the ``rows``, in stamp order, do not repeat the values of the row just before: published twice."""
    keep = np.ones(rows.size, dtype=bool)
    equal = np.arange(1, rows.size)
    for column in values.T:  # few rows are left after the first
        equal = equal[column[rows[equal]] == column[rows[equal - 1]]]
    if not equal.size:
        return keep
    stamps = stamps_ns[rows]
    steps = np.diff(stamps)
    usual = float(np.quantile(steps[steps > 0], 0.75)) if np.any(steps > 0) else 0.0  # of three rows two may be twins
    near = equal[(steps[equal - 1] > 0) & (steps[equal - 1] < MANY_TWINS * usual)]
    if near.size < MANY_TWINS * rows.size:
        near = near[steps[near - 1] < TWIN * usual]
    keep[near] = False
    return keep


def _told_repeats(name: str, count: int) -> Warn:
    hint = "is the sensor published or logged twice?"
    return Warn("duplicate-rows", f"{name}: {count} rows repeat stamp and values of another: dropped", hint)


def _of_bursts(stamps_ns: Ints, values: Array) -> Ints | None:
    """Return the stamps with that of the last row of a burst for all of it; None where rows do not come in bursts.

    Then most steps are far shorter than their mean, and pauses hold most of the time. A sensor that pauses itself
    changes more over a pause than from row to row; one whose rows are held back on the way does not.
    """
    n = stamps_ns.size
    if n < FEW_BURSTS:
        return None
    step = np.diff(stamps_ns)
    short = np.partition(step, int(IN_BURST * n))[int(IN_BURST * n)]
    if short > BURST * (stamps_ns[-1] - stamps_ns[0]) / (n - 1):
        return None  # of nearly every log
    near = step < LONGEST_BATCH_NS
    mean = float(step[near].mean()) if near.any() else 0.0
    pause = near & (step > mean)
    if short > BURST * mean or step[pause].sum() < PAUSED * step[near].sum():
        return None
    before = np.flatnonzero(pause[1:-1] & ~pause[2:] & ~pause[:-2])
    times, weight, _ = changes(np.diff(values, axis=0), before)
    if before.size < FEW_BURSTS or float(weight @ times) > OF_ITSELF * float(weight.sum()):
        return None
    last = np.append(np.flatnonzero(step > mean), n - 1)
    return np.asarray(stamps_ns[last[np.searchsorted(last, np.arange(n))]])


def _spread(stamps_ns: Ints) -> tuple[Ints, int]:
    """Spread rows of one stamp over the interval before it, or after it where that suits better. Returns how many."""
    starts = np.flatnonzero(np.diff(stamps_ns, prepend=stamps_ns[:1] - 1))
    counts = np.diff(np.append(starts, stamps_ns.size))
    spread = int(np.sum(counts[counts > 1]))
    if not spread:
        return stamps_ns, 0
    distinct = stamps_ns[starts]
    period = max(int(np.median(np.diff(distinct) // counts[1:])), 1)
    before = np.diff(distinct, prepend=distinct[0] - period * counts[0]) // counts
    after = np.diff(distinct, append=distinct[-1] + period * counts[-1]) // counts
    forward = (np.abs(after - period) < np.abs(before - period)) & (np.append(counts[1:], 1) == 1)
    step = np.repeat(np.where(counts > 1, np.minimum(np.where(forward, after, before), 2 * period), 0), counts)
    place = np.arange(stamps_ns.size) - np.repeat(starts, counts)
    last = np.repeat(counts - 1, counts)
    moved = stamps_ns + step * np.where(np.repeat(forward, counts), place, place - last)
    index = np.arange(moved.size)
    return np.maximum.accumulate(moved - index) + index, spread  # at least 1 ns apart, whatever the batches
