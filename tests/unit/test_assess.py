"""What a run says about itself: separation, checks per motion, stop advice."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from support.drives import Job, simulated
from support.linear import spd

from attest_cli import assess
from attest_cli.assess import Pass
from attest_cli.filters import indirect
from attest_cli.maths import rotation
from attest_cli.maths.propagation import transition
from attest_cli.records import FilterRun, Segment, Smoothed
from attest_cli.simulate import RoverOptions
from attest_cli.smoothers import SMOOTHERS, backward_estimate

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def work() -> Job:
    return simulated(RoverOptions(seed=91, motions=2, motion_s=(120.0, 150.0)), smoothing={"zero_rate": False})


@pytest.fixture(scope="module")
def run(work: Job) -> FilterRun:
    return indirect.run(work.nodes, work.start)


@pytest.fixture(scope="module")
def smoothed(run: FilterRun) -> Smoothed:
    return SMOOTHERS["two-filter"](run)


def passes(run: FilterRun, smoothed: Smoothed) -> dict[str, Pass]:
    return {
        "forward": Pass(run.q, run.bias, run.chain.P),
        "backward": Pass(*backward_estimate(run)),
        "smoothed": Pass(smoothed.q, smoothed.bias, smoothed.P),
    }


def test_a_pass_turned_is_the_same_pass_in_other_axes(run: FilterRun) -> None:
    p, q_bv = Pass(run.q, run.bias, run.chain.P), rotation.exp_quaternion(np.array([0.3, -0.7, 2.0]))
    sure = np.zeros(3)
    turned = p.turned(q_bv, sure)
    assert np.allclose(turned.sigma_n, p.sigma_n, rtol=1e-9)
    R = rotation.matrix(q_bv)
    assert np.allclose(rotation.matrix(turned.q), rotation.matrix(p.q) @ R, atol=1e-12)
    assert np.allclose(turned.bias @ R.T, p.bias, atol=1e-15)
    back = turned.turned(rotation.conjugate(q_bv), sure)
    assert np.allclose(back.P, p.P, rtol=1e-9, atol=1e-18)
    known = p.turned(q_bv, np.array([0.1, 0.2, 0.3]))
    assert np.allclose((known.P - turned.P)[:, :3, :3], np.diag([0.01, 0.04, 0.09]))


def test_separation_is_forward_minus_backward_about_world_axes(rng: np.random.Generator) -> None:
    q = rotation.normalise(rng.normal(size=(20, 4)))
    apart = 0.01 * rng.normal(size=(20, 3))
    forward = Pass(
        rotation.multiply(rotation.exp_quaternion(apart), q), np.zeros((20, 3)), np.tile(4e-6 * np.eye(6), (20, 1, 1))
    )
    backward = Pass(q, np.zeros((20, 3)), np.tile(5e-6 * np.eye(6), (20, 1, 1)))
    found, sigma = assess.separation(forward, backward)
    assert np.allclose(found, apart, atol=1e-12)
    assert np.allclose(sigma, 3e-3)


def test_passes_of_a_good_drive_agree_where_both_are_equally_sure(
    work: Job, run: FilterRun, smoothed: Smoothed
) -> None:
    p = passes(run, smoothed)
    checks = assess.segment_checks(run.t, p["forward"], p["backward"], work.segmentation)
    assert set(checks) == {s.index for s in work.segmentation.motions}
    for s in work.segmentation.motions:
        when, apart = checks[s.index]
        assert s.start < when < s.end
        assert np.abs(apart).max() < 4.0


def test_a_disturbed_forward_pass_is_told_with_its_axis(work: Job, run: FilterRun, smoothed: Smoothed) -> None:
    p = passes(run, smoothed)
    sigma = p["forward"].sigma_n[:, 2]
    push = rotation.exp_quaternion(np.stack([0 * sigma, 0 * sigma, 8.0 * sigma], axis=1))
    p["forward"] = replace(p["forward"], q=rotation.multiply(push, p["forward"].q))
    rows = assess.segment_table(work.log, work.segmentation, run.t, p, None, work.noise, 2.0, relative=False)
    for row in rows:
        if row["kind"] == "motion":
            assert "z" in row["checks"]
            assert abs(row["separation_z_sigma"]) > 3.0


def test_segment_table_tells_every_segment(work: Job, run: FilterRun, smoothed: Smoothed) -> None:
    rows = assess.segment_table(
        work.log, work.segmentation, run.t, passes(run, smoothed), None, work.noise, 2.0, relative=False
    )
    assert [r["index"] for r in rows] == [1, 2, 3, 4, 5]
    assert [r["kind"] for r in rows] == ["stop", "motion", "stop", "motion", "stop"]
    for row, s in zip(rows, work.segmentation.segments, strict=True):
        assert row["end_ns"] - row["start_ns"] == pytest.approx(1e9 * row["duration_s"], abs=2)
        assert row["sigma_attitude_smoothed_deg"] <= row["sigma_attitude_forward_deg"] * 1.01
        if s.motion:
            assert row["closing_velocity_m_s"] is None
            continue
        mean = np.array([row[f"gyro_mean_{a}_rad_s"] for a in "xyz"])
        true = work.gyro_bias[s.first : s.last].mean(axis=0)
        assert np.abs(mean - true).max() < 4.0 * row["gyro_mean_sigma_x_rad_s"]


@pytest.mark.parametrize("seed", range(4))
def test_drive_sigma_is_the_filters_own_propagation(seed: int) -> None:
    """A drive without turns: the closed form is the covariance recursion."""
    rng = np.random.default_rng(seed)
    scale = np.diag([1e-3] * 3 + [1e-4] * 3)
    P, n_r, n_w = scale @ spd(rng, 6) @ scale, 2.25e-8, 2.5e-11
    t = np.array([0.0, 1.0, 30.0, 300.0])
    Phi, Q = transition(np.zeros((4, 3)), t, n_r, n_w)
    exact = np.sqrt(np.linalg.eigvalsh((Phi @ P @ Phi.swapaxes(1, 2) + Q)[:, :3, :3])[:, -1])
    assert np.allclose(assess.drive_sigma(P, n_r, n_w, t), exact, rtol=1e-9)


def test_stop_advice_of_the_note_after_a_stop_of_ten_seconds() -> None:
    """Its table for zero rate: 47 urad/s after 10 s, 1, 2 and 5 deg of heading after 254, 446 and 886 s."""
    P = np.diag([np.radians(0.2) ** 2] * 3 + [47e-6**2] * 3)
    sigma = np.degrees(assess.drive_sigma(P, 1.5e-4**2, 5e-6**2, np.array([254.0, 446.0, 886.0])))
    assert np.allclose(sigma, [1.0, 2.0, 5.0], rtol=0.05)


def test_advice_comes_when_the_forward_sigma_passes_the_threshold(
    work: Job, run: FilterRun, smoothed: Smoothed
) -> None:
    sigma = np.degrees(Pass(run.q, run.bias, run.chain.P).sigma_n.max(axis=1))
    first = work.segmentation.motions[0]
    middle = sigma[(run.t > first.start) & (run.t < first.end)]
    threshold = float(np.quantile(middle, 0.5))
    advice = assess.stop_advice(run.t, run.moving, passes(run, smoothed), work.segmentation, work.noise, threshold)
    over = run.moving & (sigma > threshold)
    assert len(advice["lines"]) >= 1
    assert advice["axis"] == "heading"
    assert advice["share_over"] == pytest.approx(over.sum() / run.moving.sum(), abs=0.02)
    rows = assess.segment_table(
        work.log, work.segmentation, run.t, passes(run, smoothed), None, work.noise, threshold, relative=False
    )
    after = rows[1]["stop_advised_after_s"]
    assert np.interp(first.start + after, run.t, sigma) == pytest.approx(threshold, rel=0.02)


def test_a_wide_threshold_advises_nothing(work: Job, run: FilterRun, smoothed: Smoothed) -> None:
    advice = assess.stop_advice(run.t, run.moving, passes(run, smoothed), work.segmentation, work.noise, 90.0)
    assert advice["lines"] == []
    assert advice["share_over"] == 0.0
    assert advice["smoothed_below"]
    strict = assess.stop_advice(run.t, run.moving, passes(run, smoothed), work.segmentation, work.noise, 1e-3)
    assert not strict["smoothed_below"]


def test_longest_drive_grows_with_the_threshold_and_needs_a_stop(work: Job, run: FilterRun) -> None:
    forward = Pass(run.q, run.bias, run.chain.P)
    lengths = [
        assess.longest_drive(run.t, forward, work.segmentation, work.noise, np.radians(d)) for d in (0.5, 1.0, 2.0, 5.0)
    ]
    assert all(a < b for a, b in pairwise(lengths))
    no_stops = replace(work.segmentation, segments=work.segmentation.motions)
    assert assess.longest_drive(run.t, forward, no_stops, work.noise, 0.1) is None


def test_a_drive_as_long_as_advised_keeps_its_middle_below_the_threshold(work: Job, run: FilterRun) -> None:
    """Half-way between two stops as good as this log's, both passes equally sure."""
    threshold = np.radians(0.3)
    forward = Pass(run.q, run.bias, run.chain.P)
    length = assess.longest_drive(run.t, forward, work.segmentation, work.noise, threshold)
    assert length is not None
    ends = np.searchsorted(run.t, [s.used_end for s in work.segmentation.stops])
    P = np.median(run.chain.P[np.minimum(ends, len(run.t) - 1)], axis=0)
    half = np.array([0.5 * length])
    Phi, Q = transition(np.zeros((1, 3)), half, work.noise.n_r, work.noise.n_w)
    one_side = (Phi @ P @ Phi.swapaxes(1, 2) + Q)[0, :3, :3]
    middle = np.sqrt(np.linalg.eigvalsh(0.5 * one_side)[-1])
    assert middle == pytest.approx(threshold, rel=0.03)


@pytest.mark.parametrize(("after", "worth"), [(0.4, False), (30.0, True), (58.0, False), (float("nan"), False)])
def test_a_stop_just_after_the_last_or_before_the_next_is_not_advised(after: float, worth: bool) -> None:
    motion = Segment(2, True, 10.0, 70.0, 0, 0, 10.0, 70.0)
    assert assess._worth_a_stop(after, motion) is worth


def test_a_datum_that_all_of_the_log_shares_asks_for_no_stop(work: Job, run: FilterRun, smoothed: Smoothed) -> None:
    datum = np.radians(4.0) ** 2
    seen = passes(run, smoothed)
    up = np.zeros((len(run.t), 6))
    wide = {}
    for name, found in seen.items():
        up[:, :3] = np.sqrt(datum) * rotation.matrix(found.q)[:, 2]
        wide[name] = Pass(found.q, found.bias, found.P + up[:, :, None] * up[:, None, :])
    threshold = 1.1 * float(np.degrees(seen["smoothed"].sigma_n.max()))
    rest = (work.segmentation, work.noise, threshold)
    assert not assess.stop_advice(run.t, run.moving, wide, *rest)["smoothed_below"]
    mended = assess.stop_advice(run.t, run.moving, wide, *rest, np.full(len(run.t), datum))
    assert mended["smoothed_below"]
    assert mended["share_over"] == assess.stop_advice(run.t, run.moving, seen, *rest)["share_over"]
