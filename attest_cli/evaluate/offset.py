"""The time offset between two tracks, from what each calls its rates: turns or moves over a short span."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..maths import rotation
from ..maths.consistency import MAD
from ..records import Array, Bools
from .alignment import nearest_rotation
from .association import GAP_PERIODS, attitudes, look_up, period, vectors
from .records import Offset

SPANS_S = (0.05, 0.25, 1.0)  # turns over less than the first are mostly noise of a camera system
SEARCH_S = 5.0  # coarse search, either way
BLOCK_S = 2.0  # residuals further apart than this are taken as independent
ROUNDS = 10
SETTLED_S = 1e-8
LEAST_MATCH = 0.8  # correlation below which nothing was found: the rotation alone fits much of any other motion
LEAST_BLOCKS = 5
OUTLIER = 4.0  # residuals beyond this many robust sigma count less
MOST_SPANS = 20_000  # of a longer log every second, third ... is compared

Increments = Callable[[Array, Array], tuple[Array, Bools]]
"""Start and end times -> turns (rotation vectors, body axes) or moves (m, 3), and where they are known."""


class Track(NamedTuple):
    """Times (n,) s and attitudes (n, 4) or positions (n, 3) at them."""

    t: Array
    values: Array


def increments(track: Track) -> Increments:
    """Return what a track turns or moves between two times."""

    def between(start: Array, end: Array) -> tuple[Array, Bools]:
        a, b = look_up(start, track.t), look_up(end, track.t)
        known = np.zeros(start.size, dtype=np.bool_)
        rows, at_a, at_b = np.intersect1d(a.rows, b.rows, assume_unique=True, return_indices=True)
        known[rows] = True
        out = np.full((start.size, 3), np.nan)
        if track.values.shape[1] == 4:
            q = rotation.multiply(
                rotation.conjugate(attitudes(track.values, a)[at_a]), attitudes(track.values, b)[at_b]
            )
            out[rows] = rotation.log_quaternion(q)
        else:
            out[rows] = vectors(track.values, b)[at_b] - vectors(track.values, a)[at_a]
        return out, known

    return between


def fit_offset(est: Track, ref: Track, source: str) -> Offset | None:
    r"""Return the seconds to add to the stamps of the estimate; None where its rates do not match the reference's.

    .. math:: \min_{\tau,R}\sum_i|R\,d_{ref,i}-d_{est}(t_i-\tau)|^2

    Parameters
    ----------
    est, ref : times of both and attitudes or positions
    source : what is compared, for the record

    Notes
    -----
    ``d``: turns in body axes (moves in world axes) over the first of ``SPANS_S`` that is long enough for the
    reference's noise, at its own samples: the smooth estimate is interpolated, not the reference. ``R``: constant
    rotation between both axes. Gauss-Newton with Huber weights from the best lag of the rates' norms; sigma from
    blocks of ``BLOCK_S`` (sandwich), so that correlated residuals do not count as independent.
    """
    if ref.t.size < 3 or est.t.size < 3:
        return None
    for span in SPANS_S:
        tau, fit = _fit(est, ref, max(1, round(span / period(ref.t))))
        if fit.match >= LEAST_MATCH and fit.blocks >= LEAST_BLOCKS and abs(tau) <= 2.0 * SEARCH_S:
            return Offset(tau, fit.sigma, source, fit.span)
    return None


def _fit(est: Track, ref: Track, ahead: int) -> tuple[float, _Fit]:
    """Fit the offset to turns or moves over ``ahead`` samples of the reference."""
    start, end = ref.t[:-ahead], ref.t[ahead:]
    whole = end - start <= GAP_PERIODS * ahead * period(ref.t)
    thin = slice(None, None, 1 + start.size // MOST_SPANS)
    start, end = start[whole][thin], end[whole][thin]
    of_est, (d_ref, _) = increments(est), increments(ref)(start, end)
    tau, fit = _coarse(est, ref, ahead * period(ref.t)), NOTHING
    for _ in range(ROUNDS):
        fit = _linearised(of_est, d_ref, start, end, tau, min(period(est.t), SPANS_S[0]))
        tau += fit.step
        if abs(fit.step) < SETTLED_S:
            break
    return tau, fit


class _Fit(NamedTuple):
    step: float = 0.0
    sigma: float = 0.0
    match: float = 0.0
    blocks: int = 0
    span: float = 0.0


NOTHING = _Fit()


def _linearised(of_est: Increments, d_ref: Array, start: Array, end: Array, tau: float, h: float) -> _Fit:
    """Return one Gauss-Newton step of the offset, with its sigma, about ``tau``."""
    now, ok = of_est(start - tau, end - tau)
    later, ok_later = of_est(start - tau + h, end - tau + h)
    sooner, ok_sooner = of_est(start - tau - h, end - tau - h)
    ok &= ok_later & ok_sooner & np.isfinite(d_ref).all(axis=1)
    if not ok.any():
        return NOTHING
    d_est, d, slope = now[ok], d_ref[ok], (later[ok] - sooner[ok]) / (2.0 * h)
    power = float(np.sqrt(np.sum(d_est**2) * np.sum(d**2)))
    if power == 0.0 or float(np.sum(slope**2)) == 0.0:
        return NOTHING
    R = nearest_rotation(d_est.T @ d)
    residual = d @ R.T - d_est
    size = np.linalg.norm(residual, axis=1)
    limit = OUTLIER * MAD * float(np.median(size))
    weight = np.where(size <= limit, 1.0, limit / np.where(size > 0.0, size, 1.0))
    curvature = float(np.sum(weight[:, None] * slope**2))
    score = weight * np.einsum("ni,ni->n", slope, residual)
    step = -float(score.sum()) / curvature
    score += weight * np.sum(slope**2, axis=1) * step  # residuals after the step
    _, block = np.unique(np.floor(start[ok] / BLOCK_S), return_inverse=True)
    sums = np.bincount(block, score)
    count = int(sums.size)
    spread = float(np.sqrt(np.sum(sums**2) * count / max(count - 1, 1)))
    match = float(np.sum((d @ R.T) * d_est)) / power
    return _Fit(step, spread / curvature, match, count, float(start[ok][-1] - start[ok][0]))


def _coarse(est: Track, ref: Track, span: float) -> float:
    """Return the lag, of ``SEARCH_S`` at most, at which the norms of both rates correlate best; 0 where none does."""
    step = max(span, 0.02)
    grid = np.arange(max(est.t[0], ref.t[0]) - SEARCH_S, min(est.t[-1], ref.t[-1]) + SEARCH_S, step)
    if grid.size < 10:
        return 0.0
    sizes = []
    for track in (est, ref):
        d, known = increments(track)(grid, grid + step)
        size = np.where(known, np.linalg.norm(d, axis=1), 0.0)
        centred = np.where(known, size - (size[known].mean() if known.any() else 0.0), 0.0)
        sizes.append(centred)
    length = 1 << int(np.ceil(np.log2(2 * grid.size)))
    product = np.fft.rfft(sizes[1], length) * np.conj(np.fft.rfft(sizes[0], length))
    most = min(round(SEARCH_S / step), grid.size - 1)
    lags = np.arange(-most, most + 1)
    correlation = np.fft.irfft(product, length)[lags]
    best = int(np.argmax(correlation))
    centre = correlation[most]
    # a lag must beat no lag clearly: rates of a periodic motion match at each of its periods
    return float(lags[best] * step) if correlation[best] > max(1.1 * centre, 0.0) else 0.0
