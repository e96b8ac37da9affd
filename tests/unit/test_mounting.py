"""The IMU's seat in the vehicle is found from wheel speed and specific force, and its sigma holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from support.drives import Job, simulated

from attest_cli.maths import rotation
from attest_cli.mounting import ENOUGH_S, Mounting, _enough, axes_agree, find_mounting
from attest_cli.records import Imu
from attest_cli.simulate import RoverOptions

Array = NDArray[np.float64]
GRAVITY = 9.80665
SEATS = {
    "straight": (0, 0, 0),
    "turned left": (0, 0, 90),
    "on its side": (90, 0, 0),
    "upside down, askew": (175, 20, -140),
}


ENCODER = 0.005  # m/s: wheel speed of a good encoder; the simulator's 0.03 is a tenth of a rover's speed


@pytest.fixture(scope="module")
def work() -> Job:
    return with_encoder(RoverOptions(seed=81, motions=3, motion_s=(60.0, 120.0), rate_hz=50.0, odometry=True))


def with_encoder(options: RoverOptions) -> Job:
    """A drive whose odometry has the noise of a good encoder."""
    work = simulated(options)
    fixes = work.log.fixes["odometry"]
    noise = np.random.default_rng([options.seed, 1]).normal(0.0, ENCODER, len(fixes.t))
    values = np.zeros_like(fixes.values)
    values[:, 0] = work.truth(fixes.t).speed + noise
    return replace(work, log=replace(work.log, fixes={"odometry": replace(fixes, values=values)}))


def seated(work: Job, R_vb: Array, late_s: float = 0.0, speed: float = 1.0) -> Mounting | None:
    """Find the seat of an IMU bolted on with ``R_vb``, true attitude, odometry stamps ``late_s`` late."""
    imu = Imu(work.log.imu.t, work.log.imu.gyro_b @ R_vb, work.log.imu.accel_b @ R_vb)
    q = rotation.multiply(work.truth(imu.t).q_nb, rotation.from_matrix(R_vb))
    fixes = work.log.fixes["odometry"]
    return find_mounting(
        imu, q, work.segmentation, replace(fixes, t=fixes.t + late_s, values=speed * fixes.values), GRAVITY
    )


def forward_sigma_deg(found: Mounting) -> float:
    """Sigma of the forward axis, the larger of its two directions."""
    return float(np.degrees(found.sigma[1:].max()))


def forward_error_deg(found: Mounting, R_vb: Array) -> float:
    """Angle between the forward axis found and the true one, both in the IMU's axes."""
    true_b = R_vb.T[:, 0]
    return float(np.degrees(np.arccos(np.clip(rotation.matrix(found.q_bv)[:, 0] @ true_b, -1.0, 1.0))))


@pytest.mark.parametrize("name", SEATS)
def test_forward_axis_is_found_within_four_sigma(work: Job, name: str) -> None:
    R_vb = Rotation.from_euler("xyz", SEATS[name], degrees=True).as_matrix()
    found = seated(work, R_vb)
    assert found is not None
    error = forward_error_deg(found, R_vb)
    print(f"{name}: forward axis {error:.2f} deg off, sigma {forward_sigma_deg(found):.2f} deg, lag {found.lag:+.2f} s")
    assert error < 4.0 * forward_sigma_deg(found)
    assert found.certain
    assert not found.contradicted
    assert found.lag == 0.0
    R = rotation.matrix(found.q_bv)
    assert np.allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    assert (R_vb.T[:, 2] @ R[:, 2]) > np.cos(
        np.radians(15.0)
    )  # up is the mean slope of the stops: only roughly the vehicle's


def test_wheels_that_are_seconds_late_do_not_speed_up_as_the_accelerometer(work: Job) -> None:
    right, late = seated(work, np.eye(3)), seated(work, np.eye(3), late_s=4.0)
    assert right is not None
    assert late is not None
    assert not right.unlike
    assert late.unlike


def test_the_seat_does_not_depend_on_the_imus_axes(work: Job) -> None:
    R_vb = Rotation.from_euler("xyz", SEATS["upside down, askew"], degrees=True).as_matrix()
    straight, turned = seated(work, np.eye(3)), seated(work, R_vb)
    assert straight is not None
    assert turned is not None
    again = rotation.multiply(rotation.from_matrix(R_vb), turned.q_bv)
    assert np.abs(rotation.log_quaternion(rotation.multiply(rotation.conjugate(straight.q_bv), again))).max() < 1e-6
    assert axes_agree(straight)
    assert not axes_agree(turned)


@pytest.mark.parametrize("encoder", [True, False], ids=["good encoder", "3 cm/s"])
def test_four_sigma_holds_over_drives(encoder: bool) -> None:
    ratios = []
    for seed in range(82, 88 if encoder else 86):
        options = RoverOptions(seed=seed, motions=4, motion_s=(60.0, 90.0), rate_hz=50.0, odometry=True)
        found = seated(with_encoder(options) if encoder else simulated(options), np.eye(3))
        if found is not None:
            ratios.append(forward_error_deg(found, np.eye(3)) / forward_sigma_deg(found))
    print("forward axis, sigma:", np.round(ratios, 1))
    assert len(ratios) == (6 if encoder else 4)
    assert max(ratios) < 4.0


@pytest.mark.parametrize("late_s", [0.4, -0.3])
def test_late_odometry_is_noticed(work: Job, late_s: float) -> None:
    found = seated(work, np.eye(3), late_s)
    assert found is not None
    assert found.lag == pytest.approx(late_s, abs=0.101)


def test_late_odometry_is_noticed_where_its_starts_and_halts_look_like_slips() -> None:
    work = simulated(RoverOptions(seed=1, scenario="S2", motions=2, motion_s=(30.0, 40.0), odometry=True))
    found = seated(work, np.eye(3), 0.5)
    assert found is not None
    assert found.lag == pytest.approx(0.5, abs=0.101)


def test_a_seat_that_the_drive_does_not_show_is_not_invented(work: Job) -> None:
    assert seated(work, np.eye(3), speed=0.0) is None  # wheels that never turned
    no_stops = replace(work.segmentation, segments=work.segmentation.motions)
    fixes, imu = work.log.fixes["odometry"], work.log.imu
    q = work.truth(imu.t).q_nb
    assert find_mounting(imu, q, no_stops, fixes, GRAVITY) is None
    short = replace(work.segmentation, segments=work.segmentation.segments[:1])
    assert find_mounting(imu, q, short, fixes, GRAVITY) is None


@pytest.mark.parametrize("factor", [3.6, 0.5])
def test_a_wrong_wheel_speed_is_contradicted(work: Job, factor: float) -> None:
    found = seated(work, np.eye(3), speed=factor)
    assert found is not None
    assert found.scale == pytest.approx(1.0 / factor, rel=0.15)
    assert found.contradicted


def test_slips_of_seconds_move_neither_axis_nor_scale_nor_clock(work: Job) -> None:
    fixes, motion = work.log.fixes["odometry"], work.segmentation.motions[0]
    for slip_m_s, length in ((0.6, 6.0), (1.5, 4.0), (3.0, 2.0)):
        slips = (fixes.t > motion.start + 20.0) & (fixes.t < motion.start + 20.0 + length)
        slipping = replace(fixes, values=fixes.values + slip_m_s * slips[:, None] * [1.0, 0.0, 0.0])
        found = seated(replace(work, log=replace(work.log, fixes={"odometry": slipping})), np.eye(3))
        assert found is not None
        print(f"{slip_m_s} m/s for {length} s: scale {found.scale:.3f} +- {found.scale_sigma:.3f}, lag {found.lag} s")
        assert found.certain
        assert not found.contradicted
        assert found.scale == pytest.approx(1.0, abs=0.1)
        assert found.lag == 0.0


def test_no_false_lag_with_noisy_wheels() -> None:
    for seed in range(90, 94):
        options = RoverOptions(seed=seed, motions=6, motion_s=(60.0, 90.0), rate_hz=50.0, odometry=True)
        found = seated(simulated(options), np.eye(3))
        assert found is not None
        print(f"seed {seed}: lag {found.lag:+.2f} s, scale {found.scale:.3f} +- {found.scale_sigma:.3f}")
        assert found.lag == 0.0
        assert found.scale == pytest.approx(1.0, abs=0.2)


def test_axes_agree_within_three_degrees_or_three_sigma() -> None:
    def turned(deg: tuple[float, float, float], sigma_deg: float) -> Mounting:
        q = rotation.exp_quaternion(np.radians(deg))
        return Mounting(q, np.full(3, np.radians(sigma_deg)), 1.0, 0.01, 0.0, "")

    assert axes_agree(turned((0.0, 2.9, 0.0), 0.1))
    assert not axes_agree(turned((0.0, 0.0, 3.1), 0.1))
    assert axes_agree(turned((0.0, 0.0, 8.9), 3.0))
    assert not axes_agree(turned((0.0, 0.0, 9.1), 3.0))


def test_a_motion_of_a_day_is_asked_for_a_quarter_of_an_hour(work: Job) -> None:
    stop, motion = work.segmentation.segments[:2]
    day = replace(work.segmentation, segments=(stop, replace(motion, end=motion.start + 86_400.0)))
    assert _enough(day, 1e6) == motion.start + ENOUGH_S
    assert _enough(work.segmentation, 1e6) == 1e6  # all of a short drive
