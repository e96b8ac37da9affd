r"""Roll and pitch from accelerometer and gyro angles: the extended Kalman filter of Vaganay, Aldon & Fournier 1993.

Symbols: pitch :math:`\psi`, roll :math:`\varphi`, mean drifts :math:`d_\psi, d_\varphi` of the gyro angles
:math:`\psi_g, \varphi_g` over the time ``t`` since they were started (``clock``), components of gravity
:math:`g_x, g_y`. Beyond the paper's four states: base errors :math:`c_\psi, c_\varphi` of the gyro angles at their
start, and the accelerometer's bias :math:`a_x, a_y`; without them sigma would be several times too small.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..errors import AttestError
from ..maths import rotation, sequential
from ..maths.sequential import Pass
from ..records import Array, Bools, Fixes, Ints, Warn
from ..segment.stillness import gap_edges
from . import Drive, Forward
from . import accelerometer_angles as accelerometer
from .level import Level, run_of, upright
from .samples import Samples, innovations, samples, untold

START_RAD = np.radians(10.0)  # tilt at the first sample, 1 sigma: a vehicle that may accelerate
GAP_RAD = 0.5  # how far it may tilt over a hole in the log
GYRO_ROUNDING_RAD = 1e-5  # least sigma of a gyro angle: keeps its rows regular, adds nothing
RELEVEL_S = 60.0  # how long a gyro whose bias no stop knows is trusted where the accelerometer's noise is read
UPRIGHT = np.cos(np.radians(30.0))  # up along the IMU's z axis beyond which its own roll and pitch are used
STEEPEST_RAD = np.radians(80.0)  # pitch at which roll loses its meaning
KNOWN_BIAS = 1e-6  # m/s^2: of a bias that is not estimated
STATES = 8
ANEW = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0])  # means that a start keeps: angles, accelerometer bias
ABSENT = ("heading", "gyro bias")


@dataclass(frozen=True, slots=True)
class Gyro:
    """Gyro angles that can be started anew.

    ``turns`` (n - 1, 4) quaternion of each step; ``starts`` samples from which they are integrated anew, ascending
    (empty: the angles are given); ``angles`` (n, 3) roll, pitch, yaw, filled by ``begin``.
    """

    turns: Array
    starts: Ints
    angles: Array

    @classmethod
    def of(cls, turn_b: Array, starts: Ints) -> Gyro:
        """Make it from rotation vectors (n - 1, 3) of the steps."""
        return cls(rotation.exp_quaternion(turn_b), starts, np.zeros((len(turn_b) + 1, 3)))

    def begin(self, k: int, pitch: float, roll: float) -> slice:
        """Integrate from sample ``k``, where pitch and roll are given, to the next start; return the steps."""
        later = int(np.searchsorted(self.starts, k, side="right"))
        end = int(self.starts[later]) if later < len(self.starts) else len(self.turns)
        q = rotation.multiply(*rotation.exp_quaternion(np.array([[0.0, pitch, 0.0], [roll, 0.0, 0.0]])))
        self.angles[k] = roll, pitch, 0.0
        if end > k:
            self.angles[k + 1 : end + 1] = rotation.roll_pitch_yaw(rotation.chain(self.turns[k:end], q))
        return slice(k, end)


@dataclass(frozen=True, slots=True)
class Model:
    r"""What the filter is told of n samples, for s states (4: the paper's; 8: base errors and accelerometer bias too).

    ``clock`` (n,) s since the gyro angles were started; ``gravity_xy`` (n, 2) m/s^2, counted where ``used`` (n,); ``Q``
    (n - 1, s, s); ``R`` (n, 4) variances of :math:`g_x, g_y, \psi_g, \varphi_g`; ``gravity`` m/s^2. With a ``gate``
    (sigmas; 0: none) a component of gravity that is off by :math:`\nu` counts less:
    :math:`R\max(1,\nu^2/(gate^2S))`, where S has the variance ``spread`` (n,) of one sample in place of R.
    """

    gyro: Gyro
    clock: Array
    gravity_xy: Array
    used: Bools
    Q: Array
    R: Array
    gravity: float
    gate: float
    spread: Array

    def begin(self, k: int, x: Array, Phi: Array) -> None:
        """Start the gyro angles from a state at sample ``k``; fill ``Phi`` (n - 1, s, s) up to the next start."""
        steps = self.gyro.begin(k, x[0], x[1])
        if len(x) == STATES:
            T = turned_errors(self.gyro.angles[steps.start : steps.stop + 1])
            Phi[steps, 4:6, 4:6] = T
            Phi[steps, 4:6, 2:4] = (T - np.eye(2)) * self.clock[steps, None, None]

    def row_variances(self, k: int, nu: Array, H: Array, P: Array) -> Array:
        """Return the variances (4,) of the measurements at sample ``k``, gated."""
        R: Array = self.R[k]
        if not self.gate:
            return R
        S = np.sum(H[:2] @ P * H[:2], axis=1) + self.spread[k]
        return np.concatenate([R[:2] * np.maximum(1.0, nu[:2] ** 2 / (self.gate**2 * S)), R[2:]])


def observation(x: Array, clock: float, gravity: float) -> tuple[Array, Array]:
    r"""Return what the sensors should show of a state, ``h`` (4,), and its Jacobian ``H`` (4, s).

    .. math:: h=(-g\sin\psi+a_x,\ g\cos\psi\sin\varphi+a_y,\ \psi+c_\psi+d_\psi t,\ \varphi+c_\varphi+d_\varphi t)

    Parameters
    ----------
    x : (s,) :math:`(\psi,\varphi,d_\psi,d_\varphi[,c_\psi,c_\varphi,a_x,a_y])`; rad, rad/s, m/s^2
    clock : ``t``, s
    gravity : m/s^2

    Notes
    -----
    The paper's section 6, where c = a = 0.
    """
    pitch, roll, drift_pitch, drift_roll, *more = x.tolist()
    c_pitch, c_roll, a_x, a_y = more or (0.0, 0.0, 0.0, 0.0)
    sp, cp, sr, cr = math.sin(pitch), math.cos(pitch), math.sin(roll), math.cos(roll)
    h = np.array([
        a_x - gravity * sp, a_y + gravity * cp * sr,
        pitch + c_pitch + drift_pitch * clock, roll + c_roll + drift_roll * clock,
    ])  # fmt: skip
    H = np.zeros((4, len(x)))
    H[0, 0], H[1, 0], H[1, 1] = -gravity * cp, -gravity * sp * sr, gravity * cp * cr
    H[2, 0] = H[3, 1] = 1.0
    H[2, 2] = H[3, 3] = clock
    if more:
        H[2, 4] = H[3, 5] = H[0, 6] = H[1, 7] = 1.0
    return h, H


def turned_errors(rpy: Array) -> Array:
    r"""Return how an error of the gyro's (pitch, roll) moves over each step, ``T`` (n - 1, 2, 2).

    .. math:: (\cos\psi\,\delta\varphi,\ \delta\psi)_{k+1}=\mathrm{Rot}(-\Delta\theta)(\cos\psi\,\delta\varphi,\
        \delta\psi)_k

    A wrong vertical stays where it is while the vehicle turns under it: the paper's "everything happens as if the robot
    had turned on an inclined plane". ``rpy`` (n, 3): roll, pitch, yaw of the gyro.
    """
    cp, yaw = np.cos(rpy[:, 1]), rpy[:, 2]
    c, s = np.cos(np.diff(yaw)), np.sin(np.diff(yaw))
    T = np.empty((len(c), 2, 2))
    T[:, 0, 0], T[:, 0, 1] = c, -s * cp[:-1]
    T[:, 1, 0], T[:, 1, 1] = s / cp[1:], c * cp[:-1] / cp[1:]
    return T


def fuse(model: Model, x0: Array, P0: Array) -> Pass:
    r"""Run the filter: random-walk states, gyro angles started anew on the estimate where ``gyro.starts`` says so.

    With eight states the gyro's error :math:`o=c+dt` moves as it does in truth, :math:`o_{k+1}=T_ko_k+d\,\Delta t`, and
    a start is exact: the new base errors are minus the errors of the angles, the drifts begin anew.

    Parameters
    ----------
    x0, P0 : (s,), (s, s) estimate before the first sample's measurement
    """
    gyro, n, whole = model.gyro, len(model.clock), len(x0) == STATES
    Phi, eye = np.tile(np.eye(len(x0)), (n - 1, 1, 1)), np.eye(4)
    starts, clock, z = set(gyro.starts.tolist()), model.clock.tolist(), model.gravity_xy.tolist()
    used, R = model.used.tolist(), model.R[:, :, None] * eye

    def predict(k: int, x: Array) -> tuple[Array, Array, Array]:
        if k == 0 or k not in starts:
            return Phi[k] @ x, Phi[k], model.Q[k]
        model.begin(k, x, Phi)
        if not whole:
            return x, Phi[k], model.Q[k]
        Phi[k, 4:6, :2] = -Phi[k, 4:6, 4:6]
        Phi[k, 4:6, 4:6], Phi[k, 2:6, 2:4] = 0.0, 0.0
        return ANEW * (Phi[k] @ x), Phi[k], model.Q[k]

    def observe(k: int, x: Array, P: Array) -> tuple[Array, Array, Array]:
        h, H = observation(x, clock[k], model.gravity)
        roll, pitch, _ = gyro.angles[k].tolist()
        nu = np.array([*z[k], pitch, roll]) - h
        nu[2], nu[3] = math.remainder(nu[2], math.tau), math.remainder(nu[3], math.tau)
        if used[k]:
            return nu, H, model.row_variances(k, nu, H, P) * eye
        nu[:2], H[:2] = 0.0, 0.0
        return nu, H, R[k]

    if 0 in starts:
        model.begin(0, x0, Phi)
    return sequential.run(n, x0, P0, 4, predict, observe)


def forward(drive: Drive) -> Forward:
    """Estimate roll and pitch; heading is carried by the gyro.

    Raises
    ------
    AttestError
        If the vehicle pitches beyond 80 degrees, where roll has no meaning.
    """
    own = samples(drive)
    R_lb = rotation.matrix(_seat(drive))  # to axes in which the vehicle stands upright
    s = replace(own, turn_b=own.turn_b @ R_lb.T, rate_b=own.rate_b @ R_lb.T, force_b=own.force_b @ R_lb.T)
    every = max(1, int(0.5 / (drive.settings.tilt_ekf.cutoff_hz * float(np.median(s.dt)))))
    seen, told = _gravity(drive, s, every, as_mounted=R_lb[2, 2] == 1.0)
    found_from, x0, P0 = _model(drive, s, seen, every)
    found = fuse(found_from, x0, P0)
    if np.abs(found.x[:, 0]).max() > STEEPEST_RAD:
        name = drive.log.sources[0].name
        raise AttestError(f"{name}: pitch passes 80 deg, where tilt-ekf has no roll", "use --filter pseudo-linear")
    tilt = 0.0 if seen.compensated else drive.settings.imu.accel_bias_sigma / drive.world.gravity
    level = Level(own, found.x, lambda x: _up(x, R_lb), np.zeros((3, STATES)), _held(s), tilt)
    run = run_of(level, found, innovations(s.t, _judged(found_from, found), {"accelerometer": slice(0, 2)}), ABSENT)
    known = np.diag(np.append(np.zeros(6), 1.0 / P0.diagonal()[6:]))
    return Forward(replace(run, beforehand=(known, -found.x @ known)), drive.noise, warnings=(*told, *untold(drive)))


def _judged(model: Model, found: Pass) -> Pass:
    """Return the pass with innovations as one sample of the accelerometer scatters: by ``spread``.

    The filter counts with the density of the vibration, which its sum over time has; a sample alone has more.
    """
    S = found.S.copy()
    S[:, [0, 1], [0, 1]] += model.spread[:, None] - model.R[:, :2]
    return replace(found, nu=np.where(model.used[:, None], found.nu, np.nan), S=S)


def _held(s: Samples) -> Bools:
    """Return the steps (n - 1,) inside a stop: nothing turns."""
    return np.asarray(s.still[1:] & s.still[:-1])


def _up(x: Array, R_lb: Array) -> tuple[Array, Array]:
    """Return up in body axes (n, 3) and its Jacobian (n, 3, s) of states (n, s) in upright axes."""
    (sp, sr), (cp, cr), zero = np.sin(x[:, :2].T), np.cos(x[:, :2].T), np.zeros(len(x))
    slope = np.zeros((len(x), 3, x.shape[1]))
    slope[:, :, 0] = np.stack([-cp, -sp * sr, -sp * cr], axis=1) @ R_lb
    slope[:, :, 1] = np.stack([zero, cp * cr, -cp * sr], axis=1) @ R_lb
    return np.stack([-sp, cp * sr, cp * cr], axis=1) @ R_lb, slope


def _seat(drive: Drive) -> Array:
    """Return the turn (4,) from the IMU's axes to upright ones: none where its z axis is within 30 deg of up."""
    force, stops = drive.log.imu.accel_b, drive.segmentation.stops
    up = np.mean([force[s.first : s.last].mean(axis=0) for s in stops] or [force.mean(axis=0)], axis=0)
    up /= np.linalg.norm(up)
    return np.array([1.0, 0.0, 0.0, 0.0]) if up[2] > UPRIGHT else upright(up[None])[0]


@dataclass(frozen=True, slots=True)
class Gravity:
    """What the accelerometer shows of gravity: ``force_b`` (n, 3) m/s^2, its noise ``density`` in motion,
    m/s^2/sqrt(Hz), the ``spread`` of one counted sample, m^2/s^4; ``compensated``: the vehicle's own acceleration is
    taken out.
    """

    force_b: Array
    density: float
    spread: float
    compensated: bool


def _gravity(drive: Drive, s: Samples, every: int, *, as_mounted: bool) -> tuple[Gravity, tuple[Warn, ...]]:
    """Return gravity as the accelerometer shows it, compensated by the odometry where that makes it quieter.

    Uncompensated, a lasting acceleration looks like a bias of the accelerometer: then that bias is not estimated, and
    its sigma stands in the tilt.
    """
    cfg, edges = drive.settings.tilt_ekf, gap_edges(s.t, drive.log.gaps)
    rpy, spans = _reckoned(drive, s)

    def seen(wheels: Fixes | None) -> Gravity:
        speed, cutoff = np.zeros(len(s.t)), cfg.cutoff_hz
        if wheels is not None:
            speed = np.where(s.still, 0.0, np.interp(s.t, wheels.t, wheels.values[:, 0]))
            period = float(np.median(np.diff(wheels.t)))
            cutoff = min(cutoff, 1.0 / (accelerometer.LEAST_OVERSAMPLING * period))
        lever = np.array(cfg.lever_arm_m)
        force = accelerometer.compensated(s.force_b, s.rate_b, speed, lever, s.t, edges, (cfg.cutoff_hz, cutoff))
        force_n = accelerometer.levelled(force, rpy)
        density = cfg.accel_noise_density or accelerometer.motion_density(force_n, s.t, spans)
        spread = accelerometer.sample_variance(force_n[~s.still][::every])
        return Gravity(force, density, spread, wheels is not None)

    alone, wheels = seen(None), drive.log.fixes.get("odometry")
    why, hint = "no odometry", "wheel odometry at 10 Hz or more helps"
    if wheels is not None and len(wheels.t) > 1:
        if as_mounted:
            helped = seen(wheels)
            if helped.density <= alone.density:
                return helped, ()
            why = "the odometry would add more noise than it takes out"
            hint = f"its speed, {1.0 / float(np.median(np.diff(wheels.t))):.4g} Hz, is too rough for an acceleration"
        else:
            why, hint = "the IMU's forward axis is not known, so the odometry cannot help", "give [imu] mounting"
    if not drive.segmentation.motions:
        return alone, ()
    message = f"{why}: the vehicle's acceleration stays in the tilt, noise {alone.density:.2g} m/s^2/sqrt(Hz)"
    return alone, (Warn("acceleration-not-compensated", message, hint),)


def _reckoned(drive: Drive, s: Samples) -> tuple[Array, Array]:
    """Return roll, pitch, yaw (n, 3) by the gyro alone, and the motions (m, 2), s, over which none is levelled anew.

    Levelled at the stops; where no stop knows the gyro's bias, every minute.
    """
    starts = _starts(s.still)
    if not drive.segmentation.stops:
        starts = np.union1d(starts, np.searchsorted(s.t, np.arange(s.t[0], s.t[-1], RELEVEL_S)))
    gyro = Gyro.of(np.where(_held(s)[:, None], 0.0, s.turn_b), starts)
    around = np.searchsorted(s.t, s.t[starts, None] + [-0.5, 0.5])
    for k, (lo, hi) in zip(starts.tolist(), around.tolist(), strict=True):
        gyro.begin(k, *accelerometer.angles(s.force_b[lo : max(hi, lo + 1)].mean(axis=0)[None])[0])
    edges = np.unique(np.concatenate([s.t[starts], *([m.start, m.end] for m in drive.segmentation.motions)]))
    middle = np.searchsorted(s.t, 0.5 * (edges[1:] + edges[:-1]))
    return gyro.angles, np.stack([edges[:-1], edges[1:]], axis=1)[~s.still[middle]]


def _model(drive: Drive, s: Samples, seen: Gravity, every: int) -> tuple[Model, Array, Array]:
    """Return the model of a drive, and the state and covariance it starts from.

    Gravity counts at each ``every``-th sample: the low-pass makes those in between repeats.
    """
    cfg, gravity, starts, eye = drive.settings.tilt_ekf, drive.world.gravity, _starts(s.still), np.eye(2)
    dt = float(np.median(s.dt))
    clock = _clock(np.where(_held(s) | s.gap, 0.0, s.dt), starts)
    R = np.empty((len(s.t), 4))
    R[:, :2] = np.where(s.still, drive.noise.accel_density, seen.density)[:, None] ** 2 / (every * dt)
    R[:, 2:] = max(drive.noise.n_r * dt, GYRO_ROUNDING_RAD**2)
    model = Model(
        gyro=Gyro.of(np.where(_held(s)[:, None], 0.0, s.turn_b), starts), clock=clock,
        gravity_xy=accelerometer.components(accelerometer.angles(seen.force_b), gravity),
        used=np.arange(len(s.t)) % every == 0, Q=_process_noise(drive, s, clock, starts), R=R, gravity=gravity,
        gate=cfg.gate_sigmas, spread=np.maximum(R[:, 0], np.where(s.still, 0.0, seen.spread)),
    )  # fmt: skip
    first = seen.force_b[: max(1, round(1.0 / dt))].mean(axis=0)
    x0, P0 = np.zeros(STATES), np.zeros((STATES, STATES))
    x0[:2] = accelerometer.angles(first[None])[0]
    P0[:2, :2] = START_RAD**2 * eye
    P0[4:6, :2] = P0[:2, 4:6] = -P0[:2, :2]  # the gyro starts from these angles, so its base is off by as much
    P0[4:6, 4:6] = P0[:2, :2] + np.diag(R[0, 2:])
    P0[2:4, 2:4] = s.bias_sigma**2 * eye
    P0[6:, 6:] = (drive.settings.imu.accel_bias_sigma if seen.compensated else KNOWN_BIAS) ** 2 * eye
    return model, x0, P0


def _starts(still: Bools) -> Ints:
    """Return the first sample and the last but one of every stop: there the gyro angles start anew."""
    ends = np.flatnonzero(still[:-2] & still[1:-1] & ~still[2:])
    return np.unique(np.concatenate([[0], ends]))


def _clock(free: Array, starts: Ints) -> Array:
    """Return the time (n,) that the gyro was integrated since the start before each sample; ``free`` (n - 1,) s."""
    total = np.concatenate([[0.0], np.cumsum(free)])
    last = np.searchsorted(starts, np.arange(len(total)), side="left") - 1
    return np.asarray(total - total[starts[np.maximum(last, 0)]])


def _process_noise(drive: Drive, s: Samples, clock: Array, starts: Ints) -> Array:
    """Return ``Q`` (n - 1, 8, 8): how the vehicle tilts, how the drifts walk, what the gyro's noise adds to the base.

    The largest tilting rate is taken for usual: a step of the gyro beyond what the vehicle may do would count as drift.
    A walk of the drift must not reach back over the time since the start: the base takes ``-t`` times it.
    """
    stated, moving = drive.settings.tilt_ekf.angle_noise_density, ~s.still
    tilting = float(np.max(s.rate_b[moving, :2] ** 2) * np.median(s.dt)) if moving.any() else 0.0
    angle = np.radians(stated) ** 2 if stated is not None else max(tilting, drive.noise.n_r)
    unknown, walk, after, eye = np.where(s.gap, GAP_RAD**2, 0.0), drive.noise.n_w * s.dt, clock[1:], np.eye(2)
    Q = np.zeros((len(s.dt), STATES, STATES))
    Q[:, :2, :2] = (angle * s.dt + unknown)[:, None, None] * eye
    Q[:, 2:4, 2:4] = walk[:, None, None] * eye
    Q[:, 2:4, 4:6] = Q[:, 4:6, 2:4] = (-walk * after)[:, None, None] * eye
    white = np.where(_held(s) | s.gap, 0.0, s.density * s.dt)
    Q[:, 4:6, 4:6] = (white + unknown + walk * after**2)[:, None, None] * eye
    anew = starts[1:]
    Q[anew, 2:4, 2:4], Q[anew, 2:4, 4:6], Q[anew, 4:6, 2:4] = s.bias_sigma**2 * eye, 0.0, 0.0
    Q[anew, 4:6, 4:6] = white[anew, None, None] * eye
    return Q
