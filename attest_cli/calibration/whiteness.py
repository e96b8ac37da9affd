"""Whether a residual is white: autocorrelation against its band, and Ljung-Box, over pieces without gaps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..records import Array
from .records import Whiteness

MOST_LAGS = 200
LAG_SHARE = 4  # lags up to a quarter of a piece
BAND = 1.96
OUTSIDE = 0.05
UNLIKELY = 0.01


def judge_whiteness(pieces: Sequence[Array], lag_s: float) -> Whiteness:
    r"""Test a residual for whiteness; lags cross no gap.

    .. math:: \hat\rho_k=\frac{\sum r_ir_{i+k}}{\hat\sigma^2N_k},\quad |\hat\rho_k|\le\frac{1.96}{\sqrt{N_k}},\quad
        Q=\sum_k\frac{N_k(N_k+2)}{n_k}\hat\rho_k^2\sim\chi^2_M

    of ``n_k`` pairs in the pieces of at least 4 k samples, ``N_k`` in all, the mean of everything removed (one piece:
    the usual N - k and N); M = min(N/4, 200) of the longest. White: both pass, the first unless as many outside have a
    probability below 1 %, the second with more than 1 %.

    Parameters
    ----------
    pieces : residual (n,) of each gap-free piece, of one sigma
    lag_s : seconds per lag
    """
    from scipy.special import bdtrc, chdtrc

    everything = np.concatenate(pieces)
    mean, variance = float(everything.mean()), float(everything.var())
    lags = min(max(len(x) for x in pieces) // LAG_SHARE, MOST_LAGS)
    if lags == 0 or variance == 0.0:
        return Whiteness(np.zeros(0), np.zeros(0), 1.0, 0.0, 1.0, variance > 0.0, lag_s)
    sums, pairs, samples = np.zeros(lags), np.zeros(lags), np.zeros(lags)
    for x in pieces:
        most = min(len(x) // LAG_SHARE, lags)
        sums[:most] += lagged_products(x - mean, most)
        pairs[:most] += len(x) - np.arange(1, most + 1)
        samples[:most] += len(x)
    rho, band = sums / (variance * samples), BAND / np.sqrt(samples)
    outside = int(np.sum(np.abs(rho) > band))
    chance = float(bdtrc(outside - 1, lags, OUTSIDE)) if outside else 1.0
    statistic = float(np.sum(samples * (samples + 2.0) / pairs * rho**2))
    probability = float(chdtrc(lags, statistic))
    white = chance >= UNLIKELY and probability > UNLIKELY
    return Whiteness(rho, band, 1.0 - outside / lags, statistic, probability, bool(white), lag_s)


def lagged_products(x: Array, lags: int) -> Array:
    """Return the sums of ``x_i x_{i+k}`` (lags,), k = 1 ... lags."""
    size = 1 << (len(x) + lags - 1).bit_length()
    spectrum = np.fft.rfft(x, size)
    return np.fft.irfft(spectrum * spectrum.conj(), size)[1 : lags + 1]
