"""Satellite fixes: degrees or what else, no fix at all, the wrong place, digits that are missing."""

from __future__ import annotations

import numpy as np

from ..records import Array, Channel, Warn
from ..settings.models import World

EARTH_M = 6.371e6
FAR_M = 2e5  # from the place of the settings
SMALL_DEG = 0.01  # places nearer to 0, 0 are those of a simulation
INTEGER = 1e-7  # deg per count, as receivers and autopilots store it
LEAST_DIGITS, FEW = 6, 5  # behind the point, 0.1 m; fixes that tell how many there are
COARSE = 3.0  # of sigma: a last digit that is noise of its own


def degrees(channel: Channel, warnings: list[Warn]) -> Array:
    """Return latitude and longitude (n, 2) in degrees; NaN where a receiver says 0, 0: it has no fix.

    Values beyond any latitude are counts of 1e-7 deg where they are integers, else ddmm.mmmm as NMEA sentences have it:
    whole degrees times 100, plus minutes. Values that are all below pi/2 and pi are radians: in degrees
    they would lie in the Gulf of Guinea.
    """
    place = np.stack([channel.values["latitude"], channel.values["longitude"]], axis=1)
    place = np.where(np.all(place == 0.0, axis=1)[:, None], np.nan, place)
    stated = channel.units.get("latitude", "") or "deg"
    if stated == "rad":
        return np.degrees(place)
    known = np.abs(place[np.isfinite(place).all(axis=1)])
    if not len(known):
        return place
    largest, middle = known.max(axis=0), np.median(known, axis=0)
    factor, taken = 1.0, ""
    if _in_minutes(known):
        place, taken = np.trunc(place / 100.0) + np.fmod(place, 100.0) / 60.0, "ddmm.mmmm (degrees and minutes)"
    elif middle[0] > 90.0 and largest[0] * INTEGER <= 90.0 and largest[1] * INTEGER <= 180.0:
        factor, taken = INTEGER, "1e-7 deg"
    elif largest[0] <= 0.5 * np.pi and largest[1] <= np.pi and middle.min() > SMALL_DEG:
        factor, taken = float(np.degrees(1.0)), "rad"
    if taken:
        fact = f"channel {channel.name}: latitude and longitude of {middle[0]:.10g} and {middle[1]:.10g}"
        warnings.append(Warn("unit-contradicted", f"{fact} taken as {taken}", "write degrees"))
    return place * factor


def _in_minutes(known: Array) -> bool:
    """Tell ddmm.mmmm, absolute values (m, 2): fractions that counts do not have, minutes below 60 all along."""
    whole, minutes = np.divmod(known, 100.0)
    beyond = bool(np.any(np.median(known, axis=0) > [90.0, 180.0]))
    fractions = bool(np.any(known != np.round(known), axis=0).all())
    return beyond and fractions and bool(np.all(minutes < 60.0) and np.all(whole <= [90.0, 180.0]))


def doubts(channel: Channel, place: Array, world: World) -> list[Warn]:
    """Say where fixes (n, 2), deg, are far from the place of the settings."""
    known = place[np.isfinite(place).all(axis=1)]
    if not len(known) or world.latitude_deg is None or world.longitude_deg is None:
        return []
    here, there = np.median(known, axis=0), np.array([world.latitude_deg, world.longitude_deg])
    away = _apart(here, there)
    if away < FAR_M:
        return []
    swapped = _apart(here[::-1], there) < FAR_M
    why = ": latitude and longitude are swapped" if swapped else ""
    message = f"channel {channel.name}: the fixes are {away * 1e-3:.0f} km from the place under [world]{why}"
    hint = "swap their columns" if swapped else "which of them is wrong?"
    return [Warn("gps-elsewhere", message, hint, fatal=swapped)]


def resolution(place: Array) -> float:
    """Return the last digit of fixes (n, 2), deg, in metres; 0 where they have all they need."""
    known = place[np.isfinite(place).all(axis=1)]
    for digits in range(LEAST_DIGITS if len(known) >= FEW else 0):
        if np.allclose(known, np.round(known, digits), rtol=0.0, atol=1e-9):
            return float(np.radians(10.0**-digits)) * EARTH_M
    return 0.0


def coarse(channel: Channel, place: Array, sigma_m: float) -> list[Warn]:
    """Say where the last digit is larger than the noise."""
    step = resolution(place)
    if step <= COARSE * sigma_m:
        return []
    message = f"channel {channel.name}: the fixes are rounded to {step:.0f} m"
    return [Warn("gps-coarse", message, "write degrees with seven digits behind the point", fatal=True)]


def _apart(a: Array, b: Array) -> float:
    """Return how far two places (latitude, longitude, deg) are apart, m, on a sphere."""
    (p, lon_a), (s, lon_b) = np.radians(a), np.radians(b)
    half = np.sin(0.5 * (s - p)) ** 2 + np.cos(p) * np.cos(s) * np.sin(0.5 * (lon_b - lon_a)) ** 2
    return float(2.0 * EARTH_M * np.arcsin(np.sqrt(min(1.0, max(0.0, half)))))
