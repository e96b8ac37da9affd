"""Units against physics: what is stated is converted, what is not is told by gravity, what is wrong is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from attest_cli.errors import AttestError
from attest_cli.prepare import units
from attest_cli.records import COLUMNS, Channel, Warn

G = 9.80665
N = 3000
T = np.arange(N) * 0.01


def moving(rng: np.random.Generator, amplitude: float = 0.3) -> tuple[np.ndarray, np.ndarray]:
    """Gyro (rad/s) and accelerometer (m/s^2) of an IMU that rocks about two axes."""
    roll, pitch = amplitude * np.sin(0.7 * T), amplitude * np.sin(1.1 * T + 1.0)
    attitude = Rotation.from_euler("xyz", np.stack([roll, pitch, 0.2 * T], axis=1))
    gyro = (attitude[:-1].inv() * attitude[1:]).as_rotvec() / 0.01
    gyro = np.vstack([gyro, gyro[-1]]) + rng.normal(0, 0.002, (N, 3)) + 0.01
    accel = attitude.inv().apply([0.0, 0.0, G]) + rng.normal(0, 0.2, (N, 3))
    return gyro, accel


def channel(columns: str, values: np.ndarray, stated: str = "") -> Channel:
    names = COLUMNS[columns]
    return Channel(
        "imu",
        "columns",
        "imu",
        np.arange(len(values)),
        {n: values[:, k] for k, n in enumerate(names)},
        dict.fromkeys(names, stated),
    )


@pytest.mark.parametrize(("stated", "factor"), [("m/s^2", 1.0), ("g", G), ("mg", G / 1000), ("m*s^-2", 1.0)])
def test_a_stated_unit_is_converted_in_silence(rng: np.random.Generator, stated: str, factor: float) -> None:
    _, accel = moving(rng)
    warnings: list[Warn] = []
    found = units.accelerometer(channel("accel", accel / factor, stated), COLUMNS["accel"], T, G, warnings)
    np.testing.assert_allclose(found, accel, rtol=1e-12)
    assert warnings == []


@pytest.mark.parametrize(
    ("stated", "factor", "code"),
    [
        ("", 1.0, None),
        ("", G, "unit-guessed"),
        ("", G / 1000, "unit-guessed"),
        ("m/s^2", G, "unit-contradicted"),
        ("g", 1.0, "unit-contradicted"),
    ],
)
def test_gravity_tells_the_unit_of_the_accelerometer(
    rng: np.random.Generator, stated: str, factor: float, code: str | None
) -> None:
    _, accel = moving(rng)
    warnings: list[Warn] = []
    found = units.accelerometer(channel("accel", accel / factor, stated), COLUMNS["accel"], T, G, warnings)
    np.testing.assert_allclose(found, accel, rtol=1e-12)
    assert [w.code for w in warnings] == ([code] if code else [])


def test_the_gravity_of_mars_is_no_wrong_unit(rng: np.random.Generator) -> None:
    warnings: list[Warn] = []
    accel = moving(rng)[1] * (3.72076 / G)
    np.testing.assert_array_equal(
        units.accelerometer(channel("accel", accel, "m/s^2"), COLUMNS["accel"], T, 3.72076, warnings), accel
    )
    assert warnings == []


@pytest.mark.parametrize("rms", [0.1, 1.0, 3.0])
def test_an_accelerometer_without_gravity_is_refused(rng: np.random.Generator, rms: float) -> None:
    with pytest.raises(AttestError, match="no gravity"):
        units.accelerometer(channel("accel", rng.normal(0, rms, (N, 3)), "m/s^2"), COLUMNS["accel"], T, G, [])


@pytest.mark.parametrize(
    ("stated", "factor", "code"),
    [
        ("rad/s", 1.0, None),
        ("deg/s", np.pi / 180, None),
        ("", 1.0, None),
        ("", np.pi / 180, "unit-guessed"),
        ("rad/s", np.pi / 180, "unit-contradicted"),
        ("deg/s", 1.0, "unit-contradicted"),
    ],
)
def test_the_turning_of_gravity_tells_degrees_from_radians(
    rng: np.random.Generator, stated: str, factor: float, code: str | None
) -> None:
    gyro, accel = moving(rng)
    warnings: list[Warn] = []
    found = units.gyroscope(channel("gyro", gyro / factor, stated), COLUMNS["gyro"], T, accel, warnings)
    np.testing.assert_allclose(found, gyro, rtol=1e-12)
    assert [w.code for w in warnings] == ([code] if code else [])


def test_a_gyro_with_its_signs_reversed_keeps_its_unit(rng: np.random.Generator) -> None:
    gyro, accel = moving(rng)
    warnings: list[Warn] = []
    found = units.gyroscope(channel("gyro", -gyro, "rad/s"), COLUMNS["gyro"], T, accel, warnings)
    assert not warnings  # prepare.axes says it
    np.testing.assert_array_equal(found, -gyro)


def test_at_rest_nothing_is_told_and_radians_are_assumed_aloud(rng: np.random.Generator) -> None:
    accel = np.array([0.0, 0.0, G]) + rng.normal(0, 0.02, (N, 3))
    gyro = rng.normal(0.5, 0.1, (N, 3))
    for stated, codes in (("rad/s", []), ("", ["unit-guessed"])):
        warnings: list[Warn] = []
        np.testing.assert_array_equal(
            units.gyroscope(channel("gyro", gyro, stated), COLUMNS["gyro"], T, accel, warnings), gyro
        )
        assert [w.code for w in warnings] == codes


@pytest.mark.parametrize("stated", ["", "rad/s"])
def test_beside_an_accelerometer_in_g_a_gyro_at_rest_is_not_guessed(rng: np.random.Generator, stated: str) -> None:
    still = channel("imu", np.hstack([rng.normal(0.5, 0.1, (N, 3)), rng.normal([0.0, 0.0, 1.0], 0.002, (N, 3))]), "")
    still = replace(still, units=dict.fromkeys(COLUMNS["gyro"], stated))
    warnings: list[Warn] = []
    accel = units.accelerometer(still, COLUMNS["accel"], T, G, warnings)
    with pytest.raises(AttestError, match="rad/s or deg/s") as refused:
        units.gyroscope(still, COLUMNS["gyro"], T, accel, warnings)
    assert "--columns" in refused.value.hint


def test_beside_an_accelerometer_in_g_a_unit_that_is_stated_in_degrees_holds(rng: np.random.Generator) -> None:
    still = channel("imu", np.hstack([rng.normal(0.5, 0.1, (N, 3)), rng.normal([0.0, 0.0, 1.0], 0.002, (N, 3))]), "")
    still = replace(still, units=dict.fromkeys(COLUMNS["gyro"], "deg/s"))
    warnings: list[Warn] = []
    accel = units.accelerometer(still, COLUMNS["accel"], T, G, warnings)
    found = units.gyroscope(still, COLUMNS["gyro"], T, accel, warnings)
    np.testing.assert_allclose(np.degrees(found[:, 0]), still.values["gyro_x"])


@pytest.mark.parametrize("stated", ["", "rad/s"])
def test_a_rate_that_no_gyro_has_in_radians_is_in_degrees(rng: np.random.Generator, stated: str) -> None:
    accel = np.array([0.0, 0.0, G]) + rng.normal(0, 0.02, (N, 3))
    gyro = np.tile([0.0, 0.0, 90.0], (N, 1)) + rng.normal(0, 0.1, (N, 3))  # a table that turns: gravity stays
    warnings: list[Warn] = []
    found = units.gyroscope(channel("gyro", gyro, stated), COLUMNS["gyro"], T, accel, warnings)
    np.testing.assert_allclose(np.degrees(found), gyro)
    assert [w.code for w in warnings] == ["unit-contradicted" if stated else "unit-guessed"]


def test_raw_counts_are_refused(rng: np.random.Generator) -> None:
    gyro, accel = moving(rng)
    for scale, sensor, says in ((131.0, "gyro", "131"), (16.4, "gyro", "16.38")):
        with pytest.raises(AttestError, match=f"raw counts: they agree with {says}"):
            units.gyroscope(channel(sensor, np.degrees(gyro) * scale), COLUMNS["gyro"], T, accel, [])
    with pytest.raises(AttestError, match=r"raw counts: .* is no rate"):
        units.gyroscope(channel("gyro", rng.normal(3e4, 9.0, (N, 3))), COLUMNS["gyro"], T, accel, [])
    with pytest.raises(AttestError, match="raw counts, or another unit"):
        units.accelerometer(channel("accel", accel * 1670.0), COLUMNS["accel"], T, G, [])


def test_a_wheel_that_spins_faster_than_the_windows_tells_nothing(rng: np.random.Generator) -> None:
    angle = 20.0 * T
    accel = G * np.stack([np.cos(angle), np.sin(angle), 0.01 * T], axis=1)
    gyro = np.tile([0.0, 0.0, -20.0], (N, 1)) + rng.normal(0, 0.01, (N, 3))
    warnings: list[Warn] = []
    np.testing.assert_array_equal(
        units.gyroscope(channel("gyro", gyro, "rad/s"), COLUMNS["gyro"], T, accel, warnings), gyro
    )
    assert warnings == []


@pytest.mark.parametrize(
    ("stated", "factor", "code"),
    [
        ("T", 1.0, None),
        ("uT", 1e-6, None),
        ("Gauss", 1e-4, None),
        ("mGauss", 1e-7, None),
        ("nT", 1e-9, None),
        ("", 1e-6, "unit-guessed"),
        ("", 1e-4, "unit-guessed"),
        ("", 1e-7, "unit-guessed"),
        ("", 1e-9, "unit-guessed"),
        ("T", 1e-6, "unit-contradicted"),
    ],
)
def test_the_magnetometer_comes_out_in_tesla(
    rng: np.random.Generator, stated: str, factor: float, code: str | None
) -> None:
    field = np.array([20e-6, 0.0, -43e-6]) + rng.normal(0, 0.3e-6, (100, 3))
    warnings: list[Warn] = []
    found = units.magnetometer(channel("magnetometer", field / factor, stated), COLUMNS["magnetometer"], warnings)
    np.testing.assert_allclose(found, field, rtol=1e-12)
    assert [w.code for w in warnings] == ([code] if code else [])


def test_a_normalised_field_keeps_its_direction(rng: np.random.Generator) -> None:
    field = np.array([0.4, 0.0, -0.9165]) + rng.normal(0, 0.005, (100, 3))
    warnings: list[Warn] = []
    found = units.magnetometer(channel("magnetometer", field), COLUMNS["magnetometer"], warnings)
    np.testing.assert_allclose(
        found / np.linalg.norm(found, axis=1)[:, None], field / np.linalg.norm(field, axis=1)[:, None]
    )
    assert np.median(np.linalg.norm(found, axis=1)) == pytest.approx(50e-6, rel=0.01)
    assert [w.code for w in warnings] == ["magnetometer-normalised"]


def test_a_unit_of_another_quantity_or_of_no_meaning_is_refused() -> None:
    with pytest.raises(AttestError, match="rad/s expected"):
        units.in_si(channel("gyro", np.ones((3, 3)), "m/s^2"), COLUMNS["gyro"], "rad/s")
    with pytest.raises(AttestError, match="'furlong' of gyro_x is not known"):
        units.in_si(channel("gyro", np.ones((3, 3)), "furlong"), COLUMNS["gyro"], "rad/s")


def test_a_column_without_a_unit_has_that_of_its_neighbours() -> None:
    mixed = Channel(
        "imu",
        "columns",
        "imu",
        np.arange(2),
        {n: np.full(2, 180.0) for n in COLUMNS["gyro"]},
        {"gyro_x": "", "gyro_y": "deg/s", "gyro_z": "deg/s"},
    )
    np.testing.assert_allclose(units.in_si(mixed, COLUMNS["gyro"], "rad/s").values, np.pi)


@pytest.mark.parametrize(("value", "text"), [(5e-5, "0.00005"), (123456.0, "123500"), (980.665, "980.7"), (0.0, "0")])
def test_numbers_in_words_have_no_exponent(value: float, text: str) -> None:
    assert units._digits(value) == text


@pytest.mark.parametrize(("factor", "codes"), [(1.0, []), (57.3, ["unit-doubted"])])
def test_degrees_on_the_level_are_asked_about(factor: float, codes: list[str], rng: np.random.Generator) -> None:
    accel = np.array([0.0, 0.0, G]) + rng.normal(0, 0.3, (N, 3))
    gyro = factor * np.stack([0.0 * T, 0.0 * T, 0.3 * np.sin(0.2 * T)], axis=1)
    warnings: list[Warn] = []
    units.gyroscope(channel("gyro", gyro, "rad/s"), COLUMNS["gyro"], T, accel, warnings)
    assert [w.code for w in warnings] == codes


@pytest.mark.parametrize(("stated", "accel_unit", "code"), [("", "cm/s^2", "unit-guessed"), ("", "mg", "unit-guessed")])
def test_gals_are_not_milli_g(rng: np.random.Generator, stated: str, accel_unit: str, code: str) -> None:
    accel = np.array([0.0, 0.0, G]) + rng.normal(0, 0.02, (N, 3))
    warnings: list[Warn] = []
    written = channel("accel", accel * {"cm/s^2": 100.0, "mg": 1000.0 / G}[accel_unit], stated)
    np.testing.assert_allclose(units.accelerometer(written, COLUMNS["accel"], T, G, warnings), accel)
    (warning,) = warnings
    assert warning.code == code
    assert warning.message.endswith(f"taken as {accel_unit}")


@pytest.mark.parametrize(("first", "second"), [(1.0, 57.3), (57.3, 1.0)])
@pytest.mark.parametrize("stated", ["", "rad/s", "deg/s"])
def test_a_unit_that_changes_within_the_log_is_refused(
    rng: np.random.Generator, first: float, second: float, stated: str
) -> None:
    gyro, accel = moving(rng)
    gyro = gyro * np.where(T < 18.0, first, second)[:, None]
    with pytest.raises(AttestError, match=r"unit changes at about 1[789] s"):
        units.gyroscope(channel("gyro", gyro, stated), COLUMNS["gyro"], T, accel, [])


def test_an_imu_that_comes_to_rest_keeps_its_unit(rng: np.random.Generator) -> None:
    gyro, accel = moving(rng)
    still = T > 15.0
    gyro[still] = 0.01 + rng.normal(0, 0.002, (N, 3))[still]
    accel[still] = accel[still.argmax()] + rng.normal(0, 0.2, (N, 3))[still]
    warnings: list[Warn] = []
    units.gyroscope(channel("gyro", gyro, "rad/s"), COLUMNS["gyro"], T, accel, warnings)
    assert warnings == []


def test_half_of_the_turning_of_gravity_is_too_little_to_convert(rng: np.random.Generator) -> None:
    gyro, accel = moving(rng)
    gyro *= 0.3  # or whatever else makes them agree by half
    halfway = units.turning(T, gyro, accel)[0]
    assert units.AGREEMENT < halfway < units.CONVINCED
    for stated in ("", "rad/s"):
        with pytest.raises(AttestError, match=r"rad/s or deg/s\? .* explains \d+%"):
            units.gyroscope(channel("gyro", np.degrees(gyro), stated), COLUMNS["gyro"], T, accel, [])
    warnings: list[Warn] = []
    found = units.gyroscope(channel("gyro", gyro, "rad/s"), COLUMNS["gyro"], T, accel, warnings)
    np.testing.assert_array_equal(found, gyro)


@pytest.mark.parametrize("name", ["rpm", "mrad/s", "mdeg/s"])
def test_rare_units_of_a_gyro_are_named(rng: np.random.Generator, name: str) -> None:
    gyro, accel = moving(rng)
    written = gyro / units.unit(name)[0]
    with pytest.raises(AttestError, match=f"agrees with {name}") as refused:
        units.gyroscope(channel("gyro", written), COLUMNS["gyro"], T, accel, [])
    assert f"state {name}" in refused.value.hint
    found = units.gyroscope(channel("gyro", written, name), COLUMNS["gyro"], T, accel, [])
    np.testing.assert_allclose(found, gyro)


@pytest.mark.parametrize("stated", ["", "rad/s"])
def test_what_is_no_rate_in_degrees_is_refused_with_units_that_fit(rng: np.random.Generator, stated: str) -> None:
    accel = np.array([0.0, 0.0, G]) + rng.normal(0, 0.02, (N, 3))
    gyro = np.tile([0.0, 0.0, 5000.0], (N, 1)) + rng.normal(0, 9.0, (N, 3))
    with pytest.raises(AttestError, match=r"is no rate in") as refused:
        units.gyroscope(channel("gyro", gyro, stated), COLUMNS["gyro"], T, accel, [])
    assert "mdeg/s or mrad/s" in refused.value.hint
