"""Calibration files made by hand (three gyro axes with a model each, and what a test adds); short records fitted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from attest_cli.calibration.calibrate import calibrate
from attest_cli.calibration.records import BiasModel, Calibration
from attest_cli.maths.bias import curve
from attest_cli.records import Array, Imu, Log, Segmentation
from attest_cli.segment.detector import as_segments
from attest_cli.settings import Settings
from attest_cli.settings.calibration import CalibrationFile

NAMES = {
    "constant": ("C",), "ramp": ("C", "slope"), "exponential": ("C1", "C2", "T"), "temperature": ("c0", "c1"),
    "random-walk": ("bias", "K"),
}  # fmt: skip
SHA = "0" * 64
NOISE = {
    "noise_density": 1.5e-4, "noise_density_95": (1.4e-4, 1.6e-4), "random_walk": 5e-6, "random_walk_95": (4e-6, 6e-6)
}  # fmt: skip


def bias(model: str, values: Sequence[float], **over: Any) -> dict[str, Any]:
    """The fitted bias of one axis."""
    found: dict[str, Any] = {
        "model": model, "names": NAMES[model], "values": tuple(values),
        "covariance": (1e-12 * np.eye(len(values))).tolist(), "sigma": 1e-6, "walk_beside": 5e-6, "walk_alone": 8e-6,
        "residual_sigma": 1e-5, "residual_every_s": 1.0, "white": True, "inside_band": 0.95,
        "ljung_box_probability": 0.5,
    }  # fmt: skip
    return {**found, **over}


def calibration(
    axes: Sequence[dict[str, Any]], noise: dict[str, Any] | None = None, source: dict[str, Any] | None = None,
    **over: Any,
) -> CalibrationFile:  # fmt: skip
    """A calibration of three axes; ``noise`` and ``source`` change what is usual."""
    known = {
        "attest_version": "0.1.0", "files": [{"name": "static.csv", "sha256": SHA}], "channel": "/imu/data", "t0_ns": 0,
        "duration_s": 600.0, "at_rest_s": 600.0, "rate_hz": 100.0, "static": True, **(source or {}),
    }  # fmt: skip
    each = {**NOISE, **(noise or {})}
    gyro = {name: {"noise": each, "bias": axis} for name, axis in zip("xyz", axes, strict=True)}
    return CalibrationFile.model_validate({"source": known, "gyro": gyro, **over})


def rest(
    seconds: float = 60.0, hz: float = 20.0, every: float = 0.0, stop: float = 12.0,
    curve: Callable[[Array], Array] = np.zeros_like, seed: int = 1,
) -> Calibration:  # fmt: skip
    """Calibrate a gyro at rest or, with ``every``, one that stops ``stop`` s in each ``every`` s; ``curve``: its
    bias.
    """
    log = log_at_rest(seconds, hz, curve, seed)
    t, n = log.imu.t, len(log.imu.t)
    still = (t % every) < stop if every else np.ones(n, dtype=np.bool_)
    segments = as_segments(still, t, np.array([0, n]), 0.5)
    return calibrate(log, Segmentation(segments, np.zeros(n), 1.0, 2.0, np.zeros(3), 1.0, "imu"), Settings())


def log_at_rest(
    seconds: float = 60.0, hz: float = 20.0, curve: Callable[[Array], Array] = np.zeros_like, seed: int = 1
) -> Log:  # fmt: skip
    """A log that does not move; ``curve``: what is added to its bias."""
    rng = np.random.default_rng(seed)
    n = round(seconds * hz)
    t = np.arange(n) / hz
    gyro = curve(t)[:, None] * [1.0, -1.5, 0.5] + [1e-3, -2e-3, 5e-4] + rng.normal(0.0, 1.5e-4 * np.sqrt(hz), (n, 3))
    force: Array = np.array([0.0, 0.0, 9.8]) + rng.normal(0.0, 2e-3 * np.sqrt(hz), (n, 3))
    return Log((Path("log.csv"),), 0, np.rint(t * 1e9).astype(np.int64), Imu(t, gyro, force), {}, np.empty((0, 2)), {})


def bias_between(model: BiasModel, at: Array, t: Array, temperature: tuple[Array, Array] | None = None) -> Array:
    """Return the model's bias (n,) at any time ``t``: its curve plus what the random walk left at the blocks ``at``
    (m,), in the mean a straight line from one to the next; ``temperature`` at the blocks and at ``t``.
    """
    at_blocks, at_t = temperature or (None, None)
    left = model.fitted - curve(model.name, model.values, at, at_blocks)
    return curve(model.name, model.values, t, at_t) + np.interp(t, at, left)
