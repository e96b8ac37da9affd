"""Whether a sun sensor and the accelerometer see the angle that the reference has between sun and vertical."""

from __future__ import annotations

import numpy as np

from ..maths import rotation
from ..records import Array, Fixes, Log, Segmentation, Warn, World
from ..settings import Settings

SURE = 3.0  # of the sensor's sigma and of the tilt that the accelerometer's bias leaves: both last over a stop


def sun_angles(fixes: Fixes, log: Log, segmentation: Segmentation, sun_n: Array, settings: Settings) -> Array:
    """Return, per stop, the angle (k, 2) from up to the sun, rad: as seen, and of its reference; medians of a stop."""
    seen = fixes.values
    if seen.shape[1] == 2:
        third = np.sqrt(np.maximum(1.0 - np.sum(seen**2, axis=1, keepdims=True), 0.0))
        seen = np.concatenate([seen, third], axis=1)
    seen = seen @ rotation.matrix(np.array(settings.sun.mounting)).T
    given = np.broadcast_to(sun_n, (len(fixes.t), 3))
    out = []
    for s in segmentation.stops:
        first, lo = (np.searchsorted(t, s.used_start) for t in (fixes.t, log.imu.t))
        end, hi = (np.searchsorted(t, s.used_end, side="right") for t in (fixes.t, log.imu.t))
        if end > first and hi - lo >= 3:
            up = log.imu.accel_b[lo:hi].mean(axis=0)
            pairs = (seen[first:end], up / np.linalg.norm(up)), (given[first:end], np.array([0.0, 0.0, 1.0]))
            out.append([float(np.median(_angles(vectors, axis))) for vectors, axis in pairs])
    return np.array(out).reshape(-1, 2)


def sun_doubts(fixes: Fixes, log: Log, segmentation: Segmentation, world: World, settings: Settings) -> list[Warn]:
    r"""Say where sun and gravity stand at another angle to each other than their references: no attitude mends that.

    At most stops it is more than :math:`3\sqrt{\sigma_s^2+(\sigma_{b_a}/g)^2}` off.
    """
    if world.sun_n is None:
        return []
    angles = sun_angles(fixes, log, segmentation, world.sun_n, settings)
    sigma = float(np.hypot(np.radians(settings.sun.sigma_deg), settings.imu.accel_bias_sigma / world.gravity))
    off = np.abs(angles[:, 0] - angles[:, 1])
    if not len(off) or not np.median(off) > SURE * sigma:
        return []
    stop = int(np.argsort(off)[len(off) // 2])
    seen, given = np.degrees(angles[stop])
    message = f"at the stops the sun stands {seen:.1f} deg from up, where by its reference it is {given:.1f} deg"
    hint = "check [world] sun_direction or time and place, [sun] mounting, and the axes of sun sensor and accelerometer"
    return [Warn("sun-reference", message, hint)]


def _angles(vectors: Array, axis: Array) -> Array:
    """Return the angles (n,) of vectors (n, 3) from a unit axis, rad."""
    sizes = np.maximum(np.linalg.norm(vectors, axis=1), 1e-300)
    return np.asarray(np.arccos(np.clip(vectors @ axis / sizes, -1.0, 1.0)))
