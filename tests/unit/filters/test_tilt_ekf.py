"""Vaganay's filter: its parts against reference vectors, what it adds to the paper, and how it meets odd drives."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt, sosfilt_zi, sosfiltfilt
from support.vaganay import charly, drive_of, tilt_errors, true_angles

from attest_cli.errors import AttestError
from attest_cli.filters import Drive, accelerometer_angles, tilt_ekf
from attest_cli.filters.samples import rotation_vectors
from attest_cli.maths import kalman, rotation
from attest_cli.records import Fixes, Log, Smoothed
from attest_cli.simulate import Simulation
from attest_cli.smoothers import SMOOTHERS, backward_estimate

Array = NDArray[np.float64]
FOLDER = Path(__file__).resolve().parents[2] / "vectors" / "others"
NO_LEVER = {"tilt_ekf": {"lever_arm_m": [0.0, 0.0, 0.0]}}
CLOSE = {"rtol": 1e-9, "atol": 1e-13}


def load(name: str) -> dict[str, NDArray[Any]]:
    with np.load(FOLDER / f"{name}.npz") as file:
        return dict(file)


# --- reference vectors


def test_angles_and_matrix_of_a_quaternion_are_the_vector() -> None:
    v = load("rotations")
    assert np.allclose(rotation.matrix(v["q"]), v["dcm"], **CLOSE)
    assert np.allclose(rotation.matrix(v["q"])[:, 2], v["up"], **CLOSE)
    assert np.allclose(rotation.roll_pitch_yaw(v["q"]), np.stack([v["roll"], v["pitch"], v["yaw"]], axis=1), **CLOSE)


def pure(v: Array) -> Array:
    return np.concatenate([np.zeros((len(v), 1)), v], axis=1)


def edwards(q0: Array, before: Array, a: Array, commutator: float, cubic: float) -> Array:
    """``Q (1 + a/2 + a^2/8 + cubic a^3 + commutator (a* a - a a*))``, normalised."""
    p, s = pure(a), pure(before)
    square = rotation.multiply(p, p)
    swap = rotation.multiply(s, p) - rotation.multiply(p, s)
    factor = pure(np.zeros_like(a)) + [1.0, 0.0, 0.0, 0.0] + p / 2 + square / 8
    factor = factor + cubic * rotation.multiply(square, p) + commutator * swap
    return rotation.normalise(rotation.multiply(q0, factor))


def one_step(v: dict[str, NDArray[Any]]) -> Array:
    """The update of attest: the second of two steps, third order."""
    turns = [
        rotation_vectors(np.stack([b, a]), np.array([False, True]))[1] for b, a in zip(v["a_prev"], v["a"], strict=True)
    ]
    return rotation.multiply(v["q0"], rotation.exp_quaternion(np.array(turns)))


def test_edwards_update_is_the_vector_in_all_its_forms() -> None:
    v = load("edwards")
    assert np.allclose(one_step(v), v["rotvec"], **CLOSE)
    assert np.allclose(edwards(v["q0"], v["a_prev"], v["a"], 1 / 48, 1 / 48), v["edwards"], **CLOSE)
    assert np.allclose(edwards(v["q0"], v["a_prev"], v["a"], 1 / 24, 0.0), v["printed"], **CLOSE)
    assert np.allclose(rotation.multiply(v["q0"], rotation.exp_quaternion(v["a"])), v["plain"], **CLOSE)


def apart(p: Array, q: Array) -> Array:
    return np.linalg.norm(rotation.log_quaternion(rotation.multiply(rotation.conjugate(p), q)), axis=1)


def test_the_update_is_nearer_to_the_truth_than_the_printed_form_and_none() -> None:
    v = load("edwards")
    ours, printed, plain = (apart(q, v["exact"]) for q in (one_step(v), v["printed"], v["plain"]))
    assert np.median(ours / plain) < 0.2
    assert np.median(printed / plain) > 0.8  # twice the commutator: as wrong as without it


@pytest.mark.parametrize(("factor", "order"), [(1.0, 3), (2.0, 2), (0.0, 2)])
def test_order_of_the_update_on_a_turning_axis(factor: float, order: int) -> None:
    """Third order with the consistent coefficient, second with the printed one or none."""
    errors = []
    for dt in (0.05, 0.025):
        t = np.linspace(0.0, 5.0, round(5.0 / dt) + 1)
        fine = np.linspace(0.0, 5.0, 20_001)

        def turn(at: Array) -> Array:  # integral of the rate
            return np.stack([np.sin(2 * at) / 2, -np.cos(3 * at) / 3, 0.7 * at], axis=1)

        truth = rotation.chain(rotation.exp_quaternion(np.diff(turn(fine), axis=0)))[-1]
        alpha = np.diff(turn(t), axis=0)
        coned = rotation_vectors(alpha, np.arange(len(alpha)) > 0)
        found = rotation.chain(rotation.exp_quaternion(alpha + factor * (coned - alpha)))[-1]
        errors.append(float(apart(truth[None], found[None])[0]))
    rate = np.log2(errors[0] / errors[1])
    print(f"factor {factor}: order {rate:.2f}")
    assert round(rate) == order


def test_compensated_accelerometer_angles_are_the_vector() -> None:
    v = load("accelerometer_angles")
    moved = accelerometer_angles.acceleration(v["V"], v["dV"], v["w"], v["dw"], v["d"])
    assert np.allclose(moved, v["lin"], rtol=1e-9, atol=1e-12)
    gravity = v["f"] - moved
    two = np.stack([v["pitch_est"], v["roll_est"]], axis=1)  # the paper's form, from x and y alone
    seen = accelerometer_angles.components(two, float(np.linalg.norm(gravity[0])))
    assert np.allclose(seen, gravity[:, :2], rtol=1e-9, atol=1e-12)
    three = accelerometer_angles.angles(1.07 * gravity)  # whatever the scale
    assert np.allclose(three, np.stack([v["pitch"], v["roll"]], axis=1), rtol=1e-9, atol=1e-12)


def test_the_low_pass_is_the_vector() -> None:
    v = load("butterworth")
    t, edges = np.arange(300) / 100.0, np.array([0, 300])
    kept = accelerometer_angles.low_pass(v["x"][:, None], t, edges, 10.0)[:, 0]
    assert np.allclose(kept, v["filtfilt_keep"], rtol=1e-9, atol=1e-12)
    sections = butter(2, 10.0, fs=100.0, output="sos")
    assert np.allclose(sosfilt(sections, v["x"], zi=sosfilt_zi(sections) * v["x"][0])[0], v["causal"], **CLOSE)
    assert np.allclose(sosfiltfilt(sections, v["x"]), v["filtfilt"], **CLOSE)


@pytest.mark.parametrize("smoother", ["rts", "two-filter"])
def test_the_filter_and_its_smoothers_are_the_vector(smoother: str) -> None:
    v = load("vaganay_ekf")
    n, z = len(v["t"]), v["z"]
    given = np.stack([z[:, 3], z[:, 2], np.zeros(n)], axis=1)  # roll, pitch, yaw of the gyro
    gyro = tilt_ekf.Gyro(np.zeros((n - 1, 4)), np.empty(0, dtype=np.int64), given)
    R = np.tile(np.diag(v["R"]), (n, 1))
    model = tilt_ekf.Model(
        gyro, v["t"], z[:, :2], np.ones(n, dtype=np.bool_), np.tile(v["Q"], (n - 1, 1, 1)), R, 9.81, 0.0, R[:, 0]
    )
    found = tilt_ekf.fuse(model, v["x0"], v["P0"] + v["Q"])  # the vector predicts before its first update
    chain = found.chain
    errors = kalman.rts(chain) if smoother == "rts" else kalman.fuse(chain, *kalman.information(chain))
    for ours, theirs in (
        (found.x_pred, v["xp"]), (found.x, v["xf"]), (chain.P_pred, v["Pp"]), (chain.P, v["Pf"]),
        (found.x + errors.d, v["xs"]), (errors.P, v["Ps"]),
    ):  # fmt: skip
        assert np.allclose(ours, theirs, rtol=1e-9, atol=1e-9 * np.abs(theirs).max())


# --- accelerometer angles


def test_the_low_pass_keeps_its_cut_and_has_no_delay() -> None:
    t = np.arange(4000) / 100.0
    for frequency, gain in ((1.0, 1.0), (10.0, np.sqrt(0.5))):
        wave = np.sin(2 * np.pi * frequency * t)
        out = accelerometer_angles.low_pass(wave[:, None], t, np.array([0, len(t)]), 10.0)[1000:-1000, 0]
        amplitude = 2.0 * np.mean(out * wave[1000:-1000])  # of the part in phase
        assert amplitude == pytest.approx(gain, abs=2e-3)
        assert np.sqrt(2.0 * np.mean(out**2)) == pytest.approx(amplitude, rel=1e-3)


def test_pieces_are_filtered_on_their_own_and_slow_or_short_ones_not_at_all() -> None:
    t = np.concatenate([np.arange(100) / 100.0, 60.0 + np.arange(100) / 100.0, 90.0 + np.arange(5) / 100.0])
    values = np.where(t < 30.0, 1.0, 5.0)[:, None] + 0.1 * np.sin(40 * t)[:, None]
    edges = np.array([0, 100, 200, 205])
    out = accelerometer_angles.low_pass(values, t, edges, 10.0)
    alone = accelerometer_angles.low_pass(values[100:200], t[100:200], np.array([0, 100]), 10.0)
    assert np.array_equal(out[100:200], alone)
    assert np.array_equal(out[200:], values[200:])
    assert np.array_equal(accelerometer_angles.low_pass(values, t, edges, 26.0), values)
    slope = accelerometer_angles.derivative(np.stack([3.0 * t, t * 0], axis=1), t, edges)
    assert np.allclose(slope, [3.0, 0.0])


def test_angles_keep_their_sign_past_ninety_degrees() -> None:
    pitch_roll = np.radians([[10.0, 120.0], [-20.0, -170.0], [5.0, 1e-9]])
    (sp, sr), (cp, cr) = np.sin(pitch_roll.T), np.cos(pitch_roll.T)
    force = 9.81 * np.stack([-sp, cp * sr, cp * cr], axis=1)
    assert np.allclose(accelerometer_angles.angles(force), pitch_roll, atol=1e-14)
    assert np.allclose(accelerometer_angles.components(pitch_roll, 9.81), force[:, :2])
    rpy = np.concatenate([pitch_roll[:, ::-1], [[0.3], [0.4], [-2.0]]], axis=1)
    assert np.abs(accelerometer_angles.levelled(force, rpy)).max() < 1e-12


def test_motion_density_finds_white_noise_under_a_drift(rng: np.random.Generator) -> None:
    t = np.arange(0.0, 400.0, 0.01)
    noise = rng.normal(0.0, 0.3, (len(t), 2))
    drift = 0.01 * t[:, None] - 2.0
    spans = np.array([[0.0, 180.0], [200.0, 390.0]])
    found = accelerometer_angles.motion_density(noise + drift, t, spans)
    assert found == pytest.approx(0.03, rel=0.5)  # the largest of four estimates, 40 to 350 differences each
    assert found >= 0.03 * 0.9
    fast = 0.5 * np.sin(2 * np.pi * 8.0 * t)[:, None] * np.ones(2)
    assert accelerometer_angles.motion_density(fast, t, spans) < 0.01  # vibration averages out
    assert accelerometer_angles.sample_variance(noise) == pytest.approx(0.09, rel=0.05)


def test_short_motions_count_as_they_are() -> None:
    t = np.arange(0.0, 1.0, 0.01)
    force = np.tile([0.3, -0.4], (len(t), 1))
    found = accelerometer_angles.motion_density(force, t, np.array([[0.0, 1.0]]))
    assert found == pytest.approx(np.sqrt(0.125))


# --- the model


@pytest.mark.parametrize("states", [4, 8])
def test_the_jacobian_is_the_derivative(states: int, rng: np.random.Generator) -> None:
    x, step = rng.normal(0.0, 0.3, states), 1e-6
    _, H = tilt_ekf.observation(x, 7.0, 9.81)
    for i in range(states):
        e = step * np.eye(states)[i]
        slope = (tilt_ekf.observation(x + e, 7.0, 9.81)[0] - tilt_ekf.observation(x - e, 7.0, 9.81)[0]) / (2 * step)
        assert np.allclose(H[:, i], slope, atol=1e-8)


def test_errors_turn_with_the_vehicle(rng: np.random.Generator) -> None:
    """A vertical that is wrong in the world looks, in roll and pitch, as ``turned_errors`` says."""
    q, eps = rotation.exp_quaternion(np.array([0.2, -0.3, 0.5])), 1e-7
    lean = rotation.exp_quaternion(eps * np.array([1.0, -0.6, 0.0]))
    turned = rotation.multiply(q, rotation.exp_quaternion(rng.normal(0.0, 0.4, 3)))
    both = np.stack([q, turned])
    rpy = rotation.roll_pitch_yaw(both)
    error = (rotation.roll_pitch_yaw(rotation.multiply(lean, both)) - rpy)[:, 1::-1] / eps
    assert np.allclose(tilt_ekf.turned_errors(rpy)[0] @ error[0], error[1], atol=1e-5)


def test_gyro_angles_are_integrated_from_where_they_are_started() -> None:
    turn = np.tile([0.002, -0.001, 0.01], (20, 1))
    gyro = tilt_ekf.Gyro.of(turn, np.array([0, 12]))
    assert gyro.begin(0, 0.1, -0.2) == slice(0, 12)
    assert gyro.begin(12, 0.3, 0.4) == slice(12, 20)
    assert np.allclose(gyro.angles[12], [0.4, 0.3, 0.0])
    q = rotation.multiply(*rotation.exp_quaternion(np.array([[0.0, 0.3, 0.0], [0.4, 0.0, 0.0]])))
    for step in turn[12:]:
        q = rotation.multiply(q, rotation.exp_quaternion(step))
    assert np.allclose(gyro.angles[20], rotation.roll_pitch_yaw(q), atol=1e-12)


def test_the_clock_and_the_starts() -> None:
    still = np.array([1, 1, 1, 0, 0, 1, 1, 1, 0, 0], dtype=np.bool_)
    starts = tilt_ekf._starts(still)
    assert starts.tolist() == [0, 1, 6]
    free = np.array([0, 0, 1, 1, 1, 0, 0, 1, 1.0])
    assert tilt_ekf._clock(free, starts).tolist() == [0, 0, 0, 1, 2, 3, 3, 0, 1, 2]


# --- drives


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return charly(5, duration_s=30.0)


@pytest.fixture(scope="module")
def drive(simulation: Simulation) -> Drive:
    return drive_of(simulation)


def without_wheels(log: Log) -> Log:
    return replace(log, fixes={})


def smoothed(drive: Drive, smoother: str = "two-filter") -> Smoothed:
    return SMOOTHERS[smoother](tilt_ekf.forward(drive).run)


def test_both_smoothers_agree_and_beat_the_filter(simulation: Simulation, drive: Drive) -> None:
    run = tilt_ekf.forward(drive).run
    two, one, none = (SMOOTHERS[name](run) for name in ("two-filter", "rts", "none"))
    assert apart(two.q, one.q).max() < 1e-8
    assert np.allclose(two.P, one.P, rtol=1e-6, atol=1e-12)
    assert np.array_equal(none.q, run.q)
    errors = [float(np.sqrt(np.mean(tilt_errors(simulation, found.q) ** 2))) for found in (two, none)]
    assert errors[0] < 0.75 * errors[1]
    assert run.absent == ("heading", "gyro bias")
    assert set(run.innovations.role) == {"accelerometer"}
    assert np.allclose(np.diff(run.innovations.t), 0.05)  # at twice the cut


def test_from_the_end_the_vertical_is_known_as_well_as_it_says(simulation: Simulation, drive: Drive) -> None:
    """The accelerometer's bias is one and the same from both ends: from the end it is known beforehand too."""
    run = tilt_ekf.forward(drive).run
    q, _, P = backward_estimate(run)
    known = np.isfinite(q[:, 0])
    assert known.mean() > 0.8
    errors, sigma = tilt_errors(simulation, np.where(known[:, None], q, run.q)), np.sqrt(P[:, [0, 1], [0, 1]])
    assert np.mean(np.abs(errors[known]) < 3.0 * sigma[known]) > 0.95
    assert np.degrees(np.median(sigma[known])) < 0.3
    blind, _, _ = backward_estimate(replace(run, beforehand=None))
    assert np.isfinite(blind[:, 0]).mean() < known.mean()


def test_a_compensated_drive_needs_no_word(drive: Drive) -> None:
    assert tilt_ekf.forward(drive).warnings == ()


def test_without_odometry_it_says_so_and_sigma_covers_it(simulation: Simulation, drive: Drive) -> None:
    found = tilt_ekf.forward(drive_of(simulation, without_wheels))
    assert [w.code for w in found.warnings] == ["acceleration-not-compensated"]
    assert found.warnings[0].message.startswith("no odometry")
    with_wheels, without = smoothed(drive), SMOOTHERS["two-filter"](found.run)
    ratio = np.median(np.sqrt(without.P[:, 0, 0] / with_wheels.P[:, 0, 0]))
    assert ratio > 1.5
    assert np.mean(np.abs(tilt_errors(simulation, without.q)) < 3 * np.sqrt(without.P[:, [0, 1], [0, 1]])) > 0.99


def test_odometry_that_adds_noise_is_left_alone(simulation: Simulation, rng: np.random.Generator) -> None:
    def noisy(log: Log) -> Log:
        wheels = log.fixes["odometry"]
        values = wheels.values.copy()
        values[:, 0] += np.repeat(rng.normal(0.0, 3.0, len(values) // 100 + 1), 100)[: len(values)]
        return replace(log, fixes={"odometry": replace(wheels, values=values)})

    found = tilt_ekf.forward(drive_of(simulation, noisy))
    assert "more noise" in found.warnings[0].message
    assert "100 Hz, is too rough" in found.warnings[0].hint


def test_a_setting_for_absolute_sensors_is_told_to_mean_nothing(simulation: Simulation) -> None:
    drive = drive_of(simulation, smoothing={"filter": "tilt-ekf", "absolute": "always"})
    assert "--absolute has no meaning with --filter tilt-ekf: not used" in [
        w.message for w in tilt_ekf.forward(drive).warnings
    ]


def turned_imu(q_new_old: Array, log: Log) -> Log:
    R = rotation.matrix(q_new_old)
    imu = replace(log.imu, gyro_b=log.imu.gyro_b @ R.T, accel_b=log.imu.accel_b @ R.T)
    return replace(log, imu=imu, fixes={})


@pytest.fixture(scope="module")
def level(simulation: Simulation) -> Smoothed:
    return smoothed(drive_of(simulation, without_wheels, **NO_LEVER))


@pytest.mark.parametrize("axis", [[np.pi / 2, 0.0, 0.0], [0.0, -np.pi / 2, 0.0], [np.pi, 0.0, 0.0]])
def test_the_seat_of_the_imu_does_not_matter(simulation: Simulation, level: Smoothed, axis: list[float]) -> None:
    """Gravity on y, on x, on -z: the tilt is that of the upright IMU, in other axes."""
    seat = rotation.exp_quaternion(np.array(axis))
    tilted = smoothed(drive_of(simulation, lambda log: turned_imu(seat, log), **NO_LEVER))
    up = rotation.matrix(level.q)[:, 2] @ rotation.matrix(seat).T
    assert np.degrees(np.arccos(np.clip(np.sum(rotation.matrix(tilted.q)[:, 2] * up, axis=1), -1, 1))).max() < 0.02


def test_a_lying_imu_cannot_use_odometry_and_says_so(simulation: Simulation) -> None:
    seat = rotation.exp_quaternion(np.array([np.pi / 2, 0.0, 0.0]))

    def lying(log: Log) -> Log:
        return replace(turned_imu(seat, log), fixes=log.fixes)

    found = tilt_ekf.forward(drive_of(simulation, lying, imu={"mounting": "auto"}))
    assert "forward axis" in found.warnings[0].message
    assert "mounting" in found.warnings[0].hint


def test_a_hole_in_the_log_opens_sigma_and_the_accelerometer_closes_it(simulation: Simulation) -> None:
    def holed(log: Log) -> Log:
        keep = (log.imu.t < 15.0) | (log.imu.t > 17.0)
        imu = replace(log.imu, t=log.imu.t[keep], gyro_b=log.imu.gyro_b[keep], accel_b=log.imu.accel_b[keep])
        return replace(log, imu=imu, stamps_ns=log.stamps_ns[keep], gaps=np.array([[14.99, 17.01]]))

    drive = drive_of(simulation, holed)
    forward = SMOOTHERS["none"](tilt_ekf.forward(drive).run)
    sigma = np.degrees(np.sqrt(forward.P[:, 0, 0]))
    after = int(np.searchsorted(drive.log.imu.t, 17.0))
    assert sigma[after] > 5.0 * sigma[after - 1] > 2.5 * sigma[after + 500]
    truth = np.interp(drive.log.imu.t, simulation.truth["t_s"], true_angles(simulation)[:, 1])
    roll = rotation.roll_pitch_yaw(forward.q)[:, 0]
    assert np.degrees(np.abs(roll - truth)[after + 500 :]).max() < 1.0


def test_beyond_eighty_degrees_of_pitch_it_refuses(simulation: Simulation) -> None:
    def tumbling(log: Log) -> Log:
        gyro = log.imu.gyro_b.copy()
        gyro[(log.imu.t > 10.0) & (log.imu.t < 11.0), 1] += 1.7
        return replace(log, imu=replace(log.imu, gyro_b=gyro), fixes={})

    with pytest.raises(AttestError, match="pitch passes 80 deg"):
        tilt_ekf.forward(drive_of(simulation, tumbling))


def test_vibration_faster_than_its_density_is_no_contradiction(
    simulation: Simulation, rng: np.random.Generator
) -> None:
    """A vibration that averages out leaves the filter's noise alone; its samples are judged as they scatter."""

    def shaken(log: Log) -> Log:
        wave = sosfiltfilt(
            butter(2, (6.0, 9.0), "bandpass", fs=100.0, output="sos"), rng.normal(size=(len(log.imu.t), 3)), axis=0
        )
        return replace(log, imu=replace(log.imu, accel_b=log.imu.accel_b + 8.0 * (log.imu.t > 6.0)[:, None] * wave))

    drive = drive_of(simulation, shaken)
    run = tilt_ekf.forward(drive).run
    s = tilt_ekf.samples(drive)
    seen, _ = tilt_ekf._gravity(drive, s, 5, as_mounted=True)
    model, _, _ = tilt_ekf._model(drive, s, seen, 5)
    moving = np.flatnonzero(~s.still)
    assert model.spread[moving[0]] > 3.0 * model.R[moving[0], 0]  # by R alone the mean NIS would be beyond 6
    judged = run.moving[run.innovations.node]
    assert 1.0 < run.innovations.nis[judged].mean() < 2.6


def test_stated_noise_is_taken(simulation: Simulation) -> None:
    told = {"accel_noise_density": 0.022, "angle_noise_density": "1 deg/sqrt(s)", "gate_sigmas": 0.0}
    drive = drive_of(simulation, tilt_ekf=told)
    s = tilt_ekf.samples(drive)
    seen, _ = tilt_ekf._gravity(drive, s, 5, as_mounted=True)
    model, _, _ = tilt_ekf._model(drive, s, seen, 5)
    moving = np.flatnonzero(~s.still)[0]
    assert model.R[moving, 0] == pytest.approx(0.022**2 / 0.05)
    assert model.Q[10, 0, 0] == pytest.approx(np.radians(1.0) ** 2 * 0.01)
    assert model.gate == 0.0


def test_odometry_before_and_after_the_log_does_no_harm(simulation: Simulation, drive: Drive) -> None:
    def cut(log: Log) -> Log:
        wheels = log.fixes["odometry"]
        inside = (wheels.t > 5.0) & (wheels.t < 20.0)
        return replace(
            log, fixes={"odometry": Fixes("odometry", wheels.channel, wheels.t[inside], wheels.values[inside])}
        )

    found = smoothed(drive_of(simulation, cut))
    assert np.degrees(np.abs(tilt_errors(simulation, found.q)).max()) < 0.5
