"""Writers of the track: one format each, imported on use.

A track is an iterable of blocks, and may be iterated again: each a mapping of column names to arrays (n,), in the order
of ``interface.md`` (``timestamp_ns`` int64, ``t_s``, ``q_w`` ...), with metadata: a mapping of text to text (frame,
convention, version, provenance). Every writer has the signature ``write(blocks, metadata, path) -> None`` and leaves
either the whole file or none.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

Blocks = Iterable[Mapping[str, NDArray[Any]]]

WRITERS: Mapping[str, str] = {
    "parquet": "attest_cli.writers.parquet",
    "csv": "attest_cli.writers.csv",
    "tum": "attest_cli.writers.tum",
    "mcap": "attest_cli.writers.mcap",
}
"""Format and suffix of the file -> module with ``write(columns, metadata, path)``."""


def write_track(blocks: Blocks, metadata: Mapping[str, str], path: Path, format_name: str) -> None:
    """Write a track in a format of ``WRITERS``."""
    importlib.import_module(WRITERS[format_name]).write(blocks, metadata, path)
