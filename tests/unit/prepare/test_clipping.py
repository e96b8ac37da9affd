"""Clipping: the ends of a range are found, nothing else is; what is drawn there is closer, and the sigma covers it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from support.drives import effective

from attest_cli.estimate import Estimate, estimate
from attest_cli.maths import rotation
from attest_cli.pipeline import read
from attest_cli.prepare import clipping, prepare
from attest_cli.records import COLUMNS, Channel, Log, Recording
from attest_cli.segment import find_segments
from attest_cli.settings import Settings
from attest_cli.simulate import (
    CharlyOptions,
    GyrostarOptions,
    RoverOptions,
    Simulation,
    WalkingOptions,
    simulate_charly,
    simulate_gyrostar,
    simulate_rover,
    simulate_walking,
)

Array = NDArray[np.float64]
RATE_HZ, LEVEL = 100.0, 6.0
SILENT = (
    "broad/08_undisturbed_fast_rotation_with_breaks_A.parquet", "broad/21_undisturbed_fast_combined.parquet",
    "repoimu/TStick_Test02_Trial1.parquet", "repoimu/Pendulum_Test01b_Static_Segment_3.parquet",
    "euroc_mh01/imu0.parquet", "wid/trial02_IMU1.parquet", "xio_fusion/sensor_data.parquet",
)  # fmt: skip
DATA = Path(__file__).parents[4] / "shared" / "data"


@cache
def shaken(seed: int = 5, still_s: float = 6.0, moving_s: float = 30.0) -> tuple[Array, Array, Array, Array]:
    """Return t, true rate, true attitude and specific force of an IMU that is turned to and fro in place."""
    rng = np.random.default_rng(seed)
    fine, per = 1.0 / (10 * RATE_HZ), 10
    t = np.arange(0.0, 2 * still_s + moving_s, fine)
    inside = np.clip((t - still_s) / moving_s, 0.0, 1.0)
    envelope = np.minimum(1.0, 20.0 * inside * (1.0 - inside))
    peaks = np.array([9.0, 2.5, 2.0])[:, None] * np.sin(
        2 * np.pi * (np.array([0.9, 0.7, 0.5])[:, None] * t + rng.uniform(0, 1, (3, 1)))
    )
    rate = (envelope * peaks).T
    q = rotation.chain(rotation.exp_quaternion(0.5 * (rate[1:] + rate[:-1]) * fine))
    force = rotation.rotate(rotation.conjugate(q), np.array([0.0, 0.0, 9.80665]))
    return t[::per], rate[::per], q[::per], force[::per]


def recorded(t: Array, gyro: Array, force: Array, seed: int = 6) -> Recording:
    rng = np.random.default_rng(seed)
    table = np.hstack([gyro, force + rng.normal(0.0, 0.02, force.shape)])
    channel = Channel("imu", "columns", "imu", np.rint(t * 1e9).astype(np.int64),
                      dict(zip(COLUMNS["imu"], table.T, strict=True)),
                      dict(zip(COLUMNS["imu"], ["rad/s"] * 3 + ["m/s^2"] * 3, strict=True)))  # fmt: skip
    return Recording(Path("shaken.csv"), "csv", (channel,), len(t))


def clipped_log(settings: Settings) -> Log:
    t, rate, _, force = shaken()
    noisy = rate + np.random.default_rng(7).normal(0.0, 0.002, rate.shape)
    return prepare([recorded(t, np.clip(noisy, -LEVEL, LEVEL), force)], settings)


def solved(log: Log, settings: Settings) -> tuple[Estimate, Array]:
    """Return the estimate and its attitude error without the mean turn about the vertical, which nothing tells."""
    _, _, q, _ = shaken()
    found = estimate(log, find_segments(log, settings), settings)
    t = shaken()[0]
    truth = q[np.clip(np.rint(found.smoothed.t * RATE_HZ).astype(int), 0, len(t) - 1)]
    start = rotation.multiply(truth[:1], rotation.conjugate(found.smoothed.q[:1]))
    turn = rotation.log_quaternion(start) * [0.0, 0.0, 1.0]
    mine = rotation.multiply(rotation.exp_quaternion(turn), found.smoothed.q)
    return found, rotation.log_quaternion(rotation.multiply(rotation.conjugate(mine), truth))


def test_both_ends_of_the_range_are_found_and_what_was_there_is_drawn() -> None:
    t, rate, _, _ = shaken()
    cut = np.clip(rate, -LEVEL, LEVEL)
    ends = clipping.clipped(t, cut, clipping.GYRO_FLOOR)
    assert [(e.axis, e.level) for e in ends] == [(0, LEVEL), (0, -LEVEL)]
    lost = np.abs(rate[:, 0]) >= LEVEL
    assert np.array_equal(ends[0].rows | ends[1].rows, lost)
    drawn, density = clipping.repaired(t, cut, ends, clipping.GYRO_DENSITY)
    error = np.abs(drawn - rate)[lost, 0]
    assert error.mean() < 0.2 * np.abs(cut - rate)[lost, 0].mean()
    assert np.array_equal(drawn[~lost], cut[~lost])
    assert np.all(density[~lost] == 0.0)
    low, high = clipping.GYRO_DENSITY
    assert low <= density[lost].min() <= density.max() <= high


def test_counts_and_a_level_that_wanders_are_no_hindrance() -> None:
    t, rate, _, _ = shaken()
    count = np.radians(1.0 / 16.4)
    counted = np.rint(np.clip(rate, -LEVEL, LEVEL) / count) * count
    wandering = np.clip(rate, -LEVEL, LEVEL) @ np.array([[1.0, 0.0, 0.0], [0.004, 1.0, 0.0], [0.0, 0.0, 1.0]])
    lost = np.abs(rate[:, 0]) >= LEVEL
    for values in (counted, wandering):
        ends = clipping.clipped(t, values, clipping.GYRO_FLOOR)
        assert [e.axis for e in ends] == [0, 0]
        assert np.mean((ends[0].rows | ends[1].rows) == lost) > 0.99


@pytest.mark.parametrize("count", [1e-9, 1e-3, 0.02, 0.2])
def test_smooth_peaks_are_none_however_coarse(count: float) -> None:
    t, rate, _, _ = shaken()
    assert clipping.clipped(t, np.rint(rate / count) * count, clipping.GYRO_FLOOR) == []


def test_a_stuck_sensor_and_one_at_rest_are_none() -> None:
    t, rate, _, _ = shaken()
    stuck = rate.copy()
    stuck[1500:2200, 1] = 8.0
    assert clipping.clipped(t, stuck, clipping.GYRO_FLOOR) == []
    assert clipping.clipped(t, np.full((len(t), 3), 20.0), clipping.GYRO_FLOOR) == []
    resting = np.rint(np.random.default_rng(1).normal((0.0, 0.0, 9.8), 0.01, (len(t), 3)) * 100) / 100
    assert clipping.clipped(t, resting, clipping.ACCEL_FLOOR) == []


def test_nothing_is_drawn_across_a_hole_or_past_the_end_of_the_log() -> None:
    t, rate, _, _ = shaken()
    cut = np.clip(rate, -LEVEL, LEVEL)
    first, last = clipping.clipped(t, cut, clipping.GYRO_FLOOR)[0].runs[4]
    after = np.where(np.arange(len(t)) >= last, 2.0, 0.0)
    held, density = clipping.repaired(t + after, cut, clipping.clipped(t, cut, 1.7), clipping.GYRO_DENSITY)
    assert np.array_equal(held[first:last], cut[first:last])
    assert np.all(density[first:last] == clipping.GYRO_DENSITY[1])
    ends = clipping.clipped(t[:last], cut[:last], clipping.GYRO_FLOOR)
    held, _ = clipping.repaired(t[:last], cut[:last], ends, clipping.GYRO_DENSITY)
    assert np.array_equal(held[first:], cut[first:last])


@pytest.mark.parametrize("name", ["navigation", "indirect"])
def test_the_attitude_of_a_clipped_log_is_far_better_and_inside_its_sigma(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = Settings.model_validate({"smoothing": {"filter": name}})
    log = clipped_log(settings)
    (told,) = (w for w in log.warnings if w.code == "gyro-clipped")
    assert "x at 6 rad/s" in told.message
    assert "x at -6 rad/s" in told.message
    found, error = solved(log, settings)
    squares = np.einsum("ki,ki->k", error, np.linalg.solve(found.smoothed.P[:, :3, :3], error[:, :, None])[:, :, 0])
    assert np.mean(squares < 16.3) > 0.99  # 99.9 % of three degrees of freedom
    monkeypatch.setattr(clipping, "clipped", lambda *_: [])
    _, bare = solved(clipped_log(settings), settings)
    assert np.sqrt(np.mean(error**2)) < 0.2 * np.sqrt(np.mean(bare**2))


def test_a_clipped_accelerometer_is_told_and_counts_less_there() -> None:
    t, rate, _, force = shaken()
    blow = force + 30.0 * np.sin(2 * np.pi * 3.0 * t)[:, None] * [0.0, 0.0, 1.0] * (np.abs(t - 20.0) < 8.0)[:, None]
    recording = recorded(t, rate, blow)
    (channel,) = recording.channels
    values = {k: np.clip(v, -25.0, 25.0) if k.startswith("accel") else v for k, v in channel.values.items()}
    log = prepare([replace(recording, channels=(replace(channel, values=values),))], Settings())
    assert [w for w in log.warnings if w.code == "accelerometer-clipped"]
    assert log.imu.accel_added is not None
    assert log.imu.accel_b.max() == 25.0
    assert np.array_equal(log.imu.accel_added > 0, np.any(np.abs(log.imu.accel_b) >= 25.0, axis=1))


@pytest.mark.parametrize(("level", "share", "fatal"), [(10.3, 0.2, True), (10.3, 0.01, False), (11.5, 0.2, False)])
def test_an_accelerometer_whose_range_ends_at_gravity_knows_no_up(level: float, share: float, fatal: bool) -> None:
    rows = np.arange(1000) < 1000 * share
    warn = clipping.told("log", "accelerometer", [clipping.Clipped(2, level, rows, 0.1)], "m/s^2")
    assert (warn.code, warn.fatal) == ("accelerometer-clipped", fatal)


@pytest.mark.parametrize(
    "make",
    [
        lambda: simulate_rover(RoverOptions(seed=3, scenario="S1", motions=1)),
        lambda: simulate_rover(RoverOptions(seed=4, scenario="S2", variant="noisy", motions=1)),
        lambda: simulate_walking(WalkingOptions(seed=2)),
        lambda: simulate_charly(CharlyOptions(seed=2)),
        lambda: simulate_gyrostar(GyrostarOptions(seed=2)),
    ],
)
def test_simulated_logs_are_silent(make: Callable[[], Simulation]) -> None:
    made = make()
    log = prepare([made.log], effective(made, {}))
    assert not [w for w in log.warnings if "clipped" in w.code]


@pytest.mark.parametrize("name", SILENT)
def test_real_logs_that_are_not_clipped_are_silent(name: str) -> None:
    if not (DATA / name).exists():
        pytest.skip(f"{name} is not there")
    _, log = read([DATA / name], Settings())
    assert not [w for w in log.warnings if "clipped" in w.code]


@pytest.mark.parametrize(("name", "axis"), [("Test05_Trial1", "x at -7.358"), ("Test06_Trial1", "y at 7.43")])
def test_a_real_clipped_gyro_is_told(name: str, axis: str) -> None:
    path = DATA / "repoimu" / f"TStick_{name}.parquet"
    if not path.exists():
        pytest.skip(f"{path.name} is not there")
    _, log = read([path], Settings())
    assert [axis in w.message for w in log.warnings if w.code == "gyro-clipped"] == [True]


def turning(seed: int = 3, minutes: float = 1.5) -> tuple[Array, Array]:
    """Return t and the noisy rate of a vehicle that stands and turns, slowly, in turn."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 60.0 * minutes, 1.0 / RATE_HZ)
    moving = np.sin(2 * np.pi * t / 30.0) > -0.3
    rate = np.where(moving, 1.0, 0.0)[:, None] * 0.4 * np.sin(2 * np.pi * t[:, None] * np.array([0.3, 0.23, 0.11]))
    return t, rate + rng.normal(0.0, 1e-3, rate.shape)


@pytest.mark.parametrize("unit", [1.0, 57.3, 1e4])
@pytest.mark.parametrize("level", [0.05, 0.1, 0.25])
def test_what_is_clipped_for_much_of_the_log_is_found_in_any_unit_and_below_a_floor(level: float, unit: float) -> None:
    t, rate = turning()
    ends = clipping.clipped(t, unit * np.clip(rate, -level, level), np.inf)
    assert [(e.axis, round(e.level / unit, 9)) for e in ends] == [(k, s * level) for k in range(3) for s in (1, -1)]
    assert all(np.array_equal(e.rows, np.sign(e.level) * rate[:, e.axis] >= level) for e in ends)
    noisy = np.clip(rate, -level, level) + np.random.default_rng(4).normal(0.0, 2e-6, rate.shape)
    ends = clipping.clipped(t, unit * noisy, np.inf)
    assert [e.axis for e in ends] == [0, 0, 1, 1, 2, 2]
    assert all(np.mean(e.rows == (np.sign(e.level) * rate[:, e.axis] >= level)) > 0.995 for e in ends)
    assert not clipping.clipped(t, rate, np.inf)


@pytest.mark.parametrize("count", [1e-4, 5e-4, 2e-3, 2e-2])
def test_a_rate_that_is_held_is_not_clipped_however_coarse(count: float) -> None:
    t, _ = turning()
    steps = np.repeat(np.array([0.0, 0.5, 0.0, -0.5, 0.5, 0.2]), len(t) // 6)
    for sigma in (0.0, 1e-4, 1e-3):
        held = steps[: len(t), None] + np.random.default_rng(2).normal(0.0, sigma, (len(steps), 3))
        assert not clipping.clipped(t[: len(held)], np.rint(held / count) * count, np.inf)


@pytest.mark.parametrize(("level", "fatal"), [(0.1, True), (0.395, False)])
def test_long_clipping_is_no_gap_and_fails_where_nothing_tells_how_far_it_turned(level: float, fatal: bool) -> None:
    t, rate = turning()
    force = np.broadcast_to([0.0, 0.0, 9.81], rate.shape)
    log = prepare([recorded(t, np.clip(rate, -level, level), force)], Settings())
    (told,) = [w for w in log.warnings if w.code != "imu-axes-doubtful"]
    assert (told.code, told.fatal) == ("gyro-clipped", fatal)
    assert not len(log.gaps)


def test_five_samples_of_vibration_that_lie_level_by_chance_are_no_range() -> None:
    rng = np.random.default_rng(5)
    y = 15.0 * np.sin(0.05 * np.arange(1000)) + rng.normal(0.0, 0.2, 1000)
    y[500:507] = [23.85, 24.25, 24.27, 24.23, 24.21, 24.24, 23.38]  # a car's log
    values = np.stack([y, 0.1 * y, 0.2 * y], axis=1)
    assert not clipping.clipped(np.arange(1000) * 0.01, values, clipping.ACCEL_FLOOR)
    values[501:506, 0] = 24.27  # as the end of a range is
    (found,) = clipping.clipped(np.arange(1000) * 0.01, values, clipping.ACCEL_FLOOR)
    assert np.flatnonzero(found.rows).tolist() == [501, 502, 503, 504, 505]


def test_one_long_run_at_the_highest_value_is_stuck() -> None:
    t, rate = turning()
    rate[4000:4500, 1] = 0.6
    log = prepare([recorded(t, rate, np.broadcast_to([0.0, 0.0, 9.81], rate.shape))], Settings())
    assert "imu-stuck" in {w.code for w in log.warnings}
    assert "gyro-clipped" not in {w.code for w in log.warnings}
