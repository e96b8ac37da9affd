"""MCAP chunk by chunk: an index only hints; whatever it says, every message is found, and none that is not there."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np
import pytest
from mcap.opcode import Opcode
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as PlainWriter

from attest_cli.errors import AttestError
from attest_cli.readers import mcap_records, read, wires
from attest_cli.readers.mcap_chunks import DamagedError
from attest_cli.readers.mcap_records import Batch, Message, batches, walk
from attest_cli.records import Recording
from attest_cli.settings import Settings
from attest_cli.simulate import RoverOptions, simulate_rover
from attest_cli.writers.logs import write_recording

Found = list[tuple[int, int, int, bytes]]


def written(count: int, *, index: bool, chunks: bool = True, seed: int = 3) -> bytes:
    rng, stream = np.random.default_rng(seed), io.BytesIO()
    types = IndexType.ALL if index else IndexType.NONE
    out = PlainWriter(
        stream, chunk_size=600, compression=CompressionType.ZSTD, index_types=types, use_chunking=chunks,
        enable_data_crcs=True,
    )  # fmt: skip
    out.start()
    schema = out.register_schema("a/msg/B", "ros2msg", b"float64 x")
    channels = [out.register_channel(topic, "cdr", schema) for topic in ("/a", "/b")]
    for k in range(count):
        which = int(rng.integers(2))
        if k == count // 2:
            channels.append(out.register_channel("/late", "cdr", schema))
            which = 2
        out.add_message(channels[which], k, rng.bytes(int(rng.integers(0, 60))), k + 7)
    out.finish()
    return stream.getvalue()


def found(raw: bytes) -> Found:
    messages = (r for r in walk(io.BytesIO(raw), len(raw)) if isinstance(r, Message))
    return [(m.channel_id, m.log_ns, m.publish_ns, bytes(m.data)) for m in messages]


def spoilt(raw: bytes, change: int) -> bytes:
    """The file with other offsets in every message index: ``change`` is added; without the data section's checksum."""
    out, at = bytearray(raw), 8
    while at < len(out) - 8:
        opcode, length = struct.unpack_from("<BQ", out, at)
        if opcode == Opcode.MESSAGE_INDEX:
            for place in range(at + 9 + 6 + 8, at + 9 + length, 16):
                offset = struct.unpack_from("<Q", out, place)[0]
                struct.pack_into("<Q", out, place, max(0, min(offset + change, 2**63)))
        if opcode == Opcode.DATA_END:
            struct.pack_into("<I", out, at + 9, 0)
        at += 9 + length
    return bytes(out)


def test_index_or_not_chunks_or_not_the_messages_are_the_same() -> None:
    plain = found(written(200, index=True))
    assert [log for _, log, _, _ in plain] == list(range(200))
    assert [publish for _, _, publish, _ in plain] == list(range(7, 207))
    assert found(written(200, index=False)) == plain
    assert found(written(200, index=True, chunks=False)) == plain


@pytest.mark.parametrize("change", [1, -1, 9, 31, 1000, 2**62, -(2**62)])
def test_a_wrong_index_misleads_nobody(change: int) -> None:
    raw = written(200, index=True)
    assert found(spoilt(raw, change)) == found(raw)


def test_an_index_of_one_channel_only_hides_no_message() -> None:
    raw = bytearray(spoilt(written(200, index=True), 0))
    at = 8
    while at < len(raw) - 8:  # the second channel's index becomes a record of a private kind
        opcode, length = struct.unpack_from("<BQ", raw, at)
        if opcode == Opcode.MESSAGE_INDEX and struct.unpack_from("<H", raw, at + 9)[0] == 2:
            raw[at] = 0x90
        at += 9 + length
    assert found(bytes(raw)) == found(written(200, index=True))


def test_a_stamp_beyond_int64_and_a_short_message_are_damage() -> None:
    for body in (struct.pack("<HIQQ", 1, 0, 2**63, 0), struct.pack("<HIQ", 1, 0, 0)):
        raw = b"\x89MCAP0\r\n" + struct.pack("<BQ", Opcode.MESSAGE, len(body)) + body
        raw += struct.pack("<BQI", Opcode.DATA_END, 4, 0)
        with pytest.raises(DamagedError):
            list(batches(io.BytesIO(raw), len(raw)))


def test_loose_messages_come_in_large_batches() -> None:
    raw = written(200, index=False, chunks=False)
    sizes = [r.start.size for r in batches(io.BytesIO(raw), len(raw)) if isinstance(r, Batch)]
    assert sum(sizes) == 200
    assert len(sizes) <= 4  # parted where channels are declared


def same(a: Recording, b: Recording) -> None:
    assert [c.name for c in a.channels] == [c.name for c in b.channels]
    assert a.rows == b.rows
    for one, other in zip(a.channels, b.channels, strict=True):
        assert (one.role, one.frame_id, one.kind) == (other.role, other.frame_id, other.kind)
        assert np.array_equal(one.stamps_ns, other.stamps_ns)
        for name, column in one.values.items():
            assert column.tobytes() == other.values[name].tobytes()


@pytest.mark.parametrize("seed", [1, 2])
def test_many_at_once_are_the_values_of_the_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    options = RoverOptions(seed=seed, duration_s=60.0, rate_hz=20.0, magnetometer=True, odometry=True, compass=True)
    path = tmp_path / "log.mcap"
    write_recording(simulate_rover(options).log, path)
    fast = read(path, Settings())
    monkeypatch.setattr(wires, "fields_of", lambda *_: None)
    same(fast, read(path, Settings()))


def test_a_definition_that_the_library_reads_otherwise_is_left_to_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "log.mcap"
    write_recording(simulate_rover(RoverOptions(duration_s=60.0, rate_hz=20.0)).log, path)
    wanted = read(path, Settings())
    real = wires.fields_of

    def swapped(name: str, text: str) -> object:
        fields = list(real(name, text) or ())
        fields[-3], fields[-2] = fields[-2], fields[-3]
        return tuple(fields)

    monkeypatch.setattr(wires, "fields_of", swapped)
    same(read(path, Settings()), wanted)


def test_an_undeclared_channel_is_refused(tmp_path: Path) -> None:
    body = struct.pack("<HIQQ", 5, 0, 1, 1)
    raw = b"\x89MCAP0\r\n" + struct.pack("<BQ", Opcode.MESSAGE, len(body)) + body
    path = tmp_path / "log.mcap"
    path.write_bytes(raw + struct.pack("<BQI", Opcode.DATA_END, 4, 0))
    with pytest.raises(AttestError, match="channel 5, which is not declared"):
        read(path, Settings())


def test_a_chunk_that_declares_more_than_an_index_can_hold_is_refused(tmp_path: Path) -> None:
    body = struct.pack("<QQQII", 1, 1, 10, 0, 0) + struct.pack("<Q", 2**63)  # times, size, crc, no compression, bytes
    path = tmp_path / "log.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + struct.pack("<BQ", Opcode.CHUNK, len(body)) + body)
    with pytest.raises(AttestError, match="an unreadable chunk"):
        read(path, Settings())


@pytest.mark.parametrize("alike", [0.0, 0.9, 0.999, 1.0])
def test_records_are_found_length_by_length_also_where_many_are_alike(alike: float) -> None:
    rng, parts, at, expected = np.random.default_rng(2), [], 0, []
    for _ in range(5000):
        length = 22 if rng.random() < alike else int(rng.integers(22, 40))
        expected.append(at)
        parts.append(struct.pack("<BQ", Opcode.MESSAGE, length) + rng.bytes(length))
        at += 9 + length
    data = np.frombuffer(b"".join(parts), np.uint8)
    assert mcap_records._scan(data, 0, data.size, 0).tolist() == expected
    with pytest.raises(DamagedError, match="record"):
        mcap_records._scan(data[:-1], 0, data.size - 1, 0)
