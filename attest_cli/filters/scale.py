r"""The scale error of the gyro that a forward run shows, without a state for it.

A constant that the filter does not estimate shifts its errors by a sensitivity :math:`U` times that constant, which
runs through the same chain; what innovations have of it gives its estimate (Friedland 1969, separate-bias estimation).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..maths import rotation
from ..maths.consistency import upper_quantile
from ..nodes import Nodes
from ..records import Array, FilterRun, Warn
from . import Drive

AS_IT_COMES = 5e-3  # scale error of a gyro, where nothing bounds it or states of the navigation take it up
VAGUE = 0.002  # of which wheels are asked too: less makes no error that an assumed scale does not cover
KNOWN, LARGEST = 0.02, 0.1  # a scale error is learnt to so much or not at all; a larger one is another fault
ASKED = frozenset({"gravity", "zero_rate", "sun"})
ALIKE = frozenset({"compass"})  # an error of it that goes with the heading looks like one of the scale
SHOWN = "the drive, which shows a scale error"  # source
ALL = np.eye(3).ravel()  # what all axes share
WIDE, SQUARE, CHANCE = 0.15, 0.01, 1e-4  # errors of axes are looked for with; square to half a degree; by noise
SHOWS, ANGLES = 0.05, 36  # of the prior: what a drive must show of errors; angles, of nine unknowns, that do
UNTURNED = frozenset({"zero_rate"})  # says nothing of a turn
LARGEST_OF_AXES, EXPLAINS = 0.3, 5.8  # larger ones are another fault; sigma of nine unknowns at that chance
ROUNDS = 3  # of errors of axes, which bend the run that shows them
TOLD, SIGMAS = 0.005, 3.0  # least error of an axis that is told, and in sigmas
TURNED_RAD = np.radians(1.2)  # from which a turn is told as a contradiction
HINT = "calibrate its scale and axes; what the drive shows of them was taken out, sigma counts what is left"
TURNED_HINT = "if the accelerometer is the one that is turned, tilt is off by as much: calibrate their axes"
LIKELY, SURE = 2.5, 4.0  # sigma from which it counts as noise; from which it is taken out


@dataclass(frozen=True, slots=True)
class Evidence:
    """What a forward run has of the errors ``M`` (3, 3), row by row, of a gyro that reads so much too little: their
    ``information`` (9, 9), and ``seen`` (9,), that times their estimate; from ``count`` angles.
    """

    information: Array
    seen: Array
    count: int

    def common(self) -> tuple[float, float]:
        """Return the scale error that all axes share, if they have no other, and its sigma."""
        weight = float(ALL @ self.information @ ALL)
        return (float(ALL @ self.seen) / weight, weight**-0.5) if weight > 0.0 else (0.0, np.inf)

    def differ(self, assumed: float) -> bool:
        r"""Whether the axes have more than a common error and those that are assumed of each:

        .. math:: b^T(W+WP_0W)^{-1}b,\quad P_0=\sigma_0^2I+\sigma_s^2ee^T

        is chi-square where they have not; combinations that the drive does not show are left out.
        """
        if self.count < ANGLES:
            return False
        size, V = np.linalg.eigh(self.information)
        V = V[:, size > SHOWS / WIDE**2]
        prior = assumed**2 * np.eye(9) + WIDE**2 * np.outer(ALL, ALL)
        C = V.T @ (self.information + self.information @ prior @ self.information) @ V
        b = V.T @ self.seen
        return V.shape[1] > 0 and float(b @ np.linalg.solve(C, b)) > upper_quantile(V.shape[1], CHANCE)

    def each(self) -> tuple[Array, Array]:
        r"""Return the errors (3, 3) of axes of which nothing is known, and their sigma: scales, or also turns of them,
        whichever is likelier by :math:`\frac12b^TPb-\frac12\log|I+WP_0|`.
        """
        best, found, P = -np.inf, np.zeros(9), np.eye(9)
        for turned in (SQUARE, WIDE):
            prior = np.diag(np.where(ALL > 0.0, WIDE, turned) ** 2) + WIDE**2 * np.outer(ALL, ALL)
            left = np.linalg.inv(self.information + np.linalg.inv(prior))
            likely = float(self.seen @ left @ self.seen) - np.linalg.slogdet(np.eye(9) + self.information @ prior)[1]
            if likely > best:
                best, found, P = likely, left @ self.seen, left
        return found.reshape(3, 3), np.sqrt(np.diag(P)).reshape(3, 3)


def learn(nodes: Nodes, run: FilterRun, roles: frozenset[str] = ASKED) -> Evidence:
    r"""Return what the innovations of a run have of the errors of the gyro.

    .. math:: U_{k+1}=\Phi_kV_k+B_k,\quad V=(I-KH)U,\qquad
        W=\sum U^TH^TS^{-1}HU,\quad b=\sum U^TH^TS^{-1}\nu,\quad \hat m=W^{-1}b

    with the turn :math:`B` of the node's interval by each error. Between measurements :math:`U` is summed in world
    axes. With :math:`Y=H^TR^{-1}H`: :math:`KH=PY`, :math:`H^TS^{-1}H=Y-YPY`, :math:`H^TS^{-1}\nu=P_-^{-1}\Delta x`.
    Gravity, sun and zero rate are asked: errors of a compass last, and look ``ALIKE``.
    """
    chain, at = run.chain, nodes.measured
    R = rotation.matrix(run.q)
    turns = rotation.log_quaternion(nodes.increments.dq)
    turned = np.einsum("kij,kl->kijl", R[1:], turns).reshape(len(turns), 3, 9)
    biased = R[1:] @ chain.Phi[:, :3, 3:]
    steps = [np.concatenate([np.zeros((1, *x.shape[1:])), np.cumsum(x, axis=0)])[at] for x in (turned, biased)]
    turned, biased = (np.diff(x, axis=0, prepend=np.zeros((1, *x.shape[1:]))) for x in steps)
    Y, P, R = chain.info[at], chain.P[at], R[at]
    left = np.eye(6) - P @ Y
    U, v, bias = np.empty((len(at), 6, 9)), np.zeros((3, 9)), np.zeros((3, 9))
    for k, (R_k, left_k) in enumerate(zip(R, left, strict=True)):
        U[k, :3], U[k, 3:] = R_k.T @ (v + turned[k] + biased[k] @ bias), bias
        V = left_k @ U[k]
        v, bias = R_k @ V[:3], V[3:]
    asked = [all(m.role in roles for m in group) for group in nodes.measurements]
    count = sum(m.sensor.dof for group, use in zip(nodes.measurements, asked, strict=True) if use for m in group
                if m.role not in UNTURNED)  # fmt: skip
    U, Y, left, at = U[asked], Y[asked], left[asked], at[asked]
    seen = np.linalg.solve(chain.P_pred[at], chain.dx[at][..., None])[..., 0]
    information = np.einsum("kia,kij,kjl,klb->ab", U, Y, left, U, optimize=True)
    return Evidence(0.5 * (information + information.T), np.einsum("kia,ki->a", U, seen), count)


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


def without(drive: Drive, error: float | Array) -> Drive:
    """Return the drive with a scale error of the gyro, or errors ``M`` (3, 3) of its axes, taken out."""
    gyro, bias = drive.log.imu.gyro_b, drive.segmentation.bias_b
    M = np.asarray(error) * np.eye(3) if np.ndim(error) == 0 else np.asarray(error)
    imu = replace(drive.log.imu, gyro_b=gyro + (gyro - bias) @ M.T)
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


def mended_axes(drive: Drive, axes: Array, sigma: Array) -> tuple[Drive, tuple[Warn, ...]]:
    """Return the drive with the errors of a gyro whose axes are ``axes`` (3, 3), :math:`I+M`, taken out, and told."""
    left = max(float(np.sqrt(np.mean(sigma**2, axis=1)).max()), drive.noise.gyro_scale)  # of the axis least known
    sources = {**drive.noise.sources, "gyro_scale_sigma": SHOWN}
    better = without(drive, np.linalg.inv(axes) - np.eye(3))
    return replace(better, noise=replace(drive.noise, gyro_scale=left, sources=sources)), (told_axes(axes, sigma),)


def told_axes(axes: Array, sigma: Array) -> Warn:
    r"""Say what ``axes`` the gyro has: :math:`I+M=RS`, turned by ``R`` against the accelerometer, of scale ``S``.

    Which of the two sensors is turned no drive tells: beyond a small turn, the attitude may be that of the wrong one.
    """
    U, _, V = np.linalg.svd(axes)
    turn, S = rotation.log_quaternion(rotation.from_matrix(U @ V)), (U @ V).T @ axes
    of_turn = 0.5 * np.hypot([sigma[2, 1], sigma[0, 2], sigma[1, 0]], [sigma[1, 2], sigma[2, 0], sigma[0, 1]])
    own = np.diag(S) - 1.0
    facts, angle = list[str](), float(np.linalg.norm(turn))
    if angle > TOLD and np.any(np.abs(turn) > SIGMAS * of_turn):
        facts.append(f"is turned {np.degrees(angle):.1f} deg against the accelerometer")
    sure = (np.abs(own) > TOLD) & (np.abs(own) > SIGMAS * np.diag(sigma))
    if sure.any():
        by_axis = ", ".join(f"{1.0 + own[i]:.3f}" for i in np.flatnonzero(sure))
        names = ", ".join("xyz"[i] for i in np.flatnonzero(sure))
        facts.append(f"reads {by_axis} times the rate about {names}")
    message = (
        " and ".join(facts) or f"has axes that are off by up to {np.degrees(np.abs(axes - np.eye(3)).max()):.1f} deg"
    )
    if facts and angle > TURNED_RAD and "turned" in facts[0]:
        return Warn("gyro-against-accel", f"the gyro {message}: taken out", TURNED_HINT, fatal=True)
    return Warn("gyro-scale", f"the gyro {message} by the other sensors: corrected", HINT)
