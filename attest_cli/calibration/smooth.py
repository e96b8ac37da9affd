"""A random walk left in the residual of a bias model, followed through blocks and gaps: Kalman filter and RTS."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..maths import sequential
from ..maths.kalman import rts
from ..records import Array
from .rest import Blocks

VAGUE = 1e6  # prior variance of the coefficients over what the record itself says


@dataclass(frozen=True, slots=True)
class Followed:
    """The bias at the blocks ``mean``, ``sigma`` (n,) given all of them, and the filter's normalised innovations (n,),
    white where the model is right.
    """

    mean: Array
    sigma: Array
    innovations: Array


def follow_walk(blocks: Blocks, residual: Array, J: Array, cov: Array, N: float, K: float) -> Followed:
    r"""Smooth what a model leaves: :math:`r_i=w_i+J_i\,d\beta+v_i`, the walk and the coefficients together.

    State :math:`(w, d\beta)`, w from 0 at the first block with variance :math:`K^2` per second between block centres,
    coefficients constant; so ``sigma`` holds what they do not know either.

    Parameters
    ----------
    residual : (n,) block means minus the model
    J, cov : (n, q) Jacobian of the model and (q, q) covariance of its parameters
    N, K : white noise and random walk densities
    """
    n, q = J.shape
    eye = np.eye(q + 1)
    H = np.column_stack([np.ones(n), J])[:, None, :]
    R = (N**2 / blocks.span)[:, None, None]
    Q = np.zeros((n, q + 1, q + 1))
    Q[1:, 0, 0] = K**2 * np.diff(blocks.t)
    P0 = np.zeros((q + 1, q + 1))
    P0[0, 0] = 1e-3 * K**2 * float(blocks.span[0])  # not quite 0: the smoother inverts it
    P0[1:, 1:] = VAGUE * cov
    run = sequential.run(
        n, np.zeros(q + 1), P0, 1,
        lambda k, x: (x, eye, Q[k + 1]),
        lambda k, x, _: (residual[k] - H[k] @ x, H[k], R[k]),
    )  # fmt: skip
    errors = rts(run.chain)
    state = run.x + errors.d
    mean = np.einsum("kij,kj->k", H, state)
    variance = np.einsum("kij,kjl,kil->k", H, errors.P, H)
    return Followed(mean, np.sqrt(np.maximum(variance, 0.0)), run.nu[:, 0] / np.sqrt(run.S[:, 0, 0]))
