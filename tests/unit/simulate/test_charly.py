"""The plank run: exact truth at the lever arm, the paper's run, the stated errors."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import ndtri
from support.signals import accel_of, assert_variance, attitude_error, channel, gyro_bias_of, gyro_of, stack

from attest_cli.errors import AttestError
from attest_cli.maths import rotation
from attest_cli.prepare import prepare
from attest_cli.segment import find_segments
from attest_cli.settings import Settings
from attest_cli.simulate import CharlyOptions, Simulation, simulate_charly
from attest_cli.simulate.charly import (
    ACCEL_NOISE_M_S2,
    EDGE_S,
    GYRO_BIAS_RAD_S,
    GYRO_BIAS_SIGMA_RAD_S,
    GYRO_NOISE_RAD_S,
    LEVER_ARM_M,
    PLANKS_S,
    ROLL_RAD,
    SHOCK_DECAY,
    SHOCK_M_S2,
    SHOCK_SAMPLES,
    SHOCKS,
    TICK_M,
    VIBRATION_M_S2,
    CharlyRun,
    shocks,
)
from attest_cli.simulate.drive import GRAVITY_M_S2

RUN = CharlyRun.of(CharlyOptions())


@pytest.fixture(scope="module")
def run() -> Simulation:
    return simulate_charly(CharlyOptions(seed=3))


def test_integrating_the_clean_gyro_gives_the_true_attitude() -> None:
    coarse, fine = (attitude_error(RUN.at, 0.0, 47.0, step) for step in (0.01, 0.005))
    assert fine < 1e-8
    assert fine < coarse / 10.0 or fine < 1e-12


def test_the_force_at_the_lever_arm_is_that_of_a_rigid_body() -> None:
    t, h = np.arange(0.0105, 47.0, 0.0231), 1e-5
    clean, after, before = (RUN.at(x) for x in (t, t + h, t - h))
    p, q, r = clean.rate_b.T
    p_, q_, r_ = ((after.rate_b - before.rate_b) / (2 * h)).T
    V, V_ = clean.speed, (after.speed - before.speed) / (2 * h)
    x, y, z = LEVER_ARM_M
    ax = V_ + q_ * z - r_ * y + q * (p * y - q * x) - r * (r * x - p * z)
    ay = V * r + r_ * x - p_ * z + r * (q * z - r * y) - p * (p * y - q * x)
    az = -V * q + p_ * y - q_ * x + p * (r * x - p * z) - q * (q * z - r * y)
    gravity = GRAVITY_M_S2 * clean.R_nb[:, 2, :]
    np.testing.assert_allclose(clean.force_b - gravity, np.column_stack([ax, ay, az]), atol=2e-5)
    assert np.abs(ay).max() > 0.3  # the turn and the edges of the planks are felt there


def test_the_force_at_the_lever_arm_moves_the_accelerometer() -> None:
    t, h, arm = np.arange(0.0105, 47.0, 0.0231), 1e-5, np.array(LEVER_ARM_M)

    def velocity(x: np.ndarray) -> np.ndarray:
        clean = RUN.at(x)
        return clean.velocity_n + np.einsum("nij,nj->ni", clean.R_nb, np.cross(clean.rate_b, arm))

    clean = RUN.at(t)
    felt = np.einsum("nij,nj->ni", clean.R_nb, clean.force_b) - [0.0, 0.0, GRAVITY_M_S2]
    np.testing.assert_allclose((velocity(t + h) - velocity(t - h)) / (2 * h), felt, atol=2e-5)


def test_the_run_is_that_of_the_paper(run: Simulation) -> None:
    t, truth = run.truth["t_s"], run.truth
    assert t.size == 4700
    np.testing.assert_allclose(np.diff(t), 0.01, atol=1e-12)
    R = Rotation.from_quat(stack(truth, "q_w", "q_x", "q_y", "q_z"), scalar_first=True)
    yaw, pitch, roll = np.degrees(R.as_euler("ZYX")).T
    for on, off, sign in PLANKS_S:
        np.testing.assert_allclose(roll[(t > on + EDGE_S) & (t < off)], sign * 1.768, atol=1e-3)
        assert R.as_matrix()[int(100 * on) + 100, 2, 1] * sign > 0.0  # roll > 0 raises the left side
        assert pitch[int(100 * on) + 75] == pytest.approx(-0.8, abs=1e-3)  # nose up when climbing
        assert R.as_matrix()[int(100 * on) + 75, 2, 0] > 0.0
        assert pitch[int(100 * off) + 75] == pytest.approx(0.8, abs=1e-3)
    assert roll[0] == roll[2150] == roll[-1] == 0.0
    np.testing.assert_allclose(np.abs(yaw[-1]), 180.0, atol=1e-9)
    position = stack(truth, *(f"position_{a}_m" for a in "xyz"))
    assert position[2400, 0] == pytest.approx(5.0, abs=1e-3)  # along the ground; 0.8 deg of pitch shorten it by 0.1 mm
    np.testing.assert_allclose(position[-1], 0.0, atol=1e-3)
    np.testing.assert_allclose(run.stops, [[0.0, 4.0], [21.0 + 2 / 3, 22.0], [26.0, 27.0], [44.0 + 2 / 3, 47.0]])
    inside = np.any((t[:, None] >= run.stops[:, 0]) & (t[:, None] <= run.stops[:, 1]), axis=1)
    np.testing.assert_array_equal(truth["moving"], ~inside)
    assert math.degrees(ROLL_RAD) == pytest.approx(1.768, abs=1e-3)


def test_position_is_the_integral_of_velocity(run: Simulation) -> None:
    t = np.arange(0.0, 47.0, 0.001)
    fine = np.cumsum(RUN.velocity(t + 0.0005) * 0.001, axis=0)[9::10]
    position = stack(run.truth, *(f"position_{a}_m" for a in "xyz"))[1:]
    np.testing.assert_allclose(position, fine[: len(position)], atol=1e-7)


def test_odometry_counts_ticks(run: Simulation) -> None:
    odometry = channel(run, "odometry")
    ticks = odometry.values["speed"] * 0.01 / TICK_M
    np.testing.assert_allclose(ticks, np.round(ticks), atol=1e-9)
    travelled = np.cumsum(odometry.values["speed"]) * 0.01
    true = RUN.speed.at(run.truth["t_s"])[0]
    assert np.abs(travelled - true).max() < TICK_M
    assert np.all(odometry.values["speed"][:401] == 0.0)
    assert travelled[-1] == pytest.approx(10.0, abs=TICK_M)


def test_errors_have_the_stated_size(run: Simulation) -> None:
    clean, moving = RUN.at(run.truth["t_s"]), run.truth["moving"]
    assert_variance(gyro_of(run) - clean.rate_b - gyro_bias_of(run), GYRO_NOISE_RAD_S)
    bias = stack(run.truth, *(f"accel_bias_{a}_m_s2" for a in "xyz"))
    error = accel_of(run) - clean.force_b - bias
    assert_variance(error[:, 2], np.where(moving, VIBRATION_M_S2, ACCEL_NOISE_M_S2))
    assert_variance(error[:400], ACCEL_NOISE_M_S2)
    assert_variance(error - shocks(CharlyOptions(seed=3), clean), np.where(moving, 0.25, 0.03)[:, None])
    assert np.all(np.diff(bias, axis=0) == 0.0)


def test_biases_are_those_of_the_paper() -> None:
    drawn = [simulate_charly(CharlyOptions(seed=seed, duration_s=1.0)) for seed in range(200)]
    gyro = np.array([gyro_bias_of(s)[0] for s in drawn])
    for axis in range(3):
        assert_variance(gyro[:, axis] - GYRO_BIAS_RAD_S[axis], GYRO_BIAS_SIGMA_RAD_S[axis])
    assert_variance(np.array([[s.truth[f"accel_bias_{a}_m_s2"][0] for a in "xyz"] for s in drawn]), 0.02)


def test_shocks_are_sharp_and_have_the_stated_energy() -> None:
    clean = RUN.at(np.arange(4700) * 0.01)
    energy = []
    for seed in range(200):
        total = shocks(CharlyOptions(seed=seed), clean)
        assert not total[:, 2].any()
        assert not total[:400].any()
        energy.append(np.sum(total**2))
        assert np.all(np.any(total[[700, 1200, 3200, 3700]] != 0.0, axis=1))
    shape = np.sum(np.exp(-2 * np.arange(SHOCK_SAMPLES) / SHOCK_DECAY))
    expected = 2 * (SHOCKS + 8) * SHOCK_M_S2**2 * shape
    allowed = ndtri(1 - 5e-5) * np.std(energy) / math.sqrt(len(energy))
    assert abs(np.mean(energy) - expected) < allowed


def test_gyro_angles_drift_and_turn_over_as_in_the_paper() -> None:
    """Roll error -5 deg/min to 22 s, the same with the other sign after the half turn: 1 sigma of a run is 0.15 deg."""
    before, after = [], []
    for seed in range(12):
        run = simulate_charly(CharlyOptions(seed=seed))
        rate = gyro_of(run)
        q = rotation.chain(rotation.exp_quaternion((rate[1:] + rate[:-1]) / 2 * 0.01))
        rolls = np.degrees(rotation.roll_pitch_yaw(q[[2189, 2649]])[:, 0])
        before.append(rolls[0])
        after.append(rolls[1])
    limit = 4.0 * math.hypot(0.4 / 60 * 22, 0.1 * math.sqrt(0.01 * 22)) / math.sqrt(12)
    assert abs(np.mean(before) + 5.0 / 60 * 21.9) < limit
    assert np.mean(after) == pytest.approx(1.82, abs=0.25)  # pitch bias of the turn adds to the scatter
    assert np.all(np.array(before) < 0.0)
    assert np.all(np.array(after) > 0.0)


def test_a_long_run_repeats_the_plank_each_minute_and_turns_as_asked() -> None:
    long = simulate_charly(CharlyOptions(seed=3, duration_s=120.0, turn_deg=90.0))
    t = long.truth["t_s"]
    assert t.size == 12_000
    yaw, _, roll = (
        Rotation.from_quat(stack(long.truth, "q_w", "q_x", "q_y", "q_z"), scalar_first=True).as_euler("ZYX").T
    )
    np.testing.assert_allclose(np.abs(yaw[[2700, 8700]]), [math.pi / 2, math.pi], atol=1e-9)
    np.testing.assert_allclose(roll[:4700], roll[6000:10_700], atol=1e-12)
    settings = Settings.model_validate(long.settings)
    stops = find_segments(prepare([long.log], settings), settings).stops
    found = np.array([[s.start, s.end] for s in stops])
    np.testing.assert_allclose(found, [[0.0, 4.0], [44.667, 64.0], [104.667, 120.0]], atol=0.6)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_stop_at_the_start_is_found(seed: int) -> None:
    run = simulate_charly(CharlyOptions(seed=seed))
    settings = Settings.model_validate(run.settings)
    stops = find_segments(prepare([run.log], settings), settings).stops
    assert stops
    assert stops[0].start == 0.0
    assert stops[0].end == pytest.approx(4.0, abs=0.6)
    assert all(s.end < 4.1 or s.start > 44.5 for s in stops)


def test_the_config_states_the_lever_arm_and_the_noise(run: Simulation) -> None:
    settings = Settings.model_validate(run.settings)
    assert settings.tilt_ekf.lever_arm_m == LEVER_ARM_M
    assert settings.imu.gyro_noise_density == pytest.approx(GYRO_NOISE_RAD_S * 0.1)
    assert settings.imu.accel_noise_density == pytest.approx(ACCEL_NOISE_M_S2 * 0.1)


def test_a_seed_fixes_every_bit(run: Simulation) -> None:
    again, other = simulate_charly(CharlyOptions(seed=3)), simulate_charly(CharlyOptions(seed=4))
    assert gyro_of(again).tobytes() == gyro_of(run).tobytes()
    assert accel_of(again).tobytes() == accel_of(run).tobytes()
    assert np.mean(gyro_of(other) == gyro_of(run)) < 1e-3


@pytest.mark.parametrize(("option", "value"), [("duration_s", 0.0), ("duration_s", math.nan), ("turn_deg", 400.0)])
def test_options_out_of_reach_are_refused(option: str, value: float) -> None:
    with pytest.raises(AttestError, match="choose"):
        CharlyOptions(**{option: value})  # type: ignore[arg-type]
