"""The passes of the navigation smoother: steps that overshoot are shortened, others are not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from attest_cli.filters.navigation import solve
from attest_cli.filters.navigation.aids import Rows, blank
from attest_cli.filters.navigation.model import Inertial, Trajectory
from attest_cli.filters.navigation.states import CORE, Layout, State, layout
from attest_cli.maths import kalman, sequential
from attest_cli.maths.propagation import Steps

Array = NDArray[np.float64]
NODES, COUNT = 3, 400


@dataclass(frozen=True)
class Bent:
    r"""Many readings of the bend of one state, :math:`z=\tfrac12cx^2+v`, whose noise does not average out."""

    bend: float
    role: str = "bent"
    robust: bool = False

    def rows(self, form: Layout, at: Trajectory) -> Rows:
        """Return what the bend does not explain: its mean is -1/20 of a sigma."""
        part, node = form.parts["odometry scale"].start, np.array([1])
        z = np.random.default_rng(3).normal(0.0, 1.0, (1, COUNT))
        z += -0.05 - z.mean()
        x, H = float(at.x[1, part]), blank(form, 1, COUNT)
        H[:, :, part] = self.bend * x
        return Rows(node, np.ones(1), z - 0.5 * self.bend * x**2, H, np.ones((1, COUNT)))


def solved(bend: float, begin: float) -> tuple[solve.Solution, float]:
    """Solve for a constant state with a prior of 0 +- 1 beside the bent readings, from ``begin``."""
    form = layout([*(State(name, 3, 1e-3) for name in CORE), State("odometry scale", 1, 1.0)])
    steps = Steps(np.full(2, 0.1), np.zeros((2, 3)), np.zeros((2, 3)), np.arange(NODES))
    up, held = np.tile([0.0, 0.0, 9.8], (2, 1)), np.zeros(2, dtype=np.bool_)
    inertial = Inertial(steps, up, up, held, held, np.full(2, 1e-8), np.full(2, 1e-8), 0.0, 0.0, 9.8)
    q, x = np.tile([1.0, 0.0, 0.0, 0.0], (NODES, 1)), np.zeros((NODES, form.size))
    prior = Trajectory(q[:1], x[:1].copy()), np.diag(form.prior())
    x[:, form.parts["odometry scale"]] = begin
    found = solve.solve(form, prior, inertial, [Bent(bend)], Trajectory(q, x), 12)
    return found, float(found.smoothed.x[0, form.parts["odometry scale"].start])


@pytest.mark.parametrize("ratio", [0.0, 0.3, 2.0, 4.0])
def test_a_state_that_noise_bends_more_than_its_prior_holds_it_settles(ratio: float) -> None:
    """A whole Gauss-Newton step is then ``-ratio`` times the one before: it diverges from 1 on."""
    found, state = solved(bend=ratio / (0.05 * COUNT), begin=0.3)
    assert found.settled
    assert abs(state) < 0.1


def test_only_steps_that_go_back_and_hardly_shrink_are_shortened() -> None:
    step = np.array([1.0, -2.0, 0.5])
    assert solve._share(step, 1.2 * step, 1.0) == 1.0
    assert solve._share(step, -0.3 * step, 1.0) == 1.0
    assert solve._share(step, -2.0 * step, 1.0) == pytest.approx(1.0 / 3.0)
    assert solve._share(step, -1.0 * step, 1.0 / 3.0) == pytest.approx(1.0 / 6.0)
    assert solve._share(step, 0.5 * step, 0.25) == pytest.approx(0.5)
    assert solve._share(step, 0.0 * step, 0.25) == pytest.approx(0.25)


def test_a_variance_rounded_off_below_zero_does_not_keep_it_from_settling(monkeypatch: pytest.MonkeyPatch) -> None:
    """As of the speed at the first node, known to 100 m/s beforehand and to millimetres by a tracker."""
    smooth = solve.adjoint.smooth

    def rounded(run: sequential.Pass) -> kalman.Errors:
        errors = smooth(run)
        errors.P[0, 3, 3] = -1e-9 * run.chain.P[0, 3, 3]
        return errors

    monkeypatch.setattr(solve.adjoint, "smooth", rounded)
    assert solved(bend=0.0, begin=0.3)[0].settled
