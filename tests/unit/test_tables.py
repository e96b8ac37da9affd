"""The track at full rate: the same whatever the blocks it is made in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.drives import simulated

from attest_cli import position, tables
from attest_cli.filters import indirect
from attest_cli.position import course
from attest_cli.simulate import RoverOptions
from attest_cli.smoothers import SMOOTHERS
from attest_cli.track import full_rate


@pytest.fixture(scope="module", params=["enu", "ned"])
def track(request: pytest.FixtureRequest) -> tables.Track:
    work = simulated(RoverOptions(seed=77, motions=2, motion_s=(20.0, 30.0), odometry=True))
    smoothed = SMOOTHERS["two-filter"](indirect.run(work.nodes, work.start))
    q = full_rate(work.nodes.samples, smoothed)
    here = np.array([1.0, 0.0, 0.0, 0.0])
    place = position.odometry_position(
        work.log.imu, q, here, smoothed, work.segmentation, work.log.fixes["odometry"], work.settings
    )
    return tables.Track(work.log, q, smoothed, place, work.segmentation, here, np.zeros(3), request.param)


def columns(track: tables.Track) -> tables.Columns:
    blocks = list(track)
    return {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}


def test_blocks_change_no_column(track: tables.Track, monkeypatch: pytest.MonkeyPatch) -> None:
    n = len(track.q)
    monkeypatch.setattr(course, "BLOCK_ROWS", n)
    whole, again = columns(track), columns(track)
    assert len(list(track)) == 1
    monkeypatch.setattr(course, "BLOCK_ROWS", 701)
    parts = columns(track)
    assert len(list(track)) == -(-n // 701)
    for name, column in whole.items():
        assert column.dtype == parts[name].dtype
        assert np.array_equal(column, again[name], equal_nan=column.dtype.kind == "f")
        if column.dtype.kind == "f":
            assert np.allclose(column, parts[name], rtol=0, atol=1e-12 * np.nanmax(np.abs(column)), equal_nan=True), (
                name
            )
        else:
            assert np.array_equal(column, parts[name]), name


def test_yaw_and_quaternion_run_on_over_the_edge_of_a_block(
    track: tables.Track, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(course, "BLOCK_ROWS", 701)
    found = columns(track)
    q = np.stack([found[f"q_{part}"] for part in "wxyz"], axis=1)
    assert np.all(np.sum(q[1:] * q[:-1], axis=1) > 0.0)
    assert np.abs(np.diff(found["yaw_deg"])).max() < 90.0


def test_without_a_position_its_columns_are_blank(track: tables.Track) -> None:
    found = columns(replace(track, position=None))
    for axis in "xyz":
        for name in (f"position_{axis}_m", f"velocity_{axis}_m_s", f"sigma_position_{axis}_m"):
            assert np.isnan(found[name]).all()


def test_between_is_linear_between_knots_and_level_beyond_them(rng: np.random.Generator) -> None:
    knots, t = np.sort(rng.uniform(0.0, 9.0, 40)), np.sort(rng.uniform(-1.0, 10.0, 500))
    values = rng.normal(size=(3, 40)).astype(np.float32)
    for at in (t, knots):
        exact = [np.interp(at, knots, row) for row in values]
        assert tables.between(knots, values, at) == pytest.approx(np.array(exact), abs=1e-5)
