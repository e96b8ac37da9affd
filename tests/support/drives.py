"""The main job in memory: a simulated drive prepared, cut into segments, put on nodes, and judged against its truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from attest_cli.filters.alignment import Start, align
from attest_cli.maths import rotation
from attest_cli.nodes import Nodes, build_nodes
from attest_cli.nodes.noise import Noise, find_noise
from attest_cli.nodes.observations import observe
from attest_cli.prepare import prepare
from attest_cli.records import Fixes, Imu, Log, Segmentation, World
from attest_cli.segment import find_segments
from attest_cli.settings import Settings
from attest_cli.simulate import RoverOptions, Simulation, simulate_rover
from attest_cli.simulate.drive import Drive, Kinematics
from attest_cli.simulate.rover import rover_drive
from attest_cli.world import find_world

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Job:
    """One drive, ready for a filter, with its truth."""

    log: Log
    settings: Settings
    segmentation: Segmentation
    world: World
    noise: Noise
    nodes: Nodes
    start: Start
    drive: Drive
    gyro_bias: Array  # (n, 3) true, at the IMU samples
    origin: float  # s of the drive at t = 0 of the log

    def truth(self, t: Array) -> Kinematics:
        """The true motion at times of the log."""
        return self.drive.at(t + self.origin)

    def errors(self, t: Array, q: Array, bias: Array) -> Array:
        """Return true minus estimated ``[dtheta_b, dbias]`` (n, 6) at times ``t``."""
        truth = self.truth(t)
        attitude = rotation.log_quaternion(rotation.multiply(rotation.conjugate(q), truth.q_nb))
        true_bias = np.stack([np.interp(t, self.log.imu.t, self.gyro_bias[:, i]) for i in range(3)], axis=1)
        return np.hstack([attitude, true_bias - bias])


def effective(simulation: Simulation, over: Mapping[str, Mapping[str, Any]]) -> Settings:
    """Settings of the drive with tables overridden."""
    tables = {name: dict(table) for name, table in simulation.settings.items()}
    for name, table in over.items():
        tables[name] = {**tables.get(name, {}), **table}
    return Settings.model_validate(tables)


def simulated(
    options: RoverOptions, change: Callable[[Log], Log] = lambda log: log, start_s: float = 0.0, walk: float = 1.0,
    **over: Mapping[str, Any],
) -> Job:  # fmt: skip
    """Simulate a drive and bring it to the door of the filter.

    ``change`` edits the log, ``start_s`` cuts its beginning off, ``walk`` is the share of the gyro bias walk kept.
    """
    simulation = simulate_rover(options)
    settings = effective(simulation, over)
    log = prepare([simulation.log], settings)
    bias = np.column_stack([simulation.truth[f"gyro_bias_{axis}_rad_s"] for axis in "xyz"])
    if walk != 1.0:
        less = (1.0 - walk) * (bias - bias[0])
        bias = bias - less
        log = replace(log, imu=replace(log.imu, gyro_b=log.imu.gyro_b - less))
    log = cut(change(log), start_s)
    return job(log, settings, rover_drive(options), bias[-len(log.imu.t) :], start_s)


def job(log: Log, settings: Settings, drive: Drive, bias: Array, origin: float = 0.0) -> Job:
    """From a log to nodes and start, as the pipeline does it."""
    segmentation = find_segments(log, settings)
    world, noise = find_world(log, settings), find_noise(log, segmentation, settings)
    observations, _ = observe(log, segmentation, world, noise, settings)
    nodes = build_nodes(log, segmentation, observations, noise, settings)
    start = align(nodes, settings.imu.gyro_bias_sigma, magnetic=world.field_n is None)
    return Job(log, settings, segmentation, world, noise, nodes, start, drive, bias, origin)


def cut(log: Log, start_s: float) -> Log:
    """Return the log from ``start_s`` on, which becomes t = 0."""
    if start_s == 0.0:
        return log
    keep = log.imu.t >= start_s - 1e-9
    shift = log.imu.t[keep][0]
    imu = Imu(log.imu.t[keep] - shift, log.imu.gyro_b[keep], log.imu.accel_b[keep])
    fixes = {
        role: Fixes(role, f.channel, f.t[f.t >= shift] - shift, f.values[f.t >= shift]) for role, f in log.fixes.items()
    }
    return replace(log, imu=imu, fixes=fixes, stamps_ns=log.stamps_ns[keep], t0_ns=int(log.stamps_ns[keep][0]))


def nees(errors: Array, P: Array) -> Array:
    """Return ``e' P^-1 e`` (n,) of errors (n, k)."""
    return np.asarray(np.einsum("ki,ki->k", errors, np.linalg.solve(P, errors[..., None])[..., 0]))


@dataclass(frozen=True)
class Score:
    """Of one pass over one drive, in motion: mean squared attitude error (rad^2) over all of it and over the middle
    thirds of the motions, mean squared bias error, mean NEES of six states, attitude and bias.
    """

    attitude: float
    middle: float
    bias: float
    nees: float
    nees_attitude: float
    nees_bias: float


def score(work: Job, t: Array, q: Array, bias: Array, P: Array) -> Score:
    """Judge a pass against the truth at the nodes in motion."""
    e = work.errors(t, q, bias)
    moving = work.truth(t).moving
    middle = np.zeros(len(t), dtype=np.bool_)
    for start, end in work.drive.timeline.motions - work.origin:
        third = (end - start) / 3
        middle |= (t > start + third) & (t < end - third)
    squares = np.sum(e[:, :3] ** 2, axis=1), np.sum(e[:, 3:] ** 2, axis=1)
    return Score(
        float(squares[0][moving].mean()), float(squares[0][middle].mean()), float(squares[1][moving].mean()),
        float(nees(e, P)[moving].mean()), float(nees(e[:, :3], P[:, :3, :3])[moving].mean()),
        float(nees(e[:, 3:], P[:, 3:, 3:])[moving].mean()),
    )  # fmt: skip


def pooled(scores: list[Score]) -> Score:
    """Mean of every figure over drives."""
    names = ("attitude", "middle", "bias", "nees", "nees_attitude", "nees_bias")
    return Score(*(float(np.mean([getattr(s, name) for s in scores])) for name in names))


def mrad(mean_square: float) -> float:
    """Root of a mean square of angles, in mrad."""
    return 1e3 * float(np.sqrt(mean_square))


def degrees_apart(p: Array, q: Array) -> float:
    """Largest angle between two tracks of quaternions, deg."""
    turns = rotation.log_quaternion(rotation.multiply(rotation.conjugate(p), q))
    return float(np.degrees(np.linalg.norm(turns, axis=-1).max()))


def wrong_start(work: Job, yaw_deg: float, rng: np.random.Generator, bias_sigma: float = 5e-3) -> Start:
    """A start in motion, its yaw ``yaw_deg`` wrong, its tilt by a sigma of 2 deg; yaw sigma max(yaw, 30 deg)."""
    tilt = np.radians(2.0)
    yaw = np.radians(max(abs(yaw_deg), 30.0))
    error_n = np.array([*rng.normal(0.0, tilt, 2), np.radians(yaw_deg)])
    q = rotation.multiply(rotation.exp_quaternion(error_n), work.truth(work.nodes.t[:1]).q_nb[0])
    R, P = rotation.matrix(q), np.zeros((6, 6))
    P[:3, :3] = R.T @ np.diag([tilt**2, tilt**2, yaw**2]) @ R
    P[3:, 3:] = bias_sigma**2 * np.eye(3)
    return Start(q, np.zeros(3), P, "absolute", True)


def in_motion(options: RoverOptions, after_s: float = 10.0, **over: Mapping[str, Any]) -> Job:
    """A drive whose log begins ``after_s`` into its first motion."""
    start = float(rover_drive(options).timeline.motions[0, 0]) + after_s
    return simulated(options, start_s=round(start * options.rate_hz) / options.rate_hz, **over)
