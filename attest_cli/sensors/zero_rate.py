"""Zero rate: at a stop the gyro reads its bias (not in the paper; the largest single gain)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..records import Array


@dataclass(frozen=True, slots=True)
class ZeroRate:
    """Values (m, 3) mean gyro over a block of a stop, rad/s: ``r = z - bias``, ``H = [0 I]``, ``R = N_r / T I``.

    The attitude must be frozen over the block: a gyro that is integrated and measured is used twice.
    """

    @property
    def dof(self) -> int:
        return 3

    def linearise(self, R_nb: Array, bias: Array, values: Array) -> tuple[Array, Array]:
        """Return residuals (m, 3) and Jacobians (m, 3, 6)."""
        H = np.zeros((len(values), 3, 6))
        H[:, :, 3:] = np.eye(3)
        return values - bias, H
