"""Simulated logs with exact truth: analytic scenarios, seeded errors. Used by tests, docs and ``attest simulate``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from .charly import CharlyOptions, simulate_charly
from .gyrostar import GyrostarOptions, simulate_gyrostar
from .rover import VARIANTS, RoverOptions, simulate_rover
from .simulation import Simulation
from .walking import WalkingOptions, simulate_walking

SCENARIOS: Mapping[str, tuple[type[Any], Callable[[Any], Simulation]]] = {
    "rover": (RoverOptions, simulate_rover),
    "charly": (CharlyOptions, simulate_charly),
    "walking": (WalkingOptions, simulate_walking),
    "gyrostar": (GyrostarOptions, simulate_gyrostar),
}

__all__ = [
    "SCENARIOS",
    "VARIANTS",
    "CharlyOptions",
    "GyrostarOptions",
    "RoverOptions",
    "Simulation",
    "WalkingOptions",
    "simulate_charly",
    "simulate_gyrostar",
    "simulate_rover",
    "simulate_walking",
]
