"""Tracks in every format: exact stamps and numbers, readable by the libraries that others use."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from scipy.spatial.transform import Rotation

from attest_cli.writers import WRITERS, write_track

META = {"frame": "enu", "convention": "Hamilton, body to world", "attest_version": "0\n# evil: 1"}
T0 = 1_780_308_000_000_000_001


@pytest.fixture
def track(rng: np.random.Generator) -> dict[str, Any]:
    n = 50
    q = Rotation.random(n, rng=rng).as_quat(scalar_first=True)
    columns: dict[str, Any] = {"timestamp_ns": T0 + np.arange(n) * 9_999_999, "t_s": np.arange(n) * 0.009999999}
    columns |= {f"q_{axis}": q[:, k] for k, axis in enumerate("wxyz")}
    columns |= {f"sigma_att_{axis}_deg": rng.uniform(0.1, 2.0, n) for axis in "xyz"}
    columns |= {f"position_{axis}_m": rng.normal(size=n) for axis in "xyz"}
    columns |= {f"sigma_position_{axis}_m": rng.uniform(0.1, 1.0, n) for axis in "xyz"}
    columns |= {f"velocity_{axis}_m_s": rng.normal(size=n) for axis in "xyz"}
    return columns | {"segment": np.ones(n, dtype=np.int32), "moving": np.arange(n) % 2 == 0}


def odometry(path: Path) -> list[Any]:
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return [item.decoded_message for item in reader.iter_decoded_messages(topics=["/attest/odometry"])]


def test_parquet_holds_all_columns_and_the_metadata(tmp_path: Path, track: dict[str, Any]) -> None:
    write_track([track], META, tmp_path / "track.parquet", "parquet")
    table = pq.read_table(tmp_path / "track.parquet")
    assert table.column_names == list(track)
    for name, column in track.items():
        np.testing.assert_array_equal(table.column(name).to_numpy(), column)
    assert table.schema.metadata[b"frame"] == b"enu"


def test_csv_is_exact_and_opens_with_pandas(tmp_path: Path, track: dict[str, Any]) -> None:
    track["position_x_m"][3] = np.nan
    write_track([track], META, tmp_path / "track.csv", "csv")
    lines = (tmp_path / "track.csv").read_text().splitlines()
    assert lines[:4] == [
        "# frame: enu",
        "# convention: Hamilton, body to world",
        "# attest_version: 0 # evil: 1",
        ",".join(track),
    ]
    rows = list(csv.DictReader(lines[3:]))
    assert [int(row["timestamp_ns"]) for row in rows] == track["timestamp_ns"].tolist()
    assert [float(row["q_w"]) for row in rows] == track["q_w"].tolist()
    assert [row["position_x_m"] for row in rows[:4]] == [*(repr(float(x)) for x in track["position_x_m"][:3]), ""]
    table = pd.read_csv(tmp_path / "track.csv", comment="#")
    assert list(table.columns) == list(track)
    assert table["moving"].tolist() == track["moving"].tolist()


def test_tum_is_exact_to_the_nanosecond_and_scalar_last(tmp_path: Path, track: dict[str, Any]) -> None:
    write_track([track], META, tmp_path / "track.tum", "tum")
    text = [line for line in (tmp_path / "track.tum").read_text().splitlines() if not line.startswith("#")]
    first = text[1].split(" ")
    assert first[0] == "1780308000.010000000"
    numbers = np.array([[float(cell) for cell in line.split(" ")[1:]] for line in text])
    np.testing.assert_array_equal(numbers[:, 0], track["position_x_m"])
    np.testing.assert_array_equal(numbers[:, 3:], np.stack([track[f"q_{axis}"] for axis in "xyzw"], axis=1))


def test_tum_without_position_says_so(tmp_path: Path, track: dict[str, Any]) -> None:
    for axis in "xyz":
        track[f"position_{axis}_m"][:] = np.nan
    track["timestamp_ns"] = np.array([-5, *range(49)])
    write_track([track], META, tmp_path / "track.tum", "tum")
    text = (tmp_path / "track.tum").read_text().splitlines()
    assert "# no position: tx ty tz are zero" in text
    assert next(line for line in text if not line.startswith("#")).startswith("-0.000000005 0 0 0 ")


def test_mcap_holds_pose_covariance_and_body_velocity(tmp_path: Path, track: dict[str, Any]) -> None:
    write_track([track], META, tmp_path / "track.mcap", "mcap")
    messages = odometry(tmp_path / "track.mcap")
    assert len(messages) == 50
    message, k = messages[7], 7
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == track["timestamp_ns"][k]
    pose, covariance = message.pose.pose, message.pose.covariance
    assert (pose.orientation.w, pose.orientation.z) == (track["q_w"][k], track["q_z"][k])
    assert pose.position.y == track["position_y_m"][k]
    assert covariance[0] == pytest.approx(track["sigma_position_x_m"][k] ** 2)
    assert covariance[35] == pytest.approx(np.radians(track["sigma_att_z_deg"][k]) ** 2)
    q = Rotation.from_quat([track[f"q_{axis}"][k] for axis in "wxyz"], scalar_first=True)
    linear = message.twist.twist.linear
    expected = q.inv().apply([track[f"velocity_{axis}_m_s"][k] for axis in "xyz"])
    np.testing.assert_allclose([linear.x, linear.y, linear.z], expected, atol=1e-14)


def test_mcap_without_position_is_marked_not_provided(tmp_path: Path, track: dict[str, Any]) -> None:
    lean = {name: column for name, column in track.items() if "position" not in name and "velocity" not in name}
    write_track([lean], META, tmp_path / "track.mcap", "mcap")
    message = odometry(tmp_path / "track.mcap")[0]
    assert (message.pose.covariance[0], message.twist.covariance[0]) == (-1.0, -1.0)
    assert message.pose.pose.position.x == 0.0


def test_mcap_with_imu_columns_has_the_imu_too(tmp_path: Path, track: dict[str, Any], rng: np.random.Generator) -> None:
    track |= {name: rng.normal(size=50) for name in ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")}
    write_track([track], META, tmp_path / "track.mcap", "mcap")
    with (tmp_path / "track.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        imus = [item.decoded_message for item in reader.iter_decoded_messages(topics=["/attest/imu"])]
    assert [message.angular_velocity.y for message in imus] == track["gyro_y"].tolist()


@pytest.mark.parametrize("format_name", list(WRITERS))
def test_the_same_track_gives_the_same_bytes(tmp_path: Path, track: dict[str, Any], format_name: str) -> None:
    for name in "ab":
        write_track([track], META, tmp_path / name, format_name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]
