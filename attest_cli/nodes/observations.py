"""Which measurements there are, when they count, and how noisy each is: Log + Segments + settings -> observations."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..maths import rotation
from ..records import Array, Bools, Fixes, Ints, Log, Segmentation, Warn, World
from ..sensors import Direction, Sensor
from ..sensors.heading import BodyHeading, FieldHeading
from ..sensors.orientation import Orientation
from ..settings import Settings
from .field import field_doubts, steepness
from .noise import Noise, reference_bias, stop_ranges
from .sun import sun_doubts

FIELD_CORRELATION_S = 5.0  # a disturbed magnetic field stays disturbed this long in motion (design note, question 1)
WINDOW_S = 10.0  # accelerometer window that stands in for a stop where a log has none
CORRELATION_S = 1.0  # readings of a direction or heading sensor within this share their error
FEW_HEADINGS = 4  # so many stops may all point one way
STOP_BLOCK_S = 1.0  # samples of a fast sensor at a stop are averaged over this


@dataclass(frozen=True, slots=True)
class Observation:
    """Samples of one sensor that make one update at time ``t``; ``still``: taken at a stop, where attitude is
    frozen.
    """

    role: str
    sensor: Sensor
    t: float
    times: Array
    values: Array
    noise: Array
    still: bool


def at_stop(t: Array, segmentation: Segmentation) -> Bools:
    """Return which times lie in the used part of a stop."""
    if not segmentation.stops:
        return np.zeros(len(t), dtype=np.bool_)
    start, end = np.array([(s.used_start, s.used_end) for s in segmentation.stops]).T
    before = np.searchsorted(start, t, side="right") - 1
    return np.asarray((before >= 0) & (t <= end[before]))


def observe(
    log: Log, segmentation: Segmentation, world: World, noise: Noise, settings: Settings
) -> tuple[list[Observation], list[Warn]]:
    """Return every observation in time order, with what the user should know about sensors that could not be used."""
    warnings: list[Warn] = []
    policy = settings.smoothing.absolute
    found = gravity_at_stops(log, segmentation, world, noise, settings)
    if not found or policy == "always":
        windows, told = gravity_in_windows(log, segmentation, world, settings)
        warnings += [] if found else told
        found += windows
    for role, build in (("sun", _sun), ("compass", _compass), ("orientation", _orientation)):
        if role in log.fixes:
            found += build(log.fixes[role], segmentation, world, settings, policy, warnings)
    if any(o.role == "sun" for o in found):
        warnings += sun_doubts(log.fixes["sun"], log, segmentation, world, settings)
    if "magnetometer" in log.fixes:
        if world.field_n is None and any(o.role in {"sun", "compass", "orientation"} for o in found):
            warnings.append(
                Warn("no-magnetic-reference",
                     "magnetometer not used: its north is not the true north of the other sensors",
                     "set [world] latitude_deg and longitude_deg, or magnetic_field_ut")
            )  # fmt: skip
        else:
            field = log.fixes["magnetometer"]
            iron, told = field_doubts(field, log, segmentation, world)
            warnings += told
            tilt = settings.imu.accel_bias_sigma / world.gravity * steepness(field, log, segmentation, world)
            found += _magnetometer(field, segmentation, world, settings, policy, float(np.hypot(iron, tilt)))
    return sorted(found, key=lambda o: o.t), warnings


def gravity_at_stops(
    log: Log, segmentation: Segmentation, world: World, noise: Noise, settings: Settings
) -> list[Observation]:
    """One update per stop: the accelerometer bias is shared by all its samples, so they do not average it away.

    It stands at the start of the stop, whose attitude is frozen: level first, then heading, keeps updates near linear.
    Without zero rate the attitude is not frozen, and gravity every second is what shows the gyro's bias: blocks of a
    second, each with so much noise that together they know no more than the accelerometer bias lets them.
    """
    out = []
    shared = _stops_that_share(segmentation, noise, settings.imu.accel_bias_sigma / world.gravity)
    for s, (lo, hi), alike in zip(segmentation.stops, stop_ranges(log, segmentation), shared, strict=True):
        if hi - lo < 3:
            continue
        span = s.used_end - s.used_start
        blocks = 1 if settings.smoothing.zero_rate else max(1, int(span / STOP_BLOCK_S))
        variance = noise.accel_density**2 * blocks / span + blocks * alike * settings.imu.accel_bias_sigma**2
        for rows in np.array_split(np.arange(lo, hi), blocks):
            mean = log.imu.accel_b[rows].mean(axis=0)
            when = s.used_start if settings.smoothing.zero_rate else float(np.mean(log.imu.t[rows]))
            up = (mean / np.linalg.norm(mean))[None]
            R = variance / world.gravity**2 * np.eye(2)
            out.append(Observation("gravity", _up(), when, np.array([when]), up, R, True))
    return out


def _stops_that_share(segmentation: Segmentation, noise: Noise, tilt: float) -> Array:
    r"""Return, per stop, how many stops the gyro links so closely that they share one accelerometer bias.

    One bias tilts all stops alike, and does not average away over stops between which the gyro drifts less than it:
    :math:`n_i=\sum_j 1/(1+d_{ij}^2/\sigma_t^2)`, :math:`d^2=N_r\Delta t+(N_r/T)\Delta t^2` with stops of length ``T``.
    """
    middle = np.array([0.5 * (s.used_start + s.used_end) for s in segmentation.stops])
    length = np.array([max(s.used_end - s.used_start, 1e-3) for s in segmentation.stops])
    apart = np.abs(middle[:, None] - middle)
    drift = noise.n_r * (apart + apart**2 / length)
    return np.asarray(np.sum(1.0 / (1.0 + drift / max(tilt, 1e-9) ** 2), axis=1))


def _up() -> Direction:
    return Direction(np.array([0.0, 0.0, 1.0]))


def gravity_in_windows(
    log: Log, segmentation: Segmentation, world: World, settings: Settings
) -> tuple[list[Observation], list[Warn]]:
    r"""Tilt in motion, for a log without a stop or by request: specific force turned by the gyro into the middle of
    long windows, and averaged.

    The mean acceleration of a window is what speed it gained over its length. Its size is not known: sigma is the
    largest of twice the misfit of the mean's norm to gravity, the change from window to window, and the steady
    acceleration :math:`\sqrt{2g\,\overline{|f|-g}}` that a mean misfit beyond the accelerometer's bias would need; to
    it comes what an unseen gyro bias about the vertical makes of the vehicle's lean within a window.
    """
    t, bias = log.imu.t, reference_bias(log, segmentation, log.imu.t)
    middles, means, turns = [], [], []
    for lo, hi in _long_windows(t, segmentation):
        dt = np.diff(t[lo:hi], prepend=t[lo])
        q = rotation.chain(rotation.exp_quaternion((log.imu.gyro_b[lo:hi] - bias[lo:hi]) * dt[:, None]))
        half = (hi - lo) // 2
        from_middle = rotation.matrix(rotation.multiply(rotation.conjugate(q[half]), q))
        means.append(np.einsum("mij,mj->i", from_middle, log.imu.accel_b[lo:hi]) / (hi - lo))
        turns.append((rotation.matrix(q[half]), from_middle[-1]))  # start -> middle -> end
        middles.append(float(t[lo + half]))
    if not means:
        return [], []
    vectors = np.array(means)
    misfit = np.linalg.norm(vectors, axis=1) - world.gravity
    follows = [k for k in range(len(means) - 1) if middles[k + 1] - middles[k] < 2.0 * WINDOW_S]
    change = np.array([(turns[k][1] @ turns[k + 1][0]).T @ means[k] - means[k + 1] for k in follows])
    excess = float(misfit.mean()) - 3.0 * settings.imu.accel_bias_sigma
    steady = float(np.sqrt(2.0 * world.gravity * max(excess, 0.0)))
    wandering = float(np.sqrt(np.mean(change**2))) if len(change) else 0.0
    largest = max(2.0 * float(np.sqrt(np.mean(misfit**2))), wandering, steady, settings.imu.accel_bias_sigma)
    up = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    leaning = float(np.sqrt(np.mean(np.sum((up - up.mean(axis=0)) ** 2, axis=1))))
    unseen = settings.imu.gyro_bias_sigma * 0.25 * WINDOW_S * leaning  # a bias about the vertical turns the lean
    sigma = float(np.hypot(largest / world.gravity, unseen))
    out = [
        Observation(
            "gravity", _up(), t_mid, np.array([t_mid]), (v / np.linalg.norm(v))[None], sigma**2 * np.eye(2), False
        )
        for t_mid, v in zip(middles, vectors, strict=True)
    ]
    deg = np.degrees(sigma)
    message = f"no stop: tilt comes from the accelerometer over windows of about {WINDOW_S:.0f} s, {deg:.1f} deg each"
    return out, [Warn("tilt-from-motion", message, "stop for 5 s or more at the start and the end of a drive")]


def _long_windows(t: Array, segmentation: Segmentation) -> list[tuple[int, int]]:
    """Return the samples ``[lo, hi)`` of the windows that share out every motion (the whole log where nothing is
    known).
    """
    out = []
    for s in segmentation.motions:
        edges = np.linspace(s.start, s.end, max(1, int((s.end - s.start) / WINDOW_S)) + 1)
        out += [(a, b) for a, b in pairwise(np.searchsorted(t, edges, side="right").tolist()) if b - a >= 10]
    return out


def _sun(
    fixes: Fixes, segmentation: Segmentation, world: World, settings: Settings, policy: str, warnings: list[Warn]
) -> list[Observation]:
    """Sun directions outside the singular cone about the vertical and inside the field of view."""
    if world.sun_n is None:
        warnings.append(
            Warn("no-sun-reference", "sun sensor not used: its reference direction is not known",
                 "set [world] sun_direction, or latitude_deg and longitude_deg")
        )  # fmt: skip
        return []
    cfg, still = settings.sun, at_stop(fixes.t, segmentation)
    reference = np.broadcast_to(world.sun_n, (len(fixes.t), 3))
    rows = cfg.components or fixes.values.shape[1]
    use = (still | (policy != "stops")) & (np.degrees(np.arccos(np.abs(reference[:, 2]))) >= cfg.min_angle_deg)
    use &= reference[:, 2] > 0.0
    across = np.hypot(fixes.values[:, 0], fixes.values[:, 1])
    if cfg.field_of_view_deg is not None:
        use &= across <= np.sin(np.radians(min(cfg.field_of_view_deg, 90.0)))
    if rows == 2:
        use &= across < 1.0 + 5 * np.radians(cfg.sigma_deg)
    if not use.any():
        message = f"none of {len(use)} sun measurements could be used"
        hint = "they are in motion with absolute = stops, out of view, or the sun is near the vertical"
        if not np.any(reference[:, 2] > 0.0):
            message += ": by its reference the sun is below the horizon"
            hint = "check [world] sun_direction (east, north, up), or time and place"
        warnings.append(Warn("sun-not-used", message, hint))
    R_sb = rotation.matrix(np.array(cfg.mounting)).T
    kind = "plane" if rows == 2 else "tangent"
    t, usable = fixes.t[use], Fixes("sun", fixes.channel, fixes.t[use], fixes.values[use])
    groups = _grouped(usable, segmentation, settings.smoothing.node_spacing_s, policy == "stops")
    R = np.radians(cfg.sigma_deg) ** 2 * _inflation(usable, groups) * np.eye(2)
    directions = reference[use]
    return [
        Observation(
            "sun", Direction(directions[g[0]], R_sb, kind), float(t[g].mean()), t[g], usable.values[g], R, still
        )
        for g, still in groups
    ]


def _inflation(fixes: Fixes, groups: list[tuple[Ints, bool]]) -> float:
    """Return the factor on a reading's variance: readings within a second share their error (mount, filter, field)."""
    if len(groups) < 2:
        return 1.0
    every = float(np.median(np.diff([fixes.t[g[0]] for g, _ in groups])))
    return max(1.0, CORRELATION_S / max(every, 1e-3))


def _grouped(fixes: Fixes, segmentation: Segmentation, spacing: float, only_stops: bool) -> list[tuple[Ints, bool]]:
    """Group the samples of a sensor: bins of a second at stops and of the node spacing in motion, else one by one."""
    still = at_stop(fixes.t, segmentation)
    stop_number = np.searchsorted([s.used_start for s in segmentation.stops], fixes.t, side="right")
    bins = np.where(still, np.floor(fixes.t / STOP_BLOCK_S), np.floor(fixes.t / spacing))
    order = np.flatnonzero(still | (not only_stops))
    key = np.stack([still[order], stop_number[order] * still[order], bins[order]])
    cuts = np.flatnonzero(np.any(np.diff(key, axis=1) != 0, axis=0)) + 1
    return [(g, bool(still[g[0]])) for g in np.split(order, cuts) if len(g)]


def _compass(
    fixes: Fixes, segmentation: Segmentation, world: World, settings: Settings, policy: str, warnings: list[Warn]
) -> list[Observation]:
    groups = _grouped(fixes, segmentation, settings.smoothing.node_spacing_s, policy == "stops")
    R = np.radians(settings.compass.sigma_deg) ** 2 * _inflation(fixes, groups) * np.eye(1)
    return [
        Observation("compass", BodyHeading(), float(fixes.t[g].mean()), fixes.t[g], fixes.values[g], R, still)
        for g, still in groups
    ]


def _orientation(
    fixes: Fixes, segmentation: Segmentation, world: World, settings: Settings, policy: str, warnings: list[Warn]
) -> list[Observation]:
    groups = _grouped(fixes, segmentation, settings.smoothing.node_spacing_s, policy == "stops")
    R = np.radians(settings.orientation.sigma_deg) ** 2 * _inflation(fixes, groups) * np.eye(3)
    return [
        Observation("orientation", Orientation(), float(fixes.t[g].mean()), fixes.t[g], fixes.values[g], R, still)
        for g, still in groups
    ]


def _magnetometer(
    fixes: Fixes, segmentation: Segmentation, world: World, settings: Settings, policy: str, iron: float
) -> list[Observation]:
    """One heading per stop, with the error of the place and of ``iron`` or tilt, rad; in motion (``always``) one a
    second, inflated for its correlation. What iron does to heading is the same wherever the body points the same way:
    headings that are few share it.
    """
    azimuth = 0.5 * np.pi if world.field_n is None else float(np.arctan2(world.field_n[1], world.field_n[0]))
    shared = min(max(len(segmentation.stops), 1), FEW_HEADINGS)
    sensor, place = FieldHeading(azimuth), np.radians(settings.magnetometer.sigma_deg) ** 2 + shared * iron**2
    still = at_stop(fixes.t, segmentation)
    out = []
    for s in segmentation.stops:
        lo, hi = np.searchsorted(fixes.t, s.used_start), np.searchsorted(fixes.t, s.used_end, side="right")
        if hi > lo:
            mean, when = fixes.values[lo:hi].mean(axis=0)[None], s.used_start
            out.append(Observation("magnetometer", sensor, when, np.array([when]), mean, np.array([[place]]), True))
    if policy == "always" or (policy == "auto" and not segmentation.stops):
        moving = np.flatnonzero(~still)
        bins = np.floor(fixes.t[moving])
        inflated = np.array([[place * max(1.0, 2 * FIELD_CORRELATION_S)]])
        for g in np.split(moving, np.flatnonzero(np.diff(bins)) + 1):
            if len(g):
                centre = g[len(g) // 2 : len(g) // 2 + 1]
                out.append(Observation("magnetometer", sensor, float(fixes.t[centre[0]]), fixes.t[centre],
                                       fixes.values[centre], inflated, False))  # fmt: skip
    return out
