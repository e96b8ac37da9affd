"""Layouts of ROS 2 messages against the library's decoder, on random definitions and on what is no plain layout."""

from __future__ import annotations

import io
import re
from functools import reduce
from typing import Any

import numpy as np
import pytest
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer

from attest_cli.readers.mcap_records import Batch, batches
from attest_cli.readers.ros2_layout import NUMBERS, Field, fields_of, layout_of
from attest_cli.writers.ros2 import DEFINITIONS, definition

KIND = "test_msgs/msg/Thing"
RULE = "=" * 80


def sent(text: str, messages: list[dict[str, Any]]) -> tuple[Batch, Any]:
    """Messages as they stand in a chunk, and the library's decoder of them."""
    stream = io.BytesIO()
    with Writer(stream) as out:
        schema = out.register_msgdef(KIND, text)
        for k, message in enumerate(messages):
            out.write_message("/thing", schema, message, log_time=k)
    size = stream.tell()
    stream.seek(0)
    records = list(batches(stream, size))
    declared = next(r for r in records if isinstance(r, Schema))
    return next(r for r in records if isinstance(r, Batch)), DecoderFactory().decoder_for("cdr", declared)


def random_type(rng: np.random.Generator, inner: list[str]) -> list[tuple[str, str, int]]:
    """Fields (type, name, count); the first names of ``inner`` are types to nest."""
    kinds = [*NUMBERS, "string", *inner]
    fields = []
    for k in range(int(rng.integers(1, 6))):
        kind = kinds[int(rng.integers(len(kinds)))]
        fields.append((kind, f"f{k}", int(rng.integers(0, 5)) if kind in NUMBERS else 0))
    return fields


def lines(fields: list[tuple[str, str, int]]) -> str:
    noise = "# a comment\nuint8 SOME=3\nstring WORD='a b'\n\n"
    return noise + "\n".join(f"{kind}{f'[{n}]' if n else ''}  {name}  # so far" for kind, name, n in fields)


def random_value(rng: np.random.Generator, kind: str, types: dict[str, list[tuple[str, str, int]]], words: str) -> Any:
    if kind in types:
        return {
            name: [random_value(rng, k, types, words) for _ in range(n)] if n else random_value(rng, k, types, words)
            for k, name, n in types[kind]
        }
    if kind == "string":
        return words
    if kind == "bool":
        return bool(rng.integers(2))
    if kind.startswith("float"):
        return float(np.float32(rng.normal()))
    info = np.iinfo(np.dtype(NUMBERS[kind]))
    return int(rng.integers(info.min, min(info.max, 2**53), dtype=np.int64)) if info.min else int(rng.integers(0, 200))


def paths_of(fields: tuple[Field, ...]) -> list[str]:
    return [p for f in fields if f.kind for p in ([f"{f.path}[{k}]" for k in range(f.count)] or [f.path])]


def looked_up(message: Any, path: str) -> float:
    value = reduce(getattr, path.partition("[")[0].split("."), message)
    place = re.search(r"\[(\d+)\]$", path)
    return float(value if place is None else value[int(place[1])])


@pytest.mark.parametrize("seed", range(40))
def test_random_definitions_read_as_the_library_reads_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    types = {"test_msgs/A": random_type(rng, [])}
    types["test_msgs/B"] = random_type(rng, ["test_msgs/A"])
    types["test_msgs/Thing"] = [("float32", "first", 0), *random_type(rng, ["test_msgs/A", "test_msgs/B"])]
    text = f"\n{RULE}\n".join(
        [lines(types["test_msgs/Thing"]), *(f"MSG: {n}\n{lines(types[n])}" for n in ("test_msgs/A", "test_msgs/B"))]
    )
    words = "x" * int(rng.integers(0, 12))
    batch, decode = sent(text, [random_value(rng, "test_msgs/Thing", types, words) for _ in range(5)])
    fields = fields_of(KIND, text)
    assert fields is not None
    paths = paths_of(fields)
    layout = layout_of(fields, paths, np.frombuffer(batch.payload(0), np.uint8))
    assert layout is not None
    found = layout.table(batch.data, batch.start, batch.size)
    assert found is not None
    wanted = [[looked_up(decode(batch.payload(k)), path) for path in paths] for k in range(5)]
    assert np.array_equal(found.T, wanted)


@pytest.mark.parametrize("kind", sorted(k for k in DEFINITIONS if k.partition("/")[0] in {"sensor_msgs", "nav_msgs"}))
def test_the_messages_of_logs_are_plain(kind: str) -> None:
    assert fields_of(kind.replace("/", "/msg/"), definition(kind)) is not None


@pytest.mark.parametrize(
    "text",
    [
        "float64[] x", "float64[<=3] x", "wstring x", "string[2] x", "string<=5 x", "Unknown x", "float64 x 1.0", "",
        "test_msgs/A[2] x\n" + RULE + "\nMSG: test_msgs/A\nfloat64 y", "test_msgs/Thing x", "float64 X y",
        "test_msgs/A x\n" + RULE + "\nMSG: test_msgs/A\n# empty", "float64[0] x", "float64[99999999999] x",
    ],
)  # fmt: skip
def test_what_is_not_plain_is_left_to_the_library(text: str) -> None:
    assert fields_of(KIND, text) is None


def test_another_byte_order_or_length_of_a_string_is_another_layout() -> None:
    text = "string name\nfloat64 x"
    batch, _ = sent(text, [{"name": "abc", "x": 1.0}, {"name": "abcdefgh", "x": 2.0}, {"name": "abd", "x": 3.0}])
    fields = fields_of(KIND, text)
    assert fields is not None
    first = np.frombuffer(batch.payload(0), np.uint8)
    layout = layout_of(fields, ["x"], first)
    assert layout is not None
    for rows, known in (([0], True), ([0, 1], False), ([0, 2], False), ([1], False)):
        assert (layout.table(batch.data, batch.start[rows], batch.size[rows]) is not None) is known
    big = first.copy()
    big[1] = 0
    assert layout_of(fields, ["x"], big) is None
    assert layout_of(fields, ["y"], first) is None
    for cut in range(first.size):
        assert layout_of(fields, ["x"], first[:cut]) is None
