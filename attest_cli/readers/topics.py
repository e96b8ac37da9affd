"""Topics of messages, whatever file they stand in: batches of messages -> channels with the stamps asked for."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from mcap.exceptions import McapError

from ..errors import AttestError
from ..records import COLUMNS, LATEST_NS, Array, Bools, Channel, Ints, Recording, Warn
from .mcap_records import Batch
from .messages import MessageType
from .ros2_layout import Bytes, Layout

CLOCK_OFFSET_S = 0.05
"""Header stamps of two topics that differ by more against the time of logging are on different clocks."""
SOME = 100_000  # messages, all along the log, that show how two clocks stand
LATEST_S = LATEST_NS // 10**9

UNDECODABLE = (
    McapError, struct.error, ValueError, TypeError, AttributeError, KeyError, IndexError, OverflowError, MemoryError,
    RecursionError, NotImplementedError,
)  # fmt: skip
NOT_OF_TYPE = "the channel declares a type that its messages are not of"


def line(error: Exception) -> str:
    """Return what a library says as a part of one line."""
    return " ".join(str(error).split())[:120]


One = Callable[[bytes], tuple[list[float], str]]
"""Decodes one message: stamp (s, ns) and fields of its type, and its frame."""


@dataclass(slots=True, eq=False)
class Topic:
    """What has been read of one topic so far: many messages at once where their layout is sure, else one by one.

    ``lay`` finds the layout of a message, or is None where the wire has none; with ``verified`` a new layout is held
    against what ``one`` makes of the same message.
    """

    name: str
    kind: str
    type: MessageType
    one: One
    lay: Callable[[Bytes], Layout | None] | None = None
    layout: Layout | None = None
    frame_id: str = ""
    stamps: Ints = field(default_factory=lambda: np.empty((3, 0), dtype=np.int64))  # header, log, publish; and room
    imu: Array = field(default_factory=lambda: np.empty((0, 0)))  # those columns of the type, and room
    others: Array = field(default_factory=lambda: np.empty((0, 0)))
    count: int = 0
    expected: int = 0  # messages that the file states: room is made for them at once

    def clocks(self) -> Ints:
        """Return header stamp, time of logging and time of publishing, (3, n) ns."""
        return self.stamps[:, : self.count]

    def columns(self) -> dict[str, Array]:
        """Return the columns of the type (n,); those of an IMU lie side by side, as they are used."""
        values = (*self.imu[:, : self.count], *self.others[:, : self.count])
        return dict(zip(self.type.columns, values, strict=True))

    def add(self, path: Path, batch: Batch, rows: Ints) -> None:
        """Read the messages ``rows`` of a batch.

        Raises
        ------
        AttestError
            If a message is not of the type that its topic declares.
        """
        found = self._at_once(path, batch, rows)
        if found is None:
            found = np.array([self._decoded(path, batch, k) for k in rows.tolist()]).T
        if not -LATEST_S <= found[:2].min() <= found[:2].max() <= LATEST_S:
            raise AttestError(f"{path}: a stamp of {self.name} is no time", NOT_OF_TYPE)
        header, end = found[0].astype(np.int64) * 1_000_000_000 + found[1].astype(np.int64), self.count + rows.size
        if end > self.stamps.shape[1]:
            self._make_room(max(end, self.expected, 2 * self.stamps.shape[1]))
        new = header, batch.log_ns[rows], batch.publish_ns[rows], *self.type.table(found[2:])
        for row, values in zip((*self.stamps, *self.imu, *self.others), new, strict=True):
            row[self.count : end] = values
        self.count = end

    def _make_room(self, rows: int) -> None:
        """Make room for so many messages; pages that are not written to are not there."""
        of_imu = sum(name in COLUMNS["imu"] for name in self.type.columns)  # they come first
        stamps, imu, others = self.stamps[:, : self.count], self.imu[:, : self.count], self.others[:, : self.count]
        self.stamps = np.empty((3, rows), dtype=np.int64)
        self.imu = np.empty((of_imu, rows), order="F")  # side by side, as they are used
        self.others = np.empty((len(self.type.columns) - of_imu, rows))
        if self.count:
            self.stamps[:, : self.count], self.imu[:, : self.count], self.others[:, : self.count] = stamps, imu, others

    def _at_once(self, path: Path, batch: Batch, rows: Ints) -> Array | None:
        """Return stamp and fields (2 + k, m), or None where a message is laid out in another way."""
        messages = batch.data, batch.start[rows], batch.size[rows]
        found = None if self.layout is None else self.layout.table(*messages)
        if found is not None or self.lay is None:
            return found
        self.layout = self.lay(np.frombuffer(batch.payload(int(rows[0])), dtype=np.uint8))
        found = None if self.layout is None else self.layout.table(*messages)
        if found is None:
            return None
        if not np.array_equal(found[:, 0], self._decoded(path, batch, int(rows[0])), equal_nan=True):
            self.lay = self.layout = None  # the library reads this definition in another way
            return None
        return found

    def _decoded(self, path: Path, batch: Batch, k: int) -> list[float]:
        """Return stamp and fields of one message, decoded on its own."""
        try:
            row, frame_id = self.one(batch.payload(k))
        except UNDECODABLE as error:
            place = self.count + 1 + int(np.count_nonzero(batch.channel_id[:k] == batch.channel_id[k]))
            reason = f"{path}: message {place} of {self.name} is no {self.kind}: {type(error).__name__} {line(error)}"
            raise AttestError(reason, NOT_OF_TYPE) from None
        self.frame_id = self.frame_id or frame_id
        return row


def recording(
    path: Path,
    format_name: str,
    topics: Sequence[Topic],
    other: Mapping[str, str],
    source: str,
    told: Sequence[Warn] = (),
) -> Recording:
    """Make channels of topics.

    Parameters
    ----------
    other : topic -> type
        What was not read.
    source : str
        Which stamp counts: header, log or publish.
    told : sequence of Warn
        What is known already.
    """
    read = [topic for topic in topics if topic.count]
    other = {**other, **{topic.name: f"{topic.kind} (no message)" for topic in topics if not topic.count}}
    warnings = list(told)
    channels: list[Channel] = []
    for topic in read:
        stamps_ns = _stamps(path, topic, source, warnings)
        units = dict(zip(topic.type.columns, topic.type.units, strict=True))
        found = topic.type.channels(topic.name, topic.kind, stamps_ns, topic.columns(), units)
        channels += [replace(channel, frame_id=topic.frame_id) for channel in found]
    if source == "header":
        _compare_clocks(path, read, warnings)
    return Recording(path, format_name, tuple(channels), sum(t.count for t in read), other, tuple(warnings))


def _stamps(path: Path, topic: Topic, source: str, warnings: list[Warn]) -> Ints:
    """Choose the stamps of a topic; zero header stamps are replaced by the time of logging, with a warning."""
    header, log, publish = topic.clocks()
    chosen: Ints = {"header": header, "log": log, "publish": publish}[source].copy()
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


def _zeros(zero: Bools, topic: Topic) -> str:
    return f"{np.count_nonzero(zero)} of {zero.size} header stamps of {topic.name} are zero"


def _compare_clocks(path: Path, topics: Sequence[Topic], warnings: list[Warn]) -> None:
    """Warn where the header stamps of a topic run beside those of the first IMU, against the time of logging."""
    offsets = {}
    for topic in topics:
        header, log, _ = topic.clocks()[:, :: max(1, topic.count // SOME)]
        if np.any(header):
            offsets[topic.name] = float(np.median((header - log)[header != 0])) * 1e-9
    base = next((topic.name for topic in topics if topic.kind.endswith("/Imu") and topic.name in offsets), None)
    for name, offset in offsets.items():
        if base is not None and abs(offset - offsets[base]) > CLOCK_OFFSET_S:
            message = f"{path.name}: the stamps of {name} stand {offset - offsets[base]:+.3f} s against those of {base}"
            warnings.append(Warn("clock-offset", message, "--time log puts all on the recorder's clock"))
