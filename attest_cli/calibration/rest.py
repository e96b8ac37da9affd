"""What stands still: the samples of static logs and of the stops of drives, and their means over blocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..errors import AttestError
from ..nodes.noise import stop_ranges
from ..records import Array, Ints, Log, Segmentation

STATIC_SHARE = 0.9  # a record that rests for this share of its time is a static one with knocks in it
GAP_PERIODS = 5.0  # a hole in the samples of a stop: as where the log is prepared
RATE_SHARE = 0.02  # sampling rates further apart are two sensors, or two settings of one
FEWEST = 10  # samples of a piece: fewer say nothing about noise
SHORTEST_S = 2.0  # at rest in all
BY_HAND = "let the sensor lie still for some minutes, or name the stops of the drive with --stops FILE"


@dataclass(frozen=True, slots=True)
class Piece:
    """Samples at rest without a gap: ``t`` (n,) s on the calibration's axis, ``gyro_b``, ``accel_b`` (n, 3), mean
    ``period`` s, number of the ``stop``.
    """

    t: Array
    gyro_b: Array
    accel_b: Array
    period: float
    stop: int


@dataclass(frozen=True, slots=True)
class Blocks:
    """Blocks of consecutive samples at rest: ``t`` (n,) their mean time s, ``count`` samples, ``span`` s of them,
    ``gap`` s from the last sample of the block before to their first, ``stop`` and ``piece`` (n,) they lie in.
    """

    t: Array
    count: Array
    span: Array
    gap: Array
    stop: Ints
    piece: Ints


@dataclass(frozen=True, slots=True)
class Record:
    """All that rests, of one log or several on one time axis: ``duration`` s from first to last sample, ``at_rest`` s
    of it used, ``static``: it rests but for knocks.
    """

    pieces: tuple[Piece, ...]
    duration: float
    at_rest: float
    rate_hz: float
    static: bool
    t0_ns: int
    notes: tuple[str, ...]

    @property
    def period(self) -> float:
        """Sampling period, s."""
        return 1.0 / self.rate_hz


def find_rest(logs: Sequence[tuple[Log, Segmentation]]) -> Record:
    """Return everything that stands still in logs of one sensor, on the time axis of the earliest.

    Raises
    ------
    AttestError
        Where two logs overlap in time or differ in rate, or nothing stands still.
    """
    logs = sorted(logs, key=lambda pair: pair[0].t0_ns)
    t0_ns = logs[0][0].t0_ns
    _refuse_strangers([log for log, _ in logs])
    pieces: list[Piece] = []
    for log, segmentation in logs:
        pieces += _pieces(log, segmentation, (log.t0_ns - t0_ns) * 1e-9, pieces[-1].stop + 1 if pieces else 0)
    names = ", ".join(path.name for log, _ in logs for path in log.sources)
    if not pieces:
        raise AttestError(f"{names}: nothing in it stands still, so neither bias nor noise can be told", BY_HAND)
    at_rest = sum(len(p.t) * p.period for p in pieces)
    if at_rest < SHORTEST_S:
        raise AttestError(f"{names}: {at_rest:.1f} s of it stand still, too short for bias and noise", BY_HAND)
    recorded = sum(float(log.imu.t[-1] - log.imu.t[0]) for log, _ in logs)
    moved = [s.end - s.start for _, segmentation in logs for s in segmentation.motions]
    static = sum(moved) <= (1.0 - STATIC_SHARE) * recorded
    notes = [f"moved {len(moved)} x, {sum(moved):.1f} s in all: left out"] if static and moved else []
    if len(logs) > 1:
        notes.append(f"{len(logs)} logs on one time axis, as if the sensor had stayed on between them")
    last = max((log.t0_ns - t0_ns) * 1e-9 + float(log.imu.t[-1]) for log, _ in logs)
    return Record(
        tuple(pieces), last - float(logs[0][0].imu.t[0]), at_rest,
        1.0 / float(np.median([p.period for p in pieces])), static, t0_ns, tuple(notes),
    )  # fmt: skip


def _refuse_strangers(logs: Sequence[Log]) -> None:
    """Refuse logs that one sensor cannot have written one after the other, or not in one setting."""
    for log, after in pairwise(logs):
        names = f"{log.sources[0].name} and {after.sources[0].name}"
        apart = (after.t0_ns - log.t0_ns) * 1e-9
        if apart + float(after.imu.t[0]) <= float(log.imu.t[-1]):
            raise AttestError(
                f"{names} overlap in time: one sensor cannot have written both",
                "calibrate from each on its own, or give logs whose stamps carry the date",
            )
        periods = [float(np.median(np.diff(x.imu.t))) for x in (log, after)]
        if abs(periods[0] / periods[1] - 1.0) > RATE_SHARE:
            raise AttestError(
                f"{names} have {1 / periods[0]:.4g} and {1 / periods[1]:.4g} samples a second",
                "calibrate from logs of one sensor in one setting",
            )


def _pieces(log: Log, segmentation: Segmentation, shift: float, number: int) -> list[Piece]:
    """Return the used part of every stop, cut at holes in its samples; stops are numbered from ``number``."""
    found = []
    for stop, (lo, hi) in enumerate(stop_ranges(log, segmentation), number):
        if hi - lo < FEWEST:
            continue
        step = np.diff(log.imu.t[lo:hi])
        holes = np.flatnonzero(step > GAP_PERIODS * float(np.median(step))) + 1 + lo
        for a, b in pairwise([lo, *holes.tolist(), hi]):
            if b - a >= FEWEST:
                t = log.imu.t[a:b]
                period = float(t[-1] - t[0]) / (b - a - 1)
                found.append(Piece(t + shift, log.imu.gyro_b[a:b], log.imu.accel_b[a:b], period, stop))
    return found


def cut(pieces: Sequence[Piece], length_s: float) -> tuple[Blocks, list[Ints]]:
    """Cut pieces into equal blocks of about ``length_s`` (one sample at least); return them, and for each piece the
    first sample of its blocks and its end.
    """
    parts, edges = [], []
    last = float(pieces[0].t[0])
    for number, piece in enumerate(pieces):
        n = len(piece.t)
        blocks = min(n, max(1, round(n * piece.period / length_s)))
        edge = np.round(np.linspace(0, n, blocks + 1)).astype(np.int64)
        first, count = edge[:-1], np.diff(edge).astype(np.float64)
        gap = piece.t[first] - np.append(last, piece.t[first[1:] - 1])
        t = np.add.reduceat(piece.t, first) / count
        parts.append((t, count, count * piece.period, gap, np.full(blocks, piece.stop), np.full(blocks, number)))
        edges.append(edge)
        last = float(piece.t[-1])
    return Blocks(*(np.concatenate(column) for column in zip(*parts, strict=True))), edges


def means(values: Sequence[Array], edges: Sequence[Ints]) -> Array:
    """Return the mean of each block (n,) of the pieces' samples."""
    sums = [np.add.reduceat(x, edge[:-1]) / np.diff(edge) for x, edge in zip(values, edges, strict=True)]
    return np.concatenate(sums)
