"""Attitude, bias and their sigmas on simulated rover drives: forward, two-filter, paper, Gauss-Newton against truth.

S1: no accelerometer bias, motions of 60-300 s, no zero rate. S2: accelerometer bias, motions of 60-120 s, zero rate.
In motion: S1 with zero rate, from 10 s into its first motion. "wrong": the start's yaw is 170 deg wrong, no gates;
"own": the start and the gates of attest.
Errors are RMS over motion at the nodes, pooled over drives; NEES are means over motion, then over drives (6, 3, 3
expected), spread is their standard error.

Run: PYTHONPATH=. python benchmarks/accuracy/rover.py [--drives 50] [--first-seed 1000] [--only S1]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tests"))

from support.drives import Job, Score, in_motion, mrad, pooled, score, simulated, wrong_start  # noqa: E402 (path above)

from attest_cli import estimate  # noqa: E402
from attest_cli.filters import indirect  # noqa: E402
from attest_cli.filters.alignment import Start  # noqa: E402
from attest_cli.records import Smoothed  # noqa: E402
from attest_cli.settings import Settings  # noqa: E402
from attest_cli.simulate import RoverOptions  # noqa: E402

PASSES = ("forward", "two-filter", "paper", "Gauss-Newton")
WRONG_DEG = 170.0
GATE = 0.9999  # share of good measurements the gate lets through, attest's default
HEADER = (
    f"{'':<14}{'attitude':>10}{'middle':>9}{'forward/':>10}{'bias':>9}{'NEES':>9}{'NEES':>9}{'NEES':>9}{'spread':>9}{'CPU':>8}\n"
    f"{'':<14}{'mrad':>10}{'third':>9}{'this, mid':>10}{'urad/s':>9}{'6':>9}{'att':>9}{'bias':>9}{'of 6':>9}{'s':>8}"
)


@dataclass(frozen=True)
class Case:
    """A drive, its start, the gate of the measurements and the Gauss-Newton passes."""

    work: Job
    start: Start
    gate: float
    iterations: int | str


def s1(seed: int) -> Case:
    """No accelerometer bias, no zero rate."""
    work = simulated(RoverOptions(seed=seed), smoothing={"zero_rate": False})
    return Case(work, work.start, GATE, 2)


def s2(seed: int) -> Case:
    """Accelerometer bias, zero rate, one gravity update per stop."""
    work = simulated(RoverOptions(seed=seed, scenario="S2", motion_s=(60.0, 120.0)))
    return Case(work, work.start, GATE, 2)


def wrong(seed: int) -> Case:
    """Start in motion with the yaw wrong; every measurement counts, since a gate would trust the start."""
    work = in_motion(RoverOptions(seed=seed))
    return Case(work, wrong_start(work, WRONG_DEG, np.random.default_rng([seed, 170])), 1.0, 6)


def own(seed: int) -> Case:
    """Start in motion as attest itself aligns it."""
    work = in_motion(RoverOptions(seed=seed))
    return Case(work, work.start, GATE, "auto")


SCENARIOS: dict[str, Callable[[int], Case]] = {"S1": s1, "S2": s2, "in motion, wrong": wrong, "in motion, own": own}


def with_smoothing(settings: Settings, **values: object) -> Settings:
    """Settings with keys of ``[smoothing]`` replaced."""
    return settings.model_copy(update={"smoothing": settings.smoothing.model_copy(update=values)})


def run_passes(case: Case) -> tuple[dict[str, Score], dict[str, float]]:
    """Score and CPU seconds of every pass over one drive."""
    work, smoothing = case.work, {"gate_probability": case.gate}
    begin = time.process_time()
    forward = indirect.run(work.nodes, case.start, case.gate)
    seconds = {"forward": time.process_time() - begin}
    scores = {"forward": score(work, forward.t, forward.q, forward.bias, forward.chain.P)}
    chosen = {
        "two-filter": with_smoothing(work.settings, smoother="two-filter", iterations=0, **smoothing),
        "paper": with_smoothing(work.settings, smoother="paper", **smoothing),
        "Gauss-Newton": with_smoothing(work.settings, iterations=case.iterations, **smoothing),
    }
    for name, settings in chosen.items():
        begin = time.process_time()
        found: Smoothed = estimate.smooth_run(work.nodes, case.start, forward, settings)
        seconds[name] = time.process_time() - begin
        scores[name] = score(work, found.t, found.q, found.bias, found.P)
    return scores, seconds


def table(name: str, seeds: range) -> str:
    """The table of one scenario."""
    scores: dict[str, list[Score]] = defaultdict(list)
    cpu: dict[str, float] = defaultdict(float)
    for seed in seeds:
        found, seconds = run_passes(SCENARIOS[name](seed))
        for which in PASSES:
            scores[which].append(found[which])
            cpu[which] += seconds[which]
    lines = [f"{name}: {len(seeds)} drives, seeds {seeds.start} to {seeds.stop - 1}", HEADER]
    worst = max(scores["Gauss-Newton"], key=lambda s: s.attitude)
    ahead = pooled(scores["forward"])
    for which in PASSES:
        p = pooled(scores[which])
        spread = np.std([s.nees for s in scores[which]], ddof=1) / np.sqrt(len(seeds)) if len(seeds) > 1 else np.nan
        cells = (mrad(p.attitude), mrad(p.middle), np.sqrt(ahead.middle / p.middle), 1e3 * mrad(p.bias))
        lines.append(
            f"{which:<14}{cells[0]:>10.2f}{cells[1]:>9.2f}{cells[2]:>10.1f}{cells[3]:>9.1f}{p.nees:>9.3g}"
            f"{p.nees_attitude:>9.3g}{p.nees_bias:>9.3g}{spread:>9.2g}{cpu[which]:>8.1f}"
        )
    lines.append(f"worst drive of Gauss-Newton: {mrad(worst.attitude):.2f} mrad, NEES {worst.nees:.2f}")
    return "\n".join(lines)


def main() -> None:
    """Print a table per scenario."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drives", type=int, default=50, help="drives per scenario")
    parser.add_argument("--first-seed", type=int, default=1000)
    parser.add_argument("--only", choices=sorted(SCENARIOS), help="one scenario")
    options = parser.parse_args()
    begin = time.process_time()
    for name in SCENARIOS if options.only is None else [options.only]:
        print(table(name, range(options.first_seed, options.first_seed + options.drives)), end="\n\n", flush=True)
    print(f"CPU in all {time.process_time() - begin:.0f} s")


if __name__ == "__main__":
    main()
