"""The stop detector on simulated drives: stops found, false stops and edge errors per variant, on seeds of your choice.

Run: PYTHONPATH=. python benchmarks/accuracy/detector.py --seeds 300 320 [--blind] [--odometry] [--rate 30]
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from attest_cli.prepare import prepare
from attest_cli.records import Segment
from attest_cli.segment import find_segments
from attest_cli.settings import Settings
from attest_cli.simulate import VARIANTS, RoverOptions, simulate_rover
from attest_cli.simulate.rover import Variant

EDGE_S = 1.0  # a stop counts as found if both edges are nearer than this
COLUMNS = ("found", "false", "median edge s", "worst", "motion as stop %", "CPU s")
HEADER = f"{'variant':<18}" + "".join(f"{name:>{len(name) + 4}}" for name in COLUMNS)


def match(stops: tuple[Segment, ...], true: np.ndarray) -> tuple[list[float], int]:
    """Edge errors of the stops that were found (two each), and the number of stops that are none."""
    errors: list[float] = []
    free = list(stops)
    for start, end in true:
        for stop in free:
            edges = [abs(stop.start - start), abs(stop.end - end)]
            if max(edges) < EDGE_S:
                errors += edges
                free.remove(stop)
                break
    return errors, len(free)


def row(variant: Variant, options: argparse.Namespace) -> str:
    """One line of the table: all seeds of a variant."""
    errors: list[float] = []
    total = false = wrong = moving = 0
    cpu = 0.0
    for seed in range(*options.seeds):
        wanted = RoverOptions(
            seed, rate_hz=options.rate, motions=options.motions, variant=variant, odometry=options.odometry
        )
        simulation = simulate_rover(wanted)
        settings = Settings.model_validate(simulation.settings)
        if options.blind:
            settings = Settings.model_validate({"imu": {"mounting": [1, 0, 0, 0]}})
        log = prepare([simulation.log], settings)
        begin = time.process_time()
        found = find_segments(log, settings)
        cpu += time.process_time() - begin
        edges, more = match(found.stops, simulation.stops)
        errors += edges
        false += more
        total += len(simulation.stops)
        wrong += sum(int(simulation.truth["moving"][s.first : s.last].sum()) for s in found.stops)
        moving += int(simulation.truth["moving"].sum())
    score = f"{len(errors) // 2}/{total}"
    edge = (np.median(errors), max(errors)) if errors else (np.nan, np.nan)
    cells = (score, f"{false}", f"{edge[0]:.2f}", f"{edge[1]:.2f}", f"{100 * wrong / moving:.2f}", f"{cpu:.2f}")
    return f"{variant:<18}" + "".join(f"{cell:>{len(name) + 4}}" for cell, name in zip(cells, COLUMNS, strict=True))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", nargs=2, type=int, default=(100, 110), metavar=("FIRST", "END"))
    parser.add_argument("--motions", type=int, default=3)
    parser.add_argument("--rate", type=float, default=100.0, help="IMU rate, Hz")
    parser.add_argument("--blind", action="store_true", help="do not tell the detector the sensors' noise")
    parser.add_argument("--odometry", action="store_true", help="give the log wheel odometry (3 cm/s, 10 Hz)")
    options = parser.parse_args()
    print(HEADER)
    for variant in VARIANTS:
        print(row(variant, options), flush=True)


if __name__ == "__main__":
    main()
