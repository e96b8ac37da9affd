"""Sensors at rest: rates with a bias and noise, stops of a drive, accelerometers and magnetometers turned about."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from attest_cli.calibration.rest import Piece
from attest_cli.records import Fixes, Imu, Log

Array = NDArray[np.float64]
GYROSTAR = (0.153, -0.264, 338.4)  # C1, C2 deg/s, T s (Barshan & Durrant-Whyte 1994, section 3)
GYROSTAR_STEP_S, GYROSTAR_SIGMA = 0.03, 0.2  # deg/s per sample
GRAVITY = 9.80665
VECTORS = Path(__file__).resolve().parents[1] / "vectors" / "others"


def vectors(name: str) -> dict[str, NDArray[Any]]:
    """One file of reference vectors."""
    with np.load(VECTORS / f"{name}.npz") as file:
        return dict(file)


def warm_up(t: Array, C1: float, C2: float, T: float) -> Array:
    """Barshan & Durrant-Whyte 1994, eq 1."""
    return np.asarray(C1 * (1.0 - np.exp(-t / T)) + C2)


def gyrostar(rng: np.random.Generator, seconds: float) -> tuple[Array, Array]:
    """Times and rates (deg/s) of the paper's gyro at rest."""
    t = GYROSTAR_STEP_S * np.arange(round(seconds / GYROSTAR_STEP_S))
    return t, warm_up(t, *GYROSTAR) + rng.normal(0.0, GYROSTAR_SIGMA, len(t))


def walking(rng: np.random.Generator, n: int, period: float, N: float, K: float) -> Array:
    """White noise of density N on a random walk of density K, sample by sample (n,)."""
    return np.asarray(
        rng.normal(0.0, N / np.sqrt(period), n) + np.cumsum(rng.normal(0.0, K * np.sqrt(period), n))
    )  # fmt: skip


def piece(n: int, period: float, start: float = 0.0, stop: int = 0) -> Piece:
    """A piece of ``n`` samples at rest, without values."""
    none = np.zeros((n, 3))
    return Piece(start + period * np.arange(n), none, none, period, stop)


@dataclass(frozen=True)
class Stops:
    """The stops of a drive and its true bias at all times: one axis, with a thermometer."""

    pieces: list[Piece]
    rates: list[Array]
    warmth: list[Array]
    t: Array
    bias: Array
    temperature: Array


BIASES = ("constant", "exponential", "temperature", "random walk", "exponential + walk")


def stops(
    rng: np.random.Generator,
    bias: str,
    minutes: float = 30.0,
    every: float = 60.0,
    stop: float = 6.0,
    hz: float = 50.0,
    N: float = 0.01,
    K: float = 5e-4,
) -> Stops:
    """Draw a drive that stops ``stop`` s in each ``every`` s, deg/s."""
    t = np.arange(round(60.0 * minutes * hz)) / hz
    celsius = 20.0 + 15.0 * (1.0 - np.exp(-t / 600.0)) + 2.0 * np.sin(2.0 * np.pi * t / 1500.0)
    x = celsius - 25.0
    walk = np.cumsum(rng.normal(0.0, K / np.sqrt(hz), len(t)))
    true = {
        "constant": np.full(len(t), 0.1),
        "exponential": warm_up(t, *GYROSTAR),
        "temperature": -0.05 + 0.008 * x + 0.0004 * x**2,
        "random walk": walk,
        "exponential + walk": warm_up(t, *GYROSTAR) + walk,
    }[bias]
    rate = true + rng.normal(0.0, N * np.sqrt(hz), len(t))
    starts = np.round(np.arange(0.0, t[-1] - stop + 1.5 / hz, every) * hz).astype(int)
    n = round(stop * hz)
    used = [slice(a, a + n) for a in starts]
    pieces = [piece(n, 1.0 / hz, float(t[a]), k) for k, a in enumerate(starts)]
    return Stops(pieces, [rate[s] for s in used], [celsius[s] for s in used], t, np.asarray(true), celsius)


def attitudes(rng: np.random.Generator, count: int) -> Array:
    """Unit vectors (count, 3) spread over the sphere: the six sides, the twelve edges, then at random."""
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    edges = np.array([a + b for i, a in enumerate(axes) for b in axes[i + 1 :] if abs(a @ b) < 0.5]) / np.sqrt(2.0)
    more = rng.normal(size=(max(0, count - 18), 3))
    more /= np.linalg.norm(more, axis=1, keepdims=True)
    order = np.concatenate([axes, rng.permutation(edges), more])
    placed = order[:count] + rng.normal(0.0, 0.02, (count, 3))  # by hand: about a degree
    return np.asarray(placed / np.linalg.norm(placed, axis=1, keepdims=True))


@dataclass(frozen=True)
class Unit:
    """An accelerometer: ``a = T K (raw + bias)``, with the errors of an uncalibrated MEMS one."""

    matrix: Array
    bias: Array

    def raw(self, a: Array) -> Array:
        """What it reads of specific forces (m, 3)."""
        return np.asarray(np.linalg.solve(self.matrix, a.T).T - self.bias)


def accelerometer(rng: np.random.Generator) -> Unit:
    """Draw scale errors of 2 %, misalignments of 1e-2 rad, biases of 0.3 m/s^2."""
    T = np.eye(3)
    T[np.triu_indices(3, 1)] = rng.normal(0.0, 1e-2, 3)
    return Unit(T @ np.diag(1.0 + rng.normal(0.0, 0.02, 3)), rng.normal(0.0, 0.3, 3))


FIELD = 48e-6  # tesla


@dataclass(frozen=True)
class Iron:
    """What sits beside a magnetometer: ``m = soft (raw - hard)``, soft iron symmetric, of determinant 1."""

    soft: Array
    hard: Array

    def raw(self, m: Array) -> Array:
        """What it reads of fields (n, 3)."""
        return np.asarray(np.linalg.solve(self.soft, m.T).T + self.hard)


def iron(rng: np.random.Generator) -> Iron:
    """Draw soft iron of 6 % and hard iron of 15 uT per axis."""
    A = rng.normal(0.0, 0.06, (3, 3))
    soft = np.eye(3) + 0.5 * (A + A.T)
    return Iron(soft / np.linalg.det(soft) ** (1.0 / 3.0), rng.normal(0.0, 15e-6, 3))


def all_over(rng: np.random.Generator, n: int) -> Array:
    """Directions (n, 3) all over the sphere."""
    u = rng.normal(size=(n, 3))
    return np.asarray(u / np.linalg.norm(u, axis=1, keepdims=True))


def apart_deg(a: Array, truth: Array) -> float:
    """Root mean square angle between vectors (n, 3) and true directions, deg per axis."""
    a = a / np.linalg.norm(a, axis=1, keepdims=True)
    return float(np.degrees(np.sqrt(np.mean(np.sum(np.cross(a, truth) ** 2, axis=1)) / 2.0)))


def log(t: Array, gyro_b: Array, accel_b: Array, t0_ns: int = 0, name: str = "still.csv", **fixes: Fixes) -> Log:
    """A log of these samples, s and SI, nothing else known."""
    stamps = t0_ns + np.round(t * 1e9).astype(np.int64)
    return Log((Path(name),), t0_ns, stamps, Imu(t, gyro_b, accel_b), fixes, np.empty((0, 2)), {})
