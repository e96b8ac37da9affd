r"""Components of the noise over a whole log: each from the disturbances that it explains, and what fixes jump.

One forward and backward pass gives the gradient of the log-likelihood to every variance :math:`q` at once. With the
adjoint :math:`\tilde\lambda` of a disturbance :math:`w\sim N(0,qV)` and its covariance :math:`\tilde\Lambda`,

.. math:: 2\frac{\partial\log L}{\partial\log q}=\sum_kq\,\tilde\lambda^TV\tilde\lambda-q\,\mathrm{tr}(V\tilde\Lambda)

which is zero where the first sum, what was seen, is the second, what was expected; so variances are multiplied by
their quotient, again and again. Source: Koopman and Shephard 1992, "Exact score for time series models in state space
form". A step that goes on in the direction of the one before is taken longer.

**Correlation times.** With what drives a coloured error held, its time :math:`T` acts through its transition alone,
:math:`F=\partial\Phi/\partial\log T`, and one step of expectation and maximisation is

.. math:: \delta\log T=\frac{-\sum_k[\tilde\lambda^TFx+\mathrm{tr}(F^T\tilde\Lambda\Phi P)]}
    {\sum_k\mathrm{tr}(F^TQ^{-1}F\,E[xx^T])},\qquad E[w\,x^T]=-Q(\tilde\lambda x^T+\tilde\Lambda\Phi P)

with what is assumed as a prior: a time that the log does not show stays. Source: Shumway and Stoffer 1982, "An approach
to time series smoothing and forecasting using the EM algorithm".

**Jumps.** A receiver that loses satellites, or sees them by reflections, finds another solution from one fix to the
next, and stays there: a metre in a log whose fixes are good to centimetres elsewhere. With one Gaussian noise for both,
IMU and fixes of the whole log pay for it. So what drives the coloured error of fixes has Student's t-distribution: a
mixture of Gaussians in which each fix has a factor :math:`s_j` of its own on the variance,

.. math:: s_j=\max\Big(1,\frac{\nu+E[w_j^TQ_j^{-1}w_j]}{\nu+d}\Big)

with :math:`w_j` the change of the error and its rate since the fix before, usually of covariance :math:`Q_j`. A stretch
without fixes is many draws that nobody saw: there the mean of the factors counts, which is 1.16 times that of the
:math:`s_j`: they are inverse means of inverses.
Source: Lange, Little and Taylor 1989, "Robust statistical modeling using the t distribution".
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from ...maths import adjoint, sequential
from ...records import Array, Ints
from . import colours
from .aids import STUDENT, UNSEEN, Aid, Place, drifts
from .identify import RANGE, Window, scaled_inertial
from .model import Inertial, Linear, inertial_noise
from .solve import Stack, forward, pile, whitening
from .states import TIME, Layout, layout, time_of

TRIAL, PASSES = 3, 5  # of factors and jumps in turn: to choose where to begin, and after; more change little
WHITE = 0.125  # share of the white noise of fixes that is left where their error is taken for coloured
MOST, MORE, MOST_GAIN = 2.0, 1.5, 4.0  # times a sigma in a pass; of a step that goes on as before; most of a step
TIMES = (0.125, 8.0)  # of the correlation time that is assumed
PRIOR = 1.0  # degrees of freedom that speak for a factor as it is
KNOWN, SLIGHT = 1.0, 1e-3  # of the logarithm of a correlation time: sigma of what is assumed; a small change
HOLE = 3.0  # times the usual time between fixes: many draws, of which the mean factor counts
SAME_S = 1e-4  # stamps of one fix agree to this

Jumps = Mapping[str, tuple[Array, Array]]
"""Per role the stamps (k,) of its fixes, on their own clock, and their factors (k,)."""


def refined(window: Window, aids: Sequence[Aid], factors: Mapping[str, float]) -> tuple[dict[str, float], Jumps]:
    """Return the factors on the sigmas and correlation times, and the jumps of the fixes among ``aids``, over a log.

    White and coloured errors of fixes have a maximum of the likelihood each: both are tried, the likelier is taken.
    """
    places = [aid for aid in aids if isinstance(aid, Place) and len(aid.t)]
    none: Jumps = {place.role: (place.t, np.ones(len(place.t))) for place in places}
    starts = [dict(factors), _coloured(window.form, places, factors)]
    starts = starts[: 1 if starts[0] == starts[1] else 2]
    tried = [_passes(window, places, start, none, TRIAL) for start in starts]
    found, jumps, _ = max(tried, key=lambda of: of[2])
    return _passes(window, places, found, jumps, PASSES)[:2]


def _passes(
    window: Window, places: Sequence[Place], factors: Mapping[str, float], jumps: Jumps, count: int
) -> tuple[dict[str, float], Jumps, float]:  # fmt: skip
    """Return factors and jumps after some passes, and how likely those before the last were."""
    found, n, likely = dict(factors), len(window.at.q), -np.inf
    steps, gains = dict[str, float](), dict[str, float]()
    for _ in range(count):
        loosened = replace(window, form=window.form.loosened(loose(places, jumps, {}, n)))
        P0, lin, placed = loosened.under(found)
        rows = pile(placed, n, window.form.size)
        run = forward(P0, lin, rows, np.zeros(window.form.size))
        likely = run.log_likelihood() - whitening(rows) + sum(_prior(s) for _, s in jumps.values())
        back = adjoint.adjoints(run)
        jumps = {place.role: (place.t, _jumped(window.form.scaled(found), place, back, jumps)) for place in places}
        seen = {**dict(_of_motion(loosened, found, lin, back)), **dict(_of_rows(run, rows, back))}
        before, steps = steps, {name: _step(*s) for name, s in _ordered(places, found, seen).items() if name in factors}
        steps |= dict(_of_times(loosened, found, lin, run, back))
        gains = {name: _gain(gains.get(name, 1.0), before.get(name, 0.0) * steps[name]) for name in steps}
        found = _moved(found, {name: gains[name] * step for name, step in steps.items()})
    return found, jumps, likely


def _prior(s: Array) -> float:
    r"""Return the logarithm of how probable factors are beside 1: inverse gamma, :math:`\nu/2` and :math:`\nu/2`."""
    return float(np.sum(-(0.5 * STUDENT + 1.0) * np.log(s) - 0.5 * STUDENT * (1.0 / s - 1.0)))


def _coloured(form: Layout, places: Sequence[Place], factors: Mapping[str, float]) -> dict[str, float]:
    """Return the factors with the error of fixes as large as it was, but nearly all of it coloured."""
    out, groups = dict(factors), {state.name: state for state in form.coloured()}
    for place in (place for place in places if place.role in factors):
        for name, _ in drifts(place.role):
            slow, white = np.median(groups[name].sigma), np.nanmedian(place.sigma)
            out[name] = float(np.hypot(factors[name], factors[place.role] * white / slow))
        out[place.role] = WHITE * factors[place.role]
    return out


def loose(aids: Sequence[Aid], jumps: Jumps, lags: Mapping[str, float], n: int) -> dict[str, Array]:
    """Return per coloured group of the fixes among ``aids``, late by ``lags``, the factors (n - 1,) between nodes."""
    out = dict[str, Array]()
    for place in (aid for aid in aids if isinstance(aid, Place) and aid.role in jumps):
        stamps, factors = jumps[place.role]
        own = np.searchsorted(stamps, place.t + lags.get(place.role, 0.0) - SAME_S)
        own = np.minimum(own, len(stamps) - 1)
        until = np.searchsorted(place.node, np.arange(1, n))  # the fix that an interval leads to
        out.update((name, np.append(factors[own], 1.0)[until]) for name, _ in drifts(place.role))
    return {**out, **{f"{name} rate": factors for name, factors in out.items()}}


def _ordered(
    places: Sequence[Place], factors: Mapping[str, float], seen: Mapping[str, tuple[float, float]]
) -> dict[str, tuple[float, float]]:
    """Return what was seen and expected, of level and up together where fixes would be worse level than up: no receiver
    is, and what looks so is a clock, a heading or a motion that contradicts them.
    """
    out = dict(seen)
    for place, end in product(places, ("", " rate")):
        level, up = (name + end for name, _ in drifts(place.role))
        if {level, up} <= factors.keys():
            ahead = np.log(factors[level] / factors[up]) + _step(*seen[level]) - _step(*seen[up])
            if ahead >= 0.0:
                out[level] = out[up] = (seen[level][0] + seen[up][0], seen[level][1] + seen[up][1])
    return out


def _step(seen: float, expected: float) -> float:
    """Return by how much the logarithm of a sigma is to change."""
    return float(0.5 * np.log((seen + PRIOR) / (expected + PRIOR)))


def _gain(gain: float, along: float) -> float:
    """Return how much of a step is taken: more of one that goes on as the one before."""
    return min(MOST_GAIN, MORE * gain) if along > 0.0 else 1.0


def _moved(factors: Mapping[str, float], steps: Mapping[str, float]) -> dict[str, float]:
    """Return the factors after steps of their logarithms; what drives an error stays where its time changes."""
    out = dict(factors)
    for name, step in steps.items():
        times, known = float(np.exp(np.clip(step, -np.log(MOST), np.log(MOST)))), out.get(name, 1.0)
        out[name] = float(np.clip(known * times, *(TIMES if name.endswith(TIME) else RANGE)))
        if name.endswith(TIME):
            out[name.removesuffix(TIME)] *= float(np.sqrt(out[name] / known))
    return out


def _of_motion(
    window: Window, factors: Mapping[str, float], lin: Linear, back: adjoint.Adjoints
) -> Iterator[tuple[str, tuple[float, float]]]:  # fmt: skip
    """Yield what was seen and expected of the noise of the IMU and of every coloured error."""
    inertial, form = scaled_inertial(window.inertial, factors), window.form.scaled(factors)
    for name, part in (("gyro", _only(inertial, gyro=1.0)), ("accelerometer", _only(inertial, accel=1.0))):
        yield name, _sums(back, np.arange(15), inertial_noise(part, window.at, lin.motion))
    for state in form.coloured():
        alone = layout(replace(s, sigma=s.sigma * float(s.name == state.name)) for s in form.states)
        yield state.name, _sums(back, colours.indices(form), colours.driving(alone, lin.motion.span))


def _only(inertial: Inertial, gyro: float = 0.0, accel: float = 0.0) -> Inertial:
    """Return the IMU with one of its noises alone."""
    return replace(
        inertial, gyro=gyro * inertial.gyro, accel=accel * inertial.accel, gyro_walk=0.0, accel_walk=0.0
    )  # fmt: skip


def _sums(back: adjoint.Adjoints, at: Ints, Q: Array) -> tuple[float, float]:
    """Return what was seen and expected of disturbances of covariance ``Q`` (n - 1, d, d) of the states ``at``."""
    shock, Shock = back.shock[1:, at], back.Shock[1:, at[:, None], at]
    return float(np.einsum("ki,kij,kj->", shock, Q, shock)), float(np.einsum("kij,kji->", Q, Shock))


def _of_times(
    window: Window, factors: Mapping[str, float], lin: Linear, run: sequential.Pass, back: adjoint.Adjoints
) -> Iterator[tuple[str, float]]:
    """Yield by how much the logarithm of the correlation time of every coloured error is to change."""
    form, span, P = window.form.scaled(factors), lin.motion.span, run.chain.P[:-1]
    among = colours.indices(form)
    block, held = (slice(None), among[:, None], among), P[:, among]
    x = (window.at.x[:-1] + run.x[:-1] - np.einsum("kij,kj->ki", P, back.lam[:-1]))[:, among]
    squares = x[:, :, None] * x[:, None] + P[block] - held @ back.Lam[:-1] @ held.swapaxes(1, 2)
    driven = back.shock[1:, among, None] * x[:, None] + back.Shock[1:, among] @ lin.Phi @ held.swapaxes(1, 2)
    weight = np.linalg.pinv(lin.Q[block], hermitian=True) * (span > SAME_S)[:, None, None]
    for name in (state.name for state in form.coloured()):
        later, sooner = (colours.fading(form.scaled({time_of(name): np.exp(h)}), span) for h in (SLIGHT, -SLIGHT))
        slope, off = (later - sooner) / (2.0 * SLIGHT), np.log(factors.get(time_of(name), 1.0))
        gradient = -float(np.sum(slope * driven)) - off / KNOWN**2
        information = float(np.sum((slope.swapaxes(1, 2) @ weight @ slope) * squares)) + 1.0 / KNOWN**2
        yield time_of(name), gradient / information


def _of_rows(
    run: sequential.Pass, rows: Stack, back: adjoint.Adjoints
) -> Iterator[tuple[str, tuple[float, float]]]:  # fmt: skip
    """Yield what was seen and expected of the noise of every aid."""
    u, D = adjoint.misfits(run, back)
    for aid, part, first, _ in rows.places:
        known = np.any(part.H != 0.0, axis=2)
        node, at = part.node[:, None], first[:, None] + np.arange(known.shape[1])
        yield aid.role, (float(np.sum(u[node, at][known] ** 2)), float(np.sum(D[node, at][known])))


def _jumped(form: Layout, place: Place, back: adjoint.Adjoints, jumps: Jumps) -> Array:
    """Return the factors (k,) of fixes, expected with those there were."""
    names, among = [n + end for n, _ in drifts(place.role) for end in ("", " rate")], colours.indices(form)
    where = np.flatnonzero(np.isin(among, np.concatenate([np.r_[form.parts[name]] for name in names])))
    at = among[where]
    span = np.diff(place.t, prepend=place.t[0])
    Q = colours.driving(form, span)[:, where[:, None], where]
    s, d = jumps[place.role][1], len(at)
    shock, Shock = back.shock[place.node][:, at], back.Shock[place.node][:, at[:, None], at]
    moved = s * np.einsum("ki,kij,kj->k", shock, Q, shock) - s * np.einsum("kij,kji->k", Q, Shock)
    found = np.maximum(1.0, (STUDENT + s * (d + moved)) / (STUDENT + d))
    hole = span > HOLE * np.median(span)
    return np.asarray(np.where(hole, np.maximum(found, UNSEEN * np.mean(found[~hole])), found))
