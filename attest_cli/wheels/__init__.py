"""Wheel odometry against the IMU: how far apart its measurements may lie, and which of them count."""

from __future__ import annotations

from .holes import longest_hole

__all__ = ["longest_hole"]
