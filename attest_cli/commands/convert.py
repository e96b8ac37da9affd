"""``attest convert``: logs of any kind as one log in attest's own columns or topics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..settings import load_settings
from .console import LOST, OK, Console

if TYPE_CHECKING:
    from ..records import Channel, Warn

SHOWN = 6


def run(
    logs: Sequence[Path],
    config: Path | None,
    overrides: Mapping[str, Any],
    output: Path,
    console: Console,
    *,
    overwrite: bool,
) -> int:
    """Read, bring to the units of attest's own logs, write; say what is not in the new file."""
    settings = load_settings(config, logs[0], overrides).settings
    from ..prepare.canonical import in_canonical_units
    from ..prepare.roles import told as of_files
    from ..prepare.roles import with_named
    from ..readers import read
    from ..records import Recording
    from ..writers.files import check_output
    from ..writers.logs import write_recording

    check_output(output, overwrite=overwrite, inputs=logs)
    recordings = [read(path, settings) for path in logs]
    channels, told = in_canonical_units(with_named(recordings, settings), settings)
    other = {name: kind for recording in recordings for name, kind in recording.other.items()}
    rows = sum(recording.rows for recording in recordings)
    left_out = write_recording(Recording(logs[0], output.suffix[1:], tuple(channels), rows, other), output)
    warnings = [*of_files(recordings), *told]
    written = [channel for channel in channels if channel.name not in left_out]
    if console.json:
        console.data(_facts(output, written, left_out, other, warnings))
    else:
        _table(written, console)
    for warning in warnings:
        console.warn(warning.message, warning.hint)
    _absent("not converted, for they have no role (--map gives one): ", left_out, console)
    _absent("not read: ", [f"{name} ({kind})" if kind != "column" else name for name, kind in other.items()], console)
    console.say(("→ ", "mute"), str(output))
    return LOST if any(warning.lost for warning in warnings) else OK


def _table(channels: Sequence[Channel], console: Console) -> None:
    from ..figures.words import cut, number

    rows = [(cut(c.name, 60), c.role or "orientation of the device", number(c.stamps_ns.size)) for c in channels]
    console.table([("channel", "written as", "rows"), *rows], right="llr")


def _absent(what: str, names: Sequence[str], console: Console) -> None:
    """What is not in the new file, in one line."""
    if names:
        shown = names if console.verbose else names[:SHOWN]
        more = f" and {len(names) - len(shown)} more (-v lists them)" if len(names) > len(shown) else ""
        console.say((what, "mute"), ", ".join(shown) + more)


def _facts(
    output: Path, written: Sequence[Channel], left_out: Sequence[str], other: Mapping[str, str], told: Sequence[Warn]
) -> dict[str, Any]:
    return {
        "file": str(output),
        "channels": [{"name": c.name, "role": c.role, "rows": int(c.stamps_ns.size)} for c in written],
        "not_converted": list(left_out),
        "not_read": dict(other),
        "warnings": [asdict(warning) for warning in told],
    }
