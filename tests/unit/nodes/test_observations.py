"""Which measurements count, when, and how noisy each is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.drives import Job, simulated

from attest_cli.nodes.observations import FIELD_CORRELATION_S, WINDOW_S, Observation, observe
from attest_cli.records import Fixes, Segmentation, Warn, World
from attest_cli.settings import Settings
from attest_cli.simulate import RoverOptions

OPTIONS = RoverOptions(
    seed=35, duration_s=100.0, motions=2, sun_always=True, compass=True, magnetometer=True, compass_hz=20.0
)


@pytest.fixture(scope="module")
def work() -> Job:
    return simulated(OPTIONS)


def seen(work: Job, world: World | None = None, **tables: dict[str, Any]) -> tuple[list[Observation], list[Warn]]:
    settings = work.settings
    for name, values in tables.items():
        section = getattr(settings, name).model_copy(update=values)
        settings = settings.model_copy(update={name: section})
    return observe(work.log, work.segmentation, world or work.world, work.noise, settings)


def of(found: list[Observation], role: str) -> list[Observation]:
    return [o for o in found if o.role == role]


def inside_a_stop(segmentation: Segmentation, t: float) -> bool:
    return any(s.used_start <= t <= s.used_end for s in segmentation.stops)


def test_observations_come_in_time_order(work: Job) -> None:
    found, warnings = seen(work)
    assert np.all(np.diff([o.t for o in found]) >= 0)
    assert not warnings
    assert {o.role for o in found} == {"gravity", "sun", "compass", "magnetometer"}


@pytest.mark.parametrize("policy", ["auto", "stops", "always"])
def test_policy_says_when_a_sensor_counts(work: Job, policy: str) -> None:
    found, _ = seen(work, smoothing={"absolute": policy})
    moving = {role: any(not o.still for o in of(found, role)) for role in ("sun", "compass", "magnetometer")}
    assert (
        moving
        == {
            "auto": {"sun": True, "compass": True, "magnetometer": False},
            "stops": {"sun": False, "compass": False, "magnetometer": False},
            "always": {"sun": True, "compass": True, "magnetometer": True},
        }[policy]
    )
    assert all(o.still == inside_a_stop(work.segmentation, o.t) for o in found if len(o.times) == 1)


def test_one_magnetic_heading_per_stop_with_the_error_of_the_place(work: Job) -> None:
    found, _ = seen(work, smoothing={"absolute": "always"}, magnetometer={"sigma_deg": 3.0})
    still = [o for o in of(found, "magnetometer") if o.still]
    assert len(still) == len(work.segmentation.stops)
    assert all(o.noise[0, 0] == pytest.approx(np.radians(3.0) ** 2) for o in still)
    moving = [o for o in of(found, "magnetometer") if not o.still]
    assert all(o.noise[0, 0] == pytest.approx(np.radians(3.0) ** 2 * 2 * FIELD_CORRELATION_S) for o in moving)
    assert np.diff([o.t for o in moving]).min() > 0.5  # one a second


def test_a_fast_sensor_is_averaged_over_a_second_at_stops_and_a_node_in_motion(work: Job) -> None:
    found = of(seen(work, compass={"sigma_deg": 3.0})[0], "compass")
    assert sum(len(o.times) for o in found) == len(work.log.fixes["compass"].t)
    for o in found:
        assert np.ptp(o.times) < (1.0 if o.still else work.settings.smoothing.node_spacing_s)
        # readings within a second share their error: ten nodes of a second know as much as one reading
        assert o.noise[0, 0] == pytest.approx(10.0 * np.radians(3.0) ** 2, rel=0.1)
    assert max(len(o.times) for o in found if o.still) == 20
    assert 2 <= max(len(o.times) for o in found if not o.still) <= 3  # the edge of a bin may round either way


def test_the_sun_near_the_vertical_or_out_of_view_is_left_out(work: Job) -> None:
    high = replace(work.world, sun_n=np.array([np.sin(np.radians(9.9)), 0.0, np.cos(np.radians(9.9))]))
    found, warnings = seen(work, world=high)
    assert not of(found, "sun")
    assert [w.code for w in warnings] == ["sun-not-used"]
    lower = replace(work.world, sun_n=np.array([np.sin(np.radians(10.1)), 0.0, np.cos(np.radians(10.1))]))
    assert of(seen(work, world=lower)[0], "sun")
    across = np.hypot(*work.log.fixes["sun"].values[:, :2].T)
    limit = float(np.degrees(np.arcsin(np.median(across))))
    narrow = of(seen(work, sun={"field_of_view_deg": limit})[0], "sun")
    assert len(narrow) == int(np.sum(across <= np.sin(np.radians(limit))))
    assert 0 < len(narrow) < len(across)


def test_a_sun_without_reference_is_said_to_be_unused(work: Job) -> None:
    found, warnings = seen(work, world=replace(work.world, sun_n=None))
    assert not of(found, "sun")
    assert [w.code for w in warnings] == ["no-sun-reference"]


def test_a_log_without_a_stop_takes_its_tilt_from_motion(work: Job) -> None:
    s = work.segmentation
    moving = Segmentation(s.motions, s.statistic, s.enter, s.leave, s.bias_b, s.margin, s.source)
    found, warnings = observe(work.log, moving, work.world, work.noise, work.settings)
    gravity = of(found, "gravity")
    assert [w.code for w in warnings] == ["tilt-from-motion"]
    assert len(gravity) == sum(int((m.end - m.start) / WINDOW_S) for m in s.motions)
    true = work.truth(np.array([o.t for o in gravity]))
    tilt = [np.arccos(np.clip(o.values[0] @ R[2], -1, 1)) for o, R in zip(gravity, true.R_nb, strict=True)]
    sigma = [np.sqrt(o.noise[0, 0]) for o in gravity]
    assert np.all(np.array(tilt) < 3.5 * np.array(sigma))


def test_orientation_has_the_noise_of_the_settings(work: Job) -> None:
    t = np.arange(0.5, 90.0, 1.0)
    log = replace(work.log, fixes={"orientation": Fixes("orientation", "x", t, work.truth(t).q_nb)})
    found, _ = observe(log, work.segmentation, work.world, work.noise, Settings.model_validate({}))
    rows = of(found, "orientation")
    assert len(rows) == len(t)
    assert all(np.allclose(o.noise, np.radians(2.0) ** 2 * np.eye(3)) for o in rows)


def test_a_magnetometer_of_unknown_north_does_not_mix_with_true_north(work: Job) -> None:
    t = np.arange(0.5, 90.0, 0.5)
    field = Fixes("magnetometer", "m", t, np.tile([2e-5, 0.0, -4e-5], (len(t), 1)))
    log = replace(work.log, fixes={**work.log.fixes, "magnetometer": field})
    unknown = replace(work.world, field_n=None)
    found, told = observe(log, work.segmentation, unknown, work.noise, work.settings)
    assert not of(found, "magnetometer")
    assert "no-magnetic-reference" in {w.code for w in told}
    known = replace(work.world, field_n=np.array([0.0, 2e-5, -4e-5]))
    assert of(observe(log, work.segmentation, known, work.noise, work.settings)[0], "magnetometer")
