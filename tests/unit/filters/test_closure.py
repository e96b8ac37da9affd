"""A gyro that does not close from the gravity of one stop to that of the next, and why."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from support.drives import Job, simulated

from attest_cli.filters.closure import doubts
from attest_cli.maths.axes import signed_permutations
from attest_cli.simulate import RoverOptions

Array = NDArray[np.float64]
OPTIONS = RoverOptions(seed=3, duration_s=120.0, rate_hz=50.0, motions=3, stop_s=(8.0, 12.0), sun=False)


@pytest.fixture(scope="module")
def job() -> Job:
    return simulated(OPTIONS)


def told(job: Job, axes: Array, *, raised: bool = True) -> list[str]:
    log = replace(job.log, imu=replace(job.log.imu, gyro_b=job.log.imu.gyro_b @ axes))
    return [w.message for w in doubts(log, job.segmentation, raised=raised)]


def test_a_sound_gyro_closes(job: Job) -> None:
    assert told(job, np.eye(3)) == []


@pytest.mark.parametrize("axes", [a for a in signed_permutations() if not np.array_equal(a, np.eye(3))][::6])
def test_other_axes_are_told(job: Job, axes: Array) -> None:
    (message,) = told(job, axes)
    assert "contradict each other" in message


def test_a_scale_is_told_with_its_value(job: Job) -> None:
    (message,) = told(job, 1.1 * np.eye(3))
    assert "with 0.91 times its rate" in message


def test_without_a_doubt_a_small_opening_is_left_alone(job: Job) -> None:
    assert told(job, 1.02 * np.eye(3), raised=False) == []


def test_one_motion_tells_nothing(job: Job) -> None:
    two = replace(job.segmentation, segments=job.segmentation.segments[:3])
    log = replace(job.log, imu=replace(job.log.imu, gyro_b=-job.log.imu.gyro_b))
    assert doubts(log, two, raised=True) == []
