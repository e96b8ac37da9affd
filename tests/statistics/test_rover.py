"""Rover drives against their truth: a small set of what ``benchmarks/accuracy/rover.py`` runs on fifty."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from support.drives import Job, Score, in_motion, mrad, nees, pooled, score, simulated, wrong_start
from support.monte_carlo import band

from attest_cli import estimate
from attest_cli.filters import indirect
from attest_cli.records import FilterRun, Smoothed
from attest_cli.simulate import RoverOptions
from attest_cli.simulate.rover import GYRO_WALK
from attest_cli.smoothers import SMOOTHERS, gauss_newton

Array = NDArray[np.float64]
pytestmark = pytest.mark.slow
DRIVES = range(1000, 1012)  # of S1, whose drives are twice as long, eight
Z = 3.89  # normal deviate of 99.99 %
SPREAD = {"S1": 1.7, "S2": 2.6}  # of one drive's mean NEES, measured over the fifty drives of the benchmark


@dataclass(frozen=True)
class Drive:
    """One drive with every pass over it."""

    work: Job
    forward: FilterRun
    smoothed: Smoothed
    paper: Smoothed | None

    def score(self, which: FilterRun | Smoothed) -> Score:
        P = which.chain.P if isinstance(which, FilterRun) else which.P
        return score(self.work, which.t, which.q, which.bias, P)


def drive(scenario: str, seed: int, with_paper: bool = False, **imu: float) -> Drive:
    if scenario == "S1":
        work = simulated(RoverOptions(seed=seed), smoothing={"zero_rate": False}, imu=imu)
    else:
        work = simulated(RoverOptions(seed=seed, scenario="S2", motion_s=(60.0, 120.0)), imu=imu)
    forward = indirect.run(work.nodes, work.start)
    return Drive(work, forward, SMOOTHERS["two-filter"](forward), SMOOTHERS["paper"](forward) if with_paper else None)


@pytest.fixture(scope="module")
def s1() -> list[Drive]:
    return [drive("S1", seed) for seed in DRIVES[:8]]


@pytest.fixture(scope="module")
def s2() -> list[Drive]:
    return [drive("S2", seed, with_paper=True) for seed in DRIVES]


@pytest.fixture(params=["S1", "S2"])
def drives(request: pytest.FixtureRequest) -> tuple[str, list[Drive]]:
    return request.param, request.getfixturevalue(request.param.lower())


def test_smoothed_attitude_is_within_four_mrad(drives: tuple[str, list[Drive]]) -> None:
    name, runs = drives
    smoothed = pooled([d.score(d.smoothed) for d in runs])
    print(f"{name}: smoothed attitude {mrad(smoothed.attitude):.2f} mrad RMS over {len(runs)} drives")
    assert mrad(smoothed.attitude) <= 4.0


def test_smoothing_pays_most_in_the_middle_of_a_motion(drives: tuple[str, list[Drive]]) -> None:
    name, runs = drives
    ahead, smoothed = (
        pooled([d.score(which(d)) for d in runs]) for which in (lambda d: d.forward, lambda d: d.smoothed)
    )
    ratio = np.sqrt(ahead.middle / smoothed.middle)
    print(f"{name}: forward over smoothed in the middle third {ratio:.1f}")
    assert ratio >= (5.0 if name == "S1" else 1.2)


def test_mean_nees_is_what_the_sigmas_promise(drives: tuple[str, list[Drive]]) -> None:
    name, runs = drives
    low, high = {"S1": (5.4, 6.8), "S2": (5.0, 7.5)}[name]
    margin = Z * SPREAD[name] / np.sqrt(len(runs))
    mean = pooled([d.score(d.smoothed) for d in runs]).nees
    print(f"{name}: NEES of attitude and bias {mean:.2f}; 50 drives {low} to {high}, {len(runs)} drives +-{margin:.1f}")
    assert min(low, 6.0 - margin) < mean < max(high, 6.0 + margin)


def epochs(d: Drive, which: FilterRun | Smoothed) -> float:
    """NEES at one epoch of a drive, the middle of its first motion."""
    t = d.work.drive.timeline.motions[0].mean() - d.work.origin
    k = np.array([int(np.argmin(np.abs(which.t - t)))])
    P = which.chain.P if isinstance(which, FilterRun) else which.P
    return float(nees(d.work.errors(which.t[k], which.q[k], which.bias[k]), P[k])[0])


def test_nees_of_one_epoch_per_drive_follows_chi_square(drives: tuple[str, list[Drive]]) -> None:
    """Drives are independent, so the sum over them is chi-square with six degrees each."""
    name, runs = drives
    low, high = band(6 * len(runs))
    for which in ("forward", "smoothed"):
        mean = float(np.mean([epochs(d, getattr(d, which)) for d in runs])) / 6
        print(f"{name} {which}: NEES per state {mean:.2f}, band {low:.2f} to {high:.2f}")
        assert low < mean < high


def test_innovations_follow_chi_square(drives: tuple[str, list[Drive]]) -> None:
    name, runs = drives
    sun = [d.forward.innovations for d in runs]
    values = np.concatenate([i.nis[i.role == "sun"] for i in sun])
    low, high = band(2 * len(values))
    print(f"{name}: mean NIS of the sun per degree {values.mean() / 2:.3f}, band {low:.3f} to {high:.3f}")
    assert low < values.mean() / 2 < high
    assert np.mean(np.concatenate([i.used for i in sun])) > 0.995


def test_the_exact_smoother_is_no_worse_than_the_paper(s2: list[Drive]) -> None:
    exact, literal = pooled([d.score(d.smoothed) for d in s2]), pooled([d.score(d.paper) for d in s2 if d.paper])
    print(f"exact {mrad(exact.attitude):.3f} mrad, paper {mrad(literal.attitude):.3f} mrad over {len(s2)} drives")
    assert exact.attitude <= literal.attitude


def told_wrong(work: Job, what: str, factor: float) -> Drive:
    """Run a drive with every ``Q``, or every ``R``, ``factor`` times what it should be."""
    nodes = work.nodes
    if what == "Q":
        nodes = replace(nodes, increments=replace(nodes.increments, Q=factor * nodes.increments.Q))
    else:
        groups = tuple(tuple(replace(m, noise=factor * m.noise) for m in group) for group in nodes.measurements)
        nodes = replace(nodes, measurements=groups)
    forward = indirect.run(nodes, work.start, gate_probability=1.0)
    return Drive(work, forward, SMOOTHERS["two-filter"](forward), None)


@pytest.mark.parametrize("factor", [0.25, 4.0])
def test_the_nees_band_breaks_when_process_noise_is_wrong(s1: list[Drive], factor: float) -> None:
    """The test of the tests above."""
    wrong = [told_wrong(d.work, "Q", factor) for d in s1]
    low, high = band(6 * len(wrong))
    mean = float(np.mean([epochs(d, d.smoothed) for d in wrong])) / 6
    print(f"Q x {factor}: NEES per state {mean:.2f}, band {low:.2f} to {high:.2f}")
    assert not low < mean < high


@pytest.mark.parametrize("factor", [0.25, 4.0])
def test_the_nis_band_breaks_when_measurement_noise_is_wrong(s2: list[Drive], factor: float) -> None:
    found = [told_wrong(d.work, "R", factor).forward.innovations for d in s2[:4]]
    nis = np.concatenate([i.nis[i.role == "sun"] for i in found])
    low, high = band(2 * len(nis))
    print(f"R x {factor}: mean NIS per degree {nis.mean() / 2:.2f}, band {low:.2f} to {high:.2f}")
    assert not low < nis.mean() / 2 < high


def test_the_paper_counts_the_past_twice_in_steady_state() -> None:
    """Seven motions of 20 s, a bias that hardly walks: the paper's sigma of it tends to 1/sqrt(2) of the exact one."""
    paper_sigma, exact_sigma, errors = [], [], []
    for seed in range(3000, 3004):
        options = RoverOptions(seed=seed, motions=7, motion_s=(20.0, 20.0))
        work = simulated(options, walk=0.04, smoothing={"zero_rate": False}, imu={"gyro_random_walk": 0.04 * GYRO_WALK})
        forward = indirect.run(work.nodes, work.start)
        last = (forward.t > work.drive.timeline.motions[5, 0]) & forward.moving
        for rows, name in ((paper_sigma, "paper"), (exact_sigma, "two-filter")):
            found = SMOOTHERS[name](forward)
            rows.append(np.einsum("kii->ki", found.P[last])[:, 3:].mean())
        errors.append(found.bias[last].mean(axis=0) - work.gyro_bias[0])
    ratio = float(np.sqrt(np.mean(paper_sigma) / np.mean(exact_sigma)))
    sigma = float(np.sqrt(np.mean(exact_sigma)))
    low, high = band(3 * len(errors))
    share = float(np.mean(np.square(errors))) / sigma**2
    print(f"bias sigma: paper {ratio:.2f} of the exact {1e6 * sigma:.1f} urad/s; squared error {share:.2f} of that")
    assert 0.65 < ratio < 0.85
    assert low < share < high  # the exact sigma is the one that holds
    assert share > ratio**2


def start_in_motion(seed: int) -> tuple[Job, Smoothed]:
    """A log that begins in motion with its yaw 170 deg wrong; no gates, for a gate would trust the start."""
    work = in_motion(RoverOptions(seed=seed))
    start = wrong_start(work, 170.0, np.random.default_rng([seed, 170]))
    forward = indirect.run(work.nodes, start, gate_probability=1.0)
    smoothed = SMOOTHERS["two-filter"](forward)
    return work, gauss_newton.refine(work.nodes.rebuild(smoothed.bias), start, smoothed, None, 6)


def test_gauss_newton_comes_home_from_a_yaw_170_degrees_wrong() -> None:
    found = []
    for seed in DRIVES[:4]:
        work, smoothed = start_in_motion(seed)
        found.append(score(work, smoothed.t, smoothed.q, smoothed.bias, smoothed.P))
    print(
        "start in motion, mrad:", [round(mrad(s.attitude), 2) for s in found], "NEES", [round(s.nees, 1) for s in found]
    )
    assert mrad(pooled(found).attitude) <= 8.0
    assert pooled(found).nees < 6.0 + Z * SPREAD["S1"] / np.sqrt(len(found))


def test_a_log_that_starts_in_motion_as_attest_runs_it() -> None:
    found = []
    for seed in DRIVES[:4]:
        work = in_motion(RoverOptions(seed=seed))
        forward = indirect.run(work.nodes, work.start)
        assert forward.start_in_motion
        smoothed = estimate.smooth_run(work.nodes, work.start, forward, work.settings)
        assert smoothed.passes >= 1
        found.append(score(work, smoothed.t, smoothed.q, smoothed.bias, smoothed.P))
    print("attest's own start in motion, mrad:", [round(mrad(s.attitude), 2) for s in found])
    assert mrad(pooled(found).attitude) <= 8.0
    assert pooled(found).nees < 6.0 + Z * SPREAD["S1"] / np.sqrt(len(found))
