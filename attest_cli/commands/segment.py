"""``attest segment``: stops and motions as a table and a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..settings import load_settings
from .console import LOST, OK, Console


def run(
    logs: Sequence[Path],
    config: Path | None,
    overrides: Mapping[str, Any],
    output: Path | None,
    console: Console,
    *,
    overwrite: bool,
) -> int:
    """Split the log, write the picture of the detector, print the table."""
    effective = load_settings(config, logs[0], overrides)
    picture = output or Path(f"{logs[0].stem}.stops.png")
    from .. import pipeline
    from ..figures.words import clock, counted, duration

    found = pipeline.segments(logs, effective, picture, overwrite)
    rows = found["segments"]
    if console.json:
        console.data(found)
    else:
        table = [
            (
                str(row["index"]),
                row["kind"],
                clock(row["start_s"], 1),
                clock(row["end_s"], 1),
                duration(row["duration_s"]),
            )
            for row in rows
        ]
        console.table([("index", "kind", "start", "end", "duration"), *table], right="rlrrr")
    for warning in found["warnings"]:
        console.warn(warning["message"], warning["hint"])
    stops = sum(row["kind"] == "stop" for row in rows)
    console.say((f"{counted(stops, 'stop')}, {counted(len(rows) - stops, 'motion').lower()}", "strong"))
    if picture.is_file():
        console.say(("→ ", "mute"), str(picture))
    return LOST if any(warning["lost"] for warning in found["warnings"]) else OK
