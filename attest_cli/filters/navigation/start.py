"""Where north is, for a log whose only sight of it is where it went: the path of the fixes against that of the IMU."""

from __future__ import annotations

import numpy as np

from ...maths import rotation
from ...records import Array, Imu
from .aids import Place

APART_S = 1.0  # fixes at least this far apart are compared
LEAST_TRIPLES = 5


def heading_offset(imu: Imu, t: Array, q: Array, bias_a: Array, place: Place) -> tuple[float, float]:
    r"""Return the turn about the vertical, rad, that brings the attitude to the fixes, and its sigma.

    Between three fixes the change of the mean velocity is free of position and velocity:

    .. math:: \frac{p_2-p_1}{t_2-t_1}-\frac{p_1-p_0}{t_1-t_0}=R_z(\psi)\Big[\frac{P_2-P_1}{t_2-t_1}-
        \frac{P_1-P_0}{t_1-t_0}\Big],\quad P=\iint(Rf-g)

    whose horizontal parts give :math:`\psi` by least squares (Wahba's problem in the plane).

    Parameters
    ----------
    t, q : (n,), (n, 4) nodes and their attitude, heading unknown
    bias_a : (3,) accelerometer bias, m/s^2
    """
    at = np.interp(imu.t, t, np.arange(len(t)))
    left = np.minimum(at.astype(np.int64), len(t) - 2)
    turn = rotation.log_quaternion(rotation.multiply(rotation.conjugate(q[left]), q[left + 1]))
    attitude = rotation.multiply(q[left], rotation.exp_quaternion((at - left)[:, None] * turn))
    a = rotation.rotate(attitude, imu.accel_b - bias_a)[:, :2]
    dt = np.diff(imu.t)[:, None]
    zero = np.zeros((1, 2))
    v = np.concatenate([zero, np.cumsum(0.5 * (a[1:] + a[:-1]) * dt, axis=0)])
    p = np.concatenate([zero, np.cumsum(v[:-1] * dt + dt**2 / 6 * (2 * a[:-1] + a[1:]), axis=0)])
    rows = [0]
    for k in range(1, len(place.t)):
        if place.t[k] - place.t[rows[-1]] >= APART_S:
            rows.append(k)
    if len(rows) < LEAST_TRIPLES + 2:
        return 0.0, np.pi
    when = place.t[rows]
    seen = _second(when, place.place_n[rows, :2])
    felt = _second(when, np.stack([np.interp(when, imu.t, p[:, i]) for i in range(2)], axis=1))
    cross = float(np.sum(felt[:, 0] * seen[:, 1] - felt[:, 1] * seen[:, 0]))
    dot = float(np.sum(felt * seen))
    psi = float(np.arctan2(cross, dot))
    turned = felt @ np.array([[np.cos(psi), np.sin(psi)], [-np.sin(psi), np.cos(psi)]])
    misfit = float(np.sum((seen - turned) ** 2)) / max(1, 2 * len(seen) - 1)
    return psi, float(min(np.pi, np.sqrt(misfit / max(float(np.sum(felt**2)), 1e-12))))


def _second(t: Array, p: Array) -> Array:
    """Return the change of the mean velocity at every middle of three."""
    mean = np.diff(p, axis=0) / np.diff(t)[:, None]
    return np.asarray(np.diff(mean, axis=0))
