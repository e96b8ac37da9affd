"""Shapes in closed form that motions are made of: plateaus with raised-cosine edges, and kicks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..records import Array


@dataclass(frozen=True, slots=True)
class Plateaus:
    r"""Plateaus one after the other: ``height`` from ``start`` to ``end`` with raised-cosine edges of ``edge`` s (m,).

    $y = h\,(S((t-a)/T) - S((t-e+T)/T))$ with $S(x) = (1 - \cos\pi x)/2$ on [0, 1]. Edges of half the length make a
    raised-cosine pulse of area $hT$, edges of 0 a step.
    """

    start: Array
    end: Array
    edge: Array
    height: Array

    @classmethod
    def of(cls, rows: Iterable[tuple[float, float, float, float]]) -> Plateaus:
        """Plateaus from rows (start, end, edge, height) in order of time."""
        return cls(*np.array(list(rows), dtype=float).reshape(-1, 4).T)

    def at(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """Integral from the beginning, value and two derivatives at ``t`` (n,)."""
        if not self.start.size:
            return np.zeros(t.size), np.zeros(t.size), np.zeros(t.size), np.zeros(t.size)
        k = np.clip(np.searchsorted(self.start, t, side="right") - 1, 0, None)
        start, end, edge, height = (part[k] for part in (self.start, self.end, self.edge, self.height))
        before = np.concatenate([[0.0], np.cumsum(self.height * (self.end - self.start - self.edge))])[k]
        up, down = (_rise(t - s, edge) for s in (start, end - edge))
        area, value, slope, bend = (height * (a - b) for a, b in zip(up, down, strict=True))
        return before + area, value, slope, bend


def _rise(t: Array, edge: Array) -> tuple[Array, Array, Array, Array]:
    """Rise from 0 to 1 within ``edge`` s from t = 0: integral, value and two derivatives."""
    sharp = edge == 0.0
    T = np.where(sharp, 1.0, edge)
    x = np.clip(t / T, 0.0, 1.0)
    inside = (t >= 0.0) & (t <= edge) & ~sharp
    integral = T * (x / 2 - np.sin(np.pi * x) / (2 * np.pi)) + np.maximum(t - T, 0.0)
    value = (1.0 - np.cos(np.pi * x)) / 2
    slope = np.where(inside, np.pi / (2 * T) * np.sin(np.pi * x), 0.0)
    bend = np.where(inside, np.pi**2 / (2 * T**2) * np.cos(np.pi * x), 0.0)
    return np.where(sharp, np.maximum(t, 0.0), integral), np.where(sharp, t >= 0.0, value), slope, bend


@dataclass(frozen=True, slots=True)
class Kicks:
    """Half-sine accelerations of ``length`` s at ``start`` (m,), ``peak`` (m, d), no two at a time.

    With ``recovery`` s each is given back by a longer half-sine of the same area, so that the speed returns.
    """

    start: Array
    peak: Array
    length: float
    recovery: float = 0.0

    def at(self, t: Array) -> tuple[Array, Array]:
        """Speed gained and acceleration at ``t`` (n,), each (n, d)."""
        if not self.start.size:
            return np.zeros((t.size, self.peak.shape[1])), np.zeros((t.size, self.peak.shape[1]))
        k = np.searchsorted(self.start, t, side="right") - 1
        since, peak = t - self.start[k], np.where(k[:, None] >= 0, self.peak[k], 0.0)
        speed, force = _half_sine(since, self.length)
        if self.recovery:
            share = self.length / self.recovery
            back, pull = _half_sine(since - self.length, self.recovery)
            return peak * (speed - share * back)[:, None], peak * (force - share * pull)[:, None]
        gained = np.cumsum(2 * self.length / np.pi * self.peak, axis=0)
        before = np.concatenate([np.zeros((1, self.peak.shape[1])), gained])[np.maximum(k, 0)]
        return before + peak * speed[:, None], peak * force[:, None]


def _half_sine(t: Array, length: float) -> tuple[Array, Array]:
    """Integral and value of a half-sine of height 1 from 0 to ``length``."""
    x = np.clip(t / length, 0.0, 1.0)
    return length / np.pi * (1.0 - np.cos(np.pi * x)), np.sin(np.pi * x)
