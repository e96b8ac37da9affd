"""The command line: commands, options, help. Imports typer alone; each command loads what it needs when it runs."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal

import typer

from .errors import AttestError

app = typer.Typer(
    name="attest",
    help="The best attitude and position track a recorded drive can give, with a sigma that holds.",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

_SENSORS = ("sun", "compass", "magnetometer", "odometry", "gps")
_READ, _METHOD, _OUTPUT, _TALK = "What is read", "Method", "Output", "What is said"


def _mapping(values: list[str] | None) -> list[str]:
    for value in values or []:
        role, _, channel = value.partition("=")
        if not role or not channel:
            raise typer.BadParameter(f"{value!r} is not ROLE=CHANNEL, such as sun=/sun")
    return values or []


def _once(logs: list[Path]) -> list[Path]:
    """Refuse a log that is given twice: it would be two sensors of one name."""
    seen: dict[str, Path] = {}
    for log in logs:
        first = seen.setdefault(os.path.realpath(log), log)
        if first is not log:
            raise AttestError(f"{log}: the same file as {first}", "name each log once")
    return logs


def _place(name: str) -> Path:
    """Refuse an empty name, which would mean this folder."""
    if not name.strip():
        raise typer.BadParameter("the name is empty")
    return Path(name)


def _version(value: bool) -> None:
    if value:
        from . import __version__

        typer.echo(f"attest {__version__}")
        raise typer.Exit


Logs = Annotated[
    list[Path],
    typer.Argument(
        metavar="LOG", readable=False, callback=_once, help="CSV, Parquet or MCAP; several are the files of one drive."
    ),
]
Config = Annotated[
    Path | None,
    typer.Option(
        "--config",
        "-c",
        metavar="FILE",
        readable=False,
        help="Settings; default: attest.toml beside the log.",
        rich_help_panel=_READ,
    ),
]
Mapping = Annotated[
    list[str] | None,
    typer.Option(
        "--map", metavar="ROLE=CHANNEL", callback=_mapping, help="Use CHANNEL as ROLE.", rich_help_panel=_READ
    ),
]
Imu = Annotated[str | None, typer.Option("--imu", metavar="TOPIC", help="The IMU to use.", rich_help_panel=_READ)]
Clock = Annotated[
    Literal["header", "log", "publish"] | None,
    typer.Option("--time", help="Which stamp of a message counts.", rich_help_panel=_READ),
]
Start = Annotated[
    float | None,
    typer.Option("--start", metavar="S", help="Start of the window, s since start.", rich_help_panel=_READ),
]
End = Annotated[
    float | None, typer.Option("--end", metavar="S", help="End of the window, s since start.", rich_help_panel=_READ)
]
StopFile = Annotated[
    Path | None,
    typer.Option(
        "--stops",
        metavar="FILE",
        readable=False,
        help="CSV with start_s, end_s instead of the detector.",
        rich_help_panel=_METHOD,
    ),
]
Output = Annotated[
    Path | None,
    typer.Option("--output", "-o", metavar="DIR", parser=_place, help="Result folder.", rich_help_panel=_OUTPUT),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace an existing result.", rich_help_panel=_OUTPUT)]
Theme = Annotated[
    Literal["light", "dark"] | None, typer.Option("--theme", help="Colours of the pages.", rich_help_panel=_OUTPUT)
]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON on stdout.", rich_help_panel=_TALK)]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Say more.", rich_help_panel=_TALK)]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Say only warnings and errors.", rich_help_panel=_TALK)]
Progress = Annotated[
    Literal["auto", "none", "json"],
    typer.Option("--progress", help="Progress on stderr; auto: a bar on a terminal.", rich_help_panel=_TALK),
]


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None: ...


@app.command()
def smooth(
    logs: Logs,
    config: Config = None,
    mapping: Mapping = None,
    imu: Imu = None,
    clock: Clock = None,
    start: Start = None,
    end: End = None,
    stops: StopFile = None,
    filter_: Annotated[
        Literal["auto", "indirect"] | None, typer.Option("--filter", help="Forward filter.", rich_help_panel=_METHOD)
    ] = None,
    smoother: Annotated[
        Literal["two-filter", "rts", "paper", "none"] | None,
        typer.Option("--smoother", help="Backward pass and how both are joined.", rich_help_panel=_METHOD),
    ] = None,
    absolute: Annotated[
        Literal["auto", "stops", "always"] | None,
        typer.Option("--absolute", help="When absolute sensors count.", rich_help_panel=_METHOD),
    ] = None,
    iterations: Annotated[
        str | None, typer.Option("--iterations", metavar="auto|N", help="Gauss-Newton passes.", rich_help_panel=_METHOD)
    ] = None,
    position: Annotated[
        Literal["auto", "strapdown", "literal", "odometry", "none"] | None,
        typer.Option("--position", help="How position is made.", rich_help_panel=_METHOD),
    ] = None,
    body: Annotated[
        Literal["auto", "imu", "vehicle"] | None,
        typer.Option("--body", help="Axes of the track.", rich_help_panel=_METHOD),
    ] = None,
    stop_threshold_deg: Annotated[
        float | None,
        typer.Option("--stop-threshold-deg", help="Sigma at which to advise a stop.", rich_help_panel=_METHOD),
    ] = None,
    output: Output = None,
    overwrite: Overwrite = False,
    formats: Annotated[
        str | None,
        typer.Option("--format", metavar="F,F", help="Of the track: parquet, csv, tum, mcap.", rich_help_panel=_OUTPUT),
    ] = None,
    frame: Annotated[
        Literal["enu", "ned"] | None,
        typer.Option("--frame", help="World axes of the outputs.", rich_help_panel=_OUTPUT),
    ] = None,
    theme: Theme = None,
    max_sigma_attitude_deg: Annotated[
        float | None,
        typer.Option("--max-sigma-attitude-deg", help="Gate: exit code 3 where passed.", rich_help_panel=_OUTPUT),
    ] = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit code 3 on any warning or doubt.", rich_help_panel=_OUTPUT)
    ] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Print the plan only.", rich_help_panel=_TALK)] = False,
    json: Json = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
    progress: Progress = "auto",
) -> int:
    """Smooth a drive: attitude and position with sigmas, and a report.

    Exit code 0: done; 1: refused or failed; 2: usage; 3: done, but data was lost, a gate or the verdict failed.
    """
    from .commands import smooth as command
    from .commands.console import Console

    overrides = {
        **_reading(mapping, imu, clock, start, end, stops),
        "smoothing.filter": filter_,
        "smoothing.smoother": smoother,
        "smoothing.absolute": absolute,
        "smoothing.iterations": iterations,
        "smoothing.position": position,
        "smoothing.stop_threshold_deg": stop_threshold_deg,
        "body.axes": body,
        "world.frame": frame,
        "output.formats": formats,
        "output.theme": theme,
        "gate.max_sigma_attitude_deg": max_sigma_attitude_deg,
    }
    console = Console(json=json, verbose=verbose, quiet=quiet, progress=progress)
    if dry_run:
        return command.plan(logs, config, overrides, console)
    return command.run(logs, config, overrides, output, console, overwrite=overwrite, strict=strict)


@app.command()
def report(
    results: Annotated[
        list[Path] | None,
        typer.Argument(metavar="RESULT", readable=False, help="Result folders; default: the newest *.attest here."),
    ] = None,
    theme: Theme = None,
    json: Json = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
    progress: Progress = "auto",
) -> int:
    """Draw the pages of a result folder again; no raw log is needed."""
    from .commands import report as command
    from .commands.console import Console

    return command.run(results or [], theme, Console(json=json, verbose=verbose, quiet=quiet, progress=progress))


@app.command()
def info(
    logs: Logs,
    config: Config = None,
    mapping: Mapping = None,
    imu: Imu = None,
    clock: Clock = None,
    json: Json = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> int:
    """Show what a log holds: channels, types, rates, spans, gaps, units, and what would be used as what."""
    from .commands import info as command
    from .commands.console import Console

    console = Console(json=json, verbose=verbose, quiet=quiet)
    return command.run(logs, config, _reading(mapping, imu, clock), console)


@app.command()
def segment(
    logs: Logs,
    config: Config = None,
    mapping: Mapping = None,
    imu: Imu = None,
    clock: Clock = None,
    start: Start = None,
    end: End = None,
    stops: StopFile = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="PNG",
            parser=_place,
            help="Picture; default: LOG.stops.png here.",
            rich_help_panel=_OUTPUT,
        ),
    ] = None,
    overwrite: Overwrite = False,
    theme: Theme = None,
    json: Json = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> int:
    """Split a log into stops and motions: a table and a picture."""
    from .commands import segment as command
    from .commands.console import Console

    overrides = {**_reading(mapping, imu, clock, start, end, stops), "output.theme": theme}
    console = Console(json=json, verbose=verbose, quiet=quiet)
    return command.run(logs, config, overrides, output, console, overwrite=overwrite)


@app.command()
def simulate(
    scenario: Annotated[
        Literal["rover"], typer.Argument(help="rover: stop-and-go over rough ground, with a sun sensor.")
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            parser=_place,
            help="NAME.csv, .mcap or .parquet; a bare NAME writes all three. Default: the scenario's name.",
            rich_help_panel=_OUTPUT,
        ),
    ] = None,
    overwrite: Overwrite = False,
    seed: Annotated[int, typer.Option("--seed", min=0, help="The same seed gives the same drive.")] = 1999,
    duration: Annotated[float, typer.Option("--duration", metavar="S", min=1, help="Length of the drive, s.")] = 600.0,
    rate: Annotated[float, typer.Option("--rate", metavar="HZ", min=1, help="IMU samples per second.")] = 100.0,
    sensors: Annotated[
        str,
        typer.Option("--sensors", metavar="A,B", help="Of sun, compass, magnetometer, odometry, gps."),
    ] = "sun",
    motion: Annotated[
        tuple[float, float], typer.Option("--motion", metavar="MIN MAX", help="Length of the motions, s.")
    ] = (60.0, 300.0),
    noise: Annotated[
        Literal["S1", "S2"], typer.Option("--noise", help="S2: the accelerometer has a bias of 0.02 m/s^2.")
    ] = "S1",
    variant: Annotated[
        Literal["nominal", "slow", "slow-no-vibration", "idle-engine", "biased", "noisy"],
        typer.Option("--variant", help="How hard the stops are to find."),
    ] = "nominal",
    json: Json = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> int:
    """Make a log with its truth beside it."""
    from .commands import simulate as command
    from .commands.console import Console

    named = [name.strip() for name in sensors.split(",") if name.strip()]
    unknown = sorted(set(named) - set(_SENSORS))
    if unknown:
        raise typer.BadParameter(f"{unknown[0]!r} is none of {', '.join(_SENSORS)}", param_hint="--sensors")
    options: dict[str, object] = {
        "seed": seed,
        "duration_s": duration,
        "rate_hz": rate,
        "scenario": noise,
        "variant": variant,
    }
    options |= {"motion_s": motion, **{name: name in named for name in _SENSORS}}
    console = Console(json=json, verbose=verbose, quiet=quiet)
    return command.run(scenario, output or Path(scenario), options, console, overwrite=overwrite)


def _reading(
    mapping: list[str] | None,
    imu: str | None,
    clock: str | None,
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
        "time.start_s": start,
        "time.end_s": end,
        "stops.file": stops,
    }
