"""Hard and soft iron of a magnetometer: the ellipsoid that its readings lie on, where it was turned about enough."""

from __future__ import annotations

import math

import numpy as np

from ..records import Array
from .least_squares import minimise
from .records import Magnetometer

MOST = 5000  # readings: more are thinned out
FEWEST = 100
CELLS = 100  # of the sphere
COVERAGE = 0.5  # share of the sphere that must be seen: a drive on hills sees a tenth
ROUNDEST = 2.5  # longest over shortest axis; a fit with more has not seen enough, or sits in iron
FARTHEST = 2.0  # centre from the mean reading, over their rms distance from it: beyond, a patch of the sphere was seen
FLATTEST = 1e-6  # smallest over largest of the quadric: beyond, a plane or a line was seen
LOOSE = 0.05  # offset's sigma over the field that is too much: 3 deg of heading
ADVICE = "turn the sensor slowly about all its axes, away from iron"


def fit_magnetometer(field: Array) -> tuple[Magnetometer | None, str]:
    r"""Fit the ellipsoid of raw readings (n, 3) tesla; None and why where too little of it was seen.

    Algebraic least squares of :math:`x^TAx+2b^Tx+c=0` (of unit length), then geometric refinement of
    :math:`\sum(\|S(x-o)\|-1)^2` over a symmetric S. ``matrix`` is S with determinant 1: it turns nothing, and
    leaves the field's strength as the ellipsoid's volume gives it.
    """
    good = field[np.all(np.isfinite(field), axis=1)]
    if len(good) < FEWEST:
        return None, _refused(f"{len(good)} readings only")
    x = good[:: math.ceil(len(good) / MOST)]
    centre = x.mean(axis=0)
    scale = float(np.sqrt(np.mean(np.sum((x - centre) ** 2, axis=1))))
    start = _algebraic((x - centre) / scale) if scale > 1e-3 * float(np.linalg.norm(centre)) else None
    if start is None:
        return None, _refused("its readings fix no ellipsoid")
    u = (x - centre) / scale

    def residual(p: Array) -> Array:
        return np.asarray(np.linalg.norm((u - p[:3]) @ _symmetric(p[3:]), axis=1) - 1.0)

    found = minimise(residual, start)
    offset, S = found.x[:3], _symmetric(found.x[3:])
    axes = np.linalg.eigvalsh(S)
    if axes.min() * ROUNDEST < axes.max() or float(np.linalg.norm(offset)) > FARTHEST:
        return None, _refused("its readings fix no ellipsoid")
    seen = coverage((u - offset) @ S)
    if seen < COVERAGE:
        return None, _refused(f"it saw {100 * seen:.0f} % of all directions")
    rms = float(np.sqrt(np.mean(found.residual**2)))
    loose = rms * math.sqrt(float(np.trace(S @ found.covariance()[:3, :3] @ S)))
    if loose > LOOSE:
        return None, _refused(f"its readings leave the centre open by {100 * loose:.0f} % of the field")
    mean = float(np.linalg.det(S)) ** (-1.0 / 3.0)
    return Magnetometer(S * mean, centre + scale * offset, mean * scale, rms, seen), ""


def _refused(why: str) -> str:
    return f"magnetometer not calibrated: {why}; {ADVICE}"


def coverage(directions: Array) -> float:
    """Return the share of the sphere's equal cells (about Fibonacci points) that ``directions`` (n, 3) fall into."""
    k = np.arange(CELLS) + 0.5
    z, turn = 1.0 - 2.0 * k / CELLS, k * math.pi * (3.0 - math.sqrt(5.0))
    ring = np.sqrt(1.0 - z**2)
    points = np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)
    return len(np.unique(np.argmax(directions @ points.T, axis=1))) / CELLS


def _symmetric(p: Array) -> Array:
    return np.array([[p[0], p[3], p[4]], [p[3], p[1], p[5]], [p[4], p[5], p[2]]])


def _algebraic(u: Array) -> Array | None:
    """Return offset (3,) and symmetric root (6,) of the least-squares quadric, None where it is no ellipsoid."""
    x, y, z = u.T
    D = np.column_stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, 2 * x, 2 * y, 2 * z, np.ones(len(u))])
    p = np.linalg.eigh(D.T @ D)[1][:, 0]
    A, b = _symmetric(p[:6]), p[6:9]
    values, vectors = np.linalg.eigh(A)
    if np.abs(values).min() < FLATTEST * np.abs(values).max():
        return None
    offset = -np.linalg.solve(A, b)
    values = values / (float(offset @ A @ offset) - p[9])
    if not np.all(values > 0.0):
        return None
    S = vectors @ np.diag(np.sqrt(values)) @ vectors.T
    return np.concatenate([offset, np.diag(S), [S[0, 1], S[0, 2], S[1, 2]]])
