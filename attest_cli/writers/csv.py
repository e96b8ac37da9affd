"""Track to CSV: ``# key: value`` lines, a header, numbers with all their digits, blank where there is none."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import pyarrow as pa
import pyarrow.csv as pv

from . import Blocks
from .files import arrow_table, atomic_write


def write(blocks: Blocks, metadata: Mapping[str, str], path: Path) -> None:
    """Write a track; see ``writers``."""
    write_text((arrow_table(block) for block in blocks), path, comments=comment_lines(metadata))


def comment_lines(metadata: Mapping[str, str]) -> list[str]:
    """Return metadata as comment lines; a line break in a value cannot start a line of its own."""
    return [f"# {key}: {' '.join(str(value).split())}" for key, value in metadata.items()]


def write_text(
    tables: Iterable[pa.Table], path: Path, comments: list[str], delimiter: str = ",", header: bool = True
) -> None:
    """Write tables as text, whole or not at all, names above where ``header``. NaN is blank; no cell needs quotes."""
    options = pv.WriteOptions(include_header=False, delimiter=delimiter, quoting_style="none")
    with atomic_write(path) as temporary, temporary.open("wb") as stream:
        for number, table in enumerate(tables):
            if number == 0:
                lines = [*comments, delimiter.join(table.column_names)] if header else comments
                stream.write("".join(f"{line}\n" for line in lines).encode())
            pv.write_csv(
                pa.table({name: _nan_to_null(table.column(name)) for name in table.column_names}), stream, options
            )


def _nan_to_null(column: pa.ChunkedArray) -> pa.Array | pa.ChunkedArray:
    return pa.array(column.to_numpy(), from_pandas=True) if pa.types.is_floating(column.type) else column
