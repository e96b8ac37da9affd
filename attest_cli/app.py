"""The command line: commands, options, help. Imports typer alone; each command loads what it needs when it runs."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any, Literal

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
_ROVER, _CHARLY, _WALKING, _GYROSTAR = "Rover only", "Charly only", "Walking only", "Gyrostar only"
_ROVER_DRIVE: dict[str, object] = {
    "duration_s": 600.0, "rate_hz": 100.0, "scenario": "S1", "variant": "nominal", "motion_s": (60.0, 300.0),
}  # fmt: skip


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


def _only(logs: list[Path] | None) -> list[Path]:
    """Take the only log of the current folder where none is given; else it is a question of usage which."""
    if logs:
        return _once(logs)
    from .commands.calibrate_bias import logs_here

    found = logs_here(Path())
    if len(found) != 1:
        names = ", ".join(path.name for path in found)
        raise typer.BadParameter(f"{len(found)} logs here, name one: {names}" if found else "no log here, name one")
    return found


def _place(name: str) -> Path:
    """Refuse an empty name, which would mean this folder."""
    if not name.strip():
        raise typer.BadParameter("the name is empty")
    return Path(name)


def _offset(value: str) -> str:
    """Take ``auto`` or seconds."""
    if value != "auto" and not _is_number(value):
        raise typer.BadParameter(f"{value!r} is neither auto nor seconds")
    return value


def _span(value: str) -> str:
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
Calibration = Annotated[
    Path | None,
    typer.Option(
        "--calibration",
        metavar="FILE",
        readable=False,
        help="calibration.toml of attest calibrate-bias; settings that are stated beat it.",
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
    calibration: Calibration = None,
    filter_: Annotated[
        Literal["auto", "indirect", "navigation", "tilt-ekf", "pseudo-linear", "projected", "geometric", "heading"]
        | None,
        typer.Option("--filter", help="Forward filter.", rich_help_panel=_METHOD),
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
        "imu.calibration": calibration,
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


@app.command("calibrate-bias")
def calibrate_bias(
    logs: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[LOG]...",
            readable=False,
            callback=_only,
            help="Static log, or drive with stops; default: the only log here. Several are the files of one drive.",
        ),
    ] = None,
    config: Config = None,
    mapping: Mapping = None,
    imu: Imu = None,
    clock: Clock = None,
    start: Start = None,
    end: End = None,
    stops: StopFile = None,
    model: Annotated[
        Literal["auto", "constant", "ramp", "exponential", "temperature", "random-walk"],
        typer.Option("--model", help="Of the bias; auto: the best of a static log, else random-walk.",
                     rich_help_panel=_METHOD),
    ] = "auto",
    output: Output = None,
    overwrite: Overwrite = False,
    theme: Theme = None,
    json: Json = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
    progress: Progress = "auto",
) -> int:  # fmt: skip
    """Find the gyro's bias and noise from a log at rest, or from the stops of a drive.

    Writes calibration.toml for attest smooth --calibration, Kalibr's imu.yaml, and a page.
    """
    from .commands import calibrate_bias as command
    from .commands.console import Console

    overrides = {**_reading(mapping, imu, clock, start, end, stops), "output.theme": theme}
    console = Console(json=json, verbose=verbose, quiet=quiet, progress=progress)
    return command.run(logs or [], config, overrides, model, output, console, overwrite=overwrite)


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
def evaluate(
    result: Annotated[
        Path, typer.Argument(metavar="RESULT", readable=False, help="Result folder, or a track of any format.")
    ],
    reference: Annotated[
        Path,
        typer.Option(
            "--reference",
            metavar="FILE",
            readable=False,
            help="Track or truth (Parquet, CSV), TUM, EuRoC ground truth, MCAP with odometry, poses or orientations.",
            rich_help_panel=_READ,
        ),
    ],
    channel: Annotated[
        str | None,
        typer.Option("--channel", metavar="TOPIC", help="Of a reference in MCAP.", rich_help_panel=_READ),
    ] = None,
    align: Annotated[
        Literal["auto", "none", "yaw", "full"],
        typer.Option(
            "--align",
            help="Turn (and shift) the reference to fit; auto: yaw where heading is relative or the reference has a "
            "datum of its own, else none.",
            rich_help_panel=_METHOD,
        ),
    ] = "auto",
    align_body: Annotated[
        bool, typer.Option("--align-body", help="Also turn the body axes of the reference.", rich_help_panel=_METHOD)
    ] = False,
    time_offset: Annotated[
        str,
        typer.Option(
            "--time-offset",
            metavar="auto|S",
            callback=_offset,
            help="Seconds to add to the stamps of the result; auto: as fitted. The fit is told in any case.",
            rich_help_panel=_METHOD,
        ),
    ] = "0",
    moving_only: Annotated[
        bool, typer.Option("--moving-only", help="Judge motion only.", rich_help_panel=_METHOD)
    ] = False,
    delta: Annotated[
        str,
        typer.Option(
            "--delta",
            metavar="Ns|Nm",
            callback=_span,
            help="Span of the relative position error: seconds or metres of path.",
            rich_help_panel=_METHOD,
        ),
    ] = "10s",
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="DIR",
            parser=_place,
            help="Folder of evaluation.json and 09-evaluate.png; default: with the result.",
            rich_help_panel=_OUTPUT,
        ),
    ] = None,
    overwrite: Overwrite = False,
    theme: Theme = None,
    json: Json = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> int:
    """Judge a result by a reference: errors of attitude and position, and whether the sigmas hold."""
    from .commands import evaluate as command
    from .commands.console import Console

    options: dict[str, object] = {
        "align": align,
        "align_body": align_body,
        "time_offset": time_offset if time_offset == "auto" else float(time_offset),
        "moving_only": moving_only,
        "delta": float(delta[:-1]),
        "delta_unit": delta[-1],
    }
    console = Console(json=json, verbose=verbose, quiet=quiet)
    return command.run(result, reference, options, channel, output, theme, console, overwrite=overwrite)


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


def _of(panel: str, flag: str, words: str, default: str, metavar: str | None = None, least: int | None = None) -> Any:
    """Option of one scenario; its default is the scenario's own."""
    return typer.Option(flag, help=words, show_default=default, metavar=metavar, min=least, rich_help_panel=panel)


@app.command()
def simulate(
    scenario: Annotated[
        Literal["rover", "charly", "walking", "gyrostar"],
        typer.Argument(
            metavar="SCENARIO",
            help="rover: stop-and-go on rough ground, with a sun sensor; charly: a wheel over a plank, with odometry; "
            "walking: a legged robot; gyrostar: a gyro that warms up.",
        ),
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
    duration: Annotated[
        float | None,
        typer.Option(
            "--duration",
            metavar="S",
            min=1,
            help="Length of the drive, s; charly is repeated each minute.",
            show_default="rover and gyrostar 600, walking 120, charly 47",
        ),
    ] = None,
    rate: Annotated[float | None, _of(_ROVER, "--rate", "IMU samples per second.", "100", "HZ", 1)] = None,
    sensors: Annotated[str | None, _of(_ROVER, "--sensors", f"Of {', '.join(_SENSORS)}.", "sun", "A,B")] = None,
    motion: Annotated[
        tuple[float, float] | None, _of(_ROVER, "--motion", "Length of the motions, s.", "60 300", "MIN MAX")
    ] = None,
    noise: Annotated[
        Literal["S1", "S2"] | None,
        _of(_ROVER, "--noise", "S2: the accelerometer has a bias of 0.02 m/s^2.", "S1"),
    ] = None,
    variant: Annotated[
        Literal["nominal", "slow", "slow-no-vibration", "idle-engine", "biased", "noisy"] | None,
        _of(_ROVER, "--variant", "How hard the stops are to find.", "nominal"),
    ] = None,
    turn_deg: Annotated[
        float | None, _of(_CHARLY, "--turn-deg", "Turn between the two straights.", "180", "DEG")
    ] = None,
    case: Annotated[
        Literal["A", "B", "C"] | None, _of(_WALKING, "--case", "A trot, B stop-and-go, C impulses.", "A")
    ] = None,
    bias_deg_s: Annotated[
        float | None, _of(_WALKING, "--bias-deg-s", "Bias of each gyro axis, either sign.", "0.05", "DEG/S")
    ] = None,
    course: Annotated[
        Literal["truck", "platform", "static"] | None, _of(_GYROSTAR, "--course", "What turns the gyro.", "truck")
    ] = None,
    stops: Annotated[
        bool, typer.Option("--stops", help="Stop for 10 s each minute.", rich_help_panel=_GYROSTAR)
    ] = False,
    scatter: Annotated[
        float | None, _of(_GYROSTAR, "--scatter", "Spread of the bias's C1, C2 and T, such as 0.15.", "0", "SHARE")
    ] = None,
    random_walk_deg_s: Annotated[
        float | None,
        _of(_GYROSTAR, "--random-walk-deg-s", "Random walk of the bias in 1 s, such as 5e-4.", "0", "DEG/S"),
    ] = None,
    json: Json = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> int:
    """Make a log with its truth beside it."""
    from .commands import simulate as command
    from .commands.console import Console

    asked: dict[str, dict[str, object]] = {
        "--duration": {"duration_s": duration},
        "--rate": {"rate_hz": rate},
        "--motion": {"motion_s": motion},
        "--noise": {"scenario": noise},
        "--variant": {"variant": variant},
        "--sensors": {} if sensors is None else _aiding(sensors),
        "--turn-deg": {"turn_deg": turn_deg},
        "--case": {"case": case},
        "--bias-deg-s": {"bias_deg_s": bias_deg_s},
        "--course": {"course": course},
        "--stops": {"stops": stops or None},
        "--scatter": {"scatter": scatter},
        "--random-walk-deg-s": {"random_walk_deg_s": random_walk_deg_s},
    }
    options: dict[str, object] = {"seed": seed}
    if scenario == "rover":
        options |= {**_ROVER_DRIVE, **_aiding("sun")}
    options |= _fitting(scenario, asked)
    console = Console(json=json, verbose=verbose, quiet=quiet)
    return command.run(scenario, output or Path(scenario), options, console, overwrite=overwrite)


def _aiding(sensors: str) -> dict[str, object]:
    """Which of the rover's sensors a list between commas names."""
    named = {name.strip() for name in sensors.split(",")} - {""}
    unknown = sorted(named - set(_SENSORS))
    if unknown:
        raise typer.BadParameter(f"{unknown[0]!r} is none of {', '.join(_SENSORS)}", param_hint="--sensors")
    return {name: name in named for name in _SENSORS}


def _fitting(scenario: str, asked: dict[str, dict[str, object]]) -> dict[str, object]:
    """Options that were given, refused where the scenario does not know them."""
    from dataclasses import fields

    from .simulate import SCENARIOS

    known = {f.name for f in fields(SCENARIOS[scenario][0])}
    given: dict[str, object] = {}
    for flag, values in asked.items():
        told = {name: value for name, value in values.items() if value is not None}
        if not told.keys() <= known:
            raise typer.BadParameter(f"{scenario} has no such option", param_hint=flag)
        given |= told
    return given


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
