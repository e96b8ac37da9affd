"""MCAP logs of ROS 2: channels of known message types are decoded, all others are only listed."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass, field, replace
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from mcap.exceptions import McapError
from mcap.records import Channel as ChannelRecord
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from ..errors import AttestError
from ..records import Array, Bools, Channel, Ints, Recording, Warn
from ..settings import Settings
from .mcap_records import Batch, DamagedError, batches
from .messages import TYPES, MessageType
from .ros2_layout import Field, Layout, fields_of, layout_of

CLOCK_OFFSET_S = 0.05
"""Header stamps of two topics that differ by more against the time of logging are on different clocks."""

_UNDECODABLE = (
    McapError, struct.error, ValueError, TypeError, AttributeError, KeyError, IndexError, OverflowError, MemoryError,
    RecursionError, NotImplementedError,
)  # fmt: skip


STAMP = ("header.stamp.sec", "header.stamp.nanosec")


@dataclass(slots=True)
class _Topic:
    """What has been read of one topic so far: many messages at once where their layout is sure, else one by one."""

    name: str
    kind: str
    type: MessageType
    decode: Any
    fields: tuple[Field, ...] | None
    layout: Layout | None = None
    frame_id: str = ""
    stamps: list[Ints] = field(default_factory=list)  # per batch: header, log, publish (3, m) ns
    tables: list[Array] = field(default_factory=list)  # per batch: columns of type (c, m)
    count: int = 0

    def clocks(self) -> Ints:
        """Return header stamp, time of logging and time of publishing, (3, n) ns."""
        return np.concatenate(self.stamps, axis=1)

    def columns(self) -> dict[str, Array]:
        """Return the columns of the type (n,), each on its own."""
        return {name: np.concatenate([t[i] for t in self.tables]) for i, name in enumerate(self.type.columns)}

    def add(self, path: Path, batch: Batch, rows: Ints) -> None:
        """Read the messages ``rows`` of a batch."""
        found = self._at_once(path, batch, rows)
        if found is None:
            found = np.array([self._decoded(path, batch, k) for k in rows.tolist()]).T
        header = found[0].astype(np.int64) * 1_000_000_000 + found[1].astype(np.int64)
        self.stamps.append(np.stack([header, batch.log_ns[rows], batch.publish_ns[rows]]))
        self.tables.append(self.type.table(found[2:]))
        self.count += rows.size

    def _at_once(self, path: Path, batch: Batch, rows: Ints) -> Array | None:
        """Return stamp and fields (2 + k, m), or None where a message is laid out in another way."""
        messages = batch.data, batch.start[rows], batch.size[rows]
        found = None if self.layout is None else self.layout.table(*messages)
        if found is not None or self.fields is None:
            return found
        first = np.frombuffer(batch.payload(int(rows[0])), dtype=np.uint8)
        self.layout = layout_of(self.fields, (*STAMP, *self.type.fields), first)
        found = None if self.layout is None else self.layout.table(*messages)
        if found is None:
            return None
        if not np.array_equal(found[:, 0], self._decoded(path, batch, int(rows[0])), equal_nan=True):
            self.fields = self.layout = None  # the library reads this definition in another way
            return None
        return found

    def _decoded(self, path: Path, batch: Batch, k: int) -> list[float]:
        """Return stamp and fields of one message as the library decodes it."""
        try:
            decoded = self.decode(batch.payload(k))
            self.frame_id = self.frame_id or str(decoded.header.frame_id)
            return [float(_at(decoded, name)) for name in (*STAMP, *self.type.fields)]
        except _UNDECODABLE as error:
            place = self.count + 1 + int(np.count_nonzero(batch.channel_id[:k] == batch.channel_id[k]))
            reason = f"{path}: message {place} of {self.name} is no {self.kind}: {type(error).__name__} {error}"
            raise AttestError(reason, "the channel declares a type that its messages are not of") from None


def _at(message: Any, name: str) -> Any:
    """Return a field by its path, such as ``twist.covariance[7]``."""
    value = reduce(getattr, name.partition("[")[0].split("."), message)
    place = re.search(r"\[(\d+)\]$", name)
    return value if place is None else value[int(place[1])]


def read(path: Path, settings: Settings) -> Recording:
    """Read the channels of known types of an MCAP file, if there is any; see ``readers.read``."""
    topics, other = _decode(path)
    read_topics = [topic for topic in topics if topic.count]
    other |= {topic.name: f"{topic.kind} (no message)" for topic in topics if not topic.count}
    warnings: list[Warn] = []
    channels: list[Channel] = []
    for topic in read_topics:
        stamps_ns = _stamps(path, topic, settings.time.source, warnings)
        units = dict(zip(topic.type.columns, topic.type.units, strict=True))
        found = topic.type.channels(topic.name, topic.kind, stamps_ns, topic.columns(), units)
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
            for record in batches(stream, path.stat().st_size):
                if isinstance(record, Batch):
                    for channel_id in np.flatnonzero(np.bincount(record.channel_id)).tolist():
                        if channel_id not in topics:
                            message = f"{path}: a message on channel {channel_id}, which is not declared"
                            raise AttestError(message, RECOVER)
                        topic = topics[channel_id]
                        if topic is not None:
                            topic.add(path, record, np.flatnonzero(record.channel_id == channel_id))
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
    fields = fields_of(schema.name, schema.data.decode("utf-8", "replace"))
    return _Topic(channel.topic, schema.name, known, decode, fields)


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
