"""MCAP of ROS 2: types and roles, clocks, damage at any place, and channels that must not be touched."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as PlainWriter
from mcap_ros2.writer import Writer

from attest_cli.errors import AttestError
from attest_cli.prepare import prepare
from attest_cli.readers import read
from attest_cli.records import Channel, Recording
from attest_cli.settings import Settings
from attest_cli.writers.ros2 import definition

T0 = 1_780_308_000_000_000_001
Sent = tuple[str, str, int | None, dict[str, Any]]  # topic, type, header stamp, fields


def xyz(x: float, y: float, z: float) -> dict[str, float]:
    return {"x": x, "y": y, "z": z}


def imu(k: int, **more: Any) -> dict[str, Any]:
    return {"angular_velocity": xyz(0.1 * k, 0.2, 0.3), "linear_acceleration": xyz(0.0, 0.0, 9.81), **more}


def write(
    path: Path, messages: list[Sent], compression: CompressionType = CompressionType.ZSTD, delay_ns: int = 0
) -> Path:
    with path.open("wb") as stream, Writer(stream, compression=compression, chunk_size=2000) as out:
        schemas: dict[str, Any] = {}
        for k, (topic, kind, stamp, fields) in enumerate(messages):
            if kind not in schemas:
                schemas[kind] = out.register_msgdef(kind.replace("/", "/msg/"), definition(kind))
            stamp_ns = T0 + k * 10_000_000 if stamp is None else stamp
            header = {"stamp": {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}, "frame_id": "imu_link"}
            out.write_message(
                topic, schemas[kind], {"header": header, **fields}, log_time=T0 + k * 10_000_000 + delay_ns
            )
    return path


def imus(count: int = 60, **more: Any) -> list[Sent]:
    return [("/imu/data", "sensor_msgs/Imu", None, imu(k, **more)) for k in range(count)]


def by_name(recording: Recording) -> dict[str, Channel]:
    return {channel.name: channel for channel in recording.channels}


@pytest.mark.parametrize("compression", list(CompressionType))
def test_values_and_stamps_are_read_exactly_under_every_compression(
    tmp_path: Path, compression: CompressionType
) -> None:
    recording = read(write(tmp_path / "log.mcap", imus(), compression), Settings())
    channel = by_name(recording)["/imu/data"]
    assert channel.role == "imu"
    assert channel.frame_id == "imu_link"
    assert channel.stamps_ns.tolist() == [T0 + k * 10_000_000 for k in range(60)]
    assert channel.values["gyro_x"].tolist() == [0.1 * k for k in range(60)]
    assert recording.warnings == ()


def test_every_type_plays_its_role(tmp_path: Path) -> None:
    vector = "geometry_msgs/Vector3Stamped"
    sent: list[Sent] = [
        ("/sun", vector, None, {"vector": xyz(0.0, 0.6, 0.8)}),
        ("/compass", vector, None, {"vector": xyz(0.0, 2.0, 0.0)}),  # north to the left: facing east
        ("/wind", vector, None, {"vector": xyz(1.0, 2.0, 3.0)}),
        ("/imu/mag", "sensor_msgs/MagneticField", None, {"magnetic_field": xyz(2e-5, 0.0, -4e-5)}),
        ("/orientation", "geometry_msgs/QuaternionStamped", None, {"quaternion": {"w": 1.0, **xyz(0, 0, 0)}}),
        (
            "/odom",
            "nav_msgs/Odometry",
            None,
            {"twist": {"twist": {"linear": xyz(0.3, 0, 0)}, "covariance": [0.04, *[0.0] * 6, 1e6]}},
        ),
        ("/vel", "geometry_msgs/TwistStamped", None, {"twist": {"linear": xyz(0.3, 0, 0)}}),
        (
            "/fix",
            "sensor_msgs/NavSatFix",
            None,
            {
                "latitude": 46.5,
                "position_covariance": [4.0, *[0.0] * 3, 4.0, *[0.0] * 3, 9.0],
                "position_covariance_type": 2,
            },
        ),
        ("/fix", "sensor_msgs/NavSatFix", None, {"latitude": 0.0, "status": {"status": -1}}),
        ("/position", "geometry_msgs/PointStamped", None, {"point": xyz(1.0, 2.0, 3.0)}),
        ("/imu/temperature", "sensor_msgs/Temperature", None, {"temperature": 21.5}),
    ]
    sent = [item for item in sent if item[1] != "geometry_msgs/TwistStamped"]
    found = by_name(read(write(tmp_path / "log.mcap", sent), Settings()))
    assert {name: channel.role for name, channel in found.items()} == {
        "/sun": "sun",
        "/compass": "compass",
        "/wind": "",
        "/imu/mag": "magnetometer",
        "/orientation": "orientation",
        "/odom": "odometry",
        "/fix": "gps",
        "/position": "position",
        "/imu/temperature": "temperature",
    }
    assert found["/compass"].values["compass_deg"].tolist() == [90.0]
    assert found["/imu/mag"].units["mag_x"] == "T"
    assert found["/fix"].values["gps_sigma_m"][0] == 2.0
    assert found["/fix"].values["gps_sigma_up_m"][0] == 3.0
    assert np.isnan(found["/fix"].values["latitude"][1])  # no fix
    odometry = found["/odom"].values
    assert odometry["velocity_sigma_x"].tolist() == [0.2]
    assert np.isnan(odometry["velocity_y"][0])  # a variance of 1e6 says: do not use


def test_rep_145_not_provided_is_not_zero(tmp_path: Path) -> None:
    none = [-1.0, *[0.0] * 8]
    found = by_name(
        read(
            write(tmp_path / "log.mcap", imus(linear_acceleration_covariance=none, orientation_covariance=none)),
            Settings(),
        )
    )
    assert list(found) == ["/imu/data"]
    assert found["/imu/data"].role == "gyro"


def test_an_orientation_of_the_device_is_kept_without_a_role(tmp_path: Path) -> None:
    turned = {"w": 0.6, **xyz(0.0, 0.0, 0.8)}
    found = by_name(read(write(tmp_path / "log.mcap", imus(orientation=turned)), Settings()))
    assert found["/imu/data#orientation"].role == ""
    assert found["/imu/data#orientation"].values["q_z"][0] == 0.8
    zero = {"w": 0.0, **xyz(0.0, 0.0, 0.0)}
    assert list(by_name(read(write(tmp_path / "zero.mcap", imus(orientation=zero)), Settings()))) == ["/imu/data"]


@pytest.mark.parametrize(("source", "shift"), [("header", 0), ("log", 7_000_000), ("publish", 7_000_000)])
def test_the_clock_that_counts_is_a_setting(tmp_path: Path, source: str, shift: int) -> None:
    path = write(tmp_path / "log.mcap", imus(), delay_ns=7_000_000)
    settings = Settings.model_validate({"time": {"source": source}})
    assert by_name(read(path, settings))["/imu/data"].stamps_ns[0] == T0 + shift


def test_zero_header_stamps_give_way_to_the_time_of_logging(tmp_path: Path) -> None:
    messages = [(topic, kind, 0, fields) for topic, kind, _, fields in imus()]
    recording = read(write(tmp_path / "log.mcap", messages), Settings())
    assert recording.channels[0].stamps_ns.tolist() == [T0 + k * 10_000_000 for k in range(60)]
    assert [w.code for w in recording.warnings] == ["zero-header-stamps"]


def test_a_few_zero_header_stamps_are_filled_on_the_header_clock(tmp_path: Path) -> None:
    messages = imus()
    messages[30] = (*messages[30][:2], 0, messages[30][3])
    recording = read(write(tmp_path / "log.mcap", messages, delay_ns=2_000_000), Settings())
    assert recording.channels[0].stamps_ns[30] == T0 + 300_000_000
    assert [w.code for w in recording.warnings] == ["zero-header-stamps"]


def test_simulated_time_that_starts_at_zero_is_left_alone(tmp_path: Path) -> None:
    messages = [(topic, kind, k * 10_000_000, fields) for k, (topic, kind, _, fields) in enumerate(imus())]
    path = tmp_path / "log.mcap"
    with path.open("wb") as stream, Writer(stream) as out:
        schema = out.register_msgdef("sensor_msgs/msg/Imu", definition("sensor_msgs/Imu"))
        for _, _, stamp, fields in messages:
            assert stamp is not None
            header = {"stamp": {"sec": 0, "nanosec": stamp}}
            out.write_message("/imu/data", schema, {"header": header, **fields}, log_time=stamp)
    recording = read(path, Settings())
    assert recording.channels[0].stamps_ns.tolist() == [k * 10_000_000 for k in range(60)]
    assert recording.warnings == ()


def test_topics_on_different_clocks_are_told(tmp_path: Path) -> None:
    messages = imus()
    messages += [("/fix", "sensor_msgs/NavSatFix", T0 + 5_000_000_000, {"latitude": 46.5}) for _ in range(3)]
    recording = read(write(tmp_path / "log.mcap", messages), Settings())
    assert [w.code for w in recording.warnings] == ["clock-offset"]
    assert "/fix" in recording.warnings[0].message


def test_two_files_with_the_same_schema_ids_decode_right_in_one_process(tmp_path: Path) -> None:
    mags: list[Sent] = [("/m", "sensor_msgs/MagneticField", None, {"magnetic_field": xyz(1e-5, 2e-5, 3e-5)})] * 3
    first, second = write(tmp_path / "a.mcap", imus()), write(tmp_path / "b.mcap", mags)
    for _ in range(2):
        assert by_name(read(first, Settings()))["/imu/data"].values["accel_z"][0] == 9.81
        assert by_name(read(second, Settings()))["/m"].values["mag_z"][0] == 3e-5


def test_a_hostile_schema_on_an_unused_channel_is_not_touched(tmp_path: Path) -> None:
    path = write(tmp_path / "log.mcap", imus())
    with path.open("wb") as stream:
        out = PlainWriter(stream)
        out.start(profile="ros2", library="test")
        evil = out.register_schema("evil/msg/<b>evil<", "ros2msg", b"<b>evil< x\n---\n")
        channel = out.register_channel("/evil", "cdr", evil)
        good = out.register_schema("sensor_msgs/msg/Imu", "ros2msg", definition("sensor_msgs/Imu").encode())
        wanted = out.register_channel("/imu/data", "cdr", good)
        out.add_message(channel, T0, b"\x00\x01\x00\x00", T0)
        header = b"\x00\x01\x00\x00" + struct.pack("<IIII", 1, 2, 1, 0)
        out.add_message(wanted, T0, header + struct.pack("<37d", *([0.0] * 36), 9.81), T0)
        out.finish()
    recording = read(path, Settings())
    assert dict(recording.other) == {"/evil": "evil/msg/<b>evil< (cdr)"}
    assert recording.channels[0].stamps_ns.tolist() == [1_000_000_002]


def test_messages_that_are_not_of_their_type_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with path.open("wb") as stream:
        out = PlainWriter(stream)
        out.start(profile="ros2", library="test")
        schema = out.register_schema("sensor_msgs/msg/Imu", "ros2msg", definition("sensor_msgs/Imu").encode())
        channel = out.register_channel("/imu/data", "cdr", schema)
        out.add_message(channel, T0, b"\x00\x01\x00\x00\x01\x02", T0)
        out.finish()
    with pytest.raises(AttestError, match=r"message 1 of /imu/data is no sensor_msgs/msg/Imu"):
        read(path, Settings())


@pytest.mark.parametrize(
    ("encoding", "schema"), [("json", "jsonschema"), ("ros1", "ros1msg"), ("protobuf", "protobuf")]
)
def test_a_log_without_usable_channels_names_what_was_found(tmp_path: Path, encoding: str, schema: str) -> None:
    path = tmp_path / "log.mcap"
    with path.open("wb") as stream:
        out = PlainWriter(stream)
        out.start()
        kind = out.register_schema("own_msgs/Imu", schema, b"{}")
        out.add_message(out.register_channel("/imu", encoding, kind), T0, b"{}", T0)
        out.finish()
    recording = read(path, Settings())
    assert (recording.channels, recording.other) == ((), {"/imu": f"own_msgs/Imu ({encoding})"})
    with pytest.raises(AttestError, match=rf"no channel that attest reads; found /imu own_msgs/Imu \({encoding}\)"):
        prepare([recording], Settings())


def test_a_chunk_that_unpacks_to_more_than_it_says_is_refused_early(tmp_path: Path) -> None:
    import zstandard

    packed = zstandard.compress(bytes(300 << 20))
    body = struct.pack("<QQQII", 0, 0, 1000, 0, 4) + b"zstd" + struct.pack("<Q", len(packed)) + packed
    header = b"\x01" + struct.pack("<Q", 8) + bytes(8)
    path = tmp_path / "bomb.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + header + b"\x06" + struct.pack("<Q", len(body)) + body)
    with pytest.raises(AttestError, match="1000 bytes it states"):
        read(path, Settings())
    body = struct.pack("<QQQII", 0, 0, 4 << 30, 0, 4) + b"zstd" + struct.pack("<Q", len(packed)) + packed
    path.write_bytes(b"\x89MCAP0\r\n" + header + b"\x06" + struct.pack("<Q", len(body)) + body)
    with pytest.raises(AttestError, match="over the limit"):
        read(path, Settings())
