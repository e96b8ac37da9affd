"""``attest init``: what attest found in a log, as an ``attest.toml`` to be looked through."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import AttestError
from ..settings import CONFIG_NAME, Settings, load_settings
from .console import LOST, OK, Console, plain

if TYPE_CHECKING:
    from ..records import Channel, Log, Recording

HALVES = ("gyro", "accel", "temperature")  # roles without a table of their own: they stand in [map]
HEAD = """\
# Settings of attest for {names}, as attest init found them. They hold from now on for every log in this folder.
# A line may go: attest then looks for itself again. The README names all settings.
"""


def run(
    logs: Sequence[Path], config: Path | None, overrides: Mapping[str, Any], output: Path | None, console: Console
) -> int:
    """Read the log as it would be smoothed, and write down what was found; an existing file is left alone."""
    target = output or logs[0].parent / CONFIG_NAME
    if target.exists() or target.is_symlink():
        raise AttestError(
            f"{target}: exists already", "attest init replaces no settings: delete it, or name another -o"
        )
    effective = load_settings(config, logs[0], overrides)
    settings = effective.settings
    from ..prepare import choose, prepare
    from ..readers import read
    from ..writers.files import atomic_write, check_output

    check_output(target)
    recordings = [read(path, settings) for path in logs]
    log = prepare(recordings, settings)
    cast = choose(recordings, settings).channels
    blocks = [
        HEAD.format(names=", ".join(plain(path.name) for path in logs)),
        *_of_sensors(recordings, cast, log, settings),
        *_of_tables(recordings, cast, settings),
    ]
    text = "\n".join(blocks)
    with atomic_write(target) as temporary:
        temporary.write_text(text, encoding="utf-8")
    for warning in log.warnings:
        console.warn(warning.message, warning.hint)
    console.say(("→ ", "mute"), str(target))
    return LOST if any(warning.lost for warning in log.warnings) else OK


def _of_sensors(
    recordings: Sequence[Recording], cast: Mapping[str, Channel], log: Log, settings: Settings
) -> Iterator[str]:
    """One table per role that a channel plays, then the channels that play none."""
    for role, channel in cast.items():
        if role not in HALVES:
            lines = [f"[{role}]", f"channel = {_quoted(channel.name)}  # {_facts(channel)}"]
            yield "\n".join([*lines, *(_of_imu(log, settings) if role == "imu" else ()), ""])
    halves = [f"{role} = {_quoted(cast[role].name)}  # {_facts(cast[role])}" for role in HALVES if role in cast]
    if halves:
        yield "\n".join(["[map]", *halves, ""])
    if "imu" not in cast:
        yield "\n".join(["[imu]", *_of_imu(log, settings), ""])
    from ..prepare.roles import joined

    used = {channel.name for channel in cast.values()}
    unused = [channel for channel in joined(recordings) if channel.name not in used]
    if unused:
        lines = [f"#   {plain(c.name)} ({_facts(c)}){_what(c)}" for c in unused]
        yield "\n".join(["# Channels that are not used:", *lines, ""])


def _what(channel: Channel) -> str:
    own = "q_w" in channel.values and not channel.role
    return ": a device's own filter; [orientation] channel uses it all the same" if own else ""


def _of_imu(log: Log, settings: Settings) -> Iterator[str]:
    """Where gravity shows, and the noise at the stops: told, not set, for attest finds both in each log."""
    import numpy as np

    from ..nodes.noise import find_noise
    from ..segment import find_segments

    mean = np.median(log.imu.accel_b, axis=0)
    axis = int(np.argmax(np.abs(mean)))
    sign = "+" if mean[axis] > 0 else "-"
    yield f'# mounting = "auto"  # gravity shows on {sign}{"xyz"[axis]}, mostly: an axis that points up shows +'
    found = find_segments(log, settings)
    noise = find_noise(log, found, settings)
    for name, value, unit in (
        ("gyro_noise_density", noise.gyro_density, "rad/s/sqrt(Hz)"),
        ("gyro_random_walk", noise.gyro_walk, "rad/s^2/sqrt(Hz)"),
        ("accel_noise_density", noise.accel_density, "m/s^2/sqrt(Hz)"),
    ):
        yield f'# {name} = "{value:.3g} {unit}"  # {plain(noise.sources[name])}'


def _of_tables(recordings: Sequence[Recording], cast: Mapping[str, Channel], settings: Settings) -> Iterator[str]:
    """How text logs are read: what was asked for, and every guess, so that it is none any more."""
    text = [recording for recording in recordings if recording.format == "csv"]
    stated = settings.table.model_dump(exclude_defaults=True)
    if not text:
        return
    from ..readers.stamps import taken_unit

    units = {unit for recording in text if (unit := taken_unit(recording.warnings)) is not None}
    if len(units) == 1 and len(text) == len(recordings):
        stated.setdefault("time_unit", units.pop())
    names = {} if settings.table.rows or settings.table.columns else _guessed_units(text, cast, settings)
    if names:
        stated["names"] = {**names, **stated.get("names", {})}
    notes = [f"# {plain(r.source.name)}: {'; '.join(n for n in r.notes if not n.startswith(' '))}" for r in text]
    body = [f"{key} = {_toml(value)}" for key, value in stated.items() if not isinstance(value, dict)]
    tables = [
        "\n".join(["", f"[table.{key}]", *(f"{_quoted(k)} = {_toml(v)}" for k, v in value.items())])
        for key, value in stated.items()
        if isinstance(value, dict)
    ]
    yield "\n".join([*notes, *(["[table]"] if body else []), *body, *tables, ""])


def _guessed_units(text: Sequence[Recording], cast: Mapping[str, Channel], settings: Settings) -> dict[str, str]:
    """Names with their unit for columns of the sensors in use whose unit only physics told."""
    from ..prepare.canonical import in_canonical_units, taken_units
    from ..readers.csv_log import columns_of, sniff

    channels = list(cast.values())
    converted, _ = in_canonical_units(channels, settings)
    taken = {(c.name, name): unit for c, new in zip(channels, converted, strict=True)
             for name, unit in taken_units(c, new).items()}  # fmt: skip
    names = {}
    for recording in text:
        for column in columns_of(recording.source, sniff(recording.source, settings.table), settings).columns:
            own = {c.name for c in recording.channels if column.canonical in c.values}
            mine = [name for name in own if name.startswith(f"{column.instance}/") or len(own) == 1]
            unit = next((taken[name, column.canonical] for name in mine if (name, column.canonical) in taken), None)
            if unit is not None and not column.unit:
                front = f"{column.instance} " if column.instance else ""
                names[column.name.strip()] = f"{front}{column.canonical} [{unit}]"
    return names


def _facts(channel: Channel) -> str:
    """Rows and units of a channel."""
    units = ", ".join(sorted({unit for unit in channel.units.values() if unit}))
    return plain(f"{channel.stamps_ns.size} rows" + (f", {units}" if units else ""))


def _toml(value: Any) -> str:
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return _quoted(value) if isinstance(value, str) else str(value)


def _quoted(text: str) -> str:
    """A TOML string: JSON's, with the one control character escaped that JSON leaves."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
