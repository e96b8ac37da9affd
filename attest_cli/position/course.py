"""A position: at the nodes with its covariance, and the course between them, made block by block."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..records import Array, Ints, Segmentation, Smoothed

BLOCK_ROWS = 1 << 16  # samples handled together
UNUSABLE_SHARE = 0.1  # of the distance: a position worse than this is not worth its name
UNUSABLE_M = 1.0  # the same of a log that never moves

Course = Callable[[], Iterator[tuple[Array, Array]]]
"""Gives position and velocity (k, 3) at the IMU samples, ``BLOCK_ROWS`` at a time, in order."""


@dataclass(frozen=True, slots=True)
class Position:
    """``p``, ``v`` (m, 3) at the nodes, m and m/s, with ``P`` (m, 3, 3) m^2; ``course`` gives both at the IMU samples;
    per motion (by segment index) closing velocity m/s and distance m; ``usable``: sigma stays below 10 % of the
    distance. NaN where nothing is known.
    """

    p: Array
    v: Array
    P: Array
    closing: Mapping[int, float]
    distance: Mapping[int, float]
    usable: bool
    method: str
    course: Course


def row_blocks(n: int) -> Iterator[slice]:
    """Yield the rows ``0 .. n``, ``BLOCK_ROWS`` at a time."""
    return cut(0, n)


def cut(lo: int, hi: int) -> Iterator[slice]:
    """Yield the rows ``lo .. hi``, cut where the blocks of a course begin."""
    while lo < hi:
        end = min(hi, (lo // BLOCK_ROWS + 1) * BLOCK_ROWS)
        yield slice(lo, end)
        lo = end


def around(grid: Array, t: Array) -> slice:
    """Return the rows of an ascending grid that ascending times ``t`` are interpolated from."""
    lo, hi = np.searchsorted(grid, t[[0, -1]])
    return slice(max(int(lo) - 1, 0), int(hi) + 1)


def running(start: Array, steps: Array) -> Array:
    """Return ``start`` (k,) and its sums with the steps (n, k) (n + 1, k): the same in blocks as in one piece."""
    return np.cumsum(np.concatenate([start[None], steps]), axis=0)


def sampled(blocks: Iterable[tuple[Array, Array]], at: Array) -> Array:
    """Interpolate signals (k, c) at ascending times, block by block; each block begins where the one before ended."""
    found, done = [], 0
    for t, values in blocks:
        until = int(np.searchsorted(at, t[-1], side="right"))
        found.append(np.stack([np.interp(at[done:until], t, column) for column in values.T], axis=1))
        done, last = until, values[-1]
    return np.concatenate([*found, np.tile(last, (len(at) - done, 1))])


def survey(course: Course, t: Array, nodes: Array, spans: Sequence[tuple[int, int]]) -> tuple[Array, Array, Array]:
    """Follow a course once: position and velocity (m, 3) at the ``nodes``, its length over spans ``[first, last)``."""

    def joined() -> Iterator[tuple[Array, Array]]:
        lo, before = 0, np.empty((0, 7))
        for p, v in course():
            way = before[-1:, 6] if len(before) else np.zeros(1)
            step = np.nan_to_num(np.diff(p, axis=0, prepend=before[-1:, :3] if len(before) else p[:1]))
            length = running(way, np.sqrt(np.einsum("ki,ki->k", step, step))[:, None])[1:]
            rows = np.concatenate([before[-1:], np.concatenate([p, v, length], axis=1)])
            yield t[max(lo - 1, 0) : lo + len(p)], rows
            lo, before = lo + len(p), rows

    edges: Ints = np.array([(a, max(b - 1, a)) for a, b in spans], dtype=np.int64).reshape(-1, 2)
    at = np.union1d(nodes, t[edges])
    found = sampled(joined(), at)
    here, way = found[np.searchsorted(at, nodes)], found[np.searchsorted(at, t[edges]), 6]
    return here[:, :3], here[:, 3:6], way[:, 1] - way[:, 0]


def navigated(t: Array, smoothed: Smoothed, segmentation: Segmentation) -> Position:
    """Return velocity and position of a filter that estimates them, at the IMU samples ``t`` (n,): cubic between nodes.

    Nodes are a tenth of a second apart: what a cubic through place and speed leaves out is the jerk between them.
    """
    assert smoothed.P_vp is not None
    P, motions = smoothed.P_vp[:, 3:, 3:], segmentation.motions

    def course() -> Iterator[tuple[Array, Array]]:
        return (_cubic(t[rows], smoothed) for rows in row_blocks(len(t)))

    p, v, lengths = survey(course, t, smoothed.t, [(m.first, m.last) for m in motions])
    distance = dict(zip((m.index for m in motions), lengths.tolist(), strict=True))
    return Position(p, v, P, {}, distance, usable(P, distance), "navigation", course)


def _cubic(t: Array, smoothed: Smoothed) -> tuple[Array, Array]:
    """Return position and velocity at times ``t``."""
    assert smoothed.p is not None
    assert smoothed.v is not None
    right = np.clip(np.searchsorted(smoothed.t, t), 1, len(smoothed.t) - 1)
    left, T = right - 1, (smoothed.t[right] - smoothed.t[right - 1])[:, None]
    s = np.clip((t[:, None] - smoothed.t[left, None]) / T, 0.0, 1.0)
    p0, p1, v0, v1 = smoothed.p[left], smoothed.p[right], smoothed.v[left], smoothed.v[right]
    return p0 + s**2 * (3 - 2 * s) * (p1 - p0) + s * (1 - s) * T * ((1 - s) * v0 - s * v1), v0 + s * (v1 - v0)


def usable(P: Array, distance: Mapping[int, float]) -> bool:
    """Return whether the largest horizontal sigma stays below a tenth of the distance driven, or below
    ``UNUSABLE_M`` in a log without a motion.
    """
    limit = UNUSABLE_SHARE * sum(distance.values()) if distance else UNUSABLE_M
    horizontal = np.sqrt(np.nanmax(P[:, 0, 0] + P[:, 1, 1])) if np.isfinite(P).any() else np.inf
    return bool(horizontal <= limit)
