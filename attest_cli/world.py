"""Reference directions of the world: gravity, the sun at each fix, the magnetic field; from the settings, else from
place and time.
"""

from __future__ import annotations

import numpy as np

from .errors import AttestError
from .records import Array, Log, World
from .settings import Settings

UNIX_EPOCH_OF_2000_NS = 946_684_800 * 10**9
SECONDS_PER_YEAR = 365.25 * 86400


def find_world(log: Log, settings: Settings) -> World:
    """Return what the absolute sensors of this log refer to; raises only where the settings contradict themselves."""
    cfg, notes = settings.world, []
    place = cfg.latitude_deg is not None and cfg.longitude_deg is not None
    sun = field = None
    if cfg.sun_direction is not None:
        sun = np.array(cfg.sun_direction)
    elif "sun" in log.fixes and place:
        if cfg.body != "earth":
            raise AttestError(
                "the sun's place is computed for the Earth only", 'set [world] sun_direction with body = "mars"'
            )
        sun = _sun(log, settings)
        notes.append("sun direction from place and time (NREL solar position algorithm)")
    if cfg.magnetic_field_ut is not None:
        field = np.array(cfg.magnetic_field_ut) * 1e-6
    elif "magnetometer" in log.fixes and place and cfg.body == "earth" and log.t0_ns > UNIX_EPOCH_OF_2000_NS:
        field = _field(log, settings)
        notes.append(
            f"magnetic declination {np.degrees(np.arctan2(field[0], field[1])):.1f} deg (World Magnetic Model)"
        )
    return World(cfg.gravity_m_s2, sun, field, tuple(notes))


def _sun(log: Log, settings: Settings) -> Array:
    """Return unit vectors to the sun (m, 3), ENU, at the sun fixes (pvlib's NREL SPA, 0.0003 deg)."""
    if log.t0_ns < UNIX_EPOCH_OF_2000_NS:
        raise AttestError(
            "the log's time is not absolute, so the sun's place is not known", "set [world] sun_direction"
        )
    import pandas as pd
    from pvlib.solarposition import get_solarposition

    cfg = settings.world
    when = pd.to_datetime(log.t0_ns + np.round(log.fixes["sun"].t * 1e9).astype(np.int64), utc=True)
    place = get_solarposition(when, cfg.latitude_deg, cfg.longitude_deg, altitude=cfg.altitude_m, method="nrel_numpy")
    azimuth, elevation = (np.radians(place[k].to_numpy()) for k in ("azimuth", "elevation"))
    return np.stack(
        [np.sin(azimuth) * np.cos(elevation), np.cos(azimuth) * np.cos(elevation), np.sin(elevation)], axis=1
    )


def _field(log: Log, settings: Settings) -> Array:
    """Return the magnetic field (3,), ENU, tesla, of the World Magnetic Model."""
    from pygeomag import GeoMag

    cfg = settings.world
    year = 1970.0 + log.t0_ns * 1e-9 / SECONDS_PER_YEAR
    model = GeoMag(high_resolution=False)
    f = model.calculate(
        glat=cfg.latitude_deg,
        glon=cfg.longitude_deg,
        alt=cfg.altitude_m / 1000,
        time=year,
        allow_date_outside_lifespan=True,
    )
    return np.array([f.y, f.x, -f.z]) * 1e-9
