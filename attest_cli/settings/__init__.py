"""Typed settings: TOML and the command line in, effective values with their sources out. Loads no numeric package."""

from .load import CONFIG_NAME, Effective, load_settings
from .models import GPS_SIGMA_M, POSITION_SIGMA_M, Role, Settings

__all__ = ["CONFIG_NAME", "GPS_SIGMA_M", "POSITION_SIGMA_M", "Effective", "Role", "Settings", "load_settings"]
