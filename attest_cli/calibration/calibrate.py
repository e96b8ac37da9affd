"""Calibration of one sensor from what rests in its logs: bias and noise of the gyro, and what else the logs allow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..errors import AttestError
from ..maths.bias import curve, gradient
from ..records import Array, Ints, Log, Segmentation
from ..settings import Settings
from .accelerometer import attitudes, fit_accelerometer
from .allan import allan_deviation
from .beside import walk_beside
from .bias import BETTER, Fitted, choose, fit_models
from .magnetometer import fit_magnetometer
from .noise import fit_noise, low_pass_note, read_instability
from .records import Accelerometer, Allan, Axis, Calibration, Magnetometer, NoiseFit, Rest
from .rest import Blocks, Record, cut, find_rest, means
from .spectrum import white_samples
from .whiteness import judge_whiteness

MOST_BLOCKS = 1000  # of a static record
BLOCKS_PER_STOP = 32  # of a drive, so that a stop's residual can be tested
MOST_STOP_BLOCKS = 4000
FEWEST_BLOCKS = 16
FINE_S = 1.0
EARTH_RATE = 7.292115e-5  # rad/s


def calibrate(
    log: Log, segmentation: Segmentation, settings: Settings, more: Sequence[tuple[Log, Segmentation]] = (),
    model: str = "auto",
) -> Calibration:  # fmt: skip
    """Calibrate the sensor of a log, and of ``more`` logs of the same sensor, from what stands still in them.

    A static record gets the bias model of lowest BIC, a drive the random walk over its stops, unless a curve is better
    beyond doubt; its noise is what that model leaves. Several logs stand on one time axis, by their stamps.

    Parameters
    ----------
    log, segmentation : in SI, body axes; its stops and motions
    settings : gravity of ``world``
    more : further logs of the sensor, in any order
    model : name of the bias model for all axes, instead

    Raises
    ------
    AttestError
        Where nothing stands still, a sensor is stuck, logs overlap in time, or the record does not tell ``model``.
    """
    logs = [(log, segmentation), *more]
    record = find_rest(logs)
    _refuse_stuck(record, log)
    white, share = white_samples([[p.gyro_b[:, k] for p in record.pieces] for k in range(3)], record.period)
    notes = [*record.notes, *([low_pass_note("gyro", 0.5 * record.rate_hz / white, share)] if white > 1 else [])]
    blocks, edges = cut(record.pieces, _block_length(record, white))
    celsius = _temperature(logs, record)
    if model == "temperature" and celsius is None:
        message = f"{log.sources[0].name}: the log has no temperature"
        raise AttestError(message, "map one with --map temperature=CHANNEL")
    axes = [_axis(record, blocks, edges, k, celsius, white, model) for k in range(3)]
    if record.static and min(float(axis.model.sigma.min()) for axis in axes) < EARTH_RATE / 3.0:
        notes.append("the bias holds what the axis sees of the Earth's rotation, up to 15 deg/h")
    accelerometer = _accelerometer(record, settings.world.gravity_m_s2)
    magnetometer, why = _magnetometer(logs)
    notes += [why] if why else []
    return Calibration(
        (axes[0], axes[1], axes[2]), accelerometer, magnetometer, record.duration, record.at_rest, record.rate_hz,
        record.static, record.t0_ns, tuple(notes),
    )  # fmt: skip


def _refuse_stuck(record: Record, log: Log) -> None:
    """Refuse a sensor that shows no noise at all."""
    for name, values in (("gyro", "gyro_b"), ("accelerometer", "accel_b")):
        for k, axis in enumerate("xyz"):
            if all(float(np.ptp(getattr(p, values)[:, k])) == 0.0 for p in record.pieces):
                raise AttestError(
                    f"{log.sources[0].name}: {name} {axis} does not change at all at rest: stuck, or rounded away",
                    "record with the sensor's full resolution",
                )


def _block_length(record: Record, white: int) -> float:
    """Return the length of the blocks, s: short enough to see the bias move, few enough to follow it, and long enough
    for their noise to be white.
    """
    stop = float(np.median([len(p.t) * p.period for p in record.pieces]))
    of_drive = max(stop / BLOCKS_PER_STOP, record.at_rest / MOST_STOP_BLOCKS)
    usual = record.at_rest / MOST_BLOCKS if record.static else of_drive
    return min(max(usual, white * record.period), record.at_rest / FEWEST_BLOCKS)


def _temperature(logs: Sequence[tuple[Log, Segmentation]], record: Record) -> list[Array] | None:
    """Return deg C at the samples of every piece, None where a log has none."""
    t, celsius = list[Array](), list[Array]()
    for log, _ in sorted(logs, key=lambda pair: pair[0].t0_ns):
        fixes = log.fixes.get("temperature")
        good = np.isfinite(fixes.values[:, 0]) if fixes is not None else np.zeros(0, dtype=np.bool_)
        if fixes is None or not good.any():
            return None
        t.append(fixes.t[good] + (log.t0_ns - record.t0_ns) * 1e-9)
        celsius.append(fixes.values[good, 0])
    return [np.interp(p.t, np.concatenate(t), np.concatenate(celsius)) for p in record.pieces]


def _axis(
    record: Record, blocks: Blocks, edges: Sequence[Ints], k: int, celsius: list[Array] | None, white: int, wanted: str
) -> Axis:  # fmt: skip
    """Calibrate one axis of the gyro."""
    values = [p.gyro_b[:, k] for p in record.pieces]
    z = means(values, edges)
    warmth = means(celsius, edges) if celsius is not None else None
    models, notes = fit_models(blocks, z, warmth)
    chosen = _chosen(models, notes, wanted, static=record.static)
    left = [
        x - curve(chosen.model.name, chosen.model.values, p.t, None if celsius is None else celsius[i])
        for i, (x, p) in enumerate(zip(values, record.pieces, strict=True))
    ]
    noise, allan = _noise(record, left, white, across=True)
    residual = [chosen.residual[blocks.piece == i] for i in range(len(record.pieces))]
    beside = walk_beside(blocks, z, gradient(chosen.model.name, chosen.model.values, blocks.t, warmth))
    rest = Rest(blocks.t, z, noise.N / np.sqrt(blocks.span), blocks.stop.astype(np.float64), warmth)
    return Axis(
        rest, replace(chosen.model, walk=beside), {name: fitted.model for name, fitted in models.items()},
        judge_whiteness(residual, float(np.median(blocks.span))), allan, noise, _fine(record, values, noise.N),
    )  # fmt: skip


def _fine(record: Record, values: list[Array], N: float) -> Rest:
    """Return means of a second."""
    blocks, edges = cut(record.pieces, FINE_S)
    return Rest(blocks.t, means(values, edges), N / np.sqrt(blocks.span), blocks.stop.astype(np.float64))


def _chosen(models: Mapping[str, Fitted], notes: list[str], wanted: str, *, static: bool) -> Fitted:
    """Return the wanted model, or the one that suits the record; its notes say why others are none."""
    name = choose(models, static=static) if wanted == "auto" else wanted
    if name not in models:
        raise AttestError(f"no {name} model of the bias from this record: {'; '.join(notes) or 'unknown'}", "")
    model = models[name].model
    rival = min(models.values(), key=lambda fitted: fitted.model.bic).model
    if model.bic - rival.bic > BETTER:
        notes = [*notes, f"{rival.name} describes the record better (BIC lower by {model.bic - rival.bic:.0f})"]
    return replace(models[name], model=replace(model, notes=(*model.notes, *notes)))


def _noise(record: Record, values: list[Array], white: int, *, across: bool) -> tuple[NoiseFit, Allan]:
    """Return noise and Allan deviation of one axis."""
    noise = fit_noise(record.pieces, values, white, across=across)
    allan = allan_deviation(values, record.period, walk_ratio=(noise.K / noise.N) ** 2 if noise.K is not None else 0.0)
    B, tau, why = read_instability(allan, noise.N)
    return replace(noise, B=B, B_tau=tau, notes=(*noise.notes, *([why] if why else []))), allan


def _accelerometer(record: Record, gravity: float) -> Accelerometer:
    """Return the accelerometer's noise, and its errors where the stops show them; gravity differs from stop to stop."""
    pieces = record.pieces
    white, share = white_samples([[p.accel_b[:, k] for p in pieces] for k in range(3)], record.period)
    notes = [low_pass_note("accelerometer", 0.5 * record.rate_hz / white, share)] if white > 1 else []
    x, y, z = (_noise(record, [p.accel_b[:, k] for p in pieces], white, across=False)[0] for k in range(3))
    force, seconds = stop_means(record)
    found, why = fit_accelerometer(force, max(x.N, y.N, z.N) / np.sqrt(seconds), gravity)
    if found is None:
        return Accelerometer((x, y, z), None, None, None, attitudes(force), (*notes, why))
    return Accelerometer(
        (x, y, z), found.matrix, found.bias, found.residual, attitudes(force), tuple(notes), found.tilt_sigma
    )  # fmt: skip


def stop_means(record: Record) -> tuple[Array, Array]:
    """Return the mean specific force (m, 3) of every stop, and how many seconds it is of."""
    numbers = np.array([p.stop for p in record.pieces])
    force, seconds = [], []
    for stop in np.unique(numbers):
        parts = [p for p in record.pieces if p.stop == stop]
        force.append(np.concatenate([p.accel_b for p in parts]).mean(axis=0))
        seconds.append(sum(len(p.t) * p.period for p in parts))
    return np.array(force), np.array(seconds)


def _magnetometer(logs: Sequence[tuple[Log, Segmentation]]) -> tuple[Magnetometer | None, str]:
    """Fit the readings of all logs, in motion and at rest; nothing to say where there are none."""
    fields = [log.fixes["magnetometer"].values for log, _ in logs if "magnetometer" in log.fixes]
    return fit_magnetometer(np.concatenate(fields)) if fields else (None, "")
