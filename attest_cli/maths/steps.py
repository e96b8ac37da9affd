"""IMU steps grouped by node interval: on a grid of their own, or read from the samples where they stand.

Intervals with about as many steps are taken side by side, parts of vectors first: every operation runs over many.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Steps:
    """IMU steps grouped by node interval.

    ``dt`` (s,), ``rate0``/``rate1`` (s, 3) gyro output at the start and the end of each step (bias not removed),
    ``first`` (m + 1,): interval ``i`` owns steps ``first[i] .. first[i + 1]``.
    """

    dt: Array
    rate0: Array
    rate1: Array
    first: Ints

    @property
    def count(self) -> Ints:
        """Steps in each interval (m,)."""
        return np.diff(self.first)

    @property
    def span(self) -> Array:
        """Length of each interval (m,), s."""
        ends = np.concatenate([[0.0], np.cumsum(self.dt)])
        return np.asarray(ends[self.first[1:]] - ends[self.first[:-1]])

    def block(self, rows: Ints, count: Ints) -> tuple[Array, Array, Array]:
        """Return the first ``count`` steps of the intervals ``rows`` side by side: lengths (k, b), rates at their
        starts and ends (3, k, b); steps of no length fill up.
        """
        k = np.arange(int(count.max()))
        at = self.first[rows][:, None] + k
        dt = np.where(k[:, None] < count, np.take(self.dt, at, mode="clip").T, 0.0)
        return dt, _gathered(self.rate0, at), _gathered(self.rate1, at)


@dataclass(frozen=True, slots=True)
class Samples:
    """Gyro samples between nodes, read where they stand: what ``Steps`` are without a copy at full rate.

    ``t`` (n,) s, ``rate`` (n, 3) rad/s; ``nodes`` (m + 1,) s within ``t``, each with the ``first`` sample at or after
    it; ``held`` (m,) intervals whose rate is zero. Rates are ``linear`` between samples, or each holds over the time
    before its sample.
    """

    t: Array
    rate: Array
    nodes: Array
    first: Ints
    held: NDArray[np.bool_]
    linear: bool = True

    @property
    def count(self) -> Ints:
        """Steps in each interval (m,): from its node over its samples to the next node."""
        return np.diff(self.first) + 1

    @property
    def span(self) -> Array:
        """Length of each interval (m,), s."""
        return np.diff(self.nodes)

    def block(self, rows: Ints, count: Ints) -> tuple[Array, Array, Array]:
        """Return steps side by side; see ``Steps.block``."""
        least, most = int(count.min()), int(count.max())
        at = self.first[rows][:, None] + np.arange(-1, most)  # the sample at the start of each step
        over = np.arange(least, most + 1)[:, None] >= count  # only the longest are as long as the block
        edges = np.ascontiguousarray(np.take(self.t, at, mode="clip").T)
        edges[0] = self.nodes[rows]
        np.copyto(edges[least:], self.nodes[rows + 1], where=over)
        if not self.linear:
            rate = _gathered(self.rate, np.minimum(at + 1, self.first[rows + 1][:, None]))
        else:
            rate = _gathered(self.rate, at)
            rate[:, 0] = self._between(rows)
            np.copyto(rate[:, least:], self._between(rows + 1)[:, None], where=over)
        rate[:, :, self.held[rows]] = 0.0
        return np.diff(edges, axis=0), rate[:, :-1], rate[:, 1:] if self.linear else rate[:, :-1]

    def _between(self, node: Ints) -> Array:
        """Return the rates (3, b) at nodes, linear between samples."""
        after = np.clip(self.first[node], 1, len(self.t) - 1)
        t0, t1 = self.t[after - 1], self.t[after]
        share = ((self.nodes[node] - t0) / (t1 - t0))[:, None]
        return np.asarray(((1.0 - share) * self.rate[after - 1] + share * self.rate[after]).T)


def _gathered(rate: Array, at: Ints) -> Array:
    """Return rows of ``rate`` (n, 3) at the places (b, k), parts first (3, k, b)."""
    return np.ascontiguousarray(np.take(rate, at, axis=0, mode="clip").transpose(2, 1, 0))
