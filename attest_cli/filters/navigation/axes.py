r"""The scale and misalignment :math:`M` of a gyro that a drive shows, where they are beyond what is assumed.

.. math:: \omega_m=(I+M)\omega+b

The states of the navigation are for the small errors of a calibrated sensor. A wider prior would cost a good gyro some
of its accuracy, so it is asked only where the drive contradicts the narrow one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...maths.consistency import upper_quantile
from ...records import Array, Log
from .. import Drive, scale
from . import solve
from .rounds import Navigated

STATES = "gyro scale"
LATE, OPENS = "accel-late", {"gyro-noise-raised", "gyro-scale"}  # codes of warnings
SHOWS = 0.05  # of its prior variance: what the drive must take off a combination of states for it to count
SURE = 1e-4  # chance of a misfit taken as proof
WIDE, LARGEST = 0.15, 0.3  # sigma with which the errors are looked for; larger ones are another fault
OFTEN, CLIPPED = 2e-3, 0.1  # share of clipped samples that bends the scale; rad/s/sqrt(Hz): as noisy as those
FAR = 30.0  # NIS that is larger counts as this


def contradicted(log: Log, done: Navigated) -> bool:
    r"""Whether the gyro's errors are beyond what is assumed of them, and neither samples that it clipped nor its clock
    explain that:

    .. math:: \hat x^T(P_0-P)^{-1}\hat x

    is chi-square where they are not, for :math:`\hat x` is what the innovations have of the states, of covariance
    :math:`P_0-P`. Combinations of them that the drive does not show are left out. Where stated noise leaves no states
    for them, the stops are asked.
    """
    problem, found = done.problem, done.found
    clipped = log.imu.gyro_added is not None and float(np.mean(log.imu.gyro_added >= CLIPPED)) > OFTEN
    if clipped or any(warn.code == LATE for warn in log.warnings):
        return False
    if STATES not in problem.layout:
        return any(warn.code in OPENS for warn in done.begun.warnings)
    part = problem.layout.parts[STATES]
    P0, P = problem.prior[1][part, part], found.errors.P[0, part, part]
    root = np.sqrt(np.diag(P0))
    shown, V = np.linalg.eigh((P0 - P) / np.outer(root, root))
    use = shown > SHOWS
    z = V.T @ ((found.smoothed.x[0, part] - problem.prior[0].x[0, part]) / root)
    return bool(use.any()) and float(np.sum(z[use] ** 2 / shown[use])) > upper_quantile(int(use.sum()), SURE)


def widened(drive: Drive, sigma: float) -> Drive:
    """Return the drive with a gyro whose scale and axes may be off by as much."""
    sources = {**drive.noise.sources, "gyro_scale_sigma": scale.SHOWN}
    return replace(drive, noise=replace(drive.noise, gyro_scale=sigma, sources=sources))


def mended(drive: Drive, wide: Navigated) -> tuple[Drive, Array, Array] | None:
    """Return the drive without the errors of its gyro that the solution with a ``wide`` prior shows, the axes
    :math:`I+M` (3, 3) of that gyro and their sigma; none where it is no error of scale and axes.
    """
    part = wide.problem.layout.parts[STATES]
    M = wide.found.smoothed.x[0, part].reshape(3, 3)
    sigma = np.sqrt(np.diagonal(wide.found.errors.P[0])[part]).reshape(3, 3)
    if np.abs(M).max() > LARGEST:
        return None
    gyro, bias = drive.log.imu.gyro_b, drive.segmentation.bias_b
    imu = replace(drive.log.imu, gyro_b=gyro - (gyro - bias) @ M.T)
    left = max(float(np.median(sigma)), drive.noise.gyro_scale)
    better = widened(replace(drive, log=replace(drive.log, imu=imu)), left)
    return better, np.asarray(np.linalg.inv(np.eye(3) - M)), np.asarray(sigma)


def misfit(done: Navigated) -> float:
    """Return the sum of the NIS of all sensors, outliers capped."""
    nis = solve.innovations(done.found.found, done.found.rows).nis
    return float(np.minimum(nis, FAR).sum())
