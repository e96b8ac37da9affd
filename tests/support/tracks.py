"""Smooth tracks of poses in closed form, sampled anywhere, with noise, constant rotations and offsets put in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from attest_cli.evaluate import Poses
from attest_cli.maths import rotation

Array = NDArray[np.float64]
T0 = 1_780_308_000_000_000_000


@dataclass(frozen=True)
class Motion:
    """Yaw, pitch, roll and position as sums of sines: smooth, known at any time. ``lively`` scales the turns."""

    seed: int = 1
    lively: float = 1.0

    def _sines(self, t: Array, k: int, size: float) -> Array:
        rng = np.random.default_rng([self.seed, k])
        f, phase = rng.uniform(0.1, 1.3, (5, 3)), rng.uniform(0.0, 2 * np.pi, (5, 3))
        return size * np.sin(2 * np.pi * f * t[:, None, None] + phase).sum(axis=1)

    def q(self, t: Array) -> Array:
        """Attitude (n, 4); the oracle's own Euler angles."""
        angles = self._sines(t, 0, 0.25 * self.lively)
        return rotation.continuous(Rotation.from_euler("ZYX", angles).as_quat(scalar_first=True))

    def p(self, t: Array) -> Array:
        """Position (n, 3)."""
        return self._sines(t, 1, 1.5) + np.stack([0.7 * t, 0.2 * t, 0.0 * t], axis=1)


def poses(motion: Motion, t: Array, *, shift: float = 0.0, **more: object) -> Poses:
    """The motion with stamps ``t`` of what it was at ``t + shift``."""
    stamps = T0 + np.rint(t * 1e9).astype(np.int64)
    return Poses(
        **{  # type: ignore[arg-type]
            "source": "track", "kind": "track", "stamps_ns": stamps, "q": motion.q(t + shift),
            "position": motion.p(t + shift), **more,
        }
    )  # fmt: skip


def turned(q: Array, q_world: Array, q_body: Array) -> Array:
    """``q_world q q_body``."""
    return rotation.multiply(rotation.multiply(q_world, q), q_body)


def noisy(q: Array, sigma: float, rng: np.random.Generator) -> Array:
    """Attitudes with white noise about their body axes."""
    return rotation.multiply(q, rotation.exp_quaternion(rng.normal(0.0, sigma, (len(q), 3))))


def random_rotation(rng: np.random.Generator) -> Array:
    """Uniform on the sphere of quaternions."""
    return np.asarray(Rotation.random(rng=rng).as_quat(scalar_first=True))
