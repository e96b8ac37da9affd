r"""A random walk seen in white noise, :math:`x_{k+1}=x_k+w_k,\ z_k=x_k+v_k`: smoothed in one solve, and its likelihood.

The scalar case of ``maths.kalman``, for where many models are tried on a long record.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def smooth(z: Array, information: Array, Q: Array) -> tuple[Array, Array]:
    r"""Return the smoothed walk (n, d) and its variance (n,), the same for each of its d components.

    .. math:: \min_x\sum_k\|z_k-x_k\|^2/R_k+\sum_k\|x_{k+1}-x_k\|^2/Q_k

    by one symmetric tridiagonal factorisation; its pivots run forward and backward are the two filters' information.

    Parameters
    ----------
    z : (n, d) measurements
    information : (n,) 1/R; zero where nothing was measured, not everywhere
    Q : (n - 1,) > 0 variance of the steps
    """
    from scipy.linalg import lapack

    stiff = 1.0 / Q
    diagonal = information.copy()
    diagonal[:-1] += stiff
    diagonal[1:] += stiff
    forward, factor, _ = lapack.dpttrf(diagonal, -stiff)
    mean, _ = lapack.dpttrs(forward, factor, information[:, None] * z)
    backward, _, _ = lapack.dpttrf(diagonal[::-1], -stiff[::-1])
    return mean, 1.0 / (forward + backward[::-1] - diagonal)


def misfit(z: Array, R: Array, Q: Array) -> tuple[Array, Array]:
    r"""Return what the innovation log-likelihood of many models is made of, the first measurement given.

    .. math:: \sum_{k>0}\|\nu_k\|^2/S_k,\quad\sum_{k>0}\log S_k,\qquad
        \log L(c)=-\tfrac12\Big(\tfrac1c\sum\frac{\|\nu\|^2}S+d\sum\log S+d(n-1)\log 2\pi c\Big)

    with all variances c times those given: innovations depend on their ratio only, so c needs no filter of its own.

    Parameters
    ----------
    z : (n, ..., d) measurements, d components of equal noise
    R : (n, ...) noise of each model
    Q : (n - 1, ...) variance of the steps of each model
    """
    shape = np.broadcast_shapes(R.shape[1:], Q.shape[1:])
    squares, logs, x, P = np.zeros(shape), np.zeros(shape), z[0], R[0]
    for k in range(1, len(z)):
        P = P + Q[k - 1]
        S = P + R[k]
        nu = z[k] - x
        squares += np.einsum("...i,...i->...", nu, nu) / S
        logs += np.log(S)
        K = P / S
        x = x + K[..., None] * nu
        P = K * R[k]
    return squares, logs
