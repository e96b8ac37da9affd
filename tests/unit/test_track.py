"""Full rate: through the smoothed nodes, along the gyro between them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from support.drives import Job, degrees_apart, simulated

from attest_cli import track
from attest_cli.filters import indirect
from attest_cli.maths import rotation
from attest_cli.records import Smoothed
from attest_cli.simulate import RoverOptions
from attest_cli.smoothers import SMOOTHERS
from attest_cli.track import full_rate, world_variance

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def work() -> Job:
    return simulated(RoverOptions(seed=71, duration_s=120.0, motions=2))


@pytest.fixture(scope="module")
def smoothed(work: Job) -> Smoothed:
    return SMOOTHERS["two-filter"](indirect.run(work.nodes, work.start))


def test_the_track_goes_through_the_nodes(work: Job, smoothed: Smoothed) -> None:
    t = work.log.imu.t
    found = full_rate(work.nodes.samples, smoothed)
    at = np.clip(np.searchsorted(t, smoothed.t - 1e-6), 0, len(t) - 1)
    same = np.abs(t[at] - smoothed.t) < 1e-6
    assert same.sum() > 20
    assert degrees_apart(found[at[same]], smoothed.q[same]) < 1e-9


def test_full_rate_is_as_good_as_the_nodes(work: Job, smoothed: Smoothed) -> None:
    t = work.log.imu.t
    found = full_rate(work.nodes.samples, smoothed)
    error = np.linalg.norm(work.errors(t, found, np.zeros((len(t), 3)))[:, :3], axis=1)
    at_nodes = np.linalg.norm(work.errors(smoothed.t, smoothed.q, smoothed.bias)[:, :3], axis=1)
    moving, moving_nodes = work.truth(t).moving, work.truth(smoothed.t).moving
    rms = [1e3 * float(np.sqrt(np.mean(e**2))) for e in (error[moving], at_nodes[moving_nodes])]
    print(f"full rate {rms[0]:.3f} mrad, nodes {rms[1]:.3f} mrad")
    assert rms[0] < 1.02 * rms[1]


def test_without_a_correction_the_track_is_the_gyros(work: Job) -> None:
    """True nodes and bias: what is left between nodes is the gyro's noise of one interval."""
    t = work.log.imu.t
    k = work.truth(work.nodes.t)
    bias = np.stack([np.interp(k.t - work.origin, t, work.gyro_bias[:, i]) for i in range(3)], axis=1)
    n = len(k.t)
    exact = Smoothed(work.nodes.t, k.q_nb, bias, np.tile(1e-12 * np.eye(6), (n, 1, 1)), np.zeros((n - 1, 6, 6)))
    found = full_rate(work.nodes.samples, exact)
    moving = work.truth(t).moving
    error = np.linalg.norm(work.errors(t, found, np.zeros((len(t), 3)))[:, :3], axis=1)[moving]
    assert np.sqrt(np.mean(error**2)) < 2.0 * work.noise.gyro_density * np.sqrt(3 * 0.1)


def test_the_defect_of_an_interval_is_spread_over_it(work: Job, smoothed: Smoothed) -> None:
    """One node pulled away by 1 mrad: its two intervals bend towards it, all others stay."""
    moving = np.flatnonzero(smoothed.t > work.drive.timeline.motions[0, 0] + 5.0)
    k = int(moving[np.argmax(~np.isin(moving, work.nodes.measured))])
    q = smoothed.q.copy()
    q[k] = rotation.multiply(q[k], rotation.exp_quaternion(np.array([1e-3, 0.0, 0.0])))
    t = work.log.imu.t
    before, after = full_rate(work.nodes.samples, smoothed), full_rate(work.nodes.samples, replace(smoothed, q=q))
    moved = np.linalg.norm(rotation.log_quaternion(rotation.multiply(rotation.conjugate(before), after)), axis=1)
    a, b, c = smoothed.t[k - 1 : k + 2]
    outside = (t < a - 1e-9) | (t > c + 1e-9)
    assert moved[outside].max() < 1e-12
    inside = (t > a) & (t < c)
    expected = 1e-3 * np.where(t < b, (t - a) / (b - a), (c - t) / (c - b))
    assert np.allclose(moved[inside], expected[inside], atol=2e-6)
    assert inside.sum() > 10


def test_signs_are_continuous_and_norms_one(work: Job, smoothed: Smoothed) -> None:
    found = full_rate(work.nodes.samples, smoothed)
    assert found.shape == (len(work.log.imu.t), 4)
    assert np.all(np.sum(found[1:] * found[:-1], axis=1) > 0)
    assert np.abs(np.linalg.norm(found, axis=1) - 1.0).max() < 1e-12


def test_blocks_change_nothing(work: Job, smoothed: Smoothed, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = full_rate(work.nodes.samples, smoothed)
    monkeypatch.setattr(track, "BLOCK_ROWS", 777)
    assert np.allclose(full_rate(work.nodes.samples, smoothed), whole, rtol=0, atol=1e-15)


def test_world_variance_turns_the_covariance(rng: np.random.Generator) -> None:
    q = rotation.normalise(rng.normal(size=(5, 4)))
    P = np.zeros((5, 6, 6))
    P[:, :3, :3] = np.diag([1.0, 4.0, 9.0])
    found = world_variance(q, P)
    assert np.allclose(np.linalg.eigvalsh(found), [1.0, 4.0, 9.0])
    R = rotation.matrix(q)
    assert np.allclose(np.einsum("kij,kj->ki", found, R[:, :, 2]), 9.0 * R[:, :, 2])
