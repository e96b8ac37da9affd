"""``attest simulate``: a log with its truth beside it. Its options are its own, so they stand here."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from .console import OK, Console
from .options import OUTPUT, Json, Overwrite, Quiet, Verbose, of, place

ROVER, CHARLY, WALKING, GYROSTAR = "Rover only", "Charly only", "Walking only", "Gyrostar only"
"""Panels of the help."""

SENSORS = ("sun", "compass", "magnetometer", "odometry", "gps")
ROVER_DRIVE: Mapping[str, object] = {
    "duration_s": 600.0, "rate_hz": 100.0, "scenario": "S1", "variant": "nominal", "motion_s": (60.0, 300.0),
}  # fmt: skip
"""The rover's drive where nothing else is asked for."""


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
        of(
            OUTPUT,
            "--output -o",
            "NAME.csv, .mcap or .parquet; a bare NAME writes all three. Default: the scenario's name.",
            metavar="FILE",
            parser=place,
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
    rate: Annotated[
        float | None, of(ROVER, "--rate", "IMU samples per second.", show_default="100", metavar="HZ", min=1)
    ] = None,
    sensors: Annotated[
        str | None, of(ROVER, "--sensors", f"Of {', '.join(SENSORS)}.", show_default="sun", metavar="A,B")
    ] = None,
    motion: Annotated[
        tuple[float, float] | None,
        of(ROVER, "--motion", "Length of the motions, s.", show_default="60 300", metavar="MIN MAX"),
    ] = None,
    noise: Annotated[
        Literal["S1", "S2"] | None,
        of(ROVER, "--noise", "S2: the accelerometer has a bias of 0.02 m/s^2.", show_default="S1"),
    ] = None,
    variant: Annotated[
        Literal["nominal", "slow", "slow-no-vibration", "idle-engine", "biased", "noisy"] | None,
        of(ROVER, "--variant", "How hard the stops are to find.", show_default="nominal"),
    ] = None,
    turn_deg: Annotated[
        float | None, of(CHARLY, "--turn-deg", "Turn between the two straights.", show_default="180", metavar="DEG")
    ] = None,
    case: Annotated[
        Literal["A", "B", "C"] | None, of(WALKING, "--case", "A trot, B stop-and-go, C impulses.", show_default="A")
    ] = None,
    bias_deg_s: Annotated[
        float | None,
        of(WALKING, "--bias-deg-s", "Bias of each gyro axis, either sign.", show_default="0.05", metavar="DEG/S"),
    ] = None,
    course: Annotated[
        Literal["truck", "platform", "static"] | None,
        of(GYROSTAR, "--course", "What turns the gyro.", show_default="truck"),
    ] = None,
    stops: Annotated[bool, of(GYROSTAR, "--stops", "Stop for 10 s each minute.")] = False,
    scatter: Annotated[
        float | None,
        of(
            GYROSTAR, "--scatter", "Spread of the bias's C1, C2 and T, such as 0.15.", show_default="0",
            metavar="SHARE",
        ),
    ] = None,
    random_walk_deg_s: Annotated[
        float | None,
        of(
            GYROSTAR, "--random-walk-deg-s", "Random walk of the bias in 1 s, such as 5e-4.", show_default="0",
            metavar="DEG/S",
        ),
    ] = None,
    json: Json = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> int:  # fmt: skip
    """Make a log with its truth beside it."""
    asked: dict[str, dict[str, object]] = {
        "--duration": {"duration_s": duration},
        "--rate": {"rate_hz": rate},
        "--motion": {"motion_s": motion},
        "--noise": {"scenario": noise},
        "--variant": {"variant": variant},
        "--sensors": _aiding(sensors),
        "--turn-deg": {"turn_deg": turn_deg},
        "--case": {"case": case},
        "--bias-deg-s": {"bias_deg_s": bias_deg_s},
        "--course": {"course": course},
        "--stops": {"stops": stops or None},
        "--scatter": {"scatter": scatter},
        "--random-walk-deg-s": {"random_walk_deg_s": random_walk_deg_s},
    }
    options = _options_of(scenario, seed, asked)
    console = Console(json=json, verbose=verbose, quiet=quiet)
    return _run(scenario, output or Path(scenario), options, console, overwrite=overwrite)


def _run(scenario: str, output: Path, options: Mapping[str, Any], console: Console, *, overwrite: bool) -> int:
    """Write the log, its truth and the ``attest.toml`` that goes with it."""
    from .. import pipeline

    files = pipeline.simulate(scenario, output, dict(options), overwrite)
    if console.json:
        console.data([str(file) for file in files])
    for file in files:
        console.say(("→ ", "mute"), str(file))
    return OK


def _options_of(scenario: str, seed: int, asked: Mapping[str, Mapping[str, object]]) -> dict[str, object]:
    """Options of a scenario: flag -> what it sets (None: not given); refused where the scenario does not know them."""
    from dataclasses import fields

    from ..simulate import SCENARIOS

    known = {f.name for f in fields(SCENARIOS[scenario][0])}
    options: dict[str, object] = {"seed": seed}
    if scenario == "rover":
        options |= {**ROVER_DRIVE, **_aiding("sun")}
    for flag, values in asked.items():
        told = {name: value for name, value in values.items() if value is not None}
        if not told.keys() <= known:
            raise typer.BadParameter(f"{scenario} has no such option", param_hint=flag)
        options |= told
    return options


def _aiding(sensors: str | None) -> dict[str, object]:
    """Which of the rover's sensors a list between commas names; none where there is no list."""
    if sensors is None:
        return {}
    named = {name.strip() for name in sensors.split(",")} - {""}
    unknown = sorted(named - set(SENSORS))
    if unknown:
        raise typer.BadParameter(f"{unknown[0]!r} is none of {', '.join(SENSORS)}", param_hint="--sensors")
    return {name: name in named for name in SENSORS}
