"""What the command line offers is what the settings take, and what the registries hold."""

from __future__ import annotations

import inspect
from typing import Any, Literal, get_args, get_origin, get_type_hints

import pytest

from attest_cli import app
from attest_cli.settings import Settings

CHOICES = {
    "filter_": ("smoothing", "filter"),
    "smoother": ("smoothing", "smoother"),
    "absolute": ("smoothing", "absolute"),
    "position": ("smoothing", "position"),
    "body": ("body", "axes"),
    "frame": ("world", "frame"),
    "theme": ("output", "theme"),
    "clock": ("time", "source"),
    "time_unit": ("table", "time_unit"),
}


def literal(annotation: Any) -> tuple[str, ...]:
    """The names of the first Literal inside an annotation."""
    if get_origin(annotation) is Literal:
        return get_args(annotation)
    return next((names for part in get_args(annotation) if (names := literal(part))), ())


def setting(section: str, key: str) -> tuple[str, ...]:
    model = Settings.model_fields[section].annotation
    assert model is not None
    return literal(get_type_hints(model, include_extras=True)[key])


@pytest.mark.parametrize("option", sorted(CHOICES))
def test_an_option_offers_what_its_setting_takes(option: str) -> None:
    hints = get_type_hints(app.smooth, include_extras=True)
    offered = literal(hints[option])
    assert offered
    assert offered == setting(*CHOICES[option])


def test_every_option_with_choices_is_compared() -> None:
    hints = get_type_hints(app.smooth, include_extras=True)
    named = {name for name in inspect.signature(app.smooth).parameters if literal(hints[name])}
    assert named - {"progress"} == set(CHOICES)


def test_filters_and_smoothers_are_those_of_their_registries() -> None:
    from attest_cli.filters import FILTERS
    from attest_cli.smoothers import SMOOTHERS

    assert set(setting("smoothing", "filter")) - {"auto"} == set(FILTERS)
    assert set(setting("smoothing", "smoother")) - {"none"} == set(SMOOTHERS) - {"none"}


def test_scenarios_are_those_of_the_registry() -> None:
    from attest_cli.simulate import SCENARIOS

    assert set(literal(get_type_hints(app.simulate, include_extras=True)["scenario"])) == set(SCENARIOS)
