"""Arrow columns as NumPy arrays, from their own memory: ``to_numpy`` would import pandas wherever that is installed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray


def is_number(kind: pa.DataType) -> bool:
    """Return whether ``numbers`` reads columns of this type."""
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind))


def numbers(column: pa.ChunkedArray) -> NDArray[Any]:
    """Return a column of numbers or booleans (n,); with nulls, integers become float64, and nulls NaN."""
    kind = np.dtype(column.type.to_pandas_dtype())
    blanks = column.null_count > 0
    parts = [_values(chunk, kind, blanks=blanks) for chunk in column.chunks]
    return parts[0] if len(parts) == 1 else np.concatenate([np.empty(0, kind), *parts])


def _values(chunk: pa.Array, kind: np.dtype[Any], *, blanks: bool) -> NDArray[Any]:
    valid, data = chunk.buffers()
    bits = kind.kind == "b"
    values = _bits(data, chunk) if bits else np.frombuffer(data, kind, len(chunk), chunk.offset * kind.itemsize)
    if not blanks:
        return values
    known = np.ones(len(chunk), np.bool_) if valid is None else _bits(valid, chunk)
    return np.where(known, values if kind.kind == "f" else values.astype(np.float64), np.nan)


def _bits(buffer: pa.Buffer, chunk: pa.Array) -> NDArray[np.bool_]:
    packed, skipped = np.frombuffer(buffer, np.uint8)[chunk.offset // 8 :], chunk.offset % 8
    return np.unpackbits(packed, count=skipped + len(chunk), bitorder="little")[skipped:].astype(np.bool_)
