"""Bad input of the plain kinds: one plain line with the way out, or a named warning; nothing left behind."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from journeys.odd_logs import ACCEL, GYRO, Drive, judged, read_track

HOSTILE = {
    "escape": "/imu\x1b]0;evil\x07\x1b[31m",
    "bidi": "imu\u202egpj.exe\u2066",
    "markup": "[bold red]imu[/bold red] [/imu]",
    "formula": '=cmd|"/C calc"!A0',
    "newline": "imu\nattest: all is well\r\n",
    "long": "x" * 500,
    "maths": "$bad{$ _^ \\frac",
    "html": "<script>alert(1)</script>",
}


@pytest.fixture
def short(whole: Drive) -> Drive:
    """The first seconds of the shipped drive, one stop and one motion, IMU alone."""
    return whole.span(0, 30).without("sun_x", "sun_y", "compass_deg", "velocity_x", "velocity_y", "velocity_z")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder."""
    here = tmp_path / "work"
    here.mkdir()
    monkeypatch.chdir(here)
    return here


def text(name: str, content: str | bytes, folder: Path) -> Path:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


DRAWN = {"escape", "markup", "maths", "long"}
"""Whose pages are drawn too: the door to the pages is one."""
NAMES = (
    *("[red]a.csv", "=cmd.csv", "-o.csv", "a\nb.csv", "\x1b[31mred.csv", "\u202ea.csv", "$bad{$.csv", "ü ö.csv"),
    "x" * 240 + ".csv",
)
HEADER = "t,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z\n"


def rows(count: int, step: float = 0.01) -> str:
    return "".join(f"{step * k:.4f},0.001,{0.0001 * (k % 3)},0,0.01,{0.01 * (k % 2)},9.81\n" for k in range(count))


FILES: dict[str, tuple[str, str | bytes, tuple[str, ...]]] = {
    "empty": ("log.csv", "", ("log.csv", "empty", "cut short")),
    "empty mcap": ("log.mcap", "", ("log.mcap", "empty")),
    "header only": ("log.csv", HEADER, ("log.csv", "no row of numbers")),
    "one row": ("log.csv", HEADER + rows(1), ("log.csv", "only 1 usable IMU rows", "at least 50")),
    "too short": ("log.csv", HEADER + rows(60), ("log.csv", "60 usable IMU rows over 0.59 s", "2 s")),
    "no header": ("log.csv", rows(500), ("log.csv", "no header", "gyro_x")),
    "no imu": (
        "log.csv",
        "t,mag_x,mag_y,mag_z\n" + "".join(f"{k},1,2,3\n" for k in range(99)),
        ("no IMU", "magnetometer"),
    ),
    "no gyro": (
        "log.csv",
        "t,accel_x,accel_y,accel_z\n" + "".join(f"{k / 100},0,0,9.8\n" for k in range(999)),
        ("no gyro",),
    ),
    "missing column": ("log.csv", (HEADER + rows(500)).replace("gyro_z", "spare", 1), ("gyro_z", "missing")),
    "no time": ("log.csv", (HEADER + rows(500)).replace("t,", "spare,", 1), ("no time column", "timestamp_ns")),
    "twice": ("log.csv", (HEADER + rows(500)).replace("gyro_z", "gyro_y", 1), ("gyro_y", "more than once")),
    "all text": ("log.csv", HEADER + "a,b,c,d,e,f,g\n" * 500, ("log.csv",)),
    "prose": ("log.csv", "Dear diary:\ntoday I drove\n" * 20, ("log.csv", "no line with numbers")),
    "garbage csv": ("log.csv", bytes(range(256)) * 200, ("log.csv",)),
    "garbage mcap": ("log.mcap", b"\x07garbage" * 999, ("log.mcap", "not MCAP")),
    "garbage parquet": ("log.parquet", b"\x07garbage" * 999, ("log.parquet", "not PARQUET")),
    "magic only mcap": ("log.mcap", b"\x89MCAP0\r\n", ("log.mcap",)),
    "magic and garbage mcap": ("log.mcap", b"\x89MCAP0\r\n" + b"\x07garbage" * 999, ("log.mcap",)),
    "magic and garbage parquet": ("log.parquet", b"PAR1" + b"\x07garbage" * 999, ("log.parquet", "damaged")),
    "utf-16": ("log.csv", (HEADER + rows(500)).encode("utf-16"), ("log.csv", "UTF-16")),
    "zip": ("log.csv", b"PK\x03\x04" + b"x" * 99, ("log.csv", "zip")),
    "gzip": ("log.csv", b"\x1f\x8b" + b"x" * 99, ("log.csv", "gunzip")),
    "no gravity": ("log.csv", HEADER + rows(500).replace("9.81", "0.05"), ("no gravity", "specific force")),
    "no resolution": ("log.csv", HEADER + rows(500, 0.0), ("distinct stamps", "int64 ns")),
}


@pytest.mark.parametrize("case", FILES)
def test_a_file_that_is_no_log_is_refused_in_one_line(case: str, folder: Path, attest: Callable[..., Any]) -> None:
    name, content, says = FILES[case]
    log = text(name, content, folder)
    attest("smooth", log).refused(*says)
    assert attest("info", log).code in {0, 1}
    assert [path.name for path in folder.iterdir()] == [name]


def test_a_missing_file_is_refused_with_the_one_meant(folder: Path, attest: Callable[..., Any]) -> None:
    text("rover.csv", HEADER + rows(500), folder)
    attest("smooth", folder / "rovr.csv").refused("rovr.csv: no such file", "did you mean", "rover.csv?")
    attest("smooth", folder / "nowhere" / "x.csv").refused("no such file")
    attest("smooth", "").refused()


def test_a_folder_is_no_log(folder: Path, attest: Callable[..., Any]) -> None:
    (folder / "logs").mkdir()
    attest("smooth", folder / "logs").refused("this is a folder", "log file itself")


@pytest.mark.parametrize("suffix", ["csv", "mcap", "parquet"])
@pytest.mark.parametrize("share", [0.02, 0.5, 0.999])
def test_a_cut_file_is_refused_or_said_to_be_cut(
    suffix: str, share: float, samples: Path, folder: Path, attest: Callable[..., Any]
) -> None:
    whole = (samples / f"rover.{suffix}").read_bytes()
    log = text(f"log.{suffix}", whole[: int(share * len(whole))], folder)
    outcome = attest("smooth", log, "--dry-run")
    if suffix == "csv":
        assert outcome.code == 0  # a shorter table is a table
    elif outcome.code == 1:
        outcome.refused(f"log.{suffix}")
    else:
        assert suffix == "mcap"  # only its summary is gone, or what was lost is said
        assert "rows 12000, used as imu" in outcome.out or "log.mcap" in outcome.out.partition("warnings")[2]
    assert [path.name for path in folder.iterdir()] == [log.name]


def test_every_command_ends_with_3_where_data_is_lost(samples: Path, folder: Path, attest: Callable[..., Any]) -> None:
    whole = (samples / "rover.mcap").read_bytes()
    log = text("log.mcap", whole[: len(whole) // 2], folder)
    for words in (
        ["smooth", "--dry-run"], ["smooth", "--dry-run", "--json"], ["info"], ["info", "--json"], ["doctor"],
        ["convert", "-o", folder / "log.csv"], ["convert", "--json", "-o", folder / "log.parquet"],
        ["init", "-o", folder / "attest.toml"], ["segment", "-o", folder / "segments"],
    ):  # fmt: skip
        assert attest(words[0], log, *words[1:]).code == 3, words
    undamaged = ["smooth", samples / "rover.mcap", "--dry-run"]
    assert (attest(*undamaged).code, attest(*undamaged, "--strict").code) == (0, 0)
    assert attest("smooth", samples / "rover.csv", "--dry-run", "--strict").code == 0


def nan_cells(d: Drive) -> Drive:
    value = d.columns["gyro_y"].copy()
    value[200:900:100] = np.nan
    return d.changed(gyro_y=value)


def shuffled(d: Drive) -> Drive:
    order = np.arange(len(d.t))
    order[[500, 501]] = order[[501, 500]]
    return d.rows(order)


def back(d: Drive) -> Drive:
    stamps = d.columns["timestamp_ns"].copy()
    stamps[700:] -= 5_000_000_000
    return d.changed(timestamp_ns=stamps)


def equal_stamps(d: Drive) -> Drive:
    stamps = d.columns["timestamp_ns"].copy()
    stamps[301] = stamps[300]
    return d.changed(timestamp_ns=stamps)


REPAIRED: dict[str, tuple[Callable[[Drive], Drive], str, int]] = {
    "NaN cells": (nan_cells, "imu-not-finite", 7),
    "swapped stamps": (shuffled, "rows-out-of-order", 0),
    "duplicate rows": (lambda d: d.rows(np.sort(np.append(np.arange(len(d.t)), [300, 800]))), "duplicate-rows", 2),
    "equal stamps": (equal_stamps, "batched-stamps", 0),
    "gap of 2 s": (lambda d: d.rows((d.t < 14) | (d.t > 16)), "imu-gap", 0),
}


@pytest.mark.parametrize("case", REPAIRED)
def test_repaired_rows_are_a_named_warning(case: str, short: Drive, folder: Path, attest: Callable[..., Any]) -> None:
    change, _, _ = REPAIRED[case]
    log = change(short).write(folder, "log.csv")
    outcome = attest("info", log)
    assert outcome.code == 0
    assert "▲" in outcome.err, outcome.err
    assert "log." in outcome.err
    assert "Traceback" not in outcome.err


@pytest.mark.parametrize("case", REPAIRED)
def test_a_repaired_log_is_smoothed_within_its_sigma(
    case: str, short: Drive, folder: Path, smooth: Callable[..., Any]
) -> None:
    change, code, dropped = REPAIRED[case]
    drive = change(short)
    result = smooth(drive.write(folder))
    assert code in result.codes
    assert result.report["coverage"]["rows_dropped"] == dropped
    assert result.report["verdict"] == "WARN"
    track = read_track(result.folder)
    assert np.all(np.diff(track["timestamp_ns"]) > 0)
    if case != "equal stamps":
        order = np.argsort(drive.columns["timestamp_ns"], kind="stable")
        assert judged(result.folder, drive.rows(order), relative=True).tilt_ratio() < 2.5


def test_a_clock_that_steps_back_is_refused(short: Drive, folder: Path, attest: Callable[..., Any]) -> None:
    log = back(short).write(folder)
    attest("smooth", log).refused("drive.parquet", "steps back by", "row 701", "--end")
    assert {path.name for path in folder.iterdir()} == {"drive.parquet", "attest.toml"}


def test_the_way_out_of_a_step_back_works(short: Drive, folder: Path, attest: Callable[..., Any]) -> None:
    log = back(short).write(folder)
    end = attest("smooth", log).err.rpartition("--end ")[2].split()[0]
    assert attest("smooth", log, "--end", end, "--dry-run").code == 0


def test_an_existing_result_is_kept(short: Drive, folder: Path, attest: Callable[..., Any]) -> None:
    log = short.write(folder)
    kept = text("mine.txt", "precious", folder)
    (folder / "drive.attest").mkdir()
    (folder / "drive.attest" / "notes.txt").write_text("precious")
    attest("smooth", log).refused("drive.attest", "exists already", "--overwrite")
    assert [path.name for path in (folder / "drive.attest").iterdir()] == ["notes.txt"]
    attest("smooth", log, "-o", kept).refused("mine.txt")
    attest("smooth", log, "-o", kept, "--overwrite").refused("mine.txt", "is a file")
    attest("smooth", log, "-o", kept / "below").refused("not a folder")
    attest("smooth", log, "-o", log, "--overwrite").refused("same file")
    assert kept.read_text() == "precious"
    attest("smooth", log, "--overwrite").refused("drive.attest", "no report.json of attest", "not a result folder")
    (folder / "drive.attest" / "report.json").write_text('{"attest_version": "0.0.1"}')
    assert attest("smooth", log, "--overwrite").code == 0
    assert (folder / "drive.attest" / "segments.csv").is_file()
    assert (folder / "drive.attest" / "notes.txt").read_text() == "precious"


def test_a_picture_does_not_replace_its_log(short: Drive, folder: Path, attest: Callable[..., Any]) -> None:
    log = short.write(folder)
    attest("segment", log, "-o", log).refused("same file")
    attest("segment", log, "-o", log, "--overwrite").refused("same file")
    attest("segment", log, "-o", folder).refused(str(folder))
    assert log.read_bytes()[:4] == b"PAR1"


@pytest.fixture
def nobody() -> Iterator[Path]:
    """An open folder of its own and, where this process may, another user for the time of the test."""
    place = Path(tempfile.mkdtemp())
    place.chmod(0o777)
    root = os.geteuid() == 0
    try:
        if root:
            os.setresuid(65534, 65534, 0)
        if os.access(place.parent / "nowhere", os.W_OK) or (root and os.geteuid() == 0):
            pytest.skip("this process cannot become a user without rights")
        yield place
    finally:
        if root:
            os.setresuid(0, 0, 0)
        for path in (place, *place.rglob("*")):
            path.chmod(0o777)
        shutil.rmtree(place)


def test_a_folder_that_is_not_ours_is_refused(
    samples: Path, short: Drive, nobody: Path, attest: Callable[..., Any]
) -> None:
    log = short.write(nobody)
    locked = nobody / "locked"
    locked.mkdir()
    locked.chmod(0o555)
    way_out = "cannot be written to; choose another place with -o"
    attest("smooth", log, "-o", locked / "result").refused(way_out)
    attest("smooth", log, "-o", locked).refused(way_out)
    attest("segment", log, "-o", locked / "stops.png").refused(way_out)
    attest("simulate", "rover", "-o", locked / "log.csv", "--duration", 30).refused(way_out)
    assert list(locked.iterdir()) == []


def test_a_log_that_is_not_ours_is_refused(short: Drive, nobody: Path, attest: Callable[..., Any]) -> None:
    log = short.write(nobody)
    stops = text("stops.csv", "start_s,end_s\n0,5\n", nobody)
    stops.chmod(0o000)
    attest("smooth", log, "--stops", stops, "-o", nobody / "result").refused("stops.csv: Permission denied")
    (nobody / "attest.toml").chmod(0o000)
    attest("smooth", log, "-o", nobody / "result").refused("attest.toml: Permission denied")
    log.chmod(0o000)
    other = text("other.toml", "", nobody)
    (nobody / "attest.toml").unlink()
    attest("smooth", log, "-c", other, "-o", nobody / "result").refused("drive.parquet", "Permission denied")
    attest("info", log).refused("drive.parquet", "Permission denied")
    closed = nobody / "closed"
    closed.mkdir()
    closed.chmod(0o000)
    attest("smooth", closed, "-o", nobody / "result").refused("closed: cannot be read: Permission denied")
    attest("report", closed).refused("closed")
    attest("smooth", closed / "drive.csv", "-o", nobody / "result").refused("closed", "Permission denied")


SETTINGS: dict[str, tuple[str, tuple[str, ...]]] = {
    "unknown table": ("[imuu]\nchannel = 'x'", ("unknown setting imuu", "did you mean imu?")),
    "unknown key": ("[sun]\nsigma = 1", ("unknown setting sun.sigma", "sun.sigma_deg?")),
    "wrong type": ("[sun]\nsigma_deg = 'much'", ("sun.sigma_deg", "'much'")),
    "negative": ("[sun]\nsigma_deg = -1", ("sun.sigma_deg",)),
    "nan": ("[sun]\nsigma_deg = nan", ("sun.sigma_deg",)),
    "wrong choice": ("[smoothing]\nsmoother = 'rst'", ("rst", "did you mean 'rts'?")),
    "wrong unit": ("[imu]\ngyro_noise_density = '0.3 deg'", ("gyro_noise_density", "0.3 deg")),
    "zero direction": ("[world]\nsun_direction = [0, 0, 0]", ("sun_direction",)),
    "short direction": ("[world]\nsun_direction = [0, 1]", ("sun_direction",)),
    "zero quaternion": ("[imu]\nmounting = [0, 0, 0, 0]", ("imu.mounting",)),
    "far latitude": ("[world]\nlatitude_deg = 123\nlongitude_deg = 0", ("latitude_deg",)),
    "no such channel": ("[imu]\nchannel = '/imu/dta'", ("no channel '/imu/dta'",)),
    "no such noise file": ("[imu]\nnoise_file = 'imu.yaml'", ("imu.yaml: no such file",)),
    "no TOML": ("[imu\nchannel", ("attest.toml is not TOML",)),
    "binary": ("\x00\xff\x00", ("attest.toml",)),
    "unknown role": ("[map]\nsunn = 'sun'", ("unknown role 'sunn'", "'sun'?")),
}


@pytest.mark.parametrize("case", SETTINGS)
def test_a_bad_config_is_refused_by_name(case: str, short: Drive, folder: Path, attest: Callable[..., Any]) -> None:
    config, says = SETTINGS[case]
    log = short.write(folder, config=False)
    text("attest.toml", config.encode("latin-1"), folder)
    attest("smooth", log).refused(*says)
    assert {path.name for path in folder.iterdir()} == {"drive.parquet", "attest.toml"}


OPTIONS: dict[str, tuple[tuple[str, ...], int, tuple[str, ...]]] = {
    "unknown role": (("--map", "moon=/moon"), 2, ("unknown role 'moon'",)),
    "unknown channel": (("--map", "sun=/sun"), 1, ("no channel '/sun'", "nearest: sun")),
    "unknown imu": (("--imu", "/imu/data"), 1, ("no channel '/imu/data'", "imu")),
    "not a pair": (("--map", "sun"), 2, ("ROLE=CHANNEL",)),
    "imu as sun": (("--map", "sun=imu"), 1, ("imu", "cannot be the sun")),
    "iterations": (("--iterations", "many"), 2, ("iterations", "many")),
    "negative iterations": (("--iterations", "-3"), 2, ("iterations",)),
    "unknown format": (("--format", "xlsx"), 2, ("xlsx",)),
    "no format": (("--format", ""), 2, ("formats",)),
    "nan window": (("--start", "nan"), 2, ("start_s",)),
    "gate": (("--max-sigma-attitude-deg", "-1"), 2, ("max_sigma_attitude_deg",)),
    "threshold": (("--stop-threshold-deg", "0"), 2, ("stop_threshold_deg",)),
    "missing config": (("-c", "none.toml"), 1, ("none.toml: no such file",)),
    "no odometry": (("--position", "odometry"), 1, ("odometry",)),
    "no vehicle axes": (("--body", "vehicle"), 1, ("vehicle",)),
}


@pytest.mark.parametrize("case", OPTIONS)
def test_bad_options_are_refused_by_name(case: str, whole: Drive, folder: Path, attest: Callable[..., Any]) -> None:
    options, code, says = OPTIONS[case]
    log = whole.span(0, 30).without("velocity_x", "velocity_y", "velocity_z").write(folder, config=False)
    outcome = attest("smooth", log, *options)
    assert outcome.code == code, outcome
    assert outcome.err.count("\n") == 1
    assert all(word in outcome.err for word in says), outcome.err
    assert "defect" not in outcome.err
    assert [path.name for path in folder.iterdir()] == ["drive.parquet"]


STOPS: dict[str, tuple[str, tuple[str, ...]]] = {
    "empty": ("", ("no stops in it",)),
    "header only": ("start_s,end_s\n", ("no stops in it",)),
    "other columns": ("from,to\n1,2\n", ("no column",)),
    "words": ("start_s,end_s\nsoon,later\n", ("line 2 is not two numbers",)),
    "blank": ("start_s,end_s\n1,\n", ("line 2",)),
    "reversed": ("start_s,end_s\n9,1\n", ("line 2", "9 to 1")),
    "nan": ("start_s,end_s\nnan,nan\n", ("line 2",)),
    "overlap": ("start_s,end_s\n1,5\n4,9\n", ("overlap",)),
    "outside": ("start_s,end_s\n500,600\n", ("the log spans",)),
    "epoch": ("start_s,end_s\n1780308000,1780308005\n", ("the log spans",)),
    "binary": ("\x00\x01\x02", ("stops.csv",)),
}


@pytest.mark.parametrize("case", STOPS)
def test_bad_stops_are_refused_by_line(case: str, short: Drive, folder: Path, attest: Callable[..., Any]) -> None:
    content, says = STOPS[case]
    log, stops = short.write(folder), text("stops.csv", content, folder)
    attest("smooth", log, "--stops", stops).refused("stops.csv", *says)
    assert not (folder / "drive.attest").exists()


def test_missing_stops_are_refused(short: Drive, folder: Path, attest: Callable[..., Any]) -> None:
    attest("smooth", short.write(folder), "--stops", "none.csv").refused("none.csv: No such file")
    attest("smooth", folder / "drive.parquet", "--stops", folder).refused(str(folder))


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_names_reach_neither_terminal_nor_page_raw(
    case: str, short: Drive, folder: Path, smooth: Callable[..., Any], attest: Callable[..., Any]
) -> None:
    name = HOSTILE[case]
    doubled = {f"{name}_{n}": short.columns[n] for n in (*GYRO, *ACCEL)}
    log = short.changed(**doubled, **{name: short.columns["gyro_x"]}).write(folder)
    shown = attest("info", log)
    assert shown.code == 0
    printable = "\n\u00a0\u2009\u202f"
    assert all(c.isprintable() or c in printable for c in shown.out + shown.err)
    if case not in DRAWN:
        return
    result = smooth(log, draw=True)
    page = (result.folder / "report/report.html").read_text(encoding="utf-8")
    assert "<script>alert" not in page
    assert all(c.isprintable() or c in printable for c in page)
    for cell in (result.folder / "segments.csv").read_text(encoding="utf-8").replace("\n", ",").split(","):
        assert cell[:1] not in {"=", "@", "\t"}
    sizes = {path.stat().st_size for path in (result.folder / "report").glob("*.png")}
    assert max(sizes) < 1_000_000


@pytest.mark.parametrize("name", NAMES)
def test_hostile_file_names_are_plain_words(name: str, folder: Path, attest: Callable[..., Any]) -> None:
    log = text(name, HEADER + "x\n", folder)
    outcome = attest("smooth", "--", log)
    outcome.refused()
    text(name, HEADER + rows(1500), folder)
    outcome = attest("segment", "--", log)
    assert outcome.code == 0 or (outcome.code == 1 and len(name) > 200), outcome
    assert all(c.isprintable() or c in "\n\u00a0\u2009\u202f" for c in outcome.err)
    assert "defect" not in outcome.err
    if outcome.code == 0:
        assert (folder / f"{log.stem}.stops.png").is_file()
    assert not [path.name for path in folder.iterdir() if path.name.endswith(".tmp")]
