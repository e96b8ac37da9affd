"""Stops are found, motions are not taken for stops, whatever the axes, rates, gaps and aids."""

from __future__ import annotations

import dataclasses
import itertools
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from attest_cli.errors import AttestError
from attest_cli.prepare import prepare
from attest_cli.readers import read
from attest_cli.records import Fixes, Imu, Log, Segment, Segmentation
from attest_cli.segment import find_segments
from attest_cli.segment.aids import read_stops, stops_that_move, wheels_turn
from attest_cli.segment.detector import as_segments, tidy
from attest_cli.segment.stillness import calm_spread, gap_edges, sensor_noise, window_moments
from attest_cli.settings import Settings
from attest_cli.simulate import RoverOptions, Simulation, simulate_rover

Floats = NDArray[np.float64]
DATA = Path(__file__).parents[3] / "shared" / "data"
SHORT: dict[str, Any] = {"motions": 3, "motion_s": (40.0, 80.0)}


def drive(seed: int, **options: Any) -> tuple[Simulation, Log, Settings]:
    simulation = simulate_rover(RoverOptions(seed=seed, sun=False, **{**SHORT, **options}))
    settings = Settings.model_validate(simulation.settings)
    return simulation, prepare([simulation.log], settings), settings


def with_stops(settings: Settings, **values: Any) -> Settings:
    return settings.model_copy(update={"stops": settings.stops.model_copy(update=values)})


def cut(log: Log, keep: NDArray[np.bool_], gaps: Floats | None = None) -> Log:
    imu = Imu(log.imu.t[keep], log.imu.gyro_b[keep], log.imu.accel_b[keep])
    gaps = np.empty((0, 2)) if gaps is None else gaps
    return dataclasses.replace(log, imu=imu, stamps_ns=log.stamps_ns[keep], gaps=gaps)


def still_log(seconds: float, seed: int = 0, rate_b: Floats | None = None) -> Log:
    """100 Hz of a level IMU at rest, turned about its up axis by ``rate_b`` (n,) rad/s if given."""
    rng, n = np.random.default_rng(seed), round(seconds * 100)
    gyro = np.array([0.003, -0.002, 0.004]) + rng.normal(0.0, 1.5e-3, (n, 3))
    accel = np.array([0.0, 0.0, 9.80665]) + rng.normal(0.0, 0.02, (n, 3))
    if rate_b is not None:
        gyro[:, 2] += rate_b
    t = np.asarray(np.arange(n) * 0.01, dtype=np.float64)
    stamps = np.arange(n, dtype=np.int64) * 10_000_000
    return Log((Path("still"),), 0, stamps, Imu(t, gyro, accel), {}, np.empty((0, 2)), {})


def edges_of(found: Segmentation) -> Floats:
    return np.array([(s.start, s.end) for s in found.stops]).reshape(-1, 2)


def assert_covers(found: Segmentation, log: Log) -> None:
    """Samples without holes or overlaps, increasing numbers of the right parity, used part inside."""
    assert found.segments[0].first == 0
    assert found.segments[-1].last == log.imu.t.size
    for a, b in itertools.pairwise(found.segments):
        assert a.last == b.first
        assert a.index < b.index
    for s in found.segments:
        assert s.index % 2 == (0 if s.motion else 1)
        assert s.start <= s.used_start < s.used_end <= s.end
        assert s.start == log.imu.t[s.first]
    assert found.statistic.shape == log.imu.t.shape


@pytest.mark.parametrize("variant", ["nominal", "slow", "idle-engine", "biased", "noisy"])
@pytest.mark.parametrize("seed", [200, 201])
def test_all_stops_no_false_ones_edges_within_a_second(variant: str, seed: int) -> None:
    simulation, log, settings = drive(seed, variant=variant)
    found = find_segments(log, settings)
    assert edges_of(found).shape == simulation.stops.shape
    assert np.abs(edges_of(found) - simulation.stops).max() < 1.0
    assert [s.index for s in found.segments] == [1, 2, 3, 4, 5, 6, 7]
    assert found.source == "imu"
    assert found.margin > 2.0
    assert_covers(found, log)
    used = np.zeros(log.imu.t.size, bool)
    for s in found.stops:
        used |= (log.imu.t >= s.used_start) & (log.imu.t <= s.used_end)
    assert not np.any(used & simulation.truth["moving"])  # what is used as a stop is one
    bias = np.array([simulation.truth[f"gyro_bias_{a}_rad_s"].mean() for a in "xyz"])
    assert np.linalg.norm(found.bias_b - bias) < 3e-4


def test_slow_drive_without_any_vibration_is_at_the_limit(capsys: pytest.CaptureFixture[str]) -> None:
    hits = false = total = 0
    for seed in (200, 201, 202):
        simulation, log, settings = drive(seed, variant="slow-no-vibration")
        found = edges_of(find_segments(log, settings))
        near = np.abs(found[:, None] - simulation.stops).max(axis=2) < 1.0
        hits, false, total = hits + int(near.any(axis=0).sum()), false + int((~near.any(axis=1)).sum()), total + 4
    with capsys.disabled():
        sys.stdout.write(f"\nslow without vibration: {hits}/{total} stops, {false} false\n")
    assert hits >= total - 2  # the note's detector finds 15 of 20
    assert false <= 2


@pytest.mark.parametrize("rate", [30.0, 286.0])
def test_other_rates_and_no_stated_noise(rate: float) -> None:
    simulation, log, _ = drive(203, rate_hz=rate)
    found = find_segments(log, Settings())
    assert np.abs(edges_of(found) - simulation.stops).max() < 1.0


def test_any_turn_of_the_axes_gives_the_same_segments() -> None:
    _, log, settings = drive(204, variant="slow")
    plain = find_segments(log, settings)
    for R in Rotation.random(3, rng=np.random.default_rng(1)).as_matrix():
        imu = Imu(log.imu.t, log.imu.gyro_b @ R.T, log.imu.accel_b @ R.T)
        turned = find_segments(dataclasses.replace(log, imu=imu), settings)
        assert turned.segments == plain.segments
        np.testing.assert_allclose(turned.bias_b, R @ plain.bias_b, atol=1e-12)


def test_drive_played_backwards_has_the_same_stops() -> None:
    _, log, settings = drive(205)
    t = log.imu.t[-1] - log.imu.t[::-1]
    back = find_segments(dataclasses.replace(log, imu=Imu(t, -log.imu.gyro_b[::-1], log.imu.accel_b[::-1])), settings)
    forth = log.imu.t[-1] - edges_of(find_segments(log, settings))[::-1, ::-1]
    assert np.abs(edges_of(back) - forth).max() < 0.1


def test_a_gyro_as_noisy_as_one_in_degrees_is_doubted_where_nothing_rests() -> None:
    _, log, settings = drive(206)
    shown = {}
    for times in (np.degrees(1.0), 30.0):
        louder = dataclasses.replace(log, imu=dataclasses.replace(log.imu, gyro_b=log.imu.gyro_b * times))
        shown[times] = [w.code for w in find_segments(louder, settings).warnings]
    assert shown == {np.degrees(1.0): ["no-stop", "unit-doubted"], 30.0: ["no-stop"]}


def test_log_without_a_stop_says_so() -> None:
    simulation, log, settings = drive(206)
    start, end = simulation.stops[0, 1] + 2.0, simulation.stops[1, 0] - 2.0
    inside = (log.imu.t > start) & (log.imu.t < end)
    for given in (settings, Settings()):
        found = find_segments(cut(log, inside), given)
        assert [s.index for s in found.segments] == [2]
        assert [w.code for w in found.warnings] == ["no-stop"]
        assert np.isnan(found.margin)


def test_log_that_starts_in_motion_starts_with_number_two() -> None:
    simulation, log, settings = drive(206)
    part = cut(log, log.imu.t > simulation.stops[0, 1] + 5.0)
    found = find_segments(part, settings)
    assert [s.index for s in found.segments] == [2, 3, 4, 5, 6, 7]
    assert_covers(found, part)


def test_log_at_rest_is_one_stop() -> None:
    found = find_segments(still_log(60.0), Settings())
    assert [(s.index, s.motion) for s in found.segments] == [(1, False)]
    assert found.warnings == ()


def test_smooth_turn_longer_than_all_stops_is_motion() -> None:
    t = np.arange(0.0, 200.0, 0.01)
    driving, turn = np.zeros(t.size), np.radians(0.3)
    for start, end in ((15.0, 30.0), (45.0, 60.0), (140.0, 160.0)):
        inside = (t > start) & (t < end)
        driving[inside] = 0.2 * np.sin(2.0 * (t[inside] - start))
    driving[(t > 75.0) & (t < 114.0)] = turn
    found = find_segments(still_log(200.0, rate_b=driving), Settings())
    assert not any(s.start < 110.0 and s.end > 80.0 for s in found.stops)
    assert [round(s.start) for s in found.stops] == [0, 30, 60, 114, 160]


@pytest.mark.parametrize(("bias", "codes"), [(0.05, []), (0.3, ["no-stop", "gyro-bias"])])
def test_a_bias_beyond_what_is_believed_is_asked_about(bias: float, codes: list[str]) -> None:
    log = still_log(30.0, rate_b=np.full(3000, bias))
    assert [w.code for w in find_segments(log, Settings()).warnings] == codes


def test_a_bias_beyond_what_is_stated_is_asked_about_however_little_that_is() -> None:
    imu = Settings().imu.model_copy(update={"gyro_bias_sigma": 1e-6})
    log = still_log(60.0, rate_b=np.full(6000, 0.01))
    found = find_segments(log, Settings().model_copy(update={"imu": imu}))
    assert [w.code for w in found.warnings] == ["no-stop", "gyro-bias"]


@pytest.mark.parametrize("sensor", ["gyro", "accelerometer"])
def test_where_nothing_is_as_calm_as_stated_the_noise_is_named(sensor: str) -> None:
    tiny = {"gyro_noise_density" if sensor == "gyro" else "accel_noise_density": 1e-7}
    given = Settings().model_copy(update={"imu": Settings().imu.model_copy(update=tiny)})
    found = find_segments(still_log(60.0), given)
    assert [w.code for w in found.warnings] == ["no-stop"]
    assert f"at its calmest the {sensor} is" in found.warnings[0].message
    assert not find_segments(still_log(60.0), Settings()).warnings


def test_a_stop_after_the_bias_has_moved_is_said() -> None:
    t = np.arange(0.0, 120.0, 0.01)
    driving = np.where((t > 20.0) & (t < 35.0) | (t > 60.0) & (t < 80.0), 0.2 * np.sin(2.0 * t), 0.0)
    sound = find_segments(still_log(120.0, rate_b=driving), Settings())
    assert [len(sound.stops), sound.warnings] == [3, ()]
    moved = find_segments(still_log(120.0, rate_b=driving + 0.01 * (t > 70.0)), Settings())
    assert "stop-bias" in [w.code for w in moved.warnings]


@pytest.mark.parametrize(("step", "fatal"), [(0.005, False), (0.02, True)])
def test_a_bias_that_jumps_about_a_level_axis_is_a_rest_by_gravity(step: float, fatal: bool) -> None:
    """Such a turn would have tilted gravity: it is no motion, however short the rest."""
    t = np.arange(0.0, 60.0, 0.01)
    driving = np.where((t > 20.0) & (t < 35.0) | (t > 40.0) & (t < 55.0), 0.2 * np.sin(2.0 * t), 0.0)
    log = still_log(60.0, rate_b=driving)
    log.imu.gyro_b[:, 0] += step * (t > 28.0)
    found = find_segments(log, Settings())
    assert [round(s.start) for s in found.stops] == [0, 36, 55]
    assert [(w.code, w.fatal) for w in found.warnings] == [("gyro-bias", fatal)]
    assert f"by {np.degrees(step):.2g} deg/s" in found.warnings[0].message


def test_gap_splits_segments() -> None:
    simulation, log, settings = drive(207)
    middle = simulation.stops[1].mean()
    moving = (simulation.stops[1, 1] + simulation.stops[2, 0]) / 2
    keep = (np.abs(log.imu.t - middle) > 1.0) & (np.abs(log.imu.t - moving) > 1.0)
    gaps = np.array([[middle - 1.0, middle + 1.0], [moving - 1.0, moving + 1.0]])
    part = cut(log, keep, gaps)
    found = find_segments(part, settings)
    assert_covers(found, part)
    assert [s.index for s in found.segments] == [1, 2, 3, 5, 6, 8, 9, 10, 11]
    for start, end in gaps:
        assert not any(s.start < start + 0.5 and s.end > end - 0.5 for s in found.segments)
    (start, end), halves = simulation.stops[1], edges_of(found)[[1, 2]]
    assert np.abs(halves - [[start, middle - 1.0], [middle + 1.0, end]]).max() < 1.0


def test_short_motions_are_filled_before_short_stops_are_dropped() -> None:
    t = np.arange(0.0, 10.0, 0.1)
    still = (t > 2.0) & (t < 5.0) & (np.abs(t - 3.5) > 0.12)  # 3 s with a bump of 0.2 s
    still |= (t > 7.0) & (t < 8.0)  # 1 s only
    tidied = tidy(still, t, np.array([0, t.size]), 2.0, 0.5)
    np.testing.assert_array_equal(tidied, (t > 2.0) & (t < 5.0))
    segments = as_segments(tidied, t, np.array([0, t.size]), 0.5)
    assert [(s.index, s.motion) for s in segments] == [(2, True), (3, False), (4, True)]


def test_stops_given_by_hand_override_the_detector(tmp_path: Path) -> None:
    _, log, settings = drive(208)
    path = tmp_path / "stops.csv"
    path.write_text("start_s, end_s\n20, 30.5\n1,8\n")
    found = find_segments(log, with_stops(settings, file=path))
    np.testing.assert_allclose(edges_of(found), [[1.0, 8.01], [20.0, 30.51]], atol=0.011)
    assert found.source == "file"
    assert_covers(found, log)


def test_a_stop_given_by_hand_that_turns_is_told(tmp_path: Path) -> None:
    _, log, settings = drive(208)
    true = edges_of(find_segments(log, settings))
    path = tmp_path / "stops.csv"
    late = true[1] + 0.5 * (true[2, 0] - true[1, 1])  # in the midst of a motion
    path.write_text("start_s,end_s\n" + "".join(f"{a},{b}\n" for a, b in (true[0], late, true[2])))
    told = find_segments(log, with_stops(settings, file=path)).warnings
    assert [(w.code, w.fatal) for w in told] == [("stop-moves", True)]
    assert told[0].message.startswith("1 of the 3 stops given by hand turn")
    path.write_text("start_s,end_s\n" + "".join(f"{a - 0.2},{b + 0.2}\n" for a, b in true[1:-1]))
    assert find_segments(log, with_stops(settings, file=path)).warnings == ()


def test_a_hole_in_a_stop_given_by_hand_turns_nothing(rng: np.random.Generator) -> None:
    t = np.arange(0.0, 40.0, 0.01)
    t = t[(t < 10.0) | (t > 26.5)]
    stop = Segment(index=1, motion=False, start=0.0, end=40.0, first=0, last=len(t), used_start=0.5, used_end=39.5)
    for _ in range(20):
        imu = Imu(t, rng.normal(0.0, 3e-3, (len(t), 3)), np.tile([0.0, 0.0, 9.8], (len(t), 1)))
        assert stops_that_move(imu, [stop]) == ()
    imu.gyro_b[1500:1600, 2] += np.radians(5.0)  # a turn beside the hole is one
    assert [w.code for w in stops_that_move(imu, [stop])] == ["stop-moves"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no stops in it"),
        ("start_s,end_s\n", "no stops in it"),
        ("start,end\n1,2\n", "no column 'start_s'"),
        ("start_s,end_s\n1,two\n", "line 2 is not two numbers"),
        ("start_s,end_s\n1\n", "line 2 is not two numbers"),
        ("start_s,end_s\n1,2\n9,8\n", "line 3: no stop"),
        ("start_s,end_s\nnan,8\n", "line 2: no stop"),
        ("start_s,end_s\n200,300\n", "the log spans 0.00 to 100.00 s"),
        ("start_s,end_s\n1,5\n4,8\n", "overlap"),
        ("start_s,end_s\n\x00\x01,\xff\n", "line 2"),
    ],
)
def test_faults_of_the_stop_file_are_told_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "stops.csv"
    path.write_text(text)
    with pytest.raises(AttestError) as fault:
        read_stops(path, 0.0, 100.0)
    assert message in str(fault.value)
    assert "\n" not in str(fault.value)
    assert str(path) in str(fault.value)


def test_missing_or_binary_stop_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(AttestError, match="No such file"):
        read_stops(tmp_path / "none.csv", 0.0, 1.0)
    (tmp_path / "image.csv").write_bytes(b"\x89PNG\xff\xfe")
    with pytest.raises(AttestError, match="not a CSV file"):
        read_stops(tmp_path / "image.csv", 0.0, 1.0)


def test_user_threshold_is_kept() -> None:
    _, log, settings = drive(208)
    found = find_segments(log, with_stops(settings, enter=20.0, leave_factor=3.0))
    assert (found.enter, found.leave) == (20.0, 60.0)


def coast(lag: float = 0.0, absent: tuple[float, float] = (0.0, 0.0)) -> tuple[Log, Floats]:
    """Rest, drive, then 30 s of straight smooth driving that an IMU cannot see, drive, rest; with wheel odometry."""
    t = np.arange(0.0, 120.0, 0.01)
    shaken = ((t > 20.0) & (t < 40.0)) | ((t > 70.0) & (t < 100.0))
    log = still_log(120.0, rate_b=np.where(shaken, 0.1 * np.sin(5.0 * t), 0.0))
    t_o = np.arange(0.0, 120.0, 0.1)
    speed = np.where((t_o - lag > 20.0) & (t_o - lag < 100.0), 0.3, 0.0)
    values = np.column_stack([speed, np.full((t_o.size, 2), np.nan)])
    there = (t_o < absent[0]) | (t_o >= absent[1])
    odometry = Fixes("odometry", "/odom", t_o[there], values[there])
    return dataclasses.replace(log, fixes={"odometry": odometry}), np.array([[0.0, 20.0], [100.0, 120.0]])


@pytest.mark.parametrize("lag", [0.0, 0.4, -0.4])
def test_odometry_tells_smooth_driving_from_a_stop(lag: float) -> None:
    log, true = coast(lag)
    found = find_segments(log, Settings())
    assert found.source == "odometry"
    assert np.abs(edges_of(found) - true).max() < 1.0
    blind = find_segments(log, with_stops(Settings(), use_odometry=False))
    assert len(blind.stops) == 3
    assert blind.source == "imu"


def test_odometry_says_nothing_where_it_is_absent() -> None:
    log, _ = coast(absent=(35.0, 75.0))
    assert len(find_segments(log, Settings()).stops) == 3


def test_odometry_at_zero_makes_no_stop_where_the_imu_moves() -> None:
    _, log, settings = drive(209)
    t = np.arange(0.0, log.imu.t[-1], 0.1)
    odometry = Fixes("odometry", "/odom", t, np.zeros((t.size, 3)))
    parked = find_segments(dataclasses.replace(log, fixes={"odometry": odometry}), settings)
    assert parked.segments == find_segments(log, settings).segments


def test_noisy_odometry_at_rest_is_not_motion() -> None:
    simulation, log, settings = drive(210, odometry=True)
    turning = wheels_turn(log.fixes["odometry"], log.imu.t)
    assert not turning[~simulation.truth["moving"]].any()
    assert turning[simulation.truth["moving"]].mean() > 0.8
    assert np.abs(edges_of(find_segments(log, settings)) - simulation.stops).max() < 1.0


def test_noise_is_stated_or_the_logs_own() -> None:
    _, log, settings = drive(211)
    windows = window_moments(log.imu, gap_edges(log.imu.t, log.gaps), 1.0)
    np.testing.assert_allclose(sensor_noise(windows, log.imu.t, settings), (1.5e-3, 0.02), rtol=1e-6)
    np.testing.assert_allclose(sensor_noise(windows, log.imu.t, Settings()), (1.5e-3, 0.02), rtol=0.03)


def test_choice_of_the_calmest_windows_does_not_bias_the_noise() -> None:
    rng = np.random.default_rng(5)
    still = rng.chisquare(3 * 99, 300) / 100.0
    mixed = np.concatenate([still, rng.uniform(5.0, 500.0, 3000)])
    assert abs(calm_spread(mixed, 100) / 3.0 - 1.0) < 0.02
    assert np.quantile(still, 0.01) / 3.0 < 0.9  # what a low quantile alone would have said


def test_window_moments_agree_with_numpy() -> None:
    log = still_log(5.0, seed=3)
    windows = window_moments(log.imu, np.array([0, 200, 500]), 1.0)
    low = int(windows.first[30]) - 50
    part = log.imu.accel_b[low : low + 100]
    np.testing.assert_allclose(windows.mean_accel[30], part.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(windows.spread_accel[30], part.var(axis=0).sum(), rtol=1e-9)
    assert windows.first[-1] == 500
    assert np.any(windows.first == 200)  # no window reaches across the gap
    np.testing.assert_allclose(windows.mean_gyro[39], log.imu.gyro_b[100:200].mean(axis=0), rtol=1e-12)


@pytest.mark.parametrize("samples", [1, 2, 5, 60])
def test_shortest_logs_do_not_fail(samples: int) -> None:
    log = still_log(1.0)
    found = find_segments(cut(log, np.arange(100) < samples), Settings())
    assert sum(s.last - s.first for s in found.segments) == samples


def test_broad_rests_and_movements() -> None:
    folder = DATA / "broad"
    if not folder.is_dir():
        pytest.skip("real data (broad) is not beside the repository")
    import pyarrow.parquet as pq

    for path in sorted(folder.glob("*.parquet")):
        table = pq.read_table(path)
        columns = {name: np.asarray(table[name]) for name in table.column_names}
        gyro, accel = (np.column_stack([columns[f"{s}_{a}"] for a in "xyz"]).astype(float) for s in ("gyr", "acc"))
        t = columns["t"].astype(float)
        log = Log((path,), 0, np.round(t * 1e9).astype(np.int64), Imu(t, gyro, accel), {}, np.empty((0, 2)), {})
        found = find_segments(log, Settings())
        still = np.zeros(t.size, bool)
        for s in found.stops:
            still[s.first : s.last] = True
        moving = columns["movement"].astype(bool)
        assert np.mean(still[moving]) < 0.001, path.stem
        assert np.mean(still[~moving]) > 0.8, path.stem


def test_husky_stops_where_its_wheels_stop() -> None:
    path = DATA / "logs" / "derived_mcap" / "test1_ros2_zstd.mcap"
    if not path.is_file():
        pytest.skip("real data (Husky) is not beside the repository")
    log = prepare([read(path, Settings())], Settings())
    found = find_segments(log, Settings())
    odometry = log.fixes["odometry"]
    at_rest = odometry.t[np.abs(odometry.values[:, 0]) < 0.005]
    rest = at_rest[(at_rest > 200.0) & (at_rest < 300.0)]
    assert len(found.stops) == 1  # the only rest of more than two seconds
    assert rest.min() - 0.5 < found.stops[0].start < rest.min() + 2.0
    assert rest.max() - 2.0 < found.stops[0].end < rest.max() + 0.5
    assert_covers(found, log)
