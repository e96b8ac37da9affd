"""Options that several commands share, their checks, and the settings they stand for. Imports typer alone."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from ..errors import AttestError

READ, METHOD, OUTPUT, TALK = "What is read", "Method", "Output", "What is said"
"""Panels of the help, in this order."""

LOG_SUFFIXES = (".csv", ".parquet", ".mcap")
"""Formats of the logs that attest writes."""


def of(panel: str, flags: str, words: str, **more: Any) -> Any:
    """Option of a panel: its flags between blanks, its help, and what else typer should know."""
    return typer.Option(*flags.split(), help=words, rich_help_panel=panel, **more)


def file_of(panel: str, flags: str, words: str, **more: Any) -> Any:
    """Option that names an input file; whether it can be read is told in our own words later."""
    return of(panel, flags, words, **{"metavar": "FILE", "readable": False, **more})


def _once(logs: list[Path]) -> list[Path]:
    """Refuse a log that is given twice: it would be two sensors of one name."""
    seen: dict[str, Path] = {}
    for log in logs:
        first = seen.setdefault(os.path.realpath(log), log)
        if first is not log:
            raise AttestError(f"{log}: the same file as {first}", "name each log once")
    return logs


def _only(logs: list[Path] | None) -> list[Path]:
    """Take the only log of the current folder where none is given; else it is a question of usage which."""
    if logs:
        return _once(logs)
    from .calibrate_bias import logs_here

    found = logs_here(Path())
    if len(found) != 1:
        names = ", ".join(path.name for path in found)
        raise typer.BadParameter(f"{len(found)} logs here, name one: {names}" if found else "no log here, name one")
    return found


def _pairs(values: list[str] | None) -> list[str]:
    """Check for ROLE=CHANNEL."""
    for value in values or []:
        role, _, channel = value.partition("=")
        if not role or not channel:
            raise typer.BadParameter(f"{value!r} is not ROLE=CHANNEL, such as sun=/sun")
    return values or []


def _columns(values: list[str] | None) -> list[str]:
    """Check for names, OLD=NAME pairs, or TYPE: before names; not two of them in one."""
    for value in values or []:
        if not all(part.strip() for part in value.split(",")):
            raise typer.BadParameter(f'{value!r} has an empty name; "-" stands for a column that is not used')
        pairs = [part.count("=") for part in value.split(",")]
        if any(pairs) and set(pairs) != {1}:
            raise typer.BadParameter(f"{value!r} mixes names with OLD=NAME")
    return values or []


def place(name: str) -> Path:
    """Refuse an empty name, which would mean this folder."""
    if not name.strip():
        raise typer.BadParameter("the name is empty")
    return Path(name)


def log_file(name: str) -> Path:
    """Take the name of a log in one of the formats that attest writes."""
    path = place(name)
    if path.suffix.lower() not in LOG_SUFFIXES:
        raise typer.BadParameter(f"{name!r} should end in {', '.join(LOG_SUFFIXES)}")
    return path


def offset(value: str) -> str:
    """Take ``auto`` or seconds."""
    if value != "auto" and not _is_number(value):
        raise typer.BadParameter(f"{value!r} is neither auto nor seconds")
    return value


def span(value: str) -> str:
    """Take a span such as ``10s`` or ``100m``."""
    if value[-1:] not in {"s", "m"} or not _is_number(value[:-1]) or float(value[:-1]) <= 0.0:
        raise typer.BadParameter(f"{value!r} is neither seconds (10s) nor metres (100m)")
    return value


def _is_number(text: str) -> bool:
    """Tell whether a text is a number that a clock or a path can have."""
    try:
        return abs(float(text)) < 9e9
    except ValueError:
        return False


Logs = Annotated[
    list[Path],
    typer.Argument(
        metavar="LOG",
        readable=False,
        callback=_once,
        help="CSV, Parquet, MCAP, ROS bag or ULog; several are the files of one drive.",
    ),
]
LogsOrOnly = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="[LOG]...",
        readable=False,
        callback=_only,
        help="Static log, or drive with stops; default: the only log here. Several are the files of one drive.",
    ),
]
Config = Annotated[Path | None, file_of(READ, "--config -c", "Settings; default: attest.toml beside the log.")]
Mapping = Annotated[
    list[str] | None, of(READ, "--map", "Use CHANNEL as ROLE.", metavar="ROLE=CHANNEL", callback=_pairs)
]
Imu = Annotated[str | None, of(READ, "--imu", "The IMU to use.", metavar="TOPIC")]
Clock = Annotated[Literal["header", "log", "publish"] | None, of(READ, "--time", "Which stamp of a message counts.")]
Columns = Annotated[
    list[str] | None,
    of(
        READ,
        "--columns",
        "Of a text log: all names in order (t_ms,gyro_x_dps,-), or other names (OLD=gyro_x_dps), or those of each type "
        "of row (g:type,t,gyro_x,gyro_y,gyro_z, once per type). A unit may also stand in brackets behind a name.",
        metavar="NAMES",
        callback=_columns,
    ),
]
TimeUnit = Annotated[
    Literal["s", "ms", "us", "ns", "min", "h", "d"] | None, of(READ, "--time-unit", "Of the time column of a text log.")
]
SampleRate = Annotated[
    float | None,
    of(READ, "--sample-rate", "Rows per second of a text log with a counter, or nothing, for time.", metavar="HZ"),
]
Start = Annotated[float | None, of(READ, "--start", "Start of the window, s since start.", metavar="S")]
End = Annotated[float | None, of(READ, "--end", "End of the window, s since start.", metavar="S")]
StopFile = Annotated[Path | None, file_of(METHOD, "--stops", "CSV with start_s, end_s instead of the detector.")]
Calibration = Annotated[
    Path | None,
    file_of(
        METHOD, "--calibration", "calibration.toml of attest calibrate-bias; settings that are stated beat it."
    ),
]  # fmt: skip
Output = Annotated[Path | None, of(OUTPUT, "--output -o", "Result folder.", metavar="DIR", parser=place)]
Overwrite = Annotated[bool, of(OUTPUT, "--overwrite", "Replace an existing result.")]
Theme = Annotated[Literal["light", "dark"] | None, of(OUTPUT, "--theme", "Colours of the pages.")]
Json = Annotated[bool, of(TALK, "--json", "Print the result as JSON on stdout.")]
Verbose = Annotated[bool, of(TALK, "--verbose -v", "Say more.")]
Quiet = Annotated[bool, of(TALK, "--quiet -q", "Say only warnings and errors.")]
Progress = Annotated[
    Literal["auto", "none", "json"], of(TALK, "--progress", "Progress on stderr; auto: a bar on a terminal.")
]


def reading(
    mapping: list[str] | None,
    imu: str | None,
    clock: str | None,
    columns: list[str] | None,
    time_unit: str | None,
    sample_rate: float | None,
    start: float | None = None,
    end: float | None = None,
    stops: Path | None = None,
) -> dict[str, object]:
    """Settings that say what is read of a log."""
    pairs = (value.partition("=") for value in mapping or [])
    return {
        **{f"map.{role}": channel for role, _, channel in pairs},
        **({"imu.channel": imu} if imu else {}),
        "time.source": clock,
        **_table(columns or []),
        "table.time_unit": time_unit,
        "table.sample_rate_hz": sample_rate,
        "time.start_s": start,
        "time.end_s": end,
        "stops.file": stops,
    }


def _table(columns: list[str]) -> dict[str, object]:
    """Settings of a text table: names in order, other names, or names of each type of row."""
    in_order: tuple[str, ...] = ()
    other: dict[str, str] = {}
    rows: dict[str, tuple[str, ...]] = {}
    for value in columns:
        typed = re.match(r"\s*([^,:=\[\s]+):(?!:)", value)
        if "=" in value:
            other |= {old.strip(): new.strip() for old, _, new in (pair.partition("=") for pair in value.split(","))}
        elif typed:
            rows[typed[1]] = tuple(name.strip() for name in value[typed.end() :].split(","))
        else:
            in_order = tuple(name.strip() for name in value.split(","))
    return {"table.columns": in_order or None, "table.names": other or None, "table.rows": rows or None}
