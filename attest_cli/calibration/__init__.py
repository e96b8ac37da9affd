"""Calibration of the gyro (and what else the log allows) from logs at rest and the stops of drives."""
