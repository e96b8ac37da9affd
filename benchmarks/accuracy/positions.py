"""Positions on real logs: fixes are withheld, each second one or whole outages, and predicted from what is left.

KITTI (car, 1 Hz GPS), EuRoC MH_01 (drone, tracker at 20 Hz), Husky (rover, wheels and GPS at 2.5 Hz); ../shared/data.
RMS of the horizontal error of the predictions, m, forward only and smoothed; share of withheld fixes inside the 95 %
region of the prediction; what was learnt. Settings are the defaults. Outages begin 10, 20, 30, 40 and 50 s into the
log, or as ``--begin`` says, and come again 40 s after their end, one run each, pooled: where they lie matters as much
as anything.
"none": no fixes at all, yaw and translation fitted to them afterwards.

Run: PYTHONPATH=. python benchmarks/accuracy/positions.py [--only KITTI] [--cases half,10,30] [--begin 30,40]
    [--picture FILE.png]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from plots import INK, Panel, drawn
from scipy.stats import chi2

from attest_cli.filters import Drive
from attest_cli.filters.navigation.aids import Place
from attest_cli.filters.navigation.fixes import place_of, possible
from attest_cli.filters.navigation.rounds import Navigated, navigate, shifted
from attest_cli.nodes.noise import find_noise
from attest_cli.prepare import prepare
from attest_cli.readers import read
from attest_cli.records import Fixes, Imu, Log
from attest_cli.segment import find_segments
from attest_cli.settings import Settings
from attest_cli.world import find_world

Array = NDArray[np.float64]
DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
BETWEEN_S, BEGIN_S = 40.0, (10.0, 20.0, 30.0, 40.0, 50.0)  # fixes between outages, and before the first
REGION = float(chi2.isf(0.05, 2))


def _log(imu: pd.DataFrame, fixes: pd.DataFrame, names: tuple[str, str, str]) -> Log:
    """Return a log of an IMU and positions in local axes."""
    t = imu["t"].to_numpy()
    gyro, accel = (imu[[f"{kind}_{axis}" for axis in "xyz"]].to_numpy() for kind in ("gyr", "acc"))
    at = fixes["t"].to_numpy() - t[0]
    inside = (at > 0.0) & (at < t[-1] - t[0])
    place = Fixes("position", "position", at[inside], fixes[list(names)].to_numpy()[inside])
    return Log((), 0, np.round((t - t[0]) * 1e9).astype(np.int64), Imu(t - t[0], gyro, accel), {"position": place},
               np.zeros((0, 2)), {})  # fmt: skip


def kitti(_: Settings) -> Log:
    """Car; the first row of the IMU has no time step."""
    folder = DATA / "kitti_gtsam"
    imu, fixes = pd.read_parquet(folder / "imu.parquet").iloc[1:], pd.read_parquet(folder / "gps.parquet")
    return _log(imu, fixes, ("x_m", "y_m", "z_m"))


def euroc(_: Settings) -> Log:
    """Drone, tracked by a total station."""
    folder = DATA / "euroc_mh01"
    imu, fixes = pd.read_parquet(folder / "imu0.parquet"), pd.read_parquet(folder / "leica0.parquet")
    return _log(imu, fixes, ("px", "py", "pz"))


def husky(settings: Settings) -> Log:
    """Rover with wheel odometry, read as any log."""
    return prepare([read(DATA / "logs" / "derived_mcap" / "test1_ros2_zstd.mcap", settings)], settings)


def husky_without_wheels(settings: Settings) -> Log:
    """The same without its odometry."""
    log = husky(settings)
    return replace(log, fixes={role: f for role, f in log.fixes.items() if role != "odometry"})


LOGS: dict[str, tuple[Callable[[Settings], Log], str]] = {
    "KITTI": (kitti, "position"),
    "EuRoC": (euroc, "position"),
    "Husky": (husky, "gps"),
    "Husky, no wheels": (husky_without_wheels, "gps"),
}


def withheld(t: Array, what: str, begin: float) -> NDArray[np.bool_]:
    """Return which fixes are not shown: ``half``, or outages of so many seconds."""
    if what == "half":
        return np.arange(len(t)) % 2 == 1
    length = float(what)
    since = t - t[0] - begin
    into = since % (length + BETWEEN_S)
    return (since >= 0.0) & (into < length) & (t - into + length < t[-1] - 0.5 * BETWEEN_S)


def drive_of(log: Log, settings: Settings) -> Drive:
    """Return what a filter is given."""
    segmentation = find_segments(log, settings)
    return Drive(log, segmentation, find_world(log, settings), find_noise(log, segmentation, settings), settings)


@dataclass(frozen=True)
class Predicted:
    """Hidden fixes: times, squared horizontal errors forward and smoothed, normalised squares, mean variance, m^2."""

    t: Array
    forward: Array
    smoothed: Array
    n2: Array
    variance: Array


def predicted(done: Navigated, drive: Drive, role: str, hidden: NDArray[np.bool_]) -> Predicted:
    """Predict the hidden fixes by the measurement model of the smoother itself."""
    late = shifted(drive, done.learnt.lags)
    every = place_of(late, done.nodes, role, np.zeros(3))
    near = np.abs(done.nodes.t[every.node] - every.t) < 1e-3  # not those that the lag moved beyond an end
    unseen = np.interp(every.t, late.log.fixes[role].t, hidden) > 0.5
    aid = next(a for a in done.problem.aids if isinstance(a, Place) and a.role == role)
    use = unseen & near
    test = replace(aid, node=every.node[use], t=every.t[use],
                   place_n=every.place_n[use],
                   sigma=np.tile(np.nanmedian(aid.sigma, axis=0), (int(use.sum()), 1)))  # fmt: skip
    form, found = done.problem.layout, done.found
    ahead, rows = (test.rows(form, at) for at in (found.at.moved(found.found.x), found.smoothed))
    H = rows.H[:, :2]
    S = H @ found.errors.P[rows.node] @ H.swapaxes(1, 2) + np.apply_along_axis(np.diag, 1, rows.sigma[:, :2] ** 2)
    n2 = np.einsum("ki,ki->k", rows.r[:, :2], np.linalg.solve(S, rows.r[:, :2, None])[:, :, 0])
    squares = (np.sum(part.r[:, :2] ** 2, axis=1) for part in (ahead, rows))
    return Predicted(test.t, *squares, n2, 0.5 * np.trace(S, axis1=1, axis2=2))


def without(drive: Drive, role: str) -> tuple[Navigated, float, float]:
    """Solve without any fix; return RMS of the fitted path at the fixes, and its length, m."""
    fixes = {name: f for name, f in drive.log.fixes.items() if name != role}
    done = navigate(replace(drive, log=replace(drive.log, fixes=fixes)))
    known, place, _ = possible(drive, role)
    path = done.found.smoothed.p[:, :2] @ [1.0, 1.0j]
    x, y = np.interp(drive.log.fixes[role].t[known], done.nodes.t, path), place[known, :2] @ [1.0, 1.0j]
    x, y = x - x.mean(), y - y.mean()
    turn = np.vdot(x, y)
    error = y - x * turn / abs(turn)
    return done, float(np.sqrt(np.mean(np.abs(error) ** 2))), float(np.sum(np.abs(np.diff(path))))


def learnt(done: Navigated) -> str:
    """Say what was found of clocks, noise and lever arms."""
    parts, x = done.problem.layout.parts, done.found.smoothed.x[0]
    arms = {name: np.round(x[part], 2) for name, part in parts.items() if name.endswith(" lever arm")}
    told = [f"{role} {lag:.3f} s late" for role, lag in done.learnt.lags.items()]
    told += [f"{role} sigma x {factor:.2f}" for role, factor in done.learnt.factors.items()]
    return ", ".join([*told, *(f"{name} {arm}" for name, arm in arms.items())])


def hiding(drive: Drive, role: str, what: str, begin: float) -> tuple[Navigated, Predicted]:
    """Solve a drive with fixes hidden, and predict them."""
    fixes = drive.log.fixes[role]
    hidden = withheld(fixes.t, what, begin)
    shown = {**drive.log.fixes, role: replace(fixes, values=np.where(hidden[:, None], np.nan, fixes.values))}
    done = navigate(replace(drive, log=replace(drive.log, fixes=shown)))
    return done, predicted(done, drive, role, hidden)


def picture(path: Path) -> None:
    """Draw errors in outages of 30 s of the car and the rover."""
    panels = []
    for name, title in (
        ("KITTI", "Car, GPS hidden for 30 s at a time"),
        ("Husky", "Rover with wheel odometry, the same"),
    ):
        load, role = LOGS[name]
        settings = Settings.model_validate({"smoothing": {"filter": "navigation"}})
        _, found = hiding(drive_of(load(settings), settings), role, "30", BEGIN_S[3])
        breaks = np.flatnonzero(np.diff(found.t) > BETWEEN_S / 2) + 1  # no line from outage to outage
        t, *errors = (
            np.insert(values, breaks, np.nan)
            for values in (found.t, np.sqrt(found.forward), np.sqrt(found.smoothed), np.sqrt(REGION * found.variance))
        )
        panel = Panel("error, m", title, log=True)
        for values, words, colour in zip(
            errors, ("forward", "smoothed", "95 % radius"), (INK["forward"], INK["ink"], INK["backward"]), strict=True
        ):
            panel.line(t, values, words, colour, 1.2)
        panels.append(panel)
    drawn(path, panels, "time, s", "Positions predicted where the fixes were hidden")


def line(drive: Drive, name: str, role: str, what: str, begin_s: tuple[float, ...]) -> str:
    """Return a line of the table."""
    start, fixes = time.process_time(), drive.log.fixes[role]
    if what == "none":
        done, rms, length = without(drive, role)
        text = f"{name:<18}{what:>9}{len(fixes.t):>7}{'':>9}{rms:>9.3f}{'':>8}  path of {length:.0f} m, {learnt(done)}"
    else:
        parts = []
        for begin in begin_s if what != "half" else begin_s[:1]:
            done, found = hiding(drive, role, what, begin)
            parts.append(found)
        forward, smoothed, n2 = (
            np.concatenate([getattr(p, key) for p in parts]) for key in ("forward", "smoothed", "n2")
        )
        text = (
            f"{name:<18}{what:>9}{len(n2):>7}{np.sqrt(forward.mean()):>9.3f}{np.sqrt(smoothed.mean()):>9.4f}"
            f"{np.mean(n2 < REGION):>8.2f}  {learnt(done)}"
        )
    return f"{text}; {time.process_time() - start:.0f} s CPU"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=LOGS)
    parser.add_argument("--cases", default="half,10,30,none")
    parser.add_argument(
        "--begin", default=",".join(f"{s:g}" for s in BEGIN_S), help="s, of the first outage; one run each"
    )
    parser.add_argument("--picture", type=Path, help="draw instead")
    wanted = parser.parse_args()
    if not DATA.is_dir():
        sys.exit(f"the logs are not here: {DATA}")
    if wanted.picture:
        picture(wanted.picture)
        return
    print(f"{'log':<18}{'withheld':>9}{'fixes':>7}{'forward':>9}{'smoothed':>9}{'inside':>8}  learnt")
    for name, (load, role) in LOGS.items():
        if wanted.only in {None, name}:
            settings = Settings.model_validate({"smoothing": {"filter": "navigation"}})
            drive = drive_of(load(settings), settings)
            for what in wanted.cases.split(","):
                if what != "none" or "odometry" in drive.log.fixes:
                    print(line(drive, name, role, what, tuple(map(float, wanted.begin.split(",")))), flush=True)


if __name__ == "__main__":
    main()
