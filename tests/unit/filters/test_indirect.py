"""The forward filter: gates, order of measurements, what it leaves for the smoothers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2
from support.drives import Job, degrees_apart, nees, simulated
from support.monte_carlo import Case, draw

from attest_cli.filters import indirect, load
from attest_cli.maths import rotation
from attest_cli.nodes import Nodes
from attest_cli.records import FilterRun
from attest_cli.sensors import Measurement
from attest_cli.simulate import RoverOptions

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def case() -> Case:
    return draw(np.random.default_rng(11))


@pytest.fixture(scope="module")
def work() -> Job:
    return simulated(RoverOptions(seed=51, duration_s=90.0, motions=1, compass=True))


def with_measurement(nodes: Nodes, at: int, change: Measurement) -> Nodes:
    """Replace the first measurement of the ``at``-th measured node."""
    groups = list(nodes.measurements)
    groups[at] = (change, *groups[at][1:])
    return replace(nodes, measurements=tuple(groups))


def pushed(m: Measurement, sigmas: float) -> Measurement:
    """A direction moved across itself by so many of its sigmas."""
    z = m.values[0]
    across = np.cross(z, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    return replace(m, values=(z + sigmas * np.sqrt(m.noise[0, 0]) * across)[None])


def test_the_registry_names_this_filter() -> None:
    assert load("indirect") is indirect.forward


def test_an_outlier_is_counted_and_does_nothing(case: Case) -> None:
    at = 4
    bad = with_measurement(case.nodes, at, pushed(case.nodes.measurements[at][0], 20.0))
    run = indirect.run(bad, case.start)
    found = run.innovations
    assert (~found.used).sum() == 1
    worst = int(np.flatnonzero(~found.used)[0])
    assert found.role[worst] == "sun"
    assert found.node[worst] == case.nodes.measured[at]
    assert found.nis[worst] > chi2.ppf(0.9999, 2)
    without = list(case.nodes.measurements)
    without[at] = without[at][1:]
    clean = indirect.run(replace(case.nodes, measurements=tuple(without)), case.start)
    assert np.array_equal(run.q, clean.q)
    assert np.array_equal(run.chain.P, clean.chain.P)


def test_the_gate_is_the_quantile_it_is_told(case: Case) -> None:
    run = indirect.run(case.nodes, case.start, gate_probability=1.0)
    nis = np.sort(run.innovations.nis)
    limit = 0.5 * (nis[-1] + nis[-2])
    narrow = indirect.run(case.nodes, case.start, gate_probability=float(chi2.cdf(limit, 2)))
    assert run.innovations.used.all()
    assert (~narrow.innovations.used).any()
    wide = indirect.run(case.nodes, case.start, gate_probability=float(chi2.cdf(1.3 * nis[-1], 2)))
    assert wide.innovations.used.all()


def test_without_gates_the_outlier_pulls(case: Case) -> None:
    bad = with_measurement(case.nodes, 4, pushed(case.nodes.measurements[4][0], 20.0))
    gated, open_ = (indirect.run(bad, case.start, g) for g in (0.9999, 1.0))
    assert degrees_apart(gated.q, open_.q) > 0.1


def test_the_order_of_measurements_at_a_node_does_not_matter(case: Case) -> None:
    swapped = replace(case.nodes, measurements=tuple(group[::-1] for group in case.nodes.measurements))
    a, b = indirect.run(case.nodes, case.start, 1.0), indirect.run(swapped, case.start, 1.0)
    assert degrees_apart(a.q, b.q) < 1e-9
    assert np.allclose(a.chain.P, b.chain.P, rtol=1e-9, atol=1e-15)


def test_innovations_list_every_measurement_once(case: Case) -> None:
    found = indirect.run(case.nodes, case.start).innovations
    total = sum(len(group) for group in case.nodes.measurements)
    assert len(found.nis) == total
    assert np.all(found.dof == 2)
    assert np.isnan(found.z[:, 2]).all()
    assert np.isfinite(found.z[:, :2]).all()
    assert set(zip(found.node.tolist(), found.role.tolist(), strict=True)) == {
        (m.node, m.role) for group in case.nodes.measurements for m in group
    }


def chain_holds(run: FilterRun) -> None:
    c = run.chain
    predicted = c.Phi @ c.P[:-1] @ c.Phi.swapaxes(1, 2) + c.Q
    sigma = np.sqrt(np.einsum("kii->ki", c.P_pred[1:]))
    assert np.abs((predicted - c.P_pred[1:]) / (sigma[:, :, None] * sigma[:, None])).max() < 1e-9
    touched = np.any(c.dx != 0, axis=1)
    assert np.array_equal(touched, np.isin(np.arange(len(run.t)), run.innovations.node[run.innovations.used]))
    assert np.array_equal(c.P[~touched], c.P_pred[~touched])
    assert not c.info[~touched].any()
    J, _ = c.reset_jacobians()
    for k in np.flatnonzero(touched):
        prior = np.linalg.inv(J[k] @ c.P_pred[k] @ J[k].T)
        scale = np.sqrt(np.diag(c.P[k]))
        posterior = np.linalg.inv(prior + c.info[k])
        assert np.abs((posterior - c.P[k]) / np.outer(scale, scale)).max() < 1e-6


def test_the_chain_says_what_the_filter_did(case: Case, work: Job) -> None:
    chain_holds(indirect.run(case.nodes, case.start))
    chain_holds(indirect.run(work.nodes, work.start))


def test_between_measurements_the_attitude_follows_the_increments(work: Job) -> None:
    run = indirect.run(work.nodes, work.start)
    c = run.chain
    for k in (50, 200, 400):
        turn, Phi = work.nodes.increments.at(run.bias[k : k + 1], k, k + 1)
        predicted = rotation.multiply(run.q[k], turn[0])
        corrected = rotation.multiply(predicted, rotation.exp_quaternion(c.dx[k + 1, :3]))
        assert (
            np.abs(rotation.log_quaternion(rotation.multiply(rotation.conjugate(run.q[k + 1]), corrected))).max()
            < 1e-12
        )
        assert np.allclose(run.bias[k + 1], run.bias[k] + c.dx[k + 1, 3:], atol=1e-15)
        assert np.allclose(c.Phi[k], Phi[0], atol=1e-14)


def test_a_measurement_at_the_first_node_counts(case: Case) -> None:
    m = replace(case.nodes.measurements[0][0], node=0, values=(rotation.matrix(case.q[0]).T @ [0.6, -0.48, 0.64])[None])
    nodes = replace(
        case.nodes, measured=np.concatenate([[0], case.nodes.measured]), measurements=((m,), *case.nodes.measurements)
    )
    run = indirect.run(nodes, case.start)
    assert np.any(run.chain.dx[0] != 0)
    assert np.trace(run.chain.P[0]) < np.trace(case.start.P)


def test_without_measurements_the_filter_dead_reckons(case: Case) -> None:
    nodes = replace(case.nodes, measured=np.array([], dtype=np.int64), measurements=())
    run = indirect.run(nodes, case.start)
    assert len(run.innovations.nis) == 0
    assert np.allclose(run.bias, case.start.bias)
    turned = rotation.chain(nodes.increments.dq, case.start.q)
    assert degrees_apart(run.q[1:], turned) < 1e-9
    assert np.all(np.diff(np.trace(run.chain.P, axis1=1, axis2=2)) > 0)


def test_more_than_one_iteration_matters_far_out(case: Case) -> None:
    far = replace(case.start, q=rotation.multiply(case.start.q, rotation.exp_quaternion(np.array([0.0, 0.0, 0.6]))),
                  P=np.diag([0.01, 0.01, 0.5, 1e-4, 1e-4, 1e-4]))  # fmt: skip
    first = case.nodes.measured[:1]
    ratios = []
    for iterations in (1, 8):
        run = indirect.run(case.nodes, far, 1.0, iterations)
        e = rotation.log_quaternion(rotation.multiply(rotation.conjugate(run.q[first]), case.q[first]))
        ratios.append(float(nees(e, run.chain.P[first, :3, :3])[0]))
    print("NEES of the attitude after the first update, plain and iterated:", ratios)
    assert ratios[1] < chi2.ppf(0.9999, 3) < ratios[0]
