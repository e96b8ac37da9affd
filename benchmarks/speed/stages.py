"""CPU time of every stage of one ``attest smooth``, taken from outside: its functions are wrapped, nothing is changed.

    python benchmarks/speed/stages.py LOG OUTPUT

Prints JSON, stage -> seconds (user + system of all threads). A stage within another is taken out of it; modules count
where they are first imported.
"""

from __future__ import annotations

import functools
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

STAGES = {
    "settings": ("attest_cli.settings:load_settings",),
    "read": ("attest_cli.pipeline:read_file",),
    "prepare": ("attest_cli.pipeline:prepare",),
    "segment": ("attest_cli.pipeline:find_segments",),
    "observe": ("attest_cli.filters.indirect:observe",),
    "nodes": ("attest_cli.filters.indirect:build_nodes",),
    "forward": ("attest_cli.filters.indirect:run", "attest_cli.filters.indirect:align"),
    "checks of the gyro": ("attest_cli.filters.closure:doubts", "attest_cli.filters.scale:learn"),
    "backward": ("attest_cli.estimate:smooth_run", "attest_cli.estimate:backward_estimate"),
    "full rate": ("attest_cli.estimate:full_rate",),
    "position": ("attest_cli.pipeline:locate",),
    "judge": ("attest_cli.pipeline:_assemble", "attest_cli.pipeline:build"),
    "write track": ("attest_cli.pipeline:write_track",),
    "write the rest": ("attest_cli.pipeline:write_table", "attest_cli.pipeline:_write_report"),
    "read back": ("attest_cli.pipeline:read_result",),
    "pages": ("attest_cli.pipeline:write_pages",),
}
"""Stage -> functions, where they are looked up when they are called."""


class Clock:
    """Seconds of each stage; the inner one stops the outer."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = {}
        self._open: list[str] = []
        self._since = 0.0

    def turn(self, name: str | None) -> None:
        """Close the books of the stage that runs; open ``name``, or return to the one outside (None)."""
        now = time.process_time()
        stage = self._open[-1] if self._open else "start and imports"
        self.spent[stage] = self.spent.get(stage, 0.0) + now - self._since
        self._since = now
        if name is None:
            self._open.pop()
        else:
            self._open.append(name)

    def timed(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return the function with its time booked."""

        @functools.wraps(function)
        def run(*args: Any, **options: Any) -> Any:
            self.turn(name)
            try:
                return function(*args, **options)
            finally:
                self.turn(None)

        return run

    def pages(self, draw: Callable[..., Iterator[Any]]) -> Callable[..., Iterator[Any]]:
        """Return the iterator over pages with each page's time booked, drawing and PNG."""

        def run(*args: Any) -> Iterator[Any]:
            drawn = draw(*args)
            while True:
                self.turn("page")
                made = next(drawn, None)
                self.turn(None)
                if made is None:
                    return
                name = f"page {made[0].removesuffix('.png')}"
                self.spent[name] = self.spent.pop("page")
                made[1].png = self.timed(name, made[1].png)
                yield made

        return run


def main() -> None:
    """Run the job and print its stages."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command does
    log, output = Path(sys.argv[1]), Path(sys.argv[2])
    clock = Clock()
    import_module("attest_cli.pipeline")
    clock.turn("between")
    for stage, functions in STAGES.items():
        for where in functions:
            module, _, name = where.partition(":")
            room = import_module(module)
            setattr(room, name, clock.timed(stage, getattr(room, name)))
    figures: Any = import_module("attest_cli.figures")
    figures.pages = clock.pages(figures.pages)
    pipeline, settings = import_module("attest_cli.pipeline"), import_module("attest_cli.settings")
    effective = settings.load_settings(None, log, {})
    pipeline.smooth([log], effective, output, overwrite=True)
    clock.turn(None)
    print(json.dumps(clock.spent | {"whole": sum(os.times()[:2])}))


if __name__ == "__main__":
    main()
