"""Files that are whole or absent: temporary name in the same folder, flush, rename. Tables for Parquet and CSV."""

from __future__ import annotations

import csv
import math
import os
import secrets
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from ..errors import AttestError

ZSTD_LEVEL = -3  # a fifth of the time of level 1 less for 2 % more bytes: split floats hardly pack
_FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Give a temporary name to write to; it becomes ``path`` when all went well and is removed when anything did not.

    Raises
    ------
    AttestError
        If the file cannot be written: no room, no permission.
    """
    temporary = path.with_name(f".{path.name[:100]}.{os.getpid()}.{secrets.token_hex(4)}.tmp")
    try:
        yield temporary
        with temporary.open("rb+") as stream:
            os.fsync(stream.fileno())
        temporary.replace(path)
    except OSError as error:
        hint = "make its folder first" if isinstance(error, FileNotFoundError) else "is there room, and is it yours?"
        why = os.strerror(error.errno) if error.errno else error
        raise AttestError(f"{path}: cannot be written: {why}", hint) from None
    finally:  # an interrupt leaves nothing behind either
        temporary.unlink(missing_ok=True)


def check_output(path: Path, *, overwrite: bool = False, inputs: Sequence[Path] = ()) -> None:
    """Refuse an output that exists, that is one of the inputs, or whose place cannot be written to.

    Raises
    ------
    AttestError
        With the way out.
    """
    for log in inputs:
        if path.exists() and log.exists() and path.samefile(log):
            raise AttestError(f"{path}: output and input are the same file", "choose another name with -o")
    if path.is_symlink() and not path.exists():
        raise AttestError(f"{path}: a link to {path.readlink()}, which does not exist", "choose another name with -o")
    filled = path.exists() and (not path.is_dir() or any(path.iterdir()))
    if filled and not overwrite:
        raise AttestError(f"{path}: exists already", "--overwrite replaces it, -o chooses another place")
    folder = path if path.is_dir() else path.parent
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    if not folder.is_dir():
        raise AttestError(f"{path}: {folder} is not a folder", "choose another name with -o")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise AttestError(f"{path}: folder {folder} cannot be written to", "choose another place with -o")


def arrow_array(column: NDArray[Any]) -> pa.Array:
    """Make an Arrow array of numbers, booleans or text (n,); NaN stays NaN.

    Of its own memory where it can be: ``pa.array`` would import pandas wherever that is installed.
    """
    if column.dtype.kind in "UO":
        return _text_array([str(text).encode() for text in column.tolist()])
    held = np.packbits(column, bitorder="little") if column.dtype.kind == "b" else np.ascontiguousarray(column)
    return pa.Array.from_buffers(pa.from_numpy_dtype(column.dtype), len(column), [None, pa.py_buffer(held)])


def _text_array(texts: list[bytes]) -> pa.Array:
    ends = np.concatenate([[0], np.cumsum([len(text) for text in texts])]).astype(np.int32)
    return pa.StringArray.from_buffers(len(texts), pa.py_buffer(ends), pa.py_buffer(b"".join(texts)))


def arrow_table(columns: Mapping[str, NDArray[Any]], metadata: Mapping[str, str] | None = None) -> pa.Table:
    """Make an Arrow table of columns (n,) of numbers, booleans or text, and (n, k) of floats as lists of fixed size."""
    arrays = {}
    for name, column in columns.items():
        if column.ndim == 2:
            arrays[name] = pa.FixedSizeListArray.from_arrays(arrow_array(column.ravel()), column.shape[1])
        else:
            arrays[name] = arrow_array(column)
    table = pa.table(arrays)
    return table.replace_schema_metadata(dict(metadata)) if metadata else table


def write_table(columns: Mapping[str, NDArray[Any]], path: Path, metadata: Mapping[str, str] | None = None) -> None:
    """Write columns to Parquet, zstd, floats split by byte; text in ``metadata`` goes to the schema."""
    write_arrow([arrow_table(columns, metadata)], path)


def write_arrow(tables: Iterable[pa.Table], path: Path) -> None:
    """Write Arrow tables of one schema to Parquet, a row group each, with page checksums, whole or not at all."""
    parts = iter(tables)
    first = next(parts)
    encodings, texts, stamps = dict[str, str](), list[str](), list[str]()
    for field in first.schema:
        if pa.types.is_fixed_size_list(field.type):
            encodings[f"{field.name}.list.element"] = "BYTE_STREAM_SPLIT"
        elif pa.types.is_floating(field.type):
            encodings[field.name] = "BYTE_STREAM_SPLIT"
        elif pa.types.is_int64(field.type):
            encodings[field.name] = "DELTA_BINARY_PACKED"
            stamps.append(field.name)
        elif pa.types.is_string(field.type):
            texts.append(field.name)
    how: dict[str, Any] = {"compression": "zstd", "use_dictionary": texts, "column_encoding": encodings}
    how["compression_level"] = ZSTD_LEVEL
    how["write_statistics"] = stamps  # a query in time skips row groups by them; of other columns nobody asks
    with (
        atomic_write(path) as temporary,
        pq.ParquetWriter(temporary, first.schema, write_page_checksum=True, **how) as writer,
    ):
        for table in chain([first], parts):
            writer.write_table(table)


def write_csv_rows(rows: Sequence[Mapping[str, Any]], path: Path, columns: Sequence[str] | None = None) -> None:
    """Write dictionaries as CSV: None and NaN are blank, floats have all their digits, text is safe for a spreadsheet.

    Parameters
    ----------
    columns : sequence of str, optional
        Header; the keys of the first row if not given.
    """
    header = list(columns if columns is not None else rows[0] if rows else ())
    with atomic_write(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(header)
        writer.writerows([_cell(row.get(name)) for name in header] for row in rows)


def _cell(value: Any) -> str:
    """Spell a cell; text that a spreadsheet would run as a formula gets an apostrophe (CWE-1236)."""
    if value is None or (isinstance(value, float | np.floating) and math.isnan(value)):
        return ""
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if isinstance(value, float | np.floating):
        return repr(float(value))
    if isinstance(value, int | np.integer):
        return str(int(value))
    text = str(value)
    return f"'{text}" if text.startswith(_FORMULA_STARTS) else text
