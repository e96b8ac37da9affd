"""Settings: units, precedence, sources, and the one line that names a wrong key."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path
from typing import Any, get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from attest_cli.errors import AttestError
from attest_cli.settings import Effective, Role, Settings, load_settings
from attest_cli.settings.units import convert


def load(folder: Path, text: str, **overrides: Any) -> Effective:
    config = folder / "c.toml"
    config.write_text(text, encoding="utf-8")
    return load_settings(config, None, {key.replace("__", "."): value for key, value in overrides.items()})


def refused(folder: Path, text: str, **overrides: Any) -> str:
    with pytest.raises(AttestError) as fault:
        load(folder, text, **overrides)
    message = str(fault.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize(
    ("text", "target", "value"),
    [
        ("0.3 deg/sqrt(hr)", "rad/s/sqrt(Hz)", math.radians(0.3) / 60),
        ("0.3 °/√h", "rad/s/sqrt(Hz)", math.radians(0.3) / 60),
        ("0.01 deg/s/sqrt(Hz)", "rad/s/sqrt(Hz)", math.radians(0.01)),
        ("120 ug/sqrt(Hz)", "m/s^2/sqrt(Hz)", 120e-6 * 9.80665),
        ("120 µg/√Hz", "m/s^2/sqrt(Hz)", 120e-6 * 9.80665),
        ("10 deg/h/sqrt(h)", "rad/s^2/sqrt(Hz)", math.radians(10) / 3600 / 60),
        ("5 deg/s", "rad/s", math.radians(5)),
        ("5 dps", "rad/s", math.radians(5)),
        ("2 mg", "m/s^2", 2e-3 * 9.80665),
        ("2 deg", "deg", 2.0),
        ("30 mrad", "deg", math.degrees(0.03)),
        ("1e-4 m/s2", "m/s^2", 1e-4),
        ("0.5 Gauss", "uT", 50.0),
        ("3 %", "1", 0.03),
        ("1.5 min", "s", 90.0),
        ("-7", "m", -7.0),
    ],
)
def test_quantities_are_converted(text: str, target: str, value: float) -> None:
    assert convert(text, target) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize(
    "text", ["", "abc", "3 parsec", "3 deg/", "3 m", "3 sqrt(s", "3 s)", "3 s^99999", "nan s", "1 2 s"]
)
def test_what_is_no_time_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"unit|number"):
        convert(text, "s")


@given(st.floats(1e-12, 1e12))
def test_a_quantity_survives_the_way_there_and_back(value: float) -> None:
    there = convert(f"{value!r} deg/sqrt(hr)", "rad/s/sqrt(Hz)")
    assert convert(f"{there!r} rad/s/sqrt(Hz)", "deg/sqrt(hr)") == pytest.approx(value, rel=1e-12)


def test_defaults_need_no_file() -> None:
    effective = load_settings(None, None, {})
    assert effective.settings == Settings()
    assert not effective.sources
    assert {entry["source"] for entry in effective.table().values()} == {"default"}


def test_the_command_line_beats_config_beats_the_file_beside_the_log_beats_the_default(tmp_path: Path) -> None:
    (tmp_path / "attest.toml").write_text(
        '[smoothing]\nsmoother = "none"\nnode_spacing_s = 0.2\nstop_threshold_deg = 3\n', encoding="utf-8"
    )
    config = tmp_path / "mine.toml"
    config.write_text('[smoothing]\nsmoother = "paper"\nstop_threshold_deg = "30 mrad"\n', encoding="utf-8")
    effective = load_settings(config, tmp_path / "log.csv", {"smoothing.smoother": "rts", "smoothing.filter": None})
    smoothing = effective.settings.smoothing
    assert (smoothing.smoother, smoothing.node_spacing_s, smoothing.filter) == ("rts", 0.2, "auto")
    assert smoothing.stop_threshold_deg == pytest.approx(math.degrees(0.03))
    table = effective.table()
    assert table["smoothing.smoother"] == {"value": "rts", "source": "command line"}
    assert table["smoothing.stop_threshold_deg"]["source"] == str(config)
    assert table["smoothing.node_spacing_s"]["source"] == str(tmp_path / "attest.toml")
    assert table["smoothing.filter"]["source"] == "default"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[smothing]", "unknown setting smothing; did you mean smoothing?"),
        ("[stops]\nmin_stop = 2", "unknown setting stops.min_stop; did you mean stops.min_stop_s?"),
        ("[stops]\nstop_threshold_deg = 2", "did you mean smoothing.stop_threshold_deg?"),
        ("min_stop_s = 2", "unknown setting min_stop_s; did you mean stops.min_stop_s?"),
        ("[stops]\nzzz = 2", "unknown setting stops.zzz"),
        ('[smoothing]\nsmoother = "rst"', "'rst' is not one of two-filter, rts, paper, none; did you mean 'rts'?"),
        ("[smoothing]\niterations = 0", "smoothing.iterations = 0: should be auto or a count of 1 to 50"),
        ('[imu]\ngyro_noise_density = "3 deg"', "unit 'deg' does not measure what rad/s/sqrt(Hz) does"),
        ("[imu]\ngyro_noise_density = -3", "imu.gyro_noise_density = -3: should be greater than 0"),
        ("[imu]\nmounting = [1, 1, 0, 0]", "should be a unit quaternion w, x, y, z; its norm is 1.414"),
        ("[imu]\nmounting = [1, 0, 0]", "should be 4 numbers"),
        ("[world]\nsun_direction = [0, 0, 0]", "should not be zero"),
        ("[world]\nlatitude_deg = 46", "latitude_deg and longitude_deg belong together"),
        ("[sun]\ncomponents = 4", "sun.components = 4 is not one of 2, 3"),
        ("[time]\nstart_s = 5\nend_s = 3", "end_s = 3 is not after start_s = 5"),
        ('[output]\nformats = ["xml"]', "output.formats = 'xml' is not one of parquet, csv, tum, mcap"),
        ('[map]\nsunn = "/sun"', "unknown role 'sunn' in map; did you mean 'sun'?"),
        ('[sun]\nchannel = "/a"\n[map]\nsun = "/b"', "sun.channel is '/a' but map.sun is '/b'; keep one of them"),
        ("stops = 3", "stops should be a table"),
        ("map = 3", "map = 3: should be a table"),
        ("[stops]\nmin_stop_s = true", "should be a number in s"),
        ("[stops]\nmin_stop_s = nan", "should be a finite number"),
        ("[stops]\nmin_stop_s = -1\nwindow_s = -1", "(and 1 more)"),
        ("[stops", "is not TOML"),
    ],
)
def test_a_wrong_setting_is_one_line_with_file_key_and_way_out(tmp_path: Path, text: str, says: str) -> None:
    message = refused(tmp_path, text)
    assert message.startswith(str(tmp_path / "c.toml"))
    assert says in message


def test_a_fault_of_the_command_line_is_named_so(tmp_path: Path) -> None:
    assert refused(tmp_path, "", smoothing__iterations="x").startswith("command line: smoothing.iterations = 'x'")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (None, "no such file"),
        (b"\xff\xfe", "not UTF-8"),
        (b"#" * 1_000_001, "larger than 1 MB"),
        (b"a=" + b"[" * 5000, "not TOML"),
    ],
)
def test_a_config_that_is_none_is_refused(tmp_path: Path, content: bytes | None, says: str) -> None:
    config = tmp_path / "c.toml"
    if content is not None:
        config.write_bytes(content)
    with pytest.raises(AttestError, match=says):
        load_settings(config, None, {})


def test_a_folder_is_no_config(tmp_path: Path) -> None:
    with pytest.raises(AttestError, match="is a folder"):
        load_settings(tmp_path, None, {})


def test_a_noise_file_lies_beneath_the_config_that_names_it(tmp_path: Path) -> None:
    (tmp_path / "imu.yaml").write_text(
        "gyroscope_noise_density: 1e-4\ngyroscope_random_walk: 2.0e-06\n"
        "accelerometer_noise_density: 1.86e-03\nrostopic: /imu0\n",
        encoding="utf-8",
    )
    effective = load(tmp_path, '[imu]\nnoise_file = "imu.yaml"\ngyro_random_walk = 5e-6\n')
    imu = effective.settings.imu
    assert (imu.gyro_noise_density, imu.gyro_random_walk, imu.accel_noise_density) == (1e-4, 5e-6, 1.86e-3)
    assert imu.noise_file == tmp_path / "imu.yaml"
    assert effective.sources["imu.gyro_noise_density"] == str(tmp_path / "imu.yaml")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("rostopic: /imu0", "names no noise density"),
        ("gyroscope_noise_density: -1", "should be greater than 0"),
        ("gyroscope_noise_density: [", "is not YAML"),
        ("!!python/object/apply:os.getcwd []", "is not YAML"),
        ("[" * 5000, "is not YAML"),
    ],
)
def test_a_bad_noise_file_is_named(tmp_path: Path, content: str, says: str) -> None:
    (tmp_path / "imu.yaml").write_text(content, encoding="utf-8")
    message = refused(tmp_path, '[imu]\nnoise_file = "imu.yaml"')
    assert "imu.yaml" in message
    assert says in message


def test_paths_are_relative_to_the_file_that_names_them(tmp_path: Path) -> None:
    assert load(tmp_path, '[stops]\nfile = "s.csv"').settings.stops.file == tmp_path / "s.csv"
    assert load_settings(None, None, {"stops.file": Path("s.csv")}).settings.stops.file == Path("s.csv")


def test_a_mapped_role_and_its_channel_are_one_setting(tmp_path: Path) -> None:
    effective = load(
        tmp_path, '[sun]\nchannel = "/old"\n[compass]\nchannel = "/compass"', map__sun="/new", map__gyro="/g"
    )
    assert effective.settings.sun.channel == "/new"
    assert effective.settings.map == {"sun": "/new", "compass": "/compass", "gyro": "/g"}
    assert effective.sources["sun.channel"] == "command line"


def test_mars_has_its_own_gravity_unless_told(tmp_path: Path) -> None:
    assert load(tmp_path, '[world]\nbody = "mars"').settings.world.gravity_m_s2 == 3.72076
    assert load(tmp_path, '[world]\nbody = "mars"\ngravity_m_s2 = 3.7').settings.world.gravity_m_s2 == 3.7


def test_directions_and_mountings_come_out_with_unit_length(tmp_path: Path) -> None:
    settings = load(
        tmp_path, "[world]\nsun_direction = [0.54, -0.54, 0.64]\n[imu]\nmounting = [0.7071, 0.7071, 0, 0]"
    ).settings
    assert settings.world.sun_direction is not None
    assert math.hypot(*settings.world.sun_direction) == pytest.approx(1.0, abs=1e-15)
    assert settings.imu.mounting == pytest.approx((math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0))


def test_settings_are_frozen() -> None:
    with pytest.raises(ValueError, match="frozen"):
        Settings().stops.min_stop_s = 3.0  # type: ignore[misc]


def test_every_setting_is_described() -> None:
    for section in Settings.model_fields.values():
        for name, info in getattr(section.annotation, "model_fields", {}).items():
            assert info.description, name


def test_roles_are_those_of_the_records() -> None:
    from attest_cli.records import ROLES

    assert get_args(Role) == ROLES


def test_settings_load_no_numeric_package() -> None:
    code = "import sys, attest_cli.settings; print({'numpy', 'pandas', 'scipy', 'yaml'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
