"""Orientations that do not turn as the gyro does."""

from __future__ import annotations

import numpy as np
import pytest

from attest_cli.maths import rotation
from attest_cli.prepare.quaternions import READINGS, doubts
from attest_cli.records import Fixes, Imu


def drive(rng: np.random.Generator) -> tuple[Imu, np.ndarray]:
    t = np.arange(5000) / 50.0
    gyro = 0.2 * np.sin(t[:, None] * [0.31, 0.23, 0.17] + [0.0, 1.0, 2.0])
    q = rotation.chain(rotation.exp_quaternion(np.vstack([np.zeros(3), gyro[1:] / 50.0])))
    return Imu(t, gyro + rng.normal(0.0, 1e-3, gyro.shape), np.tile([0.0, 0.0, 9.8], (5000, 1))), q


def seen(q: np.ndarray, rng: np.random.Generator) -> Fixes:
    noisy = rotation.multiply(q[::10], rotation.exp_quaternion(rng.normal(0.0, 0.02, (500, 3))))
    return Fixes("orientation", "/orientation", np.arange(500) / 5.0, noisy)


def test_orientations_that_turn_with_the_gyro_are_silent(rng: np.random.Generator) -> None:
    imu, q = drive(rng)
    assert doubts(seen(q, rng), imu) == []


@pytest.mark.parametrize("words", READINGS)
def test_each_way_to_write_them_wrong_is_named(words: str, rng: np.random.Generator) -> None:
    imu, q = drive(rng)
    fixes = seen(q, rng)
    wrong = fixes.values
    wrong = rotation.conjugate(wrong) if "world" in words else wrong
    wrong = np.roll(wrong, -1, axis=1) if "order" in words else wrong
    (told,) = doubts(Fixes("orientation", "/orientation", fixes.t, wrong), imu)
    assert words in told.message
    assert told.fatal
