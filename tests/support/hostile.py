"""Files that are small and claim, or unpack to, far more; and attest run as a process of its own, with limits."""

from __future__ import annotations

import os
import resource
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MCAP = b"\x89MCAP0\r\n"
HEADER = b"\x01" + struct.pack("<Q", 8) + bytes(8)


@dataclass(frozen=True)
class Ended:
    """How a process ended: exit code, what it said, seconds, and the most memory it held, bytes."""

    code: int
    out: str
    err: str
    seconds: float
    memory: int


def run(
    *arguments: object, cwd: Path | None = None, env: Mapping[str, str] | None = None, kill_after: float | None = None,
    number: int = signal.SIGINT, limits: Mapping[int, int] | None = None, stdout: int | None = None,
) -> Ended:  # fmt: skip
    """Run one command line as a process; send it a signal after a while, or keep it within limits (``resource``)."""

    def limited() -> None:
        for what, most in (limits or {}).items():
            resource.setrlimit(what, (most, most))
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # a write that is too large is then an error, as on a full disk

    words = [sys.executable, "-m", "attest_cli", *map(str, arguments)]
    here = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1", **(env or {})}
    start = time.monotonic()
    done = subprocess.Popen(
        words, cwd=cwd, env=here, stdout=subprocess.PIPE if stdout is None else stdout, stderr=subprocess.PIPE,
        text=True, preexec_fn=limited,  # noqa: PLW1509 (nothing but system calls)
    )  # fmt: skip
    if kill_after is not None:
        time.sleep(kill_after)
        done.send_signal(number)
    out, err = done.communicate(timeout=120)
    memory = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024  # of the largest child so far
    return Ended(done.returncode, out or "", err, time.monotonic() - start, memory)


def zeros_in_zstd(count: int) -> bytes:
    """Zeros as a zstd frame that does not state its size, of blocks that repeat one byte."""
    size = 128 << 10
    blocks = [(size, False)] * (count // size - 1) + [(size, True)]
    body = b"".join(struct.pack("<I", int(last) | 1 << 1 | n << 3)[:3] + b"\x00" for n, last in blocks)
    return b"\x28\xb5\x2f\xfd" + b"\x00\x38" + body  # window of 128 kB


def zeros_in_lz4(count: int) -> bytes:
    """Zeros as an lz4 frame of blocks that are all alike."""
    import lz4.block
    import lz4.frame

    size = 64 << 10
    block = lz4.block.compress(bytes(size), store_size=False)
    head = lz4.frame.compress(b"x", block_linked=False, store_size=False)[:7]
    return head + (struct.pack("<I", len(block)) + block) * (count // size) + bytes(4)


def chunk(packed: bytes, stated: int, compression: bytes) -> bytes:
    """A chunk of MCAP that states to unpack to a size."""
    body = struct.pack("<QQQII", 0, 0, stated, 0, len(compression)) + compression
    body += struct.pack("<Q", len(packed)) + packed
    return b"\x06" + struct.pack("<Q", len(body)) + body


def messages(count: int) -> bytes:
    """Unpacked chunk of messages without content, on a channel of a type that is not read."""
    declared = struct.pack("<HHI", 1, 0, 2) + b"/x" + struct.pack("<I", 3) + b"cdr" + bytes(4)
    return (
        b"\x04"
        + struct.pack("<Q", len(declared))
        + declared
        + (b"\x05" + struct.pack("<QHIQQ", 22, 1, 0, 10**18, 10**18)) * count
    )


def _mcap_zstd(path: Path) -> None:
    packed = zeros_in_zstd(4 << 30)
    path.write_bytes(MCAP + HEADER + chunk(packed, 1000, b"zstd") + chunk(packed, 4 << 30, b"zstd"))


def _mcap_zstd_true(path: Path) -> None:
    path.write_bytes(MCAP + HEADER + chunk(zeros_in_zstd(500 << 20), 500 << 20, b"zstd") * 40)


def _mcap_messages(path: Path) -> None:
    import zstandard

    inside = messages(8_000_000)
    path.write_bytes(MCAP + HEADER + chunk(zstandard.compress(inside), len(inside), b"zstd") * 30)


def _mcap_lz4(path: Path) -> None:
    packed = zeros_in_lz4(2 << 30)
    path.write_bytes(MCAP + HEADER + chunk(packed, 4096, b"lz4") + chunk(packed, 400 << 20, b"lz4"))


def _mcap_lengths(path: Path) -> None:
    lies = b"".join(bytes([opcode]) + struct.pack("<Q", 1 << shift) for opcode in (3, 4, 5, 6, 7) for shift in (32, 62))
    inside = struct.pack("<HI", 1, 2**32 - 1) + b"a/B"
    path.write_bytes(MCAP + HEADER + b"\x03" + struct.pack("<Q", len(inside)) + inside + lies)


def _parquet(path: Path) -> None:
    """Forty million rows in a MB: the metadata states its bytes, not its numbers."""
    _table(path, 40)


def _parquet_below(path: Path) -> None:
    """As many rows as the limit lets pass."""
    _table(path, 9)


def _table(path: Path, millions: int) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    names = ("timestamp_ns", "gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")
    blanks = pa.nulls(10**6, pa.float64())
    table = pa.table(dict.fromkeys(names, blanks))
    with pq.ParquetWriter(path, table.schema, compression="zstd") as writer:
        for _ in range(millions):
            writer.write_table(table)


def _parquet_lengths(path: Path) -> None:
    path.write_bytes(b"PAR1" + bytes(64) + struct.pack("<I", 2**32 - 9) + b"PAR1")


def _csv_columns(path: Path) -> None:
    path.write_text(",".join(f"gyro_{k}" for k in range(300_000)) + "\n" + ("0," * 299_999 + "0\n") * 3)


def _csv_quote(path: Path) -> None:
    path.write_bytes(b't,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z\n0,"' + b"1,2,3\n" * (4 << 20))


def _csv_number(path: Path) -> None:
    head = b"t,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z\n"
    path.write_bytes(head + b"0," + b"9" * (8 << 20) + b",1,1,1,1,9.8\n" + b"1e99999999999,1,1,1,1,1,9.8\n" * 60)


def _ulog(path: Path) -> None:
    def record(kind: bytes, body: bytes) -> bytes:
        return struct.pack("<H", len(body)) + kind + body

    nested = [record(b"F", f"t{k}:uint64_t timestamp;t{k + 1}[200] x;".encode()) for k in range(40)]
    body = b"".join(nested) + record(b"F", b"sensor_combined:uint64_t timestamp;t0[65535] x;")
    path.write_bytes(
        b"ULog\x01\x12\x35\x01" + bytes(8) + record(b"B", bytes(40)) + body + record(b"A", b"\0\0\0sensor_combined")
    )


BOMBS: Mapping[str, Callable[[Path], None]] = {
    "zstd.mcap": _mcap_zstd, "zstd-true.mcap": _mcap_zstd_true, "messages.mcap": _mcap_messages, "lz4.mcap": _mcap_lz4,
    "lengths.mcap": _mcap_lengths, "rows.parquet": _parquet, "rows-below.parquet": _parquet_below,
    "lengths.parquet": _parquet_lengths, "columns.csv": _csv_columns, "quote.csv": _csv_quote,
    "number.csv": _csv_number, "nested.ulg": _ulog,
}  # fmt: skip
"""Name of a bomb -> what writes it."""


def leftovers(folder: Path, but: Sequence[Path] = ()) -> list[str]:
    """Names of everything in a folder that is neither named nor below one of those."""
    kept = {path.resolve() for path in but}
    found = [path for path in folder.rglob("*") if not ({path.resolve(), *path.resolve().parents} & kept)]
    return sorted(path.relative_to(folder).as_posix() for path in found)
