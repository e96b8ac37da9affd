"""Recordings of one drive -> ``Log``: roles cast, clocks put in order, SI units, body axes, gaps listed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..records import Fixes, Log, Recording, Warn
from ..settings import Settings
from . import axes, course, quaternions
from .clock import seconds
from .epochs import INERTIAL, one_clock
from .fixes import Span, fixes_of
from .imu import ImuRows, imu_rows
from .roles import Cast, choose, told
from .stuck import unchanging

__all__ = ["choose", "prepare"]

TURNING_RAD_S, FEW = 0.01, 10  # rms rate of an IMU that turns; measurements that show whether a sensor changes


def prepare(recordings: Sequence[Recording], settings: Settings, *, spent: bool = False) -> Log:
    """Make one log in SI units and body axes of the files of one drive.

    Parameters
    ----------
    recordings : sequence of Recording
        As found in the files; several are joined by time.
    settings : Settings
        ``map`` and the ``channel`` of each role, ``imu.mounting`` (applied where it is a quaternion; the magnetometer
        sits in the same box), ``imu.calibration``, ``sun.components``, ``time``, ``world.gravity_m_s2``.
    spent : bool
        Nobody reads the recordings afterwards: the values of the IMU are let go once they are in SI.

    Returns
    -------
    Log
        ``t`` in s since the log's first IMU stamp, also where a window starts later. A clean log carries no warning.

    Raises
    ------
    AttestError
        If there is no IMU, a named channel is missing, files are on other clocks, the clock steps back, gravity is
        missing, or too little is left.
    """
    files = ", ".join(recording.source.name for recording in recordings)
    cast = choose(recordings, settings)
    apart = one_clock(cast.channels, recordings) if len(recordings) > 1 else []
    parts = [cast.channels["imu"]] if "imu" in cast.channels else [cast.channels["gyro"], cast.channels["accel"]]
    rows = imu_rows(files, parts, settings, spent=spent)
    span = Span(rows.t0_ns, int(rows.stamps_ns[0]), int(rows.stamps_ns[-1]), settings.time.max_gap_s)
    warnings = [*told(recordings), *cast.warnings, *apart, *rows.warnings]
    fixes = _fixes(cast, span, settings, warnings)
    fixes = _changing(fixes, rows, warnings)
    warnings += course.doubts(fixes, rows.imu)
    if "magnetometer" in fixes and all(warn.code not in {"gyro-against-accel", "gyro-scale"} for warn in warnings):
        gyros = {c.name for r in recordings for c in r.channels if c.role in {"imu", "gyro"}}
        warnings += axes.of_field(fixes["magnetometer"], rows.imu, others=len(gyros) > 1)
    warnings += quaternions.doubts(fixes["orientation"], rows.imu) if "orientation" in fixes else []
    log = Log(
        sources=tuple(recording.source for recording in recordings),
        t0_ns=rows.t0_ns,
        stamps_ns=rows.stamps_ns,
        imu=rows.imu,
        fixes=fixes,
        gaps=seconds(rows.holes_ns, rows.t0_ns),
        coverage=_coverage(rows),
        warnings=tuple(warnings),
        history=_history(cast, fixes, rows, settings),
    )
    if settings.imu.calibration is None:
        return log
    from .calibration import calibrated  # the models of its file

    return calibrated(log, settings)


def _fixes(cast: Cast, span: Span, settings: Settings, warnings: list[Warn]) -> dict[str, Fixes]:
    found = {
        role: fixes_of(role, channel, span, settings, warnings)
        for role, channel in cast.channels.items()
        if role not in INERTIAL
    }
    return {role: fixes for role, fixes in found.items() if fixes is not None}


def _changing(fixes: Mapping[str, Fixes], rows: ImuRows, warnings: list[Warn]) -> dict[str, Fixes]:
    """Leave out a magnetometer or compass that says the same all along while the IMU turns."""
    dead = [
        role for role in ("magnetometer", "compass")
        if role in fixes and len(fixes[role].t) >= FEW and unchanging(fixes[role].values).all()
    ]  # fmt: skip
    if dead:
        off = rows.imu.gyro_b - np.median(rows.imu.gyro_b, axis=0)
        turns = float(np.mean(np.einsum("ij,ij->i", off, off))) > TURNING_RAD_S**2
        dead = dead if turns else []
    for role in dead:
        message = f"all {len(fixes[role].t)} measurements of {fixes[role].channel} ({role}) are equal: not used"
        warnings.append(Warn("stale-repeats", message, "is the sensor connected?"))
    return {role: found for role, found in fixes.items() if role not in dead}


def _coverage(rows: ImuRows) -> Mapping[str, float]:
    """Count IMU rows and seconds: in the window as found, and used. Gaps are not used time."""
    used = int(rows.stamps_ns.size)
    holes_ns = int((rows.holes_ns[:, 1] - rows.holes_ns[:, 0]).sum())
    return {
        "rows_in": rows.rows_in,
        "rows_used": used,
        "rows_dropped": rows.rows_in - used,
        "seconds_in": rows.seconds_in,
        "seconds_used": (int(rows.stamps_ns[-1] - rows.stamps_ns[0]) - holes_ns) * 1e-9,
    }


def _history(cast: Cast, fixes: Mapping[str, Fixes], rows: ImuRows, settings: Settings) -> tuple[str, ...]:
    """Say which channel plays which role, with how many measurements."""
    lines = []
    for role, channel in cast.channels.items():
        count = rows.stamps_ns.size if role in INERTIAL else len(fixes[role].t) if role in fixes else 0
        lines.append(f"{role}: {channel.name} ({channel.kind}), {count} of {channel.stamps_ns.size}")
    if settings.imu.mounting != "auto":
        lines.append(f"imu mounting: body <- sensor {settings.imu.mounting}")
    return tuple(lines)
