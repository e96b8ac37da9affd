"""Density and quantile of chi-square in closed form: importing scipy.stats costs more than all pages together."""

from __future__ import annotations

import math

import numpy as np

from ..records import Array


def density(x: Array, dof: int) -> Array:
    """Density at ``x`` > 0: ``x^(k/2-1) exp(-x/2) / (2^(k/2) Gamma(k/2))``."""
    half = 0.5 * dof
    return np.asarray(x ** (half - 1.0) * np.exp(-0.5 * x) / (2.0**half * math.gamma(half)))


def probability(x: float, dof: int) -> float:
    """Distribution function, from k = 1 or 2 by ``F_(k+2) = F_k - (x/2)^(k/2) exp(-x/2) / Gamma(k/2 + 1)``."""
    odd = dof % 2 == 1
    found = math.erf(math.sqrt(0.5 * x)) if odd else 1.0 - math.exp(-0.5 * x)
    for k in range(1 if odd else 2, dof, 2):
        found -= (0.5 * x) ** (0.5 * k) * math.exp(-0.5 * x) / math.gamma(0.5 * k + 1.0)
    return found


def quantile(share: float, dof: int) -> float:
    """Where the distribution function reaches ``share``, by bisection."""
    low, high = 0.0, dof + 20.0 * math.sqrt(2.0 * dof)
    for _ in range(80):
        half = 0.5 * (low + high)
        low, high = (half, high) if probability(half, dof) < share else (low, half)
    return 0.5 * (low + high)
