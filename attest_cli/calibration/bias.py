r"""Models of a gyro's bias on blocks at rest: constant, ramp, exponential, temperature polynomial, random walk.

Each is fitted by generalised least squares twice, with a white residual and with a random walk left in it at its most
likely strength (:mod:`walk`); the one of lower BIC is kept. All likelihoods are of the same means, so the BIC compare.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..maths.bias import exponential, polynomial
from ..records import Array
from .records import BiasModel
from .rest import Blocks
from .smooth import follow_walk
from .walk import Fit, Walk, best, build_walk, likely_walk

TEMPERATURE_SPAN_C = 1.0  # a bias cannot be told against less change of temperature
T_SHORTEST, T_SHORTEST_SAMPLES, T_LONGEST = 0.01, 20.0, 3.0  # bounds of T: share of the record, samples, records
T_SHORTEST_START = 0.2  # of the time before the first stop: what decays faster is not seen any more
T_GRID = 25
T_AT_BOUND = 0.02  # of ln T
SHORT = 2.0  # a record of fewer T knows T badly: to 19 % at 1.8 T, 7 % at 3.5 T (Cramer-Rao)
BETTER = 10.0  # difference of BIC: "very strong" evidence (Kass & Raftery 1995)
ROUNDS = 4  # of T and the residual's random walk in turn


@dataclass(frozen=True, slots=True)
class Fitted:
    """A model and its residual (n,), of unit variance and white where the model is right (with a random walk: the
    innovations of its filter).
    """

    model: BiasModel
    residual: Array


@dataclass(frozen=True, slots=True)
class _Trial:
    """Values (q,) by name, the model's curve (n,) and Jacobian (n, q) at the blocks, and the fit behind them."""

    name: str
    names: tuple[str, ...]
    values: Array
    curve: Array
    J: Array
    fit: Fit

    @property
    def bic(self) -> float:
        """Bayesian information criterion; the noise counts for no model, the random walk where there is one."""
        return self.fit.value + (len(self.values) + (self.fit.ratio > 0.0)) * math.log(self.fit.n)


def fit_models(blocks: Blocks, z: Array, temperature: Array | None = None) -> tuple[Mapping[str, Fitted], list[str]]:
    """Fit every model that the record can tell to block means ``z`` (n,); return them by name, and why others fail."""
    walk = build_walk(blocks, level=True)
    notes: list[str] = []
    one, t = np.ones_like(blocks.t), blocks.t
    trials = [_white(walk, z, "constant", ("C",), one[:, None])]
    if len(z) > 3:
        trials.append(_linear(walk, z, "ramp", ("C", "slope"), np.stack([one, t], axis=1)))
        bent, why = _fit_exponential(walk, blocks, z)
        trials += [bent] if bent is not None else []
        notes += [why] if why else []
    if temperature is not None and len(z) > 4:
        if float(np.ptp(temperature)) >= TEMPERATURE_SPAN_C:
            trials.append(_fit_temperature(walk, z, temperature))
        else:
            notes.append(f"temperature changes by {np.ptp(temperature):.1f} deg C only: no model against it")
    models = {trial.name: _finish(blocks, z, trial) for trial in trials}
    models["random-walk"] = _random_walk(blocks, walk, z)
    return models, notes


def choose(models: Mapping[str, Fitted], *, static: bool) -> str:
    """Return the name of the model to use: of a static record the one of lowest BIC; of a drive the random walk, unless
    another is better beyond doubt.

    A drive's stops leave gaps in which a curve that only looks right goes anywhere; the random walk does not. Measured
    (``benchmarks/accuracy/calibration.py``): it is never chosen against where the bias walks, and where the bias is a
    curve that shows, the curve is 2 to 3 times better.
    """
    best = min(models, key=lambda name: models[name].model.bic)
    doubted = models["random-walk"].model.bic - models[best].model.bic < BETTER
    return "random-walk" if doubted and not static else best


def _white(walk: Walk, z: Array, name: str, names: tuple[str, ...], X: Array, ratio: float = 0.0) -> _Trial:
    fit = walk.fit(ratio, walk.differences(z), walk.differences(X))
    return _Trial(name, names, fit.beta, X @ fit.beta, X, fit)


def _linear(walk: Walk, z: Array, name: str, names: tuple[str, ...], X: Array) -> _Trial:
    """Fit regressors ``X`` (n, p) with a white residual and with a random walk in it; return the one of lower BIC."""
    ratio = best(walk, walk.differences(z), X=walk.differences(X)).ratio
    return min((_white(walk, z, name, names, X, r) for r in {0.0, ratio}), key=lambda trial: trial.bic)


def _fit_temperature(walk: Walk, z: Array, temperature: Array) -> _Trial:
    names = ("c0", "c1", "c2")
    trials = [
        _linear(walk, z, "temperature", names[: degree + 1], polynomial(temperature, degree)) for degree in (1, 2)
    ]
    return min(trials, key=lambda trial: trial.bic)


def _fit_exponential(walk: Walk, blocks: Blocks, z: Array) -> tuple[_Trial | None, str]:
    """Fit the exponential with a white residual, then with a random walk in it, T and its strength in turn."""
    span = float(blocks.t[-1] - blocks.t[0])
    period = float(np.median(blocks.span / blocks.count))
    shortest = max(T_SHORTEST_SAMPLES * period, T_SHORTEST * span, T_SHORTEST_START * float(blocks.t[0]))
    bounds = math.log(shortest), math.log(T_LONGEST * span)
    if bounds[0] >= bounds[1]:
        return None, "no exponential: at rest too late, or for too short a time"
    white = _projected(walk, blocks.t, z, 0.0, bounds)
    walked = white
    for _ in range(ROUNDS):
        X = walk.differences(exponential(blocks.t, float(walked.values[2])))
        ratio = best(walk, walk.differences(z), X=X).ratio
        if ratio == 0.0:
            break
        walked = _projected(walk, blocks.t, z, ratio, bounds)
    trial = min((white, walked), key=lambda made: made.bic)
    T = float(trial.values[2])
    if min(abs(math.log(T) - bound) for bound in bounds) < T_AT_BOUND:
        return None, f"no exponential: its T would leave {math.exp(bounds[0]):.3g} to {math.exp(bounds[1]):.3g} s"
    return trial, ""


def _projected(walk: Walk, t: Array, z: Array, ratio: float, bounds: tuple[float, float]) -> _Trial:
    """Find T by variable projection: the best of a grid, refined by Brent between its neighbours, then Gauss-Newton on
    all three, never outside the bounds.
    """
    from scipy.optimize import minimize_scalar

    dz = walk.differences(z)

    def value(log_T: float) -> float:
        return walk.fit(ratio, dz, walk.differences(exponential(t, math.exp(log_T)))).value

    grid = np.linspace(*bounds, T_GRID)
    lowest = int(np.argmin([value(x) for x in grid]))
    between = grid[max(lowest - 1, 0)], grid[min(lowest + 1, T_GRID - 1)]
    x = float(minimize_scalar(value, bounds=between, method="bounded", options={"xatol": 1e-6}).x)
    beta = walk.fit(ratio, dz, walk.differences(exponential(t, math.exp(x)))).beta
    for _ in range(3):
        bent, J = _curve(t, beta, math.exp(x))
        step = walk.fit(ratio, walk.differences(z - bent), walk.differences(J)).beta
        T = math.exp(x) + float(step[2])
        if not math.exp(between[0]) < T < math.exp(between[1]):
            break
        x, beta = math.log(T), beta + step[:2]
    bent, J = _curve(t, beta, math.exp(x))
    fit = walk.fit(ratio, walk.differences(z - bent), walk.differences(J))
    return _Trial("exponential", ("C1", "C2", "T"), np.append(beta, math.exp(x)), bent, J, fit)


def _curve(t: Array, beta: Array, T: float) -> tuple[Array, Array]:
    """Return the exponential (n,) and its Jacobian (n, 3) by C1, C2, T."""
    X = exponential(t, T)
    return X @ beta, np.column_stack([X, -beta[0] * np.exp(-t / T) * t / T**2])


def _finish(blocks: Blocks, z: Array, trial: _Trial) -> Fitted:
    """Make the record of a trial: where a random walk is left in its residual, follow it; where none is seen, ``sigma``
    still holds the walk that could just hide.
    """
    fit, q, left = trial.fit, len(trial.values), z - trial.curve
    cov = fit.cov * (fit.n / (fit.n - q))
    N = fit.N * math.sqrt(fit.n / (fit.n - q))
    if fit.ratio > 0.0:
        K = math.sqrt(fit.ratio) * N
        followed = follow_walk(blocks, left, trial.J, cov, N, K)
        fitted, sigma, residual = trial.curve + followed.mean, followed.sigma, followed.innovations
        notes = [f"a random walk of {K:.3g} rad/s^2/sqrt(Hz) is left in the residual and followed"]
    else:
        rows = build_walk(blocks, level=False)
        K, _ = likely_walk(rows, rows.differences(left), best(rows, rows.differences(left)))
        followed = follow_walk(blocks, left, trial.J, cov, N, K)
        fitted, residual, notes = trial.curve, left * np.sqrt(blocks.span) / N, []
        sigma = np.sqrt(followed.sigma**2 + np.mean(followed.mean**2))
    if trial.name == "exponential":
        T, span = float(trial.values[2]), float(blocks.t[-1])
        if span < SHORT * T:
            sure = math.sqrt(cov[2, 2]) / T
            notes.append(f"record of {span / T:.1f} T: too short to know T ({100 * sure:.0f} %) or where it ends")
    model = BiasModel(trial.name, trial.names, trial.values, cov, fitted, sigma, trial.bic, tuple(notes))
    return Fitted(model, residual)


def _random_walk(blocks: Blocks, walk: Walk, z: Array) -> Fitted:
    """Follow the bias itself as a random walk, of the strength that the record makes likely in the mean."""
    one = np.ones((len(z), 1))
    rows = build_walk(blocks, level=False)
    found = best(rows, rows.differences(z))
    K, sigma_K = likely_walk(rows, rows.differences(z), found)
    dz, level = walk.differences(z), walk.differences(one)
    fit = walk.fit((K / found.N) ** 2, dz, level)
    followed = follow_walk(blocks, z - fit.beta, one, fit.cov, found.N, K)
    fitted = fit.beta + followed.mean
    bic = walk.fit(found.ratio, dz, level).value + 2.0 * math.log(len(dz))
    cov = np.diag([followed.sigma[-1] ** 2, sigma_K**2])
    model = BiasModel("random-walk", ("bias", "K"), np.array([fitted[-1], K]), cov, fitted, followed.sigma, bic)
    return Fitted(model, followed.innovations)
