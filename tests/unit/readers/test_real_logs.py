"""Real logs in their own formats: what is found in each, and what becomes of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from attest_cli.errors import AttestError
from attest_cli.prepare import prepare
from attest_cli.readers import read
from attest_cli.records import Log, Recording
from attest_cli.settings import Settings


@pytest.fixture
def load(shared_data: Path):
    def of(name: str, *codes: str) -> tuple[Recording, Log]:
        path = shared_data / name
        if not path.is_file():
            pytest.skip(f"{name} is not here")
        recording = read(path, Settings())
        log = prepare([recording], Settings())
        assert [w.code for w in log.warnings] == list(codes)
        return recording, log

    return of


def test_husky(load) -> None:
    recording, log = load("logs/derived_mcap/test1_ros2_zstd.mcap")
    counts = {channel.name: (channel.role, channel.stamps_ns.size) for channel in recording.channels}
    assert counts == {
        "/imu/data": ("imu", 11865),
        "/imu/data#orientation": ("", 11865),
        "/husky_velocity_controller/odom": ("odometry", 3952),
        "/fix": ("gps", 989),
    }
    assert log.coverage["rows_used"] == 11865
    assert np.median(log.imu.accel_b, axis=0)[1] == pytest.approx(9.8, abs=0.1)  # mounted with gravity on +Y
    assert np.degrees(log.fixes["gps"].values[0, :2]) == pytest.approx([42.3758, -71.1474], abs=1e-3)
    assert log.fixes["gps"].sigma is not None
    assert log.fixes["gps"].sigma[0] == pytest.approx([0.9, 0.9, 1.8])
    assert set(log.fixes) == {"odometry", "gps"}  # the orientation is not used unless mapped


def test_phidgets_upside_down(load) -> None:
    recording, log = load("logs/derived_mcap/phidgets_imu_upside_down_ros2_zstd.mcap", "magnetometer-dropped")
    assert [channel.role for channel in recording.channels] == ["imu", "magnetometer"]  # the zero quaternions are none
    assert log.imu.t.size == 13964
    assert np.median(log.imu.accel_b, axis=0)[2] == pytest.approx(-9.88, abs=0.05)
    assert log.fixes["magnetometer"].t.size == 13964 - 6990  # NaN in half of the rows


def test_two_mcap_in_one_process_decode_right(load) -> None:
    load("logs/derived_mcap/phidgets_imu_upside_down_ros2_zstd.mcap", "magnetometer-dropped")
    _, log = load("logs/derived_mcap/test1_ros2_zstd.mcap")
    assert np.nanmax(np.abs(log.fixes["odometry"].values[:, 0])) < 2.0


@pytest.mark.parametrize(
    ("name", "rows"), [("kimera_microeuroc_imu0_data.csv", 29120), ("kimera_real_imu0_data.csv", 7999)]
)
def test_euroc(load, name: str, rows: int) -> None:
    _, log = load(f"logs/euroc_asl/{name}")
    assert log.imu.t.size == rows
    assert log.t0_ns in {1_403_715_273_262_142_976, 1_403_715_523_912_140_000}
    assert np.median(np.linalg.norm(log.imu.accel_b, axis=1)) == pytest.approx(9.81, abs=0.1)


def test_xio(load) -> None:
    recording, log = load("logs/xio_fusion/sensor_data.csv")
    assert recording.channels[0].units["gyro_x"] == "deg/s"
    assert log.imu.t.size == 13514
    assert log.imu.gyro_b[0, 0] == pytest.approx(np.radians(0.01644619))
    assert np.linalg.norm(log.imu.accel_b[0]) == pytest.approx(9.78, abs=0.02)
    assert np.linalg.norm(log.fixes["magnetometer"].values[0]) == pytest.approx(43.8e-6, rel=0.01)


def test_vectornav(load) -> None:
    recording, log = load("logs/vectornav/vn310-imu.csv", "several-channels")
    assert [channel.name for channel in recording.channels if channel.role == "imu"] == ["imu", "uncomp/imu"]
    assert log.imu.gyro_b[0, 0] == pytest.approx(-0.00048612026)  # the column without a unit has that of its neighbours
    assert log.fixes["magnetometer"].channel == "magnetometer"  # the one beside the IMU that was taken
    assert log.fixes["magnetometer"].values[0, 2] == pytest.approx(0.21280421e-4)


def test_apdm(load) -> None:
    recording, _ = load("logs/apdm/imuData01.csv", "several-channels")
    assert [c.name for c in recording.channels if c.role == "imu"] == [
        "static/imu",
        "upper/imu",
        "middle/imu",
        "lower/imu",
    ]


@pytest.mark.parametrize(
    ("name", "rows", "accel", "code", "fixes"),
    [
        ("imu_tools/ardrone_imu.bag", 4308, [0.16, 0.22, 9.60], "imu-rows-missing imu-gap", {"magnetometer": 4308}),
        ("imu_tools/phidgets_imu_upside_down.bag", 13964, [-0.18, -0.09, -9.87], "magnetometer-dropped",
         {"magnetometer": 6974}),
        ("imu_tools/sparkfun_razor.bag", 2144, [-2.63, 3.76, 5.68], None, {"magnetometer": 2144}),
        ("robot_localization/test1.bag", 11865, [-0.22, 9.79, 0.09], None, {"odometry": 3951, "gps": 989}),
        ("robot_localization/test2.bag", 3061, [-0.13, -0.15, 9.76], None, {"odometry": 3060}),
        ("derived_mcap/razor_ros1_lz4.mcap", 2144, [-2.63, 3.76, 5.68], None, {"magnetometer": 2144}),
        ("derived_mcap/razor_ros1_unchunked.mcap", 2144, [-2.63, 3.76, 5.68], None, {"magnetometer": 2144}),
    ],
)  # fmt: skip
def test_ros1(load, name: str, rows: int, accel: list[float], code: str | None, fixes: dict[str, int]) -> None:
    if name.endswith(".bag"):
        pytest.importorskip("rosbags", reason="the extra [bag] is not installed")
    _, log = load(f"logs/{name}", *(code or "").split())
    assert log.imu.t.size == rows
    assert np.median(log.imu.accel_b, axis=0) == pytest.approx(np.array(accel), abs=0.006)
    assert {role: found.t.size for role, found in log.fixes.items()} == fixes


def test_foxglove_in_protobuf_gives_the_fixes_of_the_bag_it_was_made_from(shared_data: Path) -> None:
    pytest.importorskip("mcap_protobuf", reason="the extra [protobuf] is not installed")
    paths = [
        shared_data / "logs/derived_mcap" / f"{n}.mcap" for n in ("husky_foxglove_protobuf_json", "test1_ros2_zstd")
    ]
    if not all(path.is_file() for path in paths):
        pytest.skip("the logs of the Husky are not here")
    found, wanted = (next(c for c in read(path, Settings()).channels if c.role == "gps") for path in paths)
    assert found.stamps_ns.tolist() == wanted.stamps_ns.tolist()
    for name, values in wanted.values.items():
        assert found.values[name].tolist() == values.tolist()


def test_broad(load) -> None:
    recording, log = load("broad/03_undisturbed_slow_rotation_C.parquet")
    assert {channel.role for channel in recording.channels} == {"imu", "magnetometer"}  # the truth is no measurement
    assert log.imu.t.size == 58412
    assert "truth_qw" in recording.other


def test_a_table_that_repeats_its_gps_between_fixes_gives_the_fixes_only(load) -> None:
    _, log = load("wid/trial02_GNSS.parquet", "unit-guessed", "stale-repeats", "gyro-against-heading")
    assert log.fixes["gps"].t.size < 1000 < log.imu.t.size


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("logs/foxglove_tutorials/foxglove_eip_bridge_2025-07-04_17-53-27.mcap", "and 30 more"),
        ("logs/derived_mcap/husky_foxglove_protobuf_json.mcap", r"no IMU; found .*/fix \(gps\)"),
        ("logs/rosbag2/wrong_rmw_test_0.mcap", "wrong_format"),
        ("logs/rosbag2/topics_and_services.mcap", "_service_event"),
        ("logs/rosbag2/wbag_0.mcap", "std_msgs/msg/String"),
        ("logs/vectornav/2023-08-15_Multi-IMU_static60s.txt", "no header, and rows of 6 types"),
        ("logs/apdm/apdm_format7.csv", "only 3 usable IMU rows"),
        ("plaza/Plaza1_DR.parquet", "no column that attest knows"),
        ("logs/vectornav/vn310-gnss.csv", "no IMU; found"),
        ("logs/euroc_asl/leica0_data.csv", "no IMU; found position"),
    ],
)
def test_what_holds_no_imu_is_refused_in_one_clear_line(shared_data: Path, name: str, says: str) -> None:
    path = shared_data / name
    if not path.is_file():
        pytest.skip(f"{name} is not here")
    with pytest.raises(AttestError, match=says) as refused:
        prepare([read(path, Settings())], Settings())
    assert path.name in refused.value.message
    assert "\n" not in str(refused.value)
