"""A simulated drive smoothed with defaults, and again with what ``attest calibrate-bias`` finds in its own stops.

Nobody states the IMU's noise: the defaults take it from the stops, tempered by what is usual of a MEMS gyro. Rover
drives of half an hour (S2: accelerometer bias, motions of 60-120 s) in four kinds:
plain: as simulated; steady: a gyro whose bias walks a tenth of that; restless: ten times; warm-up: an exponential
drift of 0.1 deg/s on top. The simulated gyro has no scale error; attest assumes one of 0.3 % both times, for no
calibration at rest can tell it, and --exact-scale states for both that there is none.
Errors are RMS over motion at the nodes, pooled over drives; NEES are means over motion, then over drives (6 and 3
expected). "better on": drives whose attitude error is smaller with the calibration; "gain": mean over drives of
1 - RMSE ratio, with its standard error.

Run: PYTHONPATH=. python benchmarks/accuracy/own_calibration.py [--drives 24] [--first-seed 3000] [--only plain]
     [--exact-scale]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tests"))

from support.drives import mrad, nees  # noqa: E402 (path above)

from attest_cli.calibration.calibrate import calibrate  # noqa: E402
from attest_cli.estimate import estimate  # noqa: E402
from attest_cli.maths import rotation  # noqa: E402
from attest_cli.pipeline import informed  # noqa: E402
from attest_cli.prepare import prepare  # noqa: E402
from attest_cli.records import Channel, Recording  # noqa: E402
from attest_cli.segment import find_segments  # noqa: E402
from attest_cli.settings import Effective, Settings  # noqa: E402
from attest_cli.simulate import RoverOptions, simulate_rover  # noqa: E402
from attest_cli.simulate.rover import rover_drive  # noqa: E402
from attest_cli.writers.calibration import describe, write_calibration  # noqa: E402

Array = NDArray[np.float64]
DURATION_S, MOTION_S = 1800.0, (60.0, 120.0)
WARM_UP_RAD_S, WARM_UP_S = np.radians(0.1), 600.0
WALKS = {"plain": 1.0, "steady": 0.1, "restless": 10.0, "warm-up": 1.0}
HEADER = (
    f"{'':<12}{'attitude RMSE, mrad':>24}{'gain':>16}{'better':>9}{'NEES of 6':>18}{'NEES of 3':>18}\n"
    f"{'':<12}{'default':>12}{'own':>12}{'%':>16}{'on':>9}{'default':>9}{'own':>9}{'default':>9}{'own':>9}"
)


@dataclass(frozen=True)
class Score:
    """Of one drive in motion: mean squared attitude error, rad^2, mean NEES of six states and of the attitude."""

    attitude: float
    nees: float
    nees_attitude: float


@dataclass(frozen=True)
class Case:
    """A drive as recorded, what is known of it besides the IMU's noise, and its true gyro bias (n, 3)."""

    log: Recording
    tables: dict[str, dict[str, object]]
    options: RoverOptions
    bias: Array


def case(kind: str, seed: int, *, exact_scale: bool = False) -> Case:
    """Simulate a drive and change its gyro bias."""
    options = RoverOptions(seed=seed, duration_s=DURATION_S, scenario="S2", motion_s=MOTION_S)
    made = simulate_rover(options)
    bias = np.column_stack([made.truth[f"gyro_bias_{axis}_rad_s"] for axis in "xyz"])
    change = (WALKS[kind] - 1.0) * (bias - bias[0])
    if kind == "warm-up":
        signs = np.random.default_rng([seed, 7]).choice([-1.0, 1.0], 3)
        t = np.asarray(made.truth["t_s"])
        change = change + WARM_UP_RAD_S * np.expm1(-t / WARM_UP_S)[:, None] * signs
    tables = {name: dict(table) for name, table in made.settings.items() if name != "imu"}
    tables["imu"] = {"mounting": made.settings["imu"]["mounting"], **({"gyro_scale_sigma": 0.0} if exact_scale else {})}
    return Case(_with_bias(made.log, change), tables, options, bias + change)


def _with_bias(log: Recording, change: Array) -> Recording:
    """Return the recording with ``change`` (n, 3) added to its gyro."""
    channels = []
    for c in log.channels:
        values = {**c.values}
        if c.role == "imu":
            values |= {f"gyro_{axis}": c.values[f"gyro_{axis}"] + change[:, k] for k, axis in enumerate("xyz")}
        channels.append(Channel(c.name, c.kind, c.role, c.stamps_ns, values, c.units, c.frame_id))
    return replace(log, channels=tuple(channels))


def smoothed(work: Case, calibration: Path | None) -> Score:
    """Smooth as ``attest smooth`` does, and judge against the truth."""
    tables = {**work.tables, "imu": {**work.tables["imu"], "calibration": calibration}}
    effective = Effective(Settings.model_validate(tables), {})
    log = prepare([work.log], effective.settings)
    segmentation = find_segments(log, effective.settings)
    found = estimate(log, segmentation, informed(effective, log).settings).smoothed
    truth = rover_drive(work.options).at(found.t)
    attitude = rotation.log_quaternion(rotation.multiply(rotation.conjugate(found.q), truth.q_nb))
    bias = found.bias if log.calibrated is None else found.bias + log.calibrated.at(found.t)
    true_bias = np.column_stack([np.interp(found.t, log.imu.t, work.bias[:, k]) for k in range(3)])
    errors, moving = np.hstack([attitude, true_bias - bias]), truth.moving
    return Score(
        float(np.mean(np.sum(attitude[moving] ** 2, axis=1))),
        float(nees(errors[moving], found.P[moving]).mean()),
        float(nees(attitude[moving], found.P[moving, :3, :3]).mean()),
    )


def own(work: Case, folder: Path) -> Path:
    """Calibrate from the drive's own stops, in the axes of the sensor, and write the file."""
    tables = {**work.tables, "imu": {}}
    settings = Settings.model_validate(tables)
    log = prepare([work.log], settings)
    path = folder / "calibration.toml"
    write_calibration(describe(calibrate(log, find_segments(log, settings), settings), [], "/imu/data"), path)
    return path


def table(kind: str, seeds: range, *, exact_scale: bool = False) -> str:
    """One line of the table."""
    pairs = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in seeds:
            work = case(kind, seed, exact_scale=exact_scale)
            pairs.append((smoothed(work, None), smoothed(work, own(work, Path(folder)))))
    rmse = np.sqrt([[a.attitude, b.attitude] for a, b in pairs])
    gain = 100.0 * (1.0 - rmse[:, 1] / rmse[:, 0])
    error = float(np.std(gain, ddof=1)) / np.sqrt(len(gain)) if len(gain) > 1 else float("nan")
    pooled = [mrad(float(np.mean([pair[k].attitude for pair in pairs]))) for k in range(2)]
    six = [float(np.mean([pair[k].nees for pair in pairs])) for k in range(2)]
    three = [float(np.mean([pair[k].nees_attitude for pair in pairs])) for k in range(2)]
    better = f"{int(np.sum(gain > 0.0))}/{len(gain)}"
    return (
        f"{kind:<12}{pooled[0]:>12.2f}{pooled[1]:>12.2f}{gain.mean():>9.1f} ± {error:<4.1f}{better:>9}"
        f"{six[0]:>9.2f}{six[1]:>9.2f}{three[0]:>9.2f}{three[1]:>9.2f}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drives", type=int, default=24, help="drives of each kind")
    parser.add_argument("--first-seed", type=int, default=3000)
    parser.add_argument("--only", choices=sorted(WALKS), help="one kind")
    parser.add_argument("--exact-scale", action="store_true", help="state that the gyro has no scale error")
    options = parser.parse_args()
    begin = time.process_time()
    print(HEADER)
    for kind in WALKS if options.only is None else [options.only]:
        seeds = range(options.first_seed, options.first_seed + options.drives)
        print(table(kind, seeds, exact_scale=options.exact_scale), flush=True)
    print(f"{options.drives} drives each, CPU in all {time.process_time() - begin:.0f} s")


if __name__ == "__main__":
    main()
