"""The one place that talks: results on stdout, words for people on stderr; nothing of a log reaches a terminal raw."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..errors import AttestError

if TYPE_CHECKING:
    from rich.console import Console as Terminal
    from rich.text import Text

OK, LOST = 0, 3
"""Exit codes of a command that came to its end: done; done, but data was lost or a gate failed."""

STYLES = {"": "", "strong": "bold", "mute": "dim", "PASS": "green", "WARN": "yellow", "FAIL": "red"}
MARKS = {"PASS": "●", "WARN": "▲", "FAIL": "✖"}
_SPACES = "\u00a0\u2009\u202f"  # narrow and no-break spaces of our own numbers
Part = tuple[str, str]  # text and the name of its style


def plain(text: object) -> str:
    r"""Text as it is safe on a terminal: control characters, bidi marks and line ends become ``\x1b`` and the like."""
    return "".join(c if c.isprintable() or c in _SPACES else _escaped(c) for c in str(text))


def _escaped(char: str) -> str:
    return char.encode("unicode_escape", "backslashreplace").decode("ascii")


@dataclass(frozen=True, slots=True)
class Console:
    """How much is said, and in which form."""

    json: bool = False
    verbose: bool = False
    quiet: bool = False
    progress: str = "none"

    def say(self, *parts: Part | str) -> None:
        """A line for people, on stderr; silent with ``--quiet``."""
        if not self.quiet:
            _print(sys.stderr, _assembled(parts))

    def warn(self, message: str, hint: str = "", level: str = "WARN") -> None:
        """A warning and, muted below it, the way out; also with ``--quiet``."""
        _print(sys.stderr, _assembled([(f"{MARKS[level]} ", level), message]))
        if hint:
            _print(sys.stderr, _assembled([(f"  {hint}", "mute")]))

    def result(self, *parts: Part | str) -> None:
        """A line of the result, on stdout."""
        _print(sys.stdout, _assembled(parts))

    def table(self, rows: Sequence[Sequence[str]], *, right: str = "") -> None:
        """Aligned columns on stdout, the first row as head; ``right`` holds ``r`` for each column aligned right."""
        cells = [[plain(cell) for cell in row] for row in rows]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        for number, row in enumerate(cells):
            padded = [
                cell.rjust(width) if right[i : i + 1] == "r" else cell.ljust(width)
                for i, (cell, width) in enumerate(zip(row, widths, strict=True))
            ]
            self.result(("  ".join(padded).rstrip(), "" if number else "mute"))

    def data(self, value: Any) -> None:
        """A result as JSON on stdout (``--json``); not a number becomes null."""
        with named(sys.stdout):
            sys.stdout.write(json.dumps(finite(value), indent=2, default=str) + "\n")

    @contextlib.contextmanager
    def working(self) -> Iterator[Callable[[str, float], None]]:
        """Progress as ``report(stage, share done)``: a bar on a terminal, JSON lines, or nothing."""
        if self.progress == "json":
            yield _json_line
        elif self.progress == "auto" and not self.quiet and sys.stderr is not None and sys.stderr.isatty():
            with _bar() as report:
                yield report
        else:
            yield _silent


@contextlib.contextmanager
def named(stream: Any) -> Iterator[None]:
    """Name the stream that cannot be written to; a reader that has left is another matter."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as fault:
        name = "standard error" if stream is sys.stderr else "standard output"
        raise AttestError(f"{name} cannot be written: {fault.strerror}", "is there room where it goes?") from None


def finite(value: Any) -> Any:
    """The value with null for every number that is none: JSON knows no NaN."""
    if isinstance(value, float):
        return value if value - value == 0 else None
    if isinstance(value, Mapping):
        return {str(k): finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [finite(v) for v in value]
    return value


def _assembled(parts: Sequence[Part | str]) -> Text:
    from rich.text import Text

    pairs = [(part, "") if isinstance(part, str) else part for part in parts]
    return Text.assemble(*((plain(text), STYLES[style]) for text, style in pairs))


def _print(stream: Any, line: Text) -> None:
    if stream is not None:
        with named(stream):
            _terminal(stream).print(line, soft_wrap=True)


def _terminal(stream: Any) -> Terminal:
    from rich.console import Console as Terminal

    return Terminal(file=stream, markup=False, highlight=False, emoji=False)


def _silent(_stage: str, _share: float) -> None:
    """No progress is shown."""


def _json_line(stage: str, share: float) -> None:
    sys.stderr.write(json.dumps({"stage": stage, "share": round(share, 4)}) + "\n")
    sys.stderr.flush()


@contextlib.contextmanager
def _bar() -> Iterator[Callable[[str, float], None]]:
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:<22}", markup=False), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=_terminal(sys.stderr), transient=True) as bar:
        task = bar.add_task("", total=1.0)
        yield lambda stage, share: bar.update(task, description=plain(stage), completed=share)
