r"""Propagation of attitude, bias and their error covariance between nodes (Roumeliotis et al. 1999, section 4.2.1).

Symbols: paper :math:`\Theta,\Psi,\Phi,Q` of the error state ``[dtheta_b, dbias]``; :math:`W=-[\omega\times]`.
Blocks are kept components first, ``(3, 3, n)``, so that every operation runs over many intervals at once.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from . import rotation
from .rotation import SINC, SMALL, all_small, series, sine_ratios
from .steps import Samples, Steps

__all__ = [
    "Increments", "Samples", "Steps", "assemble", "bridged", "preintegrate", "run_steps", "step_vectors", "transition",
]  # fmt: skip

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Complex = NDArray[np.complex128]
QUARTIC = ((5, 6), (7, 8), (9, 10), (11, 12), (13, 14))
QUINTIC = ((6, 7), (8, 9), (10, 11), (12, 13), (14, 15))
BLOCK = 1 << 15  # steps handled together: temporaries stay in cache
PART = 16  # steps summed before matrices are multiplied


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

    .. math:: \Phi=\begin{bmatrix}\Theta&-\Psi\0&I\end{bmatrix},\quad
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
    steps: Steps | Samples, bias_ref: Array, n_r: float | Array, n_w: float, held: NDArray[np.bool_] | None = None
) -> Increments:
    r"""Compose the IMU steps of every node interval: relative rotation, bias Jacobian, ``Phi`` and ``Q``.

    In the axes of an interval's start all of them are running sums: with the attitude :math:`R_u` and
    :math:`N_u=\int_0^uR\,ds`

    .. math:: \Theta=R_T^T,\quad\Psi=R_T^TN_T,\quad Q_{12}=-N_wR_T^T\int(N_T-N_u)\,du,\quad
        Q_{11}=N_rT\,I+N_wR_T^T\int(N_T-N_u)(N_T-N_u)^Tdu\,R_T.

    Parameters
    ----------
    steps : the IMU, grouped by interval (m intervals; an interval without steps gives the identity and no noise)
    bias_ref : (m, 3) rad/s, the gyro bias removed in each interval
    n_r : one for all, or one per interval (m,); n_r, n_w as in :func:`transition`
    held : (m,) intervals that are not composed, for somebody else knows better

    Notes
    -----
    ``N`` is summed over all steps, to fourth order in their angle; the integrals of it, which are the noise of a bias
    that walks, over parts of an interval (``PART``), to fourth order in theirs.
    """
    m = bias_ref.shape[0]
    dq = np.tile([1.0, 0.0, 0.0, 0.0], (m, 1))
    theta, psi, q12, q11 = (np.zeros((3, 3, m)) for _ in range(4))
    _add_identity(theta, np.ones(m))
    count = steps.count if held is None else np.where(held, 0, steps.count)
    for rows in _side_by_side(count):
        dt, rate0, rate1 = steps.block(rows, count[rows])
        v = _vectors(dt, rate0, rate1, bias_ref[rows].T[:, None])
        q = _products(_turns(v))
        dq[rows] = q[-1]
        theta[..., rows], psi[..., rows], q12[..., rows], q11[..., rows] = _sums(dt, v, q)
    span = steps.span
    phi, Q = assemble(theta, psi, q11, q12, span, n_r, n_w)
    return Increments(rotation.normalise(dq), np.moveaxis(psi, -1, 0).copy(), phi, Q, span, bias_ref)


def _side_by_side(count: Ints) -> Iterator[Ints]:
    """Yield intervals with about as many steps each, in blocks of ``BLOCK`` steps; those without any are left out."""
    order = np.argsort(-count, kind="stable")
    lo, end = 0, int(np.count_nonzero(count))
    while lo < end:
        hi = min(end, lo + max(1, BLOCK // int(count[order[lo]])))
        yield order[lo:hi]
        lo = hi


def _vectors(dt: Array, rate0: Array, rate1: Array, bias: Array) -> Array:
    """Return the rotation vectors (3, k, b) of steps side by side; see ``step_vectors``."""
    mean = rate0 + rate1
    mean *= 0.5
    mean -= bias
    mean *= dt
    change = rate1 - rate0
    change *= dt / 12
    v = mean.copy()
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        v[i] += mean[j] * change[k]
        v[i] -= mean[k] * change[j]
    return v


def _turns(v: Array) -> Array:
    """Return the quaternions (k, b, 4) of rotation vectors (3, k, b)."""
    x2 = 0.25 * (v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    q = np.empty((*x2.shape, 4))
    if all_small(x2):
        ratio = series(x2, 1.0, SINC)
        q[..., 0] = np.sqrt(1.0 - ratio * ratio * x2)
    else:
        ratio = sine_ratios(x2)[0]
        q[..., 0] = np.cos(np.sqrt(x2))
    ratio *= 0.5
    for i in range(3):
        np.multiply(ratio, v[i], out=q[..., 1 + i])
    return q


def _products(turns: Array, start: Array | None = None) -> Array:
    """Return the running products (k, b, 4) of quaternions down the first axis, in their place; of ``start`` (b, 4)
    first, where it is given.
    """
    alpha, beta = _pair(turns)
    alpha_bar, beta_bar = alpha.conj(), beta.conj()
    if start is not None:
        a, b = _pair(start)
        alpha[0], beta[0] = a * alpha[0] - b * beta_bar[0], a * beta[0] + b * alpha_bar[0]
    spare = np.empty_like(alpha[0])
    for k in range(1, len(turns)):
        a, b = alpha[k - 1], beta[k - 1]
        np.multiply(a, beta[k], out=beta[k])
        beta[k] += np.multiply(b, alpha_bar[k], out=spare)
        np.multiply(a, alpha[k], out=alpha[k])
        alpha[k] -= np.multiply(b, beta_bar[k], out=spare)
    return _unpair(alpha, beta, turns)


def _pair(q: Array) -> tuple[Complex, Complex]:
    r"""Return quaternions (..., 4) as :math:`q=\alpha+\beta j`: :math:`(\alpha_1\alpha_2-\beta_1\bar\beta_2)+
    (\alpha_1\beta_2+\beta_1\bar\alpha_2)j` is their product.
    """
    pairs = np.ascontiguousarray(q).view(np.complex128)
    return np.ascontiguousarray(pairs[..., 0]), np.ascontiguousarray(pairs[..., 1])


def _unpair(alpha: Complex, beta: Complex, out: Array) -> Array:
    pairs = out.view(np.complex128)
    pairs[..., 0], pairs[..., 1] = alpha, beta
    return out


def _sums(dt: Array, v: Array, q: Array) -> tuple[Array, Array, Array, Array]:
    r"""Return :math:`\Theta,\Psi` and, per unit :math:`N_w`, :math:`Q_{12},Q_{11}` (3, 3, b) of running products ``q``.

    A step's mean attitude is :math:`\bar R(I+\frac1{12}(|v|^2I-vv^T))` with the mean :math:`\bar R` of both ends; the
    second part is summed over ``PART`` steps and taken at their :math:`\bar R`.
    """
    b = dt.shape[1]
    parts = [slice(a, min(a + PART, len(dt))) for a in range(0, len(dt), PART)]
    start = np.tile([1.0, 0.0, 0.0, 0.0], (1, b, 1))
    R = _matrices(*np.moveaxis(np.concatenate([start, *(q[part.stop - 1 : part.stop] for part in parts)]), -1, 0))
    N, length = np.zeros((3, 3, len(parts) + 1, b)), np.empty((len(parts), b))
    wxyz = [np.ascontiguousarray(q[..., i]) for i in range(4)]
    for k, part in enumerate(parts):
        mine = dt[part]
        weight = 0.5 * mine
        weight[:-1] += 0.5 * mine[1:]  # of the attitude at the end of each step
        length[k] = mine.sum(axis=0)
        N[:, :, k + 1] = N[:, :, k] + 0.5 * mine[0] * R[:, :, k] + _mean_matrix(weight, [c[part] for c in wxyz])
        N[:, :, k + 1] += _mm(0.5 * (R[:, :, k] + R[:, :, k + 1]), _spread(mine, v[:, part]))
    return _walk(length, R, N)


def _mean_matrix(weight: Array, wxyz: Sequence[Array]) -> Array:
    """Return the weighted sum (3, 3, b) of the matrices of quaternions, parts (k, b) each."""
    _, *xyz = wxyz
    total = weight.sum(axis=0)
    weighted = [weight * part for part in xyz]
    products = [[_dot(a, c) for c in wxyz] for a in weighted]  # w, x, y, z times x, y, z
    out = np.empty((3, 3, weight.shape[1]))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[i, i] = total - 2.0 * (products[j][j + 1] + products[k][k + 1])
        out[i, j] = 2.0 * (products[i][j + 1] - products[k][0])
        out[j, i] = 2.0 * (products[i][j + 1] + products[k][0])
    return out


def _spread(dt: Array, v: Array) -> Array:
    """Return the sum (3, 3, b) of ``dt (|v|^2 I - v v') / 12`` over rotation vectors (3, k, b)."""
    weighted = v * (dt / 12)
    out = np.empty((3, 3, dt.shape[1]))
    for i in range(3):
        for j in range(i, 3):
            out[i, j] = out[j, i] = -_dot(weighted[i], v[j])
    return _add_identity(out, -(out[0, 0] + out[1, 1] + out[2, 2]))


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("kb,kb->b", a, b))


def _walk(length: Array, R: Array, N: Array) -> tuple[Array, Array, Array, Array]:
    """Integrate what a walking bias does, from ``R`` and ``N`` (3, 3, k + 1, b) at the knots, ``length`` (k, b) s
    apart; return as ``_sums``.
    """
    left = N[:, :, -1:] - N  # what is still to come
    square = np.einsum("ijkb,ljkb->ilkb", left, left)
    slope = -np.einsum("ijkb,ljkb->ilkb", R, left)
    slope = slope + slope.swapaxes(0, 1)
    half, twelfth = 0.5 * length, length * length / 12
    A = np.sum(half * (left[:, :, 1:] + left[:, :, :-1]) + twelfth * (R[:, :, 1:] - R[:, :, :-1]), axis=2)
    B = np.sum(half * (square[:, :, 1:] + square[:, :, :-1]) - twelfth * (slope[:, :, 1:] - slope[:, :, :-1]), axis=2)
    theta = _transpose(R[:, :, -1])
    return theta, _mm(theta, N[:, :, -1]), -_mm(theta, A), _mm(_mm(theta, B), _transpose(theta))


def _matrices(w: Array, x: Array, y: Array, z: Array) -> Array:
    """Return the rotation matrices (3, 3, ...) of quaternions by their parts."""
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def run_steps(steps: Steps, q_start: Array, bias: Array) -> Array:
    """Re-propagate every interval at full rate: attitude (s, 4) at the end of each step.

    Parameters
    ----------
    q_start : (m, 4) attitude at the start of each interval
    bias : (m, 3) gyro bias in each interval, rad/s
    """
    out = np.empty((steps.dt.size, 4))
    for rows, _, q in _running(steps, np.arange(len(bias)), q_start, bias):
        at = steps.first[rows][:, None] + np.arange(len(q))
        inside = at < steps.first[rows + 1][:, None]
        out[at[inside]] = q.swapaxes(0, 1)[inside]
    return rotation.normalise(out)


def bridged(steps: Steps | Samples, among: Ints, q: Array, q_end: Array, bias: Array) -> Iterator[tuple[Ints, Array]]:
    """Yield intervals side by side, places in ``among``, and their attitude (k, b, 4) at the end of each step; what an
    interval lacks to its end is spread evenly over it.

    Parameters
    ----------
    among : (m,) intervals to run
    q, q_end, bias : (m, 4) where each begins and ends, (m, 3) rad/s
    """
    for rows, dt, run in _running(steps, among, q, bias):
        defect_b = rotation.log_quaternion(rotation.multiply(rotation.conjugate(run[-1]), q_end[rows]))
        share = np.cumsum(dt, axis=0)
        share /= share[-1]
        (alpha, beta), (a, b) = _pair(run), _pair(_turns(rotation.rotate(run[-1], defect_b).T[:, None] * share))
        yield rows, _unpair(a * alpha - b * beta.conj(), a * beta + b * alpha.conj(), run)


def _running(steps: Steps | Samples, among: Ints, q: Array, bias: Array) -> Iterator[tuple[Ints, Array, Array]]:
    """Yield intervals side by side, the lengths (k, b) of their steps and the attitude (k, b, 4) at the end of each."""
    count = steps.count[among]
    for rows in _side_by_side(count):
        dt, rate0, rate1 = steps.block(among[rows], count[rows])
        yield rows, dt, _products(_turns(_vectors(dt, rate0, rate1, bias[rows].T[:, None])), q[rows])
