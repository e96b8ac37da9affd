"""From a drive to the problem of its navigation: which states, which aids, how noisy, and where to begin."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...maths import rotation
from ...maths.consistency import MAD
from ...nodes import Nodes
from ...nodes.noise import added_density
from ...records import Array, Warn
from ...wheels import Judged
from .. import Drive
from ..choice import LIVELY_RAD_S, liveliness
from ..scale import AS_IT_COMES
from . import colours, jumps
from .aids import Aid, Bound, Magnetometer, Place, Seen, Wheels, ZeroRate
from .field import field_at_nodes, field_states, start_field, tuned_field
from .fixes import FAST_M_S, LAG_SIGMA_S, far_off, origin_of, place_of, place_states
from .model import Inertial, Trajectory, inertial_of
from .north import north_sigma
from .offsets import offset_states
from .start import heading_of_velocity, heading_of_wheels, heading_offset, mirrored
from .states import Layout, State, layout
from .streams import clock_of, height_of, velocity_of
from .wheels import wheel_states, wheels_of

TILT_SIGMA, HEADING_SIGMA, DATUM = 0.3, 1.0, 1e-4  # rad, at the first node
STILL_M_S = 0.01  # a stop may rock this much
SPEED_S, PLACE_S = 1.0, 10.0  # correlation times of the bounds: speed turns soon, who stands elsewhere stays there
RATE_SHARE = 1e-3  # of the rate: what scale and misalignment leave as noise, rad/s/sqrt(Hz)
ACCEL_FLOOR, ACCEL_SHARE = 0.05, 0.03  # m/s^2/sqrt(Hz) in motion where no density is stated; share of the acceleration
ARM_SIGMA_M = 0.5  # where an antenna or the wheels may be from the IMU
NEAR_M = 100.0  # how far off the start may be at once; further for every second before the first fix
ROLLING_M_S = 30.0  # of what has wheels, m/s at the start
NORTH_RAD, WENT = 0.5, 5.0  # sigma of a heading that is shown; share of their sigma by which places have to spread
MOVING = {"odometry", "gps", "gps_velocity", "position"}  # sensors of how it moves: it may be fast
MOTIONS = {  # place m, speed m/s of a motion without any sensor of them
    "handheld": (2.0, 1.0),
    "static": (0.1, 0.01),
    "rover": (np.inf, 1.0),
    "vehicle": (np.inf, 30.0),
    "drone": (np.inf, 15.0),
}
HAND_WALK, HAND_RAD_S = 4e-4, 0.25  # rad/s^2/sqrt(Hz): bias of a MEMS gyro in a hand that turns it so; none stated
MOST_NODES = 12_000  # about 4 GB at 30 states
LIVELY_SPACING_S = 0.05  # between nodes of such a log; 0.1 s costs 3 % of accuracy there

Tune = Callable[[Sequence[Aid], Layout, Trajectory], list[Aid]]


@dataclass(frozen=True, slots=True)
class Problem:
    """What the solver needs; what ``heading`` counts from, and the ``origin`` of places: rad, rad, m (WGS 84);
    ``north``: sigma of its direction beyond what the states know, rad; ``rest_accel`` (n - 1,) spectral density of the
    accelerometer without what its motion adds.
    """

    layout: Layout
    prior: tuple[Trajectory, Array]
    inertial: Inertial
    aids: tuple[Aid, ...]
    at: Trajectory
    tune: Tune
    warnings: tuple[Warn, ...]
    heading: str
    origin: tuple[float, float, float] | None
    north: float
    rest_accel: Array


def assemble(
    drive: Drive, nodes: Nodes, q: Array, bias: Array, heading: str, arms: Mapping[str, Array],
    odometry: Judged | None, off: Mapping[str, float] | None = None,
) -> Problem:  # fmt: skip
    """Build the problem about the attitude ``q`` (n, 4) and gyro bias (n, 3) of the indirect filter.

    A heading that counts from the start is turned to where the fixes went. Lever arms that ``arms`` does not name are
    states. ``odometry``: as far as it is believed; ``off``: how far heading sensors are found to be off, rad.
    """
    places, leaps, doubts = _places(drive, nodes, q, arms)
    wheels, told = wheels_of(drive, nodes, bias, arms.get("odometry", np.zeros(3)), odometry)
    doubts += [_mirrored(place.role) for place in places if mirrored(drive.log.imu, nodes.t, q, place, wheels)]
    if heading == "relative" and (places or "gps_velocity" in drive.log.fixes):
        turn, shows = _headed(drive, nodes, q, bias, places, wheels)
        if shows:
            heading = "absolute"
            q = rotation.multiply(rotation.exp_quaternion(turn[:, None] * [0.0, 0.0, 1.0]), q)
        else:
            doubts.append(no_north())
    aids, states = _inertial_aids(drive, nodes), _core_states(drive)
    field, north = None, 0.0
    if "magnetometer" in drive.log.fixes:
        field = field_at_nodes(drive, nodes, q, bias)
        states += field_states(drive, field, at_rest=bool((~nodes.moving).any()))
        north, of_reference = north_sigma(field, rotation.matrix(q[field.node]), drive.world.field_n)
        north = 0.0 if places or "gps_velocity" in drive.log.fixes else north  # which show it
        doubts += of_reference
    aids += _seen(nodes)
    if places or "gps_velocity" in drive.log.fixes:
        seen = {aid.role for aid in aids} | ({"magnetometer"} if field is not None else set())
        states += offset_states(drive.settings, seen, off or {})
    for place, found in zip(places, leaps, strict=True):
        states += place_states(drive, place) + jumps.jump_states(place, found)
        aids.append(place)
    more, further = _streams(drive, nodes, bias, arms)
    aids, states = aids + more, states + further
    if wheels is not None:
        states += wheel_states(drive, wheels)
        aids.append(wheels)
    armed = [*(place.role for place in places), *(["odometry"] if wheels is not None else [])]
    states += [State(f"{role} lever arm", 3, ARM_SIGMA_M) for role in armed if role not in arms]
    form = layout(states)
    x = np.zeros((len(nodes.t), form.size))
    x[:, form.parts["gyro bias"]] = bias
    at = Trajectory(q, x)
    if field is not None:
        start_field(field, form, at)
        aids.append(tuned_field(field, form, at, nodes.t))
    late = max(0.0, places[0].t[0] - nodes.t[0]) if places else 0.0
    prior = _prior(form, at, heading, NEAR_M + FAST_M_S * late if places else None)
    inertial, rest_accel = _inertial(drive, nodes, scaled="gyro scale" in form)
    return Problem(
        form, prior, inertial, tuple(aids), at, _tuner(nodes.t), (*doubts, *told), heading, origin_of(drive), north,
        rest_accel,
    )  # fmt: skip


def _places(
    drive: Drive, nodes: Nodes, q: Array, arms: Mapping[str, Array]
) -> tuple[list[Place], list[list[jumps.Jump]], list[Warn]]:
    """Return the fixes of every sensor of them, without their leaps, and these; what the user should know of both."""
    roles = [role for role in ("gps", "position") if role in drive.log.fixes]
    places = [place_of(drive, nodes, role, arms.get(role, np.zeros(3))) for role in roles]
    leaps = [jumps.jumps(drive.log.imu, nodes.t, q, place, drive.world.gravity) for place in places]
    doubts = [warn for role in roles for warn in far_off(drive, role)]
    doubts += [warn for place, found in zip(places, leaps, strict=True) for warn in jumps.doubts(place, found)]
    return [jumps.mended(place, found) for place, found in zip(places, leaps, strict=True)], leaps, doubts


def _headed(
    drive: Drive, nodes: Nodes, q: Array, bias: Array, places: Sequence[Place], wheels: Wheels | None
) -> tuple[Array, bool]:
    """Return the turn about the vertical (n,), rad, to where the receiver went, and whether it went anywhere."""
    if not places:
        turn, sigma = heading_of_velocity(drive.log.imu, nodes.t, q, velocity_of(drive, nodes, bias, np.zeros(3)))
        return turn, sigma < NORTH_RAD
    turn, sigma = heading_offset(drive.log.imu, nodes.t, q, np.zeros(3), places[0])
    if wheels is not None:  # a slow rover shows its path, hardly its acceleration
        by_path, path_sigma = heading_of_wheels(nodes.t, q, wheels, places[0])
        if path_sigma < sigma:
            turn, sigma = np.full(len(nodes.t), by_path), path_sigma
    if not nodes.moving.any():
        return turn, False
    level = places[0].place_n[:, :2]
    went = float(np.sqrt(np.mean(np.sum((level - np.median(level, axis=0)) ** 2, axis=1))))
    noise = float(np.nanmedian(places[0].sigma[:, :2]))
    if len(level) > 2:  # what is stated may be too small
        noise = max(noise, float(np.median(np.abs(np.diff(level, 2, axis=0)))) * MAD / np.sqrt(6.0))
    return turn, sigma < NORTH_RAD or went > WENT * noise


def no_north() -> Warn:
    """Say that heading is relative in spite of fixes."""
    return Warn("north-not-shown", "the fixes do not show where north is: heading counts from the start",
                "a compass or a livelier drive would")  # fmt: skip


def _mirrored(role: str) -> Warn:
    swapped = "latitude and longitude" if role == "gps" else "east and north"
    message = f"the fixes of {role} are a mirror image of the path that the other sensors show"
    return Warn(
        f"{role}-mirrored", message, f"are {swapped} swapped? mend the driver, or the names with --columns", fatal=True
    )


def motion_of(drive: Drive) -> str:
    """Return what kind of motion the drive is taken for: it sets weak bounds on speed and place only."""
    stated = drive.settings.navigation.motion
    if stated != "auto":
        return stated
    if MOVING & drive.log.fixes.keys():
        return "vehicle"
    return "handheld" if liveliness(drive.log, drive.segmentation) > LIVELY_RAD_S else "rover"


def node_spacing(drive: Drive) -> float:
    """Return how close nodes are, s: half as close where a hand turns the IMU, further apart in a log of hours."""
    spacing = drive.settings.smoothing.node_spacing_s
    if "node_spacing_s" in drive.settings.smoothing.model_fields_set:
        return spacing
    if liveliness(drive.log, drive.segmentation) > LIVELY_RAD_S:
        spacing = LIVELY_SPACING_S
    return max(spacing, float(drive.log.imu.t[-1] - drive.log.imu.t[0]) / MOST_NODES)


def _core_states(drive: Drive) -> list[State]:
    cfg = drive.settings
    fast = MOVING & drive.log.fixes.keys()
    speed = ROLLING_M_S if "odometry" in fast else FAST_M_S if fast else 1.0
    states = [
        State("attitude", 3, TILT_SIGMA), State("velocity", 3, speed), State("position", 3, 1e-3),
        State("gyro bias", 3, cfg.imu.gyro_bias_sigma), State("accelerometer bias", 3, cfg.imu.accel_bias_sigma),
    ]  # fmt: skip
    if drive.noise.gyro_scale > 0.0:
        states.append(State("gyro scale", 9, max(AS_IT_COMES, drive.noise.gyro_scale)))
    if cfg.imu.accel_scale_sigma > 0.0:
        states.append(State("accelerometer scale", 3, cfg.imu.accel_scale_sigma))
    return states


def _inertial(drive: Drive, nodes: Nodes, *, scaled: bool) -> tuple[Inertial, Array]:
    """Return the IMU with the noise of each interval: what a stop shows, and more where it moves; that of the
    accelerometer also without.
    """
    noise, n = drive.noise, len(nodes.t)
    bare = np.zeros(n - 1)
    walk = noise.gyro_walk
    if noise.sources["gyro_random_walk"] != "settings":
        lively = liveliness(drive.log, drive.segmentation) / HAND_RAD_S
        walk = float(np.hypot(walk, HAND_WALK * min(1.0, lively) ** 3))  # hardly any in a rover
    walks = (walk**2, drive.settings.imu.accel_random_walk**2)
    found = inertial_of(nodes, drive.log.imu, (bare, bare), walks, drive.world.gravity)
    steps, starts = found.steps, found.steps.first[:-1]
    span = np.add.reduceat(steps.dt, starts)
    rate = np.sqrt(np.add.reduceat(np.sum((0.5 * (steps.rate0 + steps.rate1)) ** 2, axis=1) * steps.dt, starts) / span)
    force = np.sqrt(np.add.reduceat(np.sum(found.force0**2, axis=1) * steps.dt, starts) / span)
    moving = ~nodes.frozen
    gyro = noise.n_r + np.where(moving & scaled, (RATE_SHARE * rate) ** 2, 0.0)
    stated = drive.settings.imu.accel_noise_density is not None
    felt = np.abs(force - drive.world.gravity)
    unmodelled = 0.0 if stated else ACCEL_FLOOR**2 + (ACCEL_SHARE * felt) ** 2
    imu = drive.log.imu
    gyro = gyro + added_density(imu.t, imu.gyro_added, nodes.t)
    rest = noise.accel_density**2 + added_density(imu.t, imu.accel_added, nodes.t)
    return replace(found, gyro=gyro, accel=rest + np.where(moving, unmodelled, 0.0)), rest


def _inertial_aids(drive: Drive, nodes: Nodes) -> list[Aid]:
    """Rest and weak bounds."""
    t, still, moving = nodes.t, np.flatnonzero(~nodes.moving), np.flatnonzero(nodes.moving)
    aids: list[Aid] = [Bound("zero_velocity", "velocity", still, t[still], np.full(len(still), STILL_M_S))]
    frozen = np.flatnonzero(nodes.frozen)
    if len(frozen):
        at = np.searchsorted(drive.log.imu.t, t)
        summed = np.concatenate([np.zeros((1, 3)), np.cumsum(drive.log.imu.gyro_b, axis=0)])
        count = np.maximum(at[frozen + 1] - at[frozen], 0)
        has = count > 0
        ends, starts = at[frozen + 1][has], at[frozen][has]
        mean = (summed[ends] - summed[starts]) / count[has][:, None]
        sigma = drive.noise.gyro_density / np.sqrt(np.diff(t)[frozen[has]])
        aids.append(ZeroRate(frozen[has] + 1, t[frozen[has] + 1], mean, sigma))
    place, speed = MOTIONS[motion_of(drive)]
    if len(moving):
        every = np.gradient(t)[moving] if len(t) > 1 else np.ones(1)
        slow, inflated = (np.sqrt(np.maximum(1.0, 2.0 * lasts / every)) for lasts in (PLACE_S, SPEED_S))
        if np.isfinite(place):
            aids.append(Bound("place", "position", moving, t[moving], place * slow, robust=True))
        seen = {"gps", "gps_velocity", "position"} & drive.log.fixes.keys()
        if not seen or "odometry" in drive.log.fixes or drive.settings.navigation.motion != "auto":
            aids.append(Bound("speed", "velocity", moving, t[moving], speed * inflated, robust=True))
    return aids


def _streams(drive: Drive, nodes: Nodes, bias: Array, arms: Mapping[str, Array]) -> tuple[list[Aid], list[State]]:
    """Return GPS velocity and height with the states they call for."""
    aids: list[Aid] = []
    states: list[State] = []
    if "gps_velocity" in drive.log.fixes:
        aids.append(velocity_of(drive, nodes, bias, arms.get("gps", np.zeros(3))))
        if clock_of("gps_velocity", drive.log.fixes) == "gps_velocity":
            states.append(State("gps_velocity lag", 1, LAG_SIGMA_S))
    if "height" in drive.log.fixes:
        height, of_height = height_of(drive, nodes)
        aids.append(height)
        states += of_height
    return aids, states


def _seen(nodes: Nodes) -> list[Aid]:
    """Sun, compass and orientation, as the indirect filter takes them."""
    flat = [m for group in nodes.measurements for m in group]
    roles = [role for role in ("sun", "compass", "orientation") if any(m.role == role for m in flat)]
    return [Seen(role, tuple(m for m in flat if m.role == role)) for role in roles]


def _tuner(t: Array) -> Tune:
    """Return what finds the noise of the aids again after a pass."""

    def tune(aids: Sequence[Aid], form: Layout, at: Trajectory) -> list[Aid]:
        return [tuned_field(a, form, at, t) if isinstance(a, Magnetometer) else a for a in aids]

    return tune


def _prior(form: Layout, at: Trajectory, heading: str, place_m: float | None) -> tuple[Trajectory, Array]:
    """Return the first state and its covariance: heading is a datum where nothing measures it; ``place_m`` sigma of the
    place where fixes give it.
    """
    P = colours.steady(np.diag(form.prior()), form)
    P[:3, :3] = upright(at.q[0], DATUM if heading == "relative" else HEADING_SIGMA)
    if place_m is not None:
        P[6:9, 6:9] = place_m**2 * np.eye(3)
    return Trajectory(at.q[:1], at.x[:1]), P


def upright(q: Array, heading: float) -> Array:
    """Return the covariance (3, 3) of the first attitude ``q`` (4,) in body axes, its heading known to a sigma, rad."""
    R = rotation.matrix(q)
    return np.asarray((R.T * np.array([TILT_SIGMA, TILT_SIGMA, heading]) ** 2) @ R)


__all__ = ["Problem", "assemble", "motion_of", "node_spacing"]
