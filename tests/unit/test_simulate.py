"""The simulator's truth is exact, its errors have the stated densities, and a seed fixes every bit."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

from attest_cli.errors import AttestError
from attest_cli.records import COLUMNS, Channel
from attest_cli.settings import Settings
from attest_cli.simulate import SCENARIOS, VARIANTS, RoverOptions, Simulation, simulate_rover
from attest_cli.simulate.drive import GRAVITY_M_S2, Kinematics
from attest_cli.simulate.rover import (
    ACCEL_NOISE,
    BOUNCE_M_S2,
    FIELD_UT,
    GYRO_NOISE,
    GYRO_WALK,
    SHAKE_RAD_S,
    rover_drive,
    sun_direction,
    sun_mounting,
)

Floats = NDArray[np.float64]
ALL = RoverOptions(seed=3, duration_s=400.0, compass=True, odometry=True, gps=True, magnetometer=True, sun_always=True)


@pytest.fixture(scope="module")
def full() -> Simulation:
    return simulate_rover(ALL)


def channel(simulation: Simulation, role: str) -> Channel:
    return next(c for c in simulation.log.channels if c.role == role)


def stack(source: Any, *names: str) -> Floats:
    return np.column_stack([source[name] for name in names])


def truth_at(options: RoverOptions, stamps: NDArray[np.int64], simulation: Simulation) -> Kinematics:
    t = (stamps - simulation.truth["timestamp_ns"][0]) * 1e-9
    return rover_drive(options).at(t)


def assert_variance(errors: Floats, sigma: float | Floats) -> None:
    """Chi-square band of 99.99 % on the sum of squares, and a mean that fits."""
    z = np.ravel(errors / sigma)
    low, high = chdtri(z.size, 1.0 - 5e-5), chdtri(z.size, 5e-5)
    assert low < np.sum(z**2) < high
    assert abs(z.mean()) < 4.0 / math.sqrt(z.size)


def gauss_points(start: float, step: float, count: int) -> tuple[Floats, Floats]:
    """Two Gauss-Legendre points per step."""
    middle = np.asarray(start + step * (np.arange(count) + 0.5), dtype=np.float64)
    return middle - step * math.sqrt(3) / 6, middle + step * math.sqrt(3) / 6


def attitude_error(step: float) -> float:
    """Fourth-order Magnus integration of the clean rate over the first minute of a drive, against the truth (rad)."""
    drive = rover_drive(RoverOptions(seed=5))
    begin, count = drive.timeline.motions[0, 0] - 1.0, round(20.0 / step)
    first, second = gauss_points(begin, step, count)
    one, two = drive.at(first).rate_b, drive.at(second).rate_b
    turns = step / 2 * (one + two) + math.sqrt(3) / 12 * step**2 * np.cross(one, two)
    R = np.eye(3)
    for turn in Rotation.from_rotvec(turns).as_matrix():
        R = R @ turn
    ends = drive.at(np.array([begin, begin + step * count])).R_nb
    return float(Rotation.from_matrix((ends[0] @ R).T @ ends[1]).magnitude())


def test_integrating_the_clean_rate_gives_the_true_attitude() -> None:
    coarse, fine = attitude_error(0.01), attitude_error(0.005)
    assert fine < 2e-7
    assert 10.0 < coarse / fine < 24.0  # fourth order: what is left is the integrator's error, not the truth's


def test_integrating_the_specific_force_twice_gives_the_true_position() -> None:
    drive = rover_drive(RoverOptions(seed=5))
    begin, step, count = drive.timeline.motions[0, 0] - 1.0, 0.002, 15_000
    first, second = gauss_points(begin, step, count)
    one, two = drive.at(first), drive.at(second)
    gravity = np.array([0.0, 0.0, GRAVITY_M_S2])
    a1, a2 = (np.einsum("nij,nj->ni", k.R_nb, k.force_b) - gravity for k in (one, two))
    velocity = np.cumsum(step / 2 * (a1 + a2), axis=0)
    half = step**2 / 2 * ((0.5 + math.sqrt(3) / 6) * a1 + (0.5 - math.sqrt(3) / 6) * a2)
    position = np.sum(half, axis=0) + step * np.sum(velocity[:-1], axis=0)
    ends = drive.at(np.array([begin, begin + step * count]))
    assert np.linalg.norm(velocity[-1] - ends.velocity_n[1]) < 1e-8
    assert np.linalg.norm(position - (ends.position_n[1] - ends.position_n[0])) < 1e-7
    assert np.linalg.norm(ends.position_n[1] - ends.position_n[0]) > 3.0


@pytest.mark.parametrize("variant", [v for v in VARIANTS if v != "idle-engine"])
def test_at_rest_nothing_moves_at_all(variant: Any) -> None:
    drive = rover_drive(RoverOptions(seed=2, variant=variant))
    for start, end in drive.timeline.stops:
        still = drive.at(np.linspace(start, end, 500))
        assert not still.moving.any()
        assert np.all(still.rate_b == 0.0)
        assert np.all(still.velocity_n == 0.0)
        assert np.all(still.speed == 0.0)
        assert np.all(still.q_nb == still.q_nb[0])
        assert np.all(still.position_n == still.position_n[0])
        np.testing.assert_allclose(still.force_b, GRAVITY_M_S2 * still.R_nb[:, 2, :], atol=1e-12)


def test_idling_engine_shakes_the_accelerometer_at_stops_only() -> None:
    idle, quiet = (rover_drive(RoverOptions(seed=2, variant=v)) for v in ("idle-engine", "nominal"))
    (start, end), (first, last) = idle.timeline.stops[0], idle.timeline.motions[0]
    stop, motion = np.arange(start, end - 0.1, 0.01), np.arange(first + 1.5, last - 1.5, 0.01)
    shaken = idle.at(stop)
    assert np.all(shaken.rate_b == 0.0)
    rms = np.sqrt(np.mean((shaken.force_b - quiet.at(stop).force_b) ** 2))
    assert 0.9 < rms / 0.05 < 1.1
    np.testing.assert_array_equal(idle.at(motion).force_b, quiet.at(motion).force_b)


def test_vibration_has_the_stated_rms_and_the_terrain_the_stated_tilt() -> None:
    shaken, smooth = (rover_drive(RoverOptions(seed=7, variant=v)) for v in ("nominal", "slow-no-vibration"))
    start, end = shaken.timeline.motions[0]
    t = np.arange(start + 2.0, end - 2.0, 0.01)
    _, rate, _ = shaken.shake.at(t)
    _, _, force = shaken.bounce.at(t)
    np.testing.assert_allclose(np.sqrt(np.mean(rate**2, axis=0)), SHAKE_RAD_S, rtol=0.05)
    np.testing.assert_allclose(np.sqrt(np.mean(force**2, axis=0)), BOUNCE_M_S2, rtol=0.05)
    assert np.all(smooth.shake.at(t)[1] == 0.0)
    for seed in range(5):
        moving = rover_drive(RoverOptions(seed=seed)).at(np.linspace(20.0, 60.0, 2000))
        assert np.degrees(np.arccos(moving.R_nb[:, 2, 2])).max() < 20.0
        assert moving.speed.max() < 0.45


def test_truth_is_consistent_with_its_quaternion(full: Simulation) -> None:
    q = stack(full.truth, "q_w", "q_x", "q_y", "q_z")
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-14)
    assert np.all(np.sum(q[1:] * q[:-1], axis=1) > 0.99)  # continuous in sign
    R_nb = truth_at(ALL, full.truth["timestamp_ns"], full).R_nb
    np.testing.assert_allclose(Rotation.from_quat(q, scalar_first=True).as_matrix(), R_nb, atol=1e-14)


def test_stop_table_is_the_truth(full: Simulation) -> None:
    t, moving = full.truth["t_s"], full.truth["moving"]
    inside = np.any((t[:, None] >= full.stops[:, 0]) & (t[:, None] <= full.stops[:, 1]), axis=1)
    np.testing.assert_array_equal(inside, ~moving)
    assert full.stops[0, 0] == 0.0
    assert full.stops[-1, 1] == 400.0
    speed = np.linalg.norm(stack(full.truth, *(f"velocity_{a}_m_s" for a in "xyz")), axis=1)
    assert np.all(speed[~moving] == 0.0)
    assert np.all(speed[moving] > 0.0)


def test_imu_noise_has_the_stated_density_at_every_rate() -> None:
    for rate in (30.0, 100.0, 200.0):
        options = RoverOptions(seed=1, duration_s=100.0, rate_hz=rate, scenario="S2")
        simulation = simulate_rover(options)
        values, period = channel(simulation, "imu").values, round(1e9 / rate) * 1e-9
        clean = truth_at(options, simulation.truth["timestamp_ns"], simulation)
        bias = stack(simulation.truth, *(f"gyro_bias_{a}_rad_s" for a in "xyz"))
        gyro = stack(values, "gyro_x", "gyro_y", "gyro_z") - clean.rate_b - bias
        accel_bias = stack(simulation.truth, *(f"accel_bias_{a}_m_s2" for a in "xyz"))
        accel = stack(values, "accel_x", "accel_y", "accel_z") - clean.force_b - accel_bias
        assert_variance(gyro, GYRO_NOISE / math.sqrt(period))
        assert_variance(accel, ACCEL_NOISE / math.sqrt(period))
        assert_variance(np.diff(bias, axis=0), GYRO_WALK * math.sqrt(period))
        assert np.abs(accel_bias).max() > 1e-3


def test_noisy_variant_doubles_the_noise_but_not_what_is_stated() -> None:
    quiet, loud = (RoverOptions(seed=1, duration_s=100.0, variant=v) for v in ("nominal", "noisy"))
    a, b = simulate_rover(quiet), simulate_rover(loud)
    assert a.settings == b.settings
    clean = truth_at(quiet, a.truth["timestamp_ns"], a).force_b[:, 0]
    x, y = (channel(s, "imu").values["accel_x"] - clean for s in (a, b))
    np.testing.assert_allclose(y, 2.0 * x, atol=1e-12)


def test_aiding_sensors_measure_the_truth(full: Simulation) -> None:
    def measured(role: str, *names: str) -> tuple[Floats, Kinematics]:
        source = channel(full, role)
        return stack(source.values, *names), truth_at(ALL, source.stamps_ns, full)

    sun, clean = measured("sun", "sun_x", "sun_y")
    seen = np.einsum("ji,nkj,k->ni", sun_mounting()[0], clean.R_nb, np.array(sun_direction()))
    assert seen[:, 2].min() > 0.05  # in front of the sensor
    assert_variance(sun - seen[:, :2], math.radians(0.5))
    heading, clean = measured("compass", "compass_deg")
    yaw = Rotation.from_matrix(clean.R_nb).as_euler("ZYX")[:, 0]
    assert_variance(np.mod(heading[:, 0] - 90.0 + np.degrees(yaw) + 180.0, 360.0) - 180.0, 3.0)
    velocity, clean = measured("odometry", "velocity_x", "velocity_y", "velocity_z")
    forward = velocity[:, 0] / clean.speed.clip(1e-9)
    scale = round(float(np.mean(forward[clean.speed > 0.2])), 2)
    assert scale in (0.99, 1.01)
    assert_variance(velocity[:, 0] - scale * clean.speed, 0.03)
    assert_variance(velocity[:, 1:], 0.05)
    field, clean = measured("magnetometer", "mag_x", "mag_y", "mag_z")
    assert_variance(field - np.einsum("nji,j->ni", clean.R_nb, FIELD_UT), 0.3)


def test_gps_is_the_position_on_the_ellipsoid(full: Simulation) -> None:
    source = channel(full, "gps")
    latitude, longitude = np.radians(source.values["latitude"]), np.radians(source.values["longitude"])
    a, e2, lat0, lon0 = 6378137.0, 0.00669437999014, math.radians(46.5), math.radians(6.6)

    def ecef(lat: Any, lon: Any, height: Any) -> Floats:
        n = a / np.sqrt(1 - e2 * np.sin(lat) ** 2)
        ring = (n + height) * np.cos(lat)
        return np.stack([ring * np.cos(lon), ring * np.sin(lon), (n * (1 - e2) + height) * np.sin(lat)], axis=-1)

    up = np.array([math.cos(lat0) * math.cos(lon0), math.cos(lat0) * math.sin(lon0), math.sin(lat0)])
    east = np.array([-math.sin(lon0), math.cos(lon0), 0.0])
    enu = (ecef(latitude, longitude, source.values["altitude"]) - ecef(lat0, lon0, 400.0)) @ np.stack(
        [east, np.cross(up, east), up], axis=1
    )
    assert_variance(enu - truth_at(ALL, source.stamps_ns, full).position_n, 1.0)


def test_channels_have_canonical_names_stamps_and_units(full: Simulation) -> None:
    assert {c.role for c in full.log.channels} == {"imu", "sun", "compass", "odometry", "gps", "magnetometer"}
    for c in full.log.channels:
        assert set(c.values) <= {*COLUMNS[c.role], "gps_sigma_m"}
        assert set(c.units) == set(c.values)
        assert c.stamps_ns.dtype == np.int64
        assert np.all(np.diff(c.stamps_ns) > 0)
    imu = channel(full, "imu").stamps_ns
    assert imu.size == 40_000
    assert np.all(np.diff(imu) == 10_000_000)


def test_sun_is_seen_at_stops_only_unless_asked(full: Simulation) -> None:
    at_stops = simulate_rover(RoverOptions(seed=3, duration_s=400.0))
    when = (channel(at_stops, "sun").stamps_ns - at_stops.truth["timestamp_ns"][0]) * 1e-9
    assert np.all(np.any((when[:, None] >= at_stops.stops[:, 0]) & (when[:, None] <= at_stops.stops[:, 1]), axis=1))
    assert channel(full, "sun").stamps_ns.size == 400


def test_a_seed_fixes_every_bit_and_another_seed_changes_the_drive(full: Simulation) -> None:
    again, other = simulate_rover(ALL), simulate_rover(RoverOptions(seed=4, duration_s=400.0))
    for a, b in zip(full.log.channels, again.log.channels, strict=True):
        assert a.stamps_ns.tobytes() == b.stamps_ns.tobytes()
        assert all(a.values[name].tobytes() == b.values[name].tobytes() for name in a.values)
    gyro, different = channel(full, "imu").values["gyro_x"], channel(other, "imu").values["gyro_x"]
    assert np.mean(gyro == different) < 1e-3


def test_one_sensor_more_changes_nothing_else(full: Simulation) -> None:
    plain = simulate_rover(RoverOptions(seed=3, duration_s=400.0))
    for name, column in channel(plain, "imu").values.items():
        assert column.tobytes() == channel(full, "imu").values[name].tobytes()


def test_length_follows_the_options() -> None:
    two = simulate_rover(RoverOptions(seed=9))
    assert len(two.stops) == 3
    lengths = np.diff(two.stops, axis=1)
    assert np.all((lengths >= 10.0) & (lengths <= 20.0))
    hour = rover_drive(RoverOptions(seed=9, duration_s=3600.0)).timeline
    assert hour.duration == 3600.0
    assert 15 <= len(hour.motions) <= 22
    five = rover_drive(RoverOptions(seed=9, duration_s=300.0, motions=5)).timeline
    assert len(five.motions) == 5
    assert five.stops[-1, 1] == 300.0
    with pytest.raises(AttestError, match="no room"):
        simulate_rover(RoverOptions(duration_s=20.0))
    with pytest.raises(AttestError, match="unknown variant"):
        RoverOptions(variant="fast")  # type: ignore[arg-type]
    assert SCENARIOS["rover"] == (RoverOptions, simulate_rover)


@pytest.mark.parametrize("variant", VARIANTS)
def test_settings_of_the_log_are_settings(variant: Any, full: Simulation) -> None:
    for settings in (full.settings, simulate_rover(RoverOptions(duration_s=60.0, variant=variant)).settings):
        valid = Settings.model_validate(settings)
        assert valid.imu.gyro_noise_density == GYRO_NOISE
        assert valid.sun.components == 2
