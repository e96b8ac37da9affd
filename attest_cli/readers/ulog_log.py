r"""PX4 ULog: sensors in forward-right-down body axes are turned to forward-left-up, north-east-down to east-north-up.

.. math:: v_{FLU} = diag(1, -1, -1)\, v_{FRD}, \qquad q_{ENU,FLU} = q_{ENU,NED}\, q_{NED,FRD}\, q_{FRD,FLU}

Stamps count microseconds from the start of the autopilot. Its own estimates have no role; its attitude can be mapped.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..errors import AttestError
from ..maths import rotation
from ..records import COLUMNS, LATEST_NS, Array, Channel, Ints, Recording, Warn
from ..settings import Settings
from .extras import extra
from .reference import ENU_FROM_NED, FLU_FROM_FRD
from .topics import line

Data = Mapping[str, NDArray[Any]]
MOST_FIELDS = 4096
"""Limit on the numbers of one record, nested types unrolled; PX4's largest has some hundred."""
HEAD_BYTES = 3  # length and letter of a record
MOST_READ = 8  # times the bytes of a file
NO_ACCEL = np.iinfo(np.int32).max  # accelerometer_timestamp_relative: no reading in this record
NS_PER_US = 1000
LATEST_US = LATEST_NS // NS_PER_US
DECIMATED = 0.5  # integrals over less than this share of the time between them leave the rest out
TESLA = 1e-4  # per gauss
AGAIN = "copy it again from the autopilot"
NOTE = "axes: body turned from forward-right-down to forward-left-up, world from north-east-down to east-north-up"
CLOCK = "time: microseconds since the autopilot started"


def read(path: Path, settings: Settings) -> Recording:
    """Read the sensors of a ULog; see ``readers.read``."""
    library = extra(path, "pyulog", "ulog", "a PX4 ULog")
    warnings: list[Warn] = []
    log = _load(path, library, warnings)
    channels: list[Channel] = []
    topics = {data.name for data in log.data_list}
    rows = 0
    for data in log.data_list:
        name = f"{data.name}/{data.multi_id}" if data.multi_id else data.name
        try:
            stamps_ns = _stamps(path, name, data.data, settings.time.source)
            rows += stamps_ns.size
            channels += TOPICS[data.name](name, stamps_ns, data.data, warnings)
        except KeyError as error:
            raise AttestError(f"{path}: {name} has no field {error}", "was it written by another autopilot?") from None
    if "sensor_combined" in topics:  # the same sensors: those that the autopilot flew with, at their full rate
        channels = [
            _without_role(channel) if channel.name.startswith("vehicle_imu") else channel for channel in channels
        ]
    other = {name: "PX4 format" for name in sorted(log.message_formats) if name not in topics}
    return Recording(path, "ulog", tuple(channels), rows, other, tuple(warnings), (CLOCK, NOTE))


def _load(path: Path, library: Any, warnings: list[Warn]) -> Any:
    """Read the chosen topics with pyulog, which says on stdout what it finds wrong; say what is lost."""
    faults = (library.ULogException, ValueError, KeyError, IndexError, TypeError, OverflowError, RecursionError)
    try:
        with path.open("rb") as stream, contextlib.redirect_stdout(io.StringIO()):
            size = path.stat().st_size
            _check_formats(path, library.ULog(_Kept(stream, size), parse_header_only=True).message_formats)
            stream.seek(0)
            kept = _Kept(stream, size)
            log = library.ULog(kept, message_name_filter_list=list(TOPICS))
            given_up = bool(stream.read(1))  # it stops without a word at some kinds of damage
    except faults as error:
        raise AttestError(f"{path}: damaged ULog: {line(error)}", AGAIN) from None
    except OSError as error:
        raise AttestError(f"{path}: cannot be read: {error.strerror}") from None
    if log.file_corruption or given_up:
        until = f" after {log.last_timestamp * 1e-6:.3f} s" if given_up else ""
        message = f"{path.name}: damaged ULog: records{until} could not be read"
        warnings.append(Warn("damaged-ulog", message, AGAIN, lost=True))
    if kept.cut:
        message = f"{path.name}: the ULog ends within a record, after {log.last_timestamp * 1e-6:.3f} s: cut short"
        warnings.append(Warn("cut-ulog", message, AGAIN, lost=True))
    if log.dropouts:
        lost_s = sum(dropout.duration for dropout in log.dropouts) * 1e-3
        message = f"{path.name}: {len(log.dropouts)} dropouts of the logger, {lost_s:.1f} s in all"
        warnings.append(Warn("logger-dropouts", message, "a faster SD card, or fewer topics"))
    return log


class _Kept:
    """A stream that outlives pyulog, which closes what it reads, and that knows of a record cut short.

    Damage can send pyulog back to where it was, for ever: what it may read in all is limited.
    """

    def __init__(self, stream: BinaryIO, size: int) -> None:
        self._stream, self.seek, self.tell = stream, stream.seek, stream.tell
        self.cut = False
        self._left = MOST_READ * (size + HEAD_BYTES)

    def read(self, size: int) -> bytes:
        """Read, and note whether all that was asked for is there; no head of a record is the end of the file."""
        data = self._stream.read(size)
        self._left -= len(data) + 1
        if self._left < 0:
            raise ValueError("a record that leads back to itself")
        self.cut = len(data) < size and (bool(data) or size > HEAD_BYTES)
        return data

    def close(self) -> None:
        """Leave it open."""


def _check_formats(path: Path, formats: Mapping[str, Any]) -> None:
    """Refuse nested formats that unroll to more numbers than a record can have, before the library unrolls them."""
    sizes: dict[str, int] = {}

    def size(name: str, depth: int = 0) -> int:
        if name not in formats or depth > len(formats):  # a number, or a format that holds itself
            return MOST_FIELDS + 1 if depth > len(formats) else 1
        if name not in sizes:
            total = 0
            for kind, count, _ in formats[name].fields:
                total += max(count, 1) * size(kind, depth + 1)
                if total > MOST_FIELDS:
                    message = f"{path}: damaged ULog: the format {name[:40]!r} has more than {MOST_FIELDS} fields"
                    raise AttestError(message, AGAIN)
            sizes[name] = total
        return sizes[name]

    for name in formats:
        size(name)


def _stamps(path: Path, name: str, data: Data, source: str) -> Ints:
    """Return when the sensor measured, or by request when it was logged."""
    logged = data["timestamp"]
    sampled = data.get("timestamp_sample", logged) if source == "header" else logged
    stamps: NDArray[np.uint64] = np.where(sampled == 0, logged, sampled)
    if stamps.size and int(stamps.max()) > LATEST_US:
        raise AttestError(
            f"{path}: damaged ULog: a stamp of {name} that is no time", "copy it again from the autopilot"
        )
    return stamps.astype(np.int64) * NS_PER_US


def _floats(column: NDArray[Any]) -> Array:
    with np.errstate(invalid="ignore"):  # a NaN that signals is one all the same
        return column.astype(np.float64)


def _vector(data: Data, name: str) -> Array:
    """Return a vector of the body (n, 3), turned to forward-left-up."""
    return np.stack([_floats(data[f"{name}[{k}]"]) * sign for k, sign in enumerate((1.0, -1.0, -1.0))], axis=1)


def _channel(name: str, kind: str, role: str, stamps_ns: Ints, values: Array, unit: str | tuple[str, ...]) -> Channel:
    columns = COLUMNS[role or "orientation"]
    units = (unit,) * len(columns) if isinstance(unit, str) else unit
    return Channel(
        name, kind, role, stamps_ns, {c: np.ascontiguousarray(values[:, k]) for k, c in enumerate(columns)},
        dict(zip(columns, units, strict=True)),
    )  # fmt: skip


def _without_role(channel: Channel) -> Channel:
    return Channel(channel.name, channel.kind, "", channel.stamps_ns, channel.values, channel.units)


IMU_UNITS = ("rad/s",) * 3 + ("m/s^2",) * 3


def _combined(name: str, stamps_ns: Ints, data: Data, _: list[Warn]) -> list[Channel]:
    """Gyro and accelerometer in one record; where the accelerometer has a time of its own, two channels."""
    gyro, accel = _vector(data, "gyro_rad"), _vector(data, "accelerometer_m_s2")
    behind = data["accelerometer_timestamp_relative"].astype(np.int64)
    has = behind != NO_ACCEL
    if not np.any(behind[has]):
        accel[~has] = np.nan
        return [_channel(name, "sensor_combined", "imu", stamps_ns, np.concatenate([gyro, accel], axis=1), IMU_UNITS)]
    own = stamps_ns[has] + behind[has] * NS_PER_US
    return [
        _channel(f"{name}#gyro", "sensor_combined", "gyro", stamps_ns, gyro, "rad/s"),
        _channel(f"{name}#accel", "sensor_combined", "accel", own, accel[has], "m/s^2"),
    ]


def _imu(name: str, stamps_ns: Ints, data: Data, warnings: list[Warn]) -> list[Channel]:
    """Mean rate and force over the interval of each integral; a record without an interval is blank."""
    parts = []
    for which in ("delta_angle", "delta_velocity"):
        span_s = _floats(data[f"{which}_dt"]) * 1e-6
        parts.append(_vector(data, which) / np.where(span_s > 0.0, span_s, np.nan)[:, None])
    step_s = float(np.median(np.diff(stamps_ns))) * 1e-9 if stamps_ns.size > 1 else 0.0
    covered = float(np.median(data["delta_angle_dt"])) * 1e-6
    if covered < DECIMATED * step_s:
        message = f"{name}: an integral over {covered * 1e3:.1f} ms every {step_s * 1e3:.1f} ms: the rest is not logged"
        warnings.append(Warn("decimated-imu", message, "log sensor_combined, or vehicle_imu at its full rate"))
    return [_channel(name, "vehicle_imu", "imu", stamps_ns, np.concatenate(parts, axis=1), IMU_UNITS)]


def _magnetometer(name: str, stamps_ns: Ints, data: Data, _: list[Warn]) -> list[Channel]:
    field_t = _vector(data, "magnetometer_ga") * TESLA
    return [_channel(name, "vehicle_magnetometer", "magnetometer", stamps_ns, field_t, "T")]


def _gps(name: str, stamps_ns: Ints, data: Data, _: list[Warn]) -> list[Channel]:
    """Places in degrees and metres (since PX4 1.14), or in 1e-7 deg and mm; below a 2-D fix there is none."""
    if "latitude_deg" in data:
        places = [data[part] for part in ("latitude_deg", "longitude_deg", "altitude_ellipsoid_m")]
    else:
        ellipsoid = data.get("alt_ellipsoid", np.zeros(1))
        height = ellipsoid if np.any(ellipsoid) else data["alt"]
        places = [data["lat"] * 1e-7, data["lon"] * 1e-7, height * 1e-3]
    fix = data["fix_type"]
    columns = dict(zip(COLUMNS["gps"], (np.where(fix < 2, np.nan, _floats(p)) for p in places), strict=True))
    columns["altitude"] = np.where(fix < 3, np.nan, columns["altitude"])
    for column, stated in (("gps_sigma_m", "eph"), ("gps_sigma_up_m", "epv")):
        sigma = _floats(data[stated])
        columns[column] = np.where(sigma > 0.0, sigma, np.nan)
    units = {column: "deg" if column in {"latitude", "longitude"} else "m" for column in columns}
    return [Channel(name, "vehicle_gps_position", "gps", stamps_ns, columns, units)]


def _attitude(name: str, stamps_ns: Ints, data: Data, _: list[Warn]) -> list[Channel]:
    """The autopilot's own attitude: a candidate without a role."""
    q = np.stack([_floats(data[f"q[{k}]"]) for k in range(4)], axis=1)
    turned = rotation.multiply(rotation.multiply(ENU_FROM_NED, q), FLU_FROM_FRD)
    return [_channel(f"{name}#orientation", "vehicle_attitude", "", stamps_ns, turned, "1")]


TOPICS: Mapping[str, Callable[[str, Ints, Data, list[Warn]], list[Channel]]] = {
    "sensor_combined": _combined,
    "vehicle_imu": _imu,
    "vehicle_magnetometer": _magnetometer,
    "vehicle_gps_position": _gps,
    "vehicle_attitude": _attitude,
}
"""Topic of PX4 -> its channels."""
