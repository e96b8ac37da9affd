"""Parquet tables: types of every kind, damage, and tables that are larger than they look."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from attest_cli.errors import AttestError
from attest_cli.readers import parquet_log, read, tables
from attest_cli.records import Recording
from attest_cli.settings import Settings

IMU = {"gyro_x": 0.1, "gyro_y": 0.2, "gyro_z": 0.3, "accel_x": 0.0, "accel_y": 0.0, "accel_z": 9.81}


def load(path: Path, time: Any, n: int = 50, **more: Any) -> Recording:
    columns = {"timestamp": time, **{name: np.full(n, value) for name, value in IMU.items()}, **more}
    pq.write_table(pa.table(columns), path)
    return read(path, Settings())


@pytest.mark.parametrize(
    ("time", "first", "step"),
    [
        (pa.array(np.arange(50) * 10_000_000 + 5, pa.timestamp("ns", "UTC")), 5, 10_000_000),
        (pa.array(np.arange(50) * 10_000, pa.timestamp("us")), 0, 10_000_000),
        (1_780_308_000_000_000_123 + np.arange(50) * 10_000_000, 1_780_308_000_000_000_123, 10_000_000),
        (np.arange(50) * 0.01, 0, 10_000_000),
        (np.arange(50, dtype=np.float32) * np.float32(0.5), 0, 500_000_000),
        (pa.array([f"2026-06-01T10:00:00.{k:02d}0Z" for k in range(50)]), 1_780_308_000_000_000_000, 10_000_000),
    ],
)
def test_stamps_of_every_type_are_read(tmp_path: Path, time: Any, first: int, step: int) -> None:
    stamps_ns = load(tmp_path / "log.parquet", time).channels[0].stamps_ns
    assert stamps_ns[0] == first
    assert stamps_ns[1] - stamps_ns[0] == step


def test_nulls_are_blank_and_integers_and_strings_of_numbers_are_values(tmp_path: Path) -> None:
    mag = pa.array([None] * 25 + [7] * 25, pa.int32())
    recording = load(tmp_path / "log.parquet", np.arange(50) * 0.01, mag_x=mag, mag_y=mag, mag_z=pa.array(["1.5"] * 50))
    magnetometer = recording.channels[1]
    assert magnetometer.values["mag_z"].tolist() == [1.5] * 50
    assert np.count_nonzero(np.isnan(magnetometer.values["mag_x"])) == 25


def test_units_come_from_the_metadata_of_a_field(tmp_path: Path) -> None:
    names = ["t", "gx", "gy", "gz"]
    fields = [
        pa.field(name, pa.float64(), metadata={"unit": "deg/s"} if name != "t" else {"unit": "s"}) for name in names
    ]
    arrays = [pa.array(np.arange(10) * 0.01), *[pa.array(np.ones(10))] * 3]
    pq.write_table(pa.table(arrays, schema=pa.schema(fields)), tmp_path / "log.parquet")
    assert read(tmp_path / "log.parquet", Settings()).channels[0].units["gyro_x"] == "deg/s"


@pytest.mark.parametrize("where", [0.3, 0.6, 0.95])
def test_a_cut_or_flipped_file_is_refused(tmp_path: Path, where: float) -> None:
    path = tmp_path / "log.parquet"
    load(path, np.arange(50) * 0.01)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(where * len(whole))])
    with pytest.raises(AttestError, match="damaged Parquet"):
        read(path, Settings())


def test_a_flipped_bit_in_a_page_is_found_by_its_checksum(tmp_path: Path) -> None:
    path = tmp_path / "log.parquet"
    columns = {
        "timestamp_ns": np.arange(1000),
        **{name: np.random.default_rng(7).normal(value, 1, 1000) for name, value in IMU.items()},
    }
    pq.write_table(pa.table(columns), path, write_page_checksum=True, use_dictionary=False, compression="none")
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0x10
    path.write_bytes(data)
    with pytest.raises(AttestError, match="damaged Parquet"):
        read(path, Settings())


def test_an_empty_table_and_text_for_numbers_are_refused(tmp_path: Path) -> None:
    with pytest.raises(AttestError, match="no rows"):
        load(tmp_path / "a.parquet", np.arange(0) * 0.01, n=0)
    with pytest.raises(AttestError, match="mag_x"):
        load(
            tmp_path / "b.parquet",
            np.arange(50) * 0.01,
            **dict.fromkeys(("mag_x", "mag_y", "mag_z"), pa.array(["red"] * 50)),
        )


def test_the_limit_counts_rows_and_columns_in_use(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "MAX_TABLE_BYTES", 50 * 7 * 8)
    load(tmp_path / "fits.parquet", np.arange(50) * 0.01, junk=np.zeros(50))
    with pytest.raises(AttestError, match="over the limit"):
        load(tmp_path / "big.parquet", np.arange(51) * 0.01, n=51)


def test_the_reader_is_the_one_in_the_registry() -> None:
    from attest_cli.readers import READERS

    assert READERS["parquet"] == parquet_log.__name__


def settings(**table: Any) -> Settings:
    return Settings.model_validate({"table": table})


def foreign(path: Path, **more: Any) -> Path:
    """A table with names that say nothing; time in ms."""
    names = dict(zip(("a", "b", "c", "d", "e", "f"), IMU.values(), strict=True))
    pq.write_table(
        pa.table({"when": np.arange(50) * 10.0, **{n: np.full(50, v) for n, v in names.items()}, **more}), path
    )
    return path


def test_columns_are_named_in_order(tmp_path: Path) -> None:
    path = foreign(tmp_path / "log.parquet", junk=np.zeros(50))
    named = ["t [ms]", "gyro_x [deg/s]", "gyro_y", "gyro_z", *list(IMU)[3:], "-"]
    recording = read(path, settings(columns=named))
    channel = recording.channels[0]
    assert (channel.role, channel.units["gyro_x"], recording.warnings) == ("imu", "deg/s", ())
    assert channel.stamps_ns[1] == 10_000_000
    assert {name: column[0] for name, column in channel.values.items()} == IMU
    with pytest.raises(AttestError, match="7 columns are named, but the table has 8"):
        read(path, settings(columns=named[:-1]))


def test_columns_are_given_other_names(tmp_path: Path) -> None:
    path = foreign(tmp_path / "log.parquet")
    names = {"when": "time", **dict(zip("abcdef", IMU, strict=True))}
    recording = read(path, settings(names=names, time_unit="ms"))
    assert recording.channels[0].stamps_ns[1] == 10_000_000
    assert recording.channels[0].values["accel_z"][0] == 9.81
    told = read(path, settings(names={**names, "wen": "t"}, time_unit="ms")).warnings
    assert [warning.code for warning in told] == ["no-such-column"]


def test_a_rate_makes_time_of_a_counter_or_of_the_rows(tmp_path: Path) -> None:
    path = tmp_path / "log.parquet"
    columns = {name: np.full(50, value) for name, value in IMU.items()}
    pq.write_table(pa.table(columns), path)
    assert read(path, settings(sample_rate_hz=100.0)).channels[0].stamps_ns[:2].tolist() == [0, 10_000_000]
    counter = np.delete(np.arange(230, 281), 7) % 256  # one byte, and a sample lost
    pq.write_table(pa.table({"packet_counter": counter.astype(np.uint8), **columns}), path)
    steps = np.diff(read(path, settings(sample_rate_hz=100.0)).channels[0].stamps_ns)
    assert sorted(steps.tolist()) == [10_000_000] * 48 + [20_000_000]
    with pytest.raises(AttestError, match="no time column"):
        read(path, Settings())


def test_whole_seconds_beside_nanoseconds_are_added(tmp_path: Path) -> None:
    k = np.arange(50) * 10_000_000 + 990_000_000
    more = {"stamp_sec": 1_780_308_000 + k // 10**9, "stamp_nsec": k % 10**9}
    columns = {**more, **{name: np.full(50, value) for name, value in IMU.items()}}
    pq.write_table(pa.table(columns), tmp_path / "log.parquet")
    stamps_ns = read(tmp_path / "log.parquet", Settings()).channels[0].stamps_ns
    assert stamps_ns[:2].tolist() == [1_780_308_000_990_000_000, 1_780_308_001_000_000_000]


def test_settings_of_text_are_said_to_do_nothing(tmp_path: Path) -> None:
    path = foreign(tmp_path / "log.parquet")
    names = {"when": "t [ms]", **dict(zip("abcdef", IMU, strict=True))}
    assert [w.code for w in read(path, settings(names=names, decimal=",")).warnings] == ["no-text-log"]


def test_times_of_day_are_read_with_their_date(tmp_path: Path) -> None:
    clock = pa.array(np.arange(50) * 10_000 + 36_000_000_000, pa.time64("us"))
    text = pa.array([f"10:00:00.{k:02d}" for k in range(50)])
    day = pa.array(["2026-06-01"] * 50).cast(pa.date32())
    for time in (clock, text):
        for more, first in (({}, 36_000_000_000_000), ({"date": day}, 1_780_308_000_000_000_000)):
            stamps_ns = load(tmp_path / "log.parquet", time, **more).channels[0].stamps_ns
            assert stamps_ns.tolist() == [first + k * 10_000_000 for k in range(50)]
    days = 46174.4166666667 + np.arange(50) * 0.01 / 86_400
    recording = load(tmp_path / "log.parquet", days)
    assert abs(int(recording.channels[0].stamps_ns[0]) - 1_780_308_000_000_000_000) < 10_000
    assert [w.code for w in recording.warnings] == ["time-unit-guessed"]
