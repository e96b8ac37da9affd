"""What gyro samples stand for: a magnetometer half a sample ahead shows means; one that is late shows nothing."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from attest_cli import estimate
from attest_cli.filters.stamps import lead, read_as
from attest_cli.maths import rotation
from attest_cli.records import Fixes, Imu, Log
from attest_cli.segment import find_segments
from attest_cli.settings import Settings

Array = NDArray[np.float64]
PERIOD, PARTS, COUNT = 0.01, 20, 4000  # s; fine steps in a sample; samples
FIELD, GRAVITY = np.array([0.0, 2e-5, -4e-5]), np.array([0.0, 0.0, 9.80665])


def turning(
    samples: str, *, bias: float = 0.01, scale: float = 0.0, iron: float = 0.0, late: float = 0.0, every: int = 1
) -> tuple[Log, Array]:
    """A log of an IMU that is turned in place at 1 rad/s about all axes, and its true attitude at the stamps; the
    magnetometer is ``late`` by so many samples and has a value for one in ``every`` of them.
    """
    rng = np.random.default_rng(7)
    t = np.arange(COUNT * PARTS) * PERIOD / PARTS
    rate = np.stack([np.sin(2 * np.pi * f * t + a) for f, a in ((0.7, 0.1), (0.5, 1.0), (0.3, 2.0))], axis=1)
    q = rotation.chain(rotation.exp_quaternion(rate * PERIOD / PARTS))
    stamps = np.arange(1, COUNT) * PARTS  # sample k of the fine steps ends at their stamp k + 1
    ends = np.concatenate([np.zeros((1, 3)), np.cumsum(rate, axis=0)]) / PARTS
    means = np.diff(ends[np.arange(COUNT) * PARTS], axis=0)
    gyro = (means if samples == "interval" else rate[stamps]) * (1.0 + scale) + bias
    then = np.minimum(stamps - 1 - round(late * PARTS), len(q) - 1)
    seen = rotation.rotate(rotation.conjugate(q[then]), FIELD) + iron * 4.5e-5
    when = PERIOD * np.arange(1, COUNT)
    fixes = Fixes("magnetometer", "mag", when[::every], (seen + rng.normal(0.0, 2e-7, seen.shape))[::every])
    force = rotation.rotate(rotation.conjugate(q[stamps - 1]), GRAVITY) + rng.normal(0.0, 0.02, seen.shape)
    imu = Imu(when, gyro + rng.normal(0.0, 2e-3, gyro.shape), force)
    log = Log((), 0, np.rint(when * 1e9).astype(np.int64), imu, {"magnetometer": fixes}, np.zeros((0, 2)), {})
    return log, q[stamps - 1]


@pytest.mark.parametrize("samples", ["point", "interval"])
@pytest.mark.parametrize("error", [{}, {"bias": 0.1}, {"scale": 0.05}, {"iron": 0.3}, {"every": 5}])
def test_the_lead_of_the_magnetometer_is_found_beside_other_errors(samples: str, error: dict[str, float]) -> None:
    found, sigma = lead(turning(samples, **error)[0])  # type: ignore[arg-type]
    assert sigma < 0.05
    assert found == pytest.approx(0.5 if samples == "interval" else 0.0, abs=max(4.0 * sigma, 0.03))


@pytest.mark.parametrize(
    ("samples", "late", "stated", "read"),
    [("interval", 0.0, "auto", "interval"), ("point", 0.0, "auto", "point"), ("interval", 3.0, "auto", "point"),
     ("point", -3.0, "auto", "point"), ("interval", 0.0, "point", "point"), ("point", 0.0, "interval", "interval")],
)  # fmt: skip
def test_samples_are_means_where_the_magnetometer_is_half_a_sample_ahead(
    samples: str, late: float, stated: str, read: str
) -> None:
    log, _ = turning(samples, late=late)
    settings, told = read_as(log, Settings.model_validate({"imu": {"gyro_samples": stated}}))
    assert settings.imu.gyro_samples == read
    assert [w.code for w in told] == ["gyro-interval"] * (stated == "auto" and read == "interval")


def test_a_log_without_a_magnetometer_or_without_a_turn_shows_nothing() -> None:
    log, _ = turning("interval")
    still = Imu(log.imu.t, np.random.default_rng(1).normal(0.0, 2e-3, log.imu.gyro_b.shape), log.imu.accel_b)
    field = Fixes("magnetometer", "mag", log.imu.t, FIELD + np.random.default_rng(2).normal(0.0, 2e-7, (COUNT - 1, 3)))
    bare = {"fixes": {}}, {"imu": still, "fixes": {"magnetometer": field}}
    for change in bare:
        parts = {name: getattr(log, name) for name in ("sources", "t0_ns", "stamps_ns", "imu", "fixes", "gaps")}
        other = Log(**{**parts, **change}, coverage={})
        assert read_as(other, Settings())[0].imu.gyro_samples == "point"


def test_the_attitude_of_such_a_log_is_that_of_its_stamps() -> None:
    """Read as points, samples that are means lag by half a sample: 0.3 deg at 1 rad/s."""
    log, truth = turning("interval")
    off = {}
    for stated in ("auto", "point"):
        settings = Settings.model_validate({"imu": {"gyro_samples": stated}, "smoothing": {"filter": "navigation"}})
        found = estimate.estimate(log, find_segments(log, settings), settings)
        error = rotation.log_quaternion(rotation.multiply(rotation.conjugate(truth), found.q))
        off[stated] = float(np.degrees(np.sqrt(np.mean(np.sum(error[:, :2] ** 2, axis=1)))))
        assert ("gyro-interval" in {w.code for w in found.warnings}) == (stated == "auto")
    assert off["auto"] < 0.6 * off["point"]
