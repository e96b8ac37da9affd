"""Column names of real logs, one by one: what each is taken for, its instance and its unit."""

from __future__ import annotations

import pytest

from attest_cli.readers.columns import counter_column, is_unit, recognise, time_column, unit_name
from attest_cli.records import COLUMNS
from attest_cli.settings.units import unit


@pytest.mark.parametrize(
    ("name", "canonical", "instance", "stated"),
    [
        ("gyro_x", "gyro_x", "", "rad/s"),
        ("mag_z", "mag_z", "", "uT"),
        ("compass_deg", "compass_deg", "", "deg"),
        ("gx", "gyro_x", "", ""),
        ("wz", "gyro_z", "", ""),
        ("ay", "accel_y", "", ""),
        ("gyr_x", "gyro_x", "", ""),
        ("accX", "accel_x", "", ""),
        ("angular_velocity.x", "gyro_x", "", ""),
        ("field.angular_velocity.y", "gyro_y", "", ""),
        ("linear_acceleration.z", "accel_z", "", ""),
        ("w_RS_S_x [rad s^-1]", "gyro_x", "", "rad/s"),
        ("a_RS_S_z [m s^-2]", "accel_z", "", "m/s^2"),
        ("Gyroscope X (deg/s)", "gyro_x", "", "deg/s"),
        ("Accelerometer Y (g)", "accel_y", "", "g"),
        ("Magnetometer Z (µT)", "mag_z", "", "uT"),
        ("IMU::Accel::X [m/s^2]", "accel_x", "", "m/s^2"),
        ("IMU::UncompGyro::X [rad/s]", "gyro_x", "uncomp", "rad/s"),
        ("IMU::AngularRate::X", "gyro_x", "", ""),
        ("IMU::Mag::X [Gauss]", "mag_x", "", "Gauss"),
        ("IMU::Temp [Celsius]", "temperature_c", "", "degC"),
        ("Static/Angular Velocity/X", "gyro_x", "static", ""),
        ("Upper/Orientation/Scalar", "q_w", "upper", ""),
        ("gyro_x_deg_s", "gyro_x", "", "deg/s"),
        ("accel_z_g", "accel_z", "", "g"),
        ("acc2_x", "accel_x", "2", ""),
        ("gyro_x_1", "gyro_x", "1", ""),
        ("imu1.AccX (m/s²)", "accel_x", "1", "m/s^2"),
        ("GYR_Y_mdps", "gyro_y", "", "mdps"),
        ("gyro_dps_z", "gyro_z", "", "deg/s"),
        ("gyro_rad[1]", "gyro_y", "", "rad/s"),
        ("accelerometer_m_s2[0]", "accel_x", "", "m/s^2"),
        ("Gyro (deg/s) X", "gyro_x", "", "deg/s"),
        ("gyroRotationRate.z(º/s)", "gyro_z", "gyro", "deg/s"),
        ("Acceleration X (G)", "accel_x", "", "g"),
        ("Gyroscope X (deg)", "gyro_x", "", "deg/s"),
        ("horizontalAccuracy", "gps_sigma_m", "", ""),
        ("lat", "latitude", "", ""),
        ("lon_deg", "longitude", "", "deg"),
        ("height_m", "altitude", "", "m"),
        ("heading", "compass_deg", "", ""),
        ("twist.twist.linear.x", "velocity_x", "", ""),
        ("speed (km/h)", "speed", "", "km/h"),
        ("qw", "q_w", "", ""),
        ("p_RS_R_x [m]", "position_x", "", "m"),
    ],
)
def test_a_name_is_taken_for_the_right_column(name: str, canonical: str, instance: str, stated: str) -> None:
    column = recognise(0, name)
    assert column is not None
    assert (column.canonical, column.instance, column.unit) == (canonical, instance, stated)


@pytest.mark.parametrize(
    "name",
    [
        "truth_qw",
        "truth_px",
        "b_w_RS_S_x [rad s^-1]",
        "v_RS_R_x [m s^-1]",
        "IMU::DeltaTheta::X [deg]",
        "IMU::DeltaVel::X [m/s]",
        "IMU::LinearAccel::X",
        "userAcceleration.x",
        "gyro_bias_x_rad_s",
        "sigma_att_x_deg",
        "angular_velocity_covariance_0",
        "pose.pose.position.x",
        "pose.pose.orientation.w",
        "gps heading",
        "angular_velocity_covariance0",
        "Mat[1][1]",
        "q[0]",
        "Quat_q1",
        "FreeAcc_X",
        "Vicon Orientation X",
        "VelInc_X",
        "gravity.x",
        "x",
        "max",
        "index",
        "euler_x",
        "movement",
        "",
    ],
)
def test_what_is_no_measurement_is_left_alone(name: str) -> None:
    assert recognise(0, name) is None


def test_every_canonical_name_is_its_own_first_choice_with_a_unit() -> None:
    for name in {name for names in COLUMNS.values() for name in names}:
        column = recognise(0, name)
        assert column is not None
        assert (column.canonical, column.rank) == (name, 0)
        assert column.unit


def test_the_best_time_column_wins() -> None:
    names = ["GpsTow [s]", "t", "Time (ms)", "timestamp_ns"]
    best, second = time_column(names, [""] * 4), time_column(names[:3], [""] * 3)
    assert best is not None
    assert second is not None
    assert (best.index, best.unit) == (3, "ns")
    assert (second.index, second.unit) == (2, "ms")
    assert time_column(["gx", "gy"], ["", ""]) is None


@pytest.mark.parametrize(
    ("name", "base", "unit_of_time"),
    [
        ("timestamp_ns", "timestamp", "ns"),
        ("Time (s)", "time", "s"),
        ("timestamp(ms)", "timestamp", "ms"),
        ("seconds_elapsed", "seconds_elapsed", "s"),
        ("timestamp_seconds", "timestamp", "s"),
        ("TimeUS", "time", "us"),
        ("__time", "time", ""),
        ("%time", "time", ""),
        ("time_boot_ms", "time_boot", "ms"),
        ("field.header.stamp", "field_header_stamp", ""),
        ("header.stamp.nanosec", "header_stamp", "ns"),
        ("millis", "millis", "ms"),
        ("Timestamp [microseconds]", "timestamp", "us"),
        ("SampleTimeFine", "sample_time_fine", ""),
    ],
)
def test_a_time_column_is_known_by_its_name_and_its_unit(name: str, base: str, unit_of_time: str) -> None:
    column = time_column([name], [""])
    assert column is not None
    assert (column.canonical, column.unit) == (base, unit_of_time)


@pytest.mark.parametrize("name", ["GpsTow [s]", "Time::TimeStartup [ns]", "IMU::DeltaTime [s]", "sec", "timeout"])
def test_other_times_are_no_stamps(name: str) -> None:
    assert time_column([name], [""]) is None


def test_the_best_counter_is_the_packet_counter() -> None:
    best = counter_column(["field.header.seq", "index", "PacketCounter", "Acc_X"])
    assert best is not None
    assert best.index == 2
    assert counter_column(["Acc_X"]) is None


@pytest.mark.parametrize("text", ["rad s^-1", "m s^-2", "deg/s", "°/s", "G", "mG", "µT", "Celsius", "m/s²", "g", "nT"])
def test_units_are_spelled_as_settings_read_them(text: str) -> None:
    assert is_unit(text)
    unit(unit_name(text))  # raises ValueError if it is not known


def test_words_are_no_units() -> None:
    assert not is_unit("Acceleration")
    assert not is_unit("0.25")
