"""Rules of the acceleration noise: eqs 1.43 to 1.48."""

from __future__ import annotations

import numpy as np
import pytest

from attest_cli.filters.acceleration import SWITCHED, Rule, windowed

W = np.array([0.0, 0.02, 0.3, 0.05, 0.01, 0.01, 0.01, 0.2, 0.0, 0.0])


def test_factors_are_the_papers() -> None:
    assert (Rule("constant", 1e-4).factor(W) == 1.0).all()
    assert Rule("switching", 1e-4, 0.1).factor(W).tolist() == [1.0 + SWITCHED * (w > 0.1) for w in W]
    assert Rule("continuous", 1e-4, 1 / 20).factor(W) == pytest.approx(1.0 + 20.0**2 * W**2)  # alpha = 20


@pytest.mark.parametrize("kind", ["constant", "switching", "continuous"])
@pytest.mark.parametrize("window", [0.0, 0.03])
def test_a_running_rule_sees_the_window_of_the_past(kind: str, window: float) -> None:
    rule = Rule(kind, 1e-4, 0.1, window)  # type: ignore[arg-type]
    running = rule.causal(0.01)
    found = [running(k, float(w)) for k, w in enumerate(W)]
    past = [W[max(0, k - round(window / 0.01)) : k + 1].max() for k in range(len(W))]
    assert found == pytest.approx(rule.factor(np.array(past)).tolist())


def test_after_the_drive_the_window_looks_both_ways() -> None:
    assert windowed(W, 0.0, 0.01) is W
    found = windowed(W, 0.04, 0.01)
    assert found.tolist() == [W[max(0, k - 2) : k + 3].max() for k in range(len(W))]
