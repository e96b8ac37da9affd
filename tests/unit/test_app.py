"""The command line: exit codes, one plain line for every fault, what stands on stdout and what on stderr."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from mcap.writer import Writer

import attest_cli
from attest_cli.__main__ import run
from attest_cli.commands.console import Console, plain
from attest_cli.errors import AttestError
from attest_cli.figures.words import number
from attest_cli.report import Report

ROOT = Path(__file__).resolve().parents[2]
HEAVY = {"numpy", "pandas", "scipy", "pyarrow", "matplotlib", "mcap"}


def attest(*arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "attest_cli", *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False, **options)


def finding(**changes: Any) -> dict[str, Any]:
    """A small report.json that the model accepts."""
    facts: dict[str, Any] = {
        "attest_version": "0.1.0",
        "created_utc": "2026-11-21T14:03:12Z",
        "verdict": "PASS",
        "input": {
            "files": [],
            "start_utc": None,
            "duration_s": 1284.0,
            "samples": 128400,
            "rate_hz": 100.0,
            "sensors": ["sun sensor", "accelerometer at stops"],
        },
        "channels": [],
        "coverage": {
            "rows_in": 128400,
            "rows_used": 128398,
            "rows_dropped": 2,
            "seconds_in": 1284.0,
            "seconds_used": 1284.0,
            "share": 1.0,
        },
        "settings": {"smoothing.smoother": {"value": "rts", "source": "command line"}},
        "methods": {"filter": "indirect", "smoother": "rts", "iterations": 2, "position": "odometry"},
        "heading": "absolute",
        "body": {"axes": "imu", "q_body_sensor": [1, 0, 0, 0], "how": "the IMU's own"},
        "statistics": {
            "sigma_heading_median_deg": 0.187,
            "sigma_heading_max_deg": 0.42,
            "sigma_tilt_median_deg": 0.15,
            "sigma_tilt_max_deg": 0.31,
            "motions": 6,
            "stops": 7,
        },
        "pages": [{"file": "01-overview.png", "title": "Heading known to 0.19°, tilt to 0.15°", "alt": "…"}],
    }
    return Report.model_validate({**facts, **changes}).model_dump(mode="json")


@pytest.fixture
def pipeline(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Put a stand-in for the pipeline in its place: the commands are tested here, not the run."""

    def install(**functions: Any) -> None:
        monkeypatch.setattr(attest_cli, "pipeline", SimpleNamespace(**functions), raising=False)

    return install


def smoothing(report: dict[str, Any]) -> Callable[..., dict[str, Any]]:
    def smooth(*_args: Any, progress: Callable[[str, float], None], **_options: Any) -> dict[str, Any]:
        progress("forward", 0.5)
        return report

    return smooth


def raising(fault: BaseException) -> Callable[..., Any]:
    def smooth(*_args: Any, **_options: Any) -> Any:
        raise fault

    return smooth


def test_help_and_version_load_nothing_heavy() -> None:
    code = (
        "import sys\n"
        "from attest_cli.__main__ import run\n"
        "code = max(run(words) for words in (['--help'], ['smooth', '--help'], ['--version']))\n"
        f"print(code, sorted({HEAVY!r} & set(sys.modules)), file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert done.stderr.strip() == "0 []"
    assert "attest" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["frob"], "No such command 'frob'"),
        (["smooth"], "Missing argument 'LOG'"),
        (["smooth", "x.csv", "--smother", "rts"], "--smoother"),
        (["smooth", "x.csv", "--smoother", "rst"], "'two-filter', 'rts', 'paper', 'none'"),
        (["smooth", "x.csv", "--map", "sun"], "ROLE=CHANNEL"),
        (["smooth", "x.csv", "--start", "soon"], "--start"),
        (["smooth", "x.csv", "--columns", "t,,gx"], "empty name"),
        (["info", "x.csv", "--columns", "t,a=gx"], "mixes names"),
        (["simulate", "boat"], "rover"),
        (["smooth", "x.csv", "-o", ""], "'--output' / '-o': the name is empty"),
        (["segment", "x.csv", "-o", " "], "'--output' / '-o': the name is empty"),
        (["simulate", "rover", "-o", ""], "'--output' / '-o': the name is empty"),
    ],
)
def test_usage_is_one_line_and_exit_2(arguments: Sequence[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert says in err
    assert "--help" in err


@pytest.mark.parametrize(
    ("fault", "says"),
    [
        (
            AttestError("x.csv: no column gyro_x", "name it with --map"),
            "attest: x.csv: no column gyro_x; name it with --map\n",
        ),
        (AttestError("a\nb\x1b]0;evil\x07 [/imu] \u202e"), "attest: a\\nb\\x1b]0;evil\\x07 [/imu] \\u202e\n"),
        (
            PermissionError(13, "Permission denied", "out/track.parquet"),
            "attest: out/track.parquet: Permission denied\n",
        ),
        (MemoryError(), "attest: not enough memory; read a part of the log with --start and --end\n"),
        (ValueError("odd"), "attest: defect in attest: ValueError: odd; run it again with -v for the traceback\n"),
    ],
)
def test_a_fault_is_one_plain_line_and_exit_1(
    fault: Exception, says: str, pipeline: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    pipeline(smooth=raising(fault))
    assert run(["smooth", "x.csv"]) == 1
    assert capsys.readouterr() == ("", says)


@pytest.mark.parametrize("command", ["smooth", "info", "segment"])
def test_the_same_log_twice_is_refused(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, link = table_log(tmp_path / "log.csv"), tmp_path / "link.csv"
    link.symlink_to(log)
    assert run([command, str(log), str(link)]) == 1
    assert capsys.readouterr() == ("", f"attest: {link}: the same file as {log}; name each log once\n")


def test_verbose_shows_the_traceback_of_a_defect(
    pipeline: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    pipeline(smooth=raising(ValueError("odd\x1b]0;")))
    assert run(["smooth", "x.csv", "-v"]) == 1
    err = capsys.readouterr().err
    assert "Traceback (most recent call last):\n" in err
    assert "\x1b" not in err
    assert err.endswith("please report it with the traceback above\n")


def test_words_go_to_stderr_and_the_finding_comes_first(
    pipeline: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    warning = {"code": "gap", "message": "gap of 2 s at 5:30", "hint": "sigma grows there", "lost": False}
    pipeline(smooth=smoothing(finding(verdict="WARN", warnings=[warning])))
    assert run(["smooth", "drive.csv"]) == 0
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("▲ Heading known to 0.19°, tilt to 0.15°  WARN\n")
    assert "▲ gap of 2 s at 5:30\n  sigma grows there\n" in err
    assert "0.19°" in err
    assert "at most 0.42°" in err
    assert err.rstrip().splitlines()[-1].startswith("→ drive.attest/")


def test_a_check_that_fails_is_told_once(pipeline: Callable[..., None], capsys: pytest.CaptureFixture[str]) -> None:
    checks = [
        {"name": "white", "status": "WARN", "fact": "Innovations are not white", "detail": "mean NIS 9"},
        {"name": "gap", "status": "WARN", "fact": "gap of 2 s", "detail": "at 5:30"},
        {"name": "agree", "status": "PASS", "fact": "Passes agree", "detail": ""},
    ]
    warning = {"code": "gap", "message": "gap of 2 s"}
    pipeline(smooth=smoothing(finding(verdict="WARN", checks=checks, warnings=[warning])))
    assert run(["smooth", "drive.csv"]) == 0
    err = capsys.readouterr().err
    assert "▲ Innovations are not white\n  mean NIS 9\n" in err
    assert err.count("gap of 2 s") == 1
    assert "Passes agree" not in err


def test_json_on_stdout_is_the_report(pipeline: Callable[..., None], capsys: pytest.CaptureFixture[str]) -> None:
    report = finding()
    pipeline(smooth=smoothing(report))
    assert run(["smooth", "drive.csv", "--json", "-q"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out) == report
    assert err == ""


@pytest.mark.parametrize(("verdict", "code", "strict"), [("PASS", 0, 0), ("WARN", 0, 3), ("FAIL", 3, 3)])
def test_a_failed_verdict_ends_with_3_and_a_doubt_does_with_strict(
    verdict: str, code: int, strict: int, pipeline: Callable[..., None]
) -> None:
    check = {"name": "sun", "status": verdict, "fact": "Sun measurements rejected", "detail": "60 of 61"}
    pipeline(smooth=smoothing(finding(verdict=verdict, checks=[check])))
    assert run(["smooth", "drive.csv"]) == code
    assert run(["smooth", "drive.csv", "--strict"]) == strict


@pytest.mark.parametrize(
    ("warnings", "arguments", "code"),
    [
        ([], [], 0),
        ([], ["--strict"], 0),
        ([], ["--max-sigma-attitude-deg", "0.42"], 0),
        ([], ["--max-sigma-attitude-deg", "0.41"], 3),
        ([{"code": "nan", "message": "3 rows repaired"}], [], 0),
        ([{"code": "nan", "message": "3 rows repaired"}], ["--strict"], 3),
        ([{"code": "cut", "message": "file ends early", "lost": True}], [], 3),
    ],
)
def test_exit_3_means_lost_data_or_a_failed_gate(
    warnings: list[dict[str, Any]],
    arguments: Sequence[str],
    code: int,
    pipeline: Callable[..., None],
    capsys: pytest.CaptureFixture[str],
) -> None:
    pipeline(smooth=smoothing(finding(warnings=warnings)))
    assert run(["smooth", "drive.csv", *arguments]) == code
    for warning in warnings:
        assert warning["message"] in capsys.readouterr().err


def test_an_unknown_sigma_does_not_pass_the_gate(
    pipeline: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    pipeline(smooth=smoothing(finding(statistics={"motions": 1, "stops": 0, "sigma_tilt_max_deg": 0.1})))
    assert run(["smooth", "drive.csv", "--max-sigma-attitude-deg", "5"]) == 3
    assert "attitude σ is unknown, over the gate of 5°" in capsys.readouterr().err


def test_options_reach_the_settings(pipeline: Callable[..., None]) -> None:
    seen: dict[str, Any] = {}

    def smooth(paths: Any, effective: Any, output: Path, *, overwrite: bool, progress: Any) -> dict[str, Any]:
        seen.update(paths=paths, effective=effective, output=output, overwrite=overwrite, progress=progress)
        return finding()

    pipeline(smooth=smooth)
    arguments = [
        *("smooth", "a.mcap", "b.mcap", "-o", "out", "--overwrite", "-q", "--smoother", "rts", "--absolute", "stops"),
        *("--iterations", "3", "--position", "literal", "--map", "sun=/sun=1", "--map", "gyro=/g", "--imu", "/imu"),
        *("--time", "log", "--frame", "ned", "--body", "imu", "--start", "5", "--end", "60", "--format", "csv,tum"),
        *("--stop-threshold-deg", "1", "--filter", "indirect", "--theme", "dark", "--stops", "s.csv"),
        *("--columns", "clock=t [ms],IMU::Gyro::X=gyro_x", "--columns", "a: type, t, accel_x", "--columns", "t, - ,gx"),
        *("--time-unit", "us", "--sample-rate", "128"),
    ]
    assert run(arguments) == 0
    settings = seen["effective"].settings
    assert seen["paths"] == [Path("a.mcap"), Path("b.mcap")]
    assert (seen["output"], seen["overwrite"]) == (Path("out"), True)
    assert settings.map == {"sun": "/sun=1", "gyro": "/g", "imu": "/imu"}
    assert (settings.smoothing.filter, settings.smoothing.smoother, settings.smoothing.absolute) == (
        "indirect",
        "rts",
        "stops",
    )
    assert (settings.smoothing.iterations, settings.smoothing.position) == (3, "literal")
    assert (settings.time.source, settings.time.start_s, settings.time.end_s) == ("log", 5.0, 60.0)
    assert (settings.world.frame, settings.body.axes, settings.stops.file) == ("ned", "imu", Path("s.csv"))
    assert (settings.output.formats, settings.output.theme) == (("csv", "tum"), "dark")
    assert settings.smoothing.stop_threshold_deg == 1.0
    assert settings.table.names == {"clock": "t [ms]", "IMU::Gyro::X": "gyro_x"}
    assert settings.table.rows == {"a": ("type", "t", "accel_x")}
    assert (settings.table.columns, settings.table.time_unit) == (("t", "-", "gx"), "us")
    assert settings.table.sample_rate_hz == 128.0
    assert set(seen["effective"].sources.values()) == {"command line"}


def test_report_takes_the_newest_result_here_and_says_so(
    pipeline: Callable[..., None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for age, name in ((300, "old"), (100, "new"), (200, "middle")):
        (tmp_path / f"{name}.attest").mkdir()
        (tmp_path / f"{name}.attest" / "report.json").write_text("{}", encoding="utf-8")
        os.utime(tmp_path / f"{name}.attest" / "report.json", (1e9 - age, 1e9 - age))
    (tmp_path / "unfinished.attest").mkdir()
    monkeypatch.chdir(tmp_path)
    pipeline(redraw=lambda folder, theme, _: [folder / f"{theme}.png"])
    assert run(["report", "--theme", "dark", "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out) == {"new.attest": [str(Path("new.attest/dark.png"))]}
    assert err.startswith("newest result here of 3: new.attest\n")


def test_report_without_a_result_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(["report"]) == 1
    assert "no result folder here" in capsys.readouterr().err


def test_segment_prints_an_aligned_table(
    pipeline: Callable[..., None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def segments(_paths: Any, _effective: Any, output: Path, _overwrite: bool) -> dict[str, Any]:
        output.write_bytes(b"picture")
        return {"segments": rows, "warnings": [], "detector": {}}

    monkeypatch.chdir(tmp_path)
    rows = [
        {"index": 1, "kind": "stop", "start_s": 0.0, "end_s": 12.34, "duration_s": 12.34},
        {"index": 2, "kind": "motion", "start_s": 12.34, "end_s": 135.0, "duration_s": 122.66},
    ]
    pipeline(segments=segments)
    assert run(["segment", "drive.csv"]) == 0
    out, err = capsys.readouterr()
    assert out.splitlines() == [
        "index  kind     start     end   duration",
        "    1  stop    0:00.0  0:12.3       12 s",
        "    2  motion  0:12.3  2:15.0  2 min 3 s",
    ]
    assert err == "One stop, one motion\n→ drive.stops.png\n"


def table_log(path: Path, *, columns: str = "t,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z,odd\x1b]0;") -> Path:
    rows = [f"{0.01 * k:.2f},0.001,{0.0001 * (k % 3)},0,0.01,{0.01 * (k % 2)},9.81,1" for k in range(1000)]
    path.write_text("\n".join([columns, *rows, ""]), encoding="utf-8")
    return path


def test_info_shows_what_would_be_used_as_what(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = table_log(tmp_path / "log.csv")
    assert run(["info", str(log)]) == 0
    out, err = capsys.readouterr()
    row = next(line for line in out.splitlines() if line.startswith("imu"))
    assert re.split(r"  +", row) == [
        "imu",
        "columns",
        number(1000),
        "100 Hz",
        "0:00.0",
        "0:10.0",
        "0",
        "m/s^2, rad/s",
        "imu",
    ]
    assert "not read: odd\\x1b]0;" in err
    assert run(["info", str(log), "--json"]) == 0
    (channel, other) = json.loads(capsys.readouterr().out)["channels"]
    assert (channel["rows"], channel["used_as"], other["used_as"]) == (1000, "imu", "not read")


def test_info_shows_a_log_before_it_refuses_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = table_log(tmp_path / "log.csv", columns="t,mag_x,mag_y,mag_z,a,b,c,d")
    assert run(["info", str(log)]) == 1
    out, err = capsys.readouterr()
    assert "magnetometer" in out
    assert "no IMU" in err.splitlines()[-1]


def test_info_shows_the_channels_of_a_log_of_which_none_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "tank.mcap"
    with log.open("wb") as stream:
        out = Writer(stream)
        out.start()
        kind = out.register_schema("Level", "jsonschema", b"{}")
        out.add_message(out.register_channel("/level", "json", kind), 1, b"{}", 1)
        out.finish()
    assert run(["info", str(log)]) == 1
    table, words = capsys.readouterr()
    assert re.split(r"  +", table.splitlines()[1]) == ["/level", "Level (json)", "not read"]
    assert words.splitlines()[-1].startswith(f"attest: {log}: no channel that attest reads; found /level Level (json)")
    assert run(["info", str(log), "--json"]) == 1
    assert [channel["name"] for channel in json.loads(capsys.readouterr().out)["channels"]] == ["/level"]


def test_simulate_names_what_it_wrote(pipeline: Callable[..., None], capsys: pytest.CaptureFixture[str]) -> None:
    seen: dict[str, Any] = {}

    def simulate(scenario: str, output: Path, options: dict[str, Any], overwrite: bool) -> list[Path]:
        seen.update(scenario=scenario, output=output, options=options, overwrite=overwrite)
        return [output.with_suffix(".csv")]

    pipeline(simulate=simulate)
    assert run(["simulate", "rover", "--seed", "7", "--duration", "60", "--rate", "50"]) == 0
    assert (seen["scenario"], seen["output"], seen["overwrite"]) == ("rover", Path("rover"), False)
    assert (seen["options"]["seed"], seen["options"]["duration_s"], seen["options"]["rate_hz"]) == (7, 60.0, 50.0)
    assert capsys.readouterr().err == "→ rover.csv\n"


def test_progress_as_json_lines(pipeline: Callable[..., None], capsys: pytest.CaptureFixture[str]) -> None:
    pipeline(smooth=smoothing(finding()))
    assert run(["smooth", "drive.csv", "--progress", "json"]) == 0
    assert json.loads(capsys.readouterr().err.splitlines()[0]) == {"stage": "forward", "share": 0.5}


@pytest.mark.parametrize(
    ("text", "safe"),
    [
        ("/imu/data σ ° 中", "/imu/data σ ° 中"),
        ("\x1b]0;title\x07", "\\x1b]0;title\\x07"),
        ("a\r\nb\tc", "a\\r\\nb\\tc"),
        ("\u202eevil\u2066", "\\u202eevil\\u2066"),
        ("\ud800", "\\ud800"),
        ("128\u202f400", "128\u202f400"),
    ],
)
def test_nothing_unprintable_is_printed(text: str, safe: str) -> None:
    assert plain(text) == safe


def test_markup_and_control_characters_are_printed_as_typed(capsys: pytest.CaptureFixture[str]) -> None:
    console = Console()
    console.say("topic [/imu] :smile: ", ("[bold]\x1b[31m", "WARN"))
    console.table([("name", "n"), ("[red]\x07", "12")], right="lr")
    out, err = capsys.readouterr()
    assert err == "topic [/imu] :smile: [bold]\\x1b[31m\n"
    assert out == "name        n\n[red]\\x07  12\n"


def test_a_reader_that_leaves_is_no_fault() -> None:
    command = f"'{sys.executable}' -m attest_cli smooth --help | head -1; echo ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, cwd=ROOT, check=True)
    assert done.stderr == ""
    assert done.stdout.split()[-1] in {"0", "1"}


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
@pytest.mark.parametrize("arguments", [["--version"], ["--help"], ["info", "LOG", "--json"], ["info", "LOG"]])
def test_a_full_disk_behind_stdout_is_one_line(arguments: Sequence[str], tmp_path: Path) -> None:
    log = table_log(tmp_path / "log.csv")
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        done = subprocess.run(
            [sys.executable, "-m", "attest_cli", *(str(log) if a == "LOG" else a for a in arguments)],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            check=False,
        )
    assert done.returncode == 1
    words = done.stderr.splitlines()
    assert len(words) == (4 if "info" in arguments and "--json" not in arguments else 1)
    assert words[-1].startswith("attest: standard output")
    assert "No space left" in words[-1]


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_it_with_its_own_code(number: signal.Signals, code: int) -> None:
    script = (
        "import time, types, attest_cli, sys\n"
        "def smooth(*a, **k):\n"
        "    try:\n"
        "        print('ready', flush=True); time.sleep(60)\n"
        "    except Exception:\n"
        "        pass\n"
        "    finally:\n"
        "        print('cleared', flush=True)\n"
        "attest_cli.pipeline = types.SimpleNamespace(smooth=smooth)\n"
        "sys.argv = ['attest', 'smooth', 'x.csv']\n"
        "from attest_cli.__main__ import main\n"
        "main()\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    process.send_signal(number)
    out, err = process.communicate(timeout=30)
    assert (process.returncode, out, err) == (code, "cleared\n", "attest: stopped\n")


def test_a_terminal_without_unicode_sees_codes_and_no_traceback() -> None:
    done = attest("smooth", "σ.csv", "-c", "σ.toml", env={**os.environ, "PYTHONIOENCODING": "ascii", "LC_ALL": "C"})
    assert done.returncode == 1
    assert done.stderr == "attest: \\u03c3.toml: no such file\n"


def test_help_is_fast() -> None:
    start = time.process_time(), os.times().children_user
    attest("--help")
    assert os.times().children_user - start[1] < 3.0  # about 0.4 s; numpy and pandas alone would pass it
