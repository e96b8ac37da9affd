"""Whether a magnetometer shows the Earth's field."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from support.drives import Job, simulated

from attest_cli.maths import rotation
from attest_cli.nodes.field import field_doubts, steepness
from attest_cli.nodes.observations import observe
from attest_cli.records import Warn
from attest_cli.simulate import RoverOptions

Array = NDArray[np.float64]
OPTIONS = RoverOptions(
    seed=2, duration_s=120.0, rate_hz=50.0, motions=3, stop_s=(8.0, 12.0), sun=False, magnetometer=True
)


@pytest.fixture(scope="module")
def job() -> Job:
    return simulated(OPTIONS)


def doubted(job: Job, change: Array, *, reference: bool = True) -> tuple[float, list[str]]:
    fixes = job.log.fixes["magnetometer"]
    field = replace(fixes, values=fixes.values @ change[:, :3].T + change[:, 3])
    world = job.world if reference else replace(job.world, field_n=None)
    iron, told = field_doubts(field, job.log, job.segmentation, world)
    return iron, [w.message for w in told]


SOUND = np.hstack([np.eye(3), np.zeros((3, 1))])


@pytest.mark.parametrize("reference", [True, False])
def test_a_calibrated_one_is_silent(job: Job, reference: bool) -> None:
    assert doubted(job, SOUND, reference=reference) == (0.0, [])


def test_a_normalised_one_has_no_size(job: Job) -> None:
    fixes = job.log.fixes["magnetometer"]
    sizes = np.linalg.norm(fixes.values, axis=1, keepdims=True)
    values = 5e-5 * fixes.values / sizes
    iron, told = field_doubts(replace(fixes, values=values), job.log, job.segmentation, job.world)
    assert (iron, [w.code for w in told]) == (0.0, ["magnetometer-normalised"])
    known = replace(job.log, warnings=tuple(told))
    assert field_doubts(replace(fixes, values=values), known, job.segmentation, job.world) == (0.0, [])


@pytest.mark.parametrize(("seconds", "said"), [(0.0, []), (1.0, []), (15.0, ["magnetometer-disturbed"])])
def test_a_field_that_is_another_for_a_while_is_told_with_its_time(job: Job, seconds: float, said: list[str]) -> None:
    fixes = job.log.fixes["magnetometer"]
    near = (fixes.t > 30.0) & (fixes.t < 30.0 + seconds)
    values = np.where(near[:, None], 1.17 * fixes.values, fixes.values)
    _, told = field_doubts(replace(fixes, values=values), job.log, job.segmentation, job.world)
    assert [w.code for w in told] == said
    assert all("% off its usual size" in w.message for w in told)
    assert all("from 30." in w.message and "to 4" in w.message for w in told)


@pytest.mark.parametrize(
    "change",
    [
        np.hstack([np.eye(3), [[8e-6], [-5e-6], [3e-6]]]),
        np.hstack([np.diag([1.0, 1.0, -1.0]), np.zeros((3, 1))]),
        np.hstack([np.diag([1.3, 0.7, 1.2]), np.zeros((3, 1))]),
    ],
    ids=["hard iron", "z reversed", "soft iron"],
)
def test_iron_is_told_and_covers_heading(job: Job, change: Array) -> None:
    iron, told = doubted(job, change)
    assert told
    assert iron > np.radians(5.0)


def test_a_steep_field_makes_heading_of_tilt(job: Job) -> None:
    fixes, world = job.log.fixes["magnetometer"], job.world
    assert world.field_n is not None
    steep = abs(world.field_n[2]) / float(np.hypot(world.field_n[0], world.field_n[1]))
    assert steepness(fixes, job.log, job.segmentation, world) == pytest.approx(steep)
    blind = replace(world, field_n=None)
    assert steepness(fixes, job.log, job.segmentation, blind) == pytest.approx(steep, rel=0.02)
    sure = job.settings.model_copy(update={
        "magnetometer": job.settings.magnetometer.model_copy(update={"sigma_deg": 0.01}),
        "imu": job.settings.imu.model_copy(update={"accel_bias_sigma": 0.02}),
    })  # fmt: skip
    observed, _ = observe(job.log, job.segmentation, world, job.noise, sure)
    sigma = min(float(o.noise[0, 0]) ** 0.5 for o in observed if o.role == "magnetometer")
    assert sigma > 0.02 / world.gravity * steep


def test_what_makes_heading_vague_is_told_however_little_of_the_field_it_is(job: Job) -> None:
    tilted = rotation.matrix(rotation.exp_quaternion(np.radians([3.0, 0.0, 0.0])))
    iron, told = doubted(job, np.hstack([tilted, np.zeros((3, 1))]))
    assert np.degrees(iron) > 5.0
    assert len(told) == 1
    assert "its dip at the stops" in told[0]
    fixes = job.log.fixes["magnetometer"]
    known = replace(job.log, warnings=(Warn("magnetometer-normalised", "taken as a normalised field"),))
    larger = replace(fixes, values=1.06 * fixes.values)
    assert field_doubts(larger, known, job.segmentation, job.world) == (0.0, [])
    assert field_doubts(larger, job.log, job.segmentation, job.world)[0] > 0.05
