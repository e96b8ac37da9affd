"""ROS 2 messages that attest reads: type -> role, canonical columns, units, and how a decoded message becomes a row."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..records import COLUMNS, Array, Channel, Ints

NAN = math.nan
IGNORED_VARIANCE = 1e5
"""From here on a variance says "do not use" (drivers write 1e6 and more)."""

DIRECTIONS: Mapping[str, tuple[str, ...]] = {
    "sun": ("sun",), "compass": ("compass", "heading", "north"), "magnetometer": ("mag",), "accel": ("accel",),
    "gyro": ("gyro", "angular"),
}  # fmt: skip
"""Role of a ``Vector3Stamped`` -> words in the name of its topic. Other topics have no role unless mapped."""

UNITS: Mapping[str, str] = {"sun": "1", "magnetometer": "T", "accel": "m/s^2", "gyro": "rad/s"}

Row = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class MessageType:
    """How one message type is read: ``row`` gives the values of ``columns`` of one message."""

    columns: tuple[str, ...]
    units: tuple[str, ...]
    row: Callable[[Any], Row]
    channels: Callable[[str, str, Ints, Mapping[str, Array], Mapping[str, str]], Sequence[Channel]]


def _variance(value: float) -> float:
    """Return a variance that can be used; zero is unknown, -1 not provided (REP-145)."""
    return value if 0.0 < value < IGNORED_VARIANCE else NAN


def _sigma(covariance: Sequence[float], *places: int) -> float:
    return math.sqrt(sum(_variance(covariance[k]) for k in places) / len(places))


def _imu(message: Any) -> Row:
    w, a, q = message.angular_velocity, message.linear_acceleration, message.orientation
    has_w, has_a = message.angular_velocity_covariance[0] != -1, message.linear_acceleration_covariance[0] != -1
    gyro = (w.x, w.y, w.z) if has_w else (NAN, NAN, NAN)
    accel = (a.x, a.y, a.z) if has_a else (NAN, NAN, NAN)
    return (*gyro, *accel, *((q.w, q.x, q.y, q.z) if message.orientation_covariance[0] != -1 else (NAN, NAN, NAN, NAN)))


def _imu_channels(
    topic: str, kind: str, stamps_ns: Ints, values: Mapping[str, Array], units: Mapping[str, str]
) -> Sequence[Channel]:
    """Split a sensor_msgs/Imu into the imu, or the half that is provided, and an orientation without a role."""
    present = [role for role in ("gyro", "accel") if not all(np.all(np.isnan(values[name])) for name in COLUMNS[role])]
    role = "imu" if len(present) != 1 else present[0]
    found = [_only(topic, kind, role, stamps_ns, values, units, COLUMNS[role])]
    if np.any(np.nan_to_num(values["q_w"]) != 0.0):  # all zero: a driver without orientation
        name = f"{topic}#orientation"
        found.append(_only(name, kind, "", stamps_ns, values, units, COLUMNS["orientation"]))
    return found


def _only(
    name: str,
    kind: str,
    role: str,
    stamps_ns: Ints,
    values: Mapping[str, Array],
    units: Mapping[str, str],
    columns: Sequence[str],
) -> Channel:
    return Channel(name, kind, role, stamps_ns, {c: values[c] for c in columns}, {c: units[c] for c in columns})


def _plain(role: str) -> Callable[[str, str, Ints, Mapping[str, Array], Mapping[str, str]], Sequence[Channel]]:
    """Make one channel of all columns; those of sigmas that are never stated are left out."""

    def channels(
        topic: str, kind: str, stamps_ns: Ints, values: Mapping[str, Array], units: Mapping[str, str]
    ) -> Sequence[Channel]:
        columns = [name for name in values if "sigma" not in name or np.any(np.isfinite(values[name]))]
        return [_only(topic, kind, role, stamps_ns, values, units, columns)]

    return channels


def _magnetic(message: Any) -> Row:
    field = message.magnetic_field
    return (field.x, field.y, field.z, _sigma(message.magnetic_field_covariance, 0, 4, 8))


def _fix(message: Any) -> Row:
    if message.status.status < 0:  # no fix
        return (NAN, NAN, NAN, NAN, NAN)
    covariance = message.position_covariance if message.position_covariance_type != 0 else [0.0] * 9
    sigmas = _sigma(covariance, 0, 4), _sigma(covariance, 8)
    return (message.latitude, message.longitude, message.altitude, *sigmas)


def _odometry(message: Any) -> Row:
    velocity, covariance = message.twist.twist.linear, message.twist.covariance
    parts = (velocity.x, velocity.y, velocity.z)
    used = tuple(NAN if covariance[7 * k] >= IGNORED_VARIANCE else parts[k] for k in range(3))
    return (*used, *(_sigma(covariance, 7 * k) for k in range(3)))


def _vector_channels(
    topic: str, kind: str, stamps_ns: Ints, values: Mapping[str, Array], _: Mapping[str, str]
) -> Sequence[Channel]:
    """Give a vector the role that its topic names; a compass is turned from a vector to north into a heading."""
    role = next((role for role, words in DIRECTIONS.items() if any(word in topic.lower() for word in words)), "")
    if role == "compass":
        heading = np.mod(np.degrees(np.arctan2(values["y"], values["x"])), 360.0)  # clockwise from north to body x
        return [Channel(topic, kind, role, stamps_ns, {"compass_deg": heading}, {"compass_deg": "deg"})]
    names = COLUMNS[role] if role else ("x", "y", "z")
    held = dict(zip(names, (values["x"], values["y"], values["z"]), strict=True))
    return [Channel(topic, kind, role, stamps_ns, held, dict.fromkeys(names, UNITS.get(role, "")))]


_IMU_COLUMNS = (*COLUMNS["imu"], *COLUMNS["orientation"])
_SPEEDS = tuple(f"velocity_sigma_{axis}" for axis in "xyz")
_GPS_SIGMAS = ("gps_sigma_m", "gps_sigma_up_m")

TYPES: Mapping[str, MessageType] = {
    "sensor_msgs/msg/Imu": MessageType(_IMU_COLUMNS, ("rad/s",) * 3 + ("m/s^2",) * 3 + ("1",) * 4, _imu, _imu_channels),
    "sensor_msgs/msg/MagneticField": MessageType(
        (*COLUMNS["magnetometer"], "mag_sigma"), ("T",) * 4, _magnetic, _plain("magnetometer")
    ),
    "sensor_msgs/msg/NavSatFix": MessageType(
        (*COLUMNS["gps"], *_GPS_SIGMAS), ("deg", "deg", "m", "m", "m"), _fix, _plain("gps")
    ),
    "sensor_msgs/msg/Temperature": MessageType(
        COLUMNS["temperature"], ("degC",), lambda m: (m.temperature,), _plain("temperature")
    ),
    "nav_msgs/msg/Odometry": MessageType((*COLUMNS["odometry"], *_SPEEDS), ("m/s",) * 6, _odometry, _plain("odometry")),
    "geometry_msgs/msg/TwistStamped": MessageType(
        COLUMNS["odometry"],
        ("m/s",) * 3,
        lambda m: (m.twist.linear.x, m.twist.linear.y, m.twist.linear.z),
        _plain("odometry"),
    ),
    "geometry_msgs/msg/PointStamped": MessageType(
        COLUMNS["position"], ("m",) * 3, lambda m: (m.point.x, m.point.y, m.point.z), _plain("position")
    ),
    "geometry_msgs/msg/QuaternionStamped": MessageType(
        COLUMNS["orientation"],
        ("1",) * 4,
        lambda m: (m.quaternion.w, m.quaternion.x, m.quaternion.y, m.quaternion.z),
        _plain("orientation"),
    ),
    "geometry_msgs/msg/Vector3Stamped": MessageType(
        ("x", "y", "z"), ("", "", ""), lambda m: (m.vector.x, m.vector.y, m.vector.z), _vector_channels
    ),
}
"""Schema name -> how it is read. All have a ``std_msgs/Header``."""
