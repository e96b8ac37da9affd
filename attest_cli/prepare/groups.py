"""Several files: the parts of one log, or logs of one sensor."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from contextlib import suppress
from pathlib import Path

from ..errors import AttestError
from ..records import Recording
from ..settings import Settings
from .roles import choose


def whole_logs(recordings: Sequence[Recording], settings: Settings) -> list[list[Recording]]:
    """Group files by log: each that holds an IMU is a log; beside a single such, all others are parts of it.

    Raises
    ------
    AttestError
        If beside several logs there is a file without an IMU: nobody said which of them it is a part of.
    """
    whole: list[Recording] = []
    for recording in recordings:
        with suppress(AttestError):
            choose([recording], settings)
            whole.append(recording)
    if len(whole) < 2:
        return [list(recordings)]
    parts = [recording.source.name for recording in recordings if not any(recording is r for r in whole)]
    if parts:
        raise AttestError(f"{parts[0]}: no IMU in it, but {len(whole)} logs beside it", "calibrate from each log alone")
    return [[recording] for recording in whole]


def files_used(recordings: Sequence[Recording], settings: Settings, roles: Collection[str]) -> list[Path]:
    """Return the files of one log of which a channel plays one of ``roles``."""
    cast = [channel for role, channel in choose(recordings, settings).channels.items() if role in roles]
    return [
        r.source for r in recordings
        if any(part.name == c.name or part.stamps_ns is c.stamps_ns for part in r.channels for c in cast)
    ]  # fmt: skip
