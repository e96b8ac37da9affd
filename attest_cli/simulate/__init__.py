"""Simulated logs with exact truth: analytic scenarios, seeded errors. Used by tests, docs and ``attest simulate``."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from .rover import VARIANTS, RoverOptions, Simulation, simulate_rover

SCENARIOS: Mapping[str, Callable[[RoverOptions], Simulation]] = {
    "rover": simulate_rover,
}

__all__ = ["SCENARIOS", "VARIANTS", "RoverOptions", "Simulation", "simulate_rover"]
