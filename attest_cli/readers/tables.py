"""What CSV and Parquet share: recognised columns of one table -> channels, one per role and instance."""

from __future__ import annotations

import difflib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ..errors import AttestError
from ..records import COLUMNS, Array, Bools, Channel, Ints, Recording, Warn
from ..settings.table import Table
from .columns import (
    DATES,
    HEADER_STAMPS,
    Column,
    bare_quantity,
    counter_column,
    recognise,
    time_columns,
    words_of,
)

EXTRA: Mapping[str, tuple[str, ...]] = {
    "odometry": ("speed", "velocity_sigma_x", "velocity_sigma_y", "velocity_sigma_z"),
    "gps": ("gps_sigma_m", "gps_sigma_up_m"),
    "gps_velocity": ("velocity_down", "velocity_sigma"),
    "magnetometer": ("mag_sigma",),
}
"""Columns a role may have beside those of ``records.COLUMNS``."""

WRITTEN = ("date and time", "time of day")
"""Units of times that are not numbers."""

SIGMAS = frozenset(name for names in EXTRA.values() for name in names) - {"speed", "velocity_down"}
GPS_VELOCITY = frozenset({*COLUMNS["gps_velocity"], *EXTRA["gps_velocity"]})
GPS = frozenset({*COLUMNS["gps"], *EXTRA["gps"]})

NEEDED: Mapping[str, int] = {"gps": 2, "gps_velocity": 2, "sun": 2, "odometry": 1, "position": 2}
"""How many of a role's columns must be there, where not all."""

MAX_BAD_SHARE = 0.01
"""Above this share of rows that cannot be read the file is refused: it is not the table it seems to be."""

MAX_TABLE_BYTES = 2 << 30
SUSPECT_BYTES, MOST_EXPANDED = 256 << 20, 100  # beyond both a file is a bomb: noise does not pack
"""Limit of rows x columns in use x 8 bytes."""

COUNT_HINT = "of a table --sample-rate HZ makes time of a counter, or of the rows"
NAMES_HINT = (
    "name the columns, for instance timestamp_ns,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z; "
    'without touching the log: --columns "OLD=gyro_x [rad/s],..."'
)


@dataclass(frozen=True, slots=True)
class Layout:
    """Which columns of a table are what.

    ``time``: the column of stamps, or of a counter, or none (index -1), where ``rate_hz`` makes time of counts.
    ``seconds``: whole seconds beside a ``time`` within the second; ``date``: that of a ``time`` of day; ``recorder``:
    the recorder's stamps beside those of the sensor. ``other``: names of columns that are not read; ``missing``: those
    that are to be renamed.
    """

    time: Column
    columns: tuple[Column, ...]
    other: Mapping[str, str] = field(default_factory=dict)
    seconds: Column | None = None
    recorder: Column | None = None
    date: Column | None = None
    rate_hz: float | None = None
    missing: Mapping[str, Warn] = field(default_factory=dict)

    @property
    def times(self) -> tuple[Column, ...]:
        """Every column that is needed for the time."""
        return tuple(c for c in (self.time, self.seconds, self.date, self.recorder) if c is not None and c.index >= 0)

    @property
    def told(self) -> tuple[str, ...]:
        """What became of which column, in words; indented what is detail."""
        unit = f", in {self.time.unit}" if self.time.unit else ", its unit by its steps"
        unit = f", as {self.time.unit}" if self.time.unit in WRITTEN else unit
        time = f"time: {self.time.name.strip()!r}{unit}"
        if self.rate_hz is not None:
            time = f"time: {repr(self.time.name) if self.time.index >= 0 else 'the row'} / {self.rate_hz:g} Hz"
        shown = [time]
        for c in self.columns:
            unit = f", in {c.unit}" if c.unit else ", no unit"
            shown.append(f"  {c.instance + ' ' if c.instance else ''}{c.canonical}: {c.name.strip()!r}{unit}")
        return tuple(shown)


def layout_of(
    path: Path, names: Sequence[str], units: Sequence[str] | None = None, table: Table | None = None, *,
    rate_hz: float | None = None, recorder: bool = False,
) -> Layout:  # fmt: skip
    """Recognise the columns of a table by their names and, where there is one, its units row.

    Parameters
    ----------
    table : Table, optional
        Settings: other names for columns, the unit of time, a rate for counters.
    rate_hz : float, optional
        Samples per second, where no column holds time.
    recorder : bool
        Take the stamps of the recorder, not those of the sensor, where there are both.

    Raises
    ------
    AttestError
        If a column appears twice, or there is no time, or nothing that attest knows.
    """
    table, units = table or Table(), units or [""] * len(names)
    spoken, missing = _renamed(path, names, table)
    twice = [name for name, count in Counter(n.strip() for n in spoken).items() if count > 1 and recognise(0, name)]
    if twice:
        raise AttestError(
            f"{path}: column {twice[0]!r} appears more than once", f"give every column a name of its own; {NAMES_HINT}"
        )
    time = times_of(path, spoken, units, table, rate_hz, recorder=recorder)
    taken = {column.index for column in time.times}
    quantity = bare_quantity(spoken, units, path.stem)
    best: dict[tuple[str, str], Column] = {}
    for index, name in enumerate(spoken):
        label = f"{quantity} {name}" if quantity and words_of(name)[0] in (["x"], ["y"], ["z"]) else name
        column = recognise(index, label, units[index]) if index not in taken else None
        if column is not None:
            key = (column.instance, column.canonical)
            best[key] = min(best.get(key, column), column, key=lambda c: c.rank)
    _one_sensor_each(path, spoken, list(best.values()))
    if not best:
        raise AttestError(f"{path}: no column that attest knows among {_some(names)}", NAMES_HINT)
    columns = tuple(replace(column, name=names[column.index]) for column in best.values())
    used = {column.index for column in columns} | taken
    other = {name: "column" for index, name in enumerate(names) if index not in used and name.strip()}
    return replace(time, columns=columns, other=other, missing=missing)


def _renamed(path: Path, names: Sequence[str], table: Table) -> tuple[list[str], dict[str, Warn]]:
    """Put the names of the settings in place of those of the file; one that is not there is said."""
    known = sorted({name.strip() for name in names} - {""})
    missing = dict[str, Warn]()
    for old in table.names:
        if old.strip() not in known:
            near = difflib.get_close_matches(old, known, n=3, cutoff=0.4) or known[:6]
            message = f"{path.name}: no column {old!r} to be {table.names[old]!r}"
            missing[old] = Warn("no-such-column", message, f"the nearest: {', '.join(map(repr, near))}")
    new = {old.strip(): name for old, name in table.names.items()}
    return [new.get(name.strip(), name) for name in names], missing


def _one_sensor_each(path: Path, names: Sequence[str], found: Sequence[Column]) -> None:
    """Refuse columns x, y, z that come again and do not say of what, where there is no gyro and no accelerometer."""
    twice = [name for name, count in Counter(n.strip() for n in names).items() if count > 1]
    axes = [name for name in twice if words_of(name)[0] in (["x"], ["y"], ["z"])]
    if axes and not {"gyro", "accel"} & {column.canonical[:-2] for column in found}:
        message = f"{path}: column {axes[0]!r} appears more than once, and does not say of which sensor"
        raise AttestError(message, f"give every column a name of its own; {NAMES_HINT}")


def times_of(
    path: Path, names: Sequence[str], units: Sequence[str], table: Table, rate_hz: float | None = None, *,
    recorder: bool = False,
) -> Layout:  # fmt: skip
    """Choose what tells the time: a column of stamps, else a counter and a rate."""
    found, counter = time_columns(names, units), counter_column(names)
    dates = [column for column in found if column.canonical in DATES]
    found = [column for column in found if column.canonical not in DATES] or dates
    # neither ticks of no fixed length, often left blank, nor a date alone tell the time beside a counter
    fine = not found or found[0].canonical in {"sample_time_fine", *DATES}
    if table.sample_rate_hz or (rate_hz is not None and fine and (counter or not found)):
        return Layout(counter or Column(-1, "", "row", "", "", 0), (), rate_hz=table.sample_rate_hz or rate_hz)
    if not found:
        counts = f"; {counter.name!r} counts: --sample-rate HZ makes time of it" if counter else f"; {COUNT_HINT}"
        hint = f'name it "timestamp_ns", "time" or "t" (s), for a text log also with --columns "OLD=time [s]"{counts}'
        raise AttestError(f"{path}: no time column among {_some(names)}", hint)
    own = [column for column in found if column.canonical in HEADER_STAMPS]
    others = [column for column in found if column.canonical not in HEADER_STAMPS]
    best = others[0] if recorder and others else found[0]
    alike = [column for column in found if column.canonical == best.canonical and column.unit == "s"]
    seconds = alike[0] if best.unit in {"ms", "us", "ns"} and alike else None
    fallback = others[0] if best in own and others else None
    unit = table.time_unit or best.unit
    date = dates[0] if dates and best.canonical not in DATES else None
    return Layout(replace(best, unit=unit), (), seconds=seconds, date=date, recorder=fallback)


def recording_of(
    path: Path,
    format_name: str,
    layout: Layout,
    values: Mapping[int, Array],
    stamps: Callable[[Bools], tuple[Ints, Array, tuple[Warn, ...]]],
    warnings: Sequence[Warn] = (),
) -> Recording:
    """Group the columns into channels and drop the rows in which a channel is blank.

    Parameters
    ----------
    values : column index -> (n,) float64
        NaN = blank.
    stamps : function
        Takes the rows of the IMU (n,) and returns stamps (n,) int64 ns, validity (n,) and warnings. The rows matter
        because a unit of time is told by the step of the IMU.
    """
    values, invalid = _valid_fixes(path, layout, values)
    groups = _groups(path, layout, values)
    imu_rows = np.zeros(next(iter(values.values())).size, dtype=bool)
    for role, _, columns in groups:
        if role in {"imu", "gyro", "accel"}:
            imu_rows |= ~_blank(columns, values)
    stamps_ns, valid, told = stamps(imu_rows)
    good = ~np.isnan(valid)
    channels = [_channel(role, name, columns, values, stamps_ns, good) for role, name, columns in groups]
    told = (*layout.missing.values(), *told, *warnings)
    if not np.all(good):
        message = f"{path.name}: {np.count_nonzero(~good)} of {good.size} rows dropped: no readable time"
        told += (Warn("rows-without-time", message, "see the rows with attest doctor"),)
    told += invalid
    channels, receiver = _without_receiver_speed(path, channels)
    told += receiver
    told += _empty(path, channels)
    kept = tuple(channel for channel in channels if channel.stamps_ns.size)
    return Recording(path, format_name, kept, int(good.size), layout.other, told, layout.told, layout.missing)


def _valid_fixes(
    path: Path, layout: Layout, values: Mapping[int, Array]
) -> tuple[Mapping[int, Array], tuple[Warn, ...]]:
    """Blank the fixes whose accuracy is negative, and a negative speed with them: so phones mark what is none."""
    kept: dict[int, Array] = {}
    told: list[Warn] = []
    for accuracy in (column for column in layout.columns if column.canonical == "gps_sigma_m"):
        wrong = values[accuracy.index] < 0.0
        if not np.any(wrong):
            continue
        for column in (column for column in layout.columns if column.instance == accuracy.instance):
            if column.canonical in GPS:
                kept[column.index] = np.where(wrong, np.nan, values[column.index])
            elif column.canonical == "speed":
                kept[column.index] = np.where(wrong & (values[column.index] < 0.0), np.nan, values[column.index])
        message = f"{path.name}: {np.count_nonzero(wrong)} fixes dropped: their accuracy is negative"
        told.append(Warn("gps-invalid", message, "a receiver marks fixes so that are none"))
    return ({**values, **kept} if kept else values), tuple(told)


def _without_receiver_speed(path: Path, channels: Sequence[Channel]) -> tuple[list[Channel], tuple[Warn, ...]]:
    """Withhold the role of odometry from a speed that comes with each fix: it is the receiver's, over ground."""
    fixes = [channel.stamps_ns for channel in channels if channel.role == "gps"]
    kept, told = [], tuple[Warn, ...]()
    for channel in channels:
        if set(channel.values) == {"speed"} and any(np.isin(channel.stamps_ns, stamps).all() for stamps in fixes):
            message = (
                f"{path.name}: the speed comes with the fixes, so it is the receiver's, not that of wheels: not used"
            )
            told = (Warn("receiver-speed", message, f"--map odometry={channel.name} uses it all the same"),)
            kept.append(replace(channel, role=""))
        else:
            kept.append(channel)
    return kept, told


def _empty(path: Path, channels: Sequence[Channel]) -> tuple[Warn, ...]:
    """Say which sensors have columns but no value in any row."""
    blank = [c for c in channels if c.role and not c.stamps_ns.size]
    return tuple(
        Warn("channel-empty", f"{path.name}: no row has a value of {c.name} ({', '.join(c.values)})", "not used")
        for c in blank
    )


def _channel(
    role: str, name: str, columns: Mapping[str, Column], values: Mapping[int, Array], stamps_ns: Ints, good: Bools
) -> Channel:
    rows = good & ~_blank(columns, values)
    whole = bool(np.all(rows))
    held = {key: values[c.index] if whole else values[c.index][rows] for key, c in columns.items()}
    units = {key: column.unit for key, column in columns.items()}
    return Channel(name, "columns", role, stamps_ns if whole else stamps_ns[rows], held, units)


def _blank(columns: Mapping[str, Column], values: Mapping[int, Array]) -> Bools:
    blank: Bools = np.logical_and.reduce([np.isnan(values[column.index]) for column in columns.values()])
    return blank


def _groups(path: Path, layout: Layout, values: Mapping[int, Array]) -> list[tuple[str, str, dict[str, Column]]]:
    """Sort the columns into (role, channel name, canonical name -> column); the plain instance comes first."""
    instances = sorted(dict.fromkeys(column.instance for column in layout.columns), key=bool)
    found: list[tuple[str, str, dict[str, Column]]] = []
    for instance in instances:
        mine = {column.canonical: column for column in layout.columns if column.instance == instance}
        if "altitude" in mine and not mine.keys() & {"latitude", "longitude", "baro_height"}:
            mine["baro_height"] = mine.pop("altitude")  # a height without a place
        if not {"velocity_east", "velocity_north"} <= mine.keys():  # half a velocity, or other things named so
            mine = {name: column for name, column in mine.items() if name not in GPS_VELOCITY}
        for role in _roles(mine, values):
            names = (*COLUMNS[role], *EXTRA.get(role, ()))
            columns = {name: mine[name] for name in names if name in mine}
            missing = [name for name in COLUMNS[role][: NEEDED.get(role)] if name not in columns]
            if missing and "speed" not in columns:
                where = f" of {instance}" if instance else ""
                raise AttestError(
                    f"{path}: column {missing[0]}{where} is missing beside {', '.join(columns)}", NAMES_HINT
                )
            found.append((role, instance, columns))
    counts = Counter(role for role, _, _ in found)
    return [
        (_told_role(role, columns), f"{instance}/{role}" if instance and counts[role] > 1 else role, columns)
        for role, instance, columns in found
    ]


def _roles(mine: Mapping[str, Column], values: Mapping[int, Array]) -> list[str]:
    """Name the roles that the columns of one instance play; gyro and accelerometer in shared rows are one imu."""
    roles = [
        role
        for role, names in COLUMNS.items()
        if role not in {"imu", "gyro", "accel"} and mine.keys() & {*names, *EXTRA.get(role, ())} - SIGMAS
    ]
    halves = [role for role in ("gyro", "accel") if mine.keys() & set(COLUMNS[role])]
    if len(halves) == 2:
        gyro, accel = (~_blank({n: mine[n] for n in COLUMNS[role] if n in mine}, values) for role in halves)
        shared = np.count_nonzero(gyro & accel)
        halves = ["imu"] if 2 * shared >= min(np.count_nonzero(gyro), np.count_nonzero(accel)) else halves
    return [*halves, *roles]


def _told_role(role: str, columns: Mapping[str, Column]) -> str:
    """Withhold the role from an orientation under a foreign name: a device's own filter is used only if mapped."""
    return "" if role == "orientation" and any(column.rank for column in columns.values()) else role


def check_size(path: Path, rows: int, columns: int) -> None:
    """Refuse a table that would not fit: the stated size of a file says nothing about it."""
    size = rows * columns * 8
    if size > MAX_TABLE_BYTES:
        limit = f"{MAX_TABLE_BYTES / 2**30:.0f} GiB"
        message = (
            f"{path}: {rows} rows x {columns} columns in use take {size / 2**30:.1f} GiB, over the limit of {limit}"
        )
        raise AttestError(message, "split the log into files of a drive each")
    if size > SUSPECT_BYTES and size > MOST_EXPANDED * path.stat().st_size:
        message = f"{path}: {rows} rows x {columns} columns in use take {MOST_EXPANDED} times the bytes of the file"
        raise AttestError(message, "no sensor says so little: write the log again, or a part of it")


def _some(names: Sequence[str], count: int = 8) -> str:
    shown = ", ".join(repr(name.strip()[:40]) for name in names[:count])
    return shown + (f" and {len(names) - count} more" if len(names) > count else "")
