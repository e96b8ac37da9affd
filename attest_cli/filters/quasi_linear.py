r"""The filters of Rehbinder & Hu over a drive: where up is, from gyro and accelerometer, at every sample.

The gyro turns the vertical (``vertical``), the specific force over gravity measures it, accelerations are its noise, by
a rule (``acceleration``) that the drive itself shows (``rule_choice``). Heading is carried by the gyro (``level``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..maths import kalman, rotation
from ..maths.sequential import Pass
from ..nodes.noise import stop_ranges
from ..records import Array, Bools, Innovations, Warn
from ..settings import Settings
from . import Drive, Forward
from .acceleration import Rule
from .level import Level, run_of
from .rule_choice import (
    GYRO_GRID,
    REFUTED,
    Carried,
    Choice,
    choose,
    constant,
    frames,
    known_gyro,
    levelled,
    rough,
    rules_to_try,
    vertical,
)
from .samples import Samples, samples, untold
from .vertical import NO_RESTS, Method, Rests, Turns, Weigh, observe, up

START_RAD = 1.0  # how little is known of the vertical before the first sample
GAP_RAD = 1.0  # and after a hole in the log
RAISED = 2.0  # factor on the variance of the gyro from which the user is told
ROUNDS = 2  # of bias and choice
LEAST_REST = 10  # samples of a stop that show a bias
FEW_STOPS = 2  # fewer do not judge the gyro's noise
BIAS_CELL_S = 0.25  # samples are summed over this for a first look at the bias


def pseudo_linear(drive: Drive) -> Forward:
    """Run the pseudo-linear Kalman filter (1.23): linear in all of space, brought to length one outside the loop."""
    return _forward(drive, "pseudo-linear")


def projected(drive: Drive) -> Forward:
    """Run the projected Kalman filter (1.28): every correction is laid along the sphere."""
    return _forward(drive, "projected")


def geometric(drive: Drive) -> Forward:
    """Run the geometric observer (1.42): every correction is a turn towards the specific force."""
    return _forward(drive, "geometric")


@dataclass(frozen=True, slots=True)
class Problem:
    """A drive as these filters see it (n samples).

    ``y`` (n, 3) specific force over gravity; ``held`` (n - 1,) steps that do not turn; ``turns_b`` (n - 1, 3) rad the
    gyro's turns, none while held, ``free`` (n - 1,) s in which it is integrated, ``q`` (n, 4) where it leads; ``dt`` s
    usual step; ``quiet`` density of the accelerometer at rest, 1/Hz; ``walk`` density of the gyro's bias,
    (rad/s^2)^2/Hz, known to ``bias_sigma`` before the log; ``rests`` what the stops say of the bias that is left;
    ``stops`` their samples ``[first, last)``; ``causal``: no smoother follows, accelerations are seen from the past.
    """

    samples: Samples
    y: Array
    held: Bools
    turns_b: Array
    free: Array
    q: Array
    dt: float
    quiet: float
    walk: float
    bias_sigma: float
    rests: Rests
    stops: Sequence[tuple[int, int]]
    causal: bool

    @classmethod
    def of(cls, drive: Drive) -> Problem:
        """Make it of a drive."""
        s, zero_rate = samples(drive), drive.settings.smoothing.zero_rate
        held = s.still[1:] & s.still[:-1] & zero_rate
        turns_b = np.where(held[:, None], 0.0, s.turn_b)
        return cls(
            samples=s,
            y=s.force_b / drive.world.gravity,
            held=held,
            turns_b=turns_b,
            free=np.where(held | s.gap, 0.0, s.dt),
            q=frames(turns_b),
            dt=float(np.median(s.dt)),
            quiet=(drive.noise.accel_density / drive.world.gravity) ** 2,
            walk=drive.noise.n_w,
            bias_sigma=drive.settings.imu.gyro_bias_sigma,
            rests=_rests(drive, s) if zero_rate else NO_RESTS,
            stops=_long_stops(drive),
            causal=drive.settings.smoothing.smoother == "none",
        )

    @property
    def stray(self) -> Array:
        """Variance (n - 1,) by which the vertical strays in each step, rad^2."""
        return np.asarray(self.samples.density * self.free + np.where(self.samples.gap, GAP_RAD**2, 0.0))

    @property
    def gyro(self) -> float:
        """Mean density of the gyro's noise where it is integrated, (rad/s)^2/Hz."""
        seconds = float(np.sum(self.free))
        return float(np.sum(self.samples.density * self.free)) / seconds if seconds else float(self.samples.density[0])

    def turns(self, factor: float, across: bool) -> Turns:
        """Return the steps, the variance of the gyro's noise times ``factor``."""
        s = self.samples
        Q = np.where(s.gap, GAP_RAD**2, factor * s.density * self.free)[:, None, None] * np.eye(3)
        drift = -np.diff(s.bias_b, axis=0)  # the bias removed moves: what is left moves against it
        return Turns(self.turns_b, self.free, Q, self.walk * s.dt, drift, across)

    def carried(self, bias: Array) -> Carried:
        """Return the drive in a level frame, ``bias`` (n, 3) rad/s taken from the gyro."""
        s, q = self.samples, self.q
        if bias.any():
            q = frames(self.turns_b - 0.5 * (bias[1:] + bias[:-1]) * self.free[:, None])
        q = levelled(q, self.y, s.gap)
        return Carried(q, rotation.rotate(q, self.y), self.dt, s.still, self.stray, self.gyro, self.quiet, self.causal)


def _rests(drive: Drive, s: Samples) -> Rests:
    """Return what the stops say of the bias that is left, each at its last sample."""
    n_r = drive.noise.n_r
    return {b - 1: (s.rate_b[a:b].mean(axis=0), n_r / float(s.t[b - 1] - s.t[a])) for a, b in _long_stops(drive)}


def _long_stops(drive: Drive) -> list[tuple[int, int]]:
    """Return the samples ``[first, last)`` of the stops that can be averaged."""
    return [(a, b) for a, b in stop_ranges(drive.log, drive.segmentation) if b - a >= LEAST_REST]


def _forward(drive: Drive, method: Method) -> Forward:
    """Choose the rule, run the observer, read the attitude off it."""
    cfg, noise = drive.settings.vertical, drive.noise
    problem = Problem.of(drive)
    carried, choice = _chosen(problem, drive.settings, drive.world.gravity)
    found = _run(problem, carried, choice, method, drive.settings)
    counted = replace(problem.samples, density=problem.samples.density * choice.gyro)
    bias = np.eye(3, 6, 3) if cfg.gyro_bias else np.zeros((3, 3))
    tilt = drive.settings.imu.accel_bias_sigma / drive.world.gravity
    level = Level(counted, found.x, up, bias, problem.held, tilt, _lag(found, carried, choice))
    absent = ("heading",) if cfg.gyro_bias else ("heading", "gyro bias")
    raised = replace(noise, gyro_density=noise.gyro_density * float(np.sqrt(choice.gyro)))
    run = run_of(level, found, _slow_innovations(problem, carried, found, choice.span), absent)
    return Forward(run, raised, warnings=(*_warnings(choice), *untold(drive)))


def _warnings(choice: Choice) -> tuple[Warn, ...]:
    if choice.gyro < RAISED:
        return ()
    message = f"the gyro strays {np.sqrt(choice.gyro):.3g} times its noise in motion: sigma raised to fit"
    hint = "its scale or vibration is beyond its noise at rest; state it in [imu]"
    return (Warn("gyro-noise-raised", message, hint),)


def _chosen(problem: Problem, settings: Settings, gravity: float) -> tuple[Carried, Choice]:
    """Return the rule of the acceleration noise, as the settings state it and by likelihood where they leave it open,
    and the drive as carried by a gyro without the bias that goes with it.
    """
    cfg = settings.vertical
    density = np.nan
    if cfg.acceleration_density is not None:
        density = (cfg.acceleration_density / gravity) ** 2
    elif cfg.gain_rad_s is not None:
        density = problem.gyro / cfg.gain_rad_s**2
    gyro = GYRO_GRID[:1] if np.isfinite(density) else GYRO_GRID  # noise that is stated is stated for the gyro's own
    carried = problem.carried(np.zeros_like(problem.y))
    choice, gyro = constant(carried, rough(carried)), _judged_at_stops(problem, carried, gyro)
    for _ in range(ROUNDS):
        carried = problem.carried(_bias(problem, choice))
        choice = choose(carried, _rules(carried, settings, gravity, density), choice, gyro)
    return carried, choice


def _judged_at_stops(problem: Problem, carried: Carried, gyro: Array) -> Array:
    r"""Return the one of the factors m on the gyro's variance that fits what it strays from stop to stop; all of them
    where the stops are few.

    .. math:: \sigma^2=m\Big(N_rt+\frac{N_rt^2}{2T}\Big)+N_w\frac{t^3}{12}+\sigma^2_{rest}

    Two stops T long, t apart, whose gyro means were its bias. The noise counts as stated unless this refutes it.
    """
    s, edges = problem.samples, np.array(problem.stops).reshape(-1, 2)
    if len(edges) < FEW_STOPS:
        return gyro
    mean = np.array([carried.force_n[first:last, :2].mean(axis=0) for first, last in edges])
    length, middle = s.t[edges[:, 1] - 1] - s.t[edges[:, 0]], edges.sum(axis=1) // 2
    walked, free = (np.diff(np.concatenate([[0.0], np.cumsum(v)])[middle]) for v in (problem.stray, problem.free))
    drift = walked * (1.0 + 0.25 * free * (1.0 / length[1:] + 1.0 / length[:-1]))
    rest = problem.quiet * (1.0 / length[1:] + 1.0 / length[:-1]) + problem.walk * free**3 / 12.0
    variance = gyro[:, None] * drift + rest
    square = np.sum(np.diff(mean, axis=0) ** 2, axis=1)
    likely = known_gyro(gyro) - np.sum(0.5 * square / variance + np.log(variance), axis=1)
    best = int(np.argmax(likely)) if likely[0] < likely.max() - REFUTED else 0
    return gyro[best : best + 1]


def _rules(carried: Carried, settings: Settings, gravity: float, density: float) -> list[Rule]:
    """Return the rules that the settings leave to choose from."""
    cfg = settings.vertical
    rules = [replace(rule, density=density) for rule in rules_to_try(carried)]
    if cfg.acceleration_limit is not None:
        rules = [replace(rule, limit=cfg.acceleration_limit / gravity) for rule in rules]
    if cfg.window_s is not None:
        rules = [replace(rule, window=cfg.window_s) for rule in rules]
    return [rule for rule in dict.fromkeys(rules) if cfg.acceleration in {"auto", rule.kind}]


def _bias(problem: Problem, choice: Choice) -> Array:
    """Return the gyro bias (n, 3) that the stops left, rad/s, smoothed over short cells with the noise of a choice."""
    s, n = problem.samples, len(problem.y)
    first = np.arange(0, n, max(1, round(BIAS_CELL_S / problem.dt)))
    if len(first) < 2:
        return np.zeros((n, 3))
    q, information = problem.q, problem.dt / choice.density
    held = np.add.reduceat(information, first)
    mean = np.add.reduceat(information[:, None] * rotation.rotate(q, problem.y), first, axis=0) / held[:, None]
    back, turns = rotation.conjugate(q[first]), problem.turns(choice.gyro, across=True)

    def over(values: Array) -> Array:
        return np.asarray(np.add.reduceat(values[: first[-1]], first[:-1], axis=0))

    turned = rotation.log_quaternion(rotation.multiply(back[:-1], q[first[1:]]))
    cells = Turns(turned, over(turns.dt), over(turns.Q), over(turns.walk), over(turns.drift))
    y, R = rotation.rotate(back, mean), np.eye(3) / held[:, None, None]
    rests = {int(np.searchsorted(first, k, side="right")) - 1: rest for k, rest in problem.rests.items()}
    found = observe(cells, y, R, *_start(y[0], problem.bias_sigma), rests=rests)
    b = found.x[:, 3:] + kalman.rts(found.chain).d[:, 3:]
    return np.stack([np.interp(s.t, s.t[first], b[:, i]) for i in range(3)], axis=1)


def _start(up_b: Array, bias_sigma: float | None) -> tuple[Array, Array]:
    """Return state and covariance before the first sample: up along ``up_b``, hardly known; no bias if it is None."""
    states = 3 if bias_sigma is None else 6
    x0, P0 = np.zeros(states), START_RAD**2 * np.eye(states)
    x0[:3] = up_b / max(float(np.linalg.norm(up_b)), 1e-9)
    if bias_sigma is not None:
        P0[3:, 3:] = bias_sigma**2 * np.eye(3)
    return x0, P0


def _run(problem: Problem, carried: Carried, choice: Choice, method: Method, settings: Settings) -> Pass:
    """Run the observer over the samples under a choice."""
    s, cfg = problem.samples, settings.vertical
    density, weigh = choice.density, None
    if problem.causal:
        density = np.where(s.still, problem.quiet, choice.rule.density)
        weigh = _moving_only(choice.rule.causal(problem.dt), s.still)
    R = (density / problem.dt)[:, None, None] * np.eye(3)
    sigma = problem.bias_sigma if cfg.gyro_bias else None
    rests = problem.rests if cfg.gyro_bias else NO_RESTS
    factor = choice.gyro * (1.0 if cfg.gyro_bias else _bias_as_noise(problem, choice))
    up_b = problem.y[0]
    if not problem.causal:  # near the truth, lest the methods on the sphere begin with a long way
        up_b = rotation.rotate(rotation.conjugate(carried.q[0]), vertical(carried, choice)[1][0])
    turns = problem.turns(factor, cfg.gain == "matrix")
    return observe(turns, problem.y, R, *_start(up_b, sigma), method, weigh, rests)


def _moving_only(rule: Weigh, still: Bools) -> Weigh:
    """Return the rule, but for stops, where nothing accelerates."""
    return lambda k, w: 1.0 if still[k] else rule(k, w)


def _bias_as_noise(problem: Problem, choice: Choice) -> float:
    r"""Return the factor on the gyro's variance that stands for a bias that is no state.

    Over the memory :math:`1/\lambda` a bias b strays as far as noise of density :math:`2b^2/\lambda`.
    """
    q1, b2 = problem.gyro * choice.gyro, problem.samples.bias_sigma**2
    total = q1
    for _ in range(30):
        total = q1 + 2.0 * b2 * float(np.sqrt(choice.rule.density / total))
    return total / q1


def _lag(found: Pass, carried: Carried, choice: Choice) -> float:
    r"""Return the sigma (rad per axis) of what the forward pass takes for tilt of accelerations faster than itself.

    .. math:: E\|\hat x_f-\hat x_s\|^2/2=P_f-P_s+\sigma^2

    A gait's velocity, times the gain, tilts a filter of the past; a smoother, which looks both ways, averages it out.
    """
    cells, x, P = vertical(carried, choice)
    middle = (cells.first + np.append(cells.first[1:], len(carried.q)) - 1) // 2
    u, slope = up(found.x[middle])
    apart = (rotation.rotate(carried.q[middle], u) - x)[:, :2]
    forward = 0.5 * np.einsum("kia,kab,kib->k", slope, found.chain.P[middle], slope)
    excess = 0.5 * np.sum(apart**2, axis=1) - np.maximum(forward - P, 0.0)
    moving = ~carried.still[middle]
    return float(np.sqrt(max(float(np.mean(excess[moving])), 0.0))) if moving.any() else 0.0


def _slow_innovations(problem: Problem, carried: Carried, found: Pass, span: float) -> Innovations:
    r"""Return level innovations, averaged over smooth windows (Hann, two steps of ``span`` s).

    .. math:: z=\frac{\sum h_kS_k^{-1}\nu_k}{\sqrt{\sum h_k^2S_k^{-1}}}

    A filter whose noise stands for slow accelerations claims nothing of its single samples: only their means over its
    memory can be judged.
    """
    t = problem.samples.t
    per = max(1, round(span / problem.dt))
    taper = np.sin(np.pi * (np.arange(2 * per) + 0.5) / (2 * per)) ** 2
    level = rotation.matrix(carried.q)[:, :2]
    information = 1.0 / np.einsum("kai,kij,kaj->ka", level, found.S, level)
    information[list(problem.rests)] = 0.0  # these measured the bias
    nu = np.einsum("kai,ki->ka", level, found.nu) * information
    rows = np.arange(0, max(len(t) - 2 * per, 0) + 1, 2 * per)
    at = np.minimum(rows[:, None] + np.arange(2 * per), len(t) - 1)
    z = np.full((len(rows), 3), np.nan)
    z[:, :2] = np.einsum("jka,k->ja", nu[at], taper) / np.sqrt(np.einsum("jka,k->ja", information[at], taper**2))
    node = np.minimum(rows + per, len(t) - 1)
    nis, used = np.sum(z[:, :2] ** 2, axis=1), np.ones(len(rows), dtype=np.bool_)
    return Innovations(np.full(len(rows), "accelerometer"), t[node], node, np.full(len(rows), 2), nis, used, z)
