"""Barshan & Durrant-Whyte 1994, what they claim of the gyro at rest: its bias is an exponential (section 3), what the
fit leaves is white and the raw record is not, and a bias that is known makes the heading better by far (section 4).

Figures of the paper: C1 = 0.153 deg/s, C2 = -0.264 deg/s, T = 5.64 min, residual 0.2 deg/s, one sample in 30 ms.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pytest
from support import still

from attest_cli.calibration.bias import Fitted, fit_models
from attest_cli.calibration.rest import cut, means
from attest_cli.calibration.whiteness import judge_whiteness
from attest_cli.maths.bias import curve

SEEDS = range(30)
HOUR = 3600.0


@dataclass(frozen=True)
class Rested:
    """One record at rest: samples (deg/s) and what was fitted to a hundred means of them."""

    t: np.ndarray
    rate: np.ndarray
    models: Mapping[str, Fitted]


@pytest.fixture(scope="module")
def hours() -> list[Rested]:
    made = []
    for seed in SEEDS:
        t, rate = still.gyrostar(np.random.default_rng([seed, 1994]), HOUR)
        blocks, edges = cut([still.piece(len(t), still.GYROSTAR_STEP_S)], HOUR / 100.0)
        made.append(Rested(t, rate, fit_models(blocks, means([rate], edges))[0]))
    return made


def test_an_hour_gives_the_three_parameters(hours: list[Rested]) -> None:
    found = np.array([record.models["exponential"].model.values for record in hours])
    apart = np.abs(found - still.GYROSTAR)
    print(f"C1, C2, T: {found.mean(axis=0)} ± {found.std(axis=0, ddof=1)}, largest error {apart.max(axis=0)}")
    assert np.all(apart.max(axis=0) < [0.012, 0.012, 40.0])


def test_the_exponential_is_the_model_that_the_record_asks_for(hours: list[Rested]) -> None:
    for record in hours:
        bic = {name: fitted.model.bic for name, fitted in record.models.items()}
        assert min(bic, key=lambda name: bic[name]) == "exponential"


def test_the_residual_is_white_and_the_raw_record_is_not(hours: list[Rested]) -> None:
    fitted = raw = 0
    inside = []
    for record in hours:
        model = record.models["exponential"].model
        left = record.rate - curve(model.name, model.values, record.t)
        assert np.std(left) == pytest.approx(still.GYROSTAR_SIGMA, rel=0.01)
        judged = judge_whiteness([left], still.GYROSTAR_STEP_S)  # the paper's own test: single samples
        fitted, raw = fitted + judged.white, raw + judge_whiteness([record.rate], still.GYROSTAR_STEP_S).white
        inside.append(judged.inside)
        assert len(judged.rho) == 200
    print(f"white: fit {fitted} of {len(hours)}, raw {raw}; lags inside the band {np.mean(inside):.3f}")
    assert fitted >= 0.9 * len(hours)
    assert raw == 0
    assert np.mean(inside) == pytest.approx(0.95, abs=0.01)


def test_known_parameters_make_the_heading_thirty_times_better() -> None:
    better = []
    for seed in SEEDS:
        t, rate = still.gyrostar(np.random.default_rng([seed, 600]), 600.0)  # at rest: all of it is error
        raw = np.cumsum(rate) * still.GYROSTAR_STEP_S
        left = np.cumsum(rate - still.warm_up(t, *still.GYROSTAR)) * still.GYROSTAR_STEP_S
        better.append(np.abs(raw).max() / np.abs(left).max())
        assert 5.0 < np.abs(raw).max() / 10.0 < 15.0  # the abstract: 5 to 15 deg/min
    print(f"raw over compensated heading error: median {np.median(better):.0f}, least {np.min(better):.0f}")
    assert np.median(better) >= 30.0


def test_fitted_parameters_make_it_better_too(hours: list[Rested]) -> None:
    better = []
    for seed, record in zip(SEEDS, hours, strict=True):
        t, rate = still.gyrostar(np.random.default_rng([seed, 601]), 600.0)
        model = record.models["exponential"].model
        left = np.cumsum(rate - curve(model.name, model.values, t)) * still.GYROSTAR_STEP_S
        better.append(np.abs(np.cumsum(rate)).max() * still.GYROSTAR_STEP_S / np.abs(left).max())
    assert np.median(better) >= 30.0


def test_ten_minutes_are_too_short_for_the_time_constant_and_say_so() -> None:
    errors, stated = [], []
    for seed in SEEDS:
        t, rate = still.gyrostar(np.random.default_rng([seed, 10]), 600.0)
        blocks, edges = cut([still.piece(len(t), still.GYROSTAR_STEP_S)], 6.0)
        models, notes = fit_models(blocks, means([rate], edges))
        if "exponential" not in models:
            assert any("its T would leave" in note for note in notes)
            continue
        found = models["exponential"].model
        errors.append(found.values[2] - still.GYROSTAR[2])
        stated.append(np.sqrt(found.covariance[2, 2]))
        if found.values[2] > 300.0:
            assert any("too short to know T" in note for note in found.notes)
    assert len(errors) >= 0.8 * len(SEEDS)
    assert np.std(errors) > 30.0  # 63 s by the Cramer-Rao bound, against 13 s after an hour
    assert 0.5 < np.median(stated) / np.std(errors) < 2.0
