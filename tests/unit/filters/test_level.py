"""Attitude and heading read off the vertical, and the samples that the filters of the vertical are given."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2
from support.still import vectors

from attest_cli.filters import Drive
from attest_cli.filters.level import DATUM, Level, carried, upright
from attest_cli.filters.samples import Samples, rotation_vectors, samples
from attest_cli.filters.vertical import up
from attest_cli.maths import rotation
from attest_cli.maths.kalman import Errors
from attest_cli.nodes.noise import find_noise
from attest_cli.prepare import prepare
from attest_cli.records import World
from attest_cli.segment import find_segments
from attest_cli.settings import Settings
from attest_cli.simulate import WalkingOptions, simulate_walking

Array = NDArray[np.float64]
T = 0.01
OUTSIDE = 1e-4  # share of good runs that a statistical limit refuses


def tumbling(n: int, seed: int = 5) -> tuple[Array, Array]:
    """Turns (n - 1, 3) of a body that turns over and over, and its attitudes (n, 4), heading 0 at the start."""
    t = T * np.arange(n - 1)
    rate = np.stack([1.7 * np.sin(0.9 * t + seed), 1.3 * np.cos(1.4 * t), 0.8 + 0.6 * np.sin(0.5 * t)], axis=1)
    q = np.concatenate([[[1.0, 0.0, 0.0, 0.0]], rotation.chain(rotation.exp_quaternion(rate * T))])
    return rate * T, q


def up_of(q: Array) -> Array:
    return np.asarray(rotation.matrix(q)[:, 2])


def at_rest(n: int, density: float = 0.0, bias_sigma: float = 0.0, still: Array | None = None) -> Samples:
    """Samples of a level body that does not turn."""
    zero = np.zeros((n, 3))
    return Samples(
        t=T * np.arange(n), dt=np.full(n - 1, T), turn_b=zero[1:], rate_b=zero,
        force_b=np.tile([0.0, 0.0, 9.8], (n, 1)),
        bias_b=zero, bias_sigma=bias_sigma, still=np.zeros(n, dtype=np.bool_) if still is None else still > 0,
        gap=np.zeros(n - 1, dtype=np.bool_), density=np.full(n - 1, density),
    )  # fmt: skip


@pytest.mark.parametrize("turned_over", [False, True])
def test_carried_is_the_gyros_integral_where_both_agree_on_up(turned_over: bool) -> None:
    turns, q = tumbling(1500)
    if turned_over:  # starts within a degree of upside down, the only place where the smallest turn is not unique
        q = rotation.multiply(rotation.exp_quaternion(np.array([np.radians(179.5), 0.0, 0.0])), q)
    found = carried(turns, up_of(q), np.zeros(len(turns), dtype=np.bool_))
    apart = rotation.multiply(q, rotation.conjugate(found))  # a turn about the vertical: the heading at the start
    assert np.abs(up_of(q) - up_of(found)).max() < 1e-12
    turn = rotation.log_quaternion(apart)
    assert np.abs(rotation.log_quaternion(rotation.multiply(apart, rotation.conjugate(apart[:1])))).max() < 1e-9
    assert np.abs(turn[:, :2]).max() < 1e-9


def test_carried_is_a_sample_by_sample_loop() -> None:
    rng = np.random.default_rng(3)
    turns, q = tumbling(400)
    wanted = up_of(q) + rng.normal(0.0, 0.05, (400, 3))  # a vertical that does not follow the gyro
    wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
    held = np.zeros(399, dtype=np.bool_)
    held[100:150] = True
    now = upright(wanted[:1])[0]
    loop = [now]
    for k, turn in enumerate(turns):
        tilt = upright(wanted[k + 1 : k + 2])[0]
        moved = rotation.multiply(now, rotation.exp_quaternion(turn))
        righted = rotation.multiply(upright(rotation.rotate(moved, wanted[k + 1])[None])[0], moved)
        w, _, _, z = rotation.multiply(righted, rotation.conjugate(tilt))
        if held[k]:  # the heading stays
            w, _, _, z = rotation.multiply(now, rotation.conjugate(upright(wanted[k : k + 1])[0]))
        now = rotation.normalise(rotation.multiply(np.array([w, 0.0, 0.0, z]), tilt))
        loop.append(now)
    found = carried(turns, wanted, held)
    apart = rotation.log_quaternion(rotation.multiply(rotation.conjugate(np.array(loop)), found))
    assert np.abs(apart).max() < 1e-10
    assert np.abs(up_of(found) - wanted).max() < 1e-12


def test_upright_is_the_smallest_turn_and_knows_upside_down() -> None:
    v = np.array([[0.0, 0.6, 0.8], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    q = upright(v)
    assert np.abs(rotation.rotate(q, v) - [0.0, 0.0, 1.0]).max() < 1e-12
    angle = np.linalg.norm(rotation.log_quaternion(q), axis=1)
    assert angle == pytest.approx(np.arccos(v[:, 2]))


@pytest.mark.parametrize("states", [3, 6])
def test_jacobian_of_the_tilt_by_finite_differences(states: int) -> None:
    rng = np.random.default_rng(8)
    s, x = at_rest(1), np.zeros((1, states))
    x[0, :3] = 1.03 * np.array([0.3, -0.5, 0.81])  # the pseudo-linear state is no unit vector
    level = Level(s, x, up, np.eye(3, states, states - 3) if states == 6 else np.zeros((3, 3)), np.zeros(0, np.bool_))
    P = rng.normal(size=(states, states))
    P = P @ P.T
    none = np.zeros((0, states, states))
    found = level(Errors(np.zeros((1, states)), P[None], none))
    u = up_of(found.q)[0]
    step, columns = 1e-6, []
    for i in range(3):
        moved = [upright(up(x + sign * step * np.eye(states)[i])[0])[0] for sign in (1.0, -1.0)]
        turn = rotation.log_quaternion(rotation.multiply(rotation.conjugate(moved[1]), moved[0])) / (2 * step)
        columns.append(turn - u * (u @ turn))  # across the vertical: the heading is the gyro's
    J = np.zeros((3, states))
    J[:, :3] = np.array(columns).T
    across = np.eye(3) - np.outer(u, u)
    tilt = across @ found.P[0, :3, :3] @ across
    assert np.abs(tilt - J @ P @ J.T).max() < 1e-7 * np.abs(P).max()
    assert found.P[0, 2, 2] >= 0.0
    if states == 6:
        assert np.abs(found.P[0, 3:, 3:] - P[3:, 3:]).max() < 1e-12
        assert np.abs(across @ found.P[0, :3, 3:] - J @ P[:, 3:]).max() < 1e-7 * np.abs(P).max()


def test_tilt_of_the_accelerometers_bias_is_in_every_pass_and_lag_in_the_one_sided_only() -> None:
    s, n = at_rest(3), 3
    x, bias = np.tile([0.0, 0.0, 1.0], (n, 1)), np.zeros((3, 3))
    errors = Errors(np.full((n, 3), 1e-9), np.tile(1e-6 * np.eye(3), (n, 1, 1)), np.full((n - 1, 3, 3), 1e-9))
    plain = Level(s, x, up, bias, np.zeros(2, np.bool_))
    more = Level(s, x, up, bias, np.zeros(2, np.bool_), tilt=2e-3, lag=3e-3)
    assert np.diff([plain(errors).P[1, 0, 0], more(errors).P[1, 0, 0]]) == pytest.approx(4e-6)
    assert np.diff([plain(errors).cross[0, 0, 0], more(errors).cross[0, 0, 0]]) == pytest.approx(4e-6)
    assert np.diff([plain(errors).P[1, 2, 2], more(errors).P[1, 2, 2]]) == pytest.approx(0.0, abs=1e-15)
    for one_sided in (replace(errors, d=0 * errors.d), replace(errors, cross=0 * errors.cross)):
        assert np.diff([plain(one_sided).P[1, 0, 0], more(one_sided).P[1, 0, 0]]) == pytest.approx(13e-6)


def headings(
    rng: np.random.Generator, runs: int, still: Array, density: float, bias_sigma: float
) -> tuple[Array, Array, Array]:
    """Errors (runs, n) of headings carried by noisy, biased gyros past stops, their told variance (n,) and lag-one
    covariance (n - 1,). The bias is drawn from stop to stop, as it is removed.
    """
    n = len(still)
    inside = still > 0
    s = at_rest(n, density, bias_sigma, still)
    held = inside[1:] & inside[:-1]
    tilted = np.tile(np.array([0.6, 0.0, 0.8]), (n, 1))
    level = Level(s, tilted, up, np.zeros((3, 3)), held)
    first = np.flatnonzero(np.diff(inside.astype(int), prepend=0) == 1)
    last = np.flatnonzero(np.diff(inside.astype(int), append=0) == -1)
    middle = 0.5 * (first + last)
    told = level(Errors(np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((n - 1, 3, 3))))
    e = np.empty((runs, n))
    for i in range(runs):
        means = rng.normal(0.0, bias_sigma, (len(middle), 3))
        bias = np.stack([np.interp(np.arange(n), middle, means[:, j]) for j in range(3)], axis=1)
        noise = rng.normal(0.0, np.sqrt(density / T), (n - 1, 3))
        turn = (0.5 * (bias[1:] + bias[:-1]) + noise) * T
        q = carried(np.where(held[:, None], 0.0, turn), tilted, held)
        spun = rotation.multiply(q, rotation.conjugate(q[:1]))
        e[i] = 2.0 * np.arctan2(spun[:, 3], spun[:, 0])
    u = tilted[0]
    variance = np.einsum("i,kij,j->k", u, told.P[:, :3, :3], u) - DATUM**2
    return e, variance, np.einsum("i,kij,j->k", u, told.cross[:, :3, :3], u) - DATUM**2


@pytest.mark.parametrize("wrong", [1.0, 4.0])
def test_heading_sigma_by_monte_carlo(wrong: float) -> None:
    runs = 300
    stops = np.zeros(1200)
    stops[:200] = 1
    e, variance, covariance = headings(np.random.default_rng(12), runs, stops, 4e-5, 0.01)
    k = 1100
    low, high = chi2.ppf([OUTSIDE / 2, 1 - OUTSIDE / 2], runs) / runs
    ratio = wrong * float(np.mean(e[:, k] ** 2)) / variance[k]
    print(f"heading: {ratio:.3f}, band {low:.3f} to {high:.3f}")
    assert (low < ratio < high) == (wrong == 1.0)  # the limit sees a variance that is wrong by four
    lagged = float(np.mean(e[:, k] * e[:, k + 1])) / covariance[k]
    assert low < lagged < high


def test_headings_past_several_stops_grow_like_independent_errors() -> None:
    """Linear from stop to stop, so neighbours share an error: half of the square of each span, and no more."""
    runs, n = 300, 2400
    stops = (np.arange(n) % 400 < 100).astype(float)
    e, variance, _ = headings(np.random.default_rng(13), runs, stops, 1e-9, 0.01)
    k = n - 1
    ratio = float(np.mean(e[:, k] ** 2)) / variance[k]
    low, high = chi2.ppf([OUTSIDE / 2, 1 - OUTSIDE / 2], runs) / runs
    print(f"past six stops: {ratio:.3f}")
    assert 0.75 * low < ratio < high  # the last error counts in full, the first by half: told somewhat too much


def test_a_gap_makes_the_heading_unknown() -> None:
    s = at_rest(50)
    s.gap[20] = True
    level = Level(s, np.tile([0.0, 0.0, 1.0], (50, 1)), up, np.zeros((3, 3)), np.zeros(49, np.bool_))
    P = level(Errors(np.zeros((50, 3)), np.zeros((50, 3, 3)), np.zeros((49, 3, 3)))).P
    assert np.sqrt(P[20, 2, 2]) < 1e-3
    assert np.sqrt(P[21, 2, 2]) == pytest.approx(np.pi / np.sqrt(3.0), rel=1e-3)  # uniform on the circle


# ---------------------------------------------------------------------------------------------------------- samples


def test_rotation_vectors_are_edwards_exactly_unit_update() -> None:
    v = vectors("edwards")
    for i in range(len(v["q0"])):
        phi = rotation_vectors(np.stack([v["a_prev"][i], v["a"][i]]), np.array([False, True]))
        q = rotation.multiply(v["q0"][i], rotation.exp_quaternion(phi[1]))
        assert np.abs(q - v["rotvec"][i]).max() < 1e-13
        assert np.abs(phi[0] - v["a_prev"][i]).max() == 0.0  # nothing before it: no coning term


def walking(**over: dict[str, object]) -> tuple[Drive, Array]:
    """A short stop-and-go walk and its true gyro bias (n, 3)."""
    simulation = simulate_walking(WalkingOptions(seed=4, case="B", bias_deg_s=0.3, duration_s=45.0))
    tables = {name: dict(table) for name, table in simulation.settings.items()}
    for name, table in over.items():
        tables[name] = {**tables.get(name, {}), **table}
    settings = Settings.model_validate(tables)
    log = prepare([simulation.log], settings)
    segmentation = find_segments(log, settings)
    drive = Drive(log, segmentation, World(9.80665), find_noise(log, segmentation, settings), settings)
    return drive, np.stack([simulation.truth[f"gyro_bias_{a}_rad_s"] for a in "xyz"], axis=1)


def test_samples_have_the_bias_of_the_stops_removed_and_say_how_well() -> None:
    drive, bias = walking()
    s = samples(drive)
    stops = drive.segmentation.stops
    assert s.still.sum() > 2000
    assert not s.gap.any()
    off = (s.bias_b - bias)[s.still]
    ratio = float(np.mean(off**2)) / s.bias_sigma**2
    print(f"{len(stops)} stops, bias known to {np.degrees(s.bias_sigma):.4f} deg/s, error/sigma {np.sqrt(ratio):.2f}")
    low, high = chi2.ppf([OUTSIDE / 2, 1 - OUTSIDE / 2], 3 * len(stops)) / (3 * len(stops))
    assert low < ratio < high
    assert np.abs(s.rate_b + s.bias_b - drive.log.imu.gyro_b).max() < 1e-15


def test_the_turn_of_a_sample_is_the_trapezoid_or_the_interval_as_stated() -> None:
    drive, _ = walking()
    s = samples(drive)
    alpha = 0.5 * (s.rate_b[1:] + s.rate_b[:-1]) * s.dt[:, None]
    assert np.abs(s.turn_b - alpha).max() < 1e-5  # but for the coning term
    assert np.abs(s.turn_b - alpha).max() > 1e-9
    interval, _ = walking(imu={"gyro_samples": "interval"})
    held = samples(interval)
    assert np.abs(held.turn_b - held.rate_b[1:] * held.dt[:, None]).max() < 1e-5


def test_a_hole_turns_by_nothing_known_and_shares_no_coning_term() -> None:
    drive, _ = walking()
    t = drive.log.imu.t
    keep = (t < 20.0) | (t > 22.0)
    imu = replace(drive.log.imu, t=t[keep], gyro_b=drive.log.imu.gyro_b[keep], accel_b=drive.log.imu.accel_b[keep])
    k = int(np.sum(t < 20.0)) - 1
    log = replace(drive.log, imu=imu, gaps=np.array([[imu.t[k], imu.t[k + 1]]]))
    s = samples(replace(drive, log=log))
    assert np.flatnonzero(s.gap).tolist() == [k]
    assert not s.turn_b[k].any()
    alpha = 0.5 * (s.rate_b[1:] + s.rate_b[:-1]) * s.dt[:, None]
    assert np.abs(s.turn_b - alpha)[k + 1].max() == 0.0


def test_vibration_is_no_noise_of_the_gyros_scale() -> None:
    """A scale error counts where the rate lasts: the mean rate over a second, as at the nodes."""
    drive, _ = walking()
    imu = drive.log.imu
    shaken = imu.gyro_b + np.where(np.arange(len(imu.t)) % 2, 2.0, -2.0)[:, None]
    noise = replace(drive.noise, gyro_scale=0.01)
    quiet = samples(replace(drive, noise=noise)).density
    loud = samples(replace(drive, noise=noise, log=replace(drive.log, imu=replace(imu, gyro_b=shaken)))).density
    assert quiet.max() > 1.001 * noise.n_r
    assert np.median(loud / quiet) == pytest.approx(1.0, abs=0.05)
