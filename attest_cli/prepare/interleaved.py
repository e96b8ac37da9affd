"""Two IMUs in one channel: rows that alternate by what the IMU does are of two devices with axes of their own."""

from __future__ import annotations

import numpy as np

from ..errors import AttestError
from ..records import Array

BLOCK, LEAST_BLOCKS = 10, 40  # rows; blocks that tell
WINDOW = 20  # blocks in which no row is lost, that would change the order
ASKED = 250  # windows, all along the log
EXPLAINED, PASSES = 0.6, 4  # share of the alternation; of its sign in windows
TOGETHER, ALIKE, ABOUT = 5, 0.2, (0.7, 1.4)  # blocks; share of the turning of gravity; scale of the gyro
TURNED = 0.02  # as much of the signal alternates: axes turned by 2 deg
OPPOSITE, ALWAYS, STEADY = 0.25, 0.95, 0.8  # of gravity; share of the blocks; mean of a window over its size


def refuse(name: str, table: Array, period_s: float) -> None:
    r"""Refuse raw gyro and accelerometer (n, 6) of two IMUs in turn, a row every ``period_s``.

    In each block of rows, :math:`A=\tfrac12\,\mathrm{med}\,(-1)^i(x_i-\tfrac12(x_{i-1}+x_{i+1}))` is half of what every
    second row is apart, and :math:`m` the median of the block. A signal that bends within few samples is like that too,
    but not by its fourth difference: both must tell. Two devices turned by :math:`R` against each other give
    :math:`A=(I-R)(I+R)^{-1}m+c`, in both sensors; upside down to each other, a force that alternates by a share of
    gravity all along. Vibration near half the sampling rate alternates too, but not in proportion. Devices that differ
    in their biases only are not told apart: their mean is right. Half a turn has no such map: there the alternation of
    gravity turns by that of the gyro.

    Raises
    ------
    AttestError
        If the alternation is that of two devices.
    """
    windows = (len(table) - 4) // (BLOCK * WINDOW)
    if windows * WINDOW < LEAST_BLOCKS:
        return
    asked = np.unique(np.linspace(0, windows - 1, min(windows, ASKED)).astype(np.int64))
    rows = (asked[:, None] * BLOCK * WINDOW + np.arange(2, BLOCK * WINDOW + 2)).reshape(-1, BLOCK)  # (blocks, BLOCK)
    sign = np.where(np.arange(BLOCK) % 2 == 0, 0.5, -0.5)[:, None]
    x = table[rows]
    beside, beyond = (table[rows - k] + table[rows + k] for k in (1, 2))
    middle = np.median(x, axis=1)
    for off in (x - 0.5 * beside, (6.0 * x - 4.0 * beside + beyond) / 8.0):
        apart = np.median(sign * off, axis=1)
        found = _opposite(middle[:, 3:], apart[:, 3:]) or _in_proportion(middle, apart)
        if not found and not _turn_alike(middle, apart, BLOCK * period_s):
            return
    size = 2.0 * np.median(np.abs(apart), axis=0)
    each = f"by {np.max(size[:3]):.2g} (gyro) and {np.max(size[3:]):.2g} (accelerometer)"
    message = f"{name}: rows of two IMUs in turn: every second row is apart {each}, as turned axes are"
    raise AttestError(message, "record each device under a name of its own")


def _opposite(middle: Array, apart: Array) -> bool:
    """Tell whether the alternation (b, 3) of force is a share of gravity all along, and steady, as noise is not."""
    force = np.linalg.norm(apart, axis=1)
    gravity = float(np.median(np.hypot(force, np.linalg.norm(middle, axis=1))))
    steady = np.linalg.norm(apart.reshape(-1, WINDOW, 3).mean(axis=1), axis=1) / np.maximum(
        force.reshape(-1, WINDOW).mean(axis=1), 1e-300
    )
    return gravity > 0.0 and bool(np.mean(force > OPPOSITE * gravity) > ALWAYS) and bool(np.median(steady) > STEADY)


def _turn_alike(middle: Array, apart: Array, step_s: float) -> bool:
    r"""Tell whether the alternation of force is gravity's, and turns by that of the gyro, in rad/s or deg/s.

    Of two devices with up :math:`u` and rate :math:`\omega`, with their halves sum :math:`m` and difference :math:`h`:
    :math:`\Delta h_u=-\Delta t(h_\omega\times m_u+m_\omega\times h_u)`.
    """
    gravity = float(np.median(np.linalg.norm(middle[:, 3:], axis=1)))
    if not gravity > 0.0:
        return False
    m, h = (x.reshape(-1, WINDOW // TOGETHER, TOGETHER, 6).mean(axis=2) for x in (middle, apart))
    rate_m, rate_h = (0.5 * (x[:, 1:, :3] + x[:, :-1, :3]) for x in (m, h))
    up_m, up_h = (0.5 * (x[:, 1:, 3:] + x[:, :-1, 3:]) / gravity for x in (m, h))
    seen = np.diff(h[:, :, 3:], axis=1).reshape(-1, 3) / gravity
    expected = -(np.cross(rate_h, up_m) + np.cross(rate_m, up_h)).reshape(-1, 3)
    both, square, total = (float(np.sum(x * y)) for x, y in ((seen, expected), (expected, expected), (seen, seen)))
    if not (square > 0.0 and total > 0.0) or both <= 0.0:
        return False
    scale, explained = both / square / (TOGETHER * step_s), both**2 / (square * total)
    likely = any(ABOUT[0] < scale * unit < ABOUT[1] for unit in (1.0, 180.0 / np.pi))
    large = float(np.sqrt(np.mean(np.sum(up_h**2, axis=2)))) > TURNED
    return likely and large and explained > ALIKE


def _in_proportion(middle: Array, apart: Array) -> bool:
    """Tell whether the alternation (b, 6) of both sensors is a map of their signal, all along or in windows."""
    for window in (len(middle), WINDOW):
        fits = [_fitted(middle[:, k], apart[:, k], window) for k in (np.s_[:3], np.s_[3:])]
        if min(share for share, _ in fits) > EXPLAINED and min(size for _, size in fits) > TURNED:
            return True
    return False


def _fitted(middle: Array, apart: Array, window: int) -> tuple[float, float]:
    """Return which share of the alternation (b, 3) one map of the signal explains, but for its sign in each window, and
    its size.
    """
    used = len(middle) // window * window
    x, y = (z[:used].reshape(-1, window, 3) for z in (middle, apart))
    x, y = x - np.median(x, axis=1, keepdims=True), y - np.median(y, axis=1, keepdims=True)
    sign, total = np.ones((len(x), 1, 1)), float(np.sum(y**2))
    most = int(np.argmax(np.sum(y**2, axis=(1, 2))))
    slope = np.linalg.pinv(x[most], rcond=1e-6) @ y[most]
    for _ in range(PASSES):
        sign = np.where(np.sum(x @ slope * y, axis=(1, 2), keepdims=True) < 0.0, -1.0, 1.0)
        slope = np.linalg.lstsq(x.reshape(-1, 3), (sign * y).reshape(-1, 3), rcond=1e-6)[0]
    if not total > 0.0:
        return 0.0, 0.0
    return 1.0 - float(np.sum((sign * y - x @ slope) ** 2)) / total, 2.0 * float(np.linalg.norm(slope, 2))
