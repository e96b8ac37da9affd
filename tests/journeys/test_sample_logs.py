"""The shipped drive through the whole job: same track from every format, honest sigmas, whole folder, drawn again."""

from __future__ import annotations

import csv
import json
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pyarrow.parquet as pq
import pytest
from journeys.odd_logs import GYRO, Drive, judged, quaternions, read_track
from scipy.spatial.transform import Rotation

from attest_cli.__main__ import run
from attest_cli.readers.result import INNOVATIONS, PASSES

FORMATS = ("csv", "mcap", "parquet")
EVERY_FORMAT = ("--format", "parquet,csv,tum")
PAGES = ("01-overview", "02-separation", "03-gyro-bias", "04-sigma", "06-plan", "07-stops")


@dataclass(frozen=True)
class Done:
    """A result folder and the words that came with it."""

    folder: Path
    words: str

    @property
    def report(self) -> dict[str, Any]:
        """``report.json``."""
        found: dict[str, Any] = json.loads((self.folder / "report.json").read_text(encoding="utf-8"))
        return found


@pytest.fixture(scope="module")
def done(samples: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Done]]:
    """The three sample logs, smoothed once; CSV drawn and with every format of the track."""
    base = tmp_path_factory.mktemp("samples")
    found = {}
    for name in FORMATS:
        words = StringIO()
        with redirect_stderr(words), pytest.MonkeyPatch.context() as patch:
            if name != "csv":
                patch.setattr("attest_cli.pipeline.write_pages", lambda *_: [])
            more = EVERY_FORMAT if name == "csv" else []
            assert run(["smooth", str(samples / f"rover.{name}"), "-o", str(base / name), *more]) == 0
        found[name] = Done(base / name, words.getvalue())
    yield found
    shutil.rmtree(base)


def degrees_apart(a: np.ndarray[Any, Any], b: np.ndarray[Any, Any]) -> float:
    """Largest angle between two tracks of quaternions, deg; by another library than attest's own."""
    turns = Rotation.from_quat(a, scalar_first=True).inv() * Rotation.from_quat(b, scalar_first=True)
    return float(np.degrees(turns.magnitude().max()))


@pytest.mark.parametrize("other", ["csv", "mcap"])
def test_every_format_gives_the_same_track(done: dict[str, Done], other: str) -> None:
    here, there = read_track(done["parquet"].folder), read_track(done[other].folder)
    assert np.array_equal(here["timestamp_ns"], there["timestamp_ns"])
    assert degrees_apart(quaternions(here), quaternions(there)) < 1e-6
    for name in here:
        np.testing.assert_allclose(here[name], there[name], rtol=1e-6, atol=1e-6, err_msg=name)


def test_the_folder_is_whole(done: dict[str, Done]) -> None:
    folder = done["csv"].folder
    files = {path.name for path in folder.iterdir()}
    tables = {"track.parquet", "track.csv", "track.tum", "passes.parquet", "innovations.parquet", "segments.csv"}
    assert files == tables | {"report.json", "report"}
    assert set(pq.read_schema(folder / "passes.parquet").names) == set(PASSES)
    assert set(pq.read_schema(folder / "innovations.parquet").names) == set(INNOVATIONS)
    drawn = {path.name for path in (folder / "report").iterdir()}
    report = done["csv"].report
    assert drawn == {page["file"] for page in report["pages"]} | {"report.html"}
    assert all(any(name.startswith(page) for name in drawn) for page in PAGES)
    for sensor in report["statistics"]["innovations"]:
        assert f"05-innovations-{sensor.replace('_', '-')}.png" in drawn
    assert all(page["title"] and page["alt"] for page in report["pages"])


def test_report_and_track_keep_to_their_schemas(done: dict[str, Done], root: Path) -> None:
    schemas = {
        name: json.loads((root / "schemas" / f"{name}.schema.json").read_text(encoding="utf-8"))
        for name in ("report", "track")
    }
    for each in done.values():
        jsonschema.validate(each.report, schemas["report"])
    table = pq.read_table(done["parquet"].folder / "track.parquet")
    assert set(table.column_names) <= set(schemas["track"]["properties"])
    assert set(schemas["track"]["required"]) <= set(table.column_names)
    rows = table.slice(0, 5).to_pylist() + table.slice(table.num_rows // 2, 5).to_pylist()
    for row in rows:
        jsonschema.validate(
            {k: v for k, v in row.items() if not isinstance(v, float) or np.isfinite(v)},
            {**schemas["track"], "required": []},
        )
    assert table.schema.field("timestamp_ns").type == "int64"
    assert table.schema.field("segment").type == "int32"
    assert table.schema.field("moving").type == "bool"


def test_sigma_holds_against_the_truth(done: dict[str, Done], whole: Drive) -> None:
    found = judged(done["parquet"].folder, whole)
    assert found.tilt_ratio() < 2.0
    assert found.heading_ratio() < 3.0  # one drive: its whole heading hangs on some sixty looks at the sun
    assert found.tilt.max() < 5.0 * found.sigma_tilt.max()
    assert found.sigma_tilt.max() < 0.2
    assert found.sigma_heading.max() < 0.3
    track = read_track(done["parquet"].folder)
    off = np.stack([track[f"position_{a}_m"] - whole.truth[f"position_{a}_m"] for a in "xyz"], axis=1)
    off -= off[0]
    sigma = np.stack([track[f"sigma_position_{a}_m"] for a in "xyz"], axis=1)
    assert np.sqrt(np.mean((off[100:] / sigma[100:]) ** 2)) < 2.0
    assert np.nanmax(sigma) < 3.0


def test_stops_are_those_of_the_truth(done: dict[str, Done], whole: Drive) -> None:
    text = (done["csv"].folder / "segments.csv").read_text(encoding="utf-8")
    rows = list(csv.DictReader(text.splitlines()))
    edges = whole.t[1:][np.diff(whole.moving.astype(int)) != 0]
    found = [float(row["start_s"]) for row in rows[1:]]
    assert [row["kind"] for row in rows] == ["stop", "motion"] * 4 + ["stop"]
    assert [int(row["index"]) for row in rows] == list(range(1, 10))
    np.testing.assert_allclose(found, edges, atol=1.0)
    track = read_track(done["csv"].folder)
    assert np.mean(track["moving"] == whole.moving) > 0.97


def test_words_are_the_numbers_of_the_report(done: dict[str, Done]) -> None:
    words, report = done["csv"].words, done["csv"].report
    lines = words.splitlines()
    assert lines[0].startswith(f"● {report['pages'][0]['title']}")
    assert lines[0].endswith(report["verdict"])
    assert "4 | 5" in words
    assert "12 000 samples at 50 Hz" in words.replace("\u00a0", " ")
    assert f"{len(report['pages'])} pages" in lines[-1]
    assert report["coverage"]["rows_in"] == report["coverage"]["rows_used"] == 12000


def test_settings_say_where_they_come_from(done: dict[str, Done], samples: Path) -> None:
    settings = done["csv"].report["settings"]
    assert settings["sun.sigma_deg"] == {"value": 0.5, "source": str(samples / "attest.toml")}
    assert settings["output.formats"]["source"] == "command line"
    assert settings["smoothing.smoother"] == {"value": "two-filter", "source": "default"}


def test_report_draws_the_same_bytes_from_the_folder_alone(
    done: dict[str, Done], tmp_path: Path, attest: Callable[..., Any]
) -> None:
    copy = tmp_path / "elsewhere.attest"
    shutil.copytree(done["csv"].folder, copy)
    before = {path.name: path.read_bytes() for path in (copy / "report").iterdir()}
    for path in (copy / "report").iterdir():
        path.unlink()
    (copy / "track.parquet").unlink()
    assert attest("report", copy).code == 0
    after = {path.name: path.read_bytes() for path in (copy / "report").iterdir()}
    assert after.keys() == before.keys()
    assert [name for name in after if after[name] != before[name]] == []


def test_report_takes_the_newest_folder_and_the_dark_theme(
    done: dict[str, Done], tmp_path: Path, attest: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for stamp, name in ((1_700_000_000, "z_older"), (1_700_000_100, "newest")):
        shutil.copytree(done["csv"].folder, tmp_path / f"{name}.attest")
        os.utime(tmp_path / f"{name}.attest" / "report.json", (stamp, stamp))
    light = (tmp_path / "newest.attest/report/04-sigma.png").read_bytes()
    outcome = attest("report", "--theme", "dark", "--json")
    assert outcome.code == 0
    assert "newest result here of 2: newest.attest" in outcome.err
    drawn = json.loads(outcome.out)["newest.attest"]
    assert len(drawn) == len(done["csv"].report["pages"])
    assert (tmp_path / "newest.attest/report/04-sigma.png").read_bytes() != light
    assert not [path for path in tmp_path.rglob("*") if ".tmp" in path.name]


def test_two_runs_differ_only_in_the_stamp_of_the_run(done: dict[str, Done], samples: Path, tmp_path: Path) -> None:
    assert run(["smooth", str(samples / "rover.csv"), "-o", str(tmp_path / "again"), "-q", *EVERY_FORMAT]) == 0
    first, again = done["csv"].folder, tmp_path / "again"
    names = sorted(path.relative_to(first) for path in first.rglob("*") if path.is_file())
    assert names == sorted(path.relative_to(again) for path in again.rglob("*") if path.is_file())
    unlike = [str(name) for name in names if (first / name).read_bytes() != (again / name).read_bytes()]
    assert set(unlike) <= {"report.json", "report/report.html"}  # the page: see the next test
    reports = [json.loads((folder / "report.json").read_text(encoding="utf-8")) for folder in (first, again)]
    for report in reports:
        report.pop("created_utc")
    assert reports[0] == reports[1]


def test_no_file_but_the_report_holds_the_stamp_of_the_run(done: dict[str, Done]) -> None:
    stamp = done["csv"].report["created_utc"]
    clock = stamp.partition("T")[2][:8]
    assert clock not in (done["csv"].folder / "report/report.html").read_text(encoding="utf-8")


def test_other_formats_hold_the_same_track(done: dict[str, Done]) -> None:
    folder, track = done["csv"].folder, read_track(done["csv"].folder)
    lines = (folder / "track.csv").read_text(encoding="utf-8").splitlines()
    comments = [line for line in lines if line.startswith("#")]
    assert any("ENU" in line for line in comments)
    table = list(csv.DictReader(lines[len(comments) :]))
    assert len(table) == 12000
    for k in (0, 5000, 11999):
        assert int(table[k]["timestamp_ns"]) == track["timestamp_ns"][k]
        for name in ("q_w", "yaw_deg", "sigma_att_z_deg", "position_x_m"):
            assert float(table[k][name]) == track[name][k]
    tum = [line.split() for line in (folder / "track.tum").read_text(encoding="utf-8").splitlines() if line[0] != "#"]
    assert len(tum) == 12000
    values = np.array(tum, dtype=float)
    assert degrees_apart(values[:, [7, 4, 5, 6]], quaternions(track)) < 1e-5
    np.testing.assert_allclose(values[:, 1], track["position_x_m"], atol=1e-6)
    seconds, _, digits = tum[1][0].partition(".")
    assert abs(int(seconds) * 10**9 + int(digits.ljust(9, "0")) - track["timestamp_ns"][1]) < 1000


def test_ned_is_the_same_track_in_other_axes(done: dict[str, Done], samples: Path, smooth: Callable[..., Any]) -> None:
    ned = smooth(samples / "rover.parquet", "--frame", "ned").folder
    a, b = read_track(done["parquet"].folder), read_track(ned)
    swap = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # north, east, down of east, north, up
    flip = np.diag([1.0, -1.0, -1.0])  # forward, right, down of forward, left, up
    enu, other = (Rotation.from_quat(quaternions(x), scalar_first=True).as_matrix() for x in (a, b))
    np.testing.assert_allclose(other, swap @ enu @ flip, atol=1e-9)
    np.testing.assert_allclose(
        [b[f"position_{axis}_m"] for axis in "xyz"],
        [a["position_y_m"], a["position_x_m"], -a["position_z_m"]],
        atol=1e-9,
    )
    for axis, source in (("x", "y"), ("y", "x"), ("z", "z")):
        np.testing.assert_allclose(b[f"sigma_att_{axis}_deg"], a[f"sigma_att_{source}_deg"], rtol=1e-9)
    euler = Rotation.from_matrix(other).as_euler("xyz", degrees=True)
    apart = (np.stack([b["roll_deg"], b["pitch_deg"], b["yaw_deg"]], axis=1) - euler + 180.0) % 360.0 - 180.0
    assert np.abs(apart).max() < 1e-6
    metadata = pq.read_schema(ned / "track.parquet").metadata
    assert b"NED" in metadata[b"frame"]


def test_start_and_end_cut_the_log(done: dict[str, Done], samples: Path, smooth: Callable[..., Any]) -> None:
    cut = smooth(samples / "rover.parquet", "--start", 55, "--end", 130)
    track, full = read_track(cut.folder), read_track(done["parquet"].folder)
    assert (track["t_s"][0], track["t_s"][-1]) == (55.0, 130.0)
    rows = np.searchsorted(full["timestamp_ns"], track["timestamp_ns"])
    assert np.array_equal(full["timestamp_ns"][rows], track["timestamp_ns"])
    assert degrees_apart(quaternions(track), quaternions({k: v[rows] for k, v in full.items()})) < 1.0
    assert cut.report["coverage"]["rows_in"] == len(track["t_s"])


@pytest.mark.parametrize(
    ("start", "end", "code", "says"),
    [
        (500, 600, 1, "rover.parquet: the window of --start"),
        (100, 100, 2, "not after"),
        (130, 55, 2, "not after"),
        (-20, -10, 2, "start_s"),
    ],
)
def test_an_empty_window_is_refused(
    samples: Path, attest: Callable[..., Any], tmp_path: Path, start: int, end: int, code: int, says: str
) -> None:
    outcome = attest("smooth", samples / "rover.parquet", f"--start={start}", f"--end={end}", "-o", tmp_path / "r")
    outcome.refused(says, code=code)
    assert list(tmp_path.iterdir()) == []


def test_dry_run_tells_the_plan_and_writes_nothing(
    samples: Path, attest: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = attest("smooth", samples / "rover.mcap", "--dry-run")
    assert outcome.code == 0
    assert list(tmp_path.iterdir()) == []
    for word in ("/imu/data", "/sun", "two-filter", "rover.mcap", "indirect"):
        assert word in outcome.out
    outcome = attest("smooth", samples / "rover.parquet", "--dry-run", "--json")
    assert json.loads(outcome.out)["segments"]["stops"] == 5


def test_json_stands_alone_on_stdout(samples: Path, smooth: Callable[..., Any]) -> None:
    result = smooth(samples / "rover.parquet", "--end", 60, "--json")
    assert json.loads(result.outcome.out) == result.report
    assert "PASS" in result.outcome.err


def test_gate_and_strict_end_with_3(samples: Path, smooth: Callable[..., Any]) -> None:
    passed = smooth(
        samples / "rover.parquet", "--end", 60, "--max-sigma-attitude-deg", "1", "--strict", "-q", output="a"
    )
    assert passed.outcome.err == ""
    failed = smooth(samples / "rover.parquet", "--end", 60, "--max-sigma-attitude-deg", "0.05", codes=(3,), output="b")
    assert "over the gate of 0.05°" in failed.outcome.err
    assert failed.report["verdict"] == "FAIL"
    assert failed.outcome.err.splitlines()[0].endswith("FAIL")


def test_strict_turns_a_warning_into_3(samples: Path, tmp_path: Path, smooth: Callable[..., Any]) -> None:
    config = tmp_path / "noon.toml"
    config.write_text("[world]\nsun_direction = [0.0, 0.0, 1.0]\n", encoding="utf-8")
    plain = smooth(samples / "rover.parquet", "--end", 60, "-c", config, output="plain")
    strict = smooth(samples / "rover.parquet", "--end", 60, "-c", config, "--strict", codes=(3,), output="strict")
    assert plain.codes == strict.codes == {"sun-not-used"}


def test_files_of_one_drive_make_one_log(
    done: dict[str, Done], whole: Drive, tmp_path: Path, smooth: Callable[..., Any]
) -> None:
    keep = np.isfinite(whole.columns["sun_x"])
    imu = whole.without("sun_x", "sun_y").write(tmp_path / "two", "imu.csv")
    sun = whole.rows(keep).without(*(n for n in whole.columns if n not in {"timestamp_ns", "sun_x", "sun_y"}))
    two = smooth(imu, sun.write(tmp_path / "two", "sun.parquet"), output="two-files")
    whole_track = read_track(done["parquet"].folder)
    assert degrees_apart(quaternions(read_track(two.folder)), quaternions(whole_track)) < 1e-6
    assert len(two.report["input"]["files"]) == 2


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_drive_cut_in_two_is_the_same_drive(
    done: dict[str, Done], whole: Drive, tmp_path: Path, smooth: Callable[..., Any], order: tuple[int, int]
) -> None:
    parts = [
        whole.span(0, 100).write(tmp_path, "b_first.parquet"),
        whole.span(100, 999).write(tmp_path, "a_second.csv"),
    ]
    result = smooth(*(parts[k] for k in order))
    assert degrees_apart(quaternions(read_track(result.folder)), quaternions(read_track(done["parquet"].folder))) < 1e-6
    assert result.report["coverage"] == done["parquet"].report["coverage"]
    assert not result.codes


def test_gyro_columns_of_another_imu_are_not_mixed(whole: Drive, tmp_path: Path, smooth: Callable[..., Any]) -> None:
    start = whole.span(0, 60)
    doubled = start.changed(**{f"second_{n}": start.columns[n] * 3.0 for n in (*GYRO, "accel_x", "accel_y", "accel_z")})
    result = smooth(doubled.write(tmp_path))
    assert "several-channels" in result.codes
    assert judged(result.folder, start).tilt_ratio() < 2.0


@pytest.mark.parametrize("content", ["{}", "not JSON", '{"verdict": 5}', "[]"])
@pytest.mark.parametrize("theme", [[], ["--theme", "dark"]])
def test_a_report_that_is_none_is_refused_in_one_line(
    content: str, theme: list[str], done: dict[str, Done], tmp_path: Path, attest: Callable[..., Any]
) -> None:
    broken = tmp_path / "broken.attest"
    shutil.copytree(done["csv"].folder, broken, ignore=shutil.ignore_patterns("report", "track*"))
    (broken / "report.json").write_text(content, encoding="utf-8")
    attest("report", broken, *theme).refused("report.json", "run attest smooth again")
    assert not (broken / "report").exists()


def test_a_report_with_a_word_for_a_number_is_refused_by_its_place(
    done: dict[str, Done], tmp_path: Path, attest: Callable[..., Any]
) -> None:
    broken = tmp_path / "broken.attest"
    shutil.copytree(done["csv"].folder, broken, ignore=shutil.ignore_patterns("report", "track*"))
    report = done["csv"].report
    report["coverage"]["share"] = "all"
    (broken / "report.json").write_text(json.dumps(report), encoding="utf-8")
    attest("report", broken).refused("report.json", "coverage.share", "valid number", "run attest smooth again")
