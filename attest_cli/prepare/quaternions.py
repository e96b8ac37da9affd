"""Whether orientations turn as the gyro does: order of the parts, and which way they turn."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ..maths import rotation
from ..records import Array, Fixes, Imu, Warn

SPAN_S, LONGEST_S = 5.0, 10.0  # between two orientations that are compared: long enough to turn, too short to drift
LEAST_RAD, FEW = np.radians(5.0), 5  # turns that show something
CLEARLY, EXPLAINED = 0.3, 0.5  # misfit over that of the orientations as they are; share of the turns it may be
MOST = 2000  # orientations that are compared

READINGS: Mapping[str, Callable[[Array], Array]] = {
    "turn the world into the body: conjugate them": rotation.conjugate,
    "are in the order x, y, z, w": lambda q: np.roll(q, 1, axis=1),
    "are in the order x, y, z, w and turn the world into the body": lambda q: rotation.conjugate(np.roll(q, 1, 1)),
}
"""What can be wrong with a quaternion -> how it is mended."""


def doubts(fixes: Fixes, imu: Imu) -> list[Warn]:
    r"""Say where orientations, read in another way, turn as the gyro does over a few seconds.

    .. math:: q_j^{-1}q_k=\prod\exp(\omega\,dt)
    """
    t = fixes.t
    rows = np.flatnonzero((t >= imu.t[0]) & (t <= imu.t[-1]))
    rows = rows[:: -(-len(rows) // MOST) or 1]
    later = np.searchsorted(t[rows], t[rows] + SPAN_S)
    use = later < len(rows)
    a, b = rows[use], rows[later[use]]
    steps = (imu.gyro_b[1:] - np.median(imu.gyro_b, axis=0)) * np.diff(imu.t)[:, None]
    turned = rotation.chain(rotation.exp_quaternion(np.concatenate([np.zeros((1, 3)), steps])))
    at = np.clip(np.searchsorted(imu.t, t), 0, len(imu.t) - 1)
    by_gyro = rotation.multiply(rotation.conjugate(turned[at[a]]), turned[at[b]])
    angle = np.linalg.norm(rotation.log_quaternion(by_gyro), axis=1)
    far = (angle > LEAST_RAD) & (t[b] - t[a] < LONGEST_S)
    if np.count_nonzero(far) < FEW:
        return []

    def misfit(q: Array) -> float:
        seen = rotation.multiply(rotation.conjugate(q[a[far]]), q[b[far]])
        error = rotation.log_quaternion(rotation.multiply(rotation.conjugate(by_gyro[far]), seen))
        return float(np.sum(error**2))

    found = {words: misfit(read(fixes.values)) for words, read in READINGS.items()}
    words, least = min(found.items(), key=lambda item: item[1])
    if least > min(CLEARLY * misfit(fixes.values), EXPLAINED * float(np.sum(angle[far] ** 2))):
        return []
    message = f"the orientations of {fixes.channel} do not turn as the gyro does: they {words}"
    return [Warn("orientation-order", message, "write q body to world as w, x, y, z", fatal=True)]
