"""The angle between sun and vertical: as it is seen at the stops, and of the reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.drives import Job, simulated

from attest_cli.maths import rotation
from attest_cli.nodes.observations import observe
from attest_cli.nodes.sun import sun_angles, sun_doubts
from attest_cli.simulate import RoverOptions

OPTIONS = RoverOptions(seed=2, duration_s=120.0, rate_hz=50.0, motions=3, stop_s=(8.0, 12.0), sun=True)


@pytest.fixture(scope="module")
def job() -> Job:
    return simulated(OPTIONS)


def told(job: Job, lower_deg: float, *, outlier: bool = False) -> list[str]:
    """What is said where the reference is so much lower than the sun; with readings of a stop that are off, or none."""
    assert job.world.sun_n is not None
    sun_n = np.atleast_2d(job.world.sun_n)
    level = np.cross(sun_n, [0.0, 0.0, 1.0])
    level /= np.linalg.norm(level, axis=1, keepdims=True)
    lower = rotation.rotate(rotation.exp_quaternion(-np.radians(lower_deg) * level), sun_n)
    fixes = job.log.fixes["sun"]
    if outlier:
        stop = job.segmentation.stops[1]
        off = (fixes.t > stop.start) & (fixes.t < stop.end)
        fixes = replace(fixes, values=np.where(off[:, None], fixes.values[:, ::-1], fixes.values))
    world = replace(job.world, sun_n=lower.reshape(job.world.sun_n.shape))
    return [w.message for w in sun_doubts(fixes, job.log, job.segmentation, world, job.settings)]


def test_a_reference_that_stands_elsewhere_is_told_with_both_angles(job: Job) -> None:
    assert told(job, 0.0) == []
    assert told(job, 0.0, outlier=True) == []
    (message,) = told(job, 3.0)
    seen, given = (float(message.split(before)[1].split(" deg")[0]) for before in ("stands ", "it is "))
    assert given - seen == pytest.approx(3.0, abs=0.5)


def test_angles_are_those_of_the_stops(job: Job) -> None:
    assert job.world.sun_n is not None
    angles = sun_angles(job.log.fixes["sun"], job.log, job.segmentation, job.world.sun_n, job.settings)
    assert len(angles) == len(job.segmentation.stops)
    assert np.abs(np.diff(angles, axis=1)).max() < np.radians(1.0)


def test_a_sun_below_the_horizon_is_said_to_be_there(job: Job) -> None:
    assert job.world.sun_n is not None
    world = replace(job.world, sun_n=job.world.sun_n * [1.0, 1.0, -1.0])
    _, warnings = observe(job.log, job.segmentation, world, job.noise, job.settings)
    assert [w.code for w in warnings] == ["sun-not-used"]
    assert "below the horizon" in warnings[0].message
