"""The evaluation, in order: clocks, pairs, frames, errors, statistics, consistency."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import AttestError
from ..maths import rotation
from ..records import Array, Bools, Warn
from . import alignment, consistency, errors
from .association import GAP_PERIODS, Lookup, attitudes, held, look_up, period, vectors
from .offset import Track, fit_offset
from .records import Association, Claims, Coverage, Evaluation, Frames, Judgement, Offset, Options, Poses, Series, Stats

AXES = "xyz"
FLOOR_RAD = np.radians(0.05)  # no claimed sigma weighs a sample more than a good reference can be trusted
FROM_START = 0.01  # a first sigma below this share of the median: positions count from the start
WRONG_AXES_RAD = np.radians(30.0)


@dataclass(frozen=True, slots=True)
class Side:
    """One of the two tracks: ``t`` (n,) s since the result's first sample, ``q`` (n, 4), ``p`` (n, 3), ``moving``."""

    t: Array
    q: Array
    p: Array
    moving: Bools | None

    def where(self, known: Bools) -> Side:
        """Keep the rows that are known."""
        moving = None if self.moving is None else self.moving[known]
        return Side(self.t[known], self.q[known], self.p[known], moving)


@dataclass(frozen=True, slots=True)
class Pairs:
    """Both tracks at common times ``t`` (k,), and how they came there."""

    t: Array
    est_q: Array
    est_p: Array
    ref_q: Array
    ref_p: Array
    moving: Bools | None
    association: Association


def evaluate(result: Poses, reference: Poses, options: Options) -> Evaluation:
    """Judge a result by a reference.

    Parameters
    ----------
    result, reference : Poses
        Their stamps count on one clock, but for an offset.
    options : Options

    Returns
    -------
    Evaluation
        Errors are the result's minus the (turned and shifted) reference's, in the world of the result.

    Raises
    ------
    AttestError
        If the tracks do not overlap in time, have nothing in common that can be compared, or cannot be aligned as
        asked.
    """
    t0 = result.stamps_ns[0]
    given = 0.0 if options.time_offset == "auto" else options.time_offset
    est = Side((result.stamps_ns - t0) * 1e-9, result.q, result.position, result.moving)
    start = t0 + np.int64(round(given * 1e9))  # as integers: an offset may be a whole epoch
    ref = Side((reference.stamps_ns - start) * 1e-9, reference.q, reference.position, reference.moving)
    compared = _compared(result, reference)
    _check_overlap(result, reference, est, ref)
    offset = _offset(est, ref, compared)
    applied = given
    if options.time_offset == "auto":
        if offset is None:
            raise AttestError(
                f"{reference.source}: no time offset can be found: the rates of both tracks do not match",
                "give it: --time-offset SECONDS, or leave the option out",
            )
        applied = offset.seconds
        ref = replace(ref, t=ref.t - applied)
        _check_overlap(result, reference, est, ref)
    elif offset is not None:
        offset = replace(offset, seconds=offset.seconds + given)
    frames, found = _judge(result, reference, est, ref, options, compared)
    told = _warnings(found, frames)
    warnings = (*result.warnings, *reference.warnings, *told)
    attitude, position, heading, noise = found
    moving_from = "reference" if reference.moving is not None else "result" if result.moving is not None else ""
    full = result.claims is not None and result.claims.full
    same_place = frames.mode == "none" and all(warn.code != "other-origin" for warn in told)
    verdict = _worst(_verdict(attitude), _verdict(position if same_place else None))
    return Evaluation(
        options, frames, offset, applied, attitude, position, heading, noise, full, moving_from, verdict, warnings
    )


Found = tuple[Judgement | None, Judgement | None, float | None, float | None]


def _verdict(judged: Judgement | None) -> str | None:
    """Return whether the errors about (along) the three axes are as small as claimed.

    A shift fitted to positions takes a part of their error away: no verdict on these.
    """
    shares = [judged.coverage[axis] for axis in AXES if axis in judged.coverage] if judged is not None else []
    return None if not shares else "PASS" if all(map(consistency.holds, shares)) else "WARN"


def _worst(*verdicts: str | None) -> str | None:
    """Return the worst of verdicts that were given."""
    given = [verdict for verdict in verdicts if verdict is not None]
    return None if not given else "WARN" if "WARN" in given else "PASS"


def _known(values: Array) -> Bools:
    """Return the rows (n,) without a blank."""
    return np.asarray(np.isfinite(values).all(axis=1), dtype=np.bool_)


def _compared(result: Poses, reference: Poses) -> tuple[bool, bool]:
    """Return whether attitudes and positions can be compared."""
    has = [(bool(_known(p.q).any()), bool(_known(p.position).any())) for p in (result, reference)]
    attitude, position = (has[0][k] and has[1][k] for k in (0, 1))
    if not (attitude or position):
        lacks = [
            f"{p.source} has {'no attitude' if not a else 'an attitude'} and {'no position' if not b else 'a position'}"
            for p, (a, b) in zip((result, reference), has, strict=True)
        ]
        raise AttestError(f"nothing to compare: {lacks[0]}, {lacks[1]}", "name a reference that has what the track has")
    return attitude, position


def _check_overlap(result: Poses, reference: Poses, est: Side, ref: Side) -> None:
    if max(est.t[0], ref.t[0]) > min(est.t[-1], ref.t[-1]):
        spans = [f"{p.source} covers {p.stamps_ns[0] * 1e-9:.3f} to {p.stamps_ns[-1] * 1e-9:.3f} s" for p in
                 (result, reference)]  # fmt: skip
        raise AttestError(
            f"no overlap in time: {spans[0]}, {spans[1]}",
            "is it the reference of this drive? --time-offset SECONDS moves the stamps of the result",
        )


def _offset(est: Side, ref: Side, compared: tuple[bool, bool]) -> Offset | None:
    """Return the fitted offset, from turns where both have attitudes."""
    source = "attitude" if compared[0] else "position"
    tracks = []
    for side in (est, ref):
        values = side.q if compared[0] else side.p
        known = _known(values)
        tracks.append(Track(side.t[known], values[known]))
    return fit_offset(tracks[0], tracks[1], source)


def _pair(est: Side, ref: Side, moving_only: bool) -> tuple[Pairs, Bools]:
    """Bring both to common times; also which of the pairs count."""
    on_reference = period(ref.t) > (1.0 + 1e-6) * period(est.t)
    base, other = (ref, est) if on_reference else (est, ref)
    found = look_up(base.t, other.t)
    if not found.rows.size:
        raise AttestError("no common time: the tracks overlap only where one of them has a gap", "see their stamps")
    own, across = base.where(_mask(base.t.size, found)), _at(other, found)
    first, second = (across, own) if on_reference else (own, across)
    moving = second.moving if second.moving is not None else first.moving
    if moving_only and moving is None:
        raise AttestError(
            "--moving-only: neither track tells when it moved", "leave it out; a track of attest has a column moving"
        )
    counts = moving if moving_only and moving is not None else np.ones(own.t.size, dtype=np.bool_)
    if not counts.any():
        raise AttestError("--moving-only: the reference covers no motion", "leave it out to judge the stops")
    kept = int(counts.sum())
    association = Association(
        "reference" if on_reference else "result", kept, found.outside, found.gaps, int(counts.size) - kept
    )
    return Pairs(own.t, first.q, first.p, second.q, second.p, moving, association), counts


def _mask(size: int, found: Lookup) -> Bools:
    mask = np.zeros(size, dtype=np.bool_)
    mask[found.rows] = True
    return mask


def _at(side: Side, found: Lookup) -> Side:
    """Interpolate a track at looked-up times."""
    moving = None if side.moving is None else held(side.moving, found)
    return Side(np.empty(0), attitudes(side.q, found), vectors(side.p, found), moving)


def _judge(
    result: Poses, reference: Poses, est: Side, ref: Side, options: Options, compared: tuple[bool, bool]
) -> tuple[Frames, Found]:
    """Align and judge attitudes, then positions."""
    t0 = int(result.stamps_ns[0])
    known_world = result.heading in {"absolute", "magnetic"} and reference.shared_world
    mode = options.align if options.align != "auto" else "none" if known_world else "yaw"
    frames = Frames(mode, options.align_body, alignment.IDENTITY, alignment.IDENTITY)
    attitude = position = None
    heading = noise = None
    if compared[0]:
        sides = [side.where(_known(side.q)) for side in (est, ref)]
        pairs, counts = _pair(sides[0], sides[1], options.moving_only)
        P = None if result.claims is None else _at_times(result.claims.attitude, result.claims, pairs.t, t0)
        turning = slice(2, 3) if mode == "yaw" and not options.align_body else slice(None)
        q_world, q_body = alignment.fit_rotations(
            pairs.est_q[counts], pairs.ref_q[counts], _weights(P, counts, turning), mode, body=options.align_body
        )
        frames = replace(frames, q_world=q_world, q_body=q_body)
        attitude, heading, noise = _attitude(pairs, counts, frames, P, _relative_sigma(result.claims, pairs.t, t0))
    elif options.align_body:
        raise AttestError(f"{reference.source}: --align-body needs an attitude in the reference", "leave it out")
    if compared[1]:
        sides = [side.where(_known(side.p)) for side in (est, ref)]
        pairs, counts = _pair(sides[0], sides[1], options.moving_only)
        q, shift = alignment.fit_points(pairs.est_p[counts], pairs.ref_p[counts], mode)
        frames = replace(frames, q_position=q, shift=shift)
        P = None if result.claims is None else _at_times(result.claims.position, result.claims, pairs.t, t0)
        position = _position(pairs, counts, frames, P, options)
    return frames, (attitude, position, heading, noise)


def _at_times(values: Array, claims: Claims, t: Array, t0_ns: int) -> Array:
    """Return claimed covariances (k, ...) at times (k,), linear between the claims' own."""
    own = (claims.stamps_ns - t0_ns) * 1e-9
    flat = values.reshape(len(own), -1)
    return np.stack([np.interp(t, own, column) for column in flat.T], axis=1).reshape(len(t), *values.shape[1:])


def _relative_sigma(claims: Claims | None, t: Array, t0_ns: int) -> Array | None:
    if claims is None or not np.isfinite(claims.heading_relative).any():
        return None
    return np.asarray(np.sqrt(_at_times(claims.heading_relative, claims, t, t0_ns)))


def _weights(P: Array | None, counts: Bools, turning: slice) -> Array:
    """Return how much each sample counts in an alignment: by the claimed variance about the axes it turns about.

    By its square, 1/sigma^4: errors of a drift are alike, and a heading that counts from the start is known best there.
    """
    if P is None:
        return np.ones(int(counts.sum()))
    trace = np.einsum("nii->n", P[counts][:, turning, turning])
    return np.asarray(1.0 / (np.where(np.isfinite(trace), trace, np.pi**2) + FLOOR_RAD**2) ** 2)


def _sigmas(P: Array | None) -> Array | None:
    return None if P is None else np.sqrt(np.einsum("nii->ni", P))


def _breaks(pairs: Pairs) -> Bools:
    """True at k where no line runs from pair k to k + 1."""
    return np.append(np.diff(pairs.t) > GAP_PERIODS * period(pairs.t), False)


def _attitude(
    pairs: Pairs, counts: Bools, frames: Frames, P: Array | None, relative_sigma: Array | None
) -> tuple[Judgement, float, float]:
    """Judge attitudes; also the mean heading error and the scatter of the reference."""
    turned = rotation.multiply(rotation.multiply(frames.q_world, pairs.ref_q), frames.q_body)
    error = errors.attitude(pairs.est_q, turned)
    e, sigma, breaks = error[counts], _sigmas(P), _breaks(pairs)
    mean = errors.circular_mean(e[:, 2])
    relative = rotation.wrap(e[:, 2] - mean)
    stats = {
        "inclination": errors.statistics(errors.inclination(e)), "heading": errors.statistics(e[:, 2]),
        "heading_relative": errors.statistics(relative),
        "total": errors.statistics(errors.total(pairs.est_q[counts], turned[counts])), **_by_axis(e),
    }  # fmt: skip
    nees, coverage = {}, {}
    if P is not None and sigma is not None:
        P_counts = P[counts]
        nees = {
            "attitude": consistency.nees(e, P_counts),
            "inclination": consistency.nees(e[:, :2], P_counts[:, :2, :2]),
            "heading": consistency.nees(e[:, 2:], P_counts[:, 2:, 2:]),
        }
        by_name = {axis: (e[:, i], sigma[counts, i]) for i, axis in enumerate(AXES)}
        if relative_sigma is not None:
            by_name["heading_relative"] = (relative, relative_sigma[counts])
            nees["heading_relative"] = consistency.nees(relative[:, None], relative_sigma[counts, None, None] ** 2)
        coverage = _coverages(by_name)
    series = Series(pairs.t, error, sigma, breaks)
    return Judgement(stats, nees, coverage, series, pairs.association), mean, errors.scatter(error, breaks)


def _by_axis(error: Array) -> dict[str, Stats]:
    return {axis: errors.statistics(error[:, i]) for i, axis in enumerate(AXES)}


def _coverages(by_name: dict[str, tuple[Array, Array]]) -> dict[str, Coverage]:
    found = {name: consistency.coverage(*pair) for name, pair in by_name.items()}
    return {name: shares for name, shares in found.items() if shares is not None}


def _position(pairs: Pairs, counts: Bools, frames: Frames, P: Array | None, options: Options) -> Judgement:
    """Judge positions: absolute, level, vertical, and relative over a span of time or path."""
    assert frames.q_position is not None
    assert frames.shift is not None
    moved = rotation.rotate(frames.q_position, pairs.ref_p) + frames.shift
    error = pairs.est_p - moved
    e, sigma = error[counts], _sigmas(P)
    stats = {
        "absolute": errors.statistics(np.linalg.norm(e, axis=1)),
        "horizontal": errors.statistics(np.hypot(e[:, 0], e[:, 1])), "vertical": errors.statistics(e[:, 2]),
        **_by_axis(e),
    }  # fmt: skip
    by_path = options.delta_unit == "m"
    start, end = (
        errors.pairs_by_path(pairs.ref_p, options.delta) if by_path else errors.pairs_by_time(pairs.t, options.delta)
    )
    start, end = start[counts[start]], end[counts[start]]
    if np.isfinite(pairs.est_q).all() and np.isfinite(pairs.ref_q).all():
        seen_from = pairs.est_q, rotation.multiply(pairs.ref_q, frames.q_body)
        relative = errors.relative_position(start, end, pairs.est_p, pairs.ref_p, *seen_from)
    else:
        relative = errors.relative_position(start, end, pairs.est_p, moved)
    stats["relative"] = errors.statistics(relative)
    nees, coverage = {}, {}
    if P is not None and sigma is not None and np.isfinite(sigma).any():
        if frames.mode != "none" and np.all(sigma[0] < FROM_START * np.nanmedian(sigma, axis=0)):
            error = error - error[0]  # what is claimed counts from the start: a fitted shift must not
        e = error[counts]
        nees = {"position": consistency.nees(e, P[counts])}
        coverage = _coverages({axis: (e[:, i], sigma[counts, i]) for i, axis in enumerate(AXES)})
    return Judgement(stats, nees, coverage, Series(pairs.t, error, sigma, _breaks(pairs)), pairs.association)


def _warnings(found: Found, frames: Frames) -> list[Warn]:
    """Return what looks like another frame than the one assumed, and positions worse than claimed."""
    told = []
    attitude, position, _, _ = found
    if attitude is not None and attitude.stats["total"].median > WRONG_AXES_RAD:
        size = np.degrees(attitude.stats["total"].median)
        fact = f"half of the attitude errors are over {size:.0f} deg: reference and result seem to have different axes"
        hint = "--align-body fits a constant rotation of the body, --align full one of the world"
        told.append(Warn("other-axes", fact, hint))
    if position is None or frames.mode != "none":
        return told
    error = position.series.error
    apart, spread = np.linalg.norm(error.mean(axis=0)), np.sqrt(np.sum(error.var(axis=0)))
    if apart > 1.0 and apart > 3.0 * spread:
        fact = (
            f"positions stand {apart:.3g} m apart and vary by {spread:.2g} m only: they seem to count from two places"
        )
        told.append(Warn("other-origin", fact, "--align yaw fits a turn and a shift"))
    elif _verdict(position) == "WARN":
        worst = max(shares.mean_square for shares in position.coverage.values())
        fact = f"position errors are larger than their sigma allows: {np.sqrt(worst):.1f} sigma rms on the worst axis"
        told.append(Warn("position-sigma", fact, "see the coverage of each axis, and the scale of the odometry"))
    return told
