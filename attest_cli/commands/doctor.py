"""``attest doctor``: every fault found in a log, where, how bad, and the option that mends it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from .console import LOST, OK, Console
from .options import (
    OUTPUT,
    Calibration,
    Clock,
    Columns,
    Config,
    End,
    Imu,
    Json,
    Logs,
    Progress,
    Quiet,
    SampleRate,
    Start,
    StopFile,
    TimeUnit,
    Verbose,
    of,
    reading,
)
from .options import Mapping as Roles

if TYPE_CHECKING:
    from ..diagnose import Finding

REFUSED = 1
HEAD = ("group", "check", "verdict", "found")


def doctor(
    logs: Logs,
    config: Config = None,
    mapping: Roles = None,
    imu: Imu = None,
    clock: Clock = None,
    columns: Columns = None,
    time_unit: TimeUnit = None,
    sample_rate: SampleRate = None,
    start: Start = None,
    end: End = None,
    stops: StopFile = None,
    calibration: Calibration = None,
    strict: Annotated[bool, of(OUTPUT, "--strict", "Exit code 3 on any warning.")] = False,
    json: Json = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
    progress: Progress = "auto",
) -> int:
    """Check a log: every fault, where it is, how bad, and what mends it; and every check that found nothing.

    Exit code 0: clean, or warnings only; 1: refused; 2: usage; 3: data was lost, or the log contradicts itself.
    """
    overrides = {
        **reading(mapping, imu, clock, columns, time_unit, sample_rate, start, end, stops),
        "imu.calibration": calibration,
    }
    console = Console(json=json, verbose=verbose, quiet=quiet, progress=progress)
    return run(logs, config, overrides, console, strict=strict)


def run(
    logs: Sequence[Path], config: Path | None, overrides: Mapping[str, Any], console: Console, *, strict: bool
) -> int:
    """Print one row per check, below it what mends it, and count them."""
    from ..diagnose import FAULT, WARNING, diagnose
    from ..settings import load_settings

    effective = load_settings(config, logs[0], overrides)

    with console.working() as progress:
        found = diagnose(logs, effective, progress)
    faults, warnings = (sum(f.verdict == verdict for f in found) for verdict in (FAULT, WARNING))
    if console.json:
        console.data([_facts(f) for f in found])
    else:
        console.table([HEAD, *(row for f in found for row in _rows(f))])
    level = "FAIL" if faults else "WARN" if warnings else "PASS"
    _sum_up(len(found), faults, warnings, level, console)
    if any(f.refused for f in found):
        return REFUSED
    return LOST if faults or (strict and warnings) else OK


def _facts(finding: Finding) -> dict[str, str]:
    """A finding as data."""
    return {name: getattr(finding, name) for name in ("group", "check", "verdict", "found", "mends")}


def _rows(finding: Finding) -> list[tuple[str, ...]]:
    """A finding as rows of the table: what was found, and what mends it."""
    rows: list[tuple[str, ...]] = [(finding.group, finding.check, finding.verdict, finding.found)]
    return [*rows, ("", "", "mends", finding.mends)] if finding.mends else rows


def _sum_up(checks: int, faults: int, warnings: int, level: str, console: Console) -> None:
    from ..figures.words import counted
    from .console import MARKS

    told = f"{counted(checks, 'check')}: {counted(faults, 'fault').lower()}, {counted(warnings, 'warning').lower()}"
    console.say((f"{MARKS[level]} ", level), (told, "strong"))
