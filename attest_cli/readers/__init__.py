"""Readers: a file -> ``Recording``, chosen by its first bytes, then by its suffix. Modules are imported on use."""

from __future__ import annotations

import difflib
import importlib
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from ..errors import AttestError
from ..records import Recording, Warn
from ..settings import Settings
from ..settings.table import Table

READERS: Mapping[str, str] = {
    "csv": "attest_cli.readers.csv_log",
    "parquet": "attest_cli.readers.parquet_log",
    "mcap": "attest_cli.readers.mcap_log",
    "ulog": "attest_cli.readers.ulog_log",
    "bag": "attest_cli.readers.bag_log",
    "db3": "attest_cli.readers.bag_log",
}
"""Format -> module with ``read(path, settings) -> Recording``."""

MAGIC: Mapping[bytes, str] = {
    b"\x89MCAP0\r\n": "mcap", b"PAR1": "parquet", b"ULog\x01\x12\x35": "ulog", b"#ROSBAG V2.0\n": "bag",
    b"SQLite format 3\x00": "db3",
}  # fmt: skip
"""First bytes of a file -> format."""

SUFFIXES: Mapping[str, str] = {
    ".csv": "csv", ".tsv": "csv", ".txt": "csv", ".parquet": "parquet", ".pq": "parquet", ".mcap": "mcap",
    ".ulg": "ulog", ".bag": "bag", ".db3": "db3",
}  # fmt: skip
"""Suffix -> format, where the first bytes do not tell."""

UNREADABLE: Mapping[bytes, tuple[str, str]] = {
    b"#ROSBAG V": ("a bag of an old version of ROS 1", "convert it with rosbag fix or rosbags-convert"),
    b"PK\x03\x04": ("a zip archive or spreadsheet", "unpack it, or save the sheet as CSV"),
    b"\x1f\x8b": ("a gzip file", "unpack it with gunzip"),
    b"\x28\xb5\x2f\xfd": ("a zstd file", "unpack it with zstd -d"),
    b"\xff\xfe": ("UTF-16 text", "save it as UTF-8"),
    b"\xfe\xff": ("UTF-16 text", "save it as UTF-8"),
}
"""First bytes of files that people hand in -> what they are, and the way out."""


def format_of(path: Path) -> str:
    """Tell the format of a log: by its first bytes, then by its suffix.

    Raises
    ------
    AttestError
        If the file is missing, a folder, empty, not readable, or of no format that attest reads.
    """
    head = _first_bytes(path)
    for magic, name in MAGIC.items():
        if head.startswith(magic):
            return name
    for magic, (what, way_out) in UNREADABLE.items():
        if head.startswith(magic):
            raise AttestError(f"{path}: this is {what}, which attest does not read", way_out)
    expected = SUFFIXES.get(path.suffix.lower(), "csv")
    if expected != "csv":
        raise AttestError(
            f"{path}: not {expected.upper()}: its first bytes are {head[:8]!r}", "is the file damaged or misnamed?"
        )
    if b"\x00" in head:
        raise AttestError(f"{path}: neither MCAP, Parquet nor text", f"attest reads {', '.join(READERS)}")
    return expected


def read(path: Path, settings: Settings) -> Recording:
    """Read every channel of interest of one log.

    Parameters
    ----------
    path : Path
        CSV, Parquet, MCAP, PX4 ULog, ROS 1 bag or ROS 2 db3.
    settings : Settings
        ``time.source``: which stamp of a message counts; ``table``: how a table is written.

    Returns
    -------
    Recording
        Channels with stamps in int64 ns and values in the units that the file states.

    Raises
    ------
    AttestError
        For every fault of the file, in one line.
    """
    name = format_of(path)
    reader = importlib.import_module(READERS[name])
    recording: Recording = reader.read(path, settings)
    told = _unused_table(path, name, settings.table)
    return replace(recording, warnings=(*recording.warnings, *told)) if told else recording


def _unused_table(path: Path, name: str, table: Table) -> tuple[Warn, ...]:
    """Say which settings of tables do nothing for this file."""
    if name == "parquet" and (table.rows or table.delimiter or table.decimal):
        message = f"{path.name}: Parquet is no text: types of rows, delimiter and decimal mark do nothing for it"
        return (Warn("no-text-log", message, '--columns "OLD=gyro_x [rad/s],..." gives its columns other names'),)
    if name not in {"csv", "parquet"} and table != Table():
        message = f"{path.name}: no table: --columns, --time-unit, --sample-rate and [table] do nothing for it"
        return (Warn("no-text-log", message, "convert it to CSV with attest convert, if its columns need other names"),)
    return ()


def _first_bytes(path: Path) -> bytes:
    try:
        with path.open("rb") as stream:
            head = stream.read(4096)
    except FileNotFoundError:
        raise AttestError(f"{path}: no such file", _nearby(path)) from None
    except IsADirectoryError:
        raise AttestError(*_folder(path)) from None
    except OSError as error:
        raise AttestError(f"{path}: cannot be read: {error.strerror}") from None
    if not head:
        raise AttestError(f"{path}: the file is empty", "was the recording or the copy cut short?")
    return head


def _folder(path: Path) -> tuple[str, str]:
    """Say what to name instead of a folder; ROS 2 keeps a bag in one."""
    names = sorted(entry.name for entry in path.iterdir()) if os.access(path, os.R_OK) else []
    what = "the folder of a ROS 2 bag" if "metadata.yaml" in names else "a folder"
    logs = [str(path / name) for name in names if Path(name).suffix.lower() in {".db3", ".mcap", ".bag"}]
    more = f" and {len(logs) - 4} more" if len(logs) > 4 else ""
    return (
        f"{path}: this is {what}",
        f"name its files: {' '.join(logs[:4])}{more}" if logs else "name the log file itself",
    )


def _nearby(path: Path) -> str:
    """Name the file in the same folder that was probably meant."""
    readable = path.parent.is_dir() and os.access(path.parent, os.R_OK)
    names = [entry.name for entry in path.parent.iterdir()] if readable else []
    near = difflib.get_close_matches(path.name, names, n=1)
    return f"did you mean {path.parent / near[0]}?" if near else "check the name"
