"""MCAP logs: channels of known message types are decoded, all others are only listed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np
from mcap.records import Schema

from ..errors import AttestError
from ..records import Recording
from ..settings import Settings
from . import topics as of_topics
from .mcap_records import Batch, DamagedError, batches
from .topics import Topic
from .wires import Wires

RECOVER = "mcap recover saves what is whole"


def read(path: Path, settings: Settings) -> Recording:
    """Read the channels of known types of an MCAP file, if there is any; see ``readers.read``."""
    try:
        with path.open("rb") as stream:
            topics, other = decode(path, stream, path.stat().st_size)
    except DamagedError as error:
        raise AttestError(f"{path}: damaged MCAP: {error}", RECOVER) from None
    except OSError as error:
        raise AttestError(f"{path}: cannot be read: {error.strerror}") from None
    return recording_of(path, settings, list(topics.values()), other)


def recording_of(path: Path, settings: Settings, topics: Sequence[Topic], other: dict[str, str]) -> Recording:
    """Return what has been decoded as channels, with the stamps that settings ask for."""
    return of_topics.recording(path, "mcap", topics, other, settings.time.source)


def decode(path: Path, stream: BinaryIO, size: int) -> tuple[dict[int, Topic], dict[str, str]]:
    """Decode all messages of known types, by channel. The decoder caches by schema id: every file gets its own."""
    wires = Wires(path)
    schemas: dict[int, Schema] = {}
    topics: dict[int, Topic | None] = {}
    other: dict[str, str] = {}
    for record in batches(stream, size):
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
            opened = wires.topic(record.topic, record.message_encoding, schemas.get(record.schema_id))
            topics[record.id] = None if isinstance(opened, str) else opened
            if isinstance(opened, str):
                other[record.topic] = opened
    return {channel_id: topic for channel_id, topic in topics.items() if topic is not None}, other
