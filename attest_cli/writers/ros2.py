"""ROS 2 messages into MCAP: the definitions of the types that attest writes, and a file that is whole or absent."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mcap.records import Schema
from mcap_ros2.writer import Writer

from ..errors import AttestError
from .files import atomic_write

Message = dict[str, Any]

_HEADER = "std_msgs/Header header\n"
DEFINITIONS: Mapping[str, str] = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance",
    "geometry_msgs/Vector3Stamped": _HEADER + "geometry_msgs/Vector3 vector",
    "geometry_msgs/PointStamped": _HEADER + "geometry_msgs/Point point",
    "geometry_msgs/QuaternionStamped": _HEADER + "geometry_msgs/Quaternion quaternion",
    "nav_msgs/Odometry": _HEADER
    + "string child_frame_id\ngeometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist",
    "sensor_msgs/Imu": _HEADER
    + "geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
    + "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
    + "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance",
    "sensor_msgs/MagneticField": _HEADER + "geometry_msgs/Vector3 magnetic_field\nfloat64[9] magnetic_field_covariance",
    "sensor_msgs/Temperature": _HEADER + "float64 temperature\nfloat64 variance",
    "sensor_msgs/NavSatStatus": "int8 status\nuint16 service",
    "sensor_msgs/NavSatFix": _HEADER
    + "sensor_msgs/NavSatStatus status\nfloat64 latitude\nfloat64 longitude\nfloat64 altitude\n"
    + "float64[9] position_covariance\nuint8 position_covariance_type",
}
"""Type without ``msg`` -> its fields, as in common_interfaces (humble), without comments and constants."""


class Bag:
    """An MCAP file being written: schemas and channels are registered on first use."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._schemas: dict[str, Schema] = {}

    def send(self, topic: str, type_name: str, stamp_ns: int, frame_id: str, fields: Message) -> None:
        """Write one message; its header, log and publish time are the stamp."""
        if type_name not in self._schemas:
            package, name = type_name.split("/")
            self._schemas[type_name] = self._writer.register_msgdef(f"{package}/msg/{name}", definition(type_name))
        stamp = {"sec": stamp_ns // 1_000_000_000, "nanosec": stamp_ns % 1_000_000_000}
        message = {"header": {"stamp": stamp, "frame_id": frame_id}, **fields}
        self._writer.write_message(topic, self._schemas[type_name], message, log_time=stamp_ns)

    def note(self, name: str, metadata: Mapping[str, str]) -> None:
        """Write a metadata record."""
        self._writer.add_metadata(name, dict(metadata))


@contextmanager
def bag(path: Path, first_stamp_ns: int) -> Iterator[Bag]:
    """Open an MCAP file for writing, zstd chunks, with checksums; whole or absent.

    Raises
    ------
    AttestError
        If stamps are negative: ROS has none.
    """
    if first_stamp_ns < 0:
        raise AttestError(f"{path}: stamps before 1970 cannot be written as ROS messages", "write Parquet or CSV")
    with atomic_write(path) as temporary, temporary.open("wb") as stream, Writer(stream) as writer:
        yield Bag(writer)


def definition(type_name: str) -> str:
    """Return the definition of a type with those of all the types in it, as MCAP's ros2msg asks."""
    parts, queue, seen = [DEFINITIONS[type_name]], [type_name], {type_name}
    while queue:
        for line in DEFINITIONS[queue.pop(0)].splitlines():
            inner = line.split()[0]
            if inner in DEFINITIONS and inner not in seen:
                seen.add(inner)
                queue.append(inner)
                parts.append(f"MSG: {inner}\n{DEFINITIONS[inner]}")
    return f"\n{'=' * 80}\n".join(parts)


def vector(x: float, y: float, z: float) -> Message:
    """Return a Vector3 or Point."""
    return {"x": x, "y": y, "z": z}


def quaternion(w: float, x: float, y: float, z: float) -> Message:
    """Return a Quaternion."""
    return {"x": x, "y": y, "z": z, "w": w}


def diagonal(size: int, *variances: float) -> list[float]:
    """Return a covariance (size x size), row-major, with these variances first on its diagonal."""
    covariance = [0.0] * (size * size)
    for k, variance in enumerate(variances):
        covariance[k * (size + 1)] = variance
    return covariance
