"""A whole attitude from outside, such as a star tracker or a motion capture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..maths import rotation
from ..records import Array


@dataclass(frozen=True, slots=True)
class Orientation:
    r"""Values (m, 4) Hamilton ``q_nb``: :math:`r=\mathrm{Log}(R_{nb}^T Z)`, :math:`H=J_r^{-1}(-r)` (exact at any
    distance below pi).
    """

    @property
    def dof(self) -> int:
        return 3

    def linearise(self, R_nb: Array, bias: Array, values: Array) -> tuple[Array, Array]:
        """Return residuals (m, 3) and Jacobians (m, 3, 6)."""
        r = rotation.log_quaternion(rotation.multiply(rotation.conjugate(rotation.from_matrix(R_nb)), values))
        H = np.zeros((len(values), 3, 6))
        H[:, :, :3] = rotation.inverse_right_jacobian(-r)
        return r, H
