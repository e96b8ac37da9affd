"""No faulty log ends well with a wrong answer: each is mended, named or refused; clean logs are silent.

The whole table, with more seeds: ``benchmarks/faulty_logs.py``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

TESTS = str(Path(__file__).resolve().parents[1])
if TESTS not in sys.path:
    sys.path.append(TESTS)

from faults.catalogue import FAULTS  # noqa: E402
from support.faults import GRADES_BAD, grade  # noqa: E402

SLOW = {
    "gps", "hand", "level", "orientation",
    "compass and gps", "compass and gps, no wheels", "magnetometer and gps", "vehicle", "tracker",
}  # fmt: skip # kinds that the navigation filter or many measurements take
SOME = {
    "clean gps", "clean level", "clean vehicle", "compass 8 deg off, vehicle",
    "tracker leaps half a metre and stays there",
}  # fmt: skip
LIKE_OTHERS = """
    NaN covariances|hard iron 50 %|IMU at 10 Hz|IMU frozen 10 s|IMU frozen 10 s, no heading
    accelerometer axis stuck 5 s|accelerometer constant|accelerometer in mg|accelerometer reversed
    accelerometer saturates|accelerometer x and y swapped|accelerometer x reversed, sun|bad covariances
    batches of 4 share a stamp|clean compass|clean walk|comments|both z, y, x (left-handed), bare|column twice
    compass 5 s late|compass counter-clockwise|compass from east|compass in rad|compass outliers 1 %
    counts of 16 bits as floats|float32 values|gap of 1000 s|gap of 20 s|gravity removed, sun|gyro all zero
    gyro and accelerometer x and y swapped|gyro axis stuck 0.5 s|gyro axis stuck 30 s|gyro bias drifts
    gyro bias of 3 deg/s|gyro holds its values, twice|gyro in deg/s, sun|gyro reversed|gyro scale 5 %
    gyro stated deg/s, is rad/s|gyro x and z swapped|gyro z reversed, compass|gyro z reversed, sun|hard iron 20 %
    header repeated amid the rows|inf cells|jitter of 1 ms at 10 Hz|jitter of 3 ms|magnetometer 1 s late
    magnetometer NaN in half the rows|magnetometer in T|magnetometer in mG|magnetometer outliers 20 %
    magnetometer x and y swapped|magnetometer z reversed|negative covariances|no absolute sensor|odometry 5 s late
    odometry in km/h|odometry outliers 5 %|odometry reversed|one row|quotes|ragged rows|small gyro spikes
    some equal stamps|spikes of 3 samples|stamps in 10 ms steps at 50 Hz|sun 10 s late|sun in millivolt
    sun lost after 30 s|sun outliers 20 %|sun reference below the horizon|sun repeats twice|time in ns, no unit
    time in us, no unit|u32 wrap of us|zero quaternions beside the IMU|zero stamps in some rows
"""  # of which another case shows as much
LEFT_OUT = {name.strip() for line in LIKE_OTHERS.splitlines() for name in line.split("|")} - {""}
CASES = [name for name, fault in FAULTS.items() if (fault.kind not in SLOW or name in SOME) and name not in LEFT_OUT]


@pytest.mark.parametrize("name", CASES)
def test_a_faulty_log_is_mended_named_or_refused(name: str, tmp_path: Path) -> None:
    found = grade(FAULTS[name], 1 + CASES.index(name) % 3, tmp_path / "log")
    assert found.grade not in GRADES_BAD, found


def test_there_are_enough_of_them() -> None:
    assert len(CASES) >= 70
    assert FAULTS.keys() >= LEFT_OUT
    assert {fault.kind for fault in FAULTS.values()} >= {"sun", "magnetometer", "gps", "walk", "hand", "orientation"}
