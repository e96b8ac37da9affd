from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from support import still

from attest_cli.calibration.magnetometer import coverage, fit_magnetometer

Array = NDArray[np.float64]


def read(seed: int, directions: Array, noise: float = 0.005) -> tuple[still.Iron, Array]:
    rng = np.random.default_rng([seed, 1])
    iron = still.iron(rng)
    return iron, iron.raw(still.FIELD * directions) + rng.normal(0.0, noise * still.FIELD, directions.shape)


def test_without_noise_the_iron_is_found() -> None:
    iron, readings = read(0, still.all_over(np.random.default_rng(0), 300), 0.0)
    found, _ = fit_magnetometer(readings)
    assert found is not None
    np.testing.assert_allclose(found.matrix, iron.soft, atol=1e-9)
    np.testing.assert_allclose(found.offset, iron.hard, atol=1e-9 * still.FIELD)
    assert found.field == pytest.approx(still.FIELD)
    assert found.residual < 1e-9
    assert found.coverage > 0.9


def test_directions_after_it_are_right() -> None:
    raw, left = [], []
    for seed in range(10):
        u = still.all_over(np.random.default_rng([seed, 2]), 400)
        iron, readings = read(seed, u)
        found, why = fit_magnetometer(readings)
        assert found is not None, why
        clean = iron.raw(still.FIELD * u)
        raw.append(still.apart_deg(clean, u))
        left.append(still.apart_deg((clean - found.offset) @ found.matrix.T, u))
        assert found.residual == pytest.approx(0.005, rel=0.3)
    assert np.median(raw) > 5.0
    assert np.median(left) < 0.1


@pytest.mark.parametrize("tilt_deg", [1.0, 5.0, 15.0])
def test_a_drive_on_the_plane_is_refused(tilt_deg: float) -> None:
    rng = np.random.default_rng(1)
    dip = np.radians(60.0) + np.radians(tilt_deg) * rng.uniform(-1.0, 1.0, 2000)
    turn = rng.uniform(0.0, 2.0 * np.pi, 2000)
    u = np.stack([np.cos(dip) * np.cos(turn), np.cos(dip) * np.sin(turn), -np.sin(dip)], axis=1)
    found, why = fit_magnetometer(read(1, u)[1])
    assert found is None
    assert "turn the sensor slowly about all its axes" in why


def test_readings_that_say_nothing_are_refused() -> None:
    rng = np.random.default_rng(2)
    still_ = np.tile([20e-6, 0.0, -40e-6], (500, 1))
    assert fit_magnetometer(still_)[0] is None
    assert fit_magnetometer(still_ + rng.normal(0.0, 1e-7, (500, 3)))[0] is None
    assert "12 readings" in fit_magnetometer(still_[:12])[1]
    assert fit_magnetometer(np.full((500, 3), np.nan))[0] is None


def test_blank_readings_are_left_out() -> None:
    iron, readings = read(3, still.all_over(np.random.default_rng(3), 500), 0.0)
    readings[::3] = np.nan
    found, _ = fit_magnetometer(readings)
    assert found is not None
    np.testing.assert_allclose(found.offset, iron.hard, atol=1e-9 * still.FIELD)


def test_coverage_is_the_share_of_the_sphere() -> None:
    rng = np.random.default_rng(4)
    u = still.all_over(rng, 20_000)
    assert coverage(u) == 1.0
    assert coverage(u[u[:, 2] > 0.0]) == pytest.approx(0.5, abs=0.1)
    assert coverage(u[:1]) == 0.01
