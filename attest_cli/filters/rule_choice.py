r"""Which rule of the acceleration noise a drive calls for, and how much noise: chosen by innovation likelihood.

The likelihood of the samples themselves chooses badly: accelerations are coloured. A gait gives back every step what it
took, so that its average over a second says far more of the vertical than the spread of its samples allows; a vehicle
that pulls away says far less. What counts is the noise as slowly as the filter averages, over its memory
:math:`1/\lambda=\sqrt{q_2/q_1}`. So, for each rule, the specific force is turned by the gyro into one level frame and
averaged over smooth windows of about that memory, and the likelihood of these means gives :math:`\bar q_2` and a factor
on the gyro's noise. With noise that holds at its own scale the filter's sigma holds, and rules can be compared: the
best one leaves the least.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ..maths import local_level, rotation
from ..records import Array, Bools, Ints
from .acceleration import Rule, windowed
from .level import upright

CELL_S = 0.05  # samples are summed over this
SPANS_S = 0.25 * np.sqrt(2.0) ** np.arange(18)  # steps between windows: 0.25 s to 90 s
MEMORY = 0.7  # the step nearest to this share of the filter's memory counts
LEAST_WINDOWS = 12
ROUGH_S = 1.0  # step of the windows that give a first figure
GRID = 1.3  # step of densities and gyro factors that are tried
GYRO_GRID: Array = GRID ** np.arange(20.0)
GYRO_SPREAD = 0.3  # width of the prior (Cauchy) of that factor's logarithm: the gyro's noise is known, if it is
LASTING_S = 4.0  # accelerations may last: windows with a step below this refute no gyro
REFUTED = 3.0  # log-likelihood by which the gyro's noise as stated falls short of the best
SEEING = 1 / 3  # share of the largest information from which a rule has a say on the gyro
CAUTION = 0.84  # quantile of the noise density's posterior: few windows must not look better than they are
PLAIN = 0.8  # a rule that varies must leave less than this share of the constant one's sigma
EQUAL = 1.02  # sigmas this close are equal: then the rule that leaves out most, for what is left out cannot mislead
LOUDEST = 1.0  # 1/Hz: an acceleration of g lasting a second
LIMITS, WINDOWS_S = 5, (0.05, 0.1, 0.4)  # thresholds, and windows of (1.46), that are tried
QUIET_SIGMAS = 4.0  # a threshold below this many sigma of the accelerometer would drop its own noise
NOTHING = 1e-12  # s, information that counts as none; rad^2, the least step of the vertical


@dataclass(frozen=True, slots=True)
class Carried:
    """A drive's specific force in one level frame (n samples), and what is known of it.

    ``q`` (n, 4) body to a frame that the gyro carries, upright on the whole; ``force_n`` (n, 3) over gravity, in it;
    ``dt`` s between samples; ``still`` (n,) at a stop; ``walk`` (n - 1,) rad^2 by which the vertical strays in a step;
    ``gyro`` density, (rad/s)^2/Hz; ``quiet`` density of the accelerometer at rest, 1/Hz. ``causal``: for a filter
    that no smoother follows, which weighs the past with a sharp edge.
    """

    q: Array
    force_n: Array
    dt: float
    still: Bools
    walk: Array
    gyro: float
    quiet: float
    causal: bool = False


@dataclass(frozen=True, slots=True)
class Choice:
    """A rule with its density, and what goes with it.

    ``gyro`` factor on the variance of the gyro's noise; ``density`` (n,) of the accelerometer's noise, 1/Hz; ``span`` s
    over which innovations are white; ``sigma`` rms tilt it leaves, rad per axis.
    """

    rule: Rule
    gyro: float
    density: Array
    span: float
    sigma: float


@dataclass(frozen=True, slots=True)
class Cells:
    """Sums over short cells (c of them): ``first`` sample of each; ``walk`` (c - 1,) rad^2 between their middles;
    ``resting`` (c,) information of the samples at stops; ``seconds`` of a cell.
    """

    first: Ints
    walk: Array
    resting: Array
    seconds: float

    @classmethod
    def of(cls, c: Carried) -> Cells:
        """Lay the cells."""
        n, per = len(c.force_n), max(1, round(CELL_S / c.dt))
        first = np.arange(0, n, per)
        middle = (first + np.append(first[1:], n) - 1) // 2
        total = np.concatenate([[0.0], np.cumsum(c.walk)])
        walk = np.maximum(np.diff(total[middle]), NOTHING)
        return cls(first, walk, np.add.reduceat(np.where(c.still, c.dt / c.quiet, 0.0), first), per * c.dt)


def frames(turn_b: Array) -> Array:
    """Return the attitudes (n, 4) after the gyro's steps ``turn_b`` (n - 1, 3), no rotation first."""
    return np.concatenate([[[1.0, 0.0, 0.0, 0.0]], rotation.chain(rotation.exp_quaternion(turn_b))])


def levelled(q: Array, y: Array, gap: Bools) -> Array:
    """Return the attitudes ``q`` (n, 4) turned so that the mean of ``y`` (n, 3), body axes, is upright in them; after
    each ``gap`` (n - 1,), anew.
    """
    parts = []
    for first, last in pairwise([0, *(np.flatnonzero(gap) + 1).tolist(), len(y)]):
        mean = rotation.rotate(q[first:last], y[first:last]).mean(axis=0)
        parts.append(rotation.multiply(upright((mean / np.linalg.norm(mean))[None]), q[first:last]))
    return np.concatenate(parts)


def rules_to_try(c: Carried) -> list[Rule]:
    """Return shapes of rules, their density to be found: the constant one, and the others with thresholds from the
    accelerometer's own noise to the largest accelerations.
    """
    least = QUIET_SIGMAS * np.sqrt(c.quiet / c.dt)
    most = float(np.quantile(np.linalg.norm(c.force_n - [0.0, 0.0, 1.0], axis=1), 0.95))
    limits = np.geomspace(least, max(most, 2.0 * least), LIMITS).tolist()
    shapes = [Rule("switching", np.nan, limit, window) for limit in limits for window in WINDOWS_S]
    return [Rule("constant", np.nan), *shapes, *(replace(rule, kind="continuous") for rule in shapes)]


def constant(c: Carried, density: float) -> Choice:
    """Return the constant rule of a stated density."""
    noise = np.where(c.still, c.quiet, density)
    return Choice(Rule("constant", density), 1.0, noise, ROUGH_S, np.inf)


def choose(c: Carried, rules: Sequence[Rule], before: Choice, gyro: Array = GYRO_GRID) -> Choice:
    """Return the rule that leaves the least sigma that holds.

    Parameters
    ----------
    c : the drive
    rules : shapes, all of one ``density``; not finite: to be found
    before : an earlier choice, for the vertical off which accelerations are seen
    gyro : factors on the variance of the gyro's noise that are tried, ascending
    """
    found = _judged(c, rules, _acceleration(c, before), gyro)
    score = np.array([f.sigma * (PLAIN if f.rule.kind == "constant" else 1.0) for f in found])
    equal = [f for f, value in zip(found, score, strict=True) if value <= EQUAL * score.min()]
    return max(equal, key=lambda f: float(np.mean(f.density)))


def known_gyro(factors: Array) -> Array:
    """Return the logarithm of the prior of factors on the gyro's noise: it is as stated, or far off."""
    return np.asarray(-np.log1p((np.log(factors) / GYRO_SPREAD) ** 2))


def rough(c: Carried) -> float:
    """Return a first figure of the noise density, 1/Hz: from second differences of means, blind to steady drift; of a
    record too short for them, as if its accelerations lasted a second.
    """
    cells = Cells.of(c)
    held, force = _summed(c, cells, np.where(c.still, 0.0, 1.0)[:, None])
    per = max(1, round(ROUGH_S / cells.seconds))
    lasting = float(np.clip(np.mean(c.force_n[:, :2] ** 2) * ROUGH_S, c.quiet, LOUDEST))
    if len(held) < 4 * per:
        return lasting
    z, R, _ = _windows(held, force, cells.walk, _taper(per, c.causal))
    seen = R[:, 0] < 2.0 / ROUGH_S
    bent = (z[2:] - 2.0 * z[1:-1] + z[:-2])[seen[2:] & seen[1:-1] & seen[:-2]]
    return float(np.clip(np.mean(bent**2) / 6.0 * ROUGH_S, c.quiet, LOUDEST)) if len(bent) else lasting


def vertical(c: Carried, found: Choice) -> tuple[Cells, Array, Array]:
    """Return cells, and in each the vertical (cells, 3), unit, smoothed under a choice, and its variance (cells,)."""
    cells = Cells.of(c)
    information = np.where(c.still, c.dt / c.quiet, c.dt / found.density)
    held = np.add.reduceat(information, cells.first)
    mean = np.add.reduceat(information[:, None] * c.force_n, cells.first, axis=0) / held[:, None]
    x, P = local_level.smooth(mean, held, cells.walk * found.gyro)
    return cells, x / np.linalg.norm(x, axis=1, keepdims=True), P


def _acceleration(c: Carried, found: Choice) -> Array:
    """Return the acceleration (n,), a share of g, off the vertical smoothed under a choice."""
    cells, x, _ = vertical(c, found)
    x = np.repeat(x, np.diff([*cells.first, len(c.force_n)]), axis=0)
    return np.asarray(np.linalg.norm(c.force_n - x, axis=1))


def _summed(c: Carried, cells: Cells, weight: Array) -> tuple[Array, Array]:
    """Return seconds of full weight (c, rules) and the level force in them (c, rules, 2), of ``weight`` (n, rules)."""
    held = np.add.reduceat(weight, cells.first, axis=0) * c.dt
    sides = [np.add.reduceat(weight * c.force_n[:, i : i + 1], cells.first, axis=0) * c.dt for i in range(2)]
    return held, np.stack(sides, axis=2)


def _judged(c: Carried, rules: Sequence[Rule], w: Array, gyro: Array) -> list[Choice]:
    """Return each rule with the noise that holds, and the sigma it leaves."""
    cells = Cells.of(c)
    factor = np.stack([rule.factor(windowed(w, rule.window, c.dt)) for rule in rules], axis=1)
    held, force = _summed(c, cells, np.where(c.still[:, None], 0.0, 1.0 / factor))
    stated = rules[0].density
    densities = np.array([stated]) if np.isfinite(stated) else _grid(c.quiet, LOUDEST)
    density, raised, span = _fitted(c, cells, held, force, densities, gyro)
    information = held.sum(axis=0) / density
    seeing = information >= SEEING * information.max()  # rules that see too little refute nothing
    factor_of_gyro = float(raised[seeing].min())
    out = []
    for i, rule in enumerate(rules):
        information = held[:, i] / density[i] + cells.resting
        _, P = local_level.smooth(np.zeros((len(information), 1)), information, cells.walk * factor_of_gyro)
        sigma = float(np.sqrt(np.mean(P)))
        noise = np.where(c.still, c.quiet, density[i] * factor[:, i])
        out.append(Choice(replace(rule, density=float(density[i])), factor_of_gyro, noise, float(span[i]), sigma))
    return out


def _fitted(
    c: Carried, cells: Cells, held: Array, force: Array, densities: Array, gyro: Array
) -> tuple[Array, Array, Array]:
    """Return, per rule, noise density, gyro factor and window step: that nearest to the filter's own memory.

    The gyro's noise counts as stated unless a step half-way to that of its likeliest factor refutes it: accelerations
    that last look like drift where windows are short, and drift like accelerations where they are long.
    """
    count = held.shape[1]
    share = np.maximum(held.sum(axis=0), NOTHING) / max(float(np.sum(~c.still)) * c.dt, c.dt)
    spans = np.array([s for s in SPANS_S if len(held) >= (LEAST_WINDOWS + 1) * max(1, round(s / cells.seconds))])
    if not len(spans):
        density = densities[0] if len(densities) == 1 else rough(c)
        return np.full(count, density), np.ones(count), np.full(count, ROUGH_S)
    likely, density = np.empty((2, len(spans), count, len(gyro)))
    for i, span in enumerate(spans):
        taper = _taper(max(1, round(span / cells.seconds)), c.causal)
        here = _likelihood(*_windows(held, force, cells.walk, taper), densities, gyro)
        likely[i] = here.max(axis=2)
        below = np.cumsum(np.exp(here - likely[i, :, :, None]), axis=2)
        density[i] = densities[np.argmax(below >= CAUTION * below[:, :, -1:], axis=2)]
    off = np.abs(np.log(spans[:, None, None] / MEMORY * np.sqrt(c.gyro * gyro * share[:, None] / density)))
    rows, likeliest = np.arange(count), np.argmax(likely, axis=2)
    k_stated = np.argmin(off[:, :, 0], axis=0)
    k_free = np.argmin(np.take_along_axis(off, likeliest[:, :, None], axis=2)[:, :, 0], axis=0)
    test = np.maximum((k_stated + k_free) // 2, np.searchsorted(spans, LASTING_S))
    heard = np.minimum(test, len(spans) - 1)
    refuted = (likely[heard, rows, 0] < likely[heard, rows].max(axis=1) - REFUTED) & (test < len(spans))
    k, m = np.where(refuted, k_free, k_stated), np.where(refuted, likeliest[k_free, rows], 0)
    return density[k, rows, m], gyro[m], spans[k]


def _likelihood(z: Array, R: Array, walk: Array, densities: Array, gyro: Array) -> Array:
    """Return the log-likelihood (rules, gyro factors, densities) of means ``z`` (J, rules, 2); both grids have the same
    step, so that their ratios are few.
    """
    noise = np.concatenate([densities[0] / gyro[:0:-1], densities])  # for a walk of one
    squares, logs = local_level.misfit(z[:, :, None], R[:, :, None] * noise, walk[:, None, None])
    at = np.arange(len(densities)) + (len(gyro) - 1 - np.arange(len(gyro)))[:, None]
    fit = squares[:, at] / gyro[:, None] + 2.0 * (logs[:, at] + (len(z) - 1) * np.log(gyro)[:, None])
    return np.asarray(-0.5 * fit + known_gyro(gyro)[:, None])


def _grid(least: float, most: float) -> Array:
    """Return powers of the grid's step from ``least`` to ``most``."""
    return np.asarray(least * GRID ** np.arange(2 + max(0, int(np.log(most / least) / np.log(GRID)))))


def _taper(per: int, causal: bool) -> Array:
    """Return the weights (2 per,) of a window of two steps: smooth as a smoother looks both ways, or one step flat."""
    if causal:
        return np.repeat([0.0, 1.0], per)
    return np.asarray(np.sin(np.pi * (np.arange(2 * per) + 0.5) / (2 * per)) ** 2)


def _windows(held: Array, force: Array, walk: Array, taper: Array) -> tuple[Array, Array, Array]:
    """Return means (J, rules, 2) over windows of two steps of cells, their noise (J, rules) for a density of one, and
    how far the vertical strays from one to the next (J - 1,).
    """
    per = len(taper) // 2
    rows = len(held) // per

    def summed(values: Array, by: Array) -> Array:
        blocks = values[: rows * per].reshape(rows, per, *values.shape[1:])
        first, second = np.tensordot(by[:per], blocks[:-1], (0, 1)), np.tensordot(by[per:], blocks[1:], (0, 1))
        return np.asarray(first + second)

    weight = np.maximum(summed(held, taper), NOTHING)
    noise = np.maximum(summed(held, taper**2), NOTHING**2) / weight**2
    strays = np.append(walk, NOTHING)[: rows * per].reshape(rows, per).sum(axis=1)
    return summed(force, taper) / weight[:, :, None], noise, strays[1:-1]
