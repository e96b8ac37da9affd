"""A gyro whose unit changes within a log, told by its own noise at rest, which scales with the unit."""

from __future__ import annotations

import numpy as np

from ..errors import AttestError
from ..records import Array

DEGREES = 40.0, 80.0  # ratio of the scales of two parts in radians and degrees; nothing else changes in a log
SAMPLES, PLACES = 16, 1000  # of a window; windows of a log: enough to meet its stops
CALM = 3.0  # times the least that the accelerometer shakes in any window: what is still
WHITE = 2.0  # second differences over first, squared: 3 of white noise, less of motion
FEW = 3  # windows at rest of a part
EVEN = 0.5  # RMS by which the noise of windows at rest may spread within a part, as a logarithm


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # a value of 1e300 is a spike, and falls out later
def refuse(name: str, t: Array, gyro: Array, accel: Array) -> None:
    r"""Refuse a gyro (n, 3) whose noise at rest becomes 57 times as large or as small at some time ``t`` (n,) s.

    Of windows all over the log those are at rest in which the accelerometer (n, 3) is as quiet as anywhere and the
    gyro's noise is white. There the mean square :math:`r` of first differences shows the noise: of all places to cut
    that with the most even :math:`\log r` on both sides is asked.
    """
    if len(t) < 2 * SAMPLES:
        return
    rows = np.unique(np.linspace(0, len(t) - SAMPLES, PLACES).astype(np.int64))[:, None] + np.arange(SAMPLES)
    rough, rougher = (np.sum(np.diff(gyro[rows], k, axis=1) ** 2, axis=(1, 2)) / (SAMPLES - k) for k in (1, 2))
    shaken = np.sum(np.diff(accel[rows], axis=1) ** 2, axis=(1, 2))
    if not shaken.any():
        return
    calm = shaken < CALM**2 * shaken[shaken > 0.0].min()  # a coarse accelerometer says nothing new in some
    still = calm & (rougher > WHITE * rough) & (rough > 0.0)
    level, at = 0.5 * np.log(rough[still]), t[rows[still, 0]]
    if len(level) < 2 * FEW:
        return
    counts = np.arange(FEW, len(level) - FEW + 1)
    sums = np.cumsum(level)
    apart = sums[counts - 1] / counts - (sums[-1] - sums[counts - 1]) / (len(level) - counts)
    cut = int(counts[np.argmax(counts * (len(level) - counts) * apart**2)])
    before, after = level[:cut], level[cut:]
    ratio = float(np.exp(after.mean() - before.mean()))
    if not DEGREES[0] < max(ratio, 1.0 / ratio) < DEGREES[1] or max(before.std(), after.std()) > EVEN:
        return
    message = f"channel {name}: the gyro's unit changes between {at[cut - 1]:.1f} and {at[cut]:.1f} s"
    message += f", where its noise at rest becomes {ratio:.2g} times as large"
    hint = f"smooth one part, with --end {at[cut - 1]:.1f} or --start {at[cut]:.1f}, or mend the log"
    raise AttestError(message, hint)
