"""Damaged and odd logs made from small whole ones: bytes changed anywhere, or what a format is made of.

A case follows from reader, seed and number alone.
"""

from __future__ import annotations

import importlib.util
import io
import sqlite3
import struct
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
ODD_NUMBERS = (0, 1, 2, 7, 127, 128, 255, 256, 32767, 65535, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**63, 2**64 - 1)
ODD_CELLS = (
    *(
        "",
        "nan",
        "inf",
        "-inf",
        "1e999",
        "-0",
        "0",
        "1e-320",
        "9" * 40,
        "1_000",
        "0x10",
        "true",
        "null",
        "#",
        '"',
        "''",
    ),
    *("2026-01-01T00:00:00Z", "12:34:56", "1,5", "1.5.2", "+", "--1", "\u0661\u0662", "\ufeff", "\x00", "\x1b[31m"),
    *("=1+1", "N/A", "None", "1.7e18", "1780308000.123456789", "1e", "e5", "(rad)", "[m/s^2]", "x" * 3000),
)
ODD_NAMES = (
    "t",
    "time",
    "timestamp",
    "timestamp_ns",
    "gyro_x",
    "gyro_x [deg/s]",
    "ax",
    "accel_z [g]",
    "q_w",
    "lat",
    "",
)
Rng = np.random.Generator
Mutate = Callable[[Rng, bytes], bytes]


# seeds: small whole logs


def seeds(reader: str, folder: Path) -> list[bytes]:
    """Return small whole logs of a format."""
    folder.mkdir(parents=True, exist_ok=True)
    return {"csv": _texts, "parquet": _tables, "mcap": _mcaps, "bag": _bags, "db3": _bags, "ulog": _ulogs}[reader](
        reader, folder
    )


def _texts(_: str, folder: Path) -> list[bytes]:
    from support import text_logs as logs

    gyro, accel, mag = logs.xyz(logs.gyro), logs.xyz(logs.accel), logs.xyz(logs.mag)
    rows = slice(0, 120)
    six = [column[rows] for column in (*gyro, *accel)]
    names = "gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z"
    count, field = [str(k) for k in range(120)], [column[rows] for column in mag]
    phone = [f"{name} {axis} ({unit})" for name, unit in (("Gyroscope", "rad/s"), ("Accelerometer", "m/s^2"),
                                                          ("Magnetic field", "µT")) for axis in "xyz"]  # fmt: skip
    made = [
        logs.table(f"t,{names}", [logs.t[rows], *six]),
        logs.table(f"timestamp_ns,{names}", [logs.stamps(1e-9, logs.EPOCH_NS)[rows], *six]),
        logs.table("t;wx;wy;wz;ax;ay;az", [logs.t[rows], *six], delimiter=";", comma=True),
        logs.table("#timestamp [ns]," + names, [logs.stamps(1e-9, logs.EPOCH_NS)[rows], *six]),
        "// Update Rate: 100.0Hz\n" + logs.table("PacketCounter,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z", [count, *six]),
        "\ufeff" + logs.table("\t".join(("Time (s)", *phone)), [logs.t[rows], *six, *field], delimiter="\t"),
        "".join(f"{kind},{k},{row}\n" for k in range(60) for kind, row in (("g", "1,2,3"), ("a", "0,0,9.81"))),
    ]
    return [text.encode() for text in made] + _recorded(folder, ".csv")


def _recorded(folder: Path, suffix: str) -> list[bytes]:
    from attest_cli.simulate import RoverOptions, simulate_rover
    from attest_cli.writers.logs import write_recording

    path = folder / f"rover{suffix}"
    write_recording(
        simulate_rover(
            RoverOptions(
                duration_s=30.0, rate_hz=20.0, motion_s=(8.0, 10.0), stop_s=(5.0, 6.0), gps=True, magnetometer=True
            )
        ).log,
        path,
    )
    return [path.read_bytes()]


def _tables(_: str, folder: Path) -> list[bytes]:
    return _recorded(folder, ".parquet")


def _mcaps(_: str, folder: Path) -> list[bytes]:
    from mcap.writer import CompressionType, IndexType, Writer

    whole = _recorded(folder, ".mcap")
    for chunked, packing in ((True, CompressionType.NONE), (True, CompressionType.LZ4), (False, CompressionType.NONE)):
        stream = io.BytesIO()
        kinds = IndexType.ALL if packing == CompressionType.NONE else IndexType.NONE
        out = Writer(stream, 3000, packing, index_types=kinds, use_chunking=chunked, enable_data_crcs=True)
        out.start()
        _copy(whole[0], out)
        out.finish()
        whole.append(stream.getvalue())
    return whole


def _copy(raw: bytes, out: object) -> None:
    """Copy the messages of an MCAP file, under another encoding for some."""
    from mcap.reader import make_reader

    ids: dict[int, int] = {}
    for schema, channel, message in make_reader(io.BytesIO(raw)).iter_messages():
        if channel.id not in ids and schema is not None:
            made = out.register_schema(schema.name, schema.encoding, schema.data)  # type: ignore[attr-defined]
            ids[channel.id] = out.register_channel(channel.topic, channel.message_encoding, made)  # type: ignore[attr-defined]
        out.add_message(ids[channel.id], message.log_time, message.data, message.publish_time)  # type: ignore[attr-defined]


def _bags(reader: str, folder: Path) -> list[bytes]:
    spec = importlib.util.spec_from_file_location("bags", ROOT / "tests/unit/readers/test_bag_log.py")
    assert spec is not None
    assert spec.loader is not None
    bags = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(bags)
    if reader == "db3":
        return [bags.db3(folder / "a.db3", 250).read_bytes()]
    packings = enumerate((None, "BZ2", "LZ4"))
    return [bags.ros1(folder / f"{k}.bag", 250, how, changing=k == 0).read_bytes() for k, how in packings]


def _ulogs(_: str, folder: Path) -> list[bytes]:
    from support import ulog_files

    rows = []
    for k in range(250):
        us = 1000 + 10_000 * k
        imu = {"timestamp": us, "gyro_rad": (0.1, 0.2, 0.3), "accelerometer_m_s2": (0.0, 0.0, -9.8)}
        rows.append(("sensor_combined", 0, imu))
        rows.append(("vehicle_magnetometer", 0, {"timestamp": us, "magnetometer_ga": (0.2, 0.0, 0.4)}))
        rows.append(
            ("vehicle_gps_position", k % 2, {"timestamp": us, "lat": 465000000, "lon": 66000000, "fix_type": 3})
        )
    return [ulog_files.write(folder / "a.ulg", rows, dropouts=1).read_bytes()]


# mutations: of any bytes, and of what a format is made of


def of_bytes(rng: Rng, data: bytes) -> bytes:
    """Flip, overwrite, cut out, double, insert, truncate: once to four times."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        if not out:
            break
        at, size = int(rng.integers(len(out))), int(2 ** rng.uniform(0, 9))
        kind = int(rng.integers(7))
        if kind == 0:
            out[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            out[at : at + size] = rng.bytes(len(out[at : at + size]))
        elif kind == 2:
            width = int(rng.choice([1, 2, 4, 8]))
            number = int(ODD_NUMBERS[int(rng.integers(len(ODD_NUMBERS)))]) % 256**width
            out[at : at + width] = number.to_bytes(width, "little" if rng.random() < 0.7 else "big")
        elif kind == 3:
            del out[at : at + size]
        elif kind == 4:
            out[at:at] = out[at : at + size]
        elif kind == 5:
            out[at:at] = rng.bytes(size)
        elif rng.random() < 0.3:
            del out[at:]
    return bytes(out)


def of_text(rng: Rng, data: bytes) -> bytes:
    """Change cells, names, columns, rows and delimiters of a table of text."""
    lines = data.decode("utf-8", "surrogateescape").split("\n")
    for _ in range(int(rng.integers(1, 4))):
        k = int(rng.integers(min(len(lines), 3))) if rng.random() < 0.4 else int(rng.integers(len(lines)))
        delimiter = next((d for d in "\t;," if d in lines[k]), ",")
        cells, kind = lines[k].split(delimiter), int(rng.integers(8))
        c = int(rng.integers(len(cells)))
        if kind <= 1:
            cells[c] = str(rng.choice(ODD_NAMES if k < 2 and rng.random() < 0.5 else ODD_CELLS))
            lines[k] = delimiter.join(cells)
        elif kind == 2:
            lines = [d.join(p[:c] + p[c + 1 :]) for d in [delimiter] for p in (line.split(d) for line in lines)]
        elif kind == 3:
            cell = str(rng.choice(ODD_CELLS))
            lines = [delimiter.join([*p[:c], cell, *p[c + 1 :]]) for p in (line.split(delimiter) for line in lines)]
        elif kind == 4:
            lines[k:k] = [lines[int(rng.integers(len(lines)))]] * int(rng.integers(1, 4))
        elif kind == 5:
            del lines[k : k + int(rng.integers(1, 40))]
            lines = lines or [""]
        elif kind == 6:
            other = str(rng.choice(list(",;\t |:")))
            lines = [line.replace(delimiter, other) for line in lines]
        else:
            lines = [line + str(rng.choice(["\r", delimiter, " ", "#"])) for line in lines]
    return "\n".join(lines).encode("utf-8", "surrogateescape")


def of_mcap(rng: Rng, data: bytes) -> bytes:
    """Change records inside and outside of chunks, and make lengths and checksums fit again."""
    out, at = [data[:8]], 8
    target = int(rng.integers(1, 30))
    while at + 9 <= len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        body = data[at + 9 : at + 9 + length]
        at += 9 + length
        target -= 1
        if opcode == 6 and (rng.random() < 0.3 or target == 0):
            body = _rechunked(rng, body)
        elif target == 0 or rng.random() < 0.02:
            body = of_bytes(rng, body)
        if opcode == 15:
            body = bytes(4)  # no checksum of the whole
        out.append(struct.pack("<BQ", opcode, len(body)) + body)
    return b"".join([*out, data[-8:]])


def _rechunked(rng: Rng, body: bytes) -> bytes:
    """Change the inside of a chunk; the new one is not compressed and its checksum holds."""
    from attest_cli.readers import mcap_chunks

    try:
        inside, _ = mcap_chunks.unpack(body, 0)
    except mcap_chunks.DamagedError:
        return body
    records, at, out = [], 0, []
    while at + 9 <= len(inside):
        opcode, length = struct.unpack_from("<BQ", inside, at)
        records.append((opcode, inside[at + 9 : at + 9 + length]))
        at += 9 + length
    chosen = int(rng.integers(max(len(records), 1)))
    for k, (opcode, inner) in enumerate(records):
        changed = of_bytes(rng, inner) if k == chosen or rng.random() < 0.02 else inner
        out.append(struct.pack("<BQ", opcode, len(changed)) + changed)
    data = b"".join(out)
    return body[:16] + struct.pack("<QII", len(data), zlib.crc32(data), 0) + struct.pack("<Q", len(data)) + data


def of_parquet(rng: Rng, data: bytes) -> bytes:
    """Give columns other names, types and blanks; the file itself is whole."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pq.read_table(io.BytesIO(data)).slice(0, int(rng.integers(0, 300)))
    for _ in range(int(rng.integers(1, 5))):
        k = int(rng.integers(table.num_columns))
        n, name = table.num_rows, table.column_names[k]
        kinds: list[Callable[[], pa.Array]] = [
            lambda n=n: pa.array(rng.choice(ODD_CELLS, n).tolist()),  # type: ignore[misc]
            lambda n=n: pa.array(rng.integers(-(2**62), 2**62, n)),  # type: ignore[misc]
            lambda n=n: pa.array([None] * n, rng.choice([pa.float64(), pa.int64(), pa.string(), pa.null()])),  # type: ignore[misc]
            lambda n=n: pa.array(rng.normal(size=n), mask=rng.random(n) < 0.3),  # type: ignore[misc]
            lambda n=n: pa.array([[1.0, 2.0]] * n),  # type: ignore[misc]
            lambda n=n: pa.array([{"x": 1.0}] * n),  # type: ignore[misc]
            lambda n=n: pa.array(rng.integers(0, 2**40, n)).cast(
                pa.timestamp(str(rng.choice(["s", "ms", "us", "ns"])))
            ),  # type: ignore[misc]
            lambda n=n: pa.array(rng.choice([0.0, np.inf, -np.inf, 1e308, 5e-324, np.nan], n)),  # type: ignore[misc]
            lambda n=n: pa.array(rng.choice(["a", "1.5"], n).tolist()).dictionary_encode(),  # type: ignore[misc]
            lambda n=n: pa.array([b"\x00\xff"] * n),  # type: ignore[misc]
            lambda n=n: pa.array(rng.integers(0, 2, n).astype(bool)),  # type: ignore[misc]
            lambda n=n: pa.array(rng.integers(0, 10**6, n)).cast(pa.decimal128(30, 3)),  # type: ignore[misc]
        ]
        if rng.random() < 0.3:
            name = str(rng.choice([*ODD_NAMES, *table.column_names, "\x1b[31m", "a" * 5000]))
        if rng.random() < 0.2 and table.num_columns > 1:
            table = table.remove_column(k)
        else:
            table = table.set_column(k, name, kinds[int(rng.integers(len(kinds)))]())
    stream = io.BytesIO()
    pq.write_table(table, stream, write_page_checksum=bool(rng.random() < 0.5), row_group_size=100)
    made = stream.getvalue()
    return of_bytes(rng, made) if rng.random() < 0.3 else made


def of_ulog(rng: Rng, data: bytes) -> bytes:
    """Change records of a ULog and make their lengths fit again."""
    out, at = [data[:16]], 16
    every = 1.0 / float(rng.choice([5, 50, 500]))
    while at + 3 <= len(data):
        length = struct.unpack_from("<H", data, at)[0]
        kind, body = data[at + 2 : at + 3], data[at + 3 : at + 3 + length]
        at += 3 + length
        if rng.random() < every:
            body = of_bytes(rng, body)[:65535]
        if rng.random() < 0.01:
            kind = bytes([int(rng.choice(list(b"FADBIMPQLCSORX")))])
        out.append(struct.pack("<H", len(body)) + kind + body)
    return b"".join(out)


def of_db3(rng: Rng, data: bytes) -> bytes:
    """Put other cells into the tables of a ROS 2 bag, by SQLite itself."""
    base = sqlite3.connect(":memory:")
    base.deserialize(data)
    cells: list[object] = [None, -1, 2**62, 1.5, "text", b"", b"\x00\x01\x00\x00", rng.bytes(400), "x" * 9000]
    for _ in range(int(rng.integers(1, 4))):
        table, column = [("topics", c) for c in ("id", "name", "type", "serialization_format")][int(rng.integers(4))]
        if rng.random() < 0.6:
            table, column = "messages", str(rng.choice(["topic_id", "timestamp", "data"]))
        value = cells[int(rng.integers(len(cells)))]
        try:
            base.execute(f"UPDATE {table} SET {column} = ? WHERE rowid % 7 = ?", (value, int(rng.integers(7))))
            if rng.random() < 0.1:
                base.execute(f"ALTER TABLE {table} RENAME COLUMN {column} TO odd")
        except sqlite3.Error:
            continue
    base.commit()
    return base.serialize()


STRUCTURED: dict[str, Mutate] = {
    "csv": of_text, "mcap": of_mcap, "parquet": of_parquet, "ulog": of_ulog, "db3": of_db3,
}  # fmt: skip


def case(reader: str, whole: Sequence[bytes], seed: int, number: int) -> bytes:
    """Return the bytes of a case."""
    rng = np.random.default_rng([seed, number])
    data = whole[int(rng.integers(len(whole)))]
    if reader in STRUCTURED and rng.random() < 0.7:
        data = STRUCTURED[reader](rng, data)
        return of_bytes(rng, data) if rng.random() < 0.1 else data
    return of_bytes(rng, data)
