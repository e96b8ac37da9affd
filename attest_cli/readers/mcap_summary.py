"""The summary and the message index of an MCAP file: when every message was logged, without reading the messages.

All of it is what a writer claims, and held against the bytes; where it does not hold, the file is read as a whole.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
from isal.isal_zlib import crc32
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import ChunkIndex, Statistics

from ..records import LATEST_NS, Ints
from .mcap_records import MAGIC

_HEADER = struct.Struct("<BQ")  # opcode, length
_INDEX = struct.Struct("<HI")  # channel, bytes of the pairs (log time, offset)
_FOOTER = struct.Struct("<QQI")  # summary, its offsets, its checksum
_FOOTER_BYTES = _HEADER.size + _FOOTER.size
DATA_END = _HEADER.pack(Opcode.DATA_END, 4) + bytes(4)  # no checksum
LARGEST_SUMMARY = 64 << 20


class UnsureError(Exception):
    """The file has no summary or no whole index, or what they say does not fit."""


@dataclass(frozen=True, slots=True)
class Summary:
    """What the end of the file says: ``declared`` schemas and channels as they stand, chunks by time, the counts."""

    declared: bytes
    chunks: tuple[ChunkIndex, ...]
    counts: dict[int, int]


@dataclass(frozen=True, slots=True)
class Logged:
    """The messages of one channel: ``log_ns`` (n,) in order, the chunks (place in ``Summary.chunks``) of both ends."""

    log_ns: Ints
    first: int
    last: int


def summary_of(stream: BinaryIO, size: int) -> Summary:
    """Read the summary; ``UnsureError`` if it is missing, or chunks and messages are not all in it."""
    summary, start, chunk_count = _read(stream, size)
    if not summary.chunks or chunk_count != len(summary.chunks) or not _apart(summary.chunks, start):
        raise UnsureError
    return summary


def stated(stream: BinaryIO, size: int) -> Summary | None:
    """Return what the summary states, whatever became of the rest of the file; None where it is damaged or missing."""
    try:
        return _read(stream, size)[0]
    except UnsureError:
        return None


def _read(stream: BinaryIO, size: int) -> tuple[Summary, int, int]:
    """Read the summary, where it starts and how many chunks it counts (-1: no statistics), and hold its checksum."""
    at = size - len(MAGIC) - _FOOTER_BYTES
    if at < len(MAGIC):
        raise UnsureError
    stream.seek(at)
    footer = stream.read(_FOOTER_BYTES)
    opcode, body = _records(footer)[0]
    start, _, crc = _FOOTER.unpack(body) if opcode == Opcode.FOOTER and len(body) == _FOOTER.size else (0, 0, 0)
    if not len(MAGIC) <= start < at or at - start > LARGEST_SUMMARY or stream.read() != MAGIC:
        raise UnsureError
    stream.seek(start)
    section = stream.read(at - start)
    if crc and crc != crc32(footer[:-4], crc32(section)):
        raise UnsureError
    declared, chunks, statistics = b"", [], None
    try:
        for opcode, body in _records(section):
            if opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                declared += _HEADER.pack(opcode, len(body)) + body
            elif opcode == Opcode.CHUNK_INDEX:
                chunks.append(ChunkIndex.read(ReadDataStream(io.BytesIO(body))))
            elif opcode == Opcode.STATISTICS:
                statistics = Statistics.read(ReadDataStream(io.BytesIO(body)))
    except (McapError, struct.error, ValueError):
        raise UnsureError from None
    chunks.sort(key=lambda chunk: (chunk.message_start_time, chunk.chunk_start_offset))
    counts = {} if statistics is None else {k: n for k, n in statistics.channel_message_counts.items() if n}
    return Summary(declared, tuple(chunks), counts), start, -1 if statistics is None else statistics.chunk_count


def logged(stream: BinaryIO, summary: Summary) -> dict[int, Logged]:
    """Return when the messages of every channel were logged; ``UnsureError`` if their count is not the stated one."""
    times: dict[int, list[Ints]] = {}
    places: dict[int, list[int]] = {}
    for place, chunk in enumerate(summary.chunks):
        for channel_id, log_ns in _indexed(_index(stream, chunk)):
            times.setdefault(channel_id, []).append(log_ns)
            places.setdefault(channel_id, []).append(place)
    if {channel_id: sum(map(len, found)) for channel_id, found in times.items()} != summary.counts:
        raise UnsureError
    every = {}
    for channel_id, found in times.items():
        first = places[channel_id][min(range(len(found)), key=lambda k: int(found[k].min()))]
        last = places[channel_id][max(range(len(found)), key=lambda k: int(found[k].max()))]
        every[channel_id] = Logged(np.sort(np.concatenate(found)), first, last)
    return every


def excerpt(stream: BinaryIO, summary: Summary, places: Iterable[int]) -> bytes:
    """Return a data section that holds the declarations and the chunks at ``places`` only, each with its index."""
    parts = [MAGIC, summary.declared]
    for chunk in (summary.chunks[place] for place in sorted(places)):
        stream.seek(chunk.chunk_start_offset)
        parts.append(stream.read(chunk.chunk_length + chunk.message_index_length))
    return b"".join([*parts, DATA_END])


def _apart(chunks: Iterable[ChunkIndex], end: int) -> bool:
    """Tell whether the chunks, each with its index, lie one after the other before ``end``."""
    at = len(MAGIC)
    for chunk in sorted(chunks, key=lambda chunk: chunk.chunk_start_offset):
        if chunk.chunk_start_offset < at:
            return False
        at = chunk.chunk_start_offset + chunk.chunk_length + chunk.message_index_length
    return at <= end


def _index(stream: BinaryIO, chunk: ChunkIndex) -> bytes:
    stream.seek(chunk.chunk_start_offset + chunk.chunk_length)
    return stream.read(chunk.message_index_length)


def _indexed(data: bytes) -> Iterator[tuple[int, Ints]]:
    """Yield channel and times of logging of each index of a chunk."""
    for opcode, body in _records(data):
        if opcode != Opcode.MESSAGE_INDEX or len(body) < _INDEX.size:
            raise UnsureError
        channel_id, length = _INDEX.unpack_from(body)
        if length != len(body) - _INDEX.size or length % 16:
            raise UnsureError
        found = np.frombuffer(body, "<u8", offset=_INDEX.size)[::2]
        if found.size and int(found.max()) > LATEST_NS:
            raise UnsureError
        if found.size:
            yield channel_id, found.astype(np.int64)


def _records(data: bytes) -> list[tuple[int, bytes]]:
    """Return opcode and body of records that lie end to end."""
    found, at = [], 0
    while at < len(data):
        if len(data) - at < _HEADER.size:
            raise UnsureError
        opcode, length = _HEADER.unpack_from(data, at)
        at += _HEADER.size
        if length > len(data) - at:
            raise UnsureError
        found.append((opcode, data[at : at + length]))
        at += length
    return found
