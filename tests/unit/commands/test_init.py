"""``attest init``: what was guessed is written down, so that it is no guess any more, and no file is replaced."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from support.text_logs import ROWS, G, accel, gyro, in_order, mag, stamps, t, table, xyz

from attest_cli.__main__ import run
from attest_cli.prepare import prepare
from attest_cli.readers import read
from attest_cli.records import Log
from attest_cli.settings import load_settings

DEG = np.degrees(1.0)
GUESSES = {"unit-guessed", "time-unit-guessed", "unit-contradicted"}


def logged(*paths: Path) -> Log:
    settings = load_settings(None, paths[0], {}).settings
    return prepare([read(path, settings) for path in paths], settings)


def same(one: Log, other: Log) -> None:
    np.testing.assert_array_equal(one.stamps_ns, other.stamps_ns)
    np.testing.assert_allclose(one.imu.gyro_b, other.imu.gyro_b, rtol=1e-12)
    np.testing.assert_allclose(one.imu.accel_b, other.imu.accel_b, rtol=1e-12)
    assert one.fixes.keys() == other.fixes.keys()


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Nothing states a unit, there are two IMUs, and a name is hostile."""
    path = tmp_path / "log.csv"
    head = "clock time," + ",".join(f"{s} {q} {a}" for s in ("left", "right") for q in ("gyro", "acc") for a in "XYZ")
    head = head.replace("clock time", "timestamp") + ',Mag X,Mag Y,Mag Z,"evil\x1b]0; ""x"" = 1"'
    other = [*xyz(gyro * 1.1, DEG), *xyz(accel, 1 / G)]
    columns = [stamps(1e-6, 7), *xyz(gyro, DEG), *xyz(accel, 1 / G), *other, *xyz(mag, 10.0), in_order(lambda _: "1")]
    path.write_text(table(head, columns), encoding="utf-8")
    return path


def test_after_it_nothing_is_guessed_and_everything_is_the_same(log: Path) -> None:
    before = logged(log)
    assert GUESSES & {w.code for w in before.warnings}
    assert run(["init", str(log), "-q"]) == 0
    config = tomllib.loads((log.parent / "attest.toml").read_text(encoding="utf-8"))
    assert config["table"]["time_unit"] == "us"
    assert config["imu"] == {"channel": "left/imu"}
    assert config["table"]["names"]["left gyro X"] == "left gyro_x [deg/s]"
    assert config["table"]["names"]["Mag Y"] == "mag_y [mGauss]"
    after = logged(log)
    assert not {w.code for w in after.warnings}
    same(before, after)


def test_what_was_asked_for_is_kept(tmp_path: Path) -> None:
    log = tmp_path / "log.txt"
    rows = [f"{kind};{20 * k};{';'.join(f'{v:.6f}' for v in values[k])}" for k in range(ROWS)
            for kind, values in (("g", gyro), ("a", accel))]  # fmt: skip
    log.write_text("\n".join([*rows, ""]), encoding="utf-8")
    options = [
        x for kind in ("gyro", "accel") for x in ("--columns", f"{kind[0]}:type,t [ms],{kind}_x,{kind}_y,{kind}_z")
    ]
    assert run(["init", str(log), "-q", *options]) == 0
    after = logged(log)
    np.testing.assert_allclose(after.imu.gyro_b, gyro, atol=1e-6)
    np.testing.assert_allclose(after.imu.accel_b, accel, atol=1e-6)
    text = (tmp_path / "attest.toml").read_text(encoding="utf-8")
    assert tomllib.loads(text)["map"] == {"gyro": "gyro", "accel": "accel"}
    assert "# gyro_noise_density" in text


def test_every_line_is_valid_and_says_what_is_not_used(log: Path) -> None:
    assert run(["init", str(log), "-q", "-o", str(log.parent / "other.toml")]) == 0
    text = (log.parent / "other.toml").read_text(encoding="utf-8")
    assert load_settings(log.parent / "other.toml", None, {}).settings.imu.channel == "left/imu"
    assert "right/imu (400 rows)" in text
    assert "gravity shows on +z" in text
    assert text.replace("\n", "").isprintable()


def test_a_file_that_is_there_is_left_alone(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = log.parent / "attest.toml"
    config.write_text("# mine\n", encoding="utf-8")
    assert run(["init", str(log)]) == 1
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert "exists already" in err
    assert config.read_text(encoding="utf-8") == "# mine\n"


def test_a_log_that_cannot_be_smoothed_leaves_no_settings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "log.csv"
    log.write_text(table("t,gyro_x,gyro_y,gyro_z", [list(t), *xyz(gyro)]), encoding="utf-8")
    assert run(["init", str(log)]) == 1
    assert "no accelerometer" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["log.csv"]
