r"""Propagation of attitude, bias and their error covariance between nodes (Roumeliotis et al. 1999, section 4.2.1).

Symbols: paper :math:`\Theta,\Psi,\Phi,Q` of the error state ``[dtheta_b, dbias]``; :math:`W=-[\omega\times]`.
Blocks are kept components first, ``(3, 3, n)``, so that every operation runs over many intervals at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from . import rotation
from .rotation import SMALL, all_small, series, sine_ratios

Array = NDArray[np.float64]
QUARTIC = ((5, 6), (7, 8), (9, 10), (11, 12), (13, 14))
QUINTIC = ((6, 7), (8, 9), (10, 11), (12, 13), (14, 15))
BLOCK = 4096  # intervals handled together: temporaries stay in cache


def _mm(a: Array, b: Array) -> Array:
    """Matrix product of component-first blocks (3, 3, n)."""
    return np.asarray(np.einsum("ijn,jkn->ikn", a, b))


def _transpose(a: Array) -> Array:
    return a.swapaxes(0, 1)


def _skew(v: Array) -> Array:
    zero = np.zeros_like(v[0])
    return np.array([[zero, -v[2], v[1]], [v[2], zero, -v[0]], [-v[1], v[0], zero]])


def _add_identity(a: Array, scalar: Array) -> Array:
    for i in range(3):
        a[i, i] += scalar
    return a


def _noise_ratios(x2: Array) -> tuple[Array, Array]:
    r"""Return :math:`(x^2/2+\cos x-1)/x^4` and :math:`(x^3/3+2\sin x-2x)/x^5`, exact near zero."""
    near = series(x2, 1 / 24, QUARTIC), series(x2, 1 / 60, QUINTIC)
    if all_small(x2):
        return near
    small = x2 < SMALL * SMALL
    safe = np.where(small, 1.0, x2)
    x = np.sqrt(safe)
    half = np.sin(0.5 * x)
    far = (0.5 * safe - 2 * half * half) / safe**2, (safe * x / 3 + 2 * np.sin(x) - 2 * x) / (safe**2 * x)
    return np.where(small, near[0], far[0]), np.where(small, near[1], far[1])


def _blocks(rate: Array, dt: Array) -> tuple[Array, Array, Array, Array]:
    r"""Return :math:`\Theta`, :math:`\Psi` and, per unit :math:`N_w`, :math:`Q_{12}` and :math:`Q_{11}`, all (3, 3, n).

    ``rate`` (3, n) rad/s constant over ``dt`` (n,) s. Checked against 50-digit Van Loan integrals (vector v2).
    """
    v = rate * dt
    w = -_skew(v)  # W dt
    x2 = np.sum(v**2, axis=0)
    ww = _add_identity(v[:, None] * v, -x2)
    a, b, c = sine_ratios(x2)
    d, e = _noise_ratios(x2)
    one = np.ones_like(dt)
    dt2 = dt * dt
    theta = _add_identity(a * w + b * ww, one)
    psi = _add_identity(dt * b * w + dt * c * ww, dt)
    q12 = _add_identity(-dt2 * c * w - dt2 * d * ww, -0.5 * dt2)
    q11 = _add_identity(dt2 * dt * e * ww, dt2 * dt / 3)
    return theta, psi, q12, q11


def assemble(
    theta: Array, psi: Array, q11: Array, q12: Array, span: Array, n_r: float | Array, n_w: float
) -> tuple[Array, Array]:
    """Return ``Phi``, ``Q`` (n, 6, 6) from component-first blocks (``q11``, ``q12`` per unit bias-walk density)."""
    n = span.shape[0]
    phi, q = np.zeros((n, 6, 6)), np.zeros((n, 6, 6))
    phi[:, :3, :3], phi[:, :3, 3:] = np.moveaxis(theta, -1, 0), -np.moveaxis(psi, -1, 0)
    q[:, :3, :3], q[:, :3, 3:] = n_w * np.moveaxis(q11, -1, 0), n_w * np.moveaxis(q12, -1, 0)
    q[:, 3:, :3] = q[:, :3, 3:].swapaxes(1, 2)
    for i in range(3):
        phi[:, 3 + i, 3 + i] = 1.0
        q[:, i, i] += n_r * span
        q[:, 3 + i, 3 + i] = n_w * span
    return phi, 0.5 * (q + q.swapaxes(1, 2))


def transition(rate: Array, dt: Array, n_r: float, n_w: float) -> tuple[Array, Array]:
    r"""Return :math:`\Phi` and :math:`Q` (n, 6, 6) for a constant rate over each interval.

    .. math:: \Phi=\begin{bmatrix}\Theta&-\Psi\\0&I\end{bmatrix},\quad
        \Theta=e^{W\Delta t},\ \Psi=\int_0^{\Delta t}e^{Ws}ds

    Parameters
    ----------
    rate : (n, 3) bias-free body rate, rad/s
    dt : (n,) s
    n_r : gyro noise density squared, (rad/s)^2/Hz
    n_w : bias random-walk density squared, (rad/s^2)^2/Hz

    Notes
    -----
    Source: paper eqs 22-24 with the errata of the project's note; Q is not in the paper (exact integral, section 1
    there).
    """
    theta, psi, q12, q11 = _blocks(np.ascontiguousarray(rate.T), dt)
    return assemble(theta, psi, q11, q12, dt, n_r, n_w)


@rotation.in_cache
def step_vectors(rate0: Array, rate1: Array, dt: Array) -> Array:
    r"""Return the rotation vectors :math:`\bar\omega\Delta t+\frac{\Delta t^2}{12}\omega_0\times\omega_1` (n, 3) of
    single steps.

    Fourth order for a rate that is linear within the step (the paper's braces, made exactly unit).
    """
    return np.asarray(0.5 * (rate0 + rate1) * dt[:, None] + dt[:, None] ** 2 / 12 * rotation.cross(rate0, rate1))


@dataclass(frozen=True, slots=True)
class Steps:
    """IMU steps grouped by node interval.

    ``dt`` (s,), ``rate0``/``rate1`` (s, 3) gyro output at the start and the end of each step (bias not removed),
    ``first`` (m + 1,): interval ``i`` owns steps ``first[i] .. first[i + 1]``.
    """

    dt: Array
    rate0: Array
    rate1: Array
    first: NDArray[np.int64]

    @property
    def count(self) -> NDArray[np.int64]:
        """Steps in each interval (m,)."""
        return np.diff(self.first)

    def part(self, lo: int, hi: int) -> Steps:
        """Return the steps of the intervals ``lo .. hi``."""
        a, b = self.first[lo], self.first[hi]
        return Steps(self.dt[a:b], self.rate0[a:b], self.rate1[a:b], self.first[lo : hi + 1] - a)


@dataclass(frozen=True, slots=True)
class Increments:
    """Preintegrated intervals at reference biases.

    ``dq`` (m, 4) relative rotation, ``psi`` (m, 3, 3) with ``dq(bias) = dq Exp(-psi (bias - bias_ref))``,
    ``Phi``, ``Q`` (m, 6, 6), ``span`` (m,) s, ``bias_ref`` (m, 3) rad/s.
    """

    dq: Array
    psi: Array
    Phi: Array
    Q: Array
    span: Array
    bias_ref: Array

    def at(self, bias: Array, lo: int, hi: int) -> tuple[Array, Array]:
        """Return relative rotations (hi - lo, 4) and ``Phi`` (hi - lo, 6, 6) of intervals ``lo .. hi`` at ``bias``,
        to first order in its change from ``bias_ref``.
        """
        small = rotation.exp_quaternion(-np.einsum("kij,kj->ki", self.psi[lo:hi], bias - self.bias_ref[lo:hi]))
        Phi = self.Phi[lo:hi].copy()
        Phi[:, :3, :3] = rotation.matrix(small).swapaxes(1, 2) @ Phi[:, :3, :3]
        return rotation.multiply(self.dq[lo:hi], small), Phi


def preintegrate(
    steps: Steps, bias_ref: Array, n_r: float | Array, n_w: float, held: NDArray[np.bool_] | None = None
) -> Increments:
    """Compose the IMU steps of every node interval: relative rotation, bias Jacobian, ``Phi`` and ``Q``, exactly.

    Parameters
    ----------
    steps : the IMU, grouped by interval (m intervals; an interval without steps gives the identity and no noise)
    bias_ref : (m, 3) rad/s, the gyro bias removed in each interval
    n_r : one for all, or one per interval (m,); n_r, n_w as in :func:`transition`
    held : (m,) intervals that are not composed, for somebody else knows better

    Notes
    -----
    With ``A_j`` the single-step matrices, ``Phi = A_L ... A_1`` and ``Q`` accumulates as ``A_j Q A_j' + Q_j``. White
    gyro noise is isotropic, so its part is ``n_r span I`` whatever the rotation.
    """
    m = bias_ref.shape[0]
    dq = np.zeros((m, 4))
    theta, psi, q12, q11 = (np.zeros((3, 3, m)) for _ in range(4))
    count = steps.count if held is None else np.where(held, 0, steps.count)
    order = np.argsort(-count, kind="stable")  # long intervals first: the active ones are always a prefix
    for lo in range(0, m, BLOCK):
        rows = order[lo : lo + BLOCK]
        dq[rows], theta[..., rows], psi[..., rows], q12[..., rows], q11[..., rows] = _compose(
            steps, rows, count[rows], bias_ref[rows]
        )
    ends = np.concatenate([[0.0], np.cumsum(steps.dt)])
    span = ends[steps.first[1:]] - ends[steps.first[:-1]]
    phi, q = assemble(theta, psi, q11, q12, span, n_r, n_w)
    return Increments(rotation.normalise(dq), np.moveaxis(psi, -1, 0).copy(), phi, q, span, bias_ref)


def _compose(
    steps: Steps, rows: NDArray[np.int64], count: NDArray[np.int64], bias: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Run over the first ``count`` steps (falling) of the intervals ``rows``, side by side."""
    first, n = steps.first[rows], rows.size
    dq = np.zeros((n, 4))
    dq[:, 0] = 1.0
    psi, q12, q11 = (np.zeros((3, 3, n)) for _ in range(3))
    theta = _add_identity(np.zeros((3, 3, n)), np.ones(n))
    span = np.zeros(n)
    for k in range(int(count.max(initial=0))):
        a = int(np.searchsorted(-count, -k, side="left"))  # intervals that still have a step k
        at = first[:a] + k
        dt, w0, w1 = steps.dt[at], steps.rate0[at] - bias[:a], steps.rate1[at] - bias[:a]
        vector = step_vectors(w0, w1, dt)
        dq[:a] = rotation.multiply(dq[:a], rotation.exp_quaternion(vector))
        th, ps, s12, s11 = _blocks(np.ascontiguousarray((0.5 * (w0 + w1)).T), dt)
        carried = _mm(th, q12[..., :a])
        cross = _mm(carried, _transpose(ps))
        grown = _mm(_mm(th, q11[..., :a]), _transpose(th))
        grown -= cross + _transpose(cross)
        s11 += span[:a] * _mm(ps, _transpose(ps))
        np.add(grown, s11, out=q11[..., :a])
        q12[..., :a] = carried - span[:a] * ps + s12
        psi[..., :a] = _mm(th, psi[..., :a]) + ps
        theta[..., :a] = _mm(th, theta[..., :a])
        span[:a] += dt
    return dq, theta, psi, q12, q11


def run_steps(steps: Steps, q_start: Array, bias: Array) -> Array:
    """Re-propagate every interval at full rate: attitude (s, 4) at the end of each step.

    Parameters
    ----------
    q_start : (m, 4) attitude at the start of each interval
    bias : (m, 3) gyro bias in each interval, rad/s
    """
    drift = np.repeat(bias, steps.count, axis=0)
    vectors = step_vectors(steps.rate0 - drift, steps.rate1 - drift, steps.dt)
    turn = rotation.exp_quaternion(vectors)
    out = np.empty((steps.dt.size, 4))
    order = np.argsort(-steps.count, kind="stable")
    count, first = steps.count[order], steps.first[:-1][order]
    now = q_start[order].copy()
    for k in range(int(count.max(initial=0))):
        a = int(np.searchsorted(-count, -k, side="left"))
        at = first[:a] + k
        now[:a] = rotation.multiply(now[:a], turn[at])
        out[at] = now[:a]
    return rotation.normalise(out)
