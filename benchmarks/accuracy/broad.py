"""Attitude on BROAD trials: attest and offline VQF 9D in the same run, by BROAD's own metric.

BROAD (Laidig et al., Data 6(7):72, 2021): hand-held IMU and magnetometer at 286 Hz with optical truth; RMSE in degrees
over the movement phase. Its IMU lags the truth by a constant of the data set, which depends on how a gyro sample is
read (0.7 samples as a mean over the interval before it, 1.2 as a value at its stamp), so errors are given as they are
and after that advance. The magnetic field gives heading a datum of its own: heading is also given with the mean of
each trial taken out.

Run: PYTHONPATH=. python benchmarks/accuracy/broad.py [../shared/data/broad] [--set smoothing.filter=indirect]
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
from peers import RULES, Run, Trial, by_attest, by_vqf, degrees, judged, load

ERRORS = ("total", "heading", "inclination", "heading_relative")
HEAD = f"{'':<44}{'as it is':^40}{'advanced':^40}\n{'trial':<26}{'estimator':<18}" + 2 * (
    f"{'total':>9}{'heading':>9}{'inclin.':>9}{'head-mean':>11}  "
)
SIGMA_HEAD = (
    f"{'trial':<26}{'estimator':<18}{'stops':>6}{'sigma incl':>11}{'NEES/2':>8}{'95 %':>7}"
    f"{'sigma head':>12}{'NEES/1':>9}{'95 %':>7}{'- mean':>9}{'95 %':>7}{'offset, deg':>13}"
)


def errors(run: Run, trial: Trial) -> list[float]:
    """RMSE as it is and after the constant advance."""
    return [v for a in (0.0, run.lag) for v in degrees(judged(run, trial, a, moving_only=True, align="none"), *ERRORS)]


def claims(run: Run, trial: Trial) -> list[float]:
    """Sigma, NEES and share in the 95 % region of inclination and heading, after the advance."""
    found = judged(run, trial, run.lag, weighted=True, moving_only=True, align="none").attitude
    assert found is not None
    assert found.series.sigma is not None
    sigma = np.degrees(np.sqrt(np.mean(found.series.sigma**2, axis=0)))
    nees = found.nees
    offset = np.degrees(np.mean(found.series.error[:, 2]))
    row = [run.stops, float(np.hypot(sigma[0], sigma[1])), nees["inclination"].mean / 2, nees["inclination"].inside]
    row += [float(sigma[2]), nees["heading"].mean, nees["heading"].inside]
    return [*row, nees["heading_relative"].mean, nees["heading_relative"].inside, float(offset)]


def error_line(name: str, estimator: str, values: list[float]) -> str:
    """One row of the first table."""
    cells = "".join(f"{v:>11.2f}  " if k % 4 == 3 else f"{v:>9.2f}" for k, v in enumerate(values))
    return f"{name[:25]:<26}{estimator:<18}{cells}"


def sigma_line(name: str, estimator: str, v: list[float]) -> str:
    """One row of the second table."""
    level = f"{v[0]:>6.0f}{v[1]:>11.2f}{v[2]:>8.2f}{100 * v[3]:>7.1f}"
    heading = f"{v[4]:>12.2f}{v[5]:>9.2f}{100 * v[6]:>7.1f}{v[7]:>9.2f}{100 * v[8]:>7.1f}{v[9]:>13.2f}"
    return f"{name[:25]:<26}{estimator:<18}{level}{heading}"


def main() -> None:
    """Run every trial and print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", default=Path("../shared/data/broad"))
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a setting of attest")
    options = parser.parse_args()
    overrides = dict(pair.split("=", 1) for pair in options.set)
    found: dict[str, list[list[float]]] = defaultdict(list)
    told: dict[str, list[list[float]]] = defaultdict(list)
    lines, sigma_lines, seconds = [], [], defaultdict(float)
    for path in sorted(options.folder.glob("*.parquet")):
        trial = load(path)
        for make in (by_vqf, *(lambda t, rule=rule: by_attest(t, rule, overrides) for rule in RULES)):
            begin = time.process_time()
            run = make(trial)
            seconds[run.name] += time.process_time() - begin
            found[run.name].append(errors(run, trial))
            lines.append(error_line(trial.name, run.name, found[run.name][-1]))
            if run.poses.claims is not None:
                told[run.name].append(claims(run, trial))
                sigma_lines.append(sigma_line(trial.name, run.name, told[run.name][-1]))
    lines += [error_line("mean", name, np.mean(rows, axis=0).tolist()) for name, rows in found.items()]
    sigma_lines += [sigma_line("mean", name, np.mean(rows, axis=0).tolist()) for name, rows in told.items()]
    print(HEAD, *lines, "", SIGMA_HEAD, *sigma_lines, sep="\n")
    print(
        "\nNEES over its degrees of freedom: 1 expected. CPU s: "
        + ", ".join(f"{k} {v:.1f}" for k, v in seconds.items())
    )


if __name__ == "__main__":
    main()
