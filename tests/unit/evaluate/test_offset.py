"""The time offset: found within its sigma, from turns or moves, whatever the axes; not made up where there is none."""

from __future__ import annotations

import numpy as np
import pytest
from support.tracks import Motion, noisy, random_rotation, turned

from attest_cli.evaluate.offset import SEARCH_S, Track, fit_offset
from attest_cli.maths import rotation

T_EST, T_REF = np.arange(0.0, 60.0, 0.01), np.arange(0.003, 59.0, 0.011)
FAR = 3.9  # sigma: 99.99 % of Gaussian errors are nearer
DRAWS = 20


def drawn(seed: int, offset: float, sigma: float = 1e-3) -> tuple[Track, Track]:
    """An estimate whose stamps need ``offset`` added, and a noisy reference in other axes on both sides."""
    rng = np.random.default_rng(seed)
    motion = Motion(seed)
    q_ref = turned(noisy(motion.q(T_REF), sigma, rng), random_rotation(rng), random_rotation(rng))
    return Track(T_EST, motion.q(T_EST + offset)), Track(T_REF, q_ref)


@pytest.mark.parametrize("offset", [0.0, 0.0025, -0.0127, 0.4, -2.345])
def test_an_offset_that_was_put_in_is_found_within_its_sigma(offset: float) -> None:
    found = fit_offset(*drawn(5, offset), "attitude")
    assert found is not None
    assert abs(found.seconds - offset) < FAR * found.sigma
    assert found.sigma < 1e-3
    assert found.source == "attitude"


def test_its_sigma_is_neither_too_small_nor_too_large() -> None:
    ratios = []
    for seed in range(DRAWS):
        offset = float(np.random.default_rng(seed).uniform(-0.02, 0.02))
        found = fit_offset(*drawn(seed, offset), "attitude")
        assert found is not None
        ratios.append((found.seconds - offset) / found.sigma)
    square = float(np.sum(np.square(ratios)))
    # a sigma from 30 blocks makes the ratios Student's t with 29 degrees of freedom
    sums = np.sum(np.random.default_rng(0).standard_t(29, (200_000, DRAWS)) ** 2, axis=1)
    assert np.quantile(sums, 5e-5) < square < np.quantile(sums, 1 - 5e-5)


def test_a_slow_error_of_the_estimate_does_not_look_like_an_offset(rng: np.random.Generator) -> None:
    est, ref = drawn(3, 0.005)
    drift = rotation.exp_quaternion(0.002 * np.sin(0.05 * T_EST)[:, None] * [1.0, 0.3, 1.0])
    found = fit_offset(Track(T_EST, rotation.multiply(drift, est.values)), ref, "attitude")
    assert found is not None
    assert abs(found.seconds - 0.005) < FAR * found.sigma


def test_jumps_of_the_reference_count_little(rng: np.random.Generator) -> None:
    est, ref = drawn(4, -0.008)
    q = ref.values.copy()
    for k in rng.integers(0, len(q) - 200, 15):
        q[k : k + 20] = rotation.multiply(q[k : k + 20], rotation.exp_quaternion(np.array([0.3, -0.2, 0.1])))
    found = fit_offset(est, Track(T_REF, q), "attitude")
    assert found is not None
    assert abs(found.seconds + 0.008) < FAR * found.sigma


def test_positions_tell_it_too(rng: np.random.Generator) -> None:
    motion, t_ref = Motion(6), np.arange(0.5, 58.0, 0.05)
    p_ref = rotation.rotate(random_rotation(rng), motion.p(t_ref) + rng.normal(0.0, 2e-3, (t_ref.size, 3)))
    found = fit_offset(Track(T_EST, motion.p(T_EST - 0.129)), Track(t_ref, p_ref), "position")
    assert found is not None
    assert abs(found.seconds + 0.129) < FAR * found.sigma
    assert found.sigma < 5e-3


def test_another_motion_gives_none() -> None:
    assert fit_offset(Track(T_EST, Motion(1).q(T_EST)), Track(T_REF, Motion(2).q(T_REF)), "attitude") is None


def test_rest_gives_none(rng: np.random.Generator) -> None:
    still = np.tile([1.0, 0.0, 0.0, 0.0], (T_EST.size, 1))
    assert fit_offset(Track(T_EST, still), Track(T_EST, still), "attitude") is None
    shaken = noisy(np.tile([1.0, 0.0, 0.0, 0.0], (T_REF.size, 1)), 1e-3, rng)
    assert fit_offset(Track(T_EST, still), Track(T_REF, shaken), "attitude") is None


def test_a_short_track_gives_none() -> None:
    short = T_EST[:300]  # 3 s: too few independent blocks for a sigma
    assert fit_offset(Track(short, Motion().q(short)), Track(short, Motion().q(short)), "attitude") is None
    one = T_EST[:1]
    assert fit_offset(Track(one, Motion().q(one)), Track(one, Motion().q(one)), "attitude") is None


def test_beyond_the_search_nothing_is_claimed() -> None:
    offset = 4.0 * SEARCH_S
    found = fit_offset(Track(T_EST, Motion(9).q(T_EST + offset)), Track(T_REF, Motion(9).q(T_REF)), "attitude")
    assert found is None
