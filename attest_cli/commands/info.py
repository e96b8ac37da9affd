"""``attest info``: what a log holds, and what would be used as what."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import AttestError
from ..settings import Settings, load_settings
from .console import OK, Console

if TYPE_CHECKING:
    from ..records import Channel, Recording

HEAD = ("channel", "type", "rows", "rate", "from", "to", "gaps", "units", "used as")


def run(logs: Sequence[Path], config: Path | None, overrides: Mapping[str, Any], console: Console) -> int:
    """Print one row per channel, then what should be known; a log that cannot be smoothed is shown, then refused."""
    settings = load_settings(config, logs[0], overrides).settings
    from ..prepare import prepare
    from ..readers import read

    recordings = [read(path, settings) for path in logs]
    found, refusal = _described(recordings, settings)
    warnings = [warning for recording in recordings for warning in recording.warnings]
    if refusal is None:
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
    return OK


def _described(recordings: Sequence[Recording], settings: Settings) -> tuple[list[dict[str, Any]], AttestError | None]:
    """Facts of every channel, with the role it would play; and why none can, where it is so."""
    from ..prepare.roles import choose, joined

    roles: dict[str, list[str]] = {}
    refusal = None
    try:
        for role, channel in choose(recordings, settings).channels.items():
            roles.setdefault(channel.name, []).append(role)
    except AttestError as fault:
        refusal = fault
    channels = joined(recordings)
    start = min((int(c.stamps_ns.min()) for c in channels if c.stamps_ns.size), default=0)
    found = [_facts(channel, roles.get(channel.name, []), start, settings.time.max_gap_s) for channel in channels]
    for recording in recordings:
        found += [{"name": name, "kind": kind, "used_as": "not read"} for name, kind in recording.other.items()]
    return found, refusal


def _facts(channel: Channel, roles: Sequence[str], start_ns: int, max_gap_s: float) -> dict[str, Any]:
    """Rows, rate, span from the start of the log, gaps and stated units of one channel."""
    import numpy as np

    stamps = np.sort(channel.stamps_ns)
    steps = np.diff(stamps) * 1e-9
    period = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
    return {
        "name": channel.name,
        "kind": channel.kind,
        "rows": int(stamps.size),
        "rate_hz": 1.0 / period if period else None,
        "start_s": (int(stamps[0]) - start_ns) * 1e-9 if stamps.size else None,
        "end_s": (int(stamps[-1]) - start_ns) * 1e-9 if stamps.size else None,
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
