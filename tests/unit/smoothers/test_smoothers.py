"""Every smoother of the registry on a simulated run, the backward pass, and Gauss-Newton."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from support.drives import Job, degrees_apart, nees, score, simulated
from support.monte_carlo import Case, draw

from attest_cli.filters import indirect
from attest_cli.maths import kalman, rotation
from attest_cli.records import FilterRun, Smoothed
from attest_cli.simulate import RoverOptions
from attest_cli.smoothers import SMOOTHERS, apply, backward_estimate, gauss_newton, paper, thinned

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def work() -> Job:
    return simulated(RoverOptions(seed=57, motions=2, motion_s=(60.0, 80.0)), smoothing={"zero_rate": False})


@pytest.fixture(scope="module")
def run(work: Job) -> FilterRun:
    return indirect.run(work.nodes, work.start)


@pytest.mark.parametrize("name", SMOOTHERS)
def test_contract_of_every_smoother(run: FilterRun, work: Job, name: str) -> None:
    found = SMOOTHERS[name](run)
    n = len(run.t)
    assert found.q.shape == (n, 4)
    assert found.bias.shape == (n, 3)
    assert found.P.shape == (n, 6, 6)
    assert found.cross.shape == (n - 1, 6, 6)
    assert np.array_equal(found.t, run.t)
    assert np.abs(np.linalg.norm(found.q, axis=1) - 1.0).max() < 1e-12
    assert np.array_equal(found.P, found.P.swapaxes(1, 2))
    assert np.linalg.eigvalsh(found.P).min() > 0
    assert degrees_apart(found.q[-1:], run.q[-1:]) < 1e-9  # nothing comes after the last node
    if name != "none":
        better = score(work, found.t, found.q, found.bias, found.P).attitude
        assert better < 0.5 * score(work, run.t, run.q, run.bias, run.chain.P).attitude


@pytest.mark.parametrize("name", ["two-filter", "rts", "none"])
def test_two_neighbours_have_a_covariance(run: FilterRun, name: str) -> None:
    """``[[P_k, cross], [cross', P_k+1]]`` is positive semidefinite; the position sigma rests on it."""
    found = SMOOTHERS[name](run)
    above = np.concatenate([found.P[:-1], found.cross], axis=2)
    joint = np.concatenate([above, np.concatenate([found.cross.swapaxes(1, 2), found.P[1:]], axis=2)], axis=1)
    sigma = np.sqrt(np.einsum("kii->ki", joint))
    assert np.linalg.eigvalsh(joint / (sigma[:, :, None] * sigma[:, None])).min() > -1e-8


def test_two_filter_is_rts(run: FilterRun) -> None:
    two, one = SMOOTHERS["two-filter"](run), SMOOTHERS["rts"](run)
    sigma = np.sqrt(np.einsum("kii->ki", one.P))
    turn = rotation.log_quaternion(rotation.multiply(rotation.conjugate(one.q), two.q))
    assert np.abs(turn / sigma[:, :3]).max() < 1e-8
    assert np.abs((two.bias - one.bias) / sigma[:, 3:]).max() < 1e-8
    scale = sigma[:, :, None] * sigma[:, None]
    assert np.abs((two.P - one.P) / scale).max() < 1e-8
    assert np.abs((two.cross - one.cross) / (sigma[:-1, :, None] * sigma[1:, None])).max() < 1e-8


def test_none_is_the_forward_pass(run: FilterRun) -> None:
    found = SMOOTHERS["none"](run)
    assert degrees_apart(found.q, run.q) < 1e-9
    assert np.array_equal(found.bias, run.bias)
    assert np.allclose(found.P, run.chain.P, rtol=1e-12)


def test_smoothed_covariance_is_below_the_forward_one_in_one_tangent(run: FilterRun) -> None:
    errors = kalman.fuse(run.chain, *kalman.information(run.chain))
    sigma = np.sqrt(np.einsum("kii->ki", run.chain.P))
    assert np.linalg.eigvalsh((run.chain.P - errors.P) / (sigma[:, :, None] * sigma[:, None])).min() > -1e-8


def test_apply_moves_the_covariance_to_the_corrected_tangent(run: FilterRun, rng: np.random.Generator) -> None:
    d = np.zeros((len(run.t), 6))
    d[:, :3] = [0.3, -0.2, 0.4]
    found = apply(run, kalman.Errors(d, run.chain.P, np.zeros((len(run.t) - 1, 6, 6))))
    k, samples = 40, rng.multivariate_normal(np.zeros(6), run.chain.P[40], 20000)
    truth = rotation.multiply(run.q[k], rotation.exp_quaternion(d[k, :3] + 1e-3 * samples[:, :3]))
    about = rotation.log_quaternion(rotation.multiply(rotation.conjugate(found.q[k]), truth)) / 1e-3
    wanted, sigma = np.cov(about.T), np.sqrt(np.diag(found.P[k])[:3])
    assert (
        np.abs((found.P[k, :3, :3] - wanted) / np.outer(sigma, sigma)).max() < 0.06
    )  # 20000 samples: 4 sigma are 0.04


def test_backward_pass_holds_what_comes_after(work: Job, run: FilterRun) -> None:
    q, bias, P = backward_estimate(run)
    known = np.isfinite(q[:, 0])
    assert known[: len(known) // 2].mean() > 0.9
    assert not known[-1]
    assert np.array_equal(known, np.isfinite(P[:, 0, 0]))
    two = SMOOTHERS["two-filter"](run)
    e = work.errors(run.t[known], q[known], bias[known])
    moving = work.truth(run.t[known]).moving
    mean = float(nees(e, P[known])[moving].mean())
    print(f"NEES of the backward pass {mean:.2f}")
    assert 2.0 < mean < 12.0
    fused = np.linalg.inv(np.linalg.inv(run.chain.P[known]) + np.linalg.inv(P[known]))
    scale = np.sqrt(np.einsum("kii->ki", fused))
    late = np.abs(fused - two.P[known]) / (scale[:, :, None] * scale[:, None])
    assert np.median(late) < 1e-2  # forward plus backward is the smoothed covariance, but for the tangent


def test_paper_leaves_the_stops_to_the_forward_pass(run: FilterRun) -> None:
    found = SMOOTHERS["paper"](run)
    still = ~run.moving
    assert degrees_apart(found.q[still], run.q[still]) < 1e-9
    assert np.allclose(found.P[still], run.chain.P[still], rtol=1e-12)
    moved = rotation.log_quaternion(rotation.multiply(rotation.conjugate(run.q[run.moving]), found.q[run.moving]))
    assert np.abs(moved).max() > 1e-3


def test_paper_motions_end_in_a_stop() -> None:
    moving = np.array([1, 1, 0, 0, 1, 1, 1, 0, 1, 1], dtype=np.bool_)
    assert paper._motions(moving) == [(0, 1, 3), (4, 6, 7)]
    assert paper._motions(np.zeros(4, dtype=np.bool_)) == []
    assert paper._motions(np.ones(4, dtype=np.bool_)) == []


@pytest.fixture(scope="module")
def case() -> Case:
    return draw(np.random.default_rng(21))


def start_of(case: Case) -> Smoothed:
    return SMOOTHERS["two-filter"](indirect.run(case.nodes, case.start, 1.0))


def residuals(case: Case, q: Array, bias: Array) -> Array:
    """Every whitened residual of the maximum a posteriori problem, written out."""
    inc = case.nodes.increments
    e = np.concatenate(
        [rotation.log_quaternion(rotation.multiply(rotation.conjugate(case.start.q), q[0])), bias[0] - case.start.bias]
    )
    out = [np.linalg.solve(np.linalg.cholesky(case.start.P), e)]
    turns, _ = inc.at(bias[:-1], 0, len(q) - 1)
    turn = rotation.log_quaternion(rotation.multiply(rotation.conjugate(rotation.multiply(q[:-1], turns)), q[1:]))
    w = np.hstack([turn, bias[1:] - bias[:-1]])
    out += [np.linalg.solve(np.linalg.cholesky(Q), x) for Q, x in zip(inc.Q, w, strict=True)]
    for k, group in zip(case.nodes.measured, case.nodes.measurements, strict=True):
        R = rotation.matrix(q[k])
        out += [np.linalg.solve(np.linalg.cholesky(m.noise), m.linearise(R, bias[k])[0]) for m in group]
    return np.concatenate(out)


def test_gauss_newton_is_scipys_least_squares(case: Case) -> None:
    """The same optimum as a general solver finds on the written-out problem, with numerical derivatives."""
    first = start_of(case)
    found = gauss_newton.refine(case.nodes, case.start, first, None, 6)
    n = len(first.t)

    def trial(x: Array) -> Array:
        d = x.reshape(n, 6)
        return residuals(case, rotation.multiply(found.q, rotation.exp_quaternion(d[:, :3])), found.bias + d[:, 3:])

    at_optimum = np.sum(residuals(case, found.q, found.bias) ** 2)
    assert at_optimum < np.sum(residuals(case, first.q, first.bias) ** 2) + 1e-12
    sigma = np.sqrt(np.einsum("kii->ki", found.P))
    solved = least_squares(lambda x: trial(x * sigma.ravel()), np.zeros(6 * n), jac="3-point", max_nfev=1)
    step = np.linalg.solve(solved.jac.T @ solved.jac, solved.grad)
    print(f"by numerical derivatives the optimum is {np.abs(step).max():.1e} sigma away")
    assert np.abs(step).max() < 2e-2  # transitions are linearised at constant rate: second order in gyro noise
    dense = np.linalg.inv(solved.jac.T @ solved.jac).reshape(n, 6, n, 6)
    P = np.stack([dense[k, :, k] for k in range(n)]) * sigma[:, :, None] * sigma[:, None]
    assert np.abs((P - found.P) / (sigma[:, :, None] * sigma[:, None])).max() < 2e-2
    cross = np.stack([dense[k, :, k + 1] for k in range(n - 1)])
    assert np.abs(cross - found.cross / (sigma[:-1, :, None] * sigma[1:, None])).max() < 2e-2


def test_passes_stop_when_nothing_moves(case: Case) -> None:
    first = start_of(case)
    free = gauss_newton.refine(case.nodes, case.start, first, None, 20, fixed=False)
    assert 1 <= free.passes < 6
    assert gauss_newton.refine(case.nodes, case.start, first, None, 7).passes == 7
    again = gauss_newton.refine(case.nodes, case.start, free, None, 20, fixed=False)
    assert again.passes == 1
    sigma = np.sqrt(np.einsum("kii->ki", free.P))
    assert np.abs((again.bias - free.bias) / sigma[:, 3:]).max() < 1e-3


def test_gauss_newton_keeps_out_what_the_gate_rejected(case: Case) -> None:
    groups = list(case.nodes.measurements)
    bad = groups[5][0]
    groups[5] = (replace(bad, values=bad.values + np.array([[0.3, -0.2, 0.1]])), *groups[5][1:])
    nodes = replace(case.nodes, measurements=tuple(groups))
    run = indirect.run(nodes, case.start)
    assert (~run.innovations.used).sum() == 1
    gated = gauss_newton.refine(nodes, case.start, SMOOTHERS["two-filter"](run), run.innovations, 4)
    groups[5] = groups[5][1:]
    without = replace(case.nodes, measurements=tuple(groups))
    clean = gauss_newton.refine(
        without, case.start, SMOOTHERS["two-filter"](indirect.run(without, case.start)), None, 4
    )
    assert degrees_apart(gated.q, clean.q) < 1e-6


def test_gauss_newton_agrees_with_the_smoothers_where_errors_are_small(work: Job, run: FilterRun) -> None:
    two = SMOOTHERS["two-filter"](run)
    found = gauss_newton.refine(work.nodes.rebuild(two.bias), work.start, two, run.innovations, 3)
    sigma = np.sqrt(np.einsum("kii->ki", two.P))
    turn = rotation.log_quaternion(rotation.multiply(rotation.conjugate(two.q), found.q))
    assert np.abs(turn / sigma[:, :3]).max() < 0.3
    assert np.allclose(np.sqrt(np.einsum("kii->ki", found.P)), sigma, rtol=0.1)


def test_thinned_keeps_the_joint_of_the_nodes_it_keeps(run: FilterRun) -> None:
    """Leaving nodes out marginalises: the covariance between two kept ones is that of the whole chain."""
    whole = SMOOTHERS["rts"](run)
    few = thinned(whole, np.array([3, 4, 9, 10, 40]))
    assert np.array_equal(few.P, whole.P[[3, 4, 9, 10, 40]])
    assert np.array_equal(few.cross[0], whole.cross[3])
    lag = whole.P[9]
    for k in range(4, 9):
        F = np.linalg.solve(whole.P[k], whole.cross[k])
        lag = whole.P[k] @ F if k == 4 else lag @ F
    assert np.allclose(few.cross[1], lag, rtol=1e-8, atol=1e-18)
    again = thinned(thinned(whole, np.array([3, 9, 10, 25, 40])), np.array([0, 1, 4]))
    assert np.allclose(again.cross, thinned(whole, np.array([3, 9, 40])).cross, rtol=1e-7, atol=1e-18)
