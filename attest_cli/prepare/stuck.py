"""What the noise of an axis tells: where it stops the axis is stuck, it has not come to rest; where it is a multiple of
that of both others the axis is in another unit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..records import Array, Bools, Ints, Warn
from .clipping import BAND, LONGEST_S

STUCK_S, LEAST_ROWS = 0.4, 8  # of equal values
USUAL = 0.25  # of such a run: values that often repeat for longer are too coarse to tell
LIVELY = 0.25  # share of the rows that must change
BESIDE, ABRUPT = 3, 0.05  # steps on either side, share of a usual one: noise-free simulations come to rest smoothly
SOME = 2000  # rows that mostly show that a column is sound
NEAR, FAINT = 20, 1e-6  # steps on either side that show noise; share of a usual one: rounding
COARSE_RAD_S = 2e-3  # 16 bits over 2000 deg/s are half of it
WINDOW, WINDOWS = 100, 1000  # rows; at most, all along the log
CALM, SHAKES, SAME, FEWEST = 0.1, 3.0, 1.4, 10  # share of the windows; times the calm ones; as loud; windows that tell
MOSTLY = 0.8  # of the windows before
UNIT, NEARLY, ALIKE, COARSELY = 57.29578, 2.5, 4.0, 0.2  # deg/s; factors of noise that axes have; share without noise
COARSE, QUANTA = 1e-3, 3.5  # of a usual step; a coarse sensor at rest holds its value until it changes by one


def stuck(t: Array, *tables: Array) -> list[Bools]:
    """Tell, for each column of tables (n, k), the rows (n,) that repeat the row before in a run of 0.4 s or longer.

    Not in a column that is coarse or constant, nor at the end of its range, where it is clipped.
    """
    period = float(np.median(np.diff(t)))
    return [_stuck(t, period, column) for values in tables for column in values.T]


def dead(*tables: Array) -> Bools:
    """Tell which columns (k,) of tables never change, beside others that do."""
    constant = np.concatenate([unchanging(values) for values in tables])
    return np.asarray(constant & ~constant.all())


def unchanging(values: Array) -> Bools:
    """Tell which columns (k,) of values (n, k) hold one value."""
    constant = np.ptp(values[:: max(len(values) // SOME, 1)], axis=0) == 0.0
    if constant.any():
        constant = np.ptp(values, axis=0) == 0.0
    return np.asarray(constant)


def told(name: str, columns: Sequence[str], found: Sequence[Bools], t: Array) -> list[Warn]:
    """Say which columns are stuck, for how long, and since when."""
    rows = np.logical_or.reduce(found)
    if not rows.any():
        return []
    period, which = float(np.median(np.diff(t))), [c for c, bad in zip(columns, found, strict=True) if bad.any()]
    first = float(t[int(np.argmax(rows))])
    message = (
        f"{name}: {', '.join(which)} stuck for {np.count_nonzero(rows) * period:.2f} s in all, from {first:.2f} s on"
    )
    hint = "no value changed there: those rows count as a gap; is it the sensor, its bus, or a driver that repeats?"
    return [Warn("imu-stuck", message, hint)]


def told_coarse(name: str, gyro: Array) -> list[Warn]:
    """Say where the gyro (n, 3), rad/s, is rounded so coarsely that its bias is not to be seen."""
    few = np.abs(np.diff(gyro[:SOME], axis=0))
    if np.any((few > 0.0) & (few < COARSE_RAD_S)):
        return []
    least = min(float(steps[steps > 0.0].min(initial=np.inf)) for steps in (np.abs(np.diff(x)) for x in gyro.T))
    if not COARSE_RAD_S <= least < np.inf:
        return []
    steps = np.abs(np.diff(gyro, axis=0))
    if least < COARSE * np.median(steps[steps > 0.0]):
        return []
    hint = "its bias is not seen below that: record it with all its digits"
    return [Warn("gyro-coarse", f"{name}: the gyro is rounded to {least:.2g} rad/s", hint)]


def told_dead(name: str, columns: Sequence[str], constant: Bools) -> list[Warn]:
    """Say which columns are constant."""
    which = [column for column, is_dead in zip(columns, constant, strict=True) if is_dead]
    if not which:
        return []
    hint = "of an axis that does not measure no turn is known: where it turns, sigma does not hold"
    return [Warn("imu-stuck", f"{name}: {', '.join(which)} never changes: a dead axis", hint)]


def told_numb(name: str, columns: Sequence[str], t: Array, gyro: Array) -> list[Warn]:
    """Say which axes of the gyro (n, 3) hold from some time on nothing but noise.

    What shakes a vehicle shakes all axes: where the others do, by the scatter of their steps in windows, this one did,
    and then has one level to the end, in shaking and at rest.
    """
    count = min((len(gyro) - 1) // WINDOW, WINDOWS)
    if count < 2 * FEWEST:
        return []
    first = np.linspace(0, len(gyro) - 1 - WINDOW, count).astype(np.int64)
    size = np.diff(gyro[first[:, None] + np.arange(WINDOW + 1)], axis=1).std(axis=1)
    shaking = size > SHAKES * np.quantile(size, CALM, axis=0)
    found = []
    for axis, column in enumerate(columns):
        shaken = np.flatnonzero(np.delete(shaking, axis, axis=1).any(axis=1))
        level = float(np.median(size[shaken[-FEWEST:], axis])) if len(shaken) >= 2 * FEWEST else 0.0
        other = np.flatnonzero((size[:, axis] > SAME * level) | (size[:, axis] < level / SAME))
        since = int(other[-1]) + 1 if level > 0.0 and len(other) else 0
        before, after = shaken[shaken < since], shaken[shaken >= since]
        if min(len(before), len(after)) >= FEWEST and np.mean(size[before, axis] > SHAKES * level) > MOSTLY:
            found.append(f"{column} from {t[first[since]]:.0f} s on")
    if not found:
        return []
    message = f"{name}: nothing but noise in {', '.join(found)}, while the other axes shake: a dead axis"
    return [Warn("imu-stuck", message, "no turn about it is known from then on: sigma does not hold", fatal=True)]


def told_unlike(name: str, columns: Sequence[str], gyro: Array) -> list[Warn]:
    """Say which axis of the gyro (n, 3) is in another unit than both others, which are like each other: its noise is a
    multiple of theirs, at the quietest and in all windows. One that is less noisy may be a better sensor.
    """
    count = min((len(gyro) - 1) // WINDOW, WINDOWS)
    if count < FEWEST:
        return []
    first = np.linspace(0, len(gyro) - 1 - WINDOW, count).astype(np.int64)
    steps = np.diff(gyro[first[:, None] + np.arange(WINDOW + 1)], axis=1)
    if np.mean(steps == 0.0) > COARSELY:
        return []  # its noise is not to be seen
    size = steps.std(axis=1)
    quiet = size <= np.quantile(size, CALM, axis=0)
    back = np.mean(steps[:, 1:] * steps[:, :-1], axis=1)
    if any(float(np.mean(back[quiet[:, i], i])) >= 0.0 for i in range(3)):
        return []  # motion without noise: steps of noise turn back
    calm = np.array([float(np.median(size[quiet[:, i], i])) for i in range(3)])
    for axis, column in enumerate(columns):
        others = np.delete(calm, axis)
        times = float(calm[axis] / np.sqrt(np.prod(others))) if others.all() else 0.0
        ratio = size[:, axis] / np.maximum(np.sqrt(np.prod(np.delete(size, axis, axis=1), axis=1)), 1e-12)
        many, few = (UNIT / NEARLY < x < UNIT * NEARLY for x in (times, 1.0 / max(times, 1e-9)))
        always = float(np.median(ratio)) > ALIKE if many else float(np.median(ratio)) < 1.0 / ALIKE
        if others.max() < ALIKE * others.min() and (many or few) and always:
            fact = f"{name}: {column} is {times:.2g} times as noisy as the other axes of the gyro"
            hint = "name the columns with their units (--columns, gyro_x_dps), or mend the driver"
            return [Warn("unit-contradicted", f"{fact}: is it in another unit?", hint, fatal=many)]
    return []


def _stuck(t: Array, period: float, x: Array) -> Bools:
    """Tell the stuck rows of one column."""
    out = np.zeros(len(x), dtype=np.bool_)
    least = max(LEAST_ROWS, round(STUCK_S / period))
    some = x[:: least // 2]  # of any long run two in a row
    if not np.any(some[1:] == some[:-1]):
        return out
    change = np.diff(x)
    first, last = _runs(change == 0.0)
    length = last - first
    long = length >= least
    usual = int(length[~long].max(initial=0))
    if not long.any() or usual > USUAL * least or np.count_nonzero(change) < LIVELY * len(change):
        return out
    steps = np.abs(change[change != 0.0])
    level, size, quantum = (1.0 - BAND) * np.abs(x).max(), float(np.median(steps)), float(steps.min())
    coarse, faint = quantum > COARSE * size, max(QUANTA * quantum, FAINT * size)
    for a, b in zip(first[long].tolist(), last[long].tolist(), strict=True):
        clipped = abs(x[a]) >= level > 0.0 and t[b] - t[a] < LONGEST_S
        before, after = change[max(a - NEAR, 0) : a], change[b : b + NEAR]
        if coarse:
            abrupt = min(np.abs(side).max(initial=0.0) for side in (before[-1:], after[:1])) > QUANTA * quantum
        else:
            abrupt = np.abs([*before[-BESIDE:], *after[:BESIDE]]).max(initial=0.0) > ABRUPT * size
            abrupt = abrupt or _noisy(before, faint) or _noisy(after, faint)
        if abrupt and not clipped:
            out[a + 1 : b + 1] = True
    return out


def _noisy(steps: Array, faint: float) -> bool:
    """Tell whether steps turn back and forth, as those of noise do and of what comes to rest do not."""
    usual = float(np.median(np.abs(steps))) if steps.size == NEAR else 0.0
    return usual > faint and float(np.median(np.abs(np.diff(steps)))) > usual


def _runs(flags: Bools) -> tuple[Ints, Ints]:
    """Return the row before the first flag of every run, and the row of its last."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return edges[::2], edges[1::2]
