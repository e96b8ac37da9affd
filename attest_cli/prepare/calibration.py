"""A calibration applied to a log: gyro bias, accelerometer and magnetometer corrected before anything else uses them.

The file speaks of the axes of the IMU as the log has them; a mounting of the settings turns it with the log.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..maths import rotation
from ..maths.bias import curve
from ..records import Array, Calibrated, Fixes, Log, Warn
from ..settings import Settings
from ..settings.calibration import Bias, CalibrationFile, GyroAxis, read_calibration, rms

FIRST_EPOCH_NS = 946_684_800 * 10**9  # clocks before 2000 count from a start of their own
TURN_ON = math.radians(0.2)  # rad/s: bias repeatability that data sheets of calibrated MEMS gyros state
TURN_ON_ACCEL = 0.02  # m/s^2, 2 mg: the same of accelerometers, and the default of accel_bias_sigma
USED_AGAIN = 10.0  # prior sigma over the fit's own: the same stops are measured again by the filter
LEAST_SIGMA = 1e-4  # rad/s
LEAST_ACCEL = 1e-3  # m/s^2: no fit knows better what tilts a sensor
KNOWN = 2.0  # a density whose 95 % bound is beyond this factor is not known
KNOT_S = 1.0  # the bias is linear between instants this far apart
RATE_SHARE = 0.05  # sampling rates further apart are another set-up


def calibrated(log: Log, settings: Settings) -> Log:
    """Return the log corrected by ``imu.calibration``; as it is where none is given.

    Raises
    ------
    AttestError
        If the file cannot be read, or is not a calibration.
    """
    if settings.imu.calibration is None:
        return log
    path, gravity = settings.imu.calibration, settings.world.gravity_m_s2
    file = read_calibration(path)
    same = same_drive(file, log)
    R_bs = np.eye(3) if settings.imu.mounting == "auto" else rotation.matrix(np.array(settings.imu.mounting))
    t, bias_s, sigma = _gyro_bias(file, log, same)
    noise = _noise(file, same, "temperature" in log.fixes)
    found = Calibrated(t, bias_s @ R_bs.T, noise, _sigmas(file, sigma, same, gravity), str(path))
    accel_b, fixes, told = _accelerometer(file, log.imu.accel_b, R_bs), dict(log.fixes), _doubts(path, file, log)
    if file.magnetometer is not None and "magnetometer" in fixes:
        fixes["magnetometer"] = _magnetometer(file, fixes["magnetometer"], R_bs)
    imu = replace(log.imu, gyro_b=log.imu.gyro_b - found.at(log.imu.t), accel_b=accel_b)
    which = "of this drive" if same else "of another switch-on"
    models = ", ".join(dict.fromkeys(axis.bias.model for axis in file.axes))
    history = f"calibration: {path.name} ({', '.join(f.name for f in file.source.files)}), {which}, bias {models}"
    return replace(
        log, imu=imu, fixes=fixes, calibrated=found, warnings=(*log.warnings, *told), history=(*log.history, history)
    )


def same_drive(file: CalibrationFile, log: Log) -> bool:
    """Return whether the calibration was made from this drive: from the same file, or at the same time of a real
    clock.
    """
    known = {source.sha256 for source in file.source.files}
    if any(_digest(path) in known for path in log.sources):
        return True
    if min(file.source.t0_ns, log.t0_ns) < FIRST_EPOCH_NS:
        return False
    apart = (log.t0_ns - file.source.t0_ns) * 1e-9
    return bool(apart + log.imu.t[0] <= file.source.duration_s and apart + log.imu.t[-1] >= 0.0)


def _digest(path: Path) -> str:
    """Return the SHA-256 of a file; empty where there is none to read."""
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError:
        return ""


def _gyro_bias(file: CalibrationFile, log: Log, same: bool) -> tuple[Array, Array, float]:
    """Return the predicted bias (k, 3) at times (k,), in sensor axes, and the sigma of what is left of it.

    Of this drive: the model over time, with a sigma so wide that its stops, measured again, count once. Of another
    switch-on: what the warm-up led to, or what the temperature says, known to the turn-on repeatability. A random walk
    predicts no change.
    """
    warm = log.fixes.get("temperature")
    knots = np.arange(log.imu.t[0], log.imu.t[-1] + KNOT_S, KNOT_S)
    time = knots + (log.t0_ns - file.source.t0_ns) * 1e-9
    celsius = None if warm is None else np.interp(knots, warm.t, warm.values[:, 0])
    columns, sigmas = [], []
    for axis in file.axes:
        bias, unsure = _predicted(axis.bias, time, celsius, same, file.source.duration_s)
        fit = USED_AGAIN * axis.bias.sigma if same else TURN_ON
        sigmas.append(math.hypot(fit, unsure, axis.bias.walk_alone * math.sqrt(file.source.duration_s)))
        columns.append(bias)
    return knots, np.stack(columns, axis=1), max(LEAST_SIGMA, *sigmas)


def _predicted(
    bias: Bias, time: Array, celsius: Array | None, same: bool, duration: float
) -> tuple[Array, float]:  # fmt: skip
    """Return the bias (k,) of one axis, and how far off it may be where the model does not apply."""
    if bias.model == "temperature" and bias.temperature_c is not None:
        low, high = bias.temperature_c
        if celsius is not None:
            return curve(bias.model, bias.values, time, np.clip(celsius, low, high)), 0.0
        ends = curve(bias.model, bias.values, time[:3], np.array([low, 0.5 * (low + high), high]))
        return np.full(len(time), ends[1]), 0.5 * float(np.ptp(ends))
    if same:  # beyond the record a ramp would go anywhere
        return curve(bias.model, bias.values, np.clip(time, 0.0, duration)), 0.0
    ends = curve(bias.model, bias.values, np.array([0.0, duration]))
    return np.full(len(time), ends[1]), float(np.ptp(ends))


def _noise(file: CalibrationFile, same: bool, thermometer: bool) -> dict[str, float]:
    """Return densities that stand for all axes; what the record did not know is left to the drive's own stops."""
    gyro, accel = [axis.noise for axis in file.axes], file.accelerometer
    out = {}
    if all(axis.knows_walk for axis in file.axes):
        out["gyro_random_walk"] = rms(_walk(axis, same, thermometer) for axis in file.axes)
    for name, noise in (("gyro", gyro), ("accel", [] if accel is None else [accel.x, accel.y, accel.z])):
        if noise and all(n.noise_density_95[1] < KNOWN * n.noise_density for n in noise):
            out[f"{name}_noise_density"] = rms(n.noise_density for n in noise)
    return out


def _walk(axis: GyroAxis, same: bool, thermometer: bool) -> float:
    """Return K of one axis.

    A curve explains this drive; on another day its warm-up need not come back, and the bias moves as it did without it.
    Temperature explains any day that has it.
    """
    return axis.walk(explained=thermometer if axis.bias.model == "temperature" else same)


def _sigmas(file: CalibrationFile, gyro_bias: float, same: bool, gravity: float) -> dict[str, float]:
    """Return what is left of both biases: an accelerometer is known to its fit, from one switch-on to another less."""
    out = {"gyro_bias_sigma": gyro_bias}
    accel = file.accelerometer
    if accel is not None and accel.tilt_sigma is not None:
        fit = accel.tilt_sigma * gravity
        out["accel_bias_sigma"] = max(fit, LEAST_ACCEL) if same else math.hypot(fit, TURN_ON_ACCEL)
    return out


def _accelerometer(file: CalibrationFile, accel_b: Array, R_bs: Array) -> Array:
    """Return ``M (a + b)`` in body axes."""
    found = file.accelerometer
    if found is None or found.matrix is None or found.bias is None:
        return accel_b
    M = R_bs @ np.array(found.matrix) @ R_bs.T
    return np.asarray((accel_b + R_bs @ np.array(found.bias)) @ M.T)


def _magnetometer(file: CalibrationFile, fixes: Fixes, R_bs: Array) -> Fixes:
    """Return the field ``M (m - o)``: the magnetometer sits in the same box."""
    found = file.magnetometer
    assert found is not None
    M = R_bs @ np.array(found.matrix) @ R_bs.T
    return replace(fixes, values=(fixes.values - R_bs @ np.array(found.offset)) @ M.T)


def _doubts(path: Path, file: CalibrationFile, log: Log) -> list[Warn]:
    """Say where the log is of another set-up than the calibration."""
    rate = 1.0 / float(np.median(np.diff(log.imu.t)))
    if abs(rate / file.source.rate_hz - 1.0) <= RATE_SHARE:
        return []
    message = f"{path}: made at {file.source.rate_hz:.4g} Hz, this log has {rate:.4g} Hz"
    return [Warn("calibration-rate", message, "another sensor or filter setting has another noise: calibrate that")]
