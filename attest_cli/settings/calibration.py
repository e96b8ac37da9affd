"""The calibration file (``calibration.toml``): what ``attest calibrate-bias`` writes and ``attest smooth`` reads.

SI units; axes x, y, z are those of the IMU as the log has them, before any mounting. The schema is generated from here.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from ..errors import AttestError
from .load import read_toml

AXES = ("x", "y", "z")
TELLING_WALK = 4e-5  # rad/s^2/sqrt(Hz), twice a consumer MEMS gyro's: a bound beyond it tells less than the make does
MOSTLY = 0.9
ModelName = Literal["constant", "ramp", "exponential", "temperature", "random-walk"]

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Interval = tuple[NotNegative, NotNegative]
Limits = tuple[NotNegative, Annotated[float, Field(ge=0)]]  # the upper one may be infinite: the record says nothing
Triple = tuple[Finite, Finite, Finite]
Matrix = tuple[Triple, Triple, Triple]


class Part(BaseModel):
    """A part of the file: frozen, nothing unnamed."""

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)


class SourceFile(Part):
    """A log that was calibrated from."""

    name: str
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


class Source(Part):
    """Where the numbers come from."""

    attest_version: str
    files: tuple[SourceFile, ...]
    channel: str = Field(description="of the IMU")
    t0_ns: int = Field(description="epoch of the log, from which the time of the bias models counts")
    duration_s: NotNegative = Field(description="first to last sample")
    at_rest_s: NotNegative = Field(description="of it at rest and used")
    rate_hz: Positive
    static: bool = Field(description="the whole record stands still")
    notes: tuple[str, ...] = ()

    @property
    def rests(self) -> bool:
        """Whether it rests for nearly all of its duration: several static logs lie apart."""
        return self.static and self.at_rest_s >= MOSTLY * self.duration_s


class Noise(Part):
    """Noise of one axis; intervals hold 95 %."""

    noise_density: Positive = Field(description="N: unit of the sensor / sqrt(Hz), maximum likelihood")
    noise_density_95: Interval
    random_walk: Positive | None = Field(None, description="K: unit / s / sqrt(Hz), maximum likelihood; none: not seen")
    random_walk_95: Limits
    instability_read_off: Positive | None = Field(
        None, description="B: unit; read off the smallest Allan deviation, not fitted: no interval"
    )
    instability_tau_s: Positive | None = Field(None, description="averaging time of that smallest deviation")
    notes: tuple[str, ...] = ()


class Bias(Part):
    """The fitted bias of one axis over time since ``source.t0_ns``, rad/s."""

    model: ModelName
    names: tuple[str, ...] = Field(description="of the values")
    values: tuple[Finite, ...] = Field(
        description="rad/s, s, K; t s since t0_ns, x deg C above 25: constant C; ramp C + slope t; exponential "
        "C1 (1 - exp(-t/T)) + C2; temperature c0 + c1 x + c2 x^2; random-walk: the bias at the end, and its K"
    )
    covariance: tuple[tuple[Finite, ...], ...]
    sigma: NotNegative = Field(description="of the fitted bias at the end of the record, rad/s")
    walk_beside: NotNegative = Field(
        description="K of the random walk beside the model, mean of its restricted likelihood, rad/s^2/sqrt(Hz)"
    )
    walk_alone: NotNegative = Field(description="the same of a random walk in its place, where its time does not apply")
    temperature_c: tuple[Finite, Finite] | None = Field(None, description="range seen, where the model needs it")
    residual_sigma: NotNegative = Field(description="rms of what the fit leaves of the mean rates, rad/s")
    residual_every_s: Positive = Field(description="length of such a mean")
    white: bool = Field(description="the residual passes both tests")
    inside_band: Annotated[float, Field(ge=0, le=1)] = Field(description="share of lags inside 95 % of white noise")
    ljung_box_probability: Annotated[float, Field(ge=0, le=1)]
    notes: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _of_one_size(self) -> Self:
        size = len(self.names)
        if len(self.values) != size or [len(row) for row in self.covariance] != [size] * size:
            raise ValueError(f"{size} names need {size} values and a covariance of {size} rows and columns")
        return self


class GyroAxis(Part):
    """One gyro axis: rad/s."""

    noise: Noise
    bias: Bias

    @property
    def knows_walk(self) -> bool:
        """Whether K was seen, or bounded so low that not seeing it tells something; else the record is too short."""
        return self.noise.random_walk is not None or self.noise.random_walk_95[1] <= TELLING_WALK

    def walk(self, *, explained: bool) -> float:
        """K to filter with, rad/s^2/sqrt(Hz): beside the model, or in its place where the model explains nothing."""
        return self.bias.walk_beside if explained else max(self.bias.walk_beside, self.bias.walk_alone)


class Gyro(Part):
    """The three gyro axes."""

    x: GyroAxis
    y: GyroAxis
    z: GyroAxis


class Accelerometer(Part):
    """``corrected = matrix (raw + bias)``, m/s^2."""

    x: Noise
    y: Noise
    z: Noise
    matrix: Matrix | None = Field(None, description="scale and misalignment; none: too few attitudes")
    bias: Triple | None = Field(None, description="m/s^2; none: too few attitudes")
    residual: NotNegative | None = Field(None, description="rms misfit of the norm to gravity after it, m/s^2")
    tilt_sigma: NotNegative | None = Field(None, description="what the fit leaves of the tilt, rad")
    attitudes: Annotated[int, Field(ge=0)] = 0
    notes: tuple[str, ...] = ()

    @field_validator("matrix")
    @classmethod
    def _regular(cls, matrix: Matrix | None) -> Matrix | None:
        return _near_identity(matrix)

    @model_validator(mode="after")
    def _both(self) -> Self:
        if (self.matrix is None) != (self.bias is None):
            raise ValueError("matrix and bias belong together: give both or none")
        return self


class Magnetometer(Part):
    """``corrected = matrix (raw - offset)``, tesla."""

    matrix: Matrix = Field(description="soft iron, symmetric")
    offset: Triple = Field(description="hard iron, tesla")
    field: Positive = Field(description="tesla")
    residual: NotNegative = Field(description="rms misfit of the norm, share of the field")
    coverage: Annotated[float, Field(ge=0, le=1)] = Field(description="share of the sphere seen")

    @field_validator("matrix")
    @classmethod
    def _regular(cls, matrix: Matrix) -> Matrix:
        _near_identity(matrix)
        return matrix


class CalibrationFile(Part):
    """What ``attest calibrate-bias`` found out about an IMU."""

    source: Source
    gyro: Gyro
    accelerometer: Accelerometer | None = None
    magnetometer: Magnetometer | None = None

    @property
    def axes(self) -> tuple[GyroAxis, GyroAxis, GyroAxis]:
        """The gyro axes in order."""
        return self.gyro.x, self.gyro.y, self.gyro.z


def _near_identity(matrix: Matrix | None) -> Matrix | None:
    """Refuse a correction that no sensor needs: a typo in it would turn every attitude."""
    if matrix is not None and any(
        abs(value - (i == j)) > 0.5 for i, row in enumerate(matrix) for j, value in enumerate(row)
    ):
        raise ValueError("should be within 0.5 of the identity: it corrects scale and misalignment")
    return matrix


def read_calibration(path: Path) -> CalibrationFile:
    """Read a calibration file.

    Raises
    ------
    AttestError
        If it is missing, not TOML, or not of this shape: one line with the file and the first key at fault.
    """
    try:
        return CalibrationFile.model_validate(read_toml(path))
    except ValidationError as fault:
        faults = fault.errors()
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        where = ".".join(map(str, faults[0]["loc"])) or "the file"
        said = faults[0]["msg"].removeprefix("Value error, ")
        message = f"{path}: not a calibration: {where}: {said[:1].lower()}{said[1:]}{more}"
        raise AttestError(message, "attest calibrate-bias LOG writes one") from None


def rms(values: Iterable[float]) -> float:
    """Root of the mean square: the density of a sensor whose axes differ."""
    squares = [value * value for value in values]
    return math.sqrt(sum(squares) / len(squares))


def document(part: Part) -> dict[str, Any]:
    """The content of a file as plain tables, without what is not known."""
    return part.model_dump(mode="python", exclude_none=True)
