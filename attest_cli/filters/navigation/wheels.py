"""The wheels of the navigation smoother: their speed at the nodes, if the drive bears it out, and their states."""

from __future__ import annotations

import numpy as np

from ...maths import rotation
from ...nodes import Nodes
from ...records import Array, Ints, Warn
from ...settings.models import Odometry
from ...wheels import Judged, longest_hole, sigma_of
from .. import Drive
from .aids import Wheels
from .states import State

SLIP_SHARE, SLIP_S = 0.5, 2.0  # wheel slip: share of the noise of a sample, correlation time
STATED_SEAT, ASSUMED_SEAT = 3e-3, 0.02  # rad: how the IMU sits in the vehicle, as stated; where it looks upright


def wheels_of(
    drive: Drive, nodes: Nodes, bias: Array, arm: Array, judged: Judged | None
) -> tuple[Wheels | None, list[Warn]]:  # fmt: skip
    """Return the wheel speed at the moving nodes, as far as the wheels are believed."""
    cfg = drive.settings
    if judged is None or judged.fixes is None or judged.forced:
        return None, []
    odometry, seat, given = judged.fixes, judged.seat, cfg.imu.mounting != "auto"
    seat_sigma = np.full(2, STATED_SEAT if given else ASSUMED_SEAT)
    if seat is not None and seat.certain and not given:
        seat_sigma = seat.sigma[1:]
    R_vb, t = rotation.matrix(judged.q_bv).T, odometry.t
    at = _heard(nodes, t)
    if not len(at):
        message = "odometry not used: its measurements lie too far apart, or none is of a motion"
        return None, [Warn("odometry-not-used", message)]
    values = np.nan_to_num(odometry.values)
    velocity = np.stack([np.interp(nodes.t[at], t, values[:, k]) for k in range(3)], axis=1)
    per = np.sqrt(
        max(1.0, float(np.median(np.diff(t))) / max(float(np.median(np.diff(nodes.t)[nodes.moving[1:]])), 1e-3))
    )
    known = sigma_of(odometry, cfg.odometry)
    known *= _usual_sigma(cfg.odometry) / np.median(known, axis=0)  # how large it is the drive shows, and better
    sigma = per * np.stack([np.interp(nodes.t[at], t, known[:, k]) for k in range(3)], axis=1)
    rate = np.stack([np.interp(nodes.t[at], drive.log.imu.t, drive.log.imu.gyro_b[:, k]) for k in range(3)], axis=1)
    return Wheels(at, nodes.t[at], velocity, sigma, R_vb, seat_sigma, rate - bias[at], arm), []


def _heard(nodes: Nodes, t: Array) -> Ints:
    """Return the moving nodes between measurements of the wheels at ``t``, but for those in their holes."""
    if len(t) < 2:
        return np.zeros(0, dtype=np.int64)
    at = np.flatnonzero(nodes.moving & (nodes.t >= t[0]) & (nodes.t <= t[-1]))
    after = np.clip(np.searchsorted(t, nodes.t[at]), 1, len(t) - 1)
    return at[t[after] - t[after - 1] < longest_hole(t)]


def _usual_sigma(cfg: Odometry) -> Array:
    return np.array([cfg.sigma_m_s, cfg.lateral_sigma_m_s, cfg.lateral_sigma_m_s])


def wheel_states(drive: Drive, wheels: Wheels) -> list[State]:
    """Return the states that wheels call for: scale, seat of the IMU, slip."""
    cfg = drive.settings.odometry
    noise = _usual_sigma(cfg)
    return [
        State("odometry scale", 1, cfg.scale_sigma), State("odometry mounting", 2, wheels.seat_sigma),
        State("odometry slip", 3, SLIP_SHARE * noise, SLIP_S),
    ]  # fmt: skip
