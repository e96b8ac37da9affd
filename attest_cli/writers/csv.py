"""Track to CSV: ``# key: value`` lines, a header, numbers with all their digits, blank where there is none."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.csv as pv
from numpy.typing import NDArray

from .files import arrow_table, atomic_write


def write(columns: Mapping[str, NDArray[Any]], metadata: Mapping[str, str], path: Path) -> None:
    """Write a track; see ``writers``."""
    write_text(arrow_table(columns), path, header=list(columns), comments=comment_lines(metadata))


def comment_lines(metadata: Mapping[str, str]) -> list[str]:
    """Return metadata as comment lines; a line break in a value cannot start a line of its own."""
    return [f"# {key}: {' '.join(str(value).split())}" for key, value in metadata.items()]


def write_text(table: pa.Table, path: Path, header: list[str], comments: list[str], delimiter: str = ",") -> None:
    """Write a table as text, whole or not at all; an empty header writes none. NaN is blank; no cell needs quotes."""
    blank = {name: _nan_to_null(table.column(name)) for name in table.column_names}
    options = pv.WriteOptions(include_header=False, delimiter=delimiter, quoting_style="none")
    with atomic_write(path) as temporary, temporary.open("wb") as stream:
        lines = [*comments, delimiter.join(header)] if header else comments
        stream.write("".join(f"{line}\n" for line in lines).encode())
        pv.write_csv(pa.table(blank), stream, options)


def _nan_to_null(column: pa.ChunkedArray) -> pa.Array | pa.ChunkedArray:
    return pa.array(column.to_numpy(), from_pandas=True) if pa.types.is_floating(column.type) else column
