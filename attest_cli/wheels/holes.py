"""How far apart measurements of the wheels may lie and still tell the speed between them."""

from __future__ import annotations

import numpy as np

from ..records import Array

USUAL_HOLE_S, MOST_HOLE_S = 1.0, 5.0  # bridged at any rate; never more: a vehicle starts and halts in it
PERIODS = 5.0  # of slower odometry: single measurements may be lost


def longest_hole(t: Array) -> float:
    """Return over how long, s, odometry with stamps ``t`` (k,) is bridged: it follows its usual rate."""
    usual = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    return float(np.clip(PERIODS * usual, USUAL_HOLE_S, MOST_HOLE_S))
