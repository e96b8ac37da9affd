"""Settings from the command line, ``--config``, ``attest.toml`` beside the log and the defaults, in this order."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from ..errors import AttestError, UsageError
from .models import Role, Settings
from .quantities import Section

CONFIG_NAME = "attest.toml"
COMMAND_LINE = "command line"  # as a source of settings
_MAX_BYTES = 1_000_000  # no settings file of a person is larger

Table = dict[str, Any]

_PLAIN = {"path_type": "should be a file name", "string_type": "should be text", "dict_type": "should be a table"}

_KALIBR = {
    "gyroscope_noise_density": "gyro_noise_density",
    "gyroscope_random_walk": "gyro_random_walk",
    "accelerometer_noise_density": "accel_noise_density",
}


@dataclass(frozen=True, slots=True)
class Effective:
    """The settings that hold, and where each came from: dotted name -> "command line" or file; else the default."""

    settings: Settings
    sources: Mapping[str, str]

    def table(self) -> dict[str, dict[str, Any]]:
        """Dotted name -> value and source of every setting, ready for ``report.json``."""
        flat = dict(_leaves(self.settings.model_dump(mode="json")))
        return {name: {"value": value, "source": self.sources.get(name, "default")} for name, value in flat.items()}

    def informed(self, values: Mapping[str, Any], source: str) -> Effective:
        """The same with ``values`` (dotted names) where nobody gave any: anything stated beats what was measured."""
        new = _nested({name: value for name, value in values.items() if name not in self.sources})
        parts = {name: getattr(self.settings, name).model_copy(update=part) for name, part in new.items()}
        named = {name: source for name, _ in _leaves(new)}
        return Effective(self.settings.model_copy(update=parts), {**self.sources, **named})


@dataclass(frozen=True, slots=True)
class _Layer:
    """One source of settings: what it says, its name in messages, the folder its paths are relative to."""

    table: Table
    source: str
    folder: Path


def load_settings(
    config: Path | None, log: Path | None, overrides: Mapping[str, Any], without: Sequence[str] = ()
) -> Effective:
    """Merge all sources: command line over ``--config`` over ``attest.toml`` beside the log over defaults.

    Parameters
    ----------
    config : Path or None
        File given by ``--config``.
    log : Path or None
        The (first) log; ``attest.toml`` in its folder is read where there is one.
    overrides : dotted name -> value
        The command line, such as ``{"smoothing.smoother": "rts", "map.sun": "/sun"}``; None = not given.
    without : dotted names
        Settings that have no say here, whoever gives them.

    Raises
    ------
    AttestError
        One line with file, key and the nearest right name.
    """
    beside = [log.parent / CONFIG_NAME] if log is not None and (log.parent / CONFIG_NAME).is_file() else []
    files = [*beside, config] if config is not None else beside
    layers = [_Layer(read_toml(path), str(path), path.parent) for path in files]
    layers.append(_Layer(_nested(overrides), COMMAND_LINE, Path()))
    merged: Table = {}
    sources: dict[str, str] = {}
    for layer in (part for given in layers for part in _prepared(given)):
        for name, value in _leaves(layer.table):
            if name not in without:
                _put(merged, name, value)
                sources[name] = layer.source
    return Effective(_checked(merged, "settings"), sources)


def _prepared(layer: _Layer) -> Iterator[_Layer]:
    """The layer checked on its own, with whole paths and channels; beneath it what its noise file says."""
    _checked(layer.table, layer.source)
    table: Table = {name: dict(part) for name, part in layer.table.items()}
    for section, key in (("imu", "noise_file"), ("imu", "calibration"), ("stops", "file")):
        if section in table and key in table[section]:
            table[section][key] = layer.folder / Path(table[section][key])
    for role in set(get_args(Role)) & set(Settings.model_fields):
        mapped, channel = table.get("map", {}).get(role), table.get(role, {}).get("channel")
        if mapped and channel and mapped != channel:
            message = f"{layer.source}: {role}.channel is {channel!r} but map.{role} is {mapped!r}"
            raise AttestError(message, "keep one of them")
        if mapped or channel:
            table.setdefault("map", {})[role] = table.setdefault(role, {})["channel"] = mapped or channel
    if "noise_file" in table.get("imu", {}):
        noise_file = table["imu"]["noise_file"]
        noise = _Layer({"imu": _read_kalibr(noise_file)}, str(noise_file), layer.folder)
        _checked(noise.table, noise.source)
        yield noise
    yield _Layer(table, layer.source, layer.folder)


def _checked(table: Table, source: str) -> Settings:
    try:
        return Settings.model_validate(table)
    except ValidationError as fault:
        faults = fault.errors()
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        message, hint = _told(faults[0])
        fault_of = UsageError if source == COMMAND_LINE else AttestError
        raise fault_of(f"{source}: {message}{more}", hint) from None


def _told(fault: ErrorDetails) -> tuple[str, str]:
    """A fault that pydantic found, in our words: what is wrong, and the nearest right name."""
    loc = [str(part) for part in fault["loc"]]
    name = ".".join(loc[:2])
    if fault["type"] == "extra_forbidden":
        near = _nearest_name(loc)
        return f"unknown setting {name}", f"did you mean {near}?" if near else "the README lists all settings"
    if loc[0] == "map" and loc[-1] == "[key]":
        return f"unknown role {loc[1]!r} in map", _did_you_mean(loc[1], get_args(Role))
    if fault["type"] == "model_type":
        return f"{name} should be a table, [{name}]", ""
    if fault["type"] == "literal_error":
        choices = [part.strip("'") for part in str(fault["ctx"]["expected"]).replace(" or ", ", ").split(", ")]
        message = f"{name} = {fault['input']!r} is not one of {', '.join(choices)}"
        return message, _did_you_mean(str(fault["input"]), choices, say_all=False)
    said = str(fault["ctx"]["error"]) if fault["type"] == "value_error" else fault["msg"].removeprefix("Input ")
    said = _PLAIN.get(fault["type"], said)
    return (name if isinstance(fault["input"], dict) else f"{name} = {fault['input']!r}") + f": {said}", ""


def _did_you_mean(word: str, choices: tuple[str, ...] | list[str], *, say_all: bool = True) -> str:
    near = difflib.get_close_matches(word, choices, n=1, cutoff=0.5)
    if near:
        return f"did you mean {near[0]!r}?"
    return f"one of {', '.join(choices)}" if say_all else ""


def _nearest_name(loc: list[str]) -> str:
    """The setting (or table) whose name is nearest: the same key elsewhere, then the same table, then anywhere."""
    names = [f"{section}.{key}" for section, part in _sections() for key in part.model_fields]
    key = loc[-1]
    leaf = {name.split(".")[1]: name for name in reversed(names)}
    if key in leaf:
        return leaf[key]
    own = {name.split(".")[1]: name for name in names if len(loc) > 1 and name.startswith(f"{loc[0]}.")}
    tables = {name: name for name in Settings.model_fields} if len(loc) == 1 else {}
    for choices, cutoff in ((own, 0.5), (tables, 0.6), (leaf, 0.7)):
        if near := difflib.get_close_matches(key, choices, n=1, cutoff=cutoff):
            return choices[near[0]]
    return ""


def _sections() -> Iterator[tuple[str, type[Section]]]:
    for name, info in Settings.model_fields.items():
        if isinstance(info.annotation, type) and issubclass(info.annotation, Section):
            yield name, info.annotation


def _read_text(path: Path) -> str:
    try:
        if path.is_dir():
            raise AttestError(f"{path} is a folder, not a settings file")
        with path.open("rb") as file:
            data = file.read(_MAX_BYTES + 1)
    except FileNotFoundError:
        raise AttestError(f"{path}: no such file") from None
    except OSError as fault:
        raise AttestError(f"{path}: {fault.strerror}") from None
    if len(data) > _MAX_BYTES:
        raise AttestError(f"{path} is larger than 1 MB: no settings file")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as fault:
        raise AttestError(f"{path} is not UTF-8 text (byte {fault.start})", "save it as UTF-8") from None


def read_toml(path: Path) -> Table:
    """Tables of a TOML file; a fault of it is one line."""
    try:
        return tomllib.loads(_read_text(path))
    except tomllib.TOMLDecodeError as fault:
        raise AttestError(f"{path} is not TOML: {fault}") from None
    except RecursionError:
        raise AttestError(f"{path} is not TOML: nested too deeply") from None


def _read_kalibr(path: Path) -> Table:
    """Noise densities of a Kalibr ``imu.yaml`` (also with one ``imu0:`` level), in SI as Kalibr defines them."""
    import yaml

    try:
        data = yaml.safe_load(_read_text(path))
    except (yaml.YAMLError, RecursionError) as fault:
        problem = getattr(fault, "problem", None) or type(fault).__name__
        raise AttestError(f"{path} is not YAML: {problem}") from None
    if isinstance(data, dict) and isinstance(data.get("imu0"), dict):
        data = data["imu0"]
    if not isinstance(data, dict) or not (set(data) & set(_KALIBR)):
        raise AttestError(f"{path} names no noise density", f"Kalibr's imu.yaml has {', '.join(_KALIBR)}")
    return {ours: data[theirs] for theirs, ours in _KALIBR.items() if theirs in data}


def _nested(flat: Mapping[str, Any]) -> Table:
    table: Table = {}
    for name, value in flat.items():
        if value is not None:
            _put(table, name, value)
    return table


def _put(table: Table, name: str, value: Any) -> None:
    section, _, key = name.partition(".")
    if key:
        table.setdefault(section, {})[key] = value
    else:
        table[section] = value


def _leaves(table: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for section, part in table.items():
        if isinstance(part, Mapping):
            yield from ((f"{section}.{key}", value) for key, value in part.items())
        else:
            yield section, part
