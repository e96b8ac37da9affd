"""The IMU of a drive: halves merged, rows that cannot be used dropped and counted, SI, body axes, holes listed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from ..errors import AttestError
from ..maths import rotation
from ..records import COLUMNS, Array, Bools, Channel, Imu, Ints, Warn
from ..settings import Settings
from . import axes, clipping, halves, held, interleaved, lost, stuck, units
from .clock import STEP_BACK_NS, gaps, in_order, seconds
from .epochs import HOUR_S, SET_NS, whole_hours
from .jitter import jittered
from .lost import LARGEST
from .spikes import ACCEL_FLOOR, AROUND, GYRO_BURST, GYRO_FLOOR, WIDTH, spikes

MIN_ROWS = 50
MIN_SECONDS = 2.0
STEPS_S, FEW_STEPS = (1e-4, 1.0), 20_000  # median step of an IMU; steps that tell it
LISTED_GAPS = 3
FASTEST_RAD_S, STRONGEST_M_S2 = 1e3, 1e5  # no IMU measures more: 57 000 deg/s, 10 000 g
FEW_MISSING = 0.01  # of the samples, lost one by one
MANY = 0.1  # of the samples: no lost bytes, but another unit


@dataclass(frozen=True, slots=True)
class ImuRows:
    """IMU samples in SI and body axes with what was lost on the way: of ``rows_in`` that are samples, no repeats of a
    slower sensor. ``holes_ns`` (g, 2).
    """

    t0_ns: int
    stamps_ns: Ints
    imu: Imu
    holes_ns: Ints
    rows_in: int
    seconds_in: float
    warnings: tuple[Warn, ...]


@dataclass(frozen=True, slots=True)
class _Rows:
    """Stamps and raw values (n, 3 or 6) of one channel inside the window, in order."""

    channel: Channel
    stamps_ns: Ints
    values: Array
    rows_in: int


def imu_rows(files: str, parts: Sequence[Channel], settings: Settings, *, spent: bool = False) -> ImuRows:
    """Make the IMU of one channel, or of a gyro and an accelerometer channel.

    Parameters
    ----------
    files : str
        Names of the files, for messages.
    parts : one imu channel, or gyro and accel
    spent : empty them when they have been read

    Raises
    ------
    AttestError
        If a column is empty, the clock steps back, gravity is missing, or too little is left.
    """
    warnings: list[Warn] = []
    t0_ns = first_stamp(parts[0].stamps_ns)
    ordered = [_in_window(files, part, t0_ns, settings, warnings) for part in parts]
    first = ordered[0]
    _outside(files, parts[0].stamps_ns, first, t0_ns)
    _enough(files, first.stamps_ns)
    _rated(files, first)
    t0_ns = min(t0_ns, int(first.stamps_ns[0]))  # a first batch is spread to before its stamp
    seconds_in, rows_in = float(first.stamps_ns[-1] - first.stamps_ns[0]) * 1e-9, first.rows_in
    stamps_ns, table = (
        (first.stamps_ns, first.values) if len(ordered) == 1 else _merged(first, ordered[1], settings, warnings)
    )
    _enough(files, stamps_ns)
    stamps_ns, table, repeats = _sampled(f"{files}: {parts[0].name}", stamps_ns, t0_ns, table, warnings)
    _enough(files, stamps_ns)
    gyro, accel = _in_si(parts, stamps_ns, t0_ns, table, settings, warnings)
    warnings += stuck.told_coarse(f"{files}: {parts[0].name}", gyro)
    del table, ordered, first  # a long log is not held twice
    for part in parts if spent else ():
        cast("dict[str, Array]", part.values).clear()
    lone = _alone(gyro, GYRO_FLOOR) | _alone(gyro, GYRO_BURST, AROUND) | _alone(accel, ACCEL_FLOOR)
    if lone.any():
        warnings.append(_told_spikes(f"{files}: {parts[0].name}", lone, stamps_ns, t0_ns))
        stamps_ns, gyro, accel = stamps_ns[~lone], gyro[~lone], accel[~lone]
    absurd = _absurd(f"{files}: {parts[0].name}", seconds(stamps_ns, t0_ns), gyro, accel, warnings)
    if absurd.any():
        stamps_ns, gyro, accel = stamps_ns[~absurd], gyro[~absurd], accel[~absurd]
        _enough(files, stamps_ns)
    warnings += stuck.told_numb(f"{files}: {parts[0].name}", COLUMNS["gyro"], seconds(stamps_ns, t0_ns), gyro)
    warnings += stuck.told_unlike(f"{files}: {parts[0].name}", COLUMNS["gyro"], gyro)
    warnings += axes.doubts(f"channel {parts[0].name}", seconds(stamps_ns, t0_ns), gyro, accel)
    if len(parts) > 1:
        warnings += halves.doubts((parts[0].name, parts[1].name), seconds(stamps_ns, t0_ns), gyro, accel)
    holes_ns = gaps(stamps_ns, settings.time.max_gap_s)
    if holes_ns.size:
        warnings.append(_told_gaps(files, seconds(holes_ns, t0_ns), float(np.median(np.diff(stamps_ns))) * 1e-9))
    imu = Imu(seconds(stamps_ns, t0_ns), gyro, accel)
    imu = _unclipped(f"{files}: {parts[0].name}", imu, settings.time.max_gap_s, warnings)
    return ImuRows(t0_ns, stamps_ns, _in_body(imu, settings), holes_ns, rows_in - repeats, seconds_in, tuple(warnings))


def _sampled(name: str, stamps_ns: Ints, t0_ns: int, table: Array, warnings: list[Warn]) -> tuple[Ints, Array, int]:
    """Return the stamps and rows of the raw ``table`` (n, 6) that are samples of one sensor, and how many rows only
    repeat them; say what is left out.
    """
    interleaved.refuse(name, table, float(np.median(np.diff(stamps_ns))) * 1e-9)
    blank = held.blank(seconds(stamps_ns, t0_ns), table)
    if blank.any():
        message = f"{name}: {np.count_nonzero(blank)} of {blank.size} rows dropped: all values are zero"
        warnings.append(Warn("imu-zero-rows", message, "does the driver write zeros where it has no sample?"))
        stamps_ns, table = stamps_ns[~blank], table[~blank]
    new, table = held.released(name, seconds(stamps_ns, t0_ns), table, warnings)
    if not new.all():
        stamps_ns, table = stamps_ns[new], table[new]
    repeats = int(np.count_nonzero(~new))
    frozen = _frozen(name, seconds(stamps_ns, t0_ns), table, warnings)
    return (stamps_ns[~frozen], table[~frozen], repeats) if frozen.any() else (stamps_ns, table, repeats)


def _in_si(
    parts: Sequence[Channel], stamps_ns: Ints, t0_ns: int, table: Array, settings: Settings, warnings: list[Warn]
) -> tuple[Array, Array]:
    """Return angular rate and specific force in SI of the raw ``table`` (n, 6), in the sensor's axes."""
    t = seconds(stamps_ns, t0_ns)
    gyro_part, accel_part = (
        replace(part, stamps_ns=stamps_ns, values={n: table[:, COLUMNS["imu"].index(n)] for n in names})
        for part, names in ((parts[0], COLUMNS["gyro"]), (parts[-1], COLUMNS["accel"]))
    )
    accel = units.accelerometer(accel_part, COLUMNS["accel"], t, settings.world.gravity_m_s2, warnings)
    return units.gyroscope(gyro_part, COLUMNS["gyro"], t, accel, warnings), accel


def _alone(values: Array, floor: float, width: int = WIDTH) -> Bools:
    """Tell the rows (n,) of spikes, axis by axis: all at once would be another copy of a long log."""
    rows: Bools = np.logical_or.reduce([spikes(values[:, i : i + 1], floor, width) for i in range(values.shape[1])])
    return rows


def _absurd(name: str, t: Array, gyro: Array, accel: Array, warnings: list[Warn]) -> Bools:
    """Tell rows (n,) that no IMU can have measured; refuse a log of them."""
    if _within(gyro, FASTEST_RAD_S) and _within(accel, STRONGEST_M_S2):
        return np.zeros(len(t), dtype=np.bool_)
    fast = np.logical_or.reduce([np.abs(gyro[:, i]) > FASTEST_RAD_S for i in range(3)])
    rows: Bools = fast | np.logical_or.reduce([np.abs(accel[:, i]) > STRONGEST_M_S2 for i in range(3)])
    count = int(np.count_nonzero(rows))
    if count > MANY * rows.size:
        what = f"{FASTEST_RAD_S:g} rad/s" if 2 * np.count_nonzero(fast) > count else "10 000 g"
        message = f"{name}: {count} of {rows.size} samples are over {what}: no IMU measures that"
        raise AttestError(message, "check the units of its columns")
    if count:
        message = f"{name}: {count} of {rows.size} rows dropped: out of any range, the first at {t[rows][0]:.2f} s"
        warnings.append(Warn("imu-out-of-range", message, "lost bytes make such samples"))
    return rows


def _within(values: Array, limit: float) -> bool:
    """Tell whether all values are within a limit, none NaN; no copy of a long log is made for it."""
    return bool(-limit < values.min() and values.max() < limit)


def _frozen(name: str, t: Array, table: Array, warnings: list[Warn]) -> Bools:
    """Tell rows (n,) in which an axis of the raw ``table`` (n, 6) is stuck; say so, and of axes that are dead."""
    found = [_but_clipped(x, rows) for x, rows in zip(table.T, stuck.stuck(t, table), strict=True)]
    warnings += stuck.told(name, COLUMNS["imu"], found, t)
    warnings += stuck.told_dead(name, COLUMNS["imu"], stuck.dead(table))
    rows: Bools = np.logical_or.reduce(found)
    return rows


def _but_clipped(x: Array, rows: Bools) -> Bools:
    """Return the stuck rows (n,) of a column, but for those at an end of its range: it was clipped there."""
    return rows & ~clipping.piled(x) & ~clipping.piled(-x) if rows.any() else rows


def _unclipped(name: str, imu: Imu, longest_s: float, warnings: list[Warn]) -> Imu:
    """Draw the gyro where it ran out of its range; make clipped samples noisier, and say so; noisier too are samples
    beside those that are lost, and those whose stamps scatter.
    """
    found = clipping.clipped(imu.t, imu.gyro_b, clipping.GYRO_FLOOR)
    if found:
        warnings.append(clipping.told(name, "gyro", found, "rad/s"))
        gyro, density = clipping.repaired(imu.t, imu.gyro_b, found, clipping.GYRO_DENSITY)
        imu = replace(imu, gyro_b=gyro, gyro_added=density)
    for added in (lost.bridged(imu.t, imu.gyro_b, longest_s), jittered(imu.t, imu.gyro_b)):
        if added is not None:
            imu = replace(imu, gyro_added=added if imu.gyro_added is None else np.hypot(added, imu.gyro_added))
    found = clipping.clipped(imu.t, imu.accel_b, clipping.ACCEL_FLOOR)
    if found:
        warnings.append(clipping.told(name, "accelerometer", found, "m/s^2"))
        _, density = clipping.repaired(imu.t, imu.accel_b, found, clipping.ACCEL_DENSITY)
        imu = replace(imu, accel_added=density)
    bridged = lost.bridged(imu.t, imu.accel_b, longest_s)
    if bridged is not None:
        imu = replace(imu, accel_added=bridged if imu.accel_added is None else np.hypot(bridged, imu.accel_added))
    return imu


def _in_body(imu: Imu, settings: Settings) -> Imu:
    """Turn the IMU into body axes where the user says how it is mounted."""
    if settings.imu.mounting == "auto":
        return imu
    R_bs = rotation.matrix(np.array(settings.imu.mounting))
    if np.array_equal(R_bs, np.eye(3)):
        return imu
    return replace(imu, gyro_b=imu.gyro_b @ R_bs.T, accel_b=imu.accel_b @ R_bs.T)


def first_stamp(stamps_ns: Ints) -> int:
    """Return the earliest stamp at the start of a channel, whose first rows may be swapped."""
    later = stamps_ns > stamps_ns[0] + STEP_BACK_NS
    end = int(np.argmax(later)) if np.any(later) else stamps_ns.size
    near = stamps_ns[:end]
    return int(near[near > stamps_ns[0] - STEP_BACK_NS].min())


def _in_window(files: str, channel: Channel, t0_ns: int, settings: Settings, warnings: list[Warn]) -> _Rows:
    """Cut to the window, drop rows that are not finite, put the rest in order."""
    names = COLUMNS[channel.role]
    start, end = _window(channel.stamps_ns, t0_ns, settings)
    stamps_ns = channel.stamps_ns[start:end]
    values = _side_by_side([channel.values[name][start:end] for name in names])
    rows_in = len(values)
    values, said = lost.without_sentinels(values)
    if rows_in and not _within(values, LARGEST):
        good = _finite(files, channel, names, values, said, warnings)
        stamps_ns, values = stamps_ns[good], values[good]
    ordered = in_order(f"{files}: {channel.name}", stamps_ns, values, t0_ns)
    warnings.extend(ordered.warnings)
    reordered = ordered.stamps_ns is not stamps_ns and not np.array_equal(ordered.rows, np.arange(len(values)))
    dropped = rows_in - len(values)
    values = values[ordered.rows] if reordered else values
    share = lost.missing(ordered.stamps_ns, settings.time.max_gap_s, dropped, values[:, :3])
    if share > FEW_MISSING:
        message = f"{files}: {share:.1%} of the rows of {channel.name} are missing, one or a few at a time"
        hint = "what turned between is a guess; does the driver, the bus or the logger drop samples?"
        warnings.append(Warn("imu-rows-missing", message, hint))
    return _Rows(channel, ordered.stamps_ns, values, rows_in)


def _finite(
    files: str, channel: Channel, names: Sequence[str], values: Array, said: str, warnings: list[Warn]
) -> Bools:
    """Tell the rows (n,) that hold numbers, say how many do not, or what is ``said`` there; refuse an empty column."""
    finite = np.abs(values) < LARGEST  # nor NaN
    if not finite.any(axis=0).all():
        empty = names[int(np.argmin(finite.any(axis=0)))]
        raise AttestError(
            f"{files}: column {empty} of {channel.name} is empty", "map another channel, or repair the export"
        )
    good = np.asarray(finite.all(axis=1))
    missing = int(np.count_nonzero(~good))
    if missing:
        counts = ", ".join(f"{name} {n}" for name, n in zip(names, np.sum(~finite, axis=0), strict=True) if n)
        message = f"{files}: {missing} of {good.size} rows of {channel.name} dropped, not finite: {counts}"
        warnings.append(Warn("imu-not-finite", f"{message}; {said} stands for no measurement" if said else message))
    return good


def _side_by_side(columns: Sequence[Array]) -> Array:
    """Return columns as a table (n, k): without a copy where a reader has put them side by side."""
    first, k = columns[0], len(columns)
    places = [column.__array_interface__["data"][0] for column in columns]
    if first.strides != (8 * k,) or places != [places[0] + 8 * i for i in range(k)]:
        return np.stack(columns, axis=1)
    return np.lib.stride_tricks.as_strided(first, (len(first), k), (8 * k, 8), writeable=False)


def _window(stamps_ns: Ints, t0_ns: int, settings: Settings) -> tuple[int, int]:
    """Return the rows from the first at ``start_s`` to the first after ``end_s``, since the start of the log."""
    start, end = 0, int(stamps_ns.size)
    if settings.time.start_s is not None:
        start = int(
            np.argmax(np.append(stamps_ns, np.iinfo(np.int64).max) >= t0_ns + round(settings.time.start_s * 1e9))
        )
    if settings.time.end_s is not None:
        end_ns, latest = t0_ns + round(settings.time.end_s * 1e9), np.maximum.accumulate(stamps_ns[start:])
        back = (latest >= end_ns) & (latest - stamps_ns[start:] > STEP_BACK_NS)  # a new clock begins: past the window
        after = (stamps_ns[start:] > end_ns) | back
        end = start + int(np.argmax(after)) if np.any(after) else end
    return start, end


def _outside(files: str, stamps_ns: Ints, rows: _Rows, t0_ns: int) -> None:
    """Refuse a window in which the log has nothing."""
    if not rows.rows_in:
        last = float(stamps_ns.max() - t0_ns) * 1e-9
        message = f"{files}: the window of --start and --end lies outside the log, which has 0 to {last:.2f} s"
        raise AttestError(message, "both count in seconds from the first IMU row")


def _enough(files: str, stamps_ns: Ints) -> None:
    seconds = float(stamps_ns[-1] - stamps_ns[0]) * 1e-9 if stamps_ns.size else 0.0
    if stamps_ns.size < MIN_ROWS or seconds < MIN_SECONDS:
        message = f"{files}: only {stamps_ns.size} usable IMU rows over {seconds:.2g} s"
        needed = f"attest needs at least {MIN_ROWS} rows and {MIN_SECONDS:g} s"
        fast = stamps_ns.size >= MIN_ROWS and seconds < STEPS_S[0] * stamps_ns.size
        raise AttestError(message, f"{needed}; is the unit of time another? --time-unit states it" if fast else needed)


def _rated(files: str, rows: _Rows) -> None:
    """Refuse a rate that no IMU has: its stamps mean something else."""
    steps = np.diff(rows.stamps_ns)
    step = float(np.median(steps[:: steps.size // FEW_STEPS | 1])) * 1e-9  # odd: rows in pairs are seen
    if not STEPS_S[0] <= step <= STEPS_S[1]:
        message = f"{files}: the rows of {rows.channel.name} are {step:.3g} s apart (median): no IMU runs at that rate"
        raise AttestError(message, "check the unit of its stamps, and whether every row has one of its own")


def _merged(gyro: _Rows, accel: _Rows, settings: Settings, warnings: list[Warn]) -> tuple[Ints, Array]:
    """Interpolate the accelerometer onto the gyro's stamps, never across a hole of its own."""
    if not accel.stamps_ns.size or accel.stamps_ns[0] > gyro.stamps_ns[-1] or accel.stamps_ns[-1] < gyro.stamps_ns[0]:
        message = f"{gyro.channel.name} and {accel.channel.name} do not overlap in time"
        raise AttestError(message, "are their clocks the same? --time log takes the recorder's")
    inside = (gyro.stamps_ns >= accel.stamps_ns[0]) & (gyro.stamps_ns <= accel.stamps_ns[-1])
    for start, end in gaps(accel.stamps_ns, settings.time.max_gap_s):
        inside &= (gyro.stamps_ns <= start) | (gyro.stamps_ns >= end)
    stamps_ns = gyro.stamps_ns[inside]
    origin = int(gyro.stamps_ns[0])
    floor = 2.0 * float(np.median(np.linalg.norm(accel.values, axis=1)))  # 2 g, in whatever unit
    lone = spikes(accel.values, floor)  # one would be many samples of the gyro long
    if lone.any():
        warnings.append(_told_spikes(accel.channel.name, lone, accel.stamps_ns, origin))
        accel = replace(accel, stamps_ns=accel.stamps_ns[~lone], values=accel.values[~lone])
    t, ta = seconds(stamps_ns, origin), seconds(accel.stamps_ns, origin)
    force = np.stack([np.interp(t, ta, column) for column in accel.values.T], axis=1)
    warnings += _half_missing(gyro, accel, inside)
    return stamps_ns, np.concatenate([gyro.values[inside], force], axis=1)


def _half_missing(gyro: _Rows, accel: _Rows, inside: Bools) -> list[Warn]:
    """Say where one half of the IMU has rows and the other has none; data is lost where that is at an end."""
    without, (a, b), (c, d) = int(np.count_nonzero(~inside)), *((part.stamps_ns[[0, -1]]) for part in (gyro, accel))
    both = float(min(b, d) - max(a, c))
    lost_s = {
        part.channel.name: 1e-9 * (float(end - start) - both) for part, start, end in ((gyro, a, b), (accel, c, d))
    }
    longest = max(lost_s, key=lambda name: lost_s[name])
    if lost_s[longest] > FEW_MISSING * both * 1e-9:
        other = next(name for name in lost_s if name != longest)
        message = f"{lost_s[longest]:.2f} s of {longest} dropped: {other} has no rows there"
        return [Warn("imu-half-missing", message, "is its file whole, and of the same drive?", lost=True)]
    if without > FEW_MISSING * inside.size:
        message = f"{without} of {inside.size} rows of {gyro.channel.name} dropped: {accel.channel.name} has none there"
        return [Warn("imu-half-missing", message)]
    return []


def _told_spikes(name: str, lone: Bools, stamps_ns: Ints, t0_ns: int) -> Warn:
    count, first = int(np.count_nonzero(lone)), seconds(stamps_ns[lone][:1], t0_ns)[0]
    message = f"{name}: {count} of {lone.size} rows dropped: spikes, the first at {first:.2f} s"
    return Warn("imu-spikes", message, "what is left is used; a loose plug or a lost byte makes such samples")


def _told_gaps(files: str, holes: Array, period_s: float) -> Warn:
    lengths = holes[:, 1] - holes[:, 0]
    shown = ", ".join(
        f"{length:.2f} s from {start:.2f} s" for start, length in zip(holes[:LISTED_GAPS, 0], lengths, strict=False)
    )
    more = f" and {len(holes) - LISTED_GAPS} more" if len(holes) > LISTED_GAPS else ""
    if len(holes) == 1:
        message = f"{files}: a gap in the IMU of {shown}"
    else:
        message = f"{files}: {len(holes)} gaps in the IMU, {lengths.sum():.2f} s in all: {shown}{more}"
    for start, length in zip(holes[:, 0], lengths, strict=True):
        if length > SET_NS * 1e-9:
            parts = f"--end {start:.2f} takes the part before it, --start {start + length:.2f} that behind it"
            return Warn("imu-gap", f"{message}; at {start:.2f} s the clock was set: that is no pause", parts)
        if hours := whole_hours(length, period_s):
            message += f"; that from {start:.2f} s is a jump of exactly {hours * HOUR_S:.0f} s"
            hint = "the clock was set to summer time or another zone, it seems: log stamps in UTC"
            return Warn("imu-gap", message, hint)
    return Warn("imu-gap", message, "nothing is integrated across a gap; the sigma grows there")
