"""The navigation smoother on simulated drives: errors inside their sigma, states found, noise found."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2
from support.drives import effective

from attest_cli import estimate
from attest_cli.filters import Drive, navigation
from attest_cli.filters.choice import choose
from attest_cli.filters.navigation.aids import Magnetometer, Place, student
from attest_cli.filters.navigation.field import start_field, tuned_field
from attest_cli.filters.navigation.fixes import GPS_SIGMA_M, possible
from attest_cli.filters.navigation.model import Trajectory
from attest_cli.filters.navigation.start import heading_offset
from attest_cli.filters.navigation.states import CORE, State, layout
from attest_cli.locate import locate
from attest_cli.maths import kalman, rotation
from attest_cli.nodes.noise import find_noise
from attest_cli.prepare import prepare
from attest_cli.records import Fixes, Imu, Log, Segmentation
from attest_cli.segment import find_segments
from attest_cli.settings import Settings
from attest_cli.simulate import RoverOptions, simulate_rover
from attest_cli.simulate.rover import rover_drive
from attest_cli.world import find_world

Array = NDArray[np.float64]


@cache
def drive(**options: object) -> tuple[RoverOptions, Log, Segmentation, Settings]:
    chosen = RoverOptions(scenario="S2", motions=2, motion_s=(30.0, 40.0), stop_s=(8.0, 10.0), **options)  # type: ignore[arg-type]
    made = simulate_rover(chosen)
    settings = effective(made, {"smoothing": {"filter": "navigation"}})
    log = prepare([made.log], settings)
    return chosen, log, find_segments(log, settings), settings


@cache
def judged(**options: object) -> tuple[estimate.Estimate, Array, Array]:
    """Return the estimate and the true minus estimated attitude and position at its nodes in motion."""
    chosen, log, segmentation, settings = drive(**options)
    est = estimate.estimate(log, segmentation, settings)
    truth = rover_drive(chosen).at(est.smoothed.t)
    assert est.smoothed.p is not None
    attitude = rotation.log_quaternion(rotation.multiply(rotation.conjugate(est.smoothed.q), truth.q_nb))
    return est, attitude, truth.position_n - truth.position_n[0] - est.smoothed.p


def nees(e: Array, P: Array) -> Array:
    return np.asarray(np.einsum("ki,ki->k", e, np.linalg.solve(P, e[:, :, None])[:, :, 0]))


@pytest.mark.parametrize("seed", [11, 12])
def test_attitude_and_place_are_inside_their_sigma(seed: int) -> None:
    est, attitude, place = judged(seed=seed, odometry=True)
    assert est.smoothed.P_vp is not None
    for e, P in ((attitude, est.smoothed.P[:, :3, :3]), (place, est.smoothed.P_vp[:, 3:, 3:])):
        ends = [int(np.searchsorted(est.smoothed.t, t)) for t in (20.0, 45.0, 65.0)]
        assert nees(e, P + 1e-12 * np.eye(3))[ends].max() < chi2.isf(1e-4 / 12, 3)
    distance = 70.0 * 0.3
    assert np.linalg.norm(place[-1]) < 0.03 * distance


def test_wheels_hold_the_place_that_the_imu_alone_loses() -> None:
    _, _, alone = judged(seed=11)
    _, _, wheels = judged(seed=11, odometry=True)
    assert np.linalg.norm(wheels[-1]) < 0.5 * np.linalg.norm(alone[-1])


@pytest.mark.parametrize(("every", "used"), [(20, True), (90, False)], ids=["0.5 Hz", "0.1 Hz"])
def test_slow_wheels_are_used_or_refused_in_words(every: int, used: bool) -> None:
    _, log, segmentation, settings = drive(seed=13, odometry=True)
    fixes = log.fixes["odometry"]
    slow = replace(fixes, t=fixes.t[::every], values=fixes.values[::every])
    est = estimate.estimate(replace(log, fixes={"odometry": slow}), segmentation, settings)
    assert ("odometry-not-used" not in {w.code for w in est.warnings}) == used
    assert any(found.name == "odometry scale" for found in est.shown) == used


def test_wheels_that_slip_do_not_move_the_place() -> None:
    chosen, log, segmentation, settings = drive(seed=13, odometry=True)
    fixes, since = log.fixes["odometry"], segmentation.motions[0].start + 12.0
    slips = (fixes.t > since) & (fixes.t < since + 4.0)
    spun = replace(fixes, values=fixes.values + 1.5 * slips[:, None] * [1.0, 0.0, 0.0])
    log = replace(log, fixes={**log.fixes, "odometry": spun})
    est = estimate.estimate(log, segmentation, settings)
    place, _, told = locate(log, segmentation, est, settings)
    truth = rover_drive(chosen).at(est.smoothed.t).position_n
    assert place is not None
    assert np.linalg.norm((truth - truth[0] - place.p)[-1]) < 0.8  # the slip went 6 m
    wheels = est.forward.innovations.t[est.forward.innovations.role == "odometry"]
    assert not np.any((wheels > since) & (wheels < since + 4.0))
    assert [w.code for w in (*est.warnings, *told) if w.code.startswith("odometry")] == ["odometry-slips"]


@pytest.mark.parametrize(
    ("moves", "passes", "ways", "fatal"),
    [(0.5, 9, "--iterations 18 or --filter indirect", False), (3.0, 30, "--iterations 50 or --filter indirect", True),
     (3.0, 50, "compare --filter indirect", True)],
)  # fmt: skip
def test_what_does_not_settle_names_a_way_on_and_fails_where_it_moves_by_a_sigma(
    moves: float, passes: int, ways: str, fatal: bool
) -> None:
    run, settings = SimpleNamespace(absent=(), heading="absolute"), drive(seed=13, odometry=True)[3]
    smoothed = SimpleNamespace(settled=False, passes=passes, moves=moves)
    (told,) = estimate._warnings(run, smoothed, settings, over_nodes=True)  # type: ignore[arg-type]
    assert (told.code, told.fatal) == ("not-settled", fatal)
    assert ways in told.hint


def test_a_wheel_scale_is_found() -> None:
    """Wheels that read a fifth too much, with a prior wide enough for it: the IMU shows it."""
    chosen, log, segmentation, settings = drive(seed=14, odometry=True)
    odometry = log.fixes["odometry"]
    faster = Fixes("odometry", odometry.channel, odometry.t, odometry.values * 1.2)
    wide = Settings.model_validate({**settings.model_dump(exclude_unset=True), "odometry": {"scale_sigma": 0.3}})
    est = estimate.estimate(replace(log, fixes={**log.fixes, "odometry": faster}), segmentation, wide)
    truth = rover_drive(chosen).at(est.smoothed.t)
    assert est.smoothed.v is not None
    moving = truth.moving
    found, true = (np.linalg.norm(v[moving], axis=1).mean() for v in (est.smoothed.v, truth.velocity_n))
    assert abs(found / true - 1.0) < 0.1


ARM = np.array([1.0, -0.6, 0.0])  # m
CAR_S = 80.0


def car(
    seed: int,
    lag: float = 0.0,
    sigma: float = 0.5,
    turn: float = 2.0,
    arm: Array | None = None,
    seconds: float = CAR_S,
) -> tuple[Drive, Array, Array]:
    """A lively car on a plane, known exactly: IMU at 100 Hz, places once a second; its axes start at heading 0, the
    places are turned by ``turn``.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 0.01)
    heading = 0.8 * np.sin(0.15 * t) + 0.02 * t
    rate = 0.8 * 0.15 * np.cos(0.15 * t) + 0.02
    speed = 8.0 + 3.0 * np.sin(0.3 * t)
    gain = 0.9 * np.cos(0.3 * t)
    v = speed[:, None] * np.stack([np.cos(heading), np.sin(heading), 0 * t], axis=1)
    p = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (v[1:] + v[:-1]) * 0.01, axis=0)])
    zero = np.zeros_like(t)
    gyro = np.stack([zero, zero, rate], axis=1) + np.array([0.002, -0.003, 0.004]) + rng.normal(0, 2e-3, (len(t), 3))
    force = np.stack([gain, speed * rate, zero + 9.80665], axis=1) + rng.normal(0, 0.05, (len(t), 3))
    when = np.arange(0.5, seconds - 1.0, 1.0)
    R = rotation.matrix(rotation.exp_quaternion(np.array([0.0, 0.0, turn])))
    ahead = np.stack([zero, zero, heading], axis=1)
    antenna = p + (0.0 if arm is None else rotation.rotate(rotation.exp_quaternion(ahead), np.tile(arm, (len(t), 1))))
    place = np.stack([np.interp(when - lag, t, antenna[:, i]) for i in range(3)], axis=1) @ R.T
    place += rng.normal(0.0, sigma, place.shape)
    stamps = (t * 1e9).astype(np.int64)
    fixes = {"position": Fixes("position", "fixes", when, place)}
    log = Log((), 0, stamps, Imu(t, gyro, force), fixes, np.zeros((0, 2)), {})
    settings = Settings()
    segmentation = find_segments(log, settings)
    truth = (p @ R.T)[::10]
    return (
        Drive(log, segmentation, find_world(log, settings), find_noise(log, segmentation, settings), settings),
        truth,
        t[::10],
    )


@pytest.mark.parametrize(("stated", "told"), [(0.5, False), (0.1, True)])
def test_fixes_that_scatter_far_more_than_their_log_says_are_told(stated: float, told: bool) -> None:
    work, _, _ = car(21, sigma=0.5, seconds=40.0)
    fixes = work.log.fixes["position"]
    log = replace(work.log, fixes={"position": replace(fixes, sigma=np.full(fixes.values.shape, stated))})
    found = navigation.forward(replace(work, log=log))
    assert ("position-scatters" in {w.code for w in found.warnings}) == told


@pytest.mark.parametrize(("lag", "fatal"), [(0.3, False), (-1.6, True), (18.0, True)])
def test_fixes_later_than_a_receiver_can_be_fail_and_are_not_said_to_be_corrected(lag: float, fatal: bool) -> None:
    found = navigation.forward(car(2, lag=lag, sigma=0.05, seconds=60.0)[0])
    (told,) = (w for w in found.warnings if w.code == "position-late")
    assert told.fatal == fatal
    assert ("more than is corrected" in told.message) == fatal
    assert "heading-contradicted" not in {w.code for w in found.warnings}


@pytest.mark.parametrize("turn", [-3.0, 0.5, 2.0])
@pytest.mark.parametrize("drift", [0.0, -0.06, 0.03])
def test_heading_is_found_from_where_the_car_went(turn: float, drift: float) -> None:
    """Also where a bias of the gyro, rad/s, turns the attitude by more than a radian meanwhile."""
    work, _, _ = car(1, turn=turn)
    fixes = work.log.fixes["position"]
    t = work.log.imu.t[::10]
    heading = 0.8 * np.sin(0.15 * t) + 0.02 * t - drift * t
    q = rotation.exp_quaternion(np.stack([0 * t, 0 * t, heading], axis=1))
    place = Place(
        np.zeros(len(fixes.t), dtype=np.int64), fixes.t, fixes.values, np.ones((len(fixes.t), 3)), np.zeros(3)
    )
    found, sigma = heading_offset(work.log.imu, t, q, np.zeros(3), place)
    off = np.angle(np.exp(1j * (found - turn - drift * t)))
    assert np.abs(off).max() < (5.0 if drift == 0.0 else 8.0) * sigma
    assert sigma < 0.15


def test_a_lever_arm_and_a_lag_are_found_with_a_good_imu() -> None:
    work, _, _ = car(2, lag=0.2, sigma=0.05, arm=ARM)
    densities = {"gyro_noise_density": 2e-4, "accel_noise_density": 5e-3, "gyro_scale_sigma": 0.0}
    settings = Settings.model_validate({"imu": densities})
    noise = find_noise(work.log, work.segmentation, settings)
    shown = {item.name: item for item in navigation.forward(replace(work, settings=settings, noise=noise)).shown}
    for name, true in (("position lever arm", ARM[:2]), ("position lag", [0.2])):
        values, sigma = (np.array(part[: len(true)]) for part in (shown[name].values, shown[name].sigma))
        assert (np.abs(values - true) < 4.0 * sigma).all(), name
        assert sigma.max() < 0.25  # half of what is known beforehand


def test_car_noise_clock_and_heading_are_found_from_the_log_alone() -> None:
    """Nothing is stated: neither the fixes' 0.5 m nor that they are 0.2 s late; the first fix is the origin."""
    work, truth, t = car(2, lag=0.2)
    found = navigation.forward(work)
    assert found.run.read is not None
    assert any("late" in w.message for w in found.warnings)
    smoothed = found.run.read(kalman.rts(found.run.chain))
    assert smoothed.p is not None
    assert smoothed.P_vp is not None
    at = np.stack([np.interp(smoothed.t, t, truth[:, i]) for i in range(3)], axis=1)
    apart = (at - smoothed.p)[:, :2]
    apart -= apart.mean(axis=0)  # the first fix's own error
    assert np.sqrt(np.mean(np.sum(apart**2, axis=1))) < 0.5
    sigma = np.sqrt(np.einsum("kii->ki", smoothed.P_vp[:, 3:, 3:]))
    assert np.mean(np.abs(apart) < 3.0 * sigma[:, :2]) > 0.9


def test_a_fix_from_elsewhere_is_left_out_and_told() -> None:
    """Null island, first of all: it is neither origin nor aid."""
    work, truth, _ = car(4, seconds=50.0)
    fixes = work.log.fixes["position"]
    values = fixes.values.copy()
    values[0] += [5e6, -3e6, 0.0]
    far = replace(work.log, fixes={"position": replace(fixes, values=values)})
    found = navigation.forward(replace(work, log=far))
    assert any("1 fixes of position" in w.message for w in found.warnings)
    assert found.run.read is not None
    smoothed = found.run.read(kalman.rts(found.run.chain))
    assert smoothed.p is not None
    assert np.ptp(smoothed.p[:, :2], axis=0).max() < 2.0 * np.ptp(truth[:, :2], axis=0).max()


def test_fixes_of_a_log_that_stands_show_no_north() -> None:
    rng = np.random.default_rng(6)
    t = np.arange(0.0, 60.0, 0.01)
    gyro, force = rng.normal(0, 2e-3, (len(t), 3)), rng.normal([0, 0, 9.80665], 0.02, (len(t), 3))
    fixes = {"position": Fixes("position", "fixes", np.arange(0.5, 59.0), rng.normal(0, 0.5, (59, 3)))}
    log = Log((), 0, (t * 1e9).astype(np.int64), Imu(t, gyro, force), fixes, np.zeros((0, 2)), {})
    settings = Settings()
    segmentation = find_segments(log, settings)
    noise = find_noise(log, segmentation, settings)
    found = navigation.forward(Drive(log, segmentation, find_world(log, settings), noise, settings))
    assert found.run.heading == "relative"
    assert "north-not-shown" in {w.code for w in found.warnings}


def test_an_arm_that_the_drive_does_not_show_is_no_state_and_scatter_that_nothing_states_is_none() -> None:
    found = navigation.forward(car(3, sigma=0.5, seconds=50.0)[0])
    assert "position lever arm" not in {item.name for item in found.shown}
    assert "position-scatters" not in {w.code for w in found.warnings}


@pytest.mark.parametrize(
    ("roles", "rate", "name"),
    [({"gps"}, 0.1, "navigation"), ({"sun"}, 0.1, "indirect"), ({"magnetometer"}, 1.5, "navigation"),
     ({"magnetometer", "odometry"}, 1.5, "indirect")],
)  # fmt: skip
def test_auto_looks_at_the_sensors_and_at_how_lively_it_is(roles: set[str], rate: float, name: str) -> None:
    t = np.arange(0.0, 20.0, 0.01)
    gyro = np.stack([rate * np.sin(2 * t), rate * np.cos(3 * t), 0 * t], axis=1)
    fixes = {role: Fixes(role, role, np.arange(0.0, 20.0), np.zeros((20, 3))) for role in roles}
    log = Log((), 0, (t * 1e9).astype(np.int64), Imu(t, gyro, np.tile([0.0, 0.0, 9.8], (len(t), 1))), fixes,
              np.zeros((0, 2)), {})  # fmt: skip
    settings = Settings()
    segmentation = find_segments(log, settings)
    assert choose(log, segmentation, settings)[0] == name
    stated = Settings.model_validate({"smoothing": {"filter": "heading"}})
    assert choose(log, segmentation, stated)[0] == "heading"


def test_students_weights_spare_what_fits_and_fade_what_does_not() -> None:
    r = np.array([[0.5, 0.0, 0.0], [30.0, 0.0, 0.0]])
    near, far = student(r, np.ones_like(r))
    assert near == 1.0
    assert far == pytest.approx((4 + 3) / (4 + 900))


def test_iron_near_part_of_a_motion_hardly_counts_though_neighbours_share_their_error(rng: np.random.Generator) -> None:
    """Sigma of each node is some ten times wider for what it shares; iron lies far off by the scatter of the others."""
    sizes = {**dict.fromkeys(CORE, 3), "hard iron": 3, "earth field": 2, "motion offset": 3}
    form = layout(State(name, size, 1.0) for name, size in sizes.items())
    t = np.arange(0.0, 60.0, 0.05)
    n, near_iron, one = len(t), slice(0, 100), np.ones(len(t))
    field_b = rng.normal([0.0, 0.4, -0.3], 0.005, (n, 3))
    field_b[near_iron] += [0.1, 0.0, 0.0]
    at = Trajectory(np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), np.zeros((n, form.size)))
    begun = Magnetometer(np.arange(n), t, field_b, one > 0, 0.5 * np.pi, one, one)
    start_field(begun, form, at)
    found = tuned_field(begun, form, at, t)
    weight = found.rows(form, at).weight
    assert np.all(found.sigma > 10 * 0.005)
    assert np.all(weight[near_iron] < 0.1)
    assert np.mean(weight[near_iron.stop :]) > 0.9


def test_fixes_in_pairs_tell_the_heading_as_even_ones_do(rng: np.random.Generator) -> None:
    """One and ten seconds apart in turn: no gap is the usual one."""
    _, log, _, _ = drive(seed=31, gps=True)
    t = np.arange(0.0, log.imu.t[-1], 0.1)
    when = np.sort(np.concatenate([np.arange(0.0, t[-1] - 2.0, 11.0), np.arange(1.0, t[-1] - 2.0, 11.0)]))
    place = Place(
        np.searchsorted(t, when), when, rng.normal(size=(len(when), 3)), np.ones((len(when), 3)), np.zeros(3), "gps"
    )
    turn, sigma = heading_offset(log.imu, t, np.tile([1.0, 0.0, 0.0, 0.0], (len(t), 1)), np.zeros(3), place)
    assert np.isfinite(turn).all()
    assert 0.0 < sigma <= np.pi


@pytest.mark.parametrize("unknown", [slice(None, None, 2), slice(None)])
def test_fixes_without_a_sigma_have_the_usual_one(unknown: slice) -> None:
    _, log, segmentation, settings = drive(seed=31, gps=True)
    fixes = log.fixes["gps"]
    sigma = np.ones((len(fixes.t), 3))
    sigma[unknown] = np.nan
    told = replace(log, fixes={**log.fixes, "gps": replace(fixes, sigma=sigma)})
    noise = find_noise(told, segmentation, settings)
    known, _, used = possible(Drive(told, segmentation, find_world(told, settings), noise, Settings()), "gps")
    assert known.all()
    assert np.all(used[unknown] == GPS_SIGMA_M)
    assert np.all(used[np.isfinite(sigma)] == 1.0)
