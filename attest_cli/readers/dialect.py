"""How a text table is written: delimiter, decimal mark, preamble, header, units row, told from its first lines."""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import AttestError
from ..settings.table import Table
from .columns import recognise
from .headers import Row, named

HEAD_BYTES = 1 << 16
NAMES = 3  # of columns that are known make a header
DELIMITERS = {"tab": "\t", ";": ";", ",": ",", "space": " "}
"""Name of a delimiter in the settings -> the delimiter, the least ambiguous first."""

BLANKS = ["", "NaN", "nan", "NAN", "-nan", "NA", "N/A", "n/a", "#N/A", "null", "NULL", "None", "--", "-"]
_DATE = r"(?P<a>\d{1,4})(?P<mark>[-/.])(?P<b>\d{1,2}|[A-Za-z]{3,9})[-/.](?P<c>\d{1,4})"
_CLOCK = r"(?:(?P<hour>\d{1,2}):)?(?P<minute>\d{1,3}):(?P<second>\d{2})(?:[.,](?P<fraction>\d+))?"
_BLANK = "[\\s\u00a0\u202f]?"  # Arrow's \s is ASCII only
_ZONE = rf"(?:{_BLANK}(?P<half>[AaPp])\.?{_BLANK}[Mm]\.?)?(?:\s?(?P<zone>Z|UTC|GMT|[-+]\d{{2}}(?::?\d{{2}})?))?"
TIME = re.compile(rf"^\s*(?:{_DATE}(?:T|,?\s+|$))?(?:{_CLOCK}{_ZONE})?\s*$")
"""A date, a time of day, or both."""
NUMBER = re.compile(r"\s*[-+]?(\d+(\.\d*|,\d+)?|[.,]\d+)([eE][-+]?\d+)?\s*|\s*[-+]?(nan|inf(inity)?)\s*", re.IGNORECASE)

BETWEEN = "'’ \u00a0\u2009\u202f"
"""Separators of thousands that are no decimal mark."""
_APART = f"[{BETWEEN}]"
_COMMA = re.compile(rf"\s*[-+]?(\d{{1,3}}((\.|{_APART})\d{{3}})+|\d*),\d+([eE][-+]?\d+)?\s*")
_POINT = re.compile(rf"\s*[-+]?((\d{{1,3}}((,|{_APART})\d{{3}})+|\d+)\.\d*|\.\d+)([eE][-+]?\d+)?\s*")
_THOUSANDS = re.compile(r"\s*[-+]?[1-9]\d{0,2}(,\d{3})+\s*")
_GROUPED = re.compile(rf"\s*[-+]?\d{{1,3}}([,.]\d{{3}}|{_APART}\d{{3}})+([.,]\d*)?\s*")
_COMMENT = re.compile(r"^\s*(#|//|%)\s*")
_RATE = re.compile(
    r"\b(?:update|sampl\w*|data|output)[ _]?(?:rate|frequency)\b\W{0,12}(\d+(?:\.\d+)?)\W{0,3}(k?hz)",
    re.IGNORECASE,
)
_MOST_TYPES, _FEWEST_ROWS = 12, 10  # rows of types tell themselves by few types in many rows
_EXAMPLE = "timestamp_ns,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z"


@dataclass(frozen=True, slots=True)
class Dialect:
    """How a text table is written: ``skip`` lines stand before its first row of numbers, which is ``first``.

    ``rate_hz``: samples per second as the preamble says; ``told``: all this in words.
    """

    delimiter: str
    decimal: str
    skip: int
    names: list[str]
    units: list[str]
    first: list[str]
    rate_hz: float | None = None
    told: str = ""


def sniff(path: Path, table: Table | None = None) -> Dialect:
    """Find delimiter, header, units row and the first row of numbers in the first lines of a file.

    Parameters
    ----------
    table : Table, optional
        Settings: what they state is not looked for.

    Raises
    ------
    AttestError
        If there is no row of numbers, no header above it, or more than one way to read them.
    """
    table = table or Table()
    lines = head_lines(path)
    delimiter, rows = layout(path, lines, table)
    skip, first = rows[0]
    above = [(n, cells_of(_COMMENT.sub("", line), delimiter)) for n, line in enumerate(lines[:skip]) if line.strip()]
    preamble = "\n".join(lines[:skip])
    if table.columns:
        if len(first) - len(table.columns) not in ((0, 1) if not first[-1].strip() else (0,)):
            message = f"{path}: {len(table.columns)} columns are named, but line {skip + 1} has {len(first)} cells"
            raise AttestError(message, 'name all of them with --columns, "-" for one that is not used')
        names = [*table.columns, *[""] * (len(first) - len(table.columns))]
        units, header = [""] * len(first), "columns as named"
    else:
        found = named(above, len(first) - (not first[-1].strip()), len(first))
        if found is None:
            raise _misfit(path, rows, above, delimiter) or _headless(path, rows, delimiter, table)
        names, units, header = found
    decimal = table.decimal or decimal_of(path, [cells for _, cells in rows])
    spoken = next(name for name, mark in DELIMITERS.items() if mark == delimiter)
    told = f"columns between {spoken!r}, decimal {'comma' if decimal == ',' else 'point'}, {header}"
    match = _RATE.search(preamble)
    rate = float(match[1]) * (1e3 if match[2].lower() == "khz" else 1.0) if match else 0.0
    return Dialect(delimiter, decimal, skip, names, units, first, rate or None, told)


def head_lines(path: Path) -> list[str]:
    """Read the first whole lines of a text file: UTF-8, with or without a mark, else Latin-1."""
    with path.open("rb") as stream:
        raw = stream.read(HEAD_BYTES)
        cut = bool(stream.read(1))
    try:
        text = codecs.getincrementaldecoder("utf-8-sig")().decode(raw, final=not cut)  # a character may be cut
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    lines = re.split(r"\r\n|\n|\r", text)  # as Arrow counts them: no other character ends a line
    return lines[: -1 if cut or not lines[-1] else None]


def layout(path: Path, lines: Sequence[str], table: Table) -> tuple[str, list[Row]]:
    """Choose the delimiter that makes most of the lines rows of numbers; return it and those rows with their line."""
    best: tuple[float, str, list[Row]] = (0.0, "", [])
    names = [table.delimiter] if table.delimiter else list(DELIMITERS)
    for delimiter in (DELIMITERS[name] for name in names):
        rows = [(n, cells) for n, line in enumerate(lines) if is_data(line, cells := cells_of(line, delimiter))]
        if rows:
            share = len(rows) / sum(bool(line.strip()) for line in lines[rows[0][0] :])
            if share > best[0] + 0.25:  # a later delimiter must be better by far
                best = (share, delimiter, rows)
    if best[2]:
        return best[1], best[2]
    widest = max((len(cells_of(line, mark)) for line in lines for mark in "\t;,"), default=0)
    if widest > 1:
        raise AttestError(f"{path}: a header but no row of numbers", "was the recording empty?")
    message = f"{path}: not a table: no line with numbers between commas, semicolons, tabs or blanks"
    raise AttestError(message, f"a log starts with a header such as {_EXAMPLE}")


def cells_of(line: str, delimiter: str) -> list[str]:
    """Split a line into cells; blanks in a row are one delimiter."""
    line = line.replace("\x00", "")
    if delimiter == " ":
        return line.split()
    try:
        return next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error:  # a cell beyond all measure
        return []


def is_data(line: str, cells: Sequence[str]) -> bool:
    """Tell whether most of the filled cells are numbers; a line of text with a number or two is a preamble."""
    if len(cells) < 2 or _COMMENT.match(line):
        return False
    filled = [cell for cell in cells if cell.strip() and cell.strip() not in BLANKS]
    numbers = sum(any(kind.fullmatch(cell) for kind in (NUMBER, TIME, _GROUPED)) for cell in filled)
    return numbers > 0 and numbers > 0.6 * len(filled) and bool(cells[0].strip() or len(filled) > 1)


def decimal_of(path: Path, rows: Sequence[Sequence[str]]) -> str:
    """Tell the decimal mark; what could be decimals or thousands is refused."""
    commas = [cell for row in rows for cell in row if _COMMA.fullmatch(cell)]
    comma = next((cell for cell in commas if not _THOUSANDS.fullmatch(cell)), None)
    point = next((cell for row in rows for cell in row if _POINT.fullmatch(cell)), None)
    if comma is None and commas and point is None:
        message = f"{path}: decimal comma or thousands? {commas[0].strip()!r} can be read in two ways"
        raise AttestError(message, 'say it in attest.toml: decimal = "," or "." under [table]')
    if comma is None:
        return "."
    if point is not None:
        message = f"{path}: decimal comma or point? There are both: {comma.strip()!r} and {point.strip()!r}"
        raise AttestError(message, 'say it in attest.toml: decimal = "," under [table]')
    return ","


def _misfit(path: Path, rows: Sequence[Row], above: Sequence[Row], delimiter: str) -> AttestError | None:
    """Say that there is a header of another width than the rows; None if there is none."""
    number, names = above[-1] if above else (0, [])
    if sum(recognise(0, name) is not None for name in names) < NAMES:
        return None
    line, cells = rows[0]
    message = f"{path}: line {number + 1} names {len(names)} columns, but line {line + 1} has {len(cells)} cells"
    if delimiter == "," and len(cells) > len(names) and _paired(rows):
        return AttestError(message, "are these decimal commas? Then export with semicolons or tabs")
    return AttestError(message, "give every column one name, and one only; or name them with --columns")


def _headless(path: Path, rows: Sequence[Row], delimiter: str, table: Table) -> AttestError:
    """Say that there is no header, and how to name the columns."""
    width = len(rows[0][1])
    for place in (0, 1):
        types = Counter(cells[place].strip() for _, cells in rows if len(cells) > place)
        widths = {len(cells) for _, cells in rows}
        letters = not any(NUMBER.fullmatch(name) for name in types)
        few = 1 < len(types) <= _MOST_TYPES and len(rows) >= _FEWEST_ROWS
        if few and (letters or (place == 0 and len(widths) > 1)):
            some = ", ".join(f"{name[:12]!r}" for name in sorted(types))
            message = f"{path}: no header, and rows of {len(types)} types ({some})"
            first = "type,t [ms]" if place == 0 else "t [ms],type"
            way = f"--columns '{min(types)}:{first},gyro_x [rad/s],gyro_y,gyro_z'"
            return AttestError(message, f"name the columns of each type: {way}")
    message = f"{path}: no header above the {width} columns of numbers"
    doubled = delimiter == "," and table.delimiter is None and width % 2 == 0
    more = "; are these decimal commas? Then export with semicolons or tabs" if doubled and _paired(rows) else ""
    return AttestError(message, f"name them in order: --columns {_EXAMPLE}{more}")


def _paired(rows: Sequence[Row]) -> bool:
    """Tell whether all cells are whole numbers or blank, as decimals cut in two at their comma are."""
    return all(re.fullmatch(r"\s*(-?\d+)?\s*", cell) for _, cells in rows[:50] for cell in cells)
