"""Numbers as text tables write them, with a decimal mark and perhaps thousands separators -> plain digits."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from ..errors import AttestError
from ..records import Warn
from .dialect import BETWEEN

GROUPED: Mapping[str, str] = {
    mark: rf"^\s*[-+]?[1-9]\d{{0,2}}(?:(?:[{BETWEEN}]\d{{3}})+|(?:[{other}]\d{{3}})+)(?:[{mark}]\d*)?\s*$"
    for mark, other in ((".", ","), (",", "."))
}
"""Decimal mark -> a number whose thousands are set apart."""

UNCLEAR = r"^\s*[-+]?\d{1,3}[.,]\d{3}\s*$"
"""One group of thousands, or three decimals."""
DECIMALS = r"^\s*[-+]?\d*[.,]\d+([eE][-+]?\d+)?\s*$"


def plain(path: Path, name: str, column: pa.ChunkedArray, decimal: str) -> tuple[pa.ChunkedArray, tuple[Warn, ...]]:
    """Return text with a decimal point and no thousands separators, and say how many cells had such.

    A cell with a point that is neither, where the decimal mark is a comma, is no number any more.

    Raises
    ------
    AttestError
        If every cell that looks like thousands has one group, as three decimals have, and other cells have decimals.
    """
    grouped = pc.fill_null(pc.match_substring_regex(column, GROUPED[decimal]), fill_value=False)
    count, told = int(pc.sum(grouped).as_py() or 0), tuple[Warn, ...]()
    if count:
        first = pc.filter(column, grouped)[0].as_py().strip()
        _refuse_unclear(path, name, column, grouped, first)
        other = "," if decimal == "." else "."
        column = pc.if_else(grouped, pc.replace_substring_regex(column, rf"[{other}{BETWEEN}]", ""), column)
        message = f"{path.name}: {count} cells of {name!r} have thousands separators, such as {first!r}"
        hint = "export plain numbers, if that is not what they are"
        told = (Warn("thousands-separators", f"{message}: read without them", hint),)
    if decimal == ",":
        column = pc.replace_substring(pc.replace_substring(column, ".", "_"), ",", ".")
    return column, told


def _refuse_unclear(path: Path, name: str, column: pa.ChunkedArray, grouped: pa.ChunkedArray, first: str) -> None:
    """Refuse 9,810 beside 9.774, or beside 0,123: the decimal mark changes within the column."""
    if not pc.all(pc.match_substring_regex(pc.filter(column, grouped), UNCLEAR)).as_py():
        return
    others = pc.filter(column, pc.and_(pc.invert(grouped), pc.match_substring_regex(column, DECIMALS)))
    if len(others):
        other = others[0].as_py().strip()
        message = f"{path}: column {name!r}: decimals or thousands? There are both {first!r} and {other!r}"
        raise AttestError(message, "write all of its numbers with the same decimal mark, without thousands separators")
