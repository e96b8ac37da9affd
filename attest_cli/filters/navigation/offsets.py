"""Heading sensors that are off by a constant (mounting, declination, iron): where fixes show the way, they show it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...maths import rotation
from ...maths.kalman import Errors
from ...records import Array, Warn
from ...settings import Settings
from .solve import Solution
from .states import Layout, State

ROLES = ("compass", "orientation", "magnetometer")  # a sun sensor has no north to be mistaken in: its mount is surveyed
BEYOND, SURE = 2.0, 4.0  # sigmas as stated, and as the fixes show it, from which an offset is told
CHANCE = 2.0  # sigmas as the fixes show it that an offset of none looks like now and then
LEAST_SEEN = 1e-3  # of the prior variance: what the fixes take from it at least


@dataclass(frozen=True, slots=True)
class Offset:
    """A heading sensor's offset: ``angle`` (counter-clockwise) and ``sigma`` as all else shows it, fixes above all, its
    prior sigma ``assumed``, the ``stated`` one; rad. ``at`` its place among the states, ``P`` its variance there.
    """

    role: str
    angle: float
    sigma: float
    assumed: float
    stated: float
    at: int
    P: float

    @property
    def told(self) -> bool:
        """Whether it is surely larger than what is stated of the sensor."""
        return abs(self.angle) > float(np.hypot(BEYOND * self.stated, SURE * self.sigma))

    @property
    def scatter(self) -> float:
        r"""The prior variance of which it is a likely draw, less what chance makes: :math:`v=(o^2-4\sigma^2)^+`."""
        return max(self.angle**2 - (CHANCE * self.sigma) ** 2, 0.0)

    @property
    def doubt(self) -> float:
        """What the assumed prior and the likely one make of it, apart, rad."""
        with_assumed, likely = (self.angle * v / (v + self.sigma**2) for v in (self.assumed**2, self.scatter))
        return likely - with_assumed


def offset_states(settings: Settings, roles: set[str], found: Mapping[str, float]) -> list[State]:
    """Return the offsets of the heading sensors in use: what is stated of a reading may be the same in all; ``found``:
    prior sigmas, rad, of those that are beyond.
    """
    return [State(f"{role} offset", 1, found.get(role, _stated(settings, role))) for role in ROLES if role in roles]


def _stated(settings: Settings, role: str) -> float:
    return float(np.radians(getattr(settings, role).sigma_deg))


def offsets(settings: Settings, layout: Layout, prior: Array, found: Solution) -> Iterator[Offset]:
    r"""Yield what all else (fixes, and other heading sensors with the offsets that theirs may have) shows of every
    offset: the estimate :math:`o_s,P` without its ``prior`` (s, s), :math:`s^2`

    .. math:: o=o_s\frac{s^2}{s^2-P},\quad\sigma^2=P\frac{s^2}{s^2-P}
    """
    for role in ROLES:
        if f"{role} offset" in layout:
            at = layout.parts[f"{role} offset"].start
            P, s2 = float(found.errors.P[-1, at, at]), float(prior[at, at])
            more = s2 / max(s2 - P, LEAST_SEEN * s2)
            angle, sigma = more * float(found.smoothed.x[-1, at]), float(np.sqrt(more * P))
            yield Offset(role, angle, sigma, float(np.sqrt(s2)), _stated(settings, role), at, P)


def wider(known: Iterable[Offset]) -> dict[str, float]:
    """Return the prior sigmas, rad, of offsets that are surely beyond theirs: such a sensor is not held to it."""
    return {o.role: float(np.sqrt(o.scatter)) for o in known if o.told and o.scatter > (BEYOND * o.assumed) ** 2}


def settled(x: Array, errors: Errors, known: Sequence[Offset]) -> Errors:
    r"""Return the errors about a pass ``x`` (n, s), with offsets no larger than the fixes make likely.

    Most heading sensors point right, and that one may be off must not make its heading worse where the fixes hardly
    show it. So the prior variance is the likely one, :math:`v`, up to the assumed :math:`s^2` (empirical Bayes; as the
    positive part of James and Stein 1961, with more for chance):

    .. math:: d'=d+g\,m_k,\quad m_k=-o_k\frac{P_{oo}(s^2-v)}{vs^2+P_{oo}(s^2-v)},\quad g=Pe_o/P_{oo}

    Sigma stays that of the assumed one, and holds the difference, :math:`P'=P+gg^Tm_k^2`; where :math:`v>s^2`, that
    between both.
    """
    for o in known:
        P_oo = np.maximum(errors.P[:, o.at, o.at], 1e-300)
        g = errors.P[:, :, o.at] / P_oo[:, None]
        s2, v, d = o.assumed**2, o.scatter, errors.d
        if v < s2:
            held = P_oo * (s2 - v)
            apart = -(x[:, o.at] + d[:, o.at]) * held / (v * s2 + held)
            d = d + g * apart[:, None]
        else:
            apart = o.doubt * np.clip((s2 - P_oo) / max(s2 - o.P, LEAST_SEEN * s2), 0.0, 1.0)  # as far as it is seen
        bent = g * apart[:, None]
        errors = replace(
            errors, d=d, P=errors.P + bent[:, :, None] * bent[:, None, :],
            cross=errors.cross + bent[:-1, :, None] * bent[1:, None, :],
        )  # fmt: skip
    return errors


def beforehand(x: Array, known: Sequence[Offset]) -> tuple[Array, Array] | None:
    """Return what is known of the offsets beforehand, as information (Y (s, s), y (n, s)) about errors of ``x``
    (n, s).
    """
    if not known:
        return None
    Y = np.zeros((x.shape[1], x.shape[1]))
    for o in known:
        Y[o.at, o.at] = 1.0 / o.assumed**2
    return Y, -x @ Y


def datum(P: Array, q: Array, known: Sequence[Offset]) -> Array:
    r"""Return the variance (n,) of heading, rad^2, that offsets make, one draw for all of the log, of covariances
    (n, s, s) at attitudes (n, 4): :math:`CP_{oo}^{-1}C^T`, with :math:`C` the covariance of heading and offsets, and
    what their prior is in doubt.
    """
    if not known:
        return np.zeros(len(P))
    at = np.array([o.at for o in known])
    C = np.einsum("ki,kio->ko", rotation.matrix(q)[:, 2], P[:, :3, at])
    gain = np.linalg.solve(P[:, at[:, None], at] + 1e-18 * np.eye(len(at)), C[..., None])[..., 0]
    return np.asarray(np.sum(gain * C, axis=1) + gain**2 @ np.array([o.doubt**2 for o in known]))


def doubts(known: Iterable[Offset], by: str) -> list[Warn]:
    """Say which sensors are off by more than is stated of them, against the way of the fixes of a sensor, ``by``."""
    out = []
    for o in (o for o in known if o.told):
        way = "counter-clockwise" if o.angle > 0.0 else "clockwise"
        message = f"heading by {o.role} is {np.degrees(abs(o.angle)):.1f} deg (sigma {np.degrees(o.sigma):.1f}) too far"
        message += f" {way} for the way of the fixes of {by}: corrected"
        hint = f"its mounting, or its north: true or magnetic? [{o.role}] sigma_deg states what it may be off"
        out.append(Warn(f"{o.role}-offset", message, hint))
    return out
