"""Text tables in all the dialects met in the field, and the plain refusal of what is no log."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from attest_cli.errors import AttestError
from attest_cli.readers import read
from attest_cli.records import Recording
from attest_cli.settings import Settings

HEADER = "timestamp_ns,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z"
ROW = "{ns},0.1,-0.2,0.3,0.01,0.02,9.81"
UNITS = "ns,rad/s,rad/s,rad/s,m/s^2,m/s^2,m/s^2"
QUOTED = ROW + ',"a, b"'
Load = Callable[..., Recording]


@pytest.fixture
def load(tmp_path: Path) -> Load:
    def from_text(text: str | bytes, name: str = "log.csv") -> Recording:
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read(path, Settings())

    return from_text


def rows(count: int = 5, template: str = ROW, separator: str = "\n") -> str:
    return separator.join(
        template.format(ns=1_780_308_000_000_000_001 + k * 10_000_000, s=k * 0.01) for k in range(count)
    )


def only(recording: Recording) -> tuple[list[int], dict[str, list[float]]]:
    (channel,) = recording.channels
    return channel.stamps_ns.tolist(), {name: values.tolist() for name, values in channel.values.items()}


@pytest.mark.parametrize(
    "text",
    [
        f"{HEADER}\n{rows()}\n",
        f"{HEADER}\n{rows()}",
        f"\ufeff{HEADER}\r\n{rows(separator=chr(13) + chr(10))}\r\n",
        f"#{HEADER}\n{rows()}\n",
        f"# made by hand\n# more, with, commas\n{HEADER}\n{rows()}\n",
        f"Test Name:,Pendulum,,,,,\nSample Rate:,128,Hz,,,,\n{HEADER}\n{UNITS}\n{rows()}\n",
        HEADER.replace(",", ";") + "\n" + rows(template=ROW.replace(",", ";")),
        HEADER.replace(",", ";") + "\n" + rows(template=ROW.replace(",", ";").replace(".", ",")),
        HEADER.replace(",", "\t") + "\n" + rows(template=ROW.replace(",", "\t")),
        ",".join(f'"{name}"' for name in HEADER.split(",")) + f"\n{rows()}\n",
        f"{HEADER}\n{rows(template=ROW.replace(',', ', '))}\n",
        f"{HEADER},note\n{rows(template=QUOTED)}\n",
        f"{HEADER}\n{rows(2)}\n# a remark\n{rows(5).split(chr(10), 2)[2]}\n",
    ],
    ids=[
        "plain",
        "no-last-newline",
        "bom-crlf",
        "hash-header",
        "comments",
        "preamble-and-units",
        "semicolon",
        "decimal-comma",
        "tabs",
        "quoted-header",
        "spaces",
        "quoted-text",
        "comment-inside",
    ],
)
def test_every_dialect_gives_the_same_values(load: Load, text: str) -> None:
    stamps, values = only(load(text))
    assert stamps == [1_780_308_000_000_000_001 + k * 10_000_000 for k in range(5)]
    assert values["gyro_y"] == [-0.2] * 5
    assert values["accel_z"] == [9.81] * 5


def test_columns_are_found_in_any_order_and_only_those_in_use_are_kept(load: Load) -> None:
    recording = load("az,ay,ax,junk,gz,gy,gx,t\n9.8,0.2,0.1,7,3,2,1,0.00\n9.8,0.2,0.1,7,3,2,1,0.01\n")
    stamps, values = only(recording)
    assert stamps == [0, 10_000_000]
    assert [values[name][0] for name in ("gyro_x", "gyro_y", "gyro_z", "accel_x")] == [1.0, 2.0, 3.0, 0.1]
    assert dict(recording.other) == {"junk": "column"}


def test_sensors_of_their_own_rates_share_a_table_by_blank_cells(load: Load) -> None:
    text = f"{HEADER},sun_x,sun_y,latitude,longitude\n"
    text += "\n".join(f"{k}0000000,1,2,3,0,0,9.8," + ("0.1,0.2,46.5,6.6" if k == 2 else ",,,") for k in range(4))
    channels = {channel.role: channel for channel in load(text).channels}
    assert {role: channel.stamps_ns.size for role, channel in channels.items()} == {"imu": 4, "sun": 1, "gps": 1}
    assert channels["sun"].stamps_ns.tolist() == [20_000_000]
    assert list(channels["sun"].values) == ["sun_x", "sun_y"]


def test_gyro_and_accelerometer_in_rows_of_their_own_are_two_channels(load: Load) -> None:
    lines = [f"{k * 0.005:.3f}," + ("1,2,3,,," if k % 2 else ",,,0,0,9.8") for k in range(10)]
    assert [channel.role for channel in load("t,gx,gy,gz,ax,ay,az\n" + "\n".join(lines)).channels] == ["gyro", "accel"]


def test_two_imus_in_one_table_stay_apart(load: Load) -> None:
    names = [
        f"{side}/{what}/{axis}"
        for side in ("Left", "Right")
        for what in ("Acceleration", "Angular Velocity")
        for axis in "XYZ"
    ]
    recording = load(f"Time (s),{','.join(names)}\n0,{','.join('123456789012')}\n0.01,{','.join('123456789012')}\n")
    assert [channel.name for channel in recording.channels] == ["left/imu", "right/imu"]
    assert recording.channels[1].values["accel_x"][0] == 7.0


def test_a_device_orientation_has_no_role_but_a_canonical_one_has(load: Load) -> None:
    foreign = load(f"{HEADER},qw,qx,qy,qz\n{rows(template=ROW + ',1,0,0,0')}")
    assert [channel.role for channel in foreign.channels] == ["imu", ""]
    own = load(f"{HEADER},q_w,q_x,q_y,q_z\n{rows(template=ROW + ',1,0,0,0')}")
    assert [channel.role for channel in own.channels] == ["imu", "orientation"]


def test_a_stray_text_cell_is_blank_and_said(load: Load) -> None:
    text = f"{HEADER}\n{rows(300)}\n".replace("0.1,-0.2", "oops,-0.2", 1)
    recording = load(text)
    assert np.isnan(recording.channels[0].values["gyro_x"][0])
    assert np.count_nonzero(np.isnan(recording.channels[0].values["gyro_x"])) == 1
    assert [w.code for w in recording.warnings] == ["text-cells"]
    assert "'oops'" in recording.warnings[0].message


def test_a_cut_last_row_is_skipped_and_said(load: Load) -> None:
    recording = load(f"{HEADER}\n{rows(300)[:-20]}")
    assert recording.channels[0].stamps_ns.size == 299
    assert [w.code for w in recording.warnings] == ["ragged-rows"]


@pytest.mark.parametrize("end", [b"\n", b"\r\n", b"\r"])
@pytest.mark.parametrize("odd", [b"\x85", b"\x0b", b"\x0c", b"\x1c", "\u2028".encode()])
def test_no_other_character_ends_a_line(load: Load, odd: bytes, end: bytes) -> None:
    text = end.join([b"# tom " + odd + b" drove", b"", HEADER.encode(), *rows().encode().split(b"\n"), b""])
    assert len(only(load(text))[0]) == 5


def test_a_ragged_row_that_is_no_utf8_is_skipped_and_said_as_any_other(
    load: Load, capfd: pytest.CaptureFixture[str]
) -> None:
    text = f"{HEADER}\n{rows(300)}\n".encode() + b"\xfe\xff grad,1\n" + rows(2).encode() + b"\n"
    recording = load(text)
    assert recording.channels[0].stamps_ns.size == 302
    assert [w.code for w in recording.warnings] == ["ragged-rows"]
    assert capfd.readouterr().err == ""


def test_rows_without_a_time_are_dropped_and_said(load: Load) -> None:
    recording = load(f"{HEADER}\n{rows(3)}\n,0.1,-0.2,0.3,0.01,0.02,9.81\n")
    assert recording.channels[0].stamps_ns.size == 3
    assert [w.code for w in recording.warnings] == ["rows-without-time"]


def test_dates_are_stamps(load: Load) -> None:
    lines = "\n".join(f"2026-06-01T10:00:00.{k:03d}Z,1,2,3,0,0,9.8" for k in range(0, 50, 10))
    assert only(load(f"time,gx,gy,gz,ax,ay,az\n{lines}"))[0][:2] == [
        1_780_308_000_000_000_000,
        1_780_308_000_010_000_000,
    ]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "empty"),
        (f"{HEADER}\n", "no row of numbers"),
        (rows(), "no header"),
        (f"{HEADER},gyro_x\n{rows(template=ROW + ',1')}", "more than once"),
        ("t,gyro_x,gyro_z,accel_x,accel_y,accel_z\n0,1,2,3,4,5\n", "gyro_y is missing"),
        ("gyro_x,gyro_y,gyro_z\n0,1,2\n", "no time column"),
        ("t,battery,voltage\n0,1,2\n1,1,2\n", "no column that attest knows"),
        ("just some prose\nover two lines\n", "not a table"),
        (f"{HEADER}\n" + rows().replace("0.1", "broken"), "holds text"),
        ("\x00\x01\x02 binary", "neither"),
        ("t,gx,gy,gz,ax,ay,az\n" + "\n".join(f"{k * 500},0,0,0,0,0,9.8" for k in range(60)), "unit of time"),
        (",Accelerometer,,,Gyroscope,,\n,X,Y,Z,X,Y,Z\n0.1,1,2,3,4,5,6\n", "no time column"),
    ],
)
def test_what_is_no_log_is_refused_in_one_line_that_names_the_file(load: Load, text: str, says: str) -> None:
    with pytest.raises(AttestError, match=says) as refused:
        load(text)
    assert "log.csv" in refused.value.message
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("head", "says"),
    [(b"#ROSBAG V1.2\n", "an old"), (b"\xff\xfet\x00", "UTF-16"), (b"\x1f\x8b\x08", "gzip"), (b"PK\x03\x04", "zip")],
)
def test_other_files_are_called_by_their_name(load: Load, head: bytes, says: str) -> None:
    with pytest.raises(AttestError, match=says):
        load(head + b"x" * 100)


def test_a_missing_file_a_folder_and_a_misnamed_one_are_refused(tmp_path: Path) -> None:
    (tmp_path / "drive.csv").write_text("x")
    with pytest.raises(AttestError, match=r"did you mean .*drive\.csv"):
        read(tmp_path / "drvie.csv", Settings())
    with pytest.raises(AttestError, match="folder"):
        read(tmp_path, Settings())
    (tmp_path / "log.mcap").write_text("timestamp")
    with pytest.raises(AttestError, match="not MCAP"):
        read(tmp_path / "log.mcap", Settings())


def test_the_first_cells_of_a_time_may_be_blank(load: Load) -> None:
    lines = "\n".join(f"{f'10:00:00.{k:03d}' if k > 2 else ''},1,2,3,0,0,9.8" for k in range(400))
    recording = load(f"time,{SENSORS}\n{lines}")
    assert only(recording)[0][0] == 36_000_003_000_000
    assert [w.code for w in recording.warnings] == ["rows-without-time"]


SENSORS = "gx,gy,gz,ax,ay,az"


@pytest.mark.parametrize(
    ("header", "cell", "says"),
    [
        ("Date,Time", "2026-06-01,10:00:{s:06.3f}", "as date and time"),
        ("Date,Time", "01.06.2026,10:00:{s:06.3f} AM", "as date and time"),
        ("time [s]", "10:00:{s:06.3f}", "as time of day"),
        ("time", "01.06.2026 10:00:{s:06.3f}", "as date and time"),
    ],
)
def test_dates_and_times_stand_in_one_or_two_columns(load: Load, header: str, cell: str, says: str) -> None:
    lines = "\n".join(f"{cell.format(s=k * 0.01)},1,2,3,0,0,9.8" for k in range(5))
    recording = load(f"{header},{SENSORS}\n{lines}")
    noon = 36_000_000_000_000 if "day" in says else 1_780_308_000_000_000_000
    assert only(recording)[0] == [noon + k * 10_000_000 for k in range(5)]
    assert any(says in note for note in recording.notes)
    assert not recording.warnings


@pytest.mark.parametrize(
    ("separator", "cells", "value"),
    [
        (",", ['"1,234.500"', '"-1,234.5"'], 1234.5),
        (",", ["1'234.500", "-1'234.5"], 1234.5),
        (";", ["1 234,500", "-1 234,5"], 1234.5),
        (";", ["1\u202f234,500", "-1\u202f234,5"], 1234.5),
        (";", ["1.234,500", "-1.234,5"], 1234.5),
        (";", ["1,234,567.25", "-1,234,567.25"], 1234567.25),
    ],
)
def test_thousands_may_be_set_apart(load: Load, separator: str, cells: list[str], value: float) -> None:
    mark = "," if cells[1].endswith(",5") else "."
    rest = separator.join(f"0{mark}5" for _ in range(5))
    lines = "\n".join(separator.join([f"{k}{mark}5", cells[k % 2], rest]) for k in range(4))
    recording = load(separator.join(["t", *SENSORS.split(",")]) + "\n" + lines)
    assert only(recording)[1]["gyro_x"] == [value, -value] * 2
    assert [(w.code, "'gx'" in w.message) for w in recording.warnings] == [("thousands-separators", True)]
    in_time = "\n".join(separator.join([cells[0], *[f"0{mark}5"] * 6]) for _ in range(4))
    recording = load(separator.join(["t [ms]", *SENSORS.split(",")]) + "\n" + in_time)
    assert only(recording)[0][0] == round(value * 1_000_000)


def test_thousands_or_decimal_comma_is_refused_unless_said(load: Load, tmp_path: Path) -> None:
    text = f"t [ms],{SENSORS}\n" + "\n".join(f'{10 * k},"9,811",12,3,1,2,7' for k in range(5))
    with pytest.raises(AttestError, match=r"thousands\? '9,811' can be read in two ways; .*decimal"):
        load(text)
    for mark, value in ((".", 9811.0), (",", 9.811)):
        settings = Settings.model_validate({"table": {"decimal": mark}})
        assert only(read(tmp_path / "log.csv", settings))[1]["gyro_x"][0] == value


@pytest.mark.parametrize(
    ("early", "late", "says"),
    [
        ("0.125", "0,123", "'gx' holds text in 40 rows, the first: '0,123'"),
        ("9.774", "9,810", r"'gx': decimals or thousands\? There are both '9,810' and '9.774'"),
        ("-0.5", "-9,810", r"'gx': decimals or thousands\? There are both '-9,810' and '-0.5'"),
    ],
)
def test_a_decimal_mark_that_changes_is_refused(load: Load, early: str, late: str, says: str) -> None:
    start = ";".join(["t", *SENSORS.split(",")])
    filling = "".join(f"{k * 0.01:.2f};{early};2.5;3.5;0.5;0.5;9.8{' ' * 40}\n" for k in range(2000))
    lines = "".join(f"{20 + k * 0.01:.2f};{late};2.5;3.5;0.5;0.5;9.8\n" for k in range(40))
    with pytest.raises(AttestError, match=says):
        load(f"{start}\n{filling}{lines}")


def test_decimals_in_the_time_are_no_thousands(load: Load, tmp_path: Path) -> None:
    lines = "\n".join(f"{k * 0.01:.3f};1,5;2,5;3,5;0,5;0,5;9,8" for k in range(3000))
    with pytest.raises(AttestError, match="decimal comma or point"):
        load(";".join(["time", *SENSORS.split(",")]) + "\n" + lines)
    with pytest.raises(AttestError, match=r"'time': decimals or thousands\? There are both '1.000' and '0.000'"):
        read(tmp_path / "log.csv", Settings.model_validate({"table": {"decimal": ","}}))


def test_thousands_between_smaller_numbers_are_read(load: Load) -> None:
    cells = ["999.5", '"1,000.5"', '"1,001"', "12"]
    lines = "\n".join(f"{k * 0.01:.2f},{cells[k % 4]},2.5,3.5,0.5,0.5,9.8" for k in range(8))
    assert only(load(f"t,{SENSORS}\n{lines}"))[1]["gyro_x"] == [999.5, 1000.5, 1001.0, 12.0] * 2


def test_the_time_unit_may_be_long(load: Load, tmp_path: Path) -> None:
    lines = "\n".join(f"{k * 0.01 / 3600:.12f},1,2,3,0,0,9.8" for k in range(300))
    with pytest.raises(AttestError, match=r"unit of time.*fits min and h and d"):
        load(f"time,{SENSORS}\n{lines}")
    recording = read(tmp_path / "log.csv", Settings.model_validate({"table": {"time_unit": "h"}}))
    assert np.abs(np.array(only(recording)[0]) - np.arange(300) * 10_000_000).max() < 10


def test_a_date_beside_a_counter_is_no_time(load: Load) -> None:
    lines = "\n".join(f"2026-06-13,{k},1,2,3,0,0,9.8" for k in range(100))
    recording = load(f"// Update Rate: 100.0Hz\ndate,PacketCounter,{SENSORS}\n{lines}")
    assert only(recording)[0] == [k * 10_000_000 for k in range(100)]
    whole = "\n".join(f"2026-06-13T10:00:00.{k:02d}0,1,2,3,0,0,9.8" for k in range(100))
    assert only(load(f"date,{SENSORS}\n{whole}"))[0][1] == 1_781_344_800_010_000_000


def test_hours_minutes_and_seconds_in_one_number_are_no_seconds(load: Load) -> None:
    lines = "\n".join(f"{95900 + k * 0.1 if k < 600 else 99940 + k * 0.1:.2f},1,2,3,0,0,9.8" for k in range(1200))
    assert "95959.90," in lines
    assert "100000.00," in lines
    with pytest.raises(AttestError, match="hhmmss"):
        load(f"utc_time,{SENSORS}\n{lines}")
    in_seconds = "\n".join(f"{95900 + k * 0.1:.2f},1,2,3,0,0,9.8" for k in range(1200))
    assert only(load(f"utc_time,{SENSORS}\n{in_seconds}"))[0][-1] == 96_019_900_000_000


def test_a_time_column_with_text_in_many_rows_is_refused(load: Load) -> None:
    lines = "\n".join(f"{'late' if k > 50 else k * 0.01},1,2,3,0,0,9.8" for k in range(100))
    with pytest.raises(AttestError, match="no readable time in 49 of 100 rows, the first: 'late'"):
        load(f"t,{SENSORS}\n{lines}")


@pytest.mark.parametrize(("unit", "seconds"), [("min", 60.0), ("hours", 3600.0), ("days", 86400.0)])
def test_long_units_of_time_are_read(load: Load, unit: str, seconds: float) -> None:
    lines = "\n".join(f"{k * 0.01 / seconds!r},1,2,3,0,0,9.8" for k in range(100))
    recording = load(f"time [{unit}],{SENSORS}\n{lines}")
    assert np.abs(np.array(only(recording)[0]) - np.arange(100) * 10_000_000).max() <= 1
    assert not recording.warnings


def test_the_days_of_a_spreadsheet_are_told(load: Load) -> None:
    lines = "\n".join(f"{46174.4166666667 + k * 0.01 / 86400:.10f},1,2,3,0,0,9.8" for k in range(300))
    recording = load(f"time,{SENSORS}\n{lines}")
    assert abs(only(recording)[0][0] - 1_780_308_000_000_000_000) < 10_000
    assert ["read as d" in w.message and "2026-06-01 at 10:00" in w.message for w in recording.warnings] == [True]
