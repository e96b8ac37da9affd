r"""The scale error of the gyro that a forward run shows, without a state for it.

A constant that the filter does not estimate shifts its errors by a sensitivity :math:`U` times that constant, which
runs through the same chain; what innovations have of it gives its estimate (Friedland 1969, separate-bias estimation).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..maths import rotation
from ..nodes import Nodes
from ..records import FilterRun, Warn
from . import Drive

VAGUE = 0.002  # of which wheels are asked too: less makes no error that an assumed scale does not cover
KNOWN, LARGEST = 0.02, 0.1  # a scale error is learnt to so much or not at all; a larger one is another fault
ASKED = frozenset({"gravity", "zero_rate", "sun"})
ALIKE = frozenset({"compass"})  # an error of it that goes with the heading looks like one of the scale
SHOWN = "the drive, which shows a scale error"  # source
LIKELY, SURE = 2.5, 4.0  # sigma from which it counts as noise; from which it is taken out


def learn(nodes: Nodes, run: FilterRun, roles: frozenset[str] = ASKED) -> tuple[float, float]:
    r"""Return the scale error, a share of the rate, that all axes of the gyro share, and its sigma.

    .. math:: U_{k+1}=\Phi_kV_k+B_k,\quad V=(I-KH)U,\qquad
        \hat s=\frac{\sum U^TH^TS^{-1}\nu}{\sum U^TH^TS^{-1}HU}

    with the turn :math:`B` of the node's interval. Between measurements :math:`U` is summed in world axes. With
    :math:`Y=H^TR^{-1}H`: :math:`KH=PY`, :math:`H^TS^{-1}H=Y-YPY`, :math:`H^TS^{-1}\nu=P_-^{-1}\Delta x`. Gravity, sun
    and zero rate are asked: errors of a compass last, and look ``ALIKE``.
    """
    chain, at = run.chain, nodes.measured
    R = rotation.matrix(run.q)
    turned = np.einsum("kij,kj->ki", R[1:], rotation.log_quaternion(nodes.increments.dq))
    biased = R[1:] @ chain.Phi[:, :3, 3:]
    steps = [np.concatenate([np.zeros((1, *x.shape[1:])), np.cumsum(x, axis=0)])[at] for x in (turned, biased)]
    turned, biased = (np.diff(x, axis=0, prepend=np.zeros((1, *x.shape[1:]))) for x in steps)
    Y, P, R = chain.info[at], chain.P[at], R[at]
    left = np.eye(6) - P @ Y
    U, v, bias = np.empty((len(at), 6)), np.zeros(3), np.zeros(3)
    for k, (R_k, left_k) in enumerate(zip(R, left, strict=True)):
        U[k, :3], U[k, 3:] = R_k.T @ (v + turned[k] + biased[k] @ bias), bias
        V = left_k @ U[k]
        v, bias = R_k @ V[:3], V[3:]
    asked = [all(m.role in roles for m in group) for group in nodes.measurements]
    U, Y, left, at = U[asked], Y[asked], left[asked], at[asked]
    seen = np.linalg.solve(chain.P_pred[at], chain.dx[at][..., None])[..., 0]
    weight = float(np.einsum("ki,kij,kjl,kl->", U, Y, left, U))
    return (float(np.einsum("ki,ki->", U, seen)) / weight, weight**-0.5) if weight > 0.0 else (0.0, np.inf)


def mended(drive: Drive, error: float, sigma: float) -> tuple[Drive | None, tuple[Warn, ...]]:
    """Return the drive with a scale error of the gyro taken out where it is sure and more than is assumed, told where
    it is much more; where it is likely, with noise that covers it, unless its sigma is stated; none where neither.
    """
    assumed = drive.noise.gyro_scale
    if sigma > KNOWN or abs(error) > LARGEST:
        return None, ()
    sources = {**drive.noise.sources, "gyro_scale_sigma": SHOWN}
    if abs(error) < max(SURE * sigma, assumed):
        if drive.settings.imu.gyro_scale_sigma is not None or abs(error) < LIKELY * float(np.hypot(sigma, assumed)):
            return None, ()  # what is stated wins over what is only likely
        return replace(drive, noise=replace(drive.noise, gyro_scale=abs(error), sources=sources)), ()
    better = replace(without(drive, error), noise=replace(drive.noise, gyro_scale=max(sigma, assumed), sources=sources))
    if abs(error) < LIKELY * assumed:
        return better, ()  # no more than such a gyro may have
    size = f"{100.0 * abs(error):.1f} % (sigma {100.0 * sigma:.1f} %) too {'little' if error > 0.0 else 'much'}"
    message = f"the gyro reads {size} by the other sensors"
    return better, (
        Warn("gyro-scale", f"{message}: corrected", "calibrate its scale, or state [imu] gyro_scale_sigma"),
    )


def without(drive: Drive, error: float) -> Drive:
    """Return the drive with a scale error of the gyro taken out."""
    gyro, bias = drive.log.imu.gyro_b, drive.segmentation.bias_b
    imu = replace(drive.log.imu, gyro_b=gyro + error * (gyro - bias))
    return replace(drive, log=replace(drive.log, imu=imu))


def doubted(
    drive: Drive, alone: tuple[float, float], both: tuple[float, float]
) -> tuple[Drive | None, tuple[Warn, ...]]:  # fmt: skip
    r"""Return the drive with noise that covers a scale error that the compass shows with the others (``both``), where
    they do not contradict it (``alone``); told where it is sure. It is not taken out: who is wrong is not known.

    The compass itself shows :math:`(s_2/\sigma_2^2-s_1/\sigma_1^2)/w` with :math:`w=\sigma_2^{-2}-\sigma_1^{-2}`.
    """
    (error, sigma), weight = both, both[1] ** -2 - alone[1] ** -2
    known = max(float(np.hypot(sigma, drive.noise.gyro_scale)), 1e-12)
    if sigma > KNOWN or abs(error) < LIKELY * known or drive.settings.imu.gyro_scale_sigma is not None or weight <= 0.0:
        return None, ()
    apart = (error / sigma**2 - alone[0] / alone[1] ** 2) / weight - alone[0]
    if abs(apart) > LIKELY * float(np.hypot(alone[1], weight**-0.5)):
        return None, ()
    sources = {**drive.noise.sources, "gyro_scale_sigma": SHOWN}
    better = replace(drive, noise=replace(drive.noise, gyro_scale=abs(error), sources=sources))
    if abs(error) < SURE * known:
        return better, ()
    size = f"{100.0 * abs(error):.1f} % (sigma {100.0 * sigma:.1f} %) too {'little' if error > 0.0 else 'much'}"
    message = f"by the compass the gyro reads {size}: sigma raised to fit"
    return better, (Warn("gyro-scale", message, "calibrate its scale; or does the compass err with the heading?"),)
