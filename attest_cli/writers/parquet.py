"""Track to Parquet; frame, convention, version and provenance stand in the metadata of the schema."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from .files import write_table


def write(columns: Mapping[str, NDArray[Any]], metadata: Mapping[str, str], path: Path) -> None:
    """Write a track; see ``writers``."""
    write_table(columns, path, metadata)
