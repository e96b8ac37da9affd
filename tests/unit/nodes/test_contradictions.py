"""A calibration held against the stops of a log: noise taken from it, and one line where the log contradicts it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from attest_cli.nodes.noise import ASSUMED_SCALE, contradictions, find_noise
from attest_cli.records import Array, Calibrated, Imu, Log, Segmentation
from attest_cli.segment.detector import as_segments
from attest_cli.settings import Settings

RATE, STOP_S, EVERY_S, STOPS = 100.0, 15.0, 60.0, 8
N, K = 1.5e-4, 5e-6
NOISE = {"gyro_noise_density": N, "gyro_random_walk": K, "accel_noise_density": 2e-3}


def drive(
    seed: int, *, noise: float = 1.0, walk: float = 1.0, off: float = 0.0, known: dict[str, float] | None = None
) -> tuple[Log, Segmentation]:
    """A gyro that is ``noise`` and ``walk`` times what its calibration says and ``off`` rad/s beside it."""
    rng = np.random.default_rng(seed)
    n = round(EVERY_S * STOPS * RATE)
    t = np.arange(n) / RATE
    bias = off + np.cumsum(rng.normal(0.0, walk * K / np.sqrt(RATE), (n, 3)), axis=0)
    gyro = bias + rng.normal(0.0, noise * N * np.sqrt(RATE), (n, 3))
    force: Array = np.array([0.0, 0.0, 9.8]) + rng.normal(0.0, 2e-3 * np.sqrt(RATE), (n, 3))
    still = (t % EVERY_S) < STOP_S
    segments = as_segments(still, t, np.array([0, n]), 0.5)
    took = Calibrated(t[[0, -1]], np.zeros((2, 3)), NOISE if known is None else known, {}, "calibration.toml")
    log = Log((Path("log.csv"),), 0, np.rint(t * 1e9).astype(np.int64), Imu(t, gyro, force), {}, np.empty((0, 2)), {},
              calibrated=took)  # fmt: skip
    return log, Segmentation(segments, np.zeros(n), 1.0, 2.0, np.zeros(3), 1.0, "imu")


def told(seed: int, sigma: float = 3.5e-3, **how: Any) -> list[str]:
    log, segmentation = drive(seed, **how)
    settings = Settings.model_validate({"imu": {"gyro_bias_sigma": sigma}})
    return [w.code for w in contradictions(log, segmentation, find_noise(log, segmentation, settings), settings)]


def test_a_calibration_that_fits_is_not_doubted() -> None:
    assert [told(seed) for seed in range(20)] == [[]] * 20


@pytest.mark.parametrize(
    ("how", "code"),
    [
        ({"off": 0.02}, "calibration-bias"),
        ({"walk": 20.0}, "calibration-walk"),
        ({"noise": 2.0}, "calibration-noise"),
        ({"noise": 0.5}, "calibration-noise"),
    ],
)
def test_each_contradiction_is_one_line(how: dict[str, float], code: str) -> None:
    for seed in range(5):
        assert told(seed, **how) == [code]


def test_a_figure_of_the_settings_is_the_users_own_and_not_held_against_the_calibration() -> None:
    log, segmentation = drive(1, noise=2.0)
    settings = Settings.model_validate({"imu": {"gyro_noise_density": 2.0 * N, "gyro_random_walk": 20.0 * K}})
    noise = find_noise(log, segmentation, settings)
    assert noise.gyro_density == 2.0 * N
    assert noise.sources["gyro_noise_density"] == "settings"
    assert contradictions(log, segmentation, noise, settings) == []


def test_noise_comes_from_the_calibration_and_says_so_but_a_calibration_at_rest_knows_no_scale() -> None:
    log, segmentation = drive(2, noise=1.3)
    noise = find_noise(log, segmentation, Settings())
    assert (noise.gyro_density, noise.gyro_walk, noise.accel_density) == (N, K, 2e-3)
    assert {noise.sources[name] for name in NOISE} == {"calibration"}
    assert (noise.gyro_scale, noise.sources["gyro_scale_sigma"]) == (ASSUMED_SCALE, "assumed")


def test_what_the_calibration_does_not_know_comes_from_the_stops() -> None:
    log, segmentation = drive(3, known={"gyro_noise_density": N})
    noise = find_noise(log, segmentation, Settings())
    assert noise.sources["gyro_noise_density"] == "calibration"
    assert noise.sources["gyro_random_walk"] == "log's stops"
    bare = find_noise(replace(log, calibrated=None), segmentation, Settings())
    assert bare.sources["gyro_noise_density"] == "log's stops"
    assert contradictions(replace(log, calibrated=None), segmentation, bare, Settings()) == []
