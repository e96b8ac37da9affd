"""The plank run of Vaganay, Aldon & Fournier 1993, simulated: the paper's own filter, and attest's, against truth.

The paper's filter has four states and the gyro's bias left in, as in its figures; attest's is ``--filter tilt-ekf``.
Medians over runs, with the 5 % and 95 % quantiles; NEES is per degree of freedom (1 for a sigma that holds).

Run: PYTHONPATH=. python benchmarks/accuracy/vaganay.py [--runs 40] [--picture docs/pictures/vaganay.png]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tests"))
sys.path.append(str(ROOT / "benchmarks" / "accuracy"))

from plots import INK, Panel, drawn  # noqa: E402 (path above)
from support.vaganay import (  # noqa: E402
    DEG,
    FIRST,
    PaperRun,
    charly,
    drive_of,
    paper_run,
    plank_means_deg,
    prepared,
    rms_deg,
    tilt_errors,
    true_angles,
)

from attest_cli.filters import tilt_ekf  # noqa: E402
from attest_cli.maths import rotation  # noqa: E402
from attest_cli.records import Log, Smoothed  # noqa: E402
from attest_cli.simulate import Simulation  # noqa: E402
from attest_cli.smoothers import SMOOTHERS  # noqa: E402

Array = NDArray[np.float64]
Table = dict[str, dict[str, list[float]]]
DRIFT_S = (10.0, 15.0, 20.0, 24.0, 26.0, 30.0, 40.0, 46.0)
SKIPPED_S = 5.0  # sigma is judged from here on: until then the vehicle stands
VARIANTS: Mapping[str, dict[str, object]] = {
    "no lever arm": {"lever_arm_m": [0.0, 0.0, 0.0]},
    "noise as in the note": {"accel_noise_density": 0.022, "angle_noise_density": 1.0},
    "no gate": {"gate_sigmas": 0.0},
}


def judged(table: Table, name: str, t: Array, pitch_roll: Array, truth: Array) -> None:
    """Add RMSE and plank means of one way to the table."""
    row, error = table[name], pitch_roll - truth
    pitch, roll = rms_deg(error)
    for key, value in (("roll", roll), ("pitch", pitch), *zip(("right", "left"), plank_means_deg(t, pitch_roll[:, 1]),
                                                              strict=True)):  # fmt: skip
        row[key].append(float(value))


def with_sigma(table: Table, name: str, simulation: Simulation, found: Smoothed) -> None:
    """Add RMSE, plank means, NEES and the share inside two sigma of a pass of attest's."""
    judged(table, name, found.t, rotation.roll_pitch_yaw(found.q)[:, 1::-1], true_angles(simulation))
    e, P = tilt_errors(simulation, found.q), found.P[:, :2, :2]
    later = found.t > SKIPPED_S
    nees = np.einsum("ki,ki->k", e, np.linalg.solve(P, e[:, :, None])[:, :, 0]) / 2
    inside = np.abs(e) < 2.0 * np.sqrt(np.einsum("kii->ki", P))
    table[name]["NEES"].append(float(nees[later].mean()))
    table[name]["2 sigma"].append(100.0 * float(inside[later].mean()))


def attest(
    simulation: Simulation, change: Callable[[Log], Log] = lambda log: log, **over: dict[str, object]
) -> Smoothed:
    """The smoothed pass of attest."""
    return SMOOTHERS["two-filter"](tilt_ekf.forward(drive_of(simulation, change, **over)).run)


def one_run(table: Table, drifts: dict[str, list[float]], seed: int) -> None:
    """Run one seed through everything."""
    simulation = charly(seed)
    truth, paper = true_angles(simulation), paper_run(*prepared(simulation))
    gated = paper_run(*prepared(simulation), gate=3.0)
    for name, found in (
        ("accelerometer", paper.accelerometer), ("gyro", paper.gyro), ("paper, forward", paper.forward.x[:, :2]),
        ("paper, smoothed", paper.smoothed[:, :2]), ("paper, gated, forward", gated.forward.x[:, :2]),
        ("paper, gated, smoothed", gated.smoothed[:, :2]),
    ):  # fmt: skip
        judged(table, name, paper.t, found, truth)
    for t in DRIFT_S:
        drifts[f"{t:.0f} s"].append(float(paper.forward.x[np.searchsorted(paper.t, t), 3]) / DEG * 60.0)
    drifts["gyro roll before"].append(float(np.degrees(paper.gyro[np.searchsorted(paper.t, 22.0), 1])))
    drifts["after"].append(float(np.degrees(paper.gyro[np.searchsorted(paper.t, 26.0), 1])))
    run = tilt_ekf.forward(drive_of(simulation)).run
    left = run.read.x[np.searchsorted(paper.t, 20.0), 3]  # type: ignore[union-attr] # the filter's own states
    drifts["size of attest's own at 20 s"].append(abs(float(left)) / DEG * 60.0)
    with_sigma(table, "attest, forward", simulation, SMOOTHERS["none"](run))
    with_sigma(table, "attest, smoothed", simulation, SMOOTHERS["two-filter"](run))


def variant_run(table: Table, seed: int) -> None:
    """Run one seed through the variants of attest's filter, smoothed."""
    simulation = charly(seed)
    with_sigma(table, "as it is", simulation, attest(simulation))
    with_sigma(table, "no odometry", simulation, attest(simulation, lambda log: replace(log, fixes={})))
    for name, over in VARIANTS.items():
        with_sigma(table, name, simulation, attest(simulation, tilt_ekf=over))


def ten_minutes(seeds: range) -> str:
    """The run repeated each minute with a turn of 90 deg: roll RMSE of the first and the last two minutes."""
    rows: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for seed in seeds:
        simulation = charly(seed, duration_s=600.0, turn_deg=90.0)
        log, settings = prepared(simulation)
        drive, truth = drive_of(simulation), true_angles(simulation)[:, 1]
        starts = tilt_ekf._starts(tilt_ekf.samples(drive).still)  # noqa: SLF001 (the starts that the filter takes)
        run = tilt_ekf.forward(drive).run
        found: dict[str, Array] = {}
        for name, at in (("one drift clock", FIRST), ("started anew at stops", starts)):
            paper = paper_run(log, settings, at)
            found |= {
                f"paper, {name}, forward": paper.forward.x[:, 1],
                f"paper, {name}, smoothed": paper.smoothed[:, 1],
            }
        for name, smoother in (("forward", "none"), ("smoothed", "two-filter")):
            found[f"attest, {name}"] = rotation.roll_pitch_yaw(SMOOTHERS[smoother](run).q)[:, 0]
        parts = (log.imu.t < 120.0, log.imu.t >= 480.0)
        for name, roll in found.items():
            rows[name].append(tuple(float(rms_deg((roll - truth)[part])) for part in parts))
    lines = [f"{'roll RMSE, deg':<42}{'minutes 1-2':>14}{'minutes 9-10':>14}"]
    lines += [
        f"{name:<42}{np.median([v[0] for v in r]):>14.3f}{np.median([v[1] for v in r]):>14.3f}"
        for name, r in rows.items()
    ]
    return "\n".join(lines)


def text(table: Table) -> str:
    """The table: medians, quantiles of the roll RMSE."""
    head = ("roll RMSE deg", "5 %", "95 %", "pitch", "right plank", "left plank", "NEES", "in 2 sigma")
    lines = [f"{'':<26}" + "".join(f"{h:>14}" for h in head)]
    for name, row in table.items():
        cells = [np.median(row["roll"]), *np.quantile(row["roll"], [0.05, 0.95])]
        cells += [np.median(row[key]) for key in ("pitch", "right", "left")]
        line = f"{name:<26}" + "".join(f"{c:>14.3f}" for c in cells)
        if row["NEES"]:
            line += f"{np.mean(row['NEES']):>14.2f}{np.mean(row['2 sigma']):>12.1f} %"
        lines.append(line)
    return "\n".join(lines)


def picture(path: Path, seed: int) -> None:
    """The paper's figures 1 and 3 and attest's own, of one run."""
    simulation = charly(seed)
    truth, paper = np.degrees(true_angles(simulation)), paper_run(*prepared(simulation))
    drive = drive_of(simulation)
    run = tilt_ekf.forward(drive).run
    forward, smoothed = SMOOTHERS["none"](run), SMOOTHERS["two-filter"](run)
    panels = [_angles(paper, truth), _drifts(paper), _attest(forward, smoothed, truth)]
    drawn(path, panels, "time, s", "The plank run of Vaganay et al. 1993, simulated")


def _angles(paper: PaperRun, truth: Array) -> Panel:
    panel = Panel("roll, deg", "The paper's filter (its figure 1)", (-5.0, 4.5))
    panel.line(paper.t[::5], np.degrees(paper.accelerometer[::5, 1]), "accelerometer", INK["measurement"], 0.6)
    panel.line(paper.t, np.degrees(paper.gyro[:, 1]), "gyro", INK["backward"], 1.0)
    panel.line(paper.t, np.degrees(paper.forward.x[:, 1]), "Kalman filter", INK["forward"], 1.2)
    panel.line(paper.t, truth[:, 1], "truth", INK["truth"], 1.2)
    return panel


def _drifts(paper: PaperRun) -> Panel:
    panel = Panel("mean drift, deg/min", "Its mean drifts (its figure 3)", (-9.0, 9.0))
    panel.line(paper.t, paper.forward.x[:, 3] / DEG * 60.0, "roll", INK["forward"], 1.2)
    panel.line(paper.t, paper.forward.x[:, 2] / DEG * 60.0, "pitch", INK["z"], 1.2)
    return panel


def _attest(forward: Smoothed, smoothed: Smoothed, truth: Array) -> Panel:
    panel = Panel("roll minus truth, deg", "attest smooth --filter tilt-ekf", (-0.5, 0.5))
    sigma = np.degrees(np.sqrt(smoothed.P[:, 0, 0]))
    panel.band(smoothed.t, 2.0 * sigma, "smoothed ±2σ", INK["band"])
    for found, name, colour in ((forward, "forward", "forward"), (smoothed, "smoothed", "ink")):
        error = np.degrees(rotation.roll_pitch_yaw(found.q)[:, 0]) - truth[:, 1]
        panel.line(found.t, error, name, INK[colour], 1.2)
    return panel


def cost(seed: int) -> str:
    """CPU per sample: forward, and each smoother."""
    drive = drive_of(charly(seed, duration_s=120.0))
    tilt_ekf.forward(drive)  # imports
    n, out = len(drive.log.imu.t), []
    begin = time.process_time()
    run = tilt_ekf.forward(drive).run
    out.append(f"forward {1e6 * (time.process_time() - begin) / n:.0f}")
    for name in ("two-filter", "rts"):
        begin = time.process_time()
        SMOOTHERS[name](run)
        out.append(f"{name} {1e6 * (time.process_time() - begin) / n:.0f}")
    return "CPU, us per sample: " + ", ".join(out)


def main() -> None:
    """Print the tables; draw the picture where asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--first-seed", type=int, default=3000)
    parser.add_argument("--only", choices=("runs", "variants", "minutes", "cost", "picture"))
    parser.add_argument("--picture", type=Path, help="PNG to draw")
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.runs)
    if options.only in {None, "runs"}:
        table: Table = defaultdict(lambda: defaultdict(list))
        drifts: dict[str, list[float]] = defaultdict(list)
        for seed in seeds:
            one_run(table, drifts, seed)
        print(f"{len(seeds)} runs, seeds {seeds.start} to {seeds.stop - 1}\n{text(table)}")
        print("drift, deg/min: " + ", ".join(f"{k} {np.median(v):+.2f}" for k, v in drifts.items()), flush=True)
    if options.only in {None, "variants"}:
        table = defaultdict(lambda: defaultdict(list))
        for seed in seeds[: max(1, len(seeds) // 2)]:
            variant_run(table, seed)
        print(f"\nattest, smoothed, {max(1, len(seeds) // 2)} runs\n{text(table)}", flush=True)
    if options.only in {None, "minutes"}:
        print(f"\n{ten_minutes(seeds[: max(1, len(seeds) // 10)])}", flush=True)
    if options.only in {None, "cost"}:
        print(f"\n{cost(seeds.start)}")
    if options.picture is not None:
        picture(options.picture, seeds.start)


if __name__ == "__main__":
    main()
