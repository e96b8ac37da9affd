"""The columns of the result folder: track (per IMU sample), passes (per node), innovations (per measurement)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .assess import Pass
from .maths import rotation
from .position import Position, around, row_blocks
from .records import Array, Innovations, Log, Segmentation, Smoothed
from .track import world_variance

Columns = dict[str, NDArray[Any]]
IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
ENU_TO_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FLU_TO_FRD = np.diag([1.0, -1.0, -1.0])


def vector(name: str, values: NDArray[np.floating]) -> Columns:
    """Return three columns; ``name`` holds ``{}`` where the axis goes."""
    return {name.format(axis): np.ascontiguousarray(values[:, i]) for i, axis in enumerate("xyz")}


def between(knots: Array, table: NDArray[np.float32], t: Array) -> NDArray[np.float32]:
    """Interpolate the rows of a table (k, m), linear between ascending knots (m,), at ascending times (n,); (k, n)."""
    left = np.searchsorted(knots[1:-1], t, side="right")
    share = np.clip((t - knots[left]) / np.diff(knots)[left], 0.0, 1.0).astype(np.float32)
    out: NDArray[np.float32] = np.diff(table).take(left, axis=1)
    out *= share
    out += table.take(left, axis=1)
    return out


def segment_of(t: Array, segmentation: Segmentation) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Return the segment number and whether it is a motion at ascending times ``t`` (n,)."""
    starts = np.array([s.start for s in segmentation.segments[1:]])
    rows = np.diff(np.searchsorted(t, starts - 1e-9), prepend=0, append=len(t))
    index = np.array([s.index for s in segmentation.segments], dtype=np.int32)
    moving = np.array([s.motion for s in segmentation.segments])
    return np.repeat(index, rows), np.repeat(moving, rows)


@dataclass(frozen=True, slots=True)
class Track:
    """The track at full rate, made block by block: iterate over it (again and again) for blocks of columns.

    ``q`` (n, 4) attitude of the IMU at its samples; ``smoothed`` the nodes; ``q_bv`` (4,) body axes to the IMU's;
    known to ``axes_sigma`` (3,) rad; ``frame`` ``ned`` turns the world to NED and the body to FRD. Sigmas are
    interpolated linearly in variance: between nodes they are smooth. Sigmas, bias and velocity have seven digits, which
    is more than is known of them.
    """

    log: Log
    q: Array
    smoothed: Smoothed
    position: Position | None
    segmentation: Segmentation
    q_bv: Array
    axes_sigma: Array
    frame: str

    def __iter__(self) -> Iterator[Columns]:
        """Give the columns of some ten thousand samples at a time, in the order of the schema."""
        body, world = self.q_bv, IDENTITY
        if self.frame == "ned":
            body, world = rotation.multiply(body, rotation.from_matrix(FLU_TO_FRD)), rotation.from_matrix(ENU_TO_NED)
        nodes = self._node_columns(rotation.matrix(body), rotation.matrix(world))
        names, table = tuple(nodes), np.stack([values.astype(np.float32) for values in nodes.values()])
        last_q, last_yaw = IDENTITY, 0.0
        course = iter(()) if self.position is None else self.position.course()
        for rows in row_blocks(len(self.q)):
            lo = rows.start
            q = rotation.continuous(rotation.multiply(rotation.multiply(world, self.q[rows]), body))
            q *= 1.0 if lo == 0 or float(q[0] @ last_q) >= 0.0 else -1.0
            angles = rotation.roll_pitch_yaw(q)
            angles[:, 2] = rotation.unwrapped(angles[:, 2])
            angles[:, 2] += 2 * np.pi * np.round((last_yaw - angles[0, 2]) / (2 * np.pi)) if lo else 0.0
            last_q, last_yaw = q[-1], float(angles[-1, 2])
            place = (x @ rotation.matrix(world).T for x in next(course, np.full((2, len(q), 3), np.nan)))
            near = around(self.smoothed.t, self.log.imu.t[rows])
            at = between(self.smoothed.t[near], table[:, near], self.log.imu.t[rows])
            yield self._columns(rows, q, angles, dict(zip(names, at, strict=True)), *place)

    def _node_columns(self, R_body: Array, R_world: Array) -> Columns:
        """Return what is interpolated, at the nodes: bias and variances, in the track's axes."""
        s = self.smoothed
        R_nv = rotation.matrix(rotation.multiply(s.q, self.q_bv))
        P_axes = (R_nv * self.axes_sigma**2) @ R_nv.swapaxes(1, 2)
        P_world = R_world @ (world_variance(s.q, s.P) + P_axes) @ R_world.T
        P_bias = R_body.T @ s.P[:, 3:, 3:] @ R_body
        out: Columns = vector("sigma_att_{}_deg", np.einsum("kii->ki", P_world) * np.degrees(1.0) ** 2)
        out |= vector("gyro_bias_{}_rad_s", s.bias @ R_body) | vector(
            "sigma_gyro_bias_{}_rad_s", np.einsum("kii->ki", P_bias)
        )
        if self.position is not None:
            P = R_world @ self.position.P @ R_world.T
            out |= vector("sigma_position_{}_m", np.einsum("kii->ki", P))
        if s.heading_relative is not None:
            out["sigma_heading_relative_deg"] = s.heading_relative * np.degrees(1.0) ** 2
        return out

    def _columns(self, rows: slice, q: Array, angles: Array, at: Columns, p: Array, v: Array) -> Columns:
        t = self.log.imu.t[rows]
        segment, moving = segment_of(t, self.segmentation)
        columns: Columns = {"timestamp_ns": self.log.stamps_ns[rows], "t_s": t}
        columns |= {f"q_{name}": np.ascontiguousarray(q[:, i]) for i, name in enumerate("wxyz")}
        columns |= {f"{name}_deg": np.degrees(angles[:, i]) for i, name in enumerate(("roll", "pitch", "yaw"))}
        columns |= _sigmas("sigma_att_{}_deg", at)
        columns |= {f"gyro_bias_{a}_rad_s": at[f"gyro_bias_{a}_rad_s"] for a in "xyz"}
        columns |= _sigmas("sigma_gyro_bias_{}_rad_s", at)
        columns |= vector("position_{}_m", p) | _sigmas("sigma_position_{}_m", at, p)
        columns |= vector("velocity_{}_m_s", v.astype(np.float32))
        columns |= {"segment": segment, "moving": moving}
        if "sigma_heading_relative_deg" in at:
            columns["sigma_heading_relative_deg"] = np.sqrt(at["sigma_heading_relative_deg"])
        return columns


def _sigmas(name: str, variances: Columns, known: Array | None = None) -> Columns:
    """Return three columns of sigmas, NaN where ``known`` (n, 3) is."""
    out: Columns = {}
    for i, axis in enumerate("xyz"):
        column = name.format(axis)
        out[column] = np.sqrt(variances[column]) if column in variances else np.asarray(np.nan, dtype=np.float32)
        if known is not None:
            out[column] = np.where(np.isnan(known[:, i]), np.float32(np.nan), out[column])
    return out


def pass_columns(
    log: Log, t: Array, passes: Mapping[str, Pass], separation: tuple[Array, Array], position: Position | None,
    segmentation: Segmentation, relative: bool,
) -> Columns:  # fmt: skip
    """Return the columns of ``passes``: the three passes at the nodes with their covariances, separation, position.

    ``separation``: forward minus backward (n, 3) and its sigma, rad, world axes; ``relative``: heading counts from the
    start; the backward pass has none of its own.
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
    yaw = rotation.unwrapped(smooth_angles[:, 2])
    rows, cols = np.triu_indices(6)
    for name, p in passes.items():
        angles = rotation.roll_pitch_yaw(p.q)
        angles[:, 2] = yaw + rotation.wrap(angles[:, 2] - yaw)
        columns |= {f"{name}_q_{part}": np.ascontiguousarray(p.q[:, i]) for i, part in enumerate("wxyz")}
        columns |= {f"{name}_{part}_deg": np.degrees(angles[:, i]) for i, part in enumerate(("roll", "pitch", "yaw"))}
        columns |= vector(f"{name}_sigma_att_{{}}_deg", np.degrees(p.sigma_n))
        columns |= vector(f"{name}_gyro_bias_{{}}_rad_s", p.bias)
        columns |= vector(f"{name}_sigma_gyro_bias_{{}}_rad_s", np.sqrt(np.einsum("kii->ki", p.P)[:, 3:]))
        columns[f"{name}_covariance"] = np.ascontiguousarray(p.P[:, rows, cols])
    sigma = np.degrees(np.sqrt(np.einsum("kii->ki", euler_covariance(passes["smoothed"]))))
    columns |= {f"smoothed_sigma_{part}_deg": sigma[:, i] for i, part in enumerate(("roll", "pitch", "yaw"))}
    apart, predicted = separation
    columns |= vector("separation_{}_deg", np.degrees(apart)) | vector("sigma_separation_{}_deg", np.degrees(predicted))
    if relative:
        for name in ("backward_yaw_deg", "backward_sigma_att_z_deg", "separation_z_deg", "sigma_separation_z_deg"):
            columns[name] = np.full(len(t), np.nan)
    return columns | _position_at_nodes(t, position)


def _position_at_nodes(t: Array, position: Position | None) -> Columns:
    nothing = np.full((len(t), 3), np.nan)
    p, v, P = nothing, nothing, np.full((len(t), 3, 3), np.nan)
    if position is not None:
        p, v, P = position.p, position.v, position.P
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
    segment = segment_of(t, segmentation)[0][found.node][order]
    columns: Columns = {"sensor": found.role[order], "t_s": found.t[order], "segment": segment}
    columns |= {"dof": found.dof[order].astype(np.int32), "nis": found.nis[order], "used": found.used[order]}
    return columns | {f"z{i}": np.ascontiguousarray(found.z[order, i]) for i in range(3)}
