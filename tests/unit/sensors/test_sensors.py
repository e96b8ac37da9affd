"""The contract of a measurement model, run over the registry: its Jacobian is the derivative of its residual."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from attest_cli.maths import rotation
from attest_cli.sensors import SENSORS, Direction, Measurement, Sensor
from attest_cli.sensors.direction import tangent_basis
from attest_cli.sensors.heading import BodyHeading, FieldHeading, azimuth
from attest_cli.sensors.orientation import Orientation
from attest_cli.sensors.zero_rate import ZeroRate

Array = NDArray[np.float64]
STEP = 1e-5
BIAS = np.array([0.01, -0.02, 0.005])
SUN_N = np.array([0.54, -0.54, 0.6428])
TILT = Rotation.from_euler("xyz", [10, 25, 40], degrees=True).as_matrix()

Case = tuple[Sensor, Callable[[np.random.Generator, Array], Array]]


def near(R: Array, rng: np.random.Generator, size: float) -> Array:
    """Attitudes a random turn of about ``size`` rad away."""
    return R @ Rotation.from_rotvec(size * rng.normal(size=(len(R), 3))).as_matrix()


def sees(reference: Array, R_sb: Array, columns: int, size: float) -> Callable[[np.random.Generator, Array], Array]:
    return lambda rng, R: np.einsum("ij,mkj,k->mi", R_sb, near(R, rng, size), reference)[:, :columns]


# role -> models of that role, each with a maker of samples (rng, R) -> values. Residuals are not zero, but for the
# tangent rows: their basis turns with the prediction, so their Jacobian is that of the residual's own direction.
CASES: dict[str, list[Case]] = {
    "gravity": [
        (
            SENSORS["gravity"](np.array([0.0, 0.0, 9.81]), rows="full"),
            sees(np.array([0.0, 0.0, 9.81]), np.eye(3), 3, 0.2),
        ),
        (SENSORS["gravity"](np.array([0.0, 0.0, 1.0])), sees(np.array([0.0, 0.0, 1.0]), np.eye(3), 3, 0.0)),
    ],
    "sun": [
        (SENSORS["sun"](SUN_N, TILT, "plane"), sees(SUN_N, TILT, 2, 0.2)),
        (SENSORS["sun"](SUN_N, TILT, "tangent"), sees(SUN_N, TILT, 3, 0.0)),
        (SENSORS["sun"](SUN_N, TILT, "full"), sees(SUN_N, TILT, 3, 0.2)),
    ],
    "compass": [
        (
            SENSORS["compass"](),
            lambda rng, R: 0.5 * np.pi - azimuth(near(R, rng, 0.2), np.tile([1.0, 0, 0], (len(R), 1)))[0][:, None],
        )
    ],
    "magnetometer": [(SENSORS["magnetometer"](1.3), sees(np.array([5.7, 20.5, -43.0]), np.eye(3), 3, 0.2))],
    "orientation": [(SENSORS["orientation"](), lambda rng, R: rotation.from_matrix(near(R, rng, 0.5)))],
    "zero_rate": [(SENSORS["zero_rate"](), lambda rng, R: 0.01 * rng.normal(size=(len(R), 3)))],
}
FLAT = [
    pytest.param(sensor, make, id=f"{role}-{i}")
    for role, cases in CASES.items()
    for i, (sensor, make) in enumerate(cases)
]


def attitudes(rng: np.random.Generator, m: int = 8) -> Array:
    """Random attitudes whose body x axis keeps clear of the vertical."""
    angles = rng.uniform([-3.0, -1.0, -3.0], [3.0, 1.0, 3.0], (m, 3))
    return np.asarray(Rotation.from_euler("xyz", angles).as_matrix())


def perturbed(R: Array, bias: Array, state: int, size: float) -> tuple[Array, Array]:
    d = np.zeros(6)
    d[state] = size
    return R @ rotation.matrix(rotation.exp_quaternion(d[:3])), bias + d[3:]


def test_every_registered_sensor_is_tested_here() -> None:
    assert set(CASES) == set(SENSORS)


@pytest.mark.parametrize(("sensor", "make"), FLAT)
def test_jacobian_is_the_derivative_of_the_residual(
    rng: np.random.Generator, sensor: Sensor, make: Callable[..., Array]
) -> None:
    R = attitudes(rng)
    values = make(rng, R)
    r, H = sensor.linearise(R, BIAS, values)
    assert r.shape == (len(R), sensor.dof)
    assert H.shape == (len(R), sensor.dof, 6)
    columns = []
    for state in range(6):
        (ahead, _), (behind, _) = (sensor.linearise(*perturbed(R, BIAS, state, s * STEP), values) for s in (1, -1))
        columns.append(-(ahead - behind) / (2 * STEP))  # r = z - h(x)
    difference = np.stack(columns, axis=2)
    if isinstance(sensor, FieldHeading):  # keeps the turn about the vertical alone
        up = np.concatenate([R[:, 2, :], np.zeros((len(R), 3))], axis=1)
        assert np.allclose(H[:, 0], up)
        H, difference = (np.einsum("mks,ms->mk", x, up)[:, :, None] for x in (H, difference))
    assert np.abs(H - difference).max() < 1e-6 * np.abs(H).max()
    assert np.abs(H).max() > 0.1


def reads(sensor: Sensor, R: Array, bias: Array) -> Array:
    """What the sensor reads at attitudes ``R`` and ``bias``, written out; an orientation with the other sign."""
    if isinstance(sensor, BodyHeading):
        return np.asarray(0.5 * np.pi - np.arctan2(R[:, 1, 0], R[:, 0, 0])[:, None])
    if isinstance(sensor, FieldHeading):
        a = sensor.azimuth_n
        return np.einsum("mkj,k->mj", R, [np.cos(a), np.sin(a), -1.4])
    if isinstance(sensor, Direction):
        full = np.einsum("ij,mkj,k->mi", sensor.R_sb, R, sensor.reference_n)
        return full[:, :2] if sensor.rows == "plane" else full
    if isinstance(sensor, Orientation):
        return -rotation.from_matrix(R)
    assert isinstance(sensor, ZeroRate)
    return np.tile(bias, (len(R), 1))


@pytest.mark.parametrize(("sensor", "make"), FLAT)
def test_residual_vanishes_at_the_truth(rng: np.random.Generator, sensor: Sensor, make: Callable[..., Array]) -> None:
    R = attitudes(rng)
    r, _ = sensor.linearise(R, BIAS, reads(sensor, R, BIAS))
    assert np.abs(r).max() < 1e-8


@pytest.mark.parametrize(("sensor", "make"), FLAT)
def test_one_step_brings_a_small_error_home(
    rng: np.random.Generator, sensor: Sensor, make: Callable[..., Array]
) -> None:
    """The residual of a small true error is ``H`` times it, to second order: signs and frames in one."""
    R = attitudes(rng, 4)
    error = np.tile(1e-4 * rng.normal(size=6), (4, 1))
    if isinstance(sensor, FieldHeading):  # it answers to a turn about the vertical alone
        error[:, :3] = 1e-4 * R[:, 2, :]
    truth = R @ rotation.matrix(rotation.exp_quaternion(error[:, :3]))
    r, H = sensor.linearise(R, BIAS, reads(sensor, truth, BIAS + error[0, 3:]))
    assert np.abs(r - np.einsum("mks,ms->mk", H, error)).max() < 1e-6 * max(1.0, float(np.abs(H).max()))
    assert np.abs(r).max() > 1e-6


def test_compass_and_magnetometer_residuals_are_wrapped() -> None:
    yaw = np.radians(179.0)
    R = Rotation.from_euler("z", yaw).as_matrix()[None]
    r, _ = BodyHeading().linearise(R, BIAS, np.array([[np.radians(90.0 - 181.0)]]))  # 181 deg from east
    assert r[0, 0] == pytest.approx(np.radians(2.0))
    field_b = R[0].T @ [np.cos(np.radians(-179.0)), np.sin(np.radians(-179.0)), 0.0]
    r, _ = FieldHeading(np.radians(179.0)).linearise(R, BIAS, field_b[None])
    assert r[0, 0] == pytest.approx(np.radians(-2.0))


@pytest.mark.parametrize(("compass_deg", "yaw_deg"), [(0.0, 90.0), (90.0, 0.0), (180.0, -90.0), (270.0, 180.0)])
def test_compass_counts_clockwise_from_north(compass_deg: float, yaw_deg: float) -> None:
    R = Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix()[None]
    r, _ = BodyHeading().linearise(R, BIAS, np.array([[np.radians(compass_deg)]]))
    assert np.cos(r[0, 0]) == pytest.approx(1.0, abs=1e-12)


def test_a_vertical_axis_has_no_azimuth() -> None:
    R = Rotation.from_euler("y", -90.0, degrees=True).as_matrix()[None]
    _, H = BodyHeading().linearise(R, BIAS, np.array([[0.3]]))
    assert np.isfinite(H).all()
    assert not H.any()


def test_magnetic_dip_says_nothing_about_heading(rng: np.random.Generator) -> None:
    R = attitudes(rng)
    flat, dipping = (np.einsum("mkj,k->mj", R, [0.3, 0.9, z]) for z in (0.0, -2.5))
    r_flat, _ = FieldHeading(1.0).linearise(R, BIAS, flat)
    r_dip, _ = FieldHeading(1.0).linearise(R, BIAS, dipping)
    assert np.allclose(r_flat, r_dip, atol=1e-13)


def test_tangent_basis_is_orthonormal(rng: np.random.Generator) -> None:
    v = np.concatenate([rng.normal(size=(100, 3)), np.eye(3), -np.eye(3)])
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    frame = np.concatenate([v[:, None], tangent_basis(v)], axis=1)
    assert np.allclose(frame @ frame.swapaxes(1, 2), np.eye(3), atol=1e-14)


def test_tangent_and_full_rows_carry_the_same_information(rng: np.random.Generator) -> None:
    R = attitudes(rng, 1)
    p = SUN_N / np.linalg.norm(SUN_N)
    z = np.einsum("mkj,k->mj", near(R, rng, 1e-4), p)
    (r2, H2), (r3, H3) = (Direction(p, np.eye(3), rows).linearise(R, BIAS, z) for rows in ("tangent", "full"))
    assert np.allclose(H2[0].T @ H2[0], H3[0].T @ H3[0], atol=1e-13)
    assert np.allclose(H2[0].T @ r2[0], H3[0].T @ r3[0], atol=1e-7 * np.linalg.norm(r3))


@pytest.mark.parametrize(("sensor", "make"), FLAT)
def test_a_group_is_the_mean_of_its_samples_turned_to_the_node(
    rng: np.random.Generator, sensor: Sensor, make: Callable[..., Array]
) -> None:
    node = attitudes(rng, 1)[0]
    turn = Rotation.from_rotvec(0.1 * rng.normal(size=(5, 3))).as_matrix()
    values = make(rng, node @ turn)
    m = Measurement("x", sensor, 0, 0.0, values, np.eye(sensor.dof), turn)
    r, H = m.linearise(node, BIAS)
    wanted = np.mean(
        [sensor.linearise((node @ T)[None], BIAS, z[None])[0][0] for T, z in zip(turn, values, strict=True)], axis=0
    )
    assert np.allclose(r, wanted, atol=1e-13)
    columns = []
    for state in range(6):
        d = np.zeros(6)
        d[state] = STEP
        ahead, behind = (
            m.linearise(node @ rotation.matrix(rotation.exp_quaternion(s * d[:3])), BIAS + s * d[3:])[0]
            for s in (1, -1)
        )
        columns.append(-(ahead - behind) / (2 * STEP))
    difference = np.column_stack(columns)
    if isinstance(sensor, FieldHeading):
        up = np.concatenate([node[2], np.zeros(3)])
        H, difference = H @ up, difference @ up
    assert np.abs(H - difference).max() < 1e-6 * np.abs(H).max()


def test_a_group_without_turns_is_the_mean_at_the_node(rng: np.random.Generator) -> None:
    node, p = attitudes(rng, 1)[0], np.array([0.0, 0.6, 0.8])
    values = np.einsum("kj,k->j", node, p) + 0.01 * rng.normal(size=(6, 3))
    sensor = Direction(p)
    r, H = Measurement("sun", sensor, 0, 0.0, values, np.eye(2)).linearise(node, BIAS)
    wanted, J = sensor.linearise(node[None], BIAS, values.mean(axis=0)[None])
    assert np.allclose(r, wanted[0], atol=1e-14)
    assert np.allclose(H, J[0], atol=1e-14)
