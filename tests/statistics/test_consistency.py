"""NEES, NIS and whiteness over many runs, in bands of 99.99 % from chi-square; and that wrong noise breaks them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2, kstest
from support.drives import nees
from support.monte_carlo import band, draw

from attest_cli.filters import indirect
from attest_cli.maths import rotation
from attest_cli.smoothers import SMOOTHERS

Array = NDArray[np.float64]
RUNS, FEW = 120, 40  # honest runs; runs told wrong


@dataclass(frozen=True)
class Sample:
    """NEES (runs, nodes) of both passes; NIS (runs, fixes, sensors); innovations in sigma (runs, fixes, sensors, 2)."""

    forward: Array
    smoothed: Array
    nis: Array
    z: Array


def sample(runs: int, **told: float) -> Sample:
    forward, smoothed, nis, z = [], [], [], []
    for seed in range(runs):
        case = draw(np.random.default_rng([2024, seed]), **told)
        run = indirect.run(case.nodes, case.start, gate_probability=1.0)
        two = SMOOTHERS["two-filter"](run)
        for rows, q, bias, P in ((forward, run.q, run.bias, run.chain.P), (smoothed, two.q, two.bias, two.P)):
            turn = rotation.log_quaternion(rotation.multiply(rotation.conjugate(q), case.q))
            rows.append(nees(np.hstack([turn, case.bias - bias]), P))
        nis.append(run.innovations.nis.reshape(-1, 2))
        z.append(run.innovations.z[:, :2].reshape(-1, 2, 2))
    return Sample(np.array(forward), np.array(smoothed), np.array(nis), np.array(z))


def per_node(values: Array) -> Array:
    """Mean NEES of each node over the runs, per state."""
    return np.asarray(values.mean(axis=0) / 6)


def share_outside(values: Array) -> float:
    low, high = band(6 * len(values))
    means = per_node(values)
    return float(np.mean((means < low) | (means > high)))


@pytest.fixture(scope="module")
def honest() -> Sample:
    return sample(RUNS)


def test_nees_of_every_node_is_inside_the_band(honest: Sample) -> None:
    low, high = band(6 * RUNS)
    for name, values in (("forward", honest.forward), ("smoothed", honest.smoothed)):
        means = per_node(values)
        print(f"{name}: mean NEES per state {means.min():.3f} to {means.max():.3f}, band {low:.3f} to {high:.3f}")
        assert np.all((low < means) & (means < high))


def test_nis_follows_chi_square(honest: Sample) -> None:
    low, high = band(2 * honest.nis[..., 0].size)
    for sensor in (0, 1):
        values = honest.nis[..., sensor].ravel()
        p = kstest(values, chi2(2).cdf).pvalue
        print(f"mean NIS per degree {values.mean() / 2:.3f}, band {low:.3f} to {high:.3f}, Kolmogorov p {p:.3f}")
        assert low < values.mean() / 2 < high
        assert p > 1e-3


def test_innovations_are_white(honest: Sample) -> None:
    """One fix says nothing about the next: lag-one correlation of the normalised innovations of a sensor."""
    first, second = honest.z[:, :-1], honest.z[:, 1:]
    n = len(first) * first.shape[1]
    for sensor in (0, 1):
        r = np.einsum("rfi,rfj->ij", first[:, :, sensor], second[:, :, sensor]) / n
        assert np.abs(r).max() < 4.5 / np.sqrt(n)


@pytest.mark.parametrize(
    "told", [{"Q": 4.0}, {"Q": 0.25}, {"R": 4.0}, {"R": 0.25}], ids=["Q x 4", "Q / 4", "R x 4", "R / 4"]
)
def test_the_bands_break_when_the_filter_is_told_wrong(told: dict[str, float]) -> None:
    found = sample(FEW, **told)
    low, high = band(2 * found.nis[..., 0].size)
    nis = found.nis.mean(axis=(0, 1)) / 2
    outside = share_outside(found.forward), share_outside(found.smoothed)
    print(f"nodes outside: forward {outside[0]:.2f}, smoothed {outside[1]:.2f}; NIS {nis}")
    assert min(outside) > 0.5
    assert np.all((nis < low) | (nis > high))
