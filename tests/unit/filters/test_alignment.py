"""The start: level by gravity, turned to the first heading, with a prior that holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from support.drives import Job, in_motion, simulated
from support.drives import job as again

from attest_cli.errors import AttestError
from attest_cli.filters.alignment import LEAST_PRIOR, _level, align
from attest_cli.maths import rotation
from attest_cli.records import Fixes
from attest_cli.simulate import RoverOptions

Array = NDArray[np.float64]
OPTIONS = RoverOptions(seed=53, duration_s=120.0, motions=2, sun=True, compass=True, magnetometer=True)


@pytest.fixture(scope="module")
def work() -> Job:
    return simulated(OPTIONS)


def only(work: Job, *roles: str) -> Job:
    """The same log with these absolute sensors."""
    log = replace(work.log, fixes={r: f for r, f in work.log.fixes.items() if r in roles})
    return again(log, work.settings, work.drive, work.gyro_bias, work.origin)


def start_error_sigma(work: Job) -> Array:
    """Start error about world axes over the prior's sigma."""
    truth = work.truth(work.nodes.t[:1]).q_nb[0]
    e = rotation.log_quaternion(rotation.multiply(rotation.conjugate(work.start.q), truth))
    R = rotation.matrix(work.start.q)
    return np.asarray((R @ e) / np.sqrt(np.diag(R @ work.start.P[:3, :3] @ R.T)))


@pytest.mark.parametrize(
    "roles", [("sun",), ("compass",), ("magnetometer",), ("sun", "compass", "magnetometer")], ids="+".join
)
def test_every_heading_sensor_aligns(work: Job, roles: tuple[str, ...]) -> None:
    found = only(work, *roles)
    assert found.start.heading == "absolute"
    assert not found.start.in_motion
    ratio = start_error_sigma(found)
    print(roles, "start error, sigma:", ratio.round(2))
    assert np.abs(ratio).max() < 1.0  # the prior is ten times wider than the alignment: one sigma of it is many of that
    sigma = np.sqrt(np.diag(found.start.P)[:3])
    assert sigma.min() >= LEAST_PRIOR * (1 - 1e-12)


def test_without_a_heading_the_start_is_level_and_says_so(work: Job) -> None:
    found = only(work)
    assert found.start.heading == "relative"
    up = rotation.matrix(found.start.q)[2]
    true_up = work.truth(work.nodes.t[:1]).R_nb[0, 2]
    assert np.degrees(np.arccos(up @ true_up)) < 0.2
    R = rotation.matrix(found.start.q)
    assert np.sqrt((R @ found.start.P[:3, :3] @ R.T)[2, 2]) < 1e-3  # heading is zero by definition


def test_a_magnetometer_without_its_reference_gives_magnetic_heading(work: Job) -> None:
    nodes = only(work, "magnetometer").nodes
    assert align(nodes, 0.01, magnetic=True).heading == "magnetic"
    assert align(nodes, 0.01, magnetic=False).heading == "absolute"


def test_an_orientation_sensor_aligns_alone(work: Job) -> None:
    t = work.log.imu.t[::100]
    q = -work.truth(t).q_nb
    log = replace(work.log, fixes={"orientation": Fixes("orientation", "x", t, q)})
    found = again(log, work.settings, work.drive, work.gyro_bias)
    assert found.start.heading == "absolute"
    assert np.abs(start_error_sigma(found)).max() < 1.0


def test_a_start_in_motion_is_carried_back_from_the_first_stop() -> None:
    found = in_motion(RoverOptions(seed=54, motions=2, motion_s=(60.0, 90.0)), 15.0)
    assert found.start.in_motion
    ratio = start_error_sigma(found)
    print("start in motion, sigma:", ratio.round(2))
    assert np.abs(ratio).max() < 3.0
    assert np.sqrt(np.trace(found.start.P[:3, :3])) > 1.5 * np.sqrt(3) * LEAST_PRIOR  # it grows with the time carried


def test_bias_prior_is_the_settings(work: Job) -> None:
    start = align(work.nodes, 0.0123, magnetic=False)
    assert np.allclose(start.P[3:, 3:], 0.0123**2 * np.eye(3))
    assert not start.P[:3, 3:].any()


def test_nothing_to_level_with_is_refused(work: Job) -> None:
    groups = tuple(tuple(m for m in g if m.role == "compass") for g in work.nodes.measurements)
    with pytest.raises(AttestError, match="attitude at the start"):
        align(replace(work.nodes, measurements=groups), 0.01, magnetic=False)


@pytest.mark.parametrize("up", [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0.3, -0.8, 0.2], [1e-12, 0, -1]])
def test_level_takes_up_to_the_vertical(up: list[float]) -> None:
    v = np.array(up, dtype=np.float64)
    v /= np.linalg.norm(v)
    assert np.allclose(rotation.matrix(_level(v)) @ v, [0.0, 0.0, 1.0], atol=1e-9)


def test_level_is_the_smallest_turn() -> None:
    v = Rotation.from_euler("x", 50, degrees=True).as_matrix().T @ [0.0, 0.0, 1.0]
    assert np.degrees(np.linalg.norm(rotation.log_quaternion(_level(v)))) == pytest.approx(50.0)
