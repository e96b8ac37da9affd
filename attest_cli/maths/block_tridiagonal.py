"""Symmetric block-tridiagonal systems by odd-even reduction, all blocks at once, with the marginal covariances."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def solve(diagonal: Array, upper: Array, right: Array) -> tuple[Array, Array, Array]:
    r"""Solve :math:`Ax=b` and return ``x`` with the blocks of :math:`A^{-1}` on and beside its diagonal.

    Parameters
    ----------
    diagonal : (n, s, s) symmetric positive definite blocks :math:`A_{kk}`
    upper : (n - 1, s, s) blocks :math:`A_{k,k+1}`; the lower ones are their transposes
    right : (n, s)

    Returns
    -------
    x (n, s), covariance (n, s, s) :math:`(A^{-1})_{kk}`, cross (n - 1, s, s) :math:`(A^{-1})_{k,k+1}`

    Notes
    -----
    Eliminating every second block leaves a system of the same form for the others; the eliminated block ``i`` follows
    from its neighbours ``a, c``: :math:`x_i=A_{ii}^{-1}(b_i-A_{ia}x_a-A_{ic}x_c)` and, with
    :math:`G=A_{ii}^{-1}[A_{ia}\ A_{ic}]`,
    :math:`\Sigma_{ii}=A_{ii}^{-1}+G\Sigma_{ac}G^T`, :math:`\Sigma_{i,(a,c)}=-G\Sigma_{ac}`. log2(n) batched sweeps.
    """
    n, s = right.shape
    if n == 1:
        inverse = np.linalg.inv(diagonal)
        return np.einsum("kij,kj->ki", inverse, right), _symmetric(inverse), upper
    odd = diagonal[1::2]
    m = len(odd)
    left = upper[0::2].swapaxes(1, 2)  # A_{i,i-1} of the odd blocks i
    beyond = np.zeros((m, s, s))
    beyond[: len(upper[1::2])] = upper[1::2]  # A_{i,i+1}; zero for a last odd block
    inverse = _symmetric(np.linalg.inv(odd))
    G_left, G_right, g = inverse @ left, inverse @ beyond, np.einsum("kij,kj->ki", inverse, right[1::2])

    x_even, cov_even, cross_even = solve(*_even(diagonal, right, left, beyond, G_left, G_right, g))
    del beyond

    pad = np.zeros((1, s, s))
    x_next = np.concatenate([x_even[1:], np.zeros((1, s))])[:m]
    cov_next = np.concatenate([cov_even[1:], pad])[:m]
    cross_next = np.concatenate([cross_even, pad])[:m]
    with_left = -(G_left @ cov_even[:m] + G_right @ cross_next.swapaxes(1, 2))  # Cov(x_i, x_{i-1})
    with_right = -(G_left @ cross_next + G_right @ cov_next)  # Cov(x_i, x_{i+1})
    x, covariance, cross = np.empty((n, s)), np.empty((n, s, s)), np.empty((n - 1, s, s))
    x[0::2], covariance[0::2] = x_even, cov_even
    x[1::2] = g - np.einsum("kij,kj->ki", G_left, x_even[:m]) - np.einsum("kij,kj->ki", G_right, x_next)
    inverse -= with_left @ G_left.swapaxes(1, 2)
    inverse -= with_right @ G_right.swapaxes(1, 2)
    covariance[1::2] = _symmetric(inverse)
    cross[0::2] = with_left.swapaxes(1, 2)
    cross[1::2] = with_right[: len(cross[1::2])]
    return x, covariance, cross


def _even(
    diagonal: Array, right: Array, left: Array, beyond: Array, G_left: Array, G_right: Array, g: Array
) -> tuple[Array, Array, Array]:
    """Return the system of the even blocks."""
    even_diagonal, even_right, m = diagonal[0::2].copy(), right[0::2].copy(), len(left)
    e = len(even_diagonal)
    even_diagonal[:m] -= left.swapaxes(1, 2) @ G_left
    even_right[:m] -= np.einsum("kji,kj->ki", left, g)
    even_diagonal[1:] -= (beyond.swapaxes(1, 2) @ G_right)[: e - 1]
    even_right[1:] -= np.einsum("kji,kj->ki", beyond, g)[: e - 1]
    return _symmetric(even_diagonal), -(left.swapaxes(1, 2) @ G_right)[: e - 1], even_right


def _symmetric(blocks: NDArray[np.floating]) -> Array:
    return np.asarray(0.5 * (blocks + blocks.swapaxes(1, 2)), dtype=np.float64)
