"""Stamps come through exactly, and a unit of time is told only where one fits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from attest_cli.errors import AttestError
from attest_cli.readers import stamps

LOG = Path("log.csv")


@pytest.mark.parametrize(
    ("text", "unit", "expected"),
    [
        ("1700000000.123456789", "s", 1_700_000_000_123_456_789),
        ("1403715273262142976", "ns", 1_403_715_273_262_142_976),
        ("1.40363657975856E+018", "ns", 1_403_636_579_758_560_000),
        ("1550879504438281", "us", 1_550_879_504_438_281_000),
        ("0.0100789071239999", "s", 10_078_907),  # digits below 1 ns are cut
        (" 12.5", "ms", 12_500_000),
        ("-0.25", "s", -250_000_000),
    ],
)
def test_text_is_read_to_the_nanosecond(text: str, unit: str, expected: int) -> None:
    stamps_ns, valid = stamps.from_text(pa.chunked_array([[text, "1"]]), unit, LOG)
    assert stamps_ns[0] == expected
    assert valid.tolist() == [1.0, 1.0]


def test_text_that_is_no_number_is_not_a_stamp() -> None:
    stamps_ns, valid = stamps.from_text(pa.chunked_array([["0.5", "Step: 0.005", None]]), "s", LOG)
    assert stamps_ns.tolist() == [500_000_000, 0, 0]
    assert np.isnan(valid).tolist() == [False, True, True]


def test_stamps_beyond_64_bits_are_refused() -> None:
    with pytest.raises(AttestError, match="year 2116"):
        stamps.from_text(pa.chunked_array([["1403715273262142976"]]), "s", LOG)


def test_chunks_and_slices_keep_their_rows() -> None:
    column = pa.chunked_array([["9", "1"], ["2", "3"]]).slice(1)
    assert stamps.from_text(column, "ns", LOG)[0].tolist() == [1, 2, 3]


def test_integers_are_scaled_exactly_and_floats_to_their_resolution() -> None:
    assert stamps.from_numbers(np.array([1_550_879_504_438_281]), "us")[0][0] == 1_550_879_504_438_281_000
    stamps_ns, valid = stamps.from_numbers(np.array([1.5, np.nan]), "s")
    assert stamps_ns[0] == 1_500_000_000
    assert np.isnan(valid[1])


@pytest.mark.parametrize(
    ("raw", "unit"),
    [
        (np.arange(100) * 0.01, "s"),
        (1.7e9 + np.arange(100) * 0.01, "s"),
        (np.arange(100) * 10.0, "ms"),
        (1.7e12 + np.arange(100) * 1.0, "ms"),  # 1 kHz since 1970: the step alone would fit seconds too
        (1.55e15 + np.arange(100) * 7812.0, "us"),
        (1.4e18 + np.arange(100) * 5e6, "ns"),
        (np.full(100, 1.7e9), "s"),  # no resolution at all: refused later, for that reason
        (np.repeat(1.7e9 + 128.0 * np.arange(10), 10), "s"),  # float32 since 1970
    ],
)
def test_the_unit_of_an_imu_is_told_by_step_and_date(raw: np.ndarray, unit: str) -> None:
    found, told = stamps.guess_unit(raw, imu=True, path=LOG)
    assert found == unit
    assert [w.code for w in told] == ([] if unit == "s" else ["time-unit-guessed"])


@pytest.mark.parametrize("step", [1.0, 500.0, 1e-6, 3e11])
def test_a_step_that_fits_no_or_several_units_is_refused(step: float) -> None:
    with pytest.raises(AttestError, match="unit of time"):
        stamps.guess_unit(np.arange(100) * step, imu=True, path=LOG)


def test_a_slow_sensor_without_a_date_is_in_seconds() -> None:
    assert stamps.guess_unit(np.arange(20) * 5.0, imu=False, path=LOG)[0] == "s"
    assert stamps.guess_unit(1.4e18 + np.arange(20) * 5e9, imu=False, path=LOG)[0] == "ns"


@pytest.mark.parametrize("values", [
    np.array([1, 2**62, -(2**62), 2**63 - 1, -(2**63)]), np.array([1, 2**62, 2**63, 2**64 - 1], np.uint64),
    np.array([1.0, 4.7e18, -9e18, 1e300, np.inf, -np.inf, np.nan]),
])  # fmt: skip
def test_numbers_that_no_clock_counts_are_no_stamps(values: np.ndarray) -> None:
    stamps_ns, valid = stamps.from_numbers(values, "ns")
    assert stamps_ns[0] == 1
    assert np.isnan(valid).tolist() == [False] + [True] * (len(values) - 1)
    seconds, known = stamps.from_numbers(np.array([10**10, 4 * 10**9]), "s")
    assert np.isnan(known).tolist() == [True, False]
    assert seconds[1] == 4 * 10**18


def test_dates_beyond_the_range_are_no_stamps() -> None:
    column = pa.chunked_array([pa.array([2**40, 1_780_308_000, None], pa.timestamp("s"))])
    stamps_ns, valid = stamps.from_dates(column)
    assert stamps_ns[1] == 1_780_308_000 * 10**9
    assert np.isnan(valid).tolist() == [True, False, True]


@pytest.mark.parametrize("text", ["+", "-", ".", "", "e5", "1e", " "])
def test_signs_alone_are_no_number(text: str) -> None:
    _, valid = stamps.from_text(pa.chunked_array([["1.5", text]]), "s", LOG)
    assert np.isnan(valid).tolist() == [False, True]


@pytest.mark.parametrize(("origin", "since"), [("1899-12-30", 25_569), ("0000-01-01", 719_529)])
def test_days_of_a_spreadsheet_are_told_by_their_steps(origin: str, since: int) -> None:
    expected = np.datetime64("2026-06-01T10:00:00", "ns").astype(np.int64) + np.arange(200) * 10_000_000
    first = np.datetime64(origin, "D") - (origin[0] == "0")  # Matlab counts from 1
    assert first + since == np.datetime64("1970-01-01")
    raw = expected * 1e-9 / 86_400 + since
    found = stamps.in_days(raw, "", imu=True, path=LOG)
    assert found is not None
    factor, back, told = found
    assert (factor, back) == (1.0, since)
    assert "2026-06-01 at 10:00:00" in told[0].message
    stamps_ns, _ = stamps.from_days(raw, back)
    assert np.abs(stamps_ns - expected).max() < 15_000  # the digits of a double


@pytest.mark.parametrize(
    ("origin", "step", "fits"),
    [
        (0.0, 0.01 / 3600, "min and h and d"),  # hours at 100 Hz would be days at 4 Hz
        (0.0, 0.01 / 86_400, "h and d"),
        (30_000.0, 0.01 / 3600, "min and h and d"),  # a date, but the steps are those of hours too
        (12.0, 1e-5, "min and h and d"),
    ],
)
def test_days_without_a_date_are_not_guessed(origin: float, step: float, fits: str) -> None:
    with pytest.raises(AttestError, match=f"unit of time.*fits {fits}"):
        stamps.in_days(origin + np.arange(500) * step, "", imu=True, path=LOG)


def test_days_that_are_stated_need_no_date() -> None:
    assert stamps.in_days(np.arange(500) * 1e-5, "d", imu=True, path=LOG) == (1.0, 0, ())
    found = stamps.in_days(46174.4 + np.arange(500) * 1e-5, "d", imu=True, path=LOG)
    assert found is not None
    assert found[1] == 25_569
    assert stamps.taken_unit(found[2]) is None  # it was stated


def test_a_clock_in_one_number_is_told_from_seconds() -> None:
    seconds = np.arange(36_000.0, 36_200.0, 0.5)
    clock = seconds // 3600 * 10_000 + seconds % 3600 // 60 * 100 + seconds % 60
    for imu in (True, False):
        with pytest.raises(AttestError, match="hhmmss"):
            stamps.guess_unit(clock, imu=imu, path=LOG)
        assert stamps.guess_unit(seconds, imu=imu, path=LOG)[0] == "s"
    paused = np.r_[np.arange(0.0, 55.0, 0.5), np.arange(105.0, 155.0, 0.5)]
    for steps in (np.arange(0.0, 5000.0, 50.0), np.arange(0.0, 9000.0, 60.0), np.arange(40) * 0.5, paused):
        assert stamps.guess_unit(steps, imu=False, path=LOG)[0] == "s"


def test_other_steps_count_no_days() -> None:
    for raw in (np.arange(100) * 0.01, 1.7e9 + np.arange(100) * 0.005, np.arange(100) * 10.0, np.zeros(9)):
        assert stamps.in_days(raw, "", imu=True, path=LOG) is None
    assert stamps.in_days(46174.4 + np.arange(20) / 86_400, "", imu=False, path=LOG)[1] == 25_569
    assert stamps.in_days(np.arange(900) * 0.001, "", imu=False, path=LOG) is None  # a track at 1 kHz
    with pytest.raises(AttestError, match=r"fits min and h and d"):
        stamps.in_days(np.arange(900) / 3600, "", imu=False, path=LOG)
    assert stamps.in_days(np.arange(9) * 0.01, "min", imu=True, path=LOG) == (60 / 86_400, 0, ())
