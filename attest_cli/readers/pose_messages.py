"""Tracks of poses from MCAP of ROS 2: one channel of odometry, poses, transforms or orientations."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.exceptions import McapError
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from ..errors import AttestError
from ..evaluate.records import Poses
from .mcap_chunks import DamagedError
from .mcap_records import Message, walk

NAN = math.nan
Row = tuple[float, ...]
NO_ATTITUDE, NO_POSITION = (NAN,) * 4, (NAN,) * 3


def _quaternion(q: Any) -> Row:
    return (q.w, q.x, q.y, q.z)


def _point(p: Any) -> Row:
    return (p.x, p.y, p.z)


def _pose(pose: Any) -> Row:
    return (*_quaternion(pose.orientation), *_point(pose.position))


def _pose_with_covariance(pose: Any) -> Row:
    """A first variance of -1 says that there is no position (REP-145's word, as attest writes it)."""
    has_position = pose.covariance[0] != -1
    return (*_quaternion(pose.pose.orientation), *(_point(pose.pose.position) if has_position else NO_POSITION))


def _imu(message: Any) -> Row:
    has = message.orientation_covariance[0] != -1
    return (*(_quaternion(message.orientation) if has else NO_ATTITUDE), *NO_POSITION)


ROWS: Mapping[str, Callable[[Any], Row]] = {
    "nav_msgs/msg/Odometry": lambda m: _pose_with_covariance(m.pose),
    "geometry_msgs/msg/PoseStamped": lambda m: _pose(m.pose),
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda m: _pose_with_covariance(m.pose),
    "geometry_msgs/msg/TransformStamped": lambda m: (
        *_quaternion(m.transform.rotation),
        *_point(m.transform.translation),
    ),
    "geometry_msgs/msg/QuaternionStamped": lambda m: (*_quaternion(m.quaternion), *NO_POSITION),
    "geometry_msgs/msg/PointStamped": lambda m: (*NO_ATTITUDE, *_point(m.point)),
    "sensor_msgs/msg/Imu": _imu,
}
"""Type -> q_w q_x q_y q_z, position of a message. All have a header."""

HINT = "name one with --channel"
_UNDECODABLE = (McapError, struct.error, ValueError, TypeError, AttributeError, KeyError, IndexError, OverflowError)


@dataclass(slots=True)
class _Channel:
    """What was read of one channel."""

    name: str
    kind: str
    decode: Any
    stamps: list[int] = field(default_factory=list)
    rows: list[Row] = field(default_factory=list)
    frame_id: str = ""

    def add(self, path: Path, message: Message) -> None:
        try:
            decoded = self.decode(bytes(message.data))
            stamp = decoded.header.stamp.sec * 1_000_000_000 + decoded.header.stamp.nanosec
            self.stamps.append(stamp or message.log_ns)
            self.rows.append(ROWS[self.kind](decoded))
            self.frame_id = self.frame_id or str(decoded.header.frame_id)
        except _UNDECODABLE as error:
            reason = f"{path}: a message of {self.name} is no {self.kind}: {type(error).__name__} {error}"
            raise AttestError(reason, "the channel declares a type that its messages are not of") from None


def read(path: Path, name: str | None) -> tuple[Poses, bool]:
    """Return the track of one channel, and whether its frame is north-east-down.

    Raises
    ------
    AttestError
        If the file is damaged, has no such channel, or several could be meant.
    """
    channel = _chosen(path, _read(path), name)
    stamps = np.array(channel.stamps, dtype=np.int64)
    rows = np.array(channel.rows, dtype=np.float64).reshape(-1, 7)
    order = np.argsort(stamps, kind="stable")
    keep = order[np.concatenate([[True], np.diff(stamps[order]) > 0])]
    own = channel.name.startswith("/attest/")
    poses = Poses(
        path.name, "mcap", stamps[keep], rows[keep, :4], rows[keep, 4:], shared_world=own, channel=channel.name
    )
    return poses, channel.frame_id.lower().endswith("ned")


def _read(path: Path) -> list[_Channel]:
    """Decode every channel that can hold poses. The decoder caches by schema id alone: one for each file."""
    factory, schemas, channels = DecoderFactory(), dict[int, Schema](), dict[int, _Channel | None]()
    try:
        with path.open("rb") as stream:
            for record in walk(stream, path.stat().st_size):
                if isinstance(record, Message):
                    channel = channels.get(record.channel_id)
                    if channel is not None:
                        channel.add(path, record)
                elif isinstance(record, Schema):
                    schemas[record.id] = record
                elif record.id not in channels:
                    schema = schemas.get(record.schema_id)
                    known = schema is not None and schema.name in ROWS and record.message_encoding == "cdr"
                    decode = factory.decoder_for("cdr", schema) if known else None
                    channels[record.id] = _Channel(record.topic, schema.name, decode) if known and schema else None
    except (DamagedError, *_UNDECODABLE) as error:
        raise AttestError(f"{path}: damaged MCAP: {error}", "mcap recover saves what is whole") from None
    return [channel for channel in channels.values() if channel is not None and channel.rows]


def _chosen(path: Path, channels: list[_Channel], name: str | None) -> _Channel:
    """Return the channel named, or the only one of the best type: poses before orientations before positions."""
    told = ", ".join(f"{channel.name} ({channel.kind})" for channel in channels)
    if name is not None:
        found = [channel for channel in channels if channel.name == name]
        if not found:
            raise AttestError(f"{path}: no poses on a channel {name!r}; there are: {told or 'none'}", HINT)
        return found[0]
    useful = [channel for channel in channels if _tells(channel)]
    if not useful:
        raise AttestError(
            f"{path}: no channel of odometry, poses or orientations", "name a file that holds the reference"
        )
    best = min(map(_rank, useful))
    found = [channel for channel in useful if _rank(channel) == best]
    if len(found) > 1:
        raise AttestError(f"{path}: more than one channel could be the reference: {told}", HINT)
    return found[0]


def _tells(channel: _Channel) -> bool:
    """Tell whether a channel holds more than "no orientation" and "no position"."""
    rows = np.array(channel.rows)
    nothing = ~np.isfinite(rows) | (rows == [1.0, *(0.0,) * 6])
    return not bool(nothing.all() or (rows[:, :4] == 0.0).all())


def _rank(channel: _Channel) -> int:
    """Poses first, whatever their type; then the others in their order."""
    return max(list(ROWS).index(channel.kind) - 3, 0)
