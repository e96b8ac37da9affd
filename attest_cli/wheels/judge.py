"""Whether the wheels of a drive tell the truth: judged once, for every filter and for the position."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .. import mounting
from ..maths import rotation
from ..mounting import Mounting, upright
from ..records import Array, Fixes, Log, Segmentation, Warn
from ..settings import Settings
from .slips import slips

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
ASKEW_DEG = 15.0  # wheels that drive this far from the stated forward axis contradict it
DEAD_M_S = 1e-3
MOST_SLIPPING = 0.5  # of the time in motion: wheels that slip longer are not believed at all


@dataclass(frozen=True, slots=True)
class Judged:
    """The wheels of a drive as far as they are believed: ``fixes`` on the IMU's clock without those of slips, None
    where none counts; how the IMU sits in the vehicle (``seat``, None: the drive does not show it); the axes ``q_bv``
    (4,) in which they drive forward, to the IMU's; what is ``told``; whether they are ``forced`` on the drive although
    it contradicts them.
    """

    fixes: Fixes | None
    seat: Mounting | None
    q_bv: Array
    told: tuple[Warn, ...]
    forced: bool = False


def judge(
    log: Log, q: Array, segmentation: Segmentation, odometry: Fixes, gravity: float, settings: Settings
) -> Judged:  # fmt: skip
    """Hold the wheels against the IMU: their axis, size, clock, and where they slip.

    Parameters
    ----------
    q : (n, 4) attitude of the IMU at its samples
    odometry : as logged
    gravity : m/s^2
    """
    seat = mounting.find_mounting(log.imu, q, segmentation, odometry, gravity)
    found = seat is not None and seat.certain
    given, forced = settings.imu.mounting != "auto", settings.smoothing.position == "odometry"
    q_bv = seat.q_bv if seat is not None and found and not given else IDENTITY
    nothing = Judged(None, seat, q_bv, ())
    unseen = "the drive does not show how the IMU sits in the vehicle"
    unknown = not given and not found and not upright(segmentation, log.imu)
    if unknown and not forced:
        warn = Warn("odometry-not-used", f"odometry not used: {unseen}", "give [imu] mounting")
        return replace(nothing, told=(warn,))
    lag = seat.lag if seat is not None else 0.0
    wheels, told = replace(odometry, t=odometry.t - lag), list[Warn]()
    if unknown:
        told.append(Warn("mounting-not-shown", f"{unseen}: its x axis is taken as forward", "give [imu] mounting"))
    if lag:
        word = "late" if lag > 0 else "early"
        told.append(Warn("odometry-late", f"odometry is {abs(lag):.2f} s {word} against the IMU: corrected"))
    doubt, hint = _contradiction(segmentation, odometry, seat, given=given), "check its unit, sign, clock and channel"
    if not doubt:
        spans, most = slips(log.imu, q, segmentation, wheels, rotation.matrix(q_bv)[:, 0], gravity)
        share = _share(spans, segmentation)
        if share <= MOST_SLIPPING:
            return Judged(_without(wheels, spans), seat, q_bv, (*told, *_slipped(spans, most)))
        doubt = f"wheels and accelerometer differ by up to {most:.2g} m/s in {100.0 * share:.0f} % of the drive"
        hint = "do they slip, does the counter hang? check unit and channel"
    warn = Warn("odometry-contradicts", doubt, hint if forced else f"{hint}; --position odometry uses it")
    return Judged(wheels, seat, q_bv, (warn, *told), forced) if forced else replace(nothing, told=(warn,))


def _contradiction(segmentation: Segmentation, odometry: Fixes, seat: Mounting | None, *, given: bool) -> str:
    """Say how wheels and accelerometer contradict each other in most of the drive; empty if they do not."""
    moving = np.zeros(len(odometry.t), dtype=np.bool_)
    for s in segmentation.motions:
        moving |= (odometry.t >= s.start) & (odometry.t <= s.end)
    speed = np.nan_to_num(odometry.values[moving])
    if moving.sum() >= mounting.LEAST_BLOCKS and float(np.abs(speed).max(initial=0.0)) < DEAD_M_S:
        return "odometry reads zero while the IMU moves"
    if seat is None or not seat.certain:
        return "wheels and accelerometer do not speed up together" if seat is not None and seat.unlike else ""
    if seat.contradicted:
        return f"odometry is {1.0 / seat.scale:.2g} times the speed that the accelerometer shows"
    off = np.degrees(np.arccos(np.clip(rotation.matrix(seat.q_bv)[0, 0], -1.0, 1.0)))
    if given and off > max(ASKEW_DEG, 4.0 * np.degrees(float(seat.sigma[1:].max()))):
        return f"odometry drives {off:.0f} deg from the forward axis of the stated mounting"
    return ""


def _share(spans: Array, segmentation: Segmentation) -> float:
    """Return the share of the time in motion that lies in ``spans`` (k, 2)."""
    moving = sum(s.end - s.start for s in segmentation.motions)
    return float(np.diff(spans, axis=1).sum()) / moving if len(spans) else 0.0


def _without(wheels: Fixes, spans: Array) -> Fixes:
    """Return the measurements outside the spans (k, 2)."""
    if not len(spans):
        return wheels
    good = ~np.any([(wheels.t > start) & (wheels.t < end) for start, end in spans], axis=0)
    sigma = None if wheels.sigma is None else wheels.sigma[good]
    return replace(wheels, t=wheels.t[good], values=wheels.values[good], sigma=sigma)


def _slipped(spans: Array, most: float) -> list[Warn]:
    """Say where the wheels slip."""
    if not len(spans):
        return []
    message = f"wheels and accelerometer differ by up to {most:.2g} m/s at {spans[0, 0]:.0f} to {spans[0, 1]:.0f} s"
    more = f" and {len(spans) - 1} times more" if len(spans) > 1 else ""
    hint = "slip, or a counter that hangs: the position is not taken from the wheels there"
    return [Warn("odometry-slips", f"{message}{more}", hint)]
