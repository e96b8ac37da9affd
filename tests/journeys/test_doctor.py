"""attest doctor on clean, odd and broken logs: clean ones are silent, every fault stands where it belongs."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from journeys.odd_logs import Drive

Rows = list[dict[str, str]]


@pytest.fixture
def checked(attest: Callable[..., Any]) -> Callable[..., tuple[int, Rows]]:
    """Run the doctor; return its exit code and its findings."""

    def command(*arguments: object) -> tuple[int, Rows]:
        outcome = attest("doctor", *arguments, "--json")
        assert "Traceback" not in outcome.err
        assert "defect" not in outcome.err
        return outcome.code, json.loads(outcome.out)

    return command


def spoken(rows: Rows) -> set[tuple[str, str, str]]:
    return {(row["group"], row["check"], row["verdict"]) for row in rows if row["verdict"] != "ok"}


@pytest.mark.parametrize("suffix", ["csv", "mcap", "parquet"])
def test_a_clean_log_has_no_warning_and_says_what_was_checked(
    suffix: str, samples: Path, checked: Callable[..., tuple[int, Rows]]
) -> None:
    code, rows = checked(samples / f"rover.{suffix}", "--strict")
    assert code == 0
    assert spoken(rows) == set()
    made = {(row["group"], row["check"]) for row in rows}
    assert {("file", "whole"), ("stamps", "gaps"), ("values", "spikes"), ("units", "gravity"), ("units", "gyro"),
            ("mounting", "axes"), ("sun", "reference"), ("sun", "noise"), ("compass", "noise"), ("stops", "found"),
            ("verdict", "sigma")} <= made  # fmt: skip
    assert any("logged" in row["found"] for row in rows) == (suffix == "mcap")


def test_the_table_has_a_row_a_check_and_one_for_what_mends_it(
    whole: Drive, tmp_path: Path, attest: Callable[..., Any]
) -> None:
    drive = whole.span(0, 60)
    log = drive.rows((drive.t < 14) | (drive.t > 16)).write(tmp_path, "log.csv")
    outcome = attest("doctor", log)
    assert outcome.code == 0
    lines = outcome.out.splitlines()
    at = next(k for k, line in enumerate(lines) if line.split()[:3] == ["stamps", "gaps", "warning"])
    assert "2.04 s from 13.98 s" in lines[at]
    assert lines[at + 1].split()[0] == "mends"
    assert "warning" in outcome.err
    assert attest("doctor", log, "--strict").code == 3
    assert list(tmp_path.glob("*.attest")) == []


def test_a_wrong_reference_is_named_with_its_setting(
    whole: Drive, tmp_path: Path, checked: Callable[..., tuple[int, Rows]]
) -> None:
    leaning = whole.changed(sun_x=whole.columns["sun_x"] + 0.2).span(0, 60)
    code, rows = checked(leaning.write(tmp_path))
    assert code in {0, 3}
    row = next(row for row in rows if (row["group"], row["check"]) == ("sun", "reference"))
    assert row["verdict"] == "warning"
    assert "sun_direction" in row["mends"]


def test_what_refuses_is_a_row_and_the_rest_is_checked(
    whole: Drive, tmp_path: Path, checked: Callable[..., tuple[int, Rows]]
) -> None:
    stamps = whole.columns["timestamp_ns"].copy()
    stamps[700:] -= 5_000_000_000
    back = whole.changed(timestamp_ns=stamps).span(0, 60).write(tmp_path)
    code, rows = checked(back)
    assert code == 1
    assert [row["verdict"] for row in rows if row["check"] == "refused"] == ["fault"]
    assert any("1 steps back" in row["found"] for row in rows if row["group"] == "stamps")
    none = tmp_path / "none.mcap"
    none.write_bytes(b"\x89MCAP0\r\n")
    code, rows = checked(none)
    assert (code, rows[0]["group"], rows[0]["check"]) == (1, "file", "refused")


def test_one_bad_file_of_a_drive_leaves_the_others_checked(
    whole: Drive, tmp_path: Path, checked: Callable[..., tuple[int, Rows]]
) -> None:
    good, bad = whole.span(0, 60).write(tmp_path), tmp_path / "bad.csv"
    bad.write_text("no log\n")
    code, rows = checked(good, bad)
    assert code == 1
    assert any(row["check"] == "sigma" for row in rows)
    assert any("bad.csv" in row["found"] for row in rows if row["check"] == "refused")


def test_rows_that_are_not_finite_and_equal_stamps_are_counted(
    whole: Drive, tmp_path: Path, checked: Callable[..., tuple[int, Rows]]
) -> None:
    gyro, stamps = whole.columns["gyro_y"].copy(), whole.columns["timestamp_ns"].copy()
    gyro[200:900:100] = np.nan
    stamps[351] = stamps[350]
    code, rows = checked(whole.changed(gyro_y=gyro, timestamp_ns=stamps).span(0, 60).write(tmp_path))
    assert code == 0
    assert {("values", "finite", "warning"), ("stamps", "order", "warning")} <= spoken(rows)


def damaged(samples: Path, folder: Path) -> Path:
    """The shipped MCAP log with one chunk in its middle that is not what its checksum says."""
    from mcap.reader import make_reader

    data = bytearray((samples / "rover.mcap").read_bytes())
    with (samples / "rover.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    data[summary.chunk_indexes[len(summary.chunk_indexes) // 2].chunk_start_offset + 500] ^= 8
    (folder / "attest.toml").write_bytes((samples / "attest.toml").read_bytes())
    log = folder / "damaged.mcap"
    log.write_bytes(data)
    return log


def test_a_lost_chunk_is_a_fault_and_the_rest_is_smoothed(
    samples: Path, tmp_path: Path, checked: Callable[..., tuple[int, Rows]], smooth: Callable[..., Any]
) -> None:
    log = damaged(samples, tmp_path)
    code, rows = checked(log)
    assert code == 3
    (row,) = [row for row in rows if row["check"] == "whole"]
    assert row["verdict"] == "fault"
    assert "a chunk that does not unpack" in row["found"] or "a chunk with a wrong checksum" in row["found"]
    assert "of 12000 messages of /imu/data" in row["found"]
    assert ("stamps", "gaps", "warning") in spoken(rows)
    result = smooth(log, codes=(3,))
    assert {"damaged-mcap", "imu-gap"} <= result.codes
    assert 0.5 < result.report["coverage"]["share"] < 1.0
