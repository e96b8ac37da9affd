"""Bombs, signals and full disks: attest ends soon, says one line, and leaves what was there before as it was."""

from __future__ import annotations

import gc
import importlib
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from journeys.odd_logs import Drive
from support import hostile

from attest_cli import __main__ as main
from attest_cli.writers import files

SLOW = {"messages.mcap", "rows.parquet"}
"""Bombs of benchmarks/robustness.py alone: they take seconds to make or to refuse."""

READ_ALL = """
import resource, sys
resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))
from attest_cli.__main__ import run
codes = [run(["info", path]) for path in sys.argv[1:]]
with open("/proc/self/status") as status:  # ru_maxrss would start at the memory of who starts this process
    print(codes, next(line.split()[1] for line in status if line.startswith("VmHWM:")))
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def log(whole: Drive, folder: Path) -> Path:
    """The first stop and motion of the shipped drive."""
    return whole.span(0, 30).write(folder)


def test_bombs_are_refused_in_one_line_with_little_memory(folder: Path) -> None:
    names = [name for name in hostile.BOMBS if name not in SLOW]
    for name in names:
        hostile.BOMBS[name](folder / name)
    env = {**os.environ, "PYTHONPATH": str(hostile.ROOT), "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", READ_ALL, *(str(folder / name) for name in names)],
        capture_output=True, text=True, env=env, timeout=120, check=True,
    )  # fmt: skip
    codes, _, memory = done.stdout.strip().rpartition(" ")
    lines = [line for line in done.stderr.splitlines() if line.startswith("attest: ")]
    assert codes == str([1] * len(names)), done.stderr
    assert len(lines) == len(names)
    assert all(name in line for name, line in zip(names, lines, strict=True))
    assert not any("defect" in line or "memory" in line for line in lines)
    assert int(memory) < 256 << 10  # kB


@pytest.fixture
def handlers() -> Iterator[None]:
    """The handlers of the process, as ``main`` sets them, for the time of a test."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)}
    listeners = gc.callbacks.copy()
    gc.callbacks.clear()  # hypothesis listens to the collector; what a signal raises there is swallowed
    yield
    gc.callbacks.extend(listeners)
    for number, handler in before.items():
        signal.signal(number, handler)


def test_a_signal_at_any_moment_leaves_the_old_result_whole(
    log: Path, folder: Path, attest: Callable[..., Any], handlers: None, rng: np.random.Generator
) -> None:
    result = folder / "drive.attest"
    assert attest("smooth", log, "--format", "csv").code == 0
    start = time.monotonic()
    assert attest("smooth", log, "--format", "csv", "--overwrite").code == 0
    took = time.monotonic() - start
    before = {path: path.read_bytes() for path in result.rglob("*") if path.is_file()}
    codes = []
    for k, share in enumerate(rng.uniform(0.02, 0.7, 5).tolist()):
        number = (signal.SIGINT, signal.SIGTERM)[k % 2]
        for other in (signal.SIGINT, signal.SIGTERM):
            signal.signal(other, main._stop)
        clock = threading.Timer(share * took, os.kill, (os.getpid(), number))
        clock.start()
        try:
            outcome = attest("smooth", log, "--overwrite", "--smoother", "rts")
            clock.join()
        except main.Stopped:  # the run was faster than the clock
            outcome = None
        finally:
            clock.cancel()
        codes.append(outcome.code if outcome else None)
        if outcome and outcome.code:
            assert outcome.code == 128 + number
            assert outcome.err == "attest: stopped\n"
            assert {path: path.read_bytes() for path in result.rglob("*") if path.is_file()} == before
        assert hostile.leftovers(folder, [result]) == ["attest.toml", "drive.parquet"]
        if outcome is None or not outcome.code:
            before = {path: path.read_bytes() for path in result.rglob("*") if path.is_file()}
    assert len([code for code in codes if code]) >= 2


def test_a_signal_that_comes_while_a_library_loads_waits_for_it(
    folder: Path, monkeypatch: pytest.MonkeyPatch, handlers: None
) -> None:
    (folder / "slow_library.py").write_text("import time\nfor _ in range(20):\n    time.sleep(0.01)\n")
    monkeypatch.syspath_prepend(str(folder))
    signal.signal(signal.SIGINT, main._stop)
    clock = threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT))
    clock.start()

    def work() -> None:
        importlib.import_module("slow_library")
        time.sleep(5)

    with pytest.raises(main.Stopped):
        work()
    assert "slow_library" in sys.modules


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_process_that_is_stopped_has_the_code_of_its_signal(log: Path, folder: Path, number: int, code: int) -> None:
    ended = hostile.run("smooth", log, cwd=folder, kill_after=0.9, number=number)
    assert ended.code in {code, 0}
    assert hostile.leftovers(folder, [folder / "drive.attest"]) == ["attest.toml", "drive.parquet"]
    assert (folder / "drive.attest").exists() == (ended.code == 0)


FORMATS = ("--format", "csv,mcap")
WRITTEN = 6
"""Files of a result without its pages: two tracks, passes, innovations, segments, report."""


def test_a_disk_that_is_full_at_the_first_or_the_last_file_leaves_nothing_half_written(
    log: Path, folder: Path, attest: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("attest_cli.pipeline.write_pages", lambda *_: [])
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    named, token = 0, files.secrets.token_hex
    failed = []

    def full_at(last: int) -> Callable[[int], str]:
        """Name temporary files; from number ``last`` on no file can have more than 16 bytes."""

        def name(count: int) -> str:
            nonlocal named
            named += 1
            if named > last:
                resource.setrlimit(resource.RLIMIT_FSIZE, (16, hard))
            return token(count)

        return name

    for k in (1, WRITTEN):  # the first name is that of the folder; each file in turn: test_full_disk.py
        named = 0
        monkeypatch.setattr(files.secrets, "token_hex", full_at(k))
        try:
            outcome = attest("smooth", log, *FORMATS)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        outcome.refused("cannot be written", "is there room")
        failed.append(outcome.err.partition(": cannot")[0].rpartition("/")[2])
        assert hostile.leftovers(folder) == ["attest.toml", "drive.parquet"]
    assert failed == ["track.csv", "report.json"]
    monkeypatch.setattr(files.secrets, "token_hex", token)
    assert attest("smooth", log, *FORMATS).code == 0


def test_a_full_disk_leaves_an_old_result_whole(
    log: Path, folder: Path, attest: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("attest_cli.pipeline.write_pages", lambda *_: [])
    assert attest("smooth", log).code == 0
    result = folder / "drive.attest"
    before = {path: path.read_bytes() for path in result.rglob("*") if path.is_file()}
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, hard))
    try:
        outcome = attest("smooth", log, "--overwrite")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    outcome.refused("drive.attest/track.parquet: cannot be written")
    assert {path: path.read_bytes() for path in result.rglob("*") if path.is_file()} == before


def test_a_plain_terminal_a_closed_pipe_and_no_screen_are_no_fault(log: Path) -> None:
    env = {"PATH": os.environ["PATH"], "PYTHONPATH": str(hostile.ROOT), "LC_ALL": "C", "PYTHONUTF8": "0",
           "PYTHONCOERCECLOCALE": "0"}  # fmt: skip
    line = f"'{sys.executable}' -m attest_cli doctor '{log}' | head -1"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, env=env, check=True)
    assert done.stdout.count("\n") == 1
    assert "Traceback" not in done.stderr
    assert done.stderr.isascii()
