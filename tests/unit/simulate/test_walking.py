"""The walking robot: exact truth in all cases, the stated gait, accelerations, kicks and noise."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.signals import (
    accel_of,
    assert_variance,
    attitude_error,
    channel,
    gauss_points,
    gyro_bias_of,
    gyro_of,
    stack,
)

from attest_cli.errors import AttestError
from attest_cli.prepare import prepare
from attest_cli.segment import find_segments
from attest_cli.settings import Settings
from attest_cli.simulate import Simulation, WalkingOptions, simulate_walking
from attest_cli.simulate.drive import GRAVITY_M_S2
from attest_cli.simulate.walking import ACCEL_NOISE_M_S2, CASES, GYRO_NOISE, GYRO_WALK, Case, Walk

PERIOD = 0.005


@cache
def simulated(case: Case, **options: Any) -> tuple[Simulation, Walk]:
    """A walk and its exact motion, made once; only to be read."""
    return simulate_walking(options_of(case, **options)), Walk.of(options_of(case, **options))


def options_of(case: Case, **options: Any) -> WalkingOptions:
    return WalkingOptions(**{"seed": 3, "case": case, **options})


def angles(simulation: Simulation) -> np.ndarray:
    """Roll, pitch, yaw (n, 3) rad of the truth."""
    q = stack(simulation.truth, "q_w", "q_x", "q_y", "q_z")
    return Rotation.from_quat(q, scalar_first=True).as_euler("ZYX")[:, ::-1]


def velocity(simulation: Simulation) -> np.ndarray:
    return stack(simulation.truth, *(f"velocity_{a}_m_s" for a in "xyz"))


@pytest.mark.parametrize("case", CASES)
def test_integrating_the_clean_gyro_gives_the_true_attitude(case: Case) -> None:
    walk = Walk.of(options_of(case))
    coarse, fine = (attitude_error(walk.at, 4.0, 30.0, step) for step in (0.01, 0.005))
    assert fine < 2e-8
    assert 10.0 < coarse / fine < 24.0  # fourth order: what is left is the integrator's error, not the truth's


@pytest.mark.parametrize("case", CASES)
def test_integrating_the_specific_force_gives_the_true_velocity_and_position(case: Case) -> None:
    walk = Walk.of(options_of(case))
    begin, step, count = 4.0, 5e-4, 18_000  # fine: the kicks have corners
    first, second = gauss_points(begin, step, count)
    one, two = walk.at(first), walk.at(second)
    a1, a2 = (np.einsum("nij,nj->ni", k.R_nb, k.force_b) - [0.0, 0.0, GRAVITY_M_S2] for k in (one, two))
    gained = np.cumsum(step / 2 * (a1 + a2), axis=0)
    grid = begin + step * np.arange(count + 1)
    clean = walk.at(grid)
    np.testing.assert_allclose(gained, clean.velocity_n[1:], atol=1e-4 if case == "C" else 1e-6)
    moved = np.cumsum(step / 2 * (one.velocity_n + two.velocity_n), axis=0)
    np.testing.assert_allclose(moved, clean.position_n[1:] - clean.position_n[0], atol=1e-6)


@pytest.mark.parametrize("case", CASES)
def test_standing_nothing_moves_at_all(case: Case) -> None:
    walk = Walk.of(options_of(case))
    for start, end in walk.stops(120.0):
        still = walk.at(np.linspace(start, end, 300))
        assert not still.moving.any()
        assert np.all(still.velocity_n == 0.0)
        np.testing.assert_allclose(still.rate_b, 0.0, atol=1e-15)
        np.testing.assert_allclose(still.force_b, GRAVITY_M_S2 * still.R_nb[:, 2, :], atol=1e-12)


def test_the_trot_swings_as_stated_and_its_velocity_stays_bounded() -> None:
    simulation, walk = simulated("A", duration_s=125.0)
    t, walking = simulation.truth["t_s"], simulation.truth["t_s"] >= 7.0
    assert simulation.stops.tolist() == [[0.0, 5.0]]
    roll, pitch, _ = angles(simulation)[walking].T
    for angle, hz, wanted in ((roll, 1.25, 4.0), (pitch, 2.5, 3.0)):
        wave = np.exp(-2j * np.pi * hz * t[walking])
        assert 2 * abs(np.mean((angle - angle.mean()) * wave)) == pytest.approx(math.radians(wanted), rel=0.03)
    for angle, gait in ((roll, 4.0), (pitch, 3.0)):
        slow = np.sqrt(2 * np.var(angle) - math.radians(gait) ** 2)  # two sinusoids of 4-6 and 2-4 deg
        assert math.radians(4.2) < slow < math.radians(7.5)
    assert np.unwrap(angles(simulation)[:, 2])[walking][-1] == pytest.approx(0.3 * (125.0 - 5.5), abs=0.01)
    assert np.abs(velocity(simulation)).max() < 1.5
    calm = walk.kicks[0].at(walk.kicks[0].start - 1e-3)[0]
    np.testing.assert_allclose(calm, 0.0, atol=1e-15)  # each footfall has given its speed back before the next


def test_footfalls_have_the_stated_size() -> None:
    walk = Walk.of(WalkingOptions(duration_s=1200.0))
    peaks = walk.kicks[0].peak / (1.5 * GRAVITY_M_S2)
    assert_variance(peaks[:, 2] - 1.0, 0.3)
    assert_variance(peaks[:, :2], 0.4)
    np.testing.assert_allclose(np.diff(walk.kicks[0].start), 0.4)


def test_stop_and_go_has_the_stated_rhythm_and_accelerations() -> None:
    simulation, walk = simulated("B")
    np.testing.assert_allclose(simulation.stops[:3], [[0.0, 5.0], [17.0, 23.0], [35.0, 41.0]])
    assert np.all(velocity(simulation)[~simulation.truth["moving"]] == 0.0)
    t = np.array([6.25, 10.99, 15.75])
    speed, push, _, _ = walk.drive.at(t)
    np.testing.assert_allclose(push, np.array([0.08, 0.0, -0.08]) * GRAVITY_M_S2, atol=1e-12)
    _, turning = walk.angles(t)
    assert turning[1, 2] * speed[1] == pytest.approx(0.05 * GRAVITY_M_S2)
    assert turning[0, 2] == turning[2, 2] == 0.0
    assert walk.turn.at(np.array([9.49, 12.51]))[1].tolist() == [0.0, 0.0]


def test_impulses_are_sparse_and_the_rest_is_quiet() -> None:
    walk = Walk.of(WalkingOptions(case="C", duration_s=605.0))
    clean = walk.at(np.arange(5.0, 305.0, PERIOD))
    quiet = np.abs(np.linalg.norm(clean.force_b, axis=1) - GRAVITY_M_S2) < 1e-9
    assert quiet.mean() == pytest.approx((1 - 0.025) ** 3, abs=0.01)
    for kicks in walk.kicks:
        assert kicks.start.size == 600
        assert_variance(kicks.peak[:, np.any(kicks.peak, axis=0)], 1.5 * GRAVITY_M_S2)


@pytest.mark.parametrize("case", CASES)
def test_errors_have_the_stated_size(case: Case) -> None:
    simulation, walk = simulated(case, bias_deg_s=0.5)
    clean, bias = walk.at(simulation.truth["t_s"]), gyro_bias_of(simulation)
    assert clean.t.size == 24_000
    np.testing.assert_allclose(np.diff(clean.t), PERIOD, atol=1e-12)
    assert_variance(gyro_of(simulation) - clean.rate_b - bias, GYRO_NOISE / math.sqrt(PERIOD))
    assert_variance(accel_of(simulation) - clean.force_b, ACCEL_NOISE_M_S2)
    assert_variance(np.diff(bias, axis=0), GYRO_WALK * math.sqrt(PERIOD))
    np.testing.assert_allclose(np.abs(bias[0]), math.radians(0.5), rtol=1e-12)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("bias_deg_s", [0.05, 0.5])
def test_the_stops_are_found(case: Case, bias_deg_s: float) -> None:
    simulation, _ = simulated(case, bias_deg_s=bias_deg_s)
    settings = Settings.model_validate(simulation.settings)
    found = find_segments(prepare([simulation.log], settings), settings).stops
    np.testing.assert_allclose([[s.start, s.end] for s in found], simulation.stops, atol=0.6)
    assert settings.imu.gyro_noise_density == GYRO_NOISE


def test_a_seed_fixes_every_bit_and_the_bias_changes_nothing_else() -> None:
    one, other = simulated("B")[0], simulated("B", bias_deg_s=0.5)[0]
    again, different = simulate_walking(options_of("B")), simulated("B", seed=4)[0]
    assert gyro_of(one).tobytes() == gyro_of(again).tobytes()
    assert accel_of(one).tobytes() == accel_of(again).tobytes() == accel_of(other).tobytes()
    assert not np.allclose(gyro_of(one), gyro_of(different), atol=1e-3)
    assert {c.role for c in one.log.channels} == {"imu"}
    assert channel(one, "imu").stamps_ns.dtype == np.int64


@pytest.mark.parametrize(("option", "value"), [("case", "D"), ("bias_deg_s", -1.0), ("duration_s", 0.5)])
def test_options_out_of_reach_are_refused(option: str, value: Any) -> None:
    with pytest.raises(AttestError, match="choose"):
        WalkingOptions(**{option: value})
