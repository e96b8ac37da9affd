"""The model of the navigation smoother against its own differences, and the heading of a slow rover with wheels."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from support.drives import effective

from attest_cli.filters import Drive, indirect
from attest_cli.filters.navigation.aids import Magnetometer, Place, Wheels
from attest_cli.filters.navigation.model import Trajectory, linearise
from attest_cli.filters.navigation.problem import MOTIONS, PLACE_S, Problem, assemble
from attest_cli.filters.navigation.rounds import believed
from attest_cli.filters.navigation.start import heading_of_wheels, mirrored
from attest_cli.maths import rotation
from attest_cli.nodes.noise import find_noise
from attest_cli.prepare import prepare
from attest_cli.records import Imu
from attest_cli.segment import find_segments
from attest_cli.simulate import RoverOptions, simulate_rover
from attest_cli.world import find_world

Array = NDArray[np.float64]
STEP = 1e-5
OPTIONS = RoverOptions(
    scenario="S2",
    motions=2,
    motion_s=(30.0, 40.0),
    stop_s=(8.0, 10.0),
    odometry=True,
    gps=True,
    compass=True,
    magnetometer=True,
    seed=5,
)


@cache
def drive() -> Drive:
    made = simulate_rover(OPTIONS)
    settings = effective(made, {"smoothing": {"filter": "navigation"}})
    log = prepare([made.log], settings)
    segmentation = find_segments(log, settings)
    return Drive(log, segmentation, find_world(log, settings), find_noise(log, segmentation, settings), settings)


@cache
def problem() -> Problem:
    """The problem of a drive with every kind of aid, about a trajectory that is some way off."""
    work = drive()
    begun = indirect.forward(work, np.zeros(0))
    nodes = begun.nodes
    assert nodes is not None
    q, bias = begun.run.q, begun.run.bias
    made = assemble(work, nodes, q, bias, "absolute", {}, believed(work, nodes, q, bias))
    rng = np.random.default_rng(1)
    d = 0.1 * np.sqrt(np.minimum(made.layout.prior(), 1.0)) * rng.normal(size=made.layout.size)
    return replace(made, at=made.at.moved(np.tile(d, (len(nodes.t), 1))))


def steps(group: str, *, upright: bool = False) -> Array:
    """The same step (n, s) at every node in one group of states; of the attitude about the vertical if ``upright``."""
    layout, at = problem().layout, problem().at
    part = layout.parts[group]
    step = np.zeros((len(at.q), layout.size))
    step[:, part] = np.random.default_rng(2).normal(size=part.stop - part.start)
    if upright and group == "attitude":
        step[:, part] = rotation.matrix(at.q)[:, 2]
    return step


@pytest.mark.parametrize("group", [s.name for s in problem().layout.states])
def test_the_rows_of_every_aid_are_its_differences(group: str) -> None:
    """A step in one group, the same at all nodes. Wheels see the body bounce: their mean speed is close, not equal. A
    magnetometer's attitude is about the vertical only.
    """
    layout, at = problem().layout, problem().at
    for aid in problem().aids:
        step = steps(group, upright=isinstance(aid, Magnetometer))
        rows = aid.rows(layout, at)
        ahead, back = (aid.rows(layout, at.moved(way * STEP * step)).r for way in (1.0, -1.0))
        slope = (back - ahead) / (2.0 * STEP)
        expected = np.einsum("kij,kj->ki", rows.H, step[rows.node])
        near = 5e-3 if isinstance(aid, Wheels) else 2e-5
        assert np.abs(slope - expected).max() <= near * max(np.abs(expected).max(), 1e-3), aid.role


@pytest.mark.parametrize("group", [s.name for s in problem().layout.states])
def test_the_motion_is_linearised_as_its_differences(group: str) -> None:
    """In the axes of the body, in which its noise is told: what is left of the motion turns with it; what is left of
    its turn counts about where it ends.
    """
    layout, at, inertial, step = problem().layout, problem().at, problem().inertial, steps(group)

    def left(at: Trajectory) -> Array:
        return in_body(at, linearise(inertial, layout, at).u)

    lin = linearise(inertial, layout, at)
    ahead, back = (left(at.moved(way * STEP * step)) for way in (1.0, -1.0))
    slope = (ahead - back) / (2.0 * STEP)
    slope[:, :3] = np.einsum("kij,kj->ki", rotation.right_jacobian(-lin.u[:, :3]), slope[:, :3])
    expected = in_body(at, np.einsum("kij,kj->ki", lin.Phi, step[:-1]) - step[1:])
    assert np.abs(slope - expected).max() <= 5e-4 * max(np.abs(expected).max(), 1e-3)


def in_body(at: Trajectory, u: Array) -> Array:
    """Velocity and position among errors (n - 1, s) in the axes of each interval's first attitude."""
    turned = u.copy()
    for i in (3, 6):
        turned[:, i : i + 3] = rotation.rotate(rotation.conjugate(at.q[:-1]), u[:, i : i + 3])
    return turned


@pytest.mark.parametrize("turn", [-2.5, 0.4])
def test_a_slow_rover_finds_north_by_its_wheels(turn: float) -> None:
    """A rover of 0.3 m/s and fixes of half a metre: its path shows the heading."""
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 300.0, 0.1)
    heading = 1.2 * np.sin(0.02 * t)
    ahead = np.stack([np.cos(heading), np.sin(heading), 0.0 * t], axis=1)
    path = np.cumsum(0.03 * ahead, axis=0)
    north = rotation.matrix(rotation.exp_quaternion(np.array([0.0, 0.0, turn])))
    R_vb = rotation.matrix(rotation.exp_quaternion(np.array([0.2, -0.3, 1.0])))  # how the IMU sits
    q = rotation.multiply(
        rotation.exp_quaternion(np.stack([0.0 * t, 0.0 * t, heading], axis=1)), rotation.from_matrix(R_vb)
    )
    k = np.arange(len(t))
    speed = np.array([0.3, 0.0, 0.0]) + rng.normal(0.0, 0.02, (len(t), 3))
    wheels = Wheels(k, t, speed, np.ones((len(t), 3)), R_vb, np.zeros(2), np.zeros((len(t), 3)), np.zeros(3))
    seen = path[::50] @ north.T + rng.normal(0.0, 0.5, (len(t[::50]), 3))
    place = Place(k[::50], t[::50], seen, np.ones((len(seen), 3)), np.zeros(3))
    found, sigma = heading_of_wheels(t, q, wheels, place)
    assert abs(np.angle(np.exp(1j * (found - turn)))) < 4.0 * sigma
    assert sigma < 0.1
    imu = Imu(t, np.zeros((len(t), 3)), np.zeros((len(t), 3)))  # not asked where there are wheels
    assert not mirrored(imu, t, q, place, wheels)
    swapped = seen[:, [1, 0, 2]] * np.array([1.4, 1.0, 1.0])  # as degrees of longitude are shorter
    assert mirrored(imu, t, q, replace(place, place_n=swapped), wheels)
    straight = np.stack([np.linspace(0.0, 90.0, len(seen)), np.zeros(len(seen)), np.zeros(len(seen))], axis=1)
    assert not mirrored(imu, t, q, replace(place, place_n=straight), wheels)


def test_the_bound_on_the_place_of_a_hand_counts_once_for_every_ten_seconds() -> None:
    """Else the mean place of a minute would be known to a quarter of a metre, and who takes a step is off by more."""
    work = drive()
    held = work.settings.model_copy(update={"navigation": work.settings.navigation.model_copy(
        update={"motion": "handheld"})})  # fmt: skip
    work = replace(work, settings=held)
    nodes = indirect.forward(work, np.zeros(0)).nodes
    assert nodes is not None
    q, none = np.tile([1.0, 0.0, 0.0, 0.0], (len(nodes.t), 1)), np.zeros((len(nodes.t), 3))
    made = assemble(work, nodes, q, none, "absolute", {}, None)
    (place,) = (aid for aid in made.aids if aid.role == "place")
    moves = float(np.sum(np.gradient(nodes.t)[nodes.moving]))
    share = float(np.sum(place.sigma**-2.0)) * MOTIONS["handheld"][0] ** 2
    assert share == pytest.approx(moves / (2.0 * PLACE_S), rel=0.01)
    assert PLACE_S >= 10.0
