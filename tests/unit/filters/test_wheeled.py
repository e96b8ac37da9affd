"""The vertical that wheels and accelerometer show in motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.drives import Job, simulated

from attest_cli.filters import Drive, indirect, wheeled
from attest_cli.filters.scale import learn
from attest_cli.maths import rotation
from attest_cli.nodes.observations import Observation
from attest_cli.records import Fixes
from attest_cli.simulate import RoverOptions

OPTIONS = RoverOptions(seed=5, duration_s=90.0, rate_hz=50.0, motions=2, stop_s=(8.0, 12.0), sun=False, compass=True,
                       odometry=True)  # fmt: skip


@pytest.fixture(scope="module")
def job() -> Job:
    return simulated(OPTIONS)


def drive_of(job: Job, factor: float = 1.0, odometry: Fixes | None = None) -> Drive:
    imu = replace(job.log.imu, gyro_b=factor * job.log.imu.gyro_b)
    fixes = {**job.log.fixes, "odometry": odometry or job.log.fixes["odometry"]}
    return Drive(replace(job.log, imu=imu, fixes=fixes), job.segmentation, job.world, job.noise, job.settings)


def seen(drive: Drive) -> list[Observation]:
    begun = indirect._begin(drive, None)
    return wheeled.verticals(drive, begun.nodes, begun.run)


def test_they_are_that_of_the_truth_within_their_sigma(job: Job) -> None:
    found = seen(drive_of(job))
    assert len(found) > 20
    truth = job.truth(np.array([o.t for o in found])).q_nb
    level = rotation.rotate(truth, np.array([o.values[0] for o in found]))[:, :2]
    nis = np.sum(level**2, axis=1) / np.array([o.noise[0, 0] for o in found])
    assert 0.3 < nis.mean() / 2.0 < 2.0


def test_without_the_wheels_speed_they_would_lean(job: Job) -> None:
    """Wheels that say nothing: what the vehicle gains over a window is taken for tilt."""
    wheels = job.log.fixes["odometry"]
    drive, forward = drive_of(job), np.array([1.0, 0.0, 0.0])
    found = []
    for start in np.arange(job.segmentation.motions[0].start, job.segmentation.motions[0].end - 2.0, 2.0):
        for speed in (wheels, replace(wheels, values=0.0 * wheels.values)):
            up, at = wheeled._vertical(drive, drive.log.imu.gyro_b, speed, forward, start)
            truth = rotation.matrix(job.truth(drive.log.imu.t[at : at + 1]).q_nb)[0]
            found.append(float(np.linalg.norm((truth @ up)[:2])))
    off, wrong = np.sqrt(np.mean(np.reshape(found, (-1, 2)) ** 2, axis=0))
    assert off < 0.5 * wrong


def test_a_bias_of_the_accelerometer_is_shared_by_the_windows_of_a_motion(job: Job) -> None:
    imu = job.settings.imu.model_copy(update={"accel_bias_sigma": 0.05})
    drive = drive_of(job)
    rough = replace(drive, settings=drive.settings.model_copy(update={"imu": imu}))
    begun = indirect._begin(drive, None)
    small, large = (wheeled.verticals(d, begun.nodes, begun.run) for d in (drive, rough))
    bounds = [(s.start, s.end) for s in job.segmentation.motions]
    for start, end in bounds:
        added = [b.noise[0, 0] - a.noise[0, 0] for a, b in zip(small, large, strict=True) if start < a.t < end]
        assert len(added) * (0.05 / job.world.gravity) ** 2 == pytest.approx(added[0], rel=1e-3)


def test_they_show_a_scale_of_the_gyro_that_stops_and_compass_hardly_do(job: Job) -> None:
    drive = drive_of(job, 0.98)
    begun = indirect._begin(drive, None)
    alone = learn(begun.nodes, begun.run).common()
    more = indirect._exact(indirect._begin(drive, None, seen(drive)))
    error, sigma = learn(more.nodes, more.run).common()
    assert sigma < 0.5 * alone[1]
    assert abs(error - (1.0 / 0.98 - 1.0)) < 3.0 * sigma
    found = indirect.forward(drive)
    assert "gyro-scale" in {w.code for w in found.warnings}
    truth = job.truth(found.run.t)
    off = rotation.log_quaternion(rotation.multiply(rotation.conjugate(found.run.q), truth.q_nb))
    wrong = rotation.log_quaternion(rotation.multiply(rotation.conjugate(begun.run.q), truth.q_nb))
    assert np.sqrt(np.mean(off[:, :2] ** 2)) < 0.5 * np.sqrt(np.mean(wrong[:, :2] ** 2))


@pytest.mark.parametrize("axes", [np.diag([1.1, 1.0, 1.0]), np.diag([1.0, 0.95, 1.0]), np.diag([1.0, 1.0, 1.1])])
def test_with_them_errors_of_single_axes_are_found_and_taken_out(job: Job, axes: np.ndarray) -> None:
    sound = drive_of(job)
    imu = replace(sound.log.imu, gyro_b=sound.log.imu.gyro_b @ axes.T)
    drive = replace(sound, log=replace(sound.log, imu=imu))
    begun = indirect._begin(drive, None)
    more = wheeled.verticals(drive, begun.nodes, begun.run)
    exact = indirect._exact(indirect._begin(drive, None, more))
    evidence = learn(exact.nodes, exact.run)
    assert evidence.differ(0.003)
    found, sigma = indirect._axes(drive, evidence, more)
    assert np.abs((found - axes) / sigma).max() < 3.5
    assert sigma.diagonal().max() < 0.05
    result = indirect.forward(drive)
    (told,) = [w for w in result.warnings if w.code == "gyro-scale"]
    assert f"about {'xyz'[int(np.argmax(np.abs(axes.diagonal() - 1.0)))]}" in told.message
    off = rotation.log_quaternion(rotation.multiply(rotation.conjugate(result.run.q), job.truth(result.run.t).q_nb))
    sigmas = np.sqrt(np.diagonal(result.run.chain.P, axis1=1, axis2=2)[:, :3])
    assert np.sqrt(np.mean((off / sigmas) ** 2)) < 2.0


@pytest.mark.parametrize("factor", [1.0, 0.98])
def test_axes_that_share_a_scale_do_not_differ(job: Job, factor: float) -> None:
    drive = drive_of(job, factor)
    exact = indirect._exact(indirect._begin(drive, None, seen(drive)))
    assert not learn(exact.nodes, exact.run).differ(0.0)


def test_none_stands_where_wheels_are_silent_nor_where_there_are_few(job: Job) -> None:
    wheels = job.log.fixes["odometry"]
    hole = (wheels.t > 20.0) & (wheels.t < 30.0)
    holed = replace(wheels, t=wheels.t[~hole], values=wheels.values[~hole],
                    sigma=None if wheels.sigma is None else wheels.sigma[~hole])  # fmt: skip
    found = seen(drive_of(job, odometry=holed))
    assert found
    assert not [o.t for o in found if 21.0 < o.t < 29.0]
    assert seen(drive_of(simulated(replace(OPTIONS, duration_s=28.0, motions=1)))) == []


def test_there_are_none_without_wheels(job: Job) -> None:
    drive = drive_of(job)
    bare = replace(drive, log=replace(drive.log, fixes={"compass": drive.log.fixes["compass"]}))
    assert seen(bare) == []
