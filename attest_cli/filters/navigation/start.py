"""Where north is, for a log whose only sight of it is where it went: the path of the fixes against that of the IMU."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...maths import rotation
from ...records import Array, Imu, Ints
from .aids import Place, Velocity, Wheels

APARTS_S, LEG_S = (1.0, 2.0, 4.0, 8.0), 10.0  # between fixes that are compared, with the IMU and with the wheels
LEAST_TRIPLES, LEAST_WIDE = 5, 12  # of fixes; where several distances are tried, chance has more of them
HOLE = 2.0  # times the usual distance of fixes: across it the heading of the IMU turns too far
FASTEST_RAD_S = 0.1  # no gyro's bias is larger
SLOT_S, FINER = 0.5, 4  # in which such a turning is looked for, and how much finer than what the log resolves
WORTH = 6.0  # log-likelihood that it has to bring
LIKE, CLEARLY = 0.8, 0.3  # coherence of a path with another that is mirrored; times what is left of it as it is
LAG_STEP_S, NEAR_STEPS, LAG_STEPS = 0.2, 5, 150  # s; of lags that are looked for elsewhere; of 30 s, leap seconds
MOST = 1000  # fixes that a lag is found from
Paths = tuple[Array, Array, Array]
"""When (k,), and two paths as steps or changes (k, 2): as seen, and as felt but for a turn."""


def heading_offset(
    imu: Imu, t: Array, q: Array, bias_a: Array, place: Place, *, drifts: bool = True
) -> tuple[Array, float]:  # fmt: skip
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
    drifts : whether the attitude may turn steadily against the fixes
    """
    path, found = _path(imu, *_felt(imu, t, q, bias_a)), (np.zeros(len(t)), np.pi)
    for rows in _spaced(place.t, APARTS_S[:1] if drifts else APARTS_S):  # noise of fixes fades, drift of the IMU grows
        paths = _by_imu(imu, path, place, rows)
        if paths is None:
            break
        psi, sigma = _turning(t, *paths) if drifts else _turn(*paths[1:])
        found = (np.broadcast_to(psi, (len(t),)), sigma) if sigma < found[1] else found
    return found


def heading_of_velocity(imu: Imu, t: Array, q: Array, velocity: Velocity) -> tuple[Array, float]:
    r"""Return the turn of :func:`heading_offset` from velocities: :math:`v_1-v_0=R_z(\psi)\int(Rf-g)`."""
    _, v = _felt(imu, t, q, np.zeros(3))
    known = np.flatnonzero(np.isfinite(velocity.velocity_n[:, :2]).all(axis=1))
    rows = known[apart(velocity.t[known])] if len(known) else known
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
    if wheels is not None:
        return _flipped(_by_wheels(t, q, wheels, place))
    path = _path(imu, *_felt(imu, t, q, np.zeros(3)))
    return any(_flipped(_by_imu(imu, path, place, rows)) for rows in _spaced(place.t))


def _spaced(t: Array, spacings: tuple[float, ...] = APARTS_S) -> Iterator[Ints]:
    """Yield rows of fixes that are ever further apart, as long as there are enough of them."""
    for spacing in spacings:
        rows = np.array(apart(t, spacing), dtype=np.int64)
        if spacing == APARTS_S[0] or len(rows) >= LEAST_WIDE + 2:
            yield rows


def _flipped(paths: Paths | None) -> bool:
    """Return whether a path is much more like the mirror image of another than like that."""
    if paths is None:
        return False
    z, w = (path @ np.array([1.0, 1j]) for path in paths[1:])
    size = max(float(np.sum(np.abs(z) ** 2) * np.sum(np.abs(w) ** 2)), 1e-300)
    turned, flipped = (float(np.abs(np.sum(np.conj(z) * x)) ** 2) / size for x in (w, np.conj(w)))
    return flipped > LIKE and 1.0 - flipped < CLEARLY * (1.0 - turned)


def lag_of(imu: Imu, t: Array, q: Array, place: Place) -> float:
    r"""Return how late fixes are, s, where that is beyond what the navigation looks for and sure, else 0.

    The coherence of :func:`mirrored`, which no heading changes, is largest where both paths are of the same time.
    """
    path = _path(imu, *_felt(imu, t, q, np.zeros(3)))
    every = list(_spaced(place.t))

    def coherent(step: int) -> float:
        found = (_by_imu(imu, path, place, rows[:MOST], LAG_STEP_S * step) for rows in every)
        return max((_coherent(*of[1:]) for of in found if of is not None and len(of[0]) >= LEAST_WIDE), default=0.0)

    near = max(coherent(step) for step in range(-NEAR_STEPS, NEAR_STEPS + 1))
    if near > LIKE:
        return 0.0
    best, step = max((coherent(step), step) for step in range(-LAG_STEPS, LAG_STEPS + 1))
    return LAG_STEP_S * step if best > LIKE and 1.0 - best < CLEARLY * (1.0 - near) else 0.0


def _coherent(seen: Array, felt: Array) -> float:
    """Return the coherence of two paths (k, 2)."""
    z, w = (path @ np.array([1.0, 1j]) for path in (seen, felt))
    size = max(float(np.sum(np.abs(z) ** 2) * np.sum(np.abs(w) ** 2)), 1e-300)
    return float(np.abs(np.sum(np.conj(z) * w)) ** 2) / size


def _by_imu(imu: Imu, p: Array, place: Place, rows: Ints, lag: float = 0.0) -> Paths | None:
    """Return the changes of mean velocity at every middle of three of the fixes ``rows``, as seen and as felt; of fixes
    that are late by ``lag``, s.
    """
    if lag:
        rows = rows[(place.t[rows] - lag >= imu.t[0]) & (place.t[rows] - lag <= imu.t[-1])]
    if len(rows) < LEAST_TRIPLES + 2:
        return None
    when = place.t[rows] - lag
    seen = second(when, place.place_n[rows, :2])
    felt = second(when, np.stack([np.interp(when, imu.t, p[:, i]) for i in range(2)], axis=1))
    gap = np.diff(when)
    longer = np.maximum(gap[1:], gap[:-1])
    near = longer <= HOLE * np.median(longer)
    return when[1:-1][near], seen[near], felt[near]


def path_felt(imu: Imu, t: Array, q: Array, gravity: float) -> Array:
    """Return the path (n, 3) that the IMU feels, in the axes of the attitude, but for a velocity. ``gravity`` m/s^2."""
    p = _path(imu, *_felt(imu, t, q, np.zeros(3)))
    p[:, 2] -= 0.5 * gravity * (imu.t - imu.t[0]) ** 2
    return p


def _path(imu: Imu, a: Array, v: Array) -> Array:
    """Return the integral (n, d) of a velocity whose acceleration is linear between samples."""
    dt = np.diff(imu.t)[:, None]
    steps = v[:-1] * dt + dt**2 / 6 * (2 * a[:-1] + a[1:])
    return np.concatenate([np.zeros((1, v.shape[1])), np.cumsum(steps, axis=0)])


def _by_wheels(t: Array, q: Array, wheels: Wheels, place: Place) -> Paths | None:
    """Return the legs between fixes, as seen and as driven."""
    velocity = np.zeros((len(t), 2))  # nodes without wheels are rests
    velocity[wheels.node] = rotation.rotate(q[wheels.node], wheels.velocity_v @ wheels.R_vb)[:, :2]
    steps = 0.5 * (velocity[1:] + velocity[:-1]) * np.diff(t)[:, None]
    path = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    rows = apart(place.t, LEG_S)
    if len(rows) < LEAST_TRIPLES + 1:
        return None
    went = np.stack([np.interp(place.t[rows], t, path[:, i]) for i in range(2)], axis=1)
    return place.t[rows[1:]], np.diff(place.place_n[rows, :2], axis=0), np.diff(went, axis=0)


def _felt(imu: Imu, t: Array, q: Array, bias_a: Array) -> tuple[Array, Array]:
    """Return specific force and its integral (n, 3) that the IMU feels, in the axes of the attitude."""
    at = np.interp(imu.t, t, np.arange(len(t)))
    left = np.minimum(at.astype(np.int64), len(t) - 2)
    turn = rotation.log_quaternion(rotation.multiply(rotation.conjugate(q[left]), q[left + 1]))
    attitude = rotation.multiply(q[left], rotation.exp_quaternion((at - left)[:, None] * turn))
    a = rotation.rotate(attitude, imu.accel_b - bias_a)
    steps = 0.5 * (a[1:] + a[:-1]) * np.diff(imu.t)[:, None]
    return a, np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def apart(t: Array, least: float = APARTS_S[0]) -> list[int]:
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


def second(t: Array, p: Array) -> Array:
    """Return the change of the mean velocity at every middle of three."""
    mean = np.diff(p, axis=0) / np.diff(t)[:, None]
    return np.asarray(np.diff(mean, axis=0))
