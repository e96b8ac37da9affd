"""What a drive does not show is said: errors stay inside sigma, or the verdict is WARN or FAIL and names why."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from journeys.odd_logs import ACCEL, GYRO, ODOMETRY, Drive, judged, read_track

from attest_cli.maths import rotation

HEADING = ("sun_x", "sun_y", "compass_deg")
SUN = "0.5416752204197018, -0.5416752204197018, 0.6427876096865393"
GIVEN_MOUNTING = "mounting = [1.0, 0.0, 0.0, 0.0]\ngyro"
HONEST = 2.5  # RMS of error over sigma that one drive may have


def position_errors(folder: Path, drive: Drive) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Horizontal error of the position against the truth and its sigma, m, at the samples."""
    track = read_track(folder)
    rows = np.searchsorted(drive.columns["timestamp_ns"], track["timestamp_ns"])
    off = [track[f"position_{a}_m"] - drive.truth[f"position_{a}_m"][rows] for a in "xy"]
    sigma = np.hypot(track["sigma_position_x_m"], track["sigma_position_y_m"])
    first = int(np.argmax(np.isfinite(off[0])))
    return np.hypot(*(o - o[first] for o in off)), sigma


def without_span(drive: Drive, start: float, end: float) -> Drive:
    return drive.rows((drive.t < start) | (drive.t > end))


def blanked(drive: Drive, start: float, end: float, *names: str) -> Drive:
    """Sensors that are silent for a while."""
    silent = (drive.t > start) & (drive.t < end)
    return drive.changed(**{name: np.where(silent, np.nan, drive.columns[name]) for name in names})


def scaled(drive: Drive, factor: float, *names: str) -> Drive:
    return drive.changed(**{name: factor * drive.columns[name] for name in names})


def sun_at(degrees: float, axis: int) -> str:
    """A sun direction that is wrong by a turn about a world axis."""
    turn = rotation.matrix(rotation.exp_quaternion(np.radians(degrees) * np.eye(3)[axis : axis + 1]))[0]
    return ", ".join(map(repr, (turn @ np.array([float(x) for x in SUN.split(", ")])).tolist()))


CASES: dict[str, tuple[Callable[[Drive], Drive], set[str], str, bool]] = {
    # name: change, warnings that must stand in the report, verdict, heading is relative
    "no stop": (lambda d: d.span(12, 50), {"no-stop", "tilt-from-motion", "channel-empty"}, "WARN", False),
    "no stop, IMU alone": (
        lambda d: d.span(12, 50).without(*HEADING, *ODOMETRY),
        {"no-stop", "tilt-from-motion", "no-heading"},
        "WARN",
        True,
    ),
    "no heading": (lambda d: d.without(*HEADING), {"no-heading"}, "WARN", True),
    "starts in motion, no heading": (lambda d: d.span(20, 240).without(*HEADING), {"no-heading"}, "WARN", True),
    "ends in motion": (lambda d: d.span(0, 40), set(), "PASS", False),
    "one stop only": (lambda d: d.span(0, 9).without(*HEADING, *ODOMETRY), {"no-heading"}, "WARN", True),
    "two minutes": (lambda d: d.span(0, 120), set(), "PASS", False),
    "gap of 2 s in motion": (lambda d: without_span(d, 20, 22), {"imu-gap", "odometry-silent"}, "WARN", False),
    "gap of 2 s in a stop": (
        lambda d: without_span(d.span(0, 120), 58, 60),
        {"imu-gap", "odometry-silent"},
        "WARN",
        False,
    ),
    "gap of 60 s, no heading": (
        lambda d: without_span(d, 90, 150).without(*HEADING),
        {"imu-gap", "no-heading", "odometry-silent", "not-settled"},
        "WARN",
        True,
    ),
    "gyro in deg/s": (
        lambda d: scaled(d.span(0, 120), float(np.degrees(1.0)), *GYRO).without(*HEADING),
        {"unit-contradicted", "no-heading"},
        "WARN",
        True,
    ),
    "accelerometer in g": (lambda d: scaled(d.span(0, 120), 1 / 9.80665, *ACCEL), {"unit-contradicted"}, "WARN", False),
    "sun direction not given": (lambda d: replace(d.span(0, 120), config=""), {"no-sun-reference"}, "WARN", False),
}


@pytest.mark.parametrize("case", CASES)
def test_errors_stay_inside_sigma_and_the_reason_is_named(
    case: str, whole: Drive, smooth_once: Callable[..., Any]
) -> None:
    change, codes, verdict, relative = CASES[case]
    drive = change(whole)
    result = smooth_once(drive)
    assert (result.codes, result.report["verdict"]) == (codes, verdict), result.outcome.err
    assert (result.report["heading"] == "relative") == relative
    found = judged(result.folder, drive, relative=relative)
    assert found.tilt_ratio() < HONEST
    assert found.heading_ratio() < HONEST
    for warning in result.report["warnings"]:
        assert warning["message"] in result.outcome.err
        assert warning["hint"] in result.outcome.err


FOUND_FAULTY: dict[str, tuple[Callable[[Drive], Drive], str]] = {
    "sun tilted by 30 deg": (lambda d: d.told(SUN, sun_at(30.0, 0)), "sun measurements rejected"),
    "sun turned by 30 deg": (lambda d: d.told(SUN, sun_at(30.0, 2)), "compass measurements rejected"),
    "upside down, declared upright": (lambda d: d.turned(np.diag([1.0, -1.0, -1.0])), "sun measurements rejected"),
    "accelerometer reversed": (lambda d: scaled(d, -1.0, *ACCEL), "sun measurements rejected"),
}


@pytest.mark.parametrize("case", FOUND_FAULTY)
def test_a_sensor_that_contradicts_the_rest_fails_the_verdict(
    case: str, whole: Drive, tmp_path: Path, smooth: Callable[..., Any]
) -> None:
    change, says = FOUND_FAULTY[case]
    result = smooth(change(whole.span(0, 120)).write(tmp_path), codes=(3,))
    assert result.report["verdict"] == "FAIL"
    assert says in result.outcome.err


def test_a_gyro_of_wrong_scale_shows_in_the_agreement_of_the_passes(
    whole: Drive, tmp_path: Path, smooth: Callable[..., Any]
) -> None:
    result = smooth(scaled(whole.without(*HEADING), 0.9, *GYRO).write(tmp_path), codes=(0, 3))
    assert result.report["verdict"] != "PASS"
    named = {"gyro-noise-raised", "gyro-scale"} & set(result.codes)
    assert "Forward and backward disagree" in result.outcome.err or named


def test_a_gyro_of_wrong_scale_is_taken_out_and_sigma_holds_for_heading_too(
    whole: Drive, smooth_once: Callable[..., Any]
) -> None:
    drive = scaled(whole.without(*HEADING), 1.05, *GYRO)
    result = smooth_once(drive)
    assert "gyro-scale" in result.codes
    assert result.report["verdict"] != "PASS"
    assert judged(result.folder, drive, relative=True).heading_ratio() < HONEST


def test_position_of_the_imu_alone_is_not_called_usable_on_a_rough_log(
    whole: Drive, tmp_path: Path, smooth: Callable[..., Any]
) -> None:
    drive = scaled(whole.without(*ODOMETRY), 1.0).told("accel_bias_sigma = 1e-06", "accel_bias_sigma = 0.05")
    result = smooth(drive.write(tmp_path))
    off, sigma = position_errors(result.folder, drive)
    assert np.nanmax(off / np.maximum(sigma, 0.05)) < 4.0
    assert not result.report["statistics"]["position_usable"]
    assert "not usable" in result.outcome.err


def test_every_row_of_a_drive_between_stops_has_a_position(
    whole: Drive, tmp_path: Path, smooth: Callable[..., Any]
) -> None:
    result = smooth(whole.span(0, 66).without(*ODOMETRY).write(tmp_path))
    assert np.isfinite(read_track(result.folder)["position_x_m"]).all()


# ---- known faults: each flips when it is mended


def test_position_sigma_covers_a_gap(whole: Drive, smooth_once: Callable[..., Any]) -> None:
    drive = without_span(whole, 90, 150)
    result = smooth_once(drive)
    off, sigma = position_errors(result.folder, drive)
    after = read_track(result.folder)["t_s"] > 149
    assert np.nanmax(off[after] / sigma[after]) < 4.0


def test_position_sigma_covers_odometry_that_ends(whole: Drive, tmp_path: Path, smooth: Callable[..., Any]) -> None:
    drive = blanked(whole, 90, 999, *ODOMETRY)
    result = smooth(drive.write(tmp_path))
    off, sigma = position_errors(result.folder, drive)
    assert np.nanmax(off / np.maximum(sigma, 0.1)) < 3.5 or not result.report["statistics"]["position_usable"]
    assert "odometry" in result.outcome.err.partition("▲")[2]


@pytest.mark.parametrize("factor", [0.0, -1.0, 3.6])
def test_odometry_that_contradicts_the_imu_is_said(
    factor: float, whole: Drive, tmp_path: Path, smooth: Callable[..., Any]
) -> None:
    result = smooth(scaled(whole.span(0, 120), factor, *ODOMETRY).write(tmp_path))
    assert result.report["verdict"] != "PASS"


def test_sigma_of_the_vehicle_covers_the_mounting_found(
    whole: Drive, tmp_path: Path, smooth: Callable[..., Any]
) -> None:
    turn = rotation.matrix(rotation.exp_quaternion(np.radians([[4.0, -3.0, 60.0]])))[0]
    drive = whole.turned(turn).told(GIVEN_MOUNTING, "gyro").without(*HEADING)
    result = smooth(drive.write(tmp_path))
    assert result.report["body"]["axes"] == "vehicle"
    assert judged(result.folder, drive, relative=True).tilt_ratio() < HONEST


def test_axes_that_agree_do_so_within_sigma(whole: Drive, tmp_path: Path, smooth: Callable[..., Any]) -> None:
    turn = rotation.matrix(rotation.exp_quaternion(np.radians([[0.0, 8.0, 0.0]])))[0]
    drive = whole.turned(turn).told(GIVEN_MOUNTING, "gyro").without(*HEADING)
    result = smooth(drive.write(tmp_path))
    assert result.report["body"]["axes"] == "imu" or judged(result.folder, drive, relative=True).tilt_ratio() < HONEST


def test_attitude_after_a_long_gap_is_inside_its_sigma(whole: Drive, smooth_once: Callable[..., Any]) -> None:
    drive = without_span(whole, 90, 150)
    found = judged(smooth_once(drive).folder, drive)
    assert np.max(found.heading / found.sigma_heading) < 5.0
    assert np.max(found.tilt / found.sigma_tilt) < 6.0


def test_a_sound_log_that_starts_in_motion_does_not_fail(whole: Drive, smooth_once: Callable[..., Any]) -> None:
    drive = whole.span(20, 240)
    result = smooth_once(drive)
    found = judged(result.folder, drive)
    assert found.heading_ratio() < HONEST
    assert np.median(found.sigma_tilt) < 0.5  # 0.04 with the whole log
    assert result.report["verdict"] != "FAIL"
    assert "drifts" not in result.outcome.err


def test_every_warning_is_told_once(whole: Drive, smooth_once: Callable[..., Any]) -> None:
    result = smooth_once(without_span(whole, 20, 22))
    assert result.outcome.err.count("nothing is integrated across a gap") == 1
    assert "Drive.parquet" not in result.outcome.err  # the file is drive.parquet


def test_an_aided_position_is_not_said_to_be_unaided(whole: Drive, smooth_once: Callable[..., Any]) -> None:
    result = smooth_once(without_span(whole, 90, 150).without(*HEADING))
    assert "odometry" in result.report["input"]["sensors"]
    assert "no sensor aids it" not in result.outcome.err


def test_advice_can_be_followed(whole: Drive, smooth_once: Callable[..., Any]) -> None:
    result = smooth_once(whole.span(20, 240).without(*HEADING))
    assert "segment 2: stop before it begins" not in result.outcome.err


def test_a_sensor_that_was_all_rejected_is_not_listed(whole: Drive, tmp_path: Path, smooth: Callable[..., Any]) -> None:
    result = smooth(whole.told(SUN, sun_at(30.0, 0)).without("compass_deg").write(tmp_path), codes=(3,))
    assert result.report["verdict"] == "FAIL"
    assert result.report["heading"] == "relative"
    assert result.report["statistics"]["innovations"]["sun"]["used"] == 0
    assert "sun sensor" not in result.report["input"]["sensors"]


def test_an_imu_upside_down_is_said(whole: Drive, tmp_path: Path, smooth: Callable[..., Any]) -> None:
    drive = scaled(whole.without(*HEADING, *ODOMETRY), -1.0, *ACCEL).told(GIVEN_MOUNTING, "gyro")
    assert "upside down" in smooth(drive.write(tmp_path)).outcome.err
