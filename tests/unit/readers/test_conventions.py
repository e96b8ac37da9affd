"""Text logs in the ways of real devices: each gives the same drive in SI, or one line that names the way out."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support.text_logs import EPOCH_NS, RATE, ROWS, G, accel, gyro, in_order, mag, stamps, t, table, xyz

from attest_cli.commands.options import reading
from attest_cli.errors import AttestError
from attest_cli.prepare import prepare
from attest_cli.readers import read
from attest_cli.readers.columns import bare_quantity
from attest_cli.readers.text_stamps import unwrapped
from attest_cli.records import Log, Recording
from attest_cli.settings import load_settings

DEG, UG = np.degrees(1.0), 1.0 / G
AXES = ("x", "y", "z")
IMU = [*xyz(gyro), *xyz(accel)]
PACKETS = [(65_500 + k) % 65_536 for k in range(ROWS)]


@dataclass(frozen=True)
class Case:
    """Files of one drive (name -> text), the options they need, the warnings they deserve."""

    files: dict[str, str]
    options: str = ""
    warns: tuple[str, ...] = ()
    start_ns: int = 0
    has: tuple[str, ...] = ()  # roles beside the IMU
    notes: tuple[str, ...] = field(default=())


def names(*patterns: str) -> str:
    """Column names: ``#`` stands for the axes."""
    return ",".join(name.replace("#", a) for name in patterns for a in (AXES if "#" in name else ("",)))


def one(text: str, options: str = "", *warns: str, **more: object) -> Case:
    return Case({"log.csv": text}, options, warns, **more)  # type: ignore[arg-type]


ROS = (
    "%time,field.header.seq,field.header.stamp,field.header.frame_id,"
    + names("field.orientation.#", "field.orientation.w")
    + "".join(f",field.orientation_covariance{k}" for k in range(9))
    + ","
    + names("field.angular_velocity.#")
    + "".join(f",field.angular_velocity_covariance{k}" for k in range(9))
    + ","
    + names("field.linear_acceleration.#")
    + "".join(f",field.linear_acceleration_covariance{k}" for k in range(9))
)


def rostopic(header: Sequence[object]) -> str:
    nines = [in_order(lambda _: "0.0")] * 9
    late = stamps(1e-9, EPOCH_NS + 3_000_000)
    ids = [late, in_order(lambda k: k), header, in_order(lambda _: "imu_link")]
    q = [in_order(lambda _: "0.0")] * 3 + [in_order(lambda _: "1.0")]
    return table(ROS, [*ids, *q, *nines, *xyz(gyro), *nines, *xyz(accel), *nines])


def sparse() -> str:
    """The IMU in two rows of three; between them a topic of its own."""
    head = "__time," + names("/imu/angular_velocity/#", "/imu/linear_acceleration/#") + ",/battery/voltage"
    rows = []
    for k in range(ROWS):
        rows.append(f"{t[k]:.6f}," + ",".join(f"{v:.7f}" for v in (*gyro[k], *accel[k])) + ",")
        rows.append(f"{t[k] + 0.004:.6f},,,,,,,12.1")
    return "\n".join([head, *rows, ""])


def typed(form: str, *kinds: tuple[str, np.ndarray]) -> str:
    """Rows of types, one after another."""
    return "".join(
        form.format(kind=kind, ms=20 * k, values=",".join(f"{v:.6f}" for v in values[k])) + "\n"
        for k in range(ROWS)
        for kind, values in kinds
    )


XSENS = (
    "// Start Time: Unknown\n// Update Rate: 50.0Hz\n// Filter Profile: human (46.1)\n// Firmware Version: 4.0.2\n"
    "PacketCounter\tSampleTimeFine\tAcc_X\tAcc_Y\tAcc_Z\tFreeAcc_X\tFreeAcc_Y\tFreeAcc_Z\t"
    "Gyr_X\tGyr_Y\tGyr_Z\tMag_X\tMag_Y\tMag_Z\tMat[1][1]\tMat[2][1]"
)
BLANK = in_order(lambda _: "")
NOUGHT = in_order(lambda _: "0")
XSENS_ROWS = [
    PACKETS, BLANK, *xyz(accel), NOUGHT, NOUGHT, NOUGHT, *xyz(gyro), *xyz(mag, 1 / np.hypot(18.0, 42.0)),
    NOUGHT, NOUGHT,
]  # fmt: skip

CASES: dict[str, Case] = {
    "euroc": one(
        table("#timestamp [ns]," + names("w_RS_S_# [rad s^-1]", "a_RS_S_# [m s^-2]"), [stamps(1e-9, EPOCH_NS), *IMU]),
        start_ns=EPOCH_NS,
    ),
    "euroc-through-a-spreadsheet-with-15-digits": one(
        table(
            "#timestamp [ns]," + names("w_RS_S_# [rad s^-1]", "a_RS_S_# [m s^-2]"),
            [[f"{s:.14E}".replace("E+", "E+0") for s in stamps(1e-9, EPOCH_NS + 123_456_789)], *IMU],
        ),
        "",
        "stamps-rounded",
        start_ns=EPOCH_NS + 123_460_000,
    ),
    "x-io": one(
        table(
            "Time (s)," + names("Gyroscope # (deg/s)", "Accelerometer # (g)", "Magnetometer # (uT)"),
            [list(t), *xyz(gyro, DEG), *xyz(accel, UG), *xyz(mag)],
        ),
        has=("magnetometer",),
    ),
    "vectornav": one(
        table(
            "Time [s],GpsTow [s]," + names("IMU::DeltaTheta::# [deg]", "IMU::Accel::# [m/s^2]", "IMU::Mag::# [Gauss]")
            + ",IMU::AngularRate::X,IMU::AngularRate::Y [rad/s],IMU::AngularRate::Z [rad/s]",
            [list(t), list(t + 4e5), *xyz(gyro, DEG / RATE), *xyz(accel), *xyz(mag, 0.01), *xyz(gyro)],
        ),
        has=("magnetometer",),
    ),
    "xsens-tabs-and-a-counter-that-wraps": one(
        table(XSENS, XSENS_ROWS, delimiter="\t", end="\t"),
        "",
        "magnetometer-normalised",
        start_ns=65_500 * 20_000_000,
        has=("magnetometer",),
        notes=("'PacketCounter' / 50 Hz",),
    ),
    "xsens-semicolons": one(
        table(XSENS.replace("\t", ";"), XSENS_ROWS, delimiter=";"),
        "",
        "magnetometer-normalised",
        start_ns=65_500 * 20_000_000,
    ),
    "xsens-without-a-preamble": one(
        table(XSENS.partition("4.0.2\n")[2].replace("\t", ","), XSENS_ROWS),
        "--sample-rate 50",
        "magnetometer-normalised",
        start_ns=65_500 * 20_000_000,
    ),
    "xsens-without-a-counter": one(
        table("// Update Rate: 50.0Hz\n" + names("Acc_#", "Gyr_#").replace(",", "\t"), [*xyz(accel), *xyz(gyro)],
              delimiter="\t"),
        "",
        "rows-counted",
    ),
    "xsens-dot": one(
        table(
            "PacketCounter,SampleTimeFine," + names("Acc_#", "Gyr_#"),
            [in_order(lambda k: k), stamps(1e-6, 192_856_375), *xyz(accel), *xyz(gyro, DEG)],
        ),
        "",
        "time-unit-guessed",
        "unit-guessed",
        start_ns=192_856_375_000,
    ),
    "apdm-units-row-and-preamble": one(
        table(
            "Test Name:,Pendulum,,,,,\nSample Rate:,50,Hz,,,,\nTime,"
            + names("Static/Acceleration/#", "Static/Angular Velocity/#")
            + "\ns,m/s^2,m/s^2,m/s^2,rad/s,rad/s,rad/s",
            [list(t), *xyz(accel), *xyz(gyro)],
        ),
        notes=("units in line 4",),
    ),
    "apdm-three-header-rows": one(
        table(
            "Format=7,5718,,,Lumbar,,,5778,,,Left Foot,,\nTime" + ",Accelerometer,,,Gyroscope,," * 2 + "\n"
            + "," + ",".join(["X,Y,Z"] * 4),
            [stamps(1e-6, EPOCH_NS // 1000), *xyz(accel), *xyz(gyro), *xyz(accel * 1.01), *xyz(gyro)],
        ),
        "",
        "time-unit-guessed",
        "several-channels",
        start_ns=EPOCH_NS,
        notes=("header in lines 1 to 3",),
    ),
    "phyphox": Case(
        {
            "Gyroscope.csv": table(
                names('"Time (s)"', '"Gyroscope # (rad/s)"'), [list(t), *xyz(gyro)], form="{:.9E}"
            ),
            "Accelerometer.csv": table(
                names('"Time (s)"', '"Acceleration # (m/s^2)"'), [list(t), *xyz(accel)], form="{:.9E}"
            ),
            "Magnetometer.csv": table(names('"Time (s)"', '"Magnetic field # (µT)"'), [list(t), *xyz(mag)]),
        },
        has=("magnetometer",),
    ),
    "phyphox-bare-axes-and-decimal-commas": Case(
        {
            "Gyroscope.csv": table(
                '"Time (s)";"X (rad/s)";"Y (rad/s)";"Z (rad/s)"', [list(t), *xyz(gyro)], delimiter=";", comma=True
            ),
            "Accelerometer.csv": table(
                '"Time (s)"\t"X (m/s^2)"\t"Y (m/s^2)"\t"Z (m/s^2)"', [list(t), *xyz(accel)], delimiter="\t", comma=True
            ),
        },
        notes=("decimal comma",),
    ),
    "sensor-logger": Case(
        {
            "Gyroscope.csv": table("time,seconds_elapsed,z,y,x", [stamps(1e-9, EPOCH_NS), list(t), *xyz(gyro)[::-1]]),
            "TotalAcceleration.csv": table(
                "time,seconds_elapsed,z,y,x", [stamps(1e-9, EPOCH_NS), list(t), *xyz(accel)[::-1]]
            ),
            "Location.csv": table(
                "time,seconds_elapsed,horizontalAccuracy,speed,altitude,longitude,latitude",
                [
                    stamps(1e-9, EPOCH_NS)[::50], t[::50].tolist(), [4.7, -1.0] * 4, [1.0, -1.0] * 4, [400.0] * 8,
                    [6.6] * 8, [46.5 + 1e-5 * k for k in range(8)],
                ],
            ),
        },
        "",
        ("time-unit-guessed", "time-unit-guessed", "time-unit-guessed", "gps-invalid", "receiver-speed"),
        start_ns=EPOCH_NS,
        has=("gps",),
    ),
    "vmu931-rows-of-types": one(
        typed("{ms},{kind},{values}", ("a", accel * UG), ("g", gyro * DEG), ("e", gyro)),
        "--columns 'a:t [ms],type,accel_x [g],accel_y [g],accel_z [g]' "
        "--columns 'g:t [ms],type,gyro_x [deg/s],gyro_y [deg/s],gyro_z [deg/s]'",
    ),
    "rows-of-types-on-one-clock": one(
        typed("{kind},{ms},{values}", ("m", mag), ("a", accel), ("g", gyro)),
        "--columns m:type,t,mag_x,mag_y,mag_z --columns g:type,t,gyro_x,gyro_y,gyro_z "
        "--columns a:type,t,accel_x,accel_y,accel_z",
        "time-unit-guessed",
        has=("magnetometer",),
    ),
    "pyins": Case(
        {
            "imu.csv": table("time,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z", [list(t), *IMU]),
            "gnss.csv": table(
                "time,lat,lon,alt,VN,VE,VD",
                [[float(k) for k in range(8)], [46.5 + 1e-5 * k for k in range(8)], [6.6] * 8, [400.0] * 8]
                + [[0.0] * 8] * 3,
            ),
        },
        has=("gps",),
    ),
    "rostopic": one(rostopic(stamps(1e-9, EPOCH_NS)), "", "time-unit-guessed", start_ns=EPOCH_NS),
    "rostopic-without-header-stamps": one(
        rostopic(NOUGHT), "", "zero-stamps", "time-unit-guessed", start_ns=EPOCH_NS + 3_000_000
    ),
    "rostopic-by-the-recorder": one(
        rostopic(stamps(1e-9, EPOCH_NS)), "--time log", "time-unit-guessed", start_ns=EPOCH_NS + 3_000_000
    ),
    "seconds-and-nanoseconds": one(
        table(
            "header.stamp.secs,header.stamp.nsecs," + names("angular_velocity.#", "linear_acceleration.#"),
            [
                [s // 10**9 for s in stamps(1e-9, EPOCH_NS)], [s % 10**9 for s in stamps(1e-9, EPOCH_NS)], *IMU,
            ],
        ),
        start_ns=EPOCH_NS,
    ),
    "seconds-and-microseconds-in-rows-of-types": one(
        "".join(
            f"2,{47129 + s // 10**6},{s % 10**6},992467,{','.join(f'{v:.6f}' for v in (*accel[k], *gyro[k]))}\n"
            f"PPS,{k}\n"
            for k, s in enumerate(stamps(1e-6))
        ),
        "--columns '2:type,t_sec,t_usec,-,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z'",
        start_ns=47_129_000_000_000,
    ),
    "repoimu": one(
        table(
            "Time (s);Vicon Orientation;;;;IMU Acceleration;;;IMU Gyroscope;;;IMU Magnetometer;;;\n"
            ";W;X;Y;Z;X;Y;Z;X;Y;Z;X;Y;Z;",
            [list(t), *[NOUGHT] * 4, *xyz(accel), *xyz(gyro), *xyz(mag, 1 / np.hypot(18.0, 42.0))],
            delimiter=";",
        ),
        "",
        "magnetometer-normalised",
        has=("magnetometer",),
    ),
    "airbrakes": one(
        table(
            "timestamp_seconds," + names("raw_acceleration_#_g", "raw_angular_velocity_#_dps", "magnetic_field_#_ut"),
            [list(t), *xyz(accel, UG), *xyz(gyro, DEG), *xyz(mag)],
        ),
        has=("magnetometer",),
    ),
    "plotjuggler-sparse-rows": one(sparse()),
    "px4-sensor-combined": one(
        table(
            "timestamp,gyro_rad[0],gyro_rad[1],gyro_rad[2],gyro_integral_dt,accelerometer_timestamp_relative,"
            "accelerometer_m_s2[0],accelerometer_m_s2[1],accelerometer_m_s2[2]",
            [stamps(1e-6, 5_000_000), *xyz(gyro), [20_000] * ROWS, NOUGHT, *xyz(accel)],
        ),
        "",
        "time-unit-guessed",
        start_ns=5_000_000_000,
    ),
    "ardupilot": one(
        table("TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ", [stamps(1e-6, 9_000_000), NOUGHT, *IMU]), start_ns=9_000_000_000
    ),
    "unit-before-the-axis": one(
        table("t_ms," + names("gyro_dps_#", "acc_g_#"), [stamps(1e-3), *xyz(gyro, DEG), *xyz(accel, UG)])
    ),
    "gravity-written-as-gauss": one(
        table("t_ms," + names("gyro# (deg/s)", "accel# (G)"), [stamps(1e-3), *xyz(gyro, DEG), *xyz(accel, UG)])
    ),
    "no-header": one(
        table("", [stamps(1e-3), *xyz(gyro, DEG), [7] * ROWS, *xyz(accel, UG)]),
        "--columns 't [ms],gyro_x [deg/s],gyro_y [deg/s],gyro_z [deg/s],-,accel_x [g],accel_y [g],accel_z [g]'",
    ),
    "no-header-and-no-time": one(
        table("", IMU),
        "--columns gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z --sample-rate 50",
        notes=("the row / 50 Hz",),
    ),
    "no-header-between-blanks": one(
        table("", [list(t), *IMU], delimiter="   "), "--columns t,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z"
    ),
    "other-names": one(
        table("clock," + names("turn #", "push #"), [stamps(1e-3), *xyz(gyro, DEG), *xyz(accel)]),
        "--columns 'clock=time [ms],turn x=gyro_x [deg/s],turn y=gyro_y [deg/s],turn z=gyro_z [deg/s],"
        "push x=accel_x,push y=accel_y,push z=accel_z'",
    ),
    "a-name-that-is-not-there": one(
        table("t," + names("gyro_#", "accel_#"), [list(t), *IMU]), "--columns 'gyroX=gyro_x'", "no-such-column"
    ),
    "a-wrong-unit-of-time": one(
        table("t [s]," + names("g#", "a#"), [stamps(1e-3), *IMU]), "--time-unit ms"
    ),
    "trailing-delimiters-only-below-the-header": one(
        table("t," + names("gyro_#", "accel_#"), [list(t), *IMU], end=",")
    ),
    "date-and-time": one(
        table(
            "datetime," + names("gyro_#", "accel_#"),
            [[f"2023-11-14T22:13:{20 + k // 50:02d}.{k % 50 * 20:03d}Z" for k in range(ROWS)], *IMU],
        ),
        start_ns=EPOCH_NS,
    ),
}  # fmt: skip


def settings_of(options: str):
    """Settings of a command line."""
    given: dict[str, list[str]] = {}
    parts = shlex.split(options)
    for flag, value in zip(parts[::2], parts[1::2], strict=True):
        given.setdefault(flag, []).append(value)
    rate = float(given["--sample-rate"][0]) if "--sample-rate" in given else None
    source, unit = given.get("--time", [None])[0], given.get("--time-unit", [None])[0]
    return load_settings(None, None, reading(None, None, source, given.get("--columns"), unit, rate)).settings


@pytest.fixture
def load(tmp_path: Path) -> Callable[[Case], tuple[list[Recording], Log]]:
    def of(case: Case) -> tuple[list[Recording], Log]:
        for name, text in case.files.items():
            (tmp_path / name).write_text(text, encoding="utf-8")
        settings = settings_of(case.options)
        recordings = [read(tmp_path / name, settings) for name in case.files]
        return recordings, prepare(recordings, settings)

    return of


@pytest.mark.parametrize("name", CASES)
def test_a_convention_gives_the_drive(name: str, load: Callable[[Case], tuple[list[Recording], Log]]) -> None:
    case = CASES[name]
    recordings, log = load(case)
    assert log.imu.t.size == ROWS
    assert log.t0_ns == case.start_ns
    np.testing.assert_allclose(np.diff(log.imu.t), 1.0 / RATE, atol=2e-5)
    np.testing.assert_allclose(log.imu.gyro_b, gyro, atol=2e-6)
    np.testing.assert_allclose(log.imu.accel_b, accel, atol=2e-5)
    assert sorted(w.code for w in log.warnings) == sorted(case.warns)
    assert set(case.has) <= log.fixes.keys()
    notes = " ".join(note for recording in recordings for note in recording.notes)
    assert all(note in notes for note in case.notes)


def test_rows_of_types_that_are_not_named_are_counted_and_told(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    noise = "".join(f"n{k},{k},1,2,3\n" for k in range(80))
    log.write_text(typed("{kind},{ms},{values}", ("g", gyro), ("e", gyro)) + noise, encoding="utf-8")
    recording = read(log, settings_of("--columns g:type,t_ms,gyro_x,gyro_y,gyro_z"))
    assert [(c.role, c.stamps_ns.size) for c in recording.channels] == [("gyro", ROWS)]
    assert recording.other["rows e"] == f"{ROWS} rows"
    assert len(recording.other) == 51
    assert recording.rows == ROWS


def test_options_of_text_logs_say_so_where_there_is_none(tmp_path: Path) -> None:
    log = tmp_path / "log.parquet"
    pq.write_table(pa.table({"t": t, **{f"{q}_{a}": v[:, k] for q, v in (("gyro", gyro), ("accel", accel))
                                        for k, a in enumerate(AXES)}}), log)  # fmt: skip
    assert read(log, settings_of("--time-unit s")).warnings == ()  # a table all the same
    types = settings_of("--columns g:type,t,gyro_x")
    assert [w.code for w in read(log, types).warnings] == ["no-text-log"]


def test_fixes_that_a_phone_marks_invalid_are_none_and_its_speed_is_no_wheel(load) -> None:
    _, log = load(CASES["sensor-logger"])
    assert log.fixes["gps"].t.size == 4
    assert log.fixes["gps"].sigma is not None
    assert "odometry" not in log.fixes


HEADER = "t," + names("gyro_#", "accel_#")
REFUSED: dict[str, tuple[Case, str, str]] = {
    "euroc-through-a-spreadsheet-with-6-digits": (
        one(
            table(
                "#timestamp [ns]," + names("w_RS_S_# [rad s^-1]", "a_RS_S_# [m s^-2]"),
                [[f"{s:.5E}" for s in stamps(1e-9, EPOCH_NS)], *IMU],
            )
        ),
        "no resolution",
        "spreadsheet",
    ),
    "no-header": (one(table("", [list(t), *IMU])), "no header above the 7 columns", "--columns"),
    "no-header-decimal-commas": (
        one(table("", [in_order(lambda k: f"0,{k}"), in_order(lambda k: f"-9,{k}")])),
        "no header",
        "decimal commas",
    ),
    "rows-of-types": (
        one(typed("{kind},{ms},{values}", ("a", accel), ("g", gyro))),
        r"rows of 2 types \('a', 'g'\)",
        "--columns 'a:type",
    ),
    "rows-of-numbered-types-without-time": (
        one("".join(f"{0 if k % 9 else 1},{'0.1,' * (6 if k % 9 else 7)}0\n" for k in range(200))),
        r"rows of 2 types \('0', '1'\)",
        "--columns",
    ),
    "rows-of-types-without-their-type": (
        one(typed("{kind},{ms},{values}", ("a", accel), ("g", gyro)), "--columns 'g:kind,t,gyro_x,gyro_y,gyro_z'"),
        "which column of rows 'g' holds the type",
        '"type"',
    ),
    "rows-of-a-type-that-is-not-there": (
        one(typed("{kind},{ms},{values}", ("a", accel)), "--columns 'q:type,t,q_w,q_x,q_y'"),
        "no row of type 'q'",
        "a",
    ),
    "rows-of-types-of-another-width": (
        one(typed("{kind},{ms},{values}", ("a", accel)), "--columns a:type,accel_x,accel_y,accel_z"),
        "4 columns are named for rows of type 'a', which have 5 cells",
        '"-"',
    ),
    "a-counter-without-a-rate": (
        one(table("PacketCounter," + names("Acc_#", "Gyr_#"), [PACKETS, *xyz(accel), *xyz(gyro)])),
        "no time column",
        "'PacketCounter' counts: --sample-rate",
    ),
    "ticks-of-no-known-length": (
        one(table("PacketCounter,SampleTimeFine," + names("Acc_#", "Gyr_#"), [PACKETS, PACKETS, *IMU])),
        "unit of time",
        "--time-unit",
    ),
    "a-blank-time-column": (
        one(table("PacketCounter,SampleTimeFine," + names("Acc_#", "Gyr_#"), [PACKETS, BLANK, *IMU])),
        "'SampleTimeFine' holds no readable time",
        "--sample-rate",
    ),
    "too-few-names": (one(table(HEADER, [list(t), *IMU]), "--columns t,gyro_x"), "2 columns are named", '"-"'),
    "point-and-comma": (
        one(table(HEADER.replace(",", ";"), [in_order(lambda k: f"{k},5"), *IMU], delimiter=";")),
        "decimal comma or point",
        "decimal =",
    ),
    "no-gravity": (
        Case({"Gyroscope.csv": CASES["sensor-logger"].files["Gyroscope.csv"],
              "Accelerometer.csv": table("time,seconds_elapsed,z,y,x", [
                  stamps(1e-9, EPOCH_NS), list(t), *xyz(0.3 * gyro)[::-1]])}),
        "no gravity in the accelerometer",
        "specific force",
    ),
    "raw-counts": (
        one(table("t," + names("gyro#", "accel#"), [list(t), *xyz(gyro), *xyz(accel, 1670.0)])),
        "steady part of the accelerometer",
        "--columns",
    ),
    "raw-counts-of-a-gyro": (
        one(table("t," + names("g#", "a#"), [list(t), *xyz(gyro, DEG * 131.0), *IMU[3:]])),
        "raw counts: they agree with 131.072 per",
        "convert them",
    ),
    "fixes-by-milliseconds-of-no-name": (
        one(table("t,lat,lon", [[1000 * k for k in range(60)], [46.5] * 60, [6.6] * 60])),
        "unit of time",
        "--time-unit",
    ),
    "axes-of-nothing": (
        one(table("time,x,y,z", [list(t), *xyz(gyro)])),
        "no column that attest knows",
        "--columns",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_can_be_read_in_two_ways_is_refused_with_the_option_that_helps(name: str, load) -> None:
    case, says, helps = REFUSED[name]
    with pytest.raises(AttestError, match=says) as refused:
        load(case)
    assert helps in refused.value.hint
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("seed", range(60))
def test_a_damaged_text_is_read_or_refused_in_one_line(seed: int, load) -> None:
    rng = np.random.default_rng(seed)
    case = list(CASES.values())[seed % len(CASES)]
    files = {}
    for name, text in case.files.items():
        data = bytearray(text.encode()[: rng.choice([400, 4000, 10**6])])
        for place in rng.integers(0, min(len(data), rng.choice([200, 10**6])), 20):
            data[place : place + rng.integers(0, 3)] = bytes(
                rng.choice(list(b",;\t\n\" '#%\x00\xfe09.-eE[):="), 2).tolist()
            )
        files[name] = data.decode("latin-1")
    said = ""
    try:
        load(Case(files, case.options))
    except AttestError as fault:
        said = str(fault)
    assert "\n" not in said


def test_counters_of_any_width_go_on_over_their_wraps_and_show_what_was_lost() -> None:
    for modulus in (256, 65_536, 2**32):
        count = np.arange(modulus - 5, modulus + 20, dtype=np.float64)
        count = np.delete(count, 12)
        np.testing.assert_array_equal(unwrapped(np.append(np.nan, count % modulus))[1:], count)
    back = np.array([5.0, 6.0, 4.0, 7.0])
    np.testing.assert_array_equal(unwrapped(back), back)  # a swap is no wrap


@pytest.mark.parametrize(
    ("names", "units", "stem", "quantity"),
    [
        ("time,seconds_elapsed,z,y,x", "", "Gyroscope", "gyroscope"),
        ("t,x,y,z", "", "drive 3 accelerometer_2024-05-01", "drive_3_accelerometer"),
        ("t,X (rad/s),Y (rad/s),Z (rad/s)", "", "export", "gyro"),
        ("t,x,y,z", "s,g,g,g", "export", "accel"),
        ("t,x,y,z", "s,mystery,g,g", "export", ""),
        ("t,x,y,z", "", "export", ""),
        ("t,x,y,z", "", "Gravity", ""),
        ("t,x,y,z", "", "Position", ""),
        ("t,x,y", "", "Gyroscope", ""),
        ("t,gyro_x,gyro_y,gyro_z", "", "Gyroscope", ""),
    ],
)
def test_bare_axes_are_told_by_the_file_or_the_unit(names: str, units: str, stem: str, quantity: str) -> None:
    listed = names.split(",")
    assert bare_quantity(listed, units.split(",") if units else [""] * len(listed), stem) == quantity
