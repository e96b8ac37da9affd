"""A calibration applied to a log: what is taken out of the gyro, in which axes, and what it says of what is left."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.calibrations import bias, calibration, rest

from attest_cli.maths import rotation
from attest_cli.prepare import prepare
from attest_cli.prepare.calibration import LEAST_SIGMA, TURN_ON, TURN_ON_ACCEL
from attest_cli.records import COLUMNS, Array, Channel, Log, Recording
from attest_cli.settings import Settings
from attest_cli.settings.calibration import CalibrationFile
from attest_cli.writers.calibration import describe, write_calibration

T0 = 1_780_308_000_000_000_000
BIAS = (0.002, -0.003, 0.001)
CONSTANT = [bias("constant", [value]) for value in BIAS]
WARM_UP = [bias("exponential", [value, 0.001, 100.0]) for value in BIAS]
UNITS = {name: "rad/s" if name.startswith("gyro") else "m/s^2" for name in COLUMNS["imu"]}
Z_90 = (0.5**0.5, 0.0, 0.0, 0.5**0.5)


def imu(seconds: float = 20.0, rate: float = 100.0) -> Channel:
    n = round(seconds * rate)
    rng = np.random.default_rng(1)
    values = {key: rng.normal(9.8 if key == "accel_z" else 0.0, 0.01, n) for key in COLUMNS["imu"]}
    return Channel("/imu", "columns", "imu", T0 + np.rint(np.arange(n) * 1e9 / rate).astype(np.int64), values, UNITS)


def fixes(role: str, values: Any, units: dict[str, str]) -> Channel:
    table = np.asarray(values, dtype=np.float64)
    stamps = T0 + np.arange(len(table)) * 1_000_000_000
    named = {name: table[:, k] for k, name in enumerate(COLUMNS[role])}
    return Channel(f"/{role}", "columns", role, stamps, named, units)


def log_of(path: Path, file: CalibrationFile | None, *channels: Channel, source: str = "log.csv", **imu_: Any) -> Log:
    given = dict(imu_)
    if file is not None:
        write_calibration(file, path / "calibration.toml")
        given["calibration"] = path / "calibration.toml"
    recording = Recording(Path(source), "csv", channels, 1)
    return prepare([recording], Settings.model_validate({"imu": given}))


def taken(path: Path, file: CalibrationFile, *channels: Channel, **imu_: Any) -> tuple[Array, Log]:
    """Rates that the calibration took out of the gyro (n, 3), and the log."""
    with_it, without = log_of(path, file, *channels, **imu_), log_of(path, None, *channels, **imu_)
    return without.imu.gyro_b - with_it.imu.gyro_b, with_it


def test_without_a_calibration_nothing_is_changed(tmp_path: Path) -> None:
    assert log_of(tmp_path, None, imu()).calibrated is None


def test_a_constant_bias_is_taken_out_and_can_be_put_back(tmp_path: Path) -> None:
    out, log = taken(tmp_path, calibration(CONSTANT), imu())
    np.testing.assert_allclose(out, np.tile(BIAS, (len(out), 1)), atol=1e-15)
    assert log.calibrated is not None
    np.testing.assert_allclose(log.calibrated.at(log.imu.t), out, atol=1e-15)


def test_a_mounting_turns_the_bias_with_the_sensor(tmp_path: Path) -> None:
    out, _ = taken(tmp_path, calibration(CONSTANT), imu(), mounting=Z_90)
    np.testing.assert_allclose(out[0], rotation.matrix(np.array(Z_90)) @ BIAS, atol=1e-15)


def test_a_warm_up_counts_over_the_time_of_its_own_drive(tmp_path: Path) -> None:
    file = calibration(WARM_UP, source={"t0_ns": T0 - 50_000_000_000, "duration_s": 600.0})
    out, log = taken(tmp_path, file, imu())
    expected = 0.001 + np.array(BIAS) * -np.expm1(-(log.imu.t[:, None] + 50.0) / 100.0)
    np.testing.assert_allclose(out, expected, atol=4e-8)  # straight lines over a second: h^2/8 f''
    assert log.calibrated is not None
    assert log.calibrated.sigmas["gyro_bias_sigma"] == pytest.approx(np.hypot(1e-5, 8e-6 * 600.0**0.5))
    assert log.calibrated.noise["gyro_random_walk"] == pytest.approx(5e-6)


def test_on_another_day_only_what_the_warm_up_led_to_is_known(tmp_path: Path) -> None:
    file = calibration(WARM_UP, source={"t0_ns": T0 - 86_400_000_000_000, "duration_s": 600.0})
    out, log = taken(tmp_path, file, imu())
    ends = 0.001 + np.array(BIAS) * -np.expm1(-6.0)
    np.testing.assert_allclose(out, np.tile(ends, (len(out), 1)), atol=1e-15)
    assert log.calibrated is not None
    worst = np.hypot(np.hypot(TURN_ON, 0.003 * -np.expm1(-6.0)), 8e-6 * 600.0**0.5)
    assert log.calibrated.sigmas["gyro_bias_sigma"] == pytest.approx(worst)
    assert log.calibrated.noise["gyro_random_walk"] == pytest.approx(8e-6)  # as it walked with its warm-up in it
    assert "of another switch-on" in log.history[-1]


def test_a_clock_that_starts_at_zero_tells_no_day_but_the_same_file_does(tmp_path: Path) -> None:
    source = tmp_path / "log.csv"
    source.write_text("t", encoding="utf-8")
    digest = hashlib.sha256(source.read_bytes()).hexdigest()
    for sha, where in ((digest, "of this drive"), ("1" * 64, "of another switch-on")):
        file = calibration(CONSTANT, source={"t0_ns": 0, "files": [{"name": "log.csv", "sha256": sha}]})
        assert where in log_of(tmp_path, file, imu(), source=str(source)).history[-1]


def test_temperature_explains_any_day_within_the_range_it_was_seen_in(tmp_path: Path) -> None:
    axes = [bias("temperature", [value, 1e-4], temperature_c=(20.0, 30.0)) for value in BIAS]
    celsius = np.linspace(15.0, 35.0, 21)[:, None]
    heat = fixes("temperature", celsius, {"temperature_c": "degC"})
    out, log = taken(tmp_path, calibration(axes), imu(20.01), heat)
    seen = np.clip(np.interp(np.floor(log.imu.t), np.arange(21.0), celsius[:, 0]), 20.0, 30.0)
    at_seconds = np.flatnonzero(np.isclose(log.imu.t % 1.0, 0.0))
    np.testing.assert_allclose(out[at_seconds], np.array(BIAS) + 1e-4 * (seen[at_seconds, None] - 25.0), atol=1e-12)
    out, log = taken(tmp_path, calibration(axes), imu())  # without a thermometer: the middle, known to half the range
    np.testing.assert_allclose(out[0], BIAS, atol=1e-15)
    assert log.calibrated is not None
    assert log.calibrated.sigmas["gyro_bias_sigma"] > np.hypot(TURN_ON, 5e-4)


def test_noise_is_the_rms_of_the_axes(tmp_path: Path) -> None:
    axes = [bias("constant", [1e-3], walk_beside=walk) for walk in (3e-6, 4e-6, 0.0)]
    found = log_of(tmp_path, calibration(axes, source={"t0_ns": T0}), imu()).calibrated
    assert found is not None
    assert found.noise == {
        "gyro_noise_density": pytest.approx(1.5e-4), "gyro_random_walk": pytest.approx(5e-6 / 3.0**0.5)
    }  # fmt: skip


def accelerometer(**over: Any) -> dict[str, Any]:
    noise = calibration(CONSTANT).gyro.x.noise.model_dump()
    return {"x": noise, "y": noise, "z": noise, "matrix": ((1.01, 0.02, 0.0), (0.0, 0.99, 0.0), (0.0, 0.0, 1.0)),
            "bias": (0.1, -0.2, 0.3), "residual": 0.002, "tilt_sigma": 3e-4, "attitudes": 20, **over}  # fmt: skip


@pytest.mark.parametrize("mounting", [(1.0, 0.0, 0.0, 0.0), Z_90])
def test_the_accelerometer_is_corrected_in_its_own_axes(tmp_path: Path, mounting: tuple[float, ...]) -> None:
    file = calibration(CONSTANT, source={"t0_ns": T0}, accelerometer=accelerometer())
    channel = imu()
    log = log_of(tmp_path, file, channel, mounting=mounting)
    raw = np.stack([channel.values[f"accel_{axis}"] for axis in "xyz"], axis=1)
    corrected = (raw + np.array([0.1, -0.2, 0.3])) @ np.array(accelerometer()["matrix"]).T
    np.testing.assert_allclose(log.imu.accel_b, corrected @ rotation.matrix(np.array(mounting)).T, atol=1e-12)
    assert log.calibrated is not None
    assert log.calibrated.sigmas["accel_bias_sigma"] == pytest.approx(3e-4 * 9.80665)
    assert log.calibrated.noise["accel_noise_density"] == pytest.approx(1.5e-4)


def test_an_accelerometer_of_another_switch_on_keeps_its_repeatability(tmp_path: Path) -> None:
    file = calibration(CONSTANT, accelerometer=accelerometer())
    found = log_of(tmp_path, file, imu()).calibrated
    assert found is not None
    assert found.sigmas["accel_bias_sigma"] == pytest.approx(np.hypot(3e-4 * 9.80665, TURN_ON_ACCEL))
    few = calibration(CONSTANT, accelerometer=accelerometer(matrix=None, bias=None, residual=None, tilt_sigma=None))
    found = log_of(tmp_path, few, imu()).calibrated
    assert found is not None
    assert "accel_bias_sigma" not in found.sigmas


def test_the_magnetometer_is_corrected_in_the_sensors_axes(tmp_path: Path) -> None:
    soft = ((1.1, 0.02, 0.0), (0.02, 0.95, 0.0), (0.0, 0.0, 1.0))
    iron = {"matrix": soft, "offset": (1e-5, -2e-5, 5e-6), "field": 5e-5, "residual": 0.01, "coverage": 0.8}
    field = np.random.default_rng(3).normal(0.0, 30.0, (20, 3))
    mag = fixes("magnetometer", field, dict.fromkeys(COLUMNS["magnetometer"], "uT"))
    log = log_of(tmp_path, calibration(CONSTANT, magnetometer=iron), imu(), mag, mounting=Z_90)
    corrected = (field * 1e-6 - np.array(iron["offset"])) @ np.array(soft).T
    expected = corrected @ rotation.matrix(np.array(Z_90)).T
    np.testing.assert_allclose(log.fixes["magnetometer"].values, expected, atol=1e-17)


def test_a_prior_is_never_sharper_than_the_stops_that_are_measured_again(tmp_path: Path) -> None:
    axes = [bias("constant", [value], sigma=1e-9, walk_alone=1e-12) for value in BIAS]
    found = log_of(tmp_path, calibration(axes, source={"t0_ns": T0}), imu()).calibrated
    assert found is not None
    assert found.sigmas["gyro_bias_sigma"] == LEAST_SIGMA


def test_another_rate_is_told(tmp_path: Path) -> None:
    log = log_of(tmp_path, calibration(CONSTANT, source={"rate_hz": 200.0}), imu())
    (told,) = (w for w in log.warnings if w.code.startswith("calibration"))
    assert "made at 200 Hz, this log has 100 Hz" in told.message
    assert not [w for w in log_of(tmp_path, calibration(CONSTANT), imu()).warnings if w.code.startswith("calibration")]


@pytest.mark.parametrize(("K", "bound", "known"), [(None, 2e-4, False), (None, 1e-5, True), (3e-4, 6e-4, True)])
def test_a_walk_that_a_short_record_could_not_see_is_left_to_the_drive(
    tmp_path: Path, K: float | None, bound: float, known: bool
) -> None:
    noise = {"random_walk": K, "random_walk_95": (0.0 if K is None else 1e-4, bound)}
    found = log_of(tmp_path, calibration(CONSTANT, noise, source={"t0_ns": T0}), imu()).calibrated
    assert found is not None
    assert ("gyro_random_walk" in found.noise) is known


@pytest.mark.parametrize(("seconds", "known"), [(8.0, False), (300.0, True)])
def test_eight_seconds_at_rest_are_too_short_for_a_walk(tmp_path: Path, seconds: float, known: bool) -> None:
    source = tmp_path / "still.csv"
    source.write_text("t", encoding="utf-8")
    file = describe(rest(seconds, hz=100.0), [source], "imu")
    assert [axis.knows_walk for axis in file.axes] == [known] * 3
