"""Lost samples: how many, cells that hold a number for none, and what bridging a short hole costs, told by bridging as
many samples where none are lost.
"""

from __future__ import annotations

import numpy as np

from ..records import Array, Ints

MISSING = 1.5  # periods: a longer step has lost a sample
AROUND_S = 3.0  # the drive is alike so near to a hole
EVEN = 0.25  # of its length: a stretch without a hole keeps its time
FEW = 10  # stretches that tell nothing: all of the log is asked

WHOLE = 0.25  # of a period: steps over lost samples are so near to a multiple of it; those of a poor clock are not
RUN, FULLEST = 150, 0.05  # samples; share of the runs of so many that are taken to be whole
ALIKE, FULL = 0.98, 0.04  # share of steps that agree; how far the fullest runs may be off where few samples are lost
SPREAD = 2.5  # periods: runs of as many samples differ by more where many are lost
SENTINELS = (99.0, 999.0, 9999.0, 99999.0, 999999.0, 32767.0, 32768.0, 65535.0, 2147483647.0, 2147483648.0)
SENTINEL_SHARE, SENTINEL_FACTOR = 0.01, 20.0  # of the rows; times the 99th percentile of the others


def missing(stamps_ns: Ints, longest_s: float, dropped: int = 0) -> float:
    """Return the share of samples that are lost in short holes, but for those that were ``dropped`` on the way.

    A hole is a step near to two or more periods. A clock that is late once, and early after it, has lost nothing: the
    time that goes beyond one period a step, over all short steps, must be as long. The share is too low rather than too
    high where stamps are rounded to ticks of about a period: lost samples then hide in them.
    """
    step = np.diff(stamps_ns) * 1e-9
    usual = float(np.median(step)) if step.size else 0.0
    short = step[step <= max(longest_s, MISSING * usual)]
    period = _period(short)
    if period <= 0.0 or not np.any(short > MISSING * period):
        return 0.0
    count = np.rint(short / period) - 1.0
    uneven = np.abs(short[short <= MISSING * period] - period)
    near = max(WHOLE * period, float(np.quantile(uneven, 0.9)) if uneven.size else 0.0)
    holes = (short > MISSING * period) & (np.abs(short - (count + 1.0) * period) < near)
    lost = min(float(count[holes].sum()), float(short.sum()) / period - short.size) - dropped
    return max(lost, 0.0) / (stamps_ns.size + max(lost, 0.0))


def _period(steps: Array) -> float:
    """Return the time between samples of which none is lost.

    Rounded stamps step by a tick or two, and the median of that is no period: the fullest runs of many samples tell it,
    but too long where samples are lost in every run; there steps that agree tell it better.
    """
    run = min(RUN, steps.size // 4)
    if not run:
        return float(np.median(steps)) if steps.size else 0.0
    t = np.concatenate([[0.0], np.cumsum(steps)])
    full, middle = np.quantile(t[run:] - t[:-run], (FULLEST, 0.5))
    period = float(full) / run
    whole = steps[steps < MISSING * period]
    alike = whole[np.abs(whole - period) < WHOLE * period]
    lossy = middle - full > SPREAD * period  # ticks fall evenly, lost samples do not
    if alike.size > ALIKE * whole.size and (lossy or abs(float(alike.mean()) / period - 1.0) < FULL):
        return min(period, float(alike.mean()))
    return period


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
        d = np.sqrt(_mean_around(t, t[mine], square, even) / (step[mine] + period))
        np.maximum.at(density, mine, d)
        np.maximum.at(density, mine + 1, d)
    return density


def _mean_around(t: Array, at: Array, square: Array, known: Array) -> Array:
    """Return the mean of the known squares around instants; of all where too few are near."""
    counts, sums = (np.concatenate([[0.0], np.cumsum(x)]) for x in (known, square))
    low, high = (np.clip(np.searchsorted(t, at + side * AROUND_S), 0, len(square)) for side in (-1.0, 1.0))
    near, summed = counts[high] - counts[low], sums[high] - sums[low]
    whole = sums[-1] / max(counts[-1], 1.0)
    return np.asarray(np.where(near >= FEW, summed / np.maximum(near, 1.0), whole))
