"""Rotations: Hamilton quaternions (w, x, y, z), rotation vectors and matrices, over any leading axes.

``Exp`` maps a rotation vector (rad) to a rotation, ``Log`` back; ``R(q)`` takes body to navigation vectors.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import wraps

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ROUNDING = 1e-17
SMALL = 0.3  # rad: below it the closed forms lose digits and their series are exact to rounding


ROWS = 8192  # rows handled together: what is made on the way stays in cache


def in_cache(function: Callable[..., Array]) -> Callable[..., Array]:
    """Run a function of rows ``(n, k)`` over a few thousand of them at a time: twice as fast on long arrays."""

    @wraps(function)
    def run(*arrays: Array) -> Array:
        n = max((len(a) for a in arrays if a.ndim == 2), default=0)
        if n <= ROWS or any(a.ndim > 2 for a in arrays):
            return function(*arrays)
        whole = [len(a) != n for a in arrays]  # broadcast over the rows
        out = None
        for lo in range(0, n, ROWS):
            part = function(*(a if w else a[lo : lo + ROWS] for a, w in zip(arrays, whole, strict=True)))
            out = np.empty((n, *part.shape[1:])) if out is None else out
            out[lo : lo + ROWS] = part
        assert out is not None
        return out

    return run


def series(x2: Array, first: float, ratios: tuple[tuple[int, int], ...]) -> Array:
    """Evaluate the nested alternating series ``first * (1 - x2/(a b) (1 - x2/(c d) (...)))`` for ``x2 = x**2``.

    Terms that cannot reach rounding at the largest ``x2`` are left out: at the rate of an IMU two or three remain.
    """
    largest, size, count = float(np.max(x2, initial=0.0)), 1.0, 0
    while count < len(ratios) and size > ROUNDING:
        size *= largest / (ratios[count][0] * ratios[count][1])
        count += 1
    total = np.ones_like(x2)
    for a, b in reversed(ratios[:count]):
        total = 1.0 - x2 / (a * b) * total
    return first * total


SINC = ((2, 3), (4, 5), (6, 7), (8, 9), (10, 11), (12, 13))
VERSINE = ((3, 4), (5, 6), (7, 8), (9, 10), (11, 12), (13, 14))
SLIP = ((4, 5), (6, 7), (8, 9), (10, 11), (12, 13), (14, 15))


def all_small(x2: Array) -> bool:
    """Return whether the series alone serve every entry of ``x2``: nearly always, at the rate of an IMU."""
    return bool(np.max(x2, initial=0.0) < SMALL * SMALL)


def sine_ratios(x2: Array) -> tuple[Array, Array, Array]:
    r"""Return :math:`\sin x/x`, :math:`(1-\cos x)/x^2` and :math:`(x-\sin x)/x^3` of ``x2 = x**2``, exact near zero.

    Each is accurate to a few units of rounding: series below 0.3 rad, closed form above.
    """
    near = series(x2, 1.0, SINC), series(x2, 0.5, VERSINE), series(x2, 1 / 6, SLIP)
    if all_small(x2):
        return near
    small = x2 < SMALL * SMALL
    safe = np.where(small, 1.0, x2)
    x = np.sqrt(safe)
    sine, half = np.sin(x), np.sin(0.5 * x)
    far = sine / x, 2.0 * half * half / safe, (x - sine) / (safe * x)
    a, b, c = (np.where(small, n, f) for n, f in zip(near, far, strict=True))
    return a, b, c


def skew(v: Array) -> Array:
    """Return ``[v x]`` (..., 3, 3) of ``v`` (..., 3), so that ``skew(v) @ u = cross(v, u)``."""
    m = np.zeros((*v.shape, 3))
    m[..., 0, 1], m[..., 0, 2], m[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    m[..., 1, 0], m[..., 2, 0], m[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return m


@in_cache
def exp_quaternion(v: Array) -> Array:
    """Return the unit quaternion (..., 4) of the rotation vector ``v`` (..., 3), rad."""
    x2 = 0.25 * np.einsum("...i,...i->...", v, v)
    q = np.empty((*v.shape[:-1], 4))
    if all_small(x2):
        ratio = series(x2, 1.0, SINC)
        q[..., 0] = np.sqrt(1.0 - ratio * ratio * x2)
    else:
        ratio = sine_ratios(x2)[0]
        q[..., 0] = np.cos(np.sqrt(x2))
    q[..., 1:] = (0.5 * ratio)[..., None] * v
    return q


@in_cache
def log_quaternion(q: Array) -> Array:
    """Return the rotation vector (..., 3), norm at most pi, of the unit quaternion ``q`` (..., 4)."""
    q = np.where(q[..., :1] < 0.0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1)
    angle = 2.0 * np.arctan2(sine, q[..., 0])
    factor = np.where(sine > 1e-12, angle / np.where(sine > 1e-12, sine, 1.0), 2.0)
    return factor[..., None] * q[..., 1:]


@in_cache
def multiply(p: Array, q: Array) -> Array:
    """Return the Hamilton product ``p q``: ``R(p q) = R(p) R(q)``."""
    if p.ndim == 1 and q.ndim == 2:  # one rotation before many, or after them: a matrix product
        return q @ multiply(p, np.eye(4)[:, None])[:, 0]
    if q.ndim == 1 and p.ndim == 2:
        return p @ multiply(np.eye(4)[:, None], q)[:, 0]
    pw, px, py, pz = (p[..., i] for i in range(4))
    qw, qx, qy, qz = (q[..., i] for i in range(4))
    out = np.empty(np.broadcast_shapes(p.shape, q.shape))
    out[..., 0] = pw * qw - px * qx - py * qy - pz * qz
    out[..., 1] = pw * qx + px * qw + py * qz - pz * qy
    out[..., 2] = pw * qy - px * qz + py * qw + pz * qx
    out[..., 3] = pw * qz + px * qy - py * qx + pz * qw
    return out


def conjugate(q: Array) -> Array:
    """Return the inverse rotation of a unit quaternion (..., 4)."""
    return np.asarray(q * np.array([1.0, -1.0, -1.0, -1.0]))


@in_cache
def normalise(q: Array) -> Array:
    """Return ``q / |q|``."""
    return np.asarray(q / np.sqrt(np.einsum("...i,...i->...", q, q))[..., None])


@in_cache
def matrix(q: Array) -> Array:
    """Return ``R`` (..., 3, 3) of the unit quaternion ``q`` (..., 4): ``v_n = R @ v_b`` for ``q_nb``."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    m = np.empty((*q.shape[:-1], 3, 3))
    m[..., 0, 0] = 1 - 2 * (y * y + z * z)
    m[..., 1, 1] = 1 - 2 * (x * x + z * z)
    m[..., 2, 2] = 1 - 2 * (x * x + y * y)
    m[..., 0, 1], m[..., 1, 0] = 2 * (x * y - w * z), 2 * (x * y + w * z)
    m[..., 0, 2], m[..., 2, 0] = 2 * (x * z + w * y), 2 * (x * z - w * y)
    m[..., 1, 2], m[..., 2, 1] = 2 * (y * z - w * x), 2 * (y * z + w * x)
    return m


@in_cache
def rotate(q: Array, v: Array) -> Array:
    """Return ``R(q) v`` (..., 3) without making the matrices: ``v + 2 w (u x v) + 2 u x (u x v)``."""
    u = q[..., 1:]
    twice = 2.0 * cross(u, v)
    return np.asarray(v + q[..., :1] * twice + cross(u, twice))


@in_cache
def cross(a: Array, b: Array) -> Array:
    """Return the cross product (..., 3); several times faster than ``numpy.cross`` on long arrays."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    out[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    out[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    out[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return out


def from_matrix(m: Array) -> Array:
    """Return the unit quaternion (..., 4), w >= 0, of rotation matrices (..., 3, 3).

    Source: Bar-Itzhack, J. Guid. Control Dyn. 23(6), 2000: the dominant eigenvector of K, here read off the largest of
    the four squared components, which never divides by a small number.
    """
    d = np.einsum("...ii->...i", m)
    trace = np.sum(d, axis=-1)
    squares = np.stack([1 + trace, *(1 + 2 * d[..., i] - trace for i in range(3))], axis=-1)  # 4 q_i^2
    off = {
        (0, 1): m[..., 2, 1] - m[..., 1, 2],
        (0, 2): m[..., 0, 2] - m[..., 2, 0],
        (0, 3): m[..., 1, 0] - m[..., 0, 1],
    }
    off |= {
        (1, 2): m[..., 0, 1] + m[..., 1, 0],
        (1, 3): m[..., 0, 2] + m[..., 2, 0],
        (2, 3): m[..., 1, 2] + m[..., 2, 1],
    }
    rows = np.stack(
        [
            np.stack([squares[..., i] if i == j else off[min(i, j), max(i, j)] for j in range(4)], axis=-1)
            for i in range(4)
        ],
        axis=-2,
    )
    best = np.argmax(squares, axis=-1)
    q = normalise(np.take_along_axis(rows, best[..., None, None], axis=-2)[..., 0, :])
    return np.where(q[..., :1] < 0.0, -q, q)


def right_jacobian(v: Array) -> Array:
    r"""Return :math:`J_r(v)=I-\frac{1-\cos x}{x^2}[v\times]+\frac{x-\sin x}{x^3}[v\times]^2`, ``x = |v|``.

    ``Exp(v + e) = Exp(v) Exp(J_r(v) e)`` to first order in ``e``; :math:`\int_0^1 Exp(-sv)\,ds = J_r(v)`.
    """
    if v.ndim == 1:
        return _right_jacobian_of_one(*v.tolist())
    _, b, c = sine_ratios(np.sum(v * v, axis=-1))
    s = skew(v)
    return np.eye(3) - b[..., None, None] * s + c[..., None, None] * (s @ s)


def _right_jacobian_of_one(x: float, y: float, z: float) -> Array:
    """Return the right Jacobian of one vector: in plain floats, ten times faster than as an array of one."""
    x2 = x * x + y * y + z * z
    if x2 < 1e-4:
        b, c = 0.5 - x2 / 24 * (1 - x2 / 30), 1 / 6 - x2 / 120 * (1 - x2 / 42)
    else:
        angle = math.sqrt(x2)
        b, c = 2 * math.sin(0.5 * angle) ** 2 / x2, (angle - math.sin(angle)) / (x2 * angle)
    return np.array(
        [
            [1 - c * (y * y + z * z), b * z + c * x * y, -b * y + c * x * z],
            [-b * z + c * x * y, 1 - c * (x * x + z * z), b * x + c * y * z],
            [b * y + c * x * z, -b * x + c * y * z, 1 - c * (x * x + y * y)],
        ]
    )


def turned_matrix(q: Array, v: Array) -> Array:
    """Return ``R(q Exp(v))`` (3, 3) of one quaternion (4,) and one rotation vector (3,), in plain floats."""
    vx, vy, vz = v.tolist()
    half = 0.5 * math.sqrt(vx * vx + vy * vy + vz * vz)
    k, c = (0.5 * math.sin(half) / half if half > 1e-9 else 0.5), math.cos(half)
    w, x, y, z = _product(q.tolist(), (c, k * vx, k * vy, k * vz))
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _product(p: Sequence[float], q: Sequence[float]) -> tuple[float, float, float, float]:
    w, x, y, z = p
    a, b, c, d = q
    return (
        w * a - x * b - y * c - z * d,
        w * b + x * a + y * d - z * c,
        w * c - x * d + y * a + z * b,
        w * d + x * c - y * b + z * a,
    )


def inverse_right_jacobian(v: Array) -> Array:
    r"""Return :math:`J_r(v)^{-1}=I+\frac12[v\times]+\frac{1-\frac{x}{2}\cot\frac x2}{x^2}[v\times]^2`, ``|v| < 2
    pi``.
    """
    x2 = np.sum(v * v, axis=-1)
    a, b, _ = sine_ratios(x2)
    small = x2 < 1e-4
    factor = np.where(small, 1 / 12 + x2 / 720, (1.0 - 0.5 * a / b) / np.where(small, 1.0, x2))
    s = skew(v)
    return np.eye(3) + 0.5 * s + factor[..., None, None] * (s @ s)


def continuous(q: Array) -> Array:
    """Return the quaternions (n, 4) with signs chosen so that neighbours have a positive scalar product; the first
    has w >= 0.
    """
    return q * signs(q)[:, None]


def signs(q: Array) -> Array:
    """Return the signs (n,) that make quaternions (n, 4) continuous; see ``continuous``."""
    flips = np.ones(len(q))
    flips[0] = 1.0 if q[0, 0] >= 0.0 else -1.0
    flips[1:][np.einsum("ki,ki->k", q[1:], q[:-1]) < 0.0] = -1.0
    return np.asarray(np.cumprod(flips, out=flips))


@in_cache
def roll_pitch_yaw(q: Array) -> Array:
    """Return fixed-axis x-y-z angles (..., 3), rad (REP-103): ``R = Rz(yaw) Ry(pitch) Rx(roll)``."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.stack([roll, pitch, yaw], axis=-1)


def wrap(angle: Array) -> Array:
    """Return the angle, rad, brought into [-pi, pi)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def unwrapped(angle: Array) -> Array:
    """Return angles (n,), rad, without jumps: whole turns are added so that each is within pi of the one before."""
    turns = np.rint(np.diff(angle) / (2 * np.pi))
    if not turns.any():
        return angle
    return angle - 2 * np.pi * np.concatenate([[0.0], np.cumsum(turns)])


def chain(turns: Array, start: Array | None = None) -> Array:
    """Return the running products ``start * turns[0] * ... * turns[k]`` (n, 4); ``start`` defaults to no rotation."""
    now = (1.0, 0.0, 0.0, 0.0) if start is None else tuple(start.tolist())
    out = []
    for turn in turns.tolist():
        now = _product(now, turn)
        out.append(now)
    return normalise(np.array(out).reshape(-1, 4))
