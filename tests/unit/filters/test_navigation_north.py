"""Whether a reference tells north: the dip of the field without its iron; and what a wrong one costs."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from attest_cli.filters.navigation.aids import Magnetometer
from attest_cli.filters.navigation.north import counted, north_sigma
from attest_cli.maths import rotation
from attest_cli.records import Smoothed

Array = NDArray[np.float64]
HERE, SOUTH = np.array([1e-6, 22e-6, -42e-6]), np.array([-5e-6, 10e-6, 21e-6])
IRON = np.array([20e-6, -15e-6, 30e-6])


def seen(*, level: bool) -> tuple[Magnetometer, Array]:
    """A sensor in iron that a hand turns, or a vehicle on ``level`` ground."""
    rng = np.random.default_rng(5)
    angles = rng.uniform(-1.0, 1.0, (300, 3)) * ([0.003, 0.003, 3.0] if level else [0.8, 0.8, 3.0])
    R = rotation.matrix(rotation.exp_quaternion(angles))
    field = np.einsum("kji,j->ki", R, HERE) + IRON + rng.normal(0, 5e-7, (300, 3))
    t = np.arange(300.0)
    one = np.ones(300)
    return Magnetometer(np.arange(300), t, field, one > 0, 0.0, one, one), R


def test_iron_alone_leaves_north_known() -> None:
    assert north_sigma(*seen(level=False), HERE) == (0.0, [])


def test_a_reference_of_the_other_hemisphere_tells_no_north() -> None:
    sigma, told = north_sigma(*seen(level=False), SOUTH)
    assert sigma > 0.5
    assert told[0].code == "field-reference"
    assert "dips 62 deg, the reference -62 deg" in told[0].message


@pytest.mark.parametrize("reference", [SOUTH, None])
def test_where_the_iron_cannot_be_told_nothing_is(reference: Array | None) -> None:
    assert north_sigma(*seen(level=reference is not None), reference) == (0.0, [])


def test_an_unknown_north_is_counted_about_the_vertical_only() -> None:
    q = rotation.exp_quaternion(np.array([[0.3, -0.2, 1.0], [0.3, -0.2, 1.1]]))
    P, v = np.tile(1e-4 * np.eye(6), (2, 1, 1)), np.array([[2.0, 0.0, 0.0], [0.0, 1.0, 5.0]])
    known = Smoothed(np.arange(2.0), q, np.zeros((2, 3)), P, 0.5 * P[:1], v=v, p=0.0 * v, P_vp=P.copy())
    found = counted(known, 0.4)
    R = rotation.matrix(q)
    world = R @ found.P[:, :3, :3] @ R.swapaxes(1, 2)
    assert world[0] == pytest.approx(np.diag([1e-4, 1e-4, 1e-4 + 0.16]))
    between = R[:1] @ found.cross[:, :3, :3] @ R[1:].swapaxes(1, 2)
    assert between[0, 2, 2] == pytest.approx(0.16, rel=1e-2)
    assert found.P_vp is not None
    assert found.P_vp[0, 1, 1] == pytest.approx(1e-4 + 0.64)
    assert found.P_vp[1, 2, 2] == pytest.approx(1e-4)
    assert counted(known, 0.0) is known
