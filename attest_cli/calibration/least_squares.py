"""Nonlinear least squares of a few parameters: scipy's, with what is used of it as plain arrays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..records import Array

STEPS_PER_PARAMETER = 100


@dataclass(frozen=True, slots=True)
class Minimum:
    """Where a sum of squares is least: parameters ``x`` (p,), ``residual`` (m,), Jacobian ``J`` (m, p)."""

    x: Array
    residual: Array
    J: Array

    def covariance(self) -> Array:
        """Return the covariance (p, p) of the parameters for residuals of unit variance."""
        return np.asarray(np.linalg.inv(self.J.T @ self.J))


def minimise(residual: Callable[[Array], Array], start: Array) -> Minimum:
    """Minimise the sum of squares of ``residual`` from ``start`` (Levenberg-Marquardt, MINPACK)."""
    from scipy.optimize import least_squares

    found = least_squares(
        residual, start, method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14, max_nfev=STEPS_PER_PARAMETER * len(start)
    )
    return Minimum(np.asarray(found.x), np.asarray(found.fun), np.asarray(found.jac, dtype=np.float64))
