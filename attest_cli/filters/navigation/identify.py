r"""The noise of a drive from the drive: what makes its own fixes and wheels most likely, seen from the sample before.

Data sheets do not hold in motion (vibration, scale, timing): on a car log the gyro's noise that explains the fixes is
fifty times the stated one. So the densities of gyro and accelerometer, and the sigma of every aid that has none stated,
are scaled until the innovations of the forward filter are most likely, one at a time, in steps that halve.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from ...maths import adjoint, strapdown
from ...records import Array, Bools, Ints
from . import colours
from .aids import UNSEEN, Aid, Place, Rows, Wheels, scaled_sigma
from .model import Inertial, Linear, Trajectory, linearise, renoised
from .solve import forward, log_likelihood, pile
from .states import Layout

WINDOW_NODES = 1500  # enough to tell a noise to a few per cent, and quick
CHECK_NODES, WIDER, TOO_FAR, MOST_STEPS = 4000, 1.41, 1.15, 8
CHANCE = 2.0  # sigmas of a mean square
HIDDEN_S, BETWEEN_S = 15.0, 25.0  # outages by which the coloured errors of fixes are checked
ROUNDS = 2
STEPS = (4.0, 2.0)  # factors tried, coarse to fine: what is left is found over the whole log
RANGE = (0.002, 400.0)
WORTH = 1.0  # log-likelihood that a change has to bring


@dataclass(frozen=True, slots=True)
class Window:
    """A stretch of the log, linearised: what the noise is judged by."""

    form: Layout
    P0: Array
    inertial: Inertial
    at: Trajectory
    lin: Linear
    rows: tuple[tuple[Aid, Rows], ...]

    def log_likelihood(self, factors: Mapping[str, float]) -> float:
        """Return that of the innovations with the sigmas times ``factors``."""
        P0, lin, placed = self.under(factors)
        return log_likelihood(P0, lin, pile(placed, len(self.at.q), self.form.size))

    def withheld(self, factors: Mapping[str, float]) -> tuple[float, float, int]:
        """Return the mean normalised square, per degree of freedom, and the log-likelihood of fixes in outages,
        predicted from both sides, and how many outages there are.
        """
        at = next(k for k, (aid, _) in enumerate(self.rows) if isinstance(aid, Place))
        shown = self.rows[at][1]
        hidden = (shown.t - shown.t[0]) % (HIDDEN_S + BETWEEN_S) > BETWEEN_S
        if not hidden.any():
            return 1.0, 0.0, 1
        P0, lin, placed = self._unseen(self.rows[at][0].role, shown.node, hidden).under(factors)
        aid, rows = placed[at]
        placed[at] = (aid, rows.where(~hidden))
        run = forward(P0, lin, pile(placed, len(self.at.q), self.form.size), np.zeros(self.form.size))
        errors, test = adjoint.smooth(run), rows.where(hidden)
        r, H = test.r[:, :2], test.H[:, :2]
        r = r - np.einsum("kij,kj->ki", H, (run.x + errors.d)[test.node])
        S = H @ errors.P[test.node] @ H.swapaxes(1, 2) + test.sigma[:, :2, None] ** 2 * np.eye(2)
        squares = np.einsum("ki,ki->k", r, np.linalg.solve(S, r[:, :, None])[:, :, 0])
        outages = len(np.unique((test.t - rows.t[0]) // (HIDDEN_S + BETWEEN_S)))
        return 0.5 * float(np.mean(squares)), -0.5 * float(np.sum(squares + np.linalg.slogdet(S)[1])), outages

    def _unseen(self, role: str, node: Ints, hidden: Bools) -> Window:
        """Return the window where ``hidden`` fixes of ``role`` at ``node`` show no jumps: the mean factor counts."""
        fix, gone = np.searchsorted(node, np.arange(1, len(self.at.q))), np.append(hidden, False)
        between = gone[fix] | gone[fix - 1]
        named = {s.name: s.loose for s in self.form.states if s.name.startswith(f"{role} drift")}
        loose = {name: of for name, of in named.items() if of is not None}
        return self.loosened({name: np.where(between, UNSEEN * of.mean(), of) for name, of in loose.items()})

    def loosened(self, loose: Mapping[str, Array]) -> Window:
        """Return the window with ``loose`` factors on what drives coloured errors, per interval between its nodes."""
        return replace(self, form=self.form.loosened(loose))

    def under(self, factors: Mapping[str, float]) -> tuple[Array, Linear, list[tuple[Aid, Rows]]]:
        """Return prior, motion and rows with the sigmas times ``factors``."""
        lin = renoised(self.lin, scaled_inertial(self.inertial, factors), self.form.scaled(factors), self.at)
        placed = [
            (aid, replace(rows, sigma=scaled_sigma(rows.sigma, factors.get(aid.role, 1.0))) if _free(aid) else rows)
            for aid, rows in self.rows
        ]
        return colours.steady(self.P0, self.form.scaled(factors)), lin, placed


def identify(
    form: Layout, P0: Array, inertial: Inertial, aids: Sequence[Aid], at: Trajectory, free: Sequence[str]
) -> dict[str, float]:
    """Return the factors on the sigmas of ``free`` (``gyro``, ``accelerometer``, roles of aids, groups of Gauss-Markov
    states), roughly: from a window of the log, where the aids are densest.

    The trajectory stays: what changes is how far the filter trusts each sensor.
    """
    window = stretch(form, P0, inertial, aids, at, WINDOW_NODES)
    factors = dict.fromkeys(free, 1.0)
    best = window.log_likelihood(factors)
    for step in STEPS:
        for _ in range(ROUNDS):
            moved = False
            for name in sorted({_level(name) for name in free}, key=list(free).index):
                for way in (step, 1.0 / step):
                    tied = [other for other in free if _level(other) == name]
                    trial = factors | {other: float(np.clip(factors[other] * way, *RANGE)) for other in tied}
                    value = window.log_likelihood(trial)
                    if value > best + WORTH:
                        best, factors, moved = value, trial, True
                        break
            if not moved:
                break
    return factors


def widened(
    form: Layout, P0: Array, inertial: Inertial, aids: Sequence[Aid], at: Trajectory, factors: Mapping[str, float]
) -> dict[str, float]:  # fmt: skip
    """Return the factors with noise wide enough for outages of the fixes.

    The likelihood judges from fix to fix; what wanders more slowly, a coloured error or an IMU that is worse than it
    looks from one second to the next, shows when a stretch of fixes is hidden. What explains them best is widened, for
    as long as they lie too far off, and that makes them likelier or is no chance: errors of one outage are one draw.
    """
    out = dict(factors)
    if not any(isinstance(aid, Place) for aid in aids):
        return out
    window = stretch(form, P0, inertial, aids, at, CHECK_NODES)
    square, best, outages = window.withheld(out)
    for _ in range(MOST_STEPS):
        if square <= TOO_FAR:
            break
        trials = [out | {tied: out[tied] * WIDER for tied in out if _level(tied) == name} for name in _slow(out, aids)]
        judged = [window.withheld(trial) for trial in trials]
        k = int(np.argmax([likely for _, likely, _ in judged]))
        if square < 1.0 + CHANCE / np.sqrt(outages) and judged[k][1] < best + WORTH:
            break
        out, (square, best, _) = trials[k], judged[k]
    return out


def _level(name: str) -> str:
    """Return the group of an error level that goes with that ``name`` up: roughly both are as large."""
    return name.replace(" up", "")


def _slow(factors: Mapping[str, float], aids: Sequence[Aid]) -> list[str]:
    """Return what may be at fault in an outage: coloured errors, and the IMU where no wheels bridge it."""
    wheels = any(isinstance(aid, Wheels) for aid in aids)
    imu = [] if wheels else ["gyro", "accelerometer"]
    return [name for name in factors if name in imu or name.endswith((" drift", " drift rate", " slip"))]


def scaled_inertial(inertial: Inertial, factors: Mapping[str, float]) -> Inertial:
    """Return the IMU with its densities scaled."""
    gyro, accel = factors.get("gyro", 1.0), factors.get("accelerometer", 1.0)
    return replace(inertial, gyro=inertial.gyro * gyro**2, accel=inertial.accel * accel**2)


def _free(aid: Aid) -> bool:
    return isinstance(aid, Place | Wheels)


def stretch(
    form: Layout, P0: Array, inertial: Inertial, aids: Sequence[Aid], at: Trajectory, most: int
) -> Window:  # fmt: skip
    """Return the stretch of at most ``most`` nodes with most fixes and wheels."""
    n, first = len(at.q), 0
    if n > most:
        count = np.concatenate([np.zeros(0, dtype=np.int64), *(a.node for a in aids if isinstance(a, Place | Wheels))])
        total = np.concatenate([[0], np.cumsum(np.bincount(count, minlength=n))])
        first = int(np.argmax(total[most:] - total[:-most]))
    nodes = slice(first, min(n, first + most))
    between = slice(nodes.start, nodes.stop - 1)
    lin = linearise(inertial, form, at)
    motion = strapdown.Motion(*(getattr(lin.motion, f.name)[between] for f in fields(lin.motion)))
    cut = {name: getattr(inertial, name)[between] for name in ("frozen", "gap", "gyro", "accel")}
    rows = tuple((aid, aid.rows(form, at).within(nodes.start, nodes.stop)) for aid in aids)
    return Window(
        form.within(between), P0, replace(inertial, **cut), Trajectory(at.q[nodes], at.x[nodes]),
        Linear(lin.Phi[between], lin.Q[between], lin.u[between], motion), rows,
    )  # fmt: skip
