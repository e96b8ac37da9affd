"""A delay between gyro and accelerometer of different channels, by the edges of their rests."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from attest_cli.prepare.halves import doubts

Array = NDArray[np.float64]
NAMES = ("gyro.csv", "accel.csv")


def shaken(t: Array, lead: float = 0.0) -> Array:
    """Noise of a sensor at ``t`` that shakes in three motions; ``lead``: what it does before and after them."""
    rng = np.random.default_rng(3)
    moving = np.zeros(len(t), dtype=bool)
    for a, b in ((8.0, 20.0), (28.0, 41.0), (50.0, 63.0)):
        moving |= (t > a - lead) & (t < b + lead)
    return rng.normal(0.0, 1.0, (len(t), 3)) * np.where(moving, 0.2, 0.01)[:, None]


@pytest.mark.parametrize("delay", [0.3, -0.5, 1.2])
def test_a_delay_is_found(delay: float) -> None:
    t = np.arange(0.0, 70.0, 0.01)
    told = doubts(NAMES, t, shaken(t), shaken(t - delay))
    assert [w.fatal for w in told] == [True]
    word = "late" if delay > 0 else "early"
    assert f" s {word} against gyro.csv" in told[0].message
    assert float(told[0].message.split(" is ")[1].split(" ")[0]) == pytest.approx(abs(delay), abs=0.06)


def test_one_clock_is_left_alone() -> None:
    t = np.arange(0.0, 70.0, 0.01)
    assert doubts(NAMES, t, shaken(t), shaken(t)) == []


def test_a_vehicle_that_pulls_away_before_it_turns_has_no_delay() -> None:
    t = np.arange(0.0, 70.0, 0.01)
    assert doubts(NAMES, t, shaken(t), shaken(t, lead=0.6)) == []


def test_without_rests_nothing_is_told() -> None:
    t = np.arange(0.0, 70.0, 0.01)
    assert doubts(NAMES, t, shaken(t), np.random.default_rng(1).normal(0.0, 1.0, (len(t), 3))) == []
