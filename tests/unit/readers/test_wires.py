"""Messages of ROS 1, JSON and protobuf in MCAP: the same channels as of ROS 2, hostile definitions in one line."""

from __future__ import annotations

import json
import struct
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer

from attest_cli.errors import AttestError
from attest_cli.readers import read
from attest_cli.records import Channel
from attest_cli.settings import Settings

T0 = 1_780_308_000_000_000_001
STEP = 10_000_000
IMU = """# an IMU of ROS 1
Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance # row major
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""


def write(path: Path, encoding: str, schema: tuple[str, str, bytes], messages: Sequence[bytes]) -> Path:
    with path.open("wb") as stream:
        out = Writer(stream)
        out.start()
        channel = out.register_channel("/topic", encoding, out.register_schema(*schema))
        for k, message in enumerate(messages):
            out.add_message(channel, T0 + k * STEP + 5, message, T0 + k * STEP + 5)
        out.finish()
    return path


def only(path: Path, role: str) -> Channel:
    recording = read(path, Settings())
    assert recording.warnings == ()
    channel = next(channel for channel in recording.channels if channel.role == role)
    assert channel.stamps_ns.tolist() == [T0 + k * STEP for k in range(channel.stamps_ns.size)]
    return channel


def ros1_imu(k: int, frame: bytes = b"imu") -> bytes:
    stamp = T0 + k * STEP
    head = struct.pack("<III", k, stamp // 10**9, stamp % 10**9) + struct.pack("<I", len(frame)) + frame
    body = [0.0] * 4 + [0.0] * 9 + [0.1 * k, 0.2, 0.3] + [0.0] * 9 + [0.0, 0.5, 9.81] + [0.0] * 9
    return head + struct.pack("<37d", *body)


@pytest.mark.parametrize("frame", [b"imu", b""])
def test_ros1_is_read_exactly(tmp_path: Path, frame: bytes) -> None:
    messages = [ros1_imu(k, frame * (1 + k % 3)) for k in range(50)]
    channel = only(write(tmp_path / "a.mcap", "ros1", ("sensor_msgs/Imu", "ros1msg", IMU.encode()), messages), "imu")
    assert channel.values["gyro_x"].tolist() == [0.1 * k for k in range(50)]
    assert channel.values["accel_z"].tolist() == [9.81] * 50
    assert (channel.kind, channel.frame_id) == ("sensor_msgs/Imu", frame.decode())


def test_a_message_of_ros1_that_does_not_fit_its_definition_is_refused(tmp_path: Path) -> None:
    for damaged in (ros1_imu(3)[:-1], ros1_imu(3) + b"x", b"", ros1_imu(3)[:12] + b"\xff\xff\xff\xff"):
        messages = [ros1_imu(0), ros1_imu(1), ros1_imu(2), damaged]
        path = write(tmp_path / "a.mcap", "ros1", ("sensor_msgs/Imu", "ros1msg", IMU.encode()), messages)
        with pytest.raises(AttestError, match=r"message 4 of /topic is no sensor_msgs/Imu") as refused:
            read(path, Settings())
        assert "\n" not in str(refused.value)


DEFINITIONS = [
    b"{}",
    b"",
    b"Header header\n",
    b"Header header\nfloat64[] x\n",
    b"import os; os.abort()",
    b"\xff\xfe",
    IMU[:200].encode(),
]


@pytest.mark.parametrize("text", DEFINITIONS)
@pytest.mark.parametrize(("encoding", "kind"), [("ros1", "ros1msg"), ("cdr", "ros2msg")])
def test_a_damaged_definition_of_a_known_type_is_refused_in_one_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], encoding: str, kind: str, text: bytes
) -> None:
    path = write(tmp_path / "a.mcap", encoding, ("sensor_msgs/Imu", kind, text), [ros1_imu(0)])
    with pytest.raises(AttestError, match=r"/topic") as refused:
        read(path, Settings())
    assert "\n" not in str(refused.value)
    assert capfd.readouterr() == ("", "")  # nor does a library say anything


def fix_json(k: int, **more: Any) -> bytes:
    stamp = T0 + k * STEP
    time = {"sec": stamp // 10**9, "nsec": stamp % 10**9}
    fix = {"timestamp": time, "frame_id": "gps", "latitude": 46.5, "longitude": 6.6, "altitude": 400 + k}
    return json.dumps(fix | more).encode()


def test_foxglove_in_json(tmp_path: Path) -> None:
    covariance = {"position_covariance": [4.0, 0, 0, 0, 4.0, 0, 0, 0, 9.0], "position_covariance_type": 2}
    schema = ("foxglove.LocationFix", "jsonschema", b"{}")
    path = write(
        tmp_path / "a.mcap", "json", schema, [fix_json(0, **covariance), fix_json(1), fix_json(2, latitude="x")]
    )
    channel = only(path, "gps")
    assert channel.frame_id == "gps"
    assert channel.values["altitude"].tolist() == [400.0, 401.0, 402.0]
    assert channel.values["latitude"][:2].tolist() == [46.5, 46.5]
    assert np.isnan(channel.values["latitude"][2])
    assert channel.values["gps_sigma_m"][0] == 2.0
    assert channel.values["gps_sigma_up_m"][0] == 3.0
    assert np.isnan(channel.values["gps_sigma_m"][1:]).all()


def test_ros_in_json(tmp_path: Path) -> None:
    def message(k: int) -> bytes:
        stamp = T0 + k * STEP
        header = {"stamp": {"secs": stamp // 10**9, "nsecs": stamp % 10**9}, "frame_id": "imu"}
        vectors = {
            "angular_velocity": {"x": 0.1 * k, "y": 0, "z": 0},
            "linear_acceleration": {"x": 0, "y": 0, "z": 9.81},
        }
        return json.dumps({"header": header, **vectors}).encode()

    path = write(tmp_path / "a.mcap", "json", ("sensor_msgs/Imu", "jsonschema", b""), [message(k) for k in range(50)])
    assert only(path, "imu").values["gyro_x"].tolist() == [0.1 * k for k in range(50)]


@pytest.mark.parametrize("text", [b"{", b"", b"\xff", b"[" * 100_000, b'{"timestamp": {"sec": 1e300, "nsec": 0}}'])
def test_json_that_is_none_is_refused_in_one_line(tmp_path: Path, text: bytes) -> None:
    path = write(tmp_path / "a.mcap", "json", ("foxglove.LocationFix", "jsonschema", b""), [fix_json(0), text])
    with pytest.raises(AttestError, match="/topic") as refused:
        read(path, Settings())
    assert "\n" not in str(refused.value)


def protobuf(name: str, fields: Sequence[tuple[str, int, str]]) -> bytes:
    """The definition of a Foxglove type: name, number and type of its fields."""
    from google.protobuf import descriptor_pb2 as pb
    from google.protobuf.timestamp_pb2 import DESCRIPTOR

    codes = {"double": 1, "string": 9, "doubles": 1, "int32": 5, "google.protobuf.Timestamp": 11}
    made = [
        pb.FieldDescriptorProto(
            name=f, number=k, type=codes[t], label=3 if t == "doubles" else 1, type_name=f".{t}" if "." in t else None
        )
        for f, k, t in fields
    ]
    stamp = pb.FileDescriptorProto.FromString(DESCRIPTOR.serialized_pb)
    message = pb.DescriptorProto(name=name, field=made)
    file = pb.FileDescriptorProto(
        name=f"foxglove/{name}.proto",
        package="foxglove",
        syntax="proto3",
        message_type=[message],
        dependency=[stamp.name],
    )
    return bytes(pb.FileDescriptorSet(file=[stamp, file]).SerializeToString())


FIX = [
    ("latitude", 1, "double"), ("longitude", 2, "double"), ("altitude", 3, "double"),
    ("position_covariance", 4, "doubles"), ("position_covariance_type", 5, "int32"),
    ("timestamp", 6, "google.protobuf.Timestamp"), ("frame_id", 7, "string"),
]  # fmt: skip


def varint(value: int) -> bytes:
    return bytes([value & 0x7F]) if value < 0x80 else bytes([value & 0x7F | 0x80]) + varint(value >> 7)


def fix_protobuf(k: int, order: Sequence[int] = (1, 2, 3)) -> bytes:
    """A fix by hand; ``order``: numbers of latitude, longitude, altitude."""
    stamp = T0 + k * STEP
    time = b"\x08" + varint(stamp // 10**9) + b"\x10" + varint(stamp % 10**9)
    places = zip(order, (46.5, 6.6, 400.0 + k), strict=True)
    return (
        b"".join(bytes([number << 3 | 1]) + struct.pack("<d", value) for number, value in places)
        + b"\x32"
        + varint(len(time))
        + time
    )


def test_foxglove_in_protobuf_and_two_files_in_one_process(tmp_path: Path) -> None:
    pytest.importorskip("mcap_protobuf", reason="the extra [protobuf] is not installed")
    swapped = [("longitude", 1, "double"), ("latitude", 2, "double"), *FIX[2:]]
    for name, fields, order in (("a", FIX, (1, 2, 3)), ("b", swapped, (2, 1, 3))):  # both have schema 1
        schema = ("foxglove.LocationFix", "protobuf", protobuf("LocationFix", fields))
        path = write(tmp_path / f"{name}.mcap", "protobuf", schema, [fix_protobuf(k, order) for k in range(3)])
        channel = only(path, "gps")
        assert channel.values["latitude"].tolist() == [46.5] * 3
        assert channel.values["altitude"].tolist() == [400.0, 401.0, 402.0]
        assert "gps_sigma_m" not in channel.values


@pytest.mark.parametrize("text", [b"", b"\xff\xff\xff", b"\x0a\x02\x0a\x00"])
def test_a_damaged_definition_in_protobuf_is_refused_in_one_line(tmp_path: Path, text: bytes) -> None:
    pytest.importorskip("mcap_protobuf", reason="the extra [protobuf] is not installed")
    path = write(tmp_path / "a.mcap", "protobuf", ("foxglove.LocationFix", "protobuf", text), [fix_protobuf(0)])
    with pytest.raises(AttestError, match=r"the definition of foxglove\.LocationFix on /topic is damaged"):
        read(path, Settings())


def test_a_damaged_message_in_protobuf_is_refused_in_one_line(tmp_path: Path) -> None:
    pytest.importorskip("mcap_protobuf", reason="the extra [protobuf] is not installed")
    schema = ("foxglove.LocationFix", "protobuf", protobuf("LocationFix", FIX))
    path = write(tmp_path / "a.mcap", "protobuf", schema, [fix_protobuf(0), fix_protobuf(1)[:-3]])
    with pytest.raises(AttestError, match=r"message 2 of /topic is no foxglove\.LocationFix"):
        read(path, Settings())


def test_a_missing_package_is_one_line_that_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path / "a.mcap", "protobuf", ("foxglove.LocationFix", "protobuf", b""), [b""])
    for name in ("mcap_protobuf", "mcap_protobuf.decoder"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(AttestError, match=r"mcap-protobuf-support.*pip install 'attest-cli\[protobuf\]'") as refused:
        read(path, Settings())
    assert str(refused.value).startswith(str(path))
    unused = write(tmp_path / "b.mcap", "protobuf", ("own.Type", "protobuf", b""), [b""])
    assert read(unused, Settings()).other == {"/topic": "own.Type (protobuf)"}
