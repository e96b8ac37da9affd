"""``attest convert``: the same drive in every format, units made SI, and every column that is left out is said."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.text_logs import ROWS, G, accel, gyro, mag, stamps, t, table, xyz

from attest_cli.__main__ import run
from attest_cli.readers import read
from attest_cli.records import Recording
from attest_cli.settings import Settings

FORMATS = ("csv", "parquet", "mcap")
DEG = np.degrees(1.0)
HEAD = "Time (ms),Gyro X,Gyro Y,Gyro Z,Acc X (g),Acc Y (g),Acc Z (g),Mag X (Gauss),Mag Y (Gauss),Mag Z (Gauss),Odd"


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "log.csv"
    columns = [stamps(1e-3), *xyz(gyro, DEG), *xyz(accel, 1 / G), *xyz(mag, 0.01), [1] * ROWS]
    path.write_text(table(HEAD, columns, form="{:.9f}"), encoding="utf-8")
    return path


def converted(*arguments: object) -> Recording:
    path = Path(str(arguments[arguments.index("-o") + 1]))
    assert run(["convert", *map(str, arguments)]) == 0
    return read(path, Settings())


@pytest.mark.parametrize("suffix", FORMATS)
def test_units_become_si_also_one_that_only_physics_tells(
    suffix: str, log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    imu, field = converted(log, "-o", log.with_suffix(f".new.{suffix}")).channels
    assert (imu.role, field.role) == ("imu", "magnetometer")
    np.testing.assert_allclose(np.stack([imu.values[f"gyro_{a}"] for a in "xyz"], 1), gyro, atol=1e-8)
    np.testing.assert_allclose(np.stack([imu.values[f"accel_{a}"] for a in "xyz"], 1), accel, atol=1e-7)
    scale = {"T": 1e6, "uT": 1.0}[field.units["mag_x"]]
    np.testing.assert_allclose(np.stack([field.values[f"mag_{a}"] for a in "xyz"], 1) * scale, mag, atol=1e-6)
    assert {imu.units["gyro_x"], imu.units["accel_x"]} == {"rad/s", "m/s^2"}
    assert imu.stamps_ns.tolist() == stamps(1e-9)
    out, err = capsys.readouterr()
    assert "gyro states no unit" in err
    assert "taken as deg/s" in err
    assert "not read: Odd" in err
    assert "magnetometer" in out


def test_rows_without_a_value_and_rows_in_disorder_stay_as_they_are(log: Path) -> None:
    lines = log.read_text(encoding="utf-8").splitlines()
    cells = lines[40].split(",")
    lines[40] = ",".join([*cells[:4], "", *cells[5:]])  # one axis is blank: the row is not whole, but there
    lines[100], lines[101] = lines[101], lines[100]
    log.write_text("\n".join([*lines, ""]), encoding="utf-8")
    imu = converted(log, "-o", log.with_suffix(".parquet")).channels[0]
    assert imu.stamps_ns.size == ROWS
    assert np.flatnonzero(np.isnan(imu.values["accel_x"])).tolist() == [39]
    np.testing.assert_allclose(imu.values["gyro_x"], gyro[:, 0], atol=1e-8)  # the writer sorts by time


def test_several_files_become_one_and_a_channel_without_a_role_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one, two = tmp_path / "Gyroscope.csv", tmp_path / "Accelerometer.csv"
    one.write_text(table("time,x,y,z,qw,qx,qy,qz", [list(t), *xyz(gyro), *[[0.5] * ROWS] * 4]), encoding="utf-8")
    two.write_text(table("time,x,y,z", [list(t + 0.005), *xyz(accel)]), encoding="utf-8")
    found = converted(one, two, "-o", tmp_path / "all.mcap", "--json")
    assert [(c.role, c.stamps_ns.size) for c in found.channels] == [("gyro", ROWS), ("accel", ROWS)]
    out, err = capsys.readouterr()
    facts = json.loads(out)
    assert facts["not_converted"] == ["orientation"]
    assert [c["role"] for c in facts["channels"]] == ["gyro", "accel"]
    assert "have no role (--map gives one): orientation" in err


def test_round_about_is_the_same(shared_data: Path, tmp_path: Path) -> None:
    source = shared_data / "logs/derived_mcap/test1_ros2_zstd.mcap"
    if not source.is_file():
        pytest.skip("the Husky's log is not here")
    steps, log = [], source
    for suffix in ("csv", "mcap", "parquet", "csv"):
        to = tmp_path / f"{len(steps)}.{suffix}"
        steps.append(converted(log, "-o", to, "-q"))
        log = to
    original = read(source, Settings())
    for recording in steps:
        by_role = {c.role: c for c in recording.channels}
        for channel in (c for c in original.channels if c.role):
            found = by_role[channel.role]
            np.testing.assert_array_equal(found.stamps_ns, channel.stamps_ns)
            assert found.values.keys() == channel.values.keys()
            for name, values in channel.values.items():
                np.testing.assert_allclose(found.values[name], values, rtol=1e-14, atol=0)


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["log.csv"], 2, "Missing option '--output'"),
        (["log.csv", "-o", "log.txt"], 2, "should end in .csv, .parquet, .mcap"),
        (["log.csv", "-o", "log.csv", "--overwrite"], 1, "the same file"),
        (["log.csv", "-o", "old.csv"], 1, "exists already"),
        (["none.csv", "-o", "new.csv"], 1, "no such file"),
        (["log.csv", "-o", "new.csv", "--map", "sun=/sun"], 1, "no channel '/sun'"),
    ],
)
def test_what_cannot_be_converted_is_refused_in_one_line(
    arguments: list[str], code: int, says: str, log: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(log.parent)
    Path("old.csv").write_text("kept", encoding="utf-8")
    assert run(["convert", *arguments]) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert says in err
    assert Path("old.csv").read_text(encoding="utf-8") == "kept"
    assert not Path("new.csv").exists()
