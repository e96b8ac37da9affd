"""Measurement models: what a sensor should read at an attitude and bias, and how that changes with the error state.

Symbols: ``r = z - h(x)`` residual, ``H`` Jacobian to ``[dtheta_b, dbias]`` (paper eqs 31-36), ``R`` noise covariance.
Every model has ``linearise(R_nb, bias, values) -> (r, H)`` over ``m`` samples at once. A new sensor is a model here and
its rule in ``nodes/observations.py``: when it counts and how noisy it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..records import Array
from .direction import Direction
from .heading import BodyHeading, FieldHeading
from .orientation import Orientation
from .zero_rate import ZeroRate

__all__ = ["SENSORS", "Direction", "Measurement", "Sensor"]


class Sensor(Protocol):
    """A measurement model with ``dof`` residuals per sample."""

    @property
    def dof(self) -> int: ...

    def linearise(self, R_nb: Array, bias: Array, values: Array) -> tuple[Array, Array]:
        """Return residuals (m, dof) and Jacobians (m, dof, 6) at attitudes ``R_nb`` (m, 3, 3) and ``bias`` (3,)."""
        ...


SENSORS = {
    "gravity": Direction,
    "sun": Direction,
    "compass": BodyHeading,
    "magnetometer": FieldHeading,
    "orientation": Orientation,
    "zero_rate": ZeroRate,
}


@dataclass(frozen=True, slots=True)
class Measurement:
    """One update: the mean of ``m`` samples of one sensor, seen from one node.

    Parameters
    ----------
    role : str
        Key of ``SENSORS``, as named in the report.
    node : int
        Index of the node it updates.
    t : float
        Mean time of the samples, s.
    values : (m, d)
    noise : (dof, dof)
        Covariance of the mean residual.
    turn : (m, 3, 3) or None
        Rotation from the node to each sample by the gyro between (``R_sample = R_node @ turn``); None = identity.
    """

    role: str
    sensor: Sensor
    node: int
    t: float
    values: Array
    noise: Array
    turn: Array | None = None

    def linearise(self, R_nb: Array, bias: Array) -> tuple[Array, Array]:
        """Return the mean residual (dof,) and Jacobian (dof, 6) at the node's ``R_nb`` (3, 3) and ``bias`` (3,)."""
        R_nb = R_nb[None] if len(self.values) == 1 else np.broadcast_to(R_nb, (len(self.values), 3, 3))
        if self.turn is None:
            r, H = self.sensor.linearise(R_nb, bias, self.values)
        else:
            r, H = self.sensor.linearise(R_nb @ self.turn, bias, self.values)
            H[:, :, :3] = H[:, :, :3] @ self.turn.swapaxes(1, 2)  # dtheta at the sample = turn' dtheta at the node
        return (r[0], H[0]) if len(r) == 1 else (r.mean(axis=0), H.mean(axis=0))
