"""PX4 ULog: axes, units and clocks of each topic; candidates that are not used; damage in one line."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import ulog_files
from support.ulog_files import FORMATS, Row

from attest_cli.errors import AttestError
from attest_cli.maths import rotation
from attest_cli.prepare import prepare
from attest_cli.readers import read
from attest_cli.records import Channel, Recording
from attest_cli.settings import Settings

pytest.importorskip("pyulog", reason="the extra [ulog] is not installed")


def combined(count: int = 500, **more: Any) -> list[tuple[str, int, Row]]:
    """At rest, level: z down reads -g."""
    fields = {"gyro_rad": [0.1, 0.2, 0.3], "accelerometer_m_s2": [0.5, 0.25, -9.75], **more}
    return [("sensor_combined", 0, {"timestamp": 10_000_000 + 5000 * k, **fields}) for k in range(count)]


def by_name(recording: Recording) -> dict[str, Channel]:
    return {channel.name: channel for channel in recording.channels}


def column(channel: Channel, *names: str) -> list[float]:
    return [float(channel.values[name][0]) for name in names]


def test_the_imu_is_turned_to_forward_left_up_and_counts_microseconds(tmp_path: Path) -> None:
    recording = read(ulog_files.write(tmp_path / "a.ulg", combined()), Settings())
    channel = by_name(recording)["sensor_combined"]
    assert (recording.format, channel.role, recording.rows, recording.warnings) == ("ulog", "imu", 500, ())
    assert column(channel, "gyro_x", "gyro_y", "gyro_z") == pytest.approx([0.1, -0.2, -0.3])
    assert column(channel, "accel_x", "accel_y", "accel_z") == [0.5, -0.25, 9.75]
    assert channel.stamps_ns[:2].tolist() == [10_000_000_000, 10_005_000_000]
    assert any("forward-left-up" in note for note in recording.notes)
    assert "battery_status" in recording.other
    assert prepare([recording], Settings()).imu.t.size == 500


def test_an_accelerometer_with_a_time_of_its_own_is_a_channel_of_its_own(tmp_path: Path) -> None:
    rows = combined(accelerometer_timestamp_relative=1500)
    rows[3] = ("sensor_combined", 0, {**rows[3][2], "accelerometer_timestamp_relative": 0x7FFFFFFF})
    channels = by_name(read(ulog_files.write(tmp_path / "a.ulg", rows), Settings()))
    gyro, accel = channels["sensor_combined#gyro"], channels["sensor_combined#accel"]
    assert (gyro.role, accel.role, gyro.stamps_ns.size, accel.stamps_ns.size) == ("gyro", "accel", 500, 499)
    assert accel.stamps_ns[0] - gyro.stamps_ns[0] == 1_500_000


def vehicle_imu(step_us: int) -> list[tuple[str, int, Row]]:
    spans = {"delta_angle_dt": 5000, "delta_velocity_dt": 5000}
    integral = {"delta_angle": [0.001, 0.002, 0.003], "delta_velocity": [0.0, 0.0, -0.049], **spans}
    at = range(step_us, 50 * step_us, step_us)
    return [("vehicle_imu", 1, {"timestamp": 200 + t, "timestamp_sample": 100 + t, **integral}) for t in at]


def test_integrals_become_mean_rates_and_those_of_a_decimated_log_are_said(tmp_path: Path) -> None:
    whole = read(ulog_files.write(tmp_path / "a.ulg", vehicle_imu(5000)), Settings())
    channel = by_name(whole)["vehicle_imu/1"]
    assert (channel.role, whole.warnings) == ("imu", ())
    assert column(channel, "gyro_x", "gyro_y", "gyro_z", "accel_z") == pytest.approx([0.2, -0.4, -0.6, 9.8])
    assert channel.stamps_ns[0] == 5_100_000
    by_log = read(tmp_path / "a.ulg", Settings.model_validate({"time": {"source": "log"}}))
    assert by_log.channels[0].stamps_ns[0] == 5_200_000
    decimated = read(ulog_files.write(tmp_path / "b.ulg", vehicle_imu(500_000)), Settings())
    assert [warning.code for warning in decimated.warnings] == ["decimated-imu"]


def test_the_imu_that_was_flown_with_is_taken_without_a_warning(tmp_path: Path) -> None:
    recording = read(ulog_files.write(tmp_path / "a.ulg", [*combined(), *vehicle_imu(5000)]), Settings())
    assert {channel.name: channel.role for channel in recording.channels} == {
        "sensor_combined": "imu",
        "vehicle_imu/1": "",
    }
    assert prepare([recording], Settings()).warnings == ()


def test_field_fixes_and_attitude(tmp_path: Path) -> None:
    place = {"lat": 465_000_000, "lon": -66_000_000, "alt": 400_000, "alt_ellipsoid": 450_000, "eph": 1.5, "epv": 2.5}
    north = [1.0, 0.0, 0.0, 0.0]  # PX4: nose to north, level
    rows: list[tuple[str, int, Row]] = [
        *combined(),
        ("vehicle_magnetometer", 0, {"timestamp": 10_100_000, "magnetometer_ga": [0.25, 0.125, 0.5]}),
        ("vehicle_gps_position", 0, {"timestamp": 10_100_000, **place, "fix_type": 3}),
        ("vehicle_gps_position", 0, {"timestamp": 10_300_000, **place, "fix_type": 2}),
        ("vehicle_gps_position", 0, {"timestamp": 10_500_000, **place, "fix_type": 1}),
        ("vehicle_attitude", 0, {"timestamp": 10_100_000, "q": north}),
    ]
    recording = read(ulog_files.write(tmp_path / "a.ulg", rows), Settings())
    channels = by_name(recording)
    assert column(channels["vehicle_magnetometer"], "mag_x", "mag_y", "mag_z") == [0.25e-4, -0.125e-4, -0.5e-4]
    gps = channels["vehicle_gps_position"]
    assert column(gps, "latitude", "longitude", "altitude", "gps_sigma_m", "gps_sigma_up_m") == pytest.approx(
        [46.5, -6.6, 450.0, 1.5, 2.5]
    )
    assert np.isnan(gps.values["altitude"]).tolist() == [False, True, True]
    assert np.isnan(gps.values["latitude"]).tolist() == [False, False, True]
    own = channels["vehicle_attitude#orientation"]
    R = rotation.matrix(np.array(column(own, "q_w", "q_x", "q_y", "q_z")))
    assert R[:, 0] == pytest.approx(np.array([0.0, 1.0, 0.0]), abs=1e-12)  # forward is north, y of east-north-up
    assert R[:, 2] == pytest.approx(np.array([0.0, 0.0, 1.0]), abs=1e-12)
    log = prepare([recording], Settings())
    assert "orientation" not in log.fixes
    mapped = Settings.model_validate({"map": {"orientation": "vehicle_attitude#orientation"}})
    assert "orientation" in prepare([recording], mapped).fixes


def test_degrees_of_newer_autopilots(tmp_path: Path) -> None:
    numbers = ["latitude_deg", "longitude_deg", "altitude_msl_m", "altitude_ellipsoid_m"]
    layout = f"uint64_t timestamp;{''.join(f'double {name};' for name in numbers)}float eph;float epv;uint8_t fix_type;"
    row = {"timestamp": 1, "latitude_deg": 46.5, "longitude_deg": 6.6, "altitude_ellipsoid_m": 450.0, "fix_type": 3}
    path = ulog_files.write(tmp_path / "a.ulg", [("vehicle_gps_position", 0, row)], {"vehicle_gps_position": layout})
    assert column(read(path, Settings()).channels[0], "latitude", "longitude", "altitude") == [46.5, 6.6, 450.0]


def test_dropouts_are_said(tmp_path: Path) -> None:
    path = ulog_files.write(tmp_path / "a.ulg", combined(), dropouts=3)
    warnings = read(path, Settings()).warnings
    assert [(w.code, w.lost) for w in warnings] == [("logger-dropouts", False)]
    assert "3 dropouts of the logger, 0.3 s" in warnings[0].message


@pytest.mark.parametrize("head", [b"\xff\x7f", b"\x00\x00D", b"\x00\x00\x00", b"\x02\x00D"])
def test_a_damaged_record_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str], head: bytes) -> None:
    path = ulog_files.write(tmp_path / "a.ulg", combined())
    whole = ulog_files.record("D", bytes(2) + ulog_files.packed(FORMATS["sensor_combined"], combined()[250][2]))
    data = bytearray(path.read_bytes())
    at = data.index(whole)
    data[at : at + len(head)] = head
    path.write_bytes(data)
    recording = read(path, Settings())
    assert any(warning.code in {"damaged-ulog", "cut-ulog"} and warning.lost for warning in recording.warnings)
    assert 250 <= recording.channels[0].stamps_ns.size < 500
    assert capsys.readouterr().out == ""  # the library's own words are not ours


def test_a_cut_file_gives_what_it_holds(tmp_path: Path) -> None:
    path = ulog_files.write(tmp_path / "a.ulg", combined())
    path.write_bytes(path.read_bytes()[:-480])
    recording = read(path, Settings())
    assert [(w.code, w.lost) for w in recording.warnings] == [("cut-ulog", True)]
    assert "after 12.445 s" in recording.warnings[0].message
    assert recording.channels[0].stamps_ns.size == 490


@pytest.mark.parametrize(
    ("formats", "says"),
    [
        (
            {"sensor_combined": "uint64_t timestamp;b[65535] a;", "b": "c[65535] a;", "c": "float[65535] a;"},
            "4096 fields",
        ),
        ({"sensor_combined": "uint64_t timestamp;sensor_combined a;"}, "4096 fields"),
        ({"sensor_combined": "uint64_t timestamp;float[3] gyro_rad;"}, "no field 'accelerometer_m_s2"),
    ],
)
def test_hostile_formats_are_refused_in_one_line(tmp_path: Path, formats: dict[str, str], says: str) -> None:
    plain = {**formats, "sensor_combined": "uint64_t timestamp;float[3] gyro_rad;"}
    path = ulog_files.write(tmp_path / "a.ulg", [("sensor_combined", 0, {"timestamp": 1})], plain)
    head = "sensor_combined:"
    old, new = (f"{head}{layouts['sensor_combined']}".encode() for layouts in (plain, formats))
    path.write_bytes(path.read_bytes().replace(ulog_files.record("F", old), ulog_files.record("F", new)))
    with pytest.raises(AttestError, match=says) as refused:
        read(path, Settings())
    assert "\n" not in str(refused.value)


def test_a_stamp_that_is_no_time_is_refused(tmp_path: Path) -> None:
    path = ulog_files.write(tmp_path / "a.ulg", [("vehicle_attitude", 0, {"timestamp": 2**63})])
    with pytest.raises(AttestError, match="no time"):
        read(path, Settings())


def test_a_missing_package_is_one_line_that_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = ulog_files.write(tmp_path / "a.ulg", combined(), FORMATS)
    monkeypatch.setitem(sys.modules, "pyulog", None)
    with pytest.raises(AttestError, match=r"pip install 'attest-cli\[ulog\]'") as refused:
        read(path, Settings())
    assert str(refused.value).startswith(str(path))
