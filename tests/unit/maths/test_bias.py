"""The curves of a gyro's bias."""

from __future__ import annotations

import numpy as np
import pytest

from attest_cli.maths.bias import curve, gradient

T = np.array([0.0, 60.0, 600.0])


@pytest.mark.parametrize(
    ("name", "values", "expected"),
    [
        ("constant", [0.1], [0.1, 0.1, 0.1]),
        ("ramp", [0.1, 1e-3], [0.1, 0.16, 0.7]),
        ("exponential", [0.2, 0.1, 60.0], [0.1, 0.1 + 0.2 * (1 - np.exp(-1)), 0.1 + 0.2 * (1 - np.exp(-10))]),
        ("random-walk", [0.1, 5e-6], [0.1, 0.1, 0.1]),
    ],
)
def test_each_model_is_its_formula(name: str, values: list[float], expected: list[float]) -> None:
    np.testing.assert_allclose(curve(name, values, T), expected, rtol=1e-14)


def test_a_temperature_polynomial_counts_from_25_degrees() -> None:
    celsius = np.array([25.0, 26.0, 23.0])
    np.testing.assert_allclose(curve("temperature", [0.1, 0.01, 0.001], T, celsius), [0.1, 0.111, 0.084])


@pytest.mark.parametrize(
    ("name", "values"),
    [("constant", [0.1]), ("ramp", [0.1, 1e-3]), ("exponential", [0.2, 0.1, 60.0]), ("temperature", [0.1, 0.01, 1e-3])],
)
def test_a_gradient_is_the_derivative_of_its_curve(name: str, values: list[float]) -> None:
    celsius, step = np.array([25.0, 26.0, 23.0]), 1e-6
    found = gradient(name, values, T, celsius)
    for k in range(len(values)):
        ends = [
            curve(name, [v + sign * step * (j == k) for j, v in enumerate(values)], T, celsius) for sign in (1.0, -1.0)
        ]
        np.testing.assert_allclose(found[:, k], (ends[0] - ends[1]) / (2.0 * step), atol=1e-8, rtol=1e-6)
