"""Wheel odometry against the IMU: how far apart its measurements may lie, and which of them count."""

from __future__ import annotations

from .holes import longest_hole
from .judge import Judged, judge
from .noise import sigma_of
from .slips import slips

__all__ = ["Judged", "judge", "longest_hole", "sigma_of", "slips"]
