"""The whole evaluation: nothing for a track against itself, what was put in is found, the rest is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import chdtri
from support.tracks import Motion, noisy, poses, random_rotation, turned

from attest_cli.errors import AttestError
from attest_cli.evaluate import Claims, Evaluation, Options, Poses, evaluate
from attest_cli.evaluate.alignment import IDENTITY
from attest_cli.maths import rotation

T = np.arange(0.0, 40.0, 0.02)
MOTION = Motion(8)
RESULT = poses(MOTION, T, heading="absolute", shared_world=True)


def about_vertical(angle: float) -> np.ndarray:
    return np.array([np.cos(0.5 * angle), 0.0, 0.0, np.sin(0.5 * angle)])


def largest(found: Evaluation) -> float:
    assert found.attitude is not None
    assert found.position is not None
    return max(s.max for judged in (found.attitude, found.position) for s in judged.stats.values())


def without(track: Poses, *names: str) -> Poses:
    return replace(track, **{name: np.full_like(getattr(track, name), np.nan) for name in names})


def claiming(track: Poses, attitude: np.ndarray, position: np.ndarray) -> Poses:
    n = len(track.stamps_ns)
    P, Q = (np.broadcast_to(c, (n, 3, 3)).copy() for c in (attitude, position))
    return replace(track, claims=Claims(track.stamps_ns, P, Q, np.full(n, np.nan), full=True))


@pytest.mark.parametrize("align", ["auto", "none", "yaw", "full"])
@pytest.mark.parametrize("align_body", [False, True])
def test_a_track_against_itself_has_no_error(align: str, align_body: bool) -> None:
    found = evaluate(RESULT, RESULT, Options(align=align, align_body=align_body))  # type: ignore[arg-type]
    assert largest(found) < 1e-12
    assert found.offset is not None
    assert abs(found.offset.seconds) < 1e-9
    assert found.attitude is not None
    assert found.attitude.association.used == T.size
    assert found.verdict is None  # it claims nothing


def test_a_reference_on_another_datum_and_other_body_axes_is_brought_back(rng: np.random.Generator) -> None:
    q_world, q_body = about_vertical(2.0), random_rotation(rng)
    moved = rotation.rotate(rotation.conjugate(q_world), RESULT.position - np.array([3.0, 4.0, 5.0]))
    other = replace(RESULT, q=turned(RESULT.q, rotation.conjugate(q_world), rotation.conjugate(q_body)), position=moved)
    found = evaluate(RESULT, other, Options(align="yaw", align_body=True))
    assert largest(found) < 1e-11
    np.testing.assert_allclose(np.abs(found.frames.q_world @ q_world), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.abs(found.frames.q_body @ q_body), 1.0, atol=1e-12)
    assert found.frames.shift is not None
    np.testing.assert_allclose(found.frames.shift, [3.0, 4.0, 5.0], atol=1e-10)
    assert "other-axes" in {w.code for w in evaluate(RESULT, other, Options(align="none")).warnings}


@pytest.mark.parametrize(
    ("heading", "shared", "mode"),
    [("absolute", True, "none"), ("magnetic", True, "none"), ("relative", True, "yaw"), ("", True, "yaw"),
     ("absolute", False, "yaw")],
)  # fmt: skip
def test_auto_aligns_yaw_where_a_datum_is_not_shared(heading: str, shared: bool, mode: str) -> None:
    found = evaluate(replace(RESULT, heading=heading), replace(RESULT, shared_world=shared), Options())
    assert found.frames.mode == mode


def test_an_error_that_was_put_in_is_told_in_its_own_place() -> None:
    v = np.radians([0.3, -0.4, 2.0])
    tilt, yaw = rotation.exp_quaternion(v * [1, 1, 0]), about_vertical(v[2])
    wrong = replace(RESULT, q=rotation.multiply(tilt, rotation.multiply(yaw, RESULT.q)),
                    position=RESULT.position + np.array([3.0, 4.0, 12.0]))  # fmt: skip
    found = evaluate(wrong, RESULT, Options(align="none"))
    assert found.attitude is not None
    assert found.position is not None
    stats = {name: np.degrees(s.rms) for name, s in found.attitude.stats.items()}
    assert stats["inclination"] == pytest.approx(0.5)
    assert stats["heading"] == pytest.approx(2.0)
    assert stats["heading_relative"] == pytest.approx(0.0, abs=1e-12)
    assert np.degrees(found.heading_offset or 0.0) == pytest.approx(2.0)
    assert {name: found.position.stats[name].rms for name in ("absolute", "horizontal", "vertical")} == pytest.approx(
        {"absolute": 13.0, "horizontal": 5.0, "vertical": 12.0}
    )
    assert {w.code for w in found.warnings} == {"other-origin"}


def test_an_offset_is_told_and_taken_out_only_when_asked() -> None:
    late = poses(MOTION, T, shift=0.0123, heading="absolute", shared_world=True)
    told = evaluate(late, RESULT, Options())
    assert told.applied == 0.0
    assert told.offset is not None
    assert told.offset.seconds == pytest.approx(0.0123, abs=1e-4)
    assert largest(told) > 1e-3
    taken = evaluate(late, RESULT, Options(time_offset="auto"))
    assert taken.applied == told.offset.seconds
    given = evaluate(late, RESULT, Options(time_offset=0.0123))
    assert given.offset is not None
    assert given.offset.seconds == pytest.approx(0.0123, abs=1e-4)  # what is told does not depend on what is given
    for found in (taken, given):
        assert largest(found) < 0.1 * largest(told)


def test_a_clock_of_its_own_is_bridged_by_a_number() -> None:
    own = replace(RESULT, stamps_ns=RESULT.stamps_ns - RESULT.stamps_ns[0])
    with pytest.raises(AttestError, match="no overlap in time"):
        evaluate(own, RESULT, Options())
    found = evaluate(own, RESULT, Options(time_offset=float(RESULT.stamps_ns[0]) * 1e-9))
    assert largest(found) < 1e-12


def test_the_denser_track_is_interpolated() -> None:
    coarse = poses(MOTION, T[3::10], heading="absolute", shared_world=True)
    for result, reference, base in ((RESULT, coarse, "reference"), (coarse, RESULT, "result")):
        found = evaluate(result, reference, Options())
        assert found.attitude is not None
        assert found.attitude.association.base == base
        assert found.attitude.association.used == len(coarse.stamps_ns)
        assert largest(found) < 1e-9


def test_gaps_and_blanks_of_the_reference_are_left_out_and_counted() -> None:
    blank = RESULT.q.copy()
    blank[(T > 10.0) & (T < 12.0)] = np.nan
    reference = replace(RESULT, q=blank, position=RESULT.position)
    reference = replace(reference, **{
        name: getattr(reference, name)[T < 30.0] for name in ("stamps_ns", "q", "position")
    })  # fmt: skip
    found = evaluate(RESULT, reference, Options())
    assert found.attitude is not None
    assert found.position is not None
    a = found.attitude.association
    assert a.gaps == np.sum((T > 10.0 + 1e-9) & (T < 12.0 - 1e-9))
    assert a.outside == np.sum(T >= 30.0)
    assert a.used + a.gaps + a.outside == T.size
    assert found.position.association.gaps == 0
    assert found.attitude.series.breaks.sum() == 1
    assert largest(found) < 1e-12


def test_motion_only_counts_motion_as_the_reference_tells_it() -> None:
    moving = T > 15.0
    wrong = replace(RESULT, q=np.where(moving[:, None], RESULT.q, rotation.multiply(about_vertical(0.1), RESULT.q)))
    told = replace(RESULT, moving=moving)
    found = evaluate(replace(wrong, moving=~moving), told, Options(moving_only=True))
    assert found.moving_from == "reference"
    assert largest(found) < 1e-12
    assert found.attitude is not None
    assert (found.attitude.association.used, found.attitude.association.still) == (moving.sum(), (~moving).sum())
    assert found.attitude.series.t.size == T.size  # all of it is drawn
    assert evaluate(replace(wrong, moving=moving), RESULT, Options(moving_only=True)).moving_from == "result"
    with pytest.raises(AttestError, match="neither track tells"):
        evaluate(wrong, RESULT, Options(moving_only=True))
    with pytest.raises(AttestError, match="no motion"):
        evaluate(wrong, replace(told, moving=np.zeros_like(moving)), Options(moving_only=True))


def test_what_only_one_of_both_has_is_not_judged() -> None:
    found = evaluate(RESULT, without(RESULT, "q"), Options())
    assert found.attitude is None
    assert found.position is not None
    assert found.offset is not None
    assert found.offset.source == "position"
    assert evaluate(without(RESULT, "position"), RESULT, Options()).position is None
    with pytest.raises(AttestError, match="nothing to compare: track has no attitude and a position"):
        evaluate(without(RESULT, "q"), without(RESULT, "position"), Options())
    with pytest.raises(AttestError, match="needs an attitude"):
        evaluate(RESULT, without(RESULT, "q"), Options(align_body=True))


def test_an_offset_that_cannot_be_found_is_not_applied() -> None:
    still = replace(RESULT, q=np.tile(IDENTITY, (T.size, 1)), position=np.zeros((T.size, 3)))
    assert evaluate(still, still, Options()).offset is None
    with pytest.raises(AttestError, match="no time offset can be found"):
        evaluate(still, still, Options(time_offset="auto"))


@pytest.mark.parametrize("factor", [1.0, 4.0])
def test_nees_of_errors_drawn_from_the_claims_is_their_degrees_of_freedom(
    rng: np.random.Generator, factor: float
) -> None:
    """White errors of a known covariance, correlated between axes; a claim four times too small is WARN."""
    a = rng.normal(size=(3, 3))
    P, Q = 1e-6 * (a @ a.T + np.eye(3)), 0.1 * (a.T @ a + np.eye(3))
    e = rng.multivariate_normal(np.zeros(3), P, T.size)
    p = RESULT.position + rng.multivariate_normal(np.zeros(3), Q, T.size)
    wrong = replace(RESULT, q=rotation.multiply(rotation.exp_quaternion(e), RESULT.q), position=p)
    found = evaluate(claiming(wrong, P / factor, Q / factor), RESULT, Options())
    assert found.attitude is not None
    assert found.position is not None
    nees = {**found.attitude.nees, **found.position.nees}
    for name, dof in {"attitude": 3, "inclination": 2, "heading": 1, "position": 3}.items():
        low, high = (chdtri(dof * T.size, p) / T.size for p in (1 - 5e-5, 5e-5))
        assert (low < nees[name].mean < high) == (factor == 1.0), name
        assert nees[name].dof == dof
    assert found.verdict == ("PASS" if factor == 1.0 else "WARN")
    assert found.band_share == pytest.approx(0.95 if factor == 1.0 else 0.67, abs=0.03)


@pytest.mark.parametrize(("attitude", "position"), [(1.0, 9.0), (9.0, 1.0), (1.0, 1.0)])
def test_the_verdict_is_that_of_the_worse(rng: np.random.Generator, attitude: float, position: float) -> None:
    """A claim three times too small, of either, is WARN."""
    e, p = (rng.normal(0.0, sigma, (T.size, 3)) for sigma in (1e-3, 0.3))
    wrong = replace(
        RESULT, q=rotation.multiply(rotation.exp_quaternion(e), RESULT.q), position=RESULT.position + p - p[0]
    )
    found = evaluate(claiming(wrong, 1e-6 * np.eye(3) / attitude, 0.09 * np.eye(3) / position), RESULT, Options())
    assert found.verdict == ("PASS" if attitude == position == 1.0 else "WARN")


def test_a_yaw_alignment_trusts_the_samples_that_claim_to_be_sure(rng: np.random.Generator) -> None:
    """A relative heading that walks away from its start is aligned at the start, where its sigma is small."""
    walk = np.cumsum(rng.normal(0.0, 0.002, T.size))
    q = rotation.multiply(np.stack([about_vertical(w) for w in walk]), RESULT.q)
    P = np.zeros((T.size, 3, 3))
    P[:, 0, 0] = P[:, 1, 1] = 1e-8
    P[:, 2, 2] = 1e-8 + 0.002**2 * np.arange(T.size)
    claims = Claims(RESULT.stamps_ns, P, np.full_like(P, np.nan), np.full(T.size, np.nan), full=True)
    found = evaluate(replace(RESULT, q=q, heading="relative", claims=claims), RESULT, Options())
    yaw = 2.0 * np.arctan2(found.frames.q_world[3], found.frames.q_world[0])
    assert abs(yaw) < 0.02
    assert found.attitude is not None
    assert found.attitude.coverage["z"].band > 0.9


def test_noise_of_the_reference_is_told(rng: np.random.Generator) -> None:
    found = evaluate(RESULT, replace(RESULT, q=noisy(RESULT.q, 1e-3, rng)), Options())
    assert found.scatter == pytest.approx(1e-3, rel=0.1)


def test_a_heading_that_counts_from_the_start_is_turned_by_what_it_knows_best() -> None:
    """A random walk from the start with the sigma of one: a turn fitted to all of it would spoil the start."""
    nees, warned = [], 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        step = np.radians(3.0) / np.sqrt(T[-1]) * np.sqrt(0.02)
        drift = np.concatenate([[0.0], np.cumsum(rng.normal(0.0, step, T.size - 1))])
        q = np.stack([np.cos(0.5 * drift), 0.0 * drift, 0.0 * drift, np.sin(0.5 * drift)], axis=1)
        track = replace(RESULT, q=rotation.multiply(q, RESULT.q), heading="relative")
        P = np.tile(np.diag([np.radians(1.0) ** 2, np.radians(1.0) ** 2, 0.0]), (T.size, 1, 1))
        P[:, 2, 2] = 1e-8 + step**2 * np.arange(T.size)
        claims = Claims(track.stamps_ns, P, np.tile(np.eye(3), (T.size, 1, 1)), np.full(T.size, np.nan), full=True)
        found = evaluate(replace(track, claims=claims), without(RESULT, "position"), Options())
        assert found.attitude is not None
        nees.append(found.attitude.nees["heading"].mean)
        warned += found.verdict == "WARN"
    assert np.mean(nees) < 1.6
    assert warned <= 3
