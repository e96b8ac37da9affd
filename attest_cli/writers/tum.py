"""Track to a TUM trajectory: ``timestamp tx ty tz qx qy qz qw``, seconds exact to the nanosecond."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from .csv import comment_lines, write_text

POSITION = ("position_x_m", "position_y_m", "position_z_m")
QUATERNION = ("q_x", "q_y", "q_z", "q_w")  # scalar last


def write(columns: Mapping[str, NDArray[Any]], metadata: Mapping[str, str], path: Path) -> None:
    """Write a track; see ``writers``. Without a position the translation is zero, and the header says so."""
    known = all(name in columns and bool(np.isfinite(columns[name]).all()) for name in POSITION)
    zeros = np.zeros(columns["q_w"].shape)
    values = [columns[name] if known else zeros for name in POSITION] + [columns[name] for name in QUATERNION]
    table = pa.table(
        {"t": seconds_text(columns["timestamp_ns"]), **{str(k): pa.array(v) for k, v in enumerate(values)}}
    )
    comments = comment_lines(metadata)
    if not known:
        comments.append("# no position: tx ty tz are zero")
    write_text(table, path, header=[], comments=[*comments, "# timestamp tx ty tz qx qy qz qw"], delimiter=" ")


def seconds_text(stamps_ns: NDArray[np.int64]) -> pa.Array:
    """Return stamps as seconds with nine decimals, exactly."""
    size = np.abs(stamps_ns)
    fraction = pc.utf8_lpad(pc.cast(pa.array(size % 1_000_000_000), pa.string()), 9, "0")
    text = pc.binary_join_element_wise(pc.cast(pa.array(size // 1_000_000_000), pa.string()), fraction, ".")
    return pc.if_else(pa.array(stamps_ns < 0), pc.binary_join_element_wise("-", text, ""), text)
