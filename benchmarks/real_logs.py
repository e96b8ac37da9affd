"""What attest makes of every real log: a Markdown table of roles, units, rate, mounting, verdict and warnings.

python benchmarks/real_logs.py                         all of ../shared/data beside the repository
python benchmarks/real_logs.py FILE ... --drive A B    some files; the files of one drive; --end 200: their start
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
DATA = ROOT.parent / "shared" / "data"
DRIVES = (
    ("kitti_gtsam/imu.parquet", "kitti_gtsam/gps.parquet"),
    ("euroc_mh01/imu0.parquet", "euroc_mh01/leica0.parquet"),
    *((f"wid/trial{n}_IMU1.parquet", f"wid/trial{n}_GNSS.parquet") for n in ("00", "02", "03", "04")),
)
"""Files of one drive, beside each file on its own."""
LOGS = {".csv", ".txt", ".mcap", ".bag", ".db3", ".ulg", ".parquet"}
HEAD = (
    "log",
    "format",
    "used as: channel (rows, unit)",
    "rate",
    "up, axes",
    "verdict",
    "warnings, or why refused",
    "s",
)


def row(paths: Sequence[Path], end_s: float | None = None) -> tuple[str, ...]:
    """Read, prepare and smooth one drive; say what was found, or the line that refuses it."""
    from attest_cli.errors import AttestError
    from attest_cli.pipeline import appraise
    from attest_cli.prepare import prepare
    from attest_cli.readers import format_of, read
    from attest_cli.report.build import build
    from attest_cli.segment import find_segments
    from attest_cli.settings import load_settings

    start, shown = time.process_time(), ["?", "", "", ""]
    try:
        shown[0] = format_of(paths[0])
        effective = load_settings(None, paths[0], {"time.end_s": end_s} if end_s else {})
        recordings = tuple(read(path, effective.settings) for path in paths)
        log = prepare(recordings, effective.settings)
        shown[1] = "; ".join(roles(recordings, effective.settings))
        shown[2] = f"{(len(log.imu.t) - 1) / log.coverage['seconds_used']:.4g} Hz"
        segmentation = find_segments(log, effective.settings)
        run, _ = appraise(paths, recordings, log, segmentation, effective, lambda *_: None)
        report = build(run)
        shown[3] = mounting(log, report)
        told = list(dict.fromkeys(warning["code"] for warning in report["warnings"]))
        codes = told + [c["name"] for c in report["checks"] if c["status"] != "PASS" and c["name"] not in told]
        ended = (f"{report['verdict']} ({report['heading']})", ", ".join(codes) or "none")
    except AttestError as fault:
        ended = ("refused", str(fault))
    return (" + ".join(map(name, paths)), *shown, *ended, f"{time.process_time() - start:.0f}")


def roles(recordings: Sequence[Any], settings: Any) -> Iterator[str]:
    """Which channel plays which role, its rows, and the unit in which it was taken."""
    from attest_cli.prepare.canonical import in_canonical_units, taken_units
    from attest_cli.prepare.roles import choose

    cast = choose(recordings, settings).channels
    converted, _ = in_canonical_units(list(cast.values()), settings)
    for (role, channel), other in zip(cast.items(), converted, strict=True):
        stated = {column: unit for column, unit in channel.units.items() if unit and column in channel.values}
        guessed = {column: f"{unit}, not stated" for column, unit in taken_units(channel, other).items()}
        units = "; ".join(dict.fromkeys((guessed | stated).values())) or "none stated"
        yield f"{role}: {channel.name} ({channel.stamps_ns.size}, {units})"


def mounting(log: Any, report: Any) -> str:
    """Which axis of the IMU points up, how far that leans, and in whose axes the track is."""
    import numpy as np

    force = np.median(log.imu.accel_b, axis=0)
    axis = int(np.argmax(np.abs(force)))
    leans = np.degrees(np.arccos(np.abs(force[axis]) / np.linalg.norm(force)))
    return f"{'+-'[int(force[axis] < 0.0)]}{'xyz'[axis]} ({leans:.0f}° off), {report['body']['axes']}"


def name(path: Path) -> str:
    """Return the path as it is known in the folder of data."""
    path = path.resolve()
    return str(path.relative_to(DATA.resolve())) if path.is_relative_to(DATA.resolve()) else path.name


def main() -> None:
    """Print the table, row by row."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--drive", nargs="+", action="append", type=Path, default=[])
    parser.add_argument("--end", type=float, help="the first seconds of each only")
    told = parser.parse_args()
    os.nice(10)
    logs = [[path] for path in told.files] + told.drive
    if not logs:
        logs = [[path] for path in sorted(DATA.rglob("*")) if path.suffix in LOGS]
        logs += [[DATA / file for file in drive] for drive in DRIVES]
    for cells in chain((HEAD, ("---",) * len(HEAD)), (row(log, told.end) for log in logs)):
        print("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |", flush=True)


if __name__ == "__main__":
    main()
