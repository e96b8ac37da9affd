"""Track to a TUM trajectory: ``timestamp tx ty tz qx qy qz qw``, seconds exact to the nanosecond."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from . import Blocks
from .csv import comment_lines, write_text

POSITION = ("position_x_m", "position_y_m", "position_z_m")
QUATERNION = ("q_x", "q_y", "q_z", "q_w")  # scalar last


def write(blocks: Blocks, metadata: Mapping[str, str], path: Path) -> None:
    """Write a track; see ``writers``. Without a position all the way it is zero, and the header says so."""
    known = all(name in block and bool(np.isfinite(block[name]).all()) for block in blocks for name in POSITION)
    comments = comment_lines(metadata)
    if not known:
        comments.append("# no position: tx ty tz are zero")
    comments.append("# timestamp tx ty tz qx qy qz qw")
    write_text((_table(block, known) for block in blocks), path, comments, delimiter=" ", header=False)


def _table(block: Mapping[str, NDArray[Any]], known: bool) -> pa.Table:
    zeros = np.zeros(block["q_w"].shape)
    values = [block[name] if known else zeros for name in POSITION] + [block[name] for name in QUATERNION]
    return pa.table({"t": seconds_text(block["timestamp_ns"]), **{str(k): pa.array(v) for k, v in enumerate(values)}})


def seconds_text(stamps_ns: NDArray[np.int64]) -> pa.Array:
    """Return stamps as seconds with nine decimals, exactly."""
    size = np.abs(stamps_ns)
    fraction = pc.utf8_lpad(pc.cast(pa.array(size % 1_000_000_000), pa.string()), 9, "0")
    text = pc.binary_join_element_wise(pc.cast(pa.array(size // 1_000_000_000), pa.string()), fraction, ".")
    return pc.if_else(pa.array(stamps_ns < 0), pc.binary_join_element_wise("-", text, ""), text)
