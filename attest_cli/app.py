"""The command line: commands, options, help. Imports typer alone; each command loads what it needs when it runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from .commands.doctor import doctor
from .commands.options import (
    METHOD,
    OUTPUT,
    READ,
    TALK,
    Calibration,
    Clock,
    Columns,
    Config,
    End,
    Imu,
    Json,
    Logs,
    LogsOrOnly,
    Mapping,
    Output,
    Overwrite,
    Progress,
    Quiet,
    SampleRate,
    Start,
    StopFile,
    Theme,
    TimeUnit,
    Verbose,
    file_of,
    log_file,
    of,
    offset,
    place,
    reading,
    span,
)
from .commands.simulate import simulate

app = typer.Typer(
    name="attest",
    help="The best attitude and position track a recorded drive can give, with a sigma that holds.",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(value: bool) -> None:
    if value:
        from . import __version__

        typer.echo(f"attest {__version__}")
        raise typer.Exit


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
    columns: Columns = None,
    time_unit: TimeUnit = None,
    sample_rate: SampleRate = None,
    start: Start = None,
    end: End = None,
    stops: StopFile = None,
    calibration: Calibration = None,
    filter_: Annotated[
        Literal["auto", "indirect", "navigation", "tilt-ekf", "pseudo-linear", "projected", "geometric", "heading"]
        | None,
        of(METHOD, "--filter", "Forward filter."),
    ] = None,
    smoother: Annotated[
        Literal["two-filter", "rts", "paper", "none"] | None,
        of(METHOD, "--smoother", "Backward pass and how both are joined."),
    ] = None,
    absolute: Annotated[
        Literal["auto", "stops", "always"] | None, of(METHOD, "--absolute", "When absolute sensors count.")
    ] = None,
    iterations: Annotated[str | None, of(METHOD, "--iterations", "Gauss-Newton passes.", metavar="auto|N")] = None,
    position: Annotated[
        Literal["auto", "strapdown", "literal", "odometry", "none"] | None,
        of(METHOD, "--position", "How position is made."),
    ] = None,
    body: Annotated[Literal["auto", "imu", "vehicle"] | None, of(METHOD, "--body", "Axes of the track.")] = None,
    stop_threshold_deg: Annotated[
        float | None, of(METHOD, "--stop-threshold-deg", "Sigma at which to advise a stop.")
    ] = None,
    output: Output = None,
    overwrite: Overwrite = False,
    formats: Annotated[
        str | None, of(OUTPUT, "--format", "Of the track: parquet, csv, tum, mcap.", metavar="F,F")
    ] = None,
    frame: Annotated[Literal["enu", "ned"] | None, of(OUTPUT, "--frame", "World axes of the outputs.")] = None,
    theme: Theme = None,
    max_sigma_attitude_deg: Annotated[
        float | None, of(OUTPUT, "--max-sigma-attitude-deg", "Gate: exit code 3 where passed.")
    ] = None,
    strict: Annotated[bool, of(OUTPUT, "--strict", "Exit code 3 on any warning or doubt.")] = False,
    dry_run: Annotated[bool, of(TALK, "--dry-run", "Print the plan only.")] = False,
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
        **reading(mapping, imu, clock, columns, time_unit, sample_rate, start, end, stops),
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
        return command.plan(logs, config, overrides, console, strict=strict)
    return command.run(logs, config, overrides, output, console, overwrite=overwrite, strict=strict)


@app.command("calibrate-bias")
def calibrate_bias(
    logs: LogsOrOnly = None,
    config: Config = None,
    mapping: Mapping = None,
    imu: Imu = None,
    clock: Clock = None,
    columns: Columns = None,
    time_unit: TimeUnit = None,
    sample_rate: SampleRate = None,
    start: Start = None,
    end: End = None,
    stops: StopFile = None,
    model: Annotated[
        Literal["auto", "constant", "ramp", "exponential", "temperature", "random-walk"],
        of(METHOD, "--model", "Of the bias; auto: the best of a static log, else random-walk."),
    ] = "auto",
    output: Output = None,
    overwrite: Overwrite = False,
    theme: Theme = None,
    json: Json = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
    progress: Progress = "auto",
) -> int:
    """Find the gyro's bias and noise from a log at rest, or from the stops of a drive.

    Writes calibration.toml for attest smooth --calibration, Kalibr's imu.yaml, and a page.
    """
    from .commands import calibrate_bias as command
    from .commands.console import Console

    overrides = {
        **reading(mapping, imu, clock, columns, time_unit, sample_rate, start, end, stops),
        "output.theme": theme,
    }
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
        file_of(
            READ,
            "--reference",
            "Track or truth (Parquet, CSV), TUM, EuRoC ground truth, MCAP with odometry, poses or orientations.",
        ),
    ],
    channel: Annotated[str | None, of(READ, "--channel", "Of a reference in MCAP.", metavar="TOPIC")] = None,
    align: Annotated[
        Literal["auto", "none", "yaw", "full"],
        of(
            METHOD,
            "--align",
            "Turn (and shift) the reference to fit; auto: yaw where heading is relative or the reference has a datum "
            "of its own, else none.",
        ),
    ] = "auto",
    align_body: Annotated[bool, of(METHOD, "--align-body", "Also turn the body axes of the reference.")] = False,
    time_offset: Annotated[
        str,
        of(
            METHOD,
            "--time-offset",
            "Seconds to add to the stamps of the result; auto: as fitted. The fit is told in any case.",
            metavar="auto|S",
            callback=offset,
        ),
    ] = "0",
    moving_only: Annotated[bool, of(METHOD, "--moving-only", "Judge motion only.")] = False,
    delta: Annotated[
        str,
        of(
            METHOD,
            "--delta",
            "Span of the relative position error: seconds or metres of path.",
            metavar="Ns|Nm",
            callback=span,
        ),
    ] = "10s",
    output: Annotated[
        Path | None,
        of(
            OUTPUT,
            "--output -o",
            "Folder of evaluation.json and 09-evaluate.png; default: with the result.",
            metavar="DIR",
            parser=place,
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
    columns: Columns = None,
    time_unit: TimeUnit = None,
    sample_rate: SampleRate = None,
    json: Json = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> int:
    """Show what a log holds: channels, types, rates, spans, gaps, units, and what would be used as what."""
    from .commands import info as command
    from .commands.console import Console

    console = Console(json=json, verbose=verbose, quiet=quiet)
    return command.run(logs, config, reading(mapping, imu, clock, columns, time_unit, sample_rate), console)


@app.command()
def convert(
    logs: Logs,
    output: Annotated[
        Path,
        of(OUTPUT, "--output -o", "Log to write: .csv, .parquet or .mcap (ROS 2).", metavar="FILE", parser=log_file),
    ],
    config: Config = None,
    mapping: Mapping = None,
    clock: Clock = None,
    columns: Columns = None,
    time_unit: TimeUnit = None,
    sample_rate: SampleRate = None,
    overwrite: Overwrite = False,
    json: Json = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> int:
    """Write logs as one log with attest's own columns or topics, in SI units; what is left out is said."""
    from .commands import convert as command
    from .commands.console import Console

    overrides = reading(mapping, None, clock, columns, time_unit, sample_rate)
    console = Console(json=json, verbose=verbose, quiet=quiet)
    return command.run(logs, config, overrides, output, console, overwrite=overwrite)


@app.command()
def init(
    logs: Logs,
    output: Annotated[
        Path | None,
        of(OUTPUT, "--output -o", "Default: attest.toml beside the log.", metavar="FILE", parser=place),
    ] = None,
    config: Config = None,
    mapping: Mapping = None,
    imu: Imu = None,
    clock: Clock = None,
    columns: Columns = None,
    time_unit: TimeUnit = None,
    sample_rate: SampleRate = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> int:
    """Write an attest.toml with what was found in a log: channels, columns, units, mounting and noise in comments."""
    from .commands import init as command
    from .commands.console import Console

    overrides = reading(mapping, imu, clock, columns, time_unit, sample_rate)
    return command.run(logs, config, overrides, output, Console(verbose=verbose, quiet=quiet))


@app.command()
def segment(
    logs: Logs,
    config: Config = None,
    mapping: Mapping = None,
    imu: Imu = None,
    clock: Clock = None,
    columns: Columns = None,
    time_unit: TimeUnit = None,
    sample_rate: SampleRate = None,
    start: Start = None,
    end: End = None,
    stops: StopFile = None,
    output: Annotated[
        Path | None,
        of(OUTPUT, "--output -o", "Picture; default: LOG.stops.png here.", metavar="PNG", parser=place),
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

    overrides = {
        **reading(mapping, imu, clock, columns, time_unit, sample_rate, start, end, stops),
        "output.theme": theme,
    }
    console = Console(json=json, verbose=verbose, quiet=quiet)
    return command.run(logs, config, overrides, output, console, overwrite=overwrite)


app.command()(doctor)
app.command()(simulate)
