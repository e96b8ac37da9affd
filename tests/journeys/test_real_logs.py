"""Real logs, where present: smoothed with honest words, or refused in the right line. Accuracy where there is truth."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from journeys.odd_logs import SIGMAS, quaternions, read_track

from attest_cli.maths import rotation


def real(shared_data: Path, name: str) -> Path:
    path = shared_data / name
    if not path.exists():
        pytest.skip(f"no {name} in the folder of real data")
    return path


def test_husky_with_gravity_on_y(shared_data: Path, smooth: Callable[..., Any]) -> None:
    log = real(shared_data, "logs/derived_mcap/test1_ros2_zstd.mcap")
    result = smooth(log, "--filter", "indirect")
    report = result.report
    assert report["coverage"]["share"] == 1.0
    assert report["input"]["samples"] == 11865
    assert report["body"]["axes"] == "vehicle"
    assert report["methods"]["position"] == "odometry"
    R = rotation.matrix(np.array(report["body"]["q_body_sensor"]))
    assert R[2, 1] > 0.95  # up of the vehicle is the IMU's y
    track = read_track(result.folder)
    assert np.median(np.abs(track["roll_deg"])) < 10.0
    assert np.median(np.abs(track["pitch_deg"])) < 10.0
    assert {"no-heading", "odometry-late"} <= result.codes


def test_husky_with_its_fixes(shared_data: Path, smooth: Callable[..., Any]) -> None:
    """A log with positions goes to the navigation smoother by itself."""
    log = real(shared_data, "logs/derived_mcap/test1_ros2_zstd.mcap")
    result = smooth(log, "--start", "200", "--end", "245")
    report = result.report
    assert (report["methods"]["filter"], report["methods"]["position"]) == ("navigation", "navigation")
    assert {"gps drift", "gyro noise in motion"} <= {found["name"].split(",")[0] for found in report["shown"]}
    assert (report["heading"] == "relative") == ("north-not-shown" in result.codes)  # slow, and the fixes wander


def test_phidgets_upside_down(shared_data: Path, smooth: Callable[..., Any]) -> None:
    log = real(shared_data, "logs/derived_mcap/phidgets_imu_upside_down_ros2_zstd.mcap")
    result = smooth(log, "--filter", "indirect", codes=(0, 3))
    track = read_track(result.folder)
    assert np.abs(track["roll_deg"]).min() > 170.0  # the IMU hangs upside down and turns about the vertical only
    assert result.report["verdict"] != "PASS"
    assert "magnetometer-uncalibrated" in result.codes


@pytest.mark.parametrize(
    ("name", "samples", "heading"),
    [
        ("logs/euroc_asl/kimera_real_imu0_data.csv", 6001, "relative"),
        ("logs/xio_fusion/sensor_data.csv", None, "magnetic"),
        ("repoimu/TStick_Test06_Trial2.parquet", 3001, "magnetic"),
        ("repoimu/Pendulum_Test01b_Static_Segment_1.parquet", None, "magnetic"),
    ],
)
def test_logs_of_many_makers(
    name: str, samples: int | None, heading: str, shared_data: Path, smooth: Callable[..., Any]
) -> None:
    """Half a minute of each: what each is read as, to its last row, stands in the tests of the readers."""
    result = smooth(real(shared_data, name), "--end", "30")
    assert result.report["heading"] == heading
    assert result.report["coverage"]["rows_used"] == result.report["coverage"]["rows_in"]
    assert samples is None or result.report["input"]["samples"] == samples
    assert result.report["verdict"] in {"PASS", "WARN"}


def test_vectornav(shared_data: Path, attest: Callable[..., Any], tmp_path: Path) -> None:
    outcome = attest("smooth", real(shared_data, "logs/vectornav/vn310-imu.csv"), "-o", tmp_path / "r")
    assert outcome.code == 0 or "defect" not in outcome.err


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("logs/derived_mcap/husky_foxglove_protobuf_json.mcap", ("no IMU", "gps")),
        ("logs/foxglove_tutorials/tutorial.mcap", ("no IMU", "gps")),
        ("logs/foxglove_tutorials/foxglove_eip_bridge_2025-07-04_17-53-27.mcap", ("JSON are not read",)),
        ("logs/euroc_asl/leica0_data.csv", ("no IMU", "position")),
        ("logs/vectornav/vn310-gnss.csv", ("no IMU", "gps")),
        ("logs/apdm/apdm_format7.csv", ("only 3 usable IMU rows",)),
        ("euroc_mh01/leica0.parquet", ("no IMU",)),
    ],
)
def test_logs_that_are_no_imu_logs_of_ours(
    name: str, says: tuple[str, ...], shared_data: Path, attest: Callable[..., Any], tmp_path: Path
) -> None:
    attest("smooth", real(shared_data, name), "-o", tmp_path / "r").refused(Path(name).name, *says)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "end_s"), [("07_undisturbed_fast_rotation_B", 86), ("15_undisturbed_fast_translation_A", 100)]
)
def test_broad_inclination_is_inside_its_sigma(
    name: str, end_s: int, shared_data: Path, smooth: Callable[..., Any]
) -> None:
    """The first minute in motion, 17 000 samples, with the rest before it."""
    path = real(shared_data, f"broad/{name}.parquet")
    result = smooth(path, "--end", end_s)
    truth = pq.read_table(path).to_pandas().iloc[: result.report["input"]["samples"]]
    q_true = truth[["truth_qw", "truth_qx", "truth_qy", "truth_qz"]].to_numpy(dtype=float)
    track = read_track(result.folder)
    e = rotation.multiply(quaternions(track), rotation.conjugate(q_true))
    error = np.degrees(2 * np.arccos(np.clip(np.hypot(e[:, 0], e[:, 3]), 0.0, 1.0)))
    sigma = np.hypot(track[SIGMAS[0]], track[SIGMAS[1]])
    use = truth["movement"].to_numpy(dtype=bool) & np.isfinite(error)
    assert use.sum() > 16_000
    rmse, ratio = np.sqrt(np.mean(error[use] ** 2)), np.sqrt(np.mean((error[use] / sigma[use]) ** 2))
    print(f"{name}: inclination RMSE {rmse:.2f} deg, median sigma {np.median(sigma[use]):.2f} deg, ratio {ratio:.2f}")
    assert ratio < 2.5
    assert rmse < 5.0


def test_a_static_log_is_one_stop(shared_data: Path, smooth: Callable[..., Any]) -> None:
    result = smooth(real(shared_data, "repoimu/TStick_Test01_Static.parquet"))
    assert (result.report["statistics"]["stops"], result.report["statistics"]["motions"]) == (1, 0)


def test_a_distance_made_of_drift_does_not_make_a_position_usable(
    shared_data: Path, smooth: Callable[..., Any]
) -> None:
    result = smooth(real(shared_data, "wid/trial03_IMU1.parquet"))
    found = result.report["statistics"]
    speed = (found["distance_m"] or 0.0) / result.report["input"]["duration_s"]
    assert not found["position_usable"] or speed < 40.0
