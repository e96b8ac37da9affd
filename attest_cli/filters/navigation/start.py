"""Where north is, for a log whose only sight of it is where it went: the path of the fixes against that of the IMU."""

from __future__ import annotations

import numpy as np

from ...maths import rotation
from ...records import Array, Imu
from .aids import Place, Velocity, Wheels

APART_S, LEG_S = 1.0, 10.0  # fixes at least this far apart are compared, with the IMU and with the wheels
LEAST_TRIPLES = 5
HOLE = 2.0  # times the usual distance of fixes: across it the heading of the IMU turns too far
FASTEST_RAD_S = 0.1  # no gyro's bias is larger
SLOT_S, FINER = 0.5, 4  # in which such a turning is looked for, and how much finer than what the log resolves
WORTH = 6.0  # log-likelihood that it has to bring
LIKE, CLEARLY = 0.8, 0.3  # coherence of a path with another that is mirrored; times what is left of it as it is
Paths = tuple[Array, Array, Array]
"""When (k,), and two paths as steps or changes (k, 2): as seen, and as felt but for a turn."""


def heading_offset(imu: Imu, t: Array, q: Array, bias_a: Array, place: Place) -> tuple[Array, float]:
    r"""Return the turn about the vertical (n,), rad, that brings the attitude to the fixes, and its sigma.

    Between three fixes the change of the mean velocity is free of position and velocity:

    .. math:: \frac{p_2-p_1}{t_2-t_1}-\frac{p_1-p_0}{t_1-t_0}=R_z(\psi)\Big[\frac{P_2-P_1}{t_2-t_1}-
        \frac{P_1-P_0}{t_1-t_0}\Big],\quad P=\iint(Rf-g)

    whose horizontal parts give :math:`\psi` by least squares (Wahba's problem in the plane), and how fast it grows
    where a bias of the gyro turns the attitude steadily.

    Parameters
    ----------
    t, q : (n,), (n, 4) nodes and their attitude, heading unknown
    bias_a : (3,) accelerometer bias, m/s^2
    """
    paths = _by_imu(imu, t, q, bias_a, place)
    return (np.zeros(len(t)), np.pi) if paths is None else _turning(t, *paths)


def heading_of_velocity(imu: Imu, t: Array, q: Array, velocity: Velocity) -> tuple[Array, float]:
    r"""Return the turn of :func:`heading_offset` from velocities: :math:`v_1-v_0=R_z(\psi)\int(Rf-g)`."""
    _, v = _felt(imu, t, q, np.zeros(3))
    known = np.flatnonzero(np.isfinite(velocity.velocity_n[:, :2]).all(axis=1))
    rows = known[_apart(velocity.t[known])] if len(known) else known
    if len(rows) < LEAST_TRIPLES + 2:
        return np.zeros(len(t)), np.pi
    when = velocity.t[rows]
    felt = np.stack([np.interp(when, imu.t, v[:, i]) for i in range(2)], axis=1)
    gap = np.diff(when)
    near = gap <= HOLE * np.median(gap)
    seen = np.diff(velocity.velocity_n[rows, :2], axis=0)
    return _turning(t, (when[:-1] + 0.5 * gap)[near], seen[near], np.diff(felt, axis=0)[near])


def heading_of_wheels(t: Array, q: Array, wheels: Wheels, place: Place) -> tuple[float, float]:
    r"""Return one turn, as :func:`heading_offset`, from legs of the path: :math:`p_1-p_0=R_z(\psi)\int Rv_b`."""
    paths = _by_wheels(t, q, wheels, place)
    return (0.0, np.pi) if paths is None else _turn(*paths[1:])


def mirrored(imu: Imu, t: Array, q: Array, place: Place, wheels: Wheels | None) -> bool:
    r"""Return whether the fixes are the mirror image of the path that wheels or IMU show.

    With paths :math:`z,w` in the complex plane :math:`w` turned is :math:`cw`, mirrored :math:`c\bar w`; the coherence
    of both is :math:`|\sum\bar zw|^2/(\sum|z|^2\sum|w|^2)`.
    """
    paths = _by_imu(imu, t, q, np.zeros(3), place) if wheels is None else _by_wheels(t, q, wheels, place)
    if paths is None:
        return False
    z, w = (path @ np.array([1.0, 1j]) for path in paths[1:])
    size = max(float(np.sum(np.abs(z) ** 2) * np.sum(np.abs(w) ** 2)), 1e-300)
    turned, flipped = (float(np.abs(np.sum(np.conj(z) * x)) ** 2) / size for x in (w, np.conj(w)))
    return flipped > LIKE and 1.0 - flipped < CLEARLY * (1.0 - turned)


def _by_imu(imu: Imu, t: Array, q: Array, bias_a: Array, place: Place) -> Paths | None:
    """Return the changes of mean velocity at every middle of three fixes, as seen and as felt."""
    a, v = _felt(imu, t, q, bias_a)
    dt = np.diff(imu.t)[:, None]
    p = np.concatenate([np.zeros((1, 2)), np.cumsum(v[:-1] * dt + dt**2 / 6 * (2 * a[:-1] + a[1:]), axis=0)])
    rows = _apart(place.t)
    if len(rows) < LEAST_TRIPLES + 2:
        return None
    when = place.t[rows]
    seen = _second(when, place.place_n[rows, :2])
    felt = _second(when, np.stack([np.interp(when, imu.t, p[:, i]) for i in range(2)], axis=1))
    gap = np.diff(when)
    longer = np.maximum(gap[1:], gap[:-1])
    near = longer <= HOLE * np.median(longer)
    return when[1:-1][near], seen[near], felt[near]


def _by_wheels(t: Array, q: Array, wheels: Wheels, place: Place) -> Paths | None:
    """Return the legs between fixes, as seen and as driven."""
    velocity = np.zeros((len(t), 2))  # nodes without wheels are rests
    velocity[wheels.node] = rotation.rotate(q[wheels.node], wheels.velocity_v @ wheels.R_vb)[:, :2]
    steps = 0.5 * (velocity[1:] + velocity[:-1]) * np.diff(t)[:, None]
    path = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    rows = _apart(place.t, LEG_S)
    if len(rows) < LEAST_TRIPLES + 1:
        return None
    went = np.stack([np.interp(place.t[rows], t, path[:, i]) for i in range(2)], axis=1)
    return place.t[rows[1:]], np.diff(place.place_n[rows, :2], axis=0), np.diff(went, axis=0)


def _felt(imu: Imu, t: Array, q: Array, bias_a: Array) -> tuple[Array, Array]:
    """Return the level acceleration and velocity (n, 2) that the IMU feels, in the axes of the attitude."""
    at = np.interp(imu.t, t, np.arange(len(t)))
    left = np.minimum(at.astype(np.int64), len(t) - 2)
    turn = rotation.log_quaternion(rotation.multiply(rotation.conjugate(q[left]), q[left + 1]))
    attitude = rotation.multiply(q[left], rotation.exp_quaternion((at - left)[:, None] * turn))
    a = rotation.rotate(attitude, imu.accel_b - bias_a)[:, :2]
    steps = 0.5 * (a[1:] + a[:-1]) * np.diff(imu.t)[:, None]
    return a, np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


def _apart(t: Array, least: float = APART_S) -> list[int]:
    """Return rows at least so far apart."""
    rows = [0]
    for k in range(1, len(t)):
        if t[k] - t[rows[-1]] >= least:
            rows.append(k)
    return rows


def _turning(t: Array, when: Array, seen: Array, felt: Array) -> tuple[Array, float]:
    """Return the turn at ``t`` (n,) from ``felt`` to ``seen`` (k, 2), which were at ``when`` (k,), and its sigma.

    It grows at the rate at which they agree best, if that is worth it: the highest peak of a periodogram.
    """
    pairs = (seen @ [1.0, 1.0j]) * np.conj(felt @ [1.0, 1.0j])
    slot = np.rint((when - when[0]) / SLOT_S).astype(np.int64)
    total = np.zeros(int(slot[-1]) + 1, dtype=np.complex128)
    np.add.at(total, slot, pairs)
    size = 1 << int(np.ceil(np.log2(FINER * len(total))))
    rates = 2.0 * np.pi * np.fft.fftfreq(size, SLOT_S)
    agreed = np.where(np.abs(rates) < FASTEST_RAD_S, np.abs(np.fft.fft(total, size)), 0.0)
    most, whole = int(np.argmax(agreed)), float(np.sum(seen**2) + np.sum(felt**2))
    misfit = whole - 2.0 * agreed[[0, most]]
    worth = len(when) * float(np.log(misfit[0] / max(misfit[1], 1e-12 * whole)))
    rate = float(rates[most]) if worth > WORTH else 0.0
    turned = (felt @ [1.0, 1.0j]) * np.exp(1j * rate * (when - when[0]))
    psi, sigma = _turn(seen, np.stack([turned.real, turned.imag], axis=1))
    return psi + rate * (t - when[0]), sigma


def _turn(seen: Array, felt: Array) -> tuple[float, float]:
    """Return the turn about the vertical from ``felt`` to ``seen`` (k, 2), and its sigma."""
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
