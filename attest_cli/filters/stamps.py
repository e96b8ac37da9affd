"""What a gyro sample stands for, where the settings leave it open: the magnetometer of the log shows it."""

from __future__ import annotations

import numpy as np

from ..maths import rotation
from ..records import Array, Log, Warn
from ..settings import Settings

STRETCH_S, MOST = 1.0, 30_000  # stretches that are compared: short against drifts; samples at most, the liveliest
FEW, WHOLE = 10, 1.5  # stretches that tell something; times its usual length: a stretch with a hole
SURE = 3.0  # sigmas
ROUNDS, LEAST = 3, 1e-4  # of the weights; of the mean square of what turns the field: what a stretch leaves at least
HALF, NEAR = 0.5, 0.25  # of a sample: what a mean since the stamp before is late by, and how near to that it must be


def read_as(log: Log, settings: Settings) -> tuple[Settings, tuple[Warn, ...]]:
    """Return the settings with gyro samples that are read as the log shows, and say so where that is no usual one.

    A mean over the interval before a stamp is half a sample late. A magnetometer may be late too, but never early: one
    that is ahead of the gyro by half a sample shows it.
    """
    if settings.imu.gyro_samples != "auto":
        return settings, ()
    ahead, sigma = lead(log)
    late = ahead > SURE * sigma and abs(ahead - HALF) < NEAR
    chosen = settings.imu.model_copy(update={"gyro_samples": "interval" if late else "point"})
    message = f"the gyro is {ahead:.2f} samples behind the magnetometer: its samples are taken as means since the stamp"
    told = (Warn("gyro-interval", f"{message} before", "[imu] gyro_samples states what they are"),) * late
    return settings.model_copy(update={"imu": chosen}), told


def lead(log: Log) -> tuple[float, float]:
    r"""Return by how many samples the magnetometer is ahead of a gyro whose samples are read as points, and its sigma.

    The field :math:`m`, turned by the gyro into the axes of a stretch's first sample, stays :math:`F` but for the lead
    :math:`\lambda`, bias :math:`b` and scale and misalignment :math:`M` of the gyro, and hard iron :math:`h`:

    .. math:: R_km_k=F-\lambda\,R_k(\omega_k\times m_k)-\sum_{j\le k}R_j(b+M\omega_j)\Delta t\times R_km_k+R_kh

    by least squares over stretches of a second, each with a field of its own and weighted by what it leaves; sigma from
    how stretches differ (the sandwich of White 1980).
    """
    stretches = _stretches(log) if "magnetometer" in log.fixes else None
    if stretches is None:
        return 0.0, np.inf
    A, y = stretches
    N, b = np.einsum("swia,swib->sab", A, A), np.einsum("swia,swi->sa", A, y)
    x, weight, size = np.zeros(A.shape[-1]), np.ones(len(y)), np.sum(y**2, axis=(1, 2))
    for _ in range(ROUNDS):
        left = size - 2.0 * b @ x + np.einsum("a,sab,b->s", x, N, x)
        weight = 1.0 / np.maximum(left, LEAST * float(np.mean(size)) + 1e-300)
        inverse = np.linalg.pinv(np.einsum("s,sab->ab", weight, N), hermitian=True)
        x = inverse @ (weight @ b)
    scores = (weight[:, None] * (b - N @ x)) @ inverse[:, 0]
    return float(x[0]), float(np.sqrt(np.sum(scores**2))) if inverse[0, 0] > 0.0 else np.inf


def _stretches(log: Log) -> tuple[Array, Array] | None:
    """Return what each of the sixteen unknowns changes (s, w, 3, 16), and the field (s, w, 3), shares of its size; in
    the axes of each stretch's first sample, less their means. None where there are too few.
    """
    imu, fixes = log.imu, log.fixes["magnetometer"]
    known = np.isfinite(fixes.values).all(axis=1)
    if len(imu.t) < 2 or np.count_nonzero(known) < FEW:
        return None
    when, values = fixes.t[known], fixes.values[known]
    values = values / max(float(np.median(np.linalg.norm(values, axis=1))), 1e-300)
    period = float(np.median(np.diff(imu.t)))
    width = max(2, round(STRETCH_S / period))
    count = len(imu.t) // width
    t, rate = imu.t[: count * width].reshape(count, width), imu.gyro_b[: count * width].reshape(count, width, 3)
    heard = t[:, -1] - t[:, 0] < WHOLE * STRETCH_S
    if imu.gyro_added is not None:  # clipped, or a guess
        heard &= ~np.any(imu.gyro_added[: count * width].reshape(count, width) > 0.0, axis=1)
    whole = np.flatnonzero(heard)
    liveliest = np.argsort(-np.sum(np.var(rate[whole], axis=1), axis=1))
    use = np.sort(whole[liveliest[: max(FEW, MOST // width)]])
    if len(use) < FEW:
        return None
    t, rate = t[use], rate[use]
    after = np.clip(np.searchsorted(when, t), 1, len(when) - 1)
    seen = np.minimum(np.abs(t - when[after - 1]), np.abs(when[after] - t)) <= 0.5 * period
    field_b = np.stack([np.interp(t, when, values[:, k]) for k in range(3)], axis=-1)
    A, field_0 = _changes(t, rate, field_b, period)
    share = (seen / np.maximum(seen.sum(axis=1, keepdims=True), 1))[:, :, None]
    y = (field_0 - np.sum(share * field_0, axis=1, keepdims=True)) * seen[:, :, None]
    A = (A - np.sum(share[..., None] * A, axis=1, keepdims=True)) * seen[:, :, None, None]
    return A, y


def _changes(t: Array, rate: Array, field_b: Array, period: float) -> tuple[Array, Array]:
    """Return what one sample of lead, bias (rad/s), scale and misalignment of the gyro and hard iron (of the field)
    change (s, w, 3, 16), and the field, in the axes of each stretch's first sample.
    """
    dt = np.diff(t, axis=1)[:, :, None]
    turns = rotation.exp_quaternion(0.5 * (rate[:, 1:] + rate[:, :-1]) * dt)
    q = np.zeros((*t.shape, 4))
    q[:, 0, 0] = 1.0
    for k in range(1, t.shape[1]):
        q[:, k] = rotation.multiply(q[:, k - 1], turns[:, k - 1])
    R = rotation.matrix(q)
    field_0 = np.einsum("swij,swj->swi", R, field_b)
    by_bias = np.zeros_like(R)
    by_bias[:, 1:] = np.cumsum(0.5 * (R[:, 1:] + R[:, :-1]) * dt[..., None], axis=1)
    per = np.einsum("swij,swk->swijk", R, rate).reshape(*t.shape, 3, 9)
    by_scale = np.zeros_like(per)
    by_scale[:, 1:] = np.cumsum(0.5 * (per[:, 1:] + per[:, :-1]) * dt[..., None], axis=1)
    turned = -np.cross(np.concatenate([by_bias, by_scale], axis=3), field_0[..., None], axis=2)
    ahead = -period * np.einsum("swij,swj->swi", R, np.cross(rate, field_b))
    return np.concatenate([ahead[..., None], turned, R], axis=3), field_0


__all__ = ["lead", "read_as"]
