"""Which channel plays which role: files of one drive joined, settings first, then type and names."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from ..errors import AttestError
from ..records import COLUMNS, ROLES, Channel, Recording, Warn
from ..settings import Settings

JOIN_OVERLAP_NS = 1_000_000_000
"""Channels of one name in several files that overlap by more are different sensors, not parts of one drive."""


@dataclass(frozen=True, slots=True)
class Cast:
    """The chosen channel of each role, and what should be known of the choice."""

    channels: Mapping[str, Channel]
    warnings: list[Warn] = field(default_factory=list)


def choose(recordings: Sequence[Recording], settings: Settings) -> Cast:
    """Give every role at most one channel: the one that settings name, else the one that is recognised.

    An IMU is never mixed from two. Orientation needs to be named: a device's own filter is no measurement.

    Raises
    ------
    AttestError
        If a named channel does not exist or cannot play its role, or if there is no IMU.
    """
    found = joined(recordings)
    named = _named(found, recordings, settings)
    cast: dict[str, Channel] = {}
    warnings: list[Warn] = []
    for role in ROLES:
        candidates = [channel for channel in found if channel.role == role]
        if role in named:
            cast[role] = named[role]
        elif candidates and role != "orientation":
            cast[role] = _best(role, candidates, cast.get("imu"), warnings)
    warnings += [
        Warn("file-not-used", f"{recording.source.name}: {_nothing(recording.other)}")
        for recording in recordings
        if found and not recording.channels
    ]
    if not ("imu" in cast or {"gyro", "accel"} <= cast.keys()):
        raise AttestError(*_no_imu(recordings, found, cast))
    if "imu" in cast and not {"gyro", "accel"} & named.keys():
        halves = [cast.pop(role) for role in ("gyro", "accel") if role in cast]
        warnings += _beside(cast["imu"], halves) if halves and "imu" not in named else []
    elif {"gyro", "accel"} <= cast.keys():
        cast.pop("imu", None)
    return Cast(cast, warnings)


def joined(recordings: Sequence[Recording]) -> list[Channel]:
    """Join channels of one name from several files by time; where they overlap and differ, they get their file's name
    instead.
    """
    by_name: dict[str, list[tuple[Recording, Channel]]] = {}
    for recording in recordings:
        for channel in (c for c in recording.channels if c.stamps_ns.size):
            by_name.setdefault(channel.name, []).append((recording, channel))
    found = []
    for name, parts in by_name.items():
        channels = [channel for _, channel in sorted(parts, key=lambda part: int(part[1].stamps_ns[0]))]
        alike = len({(channel.role, tuple(channel.values), tuple(channel.units.items())) for channel in channels}) == 1
        if alike:
            channels = [channels[0], *(_after(a, b) for a, b in pairwise(channels))]
        follows = all(b.stamps_ns[0] > a.stamps_ns[-1] - JOIN_OVERLAP_NS for a, b in pairwise(channels))
        if len(channels) == 1 or (follows and alike):
            found.append(_concatenated(channels))
        else:
            named = len({recording.source.stem for recording, _ in parts}) == len(parts)
            files = [recording.source.stem if named else str(recording.source) for recording, _ in parts]
            found += [replace(channel, name=f"{file}:{name}") for file, (_, channel) in zip(files, parts, strict=True)]
    return found


def _after(first: Channel, second: Channel) -> Channel:
    """Return what ``second`` adds to ``first``, if all that it has of the same time is the same."""
    repeated = int(np.searchsorted(second.stamps_ns, first.stamps_ns[-1], side="right"))
    if not 0 < repeated < second.stamps_ns.size or np.any(np.diff(second.stamps_ns) < 0):
        return second
    same = first.stamps_ns.size - repeated
    if same < 0 or not np.array_equal(first.stamps_ns[same:], second.stamps_ns[:repeated]):
        return second
    if not all(np.array_equal(first.values[k][same:], v[:repeated], equal_nan=True) for k, v in second.values.items()):
        return second
    values = {name: column[repeated:] for name, column in second.values.items()}
    return replace(second, stamps_ns=second.stamps_ns[repeated:], values=values)


def told(recordings: Sequence[Recording]) -> list[Warn]:
    """Return what the readers said of their files; a renamed column is missing only where no file of a drive has it."""
    elsewhere = {w for r in recordings for column, w in r.missing.items()
                 if any(column not in other.missing for other in recordings)}  # fmt: skip
    return [warning for recording in recordings for warning in recording.warnings if warning not in elsewhere]


def with_named(recordings: Sequence[Recording], settings: Settings) -> list[Channel]:
    """Return all channels, joined, with the role that settings give them; a channel is there once per role.

    Raises
    ------
    AttestError
        If a named channel does not exist or cannot play its role.
    """
    found = joined(recordings)
    named = _named(found, recordings, settings)
    changed = {channel.name for channel in named.values()}
    return [*named.values(), *(channel for channel in found if channel.name not in changed)]


def _concatenated(parts: list[Channel]) -> Channel:
    if len(parts) == 1:
        return parts[0]
    stamps_ns = np.concatenate([part.stamps_ns for part in parts])
    values = {name: np.concatenate([part.values[name] for part in parts]) for name in parts[0].values}
    return replace(parts[0], stamps_ns=stamps_ns, values=values)


def _named(found: Sequence[Channel], recordings: Sequence[Recording], settings: Settings) -> dict[str, Channel]:
    """Look up the channels that settings name, by a role's own table or by ``map``."""
    wanted: dict[str, str] = {}
    for role in ROLES:
        channel = getattr(getattr(settings, role, None), "channel", None)
        if channel is not None:
            wanted[role] = channel
    wanted |= {str(role): channel for role, channel in settings.map.items()}
    return {role: _playing(role, _lookup(name, found, recordings), found) for role, name in wanted.items()}


def _lookup(name: str, found: Sequence[Channel], recordings: Sequence[Recording]) -> Channel:
    for channel in found:
        if channel.name == name:
            return channel
    other = {key: kind for recording in recordings for key, kind in recording.other.items()}
    files = ", ".join(str(recording.source) for recording in recordings)
    if name in other:
        raise AttestError(
            f"{files}: channel {name!r} is of a kind attest does not read: {other[name]}", "map another channel"
        )
    known = [channel.name for channel in found]
    near = difflib.get_close_matches(name, known, n=3, cutoff=0.4) or known[:6]
    raise AttestError(f"{files}: no channel {name!r}", f"the nearest: {', '.join(near)}")


def _playing(role: str, channel: Channel, found: Sequence[Channel]) -> Channel:
    """Return the channel with the columns of the role; a bare vector takes their names in order."""
    names = COLUMNS[role]
    if role == "orientation" and "q_w" not in channel.values:
        channel = next((c for c in found if c.name == f"{channel.name}#orientation"), channel)
    columns = [name for name in channel.values if "sigma" not in name]
    if names[0] in channel.values or (role == "odometry" and "speed" in channel.values):
        return replace(channel, role=role)
    if role == "gps_velocity" and set(COLUMNS["odometry"]) <= channel.values.keys():  # a twist in the world's axes
        values = {new: channel.values[old] for new, old in zip(names, COLUMNS["odometry"], strict=True)}
        return replace(channel, role=role, values=values, units=dict.fromkeys(names, "m/s"))
    if len(columns) == len(names) and not channel.role:
        return replace(
            channel, role=role, values={names[k]: channel.values[c] for k, c in enumerate(columns)}, units={}
        )
    raise AttestError(
        f"channel {channel.name!r} ({channel.kind}) cannot be the {role}: it holds {', '.join(columns)}",
        f"the {role} needs {', '.join(names)}",
    )


def _best(role: str, candidates: list[Channel], imu: Channel | None, warnings: list[Warn]) -> Channel:
    """Take the channel beside the IMU if there is one, else the one with most rows; say so where it was a choice."""
    if len(candidates) == 1:
        return candidates[0]
    for place in (_file, _space):
        beside = [channel for channel in candidates if imu is not None and place(channel) == place(imu)]
        if len(beside) == 1:
            return beside[0]
    best = max(candidates, key=lambda channel: channel.stamps_ns.size)  # rate x span; the first of equals
    names = ", ".join(f"{channel.name} ({channel.stamps_ns.size} rows)" for channel in candidates)
    what = "IMUs" if role == "imu" else f"channels for {role}"
    hint = f"--map {role}=... takes another"
    warnings.append(Warn("several-channels", f"{len(candidates)} {what}: {names}; {best.name} is used", hint))
    return best


def _beside(imu: Channel, halves: list[Channel]) -> list[Warn]:
    """Say that an IMU is used and not the gyro or accelerometer of another."""
    what = "IMUs" if len(halves) > 1 else "gyros" if halves[0].role == "gyro" else "accelerometers"
    names = " with ".join(f"{channel.name} ({channel.stamps_ns.size} rows)" for channel in halves)
    message = f"2 {what}: {imu.name} ({imu.stamps_ns.size} rows), {names}; {imu.name} is used"
    hint = "--map gyro=... --map accel=... takes the other" if len(halves) > 1 else "leave out the other"
    return [Warn("several-channels", message, hint)]


def _file(channel: Channel) -> str:
    """Return the file that a channel is named after, where several have its name."""
    return channel.name.partition(":")[0] if ":" in channel.name else ""


def _space(channel: Channel) -> str:
    """Return the name space of a topic."""
    return channel.name.rpartition("/")[0]


def _no_imu(recordings: Sequence[Recording], found: Sequence[Channel], cast: Mapping[str, Channel]) -> tuple[str, str]:
    files = ", ".join(str(recording.source) for recording in recordings)
    if not found:
        unread = {name: kind for recording in recordings for name, kind in recording.other.items()}
        return f"{files}: {_nothing(unread)}", _way_out(unread)
    half = next((role for role in ("gyro", "accel") if role in cast), None)
    if half is not None:
        other = "accelerometer" if half == "gyro" else "gyro"
        named = f'--columns "OLD={COLUMNS[other[:5]][0]} [UNIT],..."'
        return (
            f"{files}: no {other} beside {cast[half].name}",
            f"hand in the file that holds it, or map {other[:5]} to its channel; columns of other names: {named}",
        )
    names = ", ".join(f"{channel.name} ({channel.role or channel.kind})" for channel in found)
    return f"{files}: no IMU; found {names}", "attest needs gyro and accelerometer: map imu to their channel"


def _nothing(other: Mapping[str, str], count: int = 5) -> str:
    """Say that no channel is of a kind that is read, and which there are."""
    shown = ", ".join(f"{name} {kind}" for name, kind in list(other.items())[:count])
    more = f" and {len(other) - count} more" if len(other) > count else ""
    return f"no channel that attest reads; found {shown + more or 'no channel at all'}"


def _way_out(other: Mapping[str, str]) -> str:
    kinds = " ".join(other.values())
    if "(protobuf)" in kinds or "(json)" in kinds:
        return "types of one's own in protobuf and JSON are not read: record a sensor_msgs/Imu, or export a CSV"
    return "attest needs gyro and accelerometer, in ROS a sensor_msgs/Imu"
