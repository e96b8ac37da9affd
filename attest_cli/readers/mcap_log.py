"""MCAP logs: channels of known message types are decoded, all others are only listed; what is damaged is told."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np
from mcap.records import Channel, Schema

from ..errors import AttestError
from ..records import Recording, Warn
from ..settings import Settings
from . import topics as of_topics
from .mcap_chunks import DamagedError
from .mcap_records import MAGIC, Batch, batches
from .mcap_summary import DATA_END, Summary, stated
from .tables import check_size
from .topics import Topic
from .wires import Wires

RECOVER = "mcap recover saves what is whole"
AGAIN = "copy or record it again: what is missing cannot be mended"
SHOWN = 3  # damaged places that are named
LEAST_BYTES = 16  # of a message in a file, compressed: no room is made for more of them than a file can hold


def read(path: Path, settings: Settings) -> Recording:
    """Read the channels of known types of an MCAP file, and what is whole of a damaged one; see ``readers.read``."""
    damage: list[DamagedError] = []
    try:
        with path.open("rb") as stream:
            size = path.stat().st_size
            found = Decoder(path, damage, stated(stream, size))
            stream.seek(0)
            found.read(stream, size)
            stream.seek(max(size - len(MAGIC), 0))
            ended = stream.read() == MAGIC
    except DamagedError as error:
        raise AttestError(f"{path}: damaged MCAP: {error}", RECOVER) from None
    except OSError as error:
        raise AttestError(f"{path}: cannot be read: {error.strerror}") from None
    if damage and not found.span_ns:
        raise AttestError(f"{path}: damaged MCAP: {damage[0]}", RECOVER)
    told = _told(path, found, damage, ended=ended)
    return recording_of(path, settings, list(found.known.values()), found.other, told)


def recording_of(
    path: Path, settings: Settings, topics: Sequence[Topic], other: Mapping[str, str], told: Sequence[Warn] = ()
) -> Recording:
    """Return what has been decoded as channels, with the stamps that settings ask for."""
    return of_topics.recording(path, "mcap", topics, other, settings.time.source, told)


def decode(path: Path, stream: BinaryIO, size: int) -> tuple[dict[int, Topic], dict[str, str]]:
    """Decode all messages of known types, by channel; ``DamagedError`` where anything is damaged."""
    found = Decoder(path)
    found.read(stream, size)
    return found.known, found.other


class Decoder:
    """The messages of one file, by channel. The libraries cache by schema id: every file gets its own.

    With ``damage``, a list, reading goes on behind what is damaged; ``summary`` then knows the channels whose
    declaration is lost, and how many messages there were.
    """

    def __init__(self, path: Path, damage: list[DamagedError] | None = None, summary: Summary | None = None) -> None:
        self.path, self.damage, self.summary = path, damage, summary
        self.other: dict[str, str] = {}
        self.lost: Counter[int] = Counter()  # messages on channels that nobody declares
        self.span_ns: tuple[int, int] | None = None  # times of logging of what was read
        self._wires = Wires(path)
        self._schemas: dict[int, Schema] = {}
        self._topics: dict[int, Topic | None] = {}
        self._most = 0  # messages that room may still be made for

    @property
    def known(self) -> dict[int, Topic]:
        """The channels that are decoded."""
        return {channel_id: topic for channel_id, topic in self._topics.items() if topic is not None}

    def read(self, stream: BinaryIO, size: int) -> None:
        """Decode what the file holds."""
        self._most = size // LEAST_BYTES
        for record in batches(stream, size, self.damage):
            if isinstance(record, Batch):
                self._add(record)
            else:
                self._declare(record)

    def _declare(self, record: Schema | Channel) -> None:
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif record.id not in self._topics:
            schema = self._schemas.get(record.schema_id)
            opened = self._wires.topic(record.topic, record.message_encoding, schema)
            self._topics[record.id] = None if isinstance(opened, str) else opened
            if isinstance(opened, str):
                self.other[record.topic] = opened
            elif self.summary is not None:
                opened.expected = min(self.summary.counts.get(record.id, 0), self._most)
                self._most -= opened.expected

    def _add(self, batch: Batch) -> None:
        """Hand the messages of a batch to their channels."""
        first, last = int(batch.log_ns.min()), int(batch.log_ns.max())
        before = self.span_ns or (first, last)
        self.span_ns = min(first, before[0]), max(last, before[1])
        for channel_id in np.flatnonzero(np.bincount(batch.channel_id)).tolist():
            rows = np.flatnonzero(batch.channel_id == channel_id)
            if channel_id not in self._topics and not self._declared_at_the_end(channel_id):
                self.lost[channel_id] += rows.size
                continue
            topic = self._topics[channel_id]
            if topic is not None:
                topic.add(self.path, batch, rows)
                check_size(self.path, topic.count, len(topic.type.columns))

    def _declared_at_the_end(self, channel_id: int) -> bool:
        """Look in the summary for a channel whose declaration is lost; refuse it where nothing is lost."""
        if not self.damage:
            message = f"{self.path}: a message on channel {channel_id}, which is not declared"
            raise AttestError(message, RECOVER)
        self.declare_all()
        return channel_id in self._topics

    def declare_all(self) -> None:
        """Take what the summary declares."""
        if self.summary is not None:
            again = MAGIC + self.summary.declared + DATA_END
            for record in batches(io.BytesIO(again), len(again)):
                if not isinstance(record, Batch):
                    self._declare(record)


def _told(path: Path, found: Decoder, damage: Sequence[DamagedError], *, ended: bool) -> list[Warn]:
    """Say what is damaged, what is lost by it, and when what is left was logged."""
    counts = {} if found.summary is None else found.summary.counts
    if counts:
        found.declare_all()
    gone = [f"{n} messages of channel {channel_id}, which is not declared" for channel_id, n in found.lost.items()]
    for channel_id, topic in found.known.items():
        stated_count = counts.get(channel_id, topic.count)
        if topic.count < stated_count:
            gone.append(f"{stated_count - topic.count} of {stated_count} messages of {topic.name}")
    if not damage and not gone:
        message = f"{path.name}: the file is cut behind its messages: all of them are there, its summary is not"
        return [] if ended else [Warn("cut-mcap", message, RECOVER)]
    start_ns, end_ns = found.span_ns or (0, 0)
    places = ", ".join(_place(d, start_ns) for d in damage[:SHOWN]) or "its summary counts more messages"
    more = f" and {len(damage) - SHOWN} more" if len(damage) > SHOWN else ""
    unknown = "no message is lost" if counts else "how much is lost is not known"
    what = f"lost: {', '.join(gone)}" if gone else unknown
    left = f"what is read was logged from 0 to {(end_ns - start_ns) * 1e-9:.2f} s"
    message = f"{path.name}: damaged MCAP: {places}{more}; {what}; {left}"
    return [Warn("damaged-mcap", message, AGAIN, lost=bool(gone) or not counts)]


def _place(damage: DamagedError, start_ns: int) -> str:
    """Name a damaged place, and the times that a lost chunk states."""
    if damage.span_ns is None:
        return str(damage)
    first, last = ((ns - start_ns) * 1e-9 for ns in damage.span_ns)
    return f"{damage} ({first:.2f} to {last:.2f} s)"
