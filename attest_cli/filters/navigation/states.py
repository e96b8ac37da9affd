"""The states of the navigation smoother: which there are, how well they are known at the start, how they wander."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ...records import Array

CORE = ("attitude", "velocity", "position", "gyro bias", "accelerometer bias")
TIME = " time"


def time_of(name: str) -> str:
    """Return the name among factors of the correlation time of a coloured group."""
    return name + TIME


@dataclass(frozen=True, slots=True)
class State:
    """A group of states. ``sigma`` prior (one for all, or one each); ``correlation_s``: 0 = a constant (it may walk),
    else a Gauss-Markov error of this time whose sigma stays. ``rate_of`` names the coloured group that it drives;
    ``loose`` (n - 1,) factors on the variance of what drives a coloured group between nodes, where it jumps; ``slope``
    by which measurements move with it: less than 1 where noise feigns much of what shows it (:mod:`feigned`).
    """

    name: str
    size: int
    sigma: float | Array
    correlation_s: float = 0.0
    rate_of: str = ""
    loose: Array | None = None
    slope: float = 1.0


@dataclass(frozen=True, slots=True)
class Layout:
    """Where each group of states stands in the vector: ``parts[name]`` is a slice; ``size`` of them all."""

    states: tuple[State, ...]
    parts: Mapping[str, slice]
    size: int

    def __contains__(self, name: str) -> bool:
        """Return whether the log calls for this group."""
        return name in self.parts

    def prior(self) -> Array:
        """Return the prior variances (size,)."""
        return np.concatenate([np.full(s.size, 1.0) * np.asarray(s.sigma) ** 2 for s in self.states])

    def coloured(self) -> tuple[State, ...]:
        """Return the groups that wander about zero: Gauss-Markov errors of a sensor."""
        return tuple(s for s in self.states if s.correlation_s > 0.0)

    def scaled(self, factors: Mapping[str, float]) -> Layout:
        """Return the layout with sigmas of named groups times a factor, and correlation times by :func:`time_of`."""
        return layout(
            replace(
                s,
                sigma=s.sigma * factors.get(s.name, 1.0),
                correlation_s=s.correlation_s * factors.get(time_of(s.name), 1.0),
            )
            for s in self.states
        )

    def loosened(self, loose: Mapping[str, Array]) -> Layout:
        """Return the layout with other factors (n - 1,) on what drives the named groups."""
        return layout(replace(s, loose=loose.get(s.name, s.loose)) for s in self.states)

    def sloped(self, slopes: Mapping[str, float]) -> Layout:
        """Return the layout with other slopes of named groups."""
        return layout(replace(s, slope=slopes.get(s.name, s.slope)) for s in self.states)

    def slopes(self) -> Array:
        """Return the slopes (size,)."""
        return np.concatenate([np.full(s.size, s.slope) for s in self.states])

    def within(self, between: slice) -> Layout:
        """Return the layout over some of the intervals between nodes."""
        return layout(s if s.loose is None else replace(s, loose=s.loose[between]) for s in self.states)


def layout(states: Iterable[State]) -> Layout:
    """Return the layout of groups in their order; the five of ``CORE`` come first."""
    found, parts, at = tuple(states), {}, 0
    for s in found:
        parts[s.name] = slice(at, at + s.size)
        at += s.size
    assert tuple(s.name for s in found[:5]) == CORE
    return Layout(found, parts, at)
