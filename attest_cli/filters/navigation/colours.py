r"""Coloured errors of sensors: Gauss-Markov states, some driven by a rate of their own, as they are all along.

.. math:: \dot x=-ax+u+w_x,\qquad\dot u=-bu+w_u

A receiver smooths its own solution, so that its error goes on for seconds in the direction in which it goes: without
``u`` it is either too stiff for a stretch without fixes or too loose from one fix to the next.
"""

from __future__ import annotations

import numpy as np

from ...records import Array, Ints
from .states import Layout, State


def indices(layout: Layout) -> Ints:
    """Return the places (c,) of all coloured states."""
    return np.concatenate([np.zeros(0, dtype=np.int64), *(_places(layout, s.name) for s in layout.coloured())])


def fading(layout: Layout, span: Array) -> Array:
    """Return how the coloured states go on over ``span`` (k,) s: their transition (k, c, c)."""
    Phi = np.zeros((len(span), layout.size, layout.size))
    for state in layout.coloured():
        at, b = _places(layout, state.name), 1.0 / state.correlation_s
        Phi[:, at, at] = np.exp(-b * span)[:, None]
        if state.rate_of:
            a = _fades(layout, state)
            Phi[:, _places(layout, state.rate_of), at] = ((np.exp(-a * span) - np.exp(-b * span)) / (b - a))[:, None]
    among = indices(layout)
    return Phi[:, among[:, None], among]


def steady(P: Array, layout: Layout) -> Array:
    """Return the covariance (s, s) with that in which the coloured states stay."""
    P = P.copy()
    for state in layout.coloured():
        at = _places(layout, state.name)
        P[at, at] = np.asarray(state.sigma) ** 2
    for state in layout.coloured():
        if state.rate_of:
            at, driven = _places(layout, state.name), _places(layout, state.rate_of)
            a, b, variance = _fades(layout, state), 1.0 / state.correlation_s, P[at, at]
            P[at, driven] = P[driven, at] = variance / (a + b)
            P[driven, driven] += variance / (a * (a + b))
    return P


def driving(layout: Layout, span: Array) -> Array:
    r"""Return the noise (k, c, c) that keeps them there, :math:`Q=P-\Phi P\Phi^T`, more where they are loose."""
    among, Phi = indices(layout), fading(layout, span)
    P = steady(np.zeros((layout.size, layout.size)), layout)[among[:, None], among]
    Q = P - Phi @ P @ Phi.swapaxes(1, 2)
    grown = np.ones((len(span), layout.size))
    for state in layout.coloured():
        if state.loose is not None:
            grown[:, layout.parts[state.name]] = np.sqrt(state.loose)[:, None]
    grown = grown[:, among]
    return Q * grown[:, :, None] * grown[:, None, :]


def _places(layout: Layout, name: str) -> Ints:
    return np.arange(layout.size)[layout.parts[name]]


def _fades(layout: Layout, state: State) -> float:
    """Return the rate, 1/s, at which fades what ``state`` drives."""
    return 1.0 / next(s.correlation_s for s in layout.states if s.name == state.rate_of)
