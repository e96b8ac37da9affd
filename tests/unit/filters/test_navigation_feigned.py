"""What noise feigns of heading and clocks where a vehicle moves slowly: sigma counts it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from attest_cli.filters import Drive
from attest_cli.filters.navigation import feigned, rounds
from attest_cli.filters.navigation.rounds import Navigated, navigate
from attest_cli.maths import rotation
from attest_cli.nodes.noise import find_noise
from attest_cli.records import Fixes, Imu, Log
from attest_cli.segment import find_segments
from attest_cli.settings import Settings
from attest_cli.world import find_world

DRIVES = ((10.0, 25.0, 6.0), (45.0, 25.0, -5.0), (80.0, 25.0, 4.0))  # begin and duration, s; way, m


@cache
def straight(
    seed: int, north: float, share: float = 1.0, shakes: float = 0.4, sigma: float = 0.01, every: float = 1.0
) -> Navigated:
    """A slow vehicle that drives straight, shakes, and stops; fixes of ``sigma`` m, no compass. It looks ``north``,
    rad, and goes a ``share`` of its way.
    """
    rng, t = np.random.default_rng(seed), np.arange(0.0, 115.0, 0.01)
    ahead = np.zeros(len(t))
    for begin, span, way in DRIVES:
        done = (t - begin) / span
        ahead += share * way * 2.0 * np.pi / span**2 * np.sin(2.0 * np.pi * done) * ((done >= 0.0) & (done <= 1.0))
    speed = np.cumsum(ahead) * 0.01
    moves = (np.abs(speed) > 5e-3)[:, None]
    gyro = rng.normal(0.0, 2e-3, (len(t), 3)) + moves * rng.normal(0.0, 0.02, (len(t), 3))
    force = rng.normal(0.0, 0.02, (len(t), 3)) + moves * rng.normal(0.0, shakes, (len(t), 3)) + [0.0, 0.0, 9.80665]
    force[:, 0] += ahead
    when = np.arange(0.5, 114.0, every)
    path = np.interp(when, t, np.cumsum(speed) * 0.01)
    place = path[:, None] * np.array([np.cos(north), np.sin(north), 0.0]) + rng.normal(0.0, sigma, (len(when), 3))
    fixes = {"position": Fixes("position", "fixes", when, place)}
    log = Log((), 0, (t * 1e9).astype(np.int64), Imu(t, gyro, force), fixes, np.zeros((0, 2)), {})
    settings = Settings.model_validate({"smoothing": {"filter": "navigation"}})
    parts = find_segments(log, settings)
    return navigate(Drive(log, parts, find_world(log, settings), find_noise(log, parts, settings), settings))


@pytest.mark.parametrize(("seed", "north"), [(1, 0.0), (2, 2.5), (3, -1.0), (4, 0.5)])
def test_a_heading_that_noise_feigns_is_no_better_than_its_sigma(seed: int, north: float) -> None:
    """The filter alone says five degrees and is off by up to 50."""
    done = straight(seed, north)
    q, P = done.found.smoothed.q, done.found.errors.P[:, :3, :3]
    up = rotation.matrix(q)[:, 2]
    sigma = np.sqrt(np.einsum("ki,kij,kj->k", up, P, up))
    error = 2.0 * np.arctan2(q[:, 3], q[:, 0]) - north
    told = {w.code for w in done.problem.warnings}
    assert done.problem.inertial.slope < 0.8
    assert not done.learnt.lags
    assert ("north-not-shown" in told) == (done.problem.heading == "relative")
    if done.problem.heading == "absolute":
        assert np.degrees(sigma.min()) > 7.0
        assert np.max(np.abs(np.angle(np.exp(1j * error))) / sigma) < 3.0
    else:
        assert np.degrees(np.ptp(np.unwrap(error))) < 5.0  # counts from the start


def test_noise_alone_shows_no_north_however_fast_fixes_come() -> None:
    """Twenty fixes of a millimetre a second of a vehicle that creeps and shakes: what noise feigns says 3 deg."""
    done = straight(1, 1.0, share=0.1, shakes=6.0, sigma=1e-3, every=0.05)
    assert done.problem.heading == "relative"
    assert "north-not-shown" in {w.code for w in done.problem.warnings}


def test_what_the_drive_costs_is_least_where_the_survey_says() -> None:
    """And the filter says the sigma that the survey found, also once it is solved with that."""
    done = straight(5, 2.5, share=1.5)
    assert done.problem.heading == "absolute"
    found = feigned.surveyed(done.problem, done.found)
    assert found is not None
    again, sigma = found
    turn = rotation.log_quaternion(rotation.multiply(again.at.q[:1], rotation.conjugate(done.found.smoothed.q[:1])))
    assert abs(turn[0, 2]) < 0.3 * sigma
    assert np.sqrt(done.found.errors.P[0, 2, 2]) == pytest.approx(sigma, rel=0.3)


def test_only_what_costs_do_not_bear_out_is_doubted() -> None:
    assert feigned.slope(50.0, 50.0) == 1.0
    assert feigned.slope(50.0, 70.0) == 1.0
    assert feigned.slope(50.0, 25.0) == pytest.approx(0.5)
    assert feigned.slope(50.0, -1.0) == 0.0


def test_a_lag_is_borne_out_by_what_the_drive_costs_without_it() -> None:
    done = straight(2, 2.5)
    (clock,) = rounds._clocks(done).values()
    assert not clock.sure
    assert clock.slope < 0.9
