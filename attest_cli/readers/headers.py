"""Header rows above a table -> one name per column: a units row, or names over two or three rows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from .columns import is_unit

MOST_ROWS = 4
"""Rows a header can take."""

Row = tuple[int, list[str]]  # line number from 0, cells


def named(above: Sequence[Row], least: int, width: int) -> tuple[list[str], list[str], str] | None:
    """Return a name and a unit for each of ``width`` columns, and where they stand; None if there is no header.

    Parameters
    ----------
    above : rows above the first row of numbers, without comment marks
    least : int
        Columns without one that a delimiter at the end of each row makes.

    Notes
    -----
    Names that are blank or not distinct take what stands above them: the merged cells of a spreadsheet
    (``Accelerometer,,,`` over ``X,Y,Z``). Names that come again for the next sensor take the label of its block.
    """
    levels: list[Row] = []
    for number, cells in reversed([row for row in above if any(cell.strip(" -=+|") for cell in row[1])]):
        fitted = _fitted(cells, least, width)
        if fitted is None or len(levels) == MOST_ROWS:
            break
        levels.append((number, fitted))
    units, told = [""] * width, "no units"
    if len(levels) > 1 and any(levels[0][1]) and all(is_unit(cell) for cell in levels[0][1]):
        number, units = levels.pop(0)
        told = f"units in line {number + 1}"
    if not levels:
        return None
    last, names = levels[0]
    top = last
    for number, upper in levels[1:]:
        if not _unclear(names):
            break
        names = _under(upper, names) if _axes(names) else _in_blocks(upper, names)
        top = number
    lines = f"line {last + 1}" if top == last else f"lines {top + 1} to {last + 1}"
    return names, units, f"header in {lines}" + (f", {told}" if any(units) else "")


def _fitted(cells: Sequence[str], least: int, width: int) -> list[str] | None:
    """Trim or fill a row to the width of the table; None if it is no row of it."""
    row = [cell.strip() for cell in cells]
    while len(row) > width and not row[-1]:
        row.pop()
    if len(row) > width or len(row) < least or not any(row):
        return None
    return row + [""] * (width - len(row))


def _unclear(names: Sequence[str]) -> bool:
    """Tell whether names repeat, or one is missing that has columns on both sides."""
    filled = [name for name in names if name]
    return len(set(filled)) < len(filled) or not names[0]


def _axes(names: Sequence[str]) -> bool:
    """Tell whether the names that repeat are axes: what they are of stands above them."""
    counts = Counter(names)
    return all(_is_axis(name) for name in names if counts[name] > 1 and name)


def _is_axis(name: str) -> bool:
    return len(name) <= 2 or name.lower() == "scalar"


def _under(upper: Sequence[str], names: Sequence[str]) -> list[str]:
    """Put each name behind the label above it; an axis without one has that to the left of there."""
    label, joined = "", []
    for above, name in zip(upper, names, strict=True):
        label = above or (label if name and _is_axis(name) else "")
        joined.append(f"{label} {name}".strip())
    return joined


def _in_blocks(labels: Sequence[str], names: Sequence[str]) -> list[str]:
    """Put names that come k times behind the labels over their k-th block."""
    counts = Counter(names)
    seen: Counter[str] = Counter()
    turns = []
    for name in names:
        turns.append(seen[name] if counts[name] > 1 and name else -1)
        seen[name] += 1
    block, blocks = 0, dict[int, list[str]]()
    for turn, label in zip(turns, labels, strict=True):
        block = max(block, turn)
        if label and "=" not in label:
            blocks.setdefault(block, []).append(label)
    spoken = {turn: " ".join(blocks.get(turn, [str(turn + 1)])) for turn in set(turns)}
    return [f"{spoken[turn]} {name}" if turn >= 0 else name for turn, name in zip(turns, names, strict=True)]
