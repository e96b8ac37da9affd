"""White noise N and random walk K of samples at rest by maximum likelihood, with intervals; B read off."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..records import Array
from .records import Allan, NoiseFit
from .rest import Piece, cut, means
from .spectrum import band_density
from .walk import Fit, Walk, best, build_walk, walk_interval

SIGMA_95 = 1.959963984540054
MOST_BLOCKS = 131_072  # longer records are averaged: N is then known to 0.2 %, and K loses nothing
COARSE_BLOCKS = 2048  # at this many the random walk is looked for first
FEWEST_ROWS = 30
FLICKER = 0.664  # sqrt(2 ln 2 / pi): Allan deviation of flicker noise over B
KNOWN = 1.5  # points of the Allan curve count where its 95 % bound is within this factor


def fit_noise(pieces: Sequence[Piece], values: Sequence[Array], white: int, *, across: bool) -> NoiseFit:
    r"""Return N and K of one axis: maximum likelihood of the differenced record (:mod:`walk`).

    Parameters
    ----------
    pieces : the samples at rest
    values : (n,) each, one axis, without what a bias model explains
    white : samples to average first, where the sensor's own low-pass asks for it
    across : differences between stops count: a gyro's bias walks on between them

    Notes
    -----
    95 % intervals: profile likelihood for K, Fisher information for N. A K whose interval holds 0 is not seen: ``K`` is
    None, and its interval reaches from 0 to the bound. Long records are averaged first, and that is said.
    """
    period = float(np.median([p.period for p in pieces]))
    total = sum(len(x) for x in values)
    averaged = max(white, math.ceil(total / MOST_BLOCKS))
    walk, z = _rows(pieces, values, averaged * period, across=across)
    while len(z) < FEWEST_ROWS and averaged > 1:
        averaged //= 2
        walk, z = _rows(pieces, values, averaged * period, across=across)
    coarse_walk, coarse = _rows(pieces, values, max(averaged, total / COARSE_BLOCKS) * period, across=across)
    near = best(coarse_walk, coarse).ratio if FEWEST_ROWS < len(coarse) < len(z) else None
    found = best(walk, z, near=near)
    N, log_sigma = found.N, _log_sigma(walk, z, found)
    if white > 1:  # neighbouring means share the noise that the low-pass spreads: N would come out low
        N, terms = band_density(values, period, averaged, found.walk)
        log_sigma = max(log_sigma, math.sqrt(0.5 / terms))
    spread = math.exp(SIGMA_95 * log_sigma)
    K = walk_interval(walk, z, found)
    notes = [] if averaged <= white else [f"{total} samples, averaged by {averaged} before the fit"]
    if K[0] == 0.0:
        span = float(pieces[-1].t[-1] - pieces[0].t[0])
        notes.append(f"no random walk seen in {span:.0f} s: K has an upper bound only")
    seen = found.walk if K[0] > 0.0 else None
    return NoiseFit(N, (N / spread, N * spread), seen, K, None, None, tuple(notes))


def _rows(pieces: Sequence[Piece], values: Sequence[Array], length_s: float, *, across: bool) -> tuple[Walk, Array]:
    """Return the covariance and the differences of means over about ``length_s``."""
    blocks, edges = cut(pieces, length_s)
    walk = build_walk(blocks, level=False, across=across)
    return walk, walk.differences(means(values, edges))


def _log_sigma(walk: Walk, z: Array, found: Fit) -> float:
    """Return the standard deviation of ln N by Fisher information, the ratio profiled out.

    By ln N^2 and ln(ratio): I_11 = n/2, I_12 = trace/2, and half the profile's curvature by ln(ratio).
    """
    variance = 2.0 / found.n
    if found.ratio > 0.0:
        h = 0.05
        slope = [walk.fit(found.ratio * math.exp(x), z).score for x in (h, -h)]
        curvature = (slope[0] - slope[1]) / (4.0 * h)
        variance += (found.trace / found.n) ** 2 / max(curvature, 0.1)
    return 0.5 * math.sqrt(variance)


def low_pass_note(what: str, hz: float, share: float) -> str:
    """Say that single samples do not show the noise that a mean has."""
    quiet = f"{100 * (1 - share):.0f} % quieter" if share < 1.0 else f"{100 * (share - 1):.0f} % noisier"
    why = "its own low-pass" if share < 1.0 else "vibration or rounding"
    return f"{what}: single samples are {quiet} than its noise density ({why}), which is that below {hz:.2g} Hz"


def read_instability(allan: Allan, N: float) -> tuple[float | None, float | None, str]:
    r"""Return B read off the lowest point of the Allan curve and its averaging time, or why there is none.

    Only points known to a factor of 1.5 count: beyond, the lowest is chance. And only where the line of white noise of
    density ``N``, :math:`N/\sqrt\tau`, lies below that point's interval: else white noise alone explains it.
    """
    known = allan.high < KNOWN * allan.deviation
    if known.sum() < 3:
        return None, None, "too short for a bias instability"
    curve = allan.deviation[known]
    lowest = int(np.argmin(curve))
    if lowest == len(curve) - 1:
        return None, None, "no bias instability seen: the Allan deviation still falls as far as it is known"
    if N / math.sqrt(float(allan.tau[known][lowest])) >= allan.low[known][lowest]:
        return None, None, "no bias instability seen: white noise explains the smallest Allan deviation"
    return float(curve[lowest]) / FLICKER, float(allan.tau[known][lowest]), ""
