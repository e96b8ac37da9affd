from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from support import still

from attest_cli.calibration.accelerometer import Fitted, attitudes, fit_accelerometer

Array = NDArray[np.float64]
SIGMA = 0.0294 / np.sqrt(200)


def rested(seed: int, directions: Array) -> tuple[still.Unit, Fitted | None, str]:
    rng = np.random.default_rng([seed, 1])
    unit = still.accelerometer(rng)
    force = unit.raw(still.GRAVITY * directions) + rng.normal(0.0, SIGMA, directions.shape)
    return unit, *fit_accelerometer(force, np.full(len(force), SIGMA), still.GRAVITY)


def test_without_noise_every_error_is_found() -> None:
    rng = np.random.default_rng(0)
    unit = still.accelerometer(rng)
    force = unit.raw(still.GRAVITY * still.attitudes(rng, 18))
    found, _ = fit_accelerometer(force, np.full(18, 1e-3), still.GRAVITY)
    assert found is not None
    np.testing.assert_allclose(found.matrix, unit.matrix, atol=1e-9)
    np.testing.assert_allclose(found.bias, unit.bias, atol=1e-8)
    assert found.residual < 1e-9


@pytest.mark.parametrize(("count", "most_deg"), [(12, 0.06), (18, 0.02), (24, 0.015)])
def test_tilt_is_as_good_as_it_says(count: int, most_deg: float) -> None:
    errors, own = [], []
    for seed in range(12):
        unit, found, why = rested(seed, still.attitudes(np.random.default_rng([seed, 2]), count))
        if found is None:
            assert count == 12, why  # of twelve drawn at random some leave too much open, and say so
            continue
        test = still.all_over(np.random.default_rng(seed), 200)
        errors.append(still.apart_deg((unit.raw(still.GRAVITY * test) + found.bias) @ found.matrix.T, test))
        own.append(np.degrees(found.tilt_sigma))
    assert len(errors) >= 9
    rms, stated = np.sqrt(np.mean(np.square(errors))), np.sqrt(np.mean(np.square(own)))
    assert rms < most_deg
    assert 0.5 < rms / stated < 1.5


def test_the_weight_of_a_stop_is_what_it_knows() -> None:
    rng = np.random.default_rng(3)
    unit = still.accelerometer(rng)
    force = unit.raw(still.GRAVITY * still.attitudes(rng, 24))
    sigma = np.full(24, 1e-3)
    sigma[20:] = 1.0
    force[20:] += rng.normal(0.0, 0.3, (4, 3))  # four short stops that are far off
    found, _ = fit_accelerometer(force, sigma, still.GRAVITY)
    assert found is not None
    np.testing.assert_allclose(found.bias, unit.bias, atol=1e-4)


def test_too_few_attitudes_are_refused_with_their_number() -> None:
    _, found, why = rested(4, still.attitudes(np.random.default_rng(4), 11))
    assert found is None
    assert "11 of the 12 needed" in why
    flat = np.array([0.0, 0.0, 9.8]) + np.random.default_rng(4).normal(0.0, 0.3, (40, 3))
    assert attitudes(flat) == 1
    assert fit_accelerometer(flat, np.full(40, SIGMA), still.GRAVITY)[0] is None


@pytest.mark.parametrize("shape", ["cone", "ring"])
def test_attitudes_that_do_not_tell_the_errors_apart_are_refused(shape: str) -> None:
    rng = np.random.default_rng(5)
    if shape == "cone":
        tilt, turn = np.arccos(1.0 - rng.random(80) * (1.0 - np.cos(np.radians(45.0)))), rng.uniform(0.0, 2 * np.pi, 80)
        u = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], axis=1)
    else:
        turn = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
        u = np.stack([np.cos(turn), 0.02 * rng.normal(size=24), np.sin(turn)], axis=1)
        u /= np.linalg.norm(u, axis=1, keepdims=True)
    assert attitudes(u) >= 12
    _, found, why = rested(5, u)
    assert found is None
    assert "deg of tilt" in why
