"""The magnetometer of the navigation smoother: its states, the field at the nodes, where to begin, how noisy it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...maths import rotation
from ...maths.consistency import MAD
from ...nodes import Nodes
from ...nodes.field import field_doubts
from ...nodes.observations import at_stop
from ...records import Array
from .. import Drive
from .aids import Magnetometer
from .model import Trajectory
from .states import Layout, State

FIELD_S = 5.0  # a disturbed field stays so
OFFSET_SHARE, OFFSET_SHARE_NO_REST, IRON_SHARE = 0.1, 0.02, 0.007  # of the field
LEVEL_SHARE = 0.5  # of the field that is level: iron turns heading by its share of that
REST_FLOOR, PLACE_SHARE, MOTION_FLOOR = 0.003, 0.01, 0.01  # of the field


def field_states(drive: Drive, field: Magnetometer, *, at_rest: bool) -> list[State]:
    """Return the states of a magnetometer."""
    norm = float(np.median(np.linalg.norm(field.field_b, axis=1)))
    offset = OFFSET_SHARE if at_rest else OFFSET_SHARE_NO_REST
    turned, _ = field_doubts(drive.log.fixes["magnetometer"], drive.log, drive.segmentation, drive.world)
    return [
        State("hard iron", 3, max(IRON_SHARE, LEVEL_SHARE * turned) * norm), State("earth field", 2, 0.3 * norm),
        State("motion offset", 3, offset * norm),
    ]  # fmt: skip


def field_at_nodes(drive: Drive, nodes: Nodes, q: Array, bias: Array) -> Magnetometer:
    """Return the field at the nodes: samples turned by the gyro into their nearest node, those of a stop into one."""
    fixes, imu = drive.log.fixes["magnetometer"], drive.log.imu
    known = np.isfinite(fixes.values).all(axis=1) & (fixes.t >= imu.t[0]) & (fixes.t <= imu.t[-1])
    t, steps = fixes.t[known], nodes.steps
    middle = np.where((nodes.frozen | nodes.gap)[:, None], 0.0, 0.5 * (bias[1:] + bias[:-1]))
    grid, q_grid = nodes.on_grid(q, bias)
    i = np.clip(np.searchsorted(grid, t, side="right") - 1, 0, len(grid) - 2)
    owner = np.repeat(np.arange(len(middle)), steps.count)[i]
    turn = rotation.exp_quaternion((steps.rate0[i] - middle[owner]) * (t - grid[i])[:, None])
    field_n = rotation.rotate(rotation.multiply(q_grid[i], turn), fixes.values[known])
    node = np.clip(np.searchsorted(nodes.t, t), 1, len(nodes.t) - 1)
    node = np.where(t - nodes.t[node - 1] < nodes.t[node] - t, node - 1, node)
    inside = at_stop(t, drive.segmentation)
    first = np.searchsorted(nodes.t, [s.used_start - 1e-6 for s in drive.segmentation.stops])
    number = np.searchsorted([s.used_start for s in drive.segmentation.stops], t, side="right") - 1
    node[inside] = first[number[inside]] if len(first) else node[inside]
    use = inside | nodes.moving[node]
    n = len(nodes.t)
    count = np.bincount(node[use], minlength=n)
    total = np.stack([np.bincount(node[use], field_n[use, k], n) for k in range(3)], axis=1)
    at = np.flatnonzero(count)
    field_b = rotation.rotate(rotation.conjugate(q[at]), total[at] / count[at][:, None])
    world = drive.world.field_n
    azimuth = 0.5 * np.pi if world is None else float(np.arctan2(world[1], world[0]))
    return Magnetometer(at, nodes.t[at], field_b, nodes.moving[at], azimuth, np.ones(len(at)), np.ones(len(at)))


def start_field(field: Magnetometer, form: Layout, at: Trajectory) -> None:
    """Begin with the earth field that the rests show (the whole log where there is none)."""
    seen = rotation.rotate(at.q[field.node], field.field_b)
    typical = np.median(seen[~field.moving] if (~field.moving).any() else seen, axis=0)
    at.x[:, form.parts["earth field"]] = [np.hypot(typical[0], typical[1]), typical[2]]


def tuned_field(field: Magnetometer, form: Layout, at: Trajectory, t: Array) -> Magnetometer:
    r"""Return the magnetometer with the noise that its own residuals show: in motion :math:`\sigma_m\sqrt{2\tau/T}`, at
    rest the scatter and the error of the place.
    """
    r = field.rows(form, at).r
    norm = float(np.median(np.linalg.norm(field.field_b, axis=1)))
    sigma, shared, moving = np.empty(len(r)), np.ones(len(r)), field.moving
    if moving.any():
        scatter = max(MAD * float(np.median(np.abs(r[moving]))), MOTION_FLOOR * norm)
        shared[moving] = np.sqrt(np.maximum(1.0, 2.0 * FIELD_S / np.gradient(t)[field.node[moving]]))
        sigma[moving] = scatter * shared[moving]
    if not moving.all():
        scatter = max(MAD * float(np.median(np.abs(r[~moving]))), REST_FLOOR * norm)
        sigma[~moving] = np.hypot(scatter, PLACE_SHARE * norm)
    return replace(field, sigma=sigma, shared=shared)
