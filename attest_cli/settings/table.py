"""Settings of text tables: what their first lines do not tell, or tell wrongly."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from .quantities import Frequency, Section


def _as_names(value: object) -> object:
    """A list, or names between commas."""
    return tuple(name.strip() for name in value.split(",")) if isinstance(value, str) else value


Names = Annotated[tuple[str, ...], BeforeValidator(_as_names)]


class Table(Section):
    """How a text table (CSV) is written; everything else is told from its first lines."""

    columns: Names = Field(
        (), description='names of all columns, in order, such as "t [ms], gyro_x [deg/s], -"; none: from the header'
    )
    names: dict[str, str] = Field({}, description="column in the file -> the name it should have, with its unit")
    rows: dict[str, Names] = Field(
        {}, description='rows of several types: type -> names of its columns; the one named "type" holds the type'
    )
    delimiter: Literal[",", ";", "tab", "space"] | None = Field(
        None, description="between columns; none: from the first lines"
    )
    decimal: Literal[".", ","] | None = Field(None, description="decimal mark; none: from the first lines")
    time_unit: Literal["s", "ms", "us", "ns", "min", "h", "d"] | None = Field(
        None, description="of the time column; none: from its name, else from its steps"
    )
    day_first: bool | None = Field(
        None, description="in dates such as 01/06/2026 the day comes first; none: where a number above 12 tells it"
    )
    sample_rate_hz: Frequency | None = Field(
        None, description="rows per second where a counter, or nothing, stands for time; none: from the preamble"
    )
