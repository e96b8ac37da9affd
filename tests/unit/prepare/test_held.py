"""Held samples: the rate of the sensor is found, its values count at their time; coarse ones are not held."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from attest_cli.prepare import held, prepare
from attest_cli.records import COLUMNS, Channel, Recording, Warn
from attest_cli.settings import Settings

Array = NDArray[np.float64]
T = np.arange(6000) * 0.01


def measured(seed: int = 1) -> Array:
    """Return gyro and accelerometer (n, 6) of an IMU that rests and turns."""
    turn = np.where(np.sin(T) > 0.0, np.sin(2 * np.pi * 0.5 * T), 0.0)
    signal = turn[:, None] * np.array([0.5, 1.0, -0.3, 1.0, 0.5, 0.2]) + np.array([0, 0, 0, 0, 0, 9.81])
    return np.asarray(signal + np.random.default_rng(seed).normal(0.0, 0.003, signal.shape))


def holding(values: Array, samples: float) -> Array:
    """Return the values as they were at the last of every so many samples."""
    return values[np.rint(np.floor(np.arange(len(values)) / samples) * samples).astype(int)]


@pytest.mark.parametrize("samples", [2, 2.5, 3.3, 4, 5, 10, 20])
def test_new_values_are_found(samples: float) -> None:
    values = holding(measured(), samples)[:, :3]
    found = held.fresh(T, values)
    assert found is not None
    assert np.array_equal(found, np.append(True, np.any(np.diff(values, axis=0) != 0.0, axis=1)))
    assert found.sum() == pytest.approx(len(T) / samples, abs=2)


@pytest.mark.parametrize("count", [1e-6, 1e-3, 5e-3, 0.02, 0.1])
def test_coarse_values_at_rest_are_not_held(count: float) -> None:
    values = np.rint(measured() / count) * count
    assert held.fresh(T, values[:, :3]) is None
    assert held.fresh(T, values[:, 3:]) is None
    stuck = measured()
    stuck[2000:5500] = stuck[2000]
    assert held.fresh(T, stuck[:, :3]) is None


def test_where_the_accelerometer_is_held_a_line_between_its_values_is_far_nearer_and_the_gyro_stays() -> None:
    truth, table = measured(), measured()
    table[:, 3:] = holding(truth, 10)[:, 3:]
    warnings: list[Warn] = []
    keep, found = held.released("log", T, table, warnings)
    assert keep.all()
    assert np.array_equal(found[:, :3], truth[:, :3])
    assert np.abs(found - truth)[:, 3:].mean() < 0.3 * np.abs(table - truth)[:, 3:].mean()
    assert [w.code for w in warnings] == ["imu-held"]


@pytest.mark.parametrize("samples", [5, 10])
def test_where_the_gyro_is_held_its_new_values_count_with_the_mean_force_about_them(samples: int) -> None:
    table = measured()
    table[:, 3:] = T[:, None] * [1.0, -2.0, 3.0] + np.random.default_rng(2).normal(0.0, 0.1, (len(T), 3))
    table[:, :3] = holding(table, samples)[:, :3]
    warnings: list[Warn] = []
    keep, found = held.released("log", T, table, warnings)
    assert np.array_equal(np.flatnonzero(keep), np.arange(0, len(T), samples))
    assert np.array_equal(found[keep, :3], table[::samples, :3])
    off = (found[keep, 3:] - T[keep, None] * [1.0, -2.0, 3.0])[1:-1]
    assert np.abs(off.mean(axis=0)).max() < 0.01
    assert off.std() == pytest.approx(0.1 / np.sqrt(samples), rel=0.1)
    assert "rows of new values" in warnings[0].message


def test_where_both_are_held_the_rows_of_new_values_are_kept() -> None:
    warnings: list[Warn] = []
    keep, found = held.released("log", T, holding(measured(), 5), warnings)
    assert np.array_equal(np.flatnonzero(keep), np.arange(0, len(T), 5))
    assert np.array_equal(found[keep], measured()[::5])
    assert "gyro (20 Hz) and accelerometer (20 Hz)" in warnings[0].message


def test_a_log_tells_it_once_and_a_stuck_sensor_stays_stuck() -> None:
    table = holding(measured(), 5)
    table[:, 3:] = measured()[:, 3:]
    table[3000:3300, :3] = table[3000, :3]
    channel = Channel("imu", "columns", "imu", np.rint(T * 1e9).astype(np.int64),
                      dict(zip(COLUMNS["imu"], table.T, strict=True)),
                      dict(zip(COLUMNS["imu"], ["rad/s"] * 3 + ["m/s^2"] * 3, strict=True)))  # fmt: skip
    recording = Recording(Path("log.csv"), "csv", (channel,), len(T))
    log = prepare([recording], Settings())
    assert [w.code for w in log.warnings][:2] == ["imu-held", "imu-stuck"]
    assert "stuck for 2.95 s" in log.warnings[1].message
    assert log.coverage["rows_in"] == pytest.approx(len(T) / 5, abs=1)
    assert log.gaps[0] == pytest.approx([30.0, 33.0], abs=0.06)
    clean = dict(zip(COLUMNS["imu"], measured().T, strict=True))
    assert "imu-held" not in {
        w.code for w in prepare([replace(recording, channels=(replace(channel, values=clean),))], Settings()).warnings
    }


def test_rows_of_zeros_are_no_samples_but_a_rest_without_gravity_is() -> None:
    table = measured()
    rows = np.random.default_rng(5).choice(len(T), 120, replace=False)
    table[rows] = 0.0
    assert np.array_equal(np.flatnonzero(held.blank(T, table)), np.sort(rows))
    table[1000:1100] = 0.0
    assert not held.blank(T, table)[1000:1100].any()
    assert not held.blank(T, measured()).any()
    assert not held.blank(T, np.zeros((len(T), 6))).any()
    lone = measured()
    lone[77, :5] = 0.0
    assert not held.blank(T, lone).any()
