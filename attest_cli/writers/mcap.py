"""Track to MCAP: ``nav_msgs/msg/Odometry`` with covariance; ``sensor_msgs/msg/Imu`` without bias where it is given."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import Blocks
from .ros2 import Bag, Message, bag, diagonal, quaternion, vector

ODOMETRY_TOPIC, IMU_TOPIC = "/attest/odometry", "/attest/imu"
CHILD_FRAME = "base_link"
IMU = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")
NOT_PROVIDED = -1.0  # first entry of a covariance, REP-145


def write(blocks: Blocks, metadata: Mapping[str, str], path: Path) -> None:
    """Write a track; see ``writers``.

    Odometry: pose in the frame of the track, its covariance about the world's axes; twist in body axes.
    Columns ``gyro_x`` ... ``accel_z`` (body axes, without bias) add the Imu topic.
    """
    frame = "map_ned" if metadata.get("frame", "").lower().startswith("ned") else "map"
    parts = iter(blocks)
    first = next(parts)
    with bag(path, int(first["timestamp_ns"][0])) as out:
        out.note("attest", metadata)
        for block in chain([first], parts):
            _send_block(out, block, frame)


def _send_block(out: Bag, block: Mapping[str, NDArray[Any]], frame: str) -> None:
    attitude = _table(block, "q_w", "q_x", "q_y", "q_z")
    sigma = np.radians(_table(block, "sigma_att_x_deg", "sigma_att_y_deg", "sigma_att_z_deg"))
    position = _table(block, "position_x_m", "position_y_m", "position_z_m")
    position_sigma = _table(block, "sigma_position_x_m", "sigma_position_y_m", "sigma_position_z_m")
    velocity_b = _to_body(attitude, _table(block, "velocity_x_m_s", "velocity_y_m_s", "velocity_z_m_s"))
    imu = _table(block, *IMU) if all(name in block for name in IMU) else None
    pose = np.concatenate([attitude, position, np.square(position_sigma), np.square(sigma)], axis=1).tolist()
    for k, stamp in enumerate(block["timestamp_ns"].tolist()):
        out.send(ODOMETRY_TOPIC, "nav_msgs/Odometry", stamp, frame, _odometry(pose[k], velocity_b[k].tolist()))
        if imu is not None:
            _send_imu(out, stamp, attitude[k].tolist(), imu[k].tolist())


def _odometry(pose: list[float], velocity_b: list[float]) -> Message:
    """Return an Odometry; what is not known is zero with a first covariance of -1."""
    has_position, has_velocity = math.isfinite(pose[4]), math.isfinite(velocity_b[0])
    variances = [value if math.isfinite(value) else 0.0 for value in pose[7:13]]
    if not has_position:
        variances[0] = NOT_PROVIDED
    return {
        "child_frame_id": CHILD_FRAME,
        "pose": {
            "pose": {
                "position": vector(*(pose[4:7] if has_position else (0.0, 0.0, 0.0))),
                "orientation": quaternion(*pose[:4]),
            },
            "covariance": diagonal(6, *variances),
        },
        "twist": {
            "twist": {
                "linear": vector(*(velocity_b if has_velocity else (0.0, 0.0, 0.0))),
                "angular": vector(0.0, 0.0, 0.0),
            },
            "covariance": diagonal(6, *(() if has_velocity else (NOT_PROVIDED,))),
        },
    }


def _send_imu(out: Bag, stamp: int, attitude: list[float], imu: list[float]) -> None:
    fields = {
        "orientation": quaternion(*attitude),
        "orientation_covariance": diagonal(3),
        "angular_velocity": vector(*imu[:3]),
        "angular_velocity_covariance": diagonal(3),
        "linear_acceleration": vector(*imu[3:]),
        "linear_acceleration_covariance": diagonal(3),
    }
    out.send(IMU_TOPIC, "sensor_msgs/Imu", stamp, CHILD_FRAME, fields)


def _table(columns: Mapping[str, NDArray[Any]], *names: str) -> NDArray[np.float64]:
    """Stack columns (n, k); NaN where the track has none."""
    blank = np.full(columns["q_w"].shape, np.nan)
    return np.stack([np.asarray(columns.get(name, blank), dtype=np.float64) for name in names], axis=1)


def _to_body(q: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``R(q)^T v``: v + 2 u x (u x v) - 2 w u x v with the vector part u of q."""
    u = q[:, 1:]
    cross = np.cross(u, v)
    return np.asarray(v + 2.0 * np.cross(u, cross) - 2.0 * q[:, :1] * cross)
