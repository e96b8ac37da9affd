"""ROS 1 bags and ROS 2 bags in SQLite: the same channels as from MCAP, damage and hostile parts in one line."""

from __future__ import annotations

import bz2
import sqlite3
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from attest_cli.errors import AttestError
from attest_cli.readers import bag_log, read
from attest_cli.records import Channel, Recording
from attest_cli.settings import Settings

pytest.importorskip("rosbags", reason="the extra [bag] is not installed")

from rosbags import rosbag1, typesys

T0 = 1_780_308_000_000_000_001
STEP = 10_000_000
STORES = {1: typesys.get_typestore(typesys.Stores.ROS1_NOETIC), 2: typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)}


def message(ros: int, kind: str, k: int, frame: str = "imu_link", **fields: Any) -> Any:
    """A message of ROS 1 or 2; what is not given is zero."""
    types = STORES[ros].types
    stamp = T0 + k * STEP
    time = types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
    head = {"seq": k} if ros == 1 else {}
    header = types["std_msgs/msg/Header"](stamp=time, frame_id=frame, **head)
    return types[kind](header=header, **fields)


def imu(ros: int, k: int, frame: str = "imu_link") -> bytes:
    types = STORES[ros].types
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    covariances = ("orientation", "angular_velocity", "linear_acceleration")
    fields = {f"{name}_covariance": np.zeros(9) for name in covariances}
    made = message(
        ros, "sensor_msgs/msg/Imu", k, frame, orientation=quaternion(0.0, 0.0, 0.0, 0.0),
        angular_velocity=vector(0.1 * k, 0.2, 0.3), linear_acceleration=vector(0.0, 0.5, 9.81), **fields,
    )  # fmt: skip
    store = STORES[ros]
    return bytes((store.serialize_ros1 if ros == 1 else store.serialize_cdr)(made, "sensor_msgs/msg/Imu"))


def ros1(path: Path, count: int = 60, compression: str | None = None, changing: bool = False) -> Path:
    """Write a bag of one IMU, and of a topic whose definition cannot be parsed; frames of changing length, if asked."""
    out = rosbag1.Writer(path)
    if compression:
        out.set_compression(rosbag1.Writer.CompressionFormat[compression])
    with out:
        hostile = {"msgtype": "evil/msg/Type", "msgdef": "<b>evil<\n=====\n---\n", "md5sum": "0" * 32}
        imus = out.add_connection("/imu/data", "sensor_msgs/msg/Imu", typestore=STORES[1])
        unused = out.add_connection("/evil", **hostile)
        for k in range(count):
            out.write(imus, T0 + k * STEP + 5, imu(1, k, "f" * (k % 7) if changing else "imu"))
            out.write(unused, T0 + k * STEP + 6, b"\x00")
    return path


DB3 = """
CREATE TABLE topics(
    id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT, offered_qos_profiles TEXT
);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
"""


def db3(path: Path, count: int = 60, definition: str | None = None) -> Path:
    """Write the file of a ROS 2 bag as rosbag2 does, without the folder and its metadata."""
    base = sqlite3.connect(path)
    base.executescript(DB3)
    topics = [
        (1, "/imu/data", "sensor_msgs/msg/Imu", "cdr"),
        (2, "/evil", "evil/msg/<b>", "cdr"),
        (3, "/odd", "a/msg/B", "x"),
    ]
    base.executemany("INSERT INTO topics VALUES(?, ?, ?, ?, '[: not yaml')", topics)
    rows = [(1, T0 + k * STEP + 5, imu(2, k)) for k in range(count)] + [(2, T0, b"\x00")]
    base.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)", rows)
    if definition is not None:
        base.execute("CREATE TABLE message_definitions(id, topic_type, encoding, encoded_message_definition)")
        base.execute("INSERT INTO message_definitions VALUES(1, 'sensor_msgs/msg/Imu', 'ros2msg', ?)", (definition,))
    base.commit()
    base.close()
    return path


def held(recording: Recording) -> Channel:
    (channel,) = recording.channels
    assert (channel.name, channel.kind, channel.role) == ("/imu/data", "sensor_msgs/msg/Imu", "imu")
    assert channel.stamps_ns.tolist() == [T0 + k * STEP for k in range(channel.stamps_ns.size)]
    assert channel.values["gyro_x"].tolist() == [0.1 * k for k in range(channel.stamps_ns.size)]
    assert channel.values["accel_z"][0] == 9.81
    return channel


@pytest.mark.parametrize("compression", [None, "BZ2", "LZ4"])
def test_a_ros1_bag_is_read_exactly_and_a_hostile_topic_is_left_alone(tmp_path: Path, compression: str | None) -> None:
    recording = read(ros1(tmp_path / "a.bag", compression=compression), Settings())
    channel = held(recording)
    assert (recording.format, recording.rows, channel.frame_id, recording.warnings) == ("bag", 60, "imu", ())
    assert recording.other == {"/evil": "evil/msg/Type (ros1)"}
    by_log = read(tmp_path / "a.bag", Settings.model_validate({"time": {"source": "log"}}))
    assert by_log.channels[0].stamps_ns[0] == T0 + 5


def test_strings_of_changing_length_are_followed(tmp_path: Path) -> None:
    held(read(ros1(tmp_path / "a.bag", changing=True), Settings()))


@pytest.mark.parametrize("own", [True, False])
def test_a_db3_without_metadata_is_read_exactly(tmp_path: Path, own: bool) -> None:
    text = STORES[2].generate_msgdef("sensor_msgs/msg/Imu", ros_version=2)[0] if own else None
    recording = read(db3(tmp_path / "a.db3", definition=text), Settings())
    assert (recording.format, held(recording).frame_id, recording.warnings) == ("db3", "imu_link", ())
    assert recording.other == {"/evil": "evil/msg/<b> (cdr)", "/odd": "a/msg/B (x)"}


def test_a_folder_of_a_bag_says_which_file_to_name(tmp_path: Path) -> None:
    db3(tmp_path / "drive_0.db3")
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information:\n")
    with pytest.raises(AttestError, match=r"the folder of a ROS 2 bag; name its files: .*drive_0\.db3"):
        read(tmp_path, Settings())


def test_what_the_write_ahead_log_holds_is_said_to_be_lost(tmp_path: Path) -> None:
    path = db3(tmp_path / "a.db3")
    (tmp_path / "a.db3-wal").write_bytes(b"x" * 100)
    assert [(w.code, w.lost) for w in read(path, Settings()).warnings] == [("write-ahead-log", True)]


@pytest.mark.parametrize("share", [0.02, 0.5, 0.9, 0.99, 0.999])
def test_a_cut_bag_is_refused_in_one_line(tmp_path: Path, share: float) -> None:
    for path, way_out in (
        (ros1(tmp_path / "a.bag", 600), "rosbag reindex"),
        (db3(tmp_path / "a.db3", 600), ".recover"),
    ):
        data = path.read_bytes()
        path.write_bytes(data[: int(len(data) * share)])
        with pytest.raises(AttestError, match=way_out) as refused:
            read(path, Settings())
        assert str(refused.value).startswith(f"{path}: damaged ROS")
        assert "\n" not in str(refused.value)


def test_an_index_that_its_summary_contradicts_is_said(tmp_path: Path) -> None:
    path = ros1(tmp_path / "a.bag")
    head, _, tail = path.read_bytes().rpartition(struct.pack("<II", 0, 60))  # messages of the first topic in the chunk
    path.write_bytes(head + struct.pack("<II", 0, 61) + tail)
    recording = read(path, Settings())
    assert [(w.code, w.lost) for w in recording.warnings] == [("damaged-index", True)]
    assert "60 messages of /imu/data, its summary 61" in recording.warnings[0].message


def test_flipped_bytes_lose_no_message_without_a_word(tmp_path: Path, rng: np.random.Generator) -> None:
    for path in (ros1(tmp_path / "a.bag", 20, "BZ2"), ros1(tmp_path / "b.bag", 20, "LZ4"), db3(tmp_path / "a.db3", 20)):
        whole, gyro = path.read_bytes(), read(path, Settings()).channels[0].values["gyro_x"]
        for at in rng.integers(16, len(whole), 100):
            data = bytearray(whole)
            data[at] ^= 1 << int(rng.integers(8))
            path.write_bytes(data)
            try:
                recording = read(path, Settings())
            except AttestError as refused:
                assert "\n" not in str(refused)  # noqa: PT017 (either outcome is fine)
                continue
            found = {c.name: c for c in recording.channels}.get("/imu/data")
            count = 0 if found is None else found.stamps_ns.size
            named = "/imu/data" in recording.other or found is None  # its name or type is what was flipped
            assert count == 20 or named or any(told.lost for told in recording.warnings), (path, at)
            if path.name == "a.bag" and found is not None and count == 20:  # of the three, bzip2 alone has checksums
                np.testing.assert_array_equal(found.values["gyro_x"], gyro)


def test_a_topic_without_a_number_is_refused(tmp_path: Path) -> None:
    path = db3(tmp_path / "a.db3", 20)
    with sqlite3.connect(path) as base:
        base.executescript(
            "CREATE TABLE other AS SELECT NULL AS id, name, type, serialization_format FROM topics;"
            "DROP TABLE topics; ALTER TABLE other RENAME TO topics;"
        )
    base.close()
    with pytest.raises(AttestError, match="damaged ROS 2 bag"):
        read(path, Settings())


def test_messages_of_no_topic_are_told(tmp_path: Path) -> None:
    path = db3(tmp_path / "a.db3", 20)
    with sqlite3.connect(path) as base:
        base.execute("UPDATE messages SET topic_id = 9 WHERE id = 7")
    base.close()
    (told,) = read(path, Settings()).warnings
    assert (told.code, told.lost) == ("damaged-bag", True)
    assert "1 messages are of no topic" in told.message


@pytest.mark.parametrize("definition", ["Header header\nfloat64[] x\n", "<b>evil<", "uint8 a\n", "uint8 a\n" * 2000])
def test_a_damaged_definition_of_a_known_type_is_refused(tmp_path: Path, definition: str) -> None:
    with pytest.raises(AttestError) as refused:
        read(db3(tmp_path / "a.db3", definition=definition), Settings())
    assert "/imu/data" in str(refused.value)


def test_a_message_that_is_none_is_refused(tmp_path: Path) -> None:
    path = db3(tmp_path / "a.db3")
    with sqlite3.connect(path) as base:
        base.execute("UPDATE messages SET data = 'text' WHERE id = 7")
    base.close()
    with pytest.raises(AttestError, match="no message"):
        read(path, Settings())


def test_an_sqlite_file_that_is_no_bag_is_refused(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "a.db3") as base:
        base.execute("CREATE TABLE t(x)")
    base.close()
    with pytest.raises(AttestError, match="without the tables of a ROS 2 bag"):
        read(tmp_path / "a.db3", Settings())


def test_a_chunk_larger_than_the_limit_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bag_log, "MAX_CHUNK_BYTES", 1 << 20)
    assert len(bag_log._unpack(bz2.compress(bytes(1 << 20)))) == 1 << 20
    with pytest.raises(ValueError, match="more than the limit of 1 MB"):
        bag_log._unpack(bz2.compress(bytes(50 << 20)))
    with pytest.raises(ValueError, match="ends too early"):
        bag_log._unpack(bz2.compress(bytes(1000))[:-8])


def test_a_missing_package_is_one_line_that_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = ros1(tmp_path / "a.bag"), db3(tmp_path / "a.db3")
    for name in [name for name in sys.modules if name.partition(".")[0] == "rosbags"]:
        monkeypatch.setitem(sys.modules, name, None)
    for path in paths:
        with pytest.raises(AttestError, match=r"pip install 'attest-cli\[bag\]'") as refused:
            read(path, Settings())
        assert str(refused.value).startswith(str(path))


@pytest.mark.parametrize(
    ("bag", "mcap"),
    [
        ("logs/robot_localization/test1.bag", "logs/derived_mcap/test1_ros2_zstd.mcap"),
        ("logs/imu_tools/phidgets_imu_upside_down.bag", "logs/derived_mcap/phidgets_imu_upside_down_ros2_zstd.mcap"),
        ("logs/imu_tools/sparkfun_razor.bag", "logs/derived_mcap/razor_ros1_lz4.mcap"),
        ("logs/imu_tools/sparkfun_razor.bag", "logs/derived_mcap/razor_ros1_unchunked.mcap"),
    ],
)
def test_a_real_bag_gives_what_its_mcap_gives(shared_data: Path, bag: str, mcap: str) -> None:
    for name in (bag, mcap):
        if not (shared_data / name).is_file():
            pytest.skip(f"{name} is not here")
    ours, theirs = (
        {channel.name: channel for channel in read(shared_data / name, Settings()).channels} for name in (bag, mcap)
    )
    assert ours.keys() == theirs.keys()
    for name, channel in ours.items():
        assert (channel.role, channel.frame_id) == (theirs[name].role, theirs[name].frame_id)
        assert np.array_equal(channel.stamps_ns, theirs[name].stamps_ns)
        for column, values in channel.values.items():
            assert np.array_equal(values, theirs[name].values[column], equal_nan=True)


@pytest.mark.parametrize("name", ["imu_tools/ardrone_imu.bag", "robot_localization/test2.bag"])
def test_a_real_bag_decodes_as_the_library_decodes_it(shared_data: Path, name: str) -> None:
    path = shared_data / "logs" / name
    if not path.is_file():
        pytest.skip(f"{name} is not here")
    channel = next(c for c in read(path, Settings()).channels if c.role == "imu")
    with rosbag1.Reader(path) as reader:
        wanted = [c for c in reader.connections if c.topic == channel.name]
        decoded = [STORES[1].deserialize_ros1(data, c.msgtype) for c, _, data in reader.messages(wanted)]
    assert channel.values["accel_y"].tolist() == [m.linear_acceleration.y for m in decoded]
    assert channel.values["gyro_z"].tolist() == [m.angular_velocity.z for m in decoded]
    assert channel.stamps_ns.tolist() == [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in decoded]
