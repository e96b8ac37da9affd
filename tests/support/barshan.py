"""Barshan & Durrant-Whyte 1994: simulated logs for the heading filter, and heading errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from attest_cli.filters import Drive, heading
from attest_cli.maths import rotation
from attest_cli.nodes.noise import find_noise
from attest_cli.prepare import prepare
from attest_cli.records import FilterRun, Log, Smoothed
from attest_cli.segment import find_segments
from attest_cli.segment.detector import as_segments
from attest_cli.segment.stillness import gap_edges
from attest_cli.settings import Settings
from attest_cli.simulate import GyrostarOptions, Simulation, simulate_gyrostar
from attest_cli.smoothers import SMOOTHERS
from attest_cli.world import find_world

Array = NDArray[np.float64]
Spans = Sequence[tuple[float, float]]
PAPER_MODEL = {"c1_deg_s": 0.153, "c2_deg_s": -0.264, "time_constant_s": 338.4}
START: Spans = ((0.0, 10.0),)
EACH_MINUTE: Spans = tuple((60.0 * k, 60.0 * k + 10.0) for k in range(10))


@dataclass(frozen=True)
class Course:
    """One log with its truth, as a filter is given it."""

    simulation: Simulation
    drive: Drive

    @property
    def true_heading(self) -> Array:
        """Heading (n,) since the start, rad."""
        q = np.stack([self.simulation.truth[f"q_{part}"] for part in "wxyz"], axis=1)
        yaw = np.unwrap(2.0 * np.arctan2(q[:, 3], q[:, 0]), period=2.0 * np.pi)
        return np.asarray(yaw - yaw[0])

    def errors(self, q: Array) -> Array:
        """True minus estimated heading (n,), rad."""
        found = np.unwrap(2.0 * np.arctan2(q[:, 3], q[:, 0]), period=2.0 * np.pi)
        return np.asarray(self.true_heading - (found - found[0]))

    def raw_errors(self) -> Array:
        """The same of the gyro as it is, summed."""
        imu = self.drive.log.imu
        step = 0.5 * (imu.gyro_b[1:, 2] + imu.gyro_b[:-1, 2]) * np.diff(imu.t)
        return np.asarray(self.true_heading - np.concatenate([[0.0], np.cumsum(step)]))

    def bias_alone_errors(self, run: FilterRun) -> Array:
        """The same of the gyro less the forward bias of each moment, whatever later stops say of it."""
        imu, held = self.drive.log.imu, ~(run.moving[1:] | run.moving[:-1])
        rate = imu.gyro_b[:, 2] - run.bias[:, 2]
        step = np.where(held, 0.0, 0.5 * (rate[1:] + rate[:-1]) * np.diff(imu.t))
        return np.asarray(self.true_heading - np.concatenate([[0.0], np.cumsum(step)]))


def course(
    seed: int, kind: str = "truck", change: Callable[[Log], Log] = lambda log: log, told: Spans = (),
    heading_settings: dict[str, Any] | None = None, walk: float | None = None, **options: Any,
) -> Course:  # fmt: skip
    """A simulated course; ``told``: its stops, where the detector's shall not be used; ``walk``: of the bias, stated
    otherwise, rad/s^2/sqrt(Hz).
    """
    simulation = simulate_gyrostar(GyrostarOptions(seed=seed, course=kind, **options))  # type: ignore[arg-type]
    tables: dict[str, Any] = {name: dict(table) for name, table in simulation.settings.items()}
    tables["imu"] |= {} if walk is None else {"gyro_random_walk": walk}
    settings = Settings.model_validate({**tables, "heading": heading_settings or {}})
    log = change(prepare([simulation.log], settings))
    segmentation = find_segments(log, settings)
    if told:
        still = np.any([(log.imu.t >= a) & (log.imu.t < b) for a, b in told], axis=0)
        segments = as_segments(still, log.imu.t, gap_edges(log.imu.t, log.gaps), 0.5)
        segmentation = replace(segmentation, segments=segments)
    noise = find_noise(log, segmentation, settings)
    return Course(simulation, Drive(log, segmentation, find_world(log, settings), noise, settings))


def passes(of: Course) -> tuple[FilterRun, Smoothed, Smoothed]:
    """The run, its forward and its smoothed pass."""
    run = heading.forward(of.drive).run
    return run, SMOOTHERS["none"](run), SMOOTHERS["rts"](run)


def largest_deg(errors: Array) -> float:
    """Largest error, deg."""
    return float(np.degrees(np.abs(errors).max()))


def turned(q_new_old: Array, log: Log) -> Log:
    """The log of an IMU that sits otherwise."""
    R = rotation.matrix(q_new_old)
    return replace(log, imu=replace(log.imu, gyro_b=log.imu.gyro_b @ R.T, accel_b=log.imu.accel_b @ R.T))
