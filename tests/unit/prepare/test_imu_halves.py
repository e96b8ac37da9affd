"""Halves of an IMU: what one lacks at an end is lost; a second IMU in other files is told; short holes cost sigma."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from attest_cli.prepare import prepare
from attest_cli.records import COLUMNS, Channel, Log, Recording
from attest_cli.settings import Settings

N = 3000
UNITS = dict(zip(COLUMNS["imu"], ["rad/s"] * 3 + ["m/s^2"] * 3, strict=True))


def channel(role: str, rows: slice = slice(None), keep: np.ndarray | None = None) -> Channel:
    table = np.random.default_rng(1).normal([0, 0, 0, 0, 0, 9.81], [0.01] * 3 + [0.3] * 3, (N, 6))
    index = np.arange(N)[rows] if keep is None else np.flatnonzero(keep)
    values = {name: table[index, COLUMNS["imu"].index(name)] for name in COLUMNS[role]}
    return Channel(role, "columns", role, index * 10_000_000, values, {name: UNITS[name] for name in values})


def log_of(*channels: Channel) -> Log:
    found = [Recording(Path(f"{i}.csv"), "csv", (c,), c.stamps_ns.size) for i, c in enumerate(channels)]
    return prepare(found, Settings())


@pytest.mark.parametrize(("gyro", "accel", "lost_s"), [
    (slice(None), slice(0, 1500), "15.00 s of gyro"), (slice(None), slice(600, None), "6.00 s of gyro"),
    (slice(0, 1000), slice(None), "20.00 s of accel"), (slice(0, 2995), slice(5, None), ""),
])  # fmt: skip
def test_an_end_that_one_half_lacks_is_lost(gyro: slice, accel: slice, lost_s: str) -> None:
    told = [w for w in log_of(channel("gyro", gyro), channel("accel", accel)).warnings if w.code == "imu-half-missing"]
    assert [w.lost for w in told] == ([True] if lost_s else [])
    assert all(w.message.startswith(lost_s) for w in told)


def test_a_second_imu_in_halves_is_told() -> None:
    log = log_of(channel("gyro"), channel("accel"), channel("imu"))
    (told,) = (w for w in log.warnings if w.code == "several-channels")
    assert told.message == "2 IMUs: imu (3000 rows), gyro (3000 rows) with accel (3000 rows); imu is used"
    log = log_of(channel("gyro"), channel("imu"))
    assert [w.message for w in log.warnings] == ["2 gyros: imu (3000 rows), gyro (3000 rows); imu is used"]
    assert not log_of(channel("imu")).warnings
    assert not log_of(channel("gyro"), channel("accel")).warnings


def test_the_force_beside_a_short_hole_is_less_known() -> None:
    keep = np.ones(N, dtype=bool)
    keep[1000:1040] = False
    log = log_of(channel("imu", keep=keep))
    assert log.imu.accel_added is not None
    assert np.flatnonzero(log.imu.accel_added).tolist() == [999, 1000]
    assert log.imu.accel_added.max() == pytest.approx(0.3 * np.sqrt(0.41 / 2), rel=0.2)  # the mean of its two ends
    assert log_of(channel("imu")).imu.accel_added is None
