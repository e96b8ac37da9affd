"""Heading: of a body axis (compass) or of a field seen by the body (magnetometer)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..maths.rotation import skew, wrap
from ..records import Array


def azimuth(R_nb: Array, vector_b: Array) -> tuple[Array, Array]:
    r"""Return the azimuth (m,) of ``vector_b`` (m, 3) from east, counter-clockwise, rad, and its Jacobian (m, 3).

    With :math:`v_n=R_{nb}v_b`: :math:`\alpha=\operatorname{atan2}(v_y,v_x)`,
    :math:`\partial\alpha/\partial\theta_b=\frac{(-v_y,v_x,0)}{v_x^2+v_y^2}(-R_{nb}[v_b\times])`.
    A vector close to the vertical has no azimuth: its Jacobian is zero.
    """
    v = np.einsum("mij,mj->mi", R_nb, vector_b)
    horizontal = v[:, 0] ** 2 + v[:, 1] ** 2
    usable = horizontal > 1e-6 * np.sum(v * v, axis=1)
    gradient = np.stack([-v[:, 1], v[:, 0], np.zeros(len(v))], axis=1) / np.where(usable, horizontal, np.inf)[:, None]
    return np.arctan2(v[:, 1], v[:, 0]), -np.einsum("mi,mij,mjk->mk", gradient, R_nb, skew(vector_b))


def near(angles: Array) -> Array:
    """Return angles (m, ...), the first in [-pi, pi), the others within half a turn of it: they can be averaged."""
    first = wrap(angles[:1])
    return np.asarray(first + wrap(angles - first))


@dataclass(frozen=True, slots=True)
class BodyHeading:
    """Compass: values (m, 1) heading of body x, rad clockwise from true north; residual wrapped to [-pi, pi)."""

    @property
    def dof(self) -> int:
        return 1

    def linearise(self, R_nb: Array, bias: Array, values: Array) -> tuple[Array, Array]:
        """Return residuals (m, 1) and Jacobians (m, 1, 6)."""
        forward = np.tile([1.0, 0.0, 0.0], (len(values), 1))
        predicted, jacobian = azimuth(R_nb, forward)
        H = np.zeros((len(values), 1, 6))
        H[:, 0, :3] = jacobian
        return near(0.5 * np.pi - values - predicted[:, None]), H


@dataclass(frozen=True, slots=True)
class FieldHeading:
    """Magnetometer used for heading only: values (m, 3) field in body axes, any unit.

    ``azimuth_n``: direction of the horizontal field, rad from east, counter-clockwise. The Jacobian keeps the turn
    about the vertical alone: a disturbed or steep field would else be explained by roll and pitch.
    """

    azimuth_n: float

    @property
    def dof(self) -> int:
        return 1

    def linearise(self, R_nb: Array, bias: Array, values: Array) -> tuple[Array, Array]:
        """Return residuals (m, 1) and Jacobians (m, 1, 6)."""
        predicted, _ = azimuth(R_nb, values)
        H = np.zeros((len(values), 1, 6))
        H[:, 0, :3] = R_nb[:, 2, :]
        return near(self.azimuth_n - predicted)[:, None], H
