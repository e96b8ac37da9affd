"""Two tracks at common times: the denser one is interpolated at the stamps of the sparser one, and never beyond."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..maths import rotation
from ..records import Array, Bools, Ints

GAP_PERIODS = 3.0  # a step of more than this many median periods is a gap: nothing is interpolated across it


@dataclass(frozen=True, slots=True)
class Lookup:
    """Where times fall in a track: sample ``before`` and ``share`` of the way to the next, for the ``rows`` (k,) of the
    times that can be looked up; how many are ``outside`` the track, and how many in its ``gaps``.
    """

    rows: Ints
    before: Ints
    share: Array
    outside: int
    gaps: int


def period(t: Array) -> float:
    """Return the median step of times (n,), s; infinite for a single one."""
    return float(np.median(np.diff(t))) if t.size > 1 else float("inf")


def look_up(at: Array, t: Array) -> Lookup:
    """Find the times ``at`` (m,) in the increasing times ``t`` (n,) of a track.

    A time is found where both neighbours stand within ``GAP_PERIODS`` of its median period, or where it is a sample's
    own.
    """
    if t.size == 0 or at.size == 0:
        none = np.empty(0, dtype=np.int64)
        return Lookup(none, none, np.empty(0), at.size, 0)
    within = (at >= t[0]) & (at <= t[-1])
    before = np.clip(np.searchsorted(t, at, side="right") - 1, 0, max(t.size - 2, 0))
    after = np.minimum(before + 1, t.size - 1)
    step = t[after] - t[before]
    share = np.where(step > 0.0, (at - t[before]) / np.where(step > 0.0, step, 1.0), 0.0)
    own = (share == 0.0) | (share == 1.0)
    near = own | (step <= GAP_PERIODS * period(t))
    rows = np.flatnonzero(within & near)
    return Lookup(rows, before[rows], share[rows], int(np.sum(~within)), int(np.sum(within & ~near)))


def attitudes(q: Array, found: Lookup) -> Array:
    r"""Return the attitude (k, 4) at looked-up times: :math:`q_i\,\mathrm{Exp}(s\,\mathrm{Log}(q_i^{-1}q_{i+1}))`."""
    q0, q1 = q[found.before], q[np.minimum(found.before + 1, len(q) - 1)]
    turn = rotation.log_quaternion(rotation.multiply(rotation.conjugate(q0), q1))
    return rotation.normalise(rotation.multiply(q0, rotation.exp_quaternion(found.share[:, None] * turn)))


def vectors(values: Array, found: Lookup) -> Array:
    """Return vectors (k, ...) at looked-up times, linear between samples."""
    share = found.share.reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray(
        values[found.before] * (1.0 - share) + values[np.minimum(found.before + 1, len(values) - 1)] * share
    )


def held(values: Bools, found: Lookup) -> Bools:
    """Return what holds from the sample before, at looked-up times."""
    return np.asarray(values[found.before])
