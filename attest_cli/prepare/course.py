"""Whether heading turns as the gyro does: the way of the fixes, or a compass, against the turn about the vertical.

Gravity does not show turns about the vertical: this is what tells their unit and sign where nothing leans.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from ..maths.rotation import wrap
from ..records import Array, Fixes, Imu, Warn
from ..settings import GPS_SIGMA_M

EARTH_M = 6.371e6
WINDOW_S, SPAN_S, LONGEST_S = 0.5, 5.0, 60.0  # of means; between compass readings; between headings that are compared
LEAST_M = 3.0  # a stretch of way that shows a course
SHORT, LONG = 6.0, 20.0  # the same in sigmas of the fixes: some drives turn often, some little
FEW, MOST = 12, 2000  # turns of heading
FACTORS = np.concatenate([sign * np.geomspace(0.01, 100.0, 161) for sign in (1.0, -1.0)])
CIRCLE_RAD, TURNS_RAD = np.radians(2.0 * np.pi), np.radians(60.0)  # a circle in rad, read as deg; a log that turns
SAME, CLEARLY = (0.6, 1.6), 0.3  # factors that are no other; loss over that without a factor, and without a gyro


def doubts(fixes: Mapping[str, Fixes], imu: Imu) -> list[Warn]:
    r"""Say where heading turns by another factor :math:`s` of what the gyro says than one.

    .. math:: \overline{1-\cos(\Delta\psi_k-s\textstyle\int\omega_{up}dt)}

    is least at :math:`s`: -1 with a reversed axis, 1/57 in degrees, 0.1 where the clock runs ten times too slow.
    """
    for role, courses in COURSES:
        if role not in fixes:
            continue
        t, course = courses(fixes[role])
        near = np.flatnonzero((np.diff(t) < LONGEST_S) & (t[:-1] >= imu.t[0]) & (t[1:] <= imu.t[-1]))[:MOST]
        if len(near) < FEW:
            continue
        turned = _turned(imu, t)
        seen, by_gyro = wrap(course[near + 1] - course[near]), turned[near + 1] - turned[near]
        losses = np.array([np.mean(1.0 - np.cos(seen - s * by_gyro)) for s in (1.0, 0.0, *FACTORS)])
        k = int(np.argmin(losses[2:]))
        factor, least = float(FACTORS[k]), float(losses[2 + k])
        if SAME[0] < factor < SAME[1] or least > CLEARLY * min(losses[0], losses[1]):
            continue
        message = f"the heading of {fixes[role].channel} ({role}) turns {factor:.2g} times as far as the gyro says"
        hint = "check the gyro's unit, the sign of its vertical axis, and the unit and rate of the clock"
        return [Warn("gyro-against-heading", message, hint, fatal=True)]
    return _in_radians(fixes["compass"], imu) if "compass" in fixes else []


def _in_radians(compass: Fixes, imu: Imu) -> list[Warn]:
    """Say where a compass in degrees stays within those of a circle in radians while the gyro turns by far more."""
    within = np.all(np.abs(compass.values) < CIRCLE_RAD) and np.ptp(compass.values, axis=0).max(initial=0.0) > 0.0
    if not within or np.ptp(_turned(imu, compass.t)) < TURNS_RAD:
        return []
    most = float(np.degrees(np.abs(compass.values).max()))
    fact = f"all headings of {compass.channel} (compass) are within {most:.2f} deg"
    return [Warn("unit-doubted", f"{fact} while the gyro turns: are they in rad?", "state their unit", fatal=True)]


def _turned(imu: Imu, at: Array) -> Array:
    """Return the angle (k,) turned about the vertical since the start, by the gyro without its median."""
    first = np.flatnonzero(np.diff(np.floor((imu.t - imu.t[0]) / WINDOW_S), prepend=-1.0))
    count = np.diff(np.append(first, len(imu.t)))[:, None]
    rate, force = (np.add.reduceat(x, first, axis=0) / count for x in (imu.gyro_b, imu.accel_b))
    middle = np.add.reduceat(imu.t, first) / count[:, 0]
    vertical = np.einsum("ij,ij->i", rate, force) / np.maximum(np.linalg.norm(force, axis=1), 1e-9)
    steps = 0.5 * (vertical[1:] + vertical[:-1]) * np.diff(middle)
    return np.asarray(np.interp(at, middle, np.concatenate([[0.0], np.cumsum(steps)])))


def _by_way(fixes: Fixes, sigmas: float) -> tuple[Array, Array]:
    """Return times and courses (k,), counter-clockwise from east, of stretches that stand out of the noise."""
    known = np.isfinite(fixes.values[:, :2]).all(axis=1)
    t, place = fixes.t[known], fixes.values[known, :2]
    if len(t) < FEW:
        return np.empty(0), np.empty(0)
    xy = EARTH_M * (place - place[0])[:, ::-1] * [np.cos(place[0, 0]), 1.0]
    sigma = GPS_SIGMA_M if fixes.sigma is None else float(np.nanmedian(fixes.sigma[:, 0]))
    kept, far = [0], max(LEAST_M, sigmas * sigma)
    for k in range(1, len(t)):
        if np.hypot(*(xy[k] - xy[kept[-1]])) > far:
            kept.append(k)
    steps = np.diff(xy[kept], axis=0)
    return 0.5 * (t[kept][1:] + t[kept][:-1]), np.arctan2(steps[:, 1], steps[:, 0])


def _by_compass(fixes: Fixes) -> tuple[Array, Array]:
    """Return times and headings (k,), counter-clockwise, some seconds apart."""
    first = np.flatnonzero(np.diff(np.floor(fixes.t / SPAN_S), prepend=-np.inf))
    return fixes.t[first], -fixes.values[first, 0]


COURSES: Sequence[tuple[str, Callable[[Fixes], tuple[Array, Array]]]] = (
    ("gps", partial(_by_way, sigmas=SHORT)),
    ("gps", partial(_by_way, sigmas=LONG)),
    ("compass", _by_compass),
)
"""Role, and function to times and headings that it shows."""
