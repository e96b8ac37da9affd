"""Stamps put in order: swapped rows sorted, repeats dropped, batches spread, holes found. All on int64 ns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import AttestError
from ..records import Array, Bools, Ints, Warn

STEP_BACK_NS = 500_000_000
"""A larger step back is another clock, not rows in a wrong order."""

LONGEST_BATCH_NS = 500_000_000
"""Stamps further apart that are shared by several rows have no resolution."""


@dataclass(frozen=True, slots=True)
class Ordered:
    """Rows in order of time: ``rows`` (m,) of the input, ``stamps_ns`` (m,) strictly increasing."""

    rows: Ints
    stamps_ns: Ints
    warnings: tuple[Warn, ...]


def in_order(name: str, stamps_ns: Ints, values: Array, t0_ns: int, *, refuse_steps: bool = True) -> Ordered:
    """Sort rows by time and make the stamps strictly increasing.

    Parameters
    ----------
    name : str
        File and channel, for messages.
    stamps_ns : (n,) int64, as found; ``values`` (n, k)
    refuse_steps : bool
        Refuse a clock that steps back by more than 0.5 s; else sort it together too.

    Raises
    ------
    AttestError
        If the clock steps back, or the stamps have no resolution.
    """
    warnings: list[Warn] = []
    latest = np.maximum.accumulate(stamps_ns)
    back = latest - stamps_ns  # against the maximum so far: 10, 5, 6, 11 has two rows out of order
    worst = int(np.argmax(back)) if back.size else 0
    if refuse_steps and back.size and back[worst] > STEP_BACK_NS:
        first = int(np.argmax(back > STEP_BACK_NS))
        when, size = (int(latest[first]) - t0_ns) * 1e-9, int(back[first]) * 1e-9
        message = f"{name}: the clock steps back by {size:.3f} s at {when:.3f} s (row {first + 1})"
        raise AttestError(message, f"cut the log there, or take the part before it with --end {when:.3f}")
    late = int(np.count_nonzero(back))
    rows = np.argsort(stamps_ns, kind="stable").astype(np.int64) if late else np.arange(stamps_ns.size, dtype=np.int64)
    if late:
        message = f"{name}: {late} rows out of order, by {back[worst] * 1e-9:.3f} s at most: sorted"
        warnings.append(Warn("rows-out-of-order", message))
    rows = rows[_not_repeated(stamps_ns[rows], values[rows])]
    if rows.size < stamps_ns.size:
        message = f"{name}: {stamps_ns.size - rows.size} rows repeat stamp and values of another: dropped"
        warnings.append(Warn("duplicate-rows", message))
    ordered, spread = _spread(name, stamps_ns[rows])
    if spread:
        message = f"{name}: {spread} rows share their stamp with others: spread over the interval of their batch"
        warnings.append(Warn("batched-stamps", message, "let the driver stamp every sample"))
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


def _not_repeated(stamps_ns: Ints, values: Array) -> Bools:
    """Tell the rows that differ from all others of the same stamp (in stamp order)."""
    keep = np.ones(stamps_ns.size, dtype=bool)
    shared = np.flatnonzero(np.diff(stamps_ns) == 0)
    for row in shared + 1:
        other = row - 1
        while other >= 0 and stamps_ns[other] == stamps_ns[row]:
            if keep[other] and np.array_equal(values[other], values[row], equal_nan=True):
                keep[row] = False
                break
            other -= 1
    return keep


def _spread(name: str, stamps_ns: Ints) -> tuple[Ints, int]:
    """Spread rows of one stamp over the interval before it, or after it where that has more room. Returns how many."""
    starts = np.flatnonzero(np.diff(stamps_ns, prepend=stamps_ns[:1] - 1))
    counts = np.diff(np.append(starts, stamps_ns.size))
    spread = int(np.sum(counts[counts > 1]))
    if not spread:
        return stamps_ns, 0
    distinct = stamps_ns[starts]
    interval = float(np.median(np.diff(distinct))) if distinct.size > 1 else np.inf
    if interval > LONGEST_BATCH_NS:
        message = f"{name}: {distinct.size} distinct stamps in {stamps_ns.size} rows: the stamps have no resolution"
        raise AttestError(message, "write stamps as int64 ns, or seconds with all their digits (float32 has too few)")
    period = int((distinct[-1] - distinct[0]) // (stamps_ns.size - 1)) or 1
    before = np.diff(distinct, prepend=distinct[0] - period * counts[0]) // counts
    after = np.diff(distinct, append=distinct[-1] + period * counts[-1]) // counts
    forward = np.abs(after - period) < np.abs(before - period)
    step = np.where(counts > 1, np.minimum(np.where(forward, after, before), 2 * period), 0)
    place = np.arange(stamps_ns.size) - np.repeat(starts, counts)
    last = np.repeat(counts - 1, counts)
    return stamps_ns + np.repeat(step, counts) * np.where(np.repeat(forward, counts), place, place - last), spread
