"""Forward filters: a drive in, one forward pass out. Dotted names: a filter is imported when it is used."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Protocol

from ..nodes.noise import Noise
from ..records import FilterRun, Log, Segmentation, Shown, Warn, World
from ..settings import Settings
from ..wheels import Judged

if TYPE_CHECKING:
    from ..nodes import Nodes
    from .alignment import Start

FILTERS = {
    "indirect": "attest_cli.filters.indirect:forward",
    "navigation": "attest_cli.filters.navigation:forward",
    "tilt-ekf": "attest_cli.filters.tilt_ekf:forward",
    "pseudo-linear": "attest_cli.filters.quasi_linear:pseudo_linear",
    "projected": "attest_cli.filters.quasi_linear:projected",
    "geometric": "attest_cli.filters.quasi_linear:geometric",
    "heading": "attest_cli.filters.heading:forward",
}
"""Name -> module and function."""


@dataclass(frozen=True, slots=True)
class Drive:
    """What every filter is given: the log in body axes, its segments, the world and the noise of the IMU."""

    log: Log
    segmentation: Segmentation
    world: World
    noise: Noise
    settings: Settings


@dataclass(frozen=True, slots=True)
class Forward:
    """A forward pass, the noise it settled on, and what the user should know.

    A filter over preintegrated nodes adds them and its start, from which the whole log can be solved again
    (Gauss-Newton) and full rate be made; one that updates at every sample has none: its nodes are the samples. What the
    drive has ``shown`` of its sensors stands in the report; which ``odometry`` it believed, for the position.
    """

    run: FilterRun
    noise: Noise
    nodes: Nodes | None = None
    start: Start | None = None
    warnings: tuple[Warn, ...] = ()
    shown: tuple[Shown, ...] = ()
    odometry: Judged | None = None


class Filter(Protocol):
    """A forward pass over a drive."""

    def __call__(self, drive: Drive) -> Forward:
        """Run over the whole log; raise ``AttestError`` where the log lacks what the filter needs."""
        ...


def load(name: str) -> Filter:
    """Return the filter of this name."""
    module, _, function = FILTERS[name].partition(":")
    found: Filter = getattr(import_module(module), function)
    return found
