"""MCAP logs of ROS 2: channels of known message types are decoded, all others are only listed."""

from __future__ import annotations

import struct
from array import array
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from mcap.exceptions import McapError
from mcap.records import Channel as ChannelRecord
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from ..errors import AttestError
from ..records import Bools, Channel, Ints, Recording, Warn
from ..settings import Settings
from .mcap_records import DamagedError, Message, walk
from .messages import TYPES, MessageType

CLOCK_OFFSET_S = 0.05
"""Header stamps of two topics that differ by more against the time of logging are on different clocks."""

_UNDECODABLE = (
    McapError, struct.error, ValueError, TypeError, AttributeError, KeyError, IndexError, OverflowError, MemoryError,
    RecursionError, NotImplementedError,
)  # fmt: skip


@dataclass(slots=True)
class _Topic:
    """What has been read of one topic so far."""

    name: str
    kind: str
    type: MessageType
    decode: Any
    frame_id: str = ""
    stamps: array[int] = field(default_factory=lambda: array("q"))  # header, log, publish (ns) of each message
    rows: array[float] = field(default_factory=lambda: array("d"))  # columns of type, message after message

    @property
    def count(self) -> int:
        """Messages read so far."""
        return len(self.rows) // len(self.type.columns)

    def clocks(self) -> Ints:
        """Return header stamp, time of logging and time of publishing, (3, n) ns."""
        return np.array(self.stamps, dtype=np.int64).reshape(-1, 3).T

    def add(self, path: Path, message: Message) -> None:
        try:
            decoded = self.decode(bytes(message.data))
            stamp = decoded.header.stamp
            self.stamps.extend((stamp.sec * 1_000_000_000 + stamp.nanosec, message.log_ns, message.publish_ns))
            self.rows.extend(self.type.row(decoded))
            self.frame_id = self.frame_id or str(decoded.header.frame_id)
        except _UNDECODABLE as error:
            reason = (
                f"{path}: message {self.count + 1} of {self.name} is no {self.kind}: {type(error).__name__} {error}"
            )
            raise AttestError(reason, "the channel declares a type that its messages are not of") from None


def read(path: Path, settings: Settings) -> Recording:
    """Read the channels of known types of an MCAP file, if there is any; see ``readers.read``."""
    topics, other = _decode(path)
    read_topics = [topic for topic in topics if topic.rows]
    other |= {topic.name: f"{topic.kind} (no message)" for topic in topics if not topic.rows}
    warnings: list[Warn] = []
    channels: list[Channel] = []
    for topic in read_topics:
        stamps_ns = _stamps(path, topic, settings.time.source, warnings)
        table = np.array(topic.rows, dtype=np.float64).reshape(topic.count, -1).T.copy()
        values = dict(zip(topic.type.columns, table, strict=True))
        units = dict(zip(topic.type.columns, topic.type.units, strict=True))
        found = topic.type.channels(topic.name, topic.kind, stamps_ns, values, units)
        channels += [replace(channel, frame_id=topic.frame_id) for channel in found]
    if settings.time.source == "header":
        _compare_clocks(path, read_topics, warnings)
    return Recording(path, "mcap", tuple(channels), sum(topic.count for topic in read_topics), other, tuple(warnings))


def _decode(path: Path) -> tuple[list[_Topic], dict[str, str]]:
    """Decode all messages of known types. The decoder caches by schema id alone, so every file gets its own."""
    factory = DecoderFactory()
    schemas: dict[int, Schema] = {}
    topics: dict[int, _Topic | None] = {}
    other: dict[str, str] = {}
    try:
        with path.open("rb") as stream:
            for record in walk(stream, path.stat().st_size):
                if isinstance(record, Message):
                    if record.channel_id not in topics:
                        raise AttestError(
                            f"{path}: a message on channel {record.channel_id}, which is not declared", RECOVER
                        )
                    topic = topics[record.channel_id]
                    if topic is not None:
                        topic.add(path, record)
                elif isinstance(record, Schema):
                    schemas[record.id] = record
                elif record.id not in topics:
                    topics[record.id] = _open(path, factory, record, schemas.get(record.schema_id), other)
    except DamagedError as error:
        raise AttestError(f"{path}: damaged MCAP: {error}", RECOVER) from None
    except OSError as error:
        raise AttestError(f"{path}: cannot be read: {error.strerror}") from None
    return [topic for topic in topics.values() if topic is not None], other


RECOVER = "mcap recover saves what is whole"


def _open(
    path: Path, factory: DecoderFactory, channel: ChannelRecord, schema: Schema | None, other: dict[str, str]
) -> _Topic | None:
    """Prepare to decode a channel, or list it among the others."""
    known = TYPES.get(schema.name) if schema is not None else None
    if schema is None or known is None or channel.message_encoding != "cdr" or schema.encoding != "ros2msg":
        name = schema.name if schema is not None else "no schema"
        encoding = (
            channel.message_encoding
            if channel.message_encoding != "cdr" or known is None
            else schema.encoding
            if schema
            else ""
        )
        other[channel.topic] = f"{name} ({encoding})"
        return None
    try:
        decode = factory.decoder_for(channel.message_encoding, schema)
    except _UNDECODABLE as error:
        raise AttestError(f"{path}: the definition of {schema.name} on {channel.topic} is damaged: {error}") from None
    return _Topic(channel.topic, schema.name, known, decode)


def _stamps(path: Path, topic: _Topic, source: str, warnings: list[Warn]) -> Ints:
    """Choose the stamps of a topic; zero header stamps are replaced by the time of logging, with a warning."""
    header, log, publish = topic.clocks()
    chosen: Ints = {"header": header, "log": log, "publish": publish}[source]
    zero = header == 0
    if source != "header" or not np.any(zero):
        return chosen
    if 2 * np.count_nonzero(zero) >= zero.size:
        message = f"{path.name}: {_zeros(zero, topic)}: time of logging taken"
        warnings.append(Warn("zero-header-stamps", message, "let the driver fill header.stamp"))
        return np.asarray(log, dtype=np.int64)
    offset = np.int64(np.median((header - log)[~zero]))
    lost = zero & (np.abs(log + offset) > np.int64(1_000_000_000))  # a simulated clock starts at zero
    if np.any(lost):
        message = f"{path.name}: {_zeros(lost, topic)}: filled from the time of logging"
        warnings.append(Warn("zero-header-stamps", message, "let the driver fill header.stamp"))
    return np.asarray(np.where(lost, log + offset, header), dtype=np.int64)


def _zeros(zero: Bools, topic: _Topic) -> str:
    return f"{np.count_nonzero(zero)} of {zero.size} header stamps of {topic.name} are zero"


def _compare_clocks(path: Path, topics: list[_Topic], warnings: list[Warn]) -> None:
    """Warn where the header stamps of a topic run beside those of the first IMU, against the time of logging."""
    offsets = {}
    for topic in topics:
        header, log, _ = topic.clocks()
        if np.any(header):
            offsets[topic.name] = float(np.median((header - log)[header != 0])) * 1e-9
    base = next((topic.name for topic in topics if topic.kind.endswith("/Imu") and topic.name in offsets), None)
    for name, offset in offsets.items():
        if base is not None and abs(offset - offsets[base]) > CLOCK_OFFSET_S:
            message = f"{path.name}: the stamps of {name} stand {offset - offsets[base]:+.3f} s against those of {base}"
            warnings.append(Warn("clock-offset", message, "--time log puts all on the recorder's clock"))
