"""The shape of ``evaluation.json``, and how an evaluation is told in it: degrees and metres, null = not known."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from .. import __version__
from ..evaluate.association import period
from ..evaluate.consistency import CLAIMED
from ..evaluate.records import Coverage, Evaluation, Judgement, Nees, Poses, Stats
from ..maths import rotation
from ..records import Array
from .model import Number, PageEntry, Part, Warned

Quaternion = tuple[float, float, float, float]
Vector = tuple[float, float, float]


class Tracked(Part):
    """One of the two tracks."""

    name: str
    path: str
    sha256: str
    kind: Literal["track", "table", "tum", "euroc", "mcap"]
    channel: str = Field("", description="of an MCAP file")
    rows: int
    rate_hz: Number
    heading: str = Field("", description="absolute, magnetic, relative; empty where not stated")


class Compared(Part):
    """How many samples were compared, at the stamps of which track, and how many were left out."""

    at: Literal["result", "reference"] = Field(description="the sparser track; the other one is interpolated")
    used: int
    outside: int = Field(description="before or after the other track")
    in_gaps: int = Field(description="in a gap of the other track")
    still: int = Field(description="left out by --moving-only")


class TimeOffset(Part):
    """Seconds to add to the stamps of the result."""

    fitted_s: Number = Field(description="from the rates of both tracks; null where they do not match")
    sigma_s: Number
    fitted_to: Literal["attitude", "position"] | None
    applied_s: float


class Alignment(Part):
    """Constant rotations that brought the reference to the result: q_world q_ref q_body (w, x, y, z)."""

    mode: Literal["none", "yaw", "full"]
    body: bool
    q_world: Quaternion
    q_body: Quaternion
    yaw_deg: float = Field(description="about the vertical, of q_world")
    q_position: Quaternion | None = Field(description="fitted to the positions")
    shift_m: Vector | None


class Errors(Part):
    """Of the absolute values."""

    rms: Number
    median: Number
    p95: Number
    max: Number
    count: int


class Consistency(Part):
    """Mean normalised squared error, its expected value, and the share in the 95 % region."""

    mean: Number
    expected: int
    inside_95: Number
    count: int


class Inside(Part):
    """Share of errors inside their bands on one axis; expected 0.683, 0.954, 0.997, 0.95."""

    sigma_1: float
    sigma_2: float
    sigma_3: float
    band_95: float
    mean_square: float = Field(description="of error over sigma; expected 1")
    independent: float = Field(description="as how many independent errors they count")
    found: list[float] = Field(description="share inside the bands of the levels in claimed")


class Judged(Part):
    """Errors of attitude (deg) or position (m) by name."""

    errors: dict[str, Errors]
    nees: dict[str, Consistency]
    coverage: dict[str, Inside]
    compared: Compared


class EvaluationReport(Part):
    """``evaluation.json``: a result against a reference. Attitude in degrees, position in metres, world axes."""

    attest_version: str
    created_utc: str
    verdict: Literal["PASS", "WARN"] | None = Field(
        description="WARN where the errors are larger than the sigmas allow; null without sigmas"
    )
    result: Tracked
    reference: Tracked
    moving_only: bool
    moving_from: str = Field(description="which track tells motion: reference, result, or empty")
    time_offset: TimeOffset
    alignment: Alignment
    attitude: Judged | None = Field(
        description="total, inclination, heading, heading_relative (its mean taken out), x, y, z"
    )
    heading_offset_deg: Number = Field(description="mean heading error")
    position: Judged | None = Field(description="absolute, horizontal, vertical, relative (over delta), x, y, z")
    delta: float
    delta_unit: Literal["s", "m"]
    covariance: Literal["full", "diagonal"] | None = Field(description="what NEES is made of")
    reference_scatter_deg: Number = Field(description="noise of the reference from sample to sample, per axis")
    claimed: list[float] = Field(description="levels of the coverage curves")
    warnings: list[Warned] = Field(default_factory=list)
    page: PageEntry | None = None


def told(found: Evaluation, facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``evaluation.json``, checked.

    ``facts``: ``created_utc``, ``result`` and ``reference`` (see ``Tracked``), ``page``.
    """
    offset, options = found.offset, found.options
    judged = found.attitude or found.position
    claimed = judged is not None and bool(judged.nees)
    content = {
        **facts, "attest_version": __version__, "verdict": found.verdict, "moving_only": options.moving_only,
        "moving_from": found.moving_from,
        "time_offset": {
            "fitted_s": None if offset is None else offset.seconds, "sigma_s": None if offset is None else offset.sigma,
            "fitted_to": None if offset is None else offset.source, "applied_s": found.applied,
        },
        "alignment": _alignment(found), "attitude": _judged(found.attitude, float(np.degrees(1.0))),
        "heading_offset_deg": None if found.heading_offset is None else float(np.degrees(found.heading_offset)),
        "position": _judged(found.position, 1.0), "delta": options.delta, "delta_unit": options.delta_unit,
        "covariance": ("full" if found.full_covariance else "diagonal") if claimed else None,
        "reference_scatter_deg": None if found.scatter is None else float(np.degrees(found.scatter)),
        "claimed": CLAIMED.tolist(),
        "warnings": [{"code": w.code, "message": w.message, "hint": w.hint, "lost": w.lost} for w in found.warnings],
    }  # fmt: skip
    return EvaluationReport.model_validate(content).model_dump(mode="json")


def tracked(path: Path, poses: Poses) -> dict[str, Any]:
    """Return what is told of one track (see ``Tracked``)."""
    with path.open("rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    step = period((poses.stamps_ns - poses.stamps_ns[0]).astype(np.float64))
    return {
        "name": path.name, "path": str(path), "sha256": digest, "kind": poses.kind, "channel": poses.channel,
        "rows": len(poses.stamps_ns), "rate_hz": 1e9 / step if np.isfinite(step) else None, "heading": poses.heading,
    }  # fmt: skip


def _alignment(found: Evaluation) -> dict[str, Any]:
    frames = found.frames
    yaw = rotation.roll_pitch_yaw(frames.q_world)[2]
    return {
        "mode": frames.mode, "body": frames.body,
        "q_world": _numbers(frames.q_world), "q_body": _numbers(frames.q_body), "yaw_deg": float(np.degrees(yaw)),
        "q_position": None if frames.q_position is None else _numbers(frames.q_position),
        "shift_m": None if frames.shift is None else _numbers(frames.shift),
    }  # fmt: skip


def _numbers(values: Array) -> tuple[float, ...]:
    return tuple(float(v) for v in values)


def _judged(found: Judgement | None, scale: float) -> dict[str, Any] | None:
    if found is None:
        return None
    a = found.association
    return {
        "errors": {name: _errors(stats, scale) for name, stats in found.stats.items()},
        "nees": {name: _consistency(nees) for name, nees in found.nees.items()},
        "coverage": {name: _inside(coverage) for name, coverage in found.coverage.items()},
        "compared": {"at": a.base, "used": a.used, "outside": a.outside, "in_gaps": a.gaps, "still": a.still},
    }


def _errors(stats: Stats, scale: float) -> dict[str, Any]:
    return {name: value if name == "count" else value * scale for name, value in asdict(stats).items()}


def _consistency(nees: Nees) -> dict[str, Any]:
    return {"mean": nees.mean, "expected": nees.dof, "inside_95": nees.inside, "count": nees.count}


def _inside(coverage: Coverage) -> dict[str, Any]:
    one, two, three = coverage.sigma
    return {
        "sigma_1": one, "sigma_2": two, "sigma_3": three, "band_95": coverage.band, "found": coverage.found.tolist(),
        "mean_square": coverage.mean_square, "independent": coverage.independent,
    }  # fmt: skip
