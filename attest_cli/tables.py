"""The columns of the result folder: track (per IMU sample), passes (per node), innovations (per measurement)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from .assess import Pass, separation
from .maths import rotation
from .position import Position
from .records import Array, Innovations, Log, Segmentation
from .track import Attitude, world_variance

Columns = dict[str, NDArray[np.generic]]
ENU_TO_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FLU_TO_FRD = np.diag([1.0, -1.0, -1.0])


def vector(name: str, values: NDArray[np.floating]) -> Columns:
    """Return three columns; ``name`` holds ``{}`` where the axis goes."""
    return {name.format(axis): np.ascontiguousarray(values[:, i]) for i, axis in enumerate("xyz")}


def segment_of(t: Array, segmentation: Segmentation) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Return the segment number and whether it is a motion at times ``t`` (n,)."""
    starts = np.array([s.start for s in segmentation.segments])
    owner = np.clip(np.searchsorted(starts, t + 1e-9, side="right") - 1, 0, None)
    index = np.array([s.index for s in segmentation.segments], dtype=np.int32)
    moving = np.array([s.motion for s in segmentation.segments])
    return index[owner], moving[owner]


def unwrapped_yaw(yaw: Array) -> Array:
    """Return yaw, rad, without jumps, its first value in (-pi, pi]."""
    return np.asarray(np.unwrap(yaw))


def track_columns(
    log: Log, attitude: Attitude, nodes_t: Array, position: Position | None, segmentation: Segmentation, frame: str,
    relative_variance: Array | None,
) -> Columns:  # fmt: skip
    """Return the columns of ``track``; ``frame`` ``ned`` turns the world to NED and the body to FRD.

    ``relative_variance`` (nodes,): variance of heading since the start, where heading has a datum of its own.
    """
    t, n = log.imu.t, len(log.imu.t)
    nothing = np.full((n, 3), np.nan)
    p, v, sigma_p = nothing, nothing, nothing
    if position is not None:
        variance = np.einsum("kii->ki", position.P)
        p, v = position.p, position.v
        sigma_p = np.sqrt(np.stack([np.interp(t, nodes_t, variance[:, i]) for i in range(3)], axis=1))
        sigma_p[np.isnan(p)] = np.nan
    q, sigma, bias = attitude.q, np.sqrt(attitude.variance_n), attitude.bias
    if frame == "ned":
        world, body = rotation.from_matrix(ENU_TO_NED), rotation.from_matrix(FLU_TO_FRD)
        q = rotation.continuous(rotation.multiply(rotation.multiply(world, q), body))
        p, v, bias = p @ ENU_TO_NED.T, v @ ENU_TO_NED.T, bias @ FLU_TO_FRD
        sigma, sigma_p = sigma[:, [1, 0, 2]], sigma_p[:, [1, 0, 2]]
    angles = rotation.roll_pitch_yaw(q)
    angles[:, 2] = unwrapped_yaw(angles[:, 2])
    segment, moving = segment_of(t, segmentation)
    columns: Columns = {"timestamp_ns": log.stamps_ns, "t_s": t}
    columns |= {f"q_{name}": np.ascontiguousarray(q[:, i]) for i, name in enumerate("wxyz")}
    columns |= {f"{name}_deg": np.degrees(angles[:, i]) for i, name in enumerate(("roll", "pitch", "yaw"))}
    sigma_b = np.sqrt(attitude.bias_variance)
    columns |= vector("sigma_att_{}_deg", _short(np.degrees(sigma)))
    columns |= vector("gyro_bias_{}_rad_s", bias) | vector("sigma_gyro_bias_{}_rad_s", _short(sigma_b))
    columns |= (
        vector("position_{}_m", p) | vector("sigma_position_{}_m", _short(sigma_p)) | vector("velocity_{}_m_s", v)
    )
    columns |= {"segment": segment, "moving": moving}
    if relative_variance is not None:
        columns["sigma_heading_relative_deg"] = np.degrees(np.sqrt(np.interp(t, nodes_t, relative_variance)))
    return columns


def _short(sigma: Array) -> NDArray[np.float32]:
    """Seven digits are plenty for a sigma, and half the file."""
    return sigma.astype(np.float32)


def pass_columns(
    log: Log, t: Array, passes: Mapping[str, Pass], position: Position | None, segmentation: Segmentation,
    relative: bool,
) -> Columns:  # fmt: skip
    """Return the columns of ``passes``: the three passes at the nodes with their covariances, separation, position.

    ``relative``: heading counts from the start; the backward pass has none of its own.
    """
    segment, moving = segment_of(t, segmentation)
    columns: Columns = {
        "timestamp_ns": log.t0_ns + np.round(t * 1e9).astype(np.int64),
        "t_s": t,
        "segment": segment,
        "moving": moving,
        "stop_statistic": np.interp(t, log.imu.t, segmentation.statistic),
    }
    smooth_angles = rotation.roll_pitch_yaw(passes["smoothed"].q)
    yaw = unwrapped_yaw(smooth_angles[:, 2])
    rows, cols = np.triu_indices(6)
    for name, p in passes.items():
        angles = rotation.roll_pitch_yaw(p.q)
        angles[:, 2] = yaw + rotation.wrap(angles[:, 2] - yaw)
        columns |= {f"{name}_q_{part}": np.ascontiguousarray(p.q[:, i]) for i, part in enumerate("wxyz")}
        columns |= {f"{name}_{part}_deg": np.degrees(angles[:, i]) for i, part in enumerate(("roll", "pitch", "yaw"))}
        columns |= vector(f"{name}_sigma_att_{{}}_deg", np.degrees(p.sigma_n()))
        columns |= vector(f"{name}_gyro_bias_{{}}_rad_s", p.bias)
        columns |= vector(f"{name}_sigma_gyro_bias_{{}}_rad_s", np.sqrt(np.einsum("kii->ki", p.P)[:, 3:]))
        columns[f"{name}_covariance"] = np.ascontiguousarray(p.P[:, rows, cols])
    sigma = np.degrees(np.sqrt(np.einsum("kii->ki", euler_covariance(passes["smoothed"]))))
    columns |= {f"smoothed_sigma_{part}_deg": sigma[:, i] for i, part in enumerate(("roll", "pitch", "yaw"))}
    apart, predicted = separation(passes["forward"], passes["backward"])
    columns |= vector("separation_{}_deg", np.degrees(apart)) | vector("sigma_separation_{}_deg", np.degrees(predicted))
    if relative:
        for name in ("backward_yaw_deg", "backward_sigma_att_z_deg", "separation_z_deg", "sigma_separation_z_deg"):
            columns[name] = np.full(len(t), np.nan)
    return columns | _position_at_nodes(log, t, position)


def _position_at_nodes(log: Log, t: Array, position: Position | None) -> Columns:
    nothing = np.full((len(t), 3), np.nan)
    p, v, P = nothing, nothing, np.full((len(t), 3, 3), np.nan)
    if position is not None:
        p, v = (
            np.stack([np.interp(t, log.imu.t, x[:, i]) for i in range(3)], axis=1) for x in (position.p, position.v)
        )
        P = position.P
    columns = vector("position_{}_m", p) | vector("sigma_position_{}_m", np.sqrt(np.einsum("kii->ki", P)))
    return columns | {"position_cov_xy_m2": P[:, 0, 1].copy()} | vector("velocity_{}_m_s", v)


def euler_covariance(p: Pass) -> Array:
    r"""Return the covariance (n, 3, 3) of roll, pitch, yaw, rad^2: :math:`\delta_n=[R_z R_y e_x,\ R_z e_y,\
    e_z]\,\delta(\phi,\theta,\psi)`.

    At a pitch of 90 deg roll and yaw are one angle; the map is kept regular 0.06 deg before it.
    """
    angles = rotation.roll_pitch_yaw(p.q)
    cy, sy = np.cos(angles[:, 2]), np.sin(angles[:, 2])
    cp, sp = np.maximum(np.cos(angles[:, 1]), 1e-3), np.sin(angles[:, 1])
    zero, one = np.zeros_like(cy), np.ones_like(cy)
    inverse = np.array([[cy / cp, sy / cp, zero], [-sy, cy, zero], [cy * sp / cp, sy * sp / cp, one]])
    J = np.moveaxis(inverse, -1, 0)
    return np.asarray(J @ world_variance(p.q, p.P) @ J.swapaxes(1, 2))


def innovation_columns(found: Innovations, t: Array, segmentation: Segmentation) -> Columns:
    """Return the columns of ``innovations``, in time order."""
    order = np.argsort(found.t, kind="stable")
    segment, _ = segment_of(t[found.node][order], segmentation)
    columns: Columns = {"sensor": found.role[order], "t_s": found.t[order], "segment": segment}
    columns |= {"dof": found.dof[order].astype(np.int32), "nis": found.nis[order], "used": found.used[order]}
    return columns | {f"z{i}": np.ascontiguousarray(found.z[order, i]) for i in range(3)}
