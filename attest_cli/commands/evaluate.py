"""``attest evaluate``: how far a result is from a reference, and whether its sigmas hold."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from .console import OK, Console

NAMES = {
    "inclination": "tilt", "heading": "heading", "heading_relative": "heading, offset removed", "total": "total",
    "absolute": "position", "horizontal": "position, level", "vertical": "position, height",
}  # fmt: skip
UNITS = {"attitude": "°", "position": " m"}
UPRIGHT = {"attitude": "heading", "position": "position z, up"}
Row = tuple[str, ...]


def run(
    result: Path,
    reference: Path,
    options: Mapping[str, Any],
    channel: str | None,
    output: Path | None,
    theme: str | None,
    console: Console,
    *,
    overwrite: bool,
) -> int:
    """Evaluate, and tell the errors in a table and what they mean in words."""
    from .. import pipeline

    found = pipeline.evaluate(result, reference, options, output, channel=channel, theme=theme, overwrite=overwrite)
    if console.json:
        console.data(found)
    _tell(found, console)
    for warning in found["warnings"]:
        console.warn(warning["message"], warning["hint"])
    folder = output or (result if result.is_dir() else result.parent)
    console.say(("→ ", "mute"), str(folder / pipeline.EVALUATION), (f"  {pipeline.EVALUATION_PAGE}", "mute"))
    return OK


def _tell(found: Mapping[str, Any], console: Console) -> None:
    """The finding, the errors, NEES and coverage as tables, and what was compared with what."""
    from .console import MARKS

    verdict = found["verdict"]
    mark = [] if verdict is None else [(f"{MARKS[verdict]} ", verdict)]
    console.say(*mark, (found["page"]["title"], "strong"), (f"  {verdict or ''}", verdict or ""))
    _grid([("error", "rms", "median", "95 %", "max"), *_errors(found)], console)
    claims = list(_nees(found))
    if claims:
        _grid([("NEES", "mean", "expected", "in the 95 % region"), *claims], console)
        head = ("share of errors inside", "1σ", "2σ", "3σ", "95 % band", "independent errors")
        _grid([head, *_shares(found), ("expected", "68 %", "95 %", "99.7 %", "95 %", "")], console)
    facts = list(_facts(found))
    label = max(len(name) for name, _ in facts)
    for name, words in facts:
        console.say((f"  {name:<{label}}  ", "mute"), words)


def _grid(rows: Sequence[Row], console: Console) -> None:
    """Aligned columns for people, the first row as head."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for number, row in enumerate(rows):
        cells = "  ".join(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))
        console.say((f"  {row[0]:<{widths[0]}}  ", "mute"), (cells, "" if number else "mute"))


def _errors(found: Mapping[str, Any]) -> Iterator[Row]:
    from ..figures.evaluate import size

    for kind, unit in UNITS.items():
        for name, stats in (found[kind] or {"errors": {}})["errors"].items():
            words = f"position over {found['delta']:g} {found['delta_unit']}" if name == "relative" else NAMES.get(name)
            if words and stats["count"]:
                yield (words, *(f"{size(stats[key])}{unit}" for key in ("rms", "median", "p95", "max")))


def _nees(found: Mapping[str, Any]) -> Iterator[Row]:
    from ..figures.words import number, percent

    for kind in UNITS:
        for name, nees in (found[kind] or {"nees": {}})["nees"].items():
            if nees["count"]:
                yield (
                    NAMES.get(name, name),
                    number(nees["mean"], 2 if nees["mean"] < 100.0 else 0),
                    str(nees["expected"]),
                    percent(nees["inside_95"]),
                )


def _shares(found: Mapping[str, Any]) -> Iterator[Row]:
    from ..figures.words import number, percent

    for kind in UNITS:
        for axis, c in (found[kind] or {"coverage": {}})["coverage"].items():
            shares = [percent(c[key]) for key in ("sigma_1", "sigma_2", "sigma_3", "band_95")]
            name = NAMES.get(axis) or (UPRIGHT[kind] if axis == "z" else f"{kind} {axis}")
            yield name, *shares, number(c["independent"])


def _facts(found: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """What was compared and how, in words."""
    from ..figures.evaluate import size

    for kind in UNITS:
        if found[kind] is not None:
            yield f"{kind}s", _compared(found[kind]["compared"])
            if not found[kind]["nees"]:
                yield f"{kind} σ", "the result states none"
    only = f"motion only, as the {found['moving_from']} tells it"
    yield "judged", only if found["moving_only"] else "motion and rest"
    yield "time offset", _offset(found["time_offset"])
    yield "aligned", _aligned(found)
    if found["reference_scatter_deg"] is not None:
        yield "reference", f"scatters at most {size(found['reference_scatter_deg'])}° from sample to sample"


def _compared(compared: Mapping[str, Any]) -> str:
    from ..figures.words import number

    other = "reference" if compared["at"] == "result" else "result"
    words = f"{number(compared['used'])} samples of the {compared['at']}, the {other} interpolated"
    left = [
        (compared["outside"], f"outside the {other}"),
        (compared["in_gaps"], "in its gaps"),
        (compared["still"], "at rest"),
    ]
    out = ", ".join(f"{number(count)} {where}" for count, where in left if count)
    return f"{words}; left out: {out}" if out else words


def _offset(offset: Mapping[str, Any]) -> str:
    from ..figures.words import number, sigma_decimals, two_digits

    given = offset["applied_s"]
    applied = f"{given:g} s added to the stamps of the result" if given else "nothing applied"
    if offset["fitted_s"] is None:
        return f"none found: the rates of both do not match; {applied}"
    sigma = max(offset["sigma_s"] * 1e3, 1e-6)
    value = number(offset["fitted_s"] * 1e3, min(sigma_decimals(sigma), 4), sign=True)
    return f"{value} ± {two_digits(sigma)} ms by the rates of {offset['fitted_to']}; {applied}"


def _aligned(found: Mapping[str, Any]) -> str:
    from ..figures.words import number

    alignment = found["alignment"]
    mode = alignment["mode"]
    words = "nothing" if mode == "none" else "reference turned to fit"
    if mode == "yaw" and found["attitude"] is not None:
        words = f"reference turned by {number(alignment['yaw_deg'], 2, sign=True)}° about the vertical"
    if alignment["body"]:
        words = f"{words}, and its body axes" if mode != "none" else "body axes of the reference"
    return f"{words}; positions by their own turn and shift" if found["position"] and mode != "none" else words
