"""A gyro that does not close from the gravity of one stop to that of the next, and why."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from support.drives import Job, simulated

from attest_cli.filters import Drive
from attest_cli.filters.closure import EXPLAINED, MOST_TIED, Motion, _axes, _closes, doubts
from attest_cli.maths.axes import signed_permutations
from attest_cli.nodes.noise import Noise
from attest_cli.records import Log, Warn
from attest_cli.simulate import RoverOptions

Array = NDArray[np.float64]
OPTIONS = RoverOptions(seed=3, duration_s=120.0, rate_hz=50.0, motions=3, stop_s=(8.0, 12.0), sun=False)


@pytest.fixture(scope="module")
def job() -> Job:
    return simulated(OPTIONS)


def drive(job: Job, log: Log) -> Drive:
    return Drive(log, job.segmentation, job.world, job.noise, job.settings)


def told(job: Job, axes: Array, *, raised: bool = True) -> list[str]:
    log = replace(job.log, imu=replace(job.log.imu, gyro_b=job.log.imu.gyro_b @ axes))
    return [w.message for w in doubts(drive(job, log), raised=raised)]


def test_a_sound_gyro_closes(job: Job) -> None:
    assert told(job, np.eye(3)) == []


@pytest.mark.parametrize("axes", [a for a in signed_permutations() if not np.array_equal(a, np.eye(3))][::6])
def test_other_axes_are_told(job: Job, axes: Array) -> None:
    (message,) = told(job, axes)
    assert "contradict each other" in message


def test_a_scale_is_told_with_its_value(job: Job) -> None:
    (message,) = told(job, 1.1 * np.eye(3))
    assert "with 0.91 times its rate" in message


@pytest.mark.parametrize(("factor", "said"), [(2.0, "with 0.50 times"), (0.5, "with 2.00 times")])
def test_a_clock_of_another_rate_is_told_as_such(job: Job, factor: float, said: str) -> None:
    log = replace(job.log, imu=replace(job.log.imu, gyro_b=factor * job.log.imu.gyro_b))
    (told,) = doubts(drive(job, log), raised=True)
    assert (told.code, told.fatal) == ("gyro-scale", True)
    assert said in told.message
    assert "--sample-rate" in told.hint


def test_without_a_doubt_a_small_opening_is_left_alone(job: Job) -> None:
    assert told(job, 1.02 * np.eye(3), raised=False) == []


def test_a_slow_imu_opens_no_wider_for_its_rate() -> None:
    def opening(rate_hz: float) -> float:
        step = max(0.04, 1.0 / rate_hz)  # of turns that are summed
        turns = np.tile([0.0, 0.0, 0.5 * step], (round(60.0 / step), 1))
        up = np.array([0.0, 0.0, 9.8])
        return Motion(60.0, np.array([10.0, 10.0]), turns, up, up).variance(
            Noise(1e-5, 1e-7, 1e-3, {}, gyro_scale=3e-3)
        )

    assert [opening(rate) for rate in (25.0, 10.0, 5.0)] == pytest.approx([opening(100.0)] * 3, rel=1e-6)


def test_one_motion_tells_nothing(job: Job) -> None:
    two = replace(job.segmentation, segments=job.segmentation.segments[:3])
    log = replace(job.log, imu=replace(job.log.imu, gyro_b=-job.log.imu.gyro_b))
    assert doubts(replace(drive(job, log), segmentation=two), raised=True) == []


def of_accelerometer(job: Job, factor: Array, bias: Array, *warnings: Warn) -> list[Warn]:
    imu = replace(job.log.imu, accel_b=job.log.imu.accel_b * factor + bias)
    return doubts(drive(job, replace(job.log, imu=imu, warnings=warnings)), raised=True)


def test_a_bias_of_the_accelerometer_is_told_with_its_size(job: Job) -> None:
    (told,) = of_accelerometer(job, np.ones(3), np.array([0.4, 0.0, 0.0]))
    found = np.array([float(x) for x in told.message.split("bias of ")[1].split(" m/s^2")[0].split(", ")])
    assert (told.code, told.fatal) == ("accel-bias", True)
    assert np.abs(found - [0.4, 0.0, 0.0]).max() < 0.1


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("bias", [0.0, 0.6])
def test_a_bias_is_told_from_a_noisy_gyro(job: Job, bias: float, seed: int) -> None:
    density = 5e-4  # so noisy that it leaves more than a little
    noise = np.random.default_rng(seed).normal(0.0, density * np.sqrt(50.0), job.log.imu.gyro_b.shape)
    imu = replace(job.log.imu, gyro_b=job.log.imu.gyro_b + noise, accel_b=job.log.imu.accel_b + np.array([bias, 0, 0]))
    noisy = replace(drive(job, replace(job.log, imu=imu)), noise=replace(job.noise, gyro_density=density))
    assert [w.code for w in doubts(noisy, raised=False)] == ["accel-bias"] * (bias > 0.0)


@pytest.mark.parametrize("axis", [0, 1])
def test_an_axis_of_the_accelerometer_in_another_unit_is_told(job: Job, axis: int) -> None:
    (told,) = of_accelerometer(job, np.where(np.arange(3) == axis, 1 / 9.80665, 1.0), np.zeros(3))
    assert (told.code, told.fatal) == ("accel-scale", True)
    assert f"accelerometer's {'xyz'[axis]} axis" in told.message


def test_gravity_of_another_size_is_the_accelerometers(job: Job) -> None:
    late = np.linspace(0.0, 0.1, len(job.log.imu.t))[:, None]  # along gravity it tilts nothing
    (told,) = of_accelerometer(job, np.ones(3), late * [0.0, 0.0, 1.0])
    assert (told.code, told.fatal) == ("accel-bias", True)
    assert "gravity changes by 0.0" in told.message


def test_lost_rows_are_not_taken_for_another_cause(job: Job) -> None:
    lost = Warn("imu-rows-missing", "30 % of the rows are missing")
    assert of_accelerometer(job, np.ones(3), np.array([0.4, 0.0, 0.0]), lost) == []


@pytest.mark.parametrize("moved", [0.0, 0.01])
def test_a_rest_that_contradicts_the_bias_is_held_against_gravity(job: Job, moved: float) -> None:
    last = job.segmentation.segments[-2:]
    gone = replace(last[0], end=last[1].end, last=last[1].last)  # the last stop, taken as motion
    doubted = replace(
        job.segmentation, segments=(*job.segmentation.segments[:-2], gone), warnings=(Warn("stop-bias", "doubted"),)
    )
    late = (job.log.imu.t > last[0].start)[:, None]
    log = replace(job.log, imu=replace(job.log.imu, gyro_b=job.log.imu.gyro_b + moved * late * [1.0, 0.0, 0.0]))
    told = doubts(replace(drive(job, log), segmentation=doubted), raised=False)
    assert [(w.code, w.fatal) for w in told] == ([("gyro-bias", True)] if moved else [])


def test_what_is_explained_to_the_last_is_no_chance_however_large_the_noise_may_be() -> None:
    rng = np.random.default_rng(1)
    off, left = (np.concatenate([[size], np.zeros(8)]) for size in (19.0**0.5, 0.01**0.5))
    assert _closes(left, off, 2)
    assert not _closes(0.1 * off, off, 2)
    assert not _closes(0.05 * off[:6], off[:6], 2)
    shares, r = rng.beta(2.0, 1.0, 200_000), 0.02  # six angles, two of them explained
    assert np.mean(shares < r) == pytest.approx(r**2, rel=0.3)
    edge = EXPLAINED**0.5
    assert [_closes(off * (f * edge) ** 0.5, off, 2) for f in (0.9, 1.1)] == [True, False]


@pytest.mark.parametrize("tied", [1, MOST_TIED, MOST_TIED + 1])
def test_axes_that_close_like_many_others_are_not_told(tied: int) -> None:
    class Ends:
        """A motion that other axes miss by 30 mrad if they are among the first, else by 0.2 rad."""

        def back(self, axes: Array) -> Array:
            return axes

        def misfit(self, axes: Array) -> float:
            k = next(k for k, other in enumerate(signed_permutations()) if np.array_equal(other, axes))
            return float(0.03**2 if 1 <= k <= tied else 0.2**2)

    told = _axes([Ends(), Ends()], 0.2)  # type: ignore[list-item]
    assert len(told) == (tied <= MOST_TIED)
