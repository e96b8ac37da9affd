"""Log + segments -> Nodes: the epochs at which the estimate is made, the IMU between them, the measurements at them.

The IMU is handled in bulk; filters and smoothers see only nodes. Between them stands a gyro product (motion), nothing
(a stop: the attitude is frozen, the gyro measures its bias) or a hole (gap: the attitude may have changed by anything).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ..maths import rotation
from ..maths.propagation import Increments, Samples, Steps, preintegrate, run_steps
from ..records import Array, Bools, Imu, Ints, Log, Segmentation
from ..sensors import Measurement
from ..sensors.zero_rate import ZeroRate
from ..settings import Settings
from .noise import Noise, added_density, motion_density, reference_bias
from .observations import Observation

STOP_NODE_S = 1.0  # nodes of a stop: its attitude is frozen, only the bias walks
FROZEN_DENSITY = 1e-7  # rad/sqrt(s): keeps the covariance of a frozen attitude regular
SAME_TIME_S = 1e-6
MERGED_S = 1e-4  # nodes nearer than this are one: an interval without noise has no inverse
RATE_WINDOW_S = 1.0  # the rate that a scale error acts on is its mean over this
LONG_FACTOR = 10.0  # nodes of long motions in long logs may be so many times further apart
PAGE_NODES = 7200  # but a log has at least so many in equal steps: more than a page has columns
NEARNESS = 20.0  # and the step is at most the time to the nearest edge or measurement over this
BLOCK_ROWS = 1 << 16  # samples handled together
GAP_MARGIN = 2.0  # a hole is as lively as the drive, twice over

__all__ = ["Nodes", "build_nodes"]


@dataclass(frozen=True, slots=True)
class Nodes:
    """Epochs of the estimate.

    ``t`` (n,) s, ``moving`` (n,) False in the used part of a stop; per interval k -> k + 1: ``frozen``, ``gap`` (n -
    1,), ``increments``, the gyro ``samples`` they are made of; ``measurements[i]`` those of node ``measured[i]``,
    ascending; ``noise``; ``lost`` (n - 1, 3, 3) rad^2 in body axes of the later node: what is lost of the attitude
    beyond that noise.
    """

    t: Array
    moving: Bools
    frozen: Bools
    gap: Bools
    samples: Samples
    increments: Increments
    measured: Ints
    measurements: tuple[tuple[Measurement, ...], ...]
    density: Array
    noise: Noise
    lost: Array | None = None

    @property
    def steps(self) -> Steps:
        """The IMU on the merged grid of samples and nodes: a copy at full rate."""
        return _steps(self.samples)

    def on_grid(self, q: Array, bias: Array) -> tuple[Array, Array]:
        """Return the grid of samples and nodes (g,) and the attitude on it (g, 4), run on from ``q`` (n, 4) and
        ``bias`` (n, 3) of every node.
        """
        middle = np.where((self.frozen | self.gap)[:, None], 0.0, 0.5 * (bias[1:] + bias[:-1]))
        steps = self.steps
        grid = self.t[0] + np.concatenate([[0.0], np.cumsum(steps.dt)])
        return grid, np.concatenate([q[:1], run_steps(steps, q[:-1], middle)])

    def rebuild(self, bias: Array) -> Nodes:
        """Return the nodes preintegrated again at ``bias`` (n, 3), rad/s: exact where the estimate moved far."""
        increments = _increments(
            self.samples, 0.5 * (bias[1:] + bias[:-1]), self.frozen, self.gap, self.density, self.noise
        )
        again = replace(self, increments=increments, lost=None)
        return again if self.lost is None else again.losing(self.lost)

    def only(self, measurements: Sequence[Sequence[Measurement]]) -> Nodes:
        """Return the nodes with these ``measurements`` of those ``measured``, of which none may be left."""
        left = [k for k, group in enumerate(measurements) if group]
        return replace(self, measured=self.measured[left], measurements=tuple(tuple(measurements[k]) for k in left))

    def losing(self, lost: Array) -> Nodes:
        """Return the nodes with ``lost`` (n - 1, 3, 3) rad^2 added to the attitude's noise."""
        Q = self.increments.Q.copy()
        Q[:, :3, :3] += lost
        return replace(self, increments=replace(self.increments, Q=Q), lost=lost)

    def raised(self, factor: float) -> Nodes:
        """Return the nodes with the gyro's variance in motion raised by ``factor``."""
        return self.denser((factor - 1.0) * self.density)

    def denser(self, more: Array) -> Nodes:
        """Return the nodes with ``more`` (n - 1,), (rad/s)^2/Hz, added to the gyro's density: white noise adds it times
        ``span`` to ``Q``, in motion.
        """
        added = np.where(self.frozen | self.gap, 0.0, more * self.increments.span)
        Q = self.increments.Q.copy()
        Q[:, :3, :3] += added[:, None, None] * np.eye(3)
        return replace(self, density=self.density + more, increments=replace(self.increments, Q=Q))

    def motion_variance(self) -> float:
        """Return the attitude variance, rad^2, that gyro noise adds over the worst motion."""
        added = np.where(self.frozen | self.gap, 0.0, self.density * self.increments.span)
        edges = np.flatnonzero(
            np.diff(np.concatenate([[False], self.moving[:-1] | self.moving[1:], [False]]).astype(np.int8))
        )
        total = np.concatenate([[0.0], np.cumsum(added)])
        return max(float(np.max(np.diff(total[edges]), initial=0.0)), 1e-12)


def build_nodes(
    log: Log, segmentation: Segmentation, observations: list[Observation], noise: Noise, settings: Settings,
    epochs: Array | None = None,
) -> Nodes:  # fmt: skip
    """Place the nodes, preintegrate the IMU between them and hand each node its measurements; ``epochs`` (k,) s are
    nodes too. Without them nothing but attitude and bias runs over the nodes, which may be coarser in long motions.
    """
    imu = log.imu
    stops = [(s.used_start, s.used_end) for s in segmentation.stops]
    gaps = [(float(a), float(b)) for a, b in log.gaps]
    frozen_stops = stops if settings.smoothing.zero_rate else []
    must, spacing = np.array([o.t for o in observations]), settings.smoothing.node_spacing_s
    coarsest = float(np.clip((imu.t[-1] - imu.t[0]) / PAGE_NODES, spacing, LONG_FACTOR * spacing))
    if epochs is not None:
        must, coarsest = np.concatenate([must, epochs]), spacing
    t = _grid(imu.t, stops, frozen_stops, gaps, must, spacing, coarsest)
    middle = 0.5 * (t[1:] + t[:-1])
    frozen, gap = _inside(middle, stops) & settings.smoothing.zero_rate, _inside(middle, gaps)
    linear = settings.imu.gyro_samples != "interval"
    samples = Samples(imu.t, imu.gyro_b, t, np.searchsorted(imu.t, t), frozen | gap, linear)
    bias = reference_bias(log, segmentation, middle)
    density = motion_density(noise, mean_rate(imu, middle) - bias) + added_density(imu.t, imu.gyro_added, t)
    increments = _increments(samples, bias, frozen, gap, density, noise)
    by_node = _assign(imu, observations, t, segmentation, settings.smoothing.zero_rate)
    for m in _zero_rates(imu, t, frozen, noise):
        by_node.setdefault(m.node, []).append(m)
    measured = np.array(sorted(by_node), dtype=np.int64)
    groups = tuple(tuple(by_node[k]) for k in measured.tolist())
    return Nodes(t, ~_inside(t, stops), frozen, gap, samples, increments, measured, groups, density, noise)


def _assign(
    imu: Imu, observations: list[Observation], t: Array, segmentation: Segmentation, frozen_stops: bool
) -> dict[int, list[Measurement]]:
    """Hand every observation to its node; samples of a moving sensor keep the turn between."""
    out: dict[int, list[Measurement]] = {}
    at = np.array([o.t for o in observations])
    after = np.clip(np.searchsorted(t, at), 1, max(len(t) - 1, 1))
    nearest = np.where(
        at - t[after - 1] < t[np.minimum(after, len(t) - 1)] - at, after - 1, np.minimum(after, len(t) - 1)
    )
    for o, node in zip(observations, nearest.tolist(), strict=True):
        here = (o.still and frozen_stops) or bool(np.all(np.abs(o.times - t[node]) < SAME_TIME_S))
        turn = None if here else _turns(imu, o.times, t[node], segmentation)
        out.setdefault(node, []).append(Measurement(o.role, o.sensor, node, o.t, o.values, o.noise, turn))
    return out


def _grid(
    t: Array, stops: list[tuple[float, float]], frozen: list[tuple[float, float]], gaps: list[tuple[float, float]],
    epochs: Array, spacing: float, coarsest: float = 0.0,
) -> Array:  # fmt: skip
    """Return node times: ends, edges of stops and gaps, epochs, and between them at most the spacing, or in the middle
    of a motion ``coarsest``.
    """
    edges = [e for pair in (*stops, *gaps) for e in pair]
    must = np.unique(np.clip(np.concatenate([[t[0], t[-1]], edges, epochs]), t[0], t[-1]))
    must = must[np.concatenate([[True], np.diff(must) > MERGED_S])]
    if len(must) == 1:
        return np.asarray(must)
    must[-1] = t[-1]
    middle, width = 0.5 * (must[1:] + must[:-1]), np.diff(must)
    still = np.where(_inside(middle, frozen), STOP_NODE_S, np.where(_inside(middle, gaps), np.inf, 0.0))
    coarsest = max(coarsest, spacing)
    moving = 2.0 * _steps_within(0.5 * width, spacing, coarsest)
    many = np.maximum(np.where(still > 0.0, width / np.maximum(still, spacing), moving), 1e-6)  # a gap is one step
    parts = np.ceil(many - 1e-9).astype(np.int64)
    owner = np.repeat(np.arange(len(parts)), parts)
    share = (np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[owner]
    near = many[owner] * np.minimum(share, 1.0 - share)  # steps to the nearer edge
    reach = _reach(near, spacing, coarsest) / _reach(0.5 * many[owner], spacing, coarsest)
    graded = 0.5 * np.where(share <= 0.5, reach, 2.0 - reach)
    return np.append(must[owner] + width[owner] * np.where(still[owner] > 0.0, share, graded), must[-1])


def _steps_within(d: Array, fine: float, coarse: float) -> Array:
    r"""Return how many steps lie within ``d`` of an edge, where the step at ``d`` is :math:`d/N` between fine and
    coarse.
    """
    first, last = NEARNESS * fine, NEARNESS * coarse
    grown = NEARNESS * np.log(np.clip(d, first, last) / first)
    return np.asarray(np.minimum(d, first) / fine + grown + np.maximum(d - last, 0.0) / coarse)


def _reach(steps: Array, fine: float, coarse: float) -> Array:
    """Return how far so many steps reach: the inverse of ``_steps_within``."""
    grown = np.clip(steps - NEARNESS, 0.0, NEARNESS * np.log(coarse / fine))
    beyond = np.maximum(steps - NEARNESS - NEARNESS * np.log(coarse / fine), 0.0)
    return np.asarray(np.minimum(steps, NEARNESS) * fine * np.exp(grown / NEARNESS) + beyond * coarse)


def _inside(t: Array, intervals: list[tuple[float, float]]) -> Bools:
    """Return which times lie inside one of the disjoint, ascending intervals."""
    if not intervals:
        return np.zeros(len(t), dtype=np.bool_)
    start, end = np.array(intervals).T
    i = np.searchsorted(start, t, side="right") - 1
    return np.asarray((i >= 0) & (t <= end[np.maximum(i, 0)]))


def _steps(samples: Samples) -> Steps:
    """Merge samples and nodes into one grid."""
    t, at = samples.nodes, samples.first
    new = samples.t[at] != t
    grid = np.insert(samples.t, at[new], t[new])
    first = np.searchsorted(grid, t)
    if samples.linear:
        rate = np.stack([np.interp(grid, samples.t, samples.rate[:, i]) for i in range(3)], axis=1)
        rate0, rate1 = rate[:-1].copy(), rate[1:]
    else:
        rate0 = samples.rate[np.searchsorted(samples.t, grid[1:])]
        rate1 = rate0.copy()
    held = np.repeat(samples.held, np.diff(first))
    rate0[held], rate1[held] = 0.0, 0.0
    return Steps(np.diff(grid), rate0, rate1, first)


def _increments(samples: Samples, bias: Array, frozen: Bools, gap: Bools, density: Array, noise: Noise) -> Increments:
    """Preintegrate; freeze the attitude at stops and let it go in gaps."""
    held, eye = frozen | gap, np.eye(3)
    inc = preintegrate(samples, bias, density, noise.n_w, held)
    inc.psi[held] = 0.0
    inc.Phi[held] = np.eye(6)
    inc.Q[held] = 0.0
    inc.Q[held, 3:, 3:] = noise.n_w * inc.span[held, None, None] * eye
    inc.Q[frozen, :3, :3] = FROZEN_DENSITY**2 * inc.span[frozen, None, None] * eye
    if gap.any():
        squares = np.add.reduceat(np.einsum("ki,ki->k", samples.rate, samples.rate), samples.first[:-1])
        lively = np.sqrt(np.sum(squares[~held]) / len(samples.t) / 3)
        turned = np.minimum(GAP_MARGIN * max(float(lively), 0.05) * inc.span[gap], np.pi)
        inc.Q[gap, :3, :3] = (turned**2)[:, None, None] * eye
    return inc


def mean_rate(imu: Imu, at: Array) -> Array:
    """Return the gyro's mean (m, 3) over a second about each of the ascending times."""
    ends = np.clip(np.stack([at - 0.5 * RATE_WINDOW_S, at + 0.5 * RATE_WINDOW_S]), imu.t[0], imu.t[-1])
    first, last = (_turned(imu, e) for e in ends)
    return np.asarray((last - first) / np.maximum(ends[1] - ends[0], 1e-9)[:, None])


def _turned(imu: Imu, at: Array) -> Array:
    """Return the gyro's integral (m, 3) from the first sample to ascending times, each sample held over its step."""
    row = np.clip(np.searchsorted(imu.t, at, side="right") - 1, 0, len(imu.t) - 1)
    out = (at - imu.t[row])[:, None] * imu.gyro_b[row]
    total, done = np.zeros(3), 0
    for lo in range(0, len(imu.t), BLOCK_ROWS):
        t = imu.t[lo : lo + BLOCK_ROWS + 1]
        until = int(np.searchsorted(row, lo + len(t) - 1)) if lo + len(t) < len(imu.t) else len(at)
        summed = np.zeros((len(t), 3))
        np.cumsum(imu.gyro_b[lo : lo + len(t) - 1] * np.diff(t)[:, None], axis=0, out=summed[1:])
        out[done:until] += total + summed[row[done:until] - lo]
        total, done = total + summed[-1], until
    return out


def _turns(imu: Imu, times: Array, t_node: float, segmentation: Segmentation) -> Array:
    """Return the rotations (m, 3, 3) from a node to samples at most a node spacing away, by the rate half-way."""
    half = 0.5 * (times + t_node)
    rate = np.stack([np.interp(half, imu.t, imu.gyro_b[:, i]) for i in range(3)], axis=1) - segmentation.bias_b
    return rotation.matrix(rotation.exp_quaternion(rate * (times - t_node)[:, None]))


def _zero_rates(imu: Imu, t: Array, frozen: Bools, noise: Noise) -> list[Measurement]:
    """Mean rate of disjoint blocks of every stop, each at the node that ends it; short remainders join the block
    before.
    """
    out: list[Measurement] = []
    at = np.searchsorted(imu.t, t, side="right")
    k = 0
    while k < len(frozen):
        if not frozen[k]:
            k += 1
            continue
        end = k
        while end < len(frozen) and frozen[end]:
            end += 1
        cuts = [k]
        for j in range(k + 1, end + 1):
            long_enough = t[j] - t[cuts[-1]] >= 0.5 * STOP_NODE_S and t[end] - t[j] >= 0.5 * STOP_NODE_S
            if long_enough or j == end:
                cuts.append(j)
        for a, b in pairwise(cuts):
            rows = imu.gyro_b[at[a] : at[b]]
            if len(rows):
                R = noise.n_r / (t[b] - t[a]) * np.eye(3)
                out.append(Measurement("zero_rate", ZeroRate(), b, float(t[b]), rows.mean(axis=0)[None], R))
        k = end
    return out
