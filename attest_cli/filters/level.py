r"""From the vertical to the attitude: what a filter knows that estimates only where up is.

Its heading is carried by the gyro: the attitude is turned by the rate, then set upright by the smallest turn. What the
filter does not estimate (heading; gyro bias) stands with the sigma that dead reckoning leaves it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..maths import rotation
from ..maths.kalman import Errors, symmetric
from ..maths.sequential import Pass
from ..records import Array, Bools, FilterRun, Innovations, Smoothed
from .samples import Samples

DATUM = 1e-4  # rad: heading that is zero by definition
Up = Callable[[Array], tuple[Array, Array]]
"""``x`` (n, s) -> up in body axes (n, 3), unit, and its Jacobian (n, 3, s)."""


@dataclass(frozen=True, slots=True)
class Level:
    """Reads attitude and gyro bias off a chain of states that hold where up is.

    ``samples`` (n of them); ``x`` (n, s) updated states of the forward pass; ``up``; ``bias`` (3, s): which states are
    corrections of the gyro bias, rad/s; ``held`` (n - 1,) steps that do not turn (stops); ``tilt`` rad, 1 sigma, by
    which the accelerometer's bias sets the vertical off all along, where no state holds it; ``lag`` rad, 1 sigma, what
    a pass of one side takes for tilt of accelerations faster than its gain.
    """

    samples: Samples
    x: Array
    up: Up
    bias: Array
    held: Bools
    tilt: float = 0.0
    lag: float = 0.0

    def __call__(self, errors: Errors) -> Smoothed:
        r"""Return attitude and bias after the errors ``d`` of the states are taken in.

        .. math:: \delta\theta=-[\hat u\times]\,\delta u+\hat u\,\delta\psi

        with the heading error :math:`\delta\psi` a random walk of the gyro's noise plus what the unknown bias about the
        vertical makes of the time; where no state holds the bias, its error is another after each stop.
        """
        s, x = self.samples, self.x + errors.d
        up, slope = self.up(x)
        b = x @ self.bias.T
        step = np.where(s.gap, 0.0, s.dt)
        q = carried(s.turn_b - 0.5 * (b[1:] + b[:-1]) * step[:, None], up, self.held)
        T = np.concatenate([-rotation.skew(up) @ slope, np.tile(self.bias, (len(x), 1, 1))], axis=1)
        P = symmetric(T @ errors.P @ T.swapaxes(1, 2))
        cross = T[:-1] @ errors.cross @ T[1:].swapaxes(1, 2)
        free = np.where(np.any(self.bias != 0.0, axis=1), 0.0, s.bias_sigma**2)
        heading, heading_cross = self._heading(np.einsum("ki,kij,kj->k", up, P[:, 3:, 3:], up), up**2 @ free)
        P[:, 3:, 3:] += np.diag(free)
        cross[:, 3:, 3:] += np.diag(free)
        one_sided = not (errors.d.any() and errors.cross.any())  # forward: nothing moved; backward: node by node
        P[:, :3, :3] += (self.tilt**2 + one_sided * self.lag**2) * (np.eye(3) - up[:, :, None] * up[:, None, :])
        cross[:, :3, :3] += self.tilt**2 * (np.eye(3) - up[:-1, :, None] * up[1:, None, :])
        P[:, :3, :3] += np.einsum("ki,kj,k->kij", up, up, heading)
        cross[:, :3, :3] += np.einsum("ki,kj,k->kij", up[:-1], up[1:], heading_cross)
        return Smoothed(s.t, q, s.bias_b + b, P, cross)

    def _heading(self, known: Array, free: Array) -> tuple[Array, Array]:
        """Return variance (n,) and lag-one covariance (n - 1,) of the heading, rad^2, from the variances (n,) of the
        bias about the vertical: of one that states hold, and of one that the stops leave, (rad/s)^2.
        """
        s = self.samples
        turning = np.where(self.held, 0.0, s.dt)
        walk = DATUM**2 + _summed(s.density * turning + np.where(s.gap, np.pi**2 / 3, 0.0))
        begins = np.concatenate([[True], s.still[1:] & ~s.still[:-1]])  # at each stop another error
        piece = np.cumsum(begins) - 1
        variance, covariance = walk, walk[:-1]
        for sigma, part in ((np.sqrt(known), np.zeros_like(piece)), (np.sqrt(free), piece)):
            ramp = _summed(0.5 * (sigma[1:] + sigma[:-1]) * turning)
            start = ramp[np.flatnonzero(np.diff(part, prepend=-1))]
            done = _summed(np.diff(start) ** 2)[part]
            since = ramp - start[part]
            variance = variance + done + since**2
            covariance = covariance + done[:-1] + since[:-1] * (ramp[1:] - start[part[:-1]])
        return variance, covariance


def _summed(steps: Array) -> Array:
    """Return the running sums (n,) of steps (n - 1,), zero first."""
    return np.concatenate([[0.0], np.cumsum(steps)])


def upright(up_b: Array) -> Array:
    """Return the smallest turns (n, 4) that take ``up_b`` (n, 3), unit, to the vertical."""
    zero = np.zeros(len(up_b))
    q = np.stack([1.0 + up_b[:, 2], up_b[:, 1], -up_b[:, 0], zero], axis=1)
    q[np.linalg.norm(q, axis=1) < 1e-9] = [0.0, 1.0, 0.0, 0.0]  # upside down: any horizontal axis will do
    return rotation.normalise(q)


def carried(turn_b: Array, up_b: Array, held: Bools) -> Array:
    """Return the attitudes (n, 4), heading 0 at the start, whose vertical is ``up_b`` (n, 3) and whose heading is the
    gyro's: each is the one before, turned by ``turn_b`` (n - 1, 3), set upright by the smallest turn.

    All at once: with the heading taken out, a step depends on its two verticals only; the headings then add up.
    """
    tilt = upright(up_b)
    turned = rotation.multiply(tilt[:-1], rotation.exp_quaternion(turn_b))
    righted = rotation.multiply(upright(rotation.rotate(turned, up_b[1:])), turned)
    about = rotation.multiply(righted, rotation.conjugate(tilt[1:]))  # a turn about the vertical
    step = np.where(held, 0.0, 2.0 * np.arctan2(about[:, 3], about[:, 0]))
    heading = np.concatenate([[0.0], np.cumsum(rotation.wrap(step))])
    zero = np.zeros(len(heading))
    q = np.stack([np.cos(0.5 * heading), zero, zero, np.sin(0.5 * heading)], axis=1)
    return rotation.normalise(rotation.multiply(q, tilt))


def run_of(level: Level, found: Pass, innovations: Innovations, absent: tuple[str, ...]) -> FilterRun:
    """Return the forward pass of a filter of the vertical, ready for every smoother."""
    s, chain = level.samples, found.chain
    forward = level(Errors(np.zeros_like(chain.dx), chain.P, np.zeros_like(chain.P[1:])))
    in_motion = not bool(s.still[: max(1, int(np.searchsorted(s.t, s.t[0] + 1.0)))].any())
    return FilterRun(
        s.t, forward.q, forward.bias, chain, None, innovations, ~s.still, "relative", in_motion,
        level, absent,
    )  # fmt: skip
