"""Files on other clocks, and clocks that are set: told by name, never joined."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from attest_cli.errors import AttestError
from attest_cli.prepare import prepare
from attest_cli.prepare.epochs import whole_hours
from attest_cli.records import COLUMNS, Channel, Ints, Log, Recording
from attest_cli.settings import Settings

UNIX, BOOT, S = 1_780_308_000_000_000_000, 100_000_000_000, 1_000_000_000
UNITS = {name: "rad/s" if name.startswith("gyro") else "m/s^2" for name in COLUMNS["imu"]}


def file(name: str, role: str, stamps_ns: Ints) -> Recording:
    rng = np.random.default_rng(2)
    values = {key: rng.normal(9.8 if key == "accel_z" else 0.0, 0.05, stamps_ns.size) for key in COLUMNS[role]}
    return Recording(Path(name), "csv", (Channel(role, "columns", role, stamps_ns, values, UNITS),), stamps_ns.size)


def imu(name: str, start_ns: int, role: str = "imu") -> Recording:
    return file(name, role, start_ns + np.arange(1000) * 10_000_000)


def gps(start_ns: int) -> Recording:
    return file("gps.csv", "gps", start_ns + np.arange(10) * S)


def log_of(*files: Recording) -> Log:
    return prepare(files, Settings())


@pytest.mark.parametrize(
    ("files", "says"),
    [
        ((imu("imu.csv", BOOT), gps(UNIX)),
         r"imu.csv spans 100.0 to 110.0 s, gps.csv spans 2026-06-01 10:00:00 to 2026-06-01 10:00:09: .*gps.*; .*clock"),
        ((imu("imu.csv", UNIX), gps(UNIX + 86_400 * S)), "gps.csv spans 2026-06-02 10:00:00 to .* gps lies in"),
        ((imu("g.csv", BOOT, "gyro"), imu("a.csv", UNIX, "accel")), "g.csv spans .* a.csv spans .* accel lies in"),
        ((imu("1.csv", BOOT), imu("2.csv", UNIX)), "1.csv spans 100.0 to .* 2.csv spans 2026-06-01 .*: .* two clocks"),
    ],
)  # fmt: skip
def test_files_on_other_clocks_are_refused_with_their_times(files: tuple[Recording, ...], says: str) -> None:
    for order in (files, files[::-1]):
        with pytest.raises(AttestError, match=says):
            log_of(*order)


@pytest.mark.parametrize("away_s", [11, 7200, -3600])
def test_an_aid_that_misses_the_drive_is_left_out_and_told(away_s: int) -> None:
    log = log_of(imu("imu.csv", UNIX), gps(UNIX + away_s * S))
    (warning,) = (warning for warning in log.warnings if warning.code == "no-overlap")
    assert f"gps (gps) spans {away_s:.1f} to {away_s + 9:.1f} s after the IMU's start, the IMU 0 to" in warning.message
    assert not log.fixes


def test_one_of_two_aids_on_another_clock_leaves_the_other() -> None:
    other = file("compass.csv", "compass", BOOT + np.arange(10) * S)
    log = log_of(imu("imu.csv", UNIX), gps(UNIX), other)
    assert [warning.message.split(" ")[0] for warning in log.warnings if warning.code == "no-overlap"] == ["compass"]
    assert set(log.fixes) == {"gps"}


@pytest.mark.parametrize("start_ns", [BOOT, UNIX + 86_400 * S])
def test_one_of_two_files_of_a_sensor_on_another_clock_is_named(start_ns: int) -> None:
    stray = file("stray.csv", "gps", start_ns + np.arange(10) * S)
    log = log_of(imu("imu.csv", UNIX), gps(UNIX), stray)
    assert log.fixes["gps"].t.size == 10
    told = [warning for warning in log.warnings if warning.code == "no-overlap"]
    assert len(told) == 1
    assert "stray.csv spans" in told[0].message
    assert "gps.csv" not in told[0].message


def test_files_of_one_clock_are_joined() -> None:
    assert log_of(imu("imu.csv", UNIX), gps(UNIX)).fixes["gps"].t.size == 10
    assert not log_of(imu("1.csv", UNIX), imu("2.csv", UNIX + 10 * S)).warnings
    codes = [w.code for w in log_of(imu("1.csv", UNIX), imu("2.csv", UNIX + 600 * S)).warnings]
    assert codes == ["imu-gap"]  # a pause


def stepped(step_ns: int) -> Recording:
    stamps_ns = UNIX + np.arange(1000) * 10_000_000
    return file("log.csv", "imu", stamps_ns + step_ns * (np.arange(1000) >= 500))


@pytest.mark.parametrize(
    ("hours", "named"), [(1, True), (-1, True), (2, True), (0.99, False), (-0.5, False), (200, False)]
)
def test_an_hour_is_named_as_what_it_is(hours: float, named: bool) -> None:
    size = rf"{abs(hours) * 3600:.0f} s"
    if hours < 0:
        with pytest.raises(AttestError, match="steps back") as refused:
            log_of(stepped(round(hours * 3600 * S)))
        assert (f"by {size} but for a sample" in refused.value.message) == named
        return
    (warning,) = log_of(stepped(round(hours * 3600 * S))).warnings
    assert warning.code == "imu-gap"
    assert (f"a jump of exactly {size}" in warning.message) == named
    assert ("summer time" in warning.hint) == named


def test_a_clock_that_is_set_from_boot_to_date_is_no_pause() -> None:
    (warning,) = log_of(stepped(UNIX - BOOT)).warnings
    assert warning.code == "imu-gap"
    assert warning.message.endswith("at 4.99 s the clock was set: that is no pause")
    assert warning.hint.startswith("--end 4.99 takes the part before it, --start 17803")


@pytest.mark.parametrize(("step", "hours"), [(3600.01, 1), (-3599.99, 1), (3601.0, 0), (30.0, 0), (14 * 3600.01, 0)])
def test_whole_hours(step: float, hours: int) -> None:
    assert whole_hours(step, 0.01) == hours
