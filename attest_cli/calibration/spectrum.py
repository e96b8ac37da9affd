r"""How white single samples are: the spectrum of the differenced record, by the DST-I that diagonalises it.

For white noise plus a random walk,
:math:`y_j=\sqrt{\tfrac{2}{n+1}}\sum_i\sin\frac{\pi ij}{n+1}(z_{i+1}-z_i)` are independent with variance
:math:`K^2\Delta+\frac{N^2}{\Delta}s_j,\ s_j=2(1-\cos\frac{\pi j}{n+1})`, one for each frequency
:math:`j/2(n+1)\Delta`. A sensor's own low-pass takes the high ones off; those below its corner still show N, without
the bias that means of neighbouring blocks have from the noise they share.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..records import Array

CHUNK = 8191  # differences transformed at a time: n + 1 a power of 2, and frequencies far below a hertz
LOWEST_HZ = 1.0  # a sensor's own low-pass is looked for above this
FEWEST = 30  # ordinates of an octave
DIFFERS = 3.0  # sigma by which two octaves must differ to be told apart
SAME = 0.01  # and variances that agree to this are the same


def ordinates(values: Sequence[Array]) -> tuple[Array, Array, Array]:
    """Return frequency over Nyquist's, ``s`` and ``y^2`` (m,) of the differences of all pieces (n,), in chunks."""
    from scipy.fft import dst

    parts = []
    for x in values:
        steps = np.diff(x)
        for first in range(0, len(steps), CHUNK):
            y = dst(steps[first : first + CHUNK], type=1, norm="ortho")
            share = np.arange(1, len(y) + 1) / (len(y) + 1.0)
            parts.append((share, 2.0 * (1.0 - np.cos(np.pi * share)), y * y))
    share, s, power = (np.concatenate(column) for column in zip(*parts, strict=True))
    return share, s, power


def white_samples(axes: Sequence[Sequence[Array]], period: float) -> tuple[int, float]:
    """Return how many samples to average for white noise, and the density at one sample over that.

    The spectrum's octaves from the highest down to 1 Hz: white from the one on that agrees with all below it, to what
    chance allows; a further octave is left out, as what a low-pass takes off there hides in the chance.

    Parameters
    ----------
    axes : per axis, the pieces (n,) at rest
    """
    found = [ordinates(values) for values in axes]
    share = np.concatenate([f[0] for f in found])
    level = np.concatenate([f[2] / f[1] / float(np.mean(f[2] / f[1])) for f in found])
    octave = np.floor(-np.log2(share) + 1e-9).astype(np.int64)
    count = max(1, math.ceil(math.log2(max(0.5 / period / LOWEST_HZ, 2.0))))
    bands = [level[octave == k] for k in range(count)]
    bands = [band for band in bands if len(band) >= FEWEST] or [level]
    mean = [float(band.mean()) for band in bands]
    k = 0
    while not all(_same(mean[k], mean[j], len(bands[k]), len(bands[j])) for j in range(k + 1, len(bands))):
        k += 1
    samples = 2 ** (k + 1) if k else 1
    below = level[share <= 1.0 / samples]
    return samples, math.sqrt(float(level.mean()) / float(below.mean())) if k and len(below) else 1.0


def _same(a: float, b: float, n_a: int, n_b: int) -> bool:
    """Return whether two variances agree, but for chance and for what does not matter."""
    return abs(math.log(a / b)) < max(SAME, DIFFERS * math.sqrt(2.0 / n_a + 2.0 / n_b))


def band_density(values: Sequence[Array], period: float, samples: int, K: float) -> tuple[float, int]:
    """Return N of one axis from the frequencies that means of ``samples`` keep, the random walk ``K`` taken off, and
    the number of ordinates it is of.
    """
    share, s, power = ordinates(values)
    low = share <= max(1.0 / samples, float(share.min()))
    ratio = 0.0
    for _ in range(3):  # the weight of an ordinate depends on N a little where the walk shows
        N2 = period * float(np.mean(power[low] / (s[low] + ratio)))
        ratio = (K * period) ** 2 / N2
    return math.sqrt(N2), int(low.sum())
