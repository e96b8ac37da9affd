"""Names of table columns as seen in real logs -> canonical columns of ``records.COLUMNS``, with instance and unit.

A name is split into words (``IMU::UncompGyro::X [rad/s]`` -> imu, uncomp, gyro, x). The last word is the axis, the
words before it that are a known alias are the quantity, what is left in front is the instance: two IMUs in one table.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ..settings.units import unit

VECTORS: Mapping[str, tuple[str, ...]] = {
    "gyro": ("gyro", "gyr", "gyroscope", "angular_velocity", "angular_rate", "ang_vel", "omega", "w_rs_s"),
    "accel": ("accel", "acc", "accelerometer", "acceleration", "linear_acceleration", "specific_force", "a_rs_s"),
    "mag": ("mag", "magn", "magnetometer", "magnetic_field"),
    "sun": ("sun", "sun_sensor", "sun_vector", "sun_direction"),
    "velocity": ("velocity", "vel", "linear_velocity", "twist_linear", "twist_twist_linear"),
    "position": ("position", "pos", "p_rs_r"),
    "q": ("q", "quat", "quaternion", "orientation", "q_rs"),
}
"""Canonical stem -> aliases, words joined by ``_``; the first is canonical."""

GLUED: Mapping[str, str] = {"g": "gyro", "w": "gyro", "a": "accel", "m": "mag", "q": "q", "p": "position"}
"""Single letters that count only glued to the axis and without an instance: ``gx``, ``ax``, ``qw``."""

SCALARS: Mapping[str, tuple[str, ...]] = {
    "latitude": ("latitude", "lat"),
    "longitude": ("longitude", "lon", "lng"),
    "altitude": ("altitude", "alt", "height"),
    "gps_sigma_m": ("gps_sigma",),
    "gps_sigma_up_m": ("gps_sigma_up",),
    "compass_deg": ("compass", "compass_heading", "heading"),
    "speed": ("speed", "forward_speed", "wheel_speed"),
    "temperature_c": ("temperature", "temp"),
}
"""Canonical name -> aliases, words joined by ``_`` and without a unit."""

TIME = (
    "timestamp_ns", "timestamp", "header_stamp", "field_header_stamp", "time", "t", "t_s", "time_s", "timestamp_s",
    "seconds", "seconds_elapsed", "timestamp_seconds", "time_ns", "t_ns", "timestamp_us", "time_us", "t_us",
    "timestamp_ms", "time_ms", "t_ms", "stamp", "datetime", "date_time", "utc",
)  # fmt: skip
"""Names of the time column, best first."""

CANONICAL_UNITS: Mapping[str, str] = {
    **{f"gyro_{axis}": "rad/s" for axis in "xyz"},
    **{f"accel_{axis}": "m/s^2" for axis in "xyz"},
    **{f"mag_{axis}": "uT" for axis in "xyz"},
    **{f"sun_{axis}": "1" for axis in "xyz"},
    **{f"q_{axis}": "1" for axis in "wxyz"},
    **{f"velocity_{axis}": "m/s" for axis in "xyz"},
    **{f"position_{axis}": "m" for axis in "xyz"},
    "speed": "m/s", "compass_deg": "deg", "latitude": "deg", "longitude": "deg", "altitude": "m", "gps_sigma_m": "m",
    "gps_sigma_up_m": "m", "temperature_c": "degC", "timestamp_ns": "ns",
}  # fmt: skip
"""Unit of a column that bears its canonical name (``interface.md``, Roles)."""

NOT_MEASURED = frozenset({
    "truth", "true", "gt", "groundtruth", "ground", "reference", "ref", "opt", "bias", "b", "sigma", "std", "cov",
    "covariance", "var", "variance", "delta", "pose", "linear", "user", "free", "gravity", "mean", "target", "cmd",
    "command", "setpoint",
})  # fmt: skip
"""Words that make a column something else than the measurement: truth, bias, sigma, increments, commands."""

NOISE_WORDS = frozenset({"imu", "gps", "gnss", "pos", "lla", "field", "data", "msg", "sensor", "sensors", "message"})
"""Words in front of a quantity that say nothing."""

_UNIT_WORDS: Mapping[tuple[str, ...], str] = {
    ("rad", "s"): "rad/s", ("deg", "s"): "deg/s", ("dps",): "deg/s", ("m", "s", "2"): "m/s^2", ("mps", "2"): "m/s^2",
    ("g",): "g", ("mg",): "mg", ("ut",): "uT", ("nt",): "nT", ("gauss",): "Gauss", ("deg",): "deg", ("rad",): "rad",
    ("m", "s"): "m/s", ("mps",): "m/s", ("m",): "m", ("c",): "degC",
}  # fmt: skip
_UNIT_NAMES: Mapping[str, str] = {
    "G": "Gauss", "Celsius": "degC", "celsius": "degC", "C": "degC", "deg C": "degC", "°C": "degC", "-": "", "1": "1",
    "sec": "s", "seconds": "s", "msec": "ms", "milliseconds": "ms", "usec": "us", "microseconds": "us", "nsec": "ns",
    "nanoseconds": "ns", "m/s/s": "m/s^2", "m/s2": "m/s^2", "m/s²": "m/s^2", "dps": "deg/s", "°/s": "deg/s",
    "°": "deg", "degrees": "deg",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Column:
    """A column of interest: its place in the table, its name there, canonical name, instance, unit as stated."""

    index: int
    name: str
    canonical: str
    instance: str
    unit: str
    rank: int  # 0: its canonical name; then the order of the aliases


def unit_name(text: str) -> str:
    """Spell a unit as ``settings.units`` reads it: ``rad s^-1`` -> ``rad*s^-1``; empty where none is stated."""
    text = text.strip().replace("µ", "u").replace("μ", "u")
    return _UNIT_NAMES.get(text, re.sub(r"\s+", "*", text))


def is_unit(text: str) -> bool:
    """Tell whether a cell holds the name of a unit (a blank one may)."""
    name = unit_name(text)
    if not name or name in _UNIT_NAMES.values() or text.strip() in {"kPa", "Pa", "hPa", "V", "%", "K", "n/a"}:
        return True
    try:
        unit(name)
    except ValueError:
        return False
    return True


def words_of(name: str) -> tuple[list[str], str]:
    """Split a column name into lower-case words and the unit in its last brackets."""
    match = re.fullmatch(r"\s*(.*?)\s*[\[(]([^\[\]()]*)[\])]\s*", name)
    text, stated = (match[1], unit_name(match[2])) if match else (name, "")
    words = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", text)
    return [word.lower() for word in words], stated


def recognise(index: int, name: str, stated: str = "") -> Column | None:
    """Return what the column is, or None if attest does not know it. ``stated``: its cell in a units row."""
    words, unit_in_name = words_of(name)
    stated = unit_in_name or unit_name(stated)
    if name.strip() in CANONICAL_UNITS:
        return Column(index, name, name.strip(), "", stated or CANONICAL_UNITS[name.strip()], 0)
    found = _scalar(words) or _vector(words)
    if found is None:
        return None
    canonical, instance, rank, suffix_unit = found
    return Column(index, name, canonical, instance, stated or suffix_unit, rank + 1)


def time_column(names: Sequence[str], units: Sequence[str]) -> Column | None:
    """Find the time column: the best name of ``TIME``; its unit from brackets, the units row or the name's end."""
    found = []
    for index, name in enumerate(names):
        words, stated = words_of(name)
        joined = "_".join(words)
        if joined in TIME:
            ending = words[-1] if len(words) > 1 and words[-1] in {"s", "ms", "us", "ns"} else ""
            stated = stated or unit_name(units[index]) or ending or ("s" if "seconds" in joined else "")
            found.append(Column(index, name, "time", "", stated, TIME.index(joined)))
    return min(found, key=lambda column: column.rank) if found else None


def _scalar(words: list[str]) -> tuple[str, str, int, str] | None:
    words, suffix_unit = _without_unit([word for word in words if word not in {"scalar", "value"}])
    for canonical, aliases in SCALARS.items():
        for rank, alias in enumerate(aliases):
            front = _front(words, alias)
            if front is not None and (canonical != "compass_deg" or "_".join(words) == alias):  # else it is a course
                return canonical, "_".join(front), rank, suffix_unit
    return None


def _vector(words: list[str]) -> tuple[str, str, int, str] | None:
    words, suffix_unit = _without_unit(words)
    if not words:
        return None
    last = "w" if words[-1] in {"scalar", "s"} else words[-1]
    if len(last) > 1 and last[-1] in "xyzw":  # glued: gx, gyrox
        stem, axis = [*words[:-1], last[:-1]], last[-1]
    else:
        stem, axis = words[:-1], last
    if axis not in {"x", "y", "z", "w"} or not stem:
        return None
    if len(stem) == 1 and stem[0] in GLUED:
        quantity = GLUED[stem[0]]
        return (f"{quantity}_{axis}", "", len(VECTORS[quantity]), suffix_unit) if _axis_fits(quantity, axis) else None
    matches = [
        (len(alias), quantity, front, rank)
        for quantity, aliases in VECTORS.items()
        for rank, alias in enumerate(aliases)
        if _axis_fits(quantity, axis) and (front := _front(stem, alias)) is not None
    ]
    if not matches:
        return None
    _, quantity, front, rank = max(matches, key=lambda match: match[0])
    return f"{quantity}_{axis}", "_".join(front), rank, suffix_unit


def _axis_fits(quantity: str, axis: str) -> bool:
    return axis != "w" or quantity == "q"


def _front(words: list[str], alias: str) -> list[str] | None:
    """Return the words in front of the alias, without noise; None if it is another quantity."""
    tail = alias.split("_")
    if words[-len(tail) :] != tail:
        return None
    front = words[: -len(tail)]
    return None if NOT_MEASURED.intersection(front) else [word for word in front if word not in NOISE_WORDS]


def _without_unit(words: list[str]) -> tuple[list[str], str]:
    """Cut a unit written as words off the end: ``gyro_x_deg_s`` -> gyro, x and ``deg/s``."""
    for length in (3, 2, 1):
        name = _UNIT_WORDS.get(tuple(words[-length:]))
        if name and len(words) > length:
            return words[:-length], name
    return words, ""
