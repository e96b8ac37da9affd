"""A result as the pages see it: time, segments and columns, tolerant of everything that may be missing."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..records import Array, Bools, Result
from . import reduce
from .words import clean, date, duration

MANY_MOTIONS = 40
SHORT_S = 300.0
HOUR_CLOCK_S = 4 * 3600.0
AXES = ("x", "y", "z")


def real(value: object) -> float:
    """A number, or nan for blank, None and words."""
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return math.nan


@dataclass(frozen=True, slots=True)
class Part:
    """One segment: its number, its times, and the row of ``segments.csv``."""

    index: int
    motion: bool
    start: float
    end: float
    row: Mapping[str, Any]

    def value(self, name: str) -> float:
        """A column of the row, nan where blank."""
        return real(self.row.get(name))

    @property
    def length(self) -> float:
        """Duration in seconds."""
        return self.end - self.start


class Drive:
    """Read-only view of a ``Result``.

    Parameters
    ----------
    result : Result
        What the result folder holds.
    """

    def __init__(self, result: Result) -> None:
        self.result = result
        self.report = result.report
        self.t = np.asarray(result.passes["t_s"], dtype=np.float64)
        self.parts = tuple(
            Part(int(real(row["index"])), str(row["kind"]) == "motion", real(row["start_s"]), real(row["end_s"]), row)
            for row in result.segments
        )
        self.stops = tuple(p for p in self.parts if not p.motion)
        self.motions = tuple(p for p in self.parts if p.motion)
        gaps = np.asarray(self.report.get("gaps") or [], dtype=np.float64)
        self.gaps: Array = gaps.reshape(-1, 2)

    @cached_property
    def limits(self) -> tuple[float, float]:
        """First and last time of the log in seconds; never empty."""
        ends = [*(p.start for p in self.parts), *(p.end for p in self.parts), *self.t[:1], *self.t[-1:]]
        known = [v for v in ends if math.isfinite(v)] or [0.0]
        low, high = min(known), max(known)
        return (low, high) if high > low else (low - 0.5, low + 0.5)

    @cached_property
    def breaks(self) -> Bools:
        """Where no line may run on."""
        return reduce.break_after(self.t, self.gaps)

    @cached_property
    def moving(self) -> Bools:
        """Per node: in a motion segment."""
        found = self.result.passes.get("moving")
        return np.zeros(self.t.size, dtype=np.bool_) if found is None else np.asarray(found, dtype=np.bool_)

    def column(self, name: str) -> Array:
        """A column of the passes; all nan where it is missing."""
        found = self.result.passes.get(name)
        return np.full(self.t.size, np.nan) if found is None else np.asarray(found, dtype=np.float64)

    def tilt_sigma(self, which: str, rows: slice = slice(None)) -> Array:
        """Sigma of the tilt in degrees: root of the sum over the two level axes."""
        return np.hypot(*(self.column(f"{which}_sigma_att_{axis}_deg")[rows] for axis in "xy"))

    def angle(self, which: str, name: str) -> Array:
        """Roll, pitch or yaw of one pass in degrees; the yaw without jumps."""
        found = self.column(f"{which}_{name}_deg")
        return reduce.unwrap_deg(found) if name == "yaw" else found

    def difference(self, which: str, name: str) -> Array:
        """One pass minus the smoothed angle, in (-180, 180] degrees."""
        return reduce.wrap_deg(self.column(f"{which}_{name}_deg") - self.column(f"smoothed_{name}_deg"))

    def stat(self, name: str) -> float:
        """A number of ``report.json`` statistics; nan where there is none."""
        return real((self.report.get("statistics") or {}).get(name))

    def setting(self, name: str) -> Any:
        """Effective value of a setting; None where it is not stated."""
        return ((self.report.get("settings") or {}).get(name) or {}).get("value")

    def during(self, start: float, end: float) -> slice:
        """Nodes in a span of time."""
        return slice(int(np.searchsorted(self.t, start)), int(np.searchsorted(self.t, end, side="right")))

    @cached_property
    def after_start(self) -> Bools:
        """Nodes past the stop in which the forward pass converges: from the first motion on; none without motion."""
        first = self.motions[0].start if self.motions else math.inf
        return np.asarray(self.t >= first) if self.stops else np.ones(self.t.size, dtype=np.bool_)

    @cached_property
    def before_end(self) -> Bools:
        """The same for the backward pass, from the end: up to the end of the last motion."""
        last = self.motions[-1].end if self.motions else -math.inf
        return np.asarray(self.t <= last) if self.stops else np.ones(self.t.size, dtype=np.bool_)

    def settled(self, which: str) -> Bools:
        """Nodes outside the transient of a pass."""
        if which == "smoothed":
            return np.ones(self.t.size, dtype=np.bool_)
        return self.after_start if which == "forward" else self.before_end

    @property
    def failed(self) -> bool:
        """True where a check failed: no sigma of this result may be called known."""
        return self.report.get("verdict") == "FAIL"

    @property
    def heading(self) -> str:
        """``absolute``, ``magnetic`` or ``relative``."""
        return str(self.report.get("heading") or "relative")

    @property
    def relative(self) -> bool:
        """True where nothing in the log tells north."""
        return self.heading == "relative"

    @property
    def method(self) -> tuple[str, str]:
        """Filter and smoother by name; empty where the report does not say."""
        methods = self.report.get("methods") or {}
        return clean(methods.get("filter") or "", 30), clean(methods.get("smoother") or "", 30)

    @property
    def not_estimated(self) -> tuple[str, ...]:
        """States that the filter leaves to dead reckoning."""
        return tuple(clean(name, 30) for name in (self.report.get("methods") or {}).get("not_estimated") or [])

    @property
    def tilts(self) -> bool:
        """False where the filter takes the vehicle as level: nothing to tell of roll and pitch."""
        return not {"roll", "pitch"} <= set(self.not_estimated)

    @property
    def duration_s(self) -> float:
        """Length of the log in seconds."""
        stated = real((self.report.get("input") or {}).get("duration_s"))
        return stated if math.isfinite(stated) else float(self.t[-1] - self.t[0]) if self.t.size else 0.0

    @property
    def long(self) -> bool:
        """More motions than can be told apart on a time axis of 5.9 in at 12 px each."""
        if not self.motions:
            return False
        low, high = self.limits
        median = float(np.median([p.length for p in self.motions]))
        return len(self.motions) > MANY_MOTIONS or median / (high - low) * 5.9 * 160.0 < 12.0

    def wide_stops(self, width: float) -> tuple[Part, ...]:
        """Stops to shade on a time axis of ``width`` inches: all, or in a long log those of 0.12 in and more."""
        low, high = self.limits
        least = 0.12 / width * (high - low) if self.long else 0.0
        return tuple(p for p in self.stops if p.length >= least)

    @property
    def short(self) -> bool:
        """A log short enough to name each segment in words."""
        return self.duration_s <= SHORT_S and len(self.parts) <= 7

    @property
    def two_passes(self) -> bool:
        """True where a backward pass knows something."""
        return bool(np.isfinite(self.column("backward_roll_deg")).any())

    @cached_property
    def directions(self) -> tuple[str, str, str]:
        """What the world axes x, y, z are called."""
        return (*(("level", "level") if self.relative else ("east", "north")), "heading")

    @cached_property
    def file_name(self) -> str:
        """Name of the input, safe to draw; the first and how many more."""
        files = (self.report.get("input") or {}).get("files") or []
        first = clean(files[0].get("name", "")) if files else ""
        return f"{first} + {len(files) - 1} more" if len(files) > 1 else first

    @cached_property
    def start_date(self) -> str:
        """Absolute start of the log."""
        return date((self.report.get("input") or {}).get("start_utc"))

    @property
    def span(self) -> str:
        """``21 min 24 s``."""
        return duration(self.duration_s)
