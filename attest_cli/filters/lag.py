"""How late the stamps of a sensor of attitude are, shown by the drive: it must turn when the gyro turns."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ..maths import rotation
from ..maths.rotation import ROWS
from ..records import Array, Fixes, Log, Smoothed, World
from ..settings import Settings

MOST_S, SHARE = 12.0, 0.2  # lags that are tried; of the log
STEP_S, FINE_S = 0.1, 0.01
MOST = 500  # measurements that are asked
FEW = 20
CAP = 16.0  # squared sigmas that a measurement may miss by: outliers tell no lag
SIGNIFICANT = 36.0  # drop of the misfit, in units of what it comes down to: six sigma
LEAST_S = 0.03  # what is smaller changes nothing

Residual = Callable[[Fixes, Array, World, Settings], tuple[Array, float]]


def find_lags(log: Log, smoothed: Smoothed, world: World, settings: Settings) -> dict[str, float]:
    r"""Return by how many seconds the measurements of each sensor come late, where the drive shows it.

    The lag :math:`\tau` with the least misfit of the measurements to the attitude at :math:`t-\tau`, with one turn
    about the vertical free, for heading may be that of the late sensor itself.
    """
    out = {}
    for role, residual in RESIDUALS.items():
        fixes = log.fixes.get(role)
        if fixes is None or len(fixes.t) < FEW or (role == "sun" and world.sun_n is None):
            continue
        every = slice(None, None, -(-len(fixes.t) // MOST))
        some = Fixes(role, fixes.channel, fixes.t[every], fixes.values[every])
        sun_n = world.sun_n if world.sun_n is None or world.sun_n.ndim == 1 else world.sun_n[every]
        lag = _lag(smoothed, some, World(world.gravity, sun_n, world.field_n), settings, residual)
        if abs(lag) > LEAST_S:
            out[role] = lag
    return out


def _lag(smoothed: Smoothed, fixes: Fixes, world: World, settings: Settings, residual: Residual) -> float:
    """Return the lag of one sensor, 0 where it is not significant."""
    span = float(smoothed.t[-1] - smoothed.t[0])
    most = STEP_S * round(float(min(MOST_S, SHARE * span)) / STEP_S)
    inside = (fixes.t > smoothed.t[0] + most) & (fixes.t < smoothed.t[-1] - most)
    count = int(np.count_nonzero(inside))
    if count < FEW:
        return 0.0
    fixes = Fixes(fixes.role, fixes.channel, fixes.t[inside], fixes.values[inside])
    sun_n = world.sun_n if world.sun_n is None or world.sun_n.ndim == 1 else world.sun_n[inside]
    world = World(world.gravity, sun_n, world.field_n)

    def misfits(lags: Array) -> Array:
        each = max(ROWS // count, 1)  # lags that are tried at once: what is made on the way stays in cache
        parts = [lags[k : k + each] for k in range(0, len(lags), each)]
        return np.concatenate([_misfits(smoothed, fixes, world, settings, residual, part) for part in parts])

    coarse = np.arange(-most, most + STEP_S / 2, STEP_S)
    best = float(coarse[int(np.argmin(misfits(coarse)))])
    fine = best + np.arange(-STEP_S, STEP_S + FINE_S / 2, FINE_S)
    *at_fine, unmoved = misfits(np.append(fine, 0.0)).tolist()
    k = int(np.argmin(at_fine))
    freedom = max(count * (1 if fixes.role == "compass" else 2), 1)
    drop = (unmoved - at_fine[k]) / max(at_fine[k] / freedom, 1e-12)
    certain = drop > SIGNIFICANT and abs(best) < most - STEP_S
    return round(float(fine[k]), 3) if certain else 0.0


def _misfits(
    smoothed: Smoothed, fixes: Fixes, world: World, settings: Settings, residual: Residual, lags: Array
) -> Array:
    """Return the sum of squared sigmas, capped, with each of the lags (l,) and the turn about the vertical for it."""
    at = _attitude(smoothed, fixes.t - lags[:, None])
    r, sigma = residual(fixes, at, world, settings)
    step, d = 1e-4, r.shape[-1]
    turned = rotation.multiply(rotation.exp_quaternion(np.array([0.0, 0.0, step])), at)
    slope = (residual(fixes, turned, world, settings)[0] - r) / step
    for _ in range(3):  # the turn about the vertical, outliers capped
        use = np.sum(r**2, axis=-1) < CAP * sigma**2 * d
        used = slope * use[..., None]
        power, along = np.einsum("lkd,lkd->l", used, slope), np.einsum("lkd,lkd->l", used, r)
        turn = -np.divide(along, power, out=np.zeros(len(lags)), where=power > 0.0)
        r = r + slope * turn[:, None, None]
    return np.asarray(np.sum(np.minimum(np.sum(r**2, axis=-1) / sigma**2, CAP * d), axis=1))


def _attitude(smoothed: Smoothed, t: Array) -> Array:
    """Return the attitude (..., 4) at instants, between the nodes."""
    k = np.clip(np.searchsorted(smoothed.t, t, side="right") - 1, 0, len(smoothed.t) - 2)
    share = np.clip((t - smoothed.t[k]) / (smoothed.t[k + 1] - smoothed.t[k]), 0.0, 1.0)
    turn = rotation.log_quaternion(rotation.multiply(rotation.conjugate(smoothed.q[k]), smoothed.q[k + 1]))
    return rotation.multiply(smoothed.q[k], rotation.exp_quaternion(turn * share[..., None]))


def _sun(fixes: Fixes, q: Array, world: World, settings: Settings) -> tuple[Array, float]:
    seen = rotation.rotate(rotation.conjugate(q), np.asarray(world.sun_n))
    seen = seen @ rotation.matrix(np.array(settings.sun.mounting))
    return fixes.values - seen[..., : fixes.values.shape[1]], float(np.radians(settings.sun.sigma_deg))


def _compass(fixes: Fixes, q: Array, world: World, settings: Settings) -> tuple[Array, float]:  # noqa: ARG001 (one signature)
    forward = rotation.matrix(q)[..., :2, 0]
    off = fixes.values[:, 0] - np.arctan2(forward[..., 0], forward[..., 1])
    return np.arctan2(np.sin(off), np.cos(off))[..., None], float(np.radians(settings.compass.sigma_deg))


def _orientation(fixes: Fixes, q: Array, world: World, settings: Settings) -> tuple[Array, float]:  # noqa: ARG001
    off = rotation.log_quaternion(rotation.multiply(fixes.values, rotation.conjugate(q)))
    return off, float(np.radians(settings.orientation.sigma_deg))


RESIDUALS: Mapping[str, Residual] = {"sun": _sun, "compass": _compass, "orientation": _orientation}
"""Role -> function from fixes and the attitude at their times (l, k, 4) to residuals (l, k, d) and their sigma, rad."""
