r"""How strong a random walk stands beside a fitted curve: restricted likelihood, for the curve takes up much of it."""

from __future__ import annotations

import math

import numpy as np

from ..records import Array
from .rest import Blocks
from .walk import Walk, build_walk

SEARCHED, POINTS = 25, 60  # of the grids
UNLIKELY = 18.0  # difference of -2 ln L from which a K counts for nothing


def walk_beside(blocks: Blocks, z: Array, X: Array) -> float:
    r"""Return the mean of K over its restricted likelihood, rad/s^2/sqrt(Hz), regressors ``X`` (n, p) fitted with it.

    .. math:: -2\ln L_R=(n-p)\ln\hat N^2+\ln|V|+\ln|X^TV^{-1}X|,\quad (n-p)\hat N^2=r^TV^{-1}r

    Notes
    -----
    The residual of a curve has lost the slow part of a random walk to the curve: K of that residual alone is too small,
    and a filter that counts with it too sure (Patterson & Thompson 1971). The mean, not the likeliest: what was not
    seen to walk is not known to stand.
    """
    walk = build_walk(blocks, level=True)
    dz, dX = walk.differences(z), walk.differences(X)
    ratios = np.exp(np.linspace(*walk.limits(), SEARCHED))
    coarse = np.array([_restricted(walk, ratio, dz, dX) for ratio in ratios.tolist()])
    likely = coarse[:, 0] - coarse[:, 0].min() < UNLIKELY
    N, top = float(coarse[coarse[:, 0].argmin(), 1]), math.sqrt(float(ratios[likely].max()))
    root = np.linspace(0.0, top, POINTS)
    value = np.array([_restricted(walk, r * r, dz, dX)[0] for r in root.tolist()])
    weight = np.exp(-0.5 * (value - value.min()))
    return N * float(weight @ root / weight.sum())


def _restricted(walk: Walk, ratio: float, dz: Array, dX: Array) -> tuple[float, float]:
    """Return -2 ln of the restricted likelihood at a ratio, and N."""
    fit, p = walk.fit(ratio, dz, dX), dX.shape[1]
    variance = fit.N**2 * fit.n / (fit.n - p)
    _, log_det = np.linalg.slogdet(fit.cov / fit.N**2)
    value = fit.value - fit.n * math.log(fit.N**2) + (fit.n - p) * math.log(variance) - float(log_det)
    return value, math.sqrt(variance)
