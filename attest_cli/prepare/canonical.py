"""Channels in the units that their canonical columns imply, as attest writes logs: SI, degrees on Earth, microtesla."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..records import COLUMNS, Array, Channel, Ints, Warn
from ..settings import Settings
from ..settings.units import unit
from . import units
from .clock import seconds
from .fixes import CONVERTERS

UNITS: Mapping[str, str] = {
    "gyro": "rad/s", "accel": "m/s^2", "mag": "uT", "velocity": "m/s", "speed": "m/s", "position": "m",
    "latitude": "deg", "longitude": "deg", "altitude": "m", "gps": "m", "baro": "m", "compass": "deg",
    "temperature": "degC",
}  # fmt: skip
"""First word of a column -> unit of attest's own logs."""

GUESSED = ("rad/s", "deg/s", *units.ACCEL_UNITS, *units.MAG_UNITS)
TESLA = 1e-6  # per microtesla


@np.errstate(over="ignore")  # a damaged number stays one
def in_canonical_units(channels: Sequence[Channel], settings: Settings) -> tuple[list[Channel], list[Warn]]:
    """Convert channels to the units of attest's own logs: as stated, held against physics as ``prepare`` does it.

    Rows, order and stamps stay as they are: nothing is dropped, sorted or turned.

    Raises
    ------
    AttestError
        If a unit is not known, or the values cannot be what they are said to be.
    """
    warnings: list[Warn] = []
    accel = next((c for c in channels if c.role == "accel"), None)
    return [_converted(channel, accel, settings, warnings) for channel in channels], warnings


def taken_units(channel: Channel, converted: Channel) -> dict[str, str]:
    """Return the unit in which each column was taken that states none, where it is not the canonical one."""
    found = {}
    for name, values in channel.values.items():
        candidates = [u for u in GUESSED if unit(u)[1] == unit(_unit(name))[1]] if _unit(name) else []
        rows = np.flatnonzero(np.isfinite(values) & (values != 0.0))
        if channel.units.get(name) or not rows.size or not candidates:
            continue
        ratio = converted.values[name][rows[0]] / values[rows[0]]
        factors = {candidate: unit(candidate)[0] / unit(_unit(name))[0] for candidate in candidates}
        near = min(candidates, key=lambda candidate: abs(factors[candidate] / ratio - 1.0))
        if abs(factors[near] / ratio - 1.0) < 1e-9:
            found[name] = near
    return found


def _converted(channel: Channel, accel: Channel | None, settings: Settings, warnings: list[Warn]) -> Channel:
    if not channel.stamps_ns.size:
        return channel
    if channel.role in {"imu", "gyro", "accel"}:
        return _inertial(channel, accel, settings, warnings)
    if channel.role == "magnetometer":
        field_t = units.magnetometer(channel, COLUMNS["magnetometer"], warnings)
        return _with(_as_stated(channel), COLUMNS["magnetometer"], field_t / TESLA)
    if channel.role in {"compass", "temperature"}:  # radians without a unit, and kelvin, are told there
        values, _ = CONVERTERS[channel.role](channel, settings, warnings)
        return _with(channel, COLUMNS[channel.role], np.degrees(values) if channel.role == "compass" else values)
    return _as_stated(channel)


def _as_stated(channel: Channel) -> Channel:
    """Convert the columns that state a unit."""
    stated = {name: said for name in channel.values if (said := channel.units.get(name, "")) and _unit(name)}
    columns = {n: channel.values[n] * (unit(said)[0] / unit(_unit(n))[0]) for n, said in stated.items()}
    return replace(
        channel, values={**channel.values, **columns}, units={**channel.units, **{n: _unit(n) for n in columns}}
    )


def _inertial(channel: Channel, accel: Channel | None, settings: Settings, warnings: list[Warn]) -> Channel:
    """Find the factors of an IMU, or of half of one, on its good rows in order of time; apply them to all rows."""
    names = COLUMNS[channel.role]
    table = np.stack([channel.values[name] for name in names], axis=1)
    order = np.argsort(channel.stamps_ns, kind="stable")
    rows = order[np.isfinite(table[order]).all(axis=1)]
    if not rows.size:
        return channel
    good = replace(channel, stamps_ns=channel.stamps_ns[rows], values={n: table[rows, k] for k, n in enumerate(names)})
    t = seconds(good.stamps_ns, int(good.stamps_ns[0]))
    found = []
    if channel.role != "gyro":
        found.append(units.accelerometer(good, COLUMNS["accel"], t, settings.world.gravity_m_s2, warnings))
    if channel.role != "accel":
        beside = found[0] if found else _at(good.stamps_ns, accel, settings)
        found.insert(0, units.gyroscope(good, COLUMNS["gyro"], t, beside, warnings))
    raw, converted = table[rows], np.concatenate(found, axis=1)
    largest = np.argmax(np.abs(raw), axis=0), np.arange(len(names))
    factors = np.divide(converted[largest], raw[largest], out=np.ones(len(names)), where=raw[largest] != 0.0)
    return _with(channel, names, np.where(factors == 1.0, table, table * factors))


def _at(stamps_ns: Ints, accel: Channel | None, settings: Settings) -> Array:
    """Return the specific force of another channel at these stamps (n, 3); without one a constant: it tells nothing."""
    if accel is None:
        return np.full((stamps_ns.size, 3), settings.world.gravity_m_s2)
    force = _inertial(accel, None, settings, [])
    origin = int(stamps_ns[0])
    table = np.stack([force.values[name] for name in COLUMNS["accel"]], axis=1)
    order = np.argsort(accel.stamps_ns, kind="stable")
    rows = order[np.isfinite(table[order]).all(axis=1)]
    t, ta = seconds(stamps_ns, origin), seconds(accel.stamps_ns[rows], origin)
    return np.stack([np.interp(t, ta, column) for column in table[rows].T], axis=1)


def _with(channel: Channel, names: Sequence[str], values: Array) -> Channel:
    columns = {name: np.ascontiguousarray(values[:, k]) for k, name in enumerate(names)}
    return replace(
        channel, values={**channel.values, **columns}, units={**channel.units, **{n: _unit(n) for n in names}}
    )


def _unit(name: str) -> str:
    return UNITS.get(name.partition("_")[0], "")
