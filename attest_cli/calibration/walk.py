r"""Exact likelihood of means of white noise plus a random walk, with regressors: one tridiagonal matrix.

A sample is :math:`z_i=b_i+v_i,\ b_{i+1}=b_i+w_i` with :math:`\mathrm{var}(v)=N^2/\Delta,\ \mathrm{var}(w)=K^2\Delta`.
Differences of the means of consecutive blocks, whatever their lengths and the gaps between them, have the covariance
:math:`N^2(A+\rho B)`, :math:`\rho=K^2/N^2`, tridiagonal because only neighbours share a block. For single samples
without gaps this is :math:`qI+R\,\mathrm{tridiag}(-1,2,-1)`, which the DST-I diagonalises; the factors of a tridiagonal
matrix give the same likelihood in O(n), and take the gaps between stops as well, where a drive shows its random walk.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..records import Array, Bools
from .rest import Blocks

GRID = 25  # ratios tried where nothing is known about the random walk
INSIDE_95 = 3.841458820694124  # chi-square of one degree of freedom, 95 %
TAIL = 12.0  # twice the log likelihood below the best at which its tail is left out: 3.5 sigma
TAIL_POINTS = 40


@dataclass(frozen=True, slots=True)
class Fit:
    """Generalised least squares at one ``ratio`` (K/N)^2, 1/s^2: ``value`` -2 ln L but for a constant, with N and the
    coefficients at their best; ``score`` its derivative by ln(ratio); ``beta`` (p,) and ``cov`` (p, p); ``N``; ``n``
    rows; ``trace`` of V^-1 dV/d ln(ratio).
    """

    ratio: float
    value: float
    score: float
    beta: Array
    cov: Array
    N: float
    n: int
    trace: float

    @property
    def walk(self) -> float:
        """Random walk density."""
        return math.sqrt(self.ratio) * self.N


@dataclass(frozen=True, slots=True)
class Walk:
    """Covariance of the differences, ``white + ratio walk``, each as diagonal and off-diagonal; ``rows``: which
    differences count; ``level``: the first row is the first mean itself, so that a constant can be fitted.
    """

    white: tuple[Array, Array]
    walk: tuple[Array, Array]
    rows: Bools
    level: bool

    def differences(self, x: Array) -> Array:
        """Return the rows of block means (n,) or (n, p)."""
        return np.concatenate([x[: int(self.level)], np.diff(x, axis=0)[self.rows]])

    def limits(self) -> tuple[float, float]:
        """Return ln(ratio) below which no record this long, and above which none of such blocks tells a ratio."""
        steps = self.walk[0]
        return math.log(1e-4 / float(steps.sum()) ** 2), math.log(1e4 / float(np.median(steps)) ** 2)

    def fit(self, ratio: float, z: Array, X: Array | None = None) -> Fit:
        r"""Fit rows ``z`` (n,) by the rows ``X`` (n, p) of regressors, at ``ratio`` = K^2/N^2.

        .. math:: -2\ln L=n\ln\hat N^2+\ln|V|,\quad V=A+\rho B,\quad n\hat N^2=r^TV^{-1}r,\quad
            \frac{d(-2\ln L)}{d\ln\rho}=\rho\,\mathrm{tr}(V^{-1}B)-\rho\,x^TBx/\hat N^2,\quad x=V^{-1}r
        """
        from scipy.linalg.lapack import dpttrf, dpttrs

        diagonal = self.white[0] + ratio * self.walk[0]
        off = self.white[1] + ratio * self.walk[1]
        pivot, lower, _ = dpttrf(diagonal, off)
        x, _ = dpttrs(pivot, lower, z)
        beta, cov, r = np.zeros(0), np.zeros((0, 0)), z
        if X is not None:
            solved, _ = dpttrs(pivot, lower, X)
            cov = np.linalg.inv(X.T @ solved)
            beta = cov @ (solved.T @ z)
            r, x = z - X @ beta, x - solved @ beta
        variance = float(r @ x) / len(z)
        from_end = dpttrf(diagonal[::-1], off[::-1])[0][::-1]
        inverse = 1.0 / (pivot + from_end - diagonal)  # diagonal of V^-1
        beside = -lower * inverse[1:]
        trace = ratio * float(inverse @ self.walk[0] + 2.0 * (beside @ self.walk[1]))
        pull = ratio * float((x * x) @ self.walk[0] + 2.0 * ((x[1:] * x[:-1]) @ self.walk[1])) / variance
        value = len(z) * math.log(variance) + float(np.log(pivot).sum())
        return Fit(ratio, value, trace - pull, beta, cov * variance, math.sqrt(variance), len(z), trace)


def build_walk(blocks: Blocks, *, level: bool, across: bool = True) -> Walk:
    r"""Return the covariance of the differences of block means.

    Of blocks of ``m`` samples and span :math:`\tau`, with the gap :math:`\delta` before (sums over samples, exact):
    :math:`A_{ii}=1/\tau_i+1/\tau_{i+1},\ A_{i,i+1}=-1/\tau_{i+1}`;
    :math:`B_{ii}=c_i+\delta_{i+1}+c_{i+1},\ c=\tau(m-1)(2m-1)/6m^2,\ B_{i,i+1}=\tau_{i+1}(m^2-1)/6m^2`.

    Parameters
    ----------
    level : keep the first mean as a row, so that a constant can be fitted and counts as a parameter
    across : count differences between stops; False where the mean differs from stop to stop (specific force)
    """
    m, span = blocks.count, blocks.span
    noise = 1.0 / span
    inside = span * (m - 1.0) * (2.0 * m - 1.0) / (6.0 * m**2)
    shared = span * (m**2 - 1.0) / (6.0 * m**2)
    rows = np.ones(len(m) - 1, dtype=np.bool_) if across else np.diff(blocks.stop) == 0
    kept = np.flatnonzero(rows)
    touch = np.diff(kept) == 1  # kept differences that share a block
    middle = kept[1:]
    white = (noise[:-1] + noise[1:])[kept], np.where(touch, -noise[middle], 0.0)
    walk = (inside[:-1] + blocks.gap[1:] + inside[1:])[kept], np.where(touch, shared[middle], 0.0)
    if level:
        white = np.append(noise[0], white[0]), np.append(-noise[0], white[1])
        walk = np.append(inside[0], walk[0]), np.append(shared[0], walk[1])
    return Walk(white, walk, rows, level)


def best(walk: Walk, z: Array, X: Array | None = None, near: float | None = None) -> Fit:
    """Return the fit at the most likely ratio; 0 where no random walk makes the record likelier.

    The score's change of sign nearest to the ratio ``near``, else to the best of a grid.
    """
    from scipy.optimize import brentq

    def fit(x: float) -> Fit:
        return walk.fit(math.exp(x), z, X)

    low, high = walk.limits()
    none = walk.fit(0.0, z, X)
    if near is None:
        grid = np.linspace(low, high, GRID).tolist()
        near = math.exp(min(grid, key=lambda x: fit(x).value))
    x = min(max(math.log(near), low), high) if near > 0.0 else low
    step = -0.5 if fit(x).score > 0.0 else 0.5
    ends = _bracket(lambda at: fit(at).score, x, step, (low, high))
    if ends is None:
        return min(none, fit(x), key=lambda f: f.value) if step > 0.0 else none
    found = fit(brentq(lambda at: fit(at).score, *ends, xtol=1e-12))
    return found if found.value < none.value else none


def walk_interval(walk: Walk, z: Array, found: Fit, inside: float = INSIDE_95) -> tuple[float, float]:
    """Return the least and largest K whose likelihood is near the best: twice its logarithm within ``inside`` (profile
    likelihood); 0 and infinity where nothing bounds it.
    """
    from scipy.optimize import brentq

    low, high = walk.limits()

    def excess(x: float) -> float:
        return walk.fit(math.exp(x), z).value - found.value - inside

    x = min(max(math.log(found.ratio), low), high) if found.ratio > 0.0 else low
    K = [0.0, math.inf]
    for side, step in enumerate((-0.5, 0.5)):
        ends = _bracket(excess, x, step, (low, high))
        if ends is not None:
            K[side] = walk.fit(math.exp(brentq(excess, *ends, xtol=5e-3)), z).walk
    return K[0], K[1]


def likely_walk(walk: Walk, z: Array, found: Fit) -> tuple[float, float]:
    """Return the mean and standard deviation of K over its likelihood.

    More than the likeliest K where a record cannot tell, and above 0 always: what is not seen to walk is not known to
    stand, and a smoother that follows with the likeliest K alone is too sure of itself.
    """
    _, top = walk_interval(walk, z, found, TAIL)
    top = top if math.isfinite(top) else walk.fit(math.exp(walk.limits()[1]), z).walk
    K = np.linspace(0.0, top, TAIL_POINTS)
    value = np.array([walk.fit((k / found.N) ** 2, z).value for k in K])
    weight = np.exp(-0.5 * (value - value.min()))
    weight /= weight.sum()
    mean = float(weight @ K)
    return mean, math.sqrt(float(weight @ (K - mean) ** 2))


def _bracket(
    f: Callable[[float], float], x: float, step: float, limits: tuple[float, float]
) -> tuple[float, float] | None:
    """Step from ``x``, ever further, until ``f`` changes sign; None where it does not within the limits."""
    below = f(x) < 0.0
    while (after := min(max(x + step, limits[0]), limits[1])) != x:
        if (f(after) < 0.0) != below:
            return min(x, after), max(x, after)
        x, step = after, 2.0 * step
    return None
