"""Nodes: where they stand, what lies between them, and that a filter over them is the per-sample filter."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from support.drives import Job, job, simulated

from attest_cli.filters import indirect
from attest_cli.maths import rotation
from attest_cli.maths.propagation import transition
from attest_cli.nodes import FROZEN_DENSITY, NEARNESS, STOP_NODE_S, _grid, _inside
from attest_cli.records import Imu, Log
from attest_cli.simulate import RoverOptions
from attest_cli.smoothers import SMOOTHERS
from attest_cli.track import full_rate, world_variance

Array = NDArray[np.float64]
OPTIONS = RoverOptions(seed=41, duration_s=90.0, motions=2, compass=True, sun_always=True)


@pytest.fixture(scope="module")
def work() -> Job:
    return simulated(OPTIONS)


def intervals(inside: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last node of every run of flagged intervals."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(int), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def test_times_rise_and_span_the_imu(work: Job) -> None:
    t = work.nodes.t
    assert np.all(np.diff(t) > 0)
    assert t[0] == work.log.imu.t[0]
    assert t[-1] == work.log.imu.t[-1]


def test_no_interval_is_longer_than_its_spacing(work: Job) -> None:
    width = np.diff(work.nodes.t)
    spacing = work.settings.smoothing.node_spacing_s
    assert width[~work.nodes.frozen].max() <= spacing * (1 + 1e-9)
    assert width[work.nodes.frozen].max() <= STOP_NODE_S * (1 + 1e-9)
    assert width[work.nodes.frozen].max() > spacing  # stops are indeed coarser


@pytest.mark.parametrize("spacing", [0.02, 0.25, 3.0])
def test_spacing_follows_the_settings(work: Job, spacing: float) -> None:
    stops = [(s.used_start, s.used_end) for s in work.segmentation.stops]
    epochs = np.array([17.123, 30.0, 30.0 + 1e-8, 45.5])
    t = _grid(work.log.imu.t, stops, stops, [], epochs, spacing)
    still = _inside(0.5 * (t[1:] + t[:-1]), stops)
    assert np.diff(t)[~still].max() <= spacing * (1 + 1e-9)
    assert all(np.abs(t - e).min() < 1e-6 for e in (*epochs, *np.ravel(stops)))
    assert np.diff(t).min() > 1e-6


def test_every_measurement_has_the_node_nearest_to_it(work: Job) -> None:
    nodes = work.nodes
    assert np.all(np.diff(nodes.measured) > 0)
    assert len(nodes.measured) == len(nodes.measurements)
    for k, group in zip(nodes.measured, nodes.measurements, strict=True):
        for m in group:
            assert m.node == k
            assert abs(nodes.t[k] - m.t) == np.abs(nodes.t - m.t).min()


def sample_steps(work: Job) -> NDArray[np.int64]:
    """The step that ends at each IMU sample but the first."""
    grid = np.unique(np.concatenate([work.log.imu.t, work.nodes.t]))
    return np.searchsorted(grid, work.log.imu.t[1:]) - 1


def test_steps_are_the_imu_between_the_nodes(work: Job) -> None:
    nodes, imu = work.nodes, work.log.imu
    ends = np.concatenate([[0.0], np.cumsum(nodes.steps.dt)]) + imu.t[0]
    assert np.allclose(ends[nodes.steps.first], nodes.t, rtol=0, atol=1e-9)
    sample_step = sample_steps(work)
    assert np.allclose(ends[1:][sample_step], imu.t[1:], rtol=0, atol=1e-9)
    held = np.repeat(nodes.frozen | nodes.gap, nodes.steps.count)
    assert not nodes.steps.rate0[held].any()
    assert not nodes.steps.rate1[held].any()
    samples = sample_step[~held[sample_step]]
    rows = np.flatnonzero(~held[sample_step]) + 1
    assert np.allclose(nodes.steps.rate1[samples], imu.gyro_b[rows], atol=1e-12)


def test_interval_rule_holds_each_sample_over_the_time_before_it() -> None:
    work = simulated(OPTIONS, imu={"gyro_samples": "interval"})
    steps, frozen = work.nodes.steps, np.repeat(work.nodes.frozen, work.nodes.steps.count)
    assert np.array_equal(steps.rate0, steps.rate1)
    at = sample_steps(work)
    rows = np.flatnonzero(~frozen[at]) + 1
    assert np.array_equal(steps.rate0[at[rows - 1]], work.log.imu.gyro_b[rows])


def test_stops_are_frozen_and_motions_are_not(work: Job) -> None:
    nodes = work.nodes
    assert len(intervals(nodes.frozen)) == len(work.segmentation.stops)
    for (a, b), s in zip(intervals(nodes.frozen), work.segmentation.stops, strict=True):
        assert nodes.t[a] == pytest.approx(s.used_start, abs=1e-9)
        assert nodes.t[b] == pytest.approx(s.used_end, abs=1e-9)
    inc, frozen, span = nodes.increments, nodes.frozen, nodes.increments.span
    assert np.array_equal(inc.dq[frozen], np.tile([1.0, 0.0, 0.0, 0.0], (frozen.sum(), 1)))
    assert np.array_equal(inc.Phi[frozen], np.tile(np.eye(6), (frozen.sum(), 1, 1)))
    wanted = np.zeros((frozen.sum(), 6, 6))
    wanted[:, :3, :3] = FROZEN_DENSITY**2 * span[frozen, None, None] * np.eye(3)
    wanted[:, 3:, 3:] = work.noise.n_w * span[frozen, None, None] * np.eye(3)
    assert np.allclose(inc.Q[frozen], wanted, rtol=1e-14)
    assert np.abs(inc.dq[~frozen, 1:]).max() > 1e-3
    run = indirect.run(nodes, work.start)
    moved = rotation.log_quaternion(rotation.multiply(rotation.conjugate(run.q[:-1]), run.q[1:]))
    untouched = frozen & ~np.isin(np.arange(1, len(nodes.t)), nodes.measured)
    assert np.abs(moved[untouched]).max(initial=0.0) < 1e-15


def test_zero_rate_blocks_are_disjoint_and_cover_each_stop(work: Job) -> None:
    nodes, imu = work.nodes, work.log.imu
    blocks = [m for group in nodes.measurements for m in group if m.role == "zero_rate"]
    spans = [(m.t - work.noise.n_r / m.noise[0, 0], m.t) for m in blocks]
    at = 0
    for s in work.segmentation.stops:
        mine = [(span, m) for span, m in zip(spans, blocks, strict=True) if s.used_start < m.t <= s.used_end + 1e-9]
        assert mine[0][0][0] == pytest.approx(s.used_start, abs=1e-6)
        assert mine[-1][0][1] == pytest.approx(s.used_end, abs=1e-6)
        assert all(a[0][1] == pytest.approx(b[0][0], abs=1e-6) for a, b in pairwise(mine))
        for (start, end), m in mine:
            rows = (imu.t > start + 1e-7) & (imu.t <= end + 1e-7)
            assert np.allclose(m.values[0], imu.gyro_b[rows].mean(axis=0), atol=1e-15)
            assert 0.5 * STOP_NODE_S <= end - start <= 2.0 * STOP_NODE_S
        at += len(mine)
    assert at == len(blocks)


def test_without_zero_rate_nothing_is_frozen_and_gravity_comes_every_second() -> None:
    work = simulated(OPTIONS, smoothing={"zero_rate": False}, imu={"accel_bias_sigma": 0.02})
    assert not work.nodes.frozen.any()
    assert np.diff(work.nodes.t).max() <= 0.1 + 1e-9
    flat = [m for group in work.nodes.measurements for m in group]
    assert not any(m.role == "zero_rate" for m in flat)
    for s in work.segmentation.stops:
        gravity = [m for m in flat if m.role == "gravity" and s.used_start <= m.t <= s.used_end]
        assert len(gravity) == int(s.used_end - s.used_start)
        together = 1.0 / sum(
            1.0 / m.noise[0, 0] for m in gravity
        )  # one stop knows no more than the accelerometer's bias
        # stops that the gyro links share one bias: none may know more than it, few may count as one and a half
        assert 0.0199 < np.sqrt(together) * 9.80665 < 0.035


def test_one_gravity_update_per_stop_with_the_accelerometer_bias(work: Job) -> None:
    flat = [m for group in work.nodes.measurements for m in group if m.role == "gravity"]
    assert len(flat) == len(work.segmentation.stops)
    for m, s in zip(flat, work.segmentation.stops, strict=True):
        span = s.used_end - s.used_start
        sigma = np.hypot(work.noise.accel_density / np.sqrt(span), work.settings.imu.accel_bias_sigma) / 9.80665
        assert np.allclose(m.noise, sigma**2 * np.eye(2), rtol=1e-9)
        assert np.linalg.norm(m.values[0]) == pytest.approx(1.0)


def test_the_turn_of_a_group_is_the_gyro_between_its_samples_and_the_node() -> None:
    work = simulated(replace(OPTIONS, compass_hz=50.0))
    groups = [m for g in work.nodes.measurements for m in g if m.role == "compass" and m.turn is not None]
    assert len(groups) > 100
    for m in groups[::50]:
        truth = work.truth(np.array([work.nodes.t[m.node]]))
        near = work.log.fixes["compass"]
        times = near.t[np.argsort(np.abs(near.t - m.t))[: len(m.values)]]
        assert m.turn is not None
        exact = truth.R_nb[0].T @ work.truth(np.sort(times)).R_nb
        error = rotation.log_quaternion(rotation.from_matrix(exact.swapaxes(1, 2) @ m.turn))
        assert np.abs(error).max() < 2e-3  # noise of a sample, and half-way rates instead of every one


def with_hole(log: Log, start: float, end: float) -> Log:
    keep = (log.imu.t <= start) | (log.imu.t >= end)
    imu = Imu(log.imu.t[keep], log.imu.gyro_b[keep], log.imu.accel_b[keep])
    hole = np.array([[imu.t[imu.t <= start][-1], imu.t[imu.t >= end][0]]])
    return replace(log, imu=imu, stamps_ns=log.stamps_ns[keep], gaps=hole)


def test_a_gap_lets_the_attitude_go() -> None:
    whole = simulated(RoverOptions(seed=41, duration_s=90.0, motions=2))
    start, end = whole.drive.timeline.motions[0] + [5.0, -5.0]
    middle = 0.5 * (start + end)
    log = with_hole(whole.log, middle - 2.0, middle + 2.0)
    work = job(log, whole.settings, whole.drive, whole.gyro_bias[np.isin(whole.log.stamps_ns, log.stamps_ns)])
    (first, last) = intervals(work.nodes.gap)[0]
    assert last == first + 1  # one interval, whatever the spacing
    assert work.nodes.t[last] - work.nodes.t[first] == pytest.approx(4.0, abs=0.03)
    run = indirect.run(work.nodes, work.start)
    sigma = np.sqrt(np.einsum("kii->ki", run.chain.P)[:, :3])
    without = indirect.run(whole.nodes, whole.start)
    reference = np.sqrt(np.einsum("kii->ki", without.chain.P)[:, :3]).max(axis=1)
    assert sigma[last].min() > 10 * reference[np.searchsorted(whole.nodes.t, work.nodes.t[last])]
    turned = work.truth(work.nodes.t[[first, last]])
    moved = rotation.log_quaternion(rotation.multiply(rotation.conjugate(turned.q_nb[0]), turned.q_nb[1]))
    assert np.all(np.abs(moved) < 3 * sigma[last])  # what happened in the hole is within what it allows
    assert np.array_equal(run.q[first], run.q[last])  # and nothing was integrated across it


def per_sample(work: Job) -> tuple[Array, Array, Array]:
    """A plain filter, one sample after the other, with the node's own measurements: ``q``, ``bias``, ``P`` at nodes."""
    nodes, steps = work.nodes, work.nodes.steps
    q, bias, P = work.start.q, work.start.bias, work.start.P
    groups = dict(zip(nodes.measured.tolist(), nodes.measurements, strict=True))
    rows: list[tuple[Array, Array, Array]] = []
    for k in range(len(nodes.t)):
        if k and nodes.frozen[k - 1]:
            span = nodes.t[k] - nodes.t[k - 1]
            P = P + np.diag([FROZEN_DENSITY**2 * span] * 3 + [work.noise.n_w * span] * 3)
        elif k:
            for j in range(steps.first[k - 1], steps.first[k]):
                w0, w1, dt = steps.rate0[j] - bias, steps.rate1[j] - bias, steps.dt[j]
                turn = 0.5 * (w0 + w1) * dt + dt**2 / 12 * np.cross(w0, w1)
                q = rotation.multiply(q, rotation.exp_quaternion(turn))
                Phi, Q = transition(0.5 * (w0 + w1)[None], np.array([dt]), nodes.density[k - 1], work.noise.n_w)
                P = Phi[0] @ P @ Phi[0].T + Q[0]
        if k in groups:
            q, bias, P = update(q, bias, P, groups[k])
        rows.append((q, bias, P))
    return tuple(np.array([row[i] for row in rows]) for i in range(3))  # type: ignore[return-value]


def update(q: Array, bias: Array, P: Array, group) -> tuple[Array, Array, Array]:  # type: ignore[no-untyped-def]
    """Iterated update written out: Gauss-Newton on the prior and every measurement, in information form."""
    d, W = np.zeros(6), np.linalg.inv(P)
    for _ in range(8):
        J = np.eye(6)
        J[:3, :3] = rotation.right_jacobian(d[:3])
        A, b = W.copy(), -W @ d
        R_nb = rotation.matrix(rotation.multiply(q, rotation.exp_quaternion(d[:3])))
        for m in group:
            r, H = m.linearise(R_nb, bias + d[3:])
            A += J.T @ H.T @ np.linalg.solve(m.noise, H @ J)
            b += J.T @ H.T @ np.linalg.solve(m.noise, r)
        d = d + np.linalg.solve(A, b)
    J[:3, :3] = rotation.right_jacobian(d[:3])
    return rotation.multiply(q, rotation.exp_quaternion(d[:3])), bias + d[3:], J @ np.linalg.inv(A) @ J.T


def test_node_filter_is_the_per_sample_filter() -> None:
    work = simulated(
        RoverOptions(seed=43, duration_s=60.0, motions=1, compass=True, sun_always=True), compass={"sigma_deg": 3.0}
    )
    run = indirect.run(work.nodes, work.start, gate_probability=1.0)
    q, bias, P = per_sample(work)
    turn = np.abs(rotation.log_quaternion(rotation.multiply(rotation.conjugate(q), run.q))).max()
    sigma = np.sqrt(np.einsum("kii->ki", P))
    drift = np.abs((run.bias - bias) / sigma[:, 3:]).max()
    print(f"node filter against per-sample filter: {turn:.1e} rad, {drift:.1e} sigma of bias")
    assert turn < 1e-8  # the bias Jacobian of a node is exact, that of single steps is of their mean rates
    assert drift < 1e-5
    assert np.abs((run.chain.P - P) / (sigma[:, :, None] * sigma[:, None])).max() < 1e-5


def test_long_motions_of_long_logs_have_coarser_nodes(work: Job) -> None:
    stops = [(s.used_start, s.used_end) for s in work.segmentation.stops]
    epochs = np.array([40.0])
    even, graded = (_grid(work.log.imu.t, stops, stops, [], epochs, 0.1, coarsest) for coarsest in (0.0, 0.5))
    assert len(graded) < 0.6 * len(even)
    must = np.sort(np.concatenate([np.ravel(stops), epochs]))
    assert all(np.abs(graded - e).min() < 1e-6 for e in must)
    middle, width = 0.5 * (graded[1:] + graded[:-1]), np.diff(graded)
    moving = ~_inside(middle, stops)
    away = np.abs(middle[:, None] - must).min(axis=1)
    limit = np.clip(away / NEARNESS, 0.1, 0.5)
    assert np.all(width[moving] <= 1.05 * limit[moving])
    assert np.array_equal(_grid(work.log.imu.t, stops, stops, [], epochs, 0.1, 0.1), even)


def test_coarser_nodes_change_neither_attitude_nor_sigma(monkeypatch: pytest.MonkeyPatch) -> None:
    options = RoverOptions(seed=5, duration_s=240.0, motions=1, rate_hz=50.0)
    found = []
    for least in (10**9, 1):  # nodes at their closest, and as far apart as they may be
        monkeypatch.setattr("attest_cli.nodes.PAGE_NODES", least)
        work = simulated(options)
        smoothed = SMOOTHERS["two-filter"](indirect.run(work.nodes, work.start))
        t, q = work.log.imu.t, full_rate(work.nodes.samples, smoothed)
        variance = np.einsum("kii->ki", world_variance(smoothed.q, smoothed.P))
        at = np.stack([np.interp(t, work.nodes.t, variance[:, i]) for i in range(3)], axis=1)
        found.append((len(work.nodes.t), q, np.sqrt(at)))
    (many, q, sigma), (few, other_q, other_sigma) = found
    assert few < 0.4 * many
    apart = rotation.log_quaternion(rotation.multiply(rotation.conjugate(q), other_q))
    assert np.degrees(np.abs(apart).max()) < 1e-4
    assert np.abs(other_sigma / sigma - 1.0).max() < 0.01
