"""Components of the noise: fixes that jump, and noise of a stretch that is not all of the log."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from attest_cli.filters import Drive
from attest_cli.filters.navigation import components
from attest_cli.filters.navigation.aids import UNSEEN, Place, scaled_sigma
from attest_cli.filters.navigation.identify import stretch
from attest_cli.filters.navigation.rounds import Navigated, navigate
from attest_cli.filters.navigation.solve import forward, pile
from attest_cli.filters.navigation.states import time_of
from attest_cli.maths import adjoint
from attest_cli.nodes.noise import find_noise
from attest_cli.records import Fixes, Imu, Log
from attest_cli.segment import find_segments
from attest_cli.settings import Settings
from attest_cli.world import find_world

Array = NDArray[np.float64]
SECONDS, JUMPS = 120.0, ((41.0, 0.9), (83.0, -0.7))  # s, m


@cache
def car(
    jumps: tuple[tuple[float, float], ...], white: float = 0.03, wanders: tuple[float, float, float] = (0.0, 0.0, 1.0),
    hole: tuple[float, float] = (0.0, 0.0),
) -> tuple[Navigated, Array]:  # fmt: skip
    """A car on a plane with fixes of a few centimetres, to which each jump adds its metres from then on, solved; and
    the truth at its nodes, east and north. Fixes wander level and up, by m, in s, and are silent in a hole.
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
    kept, steps = np.exp(-1.0 / wanders[2]), rng.normal(0.0, 1.0, (len(when), 3)) * np.array(wanders)[[0, 0, 1]]
    place += lfilter([np.sqrt(1.0 - kept**2)], [1.0, -kept], steps, axis=0)
    heard = (when < hole[0]) | (when > hole[1])
    when, place = when[heard], place[heard]
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


def test_errors_of_fixes_level_and_up_are_of_their_own_size() -> None:
    done, _ = car((), 0.02, (0.1, 0.5, 20.0))
    sigma = {state.name: float(np.max(state.sigma)) for state in done.problem.layout.coloured()}
    assert sigma["position drift up"] > 5.0 * sigma["position drift"]


def test_errors_of_fixes_are_no_worse_level_than_up() -> None:
    place = next(aid for aid in car(())[0].problem.aids if isinstance(aid, Place))
    factors = {"position drift": 2.0, "position drift up": 2.0}
    larger, smaller = (80.0, 20.0), (20.0, 30.0)
    free = dict(zip(factors, (smaller, larger), strict=True))
    assert components._ordered([place], factors, free) == free
    tied = components._ordered([place], factors, dict(zip(factors, (larger, smaller), strict=True)))
    assert tied == dict.fromkeys(factors, (100.0, 50.0))


def test_a_correlation_time_goes_where_the_slope_of_the_likelihood_leads() -> None:
    problem = (done := car((), 0.02, (0.0, 0.5, 4.0))[0]).problem
    name = "position drift up"
    state = next(s for s in problem.layout.coloured() if s.name == name)
    driven = 0.5 * np.sqrt(state.correlation_s / 4.0)  # what drives it is right, only it lasts too long
    free = {"accelerometer": 0.02, "position": 0.1, name: float(driven / np.max(state.sigma))}
    window = stretch(problem.layout, problem.prior[1], problem.inertial, problem.aids, done.found.smoothed, 10_000)
    P0, lin, placed = window.under(free)
    rows = pile(placed, len(window.at.q), window.form.size)
    run = forward(P0, lin, rows, np.zeros(window.form.size))
    steps = dict(components._of_times(window, free, lin, run, adjoint.adjoints(run)))
    shorter = 4.0 / state.correlation_s
    right = {**free, name: free[name] * np.sqrt(shorter), time_of(name): shorter}
    assert window.log_likelihood(right) > window.log_likelihood(free) + 2.0
    assert steps[time_of(name)] < -0.03


def test_a_hole_of_the_fixes_has_the_mean_factor_of_their_jumps() -> None:
    done, _ = car(JUMPS, hole=(55.0, 70.0))
    stamps, factors = done.learnt.jumps["position"]
    behind = int(np.argmax(stamps > 60.0))
    assert factors[behind] >= np.mean(np.delete(factors, behind)) > 1.2


def test_hidden_fixes_do_not_show_where_they_jumped() -> None:
    problem = (done := car(JUMPS)[0]).problem
    window = stretch(problem.layout, problem.prior[1], problem.inertial, problem.aids, done.found.smoothed, 10_000)
    node = next(aid.node for aid in problem.aids if aid.role == "position")  # type: ignore[attr-defined]
    hidden = np.arange(len(node)) // 10 % 2 == 1
    usual, unseen = (
        next(s.loose for s in w.form.states if s.name == "position drift")
        for w in (window, window._unseen("position", node, hidden))
    )
    assert usual is not None
    assert unseen is not None
    fix = np.searchsorted(node, np.arange(1, len(window.at.q)))
    among = np.isin(fix, np.flatnonzero(hidden))
    np.testing.assert_allclose(unseen[among], UNSEEN * usual.mean())
    deep = np.isin(fix, np.flatnonzero(~hidden & ~np.roll(hidden, 1)))
    np.testing.assert_array_equal(unseen[deep], usual[deep])
