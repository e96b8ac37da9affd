"""Walks of the scenario of Rehbinder and Hu as drives, and how far a pass over them is from the truth."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from attest_cli.filters import Drive, Forward, load
from attest_cli.maths import rotation
from attest_cli.nodes.noise import find_noise
from attest_cli.prepare import prepare
from attest_cli.records import Segment, Smoothed
from attest_cli.segment import find_segments
from attest_cli.settings import Settings
from attest_cli.simulate import WalkingOptions, simulate_walking
from attest_cli.smoothers import SMOOTHERS
from attest_cli.world import find_world

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Walk:
    """A drive and its truth: up in body axes (n, 3), gyro bias (n, 3)."""

    drive: Drive
    up_b: Array
    bias_b: Array

    def with_settings(self, **tables: dict[str, object]) -> Walk:
        """The same log under other settings."""
        old = self.drive.settings.model_dump()
        new = {name: {**old[name], **table} for name, table in tables.items()}
        settings, d = Settings.model_validate({**old, **new}), self.drive
        noise = find_noise(d.log, d.segmentation, settings)
        return replace(self, drive=replace(d, settings=settings, noise=noise))

    def without_stops(self) -> Walk:
        """The same log with its stops unknown, as in the paper; the gyro's bias is not removed."""
        t = self.drive.log.imu.t
        whole = Segment(2, True, float(t[0]), float(t[-1]), 0, len(t), float(t[0]), float(t[-1]))
        segmentation = replace(self.drive.segmentation, segments=(whole,), bias_b=np.zeros(3))
        return replace(self, drive=replace(self.drive, segmentation=segmentation))

    def run(self, name: str = "pseudo-linear") -> Forward:
        """Run a filter over it."""
        return load(name)(self.drive)


@lru_cache(maxsize=4)
def walk(case: str, bias_deg_s: float = 0.05, seed: int = 0, duration_s: float = 120.0) -> Walk:
    """A walk with the noise it states."""
    simulation = simulate_walking(WalkingOptions(seed=seed, case=case, bias_deg_s=bias_deg_s, duration_s=duration_s))  # type: ignore[arg-type]
    settings = Settings.model_validate(simulation.settings)
    log = prepare([simulation.log], settings)
    segmentation = find_segments(log, settings)
    noise = find_noise(log, segmentation, settings)
    truth = simulation.truth
    q = np.stack([truth[f"q_{c}"] for c in "wxyz"], axis=1)
    bias = np.stack([truth[f"gyro_bias_{a}_rad_s"] for a in "xyz"], axis=1)
    drive = Drive(log, segmentation, find_world(log, settings), noise, settings)
    return Walk(drive, rotation.matrix(q)[:, 2], bias)


def tilt(found: Smoothed, up_b: Array) -> tuple[Array, Array]:
    """Tilt errors (n,), rad, and their squares over the told covariance (n,), two degrees of freedom."""
    R = rotation.matrix(found.q)
    e = np.einsum("kij,kj->ki", R, rotation.cross(R[:, 2], up_b))[:, :2]
    P = np.einsum("kij,kjl,kml->kim", R, found.P[:, :3, :3], R)[:, :2, :2]
    return np.linalg.norm(e, axis=1), np.einsum("ki,ki->k", e, np.linalg.solve(P, e[:, :, None])[:, :, 0])


def rms_deg(error: Array) -> float:
    """Root mean square of errors in rad, in degrees."""
    return float(np.degrees(np.sqrt(np.mean(error**2))))


def passes(forward: Forward, smoother: str = "rts") -> tuple[Smoothed, Smoothed]:
    """The forward pass and the smoothed one."""
    return SMOOTHERS["none"](forward.run), SMOOTHERS[smoother](forward.run)


def riccati(t: Array, p0: float, q1: float, q2: float) -> Array:
    r"""Return the scalar covariance at ``t`` (n,) s, of :math:`\dot p=q_1-p^2/q_2` (1.34), in closed form.

    .. math:: p=s\frac{p_0+s\tanh\lambda t}{s+p_0\tanh\lambda t},\quad s=\sqrt{q_1q_2},\ \lambda=\sqrt{q_1/q_2}
    """
    s, grown = math.sqrt(q1 * q2), np.tanh(math.sqrt(q1 / q2) * t)
    return np.asarray(s * (p0 + s * grown) / (s + p0 * grown))
