r"""Where up is, from gyro and accelerometer: the quasi-linear observers of Rehbinder and Hu in sampled time.

Symbols: state ``x`` = up in body axes (third column of the paper's R), with ``[x, b]`` also the gyro bias; turn
:math:`\phi`, ``Phi`` = :math:`\exp(-[\phi-bT]_\times)`, ``y`` = f/g, ``w = y - x``, ``Q`` for the paper's Q_1 T and
``R`` for its Q_2 / T.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..maths import rotation, sequential
from ..records import Array

Method = Literal["pseudo-linear", "projected", "geometric"]
Weigh = Callable[[int, float], float]
"""Sample, ``|y - x|`` predicted -> factor :math:`1+\\varphi` on the accelerometer's noise (1.43)."""
Rests = Mapping[int, tuple[Array, float]]
"""Sample -> mean rate of the gyro at rest (3,), rad/s, and its variance."""
NO_RESTS: Rests = {}
EYE = np.eye(3)
FLOOR = 1e-14  # rad^2 per step: keeps covariances regular along the vertical
LOST = 1e-9  # a state shorter than this points nowhere (1.22)
ANTIPODE = 1e-15  # sine below which two unit vectors span no plane
SURE = 1.0 - 1e-12  # no finite turn follows a gain of one
ONE = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True, slots=True)
class Turns:
    r"""What the gyro says of the steps between n samples.

    ``turn_b`` (n - 1, 3) rad; ``dt`` (n - 1,) s over which a bias acts (0: it does not); ``Q`` (n - 1, 3, 3) rad^2
    noise of the turn; ``walk`` (n - 1,) variance of the bias step, (rad/s)^2, ``drift`` (n - 1, 3) what is known of it.
    ``across``: the noise turns the vertical, :math:`[x]_\times Q[x]_\times^T`; else it is added to it, as in the paper.
    """

    turn_b: Array
    dt: Array
    Q: Array
    walk: Array
    drift: Array
    across: bool = True


def observe(
    turns: Turns, y: Array, R: Array, x0: Array, P0: Array, method: Method = "pseudo-linear",
    weigh: Weigh | None = None, rests: Rests = NO_RESTS,
) -> sequential.Pass:  # fmt: skip
    r"""Run an observer of the vertical over n samples.

    .. math:: z^-=\Phi z,\ P^-=\Phi P\Phi^T+Q,\ K=P^-(P^-+R)^{-1};\qquad
        z\leftarrow z^-+K(y-z^-)\ (1.23),\qquad \hat x\leftarrow\frac{\hat x^-+e}{\|\cdot\|},\
        e=(I-\hat x^-\hat x^{-T})K(y-\hat x^-)\ (1.28)

    or, geometric (1.42), by the exact turn of :func:`towards` with :math:`lT=-\ln(1-k)`, k the mean gain across x.

    Parameters
    ----------
    turns : the gyro's steps
    y : (n, 3) specific force over gravity, body axes
    R : (n, 3, 3) its noise
    x0, P0 : (3,), (3, 3), or with the gyro bias (rad/s) (6,), (6, 6); before the first sample's measurement
    method : the pseudo-linear state is no unit vector: :func:`up` makes it one, outside of the loop
    weigh : factor on ``R`` from the predicted residual (a causal rule of the acceleration noise)
    rests : samples that measure the gyro's bias instead

    Notes
    -----
    With Q and R multiples of I, P stays one too: the paper's scalar gain (Corollary 1) needs no code of its own.
    Source: Rehbinder & Hu, eqs 1.18-1.28; sampled data: the project's note, section 2.2, bias 2.4.
    """
    biased, s = len(x0) == 6, len(x0)
    H, H_bias = np.eye(3, s), np.eye(3, s, s - 3)

    def measure(k: int, x: Array, _P: Array) -> tuple[Array, Array, Array]:
        if k in rests:
            rate, variance = rests[k]
            return rate - x[3:], H_bias, variance * EYE
        residual = y[k] - x[:3]
        if weigh is None:
            return residual, H, R[k]
        w = y[k] - x[:3] / max(_norm(x), LOST)
        return residual, H, R[k] * weigh(k, math.sqrt(w @ w))

    predict = _predict_biased(turns) if biased else _predict(turns)
    return sequential.run(len(y), x0, P0, 3, predict, measure, _correct(method, y, rests))


def _predict(turns: Turns) -> sequential.Predict:
    """Turn the vertical with the gyro; noise across the vertical half-way."""
    Phi = rotation.matrix(rotation.exp_quaternion(-turns.turn_b))
    floor = FLOOR * EYE

    def predict(k: int, x: Array) -> tuple[Array, Array, Array]:
        new = Phi[k] @ x
        if not turns.across:
            return new, Phi[k], turns.Q[k]
        A = _skew(0.5 * (new + x))
        return new, Phi[k], A @ turns.Q[k] @ A.T + floor

    return predict


def _predict_biased(turns: Turns) -> sequential.Predict:
    r"""Turn the vertical with the gyro less its bias: :math:`\partial x/\partial b=-[\bar x]_\times T`, x half-way."""
    eye, floor, lower = np.eye(6), FLOOR * EYE, np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])

    def predict(k: int, x: Array) -> tuple[Array, Array, Array]:
        F, Q = eye.copy(), turns.walk[k] * lower
        F[:3, :3] = rotation.turned_matrix(ONE, turns.dt[k] * x[3:] - turns.turn_b[k])
        new = x.copy()
        new[3:] += turns.drift[k]
        new[:3] = F[:3, :3] @ x[:3]
        A = _skew(0.5 * (new[:3] + x[:3]))
        F[:3, 3:] = -turns.dt[k] * A
        Q[:3, :3] = A @ turns.Q[k] @ A.T + floor if turns.across else turns.Q[k]
        return new, F, Q

    return predict


def _correct(method: Method, y: Array, rests: Rests) -> sequential.Correct | None:
    """Return how an update moves the state: as it is (None), along the sphere, or by a turn towards y."""
    if method == "pseudo-linear":
        return None

    def projected(_k: int, x: Array, step: Array, _K: Array) -> Array:
        new, u = x + step, x[:3]
        new[:3] -= u * (u @ step[:3])
        new[:3] /= _norm(new)
        return new

    def geometric(k: int, x: Array, step: Array, K: Array) -> Array:
        if k in rests:
            return projected(k, x, step, K)
        new, u = x + step, x[:3]
        gain = 0.5 * float(K[0, 0] + K[1, 1] + K[2, 2] - u @ K[:3] @ u)
        new[:3] = towards(u, y[k], -math.log1p(-min(gain, SURE)))
        return new

    return projected if method == "projected" else geometric


def towards(x: Array, y: Array, gain: float) -> Array:
    r"""Return the unit vector ``x`` (3,) turned towards ``y`` (3,): the observer's flow over one step, y held.

    .. math:: \tan\tfrac\alpha2\leftarrow\tan\tfrac\alpha2\,e^{-lT\|y\|},\qquad\text{gain}=lT

    It never overshoots. At the antipode, the law's only other rest, ``x`` stays. Source: eqs 1.42 and 1.31.
    """
    size = _norm(y)
    if size < LOST:
        return x
    unit = y / size
    cosine = float(x @ unit)
    across = unit - cosine * x
    sine = _norm(across)
    if sine < ANTIPODE:
        return x
    # half-angle from whichever of 1 - cos and 1 + cos keeps its digits
    tangent = sine / (1.0 + cosine) if cosine > 0.0 else (1.0 - cosine) / sine
    turn = 2.0 * (math.atan(tangent) - math.atan(tangent * math.exp(-gain * size)))
    new = math.cos(turn) * x + math.sin(turn) / sine * across
    return np.asarray(new / _norm(new))


def law(xi0: float, area: Array) -> Array:
    r"""Return the error :math:`\xi=1-x^T\hat x` after the gain's integral ``area`` (n,): Theorem 1.

    .. math:: \xi(t)=\frac{\xi_0e^{-2\int l}}{1-\frac{\xi_0}2+\frac{\xi_0}2e^{-2\int l}}\qquad(1.31)
    """
    fallen = 0.5 * xi0 * np.exp(-2.0 * area)
    return np.asarray(2.0 * fallen / (1.0 - 0.5 * xi0 + fallen))


def up(x: Array) -> tuple[Array, Array]:
    r"""Return the unit vector of the states ``x`` (n, 3 or 6), (1.21), and its Jacobian (n, 3, s):
    :math:`(I-uu^T)/\|z\|`.

    Where z vanishes the direction before it is kept (1.22).
    """
    length = np.linalg.norm(x[:, :3], axis=1)
    known = np.where(length >= LOST, np.arange(len(x)), 0)
    last = np.maximum.accumulate(known)
    size = np.maximum(length[last], LOST)
    u = x[last, :3] / size[:, None]
    slope = np.zeros((len(x), 3, x.shape[1]))
    slope[:, :, :3] = (np.eye(3) - u[:, :, None] * u[:, None, :]) / size[:, None, None]
    return u, slope


def _norm(v: Array) -> float:
    """Return the length of the first three components."""
    return math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


def _skew(v: Array) -> Array:
    """Return ``[v x]`` of one vector: from plain floats, several times faster than as an array of one."""
    x, y, z = v.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
