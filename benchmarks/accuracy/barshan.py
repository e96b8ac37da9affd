"""Heading from one cheap gyro, Barshan & Durrant-Whyte 1994, simulated: ten minutes on a truck and on a turntable.

Largest heading error in ten minutes, deg: median over runs and 95 % quantile, and how many times smaller it is than
that of the gyro as it is. NEES of the heading once a minute (1 for a sigma that holds) and the share inside two sigma.
Stops are told to the filter: ten seconds at the start, or of each minute (then both courses give the same).

Run: PYTHONPATH=. python benchmarks/accuracy/barshan.py [--runs 30] [--picture docs/pictures/barshan.png]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tests"))
sys.path.append(str(ROOT / "benchmarks" / "accuracy"))

from plots import INK, Panel, drawn  # noqa: E402 (path above)
from support.barshan import EACH_MINUTE, PAPER_MODEL, START, Course, course, largest_deg  # noqa: E402

from attest_cli.filters import heading  # noqa: E402
from attest_cli.filters.heading import BiasModel, six_state_steps  # noqa: E402
from attest_cli.records import Smoothed  # noqa: E402
from attest_cli.smoothers import SMOOTHERS  # noqa: E402

Array = NDArray[np.float64]
COURSES = ("truck", "platform")
NO_WALK = 1e-9  # rad/s^2/sqrt(Hz): a setting must be positive
DRIFTING: dict[str, Any] = {"scatter": 0.15, "random_walk_deg_s": 5e-4}
STOPS: dict[str, Any] = {**DRIFTING, "stops": True, "told": EACH_MINUTE}
SCATTERS = (0.0, 0.06, 0.10, 0.15, 0.20, 0.25)
MINUTES = 60.0 * np.arange(1.5, 10.0)
STEP_RAD_S, STEP_AT_S = np.radians(20.0), 30.0


class Row:
    """What one way made of all runs."""

    def __init__(self) -> None:
        self.largest: list[float] = []
        self.nees: list[float] = []
        self.inside: list[float] = []

    def add(self, of: Course, found: Smoothed) -> None:
        """Judge one run with its sigma."""
        error = of.errors(found.q)
        self.largest.append(largest_deg(error))
        k = np.searchsorted(found.t, MINUTES)
        ratio = error[k] ** 2 / found.P[k, 2, 2]
        self.nees.append(float(ratio.mean()))
        self.inside.append(float(np.mean(ratio < 4.0)))

    def text(self, name: str, raw: float) -> str:
        """One line."""
        median, worst = np.median(self.largest), np.quantile(self.largest, 0.95)
        line = f"{name:<46}{median:>8.2f}{worst:>8.2f}{raw / median:>8.1f}"
        return line + (f"{np.mean(self.nees):>8.2f}{100 * np.mean(self.inside):>10.1f} %" if self.nees else "")


Table = dict[str, Row]


def known(of: Course, table: Table, name: str) -> None:
    """Add the gyro as it is and less its first mean."""
    table["gyro as it is"].largest.append(largest_deg(of.raw_errors()))
    if name:
        imu, stop = of.drive.log.imu, of.drive.segmentation.stops[0]
        first = float(imu.gyro_b[(imu.t >= stop.used_start) & (imu.t <= stop.used_end), 2].mean())
        table[name].largest.append(largest_deg(of.raw_errors() + first * (imu.t - imu.t[0])))


def papers_noise(of: Course) -> Array:
    """Heading errors of the six states with the paper's noise: 0.05 deg/s^3.5, and 0.2 deg/s taken for the bias's; they
    begin at rest.
    """
    imu, n = of.drive.log.imu, len(of.drive.log.imu.t)
    model = BiasModel(*np.radians([0.153, -0.264]), 338.4, float(np.radians(0.2)))
    H = np.array([[0.0, 1.0, 0.0, 0.0, 0.0, 1.0]])
    x0 = np.array([0.0, 0.0, 0.0, 0.0, 0.0, model.c2])
    system = six_state_steps(np.diff(imu.t), model, float(np.radians(0.05)))
    R = np.full((n, 1, 1), np.radians(0.2) ** 2)
    found = heading.run(system, imu.gyro_b[:, 2:], H, R, x0, np.diag([1e-8, 1e-4, 1e-4, 1e-4, 1e-8, 1e-8]))
    return np.asarray(of.true_heading - found.x[:, 0])


def exact(kind: str, seeds: range) -> str:
    """Known parameters, no stop but the one at the start."""
    table: Table = defaultdict(Row)
    for seed in seeds:
        settings = {**PAPER_MODEL, "parameter_sigma": 0.0}
        for form, name in (("six-state", "six states, exact parameters"), ("indirect", "model subtracted")):
            of = course(seed, kind, told=START, heading_settings={**settings, "form": form}, walk=NO_WALK)
            run = heading.forward(of.drive).run
            table[name].add(of, SMOOTHERS["none"](run))
            if form == "six-state":
                table[name + ", smoothed"].add(of, SMOOTHERS["rts"](run))
                known(of, table, "less its first mean")
                table["six states, noise of the paper"].largest.append(largest_deg(papers_noise(of)))
    return told(f"{kind}, exact parameters, {len(seeds)} runs", table)


def with_stops(kind: str, seeds: range) -> str:
    """Parameters that scatter by 15 %, a bias that walks, ten seconds of stop each minute."""
    table: Table = defaultdict(Row)
    for seed in seeds:
        for settings, name in (({}, "random walk and stops"), (PAPER_MODEL, "nominal model and stops")):
            of = course(seed, kind, heading_settings=settings, **STOPS)
            run = heading.forward(of.drive).run
            if not settings:
                known(of, table, "")
            table[f"{name}, bias alone, forward"].largest.append(largest_deg(of.bias_alone_errors(run)))
            table[f"{name}, forward"].add(of, SMOOTHERS["none"](run))
            table[f"{name}, smoothed"].add(of, SMOOTHERS["rts"](run))
    return told(f"{kind}, stops, 15 % scatter, walk 5e-4 deg/s/sqrt(s), {len(seeds)} runs", table)


def told(title: str, table: Table) -> str:
    """A table as text."""
    raw = float(np.median(table["gyro as it is"].largest))
    head = f"{title}\n{'':<46}{'median':>8}{'95 %':>8}{'times':>8}{'NEES':>8}{'in 2 sigma':>12}"
    return "\n".join([head, *(row.text(name, raw) for name, row in table.items())])


def scatter(seeds: range) -> str:
    """How the factor depends on how well the parameters are known: the nominal model on a truck, no stops."""
    lines = [f"truck, nominal model, no stops, {len(seeds)} runs\n{'scatter':<10}{'median':>8}{'times':>8}{'NEES':>8}"]
    for share in SCATTERS:
        row, raw = Row(), []
        for seed in seeds:
            settings = {**PAPER_MODEL, "form": "indirect", "parameter_sigma": share}
            of = course(seed, scatter=share, told=START, heading_settings=settings, walk=NO_WALK)
            row.add(of, SMOOTHERS["none"](heading.forward(of.drive).run))
            raw.append(largest_deg(of.raw_errors()))
        median = np.median(row.largest)
        lines.append(f"{share:<10.0%}{median:>8.2f}{np.median(raw) / median:>8.1f}{np.mean(row.nees):>8.2f}")
    return "\n".join(lines)


def step_response() -> str:
    """A step of 20 deg/s without noise: when the rate is at 90 %, and by how much it overshoots."""
    lines = [f"step of 20 deg/s\n{'sigma_u deg/s^3.5':<20}{'90 % after s':>14}{'overshoot deg/s':>18}"]
    t = 0.03 * np.arange(2000)
    rate = np.where(t >= STEP_AT_S, STEP_RAD_S, 0.0)[:, None]
    H, R = np.array([[0.0, 1.0, 0.0, 0.0, 0.0, 1.0]]), np.full((len(t), 1, 1), np.radians(0.2) ** 2)
    for density in (0.05, 30.0, 1000.0):
        system = six_state_steps(np.diff(t), BiasModel(walk=float(np.radians(5e-4))), float(np.radians(density)))
        x = heading.run(system, rate, H, R, np.zeros(6), np.diag([1e-8, 1.0, 1.0, 1.0, 1e-8, 1e-8])).x[:, 1]
        late = t >= STEP_AT_S
        rise = float(t[late][np.argmax(x[late] >= 0.9 * STEP_RAD_S)] - STEP_AT_S)
        lines.append(f"{density:<20g}{rise:>14.2f}{np.degrees(x[late].max() - STEP_RAD_S):>18.1f}")
    return "\n".join(lines)


def cost() -> str:
    """CPU per sample of both forms."""
    out = []
    for form in ("six-state", "indirect"):
        of = course(1, heading_settings={"form": form}, stops=True)
        n, begin = len(of.drive.log.imu.t), time.process_time()
        run = heading.forward(of.drive).run
        middle = time.process_time()
        SMOOTHERS["two-filter"](run)
        end = time.process_time()
        out.append(f"{form} {1e6 * (middle - begin) / n:.0f} + {1e6 * (end - middle) / n:.0f}")
    return "CPU, us per sample, forward + two-filter: " + ", ".join(out)


def picture(path: Path, seed: int) -> None:
    """One truck run: with exact parameters, and with stops."""
    settings = {**PAPER_MODEL, "form": "six-state", "parameter_sigma": 0.0}
    of = course(seed, told=START, heading_settings=settings, walk=NO_WALK)
    t, run = of.drive.log.imu.t / 60.0, heading.forward(of.drive).run
    first = SMOOTHERS["none"](run)
    drives = Panel("heading, deg", "A truck (the paper's figure 6): six states, parameters known")
    drives.line(t, np.degrees(of.true_heading - of.raw_errors()), "gyro as it is", INK["measurement"], 1.0)
    drives.line(t, np.degrees(of.true_heading - of.errors(first.q)), "six states", INK["forward"], 1.4)
    drives.line(t, np.degrees(of.true_heading), "truth", INK["truth"], 1.0)
    panels = [drives, _error(of, t, first, "Its error", "six states", "forward")]
    of = course(seed, **STOPS)
    run = heading.forward(of.drive).run
    bias = Panel("bias, deg/s", "Stops of ten seconds each minute, parameters not known: the bias")
    bias.spans(np.array([[s.start, s.end] for s in of.drive.segmentation.stops]) / 60.0, INK["stop"], "stop")
    truth = np.degrees(of.simulation.truth["gyro_bias_z_rad_s"])
    forward, smoothed = SMOOTHERS["none"](run), SMOOTHERS["rts"](run)
    bias.line(t, np.degrees(forward.bias[:, 2]), "forward", INK["forward"], 1.2)
    bias.line(t, np.degrees(smoothed.bias[:, 2]), "smoothed", INK["ink"], 1.2)
    bias.line(t, truth, "truth", INK["truth"], 1.2)
    last = _error(of, t, smoothed, "and the heading's error", "smoothed", "ink")
    last.line(t, np.degrees(-of.errors(forward.q)), "forward", INK["forward"], 1.0)
    drawn(
        path,
        [*panels, bias, last],
        "time, min",
        "Ten minutes of a cheap gyro (Barshan & Durrant-Whyte 1994), simulated",
    )


def _error(of: Course, t: Array, found: Smoothed, title: str, name: str, colour: str) -> Panel:
    panel = Panel("estimate minus truth, deg", title)
    panel.band(t, 2.0 * np.degrees(np.sqrt(found.P[:, 2, 2])), "±2σ", INK["band"])
    panel.line(t, np.degrees(-of.errors(found.q)), name, INK[colour], 1.2)
    return panel


def main() -> None:
    """Print the tables; draw the picture where asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=30)
    parser.add_argument("--first-seed", type=int, default=5000)
    parser.add_argument(
        "--only", choices=("exact", "exact-truck", "exact-platform", "stops", "scatter", "rest", "picture")
    )
    parser.add_argument("--picture", type=Path, help="PNG to draw")
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.runs)
    for kind in COURSES:
        if options.only in {None, "exact", f"exact-{kind}"}:
            print(exact(kind, seeds), end="\n\n", flush=True)
    if options.only in {None, "stops"}:
        print(with_stops("truck", seeds), end="\n\n", flush=True)
    if options.only in {None, "scatter"}:
        print(scatter(seeds), end="\n\n", flush=True)
    if options.only in {None, "rest"}:
        print(step_response(), cost(), sep="\n\n")
    if options.picture is not None:
        picture(options.picture, seeds.start)


if __name__ == "__main__":
    main()
