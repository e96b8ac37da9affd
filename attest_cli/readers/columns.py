"""Names of table columns as seen in real logs -> canonical columns of ``records.COLUMNS``, with instance and unit.

A name is split into words (``IMU::UncompGyro::X [rad/s]`` -> imu, uncomp, gyro, x). The last word is the axis, the
words before it that are a known alias are the quantity, what is left in front is the instance: two IMUs in one table.
The unit stands in brackets, in a units row, or as words beside the axis (``gyro_x_dps``, ``accelerometer_m_s2[0]``).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from ..settings.units import unit

VECTORS: Mapping[str, tuple[str, ...]] = {
    "gyro": (
        "gyro", "gyr", "gyroscope", "angular_velocity", "angular_rate", "ang_vel", "omega", "w_rs_s", "rotation_rate",
        "rate_gyro", "angular_rates", "gyros", "angvel", "angularvelocity", "rot_rate", "turn_rate",
    ),
    "accel": (
        "accel", "acc", "accelerometer", "acceleration", "linear_acceleration", "specific_force", "a_rs_s",
        "accelerometers", "accels", "proper_acceleration",
    ),
    "mag": ("mag", "magn", "magnetometer", "magnetic_field", "magnetic"),
    "sun": ("sun", "sun_sensor", "sun_vector", "sun_direction"),
    "velocity": ("velocity", "vel", "linear_velocity", "twist_linear", "twist_twist_linear"),
    "position": ("position", "pos", "p_rs_r"),
    "q": ("q", "quat", "quaternion", "orientation", "q_rs"),
}  # fmt: skip
"""Canonical stem -> aliases, words joined by ``_``; the first is canonical."""

GLUED: Mapping[str, str] = {"g": "gyro", "w": "gyro", "a": "accel", "m": "mag", "q": "q", "p": "position"}
"""Single letters that count only glued to the axis and without an instance: ``gx``, ``ax``, ``qw``."""

SCALARS: Mapping[str, tuple[str, ...]] = {
    "baro_height": (
        "baro_height", "baro_altitude", "baro_alt", "height_baro", "altitude_baro", "alt_baro", "barometer_height",
        "barometer_altitude", "barometric_height", "barometric_altitude", "pressure_altitude", "relative_altitude",
        "altimeter", "altimeter_height", "altimeter_altitude",
    ),
    **{
        f"velocity_{name}": (
            f"velocity_{name}", f"{name}_velocity", f"vel_{name}", f"velocity_{a}", f"vel_{a}", f"v_{a}", f"v{a}",
            f"v_{name}", *(f"{stem}_{a}" for stem in ("velocity_ned", "vel_ned", "velocity_enu", "vel_enu")),
        )
        for name, a in (("east", "e"), ("north", "n"), ("up", "u"), ("down", "d"))
    },
    "velocity_sigma": ("speed_accuracy", "velocity_accuracy"),
    "latitude": ("latitude", "lat"),
    "longitude": ("longitude", "lon", "lng", "long"),
    "altitude": ("altitude", "alt", "height"),
    "gps_sigma_m": ("gps_sigma", "horizontal_accuracy"),
    "gps_sigma_up_m": ("gps_sigma_up", "vertical_accuracy"),
    "compass_deg": ("compass", "compass_heading", "heading"),
    "speed": ("speed", "forward_speed", "wheel_speed"),
    "temperature_c": ("temperature", "temp"),
}  # fmt: skip
"""Canonical name -> aliases, words joined by ``_`` and without a unit."""

DATES = ("date", "local_date", "utc_date", "date_utc")
"""Names of a column of dates beside times of day."""

TIME = (
    "timestamp", "header_stamp", "field_header_stamp", "time", "t", "seconds_elapsed", "elapsed", "elapsed_time",
    "time_elapsed", "elapsed_seconds", "stamp", "time_stamp", "datetime", "date_time", "utc", "unix_time",
    "unix_timestamp", "epoch", "epoch_time", "uptime", "time_boot", "time_since_boot", "time_since_start", "host_time",
    "host_timestamp", "system_time", "logging_time", "seconds", "millis", "micros", "local_time", "time_of_day",
    "utc_time", "sample_time_fine", *DATES,
)  # fmt: skip
"""Names of the time column without their unit, best first."""

HEADER_STAMPS = frozenset({"header_stamp", "field_header_stamp"})
"""The sensor's own stamp of a ROS message, beside the one of the recorder."""

COUNTERS = (
    "packet_counter", "counter", "sample_counter", "sample_number", "sample_index", "sample_id", "sample", "packet",
    "packet_number", "frame_number", "frame", "count", "seq", "sequence", "index",
)  # fmt: skip
"""Names of columns that count samples, best first: time, where a rate is known."""

TIME_ENDINGS: Mapping[str, str] = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("ms", "msec", "msecs", "millis", "millisec", "millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("us", "usec", "usecs", "micros", "microsec", "microsecond", "microseconds"), "us"),
    **dict.fromkeys(("min", "mins", "minute", "minutes"), "min"),
    **dict.fromkeys(("h", "hr", "hour", "hours"), "h"),
    **dict.fromkeys(("d", "day", "days"), "d"),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanos", "nanosec", "nanosecs", "nanosecond", "nanoseconds"), "ns"),
}
"""Last word of a time column -> its unit."""

CANONICAL_UNITS: Mapping[str, str] = {
    **{f"gyro_{axis}": "rad/s" for axis in "xyz"},
    **{f"accel_{axis}": "m/s^2" for axis in "xyz"},
    **{f"mag_{axis}": "uT" for axis in "xyz"},
    **{f"sun_{axis}": "1" for axis in "xyz"},
    **{f"q_{axis}": "1" for axis in "wxyz"},
    **{f"velocity_{axis}": "m/s" for axis in "xyz"},
    **{f"position_{axis}": "m" for axis in "xyz"},
    "speed": "m/s", "compass_deg": "deg", "latitude": "deg", "longitude": "deg", "altitude": "m", "gps_sigma_m": "m",
    "gps_sigma_up_m": "m", "baro_height": "m", "velocity_sigma": "m/s", "temperature_c": "degC",
    "timestamp_ns": "ns", "mag_sigma": "uT",
    **{f"velocity_sigma_{axis}": "m/s" for axis in "xyz"},
    **{f"velocity_{way}": "m/s" for way in ("east", "north", "up", "down")},
}  # fmt: skip
"""Unit of a column that bears its canonical name (``interface.md``, Roles)."""

NOT_MEASURED = frozenset({
    "truth", "true", "gt", "groundtruth", "ground", "reference", "ref", "opt", "bias", "b", "sigma", "std", "cov",
    "covariance", "var", "variance", "delta", "pose", "linear", "user", "free", "gravity", "mean", "target", "cmd",
    "command", "setpoint", "vicon", "optitrack", "mocap", "estimated", "est",
})  # fmt: skip
"""Words that make a column something else than the measurement: truth, bias, sigma, increments, commands."""

NOISE_WORDS = frozenset({
    "imu", "gps", "gnss", "pos", "lla", "field", "data", "msg", "sensor", "sensors", "message",
})  # fmt: skip
"""Words in front of a quantity that say nothing."""

_UNIT_WORDS: Mapping[tuple[str, ...], str] = {
    **dict.fromkeys([("rad", "s"), ("rad", "sec"), ("rads",), ("radps",), ("rad", "per", "s")], "rad/s"),
    **dict.fromkeys([("deg", "s"), ("deg", "sec"), ("degs",), ("dps",), ("degps",), ("deg", "per", "s")], "deg/s"),
    **dict.fromkeys([("m", "s", "2"), ("ms", "2"), ("mps", "2"), ("mss",), ("m", "s", "s"), ("mpss",)], "m/s^2"),
    ("mdps",): "mdps", ("g",): "g", ("gs",): "g", ("mg",): "mg", ("ut",): "uT", ("nt",): "nT", ("gauss",): "Gauss",
    ("mgauss",): "mGauss", ("deg",): "deg", ("rad",): "rad", ("m", "s"): "m/s", ("mps",): "m/s", ("m",): "m",
    ("c",): "degC",
}  # fmt: skip
_UNIT_NAMES: Mapping[str, str] = {
    "G": "Gauss", "Celsius": "degC", "celsius": "degC", "C": "degC", "deg C": "degC", "°C": "degC", "-": "", "1": "1",
    "m/s/s": "m/s^2", "m/s2": "m/s^2", "m/s²": "m/s^2", "m/sec^2": "m/s^2", "dps": "deg/s", "°/s": "deg/s",
    "°": "deg", "degrees": "deg", "degrees/s": "deg/s", "deg/sec": "deg/s", "rad/sec": "rad/s", "rad s^-1": "rad/s",
    "deg s^-1": "deg/s", "m s^-1": "m/s", "m s^-2": "m/s^2", "rad.s-1": "rad/s", "m.s-2": "m/s^2",
    "uTesla": "uT", "microTesla": "uT", "microtesla": "uT", "Tesla": "T", "tesla": "T", "gs": "g", "G's": "g",
    **{name: short for name, short in TIME_ENDINGS.items() if name != short},
}  # fmt: skip
_OF_QUANTITY: Mapping[str, Mapping[str, str]] = {
    "accel": {"Gauss": "g", "mG": "mg"},
    "gyro": {"deg": "deg/s", "rad": "rad/s"},
}
"""Units that are written for another one beside a quantity: physics holds them to it later."""

_BARE_UNITS: Mapping[tuple[float, ...], str] = {
    unit("rad/s")[1]: "gyro", unit("m/s^2")[1]: "accel", unit("T")[1]: "mag",
}  # fmt: skip
"""What a column named ``x`` measures, by the dimensions of its unit."""

_INDEX = {"0": "x", "1": "y", "2": "z"}


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
    """Spell a unit as ``settings.units`` reads it: ``rad s^-1`` -> ``rad/s``; empty where none is stated."""
    text = text.strip().replace("µ", "u").replace("μ", "u").replace("º", "°")
    return _UNIT_NAMES.get(text, re.sub(r"\s+", "*", text))


def is_unit(text: str) -> bool:
    """Tell whether a cell holds the name of a unit (a blank one may)."""
    text = re.sub(r"^\s*[\[(](.*)[\])]\s*$", r"\1", text)
    name = unit_name(text)
    if not name or name in _UNIT_NAMES.values() or text.strip() in {"kPa", "Pa", "hPa", "V", "%", "K", "n/a"}:
        return True
    try:
        unit(name)
    except ValueError:
        return False
    return True


def words_of(name: str) -> tuple[list[str], str]:
    """Split a column name into lower-case words and the unit in its brackets; ``[0]`` is the axis x."""
    match = re.fullmatch(r"\s*([^\[\]()]*?)\s*[\[(]([^\[\]()]*)[\])]([^\[\]()]*)", name)
    text, stated = (f"{match[1]} {match[3]}", match[2]) if match else (name, "")
    words = [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", text)]
    if stated in _INDEX:  # of a quaternion it could be w, x, y, z or x, y, z, w
        return [*words, *([] if set(words) & set(VECTORS["q"]) else [_INDEX[stated]])], ""
    return words, unit_name(stated)


def recognise(index: int, name: str, stated: str = "") -> Column | None:
    """Return what the column is, or None if attest does not know it. ``stated``: its cell in a units row."""
    words, unit_in_name = words_of(name)
    stated = unit_in_name or unit_name(stated.strip("[]() "))
    if name.strip() in CANONICAL_UNITS:
        return Column(index, name, name.strip(), "", stated or CANONICAL_UNITS[name.strip()], 0)
    found = _scalar(words) or _vector(words)
    if found is None:
        return None
    canonical, instance, rank, suffix_unit = found
    spelled = _OF_QUANTITY.get(canonical[:-2], {})
    stated = stated or suffix_unit
    return Column(index, name, canonical, instance, spelled.get(stated, stated), rank + 1)


def bare_quantity(names: Sequence[str], units: Sequence[str], stem: str) -> str:
    """Tell what columns named just ``x``, ``y``, ``z`` measure: by the name of their file, else by their unit.

    Phones write one file per sensor: ``Gyroscope.csv`` with ``time,seconds_elapsed,z,y,x``. Empty where neither tells.
    """
    found = {words[0]: stated or unit_name(units[k]) for k, name in enumerate(names)
             for words, stated in [words_of(name)] if len(words) == 1 and words[0] in {"x", "y", "z"}}  # fmt: skip
    if len(found) < 3:
        return ""
    words, _ = words_of(stem)
    while words and words[-1].isdigit():
        words.pop()
    column = recognise(0, "_".join([*words, "x"]))
    if column is not None and column.canonical[:-2] in set(_BARE_UNITS.values()):
        return "_".join(words)
    try:
        kinds = {_BARE_UNITS.get(unit(stated)[1], "") for stated in found.values()}
    except ValueError:
        return ""
    return kinds.pop() if len(kinds) == 1 else ""


def time_columns(names: Sequence[str], units: Sequence[str]) -> list[Column]:
    """Find the time columns, best first; ``canonical`` is the name without its unit."""
    found = []
    for index, name in enumerate(names):
        words, stated = words_of(name)
        ending = TIME_ENDINGS.get(words[-1], "") if words else ""
        base = "_".join(words[:-1] if ending and "_".join(words[:-1]) in TIME else words)
        if base in TIME:
            stated = stated or unit_name(units[index].strip("[]() ")) or ending
            stated = stated or ("s" if "seconds" in words else "")
            found.append(Column(index, name, base, "", stated, TIME.index(base)))
    return sorted(found, key=lambda column: (column.rank, column.unit == "s"))


def time_column(names: Sequence[str], units: Sequence[str]) -> Column | None:
    """Find the best time column."""
    found = time_columns(names, units)
    return found[0] if found else None


def counter_column(names: Sequence[str]) -> Column | None:
    """Find the column that counts samples."""
    found = []
    for index, name in enumerate(names):
        words = [word for word in words_of(name)[0] if word not in {"field", "header"}]
        if "_".join(words) in COUNTERS:
            found.append(Column(index, name, "counter", "", "", COUNTERS.index("_".join(words))))
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
    """Match stem and axis against the aliases; the longest alias wins."""
    matches = []
    for stem, axis, suffix_unit in _stems(words):
        if len(stem) == 1 and stem[0] in GLUED:
            quantity = GLUED[stem[0]]
            if _axis_fits(quantity, axis):
                return f"{quantity}_{axis}", "", len(VECTORS[quantity]), suffix_unit
        matches += [
            (len(alias), quantity, axis, front, rank, suffix_unit)
            for quantity, aliases in VECTORS.items()
            for rank, alias in enumerate(aliases)
            if _axis_fits(quantity, axis) and (front := _front(stem, alias)) is not None
        ]
    if not matches:
        return None
    _, quantity, axis, front, rank, suffix_unit = max(matches, key=lambda match: match[0])
    return f"{quantity}_{axis}", "_".join(front), rank, suffix_unit


def _stems(words: list[str]) -> Iterator[tuple[list[str], str, str]]:
    """Yield words in front of the axis, axis, and unit: the unit may stand behind the axis, before it, or nowhere."""
    outer, outer_unit = _without_unit(words)
    words = words if outer_unit else _counted_first(words)
    for whole, behind in ((outer, outer_unit), (words, "")) if outer_unit else ((words, ""),):
        if not whole:
            continue
        last = "w" if whole[-1] in {"scalar", "s"} else whole[-1]
        if len(last) > 1 and last[-1] in "xyzw":  # glued: gx, gyrox
            stem, axis = [*whole[:-1], last[:-1]], last[-1]
        else:
            stem, axis = whole[:-1], last
        if axis not in {"x", "y", "z", "w"} or not stem:
            continue
        yield _counted_first(stem), axis, behind
        inner, before = _without_unit(stem)
        if before and not behind:
            yield _counted_first(inner), axis, before


def _counted_first(words: list[str]) -> list[str]:
    """Put the number of a sensor in front, where instances stand: ``acc2_x``, ``gyro_x_1``."""
    return [words[-1], *words[:-1]] if len(words) > 1 and words[-1].isdigit() else words


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
