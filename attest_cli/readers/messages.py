"""Messages of ROS and Foxglove that attest reads: type -> role, the fields used, canonical columns, units, and how one
becomes the other.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..records import COLUMNS, Array, Bools, Channel, Ints

IGNORED_VARIANCE = 1e5
"""From here on a variance says "do not use" (drivers write 1e6 and more)."""

DIRECTIONS: Mapping[str, tuple[str, ...]] = {
    "sun": ("sun",), "compass": ("compass", "heading", "north"), "magnetometer": ("mag",), "accel": ("accel",),
    "gyro": ("gyro", "angular"),
}  # fmt: skip
"""Role of a ``Vector3Stamped`` -> words in the name of its topic. Other topics have no role unless mapped."""

UNITS: Mapping[str, str] = {"sun": "1", "magnetometer": "T", "accel": "m/s^2", "gyro": "rad/s"}


def unchanged(fields: Array) -> Sequence[Array]:
    """Take the fields as the columns."""
    return [*fields]


STAMP = ("header.stamp.sec", "header.stamp.nanosec")
FRAME = "header.frame_id"


@dataclass(frozen=True, slots=True)
class MessageType:
    """How one message type is read: ``table`` makes ``columns``, c of (n,), of the ``fields`` (k, n) of n messages.

    ``stamp``: the fields of seconds and nanoseconds; ``frame``: that of the frame's name.
    """

    columns: tuple[str, ...]
    units: tuple[str, ...]
    fields: tuple[str, ...]
    table: Callable[[Array], Sequence[Array]]
    channels: Callable[[str, str, Ints, Mapping[str, Array], Mapping[str, str]], Sequence[Channel]]
    stamp: tuple[str, str] = STAMP
    frame: str = FRAME


def _sigma(*variances: Array) -> Array:
    """Return the root of the mean of variances; zero is unknown, -1 not provided (REP-145), huge says "do not use"."""
    total = np.zeros_like(variances[0])
    for v in variances:
        total += np.where((v > 0.0) & (v < IGNORED_VARIANCE), v, np.nan)
    return np.asarray(np.sqrt(total / len(variances)))


def _blank(fields: Array, where: Bools) -> Array:
    return np.where(where, np.nan, fields) if np.any(where) else fields


def _imu(f: Array) -> Sequence[Array]:
    """A first variance of -1 says that the reading is not provided."""
    return [*_blank(f[0:3], f[10] == -1.0), *_blank(f[3:6], f[11] == -1.0), *_blank(f[6:10], f[12] == -1.0)]


def _imu_channels(
    topic: str, kind: str, stamps_ns: Ints, values: Mapping[str, Array], units: Mapping[str, str]
) -> Sequence[Channel]:
    """Split a sensor_msgs/Imu into the imu, or the half that is provided, and an orientation without a role."""
    present = [role for role in ("gyro", "accel") if not all(np.all(np.isnan(values[name])) for name in COLUMNS[role])]
    role = "imu" if len(present) != 1 else present[0]
    found = [_only(topic, kind, role, stamps_ns, values, units, COLUMNS[role])]
    if np.any(np.abs(values["q_w"]) > 0.0):  # all zero: a driver without orientation
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


def _magnetic(f: Array) -> Sequence[Array]:
    return [*f[:3], _sigma(*f[3:])]


def _fix(f: Array) -> Sequence[Array]:
    """A negative status is no fix; a covariance type of 0 is no covariance."""
    status, kind, place, variances = f[0], f[1], f[2:5], f[5:8]
    known = _blank(variances, kind == 0.0)
    return [*_blank(np.stack([*place, _sigma(known[0], known[1]), _sigma(known[2])]), status < 0.0)]


def _location(f: Array) -> Sequence[Array]:
    """As a NavSatFix, but without a status: Foxglove has none."""
    return _fix(np.concatenate([np.zeros((1, f.shape[1])), f]))


def _pose_channels(
    topic: str, kind: str, stamps_ns: Ints, values: Mapping[str, Array], units: Mapping[str, str]
) -> Sequence[Channel]:
    """Split a pose, which is what another filter made of the sensors, into two channels without a role."""
    parts = (("orientation", COLUMNS["orientation"]), ("position", COLUMNS["position"]))
    return [_only(f"{topic}#{part}", kind, "", stamps_ns, values, units, columns) for part, columns in parts]


def _odometry(f: Array) -> Sequence[Array]:
    velocity, variances = f[:3], f[3:]
    return [*_blank(velocity, variances >= IGNORED_VARIANCE), *map(_sigma, variances)]


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


def _of(name: str, *parts: str) -> tuple[str, ...]:
    return tuple(f"{name}{part}" for part in parts)


XYZ = (".x", ".y", ".z")
_SPEEDS = tuple(f"velocity_sigma_{axis}" for axis in "xyz")
_IMU_FIELDS = (
    *_of("angular_velocity", *XYZ), *_of("linear_acceleration", *XYZ), *_of("orientation", ".w", *XYZ),
    "angular_velocity_covariance[0]", "linear_acceleration_covariance[0]", "orientation_covariance[0]",
)  # fmt: skip
_FIX_FIELDS = (
    "status.status", "position_covariance_type", "latitude", "longitude", "altitude",
    *_of("position_covariance", "[0]", "[4]", "[8]"),
)  # fmt: skip
_FOXGLOVE = (("timestamp.sec", "timestamp.nanosec"), "frame_id")

TYPES: Mapping[str, MessageType] = {
    "sensor_msgs/msg/Imu": MessageType(
        (*COLUMNS["imu"], *COLUMNS["orientation"]), ("rad/s",) * 3 + ("m/s^2",) * 3 + ("1",) * 4, _IMU_FIELDS, _imu,
        _imu_channels,
    ),
    "sensor_msgs/msg/MagneticField": MessageType(
        (*COLUMNS["magnetometer"], "mag_sigma"), ("T",) * 4,
        (*_of("magnetic_field", *XYZ), *_of("magnetic_field_covariance", "[0]", "[4]", "[8]")), _magnetic,
        _plain("magnetometer"),
    ),
    "sensor_msgs/msg/NavSatFix": MessageType(
        (*COLUMNS["gps"], "gps_sigma_m", "gps_sigma_up_m"), ("deg", "deg", "m", "m", "m"), _FIX_FIELDS, _fix,
        _plain("gps"),
    ),
    "sensor_msgs/msg/Temperature": MessageType(
        COLUMNS["temperature"], ("degC",), ("temperature",), unchanged, _plain("temperature")
    ),
    "nav_msgs/msg/Odometry": MessageType(
        (*COLUMNS["odometry"], *_SPEEDS), ("m/s",) * 6,
        (*_of("twist.twist.linear", *XYZ), *_of("twist.covariance", "[0]", "[7]", "[14]")), _odometry,
        _plain("odometry"),
    ),
    "geometry_msgs/msg/TwistStamped": MessageType(
        COLUMNS["odometry"], ("m/s",) * 3, _of("twist.linear", *XYZ), unchanged, _plain("odometry")
    ),
    "geometry_msgs/msg/PointStamped": MessageType(
        COLUMNS["position"], ("m",) * 3, _of("point", *XYZ), unchanged, _plain("position")
    ),
    "geometry_msgs/msg/QuaternionStamped": MessageType(
        COLUMNS["orientation"], ("1",) * 4, _of("quaternion", ".w", *XYZ), unchanged, _plain("orientation")
    ),
    "geometry_msgs/msg/Vector3Stamped": MessageType(
        ("x", "y", "z"), ("", "", ""), _of("vector", *XYZ), unchanged, _vector_channels
    ),
    "foxglove.LocationFix": MessageType(
        (*COLUMNS["gps"], "gps_sigma_m", "gps_sigma_up_m"), ("deg", "deg", "m", "m", "m"), _FIX_FIELDS[1:], _location,
        _plain("gps"), *_FOXGLOVE,
    ),
    "foxglove.PoseInFrame": MessageType(
        (*COLUMNS["orientation"], *COLUMNS["position"]), ("1",) * 4 + ("m",) * 3,
        (*_of("pose.orientation", ".w", *XYZ), *_of("pose.position", *XYZ)), unchanged, _pose_channels, *_FOXGLOVE,
    ),
}  # fmt: skip
"""Schema name -> how it is read. Those of ROS have a ``std_msgs/Header``."""
