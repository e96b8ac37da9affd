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
STRETCHES, EXPLAINED, NOISE = 4, 0.5, 4.0  # of the log; of the misfit, and squared sigmas: what a lag may leave
STEP_RAD, STEEP = 1e-4, 0.01  # of a slope by differences; least square of one that shows a turn
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

    turns = rotation.log_quaternion(rotation.multiply(rotation.conjugate(smoothed.q[:-1]), smoothed.q[1:]))

    def misfits(lags: Array) -> Array:
        each = max(ROWS // count, 1)  # lags that are tried at once: what is made on the way stays in cache
        parts = [lags[k : k + each] for k in range(0, len(lags), each)]
        return np.concatenate(
            [
                _misfits(_attitude(smoothed, turns, fixes.t - part[:, None]), fixes, world, settings, residual)
                for part in parts
            ]
        )

    coarse = np.arange(-most, most + STEP_S / 2, STEP_S)
    best = float(coarse[int(np.argmin(misfits(coarse).sum(axis=1)))])
    fine = best + np.arange(-STEP_S, STEP_S + FINE_S / 2, FINE_S)
    *at_fine, unmoved = misfits(np.append(fine, 0.0))
    k = int(np.argmin(np.sum(at_fine, axis=1)))
    freedom = max(count * (1 if fixes.role == "compass" else 2), 1)
    certain = abs(best) < most - STEP_S and _explains(at_fine[k], unmoved, freedom)
    return round(float(fine[k]), 3) if certain else 0.0


def _explains(late: Array, unmoved: Array, freedom: int) -> bool:
    """Whether a lag explains misfits (k,) that were ``unmoved`` (k,): it takes off more than chance would, in more than
    one stretch of the log, and what it leaves is noise, or a fraction.
    """
    left, before = float(late.sum()), float(unmoved.sum())
    gains = np.array([float(part.sum()) for part in np.array_split(unmoved - late, STRETCHES)])
    significant = before - left > SIGNIFICANT * max(left / freedom, 1e-12)
    return significant and gains.sum() - gains.max() > 0.0 and left < max(EXPLAINED * before, NOISE * freedom)


def _misfits(at: Array, fixes: Fixes, world: World, settings: Settings, residual: Residual) -> Array:
    """Return the squared sigmas (l, k), capped, at the attitudes (l, k, 4) of each lag, with the turn about the
    vertical for it.
    """
    r, slope, sigma = _sloped(fixes, at, world, settings, residual)
    at = rotation.multiply(rotation.exp_quaternion(_usual_turn(r, slope)[:, None, None] * [0.0, 0.0, 1.0]), at)
    r, slope, sigma = _sloped(fixes, at, world, settings, residual)
    d = r.shape[-1]
    for _ in range(3):  # the turn about the vertical, outliers capped
        use = np.sum(r**2, axis=-1) < CAP * sigma**2 * d
        used = slope * use[..., None]
        power, along = np.einsum("lkd,lkd->l", used, slope), np.einsum("lkd,lkd->l", used, r)
        turn = -np.divide(along, power, out=np.zeros(len(at)), where=power > 0.0)
        r = r + slope * turn[:, None, None]
    return np.asarray(np.minimum(np.sum(r**2, axis=-1) / sigma**2, CAP * d))


def _sloped(
    fixes: Fixes, at: Array, world: World, settings: Settings, residual: Residual
) -> tuple[Array, Array, float]:  # fmt: skip
    """Return the residuals (l, k, d) at attitudes (l, k, 4), what a turn about the vertical makes of them, per rad, and
    their sigma.
    """
    r, sigma = residual(fixes, at, world, settings)
    turned = rotation.multiply(rotation.exp_quaternion(np.array([0.0, 0.0, STEP_RAD])), at)
    return r, (residual(fixes, turned, world, settings)[0] - r) / STEP_RAD, sigma


def _usual_turn(r: Array, slope: Array) -> Array:
    """Return the median (l,) of the turns about the vertical that each residual asks for: a heading that is far off as
    a whole would make every measurement an outlier.
    """
    power = np.sum(slope**2, axis=-1)
    asked = -np.sum(slope * r, axis=-1) / np.maximum(power, 1e-12)
    middle = np.angle(np.mean(power * np.exp(1j * asked), axis=1, keepdims=True))
    steep = power > STEEP
    nothing = np.where(steep.any(axis=1, keepdims=True), np.nan, 0.0)  # the sun stands overhead
    return np.asarray(middle[:, 0] + np.nanmedian(np.where(steep, rotation.wrap(asked - middle), nothing), axis=1))


def _attitude(smoothed: Smoothed, turns: Array, t: Array) -> Array:
    """Return the attitude (..., 4) at instants, between the nodes, that ``turns`` (n - 1, 3) apart are."""
    k = np.clip(np.searchsorted(smoothed.t, t, side="right") - 1, 0, len(smoothed.t) - 2)
    share = np.clip((t - smoothed.t[k]) / (smoothed.t[k + 1] - smoothed.t[k]), 0.0, 1.0)
    return rotation.multiply(smoothed.q[k], rotation.exp_quaternion(turns[k] * share[..., None]))


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
