"""Axes named and signed in other ways."""

from __future__ import annotations

import numpy as np
import pytest

from attest_cli.maths.axes import changed, in_words, signed_permutations


def test_there_are_48_half_of_them_left_handed() -> None:
    found = np.array(signed_permutations())
    assert len(np.unique(found.reshape(48, 9), axis=0)) == 48
    assert np.sum(np.linalg.det(found) < 0.0) == 24


@pytest.mark.parametrize("axes", signed_permutations())
def test_an_accelerometer_that_is_mended_as_told_agrees(axes: np.ndarray) -> None:
    """What turns the gyro's axes also mends an accelerometer that looks the same: -P' of a right-handed P."""
    if np.linalg.det(axes) < 0.0:
        return
    rng = np.random.default_rng(3)
    theta, up = rng.normal(size=(2, 5, 3))
    seen = -np.cross(theta @ axes.T, up)  # of the accelerometer as it is
    mended = -axes.T
    np.testing.assert_allclose(seen @ mended.T, -np.cross(theta, up @ mended.T), atol=1e-12)


def test_the_sensor_with_fewer_changes_is_named() -> None:
    assert in_words(np.diag([-1.0, 1.0, 1.0])) == "they would agree, were the gyro's x, y, z its -x, y, z"
    assert in_words(np.diag([1.0, -1.0, -1.0])) == "they would agree, were the accelerometer's x, y, z its -x, y, z"
    assert "reversed" in in_words(-np.eye(3))
    assert changed(np.eye(3)) == 0
