"""What a result folder claims of its track, from the covariance blocks at the nodes of ``passes.parquet``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..maths import rotation
from ..records import Array
from .records import Claims


def of_passes(passes: Mapping[str, NDArray[Any]], beside: Claims | None = None) -> Claims:
    r"""Return the smoothed pass' claims about world axes: :math:`R\,P_\theta R^\top` of its attitude, its position.

    Parameters
    ----------
    passes : columns of ``passes.parquet``; ``smoothed_covariance`` (m, 21) is the upper triangle of ``[dtheta_b,
        dbias]``
    beside : Claims, optional
        Of the full-rate track: its sigma of the relative heading is taken over.
    """
    stamps_ns = np.asarray(passes["timestamp_ns"], dtype=np.int64)
    upper = np.asarray(passes["smoothed_covariance"], dtype=np.float64)
    rows, cols = np.triu_indices(6)
    P = np.empty((len(stamps_ns), 6, 6))
    P[:, rows, cols] = P[:, cols, rows] = upper
    R = rotation.matrix(_columns(passes, *(f"smoothed_q_{part}" for part in "wxyz")))
    attitude = R @ P[:, :3, :3] @ R.swapaxes(1, 2)
    sigma = _columns(passes, *(f"sigma_position_{axis}_m" for axis in "xyz"))
    position = sigma[:, :, None] ** 2 * np.eye(3)
    level = np.asarray(passes["position_cov_xy_m2"], dtype=np.float64)
    position[:, 0, 1] = position[:, 1, 0] = level
    relative = np.full(len(stamps_ns), np.nan)
    if beside is not None:
        relative = np.interp(stamps_ns - stamps_ns[0], beside.stamps_ns - stamps_ns[0], beside.heading_relative)
    return Claims(stamps_ns, attitude, position, relative, full=True)


def _columns(passes: Mapping[str, NDArray[Any]], *names: str) -> Array:
    return np.stack([np.asarray(passes[name], dtype=np.float64) for name in names], axis=1)
