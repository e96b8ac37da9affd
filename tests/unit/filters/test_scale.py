"""The scale error of a gyro that a drive shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.drives import Job, simulated

from attest_cli.filters import Drive, indirect
from attest_cli.filters.scale import doubted, learn, mended
from attest_cli.nodes import build_nodes
from attest_cli.nodes.observations import observe
from attest_cli.simulate import RoverOptions

OPTIONS = RoverOptions(seed=3, duration_s=200.0, rate_hz=50.0, motions=4, stop_s=(8.0, 12.0), sun=True)


@pytest.fixture(scope="module")
def job() -> Job:
    return simulated(OPTIONS)


def scaled(job: Job, factor: float) -> Drive:
    log = replace(job.log, imu=replace(job.log.imu, gyro_b=factor * job.log.imu.gyro_b))
    return Drive(log, job.segmentation, job.world, job.noise, job.settings)


def found(drive: Drive, job: Job) -> tuple[float, float]:
    observations, _ = observe(drive.log, drive.segmentation, drive.world, drive.noise, drive.settings)
    nodes = build_nodes(drive.log, drive.segmentation, observations, drive.noise, drive.settings, None)
    return learn(nodes, indirect.run(nodes, job.start, gate_probability=1.0))


@pytest.mark.parametrize("factor", [0.98, 0.99, 1.0, 1.01, 1.02])
def test_a_scale_is_found_within_its_sigma(job: Job, factor: float) -> None:
    error, sigma = found(scaled(job, factor), job)
    assert sigma < 0.005
    assert abs(error - (1.0 / factor - 1.0)) < 3.0 * sigma


def test_its_estimate_is_that_of_the_likelihood(job: Job) -> None:
    """The squared innovations of three runs, each with another scale, lie on a parabola with that minimum."""
    error, sigma = found(scaled(job, 1.01), job)
    totals = []
    for step in (-2e-3, 0.0, 2e-3):
        drive = scaled(job, 1.01 * (1.0 + step))
        observations, _ = observe(drive.log, drive.segmentation, drive.world, drive.noise, drive.settings)
        nodes = build_nodes(drive.log, drive.segmentation, observations, drive.noise, drive.settings, None)
        totals.append(float(indirect.run(nodes, job.start, gate_probability=1.0).innovations.nis.sum()))
    curve = (totals[0] - 2.0 * totals[1] + totals[2]) / 2e-3**2
    slope = (totals[2] - totals[0]) / 4e-3
    assert sigma == pytest.approx((0.5 * curve) ** -0.5, rel=0.1)
    assert error == pytest.approx(-slope / curve, rel=0.1)


def test_what_is_sure_is_taken_out_and_told(job: Job) -> None:
    drive = scaled(job, 1.02)
    better, told = mended(drive, *found(drive, job))
    assert better is not None
    assert [w.code for w in told] == ["gyro-scale"]
    again, sigma = found(better, job)
    assert abs(again) < sigma


def test_what_is_likely_counts_as_noise_and_what_is_neither_as_nothing(job: Job) -> None:
    drive = scaled(job, 1.0)
    better, told = mended(drive, 0.006, 0.002)
    assert better is not None
    assert (better.noise.gyro_scale, told) == (0.006, ())
    assert mended(drive, 0.003, 0.002) == (None, ())
    assert mended(drive, 0.3, 0.002) == (None, ())
    assert mended(drive, 0.1, 0.03) == (None, ())


def test_noise_that_is_added_is_that_of_nodes_made_with_it(job: Job) -> None:
    begun = indirect._begin(scaled(job, 1.0), None)
    drive = replace(begun.drive, noise=replace(job.noise, gyro_scale=0.006))
    added, made = indirect._noisier(begun, drive), indirect._begin(drive, None)
    assert made.nodes.motion_variance() > 1.1 * begun.nodes.motion_variance()
    np.testing.assert_allclose(added.run.chain.P, made.run.chain.P, rtol=1e-6, atol=1e-15)
    np.testing.assert_allclose(added.run.q, made.run.q, atol=1e-7)


def test_a_sound_drive_runs_once_and_as_before(job: Job) -> None:
    drive = scaled(job, 1.0)
    run = indirect.forward(drive)
    assert run.noise == job.noise
    assert run.warnings == ()


def test_a_drive_with_a_scale_ends_as_sure_as_one_without(job: Job) -> None:
    sound, faulty = (indirect.forward(scaled(job, factor)) for factor in (1.0, 1.02))
    assert [w.code for w in faulty.warnings] == ["gyro-scale"]
    nis = [f.run.innovations.nis[f.run.innovations.used].sum() for f in (sound, faulty)]
    assert nis[1] == pytest.approx(nis[0], rel=0.1)


@pytest.mark.parametrize("seed", [4, 5])
def test_iron_in_a_compass_is_no_scale_of_the_gyro(seed: int) -> None:
    made = simulated(replace(OPTIONS, seed=seed, sun=False, compass=True))
    compass = made.log.fixes["compass"]
    bent = replace(compass, values=compass.values + np.radians(8.0) * np.sin(compass.values))
    log = replace(made.log, fixes={**made.log.fixes, "compass": bent})
    drive = Drive(log, made.segmentation, made.world, replace(made.noise, gyro_scale=0.003), made.settings)
    assert "gyro-scale" not in {w.code for w in indirect.forward(drive).warnings}


@pytest.mark.parametrize(("factor", "off_deg", "shown"), [(0.98, 0.0, True), (1.0, 0.0, False), (1.0, 15.0, False)])
def test_a_scale_that_only_the_compass_shows_counts_as_noise(factor: float, off_deg: float, shown: bool) -> None:
    """Not what the compass reads at one stop, which no scale explains."""
    made = simulated(RoverOptions(seed=14, duration_s=90.0, rate_hz=50.0, motions=2, stop_s=(8.0, 12.0), sun=False,
                                  compass=True))  # fmt: skip
    compass, (stop, *_) = made.log.fixes["compass"], made.segmentation.stops
    values = compass.values + np.radians(off_deg) * (compass.t < stop.end)[:, None]
    imu = replace(made.log.imu, gyro_b=factor * made.log.imu.gyro_b)
    log = replace(made.log, imu=imu, fixes={"compass": replace(compass, values=values)})
    found = indirect.forward(Drive(log, made.segmentation, made.world, made.noise, made.settings))
    assert (found.noise.gyro_scale > 0.015) == shown


def test_a_doubt_of_the_compass_needs_to_be_sure_to_be_told(job: Job) -> None:
    drive = scaled(job, 1.0)
    none = (0.0, np.inf)
    assert doubted(drive, none, (0.004, 0.002)) == (None, ())
    assert doubted(drive, (0.0, 0.002), (0.01, 0.0019)) == (None, ())  # gravity contradicts it
    for error, told in ((0.006, 0), (0.01, 1)):
        better, warnings = doubted(drive, none, (error, 0.002))
        assert better is not None
        assert (better.noise.gyro_scale, better.log, len(warnings)) == (error, drive.log, told)
