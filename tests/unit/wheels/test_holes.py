"""How far apart measurements of the wheels may lie."""

from __future__ import annotations

import numpy as np
import pytest

from attest_cli.wheels import longest_hole


@pytest.mark.parametrize(
    ("t", "hole"),
    [(np.arange(0.0, 9.0, 0.1), 1.0), (np.arange(0.0, 9.0, 0.5), 2.5), (np.arange(0.0, 90.0, 2.0), 5.0),
     (np.array([0.0, 30.0, 60.0]), 5.0), (np.array([3.0]), 1.0), (np.zeros(0), 1.0)],
)  # fmt: skip
def test_the_longest_hole_follows_the_usual_rate_and_is_no_drive(t: np.ndarray, hole: float) -> None:
    assert longest_hole(t) == hole
