"""One short drive, written as text in the ways of real devices and tools."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

G = 9.80665
RATE = 50.0
ROWS = 400
EPOCH_NS = 1_700_000_000_000_000_000

Array = NDArray[np.float64]
t = np.arange(ROWS) / RATE


def _drive() -> tuple[Array, Array, Array]:
    """Gyro (rad/s), specific force (m/s^2) and field (uT) of a box that is rocked about all axes."""
    rng = np.random.default_rng(7)
    angles = np.stack([0.4 * np.sin(1.3 * t), 0.3 * np.sin(1.7 * t + 1.0), 0.5 * t], axis=1)
    attitude = Rotation.from_euler("xyz", angles)
    rate = (attitude[:-1].inv() * attitude[1:]).as_rotvec() * RATE
    gyro = np.vstack([rate, rate[-1]]) + rng.normal(0.0, 1e-3, (ROWS, 3))
    accel = attitude.inv().apply([0.0, 0.0, G]) + rng.normal(0.0, 0.02, (ROWS, 3))
    mag = attitude.inv().apply([18.0, 0.5, -42.0])
    return gyro, accel, mag


gyro, accel, mag = _drive()


def table(
    header: str, columns: Sequence[Array | Iterable[object]], *, delimiter: str = ",", form: str = "{:.7f}",
    comma: bool = False, end: str = "",
) -> str:  # fmt: skip
    """Put rows below a header; numbers as ``form`` says, everything else as it is."""

    def cell(value: object) -> str:
        text = form.format(value) if isinstance(value, float) else str(value)
        return text.replace(".", ",") if comma else text

    rows = (delimiter.join(map(cell, row)) + end for row in zip(*columns, strict=True))
    return "\n".join([*([header] if header else []), *rows, ""])


def xyz(values: Array, factor: float = 1.0) -> list[Array]:
    """Three columns."""
    return [np.asarray(values[:, k] * factor) for k in range(3)]


def stamps(step: float, start: int = 0) -> list[int]:
    """Whole numbers of the time in a unit of ``step`` s."""
    return [start + round(value / step) for value in t]


def in_order(what: Callable[[int], object]) -> list[object]:
    """A column made row by row."""
    return [what(k) for k in range(ROWS)]
