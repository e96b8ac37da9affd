"""The filters of Rehbinder and Hu over a drive: what they leave for smoothers, report and reader."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError
from support.walking import Walk, passes, rms_deg, tilt, walk

from attest_cli.filters import Forward
from attest_cli.maths import rotation
from attest_cli.records import Smoothed
from attest_cli.settings import Settings
from attest_cli.smoothers import SMOOTHERS, backward_estimate

Array = NDArray[np.float64]
METHODS = ("pseudo-linear", "projected", "geometric")
STATED = {"acceleration": "switching", "acceleration_density": 0.02, "acceleration_limit": 0.5, "window_s": 0.1}


@pytest.fixture(scope="module")
def short() -> Walk:
    return walk("B", seed=3, duration_s=24.0)


@pytest.fixture(scope="module")
def forward(short: Walk) -> Forward:
    return short.run()


@pytest.fixture(scope="module")
def smoothed(forward: Forward) -> Smoothed:
    return SMOOTHERS["rts"](forward.run)


def heading_of(q: Array) -> Array:
    return np.unwrap(rotation.roll_pitch_yaw(q)[:, 2])


def test_run_is_whole_and_says_what_it_leaves_out(short: Walk, forward: Forward) -> None:
    run, n = forward.run, len(short.drive.log.imu.t)
    assert len(run.t) == n
    assert run.chain.dx.shape == (n, 6)
    assert run.absent == ("heading",)
    assert run.heading == "relative"
    assert not run.start_in_motion
    assert set(run.innovations.role.tolist()) == {"accelerometer"}
    assert (run.innovations.dof == 2).all()
    assert forward.nodes is None
    assert not forward.warnings
    for smoother in SMOOTHERS.values():
        if smoother is not SMOOTHERS["paper"]:
            found = smoother(run)
            assert np.isfinite(found.q).all()
            assert np.linalg.eigvalsh(found.P).min() > 0.0
    q, _, _ = backward_estimate(run)
    assert np.isfinite(q).all(axis=1).mean() > 0.9


@pytest.mark.parametrize("method", METHODS)
def test_the_methods_agree_and_so_do_the_smoothers(
    short: Walk, forward: Forward, smoothed: Smoothed, method: str
) -> None:
    mine = forward if method == "pseudo-linear" else short.run(method)
    one, _ = tilt(smoothed, short.up_b)
    other, _ = tilt(SMOOTHERS["two-filter"](mine.run), short.up_b)
    rts, _ = tilt(SMOOTHERS["rts"](mine.run), short.up_b)
    print(f"{method}: {rms_deg(other):.4f} deg, pseudo-linear {rms_deg(one):.4f}, RTS {rms_deg(rts):.4f}")
    assert rms_deg(other) == pytest.approx(rms_deg(one), abs=0.01)
    assert rms_deg(rts) == pytest.approx(rms_deg(other), abs=0.002)


def test_heading_is_the_gyros_with_its_sigma(forward: Forward, smoothed: Smoothed) -> None:
    found = smoothed
    R = rotation.matrix(found.q)
    sigma = np.sqrt(np.einsum("ki,kij,kj->k", R[:, 2], found.P[:, :3, :3], R[:, 2]))
    assert np.degrees(sigma[0]) < 0.01
    assert (np.diff(sigma) >= -1e-9).all()
    assert 0.1 < np.degrees(sigma[-1]) < 2.0
    held = ~forward.run.moving[1:] & ~forward.run.moving[:-1]
    steps = np.diff(heading_of(found.q))
    assert np.abs(steps[held]).max() < 2e-3 * np.abs(steps[~held]).max()  # but for the tilt that still settles


def test_without_its_state_the_bias_is_said_to_be_left_out(short: Walk) -> None:
    found = short.with_settings(vertical={"gyro_bias": False}).run()
    assert found.run.absent == ("heading", "gyro bias")
    assert found.run.chain.dx.shape[1] == 3
    smoothed = SMOOTHERS["rts"](found.run)
    assert smoothed.P[:, 3, 3] == pytest.approx(smoothed.P[0, 3, 3])  # as well as the stops know it
    e, nees = tilt(smoothed, short.up_b)
    print(f"no bias state: {rms_deg(e):.4f} deg, squares over covariance {nees.mean():.2f}")
    assert nees.mean() < 6.0


def test_scalar_gain_is_nearly_the_matrix_one(short: Walk, smoothed: Smoothed) -> None:
    scalar = SMOOTHERS["rts"](short.with_settings(vertical={"gain": "scalar"}).run().run)
    apart = rotation.log_quaternion(rotation.multiply(rotation.conjugate(smoothed.q), scalar.q))
    assert 1e-9 < np.abs(apart).max() < np.radians(0.02)


def test_a_stated_gain_is_the_gain(short: Walk) -> None:
    """In the long run K / T of the scalar filter without bias is the stated one."""
    vertical = {"gain": "scalar", "gyro_bias": False, "acceleration": "constant", "gain_rad_s": 0.5}
    imu = {"gyro_bias_sigma": 1e-6}
    drive = walk("A", seed=3, duration_s=30.0).without_stops().with_settings(vertical=vertical, imu=imu)
    run = drive.run().run
    P, dt = run.chain.P_pred[-1], float(np.median(np.diff(run.t)))
    R = run.chain.info[-1]
    assert np.diag(P @ R) == pytest.approx(0.5 * dt, rel=0.02)


def test_accelerometer_bias_widens_every_tilt(short: Walk, forward: Forward) -> None:
    biased = short.with_settings(imu={"accel_bias_sigma": 0.05}).run()
    extra = (0.05**2 - 1e-12) / short.drive.world.gravity**2
    for one, other in zip(passes(forward), passes(biased), strict=True):
        up_b = rotation.matrix(one.q)[:, 2]
        across = np.eye(3) - up_b[:, :, None] * up_b[:, None]
        assert np.abs(other.P[:, :3, :3] - one.P[:, :3, :3] - extra * across).max() < 1e-6 * extra


def test_a_gap_opens_the_vertical_and_what_follows_closes_it(short: Walk) -> None:
    log = short.drive.log
    keep = (log.imu.t < 12.0) | (log.imu.t > 13.5)
    imu = replace(log.imu, t=log.imu.t[keep], gyro_b=log.imu.gyro_b[keep], accel_b=log.imu.accel_b[keep])
    k = int(np.sum(log.imu.t < 12.0))
    cut = replace(log, imu=imu, gaps=np.array([[imu.t[k - 1], imu.t[k]]]))
    found = replace(short, drive=replace(short.drive, log=cut)).run()
    P = found.run.chain.P_pred[k, :3, :3]
    assert np.sqrt(np.trace(P)) > 0.8
    e, nees = tilt(SMOOTHERS["rts"](found.run), short.up_b[keep])
    print(f"behind a hole: {rms_deg(e[k:]):.3f} deg, squares over covariance {nees.mean():.2f}")
    assert rms_deg(e[:k]) < 0.3
    assert rms_deg(e[k:]) < 3.0  # of 46 deg: found again from a walk that lurches, until it stops
    assert nees.mean() < 9.2  # one error, on the whole, of two degrees of freedom: 99 %


@pytest.mark.parametrize("method", METHODS)
def test_without_a_smoother_nothing_is_seen_before_its_time(method: str) -> None:
    told = walk("B", seed=3, duration_s=12.0).with_settings(vertical=STATED, smoothing={"smoother": "none"})
    imu, n = told.drive.log.imu, 900  # at rest, where the rule takes no sample for an acceleration yet
    pushed = imu.accel_b.copy()
    pushed[n:] += 3.0
    later = replace(told, drive=replace(told.drive, log=replace(told.drive.log, imu=replace(imu, accel_b=pushed))))
    one, other = told.run(method).run, later.run(method).run
    assert np.abs(rotation.matrix(one.q)[:n, 2] - rotation.matrix(other.q)[:n, 2]).max() < 1e-12
    assert np.abs(rotation.matrix(one.q)[n:, 2] - rotation.matrix(other.q)[n:, 2]).max() > 1e-6


def test_upside_down_changes_nothing_but_the_axes(short: Walk, forward: Forward, smoothed: Smoothed) -> None:
    turn = np.diag([1.0, -1.0, -1.0])
    imu = short.drive.log.imu
    log = replace(short.drive.log, imu=replace(imu, gyro_b=imu.gyro_b @ turn, accel_b=imu.accel_b @ turn))
    over = replace(short.drive, log=log)
    found = replace(short, drive=over).run()
    other = SMOOTHERS["rts"](found.run)
    assert np.abs(rotation.matrix(smoothed.q)[:, 2] - rotation.matrix(other.q)[:, 2] @ turn).max() < 1e-6
    assert found.run.innovations.nis == pytest.approx(forward.run.innovations.nis, rel=1e-3)


def test_twice_the_same_drive_is_twice_the_same_answer(short: Walk, forward: Forward) -> None:
    again = short.run()
    assert (again.run.q == forward.run.q).all()
    assert (again.run.chain.P == forward.run.chain.P).all()


def test_a_gyro_noisier_than_stated_is_told() -> None:
    noisy = walk("C", seed=5, duration_s=60.0).with_settings(imu={"gyro_noise_density": 1e-4})
    found = noisy.run()
    assert [w.code for w in found.warnings] == ["gyro-noise-raised"]
    assert found.noise.gyro_density > 2e-4


def test_gain_and_noise_stated_together_are_refused() -> None:
    with pytest.raises(ValidationError, match="give one"):
        Settings.model_validate({"vertical": {"gain_rad_s": 0.5, "acceleration_density": 0.1}})
