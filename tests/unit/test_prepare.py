"""Recordings to one log: roles, several files, faults of rows and clocks, windows, mounting, fixes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from attest_cli.errors import AttestError
from attest_cli.prepare import prepare
from attest_cli.records import COLUMNS, Array, Channel, Ints, Log, Recording, Warn
from attest_cli.settings import Settings

T0 = 1_780_308_000_000_000_123
UNITS = {name: "rad/s" if name.startswith("gyro") else "m/s^2" for name in COLUMNS["imu"]}


def imu(n: int = 1000, name: str = "/imu/data", start_ns: int = T0, seed: int = 1) -> Channel:
    rng = np.random.default_rng(seed)
    values = {key: rng.normal(9.8 if key == "accel_z" else 0.0, 0.05, n) for key in COLUMNS["imu"]}
    return Channel(name, "sensor_msgs/msg/Imu", "imu", start_ns + np.arange(n) * 10_000_000, values, UNITS)


def half(whole: Channel, role: str, stamps_ns: Ints | None = None, **values: Array) -> Channel:
    held = {key: values.get(key, whole.values[key]) for key in COLUMNS[role]}
    return Channel(f"/imu/{role}", "columns", role, whole.stamps_ns if stamps_ns is None else stamps_ns, held, UNITS)


def fixes(
    role: str, t: Array | list[float], values: Any, units: dict[str, str] | None = None, name: str = ""
) -> Channel:
    table = np.asarray(values, dtype=np.float64)
    stamps_ns = T0 + np.rint(np.asarray(t) * 1e9).astype(np.int64)
    return Channel(
        name or f"/{role}",
        "columns",
        role,
        stamps_ns,
        {k: table[:, j] for j, k in enumerate(COLUMNS[role][: table.shape[1]])},
        units or {},
    )


def recording(*channels: Channel, name: str = "log.csv", other: dict[str, str] | None = None) -> Recording:
    return Recording(Path(name), "csv", channels, sum(c.stamps_ns.size for c in channels), other or {})


def log_of(*channels: Channel, **settings: Any) -> Log:
    return prepare([recording(*channels)], Settings.model_validate(settings))


def codes(log: Log) -> list[str]:
    return [warning.code for warning in log.warnings]


def test_a_clean_log_comes_through_untouched_and_without_a_warning() -> None:
    channel = imu()
    log = log_of(channel)
    assert log.t0_ns == T0
    np.testing.assert_array_equal(log.stamps_ns, channel.stamps_ns)
    np.testing.assert_array_equal(log.imu.t, np.arange(1000) * 10_000_000 * 1e-9)
    np.testing.assert_array_equal(log.imu.gyro_b[:, 1], channel.values["gyro_y"])
    assert log.coverage == {
        "rows_in": 1000,
        "rows_used": 1000,
        "rows_dropped": 0,
        "seconds_in": pytest.approx(9.99),
        "seconds_used": pytest.approx(9.99),
    }
    assert log.warnings == ()
    assert log.gaps.shape == (0, 2)
    assert log.history == ("imu: /imu/data (sensor_msgs/msg/Imu), 1000 of 1000",)


@pytest.mark.parametrize(
    ("role", "columns"),
    [("sun", 3), ("magnetometer", 3), ("compass", 1), ("orientation", 4), ("odometry", 3), ("gps", 3), ("position", 3),
     ("height", 1), ("temperature", 1), ("gps_velocity", 3)],
)  # fmt: skip
@pytest.mark.parametrize("value", [1e300, -1e20, np.inf, np.nan])
def test_damaged_numbers_of_a_sensor_are_left_out_in_one_line(role: str, columns: int, value: float) -> None:
    rng = np.random.default_rng(3)
    table = 0.5 + rng.normal(0.0, 0.01, (200, columns))
    table[50:60, -1] = value
    log = log_of(
        imu(), fixes(role, np.arange(200) * 0.05, table), map={"orientation": "/orientation"} if columns == 4 else {}
    )
    told = [warning for warning in log.warnings if role in warning.code]
    if role in {"gps", "position", "odometry", "gps_velocity"}:  # the other axes are measured
        assert [w.code for w in told if w.code != "gps-coarse"] == (
            [f"{role}-out-of-range"] if abs(value) > 1e12 else []
        )
    else:
        assert [w.code for w in told] == [f"{role}-dropped"]
        assert told[0].message.startswith(f"10 of 200 measurements of /{role}")
    assert not np.any(np.abs(log.fixes[role].values) > 1e12)


@pytest.mark.parametrize("unknown", [np.nan, 0.0, -1.0])
def test_a_sigma_that_is_unknown_in_every_row_is_none(unknown: float) -> None:
    column = {"latitude": np.full(100, 46.5), "longitude": np.full(100, 6.6), "gps_sigma_m": np.full(100, unknown)}
    column["longitude"] = 6.6 + np.arange(100) * 1e-5
    channel = Channel("/gps", "columns", "gps", T0 + np.arange(100) * 100_000_000, column, {})
    assert log_of(imu(), channel).fixes["gps"].sigma is None


class TestSpikes:
    @pytest.mark.parametrize(("column", "value"), [("accel_x", 1e6), ("accel_z", -60.0), ("gyro_y", 30.0)])
    def test_a_sample_far_out_is_dropped_counted_and_told(self, column: str, value: float) -> None:
        channel = imu()
        channel.values[column][[0, 400, 402]] = value
        log = log_of(channel)
        (warning,) = log.warnings
        assert warning.code == "imu-spikes"
        assert "/imu/data: 3 of 1000 rows dropped" in warning.message
        assert "the first at 0.00 s" in warning.message
        assert (log.coverage["rows_used"], log.coverage["rows_dropped"]) == (997, 3)
        assert T0 + 4_000_000_000 not in log.stamps_ns
        assert np.abs(log.imu.gyro_b).max() < 1.0
        assert np.abs(log.imu.accel_b).max() < 11.0

    def test_rows_of_zeros_are_dropped_under_a_name_of_their_own(self) -> None:
        channel = imu()
        for values in channel.values.values():
            values[[100, 300, 301]] = 0.0
        log = log_of(channel)
        (warning,) = log.warnings
        assert (warning.code, log.coverage["rows_dropped"]) == ("imu-zero-rows", 3)
        assert "/imu/data: 3 of 1000 rows dropped: all values are zero" in warning.message

    def test_a_spike_of_a_slow_accelerometer_is_not_spread_over_the_gyro(self) -> None:
        whole = imu()
        slow = half(imu(250, start_ns=T0), "accel", T0 + np.arange(250) * 40_000_000)
        slow.values["accel_y"][100] = 500.0
        log = log_of(half(whole, "gyro"), slow)
        assert "/imu/accel: 1 of 250 rows dropped" in next(w.message for w in log.warnings if w.code == "imu-spikes")
        assert np.abs(log.imu.accel_b[:, 1]).max() < 1.0


class TestRoles:
    def test_the_imu_with_most_rows_is_taken_and_both_are_named(self) -> None:
        log = log_of(imu(500, "/a"), imu(1000, "/b"), imu(1000, "/c"))
        assert log.imu.t.size == 1000
        (warning,) = log.warnings
        assert warning.code == "several-channels"
        assert all(name in warning.message for name in ("/a", "/b", "/c"))
        assert "/b is used" in warning.message

    def test_settings_choose_the_imu_in_silence(self) -> None:
        log = log_of(imu(500, "/a"), imu(1000, "/b"), imu={"channel": "/a"})
        assert log.imu.t.size == 500
        assert log.warnings == ()

    def test_the_sensor_beside_the_imu_is_taken(self) -> None:
        near = fixes(
            "magnetometer",
            [1.0, 2.0],
            [[2e-5, 0, -4e-5]] * 2,
            dict.fromkeys(COLUMNS["magnetometer"], "T"),
            "/front/mag",
        )
        far = fixes(
            "magnetometer",
            [1.0, 2.0, 3.0],
            [[4e-5, 0, 0]] * 3,
            dict.fromkeys(COLUMNS["magnetometer"], "T"),
            "/rear/mag",
        )
        assert log_of(imu(name="/front/imu"), far, near).fixes["magnetometer"].channel == "/front/mag"

    def test_an_unknown_name_is_refused_with_the_nearest(self) -> None:
        with pytest.raises(AttestError, match="no channel '/imu/dta'") as refused:
            log_of(imu(), imu={"channel": "/imu/dta"})
        assert "/imu/data" in refused.value.hint

    def test_a_channel_of_an_unread_kind_is_named_as_such(self) -> None:
        with pytest.raises(AttestError, match="json"):
            prepare(
                [recording(imu(), other={"/sun_json": "Sun (json)"})],
                Settings.model_validate({"map": {"sun": "/sun_json"}}),
            )

    def test_a_file_of_which_nothing_is_read_is_named(self) -> None:
        log = prepare([recording(imu()), recording(name="camera.mcap", other={"/c": "Image (cdr)"})], Settings())
        (warning,) = log.warnings
        assert warning.code == "file-not-used"
        assert warning.message == "camera.mcap: no channel that attest reads; found /c Image (cdr)"

    def test_imus_in_files_of_one_name_can_be_told_apart(self) -> None:
        files = [recording(imu(seed=k), name=f"{folder}/drive.csv") for k, folder in enumerate("ab")]
        (warning,) = prepare(files, Settings()).warnings
        assert all(name in warning.message for name in ("a/drive.csv:/imu/data", "b/drive.csv:/imu/data"))
        named = prepare(files, Settings.model_validate({"imu": {"channel": "b/drive.csv:/imu/data"}}))
        np.testing.assert_array_equal(named.imu.gyro_b[:, 0], files[1].channels[0].values["gyro_x"])
        assert named.warnings == ()

    def test_a_bare_vector_plays_the_role_it_is_mapped_to(self) -> None:
        wind = Channel(
            "/dir",
            "geometry_msgs/msg/Vector3Stamped",
            "",
            T0 + np.arange(1, 4) * 10**9,
            {k: np.array([0.0, 3.0, 4.0]) + (k == "z") for k in "xyz"},
        )
        assert log_of(imu(), wind).fixes == {}
        np.testing.assert_allclose(
            np.linalg.norm(log_of(imu(), wind, map={"sun": "/dir"}).fixes["sun"].values, axis=1), 1.0
        )

    def test_a_channel_that_cannot_play_a_role_is_refused(self) -> None:
        with pytest.raises(AttestError, match="cannot be the sun"):
            log_of(imu(), map={"sun": "/imu/data"})

    def test_orientation_counts_only_where_it_is_mapped(self) -> None:
        q = fixes("orientation", [1.0, 2.0], [[1, 0, 0, 0], [0, 0, 0, 2]], name="/imu/data#orientation")
        device = Channel(q.name, q.kind, "", q.stamps_ns, q.values)
        assert log_of(imu(), device).fixes == {}
        assert log_of(imu(), q).fixes == {}
        mapped = log_of(imu(), device, map={"orientation": "/imu/data"})
        np.testing.assert_array_equal(mapped.fixes["orientation"].values, [[1, 0, 0, 0], [0, 0, 0, 1]])

    @pytest.mark.parametrize(
        ("channels", "says"),
        [
            ((fixes("sun", [1.0], [[0, 0, 1]]),), r"no IMU; found /sun \(sun\)"),
            ((half(imu(), "gyro"),), "no accelerometer beside /imu/gyro"),
            ((half(imu(), "accel"),), "no gyro beside /imu/accel"),
            ((), "no channel that attest reads; found no channel at all"),
        ],
    )
    def test_without_an_imu_the_log_is_refused(self, channels: tuple[Channel, ...], says: str) -> None:
        with pytest.raises(AttestError, match=says):
            log_of(*channels)


class TestFiles:
    def test_parts_of_one_drive_are_joined_in_any_order(self) -> None:
        whole = imu(1000)
        parts = [
            recording(
                Channel(
                    "imu", "columns", "imu", whole.stamps_ns[rows], {k: v[rows] for k, v in whole.values.items()}, UNITS
                ),
                name=name,
            )
            for name, rows in (("b.csv", slice(500, None)), ("a.csv", slice(0, 500)))
        ]
        log = prepare(parts, Settings())
        np.testing.assert_array_equal(log.stamps_ns, whole.stamps_ns)
        np.testing.assert_array_equal(log.imu.accel_b[:, 2], whole.values["accel_z"])
        assert log.warnings == ()

    @pytest.mark.parametrize("changed", [0.0, 1e-9])
    def test_files_that_share_rows_are_joined_if_those_are_the_same(self, changed: float) -> None:
        """Cut with an overlap: nothing is lost, and nothing counts twice. Two IMUs differ in the same time."""
        whole = imu(1000)
        parts = [
            recording(
                Channel(
                    "imu",
                    "columns",
                    "imu",
                    whole.stamps_ns[rows],
                    {k: v[rows] + more for k, v in whole.values.items()},
                    UNITS,
                ),
                name=name,
            )
            for name, rows, more in (("b.csv", slice(400, None), changed), ("a.csv", slice(0, 600), 0.0))
        ]
        log = prepare(parts, Settings())
        if changed:
            assert codes(log) == ["several-channels"]
        else:
            np.testing.assert_array_equal(log.stamps_ns, whole.stamps_ns)
            np.testing.assert_array_equal(log.imu.accel_b[:, 2], whole.values["accel_z"])
            assert log.warnings == ()

    def test_a_sensor_is_taken_from_the_file_of_the_imu(self) -> None:
        files = [
            [recording(imu(name="imu", seed=seed), name=f"{name}.csv"),
             recording(fixes("sun", [1.0, 2.0, 3.0][:n], [[0, 0.1 * n, 0.8]] * n), name=f"{name}.csv")]
            for name, seed, n in (("left", 1, 2), ("right", 2, 3))
        ]  # fmt: skip
        both = [replace(imu_part, channels=(*imu_part.channels, *sun.channels)) for imu_part, sun in files]
        log = prepare(both, Settings.model_validate({"imu": {"channel": "left:imu"}}))
        assert len(log.fixes["sun"].t) == 2

    def test_sensors_in_files_of_their_own_are_one_log(self) -> None:
        log = prepare(
            [recording(imu()), recording(fixes("sun", [1.0, 2.0], [[0, 0.6, 0.8], [0, 0.8, 0.6]]), name="sun.csv")],
            Settings(),
        )
        assert log.fixes["sun"].t.tolist() == [1.0, 2.0]
        assert log.sources == (Path("log.csv"), Path("sun.csv"))

    def test_two_imus_that_overlap_are_never_mixed(self) -> None:
        log = prepare(
            [recording(imu(name="imu"), name="left.csv"), recording(imu(name="imu", seed=2), name="right.csv")],
            Settings(),
        )
        assert log.imu.t.size == 1000
        assert codes(log) == ["several-channels"]
        chosen = prepare(
            [recording(imu(name="imu"), name="left.csv"), recording(imu(name="imu", seed=2), name="right.csv")],
            Settings.model_validate({"imu": {"channel": "right:imu"}}),
        )
        np.testing.assert_array_equal(chosen.imu.gyro_b[:, 0], imu(seed=2).values["gyro_x"])


class TestHalves:
    def test_the_accelerometer_is_interpolated_onto_the_gyro(self) -> None:
        whole = imu()
        stamps_ns = whole.stamps_ns + 3_000_000
        ramp = np.linspace(9.0, 10.0, 1000)
        log = log_of(half(whole, "gyro"), half(whole, "accel", stamps_ns, accel_z=ramp))
        assert log.imu.t.size == 999  # the first gyro row is before the accelerometer
        np.testing.assert_array_equal(log.stamps_ns, whole.stamps_ns[1:])
        np.testing.assert_allclose(log.imu.accel_b[:, 2], np.interp(whole.stamps_ns[1:], stamps_ns, ramp))
        assert log.warnings == ()
        assert log.coverage["rows_dropped"] == 1

    def test_nothing_is_interpolated_across_a_hole(self) -> None:
        whole = imu()
        keep = np.r_[0:300, 500:1000]
        accel = half(whole, "accel", whole.stamps_ns[keep], **{k: whole.values[k][keep] for k in COLUMNS["accel"]})
        log = log_of(half(whole, "gyro"), accel)
        assert codes(log) == ["imu-half-missing", "imu-gap"]
        assert log.imu.t.size == 800
        np.testing.assert_allclose(log.gaps, [[2.99, 5.0]])

    def test_halves_on_different_clocks_are_refused(self) -> None:
        whole = imu()
        with pytest.raises(AttestError, match="do not overlap"):
            log_of(half(whole, "gyro"), half(whole, "accel", whole.stamps_ns - T0))


class TestRows:
    def test_rows_that_are_not_finite_are_dropped_and_counted_by_column(self) -> None:
        channel = imu()
        channel.values["gyro_x"][[3, 4]] = np.nan
        channel.values["accel_z"][[4, 9]] = np.inf
        log = log_of(channel)
        assert log.coverage["rows_used"] == 997
        (warning,) = log.warnings
        assert warning.code == "imu-not-finite"
        assert "3 of 1000" in warning.message
        assert "gyro_x 2, accel_z 2" in warning.message

    def test_an_empty_column_is_refused(self) -> None:
        channel = imu()
        channel.values["gyro_z"][:] = np.nan
        with pytest.raises(AttestError, match="column gyro_z of /imu/data is empty"):
            log_of(channel)

    @pytest.mark.parametrize(("n", "step_ns"), [(49, 100_000_000), (150, 10_000_000), (1, 1), (0, 1)])
    def test_too_little_is_refused_with_the_minimum(self, n: int, step_ns: int) -> None:
        channel = imu(n)
        short = Channel("imu", "columns", "imu", T0 + np.arange(n) * step_ns, channel.values, UNITS)
        with pytest.raises(AttestError) as refused:
            log_of(short)
        if n:
            assert f"only {n} usable IMU rows" in refused.value.message
            assert "at least 50 rows and 2 s" in refused.value.hint

    @pytest.mark.parametrize("step_ns", [50_000, 1_500_000_000])
    def test_a_rate_that_no_imu_has_is_refused(self, step_ns: int) -> None:
        channel = imu(50_000)
        channel.stamps_ns[:] = T0 + np.arange(50_000) * step_ns
        with pytest.raises(AttestError, match="no IMU runs at that rate"):
            log_of(channel)

    @pytest.mark.parametrize("sentinel", [-999.0, -9999.0, 32767.0])
    def test_a_number_that_stands_for_none_is_not_measured(self, sentinel: float) -> None:
        channel = imu()
        channel.values["gyro_y"][::20] = sentinel
        log = log_of(channel)
        (warning,) = [w for w in log.warnings if w.code == "imu-not-finite"]
        assert "gyro_y 50" in warning.message
        assert f"{sentinel:.0f} stands for no measurement" in warning.message
        assert log.imu.t.size == 950
        assert np.abs(log.imu.gyro_b).max() < 1.0
        assert channel.values["gyro_y"][0] == sentinel  # the recording is left as it is

    @pytest.mark.parametrize(("share", "said"), [(0.002, []), (0.05, ["imu-rows-missing"])])
    def test_rows_lost_one_by_one_are_told(self, share: float, said: list[str]) -> None:
        whole = imu(5000)
        keep = np.random.default_rng(2).random(5000) > share
        values = {key: column[keep] for key, column in whole.values.items()}
        assert codes(log_of(replace(whole, stamps_ns=whole.stamps_ns[keep], values=values))) == said

    def test_rows_dropped_for_a_cause_that_is_told_are_not_missing_too(self) -> None:
        channel = imu()
        channel.values["accel_x"][::20] = np.nan
        assert codes(log_of(channel)) == ["imu-not-finite"]

    def test_a_log_that_begins_at_its_end_is_named(self) -> None:
        channel = imu()
        channel.stamps_ns[:] = channel.stamps_ns[::-1].copy()
        with pytest.raises(AttestError, match="in reverse order"):
            log_of(channel)

    def test_the_scale_of_the_accelerometer_is_not_told_by_rows_that_are_stuck(self) -> None:
        channel = imu()
        for column in channel.values.values():
            column[500:700] = 0.0
        assert codes(log_of(channel)) == ["imu-stuck", "imu-gap"]

    def test_swapped_and_repeated_rows_equal_the_clean_log(self) -> None:
        clean = imu()
        rows = np.sort(np.r_[np.arange(1000), 17, 17, 400])
        rows[[0, 1]] = rows[[1, 0]]  # the very first rows too
        rows[[600, 601]] = rows[[601, 600]]
        log = log_of(
            Channel(
                clean.name,
                clean.kind,
                "imu",
                clean.stamps_ns[rows],
                {k: v[rows] for k, v in clean.values.items()},
                UNITS,
            )
        )
        expected = log_of(clean)
        assert log.t0_ns == expected.t0_ns
        np.testing.assert_array_equal(log.stamps_ns, expected.stamps_ns)
        np.testing.assert_array_equal(log.imu.gyro_b, expected.imu.gyro_b)
        assert codes(log) == ["rows-out-of-order", "duplicate-rows"]

    def test_a_step_back_names_the_file_and_the_window_is_a_way_out(self) -> None:
        channel = imu()
        channel.stamps_ns[700:] -= 2_000_000_000
        with pytest.raises(AttestError, match=r"log\.csv: /imu/data: the clock steps back by 1\.990 s at 6\.990 s"):
            log_of(channel)
        assert log_of(channel, time={"end_s": 6.99}).imu.t[-1] == pytest.approx(6.99)

    def test_a_gap_is_listed_with_start_and_length_and_is_not_used_time(self) -> None:
        channel = imu()
        channel.stamps_ns[400:] += 3_600_000_000_000
        log = log_of(channel)
        np.testing.assert_allclose(log.gaps, [[3.99, 3604.0]])
        assert codes(log) == ["imu-gap"]
        assert "3600.01 s from 3.99 s" in log.warnings[0].message
        assert log.coverage["seconds_used"] == pytest.approx(9.98)
        assert log.imu.t.size == 1000  # nothing is filled in


class TestWindowAndAxes:
    def test_a_window_keeps_the_time_of_the_log(self) -> None:
        log = log_of(imu(), time={"start_s": 2.0, "end_s": 7.0})
        assert log.t0_ns == T0
        assert (log.imu.t[0], log.imu.t[-1]) == (2.0, 7.0)
        assert log.coverage["rows_in"] == 501
        assert log.coverage["rows_dropped"] == 0

    def test_fixes_outside_a_window_are_no_loss(self) -> None:
        sun = fixes("sun", np.arange(10.0), np.random.default_rng(3).normal(size=(10, 3)))
        log = log_of(imu(), sun, time={"start_s": 2.0, "end_s": 7.0})
        assert log.fixes["sun"].t.tolist() == [2.0, 3.0, 4.0, 5.0, 6.0, 7.0]
        assert log.warnings == ()

    def test_a_window_beyond_the_log_is_refused(self) -> None:
        with pytest.raises(AttestError, match=r"lies outside the log, which has 0 to 9\.99 s"):
            log_of(imu(), time={"start_s": 100.0})

    def test_the_mounting_turns_imu_and_magnetometer_into_the_body(self) -> None:
        half_turn = np.sqrt(0.5)
        mag = fixes("magnetometer", [1.0], [[2e-5, 0, 0]], dict.fromkeys(COLUMNS["magnetometer"], "T"))
        log = log_of(imu(), mag, imu={"mounting": [half_turn, half_turn, 0, 0]})  # 90 degrees about x: y -> z, z -> -y
        plain = log_of(imu())
        np.testing.assert_allclose(log.imu.accel_b[:, 1], -plain.imu.accel_b[:, 2], atol=1e-12)
        np.testing.assert_allclose(log.imu.gyro_b[:, 2], plain.imu.gyro_b[:, 1], atol=1e-12)
        np.testing.assert_allclose(log.fixes["magnetometer"].values, [[2e-5, 0, 0]])


class TestFixes:
    def test_sun_vectors_are_unit_and_zero_is_no_measurement(self) -> None:
        log = log_of(imu(), fixes("sun", [1, 2, 3, 4], [[0, 3, 4], [0, 0, 0], [1, 1, np.nan], [2, 0, 0]]))
        np.testing.assert_allclose(log.fixes["sun"].values, [[0, 0.6, 0.8], [1, 0, 0]])
        (warning,) = log.warnings
        assert warning.code == "sun-dropped"
        assert "2 of 4" in warning.message

    def test_a_two_dimensional_sun_sensor_keeps_its_components(self) -> None:
        plane = log_of(imu(), fixes("sun", [1, 2], [[0.1, -0.7], [0.2, 0.3]])).fixes["sun"].values
        np.testing.assert_array_equal(plane, [[0.1, -0.7], [0.2, 0.3]])
        cut = log_of(imu(), fixes("sun", [1], [[0, 3, 4]]), sun={"components": 2}).fixes["sun"].values
        np.testing.assert_allclose(cut, [[0, 0.6]])

    def test_each_role_comes_in_the_units_of_fixes(self) -> None:
        log = log_of(
            imu(),
            fixes("compass", [1, 2], [[90.0], [271.0]], {"compass_deg": "deg"}),
            fixes("gps", [1], [[46.5, 6.6, 400.0]], {"latitude": "deg", "longitude": "deg", "altitude": "m"}),
            fixes("position", [1], [[1.0, 2.0, 3.0]], dict.fromkeys(COLUMNS["position"], "m")),
            Channel(
                "/odom", "columns", "odometry", T0 + np.array([10**9]), {"speed": np.array([3.6])}, {"speed": "km/h"}
            ),
            fixes("temperature", [1], [[294.15]], {"temperature_c": "K"}),
        )
        np.testing.assert_allclose(log.fixes["compass"].values[:, 0], np.radians([90.0, 271.0]))
        np.testing.assert_allclose(log.fixes["gps"].values, [[np.radians(46.5), np.radians(6.6), 400.0]])
        np.testing.assert_allclose(log.fixes["odometry"].values, [[1.0, np.nan, np.nan]])
        np.testing.assert_allclose(log.fixes["temperature"].values, [[21.0]])
        assert log.fixes["position"].values.tolist() == [[1.0, 2.0, 3.0]]
        assert log.warnings == ()

    def test_a_heading_without_a_unit_below_two_pi_is_in_radians_and_said(self) -> None:
        log = log_of(imu(), fixes("compass", [1, 2, 3], [[0.1], [3.0], [6.2]]))
        np.testing.assert_array_equal(log.fixes["compass"].values[:, 0], [0.1, 3.0, 6.2])
        assert codes(log) == ["unit-guessed"]

    def test_exact_repeats_in_long_runs_are_dropped_and_counted(self) -> None:
        values = np.random.default_rng(4).normal(size=(9, 3))
        values[1:3] = values[0]  # three in a row: allowed
        values[5:9] = values[4]  # five in a row: four repeats
        log = log_of(imu(), fixes("sun", np.arange(9.0), values))
        assert log.fixes["sun"].t.tolist() == [0, 1, 2, 3, 4]
        assert codes(log) == ["stale-repeats"]
        assert "4 of 9" in log.warnings[0].message
        assert "5 in a row" in log.warnings[0].message

    @pytest.mark.parametrize(("leap", "told"), [(0.5, ["stale-repeats"]), (0.01, [])])
    def test_a_tracker_that_stands_still_to_the_last_bit_and_leaps_has_not_measured(
        self, leap: float, told: list[str]
    ) -> None:
        """One that truly stands still, to its last digit, goes on from there."""
        t = np.arange(0.0, 9.9, 0.05)
        steps = np.random.default_rng(4).normal(0.0, 0.01, (len(t), 3))
        steps[60:100] = 0.0
        steps[100] = leap
        log = log_of(imu(), fixes("position", t, np.cumsum(steps, axis=0)))
        assert codes(log) == told
        assert len(log.fixes["position"].t) == len(t) - 40 * bool(told)

    def test_a_tracker_that_says_zero_where_it_sees_nothing_was_never_there(self) -> None:
        t = np.arange(0.0, 9.9, 0.05)
        values = np.array([3.0, 2.0, 1.0]) + np.cumsum(np.random.default_rng(4).normal(0.0, 0.01, (len(t), 3)), axis=0)
        values[60:100] = 0.0
        log = log_of(imu(), fixes("position", t, values))
        assert codes(log) == ["stale-repeats"]
        assert len(log.fixes["position"].t) == len(t) - 40
        assert np.all(log.fixes["position"].values[:, 0] > 1.0)

    @pytest.mark.parametrize(("held", "told"), [(1.5, ["odometry-stuck"]), (0.0, [])])
    def test_wheels_that_hold_one_speed_for_long_are_dropped_unless_they_stand(
        self, held: float, told: list[str]
    ) -> None:
        t = np.arange(0.0, 9.9, 0.05)
        speed = 1.5 + np.random.default_rng(6).normal(0.0, 0.02, t.size)
        speed[50:100] = held
        log = log_of(imu(), fixes("odometry", t, speed[:, None]))
        assert codes(log) == told
        assert log.fixes["odometry"].t.size == t.size - (50 if told else 0)
        assert not told or "for up to 2.5 s" in log.warnings[0].message

    def test_coarse_wheels_may_hold_a_speed(self) -> None:
        t = np.arange(0.0, 9.9, 0.05)
        speed = np.round(1.5 + 0.3 * np.sin(0.7 * t), 1)
        log = log_of(imu(), fixes("odometry", t, speed[:, None]))
        assert codes(log) == []

    def test_fixes_outside_the_imu_are_counted_and_those_just_outside_are_not(self) -> None:
        values = np.random.default_rng(5).normal(size=(6, 3))
        near = log_of(imu(), fixes("sun", [-0.3, 1, 2, 3, 4, 10.2], values))
        assert near.fixes["sun"].t.tolist() == [1, 2, 3, 4]
        assert near.warnings == ()
        far = log_of(imu(), fixes("sun", [-5, 1, 2, 3, 4, 20], values))
        assert codes(far) == ["outside-imu-span"]
        assert "2 of 6" in far.warnings[0].message

    def test_a_sensor_on_another_clock_is_left_out_with_both_spans(self) -> None:
        log = log_of(imu(), fixes("sun", [1e6, 1e6 + 5], [[0, 0.6, 0.8], [0, 0.8, 0.6]]))
        assert log.fixes == {}
        (warning,) = log.warnings
        assert warning.code == "no-overlap"
        assert "1000000.0 to 1000005.0 s" in warning.message
        assert "0 to 10.0 s" in warning.message
        assert "--time log" in warning.hint

    def test_sigmas_that_the_log_states_are_kept(self) -> None:
        values = {"latitude": np.array([46.5]), "longitude": np.array([6.6]), "gps_sigma_m": np.array([2.0])}
        log = log_of(
            imu(),
            Channel("/fix", "columns", "gps", T0 + np.array([10**9]), values, {"latitude": "deg", "longitude": "deg"}),
        )
        assert log.fixes["gps"].sigma is not None
        np.testing.assert_array_equal(log.fixes["gps"].sigma, [[2.0, 2.0, 2.0]])
        assert np.isnan(log.fixes["gps"].values[0, 2])


def test_warnings_of_the_readers_come_first() -> None:
    from attest_cli.records import Warn

    told = Recording(Path("log.csv"), "csv", (imu(),), 1000, {}, (Warn("text-cells", "one"),))
    assert codes(prepare([told], Settings())) == ["text-cells"]


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_spikes_of_a_magnetometer_are_dropped(share: float) -> None:
    rng = np.random.default_rng(7)
    values = np.array([2e-5, 0.0, -4e-5]) + rng.normal(0.0, 3e-7, (100, 3))
    off = rng.random(100) < share
    values[off] += 6e-5 * rng.uniform(0.3, 1.0, (np.count_nonzero(off), 3))
    units = dict.fromkeys(COLUMNS["magnetometer"], "T")
    log = log_of(imu(), fixes("magnetometer", np.arange(100) * 0.1, values, units))
    assert codes(log) == ["magnetometer-spikes"] * (share > 0.0)
    left = np.abs(log.fixes["magnetometer"].values - [2e-5, 0.0, -4e-5]).max(axis=1) > 1e-5
    assert np.count_nonzero(left) <= 0.25 * np.count_nonzero(off)


def test_a_renamed_column_is_missing_only_where_no_file_has_it() -> None:
    def told(name: str, *columns: str) -> Recording:
        missing = {c: Warn("no-such-column", f"{name}: no column {c}") for c in columns}
        channel = imu(name=name, start_ns=T0 if name == "a.csv" else T0 + 10_000_000_000)
        told = recording(replace(channel, name="/imu/data"), name=name)
        return replace(told, warnings=tuple(missing.values()), missing=missing)

    log = prepare([told("a.csv", "wx", "wz"), told("b.csv", "wy", "wz")], Settings())
    assert [w.message for w in log.warnings] == ["a.csv: no column wz", "b.csv: no column wz"]


@pytest.mark.parametrize(("forward", "aside", "said"), [(0.0, 0.0, False), (0.4, 0.0, False), (0.05, 0.4, True)])
def test_odometry_that_goes_sideways_is_told_and_noise_at_rest_is_not(forward: float, aside: float, said: bool) -> None:
    noise = np.random.default_rng(3).normal(0.0, (0.02, 0.05, 0.05), (200, 3))
    odometry = fixes("odometry", np.arange(200) * 0.05, noise + np.array([forward, aside, 0.0]))
    assert ("odometry-sideways" in codes(log_of(imu(), odometry))) is said
