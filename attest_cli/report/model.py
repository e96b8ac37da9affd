"""The shape of ``report.json`` and of a row of ``track``: the schemas in ``schemas/`` are generated from here."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, create_model

Verdict = Literal["PASS", "WARN", "FAIL"]


def _known(value: object) -> object:
    """Null for a number that is none: JSON knows no NaN."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


Number = Annotated[float | None, BeforeValidator(_known)]


class Part(BaseModel):
    """A part of the report: frozen, nothing unnamed."""

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)


class File(Part):
    """One input file."""

    name: str
    path: str
    bytes: int
    sha256: str
    format: str


class Input(Part):
    """What was read."""

    files: list[File]
    start_utc: str | None = Field(description="ISO 8601; null where the log's clock has no epoch")
    duration_s: float
    samples: int
    rate_hz: Number
    sensors: list[str] = Field(description="plain names of what was used")


class ChannelLine(Part):
    """One channel of the log and what it was used as."""

    name: str
    kind: str
    role: str = Field(description="empty: not used")
    rows: int
    rate_hz: Number = None
    unit_note: str = ""


class Coverage(Part):
    """How much of the input stands in the output."""

    rows_in: int
    rows_used: int
    rows_dropped: int
    seconds_in: float
    seconds_used: float
    share: float = Field(ge=0, le=1)


class Setting(Part):
    """The effective value of one setting, and where it came from."""

    value: Any
    source: str


class Methods(Part):
    """What was run."""

    filter: str
    smoother: str
    iterations: int | str
    position: str
    not_estimated: list[str] = Field(default_factory=list, description="states that this filter does not estimate")


class Shown(Part):
    """A sensor error, lag, lever arm or noise that was found in the drive."""

    name: str
    values: list[Number]
    sigma: list[Number] = Field(description="1 sigma of each value; empty: found otherwise")
    unit: str


class BodyAxes(Part):
    """Axes of the track."""

    axes: str
    q_body_sensor: tuple[float, float, float, float] = Field(description="w, x, y, z")
    how: str


class Innovations(Part):
    """Counts and mean normalised innovation squared of one sensor."""

    count: int
    used: int
    rejected: int
    mean_nis: Number
    dof: int


class Detector(Part):
    """The stop detector's thresholds, in units of sensor noise."""

    enter: Number
    leave: Number
    margin: Number
    source: str


class Statistics(Part):
    """Numbers of the whole drive; sigmas are one standard deviation; null = not known."""

    sigma_heading_median_deg: Number = None
    sigma_heading_max_deg: Number = None
    sigma_tilt_median_deg: Number = None
    sigma_tilt_max_deg: Number = None
    forward_sigma_heading_max_deg: Number = None
    position_sigma_median_m: Number = None
    position_sigma_max_m: Number = None
    distance_m: Number = None
    motions: int
    stops: int
    separation_checks: int = 0
    separation_inside_2sigma: int = 0
    innovations: dict[str, Innovations] = Field(default_factory=dict)
    forward_over_threshold_share: Number = None
    longest_smoothed_drive_s: Number = None
    gyro_bias_drift_deg_s: Number = None
    position_usable: bool = False
    gap_count: int = 0
    jitter_ms: Number = None
    detector: Detector | None = None


class Advice(Part):
    """When the rover should have stopped."""

    threshold_deg: float
    axis: str
    lines: list[str]


class Warned(Part):
    """Something the user should know; ``lost``: data was lost; ``fatal``: sigma does not hold."""

    code: str
    message: str
    hint: str = ""
    lost: bool = False
    fatal: bool = False


class Check(Part):
    """One line of "What to know"."""

    name: str
    status: Verdict
    fact: str
    detail: str = ""


class PageEntry(Part):
    """One picture under ``report/``."""

    file: str
    title: str
    alt: str


class Report(Part):
    """``report.json``: what was done, with which settings, and how good the result is."""

    attest_version: str
    created_utc: str
    verdict: Verdict
    input: Input
    channels: list[ChannelLine]
    coverage: Coverage
    settings: dict[str, Setting]
    methods: Methods
    heading: Literal["absolute", "magnetic", "relative"]
    body: BodyAxes
    statistics: Statistics
    advice: Advice | None = None
    warnings: list[Warned] = Field(default_factory=list)
    checks: list[Check] = Field(default_factory=list)
    gaps: list[tuple[float, float]] = Field(default_factory=list, description="holes in the IMU: start and end, s")
    pages: list[PageEntry] = Field(default_factory=list)
    shown: list[Shown] = Field(default_factory=list, description="what the drive shows of its sensors")
    history: list[Any] = Field(default_factory=list)


def _columns() -> dict[str, Any]:
    """Name -> type and description of every column of the track, in file order."""
    columns: dict[str, Any] = {
        "timestamp_ns": (int, Field(description="ns, epoch of the log (int64)")),
        "t_s": (float, Field(description="s since the first sample")),
    }
    for part in "wxyz":
        columns[f"q_{part}"] = (float, Field(ge=-1, le=1, description="Hamilton quaternion, body -> world"))
    for name in ("roll", "pitch", "yaw"):
        columns[f"{name}_deg"] = (float, Field(description="deg, about the fixed axes x, y, z (REP-103)"))
    vectors = (
        ("sigma_att_{}_deg", float, "deg, 1 sigma about the world's {} axis"),
        ("gyro_bias_{}_rad_s", float, "rad/s, body {} axis"),
        ("sigma_gyro_bias_{}_rad_s", float, "rad/s, 1 sigma, body {} axis"),
        ("position_{}_m", float | None, "m from the start, world {} axis"),
        ("sigma_position_{}_m", float | None, "m, 1 sigma, world {} axis"),
        ("velocity_{}_m_s", float | None, "m/s, world {} axis"),
    )
    for name, kind, text in vectors:
        for axis in "xyz":
            columns[name.format(axis)] = (kind, Field(description=text.format(axis)))
    columns["segment"] = (int, Field(ge=1, description="stops odd, motions even (int32)"))
    columns["moving"] = (bool, Field(description="false at a stop"))
    relative = "deg, 1 sigma of heading with its mean over the motion taken out, where its datum is the larger error"
    columns["sigma_heading_relative_deg"] = (float | None, Field(default=None, description=relative))
    return columns


TrackRow: type[BaseModel] = create_model(
    "TrackRow", __base__=Part, __doc__="One row of ``track``: one IMU sample, smoothed.", **_columns()
)
