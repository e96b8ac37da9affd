r"""Heading from one gyro axis and a model of its bias (Barshan & Durrant-Whyte, IROS 1994).

Symbols: heading :math:`\Phi` with three derivatives, integrated bias :math:`\epsilon_\Phi`, bias
:math:`\epsilon_{\dot\Phi}` with :math:`\dot\epsilon_{\dot\Phi}=(C_1+C_2-\epsilon_{\dot\Phi})/T+w`. Two forms: the
paper's six states, driven by the measured rate; and the indirect one, :math:`(\epsilon_\Phi,\epsilon_{\dot\Phi})`, in
which the gyro is integrated in motion and shows its bias at the stops.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..errors import AttestError
from ..maths import rotation, sequential
from ..maths.kalman import Errors, symmetric
from ..maths.sequential import Pass
from ..nodes.noise import SCALE_CORRELATION_S
from ..records import Array, FilterRun, Smoothed, Warn
from . import Drive, Forward
from .level import DATUM, upright
from .samples import Samples, innovations, samples, untold

STEEP_RAD, STEEPEST_RAD = np.radians(5.0), np.radians(20.0)  # lean, rms, that is told, and at which it refuses
LEAST_BIAS_RAD_S = 1e-6  # of a bias that its model knows: the model's own error is told by its ramps
PROOF = 1.92  # log likelihood ratio of 95 % for one parameter
MOST_RAISE = 1e3
SERIES_BELOW, SERIES_TERMS = 0.5, 18
RATE_RAD_S, TURN_RAD_S2, JERK_RAD_S3 = 1.0, 1.0, 10.0  # of a vehicle before anything is measured, 1 sigma
BLOCK_S = 2.0  # specific force is averaged over this where it shows the tilt
ABSENT = ("roll", "pitch")


@dataclass(frozen=True, slots=True)
class Linear:
    """A linear system of s states over n - 1 steps: ``F`` (n - 1, s, s), ``u`` (n - 1, s), ``Q`` (n - 1, s, s)."""

    F: Array
    u: Array
    Q: Array


@dataclass(frozen=True, slots=True)
class BiasModel:
    """The bias :math:`C_1(1-e^{-t/T})+C_2` and its walk: rad/s, s, rad/s^2/sqrt(Hz); ``time_constant`` inf: a walk."""

    c1: float = 0.0
    c2: float = 0.0
    time_constant: float = math.inf
    walk: float = 0.0

    def at(self, t: Array) -> Array:
        """Return the bias (n,), rad/s, at ``t`` (n,) s after the start."""
        return np.asarray(self.c2 - self.c1 * np.expm1(-t / self.time_constant))


def bias_steps(dt: Array, model: BiasModel) -> Linear:
    r"""Return the exact steps of :math:`(\epsilon_\Phi,\epsilon_{\dot\Phi})`, with :math:`x=\Delta t/T`.

    .. math:: F=\begin{pmatrix}1&T(1-e^{-x})\\0&e^{-x}\end{pmatrix},\quad
        u=(C_1+C_2)\begin{pmatrix}\Delta t-T(1-e^{-x})\\1-e^{-x}\end{pmatrix}

    and Q of white noise through them (Ornstein-Uhlenbeck), in forms that hold for :math:`T\to\infty` too.

    Notes
    -----
    Eqs (3), (6) corrected: the paper prints backward Euler, with two entries out of place.
    """
    x = dt / model.time_constant
    decay, once, twice = np.exp(-x), _mean_decay(x), _mean_decay(2.0 * x)
    n, settled, q = len(dt), model.c1 + model.c2, model.walk**2
    F, Q = np.tile(np.eye(2), (n, 1, 1)), np.empty((n, 2, 2))
    F[:, 0, 1], F[:, 1, 1] = dt * once, decay
    Q[:, 0, 0], Q[:, 1, 1] = q * dt**3 * _third(x), q * dt * twice
    Q[:, 0, 1] = Q[:, 1, 0] = 0.5 * q * (dt * once) ** 2
    return Linear(F, settled * np.stack([dt * (1.0 - once), -np.expm1(-x)], axis=1), Q)


def _mean_decay(x: Array) -> Array:
    """Return ``(1 - exp(-x)) / x``, 1 at zero."""
    safe = np.where(x == 0.0, 1.0, x)
    return np.where(x == 0.0, 1.0, -np.expm1(-safe) / safe)


def _third(x: Array) -> Array:
    r"""Return :math:`(x-2(1-e^{-x})+\frac12(1-e^{-2x}))/x^3`, 1/3 at zero: by its series where digits would be lost."""
    near, term = np.zeros_like(x), np.full_like(x, -1.0 / 6.0)
    for k in range(3, 3 + SERIES_TERMS):
        near += term * (2.0 - 2.0 ** (k - 1))
        term = -term * x / (k + 1)
    safe = np.where(x < SERIES_BELOW, 1.0, x)
    far = (safe + 2.0 * np.expm1(-safe) - 0.5 * np.expm1(-2.0 * safe)) / safe**3
    return np.where(x < SERIES_BELOW, near, far)


def motion_steps(dt: Array, density: float) -> tuple[Array, Array]:
    r"""Return ``F`` and ``Q`` (n, 4, 4) of :math:`(\Phi,\dot\Phi,\ddot\Phi,\dddot\Phi)`, white noise on the fourth
    derivative.

    .. math:: F_{ij}=\frac{\Delta t^{j-i}}{(j-i)!},\quad
        Q_{ij}=\sigma_u^2\frac{\Delta t^{7-i-j}}{(3-i)!\,(3-j)!\,(7-i-j)},\quad i,j=0..3

    ``density`` :math:`\sigma_u`: rad/s^3.5. Source: eqs (6), (8), right as printed.
    """
    F, Q = np.zeros((len(dt), 4, 4)), np.empty((len(dt), 4, 4))
    for i in range(4):
        for j in range(4):
            power = 7 - i - j
            Q[:, i, j] = density**2 * dt**power / (math.factorial(3 - i) * math.factorial(3 - j) * power)
            if j >= i:
                F[:, i, j] = dt ** (j - i) / math.factorial(j - i)
    return F, Q


def six_state_steps(dt: Array, model: BiasModel, jerk_density: float) -> Linear:
    """Return the steps of the paper's six states; motion and bias are coupled by what is measured only."""
    bias, (F_motion, Q_motion) = bias_steps(dt, model), motion_steps(dt, jerk_density)
    F, Q, u = np.zeros((len(dt), 6, 6)), np.zeros((len(dt), 6, 6)), np.zeros((len(dt), 6))
    F[:, :4, :4], F[:, 4:, 4:] = F_motion, bias.F
    Q[:, :4, :4], Q[:, 4:, 4:] = Q_motion, bias.Q
    u[:, 4:] = bias.u
    return Linear(F, u, Q)


def run(system: Linear, z: Array, H: Array, R: Array, x0: Array, P0: Array) -> Pass:
    """Run the linear filter; the estimate it starts from belongs to the first sample.

    Parameters
    ----------
    z : (n, m) measurements; a row that begins with NaN is none
    H : (m, s); R : (n, m, m)
    x0, P0 : (s,), (s, s)
    """
    measured = np.isfinite(z[:, 0])

    def predict(k: int, x: Array) -> tuple[Array, Array, Array]:
        return system.F[k] @ x + system.u[k], system.F[k], system.Q[k]

    def observe(k: int, x: Array, P: Array) -> tuple[Array, Array, Array] | None:  # noqa: ARG001 (one signature)
        return (z[k] - H @ x, H, R[k]) if measured[k] else None

    return sequential.run(len(z), x0, P0, len(H), predict, observe)


@dataclass(frozen=True, slots=True)
class Upright:
    """Reads attitude and gyro bias off a chain that holds a heading: the vehicle stands on its mean vertical.

    ``x`` (n, s) updated states; heading is ``counted`` (n,) + ``sign`` x[:, angle], the bias about the vertical
    x[:, -1]; ``up_b`` (3,) unit; ``tilt`` how far it leans, rad; ``ramps`` (n, r) heading errors, 1 sigma, that grow by
    a law of their own.
    """

    samples: Samples
    x: Array
    angle: int
    sign: float
    counted: Array
    up_b: Array
    tilt: float
    ramps: Array

    def __call__(self, errors: Errors) -> Smoothed:
        """Return attitude and bias after the errors of the states are taken in."""
        s, x, n = self.samples, self.x + errors.d, len(self.x)
        along, across = np.outer(self.up_b, self.up_b), np.eye(3) - np.outer(self.up_b, self.up_b)
        heading = self.counted + self.sign * x[:, self.angle]
        turn = np.zeros((n, 4))
        turn[:, 0], turn[:, 3] = np.cos(0.5 * heading), np.sin(0.5 * heading)
        q = rotation.normalise(rotation.multiply(turn, upright(self.up_b[None])))
        bias = s.bias_b @ across + x[:, -1:] * self.up_b
        T = np.zeros((6, x.shape[1]))
        T[:3, self.angle], T[3:, -1] = self.sign * self.up_b, self.up_b
        free = np.zeros((6, 6))
        free[:3, :3], free[3:, 3:] = self.tilt**2 * across, s.bias_sigma**2 * across
        P, cross = T @ errors.P @ T.T + free, T @ errors.cross @ T.T + free
        P[:, :3, :3] += np.sum(self.ramps**2, axis=1)[:, None, None] * along
        cross[:, :3, :3] += np.sum(self.ramps[1:] * self.ramps[:-1], axis=1)[:, None, None] * along
        return Smoothed(s.t, rotation.continuous(q), bias, symmetric(P), cross)


@dataclass(frozen=True, slots=True)
class Solved:
    """A pass over one of the two systems and where its heading stands: see ``Upright``."""

    found: Pass
    angle: int
    sign: float
    counted: Array
    role: str


def forward(drive: Drive) -> Forward:
    """Estimate the heading, relative to the start, of a vehicle that counts as level.

    Raises
    ------
    AttestError
        If it leans by more than 20 degrees rms: rates about the other axes would be its heading.
    """
    s, cfg, stops = samples(drive), drive.settings.heading, drive.segmentation.stops
    axis = _axis(drive, s)
    rate = drive.log.imu.gyro_b @ axis.up_b
    model, told = _bias_model(drive, s, rate)
    form = cfg.form if cfg.form != "auto" else "indirect" if stops else "six-state"
    start = _start(drive, s, rate, model)
    solved = (_six_state if form == "six-state" else _indirect)(drive, s, rate, axis, model, start)
    corrected = form == "indirect" and len(stops) > 1
    ramps = np.zeros((len(s.t), 1)) if corrected else parameter_ramps(s.t - s.t[0], model, cfg.parameter_sigma, start)
    read = Upright(s, solved.found.x, solved.angle, solved.sign, solved.counted, axis.up_b, axis.tilt, ramps)
    chain = solved.found.chain
    first = read(Errors(np.zeros_like(chain.dx), chain.P, np.zeros_like(chain.P[1:])))
    seen = innovations(s.t, solved.found, {solved.role: slice(0, 1)})
    moving = not s.still[: int(np.searchsorted(s.t, s.t[0] + 1.0))].any()
    run_ = FilterRun(
        s.t, first.q, first.bias, chain, None, seen, ~s.still, "relative", bool(moving), read, ABSENT
    )  # fmt: skip
    return Forward(run_, drive.noise, warnings=(*told, *axis.warnings, *untold(drive)))


@dataclass(frozen=True, slots=True)
class Axis:
    """The vertical in body axes ``up_b`` (3,), how far the vehicle leans from it (``tilt``, rad), the ``density``
    (n - 1,) of the heading rate's noise, (rad/s)^2/Hz, and the ``spread`` of one sample at rest, (rad/s)^2.
    """

    up_b: Array
    tilt: float
    density: Array
    spread: float
    warnings: tuple[Warn, ...]


def _axis(drive: Drive, s: Samples) -> Axis:
    """Return the mean vertical (of the stops, else of the log), and what a vehicle that leans adds to the noise.

    A lean of ``tilt`` lets rates about the other axes into the heading for as long as they last.
    """
    force = s.force_b / np.linalg.norm(s.force_b, axis=1, keepdims=True)
    up_b = (force[s.still] if s.still.any() else force).mean(axis=0)
    up_b /= np.linalg.norm(up_b)
    per = max(1, round(BLOCK_S / float(np.median(s.dt))))
    blocks = force[: len(force) // per * per].reshape(-1, per, 3).mean(axis=1) if len(force) >= per else force
    along = blocks @ up_b / np.maximum(np.linalg.norm(blocks, axis=1), 1e-9)
    leaning = float(np.sqrt(np.mean(np.arccos(np.clip(along, -1.0, 1.0)) ** 2)))
    if leaning > STEEPEST_RAD:
        message = f"{drive.log.sources[0].name}: leans by {np.degrees(leaning):.0f} deg rms, which is not level"
        raise AttestError(f"{message} as --filter heading takes it", "use --filter indirect")
    tilt = math.hypot(math.sqrt(0.5) * leaning, drive.settings.imu.accel_bias_sigma / drive.world.gravity)
    rate = 0.5 * (s.rate_b[1:] + s.rate_b[:-1])
    across = rate - np.outer(rate @ up_b, up_b)
    density = s.density + 2.0 * SCALE_CORRELATION_S * tilt**2 * np.sum(across**2, axis=1)
    told: tuple[Warn, ...] = ()
    if leaning > STEEP_RAD:
        message = f"the heading filter takes the vehicle as level, but it leans by {np.degrees(leaning):.0f} deg rms"
        told = (Warn("not-level", message, "use --filter indirect"),)
    change = np.diff(drive.log.imu.gyro_b @ up_b)[s.still[1:] & s.still[:-1]]
    shaking = 0.5 * float(np.mean(change**2)) if change.size else 0.0  # an engine that runs at the stops
    spread = max(shaking, drive.noise.n_r / float(np.median(s.dt)))
    return Axis(up_b, tilt, density, spread, told)


def _bias_model(drive: Drive, s: Samples, rate: Array) -> tuple[BiasModel, list[Warn]]:
    """Return the bias model of the settings, else a random walk; the walk as large as the stops ask for."""
    cfg, told = drive.settings.heading, []
    model = BiasModel(walk=drive.noise.gyro_walk)
    if cfg.c1_deg_s is not None and cfg.c2_deg_s is not None and cfg.time_constant_s is not None:
        if drive.log.calibrated is None:
            model = BiasModel(math.radians(cfg.c1_deg_s), math.radians(cfg.c2_deg_s), cfg.time_constant_s, model.walk)
        else:
            message = "the calibration took the bias out of the gyro: the bias model of [heading] is not used"
            told.append(Warn("bias-model-not-used", message, "give one of them"))
    stops = drive.segmentation.stops
    if len(stops) < 2:
        if not stops and not math.isfinite(model.time_constant):
            message = "no stop and no bias model: the heading drifts as the gyro does"
            told.append(Warn("no-bias", message, "stop for 10 s each minute, or calibrate the gyro"))
        return model, told
    middle = np.array([0.5 * (x.used_start + x.used_end) for x in stops])
    length = np.array([max(x.used_end - x.used_start, 1e-3) for x in stops])
    means = np.array([rate[(s.t >= x.used_start) & (s.t <= x.used_end)].mean() for x in stops])
    unexplained = cfg.parameter_sigma * math.hypot(model.c1, model.c2) / model.time_constant
    walk = math.hypot(model.walk, unexplained * math.sqrt(float(np.median(np.diff(middle)))))
    needed = walk_of_stops(means - model.at(middle - s.t[0]), middle, drive.noise.n_r / length, walk)
    if needed > walk:
        message = f"the gyro's bias walks {needed / walk:.2g} times as fast from stop to stop as stated: raised to fit"
        told.append(Warn("bias-walk-raised", message, "give its model in [heading], or calibrate the gyro"))
    return replace(model, walk=needed), told


def walk_of_stops(means: Array, times: Array, variances: Array, stated: float) -> float:
    """Return the density of a random walk, rad/s^2/sqrt(Hz), by maximum likelihood from the mean rates of stops.

    Parameters
    ----------
    means, times, variances : (k,) rad/s, s, (rad/s)^2
    stated : returned unless the stops contradict it (likelihood ratio, 95 %)
    """
    walks = np.concatenate([[stated], stated * np.geomspace(1.0, MOST_RAISE, 200)])
    x, P = np.full(len(walks), means[0]), np.full(len(walks), variances[0])
    likelihood = np.zeros(len(walks))
    for z, dt, r in zip(means[1:], np.diff(times), variances[1:], strict=True):
        P = P + walks**2 * dt
        S = P + r
        likelihood -= 0.5 * ((z - x) ** 2 / S + np.log(S))
        x, P = x + P / S * (z - x), P * r / S
    best = int(np.argmax(likelihood))
    return float(walks[best]) if likelihood[best] - likelihood[0] > PROOF else stated


def _start(drive: Drive, s: Samples, rate: Array, model: BiasModel) -> tuple[float, float, float]:
    """Return the bias at the first sample, its sigma but for an error of C2, and the weight of C2 in it.

    The model's, as if the gyro had been switched on then, and what a stop measured with which the log starts, each by
    its inverse variance.
    """
    stops, stated = drive.segmentation.stops, math.isfinite(model.time_constant)
    if not stops or stops[0].motion or stops[0].start > s.t[0] + 1.0:
        return model.c2, LEAST_BIAS_RAD_S if stated else drive.settings.imu.gyro_bias_sigma, 1.0
    inside = (s.t >= stops[0].used_start) & (s.t <= stops[0].used_end)
    span = max(stops[0].used_end - stops[0].used_start, 1e-3)
    settled, age = model.c1 + model.c2, 0.5 * (stops[0].used_start + stops[0].used_end) - s.t[0]
    first = settled + (float(rate[inside].mean()) - settled) * math.exp(age / model.time_constant)
    variance = drive.noise.n_r / span + model.walk**2 * (age + span)
    if not stated:
        return first, math.sqrt(variance), 0.0
    weight = variance / (variance + _prior(drive, model) ** 2)
    return first + weight * (model.c2 - first), max((1.0 - weight) * math.sqrt(variance), LEAST_BIAS_RAD_S), weight


def _prior(drive: Drive, model: BiasModel) -> float:
    """Return how well the bias at the first sample is known beforehand, rad/s."""
    if not math.isfinite(model.time_constant):
        return drive.settings.imu.gyro_bias_sigma
    return max(drive.settings.heading.parameter_sigma * abs(model.c2), LEAST_BIAS_RAD_S)


def parameter_ramps(t: Array, model: BiasModel, share: float, start: tuple[float, float, float]) -> Array:
    r"""Return what errors of C1 and C2 make of the heading (n, 2), 1 sigma, rad, ``t`` (n,) s after the start.

    :math:`C_1\,a,\ C_2\,(a+w(t-a))` with :math:`a=t-T(1-e^{-t/T})` and the weight w of C2 in the bias at the start: as
    far as that was measured, an error of C2 shows only in where the bias settles.
    """
    if not math.isfinite(model.time_constant):
        return np.zeros((len(t), 1))
    grown = t + model.time_constant * np.expm1(-t / model.time_constant)
    return share * np.stack([model.c1 * grown, model.c2 * (grown + start[2] * (t - grown))], axis=1)


def _six_state(
    drive: Drive, s: Samples, rate: Array, axis: Axis, model: BiasModel, start: tuple[float, float, float]
) -> Solved:
    """Run the paper's filter on the rate.

    Its other measurement, the summed rate, has no information of its own, and an error that is no white noise: with it
    the heading would seem known.
    """
    density = np.append(axis.density, axis.density[-1])
    step = float(np.median(s.dt))
    system = six_state_steps(s.dt, model, math.radians(drive.settings.heading.jerk_density))
    still = six_state_steps(np.where(s.gap, step, s.dt), model, math.radians(drive.settings.heading.jerk_density))
    F, Q, known = system.F.copy(), system.Q.copy(), np.array([DATUM, RATE_RAD_S, TURN_RAD_S2, JERK_RAD_S3])
    F[:, :4, :4], Q[:, :4, :4] = still.F[:, :4, :4], still.Q[:, :4, :4]
    Q[s.gap, :4, :4] += np.diag([np.pi**2 / 3, *known[1:] ** 2])  # after a hole nothing of the motion is known
    R = np.maximum(density / np.append(s.dt, step), axis.spread)[:, None, None]
    P0 = np.diag([*known**2, DATUM**2, start[1] ** 2])
    x0 = np.array([0.0, 0.0, 0.0, 0.0, 0.0, start[0]])
    found = run(replace(system, F=F, Q=Q), rate[:, None], np.array([[0.0, 1.0, 0.0, 0.0, 0.0, 1.0]]), R, x0, P0)
    return Solved(found, 0, 1.0, np.zeros(len(s.t)), "rate")


def _indirect(
    drive: Drive, s: Samples, rate: Array, axis: Axis, model: BiasModel, start: tuple[float, float, float]
) -> Solved:
    """Integrate the gyro in motion and let it show its bias at the stops, where the heading stands still."""
    held = s.still[1:] & s.still[:-1]
    frozen = held | s.gap
    mean = rate[1:] if drive.settings.imu.gyro_samples == "interval" else 0.5 * (rate[1:] + rate[:-1])
    counted = np.concatenate([[0.0], np.cumsum(np.where(frozen, 0.0, mean * s.dt))])
    system = bias_steps(s.dt, model)
    system.Q[:, 0, 0] += axis.density * s.dt
    system.F[frozen, 0, 1], system.u[frozen, 0] = 0.0, 0.0
    system.Q[frozen, 0, :] = system.Q[frozen, :, 0] = 0.0
    system.Q[s.gap, 0, 0] = np.pi**2 / 3
    z = np.where(s.still, rate, np.nan)[:, None]
    R = np.full((len(s.t), 1, 1), axis.spread)
    prior = _prior(drive, model) if drive.segmentation.stops else start[1]
    P0 = np.diag([DATUM**2, prior**2])
    found = run(system, z, np.array([[0.0, 1.0]]), R, np.array([0.0, model.c2]), P0)
    return Solved(found, 0, -1.0, counted, "zero_rate")
