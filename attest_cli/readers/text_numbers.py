"""Numbers as text tables write them, with a decimal mark and perhaps thousands separators -> plain digits."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from ..records import Warn

BETWEEN = "'’ \u00a0\u2009\u202f"
"""Separators of thousands that are no decimal mark."""
GROUPED: Mapping[str, str] = {
    mark: rf"^\s*[-+]?\d{{1,3}}(?:(?:[{BETWEEN}]\d{{3}})+|(?:[{other}]\d{{3}})+)(?:[{mark}]\d*)?\s*$"
    for mark, other in ((".", ","), (",", "."))
}
"""Decimal mark -> a number whose thousands are set apart."""


def plain(column: pa.ChunkedArray, decimal: str) -> tuple[pa.ChunkedArray, tuple[int, str]]:
    """Return text with a decimal point and no thousands separators; how many cells had such, and the first of them.

    A cell with a point that is neither, where the decimal mark is a comma, is no number any more.
    """
    grouped = pc.fill_null(pc.match_substring_regex(column, GROUPED[decimal]), fill_value=False)
    count, first = int(pc.sum(grouped).as_py() or 0), ""
    if count:
        first = next(cell.as_py() for cell in pc.filter(column, grouped)).strip()
        other = "," if decimal == "." else "."
        column = pc.if_else(grouped, pc.replace_substring_regex(column, rf"[{other}{BETWEEN}]", ""), column)
    if decimal == ",":
        column = pc.replace_substring(pc.replace_substring(column, ".", "_"), ",", ".")
    return column, (count, first)


def told_grouped(path: Path, name: str, grouped: tuple[int, str]) -> tuple[Warn, ...]:
    """Say how numbers with thousands separators were read."""
    count, first = grouped
    if not count:
        return ()
    message = f"{path.name}: {count} cells of {name!r} have thousands separators, such as {first!r}: read without them"
    return (Warn("thousands-separators", message, "export plain numbers, if that is not what they are"),)
