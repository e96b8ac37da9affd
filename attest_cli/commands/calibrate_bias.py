"""``attest calibrate-bias``: the gyro's bias and noise from what stands still in a log."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..settings import load_settings
from .console import LOST, OK, Console

if TYPE_CHECKING:
    from ..settings.calibration import CalibrationFile, GyroAxis, Noise

READABLE = (".csv", ".mcap", ".parquet")
NOT_LOGS = (".truth", ".stops")  # what attest writes beside a log
DEG = math.degrees(1.0)
ROOT_HOUR, HOUR = 60.0, 3600.0
UNITS = {"c0": " at 25 °C", "c1": "/K", "c2": "/K²"}  # of a temperature polynomial, after °/s


def logs_here(folder: Path) -> list[Path]:
    """The logs of a folder, by name."""
    return sorted(
        path for path in folder.iterdir()
        if path.suffix.lower() in READABLE and not path.stem.endswith(NOT_LOGS) and path.is_file()
    )  # fmt: skip


def run(
    logs: Sequence[Path],
    config: Path | None,
    overrides: Mapping[str, Any],
    model: str,
    output: Path | None,
    console: Console,
    *,
    overwrite: bool,
) -> int:
    """Calibrate into a folder and tell what was found."""
    effective = load_settings(config, logs[0], overrides, without=("imu.calibration", "imu.mounting"))
    folder = output or Path(f"{logs[0].stem}.calibration")
    from .. import pipeline

    with console.working() as progress:
        found = pipeline.calibrate(logs, effective, folder, model=model, overwrite=overwrite, progress=progress)
    file, title, status = found["file"], found["title"], found["status"]
    if console.json:
        console.data({"title": title, "status": status, **file.model_dump(mode="json")})
    _tell(file, title, status, console)
    for warning in found["warnings"]:
        console.warn(warning.message, warning.hint)
    for line in (*notes(file), *(notes(file, noise=True) if console.verbose else ())):
        console.say((f"  {line}", "mute"))
    console.say(("→ ", "mute"), f"{folder}/", ("  calibration.toml, imu.yaml, 08-calibrate-bias.png", "mute"))
    return LOST if any(warning.lost for warning in found["warnings"]) else OK


def notes(file: CalibrationFile, *, noise: bool = False) -> Iterator[str]:
    """What could not be told, and why, each once with the axes that it holds for; ``noise``: of the noise, which the
    figures say already.
    """
    if not noise:
        yield from file.source.notes
    said: dict[str, list[str]] = {}
    for name, axis in zip("xyz", file.axes, strict=True):
        for note in axis.noise.notes if noise else axis.bias.notes:
            said.setdefault(note, []).append(name)
    for note, axes in said.items():
        yield f"gyro {', '.join(axes)}: {note}"
    if file.accelerometer is not None and not noise:
        yield from file.accelerometer.notes


def _tell(file: CalibrationFile, title: str, status: str, console: Console) -> None:
    """The finding, then each axis in both unit systems."""
    from ..figures.words import duration
    from .console import MARKS

    console.say((f"{MARKS[status]} ", status), (title, "strong"), (f"  {status}", status))
    source = file.source
    rest = "at rest" if source.rests else f"{duration(source.at_rest_s)} of it at rest"
    console.say(("  log  ", "mute"), f"{duration(source.duration_s)}, {rest}, {source.rate_hz:.4g} Hz")
    for name, axis in zip("xyz", file.axes, strict=True):
        for what, value, note in _rows(axis):
            console.say((f"  {name}  {what:<5}", "mute"), f"{value:<27}", (note, "mute"))
    accel = file.accelerometer
    if accel is not None:
        density = ", ".join(f"{n.noise_density:.3g}" for n in (accel.x, accel.y, accel.z))
        fitted = f"; bias and scale from {accel.attitudes} attitudes" if accel.matrix is not None else ""
        console.say(("  accelerometer  ", "mute"), f"{density} m/s²/√Hz", (fitted, "mute"))


def _rows(axis: GyroAxis) -> Iterator[tuple[str, str, str]]:
    """Bias, N, B and K of one axis: SI, and what data sheets use."""
    bias, noise = axis.bias, axis.noise
    now = bias.values[0] if bias.model in {"constant", "random-walk"} else None
    if now is not None:
        two = 2.0 * bias.sigma
        degrees = f"{now * DEG:.4g} ± {two * DEG:.2g} °/s (95 %), {now * DEG * HOUR:.4g} °/h"
        yield "bias", f"{now:.4g} ± {two:.2g} rad/s", f"{degrees}, {bias.model}{_white(axis)}"
    else:
        values = ", ".join(_named(n, v) for n, v in zip(bias.names, bias.values, strict=True))
        yield "bias", bias.model, f"{values}{_white(axis)}"
    yield "N", f"{noise.noise_density:.4g} rad/s/√Hz", _both(noise, "noise_density", ROOT_HOUR, "°/√h")
    if noise.instability_read_off is not None:
        B = noise.instability_read_off
        yield "B", f"{B:.3g} rad/s", f"{B * DEG * HOUR:.3g} °/h, read off at {noise.instability_tau_s:.3g} s"
    if noise.random_walk is not None:
        yield "K", f"{noise.random_walk:.3g} rad/s²/√Hz", _both(noise, "random_walk", HOUR * ROOT_HOUR, "°/h/√h")
    else:
        bound = noise.random_walk_95[1]
        below = f"below {bound:.3g} rad/s²/√Hz, {bound * DEG * HOUR * ROOT_HOUR:.3g} °/h/√h (95 %)"
        short = f"too short for K: {below}" if math.isfinite(bound) else "the record is too short for K"
        yield "K", "not seen", below if axis.knows_walk else short


def _both(noise: Noise, name: str, factor: float, unit: str) -> str:
    value, (low, high) = getattr(noise, name), getattr(noise, f"{name}_95")
    scale = DEG * factor
    return f"{value * scale:.4g} {unit} (95 %: {low * scale:.3g} to {high * scale:.3g})"


def _named(name: str, value: float) -> str:
    """A parameter in the unit people use: T in minutes, a slope per hour, the rest as rates."""
    if name == "T":
        return f"T {value / 60.0:.3g} min"
    if name == "slope":
        return f"slope {value * DEG * HOUR:.3g} °/s per h"
    return f"{name} {value * DEG:.3g} °/s{UNITS.get(name, '')}"


def _white(axis: GyroAxis) -> str:
    return "" if axis.bias.white else "; the residual is not white"
