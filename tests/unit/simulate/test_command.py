"""``attest simulate``: what is written is read back, and options of another scenario are refused."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from support.signals import accel_of, channel, gyro_of

from attest_cli import pipeline
from attest_cli.__main__ import run
from attest_cli.settings import Settings
from attest_cli.simulate import (
    CharlyOptions,
    GyrostarOptions,
    Simulation,
    WalkingOptions,
    simulate_charly,
    simulate_gyrostar,
    simulate_walking,
)

MADE = {
    "charly": (["--duration", "20"], lambda: simulate_charly(CharlyOptions(seed=5, duration_s=20.0))),
    "walking": (
        ["--duration", "20", "--case", "B", "--bias-deg-s", "0.5"],
        lambda: simulate_walking(WalkingOptions(seed=5, case="B", bias_deg_s=0.5, duration_s=20.0)),
    ),
    "gyrostar": (
        ["--duration", "90", "--course", "platform", "--stops", "--scatter", "0.15", "--random-walk-deg-s", "5e-4"],
        lambda: simulate_gyrostar(
            GyrostarOptions(
                seed=5, course="platform", duration_s=90.0, stops=True, scatter=0.15, random_walk_deg_s=5e-4
            )
        ),
    ),
}
ROLES = {"charly": {"imu", "odometry"}, "walking": {"imu"}, "gyrostar": {"imu"}}
FOREIGN = [
    ["charly", "--motion", "3", "5"],
    ["charly", "--rate", "50"],
    ["charly", "--case", "A"],
    ["rover", "--turn-deg", "90"],
    ["rover", "--stops"],
    ["walking", "--sensors", "sun"],
    ["walking", "--variant", "noisy"],
    ["walking", "--course", "truck"],
    ["gyrostar", "--bias-deg-s", "0.5"],
    ["gyrostar", "--noise", "S2"],
]


@pytest.mark.parametrize("scenario", sorted(MADE))
def test_every_format_is_read_back_with_its_roles(
    scenario: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments, make = MADE[scenario]
    made: Simulation = make()
    assert run(["simulate", scenario, "-o", str(tmp_path / "log"), "--seed", "5", *arguments]) == 0
    capsys.readouterr()
    with (tmp_path / "attest.toml").open("rb") as stream:
        settings = Settings.model_validate(tomllib.load(stream))
    for suffix in (".csv", ".mcap", ".parquet"):
        log = tmp_path / f"log{suffix}"
        assert run(["info", str(log), "--json"]) == 0
        found = {c["used_as"] for c in json.loads(capsys.readouterr().out)["channels"]}
        assert found == ROLES[scenario]
        _, read = pipeline.read([log], settings)
        np.testing.assert_allclose(read.imu.gyro_b, gyro_of(made), atol=1e-12)
        np.testing.assert_allclose(read.imu.accel_b, accel_of(made), atol=1e-12)
        assert not read.warnings
        if scenario == "charly":
            odometry = read.fixes["odometry"].values
            np.testing.assert_allclose(odometry[:, 0], channel(made, "odometry").values["speed"], atol=1e-12)
            assert np.all(np.isnan(odometry[:, 1:]))


@pytest.mark.parametrize("scenario", sorted(MADE))
def test_the_truth_has_the_columns_of_a_track(scenario: str, tmp_path: Path) -> None:
    arguments, make = MADE[scenario]
    assert run(["simulate", scenario, "-o", str(tmp_path / "log.csv"), "--seed", "5", "-q", *arguments]) == 0
    table = pq.read_table(tmp_path / "log.truth.parquet")
    names = ["timestamp_ns", *(f"q_{p}" for p in "wxyz"), "moving"]
    for form in ("position_{}_m", "velocity_{}_m_s", "gyro_bias_{}_rad_s", "accel_bias_{}_m_s2"):
        names += [form.format(axis) for axis in "xyz"]
    assert set(names) <= set(table.column_names)
    np.testing.assert_array_equal(table["timestamp_ns"].to_numpy(), channel(make(), "imu").stamps_ns)
    assert table.schema.metadata[b"scenario"] == scenario.encode()


@pytest.mark.parametrize("arguments", FOREIGN, ids=" ".join)
def test_an_option_of_another_scenario_is_refused_in_one_line(
    arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["simulate", *arguments, "-o", str(tmp_path / "log.csv")]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert f"{arguments[1]}: {arguments[0]} has no such option" in err
    assert not any(tmp_path.iterdir())


def test_a_value_out_of_reach_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["simulate", "gyrostar", "--scatter", "3", "-o", str(tmp_path / "log.csv")]) == 1
    assert capsys.readouterr().err == "attest: a scatter of 3; choose 0 to 0.3, such as 0.15 for 15 %\n"
    assert not any(tmp_path.iterdir())
