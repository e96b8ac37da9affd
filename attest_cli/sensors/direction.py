"""A known direction seen in the body: gravity at stops, the sun, any landmark (paper eqs 31-36)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..maths.rotation import cross, skew
from ..records import Array


def tangent_basis(v: Array) -> Array:
    """Return two unit vectors (m, 2, 3) orthogonal to each unit vector ``v`` (m, 3) and to each other."""
    helper = np.zeros_like(v)
    helper[np.arange(len(v)), np.argmin(np.abs(v), axis=1)] = 1.0
    first = cross(v, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, cross(v, first)], axis=1)


@dataclass(frozen=True, slots=True)
class Direction:
    r"""Reference vector ``reference_n`` measured in a sensor frame.

    .. math:: r = \Pi\,(z - T_{sb} R_{nb}^T p_n),\qquad H = \Pi\,T_{sb}\,[(R_{nb}^T p_n)\times]

    Parameters
    ----------
    reference_n : (3,) reference in navigation axes, in the unit of the values
    R_sb : (3, 3) body to sensor
    rows : ``"plane"`` the first two sensor axes (values (m, 2), the paper's 2-D sun sensor), ``"tangent"`` the two
        directions across the predicted vector (values (m, 3) unit vectors), ``"full"`` all three rows
    """

    reference_n: Array
    R_sb: Array = field(default_factory=lambda: np.eye(3))
    rows: str = "tangent"

    @property
    def dof(self) -> int:
        return 3 if self.rows == "full" else 2

    def linearise(self, R_nb: Array, bias: Array, values: Array) -> tuple[Array, Array]:
        """Return residuals (m, dof) and Jacobians (m, dof, 6)."""
        predicted_b = np.einsum("mji,j->mi", R_nb, self.reference_n)
        predicted_s = predicted_b @ self.R_sb.T
        jacobian = self.R_sb @ skew(predicted_b)
        H = np.zeros((len(values), self.dof, 6))
        if self.rows == "plane":
            H[:, :, :3] = jacobian[:, :2]
            return values[:, :2] - predicted_s[:, :2], H
        if self.rows == "full":
            H[:, :, :3] = jacobian
            return values - predicted_s, H
        across = tangent_basis(predicted_s)
        H[:, :, :3] = across @ jacobian
        r = np.einsum("mki,mi->mk", across, values)
        behind = np.sum(values * predicted_s, axis=1) < 0.0
        if behind.any():  # else the residual would vanish at the antipode, and a body on its head would fit
            r[behind] *= (2.0 / np.maximum(np.linalg.norm(r[behind], axis=1), 1e-9) - 1.0)[:, None]
        return r, H
