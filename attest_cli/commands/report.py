"""``attest report``: the pages of a result folder, drawn again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..errors import AttestError
from .console import OK, Console


def run(results: Sequence[Path], theme: str | None, console: Console) -> int:
    """Redraw the pages of each result folder; without one, of the newest here."""
    folders = list(results) or [_newest(Path(), console)]
    from .. import pipeline

    drawn: dict[str, list[str]] = {}
    for folder in folders:
        with console.working() as progress:
            pages = pipeline.redraw(folder, theme, progress)
        drawn[str(folder)] = [str(page) for page in pages]
        for page in pages:
            console.say(("→ ", "mute"), str(page))
    if console.json:
        console.data(drawn)
    return OK


def _newest(here: Path, console: Console) -> Path:
    """The ``*.attest`` folder whose report was written last, and say which."""
    found = [report for report in here.glob("*.attest/report.json") if report.is_file()]
    if not found:
        raise AttestError("no result folder here (*.attest)", "name one, or make one with attest smooth LOG")
    newest = max(found, key=lambda report: (report.stat().st_mtime_ns, report.parent.name)).parent
    others = f" of {len(found)}" if len(found) > 1 else ""
    console.say(("newest result here", "mute"), (f"{others}: ", "mute"), f"{newest}")
    return newest
