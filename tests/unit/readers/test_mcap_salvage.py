"""A damaged MCAP file, cut or flipped anywhere: what is read is what was written, nothing is lost without a word."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np
import pytest
from mcap.opcode import Opcode
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as PlainWriter
from mcap_ros2.writer import Writer

from attest_cli.errors import AttestError
from attest_cli.readers import read
from attest_cli.readers.mcap_chunks import next_chunk
from attest_cli.records import Recording, Warn
from attest_cli.settings import Settings
from attest_cli.writers.ros2 import definition

T0 = 1_780_308_000_000_000_001
IMU, SUN = "/imu/data", "/sun"
Rows = dict[str, dict[int, tuple[float, ...]]]


def written(
    compression: CompressionType = CompressionType.NONE,
    *,
    chunked: bool = True,
    index: bool = True,
    summed: bool = True,
) -> bytes:
    """240 messages of an IMU and of a sun sensor that starts late, in chunks of ten or so."""
    stream = io.BytesIO()
    with Writer(stream, chunk_size=4000, compression=compression) as first:
        kinds = {IMU: "sensor_msgs/Imu", SUN: "geometry_msgs/Vector3Stamped"}
        schemas = {name: first.register_msgdef(k.replace("/", "/msg/"), definition(k)) for name, k in kinds.items()}
        for k in range(240):
            ns = T0 + 10_000_000 * k
            header = {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}, "frame_id": "imu"}
            rate, force = {"x": 0.1 * k, "y": -0.2, "z": 0.3}, {"x": 0.0, "y": 0.01 * k, "z": 9.81}
            turn = {"header": header, "angular_velocity": rate, "linear_acceleration": force}
            first.write_message(IMU, schemas[IMU], turn, log_time=ns)
            if k >= 100 and k % 10 == 0:
                first.write_message(
                    SUN, schemas[SUN], {"header": header, "vector": {"x": k, "y": 0, "z": 1}}, log_time=ns
                )
    if chunked and index and summed:
        return stream.getvalue()
    return copied(stream.getvalue(), compression, chunked=chunked, index=index, summed=summed)


def copied(raw: bytes, compression: CompressionType, *, chunked: bool, index: bool, summed: bool) -> bytes:
    from mcap.reader import make_reader

    stream, ids = io.BytesIO(), dict[int, int]()
    out = PlainWriter(
        stream, 4000, compression, index_types=IndexType.ALL if index else IndexType.NONE, use_chunking=chunked,
        enable_crcs=summed, enable_data_crcs=True, use_statistics=index,
    )  # fmt: skip
    out.start()
    for schema, channel, message in make_reader(io.BytesIO(raw)).iter_messages():
        assert schema is not None
        if channel.id not in ids:
            made = out.register_schema(schema.name, schema.encoding, schema.data)
            ids[channel.id] = out.register_channel(channel.topic, "cdr", made)
        out.add_message(ids[channel.id], message.log_time, message.data, message.publish_time)
    out.finish()
    return stream.getvalue()


def rows(recording: Recording) -> Rows:
    """Topic -> stamp -> values."""
    return {
        c.name: dict(zip(c.stamps_ns.tolist(), zip(*(v.tolist() for v in c.values.values()), strict=True), strict=True))
        for c in recording.channels if c.name in {IMU, SUN}
    }  # fmt: skip


def places(raw: bytes, *opcodes: int) -> list[tuple[int, int, int]]:
    """Opcode, start and end of the records of a file."""
    found, at = [], 8
    while at < len(raw) - 8:
        opcode, length = struct.unpack_from("<BQ", raw, at)
        if not opcodes or opcode in opcodes:
            found.append((opcode, at, at + 9 + length))
        at += 9 + length
    return found


def held(path: Path, data: bytes, whole: Rows) -> str:
    """Read a damaged file against what was written; say how it ended."""
    path.write_bytes(data)
    try:
        recording = read(path, Settings())
    except AttestError:
        return "refused"
    found = rows(recording)
    for name, values in found.items():
        assert values.keys() <= whole[name].keys()
        np.testing.assert_array_equal(list(values.values()), [whole[name][stamp] for stamp in values])
    complete = {name: len(v) for name, v in found.items()} == {name: len(v) for name, v in whole.items()}
    lost = any(warning.lost for warning in recording.warnings)
    assert complete or lost, recording.warnings
    assert all("\n" not in warning.message for warning in recording.warnings)
    return "told" if lost else "whole"


VARIANTS = {
    "plain": {"compression": CompressionType.NONE},
    "zstd": {"compression": CompressionType.ZSTD},
    "lz4 without an index": {"compression": CompressionType.LZ4, "index": False},
    "no chunks": {"compression": CompressionType.NONE, "chunked": False},
    "no checksum of chunks": {"compression": CompressionType.NONE, "summed": False},
}


@pytest.fixture(scope="module", params=VARIANTS)
def variant(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, Rows]:
    raw = written(**VARIANTS[request.param])
    path = tmp_path_factory.mktemp("whole") / "whole.mcap"
    path.write_bytes(raw)
    recording = read(path, Settings())
    assert recording.warnings == ()
    assert {name: len(values) for name, values in rows(recording).items()} == {IMU: 240, SUN: 14}
    return raw, rows(recording)


def test_a_file_cut_anywhere_is_salvaged_or_refused(
    variant: tuple[bytes, Rows], tmp_path: Path, rng: np.random.Generator
) -> None:
    raw, whole = variant
    ends = [held(tmp_path / "cut.mcap", raw[:at], whole) for at in rng.integers(9, len(raw), 30).tolist()]
    assert ends.count("told") + ends.count("whole") >= 15


def test_a_bit_flipped_anywhere_is_salvaged_or_refused(
    variant: tuple[bytes, Rows], tmp_path: Path, rng: np.random.Generator
) -> None:
    raw, whole = variant
    for _ in range(30):
        data = bytearray(raw)
        data[int(rng.integers(8, len(raw)))] ^= 1 << int(rng.integers(8))
        held(tmp_path / "flipped.mcap", bytes(data), whole)


def test_a_bit_flipped_in_the_head_of_a_record_is_salvaged_or_refused(
    variant: tuple[bytes, Rows], tmp_path: Path, rng: np.random.Generator
) -> None:
    raw, whole = variant
    heads = places(raw)
    for _ in range(30):
        data, (_, start, _) = bytearray(raw), heads[int(rng.integers(len(heads)))]
        data[start + int(rng.integers(9))] ^= 1 << int(rng.integers(8))
        held(tmp_path / "head.mcap", bytes(data), whole)


def damaged(raw: bytes, at: int) -> bytes:
    out = bytearray(raw)
    out[at] ^= 0x10
    return bytes(out)


def test_a_damaged_chunk_costs_that_chunk_only(tmp_path: Path) -> None:
    raw = written()
    _, start, end = places(raw, Opcode.CHUNK)[3]
    path = tmp_path / "log.mcap"
    path.write_bytes(damaged(raw, (start + end) // 2))
    recording = read(path, Settings())
    (told,) = recording.warnings
    lost = 240 - len(rows(recording)[IMU])
    assert 5 <= lost <= 20
    assert (told.code, told.lost) == ("damaged-mcap", True)
    assert f"a chunk with a wrong checksum at byte {start} (" in told.message
    assert f"{lost} of 240 messages of {IMU}" in told.message
    assert "logged from 0 to 2.39 s" in told.message


def test_a_wrong_length_of_a_chunk_costs_that_chunk_only(tmp_path: Path) -> None:
    raw = written()
    _, start, end = places(raw, Opcode.CHUNK)[3]
    path = tmp_path / "log.mcap"
    for length in (0, end - start - 9 - 1, end - start, 2**63):
        data = bytearray(raw)
        struct.pack_into("<Q", data, start + 1, length)
        path.write_bytes(data)
        assert len(rows(read(path, Settings()))[IMU]) >= 220


def test_the_summary_names_a_channel_whose_declaration_is_lost(tmp_path: Path) -> None:
    raw = written()
    first = places(raw, Opcode.CHUNK)[0]
    data, path = damaged(raw, first[2] - 5), tmp_path / "log.mcap"
    path.write_bytes(data)
    assert 220 <= len(rows(read(path, Settings()))[IMU]) < 240
    end = places(raw, Opcode.DATA_END)[0][2]
    path.write_bytes(data[:end])  # and without it nobody knows
    recording = read(path, Settings())
    assert recording.channels == ()
    assert "messages of channel 1, which is not declared" in recording.warnings[0].message


def codes(path: Path) -> list[Warn]:
    return list(read(path, Settings()).warnings)


def test_a_cut_says_what_was_logged_before_it(tmp_path: Path) -> None:
    raw, path = written(), tmp_path / "log.mcap"
    _, start, end = places(raw, Opcode.CHUNK)[10]
    for at in (start, start + 5, (start + end) // 2):
        path.write_bytes(raw[:at])
        (told,) = codes(path)
        assert told.lost
        assert "how much is lost is not known; what is read was logged from 0 to 1." in told.message
    path.write_bytes(raw[: places(raw, Opcode.DATA_END)[0][2]])
    (told,) = codes(path)
    assert (told.code, told.lost) == ("cut-mcap", False)


def test_damage_of_what_is_not_needed_loses_nothing(tmp_path: Path) -> None:
    raw, path = written(), tmp_path / "log.mcap"
    for opcode in (Opcode.STATISTICS, Opcode.CHUNK_INDEX, Opcode.SUMMARY_OFFSET, Opcode.FOOTER):
        _, start, end = places(raw, opcode)[0]
        path.write_bytes(damaged(raw, (start + end) // 2))
        assert codes(path) == []
    _, start, end = places(raw, Opcode.MESSAGE_INDEX)[4]
    path.write_bytes(damaged(raw, end - 3))
    assert not any(told.lost for told in codes(path))


def test_without_any_checksum_of_its_own_a_section_with_a_wrong_one_is_refused(tmp_path: Path) -> None:
    raw, path = written(chunked=False), tmp_path / "log.mcap"
    _, start, end = places(raw, Opcode.MESSAGE)[50]
    path.write_bytes(damaged(raw, (start + end) // 2))
    with pytest.raises(AttestError, match="checksum of the data section"):
        read(path, Settings())


def test_the_next_chunk_is_found_over_the_edge_of_a_block() -> None:
    raw = written()
    _, start, end = places(raw, Opcode.CHUNK)[2]
    chunk = raw[start:end]
    for before in (0, 1, (1 << 20) - 20, (1 << 20) - 1, 1 << 20, (1 << 20) + 7):
        data = b"\x06" * before + chunk + b"tail"
        assert next_chunk(io.BytesIO(data), 0, len(data)) == before
    assert next_chunk(io.BytesIO(raw[start : end - 1]), 0, end - 1 - start) is None
