"""How still the IMU is: window moments, noise, the gyro's bias found blind, the statistic and its thresholds."""

from __future__ import annotations

import itertools
import math
from bisect import bisect
from dataclasses import dataclass

import numpy as np

from ..maths.consistency import upper_quantile
from ..records import Array, Bools, Imu, Ints
from ..settings import Settings

FALSE_ALARM = 1e-6  # per window, of a threshold that knows the noise only
FLOOR_FACTOR, FLOOR_CAP = 2.0, 50.0  # stops that shake: threshold over their own level, at most this over the noise's
QUIET_SHARE = 0.01  # share of the log that is taken as still when nothing else is known
HOPS = 20  # the window moves by this share of its width
BLOCK_HOPS = 1 << 13  # handled together: their samples stay in cache
GYRO_DRIFT, ACCEL_DRIFT = 5e-5, 1e-3  # rad/s, m/s^2: how far means of a still sensor wander beyond white noise
ACCEL_WALK = 3e-4  # m/s^2/sqrt(s): the same over a longer stop
LONE_STOP_S = 4.0  # a bias that a single quiet interval supports needs one this long
GRAVITY_MOVES = 30.0  # times the noise of a block: a turn that gravity cannot hide
BIAS_WALK = 1e-5  # rad/s^2/sqrt(Hz): walk of the gyro's bias between stops where it is not stated
CHI2_3 = upper_quantile(3, FALSE_ALARM)
CHI2_6 = upper_quantile(6, FALSE_ALARM)


@dataclass(frozen=True, slots=True)
class Windows:
    """Moments over windows of ``width`` samples, one per hop: hop ``k`` holds samples ``[first[k], first[k + 1])``.

    ``spread_*`` (k,): mean square of the distance to the window's mean; ``mean_*`` (k, 3); ``run`` (k,): stretch
    between gaps; ``blocks``: hops whose windows are disjoint.
    """

    t: Array
    first: Ints
    run: Ints
    width: int
    spread_gyro: Array
    spread_accel: Array
    mean_gyro: Array
    mean_accel: Array
    blocks: Ints


@dataclass(frozen=True, slots=True)
class Quiet:
    """Intervals in which nothing changes: ``start``, ``end`` (k,) s, mean rate and specific force (k, 3), ``blocks``
    (k,) in each.
    """

    start: Array
    end: Array
    rate: Array
    force: Array
    blocks: Array

    def some(self, which: Ints | Bools) -> Quiet:
        """Return some of them."""
        return Quiet(self.start[which], self.end[which], self.rate[which], self.force[which], self.blocks[which])


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Of the statistic: what noise alone passes once in ``1/FALSE_ALARM`` windows, and what is used."""

    noise: float
    enter: float
    leave: float


def gap_edges(t: Array, gaps: Array) -> Ints:
    """First sample of every stretch without a gap, and the number of samples behind the last."""
    after = np.searchsorted(t, np.reshape(gaps, (-1, 2))[:, 1]) if gaps.size else np.empty(0, np.int64)
    return np.unique(np.concatenate([[0], after, [t.size]]).astype(np.int64))


def window_moments(imu: Imu, edges: Ints, window_s: float) -> Windows:
    """Moments of both sensors over windows that move by a twentieth of their width and stay inside their run."""
    n = imu.t.size
    period = float(np.median(np.diff(imu.t))) if n > 1 else window_s
    width = max(4, round(window_s / period))
    hop = max(1, width // HOPS)
    span = max(1, round(width / hop))
    first = np.concatenate([np.arange(a, max(a + 1, b - hop + 1), hop) for a, b in itertools.pairwise(edges)])
    ends = np.append(first, n)
    counts = np.diff(ends)
    run = np.searchsorted(edges, first, side="right") - 1
    begin, end = np.searchsorted(run, run), np.searchsorted(run, run, side="right")
    hops = np.arange(first.size)
    low = np.maximum(np.minimum(hops - span // 2, end - span), begin)
    high = np.minimum(low + span, end)

    samples = (ends[high] - ends[low]).astype(float)

    def moments(x: Array) -> tuple[Array, Array]:
        centre = np.einsum("ij->j", x) / n  # five times as fast as its mean, and no need to be exact
        sums = np.empty((first.size + 1, 4))
        sums[0] = 0.0
        for lo in range(0, first.size, BLOCK_HOPS):
            part = slice(lo, min(lo + BLOCK_HOPS, first.size))
            off = x[ends[lo] : ends[part.stop]] - centre  # without gravity and bias the sums lose no digits
            terms = np.concatenate([off, np.einsum("ij,ij->i", off, off)[:, None]], axis=1)
            sums[lo + 1 : part.stop + 1] = np.add.reduceat(terms, first[part] - ends[lo], axis=0)
        np.cumsum(sums, axis=0, out=sums)
        means = (sums[high] - sums[low]) / samples[:, None]
        mean, square = means[:, :3], means[:, 3]
        return np.maximum(square - np.einsum("ij,ij->i", mean, mean), 0.0), mean + centre

    spread_gyro, mean_gyro = moments(imu.gyro_b)
    spread_accel, mean_accel = moments(imu.accel_b)
    whole = (hops - begin) % span == span // 2
    blocks = np.flatnonzero(whole & (low == hops - span // 2) & (high - low == span))
    if not blocks.size:
        blocks = np.unique(begin + (end - begin) // 2)
    return Windows(
        t=imu.t[first + counts // 2],
        first=ends,
        run=run,
        width=width,
        spread_gyro=spread_gyro,
        spread_accel=spread_accel,
        mean_gyro=mean_gyro,
        mean_accel=mean_accel,
        blocks=blocks,
    )


def sensor_noise(windows: Windows, t: Array, settings: Settings) -> tuple[float, float]:
    """Noise per sample and axis of gyro and accelerometer (1 sigma): as stated, else of the log's calmest windows."""
    period = float(np.median(np.diff(t))) if t.size > 1 else 1.0
    found = []
    for density, spread in (
        (settings.imu.gyro_noise_density, windows.spread_gyro),
        (settings.imu.accel_noise_density, windows.spread_accel),
    ):
        if density is not None:
            found.append(density / math.sqrt(period))
        else:
            found.append(math.sqrt(calm_spread(spread[windows.blocks], windows.width) / 3.0))
    return found[0], found[1]


def calm_spread(spread: Array, width: int) -> float:
    """Centre of the lowest cluster of window variances: a low quantile, walked up to the median of its neighbours.

    A low quantile alone is biased low by the choice; windows of equal noise scatter by sqrt(2 / dof) about its centre.
    """
    values = np.sort(spread[spread > 0.0])
    if not values.size:
        return 1e-12
    reach = 1.0 + 4.0 * math.sqrt(2.0 / (3.0 * (width - 1)))
    centre = float(values[min(values.size - 1, max(1, int(QUIET_SHARE * values.size)))])
    for _ in range(10):
        centre = float(np.median(values[values <= reach * centre]))
    return centre * width / (width - 1)


def thresholds(windows: Windows, sigmas: tuple[float, float], settings: Settings) -> Thresholds:
    """Noise-derived threshold, raised where even the calmest two windows in a row pass it: a stop that shakes."""
    noise = upper_quantile(6 * windows.width - 3, FALSE_ALARM) / windows.width
    change = own_spread(windows, sigmas)[windows.blocks]
    pairs = np.sort(np.maximum(change[1:], change[:-1])) if change.size > 1 else change
    level = float(pairs[min(pairs.size - 1, int(QUIET_SHARE * pairs.size))])
    enter = noise if level < noise else min(FLOOR_FACTOR * level, FLOOR_CAP * noise)
    enter = settings.stops.enter or enter
    return Thresholds(noise, enter, enter * settings.stops.leave_factor)


def own_spread(windows: Windows, sigmas: tuple[float, float]) -> Array:
    """Both sensors' spread about their window means in units of noise: about 6 at rest, whatever the biases."""
    return np.asarray(windows.spread_gyro / sigmas[0] ** 2 + windows.spread_accel / sigmas[1] ** 2)


def quiet_intervals(
    windows: Windows, sigmas: tuple[float, float], enter: float, turning: Bools, settings: Settings,
    factor: float = 1.0,
) -> Quiet:  # fmt: skip
    """Sequences of calm blocks whose means do not change from one to the next, at a rate that a bias can have, times
    ``factor``.
    """
    blocks = windows.blocks
    spread = own_spread(windows, sigmas)[blocks]
    scale = max(1.0, enter / FLOOR_FACTOR / 6.0)
    rate, force = windows.mean_gyro[blocks], windows.mean_accel[blocks]
    slow = np.linalg.norm(rate, axis=1) < 3.0 * math.sqrt(3.0) * factor * settings.imu.gyro_bias_sigma
    calm = (spread < enter) & slow & ~turning[blocks]
    variance_gyro = 2.0 * (scale * sigmas[0] ** 2 / windows.width + GYRO_DRIFT**2)
    variance_accel = 2.0 * (scale * sigmas[1] ** 2 / windows.width + ACCEL_DRIFT**2)
    step = np.sum(np.diff(rate, axis=0) ** 2, axis=1) / variance_gyro
    step += np.sum(np.diff(force, axis=0) ** 2, axis=1) / variance_accel
    linked = calm[1:] & calm[:-1] & (step < CHI2_6) & (np.diff(windows.run[blocks]) == 0)
    for first, last in spans(linked):  # a slow start may creep away from the stop in steps too small to see
        core = slice(first + (last - first) // 4, last + 1 - (last - first) // 4)
        drift = np.sum((rate[first : last + 1] - rate[core].mean(axis=0)) ** 2, axis=1) / variance_gyro
        drift += np.sum((force[first : last + 1] - force[core].mean(axis=0)) ** 2, axis=1) / variance_accel
        calm[first : last + 1] &= drift < CHI2_6
    bounds = spans(linked & calm[1:] & calm[:-1])
    half = settings.stops.window_s / 2
    return Quiet(
        start=windows.t[blocks[bounds[:, 0]]] - half,
        end=windows.t[blocks[bounds[:, 1]]] + half,
        rate=np.array([rate[a : b + 1].mean(axis=0) for a, b in bounds]).reshape(-1, 3),
        force=np.array([force[a : b + 1].mean(axis=0) for a, b in bounds]).reshape(-1, 3),
        blocks=(bounds[:, 1] - bounds[:, 0] + 1).astype(float),
    )


def spans(flags: Bools) -> Ints:
    """Index of the first flag of every sequence of set flags, and of the first unset one behind it (k, 2)."""
    change = np.diff(np.concatenate([[0], flags.astype(np.int64), [0]]))
    return np.column_stack([np.flatnonzero(change == 1), np.flatnonzero(change == -1)])


def agreeing(quiet: Quiet, variance: float, walk: float, most: int = 1000) -> Quiet:
    """The intervals that share one slowly walking bias: the largest such set, of two intervals or more if there is one.

    Stops all show the gyro's bias; smooth turns show it plus a rate of their own, each another.
    """
    if not quiet.start.size:
        return quiet
    keep = np.sort(np.argsort(-quiet.blocks, kind="stable")[:most])
    start, end, rate, blocks = quiet.start[keep], quiet.end[keep], quiet.rate[keep], quiet.blocks[keep]
    middle = (start + end) / 2
    apart = np.sum((rate[:, None] - rate) ** 2, axis=2)
    allowed = variance * (1 / blocks[:, None] + 1 / blocks) + walk**2 * np.abs(middle[:, None] - middle)
    alike = apart < CHI2_3 * allowed
    support = np.where(alike.sum(axis=1) > 1, 1e9, 0.0) + alike @ blocks
    member = [int(np.argmax(support))]
    for k in np.argsort(
        -blocks, kind="stable"
    ):  # the longest first; each must agree with the members next to it in time
        place = bisect(member, k)
        if k not in member and all(alike[k, m] for m in member[max(place - 1, 0) : place + 1]):
            member.insert(place, int(k))
    if len(member) == 1 and end[member[0]] - start[member[0]] < LONE_STOP_S:
        member = []
    return quiet.some(keep[member])


def at_rest(found: Quiet, agreed: Quiet, noise: float) -> Quiet:
    """The intervals that have ``agreed`` on a bias, and those of another rate that cannot be a turn: about a level axis
    it would have moved gravity. ``noise`` (m/s^2) of a block.
    """
    if not agreed.start.size:
        return agreed
    middle, known = (0.5 * (q.start + q.end) for q in (found, agreed))
    bias = np.stack([np.interp(middle, known, agreed.rate[:, i]) for i in range(3)], axis=1)
    moved = np.linalg.norm(np.cross(found.rate - bias, found.force), axis=1) * (found.end - found.start)
    return found.some(np.isin(found.start, agreed.start) | (moved > GRAVITY_MOVES * noise))


def stop_statistic(
    windows: Windows, sigmas: tuple[float, float], limits: Thresholds, quiet: Quiet, walk: float
) -> Array:
    """Return the statistic of ``find_segments`` per hop; without any quiet interval there is no bias and no stop."""
    spread = own_spread(windows, sigmas)
    if not quiet.start.size:
        return np.maximum(spread, 2.0 * limits.leave)
    middle = (quiet.start + quiet.end) / 2
    bias = np.column_stack([np.interp(windows.t, middle, quiet.rate[:, axis]) for axis in range(3)])
    off = windows.mean_gyro - bias
    square = np.einsum("ij,ij->i", off, off)
    white = mean_variance(windows.spread_gyro, sigmas[0], windows, quiet)
    wander = GYRO_DRIFT**2 + walk**2 * np.abs(windows.t - middle[nearest(middle, windows.t)])
    statistic: Array = np.maximum(spread + square / sigmas[0] ** 2, limits.leave * square / (CHI2_3 * (white + wander)))

    runs = np.searchsorted(windows.run, np.arange(windows.run[-1] + 2))
    calm = hysteresis(statistic, limits, windows.run)
    white_force = mean_variance(windows.spread_accel, sigmas[1], windows, quiet)
    for a, b in itertools.pairwise(stretches(calm, runs)):
        if not calm[a]:
            continue
        samples = windows.first[b] - windows.first[a]
        whole = np.sum(off[a:b].mean(axis=0) ** 2) / (white * windows.width / samples + wander[a:b].mean())
        core = slice(a + (b - a) // 4, b - (b - a) // 4)
        tilt = np.sum((windows.mean_accel[a:b] - windows.mean_accel[core].mean(axis=0)) ** 2, axis=1)
        tilt /= white_force + ACCEL_DRIFT**2 + ACCEL_WALK**2 * np.abs(windows.t[a:b] - windows.t[core].mean())
        statistic[a:b] = np.maximum(statistic[a:b], limits.leave * np.maximum(whole, tilt) / CHI2_3)
    return statistic


def mean_variance(spread: Array, sigma: float, windows: Windows, quiet: Quiet) -> float:
    """Variance per axis of a window's mean at rest: of white noise as stated, or as seen in quiet intervals."""
    t = windows.t[windows.blocks]
    inside = np.searchsorted(quiet.start, t) > np.searchsorted(quiet.end, t)
    seen = float(spread[windows.blocks[inside]].mean()) / 3.0 if inside.any() else 0.0
    return max(seen, sigma**2) / windows.width


def nearest(places: Array, t: Array) -> Ints:
    """Index of the place nearest to each instant; ``places`` in order."""
    after = np.clip(np.searchsorted(places, t), 1, max(1, places.size - 1))
    before = after - 1
    after = np.minimum(after, places.size - 1)
    return np.where(np.abs(places[after] - t) < np.abs(places[before] - t), after, before)


def hysteresis(statistic: Array, limits: Thresholds, run: Ints) -> Bools:
    """Stretches below ``leave`` that fall below ``enter`` somewhere: a Schmitt trigger that is the same backwards."""
    low = statistic < limits.leave
    number = np.cumsum(np.concatenate([[True], (np.diff(low) != 0) | (np.diff(run) != 0)])) - 1
    enters = np.zeros(number[-1] + 1, bool)
    enters[number[statistic < limits.enter]] = True
    return np.asarray(low & enters[number])


def stretches(still: Bools, edges: Ints) -> Ints:
    """Sample indices at which a segment begins, and the number of samples: where ``still`` changes, and at gaps."""
    return np.union1d(np.flatnonzero(np.diff(still)) + 1, edges).astype(np.int64)
