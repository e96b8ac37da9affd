"""Samples that are held: a sensor slower than its log, whose last value is repeated until there is a new one."""

from __future__ import annotations

import numpy as np

from ..records import Array, Bools, Ints, Warn

LONGEST_S = 0.4  # what stays longer is stuck
MOSTLY, SELDOM = 0.5, 0.1  # share of the runs that are of the usual length; of those that are shorter
FEW = 0.25  # of the rows
ALIKE = 0.9  # of the new values come in rows in which the other sensor has one, too


def fresh(t: Array, values: Array) -> Bools | None:
    """Tell the rows (n,) of a sensor (n, 3) in which its values are new; None where it does not hold them.

    A sensor that holds does so alike at rest and in motion: runs of equal rows are of one length, two at least, or
    longer where two values in a row happen to be equal, hardly ever shorter. Those of a coarse sensor are of any.
    """
    new = np.ones(len(values), dtype=np.bool_)
    if len(values) < 3:
        return None
    new[1:] = values[1:, 0] != values[:-1, 0]
    if np.mean(new) > 1.0 - MOSTLY / 2.0:
        return None  # of nearly every log, at little cost
    for column in values.T[1:]:
        new[1:] |= column[1:] != column[:-1]
    rows = np.flatnonzero(new)
    length = np.diff(rows)[np.diff(t[rows]) < LONGEST_S]
    if length.size < len(values) * np.median(np.diff(t)) or not length.size:
        return None  # less than one new value a second
    usual = float(np.median(length))
    near = np.abs(length - usual) <= (1.0 if usual > 2.0 else 0.0)
    more = length == usual + 1.0  # 40 Hz in 100
    shorter = (length < usual - 1.0) | (length == 1)
    held = usual >= 2.0 and np.mean(near | more) > MOSTLY and np.mean(shorter) < SELDOM
    return new if held else None


def blank(t: Array, table: Array) -> Bools:
    """Tell the rows (n,) of gyro and accelerometer (n, 6) in which all is exactly zero, for less than 0.4 s: no sample.

    Longer ones are stuck, or of a simulation that rests without gravity.
    """
    zero = table[:, 0] == 0.0
    zero[zero] = np.all(table[zero] == 0.0, axis=1)
    edges = np.flatnonzero(np.diff(zero, prepend=False, append=False))
    first, last = edges[::2], edges[1::2] - 1
    if not edges.size or np.count_nonzero(zero) > FEW * len(t):
        return np.zeros(len(t), dtype=np.bool_)
    run = np.searchsorted(first, np.arange(len(t)), side="right") - 1
    return np.asarray(zero & (t[last] - t[first] < LONGEST_S)[run])


def released(name: str, t: Array, table: Array, warnings: list[Warn]) -> tuple[Bools, Array]:
    """Return which rows (n,) of gyro and accelerometer (n, 6) to keep, and the table with values in place of those that
    are held; say so.

    A held value is that of the first row of its run. Where it is the gyro that is held, only its new values count, each
    with the mean of the accelerometer about it: noise that is shared by rows would look like less. A slow accelerometer
    has a line between its values, unless both sensors have their new values in the same rows.
    """
    found = {what: fresh(t, table[:, k]) for what, k in (("gyro", np.s_[:3]), ("accelerometer", np.s_[3:]))}
    held = {what: rows for what, rows in found.items() if rows is not None}
    keep: Bools = np.ones(len(t), dtype=np.bool_)
    if not held:
        return keep, table
    both = np.logical_and.reduce(list(held.values()))
    together = len(held) > 1 and all(np.count_nonzero(both) > ALIKE * np.count_nonzero(r) for r in held.values())
    if together:
        keep = np.logical_or.reduce(list(held.values()))
    else:
        table = table.copy()
        if "accelerometer" in held:
            _drawn(t, table[:, 3:], np.flatnonzero(held["accelerometer"]))
        if "gyro" in held:
            rows = np.flatnonzero(held["gyro"])
            since = np.arange(len(t)) - rows[np.searchsorted(rows, np.arange(len(t)), side="right") - 1]
            keep = held["gyro"] | (_stuck(t, rows) & (since % round(float(np.median(np.diff(rows)))) == 0))
            table[keep, 3:] = _means(t, table[:, 3:], np.flatnonzero(keep))
    warnings.append(_told(name, t, held, rows="gyro" in held or together))
    return keep, table


def _drawn(t: Array, values: Array, rows: Ints) -> None:
    """Draw lines, in place, between new values that come soon after each other: a stuck sensor stays stuck."""
    soon = ~_stuck(t, rows)
    for column in values.T:
        column[soon] = np.interp(t[soon], t[rows], column[rows])


def _stuck(t: Array, rows: Ints) -> Bools:
    """Tell the rows (n,) of a value that is held for long, between the ``rows`` of new ones."""
    long = np.diff(t[rows], append=t[-1]) >= LONGEST_S
    return np.asarray(long[np.searchsorted(rows, np.arange(len(t)), side="right") - 1])


def _means(t: Array, values: Array, rows: Ints) -> Array:
    r"""Return the means (k, 3) of a signal (n, 3), linear between its samples, about some rows: half-way to the next on
    either side, which are as near as those of most.
    """
    step = np.diff(t)[:, None]
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (values[1:] + values[:-1]) * step, axis=0)])
    at = t[rows]
    half = 0.5 * float(np.median(np.diff(at)))
    middle = 0.5 * (at[1:] + at[:-1])
    start = np.maximum(np.append(at[0], middle), at - half)
    end = np.minimum(np.append(middle, at[-1]), at + half)
    gained = np.stack([np.interp(end, t, x) - np.interp(start, t, x) for x in total.T], axis=1)
    return np.asarray(gained / (end - start)[:, None])


def _told(name: str, t: Array, held: dict[str, Bools], *, rows: bool) -> Warn:
    step = float(np.median(np.diff(t)))
    rates = {what: 1.0 / float(np.median(np.diff(t[new]))) for what, new in held.items()}
    each = " and ".join(f"{what} ({rate:.3g} Hz)" for what, rate in rates.items())
    used = "rows of new values are used" if rows else "a line between new values is used"
    message = f"{name}: {each} slower than the log ({1.0 / step:.3g} Hz), which repeats old values: {used}"
    return Warn("imu-held", message, "log the sensor's own rate, with its own stamps")
