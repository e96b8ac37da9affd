"""From the smoothed attitude to the vehicle: how the IMU sits in it, whether its wheels tell the truth, where it
went.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from . import mounting, position
from .errors import AttestError
from .estimate import Estimate
from .maths import rotation
from .mounting import Mounting, up_at_stops
from .position import Position
from .records import Array, Fixes, Log, Segmentation, Warn
from .settings import Settings
from .wheels import judge

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
HANGING = -0.7  # up along the IMU's z axis below which it points down
LYING = 0.5  # the same of a vehicle whose IMU is mounted as stated


@dataclass(frozen=True, slots=True)
class Vehicle:
    """Axes of the track: ``q_bv`` (4,) to the IMU's, their ``sigma`` (3,) about themselves, rad, and how the report
    tells it.
    """

    q_bv: Array
    sigma: Array
    told: dict[str, Any]


def locate(
    log: Log, segmentation: Segmentation, est: Estimate, settings: Settings
) -> tuple[Position | None, Vehicle, list[Warn]]:
    """Find how the IMU sits in the vehicle, where odometry shows it, and integrate the position."""
    q, mode, odometry = est.q, settings.smoothing.position, log.fixes.get("odometry")
    if mode == "odometry" and odometry is None:
        raise AttestError(f"{log.sources[0].name}: no odometry for the position", "use --position auto")
    told = _hanging(log, segmentation, given=settings.imu.mounting != "auto")
    judged = est.odometry
    if judged is None and odometry is not None:
        judged = judge(log, q, segmentation, odometry, est.world.gravity, settings)
    seat, wheels = None, None
    if judged is not None:
        seat, wheels = judged.seat, judged.fixes
        told += [*judged.told, *_silent(log, segmentation, odometry if wheels is not None else None)]
    vehicle = _vehicle(seat if wheels is not None else None, settings)
    if est.smoothed.p is not None and mode == "auto":
        return position.navigated(log.imu.t, est.smoothed, segmentation), vehicle, told
    if judged is not None and wheels is not None and mode in {"auto", "odometry"}:
        of_drive = est.errors, segmentation, wheels, settings, log.gaps
        return position.odometry_position(log.imu, q, judged.q_bv, *of_drive), vehicle, told
    if mode == "none" or not segmentation.stops:
        return None, vehicle, told
    literal = mode == "literal"
    found = position.inertial_position(
        log.imu, q, est.errors, segmentation, settings, est.world.gravity, est.noise.accel_density, log.gaps, literal
    )
    return found, vehicle, told


def _silent(log: Log, segmentation: Segmentation, odometry: Fixes | None) -> list[Warn]:
    """Say where the log holds no odometry."""
    silent = position.silences(odometry, log.imu.t, segmentation) if odometry is not None else np.zeros((0, 2))
    if not len(silent):
        return []
    longest = float(np.diff(silent, axis=1).max())
    total = float(np.diff(silent, axis=1).sum())
    return [
        Warn("odometry-silent", f"odometry is silent for {total:.0f} s, {longest:.0f} s at a time",
             "the position stands still there and its sigma grows")
    ]  # fmt: skip


def _vehicle(seat: Mounting | None, settings: Settings) -> Vehicle:
    """Choose the axes of the track."""
    given, sure = settings.imu.mounting, np.zeros(3)
    if given != "auto":
        told = {"axes": "vehicle", "q_body_sensor": list(given), "how": "mounting of the settings"}
        return Vehicle(IDENTITY, sure, told)
    usable = seat is not None and seat.certain
    if settings.body.axes == "vehicle" and not usable:
        raise AttestError("the drive does not show the vehicle's axes", "give [imu] mounting, or use --body imu")
    if settings.body.axes == "imu" or seat is None or not usable:
        return Vehicle(IDENTITY, sure, {"axes": "imu", "q_body_sensor": IDENTITY.tolist(), "how": "axes of the IMU"})
    if settings.body.axes == "auto" and mounting.axes_agree(seat):
        told = {"axes": "imu", "q_body_sensor": IDENTITY.tolist(), "how": f"IMU and vehicle agree; {seat.how}"}
        return Vehicle(IDENTITY, sure, told)
    told = {"axes": "vehicle", "q_body_sensor": rotation.conjugate(seat.q_bv).tolist(), "how": seat.how}
    return Vehicle(seat.q_bv, seat.sigma, told)


def _hanging(log: Log, segmentation: Segmentation, *, given: bool) -> list[Warn]:
    """Say where the IMU's z axis points down: its track stands on its head, which a reader may not expect.

    Under a stated mounting it is the vehicle that would lie on its side or its head.
    """
    up = up_at_stops(segmentation, log.imu)[2] if segmentation.stops else 1.0
    if given and up < LYING:
        off = np.degrees(np.arccos(np.clip(up, -1.0, 1.0)))
        message = f"with the stated mounting the vehicle rests {off:.0f} deg from upright"
        hint = "mend [imu] mounting, or leave it out; or is the accelerometer reversed?"
        return [Warn("mounting-contradicted", message, hint, fatal=True)]
    if up > HANGING:
        return []
    return [
        Warn("imu-upside-down", "the IMU's z axis points down: it hangs upside down, or is a z-down (NED) sensor",
             "[imu] mounting turns the track; a reversed accelerometer looks the same")
    ]  # fmt: skip
