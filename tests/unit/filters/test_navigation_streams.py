"""GPS velocity and height as aids: smaller errors, inside their sigma; clocks, datum and columns as they come."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2
from support.drives import effective

from attest_cli import estimate
from attest_cli.filters import Drive, navigation
from attest_cli.filters.navigation import rounds
from attest_cli.filters.navigation.aids import Height, Velocity
from attest_cli.filters.navigation.model import Trajectory
from attest_cli.filters.navigation.states import CORE, Layout, State, layout
from attest_cli.maths import rotation
from attest_cli.nodes.noise import find_noise
from attest_cli.prepare import prepare
from attest_cli.records import COLUMNS, Channel, Fixes, Log, Recording
from attest_cli.segment import find_segments
from attest_cli.settings import Settings
from attest_cli.simulate import RoverOptions, simulate_rover
from attest_cli.simulate.rover import rover_drive
from attest_cli.world import find_world

Array = NDArray[np.float64]
SPEED_SIGMA, HEIGHT_SIGMA = 0.05, 0.3
WHEN = (22.0, 45.0, 72.0)  # s, in motion and far enough apart to count as draws


@cache
def rover(seed: int, motion_s: float = 35.0) -> tuple[RoverOptions, Log, Settings]:
    """A rover that sees its heading, but not where it goes: two motions, or a long one."""
    motions = 2 if motion_s < 60.0 else 1
    chosen = RoverOptions(
        scenario="S2", motions=motions, motion_s=(motion_s, motion_s), stop_s=(8.0, 10.0), compass=True, seed=seed
    )
    made = simulate_rover(chosen)
    settings = effective(made, {"smoothing": {"filter": "navigation"}, "gps": {"velocity_sigma_m_s": SPEED_SIGMA},
                                "height": {"sigma_m": HEIGHT_SIGMA}})  # fmt: skip
    return chosen, prepare([made.log], settings), settings


def velocities(chosen: RoverOptions, rate_hz: float, lag: float = 0.0, arm: Array | None = None) -> Fixes:
    end = rover_drive(chosen).timeline.duration
    t = np.arange(0.53, end - 0.5, 1.0 / rate_hz)
    truth = rover_drive(chosen).at(t - lag)
    values = truth.velocity_n.copy()
    if arm is not None:
        step = 1e-3
        ahead, behind = (rover_drive(chosen).at(t - lag + s).R_nb @ arm for s in (step, -step))
        values += (ahead - behind) / (2 * step)
    values += np.random.default_rng(chosen.seed + 100).normal(0.0, SPEED_SIGMA, values.shape)
    return Fixes("gps_velocity", "gps_velocity", t, values)


def heights(chosen: RoverOptions, rate_hz: float, datum: float = 431.0) -> Fixes:
    """Above the sea, with weather that wanders as assumed."""
    end = rover_drive(chosen).timeline.duration
    t = np.arange(0.27, end - 0.3, 1.0 / rate_hz)
    rng = np.random.default_rng(chosen.seed + 200)
    kept = np.exp(-1.0 / rate_hz / 600.0)
    weather = np.zeros(len(t))
    weather[0] = rng.normal()
    for k in range(1, len(t)):
        weather[k] = kept * weather[k - 1] + np.sqrt(1.0 - kept**2) * rng.normal()
    up = rover_drive(chosen).at(t).position_n[:, 2]
    return Fixes("height", "height", t, (up + datum + weather + rng.normal(0.0, HEIGHT_SIGMA, len(t)))[:, None])


@cache
def solved(
    seed: int, *kinds: tuple[str, float], motion_s: float = 35.0
) -> tuple[estimate.Estimate, Array, Array, Array]:
    """Return the estimate, its nodes of ``WHEN``, and true minus estimated velocity and position (n, 3)."""
    chosen, log, settings = rover(seed, motion_s)
    more = {kind: (velocities if kind == "gps_velocity" else heights)(chosen, rate) for kind, rate in kinds}
    log = replace(log, fixes={**log.fixes, **more})
    est = estimate.estimate(log, find_segments(log, settings), settings)
    truth = rover_drive(chosen).at(est.smoothed.t)
    assert est.smoothed.v is not None
    assert est.smoothed.p is not None
    at = np.searchsorted(est.smoothed.t, WHEN)
    place = truth.position_n - truth.position_n[0] - est.smoothed.p
    return est, at, truth.velocity_n - est.smoothed.v, place


def squares(e: Array, P: Array) -> float:
    return float(np.sum(np.einsum("ki,ki->k", e, np.linalg.solve(P, e[:, :, None])[:, :, 0])))


@pytest.mark.parametrize("rate_hz", [1.0, 10.0])
def test_velocity_holds_the_track_and_its_errors_are_inside_their_sigma(rate_hz: float) -> None:
    speed, place, with_it, without = 0.0, 0.0, np.zeros(2), np.zeros(2)
    for seed in (11, 12):
        est, at, dv, dp = solved(seed, ("gps_velocity", rate_hz))
        assert est.smoothed.P_vp is not None
        speed += squares(dv[at], est.smoothed.P_vp[at, :3, :3])
        place += squares(dp[at], est.smoothed.P_vp[at, 3:, 3:])
        _, _, bare_v, bare_p = solved(seed)
        with_it += [np.mean(dv**2), np.mean(dp**2)]
        without += [np.mean(bare_v**2), np.mean(bare_p**2)]
    low, high = chi2.ppf([0.001, 0.999], 2 * 3 * len(WHEN))
    assert low < speed < high
    assert place < high
    assert (with_it < 0.7**2 * without).all()


@pytest.mark.parametrize("rate_hz", [2.0, 20.0])
def test_height_holds_the_vertical_and_its_error_is_inside_its_sigma(rate_hz: float) -> None:
    total, with_it, without = 0.0, np.zeros(2), np.zeros(2)
    for seed in (11, 12):
        est, at, dv, dp = solved(seed, ("height", rate_hz), motion_s=75.0)
        assert est.smoothed.P_vp is not None
        total += squares(dp[at, 2:], est.smoothed.P_vp[at][:, 5:, 5:])
        _, _, bare_v, bare_p = solved(seed, motion_s=75.0)
        with_it += [np.mean(dv[:, 2] ** 2), np.mean(dp[:, 2] ** 2)]
        without += [np.mean(bare_v[:, 2] ** 2), np.mean(bare_p[:, 2] ** 2)]
    low, high = chi2.ppf([0.001, 0.999], 2 * len(WHEN))
    assert low < total < high
    assert (with_it < 0.7**2 * without).all()


def test_velocity_alone_tells_where_north_is() -> None:
    chosen, log, settings = rover(11)
    log = replace(log, fixes={"gps_velocity": velocities(chosen, 5.0)})
    est = estimate.estimate(log, find_segments(log, settings), settings)
    truth = rover_drive(chosen).at(est.smoothed.t)
    assert est.forward.heading == "absolute"
    turn = rotation.multiply(truth.q_nb, rotation.conjugate(est.smoothed.q))
    error = rotation.log_quaternion(turn)[:, 2]
    up = truth.R_nb[:, 2]
    sigma = np.sqrt(np.einsum("ki,kij,kj->k", up, est.smoothed.P[:, :3, :3], up))
    moving = truth.moving
    assert np.mean(np.abs(error[moving]) < 3.0 * sigma[moving]) > 0.95
    assert np.degrees(np.sqrt(np.mean(error[moving] ** 2))) < 3.0


def test_a_late_receiver_is_found_and_its_clock_corrected() -> None:
    chosen, log, settings = rover(11)
    log = replace(log, fixes={**log.fixes, "gps_velocity": velocities(chosen, 4.0, lag=0.3)})
    segmentation = find_segments(log, settings)
    drive = Drive(log, segmentation, find_world(log, settings), find_noise(log, segmentation, settings), settings)
    found = navigation.forward(drive)
    lag = next(item for item in found.shown if item.name == "gps_velocity lag")
    assert abs(lag.values[0] - 0.3) < 4.0 * lag.sigma[0] < 0.2
    assert any(w.code == "gps_velocity-late" for w in found.warnings)


def test_fixes_and_velocities_of_one_receiver_are_late_alike() -> None:
    chosen, log, settings = rover(12)
    late, arm = 0.25, np.array([0.4, 0.2, 0.0])
    t = velocities(chosen, 2.0).t
    place = rover_drive(chosen).at(t - late).position_n
    place = place + rover_drive(chosen).at(t - late).R_nb @ arm + np.random.default_rng(3).normal(0, 0.1, place.shape)
    more = {"gps": Fixes("gps", "gps", t, _geodetic(place)), "gps_velocity": velocities(chosen, 2.0, late, arm)}
    log = replace(log, fixes={**log.fixes, **more})
    segmentation = find_segments(log, settings)
    drive = Drive(log, segmentation, find_world(log, settings), find_noise(log, segmentation, settings), settings)
    done = rounds.navigate(drive)
    assert list(done.learnt.lags) == ["gps"]
    assert abs(done.learnt.lags["gps"] - late) < 0.1
    (aid,) = (a for a in done.problem.aids if isinstance(a, Velocity))
    assert np.allclose(np.sort(aid.t)[5:-5], np.sort(t - done.learnt.lags["gps"])[5:-5], atol=1e-3)


def _geodetic(place: Array) -> Array:
    """Return latitude, longitude (rad) and height of places east, north and up of a point on the ellipsoid."""
    from pymap3d import enu2geodetic

    parts = enu2geodetic(*place.T, 0.7, 0.2, 100.0, deg=False)
    return np.stack([np.asarray(part) for part in parts], axis=1)


@pytest.mark.parametrize("kind", ["velocity", "height"])
def test_the_jacobians_are_the_slopes_of_the_residuals(kind: str) -> None:
    rng = np.random.default_rng(1)
    core = [State(name, 3, 1.0) for name in CORE]
    form: Layout = layout([
        *core, State("gps lag", 1, 1.0), State("gps lever arm", 3, 1.0), State("height datum", 1, 1.0),
        State("height drift", 1, 1.0, 600.0),
    ])  # fmt: skip
    q = rotation.normalise(rng.normal(size=(4, 4)))
    x = rng.normal(size=(4, form.size))
    x[:, :3] = 0.0
    at, node, t = Trajectory(q, x), np.arange(4), np.arange(4.0)
    rate, around = rng.normal(size=(4, 3)), np.stack([np.maximum(node - 1, 0), np.minimum(node + 1, 3)], axis=1)
    span = np.array([1.0, 2.0, 2.0, 1.0])
    aid: Velocity | Height = Height(node, t, rng.normal(size=(4, 1)), np.ones((4, 1)))
    if kind == "velocity":
        aid = Velocity(node, t, rng.normal(size=(4, 3)), np.ones((4, 3)), rate, np.ones(3), around, span, "gps")
    rows, step = aid.rows(form, at), 1e-6
    x[:, form.parts["gps lag"]] *= kind == "height"  # near zero: what it makes of the nodes around is left out
    for k in range(form.size):
        d = np.zeros((4, form.size))
        d[:, k] = step
        slope = (aid.rows(form, at.moved(-d)).r - aid.rows(form, at.moved(d)).r) / (2 * step)
        assert np.allclose(slope, rows.H[:, :, k], atol=1e-6), k


def test_a_lever_arm_that_is_stated_is_taken_out() -> None:
    chosen, log, settings = rover(12)
    arm = np.array([1.5, -1.0, 0.5])
    fixes = velocities(chosen, 4.0, arm=arm)
    errors = []
    for stated in ([0.0, 0.0, 0.0], arm.tolist()):
        gps = settings.gps.model_copy(update={"lever_arm_m": tuple(stated)})
        told = settings.model_copy(update={"gps": gps})
        with_arm = replace(log, fixes={**log.fixes, "gps_velocity": fixes})
        est = estimate.estimate(with_arm, find_segments(log, told), told)
        assert est.smoothed.v is not None
        errors.append(np.sqrt(np.mean((rover_drive(chosen).at(est.smoothed.t).velocity_n - est.smoothed.v) ** 2)))
    assert errors[1] < errors[0]


@pytest.mark.parametrize(
    ("names", "signs"),
    [
        (("ve", "vn", "vu"), (1.0, 1.0, 1.0)), (("gps_vel_e", "gps_vel_n", "gps_vel_d"), (1.0, 1.0, -1.0)),
        (("velocity_east", "velocity_north", "velocity_up"), (1.0, 1.0, 1.0)),
    ],
)  # fmt: skip
def test_a_table_gives_both_roles(tmp_path: Path, names: tuple[str, ...], signs: tuple[float, ...]) -> None:
    from attest_cli.pipeline import read

    t = np.arange(0.0, 10.0, 0.01)
    rng = np.random.default_rng(2)
    imu = np.hstack([rng.normal(0, 1e-3, (len(t), 3)), rng.normal((0, 0, 9.8), 1e-2, (len(t), 3))])
    rows = ["t [s],gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z," + ",".join(names) + ",baro_alt [m]"]
    for k, (when, values) in enumerate(zip(t, imu, strict=True)):
        aids = "1.0,2.0,3.0,250.5" if k % 20 == 0 else ",,,"
        rows.append(f"{when:.2f}," + ",".join(f"{v:.6f}" for v in values) + "," + aids)
    path = tmp_path / "log.csv"
    path.write_text("\n".join(rows) + "\n")
    _, log = read([path], Settings())
    assert np.allclose(log.fixes["gps_velocity"].values, np.array([1.0, 2.0, 3.0]) * signs)
    assert np.allclose(log.fixes["height"].values, 250.5)
    assert len(log.fixes["height"].t) == 50


def test_what_a_receiver_repeats_or_does_not_know_is_not_taken_for_a_measurement() -> None:
    chosen, _, settings = rover(11)
    recording = simulate_rover(chosen).log
    (imu,) = (c for c in recording.channels if c.role == "imu")
    stamps = imu.stamps_ns[::10]
    values = np.repeat(np.random.default_rng(4).normal(size=(len(stamps) // 10 + 1, 3)), 10, axis=0)[: len(stamps)]
    values[:100] = 0.0
    columns = dict(
        zip((*COLUMNS["gps_velocity"], "velocity_sigma"), (*values.T, np.full(len(stamps), -1.0)), strict=True)
    )
    channel = Channel("gps_velocity", "columns", "gps_velocity", stamps, columns)
    log = prepare([replace(recording, channels=(imu, channel))], settings)
    fixes = log.fixes["gps_velocity"]
    assert "stale-repeats" in {w.code for w in log.warnings}
    assert len(fixes.t) == 100 + len(values[100::10])
    assert fixes.sigma is None


def test_half_a_velocity_is_none_and_a_lone_altitude_is_a_height() -> None:
    from attest_cli.readers.columns import recognise

    found = [recognise(k, name) for k, name in enumerate(("vn", "alt_baro", "vel_ned_d", "height"))]
    assert [c.canonical for c in found if c] == ["velocity_north", "baro_height", "velocity_down", "altitude"]


def test_a_twist_can_be_mapped(tmp_path: Path) -> None:
    chosen, _, _ = rover(11)
    made = simulate_rover(replace(chosen, odometry=True))
    recording: Recording = made.log
    settings = effective(made, {"map": {"gps_velocity": "/odom"}})
    log = prepare([recording], settings)
    assert log.fixes["gps_velocity"].values.shape == log.fixes["odometry"].values.shape
