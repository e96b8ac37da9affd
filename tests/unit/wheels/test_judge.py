"""Which wheels count: one judgement, told once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from support.drives import Job, simulated

from attest_cli import mounting
from attest_cli.mounting import Mounting
from attest_cli.simulate import RoverOptions
from attest_cli.wheels import Judged, judge

Array = NDArray[np.float64]
GRAVITY = 9.80665


@pytest.fixture(scope="module")
def work() -> Job:
    return simulated(RoverOptions(seed=81, motions=2, motion_s=(60.0, 90.0), odometry=True))


def judged(work: Job, change: Callable[[Array], Array], position: str = "auto") -> Judged:
    """Judge the wheels of a drive that tell ``change(t)`` m/s too much, beside the true attitude."""
    fixes = work.log.fixes["odometry"]
    told = replace(fixes, values=fixes.values + change(fixes.t)[:, None] * [1.0, 0.0, 0.0])
    smoothing = work.settings.smoothing.model_copy(update={"position": position})
    settings = work.settings.model_copy(update={"smoothing": smoothing})
    return judge(work.log, work.truth(work.log.imu.t).q_nb, work.segmentation, told, GRAVITY, settings)


def test_clean_wheels_count_in_silence(work: Job) -> None:
    found = judged(work, np.zeros_like)
    assert found.fixes is not None
    assert len(found.fixes.t) == len(work.log.fixes["odometry"].t)
    assert found.told == ()


@pytest.mark.parametrize(("slip_m_s", "length"), [(1.5, 4.0), (3.0, 2.0)])
def test_a_short_slip_is_cut_out_and_told_as_what_it_is(work: Job, slip_m_s: float, length: float) -> None:
    since = work.segmentation.motions[0].start + 25.0
    found = judged(work, lambda t: slip_m_s * ((t > since) & (t < since + length)))
    assert [w.code for w in found.told] == ["odometry-slips"]
    assert found.fixes is not None
    assert not np.any((found.fixes.t > since) & (found.fixes.t < since + length))
    assert len(work.log.fixes["odometry"].t) - len(found.fixes.t) < 12.0 * 10.0  # 10 Hz


@pytest.mark.parametrize("wrong", ["slips", "scale"])
def test_wheels_that_most_of_the_drive_contradicts_are_refused_once(work: Job, wrong: str) -> None:
    fixes = work.log.fixes["odometry"]

    def change(t: Array) -> Array:
        return 1.6 * (t % 12.0 < 6.0) if wrong == "slips" else 2.6 * np.interp(t, fixes.t, fixes.values[:, 0])

    found = judged(work, change)
    assert found.fixes is None
    assert [w.code for w in found.told] == ["odometry-contradicts"]
    forced = judged(work, change, position="odometry")
    assert forced.forced
    assert forced.fixes is not None


@pytest.mark.parametrize(("scale", "sigma", "used"), [(0.37, 0.06, False), (0.37, 0.2, True), (0.8, 0.02, True)])
def test_wheels_that_surely_do_not_speed_up_as_the_accelerometer_are_refused_though_no_axis_is_sure(
    work: Job, scale: float, sigma: float, used: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wheels that are seconds late, say: the axis that is assumed for them must not be believed."""
    vague = Mounting(np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.05, 0.2, 0.2]), scale, sigma, 0.0, "")
    monkeypatch.setattr(mounting, "find_mounting", lambda *_: vague)
    found = judged(work, np.zeros_like)
    assert (found.fixes is not None) == used
    assert [w.code for w in found.told] == ([] if used else ["odometry-contradicts"])


@pytest.mark.parametrize(("position", "code"), [("auto", "odometry-not-used"), ("odometry", "mounting-not-shown")])
def test_wheels_of_an_imu_on_its_side_whose_seat_nothing_shows_are_never_used_in_silence(
    work: Job, position: str, code: str
) -> None:
    imu = work.log.imu
    side = replace(imu, gyro_b=imu.gyro_b[:, [0, 2, 1]], accel_b=imu.accel_b[:, [0, 2, 1]])
    slow = replace(work.log.fixes["odometry"], t=work.log.fixes["odometry"].t[::30])
    slow = replace(slow, values=work.log.fixes["odometry"].values[::30])
    settings = work.settings.model_copy(
        update={"imu": work.settings.imu.model_copy(update={"mounting": "auto"}),
                "smoothing": work.settings.smoothing.model_copy(update={"position": position})}
    )  # fmt: skip
    q = work.truth(imu.t).q_nb
    found = judge(replace(work.log, imu=side), q, work.segmentation, slow, GRAVITY, settings)
    assert code in {w.code for w in found.told}
    assert (found.fixes is None) == (position == "auto")
