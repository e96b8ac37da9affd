"""What wheels tell a filter over nodes: which of them are believed, and the vertical while the vehicle moves."""

from __future__ import annotations

import numpy as np

from ..maths import kalman, rotation
from ..nodes import Nodes
from ..nodes.noise import reference_bias
from ..nodes.observations import Observation
from ..records import Array, FilterRun, Fixes, Log
from ..sensors import Direction
from ..wheels import Judged, judge, longest_hole, sigma_of
from . import Drive

WINDOW_S = 2.0  # scatter by bumps is the same over any window, so that short ones, which are many, show more
LEAST_WINDOWS = 8  # whose scatter is known
OF_DIFFERENCES = 1.4826 / np.sqrt(2.0)  # sigma of a normal error over the median size of differences of two


def smoothed(run: FilterRun) -> tuple[Array, Array]:
    """Return the smoothed attitude (n, 4) and gyro bias (n, 3) of a run over nodes."""
    d = kalman.rts(run.chain).d
    return rotation.normalise(rotation.multiply(run.q, rotation.exp_quaternion(d[:, :3]))), run.bias + d[:, 3:]


def believed(drive: Drive, nodes: Nodes, q: Array, bias: Array) -> Judged | None:
    """Return which odometry is believed beside an attitude (n, 4) and gyro bias (n, 3) at the nodes."""
    odometry = drive.log.fixes.get("odometry")
    if odometry is None:
        return None
    at_samples = _at_samples(drive.log, nodes, q, bias)
    return judge(drive.log, at_samples, drive.segmentation, odometry, drive.world.gravity, drive.settings)


def _at_samples(log: Log, nodes: Nodes, q: Array, bias: Array) -> Array:
    grid, on_grid = nodes.on_grid(q, bias)
    return np.asarray(on_grid[np.searchsorted(grid, log.imu.t - 1e-9).clip(0, len(grid) - 1)])


def verticals(drive: Drive, nodes: Nodes, run: FilterRun) -> list[Observation]:
    r"""Return the vertical in motion, from the accelerometer less what the wheels say of its acceleration.

    With the gyro's turn :math:`C` from the middle of a window, the speed :math:`v` along the forward axis :math:`u_b`,
    and a Hann window :math:`w` of integral 1, which is zero at both ends,

    .. math:: R^Tg_n=\int w\,C\Big(f_b-\frac{dv_b}{dt}-\omega\times v_b\Big)dt
        =\int w\,C\,f_b\,dt+\int\dot w\,C\,u_bv\,dt

    Its sigma is what white noise of both makes of it or, where that is more, what the directions scatter from window
    to window beside the attitude of ``run``; and the accelerometer's bias, which all windows of a motion share.
    """
    q, bias = smoothed(run)
    wheels = believed(drive, nodes, q, bias)
    if wheels is None or wheels.fixes is None:
        return []
    gyro = drive.log.imu.gyro_b - reference_bias(drive.log, drive.segmentation, drive.log.imu.t)
    spans = _windows(drive, wheels.fixes)
    if len(spans) < LEAST_WINDOWS:
        return []
    forward = rotation.matrix(wheels.q_bv)[:, 0]
    found = [_vertical(drive, gyro, wheels.fixes, forward, start) for _, start in spans]
    up, at = np.array([v for v, _ in found]), np.array([k for _, k in found])
    level = rotation.rotate(_at_samples(drive.log, nodes, q, bias)[at], up)[:, :2]
    scatter = OF_DIFFERENCES * float(np.median(np.abs(np.diff(level, axis=0))))
    white, shared = _white(drive, wheels.fixes), drive.settings.imu.accel_bias_sigma / drive.world.gravity
    motion, count = np.unique([number for number, _ in spans], return_inverse=True, return_counts=True)[1:]
    variance = max(scatter, white) ** 2 + count[motion] * shared**2
    t, sensor = drive.log.imu.t[at], Direction(np.array([0.0, 0.0, 1.0]))
    return [
        Observation("gravity", sensor, float(when), np.array([when]), u[None], v * np.eye(2), False)
        for when, u, v in zip(t, up, variance, strict=True)
    ]


def _windows(drive: Drive, wheels: Fixes) -> list[tuple[int, float]]:
    """Return number of the motion and start of the windows in which wheels and IMU have no hole."""
    imu, longest, out = drive.log.imu, longest_hole(wheels.t), list[tuple[int, float]]()
    for number, s in enumerate(drive.segmentation.motions):
        for start in np.arange(s.start, s.end - WINDOW_S, WINDOW_S).tolist():
            for t, hole in ((imu.t, 0.1 * WINDOW_S), (wheels.t, longest)):
                lo, hi = np.searchsorted(t, [start, start + WINDOW_S])
                if np.diff(np.concatenate([[start], t[lo:hi], [start + WINDOW_S]])).max() > hole:
                    break
            else:
                out.append((number, start))
    return out


def _vertical(drive: Drive, gyro: Array, wheels: Fixes, forward: Array, start: float) -> tuple[Array, int]:
    """Return the vertical (3,) of the window from ``start`` in body axes at its middle sample, and that sample."""
    t = drive.log.imu.t
    lo, hi = np.searchsorted(t, [start, start + WINDOW_S])
    rows, half = slice(lo, hi), (hi - lo) // 2
    step = 0.5 * (gyro[lo + 1 : hi] + gyro[lo : hi - 1]) * np.diff(t[rows])[:, None]
    q = rotation.chain(rotation.exp_quaternion(np.concatenate([np.zeros((1, 3)), step])))
    C = rotation.matrix(rotation.multiply(rotation.conjugate(q[half]), q))
    phase, dt = 2.0 * np.pi * (t[rows] - start) / WINDOW_S, np.gradient(t[rows])
    w, slope = dt * (1.0 - np.cos(phase)), dt * np.sin(phase) * 2.0 * np.pi / WINDOW_S
    speed = np.interp(t[rows], wheels.t, wheels.values[:, 0])
    total = np.einsum("m,mij,mj->i", w, C, drive.log.imu.accel_b[rows])
    total += np.einsum("m,mij,j->i", slope * speed, C, forward)
    return total / np.linalg.norm(total), int(lo + half)


def _white(drive: Drive, wheels: Fixes) -> float:
    r"""Return the sigma, rad, that white noise of both leaves in a window of length T:
    :math:`\int w^2=3/2T,\ \int\dot w^2=2\pi^2/T^3`.
    """
    every = float(np.median(np.diff(wheels.t)))
    speed = float(np.median(sigma_of(wheels, drive.settings.odometry)[:, 0])) * np.sqrt(every)
    accel = drive.noise.accel_density * np.sqrt(1.5 / WINDOW_S)
    return float(np.hypot(accel, speed * np.pi * np.sqrt(2.0 / WINDOW_S**3))) / drive.world.gravity
