"""MCAP, record by record: lengths are held against the bytes left, checksums verified, chunks unpacked under a cap.

The library's readers do none of this: they drop the CRC flag where the index is missing, and unpack without a limit.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Schema

MAGIC = b"\x89MCAP0\r\n"
MAX_CHUNK_BYTES = 512 << 20
"""Limit of one unpacked chunk; writers use 1 to 16 MB."""

READ = frozenset({Opcode.CHUNK, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.DATA_END})
_BLOCK = 1 << 20
_HEADER = struct.Struct("<BQ")  # opcode, length
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time


class DamagedError(Exception):
    """The bytes at ``offset`` are not what the format asks for."""

    def __init__(self, offset: int, reason: str) -> None:
        self.offset = offset
        super().__init__(f"{reason} at byte {offset}")


@dataclass(frozen=True, slots=True)
class Message:
    """A message as it stands in the file, its payload not decoded."""

    channel_id: int
    log_ns: int
    publish_ns: int
    data: memoryview


Record = Schema | Channel | Message


def walk(stream: BinaryIO, size: int) -> Iterator[Record]:
    """Yield schemas, channels and messages in the order of the file.

    Parameters
    ----------
    stream : binary file, at its start
    size : int
        Bytes of the file.

    Raises
    ------
    DamagedError
        If the file is cut or a length, a checksum or a compressed block is wrong.
    """
    crc = zlib.crc32(stream.read(len(MAGIC)))
    while True:
        offset = stream.tell()
        header = stream.read(_HEADER.size)
        if len(header) < _HEADER.size:
            raise DamagedError(offset, "the file ends before its footer")
        opcode, length = _HEADER.unpack(header)
        if length > size - stream.tell():
            name = Opcode(opcode).name.lower() if opcode in Opcode._value2member_map_ else f"unknown ({opcode})"
            raise DamagedError(offset, f"a record ({name}) of {length} bytes with {size - stream.tell()} left")
        if opcode not in READ:
            crc = _skip(stream, length, zlib.crc32(header, crc))
            continue
        body = stream.read(length)
        if opcode == Opcode.DATA_END:
            stated = _at_least(body, 4, offset) and struct.unpack_from("<I", body)[0]
            if stated and stated != crc:
                raise DamagedError(offset, "the checksum of the data section is wrong")
            return
        crc = zlib.crc32(body, zlib.crc32(header, crc))
        if opcode == Opcode.CHUNK:
            yield from _records(_unpack(body, offset), offset)
        else:
            yield from _records(memoryview(header + body), offset)


def _skip(stream: BinaryIO, length: int, crc: int) -> int:
    """Pass over a record, however long, and return the checksum with it."""
    while length > 0:
        block = stream.read(min(length, _BLOCK))
        if not block:
            break
        crc = zlib.crc32(block, crc)
        length -= len(block)
    return crc


def _records(data: memoryview, offset: int) -> Iterator[Record]:
    """Yield the records in a chunk, or the one record outside of chunks; ``offset`` is its place in the file."""
    at = 0
    while at < len(data):
        if len(data) - at < _HEADER.size:
            raise DamagedError(offset, "a cut record in the chunk")
        opcode, length = _HEADER.unpack_from(data, at)
        at += _HEADER.size
        if length > len(data) - at or opcode == 0:
            raise DamagedError(offset, f"a record of {length} bytes with {len(data) - at} left in the chunk")
        body = data[at : at + length]
        at += length
        if opcode == Opcode.MESSAGE:
            _at_least(body, _MESSAGE.size, offset)
            channel_id, _, log_ns, publish_ns = _MESSAGE.unpack_from(body)
            yield Message(channel_id, log_ns, publish_ns, body[_MESSAGE.size :])
        elif opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
            yield _described(opcode, body, offset)


def _described(opcode: int, body: memoryview, offset: int) -> Schema | Channel:
    source = ReadDataStream(io.BytesIO(body))
    try:
        record: Schema | Channel = Schema.read(source) if opcode == Opcode.SCHEMA else Channel.read(source)
    except (struct.error, ValueError, EOFError) as error:
        raise DamagedError(offset, f"an unreadable {Opcode(opcode).name.lower()} ({error})") from None
    return record


def _unpack(body: bytes, offset: int) -> memoryview:
    """Unpack a chunk to exactly the size it states, and verify its checksum."""
    try:
        chunk = Chunk.read(ReadDataStream(io.BytesIO(body)))
    except (struct.error, ValueError, EOFError) as error:
        raise DamagedError(offset, f"an unreadable chunk ({error})") from None
    if chunk.uncompressed_size > MAX_CHUNK_BYTES:
        limit = MAX_CHUNK_BYTES >> 20
        raise DamagedError(offset, f"a chunk of {chunk.uncompressed_size >> 20} MB, over the limit of {limit} MB,")
    limit = chunk.uncompressed_size + 1  # one byte more shows a chunk that is larger than it says
    try:
        if chunk.compression == "zstd":
            with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
                data = reader.read(limit)
        elif chunk.compression == "lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=limit)
        elif not chunk.compression:
            data = chunk.data
        else:
            raise DamagedError(offset, f"an unknown compression {chunk.compression[:20]!r}")
    except (zstandard.ZstdError, RuntimeError, EOFError) as error:
        raise DamagedError(offset, f"a chunk that does not unpack ({error})") from None
    if len(data) != chunk.uncompressed_size:
        raise DamagedError(offset, f"a chunk that is not of the {chunk.uncompressed_size} bytes it states")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise DamagedError(offset, "a chunk with a wrong checksum")
    return memoryview(data)


def _at_least(body: bytes | memoryview, count: int, offset: int) -> bool:
    if len(body) < count:
        raise DamagedError(offset, f"a record of {len(body)} bytes, {count} at least expected,")
    return True
