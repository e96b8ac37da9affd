"""How noisy the wheels are: as the settings say, else as the log does."""

from __future__ import annotations

import numpy as np

from ..records import Array, Fixes
from ..settings.models import Odometry

LEAST_M_S = 0.01  # no wheel on the ground tells its speed better, whatever it states
UNKNOWN_M_S = 100.0  # a driver's word for "not measured"


def sigma_of(odometry: Fixes, settings: Odometry) -> Array:
    """Return the sigma (k, 3) of the wheel speed, m/s, vehicle axes.

    What the user states counts, then what the log states, then the default. Sideways and up the default also counts
    where the log knows nothing: a vehicle on wheels does not go there.
    """
    default = np.array([settings.sigma_m_s, settings.lateral_sigma_m_s, settings.lateral_sigma_m_s])
    out = np.tile(default, (len(odometry.t), 1))
    if odometry.sigma is None:
        return out
    given = np.isfinite(odometry.sigma) & (odometry.sigma > 0.0)
    given[:, 1:] &= odometry.sigma[:, 1:] < UNKNOWN_M_S
    stated = settings.model_fields_set
    given &= np.array(["sigma_m_s" not in stated, *["lateral_sigma_m_s" not in stated] * 2])
    return np.where(given, np.maximum(np.where(given, odometry.sigma, 0.0), LEAST_M_S), out)
