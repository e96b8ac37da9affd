"""Track to Parquet, a row group per block; frame, convention, version and provenance stand in the schema's metadata."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from . import Blocks
from .files import arrow_table, write_arrow


def write(blocks: Blocks, metadata: Mapping[str, str], path: Path) -> None:
    """Write a track; see ``writers``."""
    write_arrow((arrow_table(block, metadata) for block in blocks), path)
