"""Chi-square distribution of squared normalised errors (NEES, NIS): gates, thresholds, bands; scatter by the median.

Written out because importing scipy.special costs a fifth of a second at every start; tested against it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Status = Literal["PASS", "WARN", "FAIL"]
MAD = 1.4826  # median absolute deviation to sigma, of a normal distribution
BAND = 1e-4  # two-sided probability outside which a mean NIS is not chance
SLIGHT = 1.25  # a mean NIS this far beyond its band is sure, but of no consequence
FAR_OFF = 4.0  # mean NIS over its degrees of freedom: sigma cannot be trusted
MANY_REJECTED, MOST_REJECTED = 0.01, 0.3  # where a third is refused, who is wrong cannot be told
TOGETHER = 10  # readings whose errors are summed: one that lasts stands out
FEW = 5  # measurements of a sensor that say little about its noise
MOST_DEGREES = 4000  # from there on the band of the mean is far narrower than what is slight


def density(x: Array, dof: int) -> Array:
    """Return the density at ``x`` > 0: ``x^(k/2-1) exp(-x/2) / (2^(k/2) Gamma(k/2))``, ``k = dof``."""
    half = 0.5 * dof
    return np.asarray(np.exp((half - 1.0) * np.log(x) - 0.5 * x - half * math.log(2.0) - math.lgamma(half)))


def survival(x: float, dof: int) -> float:
    r"""Return the probability of more than ``x``.

    .. math:: \sum_{j} e^{-x/2}\frac{(x/2)^j}{\Gamma(j+1)},\quad j=0,1,\dots<k/2 \text{ (even)},\
        \operatorname{erfc}\sqrt{x/2}+\sum_{j=1/2,3/2,\dots<k/2} \text{ (odd)}

    Only positive terms: small tails keep their digits. Abramowitz & Stegun 26.4.4-5.
    """
    if x <= 0.0:
        return 1.0
    half = 0.5 * x
    odd = dof % 2
    j = np.arange(dof // 2) + 0.5 * odd
    log_gamma = np.concatenate([[math.lgamma(1.0 + 0.5 * odd)], np.log(j[1:])]).cumsum()[: len(j)]
    terms = float(np.exp(j * math.log(half) - half - log_gamma).sum()) if len(j) else 0.0
    return terms + (math.erfc(math.sqrt(half)) if odd else 0.0)


@lru_cache(maxsize=4096)
def upper_quantile(dof: int, probability: float) -> float:
    """Return the value that a chi-square of ``dof`` degrees of freedom passes with ``probability`` (by bisection)."""
    low, high = 0.0, dof + 10.0 * math.sqrt(2.0 * dof) + 40.0
    while survival(high, dof) > probability:
        high *= 2.0
    while high - low > 4e-16 * high:
        middle = 0.5 * (low + high)
        if middle in {low, high}:
            break
        low, high = (middle, high) if survival(middle, dof) > probability else (low, middle)
    return 0.5 * (low + high)


def mean_nis(mean: float, used: int, dof: int) -> Literal["smaller", "fits", "larger"]:
    """Return whether a mean NIS of ``used`` measurements of ``dof`` degrees of freedom is what their noise claims."""
    degrees = max(1, min(used * dof, MOST_DEGREES))
    low, high = (upper_quantile(degrees, p) * dof / degrees for p in (1.0 - 0.5 * BAND, 0.5 * BAND))
    return "smaller" if mean < low / SLIGHT else "larger" if mean > high * SLIGHT else "fits"


def agree(apart: Sequence[float]) -> bool:
    """Return whether separations (m,) in sigmas are those of two passes whose sigma holds: their mean square is judged
    as that of innovations is, and so is the largest of them.
    """
    squares = np.square(apart)
    if not squares.size:
        return True
    by_chance = squares.size * survival(float(squares.max()) / SLIGHT, 1) > BAND
    return by_chance and mean_nis(float(squares.mean()), squares.size, 1) != "larger"


def lasting(z: Array) -> tuple[float, int]:
    r"""Return the mean square of what ``TOGETHER`` successive normalised innovations ``z`` (m, d) sum up to, and of how
    many such sums.

    .. math:: s_b=\frac1{\sqrt m}\sum_{k\in b}z_k,\quad E\,s_b^Ts_b=d

    An error that lasts from reading to reading makes it larger than :math:`d`, however wide the stated sigma.
    """
    blocks = len(z) // TOGETHER
    if blocks == 0:
        return 0.0, 0
    sums = z[len(z) - blocks * TOGETHER :].reshape(blocks, TOGETHER, -1).sum(axis=1) / math.sqrt(TOGETHER)
    return float(np.mean(np.sum(sums**2, axis=1))), blocks


def noise_status(mean: float, used: int, dof: int, few: int = FEW) -> Status:
    """Return the verdict on a mean NIS of more than a ``few``: noise claimed too large only makes sigma careful."""
    if used < few or mean_nis(mean, used, dof) != "larger":
        return "PASS"
    return "FAIL" if mean > FAR_OFF * dof else "WARN"


def rejection_status(rejected: int, count: int) -> Status:
    """Return the verdict on how many measurements of a sensor were rejected."""
    if rejected > MOST_REJECTED * count and count >= FEW:
        return "FAIL"
    return "WARN" if rejected > MANY_REJECTED * count else "PASS"
