"""Recordings to logs: the canonical columns and topics of ``interface.md``, the same values in every format."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from ..errors import AttestError
from ..records import Channel, Recording
from ..settings.units import unit
from .csv import write_text
from .files import write_arrow
from .ros2 import Message, bag, diagonal, quaternion, vector

CANONICAL_UNITS: Mapping[str, str] = {
    "gyro": "rad/s", "accel": "m/s^2", "mag": "uT", "sun": "1", "q": "1", "velocity": "m/s", "position": "m",
    "speed": "m/s", "compass": "deg", "latitude": "deg", "longitude": "deg", "altitude": "m", "gps": "m",
    "temperature": "degC", "baro": "m",
}  # fmt: skip
"""First word of a column -> unit that its name implies in a table."""

IGNORED_VARIANCE = 1e6
BLOCK_ROWS = 1 << 16  # made into messages together


def write_recording(recording: Recording, path: Path) -> tuple[str, ...]:
    """Write the channels of a recording as CSV, Parquet or MCAP, by the suffix.

    In a table all channels share one time column; blank cells are no measurement. A unit other than the canonical one
    stands in the header (CSV) or the field's metadata (Parquet); messages are in SI.

    Returns
    -------
    tuple of str
        Names of the channels that have no place in the format and were left out.

    Raises
    ------
    AttestError
        If the suffix is unknown, or the file cannot be written.
    """
    writers: Mapping[str, Callable[[Recording, Path], tuple[str, ...]]] = {
        ".csv": _write_csv, ".parquet": _write_parquet, ".pq": _write_parquet, ".mcap": _write_mcap,
    }  # fmt: skip
    writer = writers.get(path.suffix.lower())
    if writer is None:
        raise AttestError(f"{path}: no log format of this name", f"use one of {', '.join(writers)}")
    if not any(channel.role and channel.stamps_ns.size for channel in recording.channels):
        raise AttestError(f"{recording.source}: no channel to write to {path}", "attest info shows what was found")
    return writer(recording, path)


Named = tuple[str, NDArray[np.float64], str]  # column name, values of the whole table, unit


def _write_csv(recording: Recording, path: Path) -> tuple[str, ...]:
    stamps_ns, columns, left_out = _table(recording)
    header = [name if not unit_name else f"{name} [{unit_name}]" for name, _, unit_name in columns]
    arrays = {"timestamp_ns": pa.array(stamps_ns)} | {name: pa.array(values) for name, values, _ in columns}
    write_text([pa.table(arrays).rename_columns(["timestamp_ns", *header])], path, [])
    return left_out


def _write_parquet(recording: Recording, path: Path) -> tuple[str, ...]:
    stamps_ns, columns, left_out = _table(recording)
    fields = [pa.field("timestamp_ns", pa.int64())]
    fields += [pa.field(name, pa.float64(), metadata={"unit": u} if u else None) for name, _, u in columns]
    arrays = [pa.array(stamps_ns), *(pa.array(values, from_pandas=True) for _, values, _ in columns)]
    write_arrow([pa.table(arrays, schema=pa.schema(fields))], path)
    return left_out


def _table(recording: Recording) -> tuple[NDArray[np.int64], list[Named], tuple[str, ...]]:
    """Put all channels on one time column; rows of one stamp in a channel keep rows of their own."""
    channels = [c for c in recording.channels if c.role or "q_w" in c.values]
    left_out = tuple(channel.name for channel in recording.channels if channel not in channels)
    orders = [np.argsort(channel.stamps_ns, kind="stable") for channel in channels]
    stamps = [channel.stamps_ns[order] for channel, order in zip(channels, orders, strict=True)]
    turns = [_turn(part) for part in stamps]
    every, turn = np.concatenate(stamps), np.concatenate(turns)
    order = np.lexsort((turn, every))
    new = np.append(True, (np.diff(every[order]) != 0) | (np.diff(turn[order]) != 0))
    rows = np.empty(every.size, dtype=np.int64)
    rows[order] = np.cumsum(new) - 1
    shared = every[order][new]
    columns: list[Named] = []
    start = 0
    for channel, inner, part in zip(channels, orders, stamps, strict=True):
        mine = rows[start : start + part.size]
        start += part.size
        for name, values in channel.values.items():
            whole = np.full(shared.size, np.nan)
            whole[mine] = values[inner]
            stated = channel.units.get(name, "")
            implied = _implied(name)
            columns.append((_free_name(name, channel, columns), whole, "" if stated in {implied, "1"} else stated))
    return shared, columns, left_out


def _turn(stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number the rows of each stamp from zero."""
    starts = np.flatnonzero(np.diff(stamps_ns, prepend=stamps_ns[:1] - 1))
    return np.arange(stamps_ns.size) - np.repeat(starts, np.diff(np.append(starts, stamps_ns.size)))


def _free_name(name: str, channel: Channel, taken: Sequence[Named]) -> str:
    """Name a column: canonical, unless a channel before has it or the orientation is a device's own."""
    name = name.replace("q_", "orientation_") if not channel.role else name
    if all(name != other for other, _, _ in taken):
        return name
    return f"{re.sub('[^a-z0-9]+', '_', channel.name.lower()).strip('_')}/{name}"


Row = Mapping[str, float]


def _write_mcap(recording: Recording, path: Path) -> tuple[str, ...]:
    """Send the messages of all channels in order of time; the first channel of a role has the canonical topic."""
    by_name = {channel.name: channel for channel in recording.channels}
    senders: list[tuple[str, str, Channel, Iterator[Message]]] = []
    left_out, topics = [], set[str]()
    for channel in recording.channels:
        if channel.role not in MESSAGES:
            if not channel.name.endswith("#orientation"):
                left_out.append(channel.name)
            continue
        topic, type_name, build = MESSAGES[channel.role]
        topic = topic if topic not in topics else f"/{re.sub('[^a-zA-Z0-9_/]+', '_', channel.name).strip('/')}"
        topics.add(topic)
        senders.append((topic, type_name, channel, map(build, _rows(channel, by_name))))
    stamps = np.concatenate([channel.stamps_ns for _, _, channel, _ in senders])
    sender = np.repeat(np.arange(len(senders)), [channel.stamps_ns.size for _, _, channel, _ in senders])
    order = np.argsort(stamps, kind="stable")
    with bag(path, int(stamps[order[0]])) as out:
        for rows in _blocks(order):
            for stamp, which in zip(stamps[rows].tolist(), sender[rows].tolist(), strict=True):
                topic, type_name, channel, messages = senders[which]
                out.send(topic, type_name, stamp, channel.frame_id, next(messages))
    return tuple(left_out)


def _blocks(order: NDArray[np.intp]) -> Iterator[NDArray[np.intp]]:
    """Yield rows in an order, some ten thousand at a time: as Python objects they take ten times the memory."""
    return (order[lo : lo + BLOCK_ROWS] for lo in range(0, len(order), BLOCK_ROWS))


def _implied(name: str) -> str:
    return CANONICAL_UNITS[name.partition("_")[0]]


def _rows(channel: Channel, by_name: Mapping[str, Channel]) -> Iterator[Row]:
    """Yield the values of a channel in order of time, in SI (degrees for angles on Earth), with its device's
    orientation.
    """
    values = {name: column * _factor(name, channel.units.get(name, "")) for name, column in channel.values.items()}
    beside = by_name.get(f"{channel.name}#orientation")
    if beside is not None and np.array_equal(beside.stamps_ns, channel.stamps_ns):
        values |= beside.values
    names = list(values)
    for rows in _blocks(np.argsort(channel.stamps_ns, kind="stable")):
        for row in zip(*(column[rows].tolist() for column in values.values()), strict=True):
            yield dict(zip(names, row, strict=True))


def _factor(name: str, stated: str) -> float:
    """Return the factor from the unit stated to that of the message."""
    implied = _implied(name)
    scale = 1e-6 if implied == "uT" else 1.0
    if stated in {"", implied}:
        return scale
    return unit(stated)[0] / unit(implied)[0] * scale


def _vector3(*names: str) -> Callable[[Row], Message]:
    return lambda row: {"vector": vector(*(row.get(name, math.nan) for name in names))}


def _imu(row: Row) -> Message:
    has_q = "q_w" in row
    q = quaternion(row["q_w"], row["q_x"], row["q_y"], row["q_z"]) if has_q else quaternion(1.0, 0.0, 0.0, 0.0)
    return {
        "orientation": q,
        "orientation_covariance": diagonal(3) if has_q else diagonal(3, -1.0),
        "angular_velocity": vector(row["gyro_x"], row["gyro_y"], row["gyro_z"]),
        "angular_velocity_covariance": diagonal(3),
        "linear_acceleration": vector(row["accel_x"], row["accel_y"], row["accel_z"]),
        "linear_acceleration_covariance": diagonal(3),
    }


def _magnetic(row: Row) -> Message:
    sigma = row.get("mag_sigma", math.nan)
    variances = (sigma * sigma,) * 3 if math.isfinite(sigma) else ()
    return {
        "magnetic_field": vector(row["mag_x"], row["mag_y"], row["mag_z"]),
        "magnetic_field_covariance": diagonal(3, *variances),
    }


def _compass(row: Row) -> Message:
    heading = math.radians(row["compass_deg"])  # body x points there; north lies that far to its left
    return {"vector": vector(math.cos(heading), math.sin(heading), 0.0)}


def _odometry(row: Row) -> Message:
    parts = (
        row.get("velocity_x", row.get("speed", math.nan)),
        row.get("velocity_y", math.nan),
        row.get("velocity_z", math.nan),
    )
    sigmas = (row.get(f"velocity_sigma_{axis}", math.nan) for axis in "xyz")
    known = [sigma * sigma if math.isfinite(sigma) else 0.0 for sigma in sigmas]
    variances = [v if math.isfinite(p) else IGNORED_VARIANCE for p, v in zip(parts, known, strict=True)]
    linear = vector(*(part if math.isfinite(part) else 0.0 for part in parts))
    return {
        "child_frame_id": "base_link",
        "pose": {"pose": {"orientation": quaternion(1.0, 0.0, 0.0, 0.0)}, "covariance": diagonal(6, -1.0)},
        "twist": {"twist": {"linear": linear}, "covariance": diagonal(6, *variances)},
    }


def _fix(row: Row) -> Message:
    level = row.get("gps_sigma_m", math.nan)
    up = row.get("gps_sigma_up_m", level)
    known = math.isfinite(level) and math.isfinite(up)
    return {
        "status": {"status": 0, "service": 1},
        "latitude": row["latitude"],
        "longitude": row["longitude"],
        "altitude": row.get("altitude", math.nan),
        "position_covariance": diagonal(3, *((level * level, level * level, up * up) if known else ())),
        "position_covariance_type": 2 if known else 0,
    }


def _over_ground(row: Row) -> Message:
    up = row.get("velocity_up", -row.get("velocity_down", math.nan))
    return {"vector": vector(row["velocity_east"], row["velocity_north"], up)}


MESSAGES: Mapping[str, tuple[str, str, Callable[[Row], Any]]] = {
    "imu": ("/imu/data", "sensor_msgs/Imu", _imu),
    "gyro": ("/imu/gyro", "geometry_msgs/Vector3Stamped", _vector3("gyro_x", "gyro_y", "gyro_z")),
    "accel": ("/imu/accel", "geometry_msgs/Vector3Stamped", _vector3("accel_x", "accel_y", "accel_z")),
    "sun": ("/sun", "geometry_msgs/Vector3Stamped", _vector3("sun_x", "sun_y", "sun_z")),
    "magnetometer": ("/imu/mag", "sensor_msgs/MagneticField", _magnetic),
    "compass": ("/compass", "geometry_msgs/Vector3Stamped", _compass),
    "orientation": (
        "/orientation",
        "geometry_msgs/QuaternionStamped",
        lambda row: {"quaternion": quaternion(row["q_w"], row["q_x"], row["q_y"], row["q_z"])},
    ),
    "odometry": ("/odom", "nav_msgs/Odometry", _odometry),
    "gps": ("/fix", "sensor_msgs/NavSatFix", _fix),
    "gps_velocity": ("/gps/velocity", "geometry_msgs/Vector3Stamped", _over_ground),
    "position": (
        "/position",
        "geometry_msgs/PointStamped",
        lambda row: {"point": vector(row["position_x"], row["position_y"], row.get("position_z", math.nan))},
    ),
    "temperature": ("/imu/temperature", "sensor_msgs/Temperature", lambda row: {"temperature": row["temperature_c"]}),
}
"""Role -> topic, type, and how a row becomes a message."""
