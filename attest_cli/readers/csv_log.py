"""CSV logs: dialect, header and units row are told from the first lines, the numbers are read by Arrow."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pv

from ..errors import AttestError
from ..records import Array, Bools, Ints, Recording, Warn
from ..settings import Settings
from . import stamps
from .columns import is_unit
from .tables import NAMES_HINT, Layout, check_size, layout_of, recording_of

HEAD_BYTES = 1 << 16
DELIMITERS = (",", ";", "\t")
BLANKS = ["", "NaN", "nan", "NAN", "-nan", "NA", "N/A", "n/a", "#N/A", "null", "NULL", "None", "--", "-"]
MAX_BAD_SHARE = 0.01
"""Above this share of rows that cannot be read the file is refused: it is not the table it seems to be."""

_NUMBER = re.compile(r"\s*[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?\s*|\s*[-+]?(nan|inf(inity)?)\s*", re.IGNORECASE)
_DATE = re.compile(r"\s*\d{4}-\d\d-\d\d([T ]\d\d:\d\d.*)?")


@dataclass(frozen=True, slots=True)
class Dialect:
    """How a text table is written: ``skip`` lines stand before its first row of numbers."""

    delimiter: str
    decimal: str
    skip: int
    names: list[str]
    units: list[str]
    first: list[str]


def read(path: Path, settings: Settings) -> Recording:  # noqa: ARG001 (every reader has this signature)
    """Read a text table into channels; see ``readers.read``."""
    dialect = sniff(path)
    layout = layout_of(path, dialect.names, dialect.units)
    bad: list[tuple[int | None, str]] = []
    table, told = _table(path, dialect, layout, bad)
    check_size(path, table.num_rows, table.num_columns)
    if table.num_rows == 0:
        raise AttestError(f"{path}: the table has no rows", "was the recording empty?")
    if len(bad) > MAX_BAD_SHARE * (table.num_rows + len(bad)) and len(bad) > 1:
        message = f"{path}: {len(bad)} rows have not the {len(dialect.names)} cells of the header: {bad[0][1][:60]!r}"
        raise AttestError(message, "make it one table with one header")
    if bad:
        cells = f"{len(dialect.names)} cells, the first: {bad[0][1][:60]!r}"
        message = f"{path.name}: {len(bad)} rows skipped that have not {cells}"
        told = (*told, Warn("ragged-rows", message, "mend or delete these lines"))
    values = {
        column.index: np.asarray(table.column(str(column.index)).to_numpy(), np.float64) for column in layout.columns
    }
    time = table.column(str(layout.time.index))
    return recording_of(path, "csv", layout, values, lambda rows: _stamps(path, dialect, layout, time, rows), told)


def sniff(path: Path) -> Dialect:
    """Find delimiter, header, units row and the first row of numbers in the first lines of a file.

    Raises
    ------
    AttestError
        If there is no row of numbers, or no header above it.
    """
    with path.open("rb") as stream:
        raw = stream.read(HEAD_BYTES)
        cut = bool(stream.read(1))
    try:
        text = raw.decode("utf-8-sig", "ignore" if cut else "strict")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    lines = text.splitlines()[: -1 if cut else None]
    for number, line in enumerate(lines):
        for delimiter in DELIMITERS:
            cells = _cells(line, delimiter)
            if _is_data(cells):
                names, units = _header(path, lines[:number], delimiter, len(cells))
                decimal = (
                    "," if delimiter == ";" and any(re.fullmatch(r"\s*-?\d+,\d+\s*", cell) for cell in cells) else "."
                )
                return Dialect(delimiter, decimal, number, names, units, cells)
    columns = max((len(_cells(line, delimiter)) for line in lines for delimiter in DELIMITERS), default=0)
    if columns > 1:
        raise AttestError(f"{path}: a header but no row of numbers", "was the recording empty?")
    raise AttestError(f"{path}: not a table: no line with numbers between commas, semicolons or tabs", NAMES_HINT)


def _cells(line: str, delimiter: str) -> list[str]:
    return next(csv.reader([line.replace("\x00", "")], delimiter=delimiter), [])


def _is_data(cells: list[str]) -> bool:
    """Tell whether most of the filled cells are numbers; a line of text with a number or two is a preamble."""
    filled = [cell for cell in cells if cell.strip() and cell.strip() not in BLANKS]
    numbers = sum(bool(_NUMBER.fullmatch(cell) or _DATE.fullmatch(cell)) for cell in filled)
    return len(cells) > 1 and numbers > 0 and numbers > 0.6 * len(filled) and bool(cells[0].strip() or len(filled) > 1)


def _header(path: Path, above: list[str], delimiter: str, count: int) -> tuple[list[str], list[str]]:
    """Take the last line of the right length above the numbers, or the last but one if that names units only."""
    rows = [_cells(re.sub(r"^\s*(#|//|%)\s*", "", line), delimiter) for line in above if line.strip()]
    units = [""] * count
    if rows and len(rows[-1]) == count and len(rows) > 1 and any(rows[-1]) and all(is_unit(cell) for cell in rows[-1]):
        units = rows.pop()
    if not rows or len(rows[-1]) != count:
        raise AttestError(f"{path}: no header above the {count} columns of numbers", NAMES_HINT)
    if not rows[-1][0].strip():
        raise AttestError(f"{path}: the header takes several rows", "give every column its whole name in one row")
    return [name.strip() for name in rows[-1]], units


def _table(
    path: Path, dialect: Dialect, layout: Layout, bad: list[tuple[int | None, str]]
) -> tuple[pa.Table, tuple[Warn, ...]]:
    """Read the columns in use as float64, time as text; cells of text become blank and are counted."""
    try:
        return _arrow(path, dialect, layout, bad, pa.float64()), ()
    except pa.ArrowInvalid:
        bad.clear()
    try:
        table = _arrow(path, dialect, layout, bad, pa.string())
    except (pa.ArrowInvalid, OSError) as error:
        raise AttestError(
            f"{path}: cannot be read: {str(error).splitlines()[0]}", "is it one table in UTF-8?"
        ) from None
    told = []
    for column in layout.columns:
        text = table.column(str(column.index))
        if dialect.decimal == ",":
            text = pc.replace_substring(text, ",", ".")
        number = pc.fill_null(pc.match_substring_regex(text, rf"(?i)^({_NUMBER.pattern})$"), fill_value=False)
        wrong = pc.filter(text, pc.and_(pc.is_valid(text), pc.invert(number)))
        if len(wrong) > MAX_BAD_SHARE * table.num_rows and len(wrong) > 1:
            message = (
                f"{path}: column {column.name!r} holds text in {len(wrong)} rows, the first: {wrong[0].as_py()[:40]!r}"
            )
            raise AttestError(message, "only numbers and blanks can stand there")
        if len(wrong):
            cells = f"{len(wrong)} cells of {column.name!r}"
            message = f"{path.name}: {cells} are no numbers and count as blank: {wrong[0].as_py()[:40]!r}"
            told.append(Warn("text-cells", message, "mend these cells"))
        numbers = pc.cast(pc.utf8_trim_whitespace(pc.if_else(number, text, pa.scalar(None, pa.string()))), pa.float64())
        table = table.set_column(table.schema.get_field_index(str(column.index)), str(column.index), numbers)
    return table, tuple(told)


def _arrow(
    path: Path, dialect: Dialect, layout: Layout, bad: list[tuple[int | None, str]], kind: pa.DataType
) -> pa.Table:
    """Let Arrow read the columns in use; rows with a wrong number of cells are noted in ``bad``."""

    def skip(row: Any) -> str:
        if not row.text.lstrip().startswith("#"):
            bad.append((row.number, row.text))
        return "skip"

    numbers = [str(column.index) for column in layout.columns]
    time = str(layout.time.index)
    return pv.read_csv(
        path,
        pv.ReadOptions(skip_rows=dialect.skip, column_names=[str(k) for k in range(len(dialect.names))]),
        pv.ParseOptions(delimiter=dialect.delimiter, invalid_row_handler=skip),
        pv.ConvertOptions(
            include_columns=[time, *numbers],
            column_types={time: pa.string(), **dict.fromkeys(numbers, kind)},
            null_values=BLANKS,
            strings_can_be_null=True,
            decimal_point=dialect.decimal,
        ),
    )


def _stamps(
    path: Path, dialect: Dialect, layout: Layout, column: pa.ChunkedArray, imu_rows: Bools
) -> tuple[Ints, Array, tuple[Warn, ...]]:
    if dialect.decimal == ",":
        column = pc.replace_substring(column, ",", ".")
    if _DATE.fullmatch(dialect.first[layout.time.index]):
        return (*stamps.from_dates(stamps.parse_dates(column, path)), ())
    unit, told = layout.time.unit, tuple[Warn, ...]()
    if unit not in stamps.DIGITS:
        number = pc.match_substring_regex(column, stamps.NUMBER)
        raw = np.asarray(
            pc.cast(pc.if_else(number, column, pa.scalar(None, pa.string())), pa.float64()).to_numpy(), np.float64
        )
        rows = imu_rows if np.any(imu_rows) else ~imu_rows
        unit, told = stamps.guess_unit(raw[rows], imu=bool(np.any(imu_rows)), path=path)
    return (*stamps.from_text(column, unit, path), told)
