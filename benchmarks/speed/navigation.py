"""CPU time of one pass of the navigation smoother over an hour of nodes 0.1 s apart, with all covariances.

A drive is linearised by the navigation filter (15 core states, and with what its sensors call for), then its forward
pass and its backward pass are run alone, over and over, and scaled to 36 000 nodes.

    PYTHONPATH=. python benchmarks/speed/navigation.py [--runs 3]
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tests"))

from support.drives import effective  # noqa: E402 (path above)

from attest_cli.filters import Drive  # noqa: E402
from attest_cli.filters.navigation import solve  # noqa: E402
from attest_cli.filters.navigation.model import linearise  # noqa: E402
from attest_cli.filters.navigation.rounds import navigate  # noqa: E402
from attest_cli.maths import adjoint  # noqa: E402
from attest_cli.nodes.noise import find_noise  # noqa: E402
from attest_cli.prepare import prepare  # noqa: E402
from attest_cli.segment import find_segments  # noqa: E402
from attest_cli.simulate import RoverOptions, simulate_rover  # noqa: E402
from attest_cli.world import find_world  # noqa: E402

HOUR = 36_000
CASES = {
    "core": ({}, {"gyro_scale_sigma": 0.0, "accel_scale_sigma": 0.0}),
    "with scale, wheels, fixes": ({"odometry": True, "gps": True}, {}),
}


def main() -> None:
    """Print a line per case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=3)
    wanted = parser.parse_args()
    for name, (sensors, imu) in CASES.items():
        made = simulate_rover(RoverOptions(seed=1, motions=2, motion_s=(100.0, 120.0), **sensors))
        settings = effective(made, {"imu": imu})
        log = prepare([made.log], settings)
        segments = find_segments(log, settings)
        done = navigate(Drive(log, segments, find_world(log, settings), find_noise(log, segments, settings), settings))
        problem, form = done.problem, done.problem.layout
        lin = linearise(problem.inertial, form, done.found.at)
        rows = solve.stack(problem.aids, form, done.found.at)
        spent = []
        for _ in range(wanted.runs):
            start = time.process_time()
            found = solve.forward(problem.prior[1], lin, rows, np.zeros(form.size))
            middle = time.process_time()
            adjoint.smooth(found)
            spent.append((middle - start, time.process_time() - middle))
        forward, backward = np.array(spent).min(axis=0) * HOUR / len(rows.r)
        print(
            f"{name}: {form.size} states, {len(rows.r)} nodes; "
            f"an hour: forward {forward:.1f} s, backward {backward:.1f} s CPU"
        )


if __name__ == "__main__":
    main()
