"""Attitude and position of a simulated rover (S2: accelerometer bias of 0.02 m/s^2) by ``--filter navigation``.

Two motions of 60-300 s (short: 20-40 s) between stops, sun at the stops, and what the row names. Attitude RMS and
displacement over each motion, RMS over drives; the share of its length where wheels measure it; NEES of attitude and
position in motion (3 expected). GPS of 1 m at 0.2 Hz is silent for 60 s in the middle of the first motion: error 30 s
into that, forward only and smoothed. Positions are held against the truth absolutely where there is GPS, else from the
start.

Run: PYTHONPATH=. python benchmarks/accuracy/rover_position.py [--drives 10] [--first-seed 1000]
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tests"))

from pymap3d import geodetic2enu  # noqa: E402 (path above)
from support.drives import effective, nees  # noqa: E402

from attest_cli.estimate import Estimate, estimate  # noqa: E402
from attest_cli.maths import rotation  # noqa: E402
from attest_cli.prepare import prepare  # noqa: E402
from attest_cli.records import Log, Segmentation  # noqa: E402
from attest_cli.segment import find_segments  # noqa: E402
from attest_cli.simulate import RoverOptions, simulate_rover  # noqa: E402
from attest_cli.simulate.rover import ORIGIN, rover_drive  # noqa: E402

Array = NDArray[np.float64]
OUTAGE_S = 60.0
ROWS = {
    "stops only, short": {"motion_s": (20.0, 40.0)},
    "stops only": {},
    "compass": {"compass": True},
    "odometry": {"odometry": True},
    "odometry, short": {"odometry": True, "motion_s": (20.0, 40.0)},
    "GPS": {"gps": True},
    "GPS, outage": {"gps": True},
}


def solved(
    options: RoverOptions, *, outage: bool, smoother: str = "two-filter"
) -> tuple[Log, Segmentation, Estimate, float]:
    """Return a drive smoothed (``none``: forward only), and the middle of its outage."""
    made = simulate_rover(options)
    settings = effective(made, {"smoothing": {"filter": "navigation", "smoother": smoother}})
    log = prepare([made.log], settings)
    segmentation = find_segments(log, settings)
    motion = segmentation.motions[0]
    middle = 0.5 * (motion.start + motion.end)
    if outage:
        fixes = log.fixes["gps"]
        shown = np.abs(fixes.t - middle) > OUTAGE_S / 2
        log = replace(log, fixes={**log.fixes, "gps": replace(fixes, t=fixes.t[shown], values=fixes.values[shown],
                      sigma=None if fixes.sigma is None else fixes.sigma[shown])})  # fmt: skip
    return log, segmentation, estimate(log, segmentation, settings), middle


def row(options: RoverOptions, *, outage: bool) -> list[float]:
    """Judge one drive: mean squares of attitude and displacement, NEES, errors in the outage."""
    log, segmentation, est, middle = solved(options, outage=outage)
    found, truth = est.smoothed, rover_drive(options).at(est.smoothed.t)
    assert found.p is not None
    assert found.P_vp is not None
    moving, begin = truth.moving, np.zeros(3)
    if options.gps:  # place zero is the first fix
        lat, lon, height = log.fixes["gps"].values[0]
        first = np.array(geodetic2enu(np.degrees(lat), np.degrees(lon), height, *ORIGIN))
        begin = first
    error = truth.position_n - (truth.position_n[0] if not options.gps else begin) - found.p
    attitude = rotation.log_quaternion(rotation.multiply(rotation.conjugate(found.q), truth.q_nb))
    ends = [(int(np.searchsorted(found.t, m.start)), int(np.searchsorted(found.t, m.end)) - 1)
            for m in segmentation.motions]  # fmt: skip
    moved = np.array([np.linalg.norm(error[b] - error[a]) for a, b in ends])
    length = [np.sum(np.linalg.norm(np.diff(truth.position_n[a : b + 1], axis=0), axis=1)) for a, b in ends]
    ahead = solved(options, outage=outage, smoother="none")[2].smoothed if outage else found
    assert ahead.p is not None
    k = int(np.searchsorted(found.t, middle))
    late = truth.position_n[k] - (begin if options.gps else truth.position_n[0]) - ahead.p[k]
    return [
        float(np.mean(np.sum(attitude[moving] ** 2, axis=1))), float(np.mean(moved**2)),
        float(np.mean((moved / length) ** 2)), float(nees(attitude[moving], found.P[moving, :3, :3]).mean()),
        float(nees(error[moving], found.P_vp[moving, 3:, 3:]).mean()), float(late @ late), float(error[k] @ error[k]),
    ]  # fmt: skip


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drives", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=1000)
    parser.add_argument("--only", choices=ROWS)
    wanted = parser.parse_args()
    print(f"{'':<20}{'attitude':>9}{'displacement':>14}{'':>8}{'NEES':>9}{'NEES':>9}{'in the outage, m':>20}")
    print(f"{'':<20}{'mrad':>9}{'m':>14}{'%':>8}{'attitude':>9}{'position':>9}{'forward':>11}{'smoothed':>9}")
    for name, what in ROWS.items():
        if wanted.only not in {None, name}:
            continue
        start = time.process_time()
        seeds = range(wanted.first_seed, wanted.first_seed + wanted.drives)
        rows = np.array([
            row(RoverOptions(seed=seed, scenario="S2", **what), outage="outage" in name) for seed in seeds  # type: ignore[arg-type]
        ])  # fmt: skip
        mean = rows.mean(axis=0)
        cells = f"{1e3 * np.sqrt(mean[0]):>9.2f}{np.sqrt(mean[1]):>14.2f}{100 * np.sqrt(mean[2]):>8.2f}"
        tail = f"{np.sqrt(mean[5]):>11.2f}{np.sqrt(mean[6]):>9.2f}" if "outage" in name else ""
        cost = f"{time.process_time() - start:.0f} s CPU"
        print(f"{name:<20}{cells}{mean[3]:>9.2f}{mean[4]:>9.2f}{tail}   {cost}", flush=True)


if __name__ == "__main__":
    main()
