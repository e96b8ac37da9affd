"""Fixes in other axes, another unit, or against the heading of another sensor are told; those as they should be are
not.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from attest_cli.filters.navigation import _noisy, _wandering, frame
from attest_cli.filters.navigation.aids import Place
from attest_cli.filters.navigation.start import lag_of
from attest_cli.filters.navigation.states import State
from attest_cli.maths import rotation
from attest_cli.records import Fixes, Imu
from attest_cli.settings import Settings

Array = NDArray[np.float64]
GRAVITY = 9.80665
RIGHT = np.eye(3)
UP = RIGHT[2]


def moved(flat: float = 1.0) -> tuple[Imu, Array, Array, Array, Array]:
    """Half a minute of a thing that is carried about at level: IMU at 100 Hz, its nodes, attitude, and path; ``flat``:
    share of the motion that is up.
    """
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 30.0, 0.01)
    rate, phase, size = rng.uniform(1.0, 3.0, (3, 4)), rng.uniform(0.0, 6.0, (3, 4)), rng.normal(0.0, 0.3, (3, 4))
    size[2] *= flat
    p = np.stack([np.sin(np.outer(t, r) + f) @ s for r, f, s in zip(rate, phase, size, strict=True)], axis=1)
    a = -np.stack([np.sin(np.outer(t, r) + f) @ (s * r**2) for r, f, s in zip(rate, phase, size, strict=True)], axis=1)
    q = rotation.exp_quaternion(np.stack([0.0 * t, 0.0 * t, 0.3 * t], axis=1))
    force = rotation.rotate(rotation.conjugate(q), a + UP * GRAVITY) + rng.normal(0.0, 0.05, (len(t), 3))
    return Imu(t, np.zeros((len(t), 3)), force), t[::10], q[::10], p, t


def fixes(p: Array, t: Array, Q: Array, late: float = 0.0, sigma: float = 0.005, role: str = "position") -> Place:
    """Return fixes at 20 Hz."""
    when = np.arange(0.5, 29.0, 0.05)
    seen = np.stack([np.interp(when - late, t, p[:, i]) for i in range(3)], axis=1) @ Q.T
    seen += np.random.default_rng(4).normal(0.0, sigma, seen.shape)
    return Place(np.searchsorted(t[::10], when), when, seen, np.full(seen.shape, sigma), np.zeros(3), role)


@pytest.mark.parametrize(
    ("Q", "words"),
    [
        (RIGHT, ""), (rotation.matrix(rotation.exp_quaternion(np.array([0.0, 0.0, 2.0]))), ""), (1.3 * RIGHT, ""),
        (rotation.matrix(rotation.exp_quaternion(np.array([0.15, 0.0, 0.0]))), ""),
        (RIGHT[[1, 0, 2]], "mirror image"), (np.diag([-1.0, 1.0, 1.0]), "mirror image"),
        (np.diag([1.0, 1.0, -1.0]), "height downwards"), (RIGHT[[1, 0, 2]] * [1.0, 1.0, -1.0], "height downwards"),
        (RIGHT[[0, 2, 1]], "90 deg from the vertical"), (1000.0 * RIGHT, "times as far"),
        (0.3048 * RIGHT, "times as far"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("late", [0.0, 0.3])
def test_axes_and_unit_of_fixes_are_held_against_the_path_that_the_imu_feels(Q: Array, words: str, late: float) -> None:
    imu, nodes, q, p, t = moved()
    found = frame.frame_of(imu, nodes, q, fixes(p, t, Q, late), GRAVITY)
    assert found is not None
    told = frame.doubts("position", found)
    assert [w.code for w in told] == ["position-frame"] * bool(words)
    assert all(words in w.message and w.fatal for w in told)


@pytest.mark.parametrize(("flat", "sigma"), [(0.0, 0.005), (1.0, 3.0)])
def test_what_a_flat_or_noisy_path_does_not_show_is_not_told(flat: float, sigma: float) -> None:
    imu, nodes, q, p, t = moved(flat)
    assert frame.frame_of(imu, nodes, q, fixes(p, t, np.diag([1.0, 1.0, -1.0]), sigma=sigma), GRAVITY) is None


@pytest.mark.parametrize(
    ("late", "sigma", "found"),
    [(0.0, 0.01, 0.0), (0.5, 0.01, 0.0), (5.0, 0.01, 5.0), (-3.4, 0.2, -3.4), (5.0, 5.0, 0.0)],
)
@pytest.mark.parametrize("turn", [0.0, 2.0])
def test_fixes_on_another_clock_are_told_by_how_much(late: float, sigma: float, found: float, turn: float) -> None:
    imu, nodes, q, p, t = moved()
    R = rotation.matrix(rotation.exp_quaternion(np.array([0.0, 0.0, turn])))
    assert lag_of(imu, nodes, q, fixes(p, t, R, late, sigma)) == pytest.approx(found)


@pytest.mark.parametrize(
    ("off", "role", "sensor", "ended", "fatal"),
    [
        (0.0, "gps", "compass", 0.0, None), (0.15, "gps", "compass", 0.15, None), (0.7, "gps", "compass", 0.0, True),
        (0.7, "gps", "magnetometer", 0.0, False), (0.7, "gps", "magnetometer", 0.7, True),
        (-3.0, "position", "magnetometer", 0.0, True), (0.7, "gps", "", 0.7, None),
    ],
)  # fmt: skip
def test_a_heading_that_the_way_of_the_fixes_contradicts_is_told(
    off: float, role: str, sensor: str, ended: float, fatal: bool | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It fails the run, unless many fixes overruled a magnetometer."""
    imu, nodes, q, p, t = moved()

    def turned(by: float) -> Array:
        return rotation.multiply(rotation.exp_quaternion(np.array([0.0, 0.0, by])), q)

    done: Any = SimpleNamespace(
        nodes=SimpleNamespace(t=nodes), problem=SimpleNamespace(aids=(fixes(p, t, RIGHT, role=role),)),
        begun=SimpleNamespace(run=SimpleNamespace(heading="absolute")),
        found=SimpleNamespace(smoothed=SimpleNamespace(q=turned(ended))),
    )  # fmt: skip
    monkeypatch.setattr(frame, "smoothed_begin", lambda _: (turned(off), np.zeros((len(nodes), 3))))
    log: Any = SimpleNamespace(imu=imu, fixes=dict.fromkeys([sensor, role]))
    told = list(frame.contradicted(log, done, GRAVITY))
    assert [(w.code, w.fatal) for w in told] == ([] if fatal is None else [("heading-contradicted", fatal)])
    assert all(sensor in w.message for w in told)


@pytest.mark.parametrize(("density", "fatal"), [(1e-3, None), (8e-3, False), (5e-2, True)])
def test_a_gyro_that_would_have_to_be_worse_than_any_is_told(density: float, fatal: bool | None) -> None:
    done: Any = SimpleNamespace(
        learnt=SimpleNamespace(factors={"gyro": 1.0}), begun=SimpleNamespace(noise=SimpleNamespace(gyro_density=1e-4)),
        problem=SimpleNamespace(inertial=SimpleNamespace(gyro=np.full(9, density**2))),
    )  # fmt: skip
    assert [w.fatal for w in _noisy(done, explained=False)] == ([] if fatal is None else [fatal])
    assert not any(w.fatal for w in _noisy(done, explained=True))


@pytest.mark.parametrize(("drift", "told"), [(1.0, False), (4.0, False), (16.0, True)])
def test_a_height_that_wanders_as_no_weather_makes_it_is_told(drift: float, told: bool) -> None:
    states = State("height drift", 1, drift, 600.0), State("gps drift", 3, 50.0, 60.0)
    layout = SimpleNamespace(coloured=lambda: states)
    done: Any = SimpleNamespace(problem=SimpleNamespace(layout=layout))
    assert [w.code for w in _wandering(done)] == ["height-wanders"] * told


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (RIGHT, ""), (1.1 * RIGHT, ""), (3.6 * RIGHT, "go 3.6"), (-RIGHT, "turned 180 deg"),
        (np.diag([1.0, 1.0, -1.0]), "rise where its fixes sink"), (RIGHT[[1, 0, 2]], "mirror image"),
    ],
)  # fmt: skip
def test_velocities_that_do_not_lead_along_the_fixes_of_their_receiver_are_told(change: Array, words: str) -> None:
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 90.0, 0.2)
    heading = 0.9 * np.sin(0.1 * t) + 0.05 * t
    v = 8.0 * np.stack([np.cos(heading), np.sin(heading), 0.2 * np.sin(0.15 * t)], axis=1)
    p = np.cumsum(0.2 * v, axis=0)[::5] + rng.normal(0.0, 1.0, (len(t[::5]), 3))
    told = v @ change.T + rng.normal(0.0, 0.1, v.shape)
    values = p / [6.378e6 * np.cos(0.8), 6.378e6, 1.0]
    gps = Fixes("gps", "fix", t[::5], values[:, [1, 0, 2]] + np.array([0.8, 0.1, 400.0]))
    velocity = Fixes("gps_velocity", "v", t, told)
    drive: Any = SimpleNamespace(
        log=SimpleNamespace(fixes={"gps": gps, "gps_velocity": velocity}), settings=Settings()
    )  # fmt: skip
    found = frame.of_receiver(drive)
    assert [w.fatal for w in found] == [True] * bool(words)
    assert all(words in w.message for w in found)
