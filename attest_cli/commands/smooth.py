"""``attest smooth``: the whole run, and what it found in a dozen lines."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..settings import load_settings
from .console import LOST, OK, Console

Row = tuple[str, str, str]  # what, its value, a muted note


def run(
    logs: Sequence[Path],
    config: Path | None,
    overrides: Mapping[str, Any],
    output: Path | None,
    console: Console,
    *,
    overwrite: bool,
    strict: bool,
) -> int:
    """Smooth the drive into a result folder and tell what was found."""
    effective = load_settings(config, logs[0], overrides)
    folder = output or Path(f"{logs[0].stem}.attest")
    from .. import pipeline

    with console.working() as progress:
        report = pipeline.smooth(logs, effective, folder, overwrite=overwrite, progress=progress)
    if console.json:
        console.data(report)
    _tell(report, folder, console)
    passed = _gate_passed(report, effective.settings.gate.max_sigma_attitude_deg, console)
    lost = any(warning.get("lost") for warning in report["warnings"])
    failed = lost or not passed or report["verdict"] == "FAIL"
    doubted = bool(report["warnings"]) or any(check["status"] != "PASS" for check in report["checks"])
    return LOST if failed or (strict and doubted) else OK


def plan(
    logs: Sequence[Path], config: Path | None, overrides: Mapping[str, Any], console: Console, *, strict: bool
) -> int:
    """Tell what a run would do: channels, segments, methods; nothing is written. Data that is lost is so now, too."""
    effective = load_settings(config, logs[0], overrides)
    from .. import pipeline

    found = pipeline.plan(logs, effective)
    if console.json:
        console.data(found)
    else:
        console.table(list(_flat(found)))
    return LOST if found["lost"] or (strict and found["warnings"]) else OK


def _flat(found: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Nested facts as two columns of text."""
    for name, value in found.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        elif isinstance(value, list | tuple) and value and isinstance(value[0], Mapping):
            for number, item in enumerate(value, start=1):
                yield f"{prefix}{name} {number}", ", ".join(f"{k} {v}" for k, v in item.items() if v not in {None, ""})
        elif value not in ("", None, [], ()):
            parts = value if isinstance(value, list | tuple) else [value]
            yield f"{prefix}{name}", ", ".join(f"{x:.6g}" if isinstance(x, float) else str(x) for x in parts)


def _tell(report: Mapping[str, Any], folder: Path, console: Console) -> None:
    """The finding, the numbers behind it, what to know, and where the result is."""
    from .console import MARKS

    verdict = report["verdict"]
    finding = report["pages"][0]["title"] if report["pages"] else f"{folder.name}: done"
    console.say((f"{MARKS[verdict]} ", verdict), (finding, "strong"), (f"  {verdict}", verdict))
    rows = list(_numbers(report))
    label, value = max(len(row[0]) for row in rows), max(len(row[1]) for row in rows)
    for what, number, note in rows:
        console.say((f"  {what:<{label}}  ", "mute"), f"{number:<{value}}", (f"  {note}" if note else "", "mute"))
    for warning in report["warnings"]:
        console.warn(warning["message"], warning["hint"], "FAIL" if warning["lost"] or warning.get("fatal") else "WARN")
    told = {warning["code"] for warning in report["warnings"]}
    for check in report["checks"]:
        if check["status"] != "PASS" and check["name"] not in told:
            console.warn(check["fact"], check["detail"], check["status"])
    for line in (report.get("advice") or {}).get("lines", []):
        console.say(("  advice: ", "mute"), line)
    if console.verbose:
        for name, setting in report["settings"].items():
            if setting["source"] != "default":
                console.say((f"  {name} = {setting['value']}  ", ""), (f"({setting['source']})", "mute"))
    console.say(("→ ", "mute"), f"{folder}/", (f"  {len(report['pages'])} pages and report.html in report/", "mute"))


def _numbers(report: Mapping[str, Any]) -> Iterator[Row]:
    from ..figures.words import duration, number, percent

    found, coverage, given = report["statistics"], report["coverage"], report["input"]
    samples = f"{number(given['samples'])} samples at {given['rate_hz']:.4g} Hz"
    yield "log", duration(given["duration_s"]), " · ".join([samples, *given["sensors"]])
    yield "segments", f"{found['motions']} | {found['stops']}", "motions | stops"
    relative = report["heading"] == "relative"
    forward = "" if relative else _two(found.get("forward_sigma_heading_max_deg"), "°")
    yield (
        "heading σ",
        _two(found.get("sigma_heading_median_deg"), "°"),
        _noted(
            _most(found.get("sigma_heading_max_deg"), "°"),
            forward and f"forward alone {forward}",
            "relative to the start" * relative,
        ),
    )
    yield "tilt σ", _two(found.get("sigma_tilt_median_deg"), "°"), _noted(_most(found.get("sigma_tilt_max_deg"), "°"))
    if found.get("position_sigma_median_m") is not None:
        far = (found.get("position_sigma_max_m") or 0.0) > 0.1 * (found.get("distance_m") or 0.0) > 0.0
        unusable = "" if found.get("position_usable") else "not usable" + ": it passes 10 % of the distance" * far
        most = _most(found.get("position_sigma_max_m"), " m")
        yield "position σ", _two(found["position_sigma_median_m"], " m"), _noted(most, unusable)
    if found.get("separation_checks"):
        inside = f"{found['separation_inside_2sigma']} of {found['separation_checks']}"
        yield "agreement", inside, "separations of forward and backward inside 2σ"
    rows = f"{number(coverage['rows_used'])} of {number(coverage['rows_in'])} rows"
    yield "coverage", percent(coverage["share"]), rows


def _two(value: float | None, unit: str) -> str:
    from ..figures.words import two_digits

    return "unknown" if value is None else f"{two_digits(value)}{unit}"


def _most(value: float | None, unit: str) -> str:
    return "" if value is None else f"at most {_two(value, unit)}"


def _noted(*notes: str) -> str:
    return ", ".join(note for note in notes if note and note != "unknown")


def _gate_passed(report: Mapping[str, Any], limit: float | None, console: Console) -> bool:
    """Whether the largest attitude sigma stays within the gate; an unknown sigma does not."""
    if limit is None:
        return True
    from ..figures.words import two_digits

    found = report["statistics"]
    largest = [found.get("sigma_heading_max_deg"), found.get("sigma_tilt_max_deg")]
    if all(value is not None and value <= limit for value in largest):
        return True
    known = [value for value in largest if value is not None]
    says = f"{two_digits(max(known))}°" if len(known) == len(largest) else "unknown"
    console.warn(f"attitude σ is {says}, over the gate of {limit:g}°", "see the sigma page for where", "FAIL")
    return False
