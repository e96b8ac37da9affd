"""Tracks of poses -> ``Poses``: attest's own in every format, their truth, TUM, EuRoC, other tables, MCAP."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pv
import pyarrow.parquet as pq

from ..errors import AttestError
from ..evaluate.records import Claims, Poses
from ..maths import rotation
from ..records import Array, Bools, Ints, Result, Warn
from ..settings.table import Table as TableSettings
from ..settings.units import unit
from . import format_of, parquet_log, pose_messages, text_stamps
from .columns import recognise, time_column, words_of
from .csv_log import BLANKS, sniff, timed
from .dialect import Dialect
from .result import read_result
from .tables import MAX_BAD_SHARE, check_size, times_of
from .text_numbers import plain

ATTITUDE, POSITION = ("q_w", "q_x", "q_y", "q_z"), ("position_x", "position_y", "position_z")
SIGMAS = (
    *(f"sigma_att_{axis}_deg" for axis in "xyz"), *(f"sigma_position_{axis}_m" for axis in "xyz"),
    "sigma_heading_relative_deg",
)  # fmt: skip
TUM = ("timestamp", *POSITION, "q_x", "q_y", "q_z", "q_w")
TRUTH_WORDS = frozenset({"truth", "true", "gt", "groundtruth", "ground", "reference", "ref", "opt"})
"""Words in front of a column that make it the truth of a log that has its own columns too."""

MOVING = ("moving", "movement", "truth_moving")
TRACKS = ("parquet", "csv", "mcap", "tum")
"""Formats of a result's track, the one with the most in it first."""

HEADINGS = ("absolute", "magnetic", "relative")
NORM_TOLERANCE = 0.01  # a quaternion further from unit length is none
HINT = (
    "a reference has timestamp_ns (or time in s) with q_w,q_x,q_y,q_z, position_x_m,position_y_m,position_z_m or both"
)
ENU_FROM_NED = np.array([0.0, np.sqrt(0.5), np.sqrt(0.5), 0.0])
FLU_FROM_FRD = np.array([0.0, 1.0, 0.0, 0.0])
_COMMENT = re.compile(r"\s*#\s*([a-z0-9_]+):\s*(.*)")


@dataclass(frozen=True, slots=True)
class Table:
    """Columns as found, with the facts written beside them; ``kind`` as in ``Poses``, ``dialect`` of text."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    columns: pa.Table
    facts: Mapping[str, str]
    kind: str
    dialect: Dialect | None = None


def read_poses(path: Path, channel: str | None = None) -> Poses:
    """Read a track of poses.

    Parameters
    ----------
    path : Path
        Parquet or CSV with columns of ``track`` or names like them (truth_qw, p_RS_R_x ...), TUM, EuRoC ground truth,
        MCAP with odometry, poses or orientations.
    channel : str, optional
        The channel of an MCAP file that has several.

    Raises
    ------
    AttestError
        If the file holds no track, columns are missing or hold something else.
    """
    found = format_of(path)
    if found == "mcap":
        poses, ned = pose_messages.read(path, channel)
        return _finished(path, poses, ned=ned)
    if channel is not None:
        raise AttestError(f"{path}: has no channels: --channel is for MCAP", "leave it out")
    if found not in {"csv", "parquet"}:
        raise AttestError(f"{path}: no reference is read from this kind of file", "name its track as MCAP, TUM or CSV")
    table = _parquet(path) if found == "parquet" else _tum(path) if _is_tum(path) else _text(path)
    return _poses(path, table)


def read_judged(path: Path) -> tuple[Result, Poses]:
    """Read what is to be judged: a result folder with its track, or a track alone.

    A track alone comes with a ``Result`` that holds what a page needs: its name, its times, its segments.
    """
    if not path.is_dir():
        try:
            poses = read_poses(path)
        except AttestError as fault:
            raise AttestError(fault.message, "the result is the folder that attest smooth wrote, or a track") from None
        return _bare(path, poses), poses
    result = read_result(path)
    track = next((path / f"track.{name}" for name in TRACKS if (path / f"track.{name}").is_file()), None)
    if track is None:
        raise AttestError(f"{path}: no track in this folder", "run attest smooth again")
    heading = str(result.report.get("heading") or "")
    return result, replace(read_poses(track), heading=heading if heading in HEADINGS else "", shared_world=True)


def _bare(path: Path, poses: Poses) -> Result:
    """Return what is known of a track without its result folder."""
    t = (poses.stamps_ns - poses.stamps_ns[0]) * 1e-9
    segments = []
    if poses.moving is not None:
        edges = [0, *(np.flatnonzero(np.diff(poses.moving)) + 1).tolist(), len(t) - 1]
        first = 1 + bool(poses.moving[0])
        for k, (start, end) in enumerate(pairwise(edges)):
            kind = "motion" if poses.moving[start] else "stop"
            segments.append({"index": first + k, "kind": kind, "start_s": float(t[start]), "end_s": float(t[end])})
    report = {"input": {"files": [{"name": path.name}], "duration_s": float(t[-1])}, "heading": poses.heading}
    return Result(path.parent, report, {"t_s": t}, {}, tuple(segments))


def _parquet(path: Path) -> Table:
    try:
        file = pq.ParquetFile(path, page_checksum_verification=True)
        schema = file.schema_arrow
        check_size(path, file.metadata.num_rows, len(schema.names))
        flat = [name for name in schema.names if not pa.types.is_nested(schema.field(name).type)]
        columns = file.read(flat)
    except (pa.ArrowException, OSError) as error:
        reason = str(error).splitlines()[0]
        raise AttestError(
            f"{path}: damaged Parquet: {reason}", "copy it again; a damaged page cannot be mended"
        ) from None
    facts = {k.decode("utf-8", "replace"): v.decode("utf-8", "replace") for k, v in (schema.metadata or {}).items()}
    units = [(schema.field(name).metadata or {}).get(b"unit", b"").decode("utf-8", "replace") for name in flat]
    return Table(tuple(flat), tuple(units), columns, facts, "track" if "attest_version" in facts else "table")


def _text(path: Path) -> Table:
    """Read a table with a header; every cell as text."""
    dialect = sniff(path)
    columns = _cells(path, path, dialect.delimiter, dialect.names, dialect.skip)
    facts = _comments(path)
    euroc = any("p_RS_R" in name or "q_RS" in name for name in dialect.names)
    kind = "track" if "attest_version" in facts else "euroc" if euroc else "table"
    return Table(tuple(dialect.names), tuple(dialect.units), columns, facts, kind, dialect)


def _cells(path: Path, source: Path | io.BytesIO, delimiter: str, names: Sequence[str], skip: int) -> pa.Table:
    """Read cells as text, columns named by their number."""
    numbers = [str(k) for k in range(len(names))]
    try:
        return pv.read_csv(
            source, pv.ReadOptions(skip_rows=skip, column_names=numbers), pv.ParseOptions(delimiter=delimiter),
            pv.ConvertOptions(
                column_types=dict.fromkeys(numbers, pa.string()), null_values=BLANKS, strings_can_be_null=True
            ),
        )  # fmt: skip
    except (pa.ArrowInvalid, OSError) as error:
        raise AttestError(f"{path}: cannot be read: {str(error).splitlines()[0]}", "is it one table?") from None


def _is_tum(path: Path) -> bool:
    """Tell whether the first line that is no comment is eight numbers between blanks."""
    with path.open(encoding="utf-8", errors="replace") as stream:
        line = next((line for line in stream if line.strip() and not line.lstrip().startswith("#")), "")
    cells = line.split()
    try:
        return len(cells) == len(TUM) and all(np.isfinite(float(cell)) for cell in cells)
    except ValueError:
        return False


def _tum(path: Path) -> Table:
    lines = [" ".join(line.split()) for line in path.read_text(encoding="utf-8", errors="replace").splitlines()]
    rows = "\n".join(line for line in lines if line and not line.startswith("#"))
    columns = _cells(path, io.BytesIO(rows.encode()), " ", TUM, 0)
    facts = _comments(path)
    if any(line.startswith("# no position") for line in lines):  # attest writes zeros where it has none
        columns = columns.select([k for k in columns.column_names if TUM[int(k)] not in POSITION])
    names = [TUM[int(k)] for k in columns.column_names]
    units = ("s", *("",) * (len(names) - 1))
    return Table(tuple(names), units, columns, facts, "tum", Dialect(" ", ".", 0, names, list(units), []))


def _comments(path: Path) -> dict[str, str]:
    """Return what ``# key: value`` lines at the top of a text say."""
    found = {}
    with path.open(encoding="utf-8", errors="replace") as stream:
        for line in stream:
            match = _COMMENT.match(line)
            if match is not None:
                found[match[1]] = match[2].strip()
            elif not line.lstrip().startswith("#"):
                break
    return found


def _poses(path: Path, table: Table) -> Poses:
    """Find the columns of a track by name, and read them."""
    if time_column(table.names, table.units) is None:
        raise AttestError(f"{path}: no time column among {_some(table.names)}", HINT)
    chosen = _choose(path, table)
    if not chosen:
        raise AttestError(f"{path}: no attitude and no position among {_some(table.names)}", HINT)
    stamps_ns, known, told = _stamps(path, table)
    sigmas = [k for k, name in enumerate(table.names) if name in SIGMAS]
    table, separated = _plain(path, table, [*(index for index, _ in chosen.values()), *sigmas])
    floats = {name: _floats(path, table, index) * scale for name, (index, scale) in chosen.items()}
    exact = {table.names[k]: _floats(path, table, k) for k in sigmas}
    moving = next((_bools(path, table, k) for k, name in enumerate(table.names) if name.strip() in MOVING), None)
    order = np.argsort(stamps_ns, kind="stable")
    order = order[known[order]]
    keep = order[np.concatenate([[True], np.diff(stamps_ns[order]) > 0])] if order.size else order
    facts = table.facts
    plain = table.kind in {"track", "table"} or "attest_version" in facts
    poses = Poses(
        source=path.name, kind=table.kind, stamps_ns=stamps_ns[keep],
        q=_stack(floats, ATTITUDE, stamps_ns.size)[keep], position=_stack(floats, POSITION, stamps_ns.size)[keep],
        moving=None if moving is None else moving[keep],
        heading=facts.get("heading", "") if facts.get("heading", "") in HEADINGS else "", shared_world=plain,
        claims=_claims(stamps_ns[keep], {name: v[keep] for name, v in exact.items()}),
        warnings=(
            *told, *separated, *_left_out(path, stamps_ns.size - keep.size, in_order=bool(np.all(np.diff(order) > 0)))
        ),
    )  # fmt: skip
    return _finished(path, poses, ned=facts.get("frame", "").upper().startswith("NED"))


def _left_out(path: Path, count: int, *, in_order: bool) -> tuple[Warn, ...]:
    """Say what was wrong with the order of the rows."""
    told = []
    if not in_order:
        told.append(Warn("rows-out-of-order", f"{path.name}: rows are out of order; sorted by time"))
    if count:
        told.append(Warn("rows-dropped", f"{path.name}: {count} rows dropped: no time, or that of another row"))
    return tuple(told)


def _choose(path: Path, table: Table) -> dict[str, tuple[int, float]]:
    """Return canonical name -> index and factor to SI; columns named truth win over others."""
    best: dict[str, tuple[int, int, float]] = {}
    for index, name in enumerate(table.names):
        words, _ = words_of(name)
        rest = [word for word in words if word not in TRUTH_WORDS]
        column = recognise(index, name) if len(rest) == len(words) else recognise(index, "_".join(rest))
        if column is None or column.canonical not in {*ATTITUDE, *POSITION} or column.instance:
            continue
        rank = column.rank - (100 if len(rest) < len(words) else 0)
        if column.canonical not in best or rank < best[column.canonical][0]:
            scale = _metres(path, name, column.unit or table.units[index]) if column.canonical in POSITION else 1.0
            best[column.canonical] = (rank, index, scale)
    for group in (ATTITUDE, POSITION):
        missing = [name for name in group if name not in best]
        if 0 < len(missing) < len(group):
            beside = table.names[next(best[name][1] for name in group if name in best)]
            raise AttestError(f"{path}: column {missing[0]} is missing beside {beside.strip()!r}", HINT)
    return {name: (index, scale) for name, (_, index, scale) in best.items()}


def _metres(path: Path, name: str, stated: str) -> float:
    try:
        scale, dims = unit(stated or "m")
    except ValueError:
        scale, dims = 0.0, ()
    if tuple(dims) != (0, 1, 0, 0, 0):
        raise AttestError(f"{path}: column {name.strip()!r}: {stated!r} is no unit of length", "name it in m")
    return scale


def _floats(path: Path, table: Table, index: int) -> Array:
    """Return a column as numbers, NaN where blank."""
    column = table.columns.column(index)
    try:
        if pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
            column = pc.utf8_trim_whitespace(column)
        return np.asarray(pc.cast(column, pa.float64()).to_numpy(), dtype=np.float64)
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as error:
        name = table.names[index].strip()
        raise AttestError(f"{path}: column {name!r} holds no numbers: {str(error).splitlines()[0]}") from None


def _bools(path: Path, table: Table, index: int) -> Bools:
    """Return a column of true and false, also as 1 and 0."""
    column = table.columns.column(index)
    if pa.types.is_boolean(column.type):
        return np.asarray(pc.fill_null(column, fill_value=False).to_numpy(zero_copy_only=False), dtype=np.bool_)
    if pa.types.is_string(column.type):
        text = pc.utf8_lower(pc.fill_null(column, ""))
        return np.asarray(pc.is_in(text, pa.array(["true", "1", "1.0"])).to_numpy(zero_copy_only=False), dtype=np.bool_)
    return np.asarray(np.nan_to_num(_floats(path, table, index)) != 0.0, dtype=np.bool_)


def _stamps(path: Path, table: Table) -> tuple[Ints, Bools, tuple[Warn, ...]]:
    """Return stamps in ns, where they are known, and what should be known of them: as the readers of logs read them."""
    layout, every = times_of(path, table.names, table.units, TableSettings()), np.zeros(table.columns.num_rows, bool)
    if table.dialect is not None:
        layout = timed(layout, table.columns)
        stamps_ns, valid, told = text_stamps.stamps_of(path, table.dialect, layout, table.columns, every)
    else:
        times = {column.index: table.columns.column(column.index) for column in layout.times}
        stamps_ns, valid, told = parquet_log.stamps_of(path, layout, times, every)
    return stamps_ns, np.isfinite(valid), told


def _plain(path: Path, table: Table, indices: Sequence[int]) -> tuple[Table, tuple[Warn, ...]]:
    """Return columns of text as plain numbers, and say which had thousands separators."""
    columns, told = table.columns, tuple[Warn, ...]()
    if table.dialect is None:
        return table, ()
    for index in indices:
        cells, grouped = plain(path, table.names[index], columns.column(index), table.dialect.decimal)
        columns, told = columns.set_column(index, columns.column_names[index], cells), told + grouped
    return replace(table, columns=columns), told


def _stack(columns: Mapping[str, Array], names: Sequence[str], rows: int) -> Array:
    """Return columns side by side (n, k); NaN where they are missing."""
    blank = np.full(rows, np.nan)
    return np.stack([columns.get(name, blank) for name in names], axis=1)


def _claims(stamps_ns: Ints, sigma: Mapping[str, Array]) -> Claims | None:
    """Return what the sigmas of a track claim, without correlations."""
    if not all(f"sigma_att_{axis}_deg" in sigma for axis in "xyz"):
        return None
    variance = {name: values**2 for name, values in sigma.items()}
    attitude = _stack(variance, SIGMAS[:3], stamps_ns.size) * np.radians(1.0) ** 2
    position = _stack(variance, SIGMAS[3:6], stamps_ns.size)
    relative = _stack(variance, SIGMAS[6:], stamps_ns.size)[:, 0] * np.radians(1.0) ** 2
    return Claims(stamps_ns, attitude[:, :, None] * np.eye(3), position[:, :, None] * np.eye(3), relative, full=False)


def _finished(path: Path, poses: Poses, *, ned: bool) -> Poses:
    """Normalise the quaternions, turn NED to ENU, and refuse what is no track."""
    if not poses.stamps_ns.size:
        raise AttestError(f"{path}: the track has no rows", "was it cut short?")
    norm = np.linalg.norm(poses.q, axis=1)
    given = np.isfinite(norm) & (norm != 0.0)  # all zero: "no orientation"
    good = given & (np.abs(norm - 1.0) <= NORM_TOLERANCE)
    if np.sum(given & ~good) > MAX_BAD_SHARE * max(int(given.sum()), 1):
        raise AttestError(
            f"{path}: {np.sum(given & ~good)} of {given.sum()} quaternions are not of unit length",
            "are the columns right?",
        )
    q = np.where(good[:, None], poses.q / np.where(good, norm, 1.0)[:, None], np.nan)
    poses = _without_stand_ins(replace(poses, q=q))
    if not (good.any() or np.isfinite(poses.position).all(axis=1).any()):
        raise AttestError(f"{path}: every attitude and position is blank", HINT)
    return _to_enu(poses) if ned else poses


def _without_stand_ins(poses: Poses) -> Poses:
    """Blank an attitude that is the identity, a position that is the origin, in every row: formats that must have both
    say "none" so.
    """
    if poses.kind in {"track", "table"}:
        return poses
    q, position, told = poses.q, poses.position, list(poses.warnings)
    if np.all(q[np.isfinite(q).all(axis=1)] == [1.0, 0.0, 0.0, 0.0]):
        told += [Warn("no-attitude", f"{poses.source}: every attitude is the identity: taken as none")] * bool(
            np.isfinite(q).any()
        )
        q = np.full_like(q, np.nan)
    if np.all(position[np.isfinite(position).all(axis=1)] == 0.0):
        told += [Warn("no-position", f"{poses.source}: every position is the origin: taken as none")] * bool(
            np.isfinite(position).any()
        )
        position = np.full_like(position, np.nan)
    return replace(poses, q=q, position=position, warnings=tuple(told))


def _to_enu(poses: Poses) -> Poses:
    """Turn a track in NED world and FRD body axes to ENU and FLU."""
    q = rotation.multiply(rotation.multiply(ENU_FROM_NED, poses.q), FLU_FROM_FRD)
    R = rotation.matrix(ENU_FROM_NED)
    claims = poses.claims
    if claims is not None:
        claims = replace(claims, attitude=R @ claims.attitude @ R.T, position=R @ claims.position @ R.T)
    return replace(poses, q=q, position=poses.position @ R.T, claims=claims)


def _some(names: Sequence[str], count: int = 8) -> str:
    shown = ", ".join(repr(name.strip()[:40]) for name in names[:count])
    return shown + (f" and {len(names) - count} more" if len(names) > count else "")
