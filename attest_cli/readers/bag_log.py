"""ROS 1 bags (.bag) and ROS 2 bags in SQLite (.db3): only messages of known types are unpacked."""

from __future__ import annotations

import bz2
import sqlite3
import struct
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing
from pathlib import Path

import lz4.frame
import numpy as np
from mcap.records import Schema

from ..errors import AttestError
from ..records import LATEST_NS, Recording, Warn
from ..settings import Settings
from . import topics
from .extras import extra
from .mcap_chunks import MAX_CHUNK_BYTES
from .mcap_records import Batch
from .messages import TYPES
from .topics import Topic, line
from .wires import Wires

Message = tuple[int, int, bytes]  # connection, time of logging in ns, payload
MAGIC_DB3 = b"SQLite format 3\x00"
BATCH_BYTES = 8 << 20
MAX_MESSAGE_BYTES = 64 << 20
"""Limit of one message; those of the types that are read take some hundred bytes."""
REINDEX = "rosbag reindex saves what is whole"
NOT_AS_STATED = "a record is not what its place asks for"
RECOVER = "sqlite3 with .recover saves what is whole"
_DAMAGED = (
    struct.error, ValueError, TypeError, AssertionError, KeyError, IndexError, EOFError, RuntimeError, OverflowError,
    MemoryError,
)  # fmt: skip


def read(path: Path, settings: Settings) -> Recording:
    """Read the channels of known types of a bag; see ``readers.read``."""
    told: list[Warn] = []
    other: dict[str, str] = {}
    try:
        with path.open("rb") as stream:
            is_db3 = stream.read(len(MAGIC_DB3)) == MAGIC_DB3
        found = _ros2(path, other, told) if is_db3 else _ros1(path, other, told)
    except OSError as error:
        raise AttestError(f"{path}: cannot be read: {error.strerror}") from None
    return topics.recording(path, "db3" if is_db3 else "bag", found, other, settings.time.source, told)


def _ros1(path: Path, other: dict[str, str], told: list[Warn]) -> list[Topic]:
    """Read a ROS 1 bag by its index; chunks are unpacked under a cap."""
    library = extra(path, "rosbags.rosbag1", "bag", "a ROS 1 bag")
    try:
        with library.Reader(path) as reader:
            reader.chunks |= {at: chunk._replace(decompressor=_unpack) for at, chunk in reader.chunks.items()}
            declared = {
                c.id: (c.topic, Schema(c.id, c.msgdef.data.encode(), "ros1msg", c.msgtype)) for c in reader.connections
            }
            chosen = _choose(path, "ros1", declared, other)
            wanted = [connection for connection in reader.connections if connection.id in chosen]
            for c in wanted:
                stated = sum(info.connection_counts.get(c.id, 0) for info in reader.chunk_infos)
                if c.msgcount != stated:
                    message = f"{path.name}: the index has {c.msgcount} messages of {c.topic}, its summary {stated}"
                    told.append(Warn("damaged-index", message, REINDEX, lost=True))
            if wanted:  # none would be all
                _fill(path, chosen, ((c.id, stamp, data) for c, stamp, data in reader.messages(wanted)))
    except (library.ReaderError, *_DAMAGED) as error:
        raise AttestError(f"{path}: damaged ROS 1 bag: {line(error) or NOT_AS_STATED}", REINDEX) from None
    return list(dict.fromkeys(chosen.values()))


def _unpack(packed: bytes) -> bytes:
    """Unpack a chunk by its first bytes, which no chunk that is not packed has, to at most the limit."""
    limit = MAX_CHUNK_BYTES + 1
    unpacker = bz2.BZ2Decompressor() if packed.startswith(b"BZh") else lz4.frame.LZ4FrameDecompressor()
    if not packed.startswith((b"BZh", b"\x04\x22\x4d\x18")):
        return packed
    data = unpacker.decompress(packed, max_length=limit)
    if len(data) == limit:
        raise ValueError(f"a chunk of more than the limit of {MAX_CHUNK_BYTES >> 20} MB")
    if not unpacker.eof:
        raise ValueError("a chunk that ends too early")
    return data


def _ros2(path: Path, other: dict[str, str], told: list[Warn]) -> list[Topic]:
    """Read a ROS 2 bag, whose tables alone are trusted: no view, no trigger, no function."""
    log = path.with_name(f"{path.name}-wal")
    if log.is_file() and log.stat().st_size:
        message = f"{path.name}: what stands in {log.name} is not read: the recorder was stopped half-way"
        told.append(Warn("write-ahead-log", message, "open the bag once with sqlite3 and it is taken over", lost=True))
    _check_pages(path)
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as base:
            base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_MESSAGE_BYTES)
            base.execute("PRAGMA trusted_schema = OFF")
            (sound,) = base.execute("PRAGMA quick_check(1)").fetchone()
            if sound != "ok":
                raise AttestError(f"{path}: damaged ROS 2 bag: {' '.join(sound.split())}", RECOVER)
            tables = {name for (name,) in base.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
            if not {"topics", "messages"} <= tables:
                raise AttestError(f"{path}: an SQLite file without the tables of a ROS 2 bag", "name the .db3 of a bag")
            declared = _declared(path, base, tables, other)
            _count_strays(path, base, told)
            chosen = _choose(path, "cdr", declared, other)
            places = ",".join("?" * len(chosen))
            query = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({places})"  # noqa: S608
            _fill(path, chosen, _checked(path, base.execute(query, list(chosen))))
    except (sqlite3.Error, *_DAMAGED) as error:
        raise AttestError(f"{path}: damaged ROS 2 bag: {line(error) or NOT_AS_STATED}", RECOVER) from None
    return list(dict.fromkeys(chosen.values()))


def _count_strays(path: Path, base: sqlite3.Connection, told: list[Warn]) -> None:
    """Say how many messages are of a topic that is not there: nothing else guards the number of a topic."""
    query = "SELECT count(*) FROM messages WHERE topic_id IS NULL OR topic_id NOT IN (SELECT id FROM topics)"
    (count,) = base.execute(query).fetchone()
    if count:
        message = f"{path.name}: damaged ROS 2 bag: {count} messages are of no topic of it"
        told.append(Warn("damaged-bag", message, RECOVER, lost=True))


def _check_pages(path: Path) -> None:
    """Refuse a file shorter than its header says: SQLite reads zeros where it ends."""
    with path.open("rb") as stream:
        head = stream.read(100)
    if len(head) < 100:
        raise AttestError(f"{path}: damaged ROS 2 bag: cut short", RECOVER)
    page, counter, pages, valid = (
        int.from_bytes(head[at:end], "big") for at, end in ((16, 18), (24, 28), (28, 32), (92, 96))
    )
    size = (65536 if page == 1 else page) * pages
    if counter == valid and path.stat().st_size < size:
        raise AttestError(f"{path}: damaged ROS 2 bag: {path.stat().st_size} of {size} bytes are there", RECOVER)


def _declared(
    path: Path, base: sqlite3.Connection, tables: set[str], other: dict[str, str]
) -> dict[int, tuple[str, Schema]]:
    """Return the channels in CDR with their definitions; of older bags, which have none, those of ROS 2 Humble."""
    texts: dict[str, str] = {}
    if "message_definitions" in tables:
        query = "SELECT topic_type, encoded_message_definition FROM message_definitions WHERE encoding = 'ros2msg'"
        texts = {str(kind): str(text) for kind, text in base.execute(query)}
    declared = {}
    for number, name, kind, encoding in base.execute("SELECT id, name, type, serialization_format FROM topics"):
        if encoding != "cdr" or kind not in TYPES:
            other[str(name)] = f"{kind} ({encoding})"
            continue
        text = texts.get(kind) or _standard(path, kind)
        declared[int(number)] = str(name), Schema(int(number), text.encode(), "ros2msg", kind)
    return declared


def _standard(path: Path, kind: str) -> str:
    """Return the definition of a type of ROS 2."""
    types = extra(path, "rosbags.typesys", "bag", "a ROS 2 bag without definitions")
    text: str = types.get_typestore(types.Stores.ROS2_HUMBLE).generate_msgdef(kind, ros_version=2)[0]
    return text


def _checked(path: Path, rows: Iterable[tuple[object, object, object]]) -> Iterator[Message]:
    """Hold the types of a row against what SQLite does not: any cell can be anything."""
    for number, stamp, data in rows:
        if (
            not (isinstance(number, int) and isinstance(stamp, int) and isinstance(data, bytes))
            or abs(stamp) > LATEST_NS
        ):
            raise AttestError(f"{path}: damaged ROS 2 bag: a message that is no message", RECOVER)
        yield number, stamp, data


def _choose(
    path: Path, encoding: str, declared: Mapping[int, tuple[str, Schema]], other: dict[str, str]
) -> dict[int, Topic]:
    """Prepare the channels of known types; publishers of one topic and type share it."""
    wires, chosen = Wires(path), dict[int, Topic]()
    shared: dict[tuple[str, str, bytes], Topic] = {}
    for number, (name, schema) in declared.items():
        key = name, schema.name, schema.data
        topic = shared.get(key) or wires.topic(name, encoding, schema)
        if isinstance(topic, str):
            other[name] = topic
        else:
            chosen[number] = shared[key] = topic
    return chosen


def _fill(path: Path, chosen: Mapping[int, Topic], messages: Iterable[Message]) -> None:
    """Hand the messages to their topics, many at a time."""
    held: dict[Topic, list[tuple[int, bytes]]] = {}
    size = 0
    for number, stamp, data in messages:
        held.setdefault(chosen[number], []).append((stamp, data))
        size += len(data)
        if size >= BATCH_BYTES:
            _hand(path, held)
            held, size = {}, 0
    _hand(path, held)


def _hand(path: Path, held: Mapping[Topic, list[tuple[int, bytes]]]) -> None:
    for topic, messages in held.items():
        stamps = np.array([stamp for stamp, _ in messages], dtype=np.int64)
        size = np.array([len(data) for _, data in messages], dtype=np.int64)
        data = np.frombuffer(b"".join(data for _, data in messages), dtype=np.uint8)
        batch = Batch(data, np.cumsum(size) - size, size, np.zeros(size.size, dtype=np.uint16), stamps, stamps)
        topic.add(path, batch, np.arange(size.size))
