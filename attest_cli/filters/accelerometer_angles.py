r"""Roll and pitch from the accelerometer of a vehicle whose own acceleration is known (Vaganay et al. 1993, section 4).

Symbols: forward speed ``V_x``, rates ``Omega = (p, q, r)``, lever arm ``d = O_r O_a`` from the vehicle's reference
point to the accelerometer, all in body axes (forward, left, up).
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ..maths import rotation
from ..records import Array, Ints

LEAST_OVERSAMPLING = 4.0  # no low-pass where samples come slower than this times the cut
TWO_PASSES = (np.sqrt(2.0) - 1.0) ** 0.25  # cut of each of two second-order passes over their common cut
BLOCKS_S = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)  # over which the noise in motion is read
SLOW_BLOCKS = 2  # of these are left out where the motions are long enough: what is fast averages out
MEDIAN_OF_NORMAL = 0.6745  # of the absolute value of a standard normal deviate
LEAST_DIFFERENCES = 12  # that make a variance worth its name


def angles(force_b: Array) -> Array:
    r"""Return pitch and roll (n, 2), rad, of specific force (n, 3) that is gravity alone.

    .. math:: \psi=\mathrm{atan2}(-g_x,\sqrt{g_y^2+g_z^2}),\qquad\varphi=\mathrm{atan2}(g_y,g_z)

    Independent of the accelerometer's scale and right past 90 degrees of roll. Source: eqs (8), (9) in the corrected
    three-axis form of the project's note.
    """
    x, y, z = force_b.T
    return np.stack([np.arctan2(-x, np.hypot(y, z)), np.arctan2(y, z)], axis=1)


def components(pitch_roll: Array, gravity: float) -> Array:
    r"""Return the components of gravity :math:`(-g\sin\psi,\ g\cos\psi\sin\varphi)` (n, 2), m/s^2."""
    pitch, roll = pitch_roll.T
    return gravity * np.stack([-np.sin(pitch), np.cos(pitch) * np.sin(roll)], axis=1)


def acceleration(speed: Array, speed_rate: Array, rate_b: Array, rate_rate_b: Array, lever_b: Array) -> Array:
    r"""Return the acceleration (n, 3) of the accelerometer, m/s^2, body axes.

    .. math:: \gamma=(\dot V_x,\ V_xr,\ -V_xq)+\dot\Omega\times d+\Omega\times(\Omega\times d)

    Parameters
    ----------
    speed, speed_rate : (n,) forward, m/s and m/s^2; the vehicle does not slip sideways
    rate_b, rate_rate_b : (n, 3) rad/s and rad/s^2
    lever_b : (3,) m

    Notes
    -----
    Eq (10) with its third component, which the paper leaves out.
    """
    driven = np.stack([speed_rate, speed * rate_b[:, 2], -speed * rate_b[:, 1]], axis=1)
    arm = np.broadcast_to(lever_b, rate_b.shape)
    turned = rotation.cross(rate_rate_b, arm) + rotation.cross(rate_b, rotation.cross(rate_b, arm))
    return np.asarray(driven + turned)


def compensated(
    force_b: Array, rate_b: Array, speed: Array, lever_b: Array, t: Array, edges: Ints, cutoffs: tuple[float, float]
) -> Array:
    """Return the specific force (n, 3) without the vehicle's own acceleration: gravity, and what shakes.

    Parameters
    ----------
    speed : (n,) forward, m/s; zeros where it is not known: then only the lever arm is taken out
    edges : as for ``low_pass``
    cutoffs : of the inertial sensors and of the speed, Hz; all is low-passed before it is differentiated
    """
    force, rate = low_pass(force_b, t, edges, cutoffs[0]), low_pass(rate_b, t, edges, cutoffs[0])
    slow = low_pass(speed[:, None], t, edges, cutoffs[1])
    speed_rate = derivative(slow, t, edges)[:, 0]
    return np.asarray(force - acceleration(slow[:, 0], speed_rate, rate, derivative(rate, t, edges), lever_b))


def low_pass(values: Array, t: Array, edges: Ints, cutoff: float) -> Array:
    r"""Low-pass (n, k) without delay: second-order Butterworth, forwards and backwards, -3 dB at ``cutoff`` Hz in all.

    Two passes double the attenuation, so each is designed for :math:`f_c'=\frac{f_s}\pi\arctan(\tan(\pi
    f_c/f_s)/(\sqrt2-1)^{1/4})`.

    Parameters
    ----------
    t : (n,) s
    edges : first sample of each piece without a gap, and n; pieces are filtered on their own

    Notes
    -----
    A piece sampled slower than four times the cut, or too short to filter, is left as it is.
    """
    from scipy.signal import butter, sosfiltfilt

    out = values.copy()
    for first, last in pairwise(edges.tolist()):
        if last - first < 2:
            continue
        rate = 1.0 / float(np.median(np.diff(t[first:last])))
        if rate < LEAST_OVERSAMPLING * cutoff:
            continue
        cut = rate / np.pi * np.arctan(np.tan(np.pi * cutoff / rate) / TWO_PASSES)
        sections = butter(2, cut, fs=rate, output="sos")
        if last - first > 3 * (2 * len(sections) + 1):  # the default padding of sosfiltfilt
            out[first:last] = sosfiltfilt(sections, values[first:last], axis=0)
    return out


def derivative(values: Array, t: Array, edges: Ints) -> Array:
    """Return the derivative of values (n, k) by central differences, piece by piece; 0 where a piece has one sample."""
    out = np.zeros_like(values)
    for first, last in pairwise(edges.tolist()):
        if last - first >= 2:
            out[first:last] = np.gradient(values[first:last], t[first:last], axis=0)
    return out


def levelled(force_b: Array, rpy: Array) -> Array:
    """Return the horizontal specific force (n, 2), m/s^2, in axes that roll, pitch, yaw ``rpy`` (n, 3) count from."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(rpy.T), np.cos(rpy.T)
    x, y, z = force_b.T
    ahead, left = cp * x + sp * (sr * y + cr * z), cr * y - sr * z
    return np.stack([cy * ahead - sy * left, sy * ahead + cy * left], axis=1)


def motion_density(force_n: Array, t: Array, spans: Array) -> float:
    r"""Return the noise density of the accelerometer in motion, m/s^2/sqrt(Hz).

    .. math:: S^2=\tau\,\tfrac16\,\overline{(m_{j+2}-2m_{j+1}+m_j)^2}

    of means :math:`m_j` over blocks of ``tau`` (Hadamard variance: a steady drift of the gyro does not count), the
    largest over blocks of 2 to 16 s: what a filter that averages for seconds must believe of one sample, whatever the
    spectrum. In levelled axes, for there a wrong vertical stands still, and an acceleration averages out over a turn.
    Where the motions are too short, their mean square counts as noise that lasts for half a second.

    Parameters
    ----------
    force_n : (n, 2) horizontal specific force by the gyro's attitude
    spans : (s, 2) in s: motions over which that attitude is not levelled anew
    """
    found = []
    for tau in BLOCKS_S:
        total = np.concatenate([np.empty((0, 2)), *(_second_differences(force_n, t, a, b, tau) for a, b in spans)])
        if total.size >= LEAST_DIFFERENCES:
            found.append(tau / 6.0 * float(np.mean(total**2)))
    if not found:
        return float(np.sqrt(2.0 * BLOCKS_S[0] * np.mean(force_n**2)))
    return float(np.sqrt(max(found[SLOW_BLOCKS:] or found)))


def sample_variance(force_n: Array) -> float:
    """Return the variance of one sample of ``force_n`` (n, 2) about its neighbours; robust, so that shocks stand out.

    Vibration makes it larger than what ``motion_density`` leaves to a sample, for vibration averages out.
    """
    change = np.abs(np.diff(force_n, axis=0))
    return float(np.median(change) / MEDIAN_OF_NORMAL) ** 2 / 2.0 if change.size else 0.0


def _second_differences(values: Array, t: Array, start: float, end: float, tau: float) -> Array:
    """Return second differences (j, k) of the means over whole blocks of one span."""
    cuts = np.searchsorted(t, start + tau * np.arange(int((end - start) / tau) + 1))
    if len(cuts) < 4 or np.any(np.diff(cuts) < 1):
        return np.empty((0, values.shape[1]))
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    means = np.diff(total[cuts], axis=0) / np.diff(cuts)[:, None]
    return np.diff(means, n=2, axis=0)
