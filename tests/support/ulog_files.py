"""PX4 ULog by hand, as its specification has it: header, flag bits, formats, subscriptions, data, dropouts."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

HEADER = b"ULog\x01\x12\x35\x01"
CODES = {"uint64_t": "Q", "uint32_t": "I", "int32_t": "i", "uint16_t": "H", "uint8_t": "B", "float": "f", "double": "d"}

Value = float | Sequence[float]
Row = Mapping[str, Value]

FORMATS: Mapping[str, str] = {
    "sensor_combined": "uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;"
    "int32_t accelerometer_timestamp_relative;float[3] accelerometer_m_s2;uint32_t accelerometer_integral_dt;"
    "uint8_t accelerometer_clipping;uint8_t[7] _padding0;",
    "vehicle_imu": "uint64_t timestamp;uint64_t timestamp_sample;float[3] delta_angle;float[3] delta_velocity;"
    "uint32_t delta_angle_dt;uint32_t delta_velocity_dt;",
    "vehicle_magnetometer": "uint64_t timestamp;uint64_t timestamp_sample;float[3] magnetometer_ga;",
    "vehicle_gps_position": "uint64_t timestamp;int32_t lat;int32_t lon;int32_t alt;int32_t alt_ellipsoid;float eph;"
    "float epv;uint8_t fix_type;",
    "vehicle_attitude": "uint64_t timestamp;float[4] q;",
    "battery_status": "uint64_t timestamp;float voltage_v;",
}
"""Topic -> its format, as PX4 1.13 writes it."""


def record(kind: str, body: bytes) -> bytes:
    """Return a record: its length, its letter, its bytes."""
    return struct.pack("<HB", len(body), ord(kind)) + body


def packed(layout: str, row: Row) -> bytes:
    """Return the bytes of one row; fields that are not given are zero, padding at the end is left out."""
    out = b""
    for field in layout.strip(";").split(";"):
        kind, name = field.split()
        base, _, rest = kind.partition("[")
        count = int(rest[:-1]) if rest else 1
        if name.startswith("_padding"):
            continue
        value = row.get(name, [0] * count if rest else 0)
        out += struct.pack(f"<{count}{CODES[base]}", *(value if isinstance(value, Sequence) else [value]))
    return out


def write(
    path: Path, rows: Sequence[tuple[str, int, Row]], formats: Mapping[str, str] = FORMATS, dropouts: int = 0
) -> Path:
    """Write rows of (topic, instance, fields) in their order, and dropouts of 100 ms."""
    ids = {key: k for k, key in enumerate(dict.fromkeys((topic, instance) for topic, instance, _ in rows))}
    data = HEADER + struct.pack("<Q", 1000) + record("B", bytes(40))
    data += b"".join(record("F", f"{name}:{layout}".encode()) for name, layout in formats.items())
    for (topic, instance), k in ids.items():
        data += record("A", struct.pack("<BH", instance, k) + topic.encode())
    for topic, instance, row in rows:
        data += record("D", struct.pack("<H", ids[topic, instance]) + packed(formats[topic], row))
    path.write_bytes(data + record("O", struct.pack("<H", 100)) * dropouts)
    return path
