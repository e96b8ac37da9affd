"""What a calibration may fill in, and what is left out of all layers."""

from __future__ import annotations

from pathlib import Path

from attest_cli.settings import Effective, Settings, load_settings


def test_measured_values_stand_only_where_nobody_gave_one() -> None:
    given = load_settings(None, None, {"imu.gyro_bias_sigma": 0.5})
    found = given.informed({"imu.gyro_bias_sigma": 0.1, "imu.accel_bias_sigma": 0.003}, "calibration")
    assert (found.settings.imu.gyro_bias_sigma, found.settings.imu.accel_bias_sigma) == (0.5, 0.003)
    table = found.table()
    assert table["imu.gyro_bias_sigma"] == {"value": 0.5, "source": "command line"}
    assert table["imu.accel_bias_sigma"] == {"value": 0.003, "source": "calibration"}
    assert given.settings.imu.accel_bias_sigma == 0.02


def test_settings_made_without_a_source_are_kept() -> None:
    settings = Settings.model_validate({"world": {"gravity_m_s2": 9.8}, "imu": {"mounting": [0, 0, 0, 1]}})
    found = Effective(settings, {}).informed({"imu.gyro_bias_sigma": 0.1}, "calibration").settings
    assert found.world == settings.world
    assert found.imu.mounting == (0.0, 0.0, 0.0, 1.0)
    assert Effective(settings, {}).informed({}, "calibration").settings == settings


def test_a_setting_left_out_has_no_say_whoever_gives_it(tmp_path: Path) -> None:
    (tmp_path / "attest.toml").write_text('[imu]\ncalibration = "c.toml"\nmounting = [0, 0, 0, 1]\n', encoding="utf-8")
    log = tmp_path / "log.csv"
    whole = load_settings(None, log, {})
    assert whole.settings.imu.calibration == tmp_path / "c.toml"
    left = load_settings(None, log, {"imu.calibration": "d.toml"}, without=("imu.calibration", "imu.mounting"))
    assert (left.settings.imu.calibration, left.settings.imu.mounting) == (None, "auto")
    assert "imu.calibration" not in left.sources
