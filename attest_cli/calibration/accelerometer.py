"""Bias, scale and misalignment of the accelerometer from the stops' mean specific force: its norm is gravity in all."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..records import Array
from .least_squares import minimise

ATTITUDES = 12  # nine unknowns; with fewer attitudes one odd stop decides
APART_DEG = 15.0  # attitudes nearer than this are one
LOOSEST_DEG = 0.1  # tilt that the parameters may leave: 2 mg, what a calibrated MEMS accelerometer has anyway
LARGEST = 0.2  # scale error, misalignment, bias over gravity: more is no accelerometer's error
ON_ALL_SIDES = "rest it on all sides and edges"


@dataclass(frozen=True, slots=True)
class Fitted:
    """``a = matrix (raw + bias)``; ``residual`` m/s^2 rms of the norm; ``tilt_sigma`` rad that the parameters leave."""

    matrix: Array
    bias: Array
    residual: float
    tilt_sigma: float


def attitudes(force: Array) -> int:
    """Return how many directions of ``force`` (m, 3) are at least 15 deg from each other, taken in time order."""
    found = np.empty((0, 3))
    for u in force / np.linalg.norm(force, axis=1, keepdims=True):
        if np.all(found @ u < math.cos(math.radians(APART_DEG))):
            found = np.vstack([found, u])
    return len(found)


def fit_accelerometer(force: Array, sigma: Array, gravity: float) -> tuple[Fitted | None, str]:
    r"""Fit bias, scale and misalignment to the mean force (m, 3) of stops; None and why where they do not show.

    .. math:: \min\sum_i\Big(\frac{\|TK(\tilde a_i+b)\|^2-g^2}{2g\sigma_i}\Big)^2

    T upper triangular with a unit diagonal, K diagonal (Tedaldi, Pretto & Menegatti 2014, eqs 1-10). Residuals are
    normalised, so stops of different lengths count by what they know.

    Parameters
    ----------
    sigma : (m,) noise of a component of each mean, m/s^2
    gravity : m/s^2; the scale is relative to it
    """
    count = attitudes(force)
    if count < ATTITUDES:
        why = f"attitudes at rest {APART_DEG:.0f} deg apart: {count} of the {ATTITUDES} needed"
        return None, f"accelerometer not calibrated: {why}; {ON_ALL_SIDES}"
    found = minimise(lambda p: _residual(p, force, sigma, gravity), np.zeros(9))
    p = found.x
    spread = max(1.0, float(found.residual @ found.residual) / (len(force) - len(p)))
    nominal = _jacobian(np.zeros(9), force, sigma, gravity)
    loose = max(_tilt_sigma(x, _covariance(J) * spread, gravity) for x, J in ((p, found.J), (np.zeros(9), nominal)))
    if math.degrees(loose) > LOOSEST_DEG or max(*np.abs(p[:3]) / gravity, *np.abs(p[3:])) > LARGEST:
        why = f"its attitudes leave {min(math.degrees(loose), 90.0):.2g} deg of tilt, {LOOSEST_DEG} are allowed"
        return None, f"accelerometer not calibrated: {why}; {ON_ALL_SIDES}"
    a = (force + p[:3]) @ _matrix(p).T
    rms = float(np.sqrt(np.mean((np.linalg.norm(a, axis=1) - gravity) ** 2)))
    return Fitted(_matrix(p), p[:3], rms, _tilt_sigma(p, _covariance(found.J) * spread, gravity)), ""


def _matrix(p: Array) -> Array:
    """Return T K of the parameters: three biases, three scales less 1, three misalignments."""
    T = np.array([[1.0, p[6], p[7]], [0.0, 1.0, p[8]], [0.0, 0.0, 1.0]])
    return np.asarray(T * (1.0 + p[3:6]))


def _residual(p: Array, force: Array, sigma: Array, gravity: float) -> Array:
    a = (force + p[:3]) @ _matrix(p).T
    return np.asarray((np.sum(a**2, axis=1) - gravity**2) / (2.0 * gravity * sigma))


def _by_parameters(p: Array, v: Array) -> Array:
    """Return the Jacobian (3, 9) of ``M v``, v = raw + bias, by the parameters."""
    M, k = _matrix(p), 1.0 + p[3:6]
    by_turn = np.array([[k[1] * v[1], k[2] * v[2], 0.0], [0.0, 0.0, k[2] * v[2]], [0.0, 0.0, 0.0]])
    return np.hstack([M, M / k * v, by_turn])


def _jacobian(p: Array, force: Array, sigma: Array, gravity: float) -> Array:
    """Return the Jacobian (m, 9) of the residual."""
    M = _matrix(p)
    rows = [(M @ v) @ _by_parameters(p, v) / (gravity * s) for v, s in zip(force + p[:3], sigma, strict=True)]
    return np.array(rows)


def _covariance(J: Array) -> Array:
    """Return the covariance of the parameters; what does not show at all gets a very large one."""
    return np.asarray(np.linalg.pinv(J.T @ J + 1e-6 * np.eye(J.shape[1]), hermitian=True))


def _tilt_sigma(p: Array, cov: Array, gravity: float) -> float:
    r"""Return the rms tilt error per axis that the parameters leave, over gravity along the six axes: the part of
    :math:`da=J\,dp` across gravity turns the vertical.
    """
    M, total = _matrix(p), 0.0
    for u in np.concatenate([np.eye(3), -np.eye(3)]):
        across = (np.eye(3) - np.outer(u, u)) @ _by_parameters(p, np.linalg.solve(M, gravity * u)) / gravity
        total += float(np.trace(across @ cov @ across.T)) / 2.0
    return math.sqrt(total / 6.0)
