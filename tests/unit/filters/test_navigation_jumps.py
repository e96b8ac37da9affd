"""Fixes that leap and stay there are told and taken out; bad fixes, fast motion and noise are no leaps."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from attest_cli.filters.navigation.aids import Place
from attest_cli.filters.navigation.jumps import doubts, jump_states, jumps, mended
from attest_cli.filters.navigation.model import Trajectory
from attest_cli.filters.navigation.states import CORE, State, layout
from attest_cli.maths import rotation
from attest_cli.records import Imu

Array = NDArray[np.float64]
GRAVITY, SIGMA = 9.80665, 0.01
LEAP = np.array([0.5, -0.2, 0.1])


def moved(seed: int, turn: float = 0.0) -> tuple[Imu, Array, Array, Place]:
    """A minute of something that swings about, its fixes at 10 Hz; the attitude is off by ``turn`` in heading."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 60.0, 0.01)
    rate, phase, size = rng.uniform(0.5, 2.0, (3, 3)), rng.uniform(0.0, 6.0, (3, 3)), rng.normal(0.0, 0.4, (3, 3))
    waves = [np.outer(t, r) + f for r, f in zip(rate, phase, strict=True)]
    p = np.stack([np.sin(w) @ s for w, s in zip(waves, size, strict=True)], axis=1)
    a = -np.stack([np.sin(w) @ (s * r**2) for w, s, r in zip(waves, size, rate, strict=True)], axis=1)
    force = a + np.array([0.0, 0.0, GRAVITY]) + rng.normal(0.0, 0.05, a.shape)
    q = rotation.exp_quaternion(np.array([0.0, 0.0, turn]))
    when = t[5::10]
    fixes = p[5::10] + rng.normal(0.0, SIGMA, (len(when), 3))
    place = Place(np.arange(len(when)), when, fixes, np.full(fixes.shape, SIGMA), np.zeros(3), "position")
    return Imu(t, np.zeros_like(a), force), t[::10], np.tile(q, (len(t[::10]), 1)), place


def bent(place: Place, by: Array, *rows: slice) -> Place:
    place_n = place.place_n.copy()
    for part in rows:
        place_n[part] += by
    return Place(place.node, place.t, place_n, place.sigma, place.lever_b, place.role)


@pytest.mark.parametrize("turn", [0.0, 1.5])
@pytest.mark.parametrize("rows", [(slice(200, None),), (slice(200, None), slice(450, None))])
def test_leaps_are_found_taken_out_and_told(turn: float, rows: tuple[slice, ...]) -> None:
    imu, t, q, place = moved(1, turn)
    found = jumps(imu, t, q, bent(place, LEAP, *rows), GRAVITY)
    assert [jump.row for jump in found] == [part.start for part in rows]
    assert all(np.linalg.norm(jump.by - LEAP) < 3.0 * jump.sigma for jump in found)
    better = mended(bent(place, LEAP, *rows), found)
    assert np.abs(better.place_n - place.place_n).max() < 0.15
    (told,) = doubts(better, found)
    assert told.code == "position-jump"
    assert "20.0" in told.message or "20.1" in told.message
    assert not told.fatal


@pytest.mark.parametrize("seed", [2, 3, 4, 5])
@pytest.mark.parametrize("rows", [(), (slice(200, 201),), (slice(200, 203),)])
def test_noise_motion_and_single_bad_fixes_are_no_leaps(seed: int, rows: tuple[slice, ...]) -> None:
    """A few bad fixes leap there and back: that is told, but nothing is left of it."""
    imu, t, q, place = moved(seed)
    found = jumps(imu, t, q, bent(place, LEAP, *rows), GRAVITY)
    assert np.linalg.norm(sum((jump.by for jump in found), start=np.zeros(3))) < 0.15
    assert len(found) == (2 if rows and rows[0].stop - rows[0].start > 2 else 0)


@pytest.mark.parametrize("turn", [0.0, 1.5, 3.1])
def test_a_short_move_is_no_leap_in_whatever_heading_it_is_felt(turn: float) -> None:
    """Three of 0.4 m in 0.7 s, between fixes of 1 Hz."""
    rng, t = np.random.default_rng(4), np.arange(0.0, 120.0, 0.01)
    p, a = np.zeros((len(t), 3)), np.zeros((len(t), 3))
    for begin in (30.7, 60.7, 90.7):
        x = np.clip((t - begin) / 0.7, 0.0, 1.0)
        p[:, 0] += 0.4 * (x - np.sin(2.0 * np.pi * x) / (2.0 * np.pi))
        a[:, 0] += 0.4 * 2.0 * np.pi / 0.7**2 * np.sin(2.0 * np.pi * x)
    force = a + np.array([0.0, 0.0, GRAVITY]) + rng.normal(0.0, 0.02, a.shape)
    fixes = p[::100] + rng.normal(0.0, SIGMA, (len(t[::100]), 3))
    place = Place(np.arange(len(fixes)), t[::100], fixes, np.full(fixes.shape, SIGMA), np.zeros(3), "position")
    q = np.tile(rotation.exp_quaternion(np.array([0.0, 0.0, turn])), (len(t[::10]), 1))
    assert jumps(Imu(t, np.zeros_like(a), force), t[::10], q, place, GRAVITY) == []


def test_fixes_that_leap_all_the_time_are_left_to_their_noise() -> None:
    imu, t, q, place = moved(1)
    assert not jumps(imu, t, q, bent(place, LEAP, *(slice(k, None) for k in range(50, 550, 40))), GRAVITY)


def test_what_is_left_of_a_leap_is_a_state_of_the_fixes_after_it() -> None:
    imu, t, q, place = moved(1)
    found = jumps(imu, t, q, bent(place, LEAP, slice(200, None)), GRAVITY)
    aid = mended(place, found)
    states = [State(name, 3, 1.0) for name in CORE]
    form = layout([*states, *jump_states(aid, found)])
    assert form.prior()[-3:] == pytest.approx(found[0].sigma ** 2)
    at = Trajectory(q[: len(aid.t)], np.zeros((len(aid.t), form.size)))
    at.x[:, form.parts["position jump"]] = [0.1, 0.2, 0.3]
    rows = aid.rows(form, at)
    change = aid.rows(form, Trajectory(at.q, np.zeros_like(at.x))).r - rows.r
    assert change[:200] == pytest.approx(0.0)
    assert change[200:] == pytest.approx(np.tile([0.1, 0.2, 0.3], (len(change) - 200, 1)))
    assert np.all(rows.H[200:, :, form.parts["position jump"]] == np.eye(3))
    assert not rows.H[:200, :, form.parts["position jump"]].any()
