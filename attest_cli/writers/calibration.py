"""``calibration.toml`` and Kalibr's ``imu.yaml`` from a calibration; numbers keep all their digits."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from .. import __version__
from ..calibration.records import Accelerometer, Axis, Calibration, Magnetometer, NoiseFit
from ..records import Array
from ..settings import calibration as model
from .files import atomic_write

HEAD = """# Written by attest calibrate-bias. SI units: rad/s, m/s^2, tesla, s; axes of the IMU as the log has them,
# before any mounting. attest smooth --calibration FILE uses it; a setting that is stated beats it.
"""


def describe(found: Calibration, logs: Sequence[Path], channel: str) -> model.CalibrationFile:
    """Return a calibration as its file says it, with where it comes from."""
    source = model.Source(
        attest_version=__version__,
        files=tuple(model.SourceFile(name=_whole(path.name), sha256=_digest(path)) for path in logs),
        channel=channel,
        t0_ns=found.t0_ns,
        duration_s=found.duration,
        at_rest_s=found.at_rest,
        rate_hz=found.rate_hz,
        static=found.static,
        notes=found.notes,
    )
    x, y, z = (_axis(axis) for axis in found.axes)
    magnetometer = None if found.magnetometer is None else _magnetometer(found.magnetometer)
    return model.CalibrationFile(
        source=source,
        gyro=model.Gyro(x=x, y=y, z=z),
        accelerometer=_accelerometer(found.accelerometer),
        magnetometer=magnetometer,
    )


def _whole(name: str) -> str:
    """A file name whose bytes are no text (lone surrogates) with question marks for them."""
    return name.encode("utf-8", "replace").decode("utf-8")


def _digest(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _noise(fit: NoiseFit) -> model.Noise:
    return model.Noise(
        noise_density=fit.N,
        noise_density_95=fit.N_interval,
        random_walk=fit.K,
        random_walk_95=fit.K_interval or (0.0, math.inf),
        instability_read_off=fit.B,
        instability_tau_s=fit.B_tau,
        notes=fit.notes,
    )


def _axis(axis: Axis) -> model.GyroAxis:
    fitted, rest, white = axis.model, axis.rest, axis.whiteness
    heat = rest.temperature if fitted.name == "temperature" else None
    bias = model.Bias(
        model=fitted.name,
        names=fitted.names,
        values=tuple(fitted.values.tolist()),
        covariance=tuple(tuple(row) for row in fitted.covariance.tolist()),
        sigma=float(fitted.sigma[-1]),
        walk_beside=fitted.walk,
        walk_alone=float(axis.models["random-walk"].values[1]),
        temperature_c=None if heat is None else (float(heat.min()), float(heat.max())),
        residual_sigma=float(np.sqrt(np.mean((rest.rate - fitted.fitted) ** 2))),
        residual_every_s=white.lag_s,
        white=white.white,
        inside_band=white.inside,
        ljung_box_probability=white.probability,
        notes=fitted.notes,
    )
    return model.GyroAxis(noise=_noise(axis.noise), bias=bias)


def _triple(vector: Array) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, y, z


def _matrix(matrix: Array) -> model.Matrix:
    x, y, z = (_triple(row) for row in matrix)
    return x, y, z


def _accelerometer(found: Accelerometer) -> model.Accelerometer:
    x, y, z = (_noise(fit) for fit in found.noise)
    return model.Accelerometer(
        x=x,
        y=y,
        z=z,
        matrix=None if found.matrix is None else _matrix(found.matrix),
        bias=None if found.bias is None else _triple(found.bias),
        residual=found.residual,
        tilt_sigma=found.tilt_sigma,
        attitudes=found.attitudes,
        notes=found.notes,
    )


def _magnetometer(found: Magnetometer) -> model.Magnetometer:
    return model.Magnetometer(
        matrix=_matrix(found.matrix), offset=_triple(found.offset), field=found.field, residual=found.residual,
        coverage=found.coverage,
    )  # fmt: skip


def write_calibration(file: model.CalibrationFile, path: Path) -> None:
    """Write ``calibration.toml``; each key is explained where it stands first."""
    lines = list(_tables(file, "", set()))
    with atomic_write(path) as temporary:
        temporary.write_text(HEAD + "\n".join(lines) + "\n", encoding="utf-8")


def _tables(part: BaseModel, name: str, told: set[tuple[str, str]]) -> Iterator[str]:
    """Lines of a table and of those in it; what is not known has no line."""
    inner: list[tuple[str, Any]] = []
    for key, info in type(part).model_fields.items():
        value = getattr(part, key)
        many = isinstance(value, tuple) and bool(value) and isinstance(value[0], BaseModel)
        if isinstance(value, BaseModel) or many:
            inner.append((key, value))
        elif value is not None:
            place = type(part).__name__, key
            note = f"  # {info.description}" if info.description and place not in told else ""
            told.add(place)
            yield f"{key} = {_value(value)}{note}"
    for key, value in inner:
        whole = f"{name}.{key}" if name else key
        for item in value if isinstance(value, tuple) else (value,):
            if isinstance(value, tuple) or _has_values(item):
                yield f"\n[[{whole}]]" if isinstance(value, tuple) else f"\n[{whole}]"
            yield from _tables(item, whole, told)


def _has_values(part: BaseModel) -> bool:
    return any(not isinstance(value, BaseModel) for _, value in part)


def _value(value: Any) -> str:
    """Spell a TOML value; a float has all its digits."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple):
        return f"[{', '.join(_value(item) for item in value)}]"
    return _text(value) if isinstance(value, str) else repr(value)


def _text(text: str) -> str:
    """Spell a TOML string; what is not printable, such as the control characters of a file name, is escaped."""
    return '"' + "".join(_char(c) for c in text) + '"'


def _char(char: str) -> str:
    if char in '"\\':
        return f"\\{char}"
    return char if char.isprintable() else f"\\u{ord(char):04x}" if ord(char) < 0x10000 else f"\\U{ord(char):08x}"


def write_kalibr(file: model.CalibrationFile, path: Path) -> None:
    """Write Kalibr's ``imu.yaml``: one figure for all axes (rms), the gyro's those that ``attest smooth --calibration``
    uses in another drive; a walk of the accelerometer that was not seen is written as its 95 % bound.
    """
    gyro = [axis.noise for axis in file.axes]
    accel = [] if file.accelerometer is None else [file.accelerometer.x, file.accelerometer.y, file.accelerometer.z]
    lines = ["# Written by attest calibrate-bias; continuous-time noise as Kalibr defines it, rms of the three axes."]
    walks = _gyro_walk_line(file), _walk_line("accelerometer", accel, "m/s^2")
    parts = ("gyroscope", gyro, "rad/s"), ("accelerometer", accel, "m/s^2")
    for (name, noise, unit), walk in zip(parts, walks, strict=True):
        if noise:
            density = model.rms(n.noise_density for n in noise)
            lines += [f"{name}_noise_density: {_number(density)}  # {unit}/sqrt(Hz)", walk]
    lines += [f"update_rate: {_number(file.source.rate_hz)}  # Hz", f"rostopic: {_text(file.source.channel)}"]
    with atomic_write(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _gyro_walk_line(file: model.CalibrationFile) -> str:
    """Say K as a drive of another day is filtered with it, or that the record does not know it."""
    bound = model.rms(axis.noise.random_walk_95[1] for axis in file.axes)
    most = f"95 % bound {bound:.3g}" if math.isfinite(bound) else "without a bound"
    if not all(axis.knows_walk for axis in file.axes):
        return f"# gyroscope_random_walk: not known, the record is too short; {most}"
    walk = model.rms(axis.walk(explained=False) for axis in file.axes)
    return f"gyroscope_random_walk: {_number(walk)}  # rad/s/s/sqrt(Hz), mean of its likelihood; {most}"


def _walk_line(name: str, noise: Sequence[model.Noise], unit: str) -> str:
    if not noise:
        return ""
    unseen = sum(n.random_walk is None for n in noise)
    walk = model.rms(n.random_walk if n.random_walk is not None else n.random_walk_95[1] for n in noise)
    if not math.isfinite(walk):
        return f"# {name}_random_walk: not known, the record is too short"
    note = f"; not seen on {unseen} of 3 axes, whose 95 % bound counts" if unseen else ""
    return f"{name}_random_walk: {_number(walk)}  # {unit}/s/sqrt(Hz){note}"


def _number(value: float) -> str:
    """Spell a float with all its digits as YAML knows floats: with a point."""
    digits = repr(value)
    return digits.replace("e", ".0e") if "e" in digits and "." not in digits else digits
