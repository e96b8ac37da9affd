"""Where the fields of ROS messages stand in their bytes, so that many messages are read at once.

Only what is sure: little-endian CDR, or ROS 1, of numbers, arrays of fixed size and strings that are the same in all
messages. Of anything else ``fields_of``, ``layout_of`` and ``Layout.table`` return None, and messages are decoded one
by one.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..records import Array, Ints

Bytes = NDArray[np.uint8]
NUMBERS = {
    "bool": "?", "byte": "u1", "char": "i1", "int8": "i1", "uint8": "u1", "int16": "<i2", "uint16": "<u2",
    "int32": "<i4", "uint32": "<u4", "int64": "<i8", "uint64": "<u8", "float32": "<f4", "float64": "<f8",
}  # fmt: skip
"""Type in a definition -> NumPy's name."""

PREFIX = 4  # bytes of the encapsulation; alignment counts from behind them
LITTLE_ENDIAN = 1
MOST_FIELDS = 1000
_SECTION = re.compile(r"^=+\s*\n\s*MSG:\s*(\S+)\s*$", re.MULTILINE)
_FIELD = re.compile(r"([A-Za-z]\w*(?:/[A-Za-z]\w*)?)(?:\[(\d+)\])?\s+([a-z]\w*)")
_CONSTANT = re.compile(r"[a-z]\w*\s+[A-Z]\w*\s*=.*")
_TIME = {"builtin_interfaces/Time": "uint32 sec\nuint32 nanosec"}  # the library's own, where a definition has none


@dataclass(frozen=True, slots=True)
class Field:
    """A number, an array of ``count`` numbers or (``kind`` empty) a string; its path is like ``header.stamp.sec``."""

    path: str
    kind: str
    count: int = 0


@dataclass(frozen=True, slots=True)
class Layout:
    """Bytes of one message: ``wanted`` (offset, type) of the fields asked for, ``fixed`` (offset, bytes) what must be
    the same in every message, and the bytes ``needed`` in all; ``exact``: no message has more.
    """

    wanted: tuple[tuple[int, np.dtype[np.generic]], ...]
    fixed: tuple[tuple[int, Bytes], ...]
    needed: int
    exact: bool = False

    def table(self, data: Bytes, start: Ints, size: Ints) -> Array | None:
        """Return the fields asked for (k, m) of the messages ``data[start : start + size]``, or None where one is not
        laid out like this.
        """
        if int(size.min()) < self.needed or (self.exact and int(size.max()) > self.needed):
            return None
        whole = np.dtype((np.void, self.needed))
        every: NDArray[np.void] = np.ndarray((data.size - self.needed + 1,), whole, data, strides=(1,))
        messages = every[start]  # one copy a message
        rows = messages.view(np.uint8).reshape(len(start), self.needed)
        if any(rows[:, at : at + len(same)].tobytes() != same.tobytes() * len(start) for at, same in self.fixed):
            return None
        out = np.empty((len(self.wanted), len(start)))
        for row, (at, kind) in zip(out, self.wanted, strict=True):
            row[:] = np.ndarray((len(start),), kind, rows, at, (self.needed,))
        return out


def fields_of(name: str, text: str) -> tuple[Field, ...] | None:
    """Return the fields of a message type in order, flat, by its definition (``ros2msg``); None where not all are
    plain.
    """
    parts = _SECTION.split(text.replace("\r", ""))
    known = _TIME | dict(zip((_short(p) for p in parts[1::2]), parts[2::2], strict=True)) | {_short(name): parts[0]}
    found: list[Field] = []
    return tuple(found) if _flatten(_short(name), "", known, found) else None


def layout_of(fields: Sequence[Field], paths: Sequence[str], message: Bytes, *, packed: bool = False) -> Layout | None:
    """Return the layout of ``message``, all of whose strings count as fixed; None where it is not sure.

    ``paths``: fields wanted, elements of arrays as ``name[3]``; ``packed``: ROS 1, end to end without encapsulation.
    """
    prefix = 0 if packed else PREFIX
    if message.size < prefix or (not packed and message[1] != LITTLE_ENDIAN):
        return None
    at, places, fixed = prefix, dict[str, tuple[int, np.dtype[np.generic]]](), [(0, message[:prefix])]
    for f in fields:
        kind = np.dtype(f.kind or "<u4")
        at += 0 if packed else -(at - prefix) % kind.itemsize
        end = at + max(f.count, 1) * kind.itemsize
        if end > message.size:
            return None
        if not f.kind:
            end += int.from_bytes(message[at:end].tobytes(), "little")
            fixed.append((at, message[at:end]))
        names = [f"{f.path}[{k}]" for k in range(f.count)] or [f.path]
        places |= {name: (at + k * kind.itemsize, kind) for k, name in enumerate(names)}
        at = end
    if at > message.size or not all(path in places for path in paths):
        return None
    return Layout(tuple(places[path] for path in paths), tuple(fixed), at, packed)


def _flatten(name: str, prefix: str, known: dict[str, str], found: list[Field]) -> bool:
    """Add the fields of a type and of the types in it; False where one is not plain."""
    before = len(found)
    for raw in known[name].splitlines():
        line = raw.partition("#")[0].strip()
        if not line or _CONSTANT.fullmatch(line):
            continue
        read = _FIELD.fullmatch(line)
        if read is None or len(found) >= MOST_FIELDS or len(prefix) > MOST_FIELDS:
            return False
        kind, count, path = read[1], int(read[2] or 0), prefix + read[3]
        inner = kind if "/" in kind else f"{name.partition('/')[0]}/{kind}"
        if kind in NUMBERS and (read[2] is None or 1 <= count <= MOST_FIELDS):
            found.append(Field(path, NUMBERS[kind], count))
        elif kind == "string" and read[2] is None:
            found.append(Field(path, ""))
        elif read[2] is not None or inner not in known or not _flatten(inner, f"{path}.", known, found):
            return False
    return len(found) > before  # an empty type takes a byte of its own


def _short(name: str) -> str:
    return name.replace("/msg/", "/")
