"""The same recording as CSV, Parquet and MCAP: identical values, identical logs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from attest_cli.errors import AttestError
from attest_cli.prepare import prepare
from attest_cli.readers import read
from attest_cli.records import COLUMNS, Channel, Log, Recording
from attest_cli.settings import Settings
from attest_cli.writers.logs import write_recording

T0 = 1_780_308_000_000_000_123
FORMATS = ("csv", "parquet", "mcap")


def channel(role: str, n: int, step_ns: int, values: dict[str, np.ndarray], units: dict[str, str]) -> Channel:
    return Channel(role, "test", role, T0 + np.arange(n) * step_ns, values, units, "base_link")


@pytest.fixture
def recording(rng: np.random.Generator) -> Recording:
    n = 400
    imu = {name: rng.normal(9.8 if name == "accel_z" else 0.0, 0.1, n) for name in COLUMNS["imu"]}
    sun = rng.normal(size=(5, 2)) * 0.3
    q = rng.normal(size=(4, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    channels = (
        channel("imu", n, 10_000_000, imu, {k: "rad/s" if "gyro" in k else "m/s^2" for k in imu}),
        channel("sun", 5, 700_000_001, {"sun_x": sun[:, 0], "sun_y": sun[:, 1]}, {}),
        channel(
            "magnetometer",
            100,
            40_000_000,
            {k: rng.normal(30, 1, 100) for k in COLUMNS["magnetometer"]},
            dict.fromkeys(COLUMNS["magnetometer"], "uT"),
        ),
        channel("compass", 20, 200_000_000, {"compass_deg": rng.uniform(0, 360, 20)}, {"compass_deg": "deg"}),
        channel("orientation", 4, 900_000_000, {k: q[:, j] for j, k in enumerate(COLUMNS["orientation"])}, {}),
        channel("odometry", 40, 100_000_000, {"speed": rng.normal(0.3, 0.01, 40)}, {"speed": "m/s"}),
        channel(
            "gps",
            3,
            1_300_000_000,
            {
                "latitude": np.array([46.5, 46.500001, 46.500002]),
                "longitude": np.array([6.6, 6.6, 6.60001]),
                "altitude": np.array([400.1, 400.2, 400.3]),
                "gps_sigma_m": np.array([1.5, 2.0, 2.5]),
            },
            {"latitude": "deg", "longitude": "deg", "altitude": "m", "gps_sigma_m": "m"},
        ),
        channel(
            "position",
            3,
            1_300_000_000,
            {k: rng.normal(size=3) for k in COLUMNS["position"]},
            dict.fromkeys(COLUMNS["position"], "m"),
        ),
        channel("temperature", 4, 900_000_000, {"temperature_c": rng.normal(21, 1, 4)}, {"temperature_c": "degC"}),
    )
    return Recording(Path("made.csv"), "csv", channels, n)


SETTINGS = Settings.model_validate({"map": {"orientation": "orientation"}})


def settings_for(format_name: str) -> Settings:
    return SETTINGS if format_name != "mcap" else Settings.model_validate({"map": {"orientation": "/orientation"}})


def same(a: Log, b: Log, format_name: str) -> None:
    assert a.t0_ns == b.t0_ns
    np.testing.assert_array_equal(a.stamps_ns, b.stamps_ns)
    np.testing.assert_array_equal(a.imu.gyro_b, b.imu.gyro_b)
    np.testing.assert_array_equal(a.imu.accel_b, b.imu.accel_b)
    assert a.fixes.keys() == b.fixes.keys()
    for role, fixes in a.fixes.items():
        np.testing.assert_array_equal(fixes.t, b.fixes[role].t)
        # a heading goes through a vector, a sigma through a variance: one rounding each
        tolerance = 1e-15 if format_name == "mcap" and role == "compass" else 0.0
        np.testing.assert_allclose(fixes.values, b.fixes[role].values, rtol=tolerance, atol=1e-14 * bool(tolerance))
        if fixes.sigma is not None:
            assert b.fixes[role].sigma is not None
            np.testing.assert_allclose(fixes.sigma, b.fixes[role].sigma, rtol=1e-15)


@pytest.mark.parametrize("format_name", FORMATS)
def test_every_format_gives_the_same_log(tmp_path: Path, recording: Recording, format_name: str) -> None:
    path = tmp_path / f"log.{format_name}"
    assert write_recording(recording, path) == ()
    back = read(path, Settings())
    assert back.warnings == ()
    log = prepare([back], settings_for(format_name))
    assert log.warnings == ()
    expected = prepare([recording], SETTINGS)
    assert set(expected.fixes) == {c.role for c in recording.channels} - {"imu"}
    same(expected, log, format_name)


@pytest.mark.parametrize("format_name", FORMATS)
def test_a_second_round_is_byte_identical(tmp_path: Path, recording: Recording, format_name: str) -> None:
    first, second = tmp_path / f"a.{format_name}", tmp_path / f"b.{format_name}"
    write_recording(recording, first)
    write_recording(recording, second)
    assert first.read_bytes() == second.read_bytes()


@pytest.mark.parametrize("format_name", FORMATS)
def test_units_are_stated_or_converted(tmp_path: Path, recording: Recording, format_name: str) -> None:
    imu = recording.channels[0]
    degrees = {k: np.degrees(v) if "gyro" in k else v / 9.80665 for k, v in imu.values.items()}
    stated = channel("imu", 400, 10_000_000, degrees, {k: "deg/s" if "gyro" in k else "g" for k in degrees})
    path = tmp_path / f"log.{format_name}"
    write_recording(Recording(Path("made.csv"), "csv", (stated,), 400), path)
    log = prepare([read(path, Settings())], Settings())
    assert log.warnings == ()
    np.testing.assert_allclose(log.imu.gyro_b, np.stack([imu.values[k] for k in COLUMNS["gyro"]], axis=1), rtol=1e-14)


@pytest.mark.parametrize("format_name", FORMATS)
def test_a_second_imu_and_the_orientation_of_a_device_stay_themselves(
    tmp_path: Path, recording: Recording, format_name: str
) -> None:
    imu = recording.channels[0]
    other = Channel("/rear/imu", "test", "imu", imu.stamps_ns, {k: v + 1.0 for k, v in imu.values.items()}, imu.units)
    q = {"q_w": np.full(400, 0.6), "q_x": np.zeros(400), "q_y": np.zeros(400), "q_z": np.full(400, 0.8)}
    device = Channel(f"{imu.name}#orientation", "test", "", imu.stamps_ns, q, dict.fromkeys(q, "1"))
    path = tmp_path / f"log.{format_name}"
    assert write_recording(Recording(Path("made.csv"), "csv", (imu, device, other), 400), path) == ()
    back = read(path, Settings())
    imus = [c for c in back.channels if c.role == "imu"]
    assert len(imus) == 2
    np.testing.assert_array_equal(imus[1].values["gyro_x"], imu.values["gyro_x"] + 1.0)
    foreign = [c for c in back.channels if not c.role]
    assert [c.values["q_z"][0] for c in foreign] == [0.8]


@pytest.mark.parametrize("format_name", ["csv", "parquet"])
def test_rows_of_one_stamp_keep_rows_of_their_own(tmp_path: Path, recording: Recording, format_name: str) -> None:
    imu = recording.channels[0]
    stamps_ns = imu.stamps_ns.copy()
    stamps_ns[100] = stamps_ns[101]
    path = tmp_path / f"log.{format_name}"
    twice = Channel("imu", "test", "imu", stamps_ns, imu.values, imu.units)
    write_recording(Recording(Path("made.csv"), "csv", (twice, *recording.channels[1:]), 400), path)
    back = read(path, Settings()).channels[0]
    np.testing.assert_array_equal(back.stamps_ns, stamps_ns)
    np.testing.assert_array_equal(back.values["gyro_x"], imu.values["gyro_x"])


def test_what_has_no_place_is_named_or_refused(tmp_path: Path, recording: Recording) -> None:
    wind = Channel("/wind", "test", "", np.array([T0]), {"x": np.ones(1), "y": np.ones(1), "z": np.ones(1)})
    extended = Recording(recording.source, "mcap", (recording.channels[0], wind), 401)
    for format_name in FORMATS:
        assert write_recording(extended, tmp_path / f"log.{format_name}") == ("/wind",)
    with pytest.raises(AttestError, match="no channel to write"):
        write_recording(Recording(recording.source, "mcap", (wind,), 1), tmp_path / "none.csv")
    with pytest.raises(AttestError, match="no log format"):
        write_recording(recording, tmp_path / "log.bag")
    early = Channel("imu", "test", "imu", recording.channels[0].stamps_ns - 2 * T0, recording.channels[0].values)
    with pytest.raises(AttestError, match="before 1970"):
        write_recording(Recording(recording.source, "csv", (early,), 400), tmp_path / "early.mcap")
    assert not (tmp_path / "early.mcap").exists()
