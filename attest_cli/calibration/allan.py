"""Overlapping Allan deviation over pieces without gaps, with a chi-square band."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..records import Array, Ints
from .records import Allan

PER_DECADE = 10
TAIL = 0.025  # outside a 95 % interval, each side


def averaging_times(longest: int, per_decade: int = PER_DECADE) -> Ints:
    """Return log-spaced counts of samples to average, up to half the longest piece."""
    top = max(1, longest // 2)
    return np.unique(np.round(np.geomspace(1, top, 1 + round(per_decade * np.log10(top)))).astype(np.int64))


def allan_deviation(
    values: Sequence[Array], period: float, m: Ints | None = None, walk_ratio: float = 0.0
) -> Allan:  # fmt: skip
    r"""Return the overlapping Allan deviation of rates, terms of all pieces pooled; none crosses a gap.

    .. math:: \sigma^2(m\tau_0)=\frac{1}{2(m\tau_0)^2n}\sum(\theta_{k+2m}-2\theta_{k+m}+\theta_k)^2

    with :math:`\theta` the integral from a leading 0. The 95 % band is chi-square of the exact equivalent degrees of
    freedom for white noise plus a random walk of ``walk_ratio`` = (K/N)^2, 1/s^2 (see ``equivalent_dof``).

    Parameters
    ----------
    values : (n,) each, rates of one axis
    m : (k,) samples to average; None: log-spaced to half the longest piece
    """
    from scipy.special import chdtri

    m = averaging_times(max(len(x) for x in values)) if m is None else m
    angles = [np.concatenate([[0.0], np.cumsum(x - x.mean())]) for x in values]  # a mean would cost digits
    squares, terms = np.zeros(len(m)), np.zeros(len(m), dtype=np.int64)
    dof = np.zeros(len(m))
    for k, width in enumerate(m.tolist()):
        counts = [len(a) - 2 * width for a in angles]
        for a, count in zip(angles, counts, strict=True):
            if count > 0:
                second = a[2 * width :] - 2.0 * a[width:-width] + a[: -2 * width]
                squares[k] += float(second @ second)
                terms[k] += count
        dof[k] = equivalent_dof(np.array([c for c in counts if c > 0]), width, walk_ratio * (width * period) ** 2)
    deviation = np.sqrt(squares / (2.0 * m.astype(float) ** 2 * terms))
    low, high = (deviation * np.sqrt(dof / chdtri(dof, tail)) for tail in (TAIL, 1.0 - TAIL))
    return Allan(m.astype(np.float64) * period, deviation, low, high, terms.astype(np.float64))


def equivalent_dof(terms: Ints, m: int, walk: float) -> float:
    r"""Return the equivalent degrees of freedom of a mean of squares of ``terms`` overlapping differences per piece.

    .. math:: \nu=\frac{2\,E^2}{\mathrm{var}}=\frac{n^2r_0^2}{\sum_p\sum_{|j|<2m}(n_p-|j|)\,r_j^2},\quad
        r(u)=2\Lambda(u)-\Lambda(u-1)-\Lambda(u+1)+w\,(\Lambda\star\Lambda)(u),\ u=j/m

    with :math:`\Lambda` the unit triangle and ``walk`` :math:`w=(K\tau/N)^2`: exact for Gaussian noise.
    """
    j = np.arange(min(2 * m, int(terms.max())), dtype=np.float64)
    r = _autocovariance(j / m, walk)
    longest_first = np.sort(terms)[::-1].astype(float)
    longer = np.searchsorted(-longest_first, -j, side="left")  # pieces with more than j terms
    total = np.concatenate([[0.0], np.cumsum(longest_first)])[longer] - longer * j
    weight = np.where(j == 0.0, 1.0, 2.0) * total
    return float(longest_first.sum() ** 2 * r[0] ** 2 / (weight @ r**2))


def _autocovariance(u: Array, walk: float) -> Array:
    """Return the autocovariance of the difference of neighbouring means at ``u`` averaging times: white plus walk."""

    def triangle(x: Array) -> Array:
        return np.asarray(np.maximum(0.0, 1.0 - np.abs(x)))

    white = 2.0 * triangle(u) - triangle(u - 1.0) - triangle(u + 1.0)
    spline = np.where(u < 1.0, 2.0 / 3.0 - u**2 + 0.5 * u**3, np.maximum(0.0, 2.0 - u) ** 3 / 6.0)
    return np.asarray(white + walk * spline)
