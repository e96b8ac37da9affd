"""Whether a magnetometer shows the Earth's field: its size, and its angle to gravity at the stops."""

from __future__ import annotations

import numpy as np

from ..maths.consistency import MAD
from ..records import Array, Fixes, Log, Segmentation, Warn, World

SIZE_OFF, DIP_OFF = 0.1, np.radians(5.0)  # share of the field, rad: what a calibrated sensor out of doors keeps to
CALIBRATED, BIAS_OFF = 0.02, 0.07  # of the field: off the reference by less does not count; by more is told
VAGUE = np.radians(5.0)  # of heading: what makes it so unsure is told
TURNED = np.radians(60.0)  # no iron that a magnetometer is used beside turns the dip so far
TURNED_HINT = "is the reference of this place, latitude north or south, and are the sensor's signs right?"
NORMALISED = 1e-3  # spread of a field whose size was taken out
FEW = 10
SAME, OFTEN = 1e-5, 0.02  # spread of sizes that are one; share of rows that is no moment
STEEPEST = 0.2  # least horizontal share of the field that a heading is told from
TAKEN_OUT = "magnetometer-normalised"  # code of a warning
HINT = "attest calibrate-bias finds its iron; away from steel and motors it would be better; heading counts less"


def field_doubts(fixes: Fixes, log: Log, segmentation: Segmentation, world: World) -> tuple[float, list[Warn]]:
    r"""Return what heading may be off, rad, by iron, and say so, where size or dip of the field cannot be the Earth's.

    Size against the reference where there is one, else against its own median; dip, the angle below the level, against
    the reference, else from stop to stop. Against a reference, what is too little to be told counts too. An offset of
    a share :math:`\epsilon` of the field turns heading by :math:`\epsilon F/H` at most, with its horizontal part ``H``.
    """
    sizes = np.linalg.norm(fixes.values, axis=1)
    if len(sizes) < FEW or not np.median(sizes) > 0.0:
        return 0.0, []
    sines = _dips(fixes, log, segmentation)
    reference = world.field_n
    usual = float(np.median(sizes))
    spread, biased = MAD * float(np.median(np.abs(sizes / usual - 1.0))), 0.0
    dip_off = float(np.ptp(np.arcsin(sines))) if len(sines) else 0.0
    level = float(np.sqrt(1.0 - np.median(sines) ** 2)) if len(sines) else 1.0
    if reference is not None:
        whole = float(np.linalg.norm(reference))
        level = float(np.hypot(reference[0], reference[1])) / whole
        sized = spread > NORMALISED and all(warning.code != TAKEN_OUT for warning in log.warnings)
        biased = abs(usual / whole - 1.0) if sized else 0.0
        if len(sines):
            dip_off = float(np.max(np.abs(np.arcsin(sines) - np.arcsin(-reference[2] / whole))))
    size_off, turned = max(spread, biased), float(np.sin(min(dip_off, 0.5 * np.pi)))
    far = size_off > SIZE_OFF or biased > BIAS_OFF
    facts = [f"its size is {100 * size_off:.0f} % off"] if far else []
    facts += [f"its dip at the stops is {np.degrees(dip_off):.0f} deg off"] if dip_off > DIP_OFF else []
    seen = float(np.hypot(size_off if facts else biased, turned))  # iron that turns heading shows in neither
    counts = bool(facts) or (reference is not None and seen > CALIBRATED)
    heading = seen / max(level, STEEPEST) if counts else 0.0
    if not facts and heading > VAGUE:
        facts = [f"its size is {100 * biased:.0f} % and its dip at the stops {np.degrees(dip_off):.0f} deg off"]
    hint = HINT if dip_off < TURNED else TURNED_HINT
    told = [Warn("magnetometer-uncalibrated", f"the magnetic field is not the Earth's: {' and '.join(facts)}", hint)]
    told = told if facts else [*_normalised(fixes, sizes, log), *_disturbed(fixes, sizes / usual - 1.0)]
    return heading, told


def steepness(fixes: Fixes, log: Log, segmentation: Segmentation, world: World) -> float:
    r"""Return by how much an error of tilt turns the heading: :math:`|\tan I|` of the field's dip, by its reference or
    at the stops; 0 where neither tells.
    """
    if world.field_n is not None:
        sine = float(abs(world.field_n[2]) / max(np.linalg.norm(world.field_n), 1e-300))
    else:
        sines = _dips(fixes, log, segmentation)
        sine = float(np.abs(np.median(sines))) if len(sines) else 0.0
    return sine / max(float(np.sqrt(max(1.0 - sine**2, 0.0))), STEEPEST)


def _normalised(fixes: Fixes, sizes: Array, log: Log) -> list[Warn]:
    """Say that the size of the field was taken out: no sensor is so still."""
    if np.ptp(sizes) > SAME * np.median(sizes) or any(warning.code == TAKEN_OUT for warning in log.warnings):
        return []
    message = f"{fixes.channel}: the magnetic field has one size in every row: it was normalised"
    return [Warn(TAKEN_OUT, message, "iron nearby cannot be seen in its size; log the field as measured")]


def _disturbed(fixes: Fixes, off: Array) -> list[Warn]:
    """Say where the size of the field leaves its usual one for more than a moment."""
    far = np.abs(off) > SIZE_OFF
    if np.count_nonzero(far) < max(OFTEN * len(off), FEW):
        return []
    edges = np.diff(np.concatenate([[0], far.astype(np.int64), [0]]))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    longest = int(np.argmax(fixes.t[ends] - fixes.t[starts]))
    first, last = fixes.t[starts[longest]], fixes.t[ends[longest]]
    message = f"the magnetic field is up to {100 * np.abs(off).max():.0f} % off its usual size, over 10 % in "
    message += f"{100 * far.mean():.0f} % of its rows, at the longest from {first:.1f} to {last:.1f} s"
    return [Warn("magnetometer-disturbed", message, "iron or currents are near: heading may be off there by more")]


def _dips(fixes: Fixes, log: Log, segmentation: Segmentation) -> Array:
    """Return the sine of the dip (k,) at the stops that have measurements."""
    out = []
    for s in segmentation.stops:
        first, lo = (np.searchsorted(t, s.used_start) for t in (fixes.t, log.imu.t))
        end, hi = (np.searchsorted(t, s.used_end, side="right") for t in (fixes.t, log.imu.t))
        if end == first or hi - lo < 3:
            continue
        field, up = np.median(fixes.values[first:end], axis=0), log.imu.accel_b[lo:hi].mean(axis=0)
        size = float(np.linalg.norm(field) * np.linalg.norm(up))
        if size > 0.0:
            out.append(-float(field @ up) / size)
    return np.asarray(np.clip(np.array(out), -1.0, 1.0))
