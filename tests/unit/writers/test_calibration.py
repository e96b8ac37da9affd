"""``calibration.toml`` and ``imu.yaml``: every number comes back, and no name of a file breaks them."""

from __future__ import annotations

import hashlib
import math
import os
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from support import calibrations

from attest_cli.calibration.records import Accelerometer, Calibration, Magnetometer
from attest_cli.prepare.calibration import calibrated
from attest_cli.settings import Settings, load_settings
from attest_cli.settings.calibration import read_calibration
from attest_cli.writers.calibration import describe, write_calibration, write_kalibr

HOSTILE = 'a"b\\c \x1b]0;evil\x07\u202e$x_1$\u2028 é𝛼.csv'


@pytest.fixture(scope="module")
def found() -> Calibration:
    """A short record with everything that may be in a file."""
    short = calibrations.rest(curve=lambda t: 5e-3 * np.exp(-t / 15.0))
    rng = np.random.default_rng(3)
    accel = Accelerometer(
        short.accelerometer.noise, np.eye(3) + rng.normal(0.0, 0.01, (3, 3)), rng.normal(0.0, 0.1, 3), 1e-3, 14, (),
        2e-4,
    )  # fmt: skip
    mag = Magnetometer(np.eye(3) + 0.01, rng.normal(0.0, 1e-5, 3), 5e-5, 0.01, 0.7)
    return replace(short, accelerometer=accel, magnetometer=mag, notes=("moved 2 times", HOSTILE))


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "log.csv"
    path.write_bytes(b"t,gyro_x\n")
    return path


def test_the_file_comes_back_to_the_last_digit(found: Calibration, log: Path, tmp_path: Path) -> None:
    file = describe(found, [log], "/imu/data")
    write_calibration(file, tmp_path / "calibration.toml")
    assert read_calibration(tmp_path / "calibration.toml") == file
    assert [entry.sha256 for entry in file.source.files] == [hashlib.sha256(log.read_bytes()).hexdigest()]


def test_toml_alone_holds_the_numbers_of_the_fit(found: Calibration, log: Path, tmp_path: Path) -> None:
    write_calibration(describe(found, [log], "/imu/data"), tmp_path / "c.toml")
    table = tomllib.loads((tmp_path / "c.toml").read_text(encoding="utf-8"))
    for name, axis in zip("xyz", found.axes, strict=True):
        part = table["gyro"][name]
        assert part["noise"]["noise_density"] == axis.noise.N
        assert part["noise"].get("random_walk") == axis.noise.K
        assert part["bias"]["values"] == axis.model.values.tolist()
        assert part["bias"]["covariance"] == axis.model.covariance.tolist()
        assert dict(zip(part["bias"]["names"], part["bias"]["values"], strict=True)).keys() == set(axis.model.names)
        assert part["bias"]["walk_alone"] == axis.models["random-walk"].values[1]
        assert part["bias"]["walk_beside"] == axis.model.walk
    assert found.accelerometer.matrix is not None
    assert found.magnetometer is not None
    assert table["accelerometer"]["matrix"] == found.accelerometer.matrix.tolist()
    assert table["magnetometer"]["offset"] == found.magnetometer.offset.tolist()
    assert table["source"]["t0_ns"] == found.t0_ns


def test_every_key_that_has_a_unit_is_explained_once(found: Calibration, log: Path, tmp_path: Path) -> None:
    write_calibration(describe(found, [log], "/imu/data"), tmp_path / "c.toml")
    lines = (tmp_path / "c.toml").read_text(encoding="utf-8").splitlines()
    assert sum("read off the smallest Allan deviation" in line for line in lines) <= 1
    assert sum(line.startswith("noise_density = ") and "# N:" in line for line in lines) == 1
    assert all(line.isprintable() for line in lines)


def test_a_hostile_name_is_escaped_and_comes_back(found: Calibration, tmp_path: Path) -> None:
    log = tmp_path / HOSTILE
    log.write_bytes(b"")
    write_calibration(describe(found, [log], HOSTILE), tmp_path / "c.toml")
    text = (tmp_path / "c.toml").read_text(encoding="utf-8")
    assert not set("\x1b\x07\u202e\u2028") & set(text)
    back = read_calibration(tmp_path / "c.toml")
    assert (back.source.files[0].name, back.source.channel, back.source.notes[1]) == (HOSTILE, HOSTILE, HOSTILE)


def test_a_name_that_is_no_text_gets_question_marks(found: Calibration, tmp_path: Path) -> None:
    log = tmp_path / os.fsdecode(b"a\xff.csv")
    log.write_bytes(b"")
    assert describe(found, [log], "imu").source.files[0].name == "a?.csv"


def kalibr(found: Calibration, path: Path) -> dict[str, Any]:
    write_kalibr(describe(found, [], "/imu/data"), path)
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert isinstance(data, dict)
    return data


def test_kalibr_gets_floats_of_all_digits_and_attest_reads_them_back(found: Calibration, tmp_path: Path) -> None:
    data = kalibr(found, tmp_path / "imu.yaml")
    density = math.sqrt(sum(axis.noise.N**2 for axis in found.axes) / 3.0)
    assert data["gyroscope_noise_density"] == density
    assert data["rostopic"] == "/imu/data"
    assert data["update_rate"] == found.rate_hz
    assert {type(value) for name, value in data.items() if name != "rostopic"} == {float}
    imu = load_settings(None, None, {"imu.noise_file": tmp_path / "imu.yaml"}).settings.imu
    assert imu.gyro_noise_density == density
    assert imu.gyro_random_walk == data["gyroscope_random_walk"]


@pytest.mark.parametrize("bound", [3e-5, 2e-4, math.inf])
def test_kalibr_gets_the_walk_that_another_drive_is_filtered_with(
    found: Calibration, tmp_path: Path, bound: float
) -> None:
    axes = [replace(a, noise=replace(a.noise, K=None, K_interval=(0.0, bound))) for a in found.axes]
    short = replace(found, axes=(axes[0], axes[1], axes[2]))
    data = kalibr(short, tmp_path / "imu.yaml")
    write_calibration(describe(short, [], "imu"), tmp_path / "c.toml")
    settings = Settings.model_validate({"imu": {"calibration": tmp_path / "c.toml"}})
    used = calibrated(calibrations.log_at_rest(), settings).calibrated
    assert used is not None
    assert data.get("gyroscope_random_walk") == used.noise.get("gyro_random_walk")
    assert ("gyroscope_random_walk" in data) is (bound < 1e-4)
    lines = (tmp_path / "imu.yaml").read_text(encoding="utf-8").splitlines()
    assert math.isinf(bound) or f"95 % bound {bound:.3g}" in next(x for x in lines if "gyroscope_random_walk" in x)


def test_a_power_of_ten_is_a_number_to_yaml(found: Calibration, tmp_path: Path) -> None:
    axes = [replace(a, noise=replace(a.noise, N=1e-05, N_interval=(1e-6, 1e-4))) for a in found.axes]
    data = kalibr(replace(found, axes=(axes[0], axes[1], axes[2])), tmp_path / "imu.yaml")
    assert data["gyroscope_noise_density"] == pytest.approx(1e-5)
