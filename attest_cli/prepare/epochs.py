"""Files of one drive on one clock: what counts from power-on, or in another time zone, is told before it is joined."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from ..errors import AttestError
from ..records import Channel, Recording, Warn

SET_NS = 100_000_000 * 1_000_000_000
"""A step by more than these three years is no pause: the clock was set, or it is another one."""
DATES_NS = (631_152_000_000_000_000, 4_102_444_800_000_000_000)
"""1990 to 2100: stamps that are a date."""
INERTIAL = frozenset({"imu", "gyro", "accel"})
HOUR_S, FARTHEST_H = 3600.0, 14  # to which clocks are set; time zones
AWAY_NS = round(FARTHEST_H * HOUR_S) * 1_000_000_000
"""What misses the IMU's time by more is no neighbour in time, nor in another zone."""

WAY_OUT = "write both with the stamps of one clock; of messages --time log takes the recorder's"

Part = tuple[Recording, int, int]  # a file, the first and the last stamp of a channel in it


def one_clock(cast: Mapping[str, Channel], recordings: Sequence[Recording]) -> list[Warn]:
    """Refuse files whose clocks have nothing in common; tell of a file that adds nothing to a sensor of several.

    A single sensor without overlap is left out, and told, where it is read.

    Raises
    ------
    AttestError
        If gyro and accelerometer share no time, parts of the IMU are years apart, or all other sensors miss the IMU's
        time and one of another file does so by more than time zones.
    """
    inertial = [_parts(cast[role], recordings) for role in ("imu", "gyro", "accel") if role in cast]
    base = inertial[0] if inertial else []
    if not base:
        return []
    for a, b in pairwise(sorted(base, key=lambda part: part[1])):
        if b[1] - a[2] > SET_NS:
            raise AttestError(f"{_spoken(a)}, {_spoken(b)}: these are two clocks", WAY_OUT)
    first, last = min(part[1] for part in base), max(part[2] for part in base)
    aids = {role: _parts(channel, recordings) for role, channel in cast.items() if role not in INERTIAL}
    missed = {role: [max(part[1] - last, first - part[2]) for part in parts] for role, parts in aids.items() if parts}
    if "accel" in cast and (accel := inertial[-1]) and all(a[1] > last or a[2] < first for a in accel):
        raise AttestError(_apart(base[0], accel[0], "accel"), WAY_OUT)
    away = [
        (role, part)
        for role, misses in missed.items()
        for part, miss in zip(aids[role], misses, strict=True)
        if miss > AWAY_NS and all(part[0] is not own[0] for own in base)
    ]
    if away and min(map(min, missed.values())) > 0:
        raise AttestError(_apart(base[0], away[0][1], away[0][0]), WAY_OUT)
    return [
        Warn("no-overlap", f"{_apart(base[0], part, role)}: not used", WAY_OUT)
        for role, part in away
        if min(missed[role]) <= 0
    ]


def _apart(base: Part, other: Part, role: str) -> str:
    return f"{_spoken(base)}, {_spoken(other)}: nothing of its {role} lies in the time of the IMU"


def whole_hours(step_s: float, period_s: float) -> int:
    """Return by how many hours a clock was set, where a step is as long but for the usual ``period_s``; else 0."""
    hours = round(abs(step_s) / HOUR_S)
    off = abs(step_s - period_s - (hours if step_s > 0.0 else -hours) * HOUR_S)
    return hours if hours <= FARTHEST_H and off < max(2.0 * period_s, 0.01) else 0


def _parts(channel: Channel, recordings: Sequence[Recording]) -> list[Part]:
    """Find the files that a channel comes from."""
    return [
        (recording, int(part.stamps_ns.min()), int(part.stamps_ns.max()))
        for recording in recordings
        for part in recording.channels
        if part.stamps_ns.size and (part.stamps_ns is channel.stamps_ns or part.name == channel.name)
    ]


def _spoken(part: Part) -> str:
    """Name a file and its time: as dates, or in s where it counts from somewhere else."""
    recording, first, last = part
    if not DATES_NS[0] < first < DATES_NS[1]:
        return f"{recording.source.name} spans {first * 1e-9:.1f} to {last * 1e-9:.1f} s"
    dates = np.array([first, last]).astype("datetime64[ns]").astype("datetime64[s]")
    return f"{recording.source.name} spans {str(dates[0]).replace('T', ' ')} to {str(dates[1]).replace('T', ' ')}"
