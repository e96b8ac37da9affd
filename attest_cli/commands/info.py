"""``attest info``: what a log holds, and what would be used as what."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import AttestError
from ..settings import Settings, load_settings
from .console import LOST, OK, Console

if TYPE_CHECKING:
    from ..readers.mcap_glance import Glance
    from ..records import Channel, Ints, Recording

SURE_RATE = 50
"""Stamps from which a rate is taken; with fewer the times of logging give it."""

HEAD = ("channel", "type", "rows", "rate", "from", "to", "gaps", "units", "used as")


def run(logs: Sequence[Path], config: Path | None, overrides: Mapping[str, Any], console: Console) -> int:
    """Print one row per channel, then what should be known; a log that cannot be smoothed is shown, then refused."""
    settings = load_settings(config, logs[0], overrides).settings
    from ..prepare import prepare
    from ..prepare.roles import told
    from ..readers import read

    glance = None if console.verbose or len(logs) > 1 else _glance(logs[0], settings)
    recordings = [read(path, settings) for path in logs] if glance is None else [glance.recording]
    found, refusal = _described(recordings, settings, () if glance is None else glance.ends.channels)
    warnings = told(recordings)
    if refusal is None and glance is None:
        try:
            warnings = list(prepare(recordings, settings).warnings)
        except AttestError as fault:
            refusal = fault
    if console.json:
        console.data(
            {"files": [_file(r) for r in recordings], "channels": found, "warnings": [asdict(w) for w in warnings]}
        )
    else:
        for recording in recordings:
            console.say(
                (f"{recording.source.name}", "strong"), (f"  {recording.format}, {recording.rows} rows in all", "mute")
            )
            for note in recording.notes:
                if console.verbose or not note.startswith(" "):
                    console.say((f"  {note}", "mute"))
        shown = [channel for channel in found if "rows" in channel or console.verbose] or found
        console.table([HEAD, *map(_row, shown)], right="llrrrrr")
        _unread([channel["name"] for channel in found if channel not in shown], console)
    for warning in warnings:
        console.warn(warning.message, warning.hint)
    if refusal is not None:
        raise refusal
    return LOST if any(warning.lost for warning in warnings) else OK


def _glance(log: Path, settings: Settings) -> Glance | None:
    """Look at a long MCAP file by its index; None where only reading all of it tells what should be known."""
    from ..prepare import prepare
    from ..readers import format_of
    from ..settings.table import Table

    if format_of(log) != "mcap" or settings.table != Table():
        return None
    from ..readers.mcap_glance import glance

    found = glance(log, settings)
    try:
        return None if found is None or prepare([found.head], settings).warnings else found
    except AttestError:
        return None


def _described(
    recordings: Sequence[Recording], settings: Settings, ends: Sequence[Channel]
) -> tuple[list[dict[str, Any]], AttestError | None]:
    """Facts of every channel, with the role it would play; and why none can, where it is so.

    Where the recording has only times of logging, ``ends`` are the channels as read at the ends of the log.
    """
    from ..prepare.roles import choose, joined

    roles: dict[str, list[str]] = {}
    refusal = None
    try:
        for role, channel in choose(recordings, settings).channels.items():
            roles.setdefault(channel.name, []).append(role)
    except AttestError as fault:
        refusal = fault
    channels = joined(recordings)
    exact = {channel.name: channel.stamps_ns for channel in (*channels, *ends)}
    start = min((int(stamps_ns.min()) for stamps_ns in exact.values() if stamps_ns.size), default=0)
    found = [
        _facts(channel, exact[channel.name], roles.get(channel.name, []), start, settings.time.max_gap_s)
        for channel in channels
    ]
    for recording in recordings:
        found += [{"name": name, "kind": kind, "used_as": "not read"} for name, kind in recording.other.items()]
    return found, refusal


def _facts(channel: Channel, exact_ns: Ints, roles: Sequence[str], start_ns: int, max_gap_s: float) -> dict[str, Any]:
    """Rows, rate, span from the start of the log, gaps and stated units of one channel.

    The span is that of the stamps ``exact_ns``, the rate too where they are not few.
    """
    import numpy as np

    stamps, exact = np.sort(channel.stamps_ns), np.sort(exact_ns)
    steps = np.diff(stamps) * 1e-9
    sure = steps if exact.size < SURE_RATE else np.diff(exact) * 1e-9
    period = float(np.median(sure[sure > 0])) if np.any(sure > 0) else 0.0
    return {
        "name": channel.name,
        "kind": channel.kind,
        "rows": int(stamps.size),
        "rate_hz": 1.0 / period if period else None,
        "start_s": (int(exact[0]) - start_ns) * 1e-9 if exact.size else None,
        "end_s": (int(exact[-1]) - start_ns) * 1e-9 if exact.size else None,
        "gaps": int(np.count_nonzero(steps > max(max_gap_s, 5 * period))),
        "units": sorted({unit for unit in channel.units.values() if unit}),
        "used_as": ", ".join(roles) or "not used",
    }


def _row(facts: Mapping[str, Any]) -> tuple[str, ...]:
    from ..figures.words import clock, cut, number

    if "rows" not in facts:
        return (cut(facts["name"], 60), cut(facts["kind"], 40), "", "", "", "", "", "", facts["used_as"])
    rate = f"{facts['rate_hz']:.4g} Hz" if facts["rate_hz"] else ""
    span = ("", "") if facts["start_s"] is None else (clock(facts["start_s"], 1), clock(facts["end_s"], 1))
    units = ", ".join(facts["units"]) or "none stated"
    name, kind = cut(facts["name"], 60), cut(facts["kind"], 40)
    return (name, kind, number(facts["rows"]), rate, *span, str(facts["gaps"]), units, facts["used_as"])


def _unread(names: Sequence[str], console: Console) -> None:
    """What is of no kind that attest reads, in one line."""
    if names:
        some = ", ".join(names[:6]) + (" …" if len(names) > 6 else "")
        console.say(
            ("not read: ", "mute"), some, (f"  ({len(names)} in all; -v lists them)" if len(names) > 6 else "", "mute")
        )


def _file(recording: Recording) -> dict[str, Any]:
    facts = {"path": str(recording.source), "format": recording.format, "rows": recording.rows}
    return {**facts, "notes": list(recording.notes)}
