r"""What noise feigns: how well motion alone shows the heading, and how late fixes are.

Both are found from the force that the IMU felt against the path of the fixes. Gauss-Newton takes the smoothed force for
the true one, and finds an information :math:`I=I_0+m`, where :math:`m` is of the noise that is left in it. If that is
much, the estimate scatters by (errors in variables; Fuller 1987, Measurement Error Models)

.. math:: \sigma^2=\frac{I_0+2m}{I_0^2}=\frac1{s^2I}.

What the drive costs with the state held elsewhere, :math:`J=-2\log L` at its optimum, tells :math:`I_0`, as noise makes
no other value more likely than that. The filter says :math:`\sigma` itself if its measurements move by the slope
:math:`s` times the state's error only: that moves no optimum, and makes the steps about those of Newton.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...maths import rotation
from ...records import Warn
from . import solve
from .aids import Place, Velocity, Wheels
from .model import Trajectory
from .problem import HEADING_SIGMA, NORTH_RAD, Problem, upright

EACH = 4.0  # information that a second with fixes would have to feign at least: it does a twelfth of that
HELD_RAD, HELD = 1e-4, 1e-12  # sigma of a heading that is held; share of the variance of another state
PASSES, TINY = 4, 1e-12
SURE, BORNE_OUT = 3.0, 2.5  # sigmas from which on a state is believed: as the filter says, and as its costs do
THREE = 2.0 * np.pi / 3.0 * np.arange(3)  # rad: turns that a cosine is found from
LEAST_SLOPE, LEAST_OTHER = 0.1, 0.02  # of a heading that is hardly shown; of another state


def slope(known: float, shown: float) -> float:
    """Return the slope ``s`` of a state of which the filter finds the information ``known``, its costs ``shown``."""
    shown = float(np.clip(shown, 0.0, known))
    return shown / float(np.sqrt(known * (2.0 * known - shown)))


def surveyed(problem: Problem, found: solve.Solution) -> Problem | None:
    r"""Return the problem at the heading that costs least, and with the slope of its heading; None where noise is too
    little to matter.

    Forces are turned about the vertical, so a drive that begins with the heading :math:`\psi` costs

    .. math:: J(\psi)=c-A\cos(\psi-\psi_0),\quad I_0=A/2:

    three headings show all of it, also where the passes stopped far from :math:`\psi_0`.
    """
    up = rotation.matrix(found.smoothed.q)[:, 2]
    variances = np.einsum("ki,kij,kj->k", up, found.errors.P[:, :3, :3], up)
    seconds = max((len(np.unique(np.floor(a.t))) for a in problem.aids if isinstance(a, Place | Velocity)), default=0)
    wheels = any(isinstance(a, Wheels) for a in problem.aids)  # show the heading by the path, of which little is noise
    if wheels or variances.min() * EACH * seconds < 1.0:
        return None
    costs = np.array([_headed(problem, found, psi) for psi in THREE])
    wave = -2.0 / 3.0 * complex(np.sum(costs * np.exp(1j * THREE)))
    known = max(1.0 / variances[0] - HEADING_SIGMA**-2, 1e-9) / problem.inertial.slope**2
    by = max(LEAST_SLOPE, slope(known, 0.5 * abs(wave)))
    at = turned(found.smoothed, float(np.angle(wave)))
    return replace(
        problem, at=at, inertial=replace(problem.inertial, slope=by),
        prior=(Trajectory(at.q[:1], problem.prior[0].x), problem.prior[1]),  # no knowledge: it must not draw
        warnings=(*problem.warnings, *_weak(1.0 / np.sqrt(by**2 * known + HEADING_SIGMA**-2))),
    )  # fmt: skip


def _weak(sigma: float) -> list[Warn]:
    """Say that the heading is hardly shown, where it is."""
    if sigma < NORTH_RAD:
        return []
    message = f"the fixes hardly show where north is: to {np.degrees(sigma):.0f} deg"
    return [Warn("north-not-shown", message, "a compass, or a livelier drive, shows it")]


def turned(at: Trajectory, psi: float) -> Trajectory:
    """Return a trajectory whose attitude is turned about the vertical by ``psi``, rad."""
    return Trajectory(rotation.multiply(rotation.exp_quaternion(np.array([[0.0, 0.0, psi]])), at.q), at.x)


def _headed(problem: Problem, found: solve.Solution, psi: float) -> float:
    """Return the cost of a drive that begins ``psi`` to the left of what was found."""
    at, P0 = turned(found.smoothed, psi), problem.prior[1].copy()
    P0[:3, :3] = upright(at.q[0], HELD_RAD)
    start = Trajectory(at.q[:1], problem.prior[0].x)
    return solve.solve(problem.layout, (start, P0), problem.inertial, found.weighted, at, PASSES).cost


@dataclass(frozen=True, slots=True)
class Doubt:
    """Of a state: its value in sigmas as the filter says, in those that count what noise feigns, and its ``slope``."""

    claimed: float
    borne_out: float
    slope: float


def constant(problem: Problem, found: solve.Solution, name: str) -> Doubt:
    r"""Return how sure a scalar state is that is constant: by what the drive costs more, :math:`d`, where it is held at
    zero; or further off, if zero is not that far away, to see its slope.

    A value of :math:`\sqrt b` of its sigmas is one of :math:`d/\sqrt{2b-d}`.
    """
    at = problem.layout.parts[name].start
    prior, before, variance = problem.prior[1][at, at], problem.layout.slopes()[at], found.errors.P[0, at, at]
    value = float(found.smoothed.x[0, at])
    claimed = value**2 / variance
    known = max(1.0 / variance - 1.0 / prior, 1e-9 / prior) / before**2
    away = -value if claimed > SURE**2 else -float(np.copysign(np.sqrt(prior), value))
    cost = _held(problem, found, at, value + away) - found.cost
    drawn = -2.0 * value * away / before - value**2  # by the prior, off the least cost
    gain = float(np.clip(cost, 0.0, claimed)) if away == -value else claimed
    by = slope(known, (cost - drawn / prior) / away**2)
    return Doubt(float(np.sqrt(claimed)), gain / float(np.sqrt(2.0 * claimed - gain + TINY)), max(LEAST_OTHER, by))


def _held(problem: Problem, found: solve.Solution, at: int, value: float) -> float:
    """Return the cost of a drive with the ``at``-th state held at a value."""
    q, x, P0 = found.smoothed.q, found.smoothed.x.copy(), problem.prior[1].copy()
    start = replace(problem.prior[0], x=problem.prior[0].x.copy())
    x[:, at] = start.x[:, at] = value
    P0[at, at] *= HELD
    return solve.solve(problem.layout, (start, P0), problem.inertial, found.weighted, Trajectory(q, x), PASSES).cost
