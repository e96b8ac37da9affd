"""What must not change: the world's yaw, the IMU's axes, the epoch of the clock, and the same input twice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from support.drives import degrees_apart, effective

from attest_cli.errors import AttestError
from attest_cli.estimate import Estimate, estimate
from attest_cli.maths import rotation
from attest_cli.prepare import prepare
from attest_cli.records import Fixes, Imu, Log, Recording
from attest_cli.segment import find_segments
from attest_cli.settings import Settings
from attest_cli.simulate import RoverOptions, Simulation, simulate_rover
from attest_cli.track import world_variance

Array = NDArray[np.float64]
SENSORS = RoverOptions(seed=61, duration_s=150.0, motions=2, scenario="S2", compass=True, magnetometer=True)
YAW = np.radians(77.0)
TURN = Rotation.from_euler("xyz", [100.0, -35.0, 50.0], degrees=True).as_matrix()  # a box bolted on its side


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return simulate_rover(SENSORS)


@pytest.fixture(scope="module", params=["auto", 2], ids=["two-filter", "gauss-newton"])
def job(request: pytest.FixtureRequest, simulation: Simulation) -> tuple[Log, Settings]:
    options = effective(simulation, {"smoothing": {"absolute": "always", "iterations": request.param}})
    return prepare([simulation.log], options), options


def run(log: Log, options: Settings) -> tuple[Estimate, Array]:
    est = estimate(log, find_segments(log, options), options)
    return est, est.q


@pytest.fixture(scope="module")
def plain(job: tuple[Log, Settings]) -> tuple[Estimate, Array]:
    """The job as it is; only to be read."""
    return run(*job)


@pytest.fixture(scope="module")
def unshifted(simulation: Simulation) -> tuple[Log, Estimate, Array]:
    """The drive under its own settings; only to be read."""
    options = effective(simulation, {})
    log = prepare([simulation.log], options)
    return log, *run(log, options)


def with_fixes(log: Log, role: str, change: Callable[[Array], Array]) -> Log:
    f = log.fixes[role]
    return replace(log, fixes={**log.fixes, role: Fixes(role, f.channel, f.t, change(f.values), f.sigma)})


def test_a_turn_of_the_world_turns_the_result(job: tuple[Log, Settings], plain: tuple[Estimate, Array]) -> None:
    """References turned about the vertical: the track turns with them, its body-axes covariances stay."""
    log, options = job
    Rz = Rotation.from_euler("z", YAW).as_matrix()
    world = options.world.model_copy(
        update={
            "sun_direction": tuple(Rz @ np.array(options.world.sun_direction)),
            "magnetic_field_ut": tuple(Rz @ np.array(options.world.magnetic_field_ut)),
        }
    )
    turned = with_fixes(log, "compass", lambda heading: heading - YAW)
    before, at_rate = plain
    after, at_rate_after = run(turned, options.model_copy(update={"world": world}))
    q_yaw = rotation.exp_quaternion(np.array([0.0, 0.0, YAW]))
    assert degrees_apart(rotation.multiply(q_yaw, at_rate), at_rate_after) < 1e-9
    assert degrees_apart(rotation.multiply(q_yaw, before.forward.q), after.forward.q) < 1e-9
    assert np.abs(before.smoothed.bias - after.smoothed.bias).max() < 1e-11
    assert np.allclose(before.smoothed.P, after.smoothed.P, rtol=0, atol=1e-9 * before.smoothed.P.max())


def test_a_turn_of_the_imu_turns_the_body_only(job: tuple[Log, Settings]) -> None:
    """Every sensor of the box turned as one: the same attitude in the new axes, the same stops, the same sigmas."""
    log, options = job
    log = replace(
        log, fixes={role: f for role, f in log.fixes.items() if role != "compass"}
    )  # it reads the body's x axis
    imu = Imu(log.imu.t, log.imu.gyro_b @ TURN, log.imu.accel_b @ TURN)  # v_new = TURN' v
    turned = with_fixes(replace(log, imu=imu), "magnetometer", lambda field: field @ TURN)
    q_turn = rotation.from_matrix(TURN)
    mounting = rotation.multiply(rotation.conjugate(q_turn), np.array(options.sun.mounting))
    sun = options.sun.model_copy(update={"mounting": tuple(mounting)})
    before, at_rate = run(log, options)
    after, at_rate_after = run(turned, options.model_copy(update={"sun": sun}))
    assert np.array_equal(before.smoothed.t, after.smoothed.t)
    assert degrees_apart(rotation.multiply(at_rate, q_turn), at_rate_after) < 1e-9
    one, other = before.smoothed, after.smoothed
    assert np.abs(one.bias @ TURN - other.bias).max() < 1e-11
    assert np.allclose(
        np.linalg.eigvalsh(world_variance(one.q, one.P)),
        np.linalg.eigvalsh(world_variance(other.q, other.P)),
        rtol=1e-6,
    )


def shifted(recording: Recording, shift_ns: int) -> Recording:
    channels = tuple(replace(c, stamps_ns=c.stamps_ns + shift_ns) for c in recording.channels)
    return replace(recording, channels=channels)


@pytest.mark.parametrize(
    "shift_ns", [-1_780_308_000_000_000_000, 1_750_000_000_000_000_000, 1_024_000_000_000, 123_456_789]
)
def test_a_shift_of_the_clock_shifts_the_result(
    simulation: Simulation, unshifted: tuple[Log, Estimate, Array], shift_ns: int
) -> None:
    options, (log, _, before) = effective(simulation, {}), unshifted
    later = prepare([shifted(simulation.log, shift_ns)], options)
    assert np.array_equal(later.stamps_ns, log.stamps_ns + shift_ns)
    _, after = run(later, options)
    assert degrees_apart(before, after) < 1e-4
    assert np.array_equal(before, after)  # stamps are subtracted as integers: not a bit moves


def test_the_same_input_twice_gives_the_same_bits(job: tuple[Log, Settings], plain: tuple[Estimate, Array]) -> None:
    (first, a), (second, b) = plain, run(*job)
    for x, y in ((a, b), (first.smoothed.P, second.smoothed.P), (first.forward.q, second.forward.q)):
        assert x.tobytes() == y.tobytes()


def test_rows_norms_and_numbers(job: tuple[Log, Settings], plain: tuple[Estimate, Array]) -> None:
    (log, _), (est, at_rate) = job, plain
    assert at_rate.shape == (len(log.imu.t), 4)
    assert est.smoothed.t[0] == log.imu.t[0]
    assert est.smoothed.t[-1] == log.imu.t[-1]
    for q in (at_rate, est.smoothed.q, est.forward.q):
        assert np.abs(np.linalg.norm(q, axis=1) - 1.0).max() < 1e-12
    assert np.all(np.sum(at_rate[1:] * at_rate[:-1], axis=1) > 0.0)
    for values in (est.smoothed.bias, est.smoothed.P, est.smoothed.cross, est.passes["forward"].P):
        assert np.isfinite(values).all()
    for P in (est.smoothed.P, est.passes["forward"].P):
        assert np.array_equal(P[1:], P[1:].swapaxes(1, 2))
        sigma = np.sqrt(np.einsum("kii->ki", P))
        assert np.linalg.eigvalsh(P / (sigma[:, :, None] * sigma[:, None])).min() > 0.0


def test_either_sign_of_an_orientation_is_the_same_measurement(simulation: Simulation) -> None:
    options = effective(simulation, {})
    log = prepare([simulation.log], options)
    t = log.imu.t[::100]
    q = np.column_stack([simulation.truth[f"q_{part}"] for part in "wxyz"])[::100]
    signs = np.where(np.random.default_rng(5).random(len(t)) < 0.5, -1.0, 1.0)[:, None]
    results = [
        run(replace(log, fixes={"orientation": Fixes("orientation", "x", t, values)}), options)[1]
        for values in (q, signs * q)
    ]
    assert degrees_apart(results[0], results[1]) < 1e-9


def test_the_smoothed_sigma_never_exceeds_the_forward_one(unshifted: tuple[Log, Estimate, Array]) -> None:
    _, est, _ = unshifted
    forward, smoothed = (np.trace(P[:, :3, :3], axis1=1, axis2=2) for P in (est.passes["forward"].P, est.smoothed.P))
    assert np.all(smoothed <= forward * (1 + 1e-3))  # the tangents of the two passes differ by their separation


SHORT = simulate_rover(RoverOptions(seed=62, duration_s=60.0, motions=1, rate_hz=50.0, compass=True))
SHORT_SETTINGS = effective(SHORT, {})
SHORT_LOG = prepare([SHORT.log], SHORT_SETTINGS)


@settings(max_examples=5)
@given(
    hole=st.tuples(st.floats(0.0, 58.0), st.floats(0.0, 6.0)),
    factor=st.floats(0.2, 5.0),
    drop=st.sets(st.integers(0, len(SHORT_LOG.imu.t) - 1), max_size=40),
)
def test_holes_scales_and_lost_rows_leave_a_whole_result_or_a_plain_refusal(
    hole: tuple[float, float], factor: float, drop: set[int]
) -> None:
    t = SHORT_LOG.imu.t
    keep = (t < hole[0]) | (t > hole[0] + hole[1])
    keep[list(drop)] = False
    channels = []
    for c in SHORT.log.channels:
        mask = keep if c.role == "imu" else np.ones(len(c.stamps_ns), dtype=np.bool_)
        scale = factor if c.role == "imu" else 1.0
        values = {name: v[mask] * (scale if name.startswith("gyro") else 1.0) for name, v in c.values.items()}
        channels.append(replace(c, stamps_ns=c.stamps_ns[mask], values=values))
    refused = None
    try:
        log = prepare([replace(SHORT.log, channels=tuple(channels))], SHORT_SETTINGS)
        est, at_rate = run(log, SHORT_SETTINGS)
    except AttestError as refusal:
        refused = str(refusal)
    if refused is not None:
        assert refused
        assert "\n" not in refused
        return
    assert at_rate.shape == (int(keep.sum()), 4)
    assert np.isfinite(at_rate).all()
    assert np.abs(np.linalg.norm(at_rate, axis=1) - 1.0).max() < 1e-12
    assert np.isfinite(est.smoothed.P).all()
    assert np.linalg.eigvalsh(est.smoothed.P).min() > 0.0
