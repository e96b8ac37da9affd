from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from support import still
from support.calibrations import bias_between

from attest_cli.calibration import bias
from attest_cli.calibration.bias import Fitted, choose, fit_models
from attest_cli.calibration.rest import Blocks, cut, means
from attest_cli.calibration.walk import build_walk

Array = NDArray[np.float64]


def samples(t: Array) -> Blocks:
    """Each sample a block of its own, of unit span: plain least squares."""
    one, none = np.ones(len(t)), np.zeros(len(t), dtype=np.int64)
    return Blocks(t, one, one, np.diff(t, prepend=t[0]), none, none)


def fitted(rate: Array, period: float, blocks: int = 500) -> tuple[dict[str, Fitted], list[str], Blocks]:
    made, edges = cut([still.piece(len(rate), period)], len(rate) * period / blocks)
    models, notes = fit_models(made, means([rate], edges))
    return dict(models), notes, made


def test_the_levenberg_marquardt_vector() -> None:
    v = still.vectors("barshan_lm")
    models, _ = fit_models(samples(v["t"]), v["e"])
    found = models["exponential"].model
    assert found.names == ("C1", "C2", "T")
    np.testing.assert_allclose(found.values, [v["C1"], v["C2"], v["T1"]], rtol=5e-6)  # its search stopped 5e-6 early:
    np.testing.assert_allclose(found.covariance, v["cov"], rtol=2e-5)
    np.testing.assert_allclose(v["e"] - found.fitted, v["resid"], atol=1e-6)
    residual, rate = v["e"] - found.fitted, np.exp(-v["t"] / found.values[2])
    J = np.stack([1.0 - rate, np.ones_like(rate), -found.values[0] * rate * v["t"] / found.values[2] ** 2], axis=1)
    step = np.linalg.lstsq(J, residual, rcond=None)[0]  # what Gauss-Newton would still move
    np.testing.assert_allclose(step / found.values, 0.0, atol=1e-9)
    assert residual @ residual < v["resid"] @ v["resid"]


def test_the_fit_on_stops_vector() -> None:
    v = still.vectors("exp_fit_stops")
    at = v["mask"]
    models, _ = fit_models(samples(v["t"][at]), v["e"][at])
    found = models["exponential"].model
    np.testing.assert_allclose(found.values, [v["C1"], v["C2"], v["T"]], rtol=1e-6)
    np.testing.assert_allclose(found.covariance, v["cov"], rtol=1e-5)
    walk, one = build_walk(samples(v["t"][at]), level=True), np.ones(at.sum())
    ramp = bias._white(walk, v["e"][at], "ramp", ("C", "slope"), np.stack([one, v["t"][at]], axis=1))
    np.testing.assert_allclose([models["constant"].model.bic, ramp.bic, found.bic], v["bic"], rtol=1e-9)
    assert models["ramp"].model.bic < ramp.bic  # a random walk in its residual stands for the bend


@pytest.mark.parametrize(
    ("true", "values"),
    [("constant", [0.1]), ("ramp", [0.1, 2e-5]), ("exponential", [0.05, 0.1, 400.0])],
)
def test_the_right_model_is_chosen_with_its_values(true: str, values: list[float]) -> None:
    rng = np.random.default_rng(2)
    t = 0.1 * np.arange(36_000)
    curve = {"constant": 0.1 + 0.0 * t, "ramp": 0.1 + 2e-5 * t, "exponential": still.warm_up(t, 0.05, 0.1, 400.0)}[true]
    models, _, blocks = fitted(curve + rng.normal(0.0, 0.02, len(t)), 0.1)
    assert choose(models, static=True) == true
    assert choose(models, static=False) == ("random-walk" if true == "constant" else true)  # beyond doubt
    found = models[true].model
    sigma = np.sqrt(np.diag(found.covariance))
    assert np.all(np.abs(found.values - values) < 4.0 * sigma)
    assert np.all(np.abs(found.fitted - np.interp(blocks.t, t, curve)) < 4.0 * found.sigma)


def test_a_walk_in_the_residual_of_a_warm_up_is_seen_and_followed() -> None:
    rng = np.random.default_rng(3)
    t = 0.1 * np.arange(72_000)
    walk = still.walking(rng, len(t), 0.1, 0.0, 1e-4)
    models, _, blocks = fitted(still.warm_up(t, 0.2, 0.1, 600.0) + walk + rng.normal(0.0, 0.02, len(t)), 0.1)
    found = models["exponential"].model
    assert choose(models, static=True) == "exponential"
    assert "random walk" in found.notes[0]
    error = found.fitted - np.interp(blocks.t, t, still.warm_up(t, 0.2, 0.1, 600.0) + walk)
    assert np.sqrt(np.mean((error / found.sigma) ** 2)) == pytest.approx(1.0, abs=0.4)


def test_an_exponential_is_none_where_its_time_constant_ends_at_a_bound() -> None:
    rng = np.random.default_rng(4)
    t = 0.1 * np.arange(6000)
    models, notes, _ = fitted(0.1 + 2e-4 * t + rng.normal(0.0, 0.02, len(t)), 0.1)  # a straight line: T -> infinity
    assert "exponential" not in models
    assert "its T would leave" in notes[0]


def test_a_record_shorter_than_two_time_constants_is_told() -> None:
    rng = np.random.default_rng(5)
    t = 0.1 * np.arange(6000)
    models, _, _ = fitted(still.warm_up(t, 0.5, 0.0, 400.0) + rng.normal(0.0, 0.02, len(t)), 0.1)
    found = models["exponential"].model
    assert "too short to know T" in found.notes[0]


def test_temperature_is_fitted_to_the_degree_that_shows() -> None:
    rng = np.random.default_rng(6)
    t = 0.1 * np.arange(18_000)
    celsius = 20.0 + 15.0 * (1.0 - np.exp(-t / 600.0)) + np.sin(t / 200.0)
    blocks, edges = cut([still.piece(len(t), 0.1)], 4.0)
    for values in ([0.1, 0.01], [0.1, 0.01, 5e-4]):
        true = np.polynomial.polynomial.polyval(celsius - 25.0, values)
        models, _ = fit_models(blocks, means([true + rng.normal(0.0, 0.02, len(t))], edges), means([celsius], edges))
        found = models["temperature"].model
        assert choose(models, static=True) == "temperature"
        assert len(found.values) == len(values)
        assert np.all(np.abs(found.values - values) < 4.0 * np.sqrt(np.diag(found.covariance)))


def test_no_temperature_model_without_a_change_of_temperature() -> None:
    rng = np.random.default_rng(7)
    models, notes = fit_models(samples(np.arange(100.0)), rng.normal(size=100), 25.0 + 0.1 * rng.normal(size=100))
    assert "temperature" not in models
    assert any("changes by" in note for note in notes)


def test_the_random_walk_is_followed_over_stops_with_a_sigma_that_holds() -> None:
    drive = still.stops(np.random.default_rng(8), "random walk")
    blocks, edges = cut(drive.pieces, 0.5)
    models, _ = fit_models(blocks, means(drive.rates, edges))
    found = models["random-walk"].model
    assert found.names == ("bias", "K")
    assert found.values[0] == found.fitted[-1]
    assert found.values[1] == pytest.approx(5e-4, rel=0.5)
    error = found.fitted - np.interp(blocks.t, drive.t, drive.bias)
    assert np.sqrt(np.mean((error / found.sigma) ** 2)) == pytest.approx(1.0, abs=0.5)
    whole = bias_between(found, blocks.t, drive.t) - drive.bias
    first = drive.rates[0].mean() - drive.bias
    assert np.sqrt(np.mean(whole**2)) < 0.3 * np.sqrt(np.mean(first**2))


def test_between_blocks_the_bias_is_the_curve_plus_what_the_walk_left() -> None:
    rng = np.random.default_rng(9)
    t = 0.1 * np.arange(36_000)
    models, _, blocks = fitted(still.warm_up(t, 0.05, 0.1, 400.0) + rng.normal(0.0, 0.02, len(t)), 0.1)
    for name in ("constant", "ramp", "exponential", "random-walk"):
        model = models[name].model
        np.testing.assert_allclose(bias_between(model, blocks.t, blocks.t), model.fitted, atol=1e-12)
    error = bias_between(models["exponential"].model, blocks.t, t) - still.warm_up(t, 0.05, 0.1, 400.0)
    assert np.abs(error).max() < 2e-3
