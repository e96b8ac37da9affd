"""Which filter ``auto`` stands for: from the sensors of a log and how lively it is."""

from __future__ import annotations

import numpy as np

from ..nodes.observations import at_stop
from ..records import Log, Segmentation
from ..settings import Settings

LIVELY_RAD_S = 0.5  # rms rate in motion from which a log without wheels is taken as hand-held
CARRIED_RAD_S = 0.2  # the same of a log that never stops: a rover turns at 0.1, a stick in slow hands at 0.25


def choose(log: Log, segmentation: Segmentation, settings: Settings) -> tuple[str, str]:
    """Return the name of the filter and why it was taken."""
    stated = settings.smoothing.filter
    if stated != "auto":
        return stated, "as stated"
    if {"gps", "gps_velocity", "position"} & log.fixes.keys():
        return "navigation", "the log has positions"
    least = LIVELY_RAD_S if segmentation.stops else CARRIED_RAD_S
    aided = "magnetometer" in log.fixes or not segmentation.stops  # with stops alone the plain filter does as well
    if aided and "odometry" not in log.fixes and liveliness(log, segmentation) > least:
        return "navigation", "the IMU turns as in a hand"
    return "indirect", "no positions, and driven motion"


def liveliness(log: Log, segmentation: Segmentation) -> float:
    """Return the rms rate in motion, rad/s."""
    moving = ~at_stop(log.imu.t, segmentation)
    rate = log.imu.gyro_b[moving] - segmentation.bias_b
    return float(np.sqrt(np.mean(np.sum(rate**2, axis=1)))) if len(rate) else 0.0
