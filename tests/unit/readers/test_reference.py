"""Tracks of poses in every format are read alike; what is no track is refused in one line."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from mcap_ros2.writer import Writer
from support.tracks import T0, Motion

from attest_cli.errors import AttestError
from attest_cli.maths import rotation
from attest_cli.readers.reference import read_judged, read_poses
from attest_cli.writers import write_track
from attest_cli.writers.ros2 import DEFINITIONS, definition, quaternion, vector

T = np.arange(0.0, 2.0, 0.01)
STAMPS = T0 + np.rint(T * 1e9).astype(np.int64)
Q, P = Motion().q(T), Motion().p(T)
META = {"attest_version": "0.1.0", "frame": "ENU world, FLU body", "heading": "magnetic"}


def columns(q: np.ndarray = Q, p: np.ndarray = P) -> dict[str, np.ndarray]:
    """The columns of a track."""
    found: dict[str, np.ndarray] = {"timestamp_ns": STAMPS, "t_s": T}
    found |= {f"q_{part}": q[:, k] for k, part in enumerate("wxyz")}
    for k, axis in enumerate("xyz"):
        found[f"sigma_att_{axis}_deg"] = np.full(T.size, 0.1 * (k + 1), dtype=np.float32)
        found[f"gyro_bias_{axis}_rad_s"] = np.zeros(T.size)
        found[f"position_{axis}_m"] = p[:, k]
        found[f"sigma_position_{axis}_m"] = np.full(T.size, 1.0 + k, dtype=np.float32)
        found[f"velocity_{axis}_m_s"] = np.zeros(T.size)
    return found | {"segment": np.full(T.size, 1, dtype=np.int32), "moving": T >= 1.0}


@pytest.mark.parametrize("name", ["parquet", "csv", "tum", "mcap"])
def test_every_format_that_attest_writes_comes_back(tmp_path: Path, name: str) -> None:
    path = tmp_path / f"track.{name}"
    write_track([columns()], META, path, name)
    found = read_poses(path)
    assert np.array_equal(found.stamps_ns, STAMPS)
    np.testing.assert_allclose(found.q, Q, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(found.position, P, rtol=0.0, atol=1e-15)
    assert found.shared_world
    if name != "mcap":
        assert found.heading == "magnetic"
    if name in {"parquet", "csv"}:
        assert found.kind == "track"
        assert found.moving is not None
        assert np.array_equal(found.moving, T >= 1.0)
        assert found.claims is not None
        assert not found.claims.full
        np.testing.assert_allclose(np.degrees(np.sqrt(found.claims.attitude[7].diagonal())), [0.1, 0.2, 0.3], rtol=1e-6)
        np.testing.assert_allclose(np.sqrt(found.claims.position[7].diagonal()), [1.0, 2.0, 3.0], rtol=1e-6)


@pytest.mark.parametrize("name", ["parquet", "csv", "tum"])
def test_a_track_in_ned_is_turned_to_enu(tmp_path: Path, name: str) -> None:
    to_ned = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    R = to_ned @ rotation.matrix(Q) @ np.diag([1.0, -1.0, -1.0])
    path = tmp_path / f"track.{name}"
    ned = {**META, "frame": "NED world, FRD body"}
    write_track([columns(rotation.continuous(rotation.from_matrix(R)), P @ to_ned.T)], ned, path, name)
    found = read_poses(path)
    np.testing.assert_allclose(rotation.matrix(found.q), rotation.matrix(Q), atol=1e-14)
    np.testing.assert_allclose(found.position, P, atol=1e-14)
    if found.claims is not None:  # north and east change places
        np.testing.assert_allclose(np.sqrt(found.claims.position[0].diagonal()), [2.0, 1.0, 3.0], rtol=1e-6)


def test_a_track_without_position_has_none_in_tum_and_mcap(tmp_path: Path) -> None:
    blank = columns(p=np.full_like(P, np.nan))
    for name in ("tum", "mcap", "parquet"):
        write_track([blank], META, tmp_path / f"track.{name}", name)
        assert np.isnan(read_poses(tmp_path / f"track.{name}").position).all(), name


def test_tum_of_others_with_exponents_and_many_blanks(tmp_path: Path) -> None:
    path = tmp_path / "groundtruth.txt"
    lines = [f"{STAMPS[k]:d}"[:10] + f".{STAMPS[k] % 10**9:09d}  1e0\t2 3   0 0 0 1.0" for k in range(3)]
    lines[1] = "1.780308000010000000e+09 1.5 2 3 0 0 0.6 0.8"
    path.write_text("# ground truth\n# timestamp tx ty tz qx qy qz qw\n\n" + "\n".join(lines) + "\n")
    found = read_poses(path)
    assert np.array_equal(found.stamps_ns, STAMPS[:3])
    assert found.kind == "tum"
    assert not found.shared_world
    np.testing.assert_allclose(found.q[1], [0.8, 0.0, 0.0, 0.6])
    assert found.position[1].tolist() == [1.5, 2.0, 3.0]


def test_euroc_ground_truth(tmp_path: Path) -> None:
    head = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], "
    head += "v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], b_w_RS_S_x [rad s^-1]"
    rows = [f"{STAMPS[k]},{P[k, 0]},{P[k, 1]},{P[k, 2]},{','.join(map(str, Q[k]))},1,2,3,0.1" for k in range(5)]
    path = tmp_path / "data.csv"
    path.write_text("\n".join([head, *rows]) + "\n")
    found = read_poses(path)
    assert (found.kind, found.shared_world) == ("euroc", False)
    assert np.array_equal(found.stamps_ns, STAMPS[:5])
    np.testing.assert_allclose(found.q, Q[:5], atol=1e-15)
    np.testing.assert_allclose(found.position, P[:5], atol=1e-15)


def test_the_truth_in_a_log_wins_over_its_other_columns(tmp_path: Path) -> None:
    names = {f"truth_q{part}": Q[:, k] for k, part in enumerate("wxyz")}
    names |= {f"q_{part}": np.full(T.size, 0.5) for part in "wxyz"}
    path = tmp_path / "trial.parquet"
    pq.write_table(pa.table({"t": T, "gyr_x": T, **names, "movement": T >= 1.0}), path)
    found = read_poses(path)
    np.testing.assert_allclose(found.q, Q, atol=1e-15)
    assert np.array_equal(found.stamps_ns, np.rint(T * 1e9).astype(np.int64))
    assert found.moving is not None
    assert found.moving.sum() == np.sum(T >= 1.0)


def test_blanks_stay_blank_and_rows_are_put_in_order(tmp_path: Path) -> None:
    table = columns()
    for part in "wxyz":
        table[f"q_{part}"] = np.where(T < 0.5, np.nan, table[f"q_{part}"])
    order = np.r_[np.arange(100, T.size), np.arange(100), 5]
    path = tmp_path / "x.truth.parquet"
    pq.write_table(pa.table({name: pa.array(v[order]) for name, v in table.items()}), path)
    found = read_poses(path)
    assert np.array_equal(found.stamps_ns, STAMPS)
    assert np.isnan(found.q).any(axis=1).sum() == np.sum(T < 0.5)
    assert {w.code for w in found.warnings} == {"rows-out-of-order", "rows-dropped"}


def test_millimetres_are_metres(tmp_path: Path) -> None:
    path = tmp_path / "mocap.csv"
    rows = [f"{t:.2f},{1e3 * p[0]},{1e3 * p[1]},{1e3 * p[2]}" for t, p in zip(T, P, strict=True)]
    path.write_text("time [s],position_x [mm],position_y [mm],position_z [mm]\n" + "\n".join(rows) + "\n")
    np.testing.assert_allclose(read_poses(path).position, P, rtol=1e-12)
    path.write_text(path.read_text().replace("[mm]", "[kg]"))
    with pytest.raises(AttestError, match="no unit of length"):
        read_poses(path)


Sent = tuple[str, str, dict[str, Any]]


def write_mcap(path: Path, sent: Callable[[int], list[Sent]], frame: str = "map") -> Path:
    kinds = {
        **DEFINITIONS,
        "geometry_msgs/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose",
    }
    with path.open("wb") as stream, Writer(stream) as out, pytest.MonkeyPatch.context() as patch:
        patch.setattr("attest_cli.writers.ros2.DEFINITIONS", kinds)
        schemas: dict[str, Any] = {}
        for k, stamp in enumerate(STAMPS.tolist()):
            for topic, kind, fields in sent(k):
                if kind not in schemas:
                    schemas[kind] = out.register_msgdef(kind.replace("/", "/msg/"), definition(kind))
                header = {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": frame}
                out.write_message(topic, schemas[kind], {"header": header, **fields}, log_time=stamp)
    return path


def pose(k: int) -> dict[str, Any]:
    return {"position": vector(*P[k].tolist()), "orientation": quaternion(*Q[k].tolist())}


def sent_pose(k: int, topic: str = "/vicon") -> Sent:
    return topic, "geometry_msgs/PoseStamped", {"pose": pose(k)}


def sent_orientation(k: int) -> Sent:
    return "/ahrs", "geometry_msgs/QuaternionStamped", {"quaternion": quaternion(*Q[k].tolist())}


def sent_odometry(k: int) -> Sent:
    return "/odom", "nav_msgs/Odometry", {"twist": {"twist": {"linear": vector(1.0, 0.0, 0.0)}}}


def test_mcap_poses_are_preferred_and_a_channel_can_be_named(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "log.mcap", lambda k: [sent_orientation(k), sent_pose(k), sent_odometry(k)])
    found = read_poses(path)
    assert (found.channel, found.kind, found.shared_world) == ("/vicon", "mcap", False)
    np.testing.assert_allclose(found.position, P, atol=1e-15)
    named = read_poses(path, "/ahrs")
    np.testing.assert_allclose(named.q, Q, atol=1e-15)
    assert np.isnan(named.position).all()
    with pytest.raises(AttestError, match=r"no poses on a channel '/x'; there are: /ahrs .*, /vicon"):
        read_poses(path, "/x")


def test_mcap_with_two_poses_asks_which(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "log.mcap", lambda k: [sent_pose(k), sent_pose(k, "/slam")])
    with pytest.raises(AttestError, match=r"more than one channel could be the reference: /vicon .*, /slam"):
        read_poses(path)


def test_odometry_that_has_only_a_twist_is_no_reference(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "log.mcap", lambda k: [sent_odometry(k)])
    with pytest.raises(AttestError, match="no channel of odometry, poses or orientations"):
        read_poses(path)


def test_a_damaged_mcap_is_refused(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "log.mcap", lambda k: [sent_pose(k)])
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(AttestError, match="damaged MCAP"):
        read_poses(path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time,speed\n0,1\n1,2\n", "no attitude and no position among 'time', 'speed'"),
        ("q_w,q_x,q_y,q_z\n1,0,0,0\n", "no time column"),
        ("time,q_w,q_x,q_y\n0,1,0,0\n", "column q_z is missing beside 'q_w'"),
        ("time,q_w,q_x,q_y,q_z\n0,2,0,0,0\n1,2,0,0,0\n", "2 of 2 quaternions are not of unit length"),
        ("time,q_w,q_x,q_y,q_z\n0,,,,\n1,,,,\n", "every attitude and position is blank"),
        ("time,q_w,q_x,q_y,q_z\n0,1,0,0,0\n1,a,0,0,0\n", "column 'q_w' holds no numbers"),
    ],
)
def test_what_is_no_track_is_refused_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "reference.csv"
    path.write_text(text)
    with pytest.raises(AttestError, match=re.escape(words)) as fault:
        read_poses(path)
    assert str(fault.value).startswith(str(path))
    assert "\n" not in str(fault.value)


def in_table(path: Path, head: str, times: list[str], mark: str = ".") -> Path:
    """A reference of attitudes with times as written."""
    rows = [";".join([time, *(f"{part:.9f}".replace(".", mark) for part in q)])
            for time, q in zip(times, Q, strict=True)]  # fmt: skip
    path.write_text("\n".join([f"{head};q_w;q_x;q_y;q_z", *rows]) + "\n")
    return path


@pytest.mark.parametrize(
    ("head", "seconds"), [("time_h", 3600.0), ("time [min]", 60.0), ("time [d]", 86_400.0), ("time [ms]", 1e-3)]
)
def test_the_unit_of_time_is_taken_as_in_a_log(tmp_path: Path, head: str, seconds: float) -> None:
    found = read_poses(in_table(tmp_path / "ref.csv", head, [f"{t / seconds:.14f}" for t in T]))
    assert np.abs(found.stamps_ns - np.rint(T * 1e9)).max() <= 10
    table = {head: T / seconds, **{f"q_{part}": Q[:, k] for k, part in enumerate("wxyz")}}
    pq.write_table(pa.table(table), tmp_path / "ref.parquet")
    assert np.abs(read_poses(tmp_path / "ref.parquet").stamps_ns - np.rint(T * 1e9)).max() <= 10


def test_times_as_people_write_them_are_read_as_in_a_log(tmp_path: Path) -> None:
    path = tmp_path / "ref.csv"
    start = np.datetime64("2026-06-13T10:00:00", "ns").astype(np.int64)
    found = read_poses(in_table(path, "date;time", [f"13.06.2026;10:00:{t:06.3f}" for t in T]))
    assert np.array_equal(found.stamps_ns, start + np.rint(T * 1e9).astype(np.int64))
    found = read_poses(in_table(path, "time", [f"{46186 + (36_000 + t) / 86_400:.11f}" for t in T]))
    assert np.abs(found.stamps_ns - start - T * 1e9).max() < 10_000
    assert [w.code for w in found.warnings] == ["time-unit-guessed"]
    found = read_poses(in_table(path, "time [ms]", [f"{1e6 + t * 1e3:,.1f}".replace(",", "'") for t in T]))
    assert np.array_equal(found.stamps_ns, np.rint((1e3 + T) * 1e9))
    assert [w.code for w in found.warnings] == ["thousands-separators"]
    found = read_poses(in_table(path, "t", [f"{t:.2f}".replace(".", ",") for t in T], ","))
    assert np.array_equal(found.stamps_ns, np.rint(T * 1e9))
    np.testing.assert_allclose(found.q, Q, atol=1e-8)


@pytest.mark.parametrize(
    ("written", "says"),
    [
        (lambda t: "x" if round(t * 100) % 40 == 7 else f"10:00:{t:06.3f}", "no readable time in 5 of 200 rows"),
        (lambda t: "x" if round(t * 100) % 40 == 7 else f"{t:.2f}", "no readable time in 5 of 200 rows"),
        (lambda t: f"01/06/2026 10:00:{t:06.3f}", "day or month first.*write dates as 2026-06-01"),
        (lambda t: f"{t / 3600:.12f}", "unit of time cannot be told"),
    ],
)
def test_times_that_are_lost_or_unclear_are_refused(tmp_path: Path, written: Callable[[float], str], says: str) -> None:
    with pytest.raises(AttestError, match=says):
        read_poses(in_table(tmp_path / "ref.csv", "time", [written(t) for t in T]))


def test_text_of_parquet_that_is_no_time_is_refused(tmp_path: Path) -> None:
    cells = ["x" if k % 40 == 7 else f"10:00:{t:06.3f}" for k, t in enumerate(T)]
    table = {"time": cells, **{f"q_{part}": Q[:, k] for k, part in enumerate("wxyz")}}
    pq.write_table(pa.table(table), tmp_path / "ref.parquet")
    with pytest.raises(AttestError, match="no readable time in 5 of 200 rows"):
        read_poses(tmp_path / "ref.parquet")


def test_a_channel_of_a_table_is_refused(tmp_path: Path) -> None:
    write_track([columns()], META, tmp_path / "track.csv", "csv")
    with pytest.raises(AttestError, match="--channel is for MCAP"):
        read_poses(tmp_path / "track.csv", "/odom")


def test_identity_and_origin_in_every_row_say_none(tmp_path: Path) -> None:
    path = tmp_path / "gps.tum"
    path.write_text("".join(f"{t:.2f} {p[0]} {p[1]} {p[2]} 0 0 0 1\n" for t, p in zip(T, P, strict=True)))
    found = read_poses(path)
    assert np.isnan(found.q).all()
    assert {w.code for w in found.warnings} == {"no-attitude"}


def test_a_bare_track_knows_its_segments(tmp_path: Path) -> None:
    path = tmp_path / "track.parquet"
    write_track([columns()], META, path, "parquet")
    result, found = read_judged(path)
    assert [(s["index"], s["kind"]) for s in result.segments] == [(1, "stop"), (2, "motion")]
    assert result.segments[1]["start_s"] == pytest.approx(1.0)
    assert result.report["heading"] == "magnetic"
    assert np.array_equal(found.stamps_ns, STAMPS)
