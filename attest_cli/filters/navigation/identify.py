r"""The noise of a drive from the drive: what makes its own fixes and wheels most likely, seen from the sample before.

Data sheets do not hold in motion (vibration, scale, timing): on a car log the gyro's noise that explains the fixes is
fifty times the stated one. So the densities of gyro and accelerometer, and the sigma of every aid that has none stated,
are scaled until the innovations of the forward filter are most likely, one at a time, in steps that halve.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...maths import sequential
from ...records import Array
from .aids import Aid, Place, Wheels
from .model import Inertial, Linear, Trajectory, linearise, renoised
from .solve import forward, stack
from .states import Layout

WINDOW_NODES = 1500  # enough to tell a noise to a few per cent, and quick
ROUNDS = 2
STEPS = (4.0, 2.0, 1.41)  # factors tried, coarse to fine
RANGE = (0.002, 400.0)


def identify(
    form: Layout, P0: Array, inertial: Inertial, aids: Sequence[Aid], at: Trajectory, free: Sequence[str]
) -> dict[str, float]:
    """Return the factors on the sigmas of ``free`` (``gyro``, ``accelerometer``, roles of aids): coordinate search.

    The trajectory stays: what changes is how far the filter trusts each sensor. A window of the log is used, where the
    aids are densest.
    """
    lin = linearise(inertial, form, at)
    rows = _window(aids, len(at.q))
    factors = dict.fromkeys(free, 1.0)
    best = _likelihood(form, P0, inertial, aids, at, lin, rows, factors)
    for step in STEPS:
        for _ in range(ROUNDS):
            moved = False
            for name in free:
                for way in (step, 1.0 / step):
                    trial = {**factors, name: float(np.clip(factors[name] * way, *RANGE))}
                    value = _likelihood(form, P0, inertial, aids, at, lin, rows, trial)
                    if value > best + 1.0:
                        best, factors, moved = value, trial, True
                        break
            if not moved:
                break
    return factors


def _scaled_inertial(inertial: Inertial, factors: dict[str, float]) -> Inertial:
    """Return the IMU with its densities scaled."""
    gyro, accel = factors.get("gyro", 1.0), factors.get("accelerometer", 1.0)
    return replace(inertial, gyro=inertial.gyro * gyro**2, accel=inertial.accel * accel**2)


def _scaled_aid(aid: Aid, factors: dict[str, float]) -> Aid:
    """Return the aid with its sigma scaled."""
    if isinstance(aid, Place | Wheels) and aid.role in factors:
        return aid.scaled(factors[aid.role])
    return aid


def _window(aids: Sequence[Aid], n: int) -> slice:
    """Return the nodes to judge by: the longest run of at most ``WINDOW_NODES`` with most fixes and wheels."""
    if n <= WINDOW_NODES:
        return slice(0, n)
    count = np.zeros(n)
    for aid in aids:
        if isinstance(aid, Place | Wheels):
            np.add.at(count, aid.node, 1.0)
    total = np.concatenate([[0.0], np.cumsum(count)])
    first = int(np.argmax(total[WINDOW_NODES:] - total[:-WINDOW_NODES]))
    return slice(first, first + WINDOW_NODES)


def _likelihood(
    form: Layout, P0: Array, inertial: Inertial, aids: Sequence[Aid], at: Trajectory, lin: Linear, rows: slice,
    factors: dict[str, float],
) -> float:  # fmt: skip
    """Return the log-likelihood of the innovations in the window."""
    noisy = renoised(lin, _scaled_inertial(inertial, factors), at)
    stacked = stack([_scaled_aid(a, factors) for a in aids], form, at)
    between = slice(rows.start, rows.stop - 1)
    part = Linear(noisy.Phi[between], noisy.Q[between], noisy.u[between], noisy.motion)
    here = replace(stacked, r=stacked.r[rows], H=stacked.H[rows])
    found: sequential.Pass = forward(P0, part, here, np.zeros(form.size))
    # whitened rows: their own scale belongs to the likelihood of what was measured
    log_sigma = 0.0
    for aid, placed, _, weight in stacked.places:
        if isinstance(aid, Place | Wheels):
            use = (placed.node >= rows.start) & (placed.node < rows.stop)
            log_sigma += float(
                np.sum(np.log(placed.sigma[use])) - 0.5 * placed.sigma.shape[1] * np.sum(np.log(weight[use]))
            )
    return found.log_likelihood() - log_sigma
