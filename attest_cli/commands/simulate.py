"""``attest simulate``: a log with its truth beside it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .console import OK, Console


def run(scenario: str, output: Path, options: Mapping[str, Any], console: Console, *, overwrite: bool) -> int:
    """Write the log, its truth and the ``attest.toml`` that goes with it."""
    from .. import pipeline

    files = pipeline.simulate(scenario, output, dict(options), overwrite)
    if console.json:
        console.data([str(file) for file in files])
    for file in files:
        console.say(("→ ", "mute"), str(file))
    return OK
