"""What a setting may be: numbers with units, vectors, lists; and the base of every table of settings."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, core_schema

from .units import convert


@dataclass(frozen=True)
class Unit:
    """The unit a number is kept in; strings with a unit of the same kind are converted (``"0.3 deg/sqrt(hr)"``)."""

    name: str

    def _parse(self, value: object) -> object:
        if isinstance(value, bool):
            raise ValueError(f"should be a number in {self.name}")  # noqa: TRY004 (pydantic collects ValueError only)
        return convert(value, self.name) if isinstance(value, str) else value

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Read a string with a unit before pydantic checks the number."""
        return core_schema.no_info_before_validator_function(self._parse, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """A number, or a string with a unit."""
        text = {
            "type": "string",
            "pattern": r"^\s*[+-]?[0-9.]",
            "description": f"with a unit, converted to {self.name}",
        }
        return {"anyOf": [handler(schema), text], "x-unit": self.name}


finite = Field(allow_inf_nan=False)
positive = Field(gt=0, allow_inf_nan=False)
not_negative = Field(ge=0, allow_inf_nan=False)

Seconds = Annotated[float, not_negative, Unit("s")]
PositiveSeconds = Annotated[float, positive, Unit("s")]
Degrees = Annotated[float, positive, Unit("deg")]
Angle = Annotated[float, not_negative, Unit("deg")]
Metres = Annotated[float, positive, Unit("m")]
Altitude = Annotated[float, Field(ge=-20_000, le=100_000), Unit("m")]
Latitude = Annotated[float, Field(ge=-90, le=90), Unit("deg")]
Longitude = Annotated[float, Field(ge=-180, le=360), Unit("deg")]
Speed = Annotated[float, positive, Unit("m/s")]
Acceleration = Annotated[float, positive, Unit("m/s^2")]
Rate = Annotated[float, positive, Unit("rad/s")]
GyroDensity = Annotated[float, positive, Unit("rad/s/sqrt(Hz)")]
GyroWalk = Annotated[float, positive, Unit("rad/s^2/sqrt(Hz)")]
AccelDensity = Annotated[float, positive, Unit("m/s^2/sqrt(Hz)")]
AccelWalk = Annotated[float, positive, Unit("m/s^3/sqrt(Hz)")]
Ratio = Annotated[float, not_negative, Unit("1")]
Frequency = Annotated[float, positive, Unit("Hz")]
AngleDensity = Annotated[float, positive, Unit("deg/sqrt(s)")]
JerkDensity = Annotated[float, positive, Unit("deg/s^3.5")]

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


def numbers(value: object, count: int, what: str) -> tuple[float, ...]:
    """Check for exactly ``count`` finite numbers."""
    if not isinstance(value, list | tuple) or len(value) != count:
        raise ValueError(f"should be {count} numbers: {what}")
    if not all(isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v) for v in value):
        raise ValueError(f"should be {count} finite numbers: {what}")
    return tuple(float(v) for v in value)


def as_direction(value: object) -> object:
    """Scale a direction to unit length."""
    if value is None:
        return None
    vector = numbers(value, 3, "east, north, up")
    norm = math.hypot(*vector)
    if norm == 0.0:
        raise ValueError("should not be zero: it is a direction")
    return tuple(v / norm for v in vector)


def as_lever(value: object) -> object:
    """Check a lever arm."""
    if value == "auto":
        return value
    return numbers(value, 3, "x, y, z in metres")


def as_field(value: object) -> object:
    """Check a magnetic field, if there is one."""
    return None if value is None else numbers(value, 3, "east, north, up, in microtesla")


def as_quaternion(value: object) -> object:
    """Check for a unit quaternion to 1 % and scale it to unit length."""
    if value == "auto":
        return value
    q = numbers(value, 4, "w, x, y, z")
    norm = math.hypot(*q)
    if abs(norm - 1.0) > 0.01:
        raise ValueError(f"should be a unit quaternion w, x, y, z; its norm is {norm:.4g}")
    return tuple(v / norm for v in q)


MOST_PASSES = 50


def as_passes(value: object) -> object:
    """``auto`` or a count; digits as text are a count too."""
    if isinstance(value, str) and value.strip().isdigit():
        value = int(value)
    if value == "auto" or (isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= MOST_PASSES):
        return value
    raise ValueError(f"should be auto or a count of 1 to {MOST_PASSES}")


def as_formats(value: object) -> object:
    """A list, or names between commas."""
    names = [n.strip() for n in value.split(",")] if isinstance(value, str) else value
    if isinstance(names, list | tuple):
        if not names:
            raise ValueError("should name at least one format")
        return tuple(dict.fromkeys(names))
    return names


LeverArm = Annotated[Vector | Literal["auto"], BeforeValidator(as_lever)]


class Section(BaseModel):
    """One table of ``attest.toml``: frozen, and it knows its keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)
