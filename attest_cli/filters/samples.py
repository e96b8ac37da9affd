"""A drive at the rate of its IMU, for the filters that update at every sample, and what they say of each update."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..maths import rotation
from ..maths.sequential import Pass
from ..nodes import mean_rate
from ..nodes.noise import motion_density, reference_bias
from ..nodes.observations import at_stop
from ..records import Array, Bools, Innovations, Warn
from . import Drive

JOINED = 1.5  # steps longer than this times the one before do not share a coning term


@dataclass(frozen=True, slots=True)
class Samples:
    """The IMU at its own rate (n samples), the bias of the stops removed.

    ``t`` (n,) s; ``dt`` (n - 1,); ``turn_b`` (n - 1, 3) rotation vector of each step; ``rate_b`` (n, 3) rad/s and
    ``force_b`` (n, 3) m/s^2; ``bias_b`` (n, 3) what was removed, known to ``bias_sigma`` rad/s; ``still`` (n,) at a
    stop; ``gap`` (n - 1,) steps over a hole, whose turn is unknown; ``density`` (n - 1,) gyro noise, (rad/s)^2/Hz.
    """

    t: Array
    dt: Array
    turn_b: Array
    rate_b: Array
    force_b: Array
    bias_b: Array
    bias_sigma: float
    still: Bools
    gap: Bools
    density: Array


def untold(drive: Drive) -> tuple[Warn, ...]:
    """Say which settings mean nothing to a filter without sensors that tell directions."""
    cfg = drive.settings.smoothing
    if cfg.absolute == "auto":
        return ()
    return (Warn("no-absolute", f"--absolute has no meaning with --filter {cfg.filter}: not used"),)


def rotation_vectors(alpha: Array, joined: Bools) -> Array:
    r"""Return rotation vectors of steps from integrated rates, third order (Edwards' update, exactly unit).

    .. math:: \phi_k=\alpha_k+\tfrac1{12}\,\alpha_{k-1}\times\alpha_k

    Parameters
    ----------
    alpha : (m, 3) integral of the rate over each step, rad
    joined : (m,) False where the step before is of another length or missing: no coning term

    Notes
    -----
    The rate is linear over two steps. Vaganay et al. 1993 print a commutator twice too large (erratum 5 of the note).
    """
    before = np.concatenate([alpha[:1], alpha[:-1]])
    return np.asarray(alpha + np.where(joined, 1.0, 0.0)[:, None] / 12.0 * rotation.cross(before, alpha))


def samples(drive: Drive) -> Samples:
    """Return the drive at the rate of its IMU."""
    imu, segmentation, noise = drive.log.imu, drive.segmentation, drive.noise
    bias = reference_bias(drive.log, segmentation, imu.t)
    rate, dt = imu.gyro_b - bias, np.diff(imu.t)
    held = drive.settings.imu.gyro_samples == "interval"
    alpha = (rate[1:] if held else 0.5 * (rate[1:] + rate[:-1])) * dt[:, None]
    gap = np.zeros(len(dt), dtype=np.bool_)
    for start, end in drive.log.gaps:
        gap |= (imu.t[1:] > start) & (imu.t[:-1] < end)
    joined = np.concatenate([[False], (dt[1:] < JOINED * dt[:-1]) & ~gap[1:] & ~gap[:-1]])
    turn = rotation_vectors(alpha, joined)
    turn[gap] = 0.0
    middle = 0.5 * (imu.t[1:] + imu.t[:-1])
    density = motion_density(noise, mean_rate(imu, middle) - 0.5 * (bias[1:] + bias[:-1]))
    still = at_stop(imu.t, segmentation)
    return Samples(imu.t, dt, turn, rate, imu.accel_b, bias, _bias_sigma(drive), still, gap, density)


def _bias_sigma(drive: Drive) -> float:
    """Return how well the stops know the bias between them, rad/s; without a stop, the setting."""
    stops, noise = drive.segmentation.stops, drive.noise
    if not stops:
        return drive.settings.imu.gyro_bias_sigma
    length = float(np.median([max(s.used_end - s.used_start, 1e-3) for s in stops]))
    span = float(drive.log.imu.t[-1] - drive.log.imu.t[0])
    return float(np.hypot(noise.gyro_density / np.sqrt(length), noise.gyro_walk * np.sqrt(span / (2 * len(stops)))))


def innovations(t: Array, found: Pass, roles: Mapping[str, slice]) -> Innovations:
    """Return one row per sample and role; ``roles`` says which rows of the measurement are whose."""
    rows = np.flatnonzero(np.isfinite(found.nu[:, 0]))
    names, dofs, scores, values = [], [], [], []
    for role, part in roles.items():
        nu, S = found.nu[rows, part], found.S[rows, part, part]
        z = np.full((len(rows), 3), np.nan)
        z[:, : nu.shape[1]] = nu / np.sqrt(np.einsum("kii->ki", S))
        names.append(np.full(len(rows), role))
        dofs.append(np.full(len(rows), nu.shape[1]))
        scores.append(np.einsum("ki,ki->k", nu, np.linalg.solve(S, nu[:, :, None])[:, :, 0]))
        values.append(z)
    node = np.tile(rows, len(roles))
    used = np.ones(len(node), dtype=np.bool_)
    return Innovations(
        np.concatenate(names), t[node], node, np.concatenate(dofs), np.concatenate(scores), used, np.concatenate(values)
    )
