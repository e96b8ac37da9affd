"""A long MCAP at a glance: what it says is what the whole says; where it cannot, the whole is read."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.writer import Writer

from attest_cli.__main__ import run
from attest_cli.readers import read
from attest_cli.readers.mcap_glance import glance
from attest_cli.settings import Settings
from attest_cli.writers.ros2 import definition

T0 = 1_780_308_000_000_000_000
GAP = (1400, 1900)  # IMU messages that are missing


def write(path: Path, rows: int = 3000, force: float = 9.81) -> Path:
    """Write 100 Hz of IMU with a gap and a sun vector at four times, logged up to 20 ms after their stamps."""
    rng = np.random.default_rng(4)
    late = rng.integers(0, 20_000_000, rows)
    kinds = {"/imu/data": "sensor_msgs/Imu", "/sun": "geometry_msgs/Vector3Stamped"}
    with path.open("wb") as stream, Writer(stream, chunk_size=20_000) as out:
        schemas = {
            topic: out.register_msgdef(kind.replace("/", "/msg/"), definition(kind)) for topic, kind in kinds.items()
        }
        for k in range(rows):
            stamp_ns = T0 + k * 10_000_000
            header = {"stamp": {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}, "frame_id": "imu_link"}
            fields: dict[str, dict[str, Any]] = {}
            if not GAP[0] <= k < GAP[1]:
                noise = rng.normal(0.0, 0.003, 6).tolist()
                turn = {"x": 0.01 + noise[0], "y": noise[1], "z": noise[2]}
                tilt = {"x": noise[3], "y": noise[4], "z": force + noise[5]}
                fields["/imu/data"] = {"angular_velocity": turn, "linear_acceleration": tilt}
            if k in {3, 700, 2000, rows - 200}:
                fields["/sun"] = {"vector": {"x": 1.0, "y": 0.0, "z": 0.1 * (k % 7)}}
            for topic, message in fields.items():
                out.write_message(topic, schemas[topic], {"header": header, **message}, log_time=stamp_ns + late[k])
    return path


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("glance") / "long.mcap")


def test_rows_spans_and_the_first_values_are_those_of_the_whole(log: Path) -> None:
    found, whole = glance(log, Settings()), read(log, Settings())
    assert found is not None
    assert found.recording.rows == whole.rows
    for seen, end, channel in zip(found.recording.channels, found.ends.channels, whole.channels, strict=True):
        assert (seen.name, seen.role, seen.units) == (channel.name, channel.role, channel.units)
        assert seen.stamps_ns.size == channel.stamps_ns.size
        assert [end.stamps_ns.min(), end.stamps_ns.max()] == [channel.stamps_ns.min(), channel.stamps_ns.max()]
    head, imu = found.head.channels[0], whole.channels[0]
    for name, values in head.values.items():
        np.testing.assert_array_equal(values, imu.values[name][: values.size])


def shown(log: Path, capsys: pytest.CaptureFixture[str], *more: str) -> dict[str, Any]:
    assert run(["info", str(log), "--json", *more]) in {0, 3}
    facts: dict[str, Any] = json.loads(capsys.readouterr().out)
    return facts


def test_info_says_the_same_of_the_index_as_of_the_whole(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    quick, whole = shown(log, capsys), shown(log, capsys, "-v")
    assert "chunks read" in quick["files"][0]["notes"][0]
    assert not whole["files"][0]["notes"]
    assert [channel["gaps"] for channel in whole["channels"]] == [1, 0]
    for a, b in zip(quick["channels"], whole["channels"], strict=True):
        rates = a.pop("rate_hz"), b.pop("rate_hz")
        assert a == b
        assert rates[0] == pytest.approx(rates[1], rel=5e-3)


def test_info_does_not_read_the_data_in_between(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with log.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    middle = summary.chunk_indexes[len(summary.chunk_indexes) // 2]
    data = bytearray(log.read_bytes())
    at = middle.chunk_start_offset + 80
    data[at : at + 200] = bytes(200)
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(data)
    assert shown(broken, capsys)["channels"] == shown(log, capsys)["channels"]
    assert run(["info", str(broken), "-v"]) == 3


def test_what_asks_for_a_closer_look_is_read_as_a_whole(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write(tmp_path / "weightless.mcap", force=0.05)
    assert glance(log, Settings()) is not None
    assert run(["info", str(log)]) == 1
    out, err = capsys.readouterr()
    assert "chunks read" not in out + err
    assert "no gravity" in err


def test_a_short_log_is_read_as_a_whole(tmp_path: Path) -> None:
    assert glance(write(tmp_path / "short.mcap", rows=300), Settings()) is None


def test_damage_at_the_end_is_never_a_traceback_and_never_another_count(log: Path, tmp_path: Path) -> None:
    data, rng = log.read_bytes(), np.random.default_rng(5)
    whole = read(log, Settings())
    damaged = tmp_path / "damaged.mcap"
    refused = 0
    for at in rng.integers(len(data) - 8000, len(data), 150):
        changed = bytearray(data)
        changed[at] ^= int(rng.integers(1, 256))
        damaged.write_bytes(changed)
        found = glance(damaged, Settings())
        refused += found is None
        assert found is None or found.recording.rows == whole.rows
    assert refused > 20
    damaged.write_bytes(data[:-100])
    assert glance(damaged, Settings()) is None
