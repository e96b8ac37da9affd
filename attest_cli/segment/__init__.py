"""Stops and motions of a drive, found from the norms of the IMU's signals: turned axes give the same segments.

A stop is where the accelerometer does not vary, the gyro shows its bias and nothing else, and, where there is wheel
odometry, the wheels do not turn. The gyro's bias is not known beforehand: it is the rate that quiet intervals share.
"""

from .detector import find_segments

__all__ = ["find_segments"]
