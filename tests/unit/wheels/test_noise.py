"""Whose word counts for the noise of the wheels, and that it counts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from support.drives import Job, simulated

from attest_cli.filters import Drive
from attest_cli.filters.navigation.wheels import wheels_of
from attest_cli.position import odometry_position
from attest_cli.records import Fixes, Smoothed
from attest_cli.settings.models import Odometry
from attest_cli.simulate import RoverOptions
from attest_cli.wheels import Judged, sigma_of

Array = NDArray[np.float64]
IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def work() -> Job:
    made = simulated(RoverOptions(seed=5, motions=1, motion_s=(30.0, 31.0), odometry=True))
    return replace(made, settings=made.settings.model_copy(update={"odometry": Odometry()}))


def with_sigma(work: Job, sigma: float) -> Fixes:
    fixes = work.log.fixes["odometry"]
    return replace(fixes, sigma=np.full((len(fixes.t), 3), sigma))


@pytest.mark.parametrize(
    ("stated", "logged", "sigma"),
    [({}, None, (0.05, 0.05)), ({}, (0.2, 0.3), (0.2, 0.3)), ({"sigma_m_s": 0.1}, (0.2, 0.3), (0.1, 0.3)),
     ({}, (np.nan, 0.0), (0.05, 0.05)), ({}, (1e-9, 1e6), (0.01, 0.05)), ({}, (1e6, -1.0), (1e6, 0.05))],
)  # fmt: skip
def test_settings_come_before_the_log_and_the_log_before_defaults(
    stated: dict[str, float], logged: tuple[float, float] | None, sigma: tuple[float, float]
) -> None:
    known = None if logged is None else np.tile([logged[0], logged[1], logged[1]], (4, 1))
    found = sigma_of(Fixes("odometry", "/odom", np.arange(4.0), np.ones((4, 3)), known), Odometry(**stated))
    assert found == pytest.approx(np.tile([sigma[0], sigma[1], sigma[1]], (4, 1)))


def test_the_position_knows_how_noisy_its_wheels_are(work: Job) -> None:
    t = work.nodes.t
    n = len(t)
    sure = Smoothed(t, work.truth(t).q_nb, np.zeros((n, 3)), np.zeros((n, 6, 6)) + 1e-12 * np.eye(6),
                    np.zeros((n - 1, 6, 6)))  # fmt: skip
    imu, settings = work.log.imu, work.settings
    settings = settings.model_copy(update={"odometry": Odometry(scale_sigma=1e-9)})
    q = work.truth(imu.t).q_nb
    P = [odometry_position(imu, q, IDENTITY, sure, work.segmentation, with_sigma(work, sigma), settings).P[-1]
         for sigma in (0.05, 0.5)]  # fmt: skip
    assert P[1] == pytest.approx(100.0 * P[0], rel=1e-3, abs=1e-9)


def test_the_navigation_filter_weighs_its_wheels_by_their_sigma_and_finds_their_noise_itself(work: Job) -> None:
    drive = Drive(work.log, work.segmentation, work.world, work.noise, work.settings)
    bias, arm = np.zeros((len(work.nodes.t), 3)), np.zeros(3)
    fixes = with_sigma(work, 0.5)
    assert fixes.sigma is not None
    late = float(np.quantile(fixes.t, 0.7))
    fixes.sigma[fixes.t > late] *= 4.0
    wheels, _ = wheels_of(drive, work.nodes, bias, arm, Judged(fixes, None, IDENTITY, ()))
    plain, _ = wheels_of(drive, work.nodes, bias, arm, Judged(replace(fixes, sigma=None), None, IDENTITY, ()))
    assert wheels is not None
    assert plain is not None
    share = wheels.sigma / plain.sigma
    assert share[wheels.t < late - 1.0] == pytest.approx(1.0)
    assert share[wheels.t > late + 1.0] == pytest.approx(4.0)
