"""Do the claimed sigmas hold: NEES and coverage."""

from __future__ import annotations

import math

import numpy as np

from ..maths import consistency
from ..records import Array
from .records import Coverage, Nees

BAND = 0.95
CLAIMED = np.concatenate([np.arange(0.02, 0.98, 0.02), [0.98, 0.99, 0.997]])
"""Levels at which the share found is told."""
NO_MEMORY = 0.1
DOUBT = 0.01
TOLERATED = 1.25  # a sigma an eighth too small is no matter
MOST_DEGREES = 4000


def band_width(share: float = BAND) -> float:
    """Return how many sigma hold this share of a Gaussian error on one axis."""
    return math.sqrt(consistency.upper_quantile(1, 1.0 - share))


def nees(error: Array, P: Array) -> Nees:
    r"""Return the mean of :math:`e^\top P^{-1}e` of errors (n, k) and the share in the 95 % region; expected ``k``.

    Errors whose covariance is unknown or singular are left out. Neighbouring errors are hardly independent: the mean is
    exact, its chi-square interval is far too narrow.
    """
    dof = error.shape[1]
    size = np.einsum("nii->ni", P)
    with np.errstate(invalid="ignore"):
        known = np.isfinite(error).all(axis=1) & np.isfinite(P).all(axis=(1, 2)) & (size > 0.0).all(axis=1)
    root = np.sqrt(size[known])
    correlation = P[known] / (root[:, :, None] * root[:, None, :])
    regular = np.linalg.det(correlation) > 1e-12
    scaled = (error[known] / root)[regular]
    squares = np.einsum("ni,ni->n", scaled, np.linalg.solve(correlation[regular], scaled[..., None])[..., 0])
    if squares.size == 0:
        return Nees(math.nan, dof, math.nan, 0)
    inside = np.mean(squares <= consistency.upper_quantile(dof, 1.0 - BAND))
    return Nees(float(squares.mean()), dof, float(inside), int(squares.size))


def coverage(error: Array, sigma: Array) -> Coverage | None:
    """Return the shares of errors (n,) inside the bands of their ``sigma`` (n,); None without one."""
    known = np.isfinite(error) & np.isfinite(sigma) & (sigma > 0.0)
    ratio = np.abs(error[known]) / sigma[known]
    if ratio.size == 0:
        return None
    widths = np.array([band_width(float(level)) for level in CLAIMED])
    found = np.searchsorted(np.sort(ratio), widths, side="right") / ratio.size
    one, two, three = (float(np.mean(ratio <= k)) for k in (1.0, 2.0, 3.0))
    count = independent(error[known] / sigma[known])
    return Coverage((one, two, three), float(np.mean(ratio <= band_width())), found, float(np.mean(ratio**2)), count)


def independent(ratio: Array) -> float:
    r"""Return how many independent values tell as much of the mean square as the series ``ratio`` (n,) does.

    .. math:: n\,/\,(1+2\sum_{k=1}^{m}(1-k/n)\,\rho_k^2)

    ``rho``: autocorrelation about zero, for an error that does not average out is one error only; the sum ends where
    it falls below ``NO_MEMORY``. Bartlett's formula for the variance of a sum of squares.
    """
    n = ratio.size
    spectrum = np.fft.rfft(ratio, 1 << int(np.ceil(np.log2(2 * n))))
    biased = np.fft.irfft(np.abs(spectrum) ** 2)[:n]
    if biased[0] <= 0.0:
        return 1.0
    share = 1.0 - np.arange(n) / n
    rho = biased / biased[0] / share
    below = np.flatnonzero(rho < NO_MEMORY)
    last = int(below[0]) if below.size else n
    return float(n / (1.0 + 2.0 * np.sum(share[1:last] * rho[1:last] ** 2)))


def holds(found: Coverage) -> bool:
    """False where the mean square of error over sigma passes ``TOLERATED`` and its 99 % limit for so many independent
    errors.
    """
    degrees = max(1, min(int(found.independent), MOST_DEGREES))
    return found.mean_square <= max(TOLERATED, consistency.upper_quantile(degrees, DOUBT) / degrees)
