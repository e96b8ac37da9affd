r"""What noise feigns: how well motion alone shows the heading, and how late fixes are.

Both are found from the force that the IMU felt against the path of the fixes. Gauss-Newton takes the smoothed force for
the true one, and finds an information :math:`I=I_0+m`, where :math:`m` is of the noise that is left in it. The estimate
scatters by (errors in variables; Fuller 1987, Measurement Error Models)

.. math:: \sigma^2=\frac{I_0+m}{I_0^2}=\frac1{s^2I},\quad s=\frac{I_0}I.

What the drive costs with the state held elsewhere, :math:`J=-2\log L` at its optimum, tells :math:`I_0`. The filter
says :math:`\sigma` itself if its measurements move by the slope :math:`s` times the state's error only: that moves no
optimum but by its prior, and makes its steps about those of Newton.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...maths import rotation
from . import solve
from .aids import Place, Velocity, Wheels
from .model import Trajectory
from .problem import DATUM, HEADING_SIGMA, Problem, no_north, upright

EACH = 4.0  # information that a fix would have to feign at least: it does a twelfth of that or less
HELD_RAD, HELD = 1e-4, 1e-12  # sigma of a heading that is held; share of the variance of another state
PASSES, TINY = 4, 1e-12
LEAST = 1e-3  # slope of what is not shown at all
SURE = 3.0  # sigmas from which on a state is believed
THREE = 2.0 * np.pi / 3.0 * np.arange(3)  # rad: turns that a cosine is found from
NOT_SHOWN = float(np.sqrt(2.0 * np.log(100.0)))  # I_0 / sqrt(I) that noise alone makes once in a hundred logs


def slope(known: float, shown: float) -> float:
    """Return the slope ``s`` of a state of which the filter finds the information ``known``, its costs ``shown``."""
    return float(np.clip(shown / known, 0.0, 1.0))


def surveyed(problem: Problem, found: solve.Solution) -> tuple[Problem, float] | None:
    r"""Return the problem at the heading that costs least, and with the slope of its heading, and the sigma of that at
    the start, rad; None where noise is too little to matter.

    Forces are turned about the vertical, so a drive that begins with the heading :math:`\psi` costs

    .. math:: J(\psi)=c-A\cos(\psi-\psi_0),\quad I_0=A/2:

    three headings show all of it, also where the passes stopped far from :math:`\psi_0`. Noise alone makes an
    :math:`I_0` that is larger than :math:`x` with a chance of :math:`e^{-x^2/2I}`. Where that is no small one, no
    heading is shown: it counts from the start, and forces do not bend it.
    """
    up = rotation.matrix(found.smoothed.q)[:, 2]
    variances = np.einsum("ki,kij,kj->k", up, found.errors.P[:, :3, :3], up)
    fixes = max((len(a.t) for a in problem.aids if isinstance(a, Place | Velocity)), default=0)
    wheels = any(isinstance(a, Wheels) for a in problem.aids)  # show the heading by the path, of which little is noise
    if wheels or variances.min() * EACH * fixes < 1.0:
        return None
    costs = np.array([_headed(problem, found, psi) for psi in THREE])
    wave = -2.0 / 3.0 * complex(np.sum(costs * np.exp(1j * THREE)))
    known = max(1.0 / variances[0] - HEADING_SIGMA**-2, TINY) / problem.inertial.slope**2
    at, by = turned(found.smoothed, float(np.angle(wave))), slope(known, 0.5 * abs(wave))
    start, P0 = Trajectory(at.q[:1], problem.prior[0].x), problem.prior[1].copy()  # no knowledge: it must not draw
    if by * np.sqrt(known) < NOT_SHOWN:
        P0[:3, :3] = upright(at.q[0], DATUM)
        inertial = replace(problem.inertial, slope=0.0)
        told = (*problem.warnings, no_north())
        none = replace(problem, at=at, prior=(start, P0), inertial=inertial, heading="relative", warnings=told)
        return none, DATUM
    inertial = replace(problem.inertial, slope=by)
    sigma = float(1.0 / np.sqrt(by**2 * known + HEADING_SIGMA**-2))
    return replace(problem, at=at, prior=(start, P0), inertial=inertial), sigma


def kept(problem: Problem, found: solve.Solution, sigma: float) -> Problem:
    r"""Return the problem with a slope that gives its heading at the start the ``sigma``, rad, that was found.

    Of a heading that wanders the filter's variance goes by :math:`1/s`, not :math:`1/s^2`.
    """
    up = rotation.matrix(found.smoothed.q[:1])[0, 2]
    says = float(np.sqrt(up @ found.errors.P[0, :3, :3] @ up))
    by = problem.inertial.slope * min(1.0, (says / sigma) ** 2)
    return replace(problem, at=found.smoothed, inertial=replace(problem.inertial, slope=by))


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

    A value of :math:`\sqrt b` of its sigmas is one of :math:`d/\sqrt b`.
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
    return Doubt(float(np.sqrt(claimed)), gain / float(np.sqrt(claimed + TINY)), max(LEAST, by))


def _held(problem: Problem, found: solve.Solution, at: int, value: float) -> float:
    """Return the cost of a drive with the ``at``-th state held at a value."""
    q, x, P0 = found.smoothed.q, found.smoothed.x.copy(), problem.prior[1].copy()
    start = replace(problem.prior[0], x=problem.prior[0].x.copy())
    x[:, at] = start.x[:, at] = value
    P0[at, at] *= HELD
    return solve.solve(problem.layout, (start, P0), problem.inertial, found.weighted, Trajectory(q, x), PASSES).cost
