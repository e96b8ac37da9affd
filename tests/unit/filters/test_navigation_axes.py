"""The gyro's scale and axes that a hand shows: taken out where they are beyond a good sensor, else left alone."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from attest_cli.filters import Drive, Forward, navigation, scale
from attest_cli.filters.navigation import axes
from attest_cli.filters.navigation.rounds import Navigated, navigate
from attest_cli.maths import kalman, rotation
from attest_cli.nodes.noise import find_noise
from attest_cli.records import Fixes, Imu, Log
from attest_cli.segment import find_segments
from attest_cli.settings import Settings
from attest_cli.world import find_world

Array = NDArray[np.float64]
DT, MOTION_S, STOP_S, MOTIONS = 0.02, 6.0, 3.0, 3
FIELD = np.array([0.0, 22e-6, -42e-6])


@cache
def turned(seed: int) -> tuple[Array, Array, Array]:
    """Return times, attitude and rate of an IMU that a hand turns between rests."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, STOP_S + MOTIONS * (MOTION_S + STOP_S), DT)
    into = (t - STOP_S) % (MOTION_S + STOP_S) / MOTION_S
    envelope = np.where((t > STOP_S) & (into < 1.0), np.sin(np.pi * np.minimum(into, 1.0)) ** 2, 0.0)
    rate = envelope[:, None] * np.stack(
        [1.6 * np.sin(2 * np.pi * rng.uniform(0.2, 0.6) * t + rng.uniform(0, 6)) for _ in range(3)], axis=1
    )
    middle = 0.5 * (rate[1:] + rate[:-1])
    start = np.array([[0.0, 0.0, 0.0, 1.0]])
    return t, np.concatenate([start, rotation.chain(rotation.exp_quaternion(middle * DT), start[0])]), rate


def hand(seed: int, M: Array) -> Drive:
    t, q, rate = turned(seed)
    rng = np.random.default_rng(seed + 50)
    gyro = rate @ (np.eye(3) + M).T + rng.normal(0, 1e-3, (len(t), 3)) + np.array([2e-3, -1e-3, 1e-3])
    back = rotation.conjugate(q)
    force = rotation.rotate(back, np.array([0.0, 0.0, 9.80665])) + rng.normal(0, 0.02, (len(t), 3))
    field = rotation.rotate(back, FIELD) + rng.normal(0, 2e-7, (len(t), 3))
    log = Log((), 0, (t * 1e9).astype(np.int64), Imu(t, gyro, force),
              {"magnetometer": Fixes("magnetometer", "mag", t, field)}, np.zeros((0, 2)), {})  # fmt: skip
    settings = Settings.model_validate({"world": {"magnetic_field_ut": (1e6 * FIELD).tolist()}})
    segmentation = find_segments(log, settings)
    noise = find_noise(log, segmentation, settings)
    return Drive(log, segmentation, find_world(log, settings), noise, settings)


@cache
def scaled() -> tuple[Drive, Navigated]:
    """A hand whose gyro reads six percent too much, solved as if it did not."""
    drive = hand(2, 0.06 * np.eye(3))
    return drive, navigate(drive)


def worst(found: Forward, seed: int) -> float:
    """Return the largest error of tilt, sigmas."""
    assert found.run.read is not None
    smoothed = found.run.read(kalman.rts(found.run.chain))
    t, q, rate = turned(seed)
    k = np.searchsorted(t, smoothed.t + 1e-9) - 1
    true = rotation.multiply(q[k], rotation.exp_quaternion(rate[k] * (smoothed.t - t[k])[:, None]))
    off = rotation.log_quaternion(rotation.multiply(true, rotation.conjugate(smoothed.q)))  # navigation axes
    R = rotation.matrix(smoothed.q)
    sigma = np.sqrt(np.einsum("kij,kjl,kil->ki", R, smoothed.P[:, :3, :3], R))
    return float(np.abs(off[:, :2] / sigma[:, :2]).max())


def test_a_good_gyro_is_left_alone() -> None:
    found = navigation.forward(hand(1, 2e-3 * np.diag([1.0, -1.0, 0.5])))
    assert not {"gyro-scale", "gyro-against-accel"} & {w.code for w in found.warnings}
    assert worst(found, 1) < 4.0


def test_a_scale_error_is_taken_out_and_told() -> None:
    found = navigation.forward(hand(2, 0.06 * np.eye(3)))
    told = [w for w in found.warnings if w.code == "gyro-scale"]
    assert [w.fatal for w in told] == [False]
    assert "1.06" in told[0].message
    assert worst(found, 2) < 4.0


@pytest.mark.parametrize(("added", "asked"), [(5e-3, True), (0.2, False)])
def test_scattering_stamps_hide_no_scale_but_clipping_does(added: float, asked: bool) -> None:
    drive, done = scaled()
    imu = replace(drive.log.imu, gyro_added=np.where(np.arange(len(drive.log.imu.t)) % 50 < 25, added, 0.0))
    assert axes.contradicted(replace(drive.log, imu=imu), done) == asked


def test_a_gyro_turned_against_the_accelerometer_fails_the_log() -> None:
    R = rotation.matrix(rotation.exp_quaternion(np.array([0.0, np.radians(9.0), 0.0])))
    found = navigation.forward(hand(3, R - np.eye(3)))
    told = [w for w in found.warnings if w.code == "gyro-against-accel"]
    assert [w.fatal for w in told] == [True]
    assert float(told[0].message.split("turned ")[1].split(" ")[0]) == pytest.approx(9.0, abs=1.0)
    assert worst(found, 3) < 4.0


def test_what_is_told_is_the_turn_and_the_scale() -> None:
    R = rotation.matrix(rotation.exp_quaternion(np.array([np.radians(0.9), 0.0, 0.0])))
    told = scale.told_axes(R @ np.diag([1.0, 1.03, 1.0]), np.full((3, 3), 1e-3))
    assert "turned 0.9 deg" in told.message
    assert "1.030 times the rate about y" in told.message
    assert not told.fatal
