"""The nouns that flow through attest: frozen records, validated once when they are made.

``Recording`` (as found in the file) -> ``Log`` (SI units, body axes, seconds since ``t0_ns``) -> ``Segment`` list
-> ``Nodes`` -> ``FilterRun`` (per node) -> ``Track`` (per IMU sample). ``Result`` is what a result folder holds.
Arrays are time first: vectors ``(n, 3)``, scalars ``(n,)``, covariances ``(n, k, k)``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import AttestError
from .maths.kalman import Chain, Errors
from .maths.propagation import Increments

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

LATEST_NS = 1 << 62
"""No stamp lies beyond (the year 2116): the step between any two is to fit int64."""


@dataclass(frozen=True, slots=True)
class Warn:
    """Something the user should know. ``code`` is stable (kebab-case), ``message`` a fact, ``hint`` the way out."""

    code: str
    message: str
    hint: str = ""
    lost: bool = False  # data was lost (time coverage or a whole channel): exit code 3
    fatal: bool = False  # sigma does not hold: the verdict is FAIL


@dataclass(frozen=True, slots=True)
class Channel:
    """One stream as found in the file.

    Parameters
    ----------
    name : str
        Topic, or the column group's role name for tables.
    kind : str
        Message type such as ``sensor_msgs/msg/Imu``; ``columns`` for tables.
    role : str
        What the reader recognises it as by type and column names (see ``ROLES``); empty = not recognised.
    stamps_ns : (n,) int64
        Stamps as found (header stamp where there is one).
    values : name -> (n,) float64
        Canonical column names (``gyro_x`` ...), values in the unit named in ``units``; NaN = blank.
    units : name -> str
        Unit as stated by the file or fixed by the message type; empty = not stated.
    """

    name: str
    kind: str
    role: str
    stamps_ns: Ints
    values: Mapping[str, Array]
    units: Mapping[str, str] = field(default_factory=dict)
    frame_id: str = ""

    def __post_init__(self) -> None:
        for key, column in self.values.items():
            if column.shape != self.stamps_ns.shape:
                raise AttestError(
                    f"channel {self.name}: column {key} has {column.size} rows, the stamps {self.stamps_ns.size}"
                )


ROLES = (
    "imu",
    "gyro",
    "accel",
    "sun",
    "magnetometer",
    "compass",
    "orientation",
    "odometry",
    "gps",
    "gps_velocity",
    "position",
    "height",
    "temperature",
)
"""Roles a channel can play. ``gyro`` and ``accel`` are halves of an imu on channels of their own."""

COLUMNS: Mapping[str, tuple[str, ...]] = {
    "imu": ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"),
    "gyro": ("gyro_x", "gyro_y", "gyro_z"),
    "accel": ("accel_x", "accel_y", "accel_z"),
    "sun": ("sun_x", "sun_y", "sun_z"),
    "magnetometer": ("mag_x", "mag_y", "mag_z"),
    "compass": ("compass_deg",),
    "orientation": ("q_w", "q_x", "q_y", "q_z"),
    "odometry": ("velocity_x", "velocity_y", "velocity_z"),
    "gps": ("latitude", "longitude", "altitude"),
    "gps_velocity": ("velocity_east", "velocity_north", "velocity_up"),
    "position": ("position_x", "position_y", "position_z"),
    "height": ("baro_height",),
    "temperature": ("temperature_c",),
}
"""Canonical columns of each role, in order (``interface.md``, Roles). Odometry may instead have ``speed`` only, GPS
velocity ``velocity_down``."""


@dataclass(frozen=True, slots=True)
class Recording:
    """What a reader found: every channel of interest, stamps in int64 ns, units as stated."""

    source: Path
    format: str  # csv, parquet, mcap
    channels: tuple[Channel, ...]
    rows: int  # rows or messages read in all
    other: Mapping[str, str] = field(default_factory=dict)  # channels not read: name -> type
    warnings: tuple[Warn, ...] = ()
    notes: tuple[str, ...] = ()  # how the file was understood: dialect, units, which column became what
    missing: Mapping[str, Warn] = field(default_factory=dict)  # columns that settings rename -> which of the warnings


@dataclass(frozen=True, slots=True)
class Imu:
    """IMU samples: ``t`` (n,) s since ``t0_ns`` strictly increasing, ``gyro_b`` (n, 3) rad/s, ``accel_b`` (n, 3)
    m/s^2 specific force. Samples that are clipped, beside a short hole, or of a scattering stamp are noisier by
    ``gyro_added`` (n,) rad/s/sqrt(Hz) and ``accel_added`` (n,) m/s^2/sqrt(Hz), 0 at the others; None where none is.
    """

    t: Array
    gyro_b: Array
    accel_b: Array
    gyro_added: Array | None = None
    accel_added: Array | None = None

    def __post_init__(self) -> None:
        n = self.t.shape[0]
        if self.gyro_b.shape != (n, 3) or self.accel_b.shape != (n, 3):
            raise AttestError(
                f"IMU arrays disagree: t {self.t.shape}, gyro {self.gyro_b.shape}, accel {self.accel_b.shape}"
            )


@dataclass(frozen=True, slots=True)
class Fixes:
    """Measurements of one absolute or aiding sensor, in SI.

    ``values`` (m, d): sun (m, 2|3) sensor-frame direction; magnetometer (m, 3) body, tesla; compass (m, 1) rad
    clockwise from true north; orientation (m, 4) Hamilton wxyz body to navigation; odometry (m, 3) body m/s (NaN =
    not measured); gps (m, 3) rad, rad, m; gps_velocity (m, 3) m/s east, north, up; position (m, 3) m
    navigation; height (m, 1) m up from anywhere; temperature (m, 1) deg C.
    ``sigma`` (m, k) or None: standard deviations the log itself states, in the unit of the residual.
    """

    role: str
    channel: str
    t: Array
    values: Array
    sigma: Array | None = None


@dataclass(frozen=True, slots=True)
class Calibrated:
    """What a calibration file did to a log: ``bias_b`` (k, 3) rad/s at ``t`` (k,) s was taken out of its gyro; its
    ``noise`` densities and the ``sigmas`` of what is left, both by the names of the settings they stand in for;
    ``name`` of the file.
    """

    t: Array
    bias_b: Array
    noise: Mapping[str, float]
    sigmas: Mapping[str, float]
    name: str

    def at(self, t: Array) -> Array:
        """Return the bias (m, 3) that was taken out at times ``t`` (m,)."""
        return np.stack([np.interp(t, self.t, self.bias_b[:, i]) for i in range(3)], axis=1)


@dataclass(frozen=True, slots=True)
class Log:
    """One drive in SI units and body axes, on one time base. ``gaps`` (g, 2): start and end of holes in the IMU, s.

    With ``calibrated`` a bias was taken out of the gyro: what filters find is what is left of it.
    """

    sources: tuple[Path, ...]
    t0_ns: int
    stamps_ns: Ints  # (n,) of the IMU samples, as written to the track
    imu: Imu
    fixes: Mapping[str, Fixes]
    gaps: Array
    coverage: Mapping[str, float]  # rows_in, rows_used, rows_dropped, seconds_in, seconds_used
    warnings: tuple[Warn, ...] = ()
    history: tuple[str, ...] = ()
    calibrated: Calibrated | None = None


@dataclass(frozen=True, slots=True)
class Segment:
    """A stop or a motion. ``index`` counts from 1: stops odd, motions even. Times in s; samples ``[first, last)``.

    ``used_start``/``used_end``: the stop shrunk by half a window (equal to start/end for a motion).
    """

    index: int
    motion: bool
    start: float
    end: float
    first: int
    last: int
    used_start: float
    used_end: float


@dataclass(frozen=True, slots=True)
class Segmentation:
    """Segments in time order, with the detector's statistic, so that it can be drawn and judged.

    ``statistic`` (n,) per IMU sample in units of sensor noise; ``enter``/``leave`` thresholds; ``bias_b`` (3,) blind
    gyro bias; ``margin``: 5 % quantile of the statistic in motion over the enter threshold (nan without motion or
    stop).
    """

    segments: tuple[Segment, ...]
    statistic: NDArray[np.float32]
    enter: float
    leave: float
    bias_b: Array
    margin: float
    source: str  # "imu", "odometry", "file"
    warnings: tuple[Warn, ...] = ()

    @property
    def stops(self) -> tuple[Segment, ...]:
        """The stops, in time order."""
        return tuple(s for s in self.segments if not s.motion)

    @property
    def motions(self) -> tuple[Segment, ...]:
        """The motions, in time order."""
        return tuple(s for s in self.segments if s.motion)


@dataclass(frozen=True, slots=True)
class Result:
    """What a result folder holds and pages are drawn from (columns: ``interface.md`` and ``readers/result.py``)."""

    folder: Path
    report: Mapping[str, Any]  # report.json
    passes: Mapping[str, NDArray[Any]]
    innovations: Mapping[str, NDArray[Any]]
    segments: tuple[Mapping[str, Any], ...]


@dataclass(frozen=True, slots=True)
class World:
    """Reference directions in navigation axes: gravity m/s^2, sun (3,) or (m, 3) per sun fix, magnetic field (3,);
    None = not known.
    """

    gravity: float
    sun_n: Array | None = None
    field_n: Array | None = None
    notes: tuple[str, ...] = ()


BOUNDS = frozenset({"place", "speed"})  # roles of innovations of what is assumed, not measured


@dataclass(frozen=True, slots=True)
class Innovations:
    """One row per measurement: ``role`` (m,) str, ``t``, ``node``, ``dof``, ``nis``, ``used``, ``z`` (m, 3)
    innovation over its predicted sigma (NaN beyond ``dof``).
    """

    role: NDArray[np.str_]
    t: Array
    node: Ints
    dof: Ints
    nis: Array
    used: Bools
    z: Array


@dataclass(frozen=True, slots=True)
class Smoothed:
    """A smoothed pass over n nodes: ``q`` (n, 4), ``bias`` (n, 3), covariance ``P`` (n, 6, 6) about it, lag-one
    covariance ``cross`` (n - 1, 6, 6), how many Gauss-Newton passes were made, and the backward ``information`` (Y,
    y) if it was used. A filter that estimates them too adds velocity and position ``v``, ``p`` (n, 3) and their
    covariance ``P_vp`` (n, 6, 6), navigation axes; ``heading_relative`` (n,) rad^2: of the heading with its mean over
    the motion taken out, where its datum is the larger error.
    """

    t: Array
    q: Array
    bias: Array
    P: Array
    cross: Array
    passes: int = 0
    information: tuple[Array, Array] | None = None
    settled: bool = True  # the last Gauss-Newton pass moved nothing
    moves: float = 0.0  # sigmas by which it still moved a state, where that is known
    v: Array | None = None
    p: Array | None = None
    P_vp: Array | None = None
    heading_relative: Array | None = None


@dataclass(frozen=True, slots=True)
class Shown:
    """What a drive shows of its sensors: ``values`` with their ``sigma`` (none: found otherwise), in ``unit``."""

    name: str
    values: tuple[float, ...]
    sigma: tuple[float, ...]
    unit: str


@dataclass(frozen=True, slots=True)
class FilterRun:
    """A forward pass over n nodes: updated estimate ``q`` (n, 4), ``bias`` (n, 3), its ``chain`` of error covariances
    (see ``maths.kalman``), every innovation; ``heading``: absolute, magnetic or relative; ``start_in_motion``.

    A chain of other states than ``[dtheta_b, dbias]`` comes with ``read``, which turns errors of its states (zero: the
    pass itself) into attitude and bias; ``absent`` names what such a filter does not estimate. ``increments`` are those
    it used, where it runs over preintegrated nodes. ``beforehand``: information (Y (s, s), y (n, s)) about states that
    do not change, known at either end of the log. ``datum`` (n,): variance of heading, rad^2, that is one draw for all
    of the log.
    """

    t: Array
    q: Array
    bias: Array
    chain: Chain
    increments: Increments | None
    innovations: Innovations
    moving: Bools  # (n,) False at the nodes of a stop
    heading: str
    start_in_motion: bool
    read: Callable[[Errors], Smoothed] | None = None
    absent: tuple[str, ...] = ()
    beforehand: tuple[Array, Array] | None = None
    datum: Array | None = None
