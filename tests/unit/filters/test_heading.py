"""The heading filter of Barshan and Durrant-Whyte: steps, both forms, and how it meets odd drives."""

from __future__ import annotations

import math
from dataclasses import replace
from decimal import Decimal, getcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm
from support.barshan import EACH_MINUTE, PAPER_MODEL, START, Course, course, largest_deg, passes, turned

from attest_cli.errors import AttestError
from attest_cli.filters import heading
from attest_cli.filters.heading import BiasModel, bias_steps, motion_steps, six_state_steps
from attest_cli.maths import kalman, rotation
from attest_cli.records import Calibrated, Log
from attest_cli.smoothers import SMOOTHERS, backward_estimate

Array = NDArray[np.float64]
VECTOR = Path(__file__).resolve().parents[2] / "vectors" / "others" / "barshan_kf.npz"
PERIOD_S = 0.03


@pytest.fixture(scope="module")
def vector() -> dict[str, NDArray[Any]]:
    with np.load(VECTOR) as file:
        return dict(file)


def steps_of(v: dict[str, NDArray[Any]], n: int) -> heading.Linear:
    """The vector's system: its noise densities read off the white Q."""
    walk, jerk = (float(np.sqrt(v["Q_white"][i, i] / v["Ts"])) for i in (5, 3))
    model = BiasModel(float(v["C1"]), float(v["C2"]), float(v["T1"]), walk)
    return six_state_steps(np.full(n, float(v["Ts"])), model, jerk)


# --- reference vector


def test_the_steps_are_the_vector(vector: dict[str, NDArray[Any]]) -> None:
    system, Q = steps_of(vector, 1), vector["Q_ou"]
    assert np.allclose(system.F[0], vector["F"], rtol=1e-9, atol=1e-15)
    assert np.allclose(system.u[0], vector["u"], rtol=1e-9, atol=1e-18)
    size = np.sqrt(np.outer(np.diag(Q), np.diag(Q)))
    off = np.abs(system.Q[0] - Q) / np.where(size > 0.0, size, 1.0)
    off[4, 4] = 0.0  # the vector's own formula lost half the digits there: see the next test
    assert off.max() < 1e-9


def decimal_q55(dt: float, T: float) -> float:
    """``T^2 (dt - 2 T (1 - e) + T (1 - e^2) / 2)``, in 60 digits."""
    getcontext().prec = 60
    x = Decimal(dt) / Decimal(T)
    e = (-x).exp()
    return float(Decimal(T) ** 3 * (x - 2 * (1 - e) + (1 - e * e) / 2))


@pytest.mark.parametrize("T", [1e-3, 0.03, 0.061, 1.0, 338.4, 1e7])
def test_the_integrated_walk_keeps_its_digits(T: float) -> None:
    Q = bias_steps(np.array([PERIOD_S]), BiasModel(time_constant=T, walk=1.0)).Q[0]
    assert Q[0, 0] == pytest.approx(decimal_q55(PERIOD_S, T), rel=1e-12)


@pytest.mark.parametrize("smoother", ["rts", "two-filter"])
def test_the_filter_and_its_smoothers_are_the_vector(vector: dict[str, NDArray[Any]], smoother: str) -> None:
    v = vector
    n = len(v["z"])
    found = heading.run(steps_of(v, n - 1), v["z"], v["H"], np.tile(v["R"], (n, 1, 1)), v["x0"], v["P0"])
    chain = found.chain
    errors = kalman.rts(chain) if smoother == "rts" else kalman.fuse(chain, *kalman.information(chain))
    for ours, theirs in (
        (found.x_pred, v["xp"]), (found.x, v["xf"]), (chain.P_pred, v["Pp"]), (chain.P, v["Pf"]),
        (found.x + errors.d, v["xs"]), (errors.P, v["Ps"]),
    ):  # fmt: skip
        assert np.allclose(ours, theirs, rtol=1e-9, atol=1e-9 * np.abs(theirs).max())


def test_the_papers_own_steps_and_where_they_differ(vector: dict[str, NDArray[Any]]) -> None:
    """Corrected: backward Euler, white noise. As printed, ``F66`` forces the bias to zero in one step."""
    v = vector
    dt, T, settled = float(v["Ts"]), float(v["T1"]), float(v["C1"] + v["C2"])
    system = steps_of(v, 1)
    euler, u = system.F[0].copy(), np.zeros(6)
    euler[4, 5], euler[5, 5], u[5] = dt, T / (T + dt), dt * settled / (T + dt)
    assert np.allclose(euler, v["F_euler"], rtol=1e-12)
    assert np.allclose(u, v["u_euler"], rtol=1e-12)
    walk = replace(BiasModel(), walk=float(np.sqrt(v["Q_white"][5, 5] / dt)))
    assert np.allclose(bias_steps(np.array([dt]), walk).Q[0], v["Q_white"][4:, 4:], rtol=1e-12)  # T -> infinity
    assert np.allclose(system.Q[0, :4, :4], v["Q_white"][:4, :4], rtol=1e-12)  # eq 8
    bias, euler_bias = -0.264, -0.264
    for _ in range(20_000):  # ten minutes
        bias = system.F[0, 5, 5] * bias + system.u[0, 5]
        euler_bias = euler[5, 5] * euler_bias + u[5]
    assert 1e-6 < abs(bias - euler_bias) < 4e-6  # deg/s
    assert abs(dt / (T + dt) * -0.264) < 1e-4  # printed F66 times the bias at the start


# --- steps


def test_the_steps_solve_their_differential_equations() -> None:
    T, dt, walk, jerk = 5.0, 0.4, 0.3, 2.0
    A = np.diag(np.ones(3), 1)
    A = np.block([[A, np.zeros((4, 2))], [np.zeros((2, 4)), np.array([[0.0, 1.0], [0.0, -1.0 / T]])]])
    G = np.diag([0.0, 0.0, 0.0, jerk**2, 0.0, walk**2])
    loan = expm(np.block([[-A, G], [np.zeros((6, 6)), A.T]]) * dt)  # Van Loan 1978
    F = loan[6:, 6:].T
    system = six_state_steps(np.array([dt]), BiasModel(0.2, -0.5, T, walk), jerk)
    assert np.allclose(system.F[0], F, atol=1e-13)
    assert np.allclose(system.Q[0], F @ loan[:6, 6:], atol=1e-13)
    drive = np.zeros(7)
    drive[5] = (0.2 - 0.5) / T
    forced = np.zeros((7, 7))
    forced[:6, :6], forced[:, 6] = A, drive
    assert np.allclose(system.u[0], expm(forced * dt)[:6, 6], atol=1e-14)


def test_two_steps_are_one_of_twice_the_length() -> None:
    model = BiasModel(0.1, -0.3, 2.0, 0.7)
    one, two = bias_steps(np.array([0.5]), model), bias_steps(np.array([1.0]), model)
    assert np.allclose(one.F[0] @ one.F[0], two.F[0])
    assert np.allclose(one.F[0] @ one.u[0] + one.u[0], two.u[0])
    assert np.allclose(one.F[0] @ one.Q[0] @ one.F[0].T + one.Q[0], two.Q[0])
    F, Q = motion_steps(np.array([0.5, 1.0]), 1.3)
    assert np.allclose(F[0] @ Q[0] @ F[0].T + Q[0], Q[1])


def test_the_bias_follows_its_curve() -> None:
    t = np.arange(0.0, 900.0, 0.5)
    model = BiasModel(0.153, -0.264, 338.4)
    steps, x = bias_steps(np.diff(t), model), np.array([0.0, -0.264])
    out = [x]
    for F, u in zip(steps.F, steps.u, strict=True):
        x = F @ x + u
        out.append(x)
    assert np.allclose(np.array(out)[:, 1], model.at(t), atol=1e-12)
    assert np.allclose(np.diff(np.array(out)[:, 0]), np.diff(0.153 * (t + 338.4 * np.expm1(-t / 338.4)) - 0.264 * t))


# --- what the stops say


def test_the_walk_is_as_stated_unless_the_stops_contradict_it(rng: np.random.Generator) -> None:
    times, variance, walk = 60.0 * np.arange(40), np.full(40, 1e-10), 5e-6
    bias = np.cumsum(rng.normal(0.0, walk * np.sqrt(60.0), 40))
    means = bias + rng.normal(0.0, 1e-5, 40)
    assert heading.walk_of_stops(means, times, variance, walk) == walk
    assert heading.walk_of_stops(means, times, variance, 10 * walk) == 10 * walk
    assert heading.walk_of_stops(means, times, variance, walk / 30) == pytest.approx(walk, rel=0.5)


def test_errors_of_the_parameters_grow_by_their_law() -> None:
    t, model = np.array([0.0, 600.0]), BiasModel(0.153, -0.264, 338.4)
    grown = 600.0 - 338.4 * (1.0 - math.exp(-600.0 / 338.4))
    measured, both, assumed = (heading.parameter_ramps(t, model, 0.1, (0.0, 1.0, w)) for w in (0.0, 0.5, 1.0))
    assert np.allclose(measured[1], [0.1 * 0.153 * grown, -0.1 * 0.264 * grown])
    assert np.allclose(assumed[1], [0.1 * 0.153 * grown, -0.1 * 0.264 * 600.0])
    assert np.allclose(both, 0.5 * (measured + assumed))
    assert not measured[0].any()
    assert not heading.parameter_ramps(t, BiasModel(), 0.1, (0.0, 1.0, 0.0)).any()


@pytest.mark.parametrize(("share", "weight"), [(0.0, 1.0), (0.15, 0.5), (10.0, 0.0)])
def test_a_stop_at_the_start_and_the_model_count_by_their_variance(share: float, weight: float) -> None:
    settings = {**PAPER_MODEL, "parameter_sigma": share, "form": "six-state"}
    of = course(3, duration_s=60.0, told=START, heading_settings=settings, walk=1e-9)
    s, rate = heading.samples(of.drive), of.drive.log.imu.gyro_b[:, 2]
    model, _ = heading._bias_model(of.drive, s, rate)
    first, sigma, w = heading._start(of.drive, s, rate, model)
    own = of.drive.noise.gyro_density / math.sqrt(10.0)
    prior = max(share * abs(model.c2), heading.LEAST_BIAS_RAD_S)
    assert w == pytest.approx(own**2 / (own**2 + prior**2), abs=0.02)
    assert (w > 0.99) if weight == 1.0 else (w < 0.01) if weight == 0.0 else 0.0 < w < 0.3
    assert sigma == pytest.approx(max((1.0 - w) * own, heading.LEAST_BIAS_RAD_S), rel=0.1)
    free = of.drive.settings.heading.model_copy(update={"parameter_sigma": 1e6})
    alone = replace(of.drive, settings=of.drive.settings.model_copy(update={"heading": free}))
    measured, _, _ = heading._start(alone, s, rate, model)
    assert first == pytest.approx(w * model.c2 + (1.0 - w) * measured, rel=1e-6)


# --- drives


def short(kind: str = "truck", **options: Any) -> Course:
    return course(3, kind, duration_s=options.pop("duration_s", 120.0), **options)


@pytest.mark.parametrize("form", ["six-state", "indirect"])
def test_both_smoothers_agree(form: str) -> None:
    run = heading.forward(short(stops=True, heading_settings={"form": form}).drive).run
    two, one = SMOOTHERS["two-filter"](run), SMOOTHERS["rts"](run)
    turn = rotation.log_quaternion(rotation.multiply(rotation.conjugate(one.q), two.q))
    assert np.abs(turn).max() < 1e-9
    assert np.allclose(one.P, two.P, rtol=1e-6, atol=1e-15)
    assert np.linalg.eigvalsh(one.P).min() > -1e-15
    assert run.absent == ("roll", "pitch")
    assert run.heading == "relative"
    assert not run.start_in_motion


def test_the_form_follows_the_stops() -> None:
    at_stops = heading.forward(short(stops=True).drive).run
    assert set(at_stops.innovations.role) == {"zero_rate"}
    moving = heading.forward(cut(short()).drive).run
    assert set(moving.innovations.role) == {"rate"}
    assert moving.start_in_motion


def cut(of: Course, start_s: float = 12.0, heading_settings: dict[str, Any] | None = None) -> Course:
    """The same course from where it moves: no stop."""

    def late(log: Log) -> Log:
        keep = log.imu.t >= start_s
        t = log.imu.t[keep] - log.imu.t[keep][0]
        imu = replace(log.imu, t=t, gyro_b=log.imu.gyro_b[keep], accel_b=log.imu.accel_b[keep])
        return replace(log, imu=imu, stamps_ns=log.stamps_ns[keep])

    found = short(change=late, heading_settings=heading_settings)
    segments = tuple(s for s in found.drive.segmentation.segments if s.motion)
    return Course(
        found.simulation, replace(found.drive, segmentation=replace(found.drive.segmentation, segments=segments))
    )


def test_without_stop_or_model_it_says_so() -> None:
    found = heading.forward(cut(short()).drive)
    assert [w.code for w in found.warnings] == ["no-bias"]
    sigma = np.degrees(np.sqrt(SMOOTHERS["none"](found.run).P[-1, 2, 2]))
    assert sigma > 20.0  # 0.26 deg/s of bias for 108 s
    modelled = heading.forward(cut(short(), heading_settings=PAPER_MODEL).drive)
    assert modelled.warnings == ()
    assert np.degrees(np.sqrt(modelled.run.chain.P[-1, 0, 0])) < 2.0


def test_a_calibrated_log_needs_no_bias_model() -> None:
    def calibrated(log: Log) -> Log:
        return replace(log, calibrated=Calibrated(log.imu.t[[0, -1]], np.zeros((2, 3)), {}, {}, "c.toml"))

    found = heading.forward(short(change=calibrated, heading_settings=PAPER_MODEL).drive)
    assert "bias-model-not-used" in [w.code for w in found.warnings]


@pytest.mark.parametrize("axis", [[np.pi / 2, 0.0, 0.0], [0.0, np.pi / 2, 0.0], [np.pi, 0.0, 0.0]])
def test_the_vertical_is_found_by_gravity(axis: list[float]) -> None:
    seat = rotation.exp_quaternion(np.array(axis))
    upright = short(stops=True)
    lying = short(stops=True, change=lambda log: turned(seat, log))
    (_, _, one), (_, _, other) = passes(upright), passes(lying)
    about = rotation.multiply(rotation.multiply(other.q, seat), rotation.conjugate(one.q))
    turn = rotation.log_quaternion(about)
    assert np.ptp(turn[:, 2]) < 1e-3
    assert np.abs(turn[:, :2]).max() < 1e-2
    assert np.allclose(other.bias @ rotation.matrix(seat), one.bias, atol=1e-4)


def test_a_vehicle_that_leans_is_told() -> None:
    def leaning(log: Log) -> Log:
        accel = log.imu.accel_b.copy()
        accel[:, 0] += 9.8 * 0.2 * np.sign(np.sin(log.imu.t / 7.0))
        return replace(log, imu=replace(log.imu, accel_b=accel))

    drive = short(stops=True, told=EACH_MINUTE, change=leaning).drive
    found = heading.forward(drive)
    assert "not-level" in [w.code for w in found.warnings]
    tilt = np.degrees(np.sqrt(SMOOTHERS["none"](found.run).P[-1, 0, 0]))
    assert 5.0 < tilt < 15.0


@pytest.mark.parametrize("lean", [0.8, 2.0, np.pi])
def test_a_vehicle_that_is_not_level_at_all_is_refused(lean: float) -> None:
    """Also one that lies on its back for a third of the drive: a lean beyond 90 degrees is none of less."""

    def tumbling(log: Log) -> Log:
        over = (log.imu.t > 80.0)[:, None]
        R = rotation.matrix(rotation.exp_quaternion(np.array([lean, 0.0, 0.0])))
        return replace(log, imu=replace(log.imu, accel_b=np.where(over, log.imu.accel_b @ R.T, log.imu.accel_b)))

    with pytest.raises(AttestError, match="deg rms, which is not level"):
        heading.forward(short(stops=True, told=EACH_MINUTE, change=tumbling).drive)


def test_from_the_end_no_heading_is_known_and_rounding_draws_none() -> None:
    of = course(1999, stops=True)
    q, _, P = backward_estimate(heading.forward(of.drive).run)
    assert np.isnan(q).all()
    assert np.isnan(P).all()


@pytest.mark.parametrize("form", ["six-state", "indirect"])
def test_a_hole_opens_the_heading(form: str) -> None:
    def holed(log: Log) -> Log:
        keep = (log.imu.t < 80.0) | (log.imu.t > 90.0)
        imu = replace(log.imu, t=log.imu.t[keep], gyro_b=log.imu.gyro_b[keep], accel_b=log.imu.accel_b[keep])
        return replace(log, imu=imu, stamps_ns=log.stamps_ns[keep], gaps=np.array([[79.98, 90.03]]))

    of = short(stops=True, change=holed, heading_settings={"form": form})
    _, _, smoothed = passes(of)
    sigma = np.sqrt(smoothed.P[:, 2, 2])
    at = int(np.searchsorted(of.drive.log.imu.t, 85.0))
    assert sigma[at - 1] < 0.3
    assert sigma[at] > np.pi / np.sqrt(3.0) * 0.99
    assert np.isfinite(smoothed.q).all()


def test_interval_samples_count_as_means() -> None:
    """Of a rate that rises, the mean of the interval before a stamp lags the rate at it by half a step."""
    of = short(stops=True)
    settings = of.drive.settings.model_copy(
        update={"imu": of.drive.settings.imu.model_copy(update={"gyro_samples": "interval"})}
    )
    _, point, _ = passes(of)
    _, interval, _ = passes(replace(of, drive=replace(of.drive, settings=settings)))
    apart = of.errors(point.q) - of.errors(interval.q)
    moving = np.abs(np.gradient(of.true_heading, of.drive.log.imu.t)) > 0.02
    expected = 0.5 * PERIOD_S * (of.drive.log.imu.gyro_b[:, 2] - of.drive.log.imu.gyro_b[0, 2])
    assert np.corrcoef(apart[moving], expected[moving])[0, 1] > 0.9


def test_the_zero_rate_form_beats_the_raw_gyro() -> None:
    of = short(stops=True, duration_s=240.0)
    _, _, smoothed = passes(of)
    assert largest_deg(of.errors(smoothed.q)) < 0.1 * largest_deg(of.raw_errors())
