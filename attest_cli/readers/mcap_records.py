"""MCAP, chunk by chunk: lengths are held against the bytes left, checksums verified, chunks unpacked under a cap.

The library's readers do none of this: they drop the CRC flag where the index is missing, and unpack without a limit.
Messages come in batches; a chunk's message index only hints where they are, and what it says is held against the bytes.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
from isal.isal_zlib import crc32
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from ..records import LATEST_NS, Ints
from .mcap_chunks import MAX_CHUNK_BYTES, UNREADABLE, DamagedError, next_chunk, unpack

Bytes = NDArray[np.uint8]
MAGIC = b"\x89MCAP0\r\n"
MOST_LOST, MOST_EXPANDED = 1000, 200
"""Damaged places after which a file is given up, and the packing of a file larger than a chunk that is no log's."""

RECORDS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE})
READ = RECORDS | {Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.DATA_END}
PASSED = frozenset({Opcode.HEADER, Opcode.ATTACHMENT, Opcode.METADATA})
FIRST_PRIVATE = 0x80
MANY_ALIKE = 64
_BLOCK = 1 << 20
_HEADER = struct.Struct("<BQ")  # opcode, length
_LENGTH = struct.Struct("<Q")
_INDEX = struct.Struct("<HI")  # channel, bytes of the pairs (log time, place)
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_HEADS = np.dtype({
    "names": ["opcode", "length", "channel_id", "log_ns", "publish_ns"], "formats": ["u1", "<u8", "<u2", "<u8", "<u8"],
    "offsets": [0, 1, 9, 15, 23], "itemsize": _HEADER.size + _MESSAGE.size,
})  # fmt: skip


@dataclass(frozen=True, slots=True)
class Message:
    """A message as it stands in the file, its payload not decoded."""

    channel_id: int
    log_ns: int
    publish_ns: int
    data: memoryview


@dataclass(frozen=True, slots=True)
class Batch:
    """The m messages of a chunk, as they stand in ``data``: payloads ``data[start : start + size]``, all (m,)."""

    data: Bytes
    start: Ints
    size: Ints
    channel_id: NDArray[np.uint16]
    log_ns: Ints
    publish_ns: Ints

    def payload(self, k: int) -> bytes:
        """Return the bytes of message ``k``."""
        return self.data[self.start[k] : self.start[k] + self.size[k]].tobytes()


Record = Schema | Channel | Message


def walk(stream: BinaryIO, size: int) -> Iterator[Record]:
    """Yield schemas, channels and messages one by one; see ``batches``."""
    for record in batches(stream, size):
        if isinstance(record, Batch):
            stamps = zip(record.channel_id.tolist(), record.log_ns.tolist(), record.publish_ns.tolist(), strict=True)
            for k, (channel_id, log_ns, publish_ns) in enumerate(stamps):
                yield Message(channel_id, log_ns, publish_ns, memoryview(record.payload(k)))
        else:
            yield record


def batches(
    stream: BinaryIO, size: int, losses: list[DamagedError] | None = None
) -> Iterator[Schema | Channel | Batch]:
    """Yield schemas, channels and messages in the order of the file; those a chunk declares before its messages.

    Parameters
    ----------
    stream : binary file, at its start
    size : int
        Bytes of the file.
    losses : list, optional
        Takes what is damaged; reading goes on with the next chunk that is whole.

    Raises
    ------
    DamagedError
        If the file is cut or a length, a checksum or a compressed block is wrong, and ``losses`` is not given; if
        nothing could be trusted, in any case.
    """
    section = _Section(stream, size)
    while True:
        try:
            yield from section.records()
        except DamagedError as damage:
            if losses is None or damage.fatal or len(losses) >= MOST_LOST:
                raise
            losses.append(damage)
            section.resume()
        else:
            return


class _Section:
    """The data section: where reading stands, and from where it can go on behind damage."""

    def __init__(self, stream: BinaryIO, size: int) -> None:
        self.stream, self.size = stream, size
        self.held = _Held()
        self.crc: int | None = crc32(stream.read(len(MAGIC)))  # None: a part was passed over
        self.sure = True  # all that was read has a checksum of its own
        self.trusted = len(MAGIC)  # end of the last chunk that was whole
        self.tried = -1  # start of the last chunk
        self.over = False
        self.packed = self.unpacked = 0

    def resume(self) -> None:
        """Go to the next chunk behind the last whole one that has not been tried yet."""
        found = next_chunk(self.stream, max(self.trusted, self.tried + 1), self.size)
        self.crc, self.over = None, found is None
        if found is not None:
            self.stream.seek(found)

    def records(self) -> Iterator[Schema | Channel | Batch]:
        """Yield what is held, then what follows."""
        yield from self._held_back()
        for offset, opcode, body in self._top_level():
            if opcode == Opcode.MESSAGE_INDEX:
                if _INDEX.size + _INDEX.unpack_from(body.ljust(_INDEX.size, b"\0"))[1] != len(body):
                    raise DamagedError(offset, "an index that is not of its length")
                self.held.hints.append(body)
            elif opcode == Opcode.MESSAGE and self.held.loose and len(self.held.data) < _BLOCK:
                self.held.data += _HEADER.pack(opcode, len(body)) + body
            else:
                yield from self._held_back()
                if opcode == Opcode.CHUNK:
                    self.held = _Held(self._chunk(body, offset), offset)
                else:
                    self.sure = False
                    self.held = _Held(bytearray(_HEADER.pack(opcode, len(body)) + body), offset, loose=True)
        yield from self._held_back()

    def _held_back(self) -> Iterator[Schema | Channel | Batch]:
        held, self.held = self.held, _Held()
        yield from held.records()

    def _chunk(self, body: bytes, offset: int) -> bytes:
        """Unpack a chunk, and stop at a file that unpacks to far more than a log does."""
        self.tried = offset
        self.packed += len(body)
        data, has_checksum = unpack(body, offset)
        self.unpacked += len(data)
        if self.unpacked > MAX_CHUNK_BYTES and self.unpacked > MOST_EXPANDED * self.packed:
            raise DamagedError(offset, f"chunks that unpack to {MOST_EXPANDED} times their size", fatal=True)
        self.sure &= has_checksum
        self.trusted = offset + _HEADER.size + len(body)
        return data

    def _top_level(self) -> Iterator[tuple[int, int, bytes]]:
        """Yield place, opcode and body of the records of the data section that are read; verify its checksum."""
        stream = self.stream
        while not self.over:
            offset = stream.tell()
            header = stream.read(_HEADER.size)
            if len(header) < _HEADER.size:
                raise DamagedError(offset, "the file ends before its footer")
            opcode, length = _HEADER.unpack(header)
            self._allow(opcode, length, offset)
            if opcode not in READ:
                self.crc = _skip(stream, length, self._summed(header))
                continue
            body = stream.read(length)
            if opcode == Opcode.DATA_END:
                self.over = True
                self._check(body, offset)
                return
            self.crc = self._summed(header, body)
            yield offset, opcode, body

    def _allow(self, opcode: int, length: int, offset: int) -> None:
        """Refuse a record that has no place here, or no room."""
        left = self.size - offset - _HEADER.size
        name = Opcode(opcode).name.lower() if opcode in Opcode._value2member_map_ else f"unknown ({opcode})"
        if length > left or (opcode < FIRST_PRIVATE and opcode not in READ | PASSED):
            raise DamagedError(offset, f"a record ({name}) of {length} bytes with {left} left")
        if opcode in READ and length > MAX_CHUNK_BYTES:
            limit = MAX_CHUNK_BYTES >> 20
            raise DamagedError(offset, f"a record ({name}) of {length >> 20} MB, over the limit of {limit} MB,")

    def _summed(self, *parts: bytes) -> int | None:
        """Return the checksum with these parts, if it is known."""
        crc = self.crc
        for part in parts:
            crc = None if crc is None else crc32(part, crc)
        return crc

    def _check(self, body: bytes, offset: int) -> None:
        """Hold the checksum of the section; where it fails and chunks have none, nobody knows what is wrong."""
        stated = _at_least(body, 4, offset) and struct.unpack_from("<I", body)[0]
        if stated and self.crc is not None and stated != self.crc:
            raise DamagedError(offset, "the checksum of the data section is wrong", fatal=not self.sure)


class _Held:
    """A chunk whose indexes may follow, or records outside of chunks that are taken together."""

    def __init__(self, data: bytes | bytearray = b"", offset: int = 0, loose: bool = False) -> None:
        self.data, self.offset, self.loose = data, offset, loose
        self.hints: list[bytes] = []

    def records(self) -> Iterator[Schema | Channel | Batch]:
        """Yield what is declared, then the messages."""
        data = np.frombuffer(self.data, dtype=np.uint8)
        places = _places(data, self.hints, self.offset)
        opcode = data[places]
        for at in places[(opcode == Opcode.SCHEMA) | (opcode == Opcode.CHANNEL)].tolist():
            length = _LENGTH.unpack_from(self.data, at + 1)[0]
            yield _described(int(data[at]), self.data[at + _HEADER.size : at + _HEADER.size + length], self.offset)
        places = places[opcode == Opcode.MESSAGE]
        if places.size:
            yield self._batch(data, places)
        if sum(len(body) - _INDEX.size for body in self.hints) > 16 * places.size:
            raise DamagedError(self.offset, "an index of more messages than there are")

    def _batch(self, data: Bytes, places: Ints) -> Batch:
        every = _every(data, np.dtype((np.void, _HEADS.itemsize)))  # copied whole: five times faster than by field
        heads = every[places[places < every.size]].view(_HEADS)
        if heads.size < places.size or heads["length"].min() < _MESSAGE.size:
            raise DamagedError(self.offset, f"a message of fewer than {_MESSAGE.size} bytes")
        if max(heads["log_ns"].max(), heads["publish_ns"].max()) > LATEST_NS:
            raise DamagedError(self.offset, "a stamp that is no time")
        stamps = (heads[name].astype(np.int64) for name in ("log_ns", "publish_ns"))
        size = heads["length"].astype(np.int64) - _MESSAGE.size
        return Batch(data, places + _HEADS.itemsize, size, heads["channel_id"], *stamps)


def _places(data: Bytes, hints: Sequence[bytes], offset: int) -> Ints:
    """Return where the records of a chunk begin: the messages that its index names, and all between them.

    Records must lie end to end; where those of the index do not, the whole chunk is read record by record.
    """
    pairs = [np.frombuffer(body, "<u8", (len(body) - _INDEX.size) // 16 * 2, _INDEX.size) for body in hints]
    named = np.sort(np.concatenate([np.empty(0, "<u8"), *(p[1::2] for p in pairs)]), kind="stable")  # runs, merged
    if not named.size or named[-1] > data.size - _HEADS.itemsize:
        return _scan(data, 0, data.size, offset)
    at = named.astype(np.int64)
    length = _every(data, np.dtype("<u8"))[at + 1]
    if np.any(data[at] != Opcode.MESSAGE) or length.max() > data.size:
        return _scan(data, 0, data.size, offset)
    ends = np.concatenate([[0], at + _HEADER.size + length.astype(np.int64)])
    begins = np.append(at, data.size)
    parts = [at]
    for k in np.flatnonzero(begins != ends).tolist():
        if begins[k] < ends[k]:
            return _scan(data, 0, data.size, offset)
        parts.append(_scan(data, int(ends[k]), int(begins[k]), offset))
    return at if len(parts) == 1 else np.sort(np.concatenate(parts))


def _every(data: Bytes, kind: np.dtype[Any]) -> NDArray[Any]:
    """Return what stands at every byte, read as ``kind``, without copying."""
    return np.ndarray((max(data.size - kind.itemsize + 1, 0),), kind, data, strides=(1,))


def _scan(data: Bytes, at: int, end: int, offset: int) -> Ints:
    """Return where the records between ``at`` and ``end`` begin, length by length; many that are alike at once."""
    found, parts, view, header = list[int](), list[Ints](), data.data, _HEADER.size
    before, alike = (-1, -1), 0
    while at < end:
        if end - at < header:
            raise DamagedError(offset, "a cut record in the chunk")
        opcode, length = _HEADER.unpack_from(view, at)
        if length > end - at - header or opcode == 0:
            raise DamagedError(offset, f"a record of {length} bytes with {end - at - header} left in the chunk")
        alike = alike + 1 if (opcode, length) == before else 0
        before = opcode, length
        if alike < MANY_ALIKE:
            found.append(at)
            at += header + length
            continue
        many = np.arange(_alike(data, at, end, header + length), dtype=np.int64) * (header + length) + at
        parts += [np.array(found, dtype=np.int64), many]
        found, alike, at = [], 0, int(many[-1]) + header + length
    return np.concatenate([*parts, np.array(found, dtype=np.int64)])


def _alike(data: Bytes, at: int, end: int, step: int) -> int:
    """Count the records of ``step`` bytes from ``at`` on whose heads are the same."""
    most = (end - at) // step
    heads: Bytes = np.ndarray((most, _HEADER.size), np.uint8, data, at, (step, 1))
    count, window = 1, MANY_ALIKE
    while count < most:
        other = np.flatnonzero(np.any(heads[count : count + window] != heads[0], axis=1))
        if other.size:
            return count + int(other[0])
        count, window = count + window, 8 * window
    return most


def _skip(stream: BinaryIO, length: int, crc: int | None) -> int | None:
    """Pass over a record, however long, and return the checksum with it."""
    while length > 0:
        block = stream.read(min(length, _BLOCK))
        if not block:
            break
        crc = None if crc is None else crc32(block, crc)
        length -= len(block)
    return crc


def _described(opcode: int, body: bytes | bytearray, offset: int) -> Schema | Channel:
    source = ReadDataStream(io.BytesIO(body))
    try:
        record: Schema | Channel = Schema.read(source) if opcode == Opcode.SCHEMA else Channel.read(source)
    except UNREADABLE as error:
        raise DamagedError(offset, f"an unreadable {Opcode(opcode).name.lower()} ({error})") from None
    return record


def _at_least(body: bytes, count: int, offset: int) -> bool:
    if len(body) < count:
        raise DamagedError(offset, f"a record of {len(body)} bytes, {count} at least expected,")
    return True
