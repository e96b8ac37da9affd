"""Components of the noise: fixes that jump, and noise of a stretch that is not all of the log."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from attest_cli.filters import Drive
from attest_cli.filters.navigation.aids import scaled_sigma
from attest_cli.filters.navigation.rounds import Navigated, navigate
from attest_cli.nodes.noise import find_noise
from attest_cli.records import Fixes, Imu, Log
from attest_cli.segment import find_segments
from attest_cli.settings import Settings
from attest_cli.world import find_world

Array = NDArray[np.float64]
SECONDS, JUMPS = 120.0, ((41.0, 0.9), (83.0, -0.7))  # s, m


@cache
def car(jumps: tuple[tuple[float, float], ...], white: float = 0.03) -> tuple[Navigated, Array]:
    """A car on a plane with fixes of a few centimetres, to which each jump adds its metres from then on, solved; and
    the truth at its nodes, east and north.
    """
    rng = np.random.default_rng(7)
    t = np.arange(0.0, SECONDS, 0.02)
    heading, speed = 0.8 * np.sin(0.15 * t) + 0.02 * t, 8.0 + 3.0 * np.sin(0.3 * t)
    rate = 0.12 * np.cos(0.15 * t) + 0.02
    v = speed[:, None] * np.stack([np.cos(heading), np.sin(heading), 0.0 * t], axis=1)
    p = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (v[1:] + v[:-1]) * 0.02, axis=0)])
    zero = np.zeros_like(t)
    gyro = np.stack([zero, zero, rate], axis=1) + rng.normal(0.0, 2e-3, (len(t), 3))
    force = np.stack([0.9 * np.cos(0.3 * t), speed * rate, zero + 9.80665], axis=1)
    force += rng.normal(0.0, 0.05, force.shape)
    when = np.arange(0.5, SECONDS - 1.0, 1.0)
    place = np.stack([np.interp(when, t, p[:, i]) for i in range(3)], axis=1) + rng.normal(0.0, white, (len(when), 3))
    for at, metres in jumps:
        place[when > at, 1] += metres
    fixes = {"position": Fixes("position", "fixes", when, place)}
    log, settings = Log((), 0, (t * 1e9).astype(np.int64), Imu(t, gyro, force), fixes, np.zeros((0, 2)), {}), Settings()
    segmentation = find_segments(log, settings)
    noise = find_noise(log, segmentation, settings)
    done = navigate(Drive(log, segmentation, find_world(log, settings), noise, settings))
    return done, np.stack([np.interp(done.nodes.t, t, p[:, i]) for i in range(2)], axis=1)


def test_the_fixes_that_jump_are_found_and_no_others() -> None:
    done, _ = car(JUMPS)
    stamps, factors = done.learnt.jumps["position"]
    assert stamps[np.sort(np.argsort(factors)[-2:])] == pytest.approx([at + 0.5 for at, _ in JUMPS])
    assert np.sort(factors)[-2] > 10.0
    assert np.sort(factors)[-3] < 3.0


def test_jumps_do_not_count_as_noise_of_the_imu_nor_bend_the_path() -> None:
    (done, truth), (calm, _) = car(JUMPS), car(())
    assert np.sort(calm.learnt.jumps["position"][1])[-1] < 3.0
    noise, usual = (np.sqrt(np.median(d.problem.inertial.accel)) for d in (done, calm))
    assert noise < 2.0 * usual
    error = done.found.smoothed.p[:, 1] - truth[:, 1]
    around = (done.nodes.t > JUMPS[0][0] - 15.0) & (done.nodes.t < JUMPS[0][0] + 15.0)
    slope = np.polyfit(done.nodes.t[around], error[around], 1)[0]
    assert abs(slope) < 0.05  # a path that followed the fixes would turn by 0.9 m in a second


@pytest.mark.parametrize("white", [0.03, 0.5])
def test_noise_of_fixes_is_found_white_though_it_begins_coloured(white: float) -> None:
    done, _ = car((), white)
    (place,) = (aid for aid in done.problem.aids if aid.role == "position")
    assert np.median(place.sigma) == pytest.approx(white, rel=0.4)  # type: ignore[attr-defined]


def test_a_sigma_found_is_no_smaller_than_any_sensor_but_a_stated_one_stays() -> None:
    np.testing.assert_allclose(scaled_sigma(np.array([0.5, 5e-4]), 1e-3), [1e-3, 5e-4])
    np.testing.assert_allclose(scaled_sigma(np.array([0.5, 5e-4]), 3.0), [1.5, 1.5e-3])
