"""Stated noise that the stops refute gives way to what they show; a running engine refutes nothing."""

from __future__ import annotations

import numpy as np
import pytest
from support.drives import simulated

from attest_cli.nodes.noise import REFUTED, contradictions, find_noise, refuting
from attest_cli.simulate import RoverOptions

OPTIONS = {"seed": 1, "duration_s": 120.0, "rate_hz": 50.0, "motions": 2, "stop_s": (12.0, 15.0), "sun": False}


@pytest.mark.parametrize(("variant", "refuted"), [("nominal", False), ("idle-engine", False), ("noisy", True)])
def test_the_stops_refute_what_is_too_small(variant: str, refuted: bool) -> None:
    job = simulated(RoverOptions(**OPTIONS, variant=variant))  # type: ignore[arg-type]
    noise = find_noise(job.log, job.segmentation, job.settings)
    told = contradictions(job.log, job.segmentation, noise, job.settings)
    assert (noise.sources["gyro_noise_density"] == REFUTED) == refuted
    assert [w.code for w in told] == ["gyro-noise-refuted"] * refuted
    stated = job.settings.imu.gyro_noise_density
    assert stated is not None
    assert noise.gyro_density == pytest.approx(stated * (2.0 if refuted else 1.0), rel=0.2)


@pytest.mark.parametrize("seed", range(20))
def test_noise_as_stated_is_not_refuted_by_chance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    stops = [(rng.normal(0.0, 1.0, (500, 3)), 0.02) for _ in range(2)]
    assert refuting(0.02**0.5, stops) is None
