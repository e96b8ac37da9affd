"""What CSV and Parquet share: recognised columns of one table -> channels, one per role and instance."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..errors import AttestError
from ..records import COLUMNS, Array, Bools, Channel, Ints, Recording, Warn
from .columns import Column, recognise, time_column

EXTRA: Mapping[str, tuple[str, ...]] = {"odometry": ("speed",), "gps": ("gps_sigma_m", "gps_sigma_up_m")}
"""Columns a role may have beside those of ``records.COLUMNS``."""

NEEDED: Mapping[str, int] = {"gps": 2, "sun": 2, "odometry": 1, "position": 2}
"""How many of a role's columns must be there, where not all."""

MAX_TABLE_BYTES = 2 << 30
"""Limit of rows x columns in use x 8 bytes."""

NAMES_HINT = "name the columns, for instance timestamp_ns,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z"


@dataclass(frozen=True, slots=True)
class Layout:
    """Which columns of a table are what. ``other``: names of columns that are not read."""

    time: Column
    columns: tuple[Column, ...]
    other: Mapping[str, str] = field(default_factory=dict)


def layout_of(path: Path, names: Sequence[str], units: Sequence[str] | None = None) -> Layout:
    """Recognise the columns of a table by their names and, where there is one, its units row.

    Raises
    ------
    AttestError
        If a column appears twice, or there is no time, or nothing that attest knows.
    """
    units = units or [""] * len(names)
    twice = [
        name for name, count in Counter(name.strip() for name in names).items() if count > 1 and recognise(0, name)
    ]
    if twice:
        raise AttestError(f"{path}: column {twice[0]!r} appears more than once", "give every column a name of its own")
    time = time_column(names, units)
    if time is None:
        raise AttestError(f"{path}: no time column among {_some(names)}", 'name it "timestamp_ns", "time" or "t" (s)')
    best: dict[tuple[str, str], Column] = {}
    for index, name in enumerate(names):
        column = recognise(index, name, units[index]) if index != time.index else None
        if column is not None:
            key = (column.instance, column.canonical)
            best[key] = min(best.get(key, column), column, key=lambda c: c.rank)
    if not best:
        raise AttestError(f"{path}: no column that attest knows among {_some(names)}", NAMES_HINT)
    used = {column.index for column in best.values()} | {time.index}
    other = {name: "column" for index, name in enumerate(names) if index not in used}
    return Layout(time, tuple(best.values()), other)


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
    groups = _groups(path, layout, values)
    imu_rows = np.zeros(next(iter(values.values())).size, dtype=bool)
    for role, _, columns in groups:
        if role in {"imu", "gyro", "accel"}:
            imu_rows |= ~_blank(columns, values)
    stamps_ns, valid, told = stamps(imu_rows)
    good = ~np.isnan(valid)
    channels = [_channel(role, name, columns, values, stamps_ns, good) for role, name, columns in groups]
    told += tuple(warnings)
    if not np.all(good):
        message = f"{path.name}: {np.count_nonzero(~good)} of {good.size} rows dropped: no readable time"
        told += (Warn("rows-without-time", message, "see the rows with attest doctor"),)
    kept = tuple(channel for channel in channels if channel.stamps_ns.size)
    return Recording(path, format_name, kept, int(good.size), layout.other, told)


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
        if role not in {"imu", "gyro", "accel"} and mine.keys() & {*names, *EXTRA.get(role, ())} - set(EXTRA["gps"])
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


def _some(names: Sequence[str], count: int = 8) -> str:
    shown = ", ".join(repr(name.strip()[:40]) for name in names[:count])
    return shown + (f" and {len(names) - count} more" if len(names) > count else "")
