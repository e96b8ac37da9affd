"""What the benchmarks on real attitude share: a trial with its truth, attest and offline VQF run over it in memory.

VQF: Laidig and Seel, Information Fusion 91, 2023 (``pip install vqf``), the acausal 9D variant.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from attest_cli.estimate import estimate
from attest_cli.evaluate import Claims, Evaluation, Options, Poses, evaluate
from attest_cli.filters.stamps import read_as
from attest_cli.pipeline import read
from attest_cli.segment import find_segments
from attest_cli.settings import load_settings
from attest_cli.track import world_variance

LAGS = {"point": 1.2, "interval": 0.7}
"""Rule of ``gyro_samples`` -> samples by which BROAD's IMU lags its truth with it."""
RULES = ("auto", *LAGS)
VQF_LAG = LAGS["interval"]


@dataclass(frozen=True)
class Trial:
    """One log with its truth in the same rows; ``period`` of the samples, s."""

    path: Path
    name: str
    truth: Poses
    gyr: np.ndarray
    acc: np.ndarray
    mag: np.ndarray
    period: float


@dataclass(frozen=True)
class Run:
    """An estimate, by whom, how many samples it lags, and the stops that were found."""

    name: str
    poses: Poses
    lag: float
    stops: int = 0


def load(path: Path) -> Trial:
    """Read a trial: t, gyr, acc, mag, truth_q and, where told, movement."""
    table = pq.read_table(path)

    def columns(name: str, axes: str) -> np.ndarray:
        return np.ascontiguousarray(np.stack([table[name + a].to_numpy().astype(np.float64) for a in axes], axis=1))

    t = table["t"].to_numpy().astype(np.float64)
    stamps = np.rint(t * 1e9).astype(np.int64)
    q = columns("truth_q", "wxyz")
    norm = np.linalg.norm(q, axis=1, keepdims=True)
    q = np.where(np.abs(norm - 1.0) < 0.01, q / np.where(norm > 0.0, norm, 1.0), np.nan)
    moving = table["movement"].to_numpy() if "movement" in table.column_names else None
    truth = Poses(path.name, "table", stamps, q, np.full((len(q), 3), np.nan), moving, shared_world=True)
    vectors = (columns(f"{name}_", "xyz") for name in ("gyr", "acc", "mag"))
    return Trial(path, path.stem, truth, *vectors, period=float((t[-1] - t[0]) / (len(t) - 1)))


def by_attest(trial: Trial, rule: str, overrides: Mapping[str, Any]) -> Run:
    """Run attest's pipeline without a config, gyro samples read by ``rule``."""
    settings = load_settings(None, trial.path, {"imu.gyro_samples": rule, **overrides}).settings
    _, log = read([trial.path], settings)
    segmentation = find_segments(log, settings)
    found = estimate(log, segmentation, settings)
    stamps = log.t0_ns + np.rint(found.smoothed.t * 1e9).astype(np.int64)
    P = world_variance(found.smoothed.q, found.smoothed.P)
    none = np.full((len(found.q), 3), np.nan)
    relative = P[:, 2, 2] if found.smoothed.heading_relative is None else found.smoothed.heading_relative
    claims = Claims(stamps, P, np.full_like(P, np.nan), relative, full=True)
    poses = Poses("attest", "track", log.stamps_ns, found.q, none, None, found.forward.heading, claims=claims)
    name = "attest" if rule == "auto" else f"attest, {rule}"
    lag = LAGS[read_as(log, settings)[0].imu.gyro_samples]
    return Run(name, poses, lag, len(segmentation.stops))


def by_vqf(trial: Trial) -> Run:
    """Run offline VQF 9D with its defaults."""
    try:
        from vqf import offlineVQF
    except ImportError:
        raise SystemExit("this compares with offline VQF: pip install vqf") from None
    q = offlineVQF(trial.gyr, trial.acc, trial.mag, trial.period)["quat9D"]
    poses = Poses("vqf", "track", trial.truth.stamps_ns, q, np.full((len(q), 3), np.nan), heading="magnetic")
    return Run("offline VQF 9D", poses, VQF_LAG)


def judged(run: Run, trial: Trial, advance: float, *, weighted: bool = False, **options: Any) -> Evaluation:
    """Hold a run against the truth, its clock advanced by ``advance`` samples.

    Alignments weigh all samples alike unless ``weighted``: then by the claimed sigma, as ``attest evaluate`` does.
    """
    poses = run.poses if weighted else replace(run.poses, claims=None)
    return evaluate(poses, trial.truth, Options(time_offset=-advance * trial.period, **options))


def degrees(found: Evaluation, *names: str) -> list[float]:
    """RMS of the named attitude errors, deg."""
    assert found.attitude is not None
    return [float(np.degrees(found.attitude.stats[name].rms)) for name in names]
