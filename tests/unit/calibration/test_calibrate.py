from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from support import still

from attest_cli.calibration.accelerometer import attitudes
from attest_cli.calibration.calibrate import calibrate
from attest_cli.calibration.records import Calibration
from attest_cli.errors import AttestError
from attest_cli.records import Fixes, Log, Segment, Segmentation
from attest_cli.segment import find_segments
from attest_cli.settings import Settings

Array = NDArray[np.float64]
DEG = np.pi / 180.0
N, ACCEL = 0.005 * DEG, 1e-3
WARM_UP = ((-0.02, 0.13, 580.0), (0.033, -0.094, 500.0), (-0.012, 0.047, 400.0))  # deg/s, deg/s, s


def at_rest(seed: int, seconds: float, hz: float = 20.0, t0_ns: int = 0, warm: bool = True, **fixes: Fixes) -> Log:
    rng = np.random.default_rng([seed, 7])
    t = np.arange(round(seconds * hz)) / hz
    noise = np.stack([still.walking(rng, len(t), 1.0 / hz, N, 0.0) for _ in range(3)], axis=1)
    bias = np.stack([DEG * still.warm_up(t, *p) if warm else np.full(len(t), 0.1 * DEG) for p in WARM_UP], axis=1)
    force = np.stack([g + still.walking(rng, len(t), 1.0 / hz, ACCEL, 0.0) for g in (0.1, -0.2, 9.8)], axis=1)
    return still.log(t, noise + bias, force, t0_ns, f"still{seed}.csv", **fixes)


def run(log: Log, **options: str) -> Calibration:
    return calibrate(log, find_segments(log, Settings()), Settings(), **options)


@pytest.fixture(scope="module")
def static() -> Calibration:
    return run(at_rest(0, 3600.0))


def test_a_static_log_is_known_throughout(static: Calibration) -> None:
    assert static.static
    assert static.duration == pytest.approx(3600.0, abs=1.0)
    assert static.at_rest > 3590.0
    assert static.rate_hz == pytest.approx(20.0)
    for axis, (C1, C2, T) in zip(static.axes, WARM_UP, strict=True):
        assert axis.model.name == "exponential"
        assert set(axis.models) == {"constant", "ramp", "exponential", "random-walk"}
        sigma = np.sqrt(np.diag(axis.model.covariance))
        assert np.all(np.abs(axis.model.values - [C1 * DEG, C2 * DEG, T]) < 4.0 * sigma)
        assert pytest.approx(N, rel=0.01) == axis.noise.N
        assert axis.whiteness.white
        assert len(axis.rest.t) == 1000
        assert len(axis.rest.t) == len(axis.model.fitted) == len(axis.model.sigma)
        ideal = axis.noise.N / np.sqrt(axis.allan.tau)
        assert np.mean((axis.allan.low <= ideal) & (ideal <= axis.allan.high)) > 0.8
    for noise in static.accelerometer.noise:
        assert pytest.approx(ACCEL, rel=0.01) == noise.N
    assert static.accelerometer.matrix is None
    assert "1 of the 12 needed" in static.accelerometer.notes[-1]
    assert static.magnetometer is None
    assert any("Earth's rotation" in note for note in static.notes)


def test_the_wanted_model_is_used_for_fit_noise_and_whiteness() -> None:
    log = at_rest(1, 1200.0)
    found = run(log, model="constant")
    assert all(axis.model.name == "constant" for axis in found.axes)
    assert all(axis.noise.K is not None for axis in found.axes)  # what it leaves walks
    assert not any(axis.whiteness.white for axis in found.axes)
    assert any("exponential describes the record better" in note for note in found.axes[0].model.notes)


def test_a_model_that_the_record_does_not_tell_is_refused() -> None:
    with pytest.raises(AttestError, match="the log has no temperature; map one"):
        run(at_rest(1, 300.0), model="temperature")


def drive(log: Log, stop_s: float, every_s: float, turn: Array | None = None) -> tuple[Log, Segmentation]:
    """Let a log at rest drive between stops of ``stop_s`` in each ``every_s``; each stop in its own attitude."""
    rng = np.random.default_rng(9)
    t, gyro, accel = log.imu.t, log.imu.gyro_b.copy(), log.imu.accel_b - [0.1, -0.2, 9.8]
    made = []
    for k, start in enumerate(np.arange(0.0, t[-1] - stop_s, every_s)):
        still_, moving = (t >= start) & (t < start + stop_s), (t >= start + stop_s) & (t < start + every_s)
        accel[still_ | moving] += [0.1, -0.2, 9.8] if turn is None else turn[k]
        gyro[moving] += rng.normal(0.0, 0.3, (moving.sum(), 3))
        made.append(Segment(2 * k + 1, False, start, start + stop_s, 0, 0, start, start + stop_s))
        made.append(Segment(2 * k + 2, True, start + stop_s, start + every_s, 0, 0, start + stop_s, start + every_s))
    found = Segmentation(tuple(made), np.zeros(0), 1.0, 2.0, np.zeros(3), 5.0, "imu")
    return still.log(t, gyro, accel, log.t0_ns, log.sources[0].name, **log.fixes), found


def test_a_drive_gets_the_random_walk_over_its_stops_unless_a_curve_is_better_beyond_doubt() -> None:
    log, segmentation = drive(at_rest(2, 1800.0, 50.0), 8.0, 60.0)
    for k in (0, 2):  # one walks, one warms up, one stands
        log.imu.gyro_b[:, k] += (
            0.0 if k else still.walking(np.random.default_rng(0), len(log.imu.t), 0.02, 0.0, 3e-4 * DEG)
        )
        log.imu.gyro_b[:, k] -= DEG * still.warm_up(log.imu.t, *WARM_UP[k])
    found = calibrate(log, segmentation, Settings())
    assert not found.static
    assert found.at_rest == pytest.approx(30 * 8.0, rel=0.01)
    assert [axis.model.name for axis in found.axes] == ["random-walk", "exponential", "random-walk"]
    assert [axis.noise.K is not None for axis in found.axes] == [True, False, False]
    assert found.axes[2].models["constant"].bic < found.axes[2].models["random-walk"].bic
    assert len(np.unique(found.axes[0].rest.stop)) == 30
    warm = found.axes[1]
    error = warm.model.fitted - DEG * still.warm_up(warm.rest.t, *WARM_UP[1])
    assert np.sqrt(np.mean((error / warm.model.sigma) ** 2)) < 2.0


def test_a_drive_that_rested_on_all_sides_calibrates_the_accelerometer() -> None:
    rng = np.random.default_rng(3)
    unit = still.accelerometer(rng)
    force = unit.raw(still.GRAVITY * still.attitudes(rng, 24))
    log, segmentation = drive(at_rest(3, 24 * 20.0 + 10.5, 50.0), 10.0, 20.0, np.concatenate([force, force]))
    found = calibrate(log, segmentation, Settings()).accelerometer
    assert found.attitudes == attitudes(force)
    assert found.matrix is not None
    assert found.bias is not None
    assert found.tilt_sigma is not None
    np.testing.assert_allclose(found.matrix, unit.matrix, atol=5e-4)
    np.testing.assert_allclose(found.bias, unit.bias, atol=5e-3)
    for noise in found.noise:
        assert pytest.approx(ACCEL, rel=0.05) == noise.N


def test_temperature_of_the_log_is_a_model() -> None:
    t = np.arange(0.0, 1800.0, 1.0)
    celsius = 20.0 + 8.0 * np.sin(t / 150.0)
    log = at_rest(4, 1800.0, warm=False, temperature=Fixes("temperature", "/t", t, celsius[:, None]))
    warmth = np.interp(log.imu.t, t, celsius)
    shifted = still.log(
        log.imu.t, log.imu.gyro_b + 0.002 * DEG * (warmth - 25.0)[:, None], log.imu.accel_b, **log.fixes
    )
    found = run(shifted)
    for axis in found.axes:
        assert axis.model.name == "temperature"
        assert axis.model.values[1] == pytest.approx(0.002 * DEG, rel=0.05)
        assert axis.rest.temperature is not None
        assert axis.noise.K is None


def test_several_logs_of_one_sensor_are_one_record() -> None:
    first, second = at_rest(5, 400.0, t0_ns=10**18, warm=False), at_rest(6, 400.0, t0_ns=10**18 + 10**12, warm=False)
    found = calibrate(
        second, find_segments(second, Settings()), Settings(), more=[(first, find_segments(first, Settings()))]
    )
    assert found.t0_ns == 10**18
    assert found.duration == pytest.approx(1400.0, abs=1.0)
    assert found.at_rest == pytest.approx(798.0, abs=2.0)
    assert found.axes[0].rest.t[-1] > 1390.0
    assert set(found.axes[0].rest.stop) == {0.0, 1.0}


def test_the_magnetometer_is_fitted_where_it_was_turned_about() -> None:
    rng = np.random.default_rng(7)
    iron = still.iron(rng)
    readings = iron.raw(still.FIELD * still.all_over(rng, 1000))
    fixes = Fixes("magnetometer", "/mag", np.linspace(0.0, 299.0, 1000), readings)
    found = run(at_rest(7, 300.0, magnetometer=fixes)).magnetometer
    assert found is not None
    np.testing.assert_allclose(found.offset, iron.hard, atol=1e-9)


@pytest.mark.parametrize("sensor", ["gyro_b", "accel_b"])
def test_a_stuck_axis_is_refused(sensor: str) -> None:
    log = at_rest(8, 60.0)
    getattr(log.imu, sensor)[:, 1] = 0.01
    with pytest.raises(AttestError, match="does not change at all"):
        run(log)


def test_a_drive_without_a_stop_is_refused() -> None:
    log = at_rest(9, 60.0)
    log.imu.gyro_b[:] += np.random.default_rng(0).normal(0.0, 0.5, log.imu.gyro_b.shape)
    log.imu.accel_b[:] += np.random.default_rng(1).normal(0.0, 2.0, log.imu.accel_b.shape)
    moving = Segmentation((Segment(2, True, 0.0, 59.9, 0, 1200, 0.0, 59.9),), np.zeros(0), 1, 2, np.zeros(3), 1, "imu")
    with pytest.raises(AttestError, match="nothing in it stands still"):
        calibrate(log, moving, Settings())


@pytest.mark.parametrize("stop_s", [2.0, 4.0])
def test_one_short_stop_late_in_a_drive_is_enough_for_what_it_tells(stop_s: float) -> None:
    log = at_rest(10, 1200.0, warm=False)
    moving = Segment(2, True, 0.0, 1000.0, 0, 0, 0.0, 1000.0)
    stop = Segment(3, False, 1000.0, 1000.0 + stop_s, 0, 0, 1000.0, 1000.0 + stop_s)
    found = calibrate(log, Segmentation((moving, stop), np.zeros(0), 1, 2, np.zeros(3), 1, "imu"), Settings())
    for axis in found.axes:
        assert axis.model.name == "random-walk"
        assert "exponential" not in axis.models
        assert abs(axis.model.fitted[0] - 0.1 * DEG) < 4.0 * axis.model.sigma[0]
        assert axis.noise.K is None
        assert 0.6 * N < axis.noise.N < 1.6 * N  # 40 or 80 samples
        assert axis.noise.B is None
