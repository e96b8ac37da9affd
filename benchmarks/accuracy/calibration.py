"""Calibration against simulated truth: bias models, whiteness, noise densities with their intervals, accelerometer,
magnetometer.

Run: PYTHONPATH=. OPENBLAS_NUM_THREADS=1 python benchmarks/accuracy/calibration.py [--seeds 30] [--only stops]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter, defaultdict
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tests"))

from support import still  # noqa: E402 (path above)

from attest_cli.calibration.accelerometer import fit_accelerometer  # noqa: E402
from attest_cli.calibration.bias import bias_between, choose, fit_models  # noqa: E402
from attest_cli.calibration.magnetometer import fit_magnetometer  # noqa: E402
from attest_cli.calibration.noise import fit_noise  # noqa: E402
from attest_cli.calibration.records import NoiseFit  # noqa: E402
from attest_cli.calibration.rest import cut, means  # noqa: E402
from attest_cli.calibration.spectrum import white_samples  # noqa: E402
from attest_cli.calibration.whiteness import judge_whiteness  # noqa: E402
from attest_cli.maths.bias import curve  # noqa: E402

MODELS = ("constant", "ramp", "exponential", "temperature", "random-walk")


def gyrostar(seeds: int) -> None:
    """The gyro of Barshan & Durrant-Whyte at rest: parameters, whiteness of the residual and of the raw record."""
    print(f"Gyrostar, exponential on a thousand means (deg/s, s), {seeds} seeds; true {still.GYROSTAR}")
    print(f"{'record':>8}{'C1':>17}{'C2':>17}{'T':>16}{'white':>8}{'raw':>6}  chosen")
    for seconds in (600.0, 1200.0, 3600.0):
        values, white, raw, chosen = [], 0, 0, Counter[str]()
        for seed in range(seeds):
            t, rate = still.gyrostar(np.random.default_rng([seed, 1]), seconds)
            blocks, edges = cut([still.piece(len(t), still.GYROSTAR_STEP_S)], seconds / 1000.0)
            models, _ = fit_models(blocks, means([rate], edges))
            chosen[choose(models, static=True)] += 1
            raw += judge_whiteness([rate], still.GYROSTAR_STEP_S).white
            if "exponential" in models:
                found = models["exponential"].model.values
                values.append(found)
                white += judge_whiteness([rate - curve("exponential", found, t)], still.GYROSTAR_STEP_S).white
        mean, sd = np.mean(values, axis=0), np.std(values, axis=0, ddof=1)
        spelled = f"{_pm(mean[0], sd[0], 4)}{_pm(mean[1], sd[1], 4)}{_pm(mean[2], sd[2], 1)}"
        print(f"{seconds:8.0f}{spelled}{100 * white / len(values):7.0f}%{100 * raw / seeds:5.0f}%  {dict(chosen)}")


def _pm(mean: float, sd: float, digits: int) -> str:
    return f"{mean:{9}.{digits}f} ± {sd:.{digits}f}"


def stops(seeds: int, minutes: float, every: float, stop: float) -> None:
    """Bias over the whole of a drive from its stops, by every model, and by the one that attest chooses."""
    print(f"\n{minutes:.0f} min drive, {stop:.0f} s stop each {every:.0f} s, N .01, K 5e-4; {seeds} seeds")
    print("rms bias error over the whole drive, 1e-3 deg/s; error over its own sigma at the stops; what was chosen")
    columns = ("first stop", *MODELS, "lowest BIC", "attest")
    print(f"{'truth':<20}" + "".join(f"{c:>13}" for c in columns))
    for bias in still.BIASES:
        squares, ratio, chosen = defaultdict[str, list[float]](list), [], Counter[str]()
        for seed in range(seeds):
            drive = still.stops(np.random.default_rng([seed, 4]), bias, minutes, every, stop)
            blocks, edges = cut(drive.pieces, stop / 32.0)
            warmth = means(drive.warmth, edges)
            models, _ = fit_models(blocks, means(drive.rates, edges), warmth)
            squares["first stop"].append(float(np.mean((drive.rates[0].mean() - drive.bias) ** 2)))
            for name, fitted in models.items():
                found = bias_between(fitted.model, blocks.t, drive.t, (warmth, drive.temperature))
                squares[name].append(float(np.mean((found - drive.bias) ** 2)))
            name = choose(models, static=False)
            chosen[name] += 1
            squares["lowest BIC"].append(squares[choose(models, static=True)][-1])
            squares["attest"].append(squares[name][-1])
            model = models[name].model
            ratio.append(np.mean(((model.fitted - np.interp(blocks.t, drive.t, drive.bias)) / model.sigma) ** 2))
        cells = "".join(
            f"{1e3 * np.sqrt(np.mean(squares[c])):13.2f}" if len(squares[c]) == seeds else f"{'-':>13}" for c in columns
        )
        print(f"{bias:<20}{cells}   {np.sqrt(np.mean(ratio)):.2f} {dict(chosen)}")


def noise(seeds: int) -> None:
    """N and K by maximum likelihood: error, and how often the 95 % intervals hold the truth."""
    print(f"\nNoise densities, {seeds} seeds: errors %, how often the 95 % intervals hold the truth %")
    columns = ("N rms", "N mean", "N held", "K rms", "K mean", "K held", "K seen", "CPU s")
    print(f"{'record':<34}" + "".join(f"{c:>8}" for c in columns))
    for label, samples, period, N, K in (
        ("2 h at 20 Hz, N .01 K 2e-4", 144_000, 0.05, 0.01, 2e-4),
        ("10 min at 20 Hz, the same", 12_000, 0.05, 0.01, 2e-4),
        ("2 h at 100 Hz, the same", 720_000, 0.01, 0.01, 2e-4),
        ("10 min at 20 Hz, no walk", 12_000, 0.05, 0.01, 0.0),
    ):
        found, begin = [], time.process_time()
        for seed in range(seeds if samples < 500_000 else max(2, seeds // 5)):
            rate = still.walking(np.random.default_rng([seed, 2]), samples, period, N, K)
            found.append(fit_noise([still.piece(samples, period)], [rate], 1, across=True))
        print(f"{label:<34}{_row(found, N, K)}{(time.process_time() - begin) / len(found):8.2f}")
    for across in (True, False):
        found = []
        for seed in range(seeds):
            drive = still.stops(np.random.default_rng([seed, 4]), "random walk")
            found.append(fit_noise(drive.pieces, drive.rates, 1, across=across))
        label = "30 min drive, " + ("steps between stops too" if across else "within stops only")
        print(f"{label:<38}{_row(found, 0.01, 5e-4)[4:]}")


def _row(found: list[NoiseFit], N: float, K: float) -> str:
    errors = np.array([[f.N / N - 1.0, (f.K or 0.0) / K - 1.0 if K else np.nan] for f in found]) * 100.0
    held = np.array([[f.N_interval[0] <= N <= f.N_interval[1], f.K_interval[0] <= K <= f.K_interval[1]] for f in found])
    rms, mean, inside = np.sqrt(np.mean(errors**2, axis=0)), errors.mean(axis=0), 100.0 * held.mean(axis=0)
    seen = 100.0 * np.mean([f.K is not None for f in found])
    return "".join(f"{c:8.2f}" for c in (rms[0], mean[0], inside[0], rms[1], mean[1], inside[1], seen))


def low_pass(seeds: int) -> None:
    """A sensor with a low-pass of its own: N from single samples, and from the band that attest chooses."""
    from scipy.signal import butter, lfilter

    print(f"\n10 min at 100 Hz behind a 2nd-order low-pass, {seeds} seeds: error of N %, mean ± standard deviation")
    for corner in (5.0, 10.0, 20.0, 40.0):
        b, a = butter(2, corner, fs=100.0)
        errors, chosen = defaultdict[str, list[float]](list), Counter[int]()
        for seed in range(seeds):
            rate = lfilter(b, a, still.walking(np.random.default_rng([seed, 3]), 60_000, 0.01, 0.01, 0.0))
            pieces, white = [still.piece(len(rate), 0.01)], white_samples([[rate]], 0.01)[0]
            chosen[white] += 1
            for label, m in (("single samples", 1), ("attest", white)):
                errors[label].append(100.0 * (fit_noise(pieces, [rate], m, across=True).N / 0.01 - 1.0))
        spelled = {label: f"{np.mean(e):.2f} ± {np.std(e):.2f}" for label, e in errors.items()}
        print(f"corner {corner:4.0f} Hz: {spelled}, samples per cycle of the band's top: {dict(chosen)}")


def tilt(seeds: int) -> None:
    """Tilt error of an accelerometer after its fit, against its own sigma (means of 200 samples of .0294 m/s^2)."""
    print(f"\nAccelerometer, {seeds} seeds: tilt error, deg rms per axis; own sigma; residual of the norm, m/s^2")
    for count in (12, 18, 24, 48):
        errors, own, raw, residual, refused = [], [], [], [], 0
        for seed in range(seeds):
            rng = np.random.default_rng([seed, 5])
            unit = still.accelerometer(rng)
            sigma = 0.0294 / np.sqrt(200)
            force = unit.raw(still.GRAVITY * still.attitudes(rng, count)) + rng.normal(0.0, sigma, (count, 3))
            found, _ = fit_accelerometer(force, np.full(count, sigma), still.GRAVITY)
            if found is None:
                refused += 1
                continue
            test = still.all_over(rng, 200)
            seen = unit.raw(still.GRAVITY * test)
            errors.append(still.apart_deg((seen + found.bias) @ found.matrix.T, test))
            raw.append(still.apart_deg(seen, test))
            own.append(np.degrees(found.tilt_sigma))
            residual.append(found.residual)
        before, after, stated = (np.sqrt(np.mean(np.square(x))) for x in (raw, errors, own))
        print(
            f"{count:3d} attitudes: raw {before:.3f}, fitted {after:.4f}, sigma {stated:.4f}, "
            f"residual {np.mean(residual):.5f}; refused {refused}"
        )


def iron(seeds: int) -> None:
    """Direction error of a magnetometer after its fit, 400 readings of 0.5 % noise all over the sphere."""
    errors, raw = [], []
    for seed in range(seeds):
        rng = np.random.default_rng([seed, 6])
        u, box = still.all_over(rng, 400), still.iron(rng)
        clean = box.raw(still.FIELD * u)
        found, why = fit_magnetometer(clean + rng.normal(0.0, 0.005 * still.FIELD, clean.shape))
        assert found is not None, why
        errors.append(still.apart_deg((clean - found.offset) @ found.matrix.T, u))
        raw.append(still.apart_deg(clean, u))
    print(
        f"\nMagnetometer, {seeds} seeds, direction error, deg rms per axis, median: raw {np.median(raw):.1f}, ", end=""
    )
    print(f"fitted {np.median(errors):.3f}")


def drives(seeds: int) -> None:
    """The table of bias models on three kinds of drive."""
    for minutes, every, stop in ((30.0, 60.0, 6.0), (10.0, 60.0, 6.0), (6.0, 150.0, 12.0), (60.0, 300.0, 10.0)):
        stops(seeds, minutes, every, stop)


def main() -> None:
    """Print the tables that were asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    tables = {"gyrostar": gyrostar, "stops": drives, "noise": noise, "low-pass": low_pass, "tilt": tilt, "iron": iron}
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--only", choices=tuple(tables), default=None)
    given = parser.parse_args()
    for name, table in tables.items():
        if given.only in {None, name}:
            table(given.seeds)


if __name__ == "__main__":
    main()
