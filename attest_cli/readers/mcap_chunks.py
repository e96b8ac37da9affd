"""Chunks of an MCAP file: unpacked under a cap, held against their checksum, and found again behind damage."""

from __future__ import annotations

import io
import re
import struct
from typing import BinaryIO

import lz4.frame
import zstandard
from isal.isal_zlib import crc32
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Chunk

MAX_CHUNK_BYTES = 256 << 20
"""Limit of one unpacked chunk; writers use 1 to 16 MB."""

UNREADABLE = (McapError, struct.error, ValueError, EOFError, OverflowError)
"""What the library raises where a record is not what it should be."""

CHUNK = re.compile(rb"\x06(?=(?s:.{36})(?:\x04\0\0\0zstd|\x03\0\0\0lz4|\0\0\0\0))")
"""Head of a record that may be a chunk: opcode, length, times, size, checksum, name of the compression."""

_HEAD = struct.Struct("<BQQQQII")
_LENGTH = struct.Struct("<Q")
_BLOCK = 1 << 20


class DamagedError(Exception):
    """The bytes at ``offset`` are not what the format asks for.

    ``span_ns`` is what a chunk that is lost says of its times of logging. A ``fatal`` fault leaves nothing that could
    be trusted.
    """

    def __init__(
        self, offset: int, reason: str, span_ns: tuple[int, int] | None = None, *, fatal: bool = False
    ) -> None:
        self.offset, self.reason, self.span_ns, self.fatal = offset, reason, span_ns, fatal
        super().__init__(f"{reason} at byte {offset}")


def unpack(body: bytes, offset: int) -> tuple[bytes, bool]:
    """Unpack a chunk to exactly the size it states; tell whether it has a checksum, which then holds.

    Raises
    ------
    DamagedError
        If any of it is not as stated, or the size passes the limit.
    """
    try:
        chunk = Chunk.read(ReadDataStream(io.BytesIO(body)))
    except UNREADABLE as error:
        raise DamagedError(offset, f"an unreadable chunk ({error})") from None
    span = chunk.message_start_time, chunk.message_end_time
    if chunk.uncompressed_size > MAX_CHUNK_BYTES:
        limit = MAX_CHUNK_BYTES >> 20
        reason = f"a chunk of {chunk.uncompressed_size >> 20} MB, over the limit of {limit} MB,"
        raise DamagedError(offset, reason, span)
    limit = chunk.uncompressed_size + 1  # one byte more shows a chunk that is larger than it says
    try:
        if chunk.compression == "zstd":
            data = _unzstd(chunk.data, limit)
        elif chunk.compression == "lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=limit)
        elif not chunk.compression:
            data = chunk.data
        else:
            raise DamagedError(offset, f"an unknown compression {chunk.compression[:20]!r}", span)
    except (zstandard.ZstdError, RuntimeError, EOFError) as error:
        raise DamagedError(offset, f"a chunk that does not unpack ({error})", span) from None
    if len(data) != chunk.uncompressed_size:
        raise DamagedError(offset, f"a chunk that is not of the {chunk.uncompressed_size} bytes it states", span)
    if chunk.uncompressed_crc and crc32(data) != chunk.uncompressed_crc:
        raise DamagedError(offset, "a chunk with a wrong checksum", span)
    return data, bool(chunk.uncompressed_crc)


def _unzstd(packed: bytes, limit: int) -> bytes:
    """Unpack at most ``limit`` bytes: in one call where the frame states its size, else as a stream."""
    unpacker = zstandard.ZstdDecompressor()
    if 0 < zstandard.get_frame_parameters(packed).content_size <= limit:
        return unpacker.decompress(packed)
    with unpacker.stream_reader(packed) as reader:
        return reader.read(limit)


def next_chunk(stream: BinaryIO, at: int, size: int) -> int | None:
    """Return where the next record begins, from byte ``at`` on, that is a chunk by its head and its lengths."""
    most = _HEAD.size + len(b"zstd")
    while at < size:
        stream.seek(at)
        block = stream.read(_BLOCK + most)
        for match in CHUNK.finditer(block):
            place = match.start()
            if place >= _BLOCK:
                break
            if _fits(stream, at + place, block[place : place + most], size):
                return at + place
        at += _BLOCK
    return None


def _fits(stream: BinaryIO, at: int, head: bytes, size: int) -> bool:
    """Tell whether the length of a record is that of a chunk with this head, and within the file."""
    _, length, start_ns, end_ns, _, _, name_bytes = _HEAD.unpack_from(head)
    stream.seek(at + _HEAD.size + name_bytes)
    stated = stream.read(_LENGTH.size)
    if len(stated) < _LENGTH.size or start_ns > end_ns:
        return False
    return bool(length == 40 + name_bytes + _LENGTH.unpack(stated)[0] and length <= size - at - 9)
