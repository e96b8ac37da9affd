"""The scale error of a gyro that a drive shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.drives import Job, simulated

from attest_cli.filters import Drive, indirect
from attest_cli.filters.scale import AS_IT_COMES, doubted, learn, mended
from attest_cli.maths import rotation
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


def unstated(drive: Drive, assumed: float) -> Drive:
    """The drive of a gyro of whose scale nothing is stated."""
    imu = drive.settings.imu.model_copy(update={"gyro_scale_sigma": None})
    noise = replace(drive.noise, gyro_scale=assumed)
    return replace(drive, noise=noise, settings=drive.settings.model_copy(update={"imu": imu}))


def found(drive: Drive, job: Job) -> tuple[float, float]:
    observations, _ = observe(drive.log, drive.segmentation, drive.world, drive.noise, drive.settings)
    nodes = build_nodes(drive.log, drive.segmentation, observations, drive.noise, drive.settings, None)
    return learn(nodes, indirect.run(nodes, job.start, gate_probability=1.0)).common()


@pytest.mark.parametrize("factor", [0.98, 0.99, 1.0, 1.01, 1.02])
def test_a_scale_is_found_within_its_sigma(job: Job, factor: float) -> None:
    error, sigma = found(scaled(job, factor), job)
    assert sigma < 0.005
    assert abs(error - (1.0 / factor - 1.0)) < 3.0 * sigma


@pytest.mark.parametrize(("factor", "assumed"), [(1.0, 0.003), (0.99, 0.003), (0.99, 0.0)])
def test_outliers_of_the_sun_bend_no_scale(job: Job, factor: float, assumed: float) -> None:
    """One in twenty is 25 deg off."""
    sun, rng = job.log.fixes["sun"], np.random.default_rng(5)
    off = rng.random(len(sun.t)) < 0.05
    values = sun.values + np.where(off[:, None], [0.4, -0.1, 0.0][: sun.values.shape[1]], 0.0)
    drive = unstated(scaled(job, factor), assumed)
    log = replace(drive.log, fixes={**drive.log.fixes, "sun": replace(sun, values=values)})
    exact = indirect._exact(indirect._begin(replace(drive, log=log), None))
    assert exact.nodes.measured.size == sum(1 for group in exact.nodes.measurements if group)
    error, sigma = learn(exact.nodes, exact.run).common()
    assert sigma < 0.005
    assert abs(error - (1.0 / factor - 1.0)) < 3.5 * sigma


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


def test_what_is_likely_counts_as_noise_unless_its_sigma_is_stated(job: Job) -> None:
    stated = scaled(job, 1.0)
    drive = unstated(stated, 0.0)
    better, told = mended(drive, 0.006, 0.002)
    assert better is not None
    assert (better.noise.gyro_scale, told) == (0.006, ())
    assert mended(stated, 0.006, 0.002) == (None, ())
    for error, sigma in ((0.003, 0.002), (0.3, 0.002), (0.1, 0.03)):  # neither
        assert mended(drive, error, sigma) == (None, ())


@pytest.mark.parametrize(("error", "out", "codes"), [
    (0.002, False, []), (0.005, True, []), (-0.005, True, []), (0.01, True, ["gyro-scale"]),
])  # fmt: skip
def test_what_a_gyro_may_have_is_taken_out_in_silence(job: Job, error: float, out: bool, codes: list[str]) -> None:
    drive = unstated(scaled(job, 1.0), 0.003)
    better, told = mended(drive, error, 5e-4)
    assert (better is not None) == out
    if better is not None:
        assert better.noise.gyro_scale == 0.003
        assert not np.array_equal(better.log.imu.gyro_b, drive.log.imu.gyro_b)
    assert [w.code for w in told] == codes


def test_noise_that_is_added_is_that_of_nodes_made_with_it(job: Job) -> None:
    begun = indirect._begin(scaled(job, 1.0), None)
    drive = replace(begun.drive, noise=replace(job.noise, gyro_scale=0.006))
    added, made = indirect._with_noise(begun, drive, 0.9999), indirect._begin(drive, None)
    assert made.nodes.motion_variance() > 1.1 * begun.nodes.motion_variance()
    np.testing.assert_allclose(added.run.chain.P, made.run.chain.P, rtol=1e-6, atol=1e-15)
    np.testing.assert_allclose(added.run.q, made.run.q, atol=1e-7)
    exact = indirect._exact(made)
    np.testing.assert_allclose(exact.run.chain.P, begun.run.chain.P, rtol=1e-6, atol=1e-15)


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
    found = indirect.forward(unstated(Drive(log, made.segmentation, made.world, made.noise, made.settings), 0.0))
    assert (found.noise.gyro_scale > 0.015) == shown


def test_a_doubt_of_the_compass_needs_to_be_sure_to_be_told(job: Job) -> None:
    drive = unstated(scaled(job, 1.0), 0.0)
    none = (0.0, np.inf)
    assert doubted(drive, none, (0.004, 0.002)) == (None, ())
    assert doubted(drive, (0.0, 0.002), (0.01, 0.0019)) == (None, ())  # gravity contradicts it
    for error, told in ((0.006, 0), (0.01, 1)):
        better, warnings = doubted(drive, none, (error, 0.002))
        assert better is not None
        assert (better.noise.gyro_scale, better.log, len(warnings)) == (error, drive.log, told)


@pytest.mark.parametrize(("sun", "scale"), [(False, 0.003), (False, 0.0), (True, 0.003)])
def test_a_heading_that_nothing_sees_is_as_unsure_as_a_scale_error_of_the_turn_since_the_start(
    sun: bool, scale: float
) -> None:
    made = simulated(replace(OPTIONS, seed=6, sun=sun))
    drive = replace(unstated(scaled(made, 1.0), 0.0), noise=replace(made.noise, gyro_scale=scale))
    with_turns, without_turns = indirect.forward(drive), indirect._begin(drive, None)
    R = rotation.matrix(with_turns.run.q)
    heading = [np.einsum("ki,kij,kj->k", R[:, 2], run.chain.P[:, :3, :3], R[:, 2])
               for run in (with_turns.run, without_turns.run)]  # fmt: skip
    assert with_turns.nodes is not None
    vertical = np.einsum("ki,ki->k", R[1:, 2], rotation.log_quaternion(with_turns.nodes.increments.dq))
    turned = np.maximum.accumulate(np.abs(np.cumsum(vertical)))
    expected = (
        np.zeros(len(R)) if sun else (max(scale, AS_IT_COMES) * (scale > 0.0) * np.concatenate([[0.0], turned])) ** 2
    )
    if sun:
        np.testing.assert_allclose(heading[0], heading[1], rtol=1e-6)
    else:
        np.testing.assert_allclose(heading[0] - heading[1], expected, rtol=0.02, atol=2e-8)
    tilt = [np.trace(run.chain.P[:, :3, :3], axis1=1, axis2=2) - h
            for run, h in zip((with_turns.run, without_turns.run), heading, strict=True)]  # fmt: skip
    np.testing.assert_allclose(tilt[0], tilt[1], rtol=0.02)
    again = with_turns.nodes.rebuild(with_turns.run.bias).increments.Q
    np.testing.assert_allclose(again, with_turns.nodes.increments.Q, rtol=0.05, atol=1e-15)
