"""Forward filters: nodes and a start in, one ``FilterRun`` out. Dotted names: a filter is imported when it is used."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from ..nodes import Nodes
    from ..records import FilterRun
    from .alignment import Start

FILTERS = {
    "indirect": "attest_cli.filters.indirect",
}
AUTO = "indirect"
"""What ``auto`` stands for."""


class Filter(Protocol):
    """A forward pass over the nodes."""

    def __call__(self, nodes: Nodes, start: Start, gate_probability: float) -> FilterRun:
        """Run from ``start``; measurements pass a chi-square gate of ``gate_probability`` (1: no gate)."""
        ...


def named(name: str) -> str:
    """Return the filter that ``name`` stands for."""
    return AUTO if name == "auto" else name


def load(name: str) -> Filter:
    """Return the filter of this name."""
    found: Filter = import_module(FILTERS[named(name)]).run
    return found
