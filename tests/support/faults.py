"""Faulty logs: clean simulated drives, what can be wrong with them, and how well attest said so."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from journeys.odd_logs import SIGMAS, Columns, Drive, Judged, quaternions, read_track
from mcap_ros2.writer import Writer
from numpy.typing import NDArray

from attest_cli.errors import AttestError
from attest_cli.maths import rotation
from attest_cli.pipeline import _toml, smooth
from attest_cli.records import COLUMNS, Channel
from attest_cli.settings import load_settings
from attest_cli.simulate import (
    GyrostarOptions,
    RoverOptions,
    Simulation,
    WalkingOptions,
    simulate_gyrostar,
    simulate_rover,
    simulate_walking,
)
from attest_cli.simulate import drive as drives
from attest_cli.simulate import instruments as sensors
from attest_cli.simulate import rover as rovers
from attest_cli.simulate.drive import GRAVITY_M_S2, Kinematics, Timeline, Waves, attitude, windowed
from attest_cli.simulate.simulation import recording, seconds, stamps_of, truth_columns
from attest_cli.writers.logs import MESSAGES
from attest_cli.writers.ros2 import definition

Array = NDArray[np.float64]
Write = Callable[[Drive, Path], Sequence[Path]]
HONEST = 3.0  # RMS of error over sigma that a drive may have, per axis
FAR, FAR_SHARE = 3.5, 0.05  # errors beyond so many sigma, in a share of the rows
LARGER = 25.0  # times the rover's way and speed: a vehicle's
GRADES_BAD = ("silent-wrong", "traceback", "leftover", "unnamed", "needless")


# ---- clean drives


def rover(seed: int, duration_s: float = 90.0, rate_hz: float = 50.0, **with_sensors: Any) -> Simulation:
    """A rover that stops three times."""
    options = {"sun": False, "motions": 2, "stop_s": (8.0, 12.0), "magnetometer_hz": 10.0, "gps_hz": 1.0}
    return simulate_rover(
        RoverOptions(seed=seed, duration_s=duration_s, rate_hz=rate_hz, **{**options, **with_sensors})
    )


def hand(seed: int, duration_s: float = 60.0, rate_hz: float = 50.0) -> Simulation:
    """An IMU with magnetometer that is waved about in a hand, at rest at both ends and once between."""
    rng = np.random.default_rng([seed, 77])
    line = Timeline(np.array([[6.0, 0.45 * duration_s], [0.45 * duration_s + 6.0, duration_s - 6.0]]), duration_s)
    stamps = stamps_of(duration_s, round(1e9 / rate_hz))
    t = seconds(stamps)
    _, *windows = line.progress(t)
    shape = (3, 3)

    def waves(size: float) -> tuple[Array, Array, Array]:
        wave = Waves(size * rng.uniform(0.5, 1.0, shape), rng.uniform(0.8, 4.0, shape), rng.uniform(0.0, 6.0, shape))
        return windowed(wave.at(t), tuple(w[:, None] for w in windows))

    (angles, rates, _), (p, v, a) = waves(0.7), waves(0.06)
    R_nb, q_nb, rate_b = attitude(angles, rates)
    force_b = np.einsum("nji,nj->ni", R_nb, a + np.array([0.0, 0.0, GRAVITY_M_S2]))
    clean = Kinematics(t, q_nb, R_nb, rate_b, force_b, p, v, np.linalg.norm(v, axis=1), line.moving(t))
    bias = np.tile(rng.normal(0.0, 5e-3, 3), (len(t), 1))
    noise, rough = rng.normal(0.0, 1e-3, (len(t), 3)), rng.normal(0.0, 0.02, (len(t), 3))
    every = slice(None, None, 2)
    there = Kinematics(*(getattr(clean, name)[every] for name in Kinematics.__dataclass_fields__))
    field_n = np.array([0.9, 21.0, -43.0])
    channels = [
        sensors.imu(stamps, clean, bias + noise, rough), sensors.magnetometer(rng, stamps[every], there, field_n, 0.3)
    ]  # fmt: skip
    return Simulation(
        recording("hand", channels), truth_columns(stamps, clean, bias, np.zeros((len(t), 3))), line.stops,
        {"world": {"magnetic_field_ut": field_n.tolist()}},
    )  # fmt: skip


def vehicle(seed: int, **with_sensors: Any) -> Simulation:
    """The rover's route, larger and faster: 8 m/s over 900 m, as gently as a car."""

    def larger(options: RoverOptions) -> drives.Drive:
        made = rovers_drive(options)
        route, terrain = made.route, made.route.terrain
        hills = drives.Waves(terrain.amplitude * [5.0, 0.2], terrain.pulsation / LARGER, terrain.phase)
        wide = replace(route, bend=route.bend / LARGER, pulsation=route.pulsation / LARGER, terrain=hills)
        return replace(made, route=wide, speed=made.speed * LARGER)

    rovers_drive = rovers.rover_drive
    with patch.object(rovers, "rover_drive", larger), patch.object(drives, "RAMP_S", 6.0):
        return rover(seed, 120.0, gps=True, **with_sensors)


def tracked(seed: int, rate_hz: float = 10.0, sigma: float = 0.005) -> Simulation:
    """A rover that a tracker follows; nobody says how well."""
    made, rng = rover(seed), np.random.default_rng([seed, 79])
    rows = slice(None, None, round(50.0 / rate_hz))
    values = {
        f"position_{a}": made.truth[f"position_{a}_m"][rows] + rng.normal(2.0, sigma, len(made.truth["t_s"][rows]))
        for a in "xyz"
    }
    stamps = made.truth["timestamp_ns"][rows]
    channel = Channel(
        "/position", "geometry_msgs/msg/PointStamped", "position", stamps, values, dict.fromkeys(values, "m")
    )
    return replace(made, log=replace(made.log, channels=(*made.log.channels, channel)))


KINDS: dict[str, Callable[[int], Simulation]] = {
    "sun": lambda seed: rover(seed, sun=True, odometry=True),
    "sun always": lambda seed: rover(seed, sun=True, sun_always=True),
    "compass": lambda seed: rover(seed, compass=True, odometry=True),
    "sun and compass": lambda seed: rover(seed, sun=True, sun_always=True, compass=True),
    "magnetometer": lambda seed: rover(seed, magnetometer=True),
    "gps": lambda seed: rover(seed, 60.0, gps=True),
    "odometry": lambda seed: rover(seed, 120.0, odometry=True),
    "level": lambda seed: simulate_gyrostar(GyrostarOptions(seed=seed, duration_s=130.0, stops=True)),
    "bare": rover,
    "walk": lambda seed: simulate_walking(WalkingOptions(seed=seed, case="B", duration_s=60.0)),
    "hand": hand,
    "orientation": rover,
    "compass and gps": lambda seed: rover(seed, 120.0, compass=True, gps=True, odometry=True),
    "compass and gps, no wheels": lambda seed: rover(seed, 120.0, compass=True, gps=True),
    "magnetometer and gps": lambda seed: rover(seed, 120.0, magnetometer=True, gps=True),
    "vehicle": lambda seed: vehicle(seed, compass=True),
    "tracker": tracked,
}
"""Kind of a drive -> its simulation."""


@lru_cache(maxsize=64)
def clean(kind: str, seed: int) -> Drive:
    """A drive without fault, as one table."""
    made = KINDS[kind](seed)
    stamps = made.truth["timestamp_ns"]
    columns: Columns = {"timestamp_ns": stamps}
    for channel in made.log.channels:
        columns |= _on_rows(channel, stamps)
    if kind == "orientation":
        rng = np.random.default_rng([seed, 78])
        tilt = rotation.exp_quaternion(rng.normal(0.0, np.radians(1.0), (len(stamps), 3)))
        q = rotation.multiply(quaternions(made.truth), tilt)
        columns |= {f"q_{c}": np.where(np.arange(len(q)) % 10 == 0, q[:, k], np.nan) for k, c in enumerate("wxyz")}
    stated = {name: value for name, value in made.settings.get("imu", {}).items() if name != "gyro_scale_sigma"}
    config = _toml({**made.settings, **({"imu": stated} if stated else {})})  # nobody states a perfect scale
    return Drive(columns, dict(made.truth), config + ('[map]\norientation = "orientation"\n' * (kind == "orientation")))


def _on_rows(channel: Channel, stamps: NDArray[np.int64]) -> Columns:
    """The columns of a channel on the rows of the IMU, blank where it has none."""
    rows, out = np.searchsorted(stamps, channel.stamps_ns), {}
    for name, values in channel.values.items():
        out[name] = np.full(len(stamps), np.nan)
        out[name][rows] = values
    return out


# ---- how a drive is written


def table(drive: Drive, folder: Path) -> Sequence[Path]:
    """As Parquet."""
    return [drive.write(folder)]


def text(edit: Callable[[str], str | bytes] = lambda content: content) -> Write:
    """As CSV, its text edited."""

    def write(drive: Drive, folder: Path) -> Sequence[Path]:
        path = drive.write(folder, "drive.csv")
        content = edit(path.read_text(encoding="utf-8"))
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return [path]

    return write


Sent = tuple[int, int, dict[str, Any]]  # header stamp, time of logging, fields


def messages(edit: Callable[[str, int, int, dict[str, Any]], Sent | None] | None = None) -> Write:
    """As MCAP; ``edit`` takes role, number and stamp of a message and its fields."""

    def write(drive: Drive, folder: Path) -> Sequence[Path]:
        path, sent = folder / "drive.mcap", []
        stamps = drive.columns["timestamp_ns"]
        for role, (topic, kind, build) in MESSAGES.items():
            names = [n for n in COLUMNS[role] if n in drive.columns]
            if not names or (role in {"gyro", "accel"}):
                continue
            values = np.stack([drive.columns[n] for n in names], axis=1)
            values = values * (1e-6 if role == "magnetometer" else 1.0)
            rows = np.flatnonzero(np.isfinite(values).any(axis=1))
            for k, row in enumerate(rows.tolist()):
                fields, stamp = build(dict(zip(names, values[row].tolist(), strict=True))), int(stamps[row])
                new = (stamp, stamp, fields) if edit is None else edit(role, k, stamp, fields)
                if new is not None:
                    sent.append((new[1], topic, kind, new[0], new[2]))
        with path.open("wb") as stream, Writer(stream) as out:
            schemas: dict[str, Any] = {}
            for log_ns, topic, kind, header_ns, fields in sorted(sent, key=lambda message: message[0]):
                if kind not in schemas:
                    schemas[kind] = out.register_msgdef(kind.replace("/", "/msg/"), definition(kind))
                header = {"stamp": {"sec": header_ns // 10**9, "nanosec": header_ns % 10**9}, "frame_id": "base_link"}
                out.write_message(topic, schemas[kind], {"header": header, **fields}, log_time=log_ns)
        (folder / "attest.toml").write_text(drive.config, encoding="utf-8")
        return [path]

    return write


# ---- faults and their grades


@dataclass(frozen=True)
class Fault:
    """One faulty log: a clean drive, what is wrong with it, and the codes, checks or words that name it.

    Without ``names`` the fault is harmless, and silence about it is right; ``base``: codes that a sound log of this
    kind has too.
    """

    kind: str
    names: tuple[str, ...] = ()
    change: Callable[[Drive], Drive] = lambda drive: drive
    write: Write = table
    base: tuple[str, ...] = ()
    same_truth: bool = True  # truth is the clean drive's by the time since its first row; else the changed one's
    needless: bool = False  # no other warning than those of the base is right


@dataclass(frozen=True)
class Graded:
    """What came of a faulty log."""

    grade: str
    verdict: str
    ratio: float  # largest RMS of error over sigma, of tilt, heading and a usable position
    said: tuple[str, ...] = field(default=())
    line: str = ""


def grade(fault: Fault, seed: int, folder: Path) -> Graded:
    """Smooth a faulty log, without pages, and judge what was said by what came of it."""
    folder.mkdir(parents=True, exist_ok=True)
    drive = fault.change(clean(fault.kind, seed))
    paths = fault.write(drive, folder)
    before = {path.name for path in folder.iterdir()}
    result, refused, report = folder / "result", "", dict[str, Any]()
    with patch("attest_cli.pipeline.write_pages", lambda *_: []):
        try:
            report = smooth(paths, load_settings(None, paths[0], {}), result)
        except AttestError as told:
            refused = str(told)
        except Exception as defect:  # noqa: BLE001 (what a user would see as a traceback)
            return Graded("traceback", "", np.nan, (), repr(defect)[:200])
    left = {path.name for path in folder.iterdir()} - before - {"result"}
    if left or any(".tmp" in path.name for path in folder.rglob("*")) or (refused and result.exists()):
        return Graded("leftover", "", np.nan, tuple(sorted(left)))
    if refused:
        named = "\n" not in refused and any(name in refused for name in fault.names)
        return Graded("refused-named" if named else "unnamed", "refused", np.nan, (), refused)
    truth = clean(fault.kind, seed) if fault.same_truth else drive
    return _graded(fault, report, ratio(result, truth, report))


def _graded(fault: Fault, report: dict[str, Any], off: float) -> Graded:
    codes = tuple(dict.fromkeys(c["name"] for c in report["checks"] if c["status"] != "PASS"))
    named = any(name in codes for name in fault.names)
    more = set(codes) - set(fault.base)
    if off > HONEST:
        found = "named-wrong" if named else "silent-wrong"
    elif not fault.names and fault.needless and more:
        found = "needless"
    else:
        found = "good" if named or not fault.names else "unnamed"
    return Graded(found, report["verdict"], off, codes)


def ratio(result: Path, truth: Drive, report: dict[str, Any]) -> float:
    """Return the largest RMS of error over sigma of tilt, heading and, where it is usable, place."""
    found = judged(result, truth, relative=report["heading"] == "relative")
    parts = [found.tilt_ratio(), found.heading_ratio()]
    for error, sigma in ((found.tilt, found.sigma_tilt), (found.heading, found.sigma_heading)):
        parts.append(HONEST * float(np.mean(error > FAR * sigma)) / FAR_SHARE)
    if report["statistics"]["position_usable"] and report["heading"] == "absolute":
        parts.append(_place_ratio(result, truth))
    return max(parts)


def judged(result: Path, truth: Drive, *, relative: bool) -> Judged:
    """Hold a track against a truth at the same time since the first row."""
    track = read_track(result)
    t, q = truth.t, quaternions(truth.truth)
    t_s = np.clip(track["t_s"], t[0], t[-1])
    k = np.clip(np.searchsorted(t, t_s, side="right") - 1, 0, len(t) - 2)
    step = rotation.log_quaternion(rotation.multiply(rotation.conjugate(q[k]), q[k + 1]))
    share = ((t_s - t[k]) / (t[k + 1] - t[k]))[:, None]
    q_true = rotation.multiply(q[k], rotation.exp_quaternion(step * share))
    error = np.degrees(rotation.log_quaternion(rotation.multiply(quaternions(track), rotation.conjugate(q_true))))
    if relative:
        yaw = np.radians(-error[0, 2])
        turn = np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)])
        back = rotation.multiply(turn, quaternions(track))
        error = np.degrees(rotation.log_quaternion(rotation.multiply(back, rotation.conjugate(q_true))))
    sigma = np.stack([track[name] for name in SIGMAS], axis=1)
    return Judged(
        np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2]), np.hypot(sigma[:, 0], sigma[:, 1]), sigma[:, 2]
    )


def _place_ratio(result: Path, truth: Drive) -> float:
    """RMS over sigma of the way from the first row, level."""
    track = read_track(result)
    off = [track[f"position_{a}_m"] - np.interp(track["t_s"], truth.t, truth.truth[f"position_{a}_m"]) for a in "xy"]
    away = np.hypot(*(part - part[0] for part in off))
    sigma = np.hypot(*(np.maximum(track[f"sigma_position_{a}_m"], 0.02) for a in "xy"))
    known = np.isfinite(away)
    return float(np.sqrt(np.mean((away[known] / np.hypot(sigma, sigma[0])[known]) ** 2))) if known.any() else 0.0


__all__ = ["GRADES_BAD", "Drive", "Fault", "Graded", "clean", "grade", "messages", "table", "text"]
