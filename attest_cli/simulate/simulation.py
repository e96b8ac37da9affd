"""A simulated log with its truth, and what every scenario shares: clock, random streams, columns of the truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..records import Array, Channel, Ints, Recording
from .drive import Kinematics

START_NS = 1_780_308_000_000_000_000  # 2026-06-01T10:00:00Z


@dataclass(frozen=True, slots=True)
class Simulation:
    """A log with its truth.

    ``truth``: columns of the truth file; ``stops`` (k, 2): true stops in s since the first stamp; ``settings``:
    content of the ``attest.toml`` that goes with the log.
    """

    log: Recording
    truth: Mapping[str, NDArray[Any]]
    stops: Array
    settings: Mapping[str, Mapping[str, Any]]


def random_stream(seed: int, name: str) -> np.random.Generator:
    """One stream per purpose, so that an option more does not change the rest of the log."""
    return np.random.default_rng([seed, *name.encode()])


def stamps_of(duration_s: float, period_ns: int) -> Ints:
    """Stamps of a sensor that samples every ``period_ns`` from the start of the drive."""
    return START_NS + period_ns * np.arange(round(duration_s / (period_ns * 1e-9)), dtype=np.int64)


def seconds(stamps: Ints) -> Array:
    """Seconds since the start of the drive, subtracted as integers."""
    return np.asarray((stamps - START_NS) * 1e-9)


def recording(scenario: str, channels: Sequence[Channel]) -> Recording:
    """What the reader of a simulated log would find."""
    return Recording(Path(scenario), "simulation", tuple(channels), sum(c.stamps_ns.size for c in channels))


def truth_columns(stamps: Ints, clean: Kinematics, gyro_bias: Array, accel_bias: Array) -> dict[str, NDArray[Any]]:
    """Columns of the truth file: those of a track, without sigmas."""
    columns: dict[str, NDArray[Any]] = {"timestamp_ns": stamps, "t_s": clean.t}
    columns |= {f"q_{part}": clean.q_nb[:, k] for k, part in enumerate("wxyz")}
    vectors = {
        "position_{}_m": clean.position_n,
        "velocity_{}_m_s": clean.velocity_n,
        "gyro_bias_{}_rad_s": gyro_bias,
        "accel_bias_{}_m_s2": accel_bias,
    }
    for name, vector in vectors.items():
        columns |= {name.format(axis): vector[:, k] for k, axis in enumerate("xyz")}
    return columns | {"moving": clean.moving}


def integral(function: Callable[[Array], Array], t: Array) -> Array:
    """Integrate a smooth ``function`` (n,) -> (n, d) from ``t[0]`` to each ``t`` by three Gauss points a step."""
    middle, half = (t[1:] + t[:-1]) / 2, np.diff(t) / 2
    offset = np.sqrt(0.6) * half
    points = np.concatenate([middle - offset, middle, middle + offset])
    before, mid, after = np.split(function(points), 3)
    steps = half[:, None] / 9 * (5 * before + 8 * mid + 5 * after)
    return np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])
