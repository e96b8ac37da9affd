"""The pages of a result: one file each, ``draw(result, theme) -> Page | None``, imported on use."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..records import Result
    from .page import Page

FIGURES = {
    "overview": "attest_cli.figures.overview",
    "separation": "attest_cli.figures.separation",
    "gyro-bias": "attest_cli.figures.gyro_bias",
    "sigma": "attest_cli.figures.sigma",
    "innovations": "attest_cli.figures.innovations",
    "plan": "attest_cli.figures.plan",
    "stops": "attest_cli.figures.stops",
}
"""Page -> module, in the order of their numbers."""


def pages(result: Result, theme: str = "light") -> Iterator[tuple[str, Page]]:
    """File name and page of everything that a result has data for, in order.

    Parameters
    ----------
    result : Result
        What the result folder holds.
    theme : str
        ``light`` or ``dark``.
    """
    for number, (name, module) in enumerate(FIGURES.items(), 1):
        room = import_module(module)
        if name == "innovations":  # one page per sensor
            for sensor in room.sensors(result):
                page = room.draw(result, theme, sensor)
                if page is not None:
                    yield f"{number:02d}-{name}-{_safe(sensor)}.png", page
            continue
        page = room.draw(result, theme)
        if page is not None:
            yield f"{number:02d}-{name}.png", page


def _safe(sensor: str) -> str:
    """A sensor's name in a file name: a result folder may come from anywhere."""
    return re.sub(r"[^a-z0-9]+", "-", sensor.lower()).strip("-")[:30] or "sensor"
