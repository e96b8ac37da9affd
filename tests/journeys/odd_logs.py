"""Odd logs made of the shipped drive: cut, turned, blanked, broken; each with its truth, and judged against it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pv
import pyarrow.parquet as pq
from numpy.typing import NDArray

from attest_cli.maths import rotation

Array = NDArray[np.float64]
Columns = dict[str, NDArray[Any]]

GYRO = ("gyro_x", "gyro_y", "gyro_z")
ACCEL = ("accel_x", "accel_y", "accel_z")
SUN = ("sun_x", "sun_y")
ODOMETRY = ("velocity_x", "velocity_y", "velocity_z")
SIGMAS = ("sigma_att_x_deg", "sigma_att_y_deg", "sigma_att_z_deg")


@dataclass(frozen=True)
class Drive:
    """Columns of a log (blank = NaN), of its truth on the same rows, and the text of its ``attest.toml``."""

    columns: Columns
    truth: Columns
    config: str

    def rows(self, keep: NDArray[Any]) -> Drive:
        """Keep these rows (mask or indices)."""
        return replace(
            self,
            columns={name: values[keep] for name, values in self.columns.items()},
            truth={name: values[keep] for name, values in self.truth.items()},
        )

    def span(self, start_s: float, end_s: float) -> Drive:
        """Keep ``start_s <= t < end_s``."""
        return self.rows((self.t >= start_s) & (self.t < end_s))

    def without(self, *names: str) -> Drive:
        """Leave columns out."""
        return replace(self, columns={name: v for name, v in self.columns.items() if name not in names})

    def changed(self, **columns: NDArray[Any]) -> Drive:
        """Put other values in columns."""
        return replace(self, columns=self.columns | columns)

    def turned(self, R_sb: Array) -> Drive:
        """Mount the IMU another way: its vectors in sensor axes; truth stays that of the vehicle."""
        out = dict(self.columns)
        for names in (GYRO, ACCEL):
            vectors = np.stack([self.columns[name] for name in names], axis=1) @ R_sb.T
            out |= dict(zip(names, vectors.T, strict=True))
        return replace(self, columns=out)

    def told(self, old: str, new: str) -> Drive:
        """Change the config."""
        assert old in self.config
        return replace(self, config=self.config.replace(old, new))

    def digest(self) -> bytes:
        """What tells this drive and config from others."""
        found = hashlib.sha256(self.config.encode())
        for name, values in self.columns.items():
            found.update(name.encode() + values.tobytes())
        return found.digest()

    @property
    def t(self) -> Array:
        """Seconds since the first row."""
        stamps = self.columns["timestamp_ns"]
        return np.asarray((stamps - stamps[0]) * 1e-9)

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Where the truth moves."""
        return np.asarray(self.truth["moving"], dtype=np.bool_)

    def write(self, folder: Path, name: str = "drive.parquet", *, config: bool = True) -> Path:
        """Write log and config; return the log."""
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / name
        table = pa.table({key: pa.array(v, from_pandas=v.dtype.kind == "f") for key, v in self.columns.items()})
        pv.write_csv(table, path) if path.suffix == ".csv" else pq.write_table(table, path)
        if config:
            (folder / "attest.toml").write_text(self.config, encoding="utf-8")
        return path


def sample_drive(samples: Path) -> Drive:
    """Read the shipped drive."""
    log, truth = (_columns(samples / name) for name in ("rover.parquet", "rover.truth.parquet"))
    return Drive(log, truth, (samples / "attest.toml").read_text(encoding="utf-8"))


def _columns(path: Path) -> Columns:
    table = pq.read_table(path)
    return {name: table[name].to_numpy() for name in table.column_names}


def read_track(folder: Path) -> Columns:
    """Columns of ``track.parquet``."""
    return _columns(folder / "track.parquet")


def quaternions(columns: Mapping[str, NDArray[Any]]) -> Array:
    """The attitude (n, 4), w x y z."""
    return np.stack([columns[name] for name in ("q_w", "q_x", "q_y", "q_z")], axis=1)


@dataclass(frozen=True)
class Judged:
    """Errors of a track against its truth, deg, about world axes, and the sigmas it states: all (n,)."""

    tilt: Array
    heading: Array
    sigma_tilt: Array
    sigma_heading: Array

    def tilt_ratio(self) -> float:
        """RMS of tilt error over its sigma (1 = honest; below 1 = careful)."""
        return float(np.sqrt(np.mean((self.tilt / self.sigma_tilt) ** 2)))

    def heading_ratio(self) -> float:
        """RMS of heading error over its sigma."""
        return float(np.sqrt(np.mean((self.heading / self.sigma_heading) ** 2)))


def judged(folder: Path, drive: Drive, *, relative: bool = False) -> Judged:
    """Hold a track against the truth of its drive; a relative heading counts from the first row."""
    track = read_track(folder)
    rows = np.searchsorted(drive.columns["timestamp_ns"], track["timestamp_ns"])
    assert np.array_equal(drive.columns["timestamp_ns"][rows], track["timestamp_ns"])
    q_true = quaternions({name: v[rows] for name, v in drive.truth.items()})
    error = np.degrees(rotation.log_quaternion(rotation.multiply(quaternions(track), rotation.conjugate(q_true))))
    if relative:
        yaw = np.radians(-error[0, 2])
        q = rotation.multiply(np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]), quaternions(track))
        error = np.degrees(rotation.log_quaternion(rotation.multiply(q, rotation.conjugate(q_true))))
    sigma = np.stack([track[name] for name in SIGMAS], axis=1)
    tilt, sigma_tilt = np.hypot(error[:, 0], error[:, 1]), np.hypot(sigma[:, 0], sigma[:, 1])
    return Judged(tilt, np.abs(error[:, 2]), sigma_tilt, sigma[:, 2])


Change = Callable[[Drive], Drive]
