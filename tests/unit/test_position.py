"""Position: against the analytic truth with the true attitude, its sigma against many drives, its usable flag."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from support.drives import Job, nees, simulated
from support.monte_carlo import band

from attest_cli import position
from attest_cli.filters import indirect
from attest_cli.maths import rotation
from attest_cli.maths.propagation import transition
from attest_cli.position import Position, chain, course, strapdown
from attest_cli.records import Imu, Smoothed
from attest_cli.simulate import RoverOptions
from attest_cli.smoothers import SMOOTHERS
from attest_cli.track import full_rate

Array = NDArray[np.float64]
GRAVITY = 9.80665
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class Drive:
    work: Job
    smoothed: Smoothed
    q: Array

    @property
    def t(self) -> Array:
        return self.work.log.imu.t

    def inertial(self, q: Array | None = None, imu: Imu | None = None, literal: bool = False) -> Position:
        w = self.work
        return position.inertial_position(
            imu or w.log.imu,
            self.q if q is None else q,
            self.smoothed,
            w.segmentation,
            w.settings,
            GRAVITY,
            w.noise.accel_density,
            literal=literal,
        )

    def odometry(self, q_bv: Array = LEVEL) -> Position:
        w = self.work
        return position.odometry_position(
            w.log.imu, self.q, q_bv, self.smoothed, w.segmentation, w.log.fixes["odometry"], w.settings
        )

    def error(self, p: Position, t: Array | None = None) -> Array:
        """Position error at the IMU samples, or at times ``t``."""
        truth = self.work.truth(self.t)
        e = path(p)[0] - (truth.position_n - truth.position_n[0])
        return e if t is None else np.stack([np.interp(t, self.t, e[:, i]) for i in range(3)], axis=1)


def path(p: Position) -> tuple[Array, Array]:
    """Position and velocity at the IMU samples."""
    blocks = list(p.course())
    return np.concatenate([b[0] for b in blocks]), np.concatenate([b[1] for b in blocks])


def drive(**options: object) -> Drive:
    work = simulated(RoverOptions(**options))  # type: ignore[arg-type]
    smoothed = SMOOTHERS["two-filter"](indirect.run(work.nodes, work.start))
    return Drive(work, smoothed, full_rate(work.nodes.samples, smoothed))


@pytest.fixture(scope="module")
def short() -> Drive:
    return drive(seed=300, motions=3, motion_s=(20.0, 40.0), odometry=True)


def test_shaking_in_motion_is_in_sigma(short: Drive) -> None:
    """White noise of 0.2 m/s^2/sqrt(Hz) while the rover moves, a hundred times that at its stops."""
    quiet, imu = short.inertial(), short.work.log.imu
    dt, ends = float(np.median(np.diff(imu.t))), [m.end for m in short.work.segmentation.motions]
    moving = np.any([(imu.t > m.start) & (imu.t < m.end) for m in short.work.segmentation.motions], axis=0)
    at = np.searchsorted(short.smoothed.t, ends) - 1
    ratios = []
    for seed in range(6):
        shaking = 0.2 / np.sqrt(dt) * np.random.default_rng(seed).normal(size=(len(imu.t), 3)) * moving[:, None]
        found = short.inertial(imu=replace(imu, accel_b=imu.accel_b + shaking))
        error = short.error(found, short.smoothed.t)[at]
        ratios += [
            [float(e @ np.linalg.solve(P, e)) for e, P in zip(error, p.P[at], strict=True)] for p in (found, quiet)
        ]
    told, untold = np.array(ratios[0::2]), np.array(ratios[1::2])
    print(f"NEES {told.mean():.1f}, by the noise at rest {untold.mean():.0f}")
    assert 0.5 < told.mean() < 6.0
    assert untold.mean() > 4.0 * told.mean()
    assert strapdown._shaking([]) == 0.0


def test_closing_velocities_that_fit_ask_for_no_shaking() -> None:
    rng, raised = np.random.default_rng(3), 0
    for _ in range(100):
        root = np.tril(rng.normal(0.0, 0.1, (3, 3)))
        closings = [(root @ rng.normal(size=3), root @ root.T, 40.0) for _ in range(4)]
        raised += strapdown._shaking(closings) > 0.0
    assert raised <= 10
    shaken = [(rng.normal(0.0, 0.3 * np.sqrt(40.0), 3), 1e-4 * np.eye(3), 40.0) for _ in range(200)]
    assert strapdown._shaking(shaken) == pytest.approx(0.3, rel=0.1)


@pytest.mark.parametrize(("literal", "limit"), [(False, 1e-4), (True, 1e-2)])
def test_true_attitude_and_force_give_the_true_path(short: Drive, literal: bool, limit: float) -> None:
    """A hundred seconds without sensor errors: strapdown to 0.1 mm, the paper's Euler steps to a centimetre."""
    truth = short.work.truth(short.t)
    found = short.inertial(truth.q_nb, replace(short.work.log.imu, accel_b=truth.force_b), literal)
    known = np.isfinite(path(found)[0][:, 0])
    error = np.abs(short.error(found)[known]).max()
    print(f"literal {literal}: position error {error:.1e} m")
    assert known.mean() > 0.97
    assert error < limit
    assert np.abs(path(found)[1][known] - truth.velocity_n[known]).max() < (
        2e-3 if not literal else 2e-2
    )  # vibration between two samples
    assert found.method == ("literal" if literal else "strapdown")
    length = np.linalg.norm(np.diff(truth.position_n, axis=0), axis=1)
    for s in short.work.segmentation.motions:
        assert found.distance[s.index] == pytest.approx(length[s.first : s.last].sum(), rel=0.01)


def test_strapdown_is_better_than_literal_steps(short: Drive) -> None:
    truth = short.work.truth(short.t)
    clean = replace(short.work.log.imu, accel_b=truth.force_b)
    errors = [np.nanmax(np.abs(short.error(short.inertial(truth.q_nb, clean, literal)))) for literal in (False, True)]
    assert errors[0] < 0.1 * errors[1]


def test_a_stop_holds_position_and_velocity(short: Drive) -> None:
    found = short.inertial()
    for s in short.work.segmentation.stops:
        rows = (short.t > s.used_start + 0.01) & (short.t < s.used_end - 0.01)
        assert np.ptp(path(found)[0][rows], axis=0).max() < 1e-12
        assert not path(found)[1][rows].any()
    assert set(found.closing) == {s.index for s in short.work.segmentation.motions}
    assert all(0.0 < v < 1.0 for v in found.closing.values())


def test_knowing_the_end_at_rest_helps(short: Drive) -> None:
    """The same motions with their closing stop taken away are worse."""
    stops = short.work.segmentation.stops
    segments = short.work.segmentation.segments[:2]
    last = segments[1]
    open_end = replace(
        short, work=replace(short.work, segmentation=replace(short.work.segmentation, segments=segments))
    )
    rows = (short.t > last.start) & (short.t < stops[1].used_start)
    closed, opened = (float(np.sqrt(np.nanmean(d.error(d.inertial())[rows] ** 2))) for d in (short, open_end))
    print(f"first motion: {closed:.2f} m closed, {opened:.2f} m open")
    assert closed < opened
    sigma = [float(np.trace(d.inertial().P[np.searchsorted(d.smoothed.t, last.end) - 5])) for d in (short, open_end)]
    assert sigma[0] < sigma[1]


def test_inertial_sigma_holds() -> None:
    """NEES of the end of one motion over independent drives, in the chi-square band of 99.99 %."""
    found = {False: [], True: []}
    for seed in range(300, 312):
        d = drive(seed=seed, motions=1, motion_s=(20.0, 40.0))
        for literal, rows in found.items():
            p = d.inertial(literal=literal)
            k = np.flatnonzero(np.isfinite(p.P[:, 0, 0]))[-1:]
            rows.append(float(nees(d.error(p, d.smoothed.t[k]), p.P[k])[0]))
    low, high = band(3 * 12)
    for literal, rows in found.items():
        mean = float(np.mean(rows)) / 3
        print(f"literal {literal}: NEES per axis {mean:.2f}, band {low:.2f} to {high:.2f}")
        assert low < mean < high


def test_odometry_is_a_useful_position(short: Drive) -> None:
    found = short.odometry()
    error, total = np.abs(short.error(found)).max(), sum(found.distance.values())
    print(f"odometry: {error:.2f} m over {total:.0f} m")
    assert error < 0.03 * total
    assert found.usable
    assert found.method == "odometry"
    assert np.isfinite(found.P).all()
    assert np.all(np.diff(np.trace(found.P, axis1=1, axis2=2)) > -1e-3)
    assert not found.P[0].any()


def test_odometry_sigma_is_not_too_small() -> None:
    """Slip counts as lasting a second, the simulated noise is white: the sigma may be wide, but must not be narrow."""
    rows = []
    for seed in range(320, 328):
        d = drive(seed=seed, motions=1, motion_s=(60.0, 90.0), rate_hz=50.0, odometry=True)
        p = d.odometry()
        rows.append(float(nees(d.error(p)[-1:], p.P[-1:])[0]))
    mean = float(np.mean(rows)) / 3
    print(f"odometry: NEES per axis {mean:.2f}")
    assert 0.02 < mean < band(3 * 8)[1]


def test_odometry_follows_the_vehicle_not_the_imu(short: Drive) -> None:
    """The IMU turned in the vehicle and the turn given: the same path."""
    q_bv = rotation.exp_quaternion(np.array([0.2, -0.4, 1.2]))
    turned = replace(short, q=rotation.multiply(short.q, rotation.conjugate(q_bv)))
    smoothed = replace(short.smoothed, q=rotation.multiply(short.smoothed.q, rotation.conjugate(q_bv)))
    found, straight = replace(turned, smoothed=smoothed).odometry(q_bv), short.odometry()
    assert np.abs(path(found)[0] - path(straight)[0]).max() < 1e-9


def test_a_speed_without_sides_is_forward_speed(short: Drive) -> None:
    fixes = short.work.log.fixes["odometry"]
    values = fixes.values.copy()
    values[:, 1:] = np.nan
    log = replace(short.work.log, fixes={"odometry": replace(fixes, values=values)})
    found = replace(short, work=replace(short.work, log=log)).odometry()
    values[:, 1:] = 0.0
    log = replace(short.work.log, fixes={"odometry": replace(fixes, values=values)})
    assert np.array_equal(found.p, replace(short, work=replace(short.work, log=log)).odometry().p)


def test_a_long_inertial_drive_says_that_it_is_not_usable() -> None:
    d = drive(seed=301, motions=1, motion_s=(120.0, 150.0), scenario="S2")
    found = d.inertial()
    assert not found.usable
    assert np.sqrt(np.nanmax(found.P[:, 0, 0] + found.P[:, 1, 1])) > 0.1 * sum(found.distance.values())


@pytest.mark.parametrize("how", ["strapdown", "literal", "odometry", "navigation"])
def test_blocks_of_samples_and_nodes_change_nothing(short: Drive, how: str, monkeypatch: pytest.MonkeyPatch) -> None:
    n = len(short.t)
    v = np.cumsum(np.random.default_rng(1).normal(size=(len(short.smoothed.t), 3)), axis=0)
    navigated = replace(short.smoothed, v=v, p=0.1 * v, P_vp=short.smoothed.P)

    def found() -> Position:
        if how == "navigation":
            return position.navigated(short.t, navigated, short.work.segmentation)
        return short.odometry() if how == "odometry" else short.inertial(literal=how == "literal")

    monkeypatch.setattr(course, "BLOCK_ROWS", n)
    monkeypatch.setattr(chain, "BLOCK_NODES", n)
    whole = found()
    course_of_whole = path(whole)
    assert len(list(whole.course())) == 1
    monkeypatch.setattr(course, "BLOCK_ROWS", 777)
    monkeypatch.setattr(chain, "BLOCK_NODES", 100)
    parts = found()
    assert len(list(parts.course())) == -(-n // 777)
    for a, b in zip(course_of_whole, path(parts), strict=True):
        assert np.array_equal(a, b, equal_nan=True)
    assert np.array_equal(whole.p, parts.p, equal_nan=True)
    assert np.allclose(whole.P, parts.P, rtol=1e-12, atol=1e-14, equal_nan=True)
    assert parts.distance == pytest.approx(whole.distance, rel=1e-12)
    inside = np.searchsorted(short.t, short.smoothed.t)
    on = short.t[np.minimum(inside, n - 1)] == short.smoothed.t
    assert np.array_equal(course_of_whole[0][inside[on]], whole.p[on], equal_nan=True)


def test_usable_is_a_tenth_of_the_distance() -> None:
    P = np.zeros((3, 3, 3))
    P[2, 0, 0], P[2, 1, 1], P[2, 2, 2] = 0.36, 0.64, 100.0  # one metre on the ground
    assert course.usable(P, {2: 6.0, 4: 4.001})
    assert not course.usable(P, {2: 6.0, 4: 3.999})
    assert not course.usable(np.full((3, 3, 3), np.nan), {})


@pytest.mark.parametrize(("sigma_m", "usable"), [(0.1, True), (2.0, False)])
def test_a_log_that_never_moves_is_usable_to_a_metre(sigma_m: float, usable: bool) -> None:
    assert course.usable(np.tile(0.5 * sigma_m**2 * np.eye(3), (3, 1, 1)), {}) == usable


def test_a_log_that_starts_in_motion_has_no_inertial_position_before_its_first_stop(short: Drive) -> None:
    segmentation = replace(short.work.segmentation, segments=short.work.segmentation.segments[1:])
    found = replace(short, work=replace(short.work, segmentation=segmentation)).inertial()
    first = segmentation.stops[0]
    assert np.isnan(path(found)[0][short.t < first.start - 0.1]).all()
    after = (short.t > first.start + 0.1) & (short.t < segmentation.stops[-1].used_end - 0.1)
    assert np.isfinite(path(found)[0][after]).all()


def test_the_error_chain_is_the_smoothers_own(short: Drive) -> None:
    """``P`` and lag-one covariances come back from ``F`` and ``W``."""
    errors, s = position.markov(short.smoothed), short.smoothed
    R = rotation.matrix(s.q)
    T = np.zeros((len(s.t), 6, 6))
    T[:, :3, :3], T[:, 3:, 3:] = R, np.eye(3)
    assert np.allclose(errors.P, T @ s.P @ T.swapaxes(1, 2), rtol=1e-9, atol=1e-20)
    again = errors.F @ errors.P[:-1] @ errors.F.swapaxes(1, 2) + errors.W
    sigma = np.sqrt(np.einsum("kii->ki", errors.P))
    assert np.abs((again - errors.P[1:]) / (sigma[1:, :, None] * sigma[1:, None])).max() < 1e-9
    back = errors.P[:-1] @ errors.F.swapaxes(1, 2)
    assert (
        np.abs((back - T[:-1] @ s.cross @ T[1:].swapaxes(1, 2)) / (sigma[:-1, :, None] * sigma[1:, None])).max() < 1e-9
    )
    assert np.linalg.eigvalsh(errors.W / (sigma[1:, :, None] * sigma[1:, None])).min() > -1e-9


def test_the_chain_of_a_forward_pass_turns_with_the_gyro() -> None:
    d = drive(seed=302, motions=1, motion_s=(20.0, 25.0))
    run = indirect.run(d.work.nodes, d.work.start)
    errors = position.markov(SMOOTHERS["none"](run))
    k = int(np.flatnonzero(run.moving)[20])
    R = rotation.matrix(run.q)
    Phi, _ = transition(np.zeros((1, 3)), np.array([run.t[k + 1] - run.t[k]]), 0.0, 0.0)
    assert np.allclose(errors.F[k][:3, :3], np.eye(3), atol=1e-6)  # about world axes an attitude error stays
    assert np.allclose(errors.F[k][:3, 3:], R[k] @ Phi[0][:3, 3:], atol=1e-3)


def test_clipped_or_lost_force_widens_the_place_from_there_on(short: Drive) -> None:
    sure, imu = short.inertial(), short.work.log.imu
    motion = next(s for s in short.work.segmentation.segments if s.motion)
    middle = 0.5 * (motion.start + motion.end)
    spoilt = np.where(np.abs(imu.t - middle) < 0.2, 10.0, 0.0)
    unsure = short.inertial(imu=replace(imu, accel_added=spoilt))
    t, (wide, narrow) = short.smoothed.t, (np.trace(p.P, axis1=1, axis2=2) for p in (unsure, sure))
    end = np.searchsorted(t, motion.end)
    assert wide[end] > 1.5 * narrow[end]
    assert wide[0] == narrow[0]
