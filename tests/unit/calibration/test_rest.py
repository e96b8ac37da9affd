from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import still

from attest_cli.calibration.rest import Piece, cut, find_rest, means
from attest_cli.errors import AttestError
from attest_cli.records import Log, Segment, Segmentation


def segments(*spans: tuple[bool, float, float]) -> Segmentation:
    """Segments as (moving, start, end)."""
    made = [Segment(k + 1, moving, a, b, 0, 0, a, b) for k, (moving, a, b) in enumerate(spans)]
    return Segmentation(tuple(made), np.zeros(0), 1.0, 2.0, np.zeros(3), 1.0, "imu")


def log(seconds: float = 100.0, t0_ns: int = 0, hz: float = 10.0, name: str = "a.csv") -> Log:
    n = round(seconds * hz)
    noise = np.random.default_rng(0).normal(size=(2, n, 3))
    return still.log(np.arange(n) / hz, 1e-3 * noise[0], noise[1] * 0.01 + [0, 0, 9.8], t0_ns=t0_ns, name=name)


def test_stops_are_the_pieces_and_motions_are_left_out() -> None:
    record = find_rest([(log(), segments((False, 0, 20), (True, 20, 70), (False, 70, 99.9)))])
    assert [(round(p.t[0], 6), round(p.t[-1], 6), p.stop) for p in record.pieces] == [(0, 19.9, 0), (70, 99.8, 1)]
    assert not record.static
    assert record.at_rest == pytest.approx(20.0 + 29.9)
    assert record.rate_hz == pytest.approx(10.0)


def test_a_record_that_rests_but_for_a_knock_is_static_and_says_so() -> None:
    record = find_rest([(log(), segments((False, 0, 50), (True, 50, 51), (False, 51, 99.9)))])
    assert record.static
    assert record.notes == ("moved 1 x, 1.0 s in all: left out",)


def test_a_hole_parts_a_stop_into_two_pieces() -> None:
    whole = log()
    keep = np.ones(len(whole.imu.t), dtype=bool)
    keep[400:430] = False
    holed = still.log(whole.imu.t[keep], whole.imu.gyro_b[keep], whole.imu.accel_b[keep])
    record = find_rest([(holed, segments((False, 0, 99.9)))])
    assert [len(p.t) for p in record.pieces] == [400, 569]
    assert {p.stop for p in record.pieces} == {0}


def test_logs_stand_on_one_axis_whatever_their_order() -> None:
    early, late = log(t0_ns=10**18, name="early.csv"), log(t0_ns=10**18 + 3600 * 10**9, name="late.csv")
    still_ = segments((False, 0, 99.9))
    record = find_rest([(late, still_), (early, still_)])
    assert record.t0_ns == 10**18
    assert [round(p.t[0]) for p in record.pieces] == [0, 3600]
    assert [p.stop for p in record.pieces] == [0, 1]
    assert record.duration == pytest.approx(3600 + 99.9)


@pytest.mark.parametrize(
    ("second", "said"),
    [
        (log(t0_ns=50 * 10**9, name="b.csv"), "overlap"),
        (log(t0_ns=200 * 10**9, hz=20.0, name="b.csv"), "samples a second"),
    ],
)
def test_logs_that_one_sensor_cannot_have_written_are_refused(second: Log, said: str) -> None:
    rest = segments((False, 0, 99.9))
    with pytest.raises(AttestError, match=said) as told:
        find_rest([(log(), rest), (second, rest)])
    assert "a.csv and b.csv" in told.value.message
    assert told.value.hint


@pytest.mark.parametrize("spans", [((True, 0.0, 99.9),), ((True, 0.0, 99.0), (False, 99.0, 99.5))])
def test_a_log_that_never_rests_is_refused(spans: tuple[tuple[bool, float, float], ...]) -> None:
    moving = replace(log(), sources=(Path("drive.mcap"),))
    with pytest.raises(AttestError, match=r"drive\.mcap: nothing in it stands still") as told:
        find_rest([(moving, segments(*spans))])
    assert "--stops" in told.value.hint


def test_blocks_cover_every_sample_once_and_never_cross_a_piece() -> None:
    rng = np.random.default_rng(1)
    pieces = [still.piece(103, 0.1), still.piece(57, 0.1, 30.0, 1), still.piece(4, 0.1, 60.0, 2)]
    values = [rng.normal(size=len(p.t)) for p in pieces]
    blocks, edges = cut(pieces, 1.0)
    assert blocks.count.sum() == 164
    assert all(np.ptp(blocks.count[blocks.piece == k]) <= 1 for k in range(3))
    assert np.bincount(blocks.piece).tolist() == [10, 6, 1]
    by_hand = [x[a:b].mean() for x, e in zip(values, edges, strict=True) for a, b in itertools.pairwise(e)]
    np.testing.assert_allclose(means(values, edges), by_hand)
    np.testing.assert_allclose(blocks.t, means([p.t for p in pieces], edges))
    np.testing.assert_allclose(blocks.span, 0.1 * blocks.count)


def test_the_gap_before_a_block_is_from_sample_to_sample() -> None:
    pieces = [still.piece(20, 0.1), Piece(np.arange(20) * 0.1 + 10.0, np.zeros((20, 3)), np.zeros((20, 3)), 0.1, 1)]
    blocks, _ = cut(pieces, 1.0)
    np.testing.assert_allclose(blocks.gap, [0.0, 0.1, 10.0 - 1.9, 0.1])


def test_a_moment_of_rest_is_too_short() -> None:
    with pytest.raises(AttestError, match=r"1\.5 s of it stand still, too short"):
        find_rest([(log(), segments((True, 0.0, 50.0), (False, 50.0, 51.5), (True, 51.5, 99.9)))])
