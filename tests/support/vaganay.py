"""Vaganay et al. 1993 on arrays: the paper's own filter, four states, its gyro's bias left in; and what to judge by."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from attest_cli.filters import Drive
from attest_cli.filters import accelerometer_angles as accelerometer
from attest_cli.filters.samples import rotation_vectors
from attest_cli.filters.tilt_ekf import Gyro, Model, fuse
from attest_cli.maths import kalman, rotation
from attest_cli.maths.sequential import Pass
from attest_cli.nodes.noise import find_noise
from attest_cli.prepare import prepare
from attest_cli.records import Log
from attest_cli.segment import find_segments
from attest_cli.segment.detector import as_segments
from attest_cli.segment.stillness import gap_edges
from attest_cli.settings import Settings
from attest_cli.simulate import CharlyOptions, Simulation, simulate_charly
from attest_cli.world import find_world

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
G = 9.80665
DEG = np.pi / 180.0
ANGLE_STEP, DRIFT_WALK = 0.10 * DEG, 0.010 * DEG  # per step of 10 ms; rad/s/sqrt(s)
ACCEL_SIGMA, GYRO_SIGMA = 0.22, 0.02 * DEG  # the note's working values: the paper gives none
START = np.array([0.3 * DEG, 0.3 * DEG, 8.0 * DEG / 60.0, 8.0 * DEG / 60.0])
FIRST = np.array([0])
PLANKS_S = ((8.0, 11.5), (33.0, 36.5))  # both wheels up for sure
PLANK_ROLLS_DEG = (-1.768, 1.768)


@dataclass(frozen=True)
class PaperRun:
    """One run of the paper's filter: ``t`` (n,), accelerometer and gyro angles (n, 2) pitch, roll, the pass over them,
    its smoothed states (n, 4).
    """

    t: Array
    accelerometer: Array
    gyro: Array
    forward: Pass
    smoothed: Array


def prepared(simulation: Simulation, **over: dict[str, object]) -> tuple[Log, Settings]:
    """The log of a simulation and its settings, tables overridden."""
    tables = {name: dict(table) for name, table in simulation.settings.items()}
    for name, table in over.items():
        tables[name] = {**tables.get(name, {}), **table}
    settings = Settings.model_validate(tables)
    return prepare([simulation.log], settings), settings


def charly(seed: int, **options: float) -> Simulation:
    """The run of the paper, simulated."""
    return simulate_charly(CharlyOptions(seed=seed, **options))


def paper_run(log: Log, settings: Settings, starts: Ints = FIRST, gate: float = 0.0) -> PaperRun:
    """Run the paper's filter on the gyro as it is; ``starts``: samples where the drift clock starts anew."""
    t, n, dt = log.imu.t, len(log.imu.t), np.diff(log.imu.t)
    edges, lever, cut = np.array([0, n]), np.array(settings.tilt_ekf.lever_arm_m), settings.tilt_ekf.cutoff_hz
    wheels = log.fixes["odometry"]
    speed = np.interp(t, wheels.t, wheels.values[:, 0])
    force = accelerometer.compensated(log.imu.accel_b, log.imu.gyro_b, speed, lever, t, edges, (cut, cut))
    seen = accelerometer.angles(force)
    alpha = 0.5 * (log.imu.gyro_b[1:] + log.imu.gyro_b[:-1]) * dt[:, None]
    gyro = Gyro.of(rotation_vectors(alpha, np.arange(n - 1) > 0), starts)
    since = np.searchsorted(starts, np.arange(n), side="left") - 1
    Q = np.diag([ANGLE_STEP**2, ANGLE_STEP**2, 0.0, 0.0]) + np.diag([0, 0, 1, 1]) * DRIFT_WALK**2 * dt[:, None, None]
    R = np.tile([ACCEL_SIGMA**2, ACCEL_SIGMA**2, GYRO_SIGMA**2, GYRO_SIGMA**2], (n, 1))
    model = Model(
        gyro, t - t[starts[np.maximum(since, 0)]], accelerometer.components(seen, G), np.ones(n, dtype=np.bool_), Q, R,
        G, gate, R[:, 0],
    )  # fmt: skip
    x0 = np.concatenate([accelerometer.angles(force[:100].mean(axis=0)[None])[0], np.zeros(2)])
    forward = fuse(model, x0, np.diag(START**2))
    return PaperRun(t, seen, gyro.angles[:, 1::-1].copy(), forward, forward.x + kalman.rts(forward.chain).d)


def true_angles(simulation: Simulation) -> Array:
    """True pitch and roll (n, 2), rad."""
    q = np.stack([simulation.truth[f"q_{part}"] for part in "wxyz"], axis=1)
    return rotation.roll_pitch_yaw(q)[:, 1::-1]


def rms_deg(error: Array) -> Array:
    """Root mean square over time, deg."""
    return np.degrees(np.sqrt(np.mean(error**2, axis=0)))


def plank_means_deg(t: Array, roll: Array) -> tuple[float, float]:
    """Mean roll while the right, and the left, wheel is on the plank."""
    means = [float(np.degrees(roll[(t > a) & (t < b)].mean())) for a, b in PLANKS_S]
    return means[0], means[1]


def tilt_errors(simulation: Simulation, q: Array) -> Array:
    """True minus estimated tilt (n, 2) about body x and y, rad: heading aside."""
    truth = np.stack([simulation.truth[f"q_{part}"] for part in "wxyz"], axis=1)
    up, true_up = rotation.matrix(q)[:, 2], rotation.matrix(truth)[:, 2]
    return np.cross(true_up, up)[:, :2]  # R = R_hat Exp(d): u = u_hat - d x u_hat


def drive_of(
    simulation: Simulation, change: Callable[[Log], Log] = lambda log: log, **over: dict[str, object]
) -> Drive:
    """What a filter is given of a simulated log, its stops known; ``change`` edits the log."""
    log, settings = prepared(simulation, **over)
    log = change(log)
    t = log.imu.t
    still = np.zeros(len(t), dtype=np.bool_)
    for start, end in simulation.stops:
        still |= (t >= start) & (t < end) & (end - start > settings.stops.min_stop_s)
    found = find_segments(log, settings)
    segments = as_segments(still, t, gap_edges(t, log.gaps), 0.5 * settings.stops.window_s)
    segmentation = replace(found, segments=segments)
    return Drive(log, segmentation, find_world(log, settings), find_noise(log, segmentation, settings), settings)
