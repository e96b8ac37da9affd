"""Heading sensors that are off by a constant: taken out as far as the fixes show it, in sigma where they do not."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from support.drives import effective

from attest_cli import estimate
from attest_cli.filters.navigation.offsets import Offset, beforehand, datum, settled
from attest_cli.maths import rotation
from attest_cli.maths.kalman import Errors
from attest_cli.prepare import prepare
from attest_cli.records import Fixes, Log
from attest_cli.segment import find_segments
from attest_cli.settings import Settings
from attest_cli.simulate import RoverOptions, simulate_rover
from attest_cli.simulate.rover import rover_drive

Array = NDArray[np.float64]


@cache
def rover(seed: int, sensor: str, odometry: bool) -> tuple[RoverOptions, Log, Settings]:
    """A slow rover with fixes of a metre each second, and a sensor of its heading."""
    sensors = {"sun": False, "odometry": odometry, "compass": False, sensor: True}
    chosen = RoverOptions(
        motions=2, duration_s=120.0, stop_s=(8.0, 12.0), rate_hz=50.0, gps=True, gps_hz=1.0, magnetometer_hz=10.0,
        seed=seed, **sensors,
    )  # fmt: skip
    made = simulate_rover(chosen)
    settings = effective(made, {})
    return chosen, prepare([made.log], settings), settings


def solved(
    seed: int, off_deg: float, sensor: str = "compass", odometry: bool = True
) -> tuple[dict[str, str], float, float]:
    """Return what is told by its codes, and heading error and sigma (rms), deg, of a sensor that is ``off_deg`` off."""
    chosen, log, settings = rover(seed, sensor, odometry)
    off, had = np.radians(off_deg), log.fixes[sensor]
    turn = rotation.matrix(rotation.exp_quaternion(np.array([0.0, 0.0, off])))
    values = had.values + off if sensor == "compass" else had.values @ turn.T  # as a rover on the level sees it
    log = replace(log, fixes={**log.fixes, sensor: Fixes(sensor, had.channel, had.t, values)})
    est = estimate.estimate(log, find_segments(log, settings), settings)
    error_b = rotation.log_quaternion(
        rotation.multiply(rotation.conjugate(est.smoothed.q), rover_drive(chosen).at(est.smoothed.t).q_nb)
    )
    error = np.einsum("ki,ki->k", rotation.matrix(est.smoothed.q)[:, 2], error_b)
    rms = (float(np.degrees(np.sqrt(np.mean(x**2)))) for x in (error, est.passes["smoothed"].sigma_n[:, 2]))
    return {w.code: w.message for w in est.warnings}, *rms


@pytest.mark.parametrize(("sensor", "off"), [("compass", 8.0), ("compass", -40.0), ("magnetometer", 15.0)])
def test_a_heading_sensor_that_is_off_is_told_and_taken_out(sensor: str, off: float) -> None:
    told, error, sigma = solved(1, off, sensor)
    way = "counter-clockwise" if off < 0.0 else "clockwise"  # a field seen counter-clockwise is a heading clockwise
    assert f"too far {way} for" in told[f"{sensor}-offset"]
    assert error < min(3.0 * sigma, 1.0)


@pytest.mark.parametrize("seed", [1, 2])
def test_where_the_fixes_hardly_show_it_sigma_holds_it(seed: int) -> None:
    _, error, sigma = solved(seed, 8.0, odometry=False)
    assert error > 2.0
    assert error < 3.0 * sigma


@pytest.mark.parametrize(("sensor", "odometry"), [("compass", True), ("compass", False), ("magnetometer", False)])
def test_a_sensor_that_is_right_is_left_as_it_is_and_none_is_told(sensor: str, odometry: bool) -> None:
    told, error, sigma = solved(2, 0.0, sensor, odometry)
    assert not told
    assert error < 0.5
    assert error < sigma


def gaussian(prior: float, fix: float, seen: float, sensor_sigma: float, fix_sigma: float) -> tuple[Array, Array]:
    """Mean and covariance of heading and offset, seen by a sensor as heading + offset, and by fixes as heading."""
    H, R = np.array([[1.0, 1.0], [1.0, 0.0]]), np.diag([sensor_sigma**2, fix_sigma**2])
    P = np.linalg.inv(np.diag([1e-12, 1.0 / prior**2]) + H.T @ np.linalg.inv(R) @ H)
    return P @ H.T @ np.linalg.inv(R) @ np.array([seen, fix]), P


@pytest.mark.parametrize("fix", [-0.05, -0.02, 0.0])
def test_an_estimate_with_the_likely_prior_is_that_of_a_new_solution(fix: float) -> None:
    """And its sigma holds the difference to the assumed one."""
    assumed, sensor, fixes = 0.05, 0.01, 0.01
    mean, P = gaussian(assumed, fix, 0.0, sensor, fixes)
    more = assumed**2 / (assumed**2 - P[1, 1])
    offset = Offset("compass", more * mean[1], float(np.sqrt(more * P[1, 1])), assumed, assumed, 1, P[1, 1])
    assert offset.angle == pytest.approx(-fix)
    assert offset.sigma == pytest.approx(np.hypot(sensor, fixes))
    found = settled(np.zeros((1, 2)), Errors(mean[None], P[None], np.zeros((0, 2, 2))), [offset])
    expected, _ = gaussian(max(float(np.sqrt(offset.scatter)), 1e-9), fix, 0.0, sensor, fixes)
    assert found.d[0] == pytest.approx(expected, abs=1e-9)
    assert found.P[0] == pytest.approx(P + np.outer(mean - expected, mean - expected))


@pytest.mark.parametrize(("angle", "told"), [(0.05, False), (0.15, True)])
def test_an_offset_counts_as_told_beyond_what_is_stated_and_what_the_fixes_show(angle: float, told: bool) -> None:
    assert Offset("compass", angle, 0.02, 0.05, 0.05, 0, 1e-4).told is told
    assert not Offset("compass", angle, 0.06, 0.05, 0.05, 0, 1e-3).told


def test_the_backward_pass_knows_the_prior_of_an_offset() -> None:
    x = np.array([[0.0, 0.02], [0.0, 0.03]])
    known = beforehand(x, [Offset("compass", 0.0, 0.1, 0.05, 0.05, 1, 1e-3)])
    assert known is not None
    Y, y = known
    assert pytest.approx(np.diag([0.0, 400.0])) == Y
    assert y == pytest.approx(-400.0 * x)
    assert beforehand(x, []) is None


def test_the_datum_is_what_of_heading_its_offsets_make_and_no_more() -> None:
    """Heading is own noise plus a half of one offset and a third of the other, which go together."""
    rng = np.random.default_rng(3)
    q = rotation.normalise(rng.normal(size=(5, 4)))
    up = rotation.matrix(q)[:, 2]
    of_offsets = np.array([[0.02, 0.006], [0.006, 0.01]])
    share, own = np.array([0.5, 1.0 / 3.0]), 3e-4
    T = np.zeros((5, 5, 3))  # attitude, offsets <- own noise, offsets
    T[:, :3, 0], T[:, :3, 1:] = up, up[:, :, None] * share
    T[:, 3:, 1:] = np.eye(2)
    inner = np.zeros((3, 3))
    inner[0, 0], inner[1:, 1:] = own, of_offsets
    P = T @ inner @ T.swapaxes(1, 2)
    known = [Offset(role, 0.0, 0.02, 0.05, 0.05, at, 1e-4) for role, at in (("compass", 3), ("magnetometer", 4))]
    doubted = sum((o.doubt * x) ** 2 for o, x in zip(known, share, strict=True))
    np.testing.assert_allclose(datum(P, q, known), share @ of_offsets @ share + doubted, rtol=1e-6)
    heading = np.einsum("ki,kij,kj->k", up, P[:, :3, :3], up)
    np.testing.assert_allclose(heading - datum(P, q, known) + doubted, own, rtol=1e-6)
