"""Heading that turns by another factor than the gyro says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from attest_cli.prepare.course import doubts
from attest_cli.records import Fixes, Imu

T = np.arange(30_000) / 50.0


def drive(rng: np.random.Generator) -> tuple[Imu, dict[str, Fixes]]:
    """Ten minutes on the level at 2 m/s, with a compass and fixes."""
    rate = 0.08 * np.sin(0.11 * T) + 0.05 * np.sin(0.05 * T + 1.0)
    heading = np.cumsum(rate) / 50.0
    gyro = np.stack([0.0 * rate, 0.0 * rate, rate], axis=1) + rng.normal(0.0, 1e-3, (len(T), 3)) + 0.002
    xy = np.cumsum(2.0 * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0) / 50.0
    every = slice(None, None, 50)
    noise = rng.normal(0.0, 0.3, (len(T[every]), 2))
    place = np.radians([46.5, 6.6]) + (xy[every] + noise)[:, ::-1] / 6.371e6 / [1.0, np.cos(np.radians(46.5))]
    values, sigma = np.column_stack([place, np.zeros(len(place))]), np.full((len(place), 3), 0.3)
    compass = 0.5 * np.pi - heading[every, None] + rng.normal(0.0, 0.05, (len(place), 1))
    return Imu(T, gyro, np.tile([0.0, 0.0, 9.8], (len(T), 1))), {
        "gps": Fixes("gps", "/fix", T[every], values, sigma),
        "compass": Fixes("compass", "/compass", T[every], compass),
    }


@pytest.mark.parametrize("seed", range(4))
def test_a_heading_that_turns_with_the_gyro_is_silent(seed: int) -> None:
    imu, fixes = drive(np.random.default_rng(seed))
    assert doubts(fixes, imu) == []


@pytest.mark.parametrize("role", ["gps", "compass"])
@pytest.mark.parametrize("factor", [-1.0, 57.3, 0.0175, 10.0])
def test_another_factor_is_told(role: str, factor: float, rng: np.random.Generator) -> None:
    imu, fixes = drive(rng)
    (told,) = doubts({role: fixes[role]}, replace(imu, gyro_b=factor * imu.gyro_b))
    assert told.code == "gyro-against-heading"
    assert float(told.message.split("turns ")[1].split()[0]) == pytest.approx(1.0 / factor, rel=0.15)


def test_few_fixes_tell_nothing(rng: np.random.Generator) -> None:
    imu, fixes = drive(rng)
    few = {role: Fixes(role, f.channel, f.t[:40], f.values[:40]) for role, f in fixes.items()}
    assert doubts(few, replace(imu, gyro_b=-imu.gyro_b)) == []


def test_a_compass_in_radians_that_states_degrees_is_doubted_if_the_gyro_turns(rng: np.random.Generator) -> None:
    imu, fixes = drive(rng)
    few = slice(None, None, 60)  # too few to be compared
    sound = Fixes("compass", "/compass", fixes["compass"].t[few], np.mod(fixes["compass"].values[few], 2.0 * np.pi))
    assert doubts({"compass": sound}, imu) == []
    told = doubts({"compass": replace(sound, values=np.radians(sound.values))}, imu)
    assert [w.code for w in told] == ["unit-doubted"]
    still = replace(imu, gyro_b=0.0 * imu.gyro_b)
    assert doubts({"compass": replace(sound, values=np.radians(sound.values))}, still) == []
