"""The nouns of an evaluation: tracks of poses, what a result claims of itself, and what was found. SI and radians."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from ..records import Array, Bools, Ints, Warn

Align = Literal["auto", "none", "yaw", "full"]


@dataclass(frozen=True, slots=True)
class Claims:
    """The uncertainty that a track states, at ``stamps_ns`` (m,) of its own: ``attitude`` (m, 3, 3) rad^2 and
    ``position`` (m, 3, 3) m^2 about world axes, ``heading_relative`` (m,) rad^2; NaN where it states none.

    ``full``: with correlations; else only the variances are known.
    """

    stamps_ns: Ints
    attitude: Array
    position: Array
    heading_relative: Array
    full: bool


@dataclass(frozen=True, slots=True)
class Poses:
    """A track to judge, or to judge by: increasing ``stamps_ns`` (n,), ``q`` (n, 4), ``position`` (n, 3) m, ENU and
    FLU; NaN where not known.

    ``moving`` (n,) or None; ``heading``: absolute, magnetic, relative, or empty where not stated; ``shared_world``: it
    stands in the world of attest (east, north, up from where the log starts), not on a datum of its own.
    """

    source: str
    kind: str  # track, table, tum, euroc, mcap
    stamps_ns: Ints
    q: Array
    position: Array
    moving: Bools | None = None
    heading: str = ""
    shared_world: bool = False
    claims: Claims | None = None
    channel: str = ""
    warnings: tuple[Warn, ...] = ()


@dataclass(frozen=True, slots=True)
class Options:
    """How to evaluate. ``time_offset``: seconds added to the stamps of the result, or ``auto`` for the fitted ones;
    ``delta``: span of the relative position error in ``delta_unit``, s or m of the reference's path.
    """

    align: Align = "auto"
    align_body: bool = False
    time_offset: float | Literal["auto"] = 0.0
    moving_only: bool = False
    delta: float = 10.0
    delta_unit: Literal["s", "m"] = "s"


@dataclass(frozen=True, slots=True)
class Association:
    """How the samples of both tracks were brought together: at the stamps of the ``base`` (the sparser one), ``used``
    of them; the others before or after the other track (``outside``), in its ``gaps``, ``still`` with ``moving_only``.
    """

    base: str  # result, reference
    used: int
    outside: int
    gaps: int
    still: int = 0


@dataclass(frozen=True, slots=True)
class Offset:
    """Seconds to add to the stamps of the result so that they fit the reference, 1 sigma; ``source``: attitude or
    position, whose rates were compared over ``span_s``.
    """

    seconds: float
    sigma: float
    source: str
    span_s: float


@dataclass(frozen=True, slots=True)
class Frames:
    """Constant rotations that brought the reference to the result: ``q_world q_ref q_body``, ``R_world p_ref + shift``.

    Rotations of positions are fitted to positions, those of attitudes to attitudes.
    """

    mode: str  # none, yaw, full
    body: bool
    q_world: Array
    q_body: Array
    q_position: Array | None = None
    shift: Array | None = None


@dataclass(frozen=True, slots=True)
class Stats:
    """Root mean square, median, 95 % quantile and largest of the absolute values of ``count`` errors."""

    rms: float
    median: float
    p95: float
    max: float
    count: int


@dataclass(frozen=True, slots=True)
class Nees:
    """Mean normalised squared error, expected ``dof``; ``inside``: share in the 95 % region."""

    mean: float
    dof: int
    inside: float
    count: int


@dataclass(frozen=True, slots=True)
class Coverage:
    """Share of errors inside 1, 2, 3 sigma and the 95 % band, and ``found`` at the ``CLAIMED`` levels; mean square of
    error over sigma, and as how many ``independent`` errors these count.
    """

    sigma: tuple[float, float, float]
    band: float
    found: Array
    mean_square: float
    independent: float


@dataclass(frozen=True, slots=True)
class Series:
    """Errors over time, for drawing: ``t`` (k,) s since the result's first sample, ``error`` (k, 3) about or along
    world axes, ``sigma`` (k, 3) or None; ``breaks`` (k,) where no line runs on.
    """

    t: Array
    error: Array
    sigma: Array | None
    breaks: Bools


@dataclass(frozen=True, slots=True)
class Judgement:
    """Errors of one kind (attitude or position): ``stats``, ``nees`` and ``coverage`` by name, and the ``series``."""

    stats: Mapping[str, Stats]
    nees: Mapping[str, Nees]
    coverage: Mapping[str, Coverage]
    series: Series
    association: Association


@dataclass(frozen=True, slots=True)
class Evaluation:
    """What was found. ``offset``: fitted, ``applied``: s added to the result's stamps; ``heading_offset``: mean heading
    error, rad; ``scatter``: noise of the reference from sample to sample, rad; ``moving_from``: who told motion;
    ``verdict``: PASS, WARN where errors are larger than their sigma allows, None without a sigma.
    """

    options: Options
    frames: Frames
    offset: Offset | None
    applied: float
    attitude: Judgement | None
    position: Judgement | None
    heading_offset: float | None
    scatter: float | None
    full_covariance: bool
    moving_from: str
    verdict: str | None
    warnings: tuple[Warn, ...] = ()

    @property
    def band_share(self) -> float | None:
        """Share of the errors about (along) all three axes inside their 95 % bands; None without a sigma."""
        judged = self.attitude or self.position
        shares = [judged.coverage[axis].band for axis in "xyz" if axis in judged.coverage] if judged else []
        return sum(shares) / len(shares) if shares else None
