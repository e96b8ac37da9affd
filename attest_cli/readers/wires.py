"""How messages stand in their bytes: ROS 2 (CDR), ROS 1, protobuf and JSON, all read by the one table of types.

No code is made of what a file says, which the libraries for ROS 1 do: they compile its definitions to Python.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import re
from collections.abc import Callable
from functools import partial, reduce
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from ..errors import AttestError
from .extras import extra
from .messages import TYPES, MessageType
from .ros2_layout import Bytes, Field, Layout, fields_of, layout_of
from .topics import One, Topic, line

SCHEMAS = {"cdr": ("ros2msg",), "ros1": ("ros1msg",), "protobuf": ("protobuf",), "json": ("jsonschema", "")}
"""Encoding of messages -> encodings of their definition that are read."""
ROS1_WORDS = (
    (re.compile(r"^(\s*)Header(?=\s)", re.MULTILINE), r"\1std_msgs/Header"),
    (re.compile(r"^(\s*)(?:time|duration)(?=\s)", re.MULTILINE), r"\1builtin_interfaces/Time"),
)
"""What definitions of ROS 1 call otherwise; a duration is two words of four bytes as well."""
SECONDS = {"secs": "sec", "seconds": "sec", "nsec": "nanosec", "nsecs": "nanosec", "nanos": "nanosec"}
"""Parts of a stamp in JSON of different writers."""

Wire = tuple[One, Callable[[Bytes], Layout | None] | None]
"""What decodes one message, and what finds the layout of many."""


class Wires:
    """The decoders of one file: the libraries cache by schema id alone, so every file gets its own."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._ros2 = DecoderFactory()
        self._protobuf: Any = None

    def topic(self, name: str, encoding: str, schema: Schema | None) -> Topic | str:
        """Prepare to decode a channel; of one that is not read, return its type in words.

        Raises
        ------
        AttestError
            If its definition is damaged, or a package that it needs is not installed.
        """
        if schema is None:
            return f"no schema ({encoding})"
        kind = TYPES.get(_full(schema.name))
        if kind is None or schema.encoding not in SCHEMAS.get(encoding, ()):
            return f"{schema.name} ({encoding if kind is None or encoding not in SCHEMAS else schema.encoding})"
        try:
            one, lay = {"cdr": self._cdr, "ros1": _ros1, "protobuf": self._proto, "json": _json}[encoding](schema, kind)
        except AttestError:
            raise
        except Exception as error:  # noqa: BLE001 (the libraries' errors have no base in common)
            message = f"{self._path}: the definition of {schema.name} on {name} is damaged: {line(error)}"
            raise AttestError(message) from None
        return Topic(name, schema.name, kind, one, lay)

    def _cdr(self, schema: Schema, kind: MessageType) -> Wire:
        with contextlib.redirect_stderr(io.StringIO()):  # it prints what it cannot parse
            decode: Any = self._ros2.decoder_for("cdr", schema)
        fields = fields_of(schema.name, schema.data.decode("utf-8", "replace"))
        lay = None if fields is None else partial(layout_of, fields, (*kind.stamp, *kind.fields))
        return partial(_strict, decode, kind), lay

    def _proto(self, schema: Schema, kind: MessageType) -> Wire:
        if self._protobuf is None:
            what, package = f"{schema.name} in protobuf", "mcap-protobuf-support"
            self._protobuf = extra(self._path, "mcap_protobuf.decoder", "protobuf", what, package).DecoderFactory()
        decode = _parsed(self._protobuf.decoder_for, "protobuf", schema)
        at = kind.stamp[0].rpartition(".")[0]
        return partial(_lenient, partial(_parsed, decode), kind, (f"{at}.seconds", f"{at}.nanos")), None


def _ros1(schema: Schema, kind: MessageType) -> Wire:
    """Numbers end to end, nothing aligned; what is not plain is refused."""
    text = schema.data.decode("utf-8", "replace")
    for words, ours in ROS1_WORDS:
        text = words.sub(ours, text)
    fields = fields_of(schema.name, text)
    if fields is None:
        raise ValueError("it holds more than numbers and strings")
    return partial(_packed, fields, kind), partial(layout_of, fields, (*kind.stamp, *kind.fields), packed=True)


def _json(_: Schema, kind: MessageType) -> Wire:
    return partial(_lenient, partial(json.loads, object_hook=_object), kind, kind.stamp), None


def _strict(decode: Callable[[bytes], Any], kind: MessageType, payload: bytes) -> tuple[list[float], str]:
    """Decode a message that has every field of its type."""
    message = decode(payload)
    return [float(_at(message, name)) for name in (*kind.stamp, *kind.fields)], str(_at(message, kind.frame))


def _packed(fields: tuple[Field, ...], kind: MessageType, payload: bytes) -> tuple[list[float], str]:
    """Decode a message of ROS 1 by its own layout."""
    data = np.frombuffer(payload, np.uint8)
    layout = layout_of(fields, (*kind.stamp, *kind.fields), data, packed=True)
    found = None if layout is None else layout.table(data, np.zeros(1, np.int64), np.array([data.size]))
    frame = layout_of(fields, (kind.frame,), data, packed=True)
    if layout is None or found is None or frame is None or layout.needed != data.size:
        raise ValueError(f"its {data.size} bytes do not fit the definition")
    at = frame.wanted[0][0]
    size = int.from_bytes(payload[at : at + 4], "little")
    return found[:, 0].tolist(), payload[at + 4 : at + 4 + size].decode("utf-8", "replace")


def _lenient(
    decode: Callable[[bytes], Any], kind: MessageType, stamp: tuple[str, str], payload: bytes
) -> tuple[list[float], str]:
    """Decode a message whose fields are all optional: a blank where one is absent, a zero stamp without one."""
    message = decode(payload)
    seconds = [0.0 if math.isnan(value) else value for value in (_number(message, name) for name in stamp)]
    return [*seconds, *(_number(message, name) for name in kind.fields)], _text(message, kind.frame)


def _number(message: Any, name: str) -> float:
    value = _or_none(message, name)
    return float(value) if isinstance(value, int | float) else math.nan


def _text(message: Any, name: str) -> str:
    value = _or_none(message, name)
    return value if isinstance(value, str) else ""


def _or_none(message: Any, name: str) -> Any:
    try:
        return _at(message, name)
    except (AttributeError, IndexError, KeyError, TypeError):
        return None


def _at(message: Any, name: str) -> Any:
    """Return a field by its path, such as ``twist.covariance[7]``."""
    value = reduce(getattr, name.partition("[")[0].split("."), message)
    place = re.search(r"\[(\d+)\]$", name)
    return value if place is None else value[int(place[1])]


def _object(pairs: dict[str, Any]) -> SimpleNamespace:
    return SimpleNamespace(**{SECONDS.get(name, name): value for name, value in pairs.items()})


def _parsed(parse: Callable[..., Any], *args: Any) -> Any:
    """Parse protobuf, whose errors are of a kind of their own."""
    from google.protobuf.message import DecodeError  # there where the decoder is

    try:
        return parse(*args)
    except DecodeError as error:
        raise ValueError(str(error)) from None


def _full(name: str) -> str:
    """Return the name of a ROS type as ROS 2 has it."""
    package, _, short = name.partition("/")
    return f"{package}/msg/{short}" if short and "/" not in short else name
