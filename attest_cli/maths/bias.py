"""The curves of a gyro's bias: what a calibration fits and what a drive is corrected by."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
REFERENCE_C = 25.0  # deg C at which the temperature polynomial is its constant


def exponential(t: Array, T: float) -> Array:
    """Return the regressors of C1 and C2 (n, 2) (Barshan & Durrant-Whyte 1994, eq 1)."""
    return np.stack([-np.expm1(-t / T), np.ones_like(t)], axis=1)


def polynomial(temperature: Array, degree: int) -> Array:
    """Return the regressors (n, degree + 1) of powers of the temperature above 25 deg C."""
    return np.vander(temperature - REFERENCE_C, degree + 1, increasing=True)


def curve(name: str, values: Sequence[float] | Array, t: Array, temperature: Array | None = None) -> Array:
    r"""Return the bias (n,) rad/s of a model at ``t`` (n,) s since its epoch.

    constant C; ramp :math:`C+s\,t`; exponential :math:`C_1(1-e^{-t/T})+C_2`; temperature
    :math:`c_0+c_1x+c_2x^2`, x = deg C above 25; random-walk: its bias at the end of the record.
    """
    v = np.asarray(values, dtype=np.float64)
    if name == "exponential":
        return np.asarray(exponential(t, float(v[2])) @ v[:2])
    if name == "ramp":
        return np.asarray(v[0] + v[1] * t)
    if name == "temperature":
        assert temperature is not None, "a temperature model needs temperatures"
        return np.asarray(polynomial(temperature, len(v) - 1) @ v)
    return np.full(len(t), float(v[0]))


def gradient(name: str, values: Sequence[float] | Array, t: Array, temperature: Array | None = None) -> Array:
    """Return the derivatives (n, p) of a curve by its values; a random walk's by its level."""
    one = np.ones_like(t)
    if name == "exponential":
        rise, _, T = (float(v) for v in values)
        return np.column_stack([exponential(t, T), -rise * np.exp(-t / T) * t / T**2])
    if name == "ramp":
        return np.stack([one, t], axis=1)
    if name == "temperature":
        assert temperature is not None, "a temperature model needs temperatures"
        return polynomial(temperature, len(values) - 1)
    return one[:, None]
