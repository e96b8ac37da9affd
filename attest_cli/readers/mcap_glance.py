"""A long MCAP file at a glance: what it holds by its summary, its message index and a few of its chunks."""

from __future__ import annotations

import io
import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..errors import AttestError
from ..records import Channel, Recording
from ..settings import Settings
from .mcap_chunks import DamagedError
from .mcap_log import decode, recording_of
from .mcap_summary import Logged, Summary, UnsureError, excerpt, logged, summary_of

AT_MOST = 0.25
"""Share of the chunks from which on a glance saves little: the file is read as a whole."""

HEAD_NS, HEAD_CHUNKS = 5_000_000_000, 8
"""The head is as many chunks as cover this time, or this many."""

BESIDE = "#orientation"


@dataclass(frozen=True, slots=True)
class Glance:
    """``recording``: all channels, stamped by the time of logging, values blank. ``head``: the first seconds as read
    in full; ``ends``: with the first and the last messages of each channel besides.
    """

    recording: Recording
    head: Recording
    ends: Recording


def glance(path: Path, settings: Settings) -> Glance | None:
    """Return what the index tells of a file; None where it tells too little, or what is read asks for a closer look.

    Parameters
    ----------
    path : Path
        MCAP file.
    settings : Settings
        ``time.source``: which stamp of a message counts.

    Raises
    ------
    AttestError
        If the file cannot be read at all.
    """
    try:
        with path.open("rb") as stream:
            return _glance(path, settings, stream)
    except OSError as error:
        raise AttestError(f"{path}: cannot be read: {error.strerror}") from None
    except (UnsureError, DamagedError, AttestError, struct.error):
        return None  # reading the whole file tells what is wrong with it, if anything is


def _glance(path: Path, settings: Settings, stream: BinaryIO) -> Glance | None:
    size = path.stat().st_size
    summary = summary_of(stream, size)
    most, end_ns = AT_MOST * len(summary.chunks), summary.chunks[0].message_start_time + HEAD_NS
    first = {k for k, chunk in enumerate(summary.chunks[:HEAD_CHUNKS]) if chunk.message_start_time <= end_ns}
    if len(first) > most:
        return None
    by_id = logged(stream, summary)
    topics, head = _excerpt(path, settings, stream, summary, first)
    every = {topics[channel_id]: found for channel_id, found in by_id.items() if channel_id in topics}
    places = first | {place for found in every.values() for place in (found.first, found.last)}
    if len(places) > most or len(set(topics.values())) < len(topics):
        return None
    _, ends = _excerpt(path, settings, stream, summary, places)
    if head.warnings or ends.warnings or not {_topic(channel, every) for channel in ends.channels} <= every.keys():
        return None
    channels = tuple(_blank(channel, every[_topic(channel, every)]) for channel in ends.channels)
    rows = sum(found.log_ns.size for found in every.values())
    note = f"{len(places)} of {len(summary.chunks)} chunks read, gaps by the time of logging; -v reads all"
    return Glance(replace(ends, channels=channels, rows=rows, notes=(note,)), head, ends)


def _excerpt(
    path: Path, settings: Settings, stream: BinaryIO, summary: Summary, places: set[int]
) -> tuple[dict[int, str], Recording]:
    """Read the chunks at ``places``; also return the topic of each channel that is of a known type."""
    data = excerpt(stream, summary, places)
    topics, other = decode(path, io.BytesIO(data), len(data))
    names = {channel_id: topic.name for channel_id, topic in topics.items()}
    return names, recording_of(path, settings, list(topics.values()), other)


def _topic(channel: Channel, every: Mapping[str, Logged]) -> str:
    """Return the topic that a channel comes from; an orientation may be a channel beside its IMU."""
    return channel.name if channel.name in every else channel.name.removesuffix(BESIDE)


def _blank(channel: Channel, found: Logged) -> Channel:
    """Return the channel with every message's time of logging and no values."""
    values = dict.fromkeys(channel.values, np.broadcast_to(np.nan, found.log_ns.shape))
    return replace(channel, stamps_ns=found.log_ns, values=values)
