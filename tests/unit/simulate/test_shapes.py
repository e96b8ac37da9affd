"""Plateaus and kicks: values, derivatives and integrals belong together."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.signals import gauss_points

from attest_cli.simulate.shapes import Kicks, Plateaus
from attest_cli.simulate.simulation import integral

ROWS = [(1.0, 3.0, 0.5, 2.0), (3.0, 5.0, 1.0, -1.0), (6.5, 6.9, 0.2, 3.0)]


def test_a_plateau_has_its_height_and_its_area() -> None:
    shape = Plateaus.of(ROWS)
    _, value, slope, _ = shape.at(np.array([0.0, 1.0, 1.25, 2.0, 3.0, 4.0, 6.7, 8.0]))
    np.testing.assert_allclose(value, [0.0, 0.0, 1.0, 2.0, 0.0, -1.0, 3.0, 0.0], atol=1e-15)
    assert np.all(slope[[0, 3, 5, 7]] == pytest.approx(0.0, abs=1e-14))
    area = sum(height * (end - start - edge) for start, end, edge, height in ROWS)
    assert shape.at(np.array([9.0]))[0][0] == pytest.approx(area, abs=1e-14)


def test_derivatives_and_integral_of_plateaus_belong_to_their_value() -> None:
    shape, step = Plateaus.of(ROWS), 1e-3
    t = np.arange(0.0, 8.0, 0.0371)
    kinks = np.array([x for start, end, edge, _ in ROWS for x in (start, start + edge, end - edge, end)])
    t = t[np.abs(t[:, None] - kinks).min(axis=1) > 2 * step]
    area, value, slope, bend = shape.at(t)
    after, before = shape.at(t + step), shape.at(t - step)
    for k, derivative in enumerate((value, slope, bend)):
        np.testing.assert_allclose((after[k] - before[k]) / (2 * step), derivative, rtol=1e-4, atol=3e-3)
    one, two = gauss_points(0.0, 0.02, 400)
    summed = np.cumsum(0.01 * (shape.at(one)[1] + shape.at(two)[1]))
    np.testing.assert_allclose(shape.at(0.02 * np.arange(1, 401))[0], summed, atol=1e-6)
    assert area.max() == pytest.approx(3.0)


def test_edges_of_no_length_are_steps() -> None:
    shape = Plateaus.of([(1.0, 2.0, 0.0, 5.0), (2.0, 4.0, 0.0, -1.0)])
    area, value, slope, bend = shape.at(np.array([0.5, 1.5, 1.999, 3.0, 4.5]))
    np.testing.assert_array_equal(value, [0.0, 5.0, 5.0, -1.0, 0.0])
    np.testing.assert_allclose(area, [0.0, 2.5, 4.995, 4.0, 3.0], atol=1e-14)
    assert not slope.any()
    assert not bend.any()


def test_no_plateau_is_nothing() -> None:
    assert not np.any(Plateaus.of([]).at(np.linspace(0.0, 1.0, 5)))


@pytest.mark.parametrize("recovery", [0.0, 0.15])
def test_the_speed_of_kicks_is_the_integral_of_their_force(recovery: float) -> None:
    kicks = Kicks(np.array([0.3, 0.7]), np.array([[1.0, -2.0], [4.0, 0.5]]), 0.025, recovery)
    t = np.arange(0.0, 1.2, 0.005)
    np.testing.assert_allclose(kicks.at(t)[0], integral(lambda x: kicks.at(x)[1], t), atol=1e-7)
    gained = 2 * 0.025 / math.pi * np.array([5.0, -1.5])
    np.testing.assert_allclose(kicks.at(np.array([1.1]))[0][0], 0.0 if recovery else gained, atol=1e-15)
    np.testing.assert_allclose(kicks.at(np.array([0.3125]))[1][0], [1.0, -2.0])
    assert not np.any(kicks.at(np.array([0.0, 0.29])))
