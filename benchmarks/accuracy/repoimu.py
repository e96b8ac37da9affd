"""Attitude on the T-stick trials of RepoIMU: attest and offline VQF 9D in the same run.

RepoIMU (Szczesna et al., ICCVG 2016): an IMU with magnetometer on a stick, 100 Hz, hardly any rest, Vicon attitude
relative to its first frame: one constant rotation on either side of the reference is fitted to each estimate (all
samples weigh alike), so that only the total error means the same for all. RMSE and median in degrees over the whole
trial; "in time" is the total after the fitted clock offset. Trials with a clipped gyro or a jumping reference are
listed apart: nobody can be judged by them. In doubt are the samples over whose next quarter of a second the reference
turns by more than 3 degrees otherwise than the gyro: they make the RMSE of some of the others (Test03), not their
median. Sigmas are held against the errors after the same fit, so they look a bit wide; "slow": of the errors of
inclination averaged over three seconds, in which a gyro can err and the noise of the reference is small.

attest reads gyro samples as the log shows (auto); beside it as values at their stamps and as means over the interval
before.

Run: PYTHONPATH=. python benchmarks/accuracy/repoimu.py [../shared/data/repoimu] [--set smoothing.filter=indirect]
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
from peers import RULES, Run, Trial, by_attest, by_vqf, degrees, judged, load
from scipy.stats import chi2

from attest_cli.evaluate import errors
from attest_cli.evaluate.alignment import nearest_rotation
from attest_cli.maths import rotation

CLIP_RAD_S, CLIPPED_SHARE = 7.3, 1e-3  # the gyro ends at 7.4
JUMP_DEG = 20.0  # from one sample to the next
DOUBT_S, DOUBT_DEG = 0.25, 3.0
SLOW_S = 3.0
ERRORS = ("total", "heading", "inclination")
HEAD = (
    f"{'trial':<22}{'estimator':<18}{'total':>8}{'in time':>8}{'median':>8}{'heading':>9}{'inclin.':>9}{'doubt %':>9}"
    f"{'offset ms':>11}{'stops':>7}{'NEES/2':>9}{'95 %':>7}{'slow':>7}{'NEES/1':>9}{'95 %':>7}"
)
Row = list[float]


def spoiled(trial: Trial) -> str:
    """Say why a trial is listed apart; empty where it is not."""
    clipped = float(np.mean(np.any(np.abs(trial.gyr) > CLIP_RAD_S, axis=1)))
    q = trial.truth.q
    jump = float(np.nanmax(np.degrees(errors.total(q[1:], q[:-1]))))
    reasons = [f"gyro clipped in {100 * clipped:.1f} % of the samples"] * (clipped > CLIPPED_SHARE)
    return ", ".join([*reasons, *[f"reference jumps by {jump:.0f} deg"] * (jump > JUMP_DEG)])


def doubt(trial: Trial) -> float:
    """Return the share of samples at which the reference turns otherwise than the gyro."""
    ahead = round(DOUBT_S / trial.period)
    measured = rotation.chain(rotation.exp_quaternion(trial.gyr * trial.period))
    by_gyro, by_truth = (
        rotation.log_quaternion(rotation.multiply(rotation.conjugate(q[:-ahead]), q[ahead:]))
        for q in (measured, trial.truth.q)
    )
    known = np.isfinite(by_truth).all(axis=1)
    for _ in range(2):  # the rotation between both axes without what it shows to be in doubt
        R = nearest_rotation(by_gyro[known].T @ by_truth[known])
        apart = np.degrees(np.linalg.norm(by_gyro - by_truth @ R.T, axis=1))
        known = apart < DOUBT_DEG
    return float(np.mean(apart[np.isfinite(apart)] > DOUBT_DEG))


def slow(error: np.ndarray, sigma: np.ndarray, period: float) -> float:
    """Return the share of errors (n, 2), averaged over ``SLOW_S``, in the 95 % region of ``sigma`` (n, 2)."""
    width = round(SLOW_S / period)
    total = np.cumsum(error, axis=0)
    mean = (total[width:] - total[:-width]) / width
    middle = sigma[width // 2 :][: len(mean)]
    return float(np.mean(np.sum((mean / middle) ** 2, axis=1) < chi2.ppf(0.95, 2)))


def row(run: Run, trial: Trial) -> Row:
    """Errors, fitted clock offset, stops, and how inclination and heading keep to their sigma."""
    fit = {"align": "full", "align_body": True}
    found = judged(run, trial, 0.0, **fit)
    assert found.attitude is not None
    total, *others = degrees(found, *ERRORS)
    offset = 1e3 * found.offset.seconds if found.offset else np.nan
    in_time = total
    if found.offset:  # constant, like the rotations
        in_time, *_ = degrees(judged(run, trial, -found.offset.seconds / trial.period, **fit), "total")
    median = float(np.degrees(found.attitude.stats["total"].median))
    values = [total, in_time, median, *others, 100.0 * doubt(trial), offset, float(run.stops)]
    if run.poses.claims is None:
        return [*values, *(np.nan,) * 5]
    attitude = judged(run, trial, 0.0, weighted=True, **fit).attitude
    assert attitude is not None
    level, heading, series = attitude.nees["inclination"], attitude.nees["heading"], attitude.series
    assert series.sigma is not None
    slowly = slow(series.error[:, :2], series.sigma[:, :2], trial.period)
    return [*values, level.mean / 2, level.inside, slowly, heading.mean, heading.inside]


def line(name: str, estimator: str, v: Row) -> str:
    """One row of the table."""
    shown = "".join(f"{x:>8.2f}" for x in v[:3]) + f"{v[3]:>9.2f}{v[4]:>9.2f}{v[5]:>9.1f}{v[6]:>11.2f}"
    if np.isfinite(v[8]):
        shown += f"{v[7]:>7.0f}{v[8]:>9.2f}{100 * v[9]:>7.1f}{100 * v[10]:>7.1f}{v[11]:>9.2f}{100 * v[12]:>7.1f}"
    return f"{name[:21]:<22}{estimator:<18}{shown}"


def main() -> None:
    """Run every trial and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", default=Path("../shared/data/repoimu"))
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a setting of attest")
    options = parser.parse_args()
    overrides = dict(pair.split("=", 1) for pair in options.set)
    clean: dict[str, list[Row]] = defaultdict(list)
    lines, apart, seconds = [], [], defaultdict(float)
    for path in sorted(options.folder.glob("TStick_*.parquet")):
        trial = load(path)
        if not np.isfinite(trial.truth.q).any():
            continue  # a static log without a reference
        why = spoiled(trial)
        apart += [f"{trial.name}: {why}"] if why else []
        for make in (by_vqf, *(lambda t, rule=rule: by_attest(t, rule, overrides) for rule in RULES)):
            begin = time.process_time()
            run = make(trial)
            seconds[run.name] += time.process_time() - begin
            values = row(run, trial)
            (apart if why else lines).append(line(trial.name, run.name, values))
            if not why:
                clean[run.name].append(values)
    lines += [line("mean", name, np.mean(rows, axis=0).tolist()) for name, rows in clean.items()]
    print(HEAD, *lines, "\nlisted apart", *apart, sep="\n")
    print(
        "\nNEES over its degrees of freedom: 1 expected. CPU s: "
        + ", ".join(f"{k} {v:.1f}" for k, v in seconds.items())
    )


if __name__ == "__main__":
    main()
