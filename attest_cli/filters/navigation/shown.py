"""What a solved drive shows of its sensors: the states that stand still, clocks, lever arms, noise."""

from __future__ import annotations

import numpy as np

from ...records import Shown
from .aids import Place, Wheels
from .offsets import ROLES
from .rounds import Navigated

DEG = 180.0 / np.pi
UNITS = {
    "gyro bias": ("deg/s", DEG), "accelerometer bias": ("m/s^2", 1.0), "gyro scale": ("%", 100.0),
    "accelerometer scale": ("%", 100.0), "hard iron": ("uT", 1e6), "earth field": ("uT", 1e6),
    "odometry scale": ("%", 100.0), "odometry mounting": ("deg", DEG), "lever arm": ("m", 1.0), "lag": ("s", 1.0),
    "datum": ("m", 1.0), "jump": ("m", 1.0), **{f"{role} offset": ("deg", DEG) for role in ROLES},
}  # fmt: skip


def shown(done: Navigated) -> tuple[Shown, ...]:
    """Return the states that are constant or walk slowly, their mean over the log, then lags and noise."""
    out, found = [], done.found
    x, P = found.smoothed.x.mean(axis=0), found.errors.P
    for state in done.problem.layout.states:
        key = next((key for key in UNITS if state.name.endswith(key)), None)
        if key is not None:
            unit, factor = UNITS[key]
            part = done.problem.layout.parts[state.name]
            values = x[part] * factor + (done.learnt.lags.get(state.name.removesuffix(" lag"), 0.0))
            sigma = np.sqrt(np.median(np.einsum("kii->ki", P[:, part, part]), axis=0)) * factor
            out.append(Shown(state.name, tuple(values.tolist()), tuple(sigma.tolist()), unit))
    if done.problem.origin is not None:
        latitude, longitude, height = done.problem.origin
        out.append(Shown("origin of the position", (latitude * DEG, longitude * DEG, height), (), "deg, deg, m"))
    return (*out, *_noise(done))


def _noise(done: Navigated) -> list[Shown]:
    """Return the noise that the drive was solved with, where it was found and not stated."""
    factors, inertial, out = done.learnt.factors, done.problem.inertial, []
    for name, density, unit in (
        ("gyro", inertial.gyro, "rad/s/sqrt(Hz)"),
        ("accelerometer", inertial.accel, "m/s^2/sqrt(Hz)"),
    ):
        if name in factors:
            out.append(Shown(f"{name} noise in motion", (float(np.sqrt(np.median(density))),), (), unit))
    for aid in done.problem.aids:
        if isinstance(aid, Place | Wheels) and aid.role in factors:
            unit = "m" if isinstance(aid, Place) else "m/s"
            sigma = np.nanmedian(aid.sigma, axis=0)
            out.append(Shown(f"{aid.role} noise", tuple(sigma.tolist()), (), unit))
    for state in done.problem.layout.coloured():
        sigma = np.broadcast_to(np.asarray(state.sigma), (state.size,))
        unit = "m/s" if state.name.endswith(("rate", "slip")) else "m"
        out.append(Shown(f"{state.name}, {state.correlation_s:.3g} s", tuple(sigma.tolist()), (), unit))
    return out
