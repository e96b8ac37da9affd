"""From the smoothed attitude to the vehicle: how the IMU sits in it, whether its wheels tell the truth, where it
went.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from . import mounting, position
from .errors import AttestError
from .estimate import Estimate
from .maths import rotation
from .mounting import Mounting, up_at_stops, upright
from .position import Position
from .records import Array, Fixes, Log, Segmentation, Warn
from .settings import Settings

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
ASKEW_DEG = 15.0  # wheels that drive this far from the stated forward axis contradict it
DEAD_M_S = 1e-3
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
    seat, wheels = None, None
    if odometry is not None:
        seat = mounting.find_mounting(log.imu, q, segmentation, odometry, est.world.gravity)
        wheels, doubts = _trusted(log, segmentation, odometry, seat, settings)
        told += doubts
    if wheels is not None:
        wheels, doubts = _gripping(log, segmentation, est, wheels, _forward(seat, settings))
        told += doubts
    vehicle = _vehicle(seat if wheels is not None else None, settings)
    if est.smoothed.p is not None and mode == "auto":
        return position.navigated(log.imu.t, est.smoothed, segmentation), vehicle, told
    if wheels is not None and mode in {"auto", "odometry"}:
        q_bv = _forward(seat, settings)
        found = position.odometry_position(log.imu, q, q_bv, est.errors, segmentation, wheels, settings, log.gaps)
        return found, vehicle, told
    if mode == "none" or not segmentation.stops:
        return None, vehicle, told
    literal = mode == "literal"
    found = position.inertial_position(
        log.imu, q, est.errors, segmentation, settings, est.world.gravity, est.noise.accel_density, log.gaps, literal
    )
    return found, vehicle, told


def _trusted(
    log: Log, segmentation: Segmentation, odometry: Fixes, seat: Mounting | None, settings: Settings
) -> tuple[Fixes | None, list[Warn]]:
    """Return the odometry on the IMU's time if it may be used, and what speaks against it or was mended."""
    forced = settings.smoothing.position == "odometry"
    told: list[Warn] = []
    doubt = _contradiction(segmentation, odometry, seat, given=settings.imu.mounting != "auto")
    if doubt:
        hint = (
            "check its unit, sign and channel"
            if forced
            else "check its unit, sign and channel; --position odometry uses it"
        )
        told.append(Warn("odometry-contradicts", doubt, hint))
    elif settings.imu.mounting == "auto" and (seat is None or not seat.certain) and not upright(segmentation, log.imu):
        doubt = "odometry not used: the drive does not show how the IMU sits in the vehicle"
        told.append(Warn("odometry-not-used", doubt, "give [imu] mounting"))
    if doubt and not forced:
        return None, told
    silent = position.silences(odometry, log.imu.t, segmentation)
    if len(silent):
        longest = float(np.diff(silent, axis=1).max())
        total = float(np.diff(silent, axis=1).sum())
        told.append(
            Warn("odometry-silent", f"odometry is silent for {total:.0f} s, {longest:.0f} s at a time",
                 "the position stands still there and its sigma grows")
        )  # fmt: skip
    lag = seat.lag if seat is not None else 0.0
    if lag:
        word = "late" if lag > 0 else "early"
        told.append(Warn("odometry-late", f"odometry is {abs(lag):.2f} s {word} against the IMU: corrected"))
    return replace(odometry, t=odometry.t - lag), told


def _forward(seat: Mounting | None, settings: Settings) -> Array:
    """Return the axes (4,) in which wheels drive forward, to the IMU's: as the drive shows, or the IMU's own."""
    return seat.q_bv if seat is not None and settings.imu.mounting == "auto" and seat.certain else IDENTITY


def _gripping(
    log: Log, segmentation: Segmentation, est: Estimate, wheels: Fixes, q_bv: Array
) -> tuple[Fixes, list[Warn]]:
    """Return the odometry without the stretches in which its wheels slip or hang, and say so."""
    forward = rotation.matrix(q_bv)[:, 0]
    spans, most = position.slips(log.imu, est.q, segmentation, wheels, forward, est.world.gravity)
    if not len(spans):
        return wheels, []
    bad = np.any([(wheels.t > start) & (wheels.t < end) for start, end in spans], axis=0)
    sigma = None if wheels.sigma is None else wheels.sigma[~bad]
    message = f"wheels and accelerometer differ by up to {most:.2g} m/s at {spans[0, 0]:.0f} to {spans[0, 1]:.0f} s"
    more = f" and {len(spans) - 1} times more" if len(spans) > 1 else ""
    hint = "slip, or a counter that hangs: the position is not taken from the wheels there"
    return replace(wheels, t=wheels.t[~bad], values=wheels.values[~bad], sigma=sigma), [
        Warn("odometry-slips", f"{message}{more}", hint)
    ]


def _contradiction(segmentation: Segmentation, odometry: Fixes, seat: Mounting | None, *, given: bool) -> str:
    """Say how wheels and accelerometer contradict each other; empty if they do not."""
    moving = np.zeros(len(odometry.t), dtype=np.bool_)
    for s in segmentation.motions:
        moving |= (odometry.t >= s.start) & (odometry.t <= s.end)
    speed = np.nan_to_num(odometry.values[moving])
    if moving.sum() >= mounting.LEAST_BLOCKS and float(np.abs(speed).max(initial=0.0)) < DEAD_M_S:
        return "odometry reads zero while the IMU moves"
    if seat is None or not seat.certain:
        return ""
    if seat.contradicted:
        return f"odometry is {1.0 / seat.scale:.2g} times the speed that the accelerometer shows"
    off = np.degrees(np.arccos(np.clip(rotation.matrix(seat.q_bv)[0, 0], -1.0, 1.0)))
    if given and off > max(ASKEW_DEG, 4.0 * np.degrees(float(seat.sigma[1:].max()))):
        return f"odometry drives {off:.0f} deg from the forward axis of the stated mounting"
    return ""


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
