"""Lost samples: how many, cells that hold a number for none, and what bridging a short hole costs, told by bridging as
many samples where none are lost.
"""

from __future__ import annotations

import math

import numpy as np

from ..records import Array, Bools, Ints

MISSING = 1.5  # periods: a longer step has lost a sample
AROUND_S = 3.0  # the drive is alike so near to a hole
EVEN = 0.25  # of its length: a stretch without a hole keeps its time
FEW = 10  # stretches that tell nothing: all of the log is asked

WHOLE = 0.25  # of a period: steps over lost samples are so near to a multiple of it; those of a poor clock are not
SINGLE = (0.6, 1.5)  # periods: the step between two samples of which none between is lost
TELLING, SHORT, MOST = 0.4, 0.05, 2.2  # share of single steps, of shorter ones at most; periods a step in the mean
OTHER_RATE, RATES = 20, 3  # steps in a row of which none is single; rates beside the usual one
PAUSES, EQUAL = 0.95, 0.05  # share of steps up to a pause between bursts; by which pauses differ
SHORTEST = 0.2  # share of the steps: one of those is single
APART, UNEVEN = 1.7, 0.25  # periods by which runs differ; of their spread if steps fall as they like: ticks fall evenly
LONGEST = 3.0  # periods: longer steps are too few for a spread
SAME, EXACT = 0.98, 1e-3  # share of lost samples that come in turn; of a rate
USUAL_HZ = (20, 25, 40, 50, 60, 80, 100, 125, 200, 250, 400, 500, 1000)  # to which IMUs are set
DOUBLE, ENOUGH, SMOOTH = 2.6, 50, 0.7  # periods at most; steps that tell; times that beside them, if values are smooth
HALF, SURE, SAMPLED = 0.5, 4.0, 200_000  # of the double steps; sigma; rows that are asked
USUAL, TIMES = 0.95, (-1.0, 4.0)  # share of the changes that are no jumps; times
RUN, FULLEST = 150, 0.05  # samples; share of the runs of so many that are taken to be whole
LARGEST = 1e12  # a raw value beyond this is a damaged number
SENTINELS = (99.0, 999.0, 9999.0, 99999.0, 999999.0, 32767.0, 32768.0, 65535.0, 2147483647.0, 2147483648.0)
SENTINEL_SHARE, SENTINEL_FACTOR = 0.01, 20.0  # of the rows; times the 99th percentile of the others


def missing(stamps_ns: Ints, longest_s: float, dropped: int = 0, values: Array | None = None) -> float:
    """Return the share of samples that are lost in short holes, but for those that were ``dropped`` on the way.

    A hole is a step near to two or more periods. A clock that is late once, and early after it, has lost nothing: the
    time that goes beyond one period a step, over all short steps, must be as long. Stamps that are rounded to ticks of
    half a period or more double some steps, too: there ``values`` (n, k), where they are smooth, tell the time that
    has passed. Else the share is rough, and 125 Hz without each fifth sample is 100 Hz on ticks of 8 ms.
    """
    steps_ns = np.diff(stamps_ns)
    k = int(SHORTEST * steps_ns.size)
    if not steps_ns.size or steps_ns.max() <= MISSING * np.partition(steps_ns, k)[k]:
        return 0.0  # of nearly every log, at no cost
    step = steps_ns * 1e-9
    short = step[step <= max(longest_s, MISSING * float(np.median(step)))]
    if not np.any(short > MISSING * np.quantile(short, SHORTEST)):
        return 0.0
    low, high = (0.0, 1.0) if values is None else _passed(step[:SAMPLED], values[: SAMPLED + 1])
    if high < HALF and _on_ticks(short):
        lost = _beside_ticks(short, max(0.5 * (low + high), 0.0))
    else:
        lost = _lost(short, RATES, in_turn=low > HALF)
    lost = max(lost - dropped, 0.0)
    return lost / (stamps_ns.size + lost)


def _passed(step: Array, values: Array) -> tuple[float, float]:
    r"""Return between what shares of the double steps twice the time has passed, by what changed in them.

    The change over a step is :math:`\beta` times the mean of those beside it: 1 after one period, 2 after two. Noise of
    the ``values`` (n, k) makes it less; then they do not tell.
    """
    usual, change = float(np.quantile(step, SHORTEST)), np.diff(values, axis=0)
    single, double = (step > 0.0) & (step < MISSING * usual), (step >= MISSING * usual) & (step < DOUBLE * usual)
    between = single[:-2] & single[2:]
    (one, spread), (two, wide) = (_times(change, np.flatnonzero(between & rows[1:-1])) for rows in (single, double))
    if one - SURE * spread > SMOOTH:
        return two - SURE * wide - one, two + SURE * wide - one
    return two - SURE * wide - 1.0, 1.0


def _times(change: Array, rows: Ints) -> tuple[float, float]:
    """Return how many times the mean change (n, k) beside it a step has, after each of these rows, and its sigma."""
    times, weight, _ = changes(change, rows)
    total = float(weight.sum())
    if not total:
        return 0.0, np.inf
    mean = float(times @ weight) / total
    return mean, float(np.linalg.norm(weight * (times - mean))) / total


def changes(change: Array, rows: Ints) -> tuple[Array, Array, Ints]:
    """Return how many times the mean ``change`` (n, k) beside it the step after each of these rows has, its weight, and
    the rows that count: none where they are few, no jumps.
    """
    beside = 0.5 * (change[rows] + change[rows + 2])
    weight = np.sum(beside**2, axis=1)
    usual = weight <= np.quantile(weight, USUAL) if rows.size >= ENOUGH else np.zeros(rows.size, dtype=np.bool_)
    rows, beside, weight = rows[usual], beside[usual], weight[usual]
    return np.clip(np.sum(change[rows + 1] * beside, axis=1) / np.maximum(weight, 1e-300), *TIMES), weight, rows


def _on_ticks(steps: Array) -> bool:
    """Tell whether steps are of one tick or two, none between, and few of more."""
    ticks = steps / np.quantile(steps, SHORTEST)
    between = np.count_nonzero((ticks > 1.0 + WHOLE) & (ticks < 2.0 - WHOLE))
    return bool(between < SHORT * steps.size and ticks.mean() < MOST)


def _beside_ticks(steps: Array, share: float) -> float:
    """Return how many samples are lost in a ``share`` of the double steps, and in longer ones."""
    usual = float(np.quantile(steps, SHORTEST))
    double, longer = (steps >= MISSING * usual) & (steps < DOUBLE * usual), steps >= DOUBLE * usual
    hidden = share * np.count_nonzero(double)
    period = float(steps[~longer].sum()) / (np.count_nonzero(~longer) + hidden)
    return hidden + float(np.maximum(np.rint(steps[longer] / period) - 1.0, 0.0).sum())


def _lost(steps: Array, rates: int, *, in_turn: bool) -> float:
    """Return how many samples are lost within ``steps``; stretches of other ``rates`` are asked on their own.

    ``in_turn``: where each so many-th step is long, a sample is lost in it.
    """
    period = _period(steps, in_turn=in_turn)
    if period <= 0.0 or not np.any(steps > MISSING * period):
        return 0.0
    single = (steps > SINGLE[0] * period) & (steps < SINGLE[1] * period)
    other = _in_runs(~single, OTHER_RATE)
    if other.any() and rates:
        return sum(_lost(steps[rows], rates - 1, in_turn=in_turn) for rows in (~other, other) if rows.any())
    count = np.rint(steps / period) - 1.0
    uneven = np.abs(steps[steps <= MISSING * period] - period)
    near = max(WHOLE * period, 2.0 * float(np.quantile(uneven, 0.9)) if uneven.size else 0.0)
    holes = (steps > MISSING * period) & (np.abs(steps - (count + 1.0) * period) < near)
    return max(min(float(count[holes].sum()), float(steps.sum()) / period - steps.size), 0.0)


def _in_runs(rows: Bools, least: int) -> Bools:
    """Tell the rows that hold in a run of at least so many."""
    starts = np.append(0, np.flatnonzero(rows[1:] != rows[:-1]) + 1)
    lengths = np.diff(np.append(starts, rows.size))
    return rows & np.repeat(lengths >= least, lengths)


def _period(steps: Array, *, in_turn: bool = False) -> float:
    """Return the time between samples of which none is lost.

    Single steps tell it where most are alike and the others are holes. Steps of a clock's ticks and of bursts are no
    periods: there the fullest runs of many samples tell it.
    """
    if not steps.size:
        return 0.0
    period = float(np.quantile(steps, SHORTEST))
    for low, high in ((SINGLE[0], 1.6), SINGLE, SINGLE, (0.5, 1.5)):  # two and three ticks are single, too
        single = (steps > low * period) & (steps < high * period)
        period = float(steps[single].mean()) if single.any() else 0.0
    mine = ~_in_runs(~single, OTHER_RATE)  # the others have another rate
    run = min(RUN, int(np.count_nonzero(mine)) // 4)
    if not run or not period:
        return float(np.median(steps))
    steps, single = steps[mine], single[mine]
    t = np.concatenate([[0.0], np.cumsum(steps)])
    full, middle = (float(x) for x in np.quantile(t[run:] - t[:-run], (FULLEST, 0.5)))
    spread = math.sqrt(run) * float(np.minimum(steps, LONGEST * period).std())  # of runs whose steps fall as they like
    uneven = middle - full > max(UNEVEN * spread, APART * period) or _in_turn(steps, period, sure=in_turn)
    few = np.count_nonzero(steps <= SINGLE[0] * period) < SHORT * steps.size
    bursts = steps.mean() >= MOST * period
    if uneven and few and single.mean() > TELLING and not bursts:
        return period
    if bursts and middle - full <= (1.0 + EQUAL) * float(np.quantile(steps, PAUSES)):
        return float(steps.mean())  # runs differ by one pause
    return max(full / run, period if few else float(np.median(steps)))


def _in_turn(steps: Array, period: float, *, sure: bool) -> bool:
    """Tell whether each so many-th sample is lost.

    Steps of a clock's ticks would do so too, were the sensor's own clock exact. It is in logs that are made; their rate
    tells.
    """
    apart, rate = np.diff(np.flatnonzero(steps > MISSING * period)), 1.0 / float(steps.mean())
    if not apart.size or np.count_nonzero(apart == np.median(apart)) < SAME * apart.size:
        return False
    return sure or all(abs(rate / hz - 1.0) > EXACT for hz in USUAL_HZ)


def without_sentinels(values: Array) -> tuple[Array, str]:
    """Return values (n, k) with NaN for a number that stands for none, such as -9999, and that number in words.

    Such a number is the largest or the least of its column, in over 1 % of the rows, and far beyond all others.
    """
    if len(values) and -SENTINELS[0] < values.min() and values.max() < SENTINELS[0]:
        return values, ""
    said: list[str] = []
    extremes = (np.fmin.reduce(values, axis=0), np.fmax.reduce(values, axis=0)) if len(values) else ()
    for found in extremes:
        for k in np.flatnonzero(np.isin(np.abs(found), SENTINELS)):
            is_it = values[:, k] == found[k]
            rest = np.abs(values[~is_it & np.isfinite(values[:, k]), k])
            often = np.count_nonzero(is_it) > SENTINEL_SHARE * len(values)
            if often and rest.size and abs(found[k]) > SENTINEL_FACTOR * np.quantile(rest, 0.99):
                values = values.copy() if not said else values
                values[is_it, k] = np.nan
                said.append(f"{found[k]:.0f}")
    return values, " and ".join(dict.fromkeys(said))


def bridged(t: Array, gyro: Array, longest_s: float) -> Array | None:
    r"""Return the noise density (n,), rad/s/sqrt(Hz), of samples beside a hole of up to ``longest_s``; 0 elsewhere.

    The gyro is taken as linear across :math:`m` lost samples. Where none are lost, doing so errs by
    :math:`e=T\sum_{i=1}^m(\omega_i-\bar\omega_i)`; the mean square of it around a hole is spread over the hole and half
    a period on either side. None where nothing is lost, so that what is recorded is used as it is.
    """
    step = np.diff(t)
    period = float(np.median(step))
    holes = np.flatnonzero((step > MISSING * period) & (step <= longest_s))
    if not holes.size:
        return None
    count = np.rint(step[holes] / period).astype(np.int64) - 1
    sizes = np.unique(np.ceil(np.geomspace(1, max(count.max(), 1), 12)).astype(np.int64))
    density = np.zeros(len(t))
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(gyro, axis=0)])
    for below, size in zip(np.append(0, sizes[:-1]), sizes, strict=True):
        mine = holes[(count > below) & (count <= size)]
        if not mine.size or len(t) < size + 2:
            continue
        inner = total[size + 1 : -1] - total[1 : -size - 1]
        ends = 0.5 * size * (gyro[size + 1 :] + gyro[: -size - 1])
        even = np.abs(t[size + 1 :] - t[: -size - 1] - (size + 1) * period) < EVEN * (size + 1) * period
        square = np.where(even, np.mean((inner - ends) ** 2, axis=1), 0.0) * period**2
        d = np.sqrt(around(t, t[mine], square, even) / (step[mine] + period))
        np.maximum.at(density, mine, d)
        np.maximum.at(density, mine + 1, d)
    return density


def around(t: Array, at: Array, square: Array, known: Array) -> Array:
    """Return the mean of the known squares around instants; of all where too few are near."""
    counts, sums = (np.concatenate([[0.0], np.cumsum(x)]) for x in (known, square))
    low, high = (np.clip(np.searchsorted(t, at + side * AROUND_S), 0, len(square)) for side in (-1.0, 1.0))
    near, summed = counts[high] - counts[low], sums[high] - sums[low]
    whole = sums[-1] / max(counts[-1], 1.0)
    return np.asarray(np.where(near >= FEW, summed / np.maximum(near, 1.0), whole))
