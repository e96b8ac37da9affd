"""attest doctor: every warning of a run in its place, a number where nothing was found, and the exit code of both."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from attest_cli import diagnose
from attest_cli.diagnose import FAULT, GROUPS, OK, SENSORS, WARNING, Finding
from attest_cli.records import Channel
from attest_cli.settings import Settings


def codes(root: Path) -> set[str]:
    """Every code of a warning that stands in the source as a plain text."""
    text = "".join(path.read_text(encoding="utf-8") for path in (root / "attest_cli").rglob("*.py"))
    return set(re.findall(r'Warn\(\s*"([a-z][a-z_-]+)"', text))


def test_every_code_of_a_warning_has_a_group(root: Path) -> None:
    places = {code: diagnose._place(code) for code in codes(root)}
    assert len(places) > 40
    assert all(group in GROUPS for group, _ in places.values())
    assert places["imu-gap"] == ("stamps", "gaps")
    assert places["no-sun-reference"] == ("sun", "reference")
    assert places["odometry-contradicts"][0] == "odometry"
    unplaced = [code for code, (group, check) in places.items() if group == "verdict" and check == code]
    assert len(unplaced) < 0.25 * len(places), unplaced


@pytest.mark.parametrize(("code", "place"), [
    ("innovations-sun", ("sun", "noise")), ("rejected-compass", ("compass", "outliers")),
    ("innovations-zero_rate", ("stops", "stillness")), ("separation", ("units", "gyro")),
    ("position", ("verdict", "estimate")), ("gyro-clipped", ("values", "range")), ("data", ("stamps", "rate")),
    ("cut-mcap", ("file", "whole")), ("never-heard-of", ("verdict", "never-heard-of")),
])  # fmt: skip
def test_checks_and_codes_stand_in_their_group(code: str, place: tuple[str, str]) -> None:
    assert diagnose._place(code) == place


def test_a_number_gives_way_to_what_speaks_against_it() -> None:
    told = [Finding("stamps", "gaps", WARNING, "a gap"), Finding("file", "whole", FAULT, "cut")]
    measured = [Finding("stamps", "gaps", OK, "none"), Finding("values", "spikes", OK, "none")]
    found = diagnose._in_order([*told, told[0]], measured)
    assert [(f.group, f.verdict) for f in found] == [("file", FAULT), ("stamps", WARNING), ("values", OK)]


def test_stamps_are_told_with_rate_order_gaps_and_the_time_of_logging() -> None:
    stamps = np.arange(100, dtype=np.int64) * 10_000_000
    stamps[50:] += 2_000_000_000
    stamps[[20, 21]] = stamps[[21, 20]]
    stamps[31] = stamps[30]
    channel = Channel("/imu", "k", "imu", stamps, {})
    text = diagnose._stamps(channel, stamps + 7_000_000, Settings())
    assert text.startswith("100 rows, 100 Hz, 1 repeats, 1 steps back, 1 gaps, longest step 2.01 s")
    assert "logged 0.007 s (0.007 to 0.007) after its stamp" in text
    assert "logged" not in diagnose._stamps(channel, None, Settings())


def test_the_angle_between_rows_is_their_median() -> None:
    a = np.eye(3)[[0, 0, 0]]
    b = np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    assert diagnose._angle(a, b) == pytest.approx(45.0)


def test_no_sensor_is_without_a_group() -> None:
    assert set(SENSORS) < set(GROUPS)
