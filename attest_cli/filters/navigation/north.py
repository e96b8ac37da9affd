"""How well the reference tells where magnetic north is: by the Earth's field that the log shows without its iron."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...maths import rotation
from ...nodes.field import STEEPEST
from ...records import Array, Smoothed, Warn
from .aids import Magnetometer

DIP_OFF = np.radians(8.0)  # rad: what soft iron makes of a good reference
SURE, UNKNOWN = 4.0, 0.9  # sigmas; rad: a north that is not known at all
SEEN, INDEPENDENT = 1e-3, 10  # of the best seen combination; readings, for their errors last
HINT = "is it of this place, with its signs? sigma of heading counts that"


def north_sigma(field: Magnetometer, R: Array, reference: Array | None) -> tuple[float, list[Warn]]:
    r"""Return the sigma of the direction of north, rad, and say so, where the field contradicts its ``reference`` (3,).

    ``R`` (k, 3, 3) attitude at the measurements. A sensor that turns tells its iron ``h`` from the Earth's field ``F``:

    .. math:: R_km_k=F+R_kh

    by least squares. A reference whose dip is off by :math:`\delta` was taken for another place, or was turned: it
    tells north no better than to :math:`F\sin\delta/H`, with the level part ``H`` of it.
    """
    if reference is None:
        return 0.0, []
    A = np.concatenate([np.broadcast_to(np.eye(3), R.shape), R], axis=2).reshape(-1, 6)
    seen = np.einsum("kij,kj->ki", R, field.field_b).ravel()
    x, left, rank, _ = np.linalg.lstsq(A, seen, rcond=SEEN)
    if rank < 6 or len(left) == 0:
        return 0.0, []
    each = left[0] / min(len(R), INDEPENDENT) * np.linalg.inv(A.T @ A / len(R)).diagonal()[:3]
    F, size = x[:3], float(np.linalg.norm(x[:3]))
    sigma = float(np.sqrt(each.sum() / len(A))) / size
    dip, stated = (float(np.arctan2(-f[2], np.hypot(f[0], f[1]))) for f in (F, reference))
    off, level = abs(dip - stated), max(float(np.cos(stated)), STEEPEST)
    if off < max(DIP_OFF, SURE * sigma):
        return 0.0, []
    message = f"without its iron the magnetic field dips {np.degrees(dip):.0f} deg, the reference"
    message += f" {np.degrees(stated):.0f} deg: it does not tell north"
    return min(float(np.sin(min(off, 0.5 * np.pi))) / level, UNKNOWN), [Warn("field-reference", message, HINT)]


def counted(smoothed: Smoothed, sigma: float) -> Smoothed:
    """Return the estimate with the ``sigma`` of north, rad, by which all of it may be turned about the vertical: no
    measurement has made it smaller, so it is added, and none of it is taken for knowledge.
    """
    if sigma == 0.0:
        return smoothed
    up = np.zeros((len(smoothed.t), 6))
    up[:, :3] = sigma * rotation.matrix(smoothed.q)[:, 2]
    wider = replace(
        smoothed, P=smoothed.P + up[:, :, None] * up[:, None, :],
        cross=smoothed.cross + up[:-1, :, None] * up[1:, None, :],
    )  # fmt: skip
    if smoothed.v is None or smoothed.p is None or smoothed.P_vp is None:
        return wider
    swung = np.zeros((len(smoothed.t), 6))
    for at, values in ((0, smoothed.v), (3, smoothed.p)):
        swung[:, at : at + 2] = sigma * np.stack([-values[:, 1], values[:, 0]], axis=1)
    return replace(wider, P_vp=smoothed.P_vp + swung[:, :, None] * swung[:, None, :])
