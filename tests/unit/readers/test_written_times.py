"""Dates and times of day as people write them: read right, or refused with the first cell."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from attest_cli.errors import AttestError
from attest_cli.readers.written_times import kind_of, parse

LOG = Path("log.csv")


def read(*cells: str | None, day_first: bool | None = None) -> tuple[list[str], list[bool]]:
    ns, valid = parse(LOG, "time", pa.chunked_array([list(cells)]), day_first=day_first)
    return np.datetime_as_string(ns.astype("datetime64[ns]"), unit="ms").tolist(), np.isfinite(valid).tolist()


@pytest.mark.parametrize(
    ("cells", "expected"),
    [
        (["10:00:00.123", "10:00:01"], ["1970-01-01T10:00:00.123", "1970-01-01T10:00:01.000"]),
        (["23:59:59.5", "00:00:00.5"], ["1970-01-01T23:59:59.500", "1970-01-02T00:00:00.500"]),
        (["59:59.9", "00:00.1"], ["1970-01-01T00:59:59.900", "1970-01-01T01:00:00.100"]),  # minutes and seconds
        (["11:59:59.5 AM", "12:00:00.0 pm", "1:00:00 p.m."],
         ["1970-01-01T11:59:59.500", "1970-01-01T12:00:00.000", "1970-01-01T13:00:00.000"]),
        (["12:00:00 AM"], ["1970-01-01T00:00:00.000"]),
        (["13.06.2026 10:00:00,5"], ["2026-06-13T10:00:00.500"]),
        (["1.6.26 7:05:01"], ["2026-06-01T07:05:01.000"]),  # with points the day comes first
        (["06/13/2026 10:00:00.5 PM"], ["2026-06-13T22:00:00.500"]),
        (["12/06/2026 23:59:59", "13/06/2026 00:00:00"], ["2026-06-12T23:59:59.000", "2026-06-13T00:00:00.000"]),
        (["01-Jun-2026 10:00:00"], ["2026-06-01T10:00:00.000"]),
        (["2026/06/01 10:00:00+02:00"], ["2026-06-01T08:00:00.000"]),
        (["2026-06-01 10:00:00,250"], ["2026-06-01T10:00:00.250"]),
        (["2024-02-29 10:00:00 -0730"], ["2024-02-29T17:30:00.000"]),
        (["10:00:15", "23:00:15"], ["1970-01-01T10:00:15.000", "1970-01-01T23:00:15.000"]),  # a pause
        (["22:00:00", "08:00:00"], ["1970-01-01T22:00:00.000", "1970-01-02T08:00:00.000"]),
        (["00:15.5", "40:15.5"], ["1970-01-01T00:00:15.500", "1970-01-01T00:40:15.500"]),
        (["59:59.5", "60:00.5", "119:00.5"],
         ["1970-01-01T00:59:59.500", "1970-01-01T01:00:00.500", "1970-01-01T01:59:00.500"]),  # a stopwatch
        (["10:00:00\u202fAM", "10:00:01\u00a0PM", "11:00:01 p.\u00a0m."],
         ["1970-01-01T10:00:00.000", "1970-01-01T22:00:01.000", "1970-01-01T23:00:01.000"]),
        (["20260601T100000.250Z"], ["2026-06-01T10:00:00.250"]),
        (["20260601 10:00:00"], ["2026-06-01T10:00:00.000"]),
        (["33/06/13 10:00:00"], ["2033-06-13T10:00:00.000"]),  # no day is the 33rd
        (["06/13/26 10:00:00"], ["2026-06-13T10:00:00.000"]),  # no month is the 13th
        (["13.06.26 10:00:00"], ["2026-06-13T10:00:00.000"]),
    ],
)  # fmt: skip
def test_times_are_read_as_they_are_meant(cells: list[str], expected: list[str]) -> None:
    found, valid = read(*cells)
    assert found == expected
    assert all(valid)


def test_as_datetime_writes_and_reads_them() -> None:
    rng = np.random.default_rng(5)
    times = [datetime(1995, 1, 1, tzinfo=UTC) + timedelta(milliseconds=int(rng.integers(3e12))) for _ in range(300)]
    for form in ("%d.%m.%Y %H:%M:%S.%f", "%Y/%m/%d %I:%M:%S.%f %p", "%d-%b-%Y %H:%M:%S.%f", "%m/%d/%Y %H:%M:%S.%f"):
        found, valid = read(*(time.strftime(form) for time in times))
        assert all(valid)
        assert found == [time.strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3] for time in times], form


def test_rows_out_of_order_across_midnight_keep_their_day() -> None:
    found, valid = read("23:59:59.8", "00:00:00.0", "23:59:59.9", None, "00:00:00.1")
    assert [cell[8:] for cell in found] == [
        "01T23:59:59.800", "02T00:00:00.000", "01T23:59:59.900", "01T00:00:00.000", "02T00:00:00.100",
    ]  # fmt: skip
    assert valid == [True, True, True, False, True]


@pytest.mark.parametrize(
    "cell",
    ["31-Jun-2026 10:00:00", "29.02.2026 10:00:00", "01.13.2026 10:00:00", "25.12.1066 10:00:00", "13:00:00.5 PM",
     "24:00:00", "10:61:00", "end of log", "0026-06-13 10:00:00", "13-06-0026 10:00:00", "126-06-13 10:00:00"],
)  # fmt: skip
def test_what_no_clock_or_calendar_shows_is_no_time(cell: str) -> None:
    first = "10:00:00" if ":" in cell[:3] else "01.01.2026 10:00:00"
    assert read(first, cell)[1] == [True, False]


@pytest.mark.parametrize(
    ("cells", "says"),
    [
        (["01/06/2026 10:00:00", "02/06/2026 10:00:00"], "day or month first.*begins with 01/06/2026.*day_first"),
        (["10:00", "10:01"], "hours and minutes only.*'10:00'"),
        (["06/13/2026 10:00"], "hours and minutes only"),
        (["2026-06-01 10:00:00.5", "2026-06-01T10:00:00Z"], "with a zone, and without"),
        (["26-06-13 10:00:00", "26-06-14 10:00:00"], "year first or last.*begins with 26-06-13"),
        (["13/06/26 10:00:00"], "year first or last.*begins with 13/06/26"),
        (["a quarter past ten"], "'a quarter past ten' is no time"),
    ],
)
def test_what_can_be_read_in_two_ways_is_refused(cells: list[str], says: str) -> None:
    with pytest.raises(AttestError, match=says):
        read(*cells)


def test_the_order_of_a_date_can_be_said() -> None:
    assert read("01/06/2026 10:00:00", day_first=True)[0] == ["2026-06-01T10:00:00.000"]
    assert read("26-06-13 10:00:00", day_first=True)[0] == ["2013-06-26T10:00:00.000"]
    assert read("01/06/2026 10:00:00", day_first=False)[0] == ["2026-01-06T10:00:00.000"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2026-06-01T10:00:00.000000001Z", 1_780_308_000_000_000_001),
        ("2026-06-01T12:00:00+02:00", 1_780_308_000_000_000_000),
        ("2026-06-01 10:00:00.5", 1_780_308_000_500_000_000),
    ],
)
def test_iso_8601_is_read_to_the_nanosecond(text: str, expected: int) -> None:
    assert parse(LOG, "time", pa.chunked_array([[text]]))[0][0] == expected


@pytest.mark.parametrize(
    ("cell", "kind"),
    [("10:00:00", "time of day"), ("1.6.2026", "date and time"), ("2026-06-01T10", "date and time"),
     ("46174.4", ""), ("-0.5", ""), ("", ""), ("12-5", "")],
)  # fmt: skip
def test_numbers_are_not_written_times(cell: str, kind: str) -> None:
    assert kind_of(cell) == kind
