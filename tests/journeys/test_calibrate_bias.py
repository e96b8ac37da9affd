"""Calibrate from a drive or from a log at rest, then smooth with what was found."""

from __future__ import annotations

import json
import re
import shutil
import tomllib
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from journeys.conftest import Outcome, Smoothed
from journeys.odd_logs import ACCEL, GYRO, Drive, judged, read_track

from attest_cli.__main__ import run

FILES = {"calibration.toml", "imu.yaml", "08-calibrate-bias.png"}
NOISE = ("gyro_noise_density", "gyro_random_walk", "accel_noise_density", "accel_bias_sigma")
Attest = Callable[..., Outcome]
Smooth = Callable[..., Smoothed]


@pytest.fixture(scope="module")
def unstated(whole: Drive) -> Drive:
    """The shipped drive; its config says nothing of the IMU's noise."""
    kept = [line for line in whole.config.splitlines() if not line.startswith(NOISE)]
    return replace(whole, config="\n".join(kept) + "\n")


@pytest.fixture
def undrawn(own: Own, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages hold nothing: one is drawn in full by :func:`own`."""
    monkeypatch.setattr("attest_cli.figures.page.Page.png", lambda _: b"")


pytestmark = pytest.mark.usefixtures("undrawn")


@dataclass(frozen=True)
class Own:
    """A drive, the folder calibrated from it, its file, and the words that came with it."""

    log: Path
    folder: Path
    found: dict[str, Any]
    words: str
    out: str

    @property
    def file(self) -> Path:
        """The calibration file."""
        return self.folder / "calibration.toml"


@pytest.fixture(scope="module")
def own(unstated: Drive, tmp_path_factory: pytest.TempPathFactory) -> Own:
    """The shipped drive calibrated once; only to be read."""
    base, words, out = tmp_path_factory.mktemp("own"), StringIO(), StringIO()
    log = unstated.write(base)
    with redirect_stderr(words), redirect_stdout(out):
        assert run(["calibrate-bias", str(log), "-o", str(base / "c"), "--json"]) == 0
    found = tomllib.loads((base / "c/calibration.toml").read_text(encoding="utf-8"))
    return Own(log, base / "c", found, words.getvalue(), out.getvalue())


def calibrated(attest: Attest, log: Path, folder: Path, *more: object) -> tuple[Outcome, dict[str, Any]]:
    done = attest("calibrate-bias", log, "-o", folder, *more)
    assert done.code == 0, done.err
    return done, tomllib.loads((folder / "calibration.toml").read_text(encoding="utf-8"))


def test_a_drive_is_calibrated_from_its_stops(own: Own) -> None:
    assert {path.name for path in own.folder.iterdir()} == FILES
    assert (own.folder / "08-calibrate-bias.png").read_bytes()[:4] == b"\x89PNG"
    assert own.found["source"]["static"] is False
    for axis in own.found["gyro"].values():
        low, high = axis["noise"]["noise_density_95"]
        assert low * 0.98 < 1.5e-4 < high * 1.02  # the shipped drive's, at 95 %
        assert axis["bias"]["model"] == "random-walk"
    for words in ("rad/s/√Hz", "°/√h", "rad/s²/√Hz", "°/h/√h", "°/s", "°/h"):
        assert words in own.words
    data = json.loads(own.out)
    assert data["gyro"]["z"]["bias"]["values"] == own.found["gyro"]["z"]["bias"]["values"]
    assert data["status"] == "PASS"
    assert 'rostopic: "' in (own.folder / "imu.yaml").read_text(encoding="utf-8")


def test_a_drive_smoothed_with_its_own_calibration_is_no_worse_and_says_where_its_noise_is_from(
    own: Own, smooth: Smooth, unstated: Drive
) -> None:
    without, with_it = smooth(own.log, output="a"), smooth(own.log, "--calibration", own.file, output="b")
    settings = with_it.report["settings"]
    assert {settings[f"imu.{name}"]["source"] for name in NOISE[:3]} == {"calibration"}
    assert settings["imu.gyro_noise_density"]["value"] == pytest.approx(1.5e-4, rel=0.03)
    assert settings["imu.gyro_bias_sigma"]["source"] == "calibration"
    assert settings["imu.gyro_scale_sigma"] == without.report["settings"]["imu.gyro_scale_sigma"]
    assert any("of this drive" in line for line in with_it.report["history"])
    a, b = (judged(done.folder, unstated) for done in (without, with_it))
    assert np.sqrt(np.mean(b.heading**2)) < 1.1 * np.sqrt(np.mean(a.heading**2))
    assert b.tilt_ratio() < 2.0
    assert b.heading_ratio() < 2.0
    track = read_track(with_it.folder)
    for axis in "xyz":  # the bias that is told is that of the raw gyro
        true = np.interp(track["t_s"], unstated.t, unstated.truth[f"gyro_bias_{axis}_rad_s"])
        sigma = track[f"sigma_gyro_bias_{axis}_rad_s"]
        assert np.abs((track[f"gyro_bias_{axis}_rad_s"] - true) / sigma).max() < 5.0
        assert np.abs(true).max() > 10.0 * sigma.max() or axis == "x"


def test_what_the_settings_state_beats_the_calibration(own: Own, smooth: Smooth, whole: Drive, tmp_path: Path) -> None:
    log = whole.told("[imu]", '[imu]\ncalibration = "mine.toml"').write(tmp_path)
    shutil.copy(own.file, tmp_path / "mine.toml")  # beside the config
    settings = smooth(log).report["settings"]
    for name in NOISE:
        assert settings[f"imu.{name}"]["source"] == str(tmp_path / "attest.toml")
    assert settings["imu.calibration"]["value"] == str(tmp_path / "mine.toml")
    assert settings["imu.gyro_bias_sigma"]["source"] == "calibration"


def test_a_config_that_names_the_calibration_to_be_made_is_no_obstacle(
    own: Own, attest: Attest, unstated: Drive, tmp_path: Path
) -> None:
    log = unstated.told("[imu]", '[imu]\ncalibration = "mine.toml"').write(tmp_path)
    attest("smooth", log, "-o", tmp_path / "early").refused("mine.toml", "no such file")
    shutil.copy(own.file, tmp_path / "mine.toml")
    calibrated(attest, log, tmp_path / "c")  # made from the log as it is, not as the calibration leaves it
    assert (tmp_path / "c/calibration.toml").read_bytes() == own.file.read_bytes()


def test_another_mounting_changes_neither_the_file_nor_what_it_does(
    own: Own, attest: Attest, smooth: Smooth, unstated: Drive, tmp_path: Path
) -> None:
    turned = unstated.turned(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    turned = turned.told("mounting = [1.0, 0.0, 0.0, 0.0]", f"mounting = [{0.5**0.5}, 0.0, 0.0, {-(0.5**0.5)}]")
    log = turned.write(tmp_path / "turned")
    _, found = calibrated(attest, log, tmp_path / "c")
    x, y = (found["gyro"][axis]["bias"]["values"][0] for axis in "xy")
    plain = [own.found["gyro"][axis]["bias"]["values"][0] for axis in "xy"]
    assert (x, y) == pytest.approx([-plain[1], plain[0]])
    track = read_track(smooth(log, "--calibration", tmp_path / "c/calibration.toml").folder)
    other = read_track(smooth(own.log, "--calibration", own.file, output="o").folder)
    for name in ("gyro_bias_x_rad_s", "gyro_bias_y_rad_s", "yaw_deg"):
        np.testing.assert_allclose(track[name], other[name], atol=1e-6)


def test_the_calibration_of_another_sensor_is_doubted_in_one_line(
    own: Own, smooth: Smooth, unstated: Drive, tmp_path: Path
) -> None:
    shifted = unstated.changed(
        timestamp_ns=unstated.columns["timestamp_ns"] + 86_400_000_000_000, gyro_y=unstated.columns["gyro_y"] + 0.05
    )
    done = smooth(shifted.write(tmp_path / "two"), "--calibration", own.file)
    (told,) = (w for w in done.report["warnings"] if w["code"].startswith("calibration"))
    assert told["code"] == "calibration-bias"
    assert "2.86 deg/s off" in told["message"]
    assert any("of another switch-on" in line for line in done.report["history"])


def test_an_existing_calibration_is_kept_unless_told(own: Own, attest: Attest, tmp_path: Path) -> None:
    log = own.log
    shutil.copytree(own.folder, tmp_path / "c")
    attest("calibrate-bias", log, "-o", tmp_path / "c").refused("exists already", "--overwrite")
    (tmp_path / "c/notes.txt").write_text("mine", encoding="utf-8")
    _, found = calibrated(attest, log, tmp_path / "c", "--overwrite", "--model", "constant")
    assert found["gyro"]["x"]["bias"]["model"] == "constant"
    assert {path.name for path in (tmp_path / "c").iterdir()} == FILES | {"notes.txt"}
    (tmp_path / "d").mkdir()
    (tmp_path / "d/thesis.txt").write_text("mine", encoding="utf-8")
    attest("calibrate-bias", log, "-o", tmp_path / "d", "--overwrite").refused("no calibration.toml of attest")


def test_without_an_argument_the_only_log_here_is_taken(
    attest: Attest, samples: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    none = attest("calibrate-bias")
    assert (none.code, none.out) == (2, "")
    assert "no log here" in none.err
    shutil.copy(samples / "rover.parquet", tmp_path / "static.parquet")
    shutil.copy(samples / "rover.truth.parquet", tmp_path)
    assert attest("calibrate-bias").code == 0
    assert {path.name for path in (tmp_path / "static.calibration").iterdir()} == FILES
    (tmp_path / "a\x1b[31m.csv").write_text("t\n", encoding="utf-8")
    two = attest("calibrate-bias")
    assert (two.code, two.out, two.err.count("\n")) == (2, "", 1)
    assert "2 logs here, name one" in two.err
    assert "static.parquet" in two.err
    assert "\x1b" not in two.err


def test_a_log_that_only_moves_is_refused(attest: Attest, whole: Drive, tmp_path: Path) -> None:
    start = float(whole.t[np.argmax(whole.moving)])
    end = start + float(np.argmin(whole.moving[np.argmax(whole.moving) :])) / 50.0
    log = whole.span(start + 3.0, end - 3.0).write(tmp_path)
    done = attest("calibrate-bias", log, "-o", tmp_path / "c")
    done.refused("drive.parquet", "nothing in it stands still", "--stops")
    assert not (tmp_path / "c").exists()


def test_too_short_a_rest_is_said_to_show_little(attest: Attest, whole: Drive, tmp_path: Path) -> None:
    log = whole.span(0.0, 4.0).write(tmp_path)
    done, found = calibrated(attest, log, tmp_path / "c")
    assert "too short for K" in done.err
    for axis in found["gyro"].values():
        assert "random_walk" not in axis["noise"]
        assert "instability_read_off" not in axis["noise"]
        assert axis["noise"]["random_walk_95"][1] > 1e-5
    shorter = whole.span(0.0, 1.0).write(tmp_path, "x.csv")
    attest("calibrate-bias", shorter, "-o", tmp_path / "d").refused("x.csv", "2 s")


def test_a_model_that_the_log_cannot_tell_is_refused(attest: Attest, samples: Path, tmp_path: Path) -> None:
    done = attest("calibrate-bias", samples / "rover.csv", "-o", tmp_path / "c", "--model", "temperature")
    done.refused("rover.csv: the log has no temperature", "--map temperature=")
    assert not (tmp_path / "c").exists()


def at_rest(start_s: float, seed: int, bias: float = 1e-3) -> Drive:
    """A minute at rest."""
    rng, n = np.random.default_rng(seed), 1200
    values = np.hstack([rng.normal(bias, 7e-4, (n, 3)), rng.normal([0.0, 0.0, 9.8], 1e-2, (n, 3))])
    stamps = 1_780_308_000_000_000_000 + round(start_s * 1e9) + 50_000_000 * np.arange(n)
    return Drive({"timestamp_ns": stamps, **dict(zip(GYRO + ACCEL, values.T, strict=True))}, {}, "")


def test_static_logs_of_one_sensor_count_together_whatever_their_order(attest: Attest, tmp_path: Path) -> None:
    logs = [at_rest(3600.0 * k, k, 1e-3 + 1e-5 * k).write(tmp_path, f"{k}.parquet") for k in (1, 0)]
    done = attest("calibrate-bias", *logs, "-o", tmp_path / "c")
    assert done.code == 0, done.err
    found = tomllib.loads((tmp_path / "c/calibration.toml").read_text(encoding="utf-8"))["source"]
    assert {file["name"] for file in found["files"]} == {"0.parquet", "1.parquet"}
    assert found["at_rest_s"] == pytest.approx(118.0, abs=1.0)
    assert "61 min, 1 min 58 s of it at rest" in done.err  # not an hour at rest
    assert "2 logs on one time axis" in done.err


def test_logs_that_overlap_are_refused_and_none_is_dropped_without_a_word(attest: Attest, tmp_path: Path) -> None:
    logs = [at_rest(10.0 * k, k).write(tmp_path, f"{k}.parquet") for k in (0, 1)]
    attest("calibrate-bias", *logs, "-o", tmp_path / "c").refused("0.parquet and 1.parquet overlap in time")
    other = tmp_path / "gps.csv"
    other.write_text("timestamp_ns,latitude,longitude\n1780308000000000000,1,1\n1780308001000000000,1,1\n")
    later = at_rest(600.0, 2).write(tmp_path, "2.parquet")
    attest("calibrate-bias", logs[0], later, other, "-o", tmp_path / "c").refused("gps.csv: no IMU in it, but 2 logs")


def test_a_file_that_gave_nothing_is_no_source(attest: Attest, tmp_path: Path) -> None:
    log, other = at_rest(0.0, 0).write(tmp_path, "0.parquet"), tmp_path / "gps.csv"
    other.write_text("timestamp_ns,latitude,longitude\n1780308000000000000,1,1\n1780308001000000000,1,1\n")
    _, found = calibrated(attest, log, tmp_path / "c", other)
    assert [file["name"] for file in found["source"]["files"]] == ["0.parquet"]


def test_what_the_log_cannot_show_is_a_note_and_no_warning(attest: Attest, tmp_path: Path) -> None:
    done, _ = calibrated(attest, at_rest(0.0, 0).write(tmp_path, "0.parquet"), tmp_path / "c")
    assert "accelerometer not calibrated" in done.err
    assert "▲" not in done.err
    assert "rad/s" in done.err.splitlines()[2]
    assert "(95 %)" in done.err.splitlines()[2]


def test_a_stuck_gyro_is_refused(attest: Attest, whole: Drive, tmp_path: Path) -> None:
    log = whole.changed(gyro_x=np.full(len(whole.t), 0.01)).write(tmp_path)
    attest("calibrate-bias", log, "-o", tmp_path / "c").refused("gyro x does not change")


def test_a_hostile_name_reaches_no_terminal_and_no_file_raw(attest: Attest, whole: Drive, tmp_path: Path) -> None:
    name = "a\x1b]0;evil\x07\u202e$x_1$.parquet"
    log = whole.write(tmp_path, name)
    done, found = calibrated(attest, log, tmp_path / "c")
    text = (tmp_path / "c/calibration.toml").read_text(encoding="utf-8")
    assert found["source"]["files"][0]["name"] == name
    for words in (done.err.replace("\n", ""), re.sub(r"\n", "", text), (tmp_path / "c/imu.yaml").read_text()):
        assert not set("\x1b\x07\u202e") & set(words)
    attest("calibrate-bias", log, "-o", tmp_path / "c").refused("exists already")


def test_a_bad_calibration_file_is_one_line(attest: Attest, whole: Drive, tmp_path: Path) -> None:
    log, bad = whole.write(tmp_path), tmp_path / "bad.toml"
    for content, words in (
        ("gyro = 1\n", "not a calibration"),
        ("[source\n", "not TOML"),
        ("\x00\n", "not TOML"),
    ):
        bad.write_text(content, encoding="utf-8")
        attest("smooth", log, "--calibration", bad, "-o", tmp_path / "r").refused(str(bad), words)
    attest("smooth", log, "--calibration", tmp_path / "none.toml", "-o", tmp_path / "r").refused("no such file")
    attest("smooth", log, "--calibration", tmp_path, "-o", tmp_path / "r").refused("is a folder")
    assert not (tmp_path / "r").exists()


def test_a_log_at_rest_shows_its_warm_up(attest: Attest, whole: Drive, tmp_path: Path) -> None:
    """Ten minutes at rest: an exponential of 100 s on the y axis."""
    rng, n = np.random.default_rng(5), 12_000
    t = np.arange(n) / 20.0
    rates = rng.normal([1e-3, 0.0, -1e-3], 1.5e-4 * 20.0**0.5, (n, 3))
    rates[:, 1] += 2e-3 * -np.expm1(-t / 100.0)
    force = rng.normal([0.0, 0.0, 9.8], 2e-3 * 20.0**0.5, (n, 3))
    columns = {"timestamp_ns": 1_780_308_000_000_000_000 + np.rint(t * 1e9).astype(np.int64)}
    columns |= dict(zip(GYRO + ACCEL, np.hstack([rates, force]).T, strict=True))
    log = Drive(columns, {}, "").write(tmp_path)
    _, found = calibrated(attest, log, tmp_path / "c")
    axis = found["gyro"]["y"]["bias"]
    assert found["source"]["static"] is True
    assert axis["model"] == "exponential"
    sigma = np.sqrt(np.diag(axis["covariance"]))
    assert np.all(np.abs(np.array(axis["values"]) - [2e-3, 0.0, 100.0]) < 4.0 * sigma)
    assert {found["gyro"][name]["bias"]["model"] for name in "xz"} == {"constant"}
