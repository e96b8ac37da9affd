"""Wheels against the accelerometer, stretch by stretch."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from attest_cli.records import Array, Fixes, Imu, Segment, Segmentation
from attest_cli.wheels import slips

G = 9.81
T = np.arange(0.0, 120.0, 0.01)
SLOPE_RAD = 0.05


def drive(rng: np.random.Generator) -> tuple[Imu, Array, Array]:
    """IMU, attitude and true speed of a drive along a slope, 1 to 2 m/s; the IMU sits as the vehicle does."""
    speed = 1.5 + 0.5 * np.sin(0.4 * T)
    ahead = 0.2 * np.cos(0.4 * T) + G * np.sin(SLOPE_RAD)
    force = np.stack([ahead, 0.0 * T, np.full_like(T, G * np.cos(SLOPE_RAD))], axis=1)
    q = np.tile([np.cos(0.5 * SLOPE_RAD), 0.0, -np.sin(0.5 * SLOPE_RAD), 0.0], (len(T), 1))  # nose up
    imu = Imu(T, np.zeros_like(force), force + np.array([0.02, 0.0, 0.0]) + rng.normal(0.0, 0.3, force.shape))
    return imu, q, speed


@pytest.mark.parametrize(
    ("change", "span"),
    [
        (lambda _, v: v, None),
        (lambda _, v: 1.05 * v, None),
        (lambda t, v: np.interp(t - 0.2, t, v), None),
        (lambda t, v: np.where((t > 40.0) & (t < 55.0), v + 1.5, v), (40.0, 55.0)),
        (lambda t, v: np.where((t > 40.0) & (t < 42.0), v + 3.0, v), (40.0, 42.0)),
    ],
    ids=["true", "scaled", "late", "spins", "spins for a moment"],
)
def test_wheels_that_slip_are_found_where_they_do(
    change: Callable[[Array, Array], Array], span: tuple[float, float] | None
) -> None:
    rng = np.random.default_rng(8)
    imu, q, speed = drive(rng)
    t = T[::5]
    told = change(t, speed[::5]) + rng.normal(0.0, 0.03, len(t))
    odometry = Fixes("odometry", "/odom", t, told[:, None], None)
    motion = Segment(1, True, 0.0, 119.0, 0, 11900, 0.0, 119.0)
    motions = Segmentation((motion,), np.zeros(len(T), dtype=np.float32), 1.0, 2.0, np.zeros(3), np.nan, "file")
    found, most = slips(imu, q, motions, odometry, np.array([1.0, 0.0, 0.0]), G)
    assert len(found) == (span is not None)
    if span is not None:
        assert found[0] == pytest.approx(span, abs=3.1)
        assert most > 0.5


def found_in(change: Callable[[Array, Array], Array]) -> Array:
    """Return the spans of slips that are found where the wheels tell a changed speed, at 20 Hz."""
    rng = np.random.default_rng(8)
    imu, q, speed = drive(rng)
    t = T[::5]
    told = change(t, speed[::5]) + rng.normal(0.0, 0.03, len(t))
    motion = Segment(1, True, 0.0, 119.0, 0, 11900, 0.0, 119.0)
    motions = Segmentation((motion,), np.zeros(len(T), dtype=np.float32), 1.0, 2.0, np.zeros(3), np.nan, "file")
    odometry = Fixes("odometry", "/odom", t, told[:, None], None)
    return slips(imu, q, motions, odometry, np.array([1.0, 0.0, 0.0]), G)[0]


def test_what_lies_between_two_slips_counts() -> None:
    found = found_in(lambda t, v: v + 1.5 * (((t > 10.0) & (t < 14.0)) | ((t > 100.0) & (t < 104.0))))
    assert found == pytest.approx(np.array([[10.0, 14.0], [100.0, 104.0]]), abs=3.1)


def test_wheels_that_slip_half_of_the_time_do_not_hide_it() -> None:
    found = found_in(lambda t, v: v + 1.6 * (t % 12.0 < 6.0))
    assert np.diff(found, axis=1).sum() > 0.9 * 119.0


def test_a_slip_that_fades_unseen_ends_with_the_last_contradiction() -> None:
    fading = 2.0 / 40.0  # m/s^2: hardly more than a slope
    found = found_in(lambda t, v: v + np.where((t > 30.0) & (t < 70.0), 2.0 - fading * (t - 30.0), 0.0))
    assert len(found) == 1
    assert found[0, 0] == pytest.approx(30.0, abs=3.1)


def test_a_slow_imu_with_steps_that_hold_no_sample_is_asked_too(rng: np.random.Generator) -> None:
    imu, q, speed = drive(rng)
    rows = np.flatnonzero(np.arange(len(T)) % 40 == 0)  # 2.5 Hz
    slow = Imu(imu.t[rows], imu.gyro_b[rows], imu.accel_b[rows])
    odometry = Fixes("odometry", "/odom", T[::5], speed[::5, None], None)
    start, end = 0.05, float(slow.t[-1]) - 0.01  # the last two steps end between the same samples
    motion = Segment(1, True, start, end, 0, len(rows), start, end)
    motions = Segmentation((motion,), np.zeros(len(rows), dtype=np.float32), 1.0, 2.0, np.zeros(3), np.nan, "file")
    found, _ = slips(slow, q[rows], motions, odometry, np.array([1.0, 0.0, 0.0]), G)
    assert len(found) == 0
