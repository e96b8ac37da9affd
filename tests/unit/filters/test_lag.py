"""Lags of sun, compass and orientation, told by the gyro."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.drives import Job, simulated

from attest_cli.filters import lag
from attest_cli.filters.lag import find_lags
from attest_cli.maths import rotation
from attest_cli.records import Fixes, Log, Smoothed
from attest_cli.settings import Settings
from attest_cli.simulate import RoverOptions

OPTIONS = RoverOptions(
    seed=4, duration_s=120.0, rate_hz=50.0, motions=2, stop_s=(8.0, 10.0), sun_always=True, compass=True
)


@pytest.fixture(scope="module")
def job() -> Job:
    return simulated(OPTIONS)


def smoothed(job: Job, turn_deg: float = 0.0) -> Smoothed:
    """The true attitude at nodes, turned about the vertical."""
    t = job.log.imu.t[::5]
    q = rotation.multiply(rotation.exp_quaternion(np.radians([0.0, 0.0, turn_deg])), job.truth(t).q_nb)
    return Smoothed(t, q, np.zeros((len(t), 3)), np.zeros((len(t), 6, 6)), np.zeros((len(t) - 1, 6, 6)))


def late(job: Job, **lags: float) -> Log:
    """The log with sensors late; an orientation of one degree besides."""
    rng = np.random.default_rng(5)
    t = np.arange(0.0, job.log.imu.t[-1], 0.5)
    q = rotation.multiply(job.truth(t).q_nb, rotation.exp_quaternion(rng.normal(0.0, np.radians(1.0), (len(t), 3))))
    fixes = {**job.log.fixes, "orientation": Fixes("orientation", "/orientation", t, q)}
    return replace(job.log, fixes={role: replace(f, t=f.t + lags.get(role, 0.0)) for role, f in fixes.items()})


def test_sensors_in_time_have_no_lag(job: Job) -> None:
    assert find_lags(late(job), smoothed(job), job.world, job.settings) == {}
    assert find_lags(late(job), smoothed(job, 5.0), job.world, job.settings) == {}


@pytest.mark.parametrize("tau", [-3.0, -0.3, 0.4, 5.0])
@pytest.mark.parametrize("role", ["sun", "compass", "orientation"])
def test_a_lag_is_found_whatever_the_heading(role: str, tau: float, job: Job) -> None:
    found = find_lags(late(job, **{role: tau}), smoothed(job, 3.0), job.world, job.settings)
    if role == "compass" and abs(tau) < 1.0 and not found:
        return  # three degrees of noise hide it
    assert found.keys() == {role}
    assert found[role] == pytest.approx(tau, abs=0.5 if role == "compass" else 0.05)


def test_outliers_make_no_lag(job: Job) -> None:
    log = late(job)
    values = log.fixes["sun"].values.copy()
    values[::10] = -values[::10]
    log = replace(log, fixes={**log.fixes, "sun": replace(log.fixes["sun"], values=values)})
    assert find_lags(log, smoothed(job), job.world, job.settings) == {}


def test_few_measurements_tell_nothing(job: Job) -> None:
    log = late(job, sun=1.0)
    few = {role: replace(f, t=f.t[:15], values=f.values[:15]) for role, f in log.fixes.items()}
    assert find_lags(replace(log, fixes=few), smoothed(job), job.world, Settings()) == {}


def test_a_heading_that_is_far_off_as_a_whole_makes_no_lag(job: Job) -> None:
    """As where the compass was disturbed at the first stop, from which the attitude has its heading."""
    assert find_lags(late(job), smoothed(job, 35.0), job.world, job.settings) == {}
    found = find_lags(late(job, compass=4.0), smoothed(job, -170.0), job.world, job.settings)
    assert found["compass"] == pytest.approx(4.0, abs=0.5)


def test_what_only_one_stretch_shows_is_no_lag() -> None:
    before, late = np.full(80, 4.0), np.full(80, 4.0)
    late[:20] = 0.5
    assert not lag._explains(late, before, 80)
    late[40:60] = 0.5
    assert lag._explains(late, before, 80)
    assert not lag._explains(np.full(80, 12.0), np.full(80, 16.0), 80)
