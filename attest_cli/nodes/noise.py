"""Noise of the IMU: as the settings state it, else from the log's own stops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..maths.consistency import upper_quantile
from ..records import Array, Log, Segmentation, Warn
from ..settings import Settings

ASSUMED_GYRO_DENSITY = 5e-4  # rad/s/sqrt(Hz), 1.7 deg/sqrt(h): a consumer MEMS gyro; only where a log has no stop
ASSUMED_ACCEL_DENSITY = 3e-3  # m/s^2/sqrt(Hz), 300 ug/sqrt(Hz)
ASSUMED_SCALE = 3e-3  # scale and misalignment of a factory-calibrated MEMS gyro
SCALE_CORRELATION_S = 2.0  # a rate lasts about this long: its scale error counts as noise of this correlation time
ASSUMED_GYRO_WALK = 2e-5  # rad/s^2/sqrt(Hz): a consumer MEMS gyro
WALK_WEIGHT = 3.0  # the assumption counts like three pairs of stops
CALIBRATION, REFUTED = "calibration", "log's stops, which refute what is stated"  # sources
FAR_OFF, SURE, NOISIER = 5.0, 1e-6, 1.5  # sigma, chance and factor from which a log contradicts its calibration
BLOCK_S = 0.5  # block whose mean shows the noise below the sensor's own low-pass


@dataclass(frozen=True, slots=True)
class Noise:
    """Densities: gyro rad/s/sqrt(Hz), its bias walk rad/s^2/sqrt(Hz), accelerometer m/s^2/sqrt(Hz); where each is from.

    ``gyro_scale``: scale error of the gyro, a share of the rate.
    """

    gyro_density: float
    gyro_walk: float
    accel_density: float
    sources: Mapping[str, str]
    gyro_scale: float = 0.0

    @property
    def n_r(self) -> float:
        """Spectral density of the gyro noise, (rad/s)^2/Hz (the paper's N_r)."""
        return self.gyro_density**2

    @property
    def n_w(self) -> float:
        """Spectral density of the bias walk, (rad/s^2)^2/Hz (the paper's N_w)."""
        return self.gyro_walk**2


def motion_density(noise: Noise, rate: Array) -> Array:
    r"""Return the spectral density of the gyro in motion, (rad/s)^2/Hz: :math:`N_r+2\tau s^2|\bar\omega|^2`.

    ``rate`` (m, 3): bias-free rate, rad/s, averaged over a second so that vibration, whose scale error averages out,
    does not count.
    """
    return np.asarray(noise.n_r + 2.0 * SCALE_CORRELATION_S * noise.gyro_scale**2 * np.sum(rate**2, axis=1))


def added_density(t: Array, density: Array | None, edges: Array) -> Array:
    r"""Return what noisier samples add to the noise between ``edges`` (m + 1,) s: the mean (m,) of their spectral
    density, :math:`\frac1T\int n_c^2\,dt`.

    ``density`` (n,): that of the samples at ``t``, per sqrt(Hz), linear in between; None adds nothing.
    """
    if density is None:
        return np.zeros(len(edges) - 1)
    added = 0.5 * (density[1:] ** 2 + density[:-1] ** 2) * np.diff(t)
    total = np.interp(edges, t, np.concatenate([[0.0], np.cumsum(added)]))
    return np.asarray(np.diff(total) / np.diff(edges))


def stop_ranges(log: Log, segmentation: Segmentation) -> list[tuple[int, int]]:
    """Return the IMU samples ``[lo, hi)`` of the used part of each stop."""
    t = log.imu.t
    return [(int(np.searchsorted(t, s.used_start)), int(np.searchsorted(t, s.used_end))) for s in segmentation.stops]


def density(blocks: list[tuple[Array, float]], taus: Sequence[float] = (0.0, BLOCK_S)) -> float | None:
    r"""Return the white-noise density of samples at rest, or None where there are too few.

    Largest of :math:`\sigma_A(\tau)\sqrt\tau` (Allan deviation) at one sample and at half a second: a sensor with an
    internal low-pass looks quieter at one sample than it is.
    """
    found = []
    for tau in taus:
        total, weight = 0.0, 0
        for values, dt in blocks:
            per = max(1, round(tau / dt))
            n = len(values) // per
            if n < 3:
                continue
            means = values[: n * per].reshape(n, per, 3).mean(axis=1)
            total += float(np.sum(np.diff(means, axis=0) ** 2)) / 2.0 * per * dt
            weight += 3 * (n - 1)
        if weight >= 30:
            found.append(np.sqrt(total / weight))
    return float(max(found)) if found and max(found) > 0.0 else None


def bias_walk(means: Array, times: Array, spans: Array, n_r: float) -> float:
    """Return the bias walk density from the mean rates (k, 3) of stops at ``times`` (k,), tempered by the
    assumption.
    """
    total, weight = WALK_WEIGHT * ASSUMED_GYRO_WALK**2, WALK_WEIGHT
    if len(means) > 1:
        excess = np.diff(means, axis=0) ** 2 - (n_r * (1 / spans[1:] + 1 / spans[:-1]))[:, None]
        total += max(0.0, float(np.sum(excess.mean(axis=1) / np.diff(times))))
        weight += len(means) - 1
    return float(np.sqrt(total / weight))


def find_noise(log: Log, segmentation: Segmentation, settings: Settings) -> Noise:
    """Return the noise of the IMU; each figure from the settings, else from a calibration, else from the log's stops,
    else assumed (and said).
    """
    t, wanted, sources = log.imu.t, settings.imu, {}
    measured = {} if log.calibrated is None else log.calibrated.noise
    ranges = [(lo, hi) for lo, hi in stop_ranges(log, segmentation) if hi - lo >= 10]
    dt = [float(np.median(np.diff(t[lo:hi]))) for lo, hi in ranges]

    def pick(name: str, stated: float | None, found: float | None, assumed: float) -> float:
        known = {"settings": stated, CALIBRATION: measured.get(name), "log's stops": found, "assumed": assumed}
        sources[name], value = next((source, value) for source, value in known.items() if value is not None)
        return value

    at_rest = [(log.imu.gyro_b[lo:hi], d) for (lo, hi), d in zip(ranges, dt, strict=True)]
    refuted = refuting(wanted.gyro_noise_density, at_rest)
    gyro = pick("gyro_noise_density", refuted or wanted.gyro_noise_density, density(at_rest), ASSUMED_GYRO_DENSITY)
    sources["gyro_noise_density"] = REFUTED if refuted else sources["gyro_noise_density"]
    pushed = [(log.imu.accel_b[lo:hi], d) for (lo, hi), d in zip(ranges, dt, strict=True)]
    accel = pick("accel_noise_density", wanted.accel_noise_density, density(pushed), ASSUMED_ACCEL_DENSITY)
    walk = None
    if len(ranges) > 1:
        means = np.array([values.mean(axis=0) for values, _ in at_rest])
        centre = np.array([0.5 * (t[lo] + t[hi - 1]) for lo, hi in ranges])
        span = np.array([(hi - lo) * d for (lo, hi), d in zip(ranges, dt, strict=True)])
        walk = bias_walk(means, centre, span, gyro**2)
    scale = pick("gyro_scale_sigma", wanted.gyro_scale_sigma, None, ASSUMED_SCALE)
    return Noise(
        gyro, pick("gyro_random_walk", wanted.gyro_random_walk, walk, ASSUMED_GYRO_WALK), accel, sources, scale
    )


def refuting(stated: float | None, at_rest: list[tuple[Array, float]]) -> float | None:
    """Return the density that the stops show where it is beyond what is stated; over half a second vibration is gone,
    so that a running engine refutes nothing.
    """
    found = density(at_rest, (BLOCK_S,)) if stated is not None else None
    return found if found is not None and stated is not None and found > NOISIER * stated else None


def contradictions(log: Log, segmentation: Segmentation, noise: Noise, settings: Settings) -> list[Warn]:
    """Return what at the log's stops contradicts the noise that is stated, or its calibration, the first alone: bias,
    noise, walk of the bias.
    """
    known, stated = log.calibrated, settings.imu.gyro_noise_density
    if noise.sources["gyro_noise_density"] == REFUTED and stated is not None:
        fact = f"the gyro is {noise.gyro_density / stated:.2g} times as noisy at the stops as stated"
        return [Warn("gyro-noise-refuted", f"{fact}: what the stops show is used", "mend [imu] gyro_noise_density")]
    ranges = [(lo, hi) for lo, hi in stop_ranges(log, segmentation) if hi - lo >= 10]
    if known is None or not ranges:
        return []
    t, rates = log.imu.t, [log.imu.gyro_b[lo:hi] for lo, hi in ranges]
    means = np.array([rate.mean(axis=0) for rate in rates])
    span = np.array([t[hi - 1] - t[lo] for lo, hi in ranges])
    middle = np.array([0.5 * (t[lo] + t[hi - 1]) for lo, hi in ranges])
    sigma = np.hypot(settings.imu.gyro_bias_sigma, noise.gyro_density / np.sqrt(span[0]))
    off = float(np.abs(means[0]).max())
    if off > FAR_OFF * sigma:
        fact = f"the gyro's bias at the first stop is {np.degrees(off):.3g} deg/s off, {off / sigma:.0f} sigma"
        hint = "of another sensor, other axes or another day's temperature? the log's own stops were used"
        return [Warn("calibration-bias", f"{known.name}: {fact}", hint)]
    found = density([(rate, float(np.median(np.diff(t[lo:hi])))) for rate, (lo, hi) in zip(rates, ranges, strict=True)])
    if found is not None and noise.sources["gyro_noise_density"] == CALIBRATION:
        times = found / noise.gyro_density
        if not 1.0 / NOISIER < times < NOISIER:
            fact = f"the gyro is {times:.2g} times as noisy at this log's stops"
            return [Warn("calibration-noise", f"{known.name}: {fact}", "did something shake, or is it another sensor?")]
    if noise.sources["gyro_random_walk"] == CALIBRATION and len(means) > 1:
        allowed = noise.n_r * (1 / span[1:] + 1 / span[:-1]) + noise.n_w * np.diff(middle)
        moved = float(np.sum(np.diff(means, axis=0) ** 2 / allowed[:, None]))
        dof = 3 * len(allowed)
        if moved > upper_quantile(dof, SURE):
            fact = f"the gyro's bias moves {np.sqrt(moved / dof):.2g} times more from stop to stop than it says"
            return [Warn("calibration-walk", f"{known.name}: {fact}", "attest calibrate-bias of this log fits it")]
    return []


def reference_bias(log: Log, segmentation: Segmentation, at: Array) -> Array:
    """Return the gyro bias (k, 3) to preintegrate with at times ``at`` (k,): between the mean rates of the stops."""
    ranges = [(lo, hi) for lo, hi in stop_ranges(log, segmentation) if hi - lo >= 10]
    if not ranges:
        return np.tile(segmentation.bias_b, (len(at), 1))
    means = np.array([log.imu.gyro_b[lo:hi].mean(axis=0) for lo, hi in ranges])
    centre = np.array([0.5 * (log.imu.t[lo] + log.imu.t[hi - 1]) for lo, hi in ranges])
    return np.stack([np.interp(at, centre, means[:, i]) for i in range(3)], axis=1)
