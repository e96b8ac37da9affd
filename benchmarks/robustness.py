"""Sweeps that are too slow for the tests, with the same functions: each prints what was tried and how it ended.

python benchmarks/robustness.py                       all of them
python benchmarks/robustness.py salvage bombs         some: salvage, bombs, signals, disk, together
"""

from __future__ import annotations

import argparse
import importlib.util
import resource
import signal
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from journeys.odd_logs import sample_drive  # noqa: E402
from support import hostile  # noqa: E402

SEED, TRIES = 20261122, 200


def salvage(folder: Path) -> bool:
    """Cut and flip each kind of MCAP file at random places; ``held`` asserts that nothing is wrong or lost unsaid."""
    tests = _module("tests/unit/readers/test_mcap_salvage.py")
    rng, good = np.random.default_rng(SEED), True
    for name, how in tests.VARIANTS.items():
        raw = tests.written(**how)
        path = folder / "log.mcap"
        path.write_bytes(raw)
        whole = tests.rows(tests.read(path, tests.Settings()))
        heads = tests.places(raw)
        ends: dict[str, Counter[str]] = {"cut": Counter(), "flipped": Counter(), "head flipped": Counter()}
        for _ in range(TRIES):
            at, bit = int(rng.integers(8, len(raw))), 1 << int(rng.integers(8))
            start = heads[int(rng.integers(len(heads)))][1] + int(rng.integers(9))
            for what, data in (("cut", raw[:at]), ("flipped", _flipped(raw, at, bit)),
                               ("head flipped", _flipped(raw, start, bit))):  # fmt: skip
                try:
                    ends[what][tests.held(path, data, whole)] += 1
                except AssertionError:
                    ends[what]["WRONG"] += 1
                    good = False
        print(f"salvage, {name}: " + "; ".join(f"{what} {dict(count)}" for what, count in ends.items()))
    return good


def _flipped(raw: bytes, at: int, bit: int) -> bytes:
    out = bytearray(raw)
    out[at] ^= bit
    return bytes(out)


def bombs(folder: Path) -> bool:
    """Hand every bomb to attest as a process: one line, under 2 GB and 60 s."""
    good = True
    for name, make in hostile.BOMBS.items():
        make(folder / name)
        most = {resource.RLIMIT_AS: 6 << 30}
        ended = hostile.run("smooth", folder / name, "-o", folder / "out", limits=most)
        fine = ended.code == 1 and ended.err.count("\n") == 1 and ended.memory < 2 << 30 and ended.seconds < 60
        good &= fine
        size = (folder / name).stat().st_size
        facts = f"{size} bytes, exit {ended.code}, {ended.seconds:.1f} s, at most {ended.memory >> 20} MB so far"
        print(f"bomb {name}: {facts}{'' if fine else ' WRONG'}: {ended.err.strip()[:160]}")
    return good


def signals(folder: Path) -> bool:
    """Stop a smoothing at 20 random moments; what was there before stays whole, and nothing else is left."""
    log = sample_drive(ROOT / "sample_logs").span(0, 60).write(folder)
    result, rng, ends = folder / "drive.attest", np.random.default_rng(SEED), Counter[str]()
    took = hostile.run("smooth", log, cwd=folder).seconds
    for k in range(20):
        before = _content(result)
        number = (signal.SIGINT, signal.SIGTERM)[k % 2]
        after = float(rng.uniform(0.05, 1.0)) * took
        ended = hostile.run(
            "smooth", log, "--overwrite", "--smoother", ("rts", "two-filter")[k % 2], cwd=folder, kill_after=after,
            number=number,
        )  # fmt: skip
        clean = hostile.leftovers(folder, [result]) == ["attest.toml", "drive.parquet"]
        old = ended.code == 0 or _content(result) == before
        late = ended.code == 128 + number and not old and set(_content(result)) == set(before)  # came with the renames
        early = ended.code in {-number, 128 + number}  # the first: before Python could set its handlers
        fine = clean and (old or late) and (ended.code == 0 or early)
        ends[f"exit {ended.code}{', new result' if late else ''}{'' if fine else ' WRONG'}"] += 1
    print(f"signals at 20 moments of {took:.1f} s: {dict(ends)}")
    return not any("WRONG" in end for end in ends)


def _content(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def disk(folder: Path) -> bool:
    """Let no file be larger than each output file is, less one byte; then none at all, over an old result."""
    log = sample_drive(ROOT / "sample_logs").span(0, 60).write(folder)
    options = ("smooth", log, "--format", "parquet,csv,tum,mcap")
    hostile.run(*options, cwd=folder)
    result, good, named = folder / "drive.attest", True, Counter[str]()
    before = _content(result)
    for size in sorted({len(content) for content in before.values()}):
        ended = hostile.run(*options, "--overwrite", cwd=folder, limits={resource.RLIMIT_FSIZE: size - 1})
        fine = ended.code == 1 and ended.err.count("\n") == 1 and _content(result) == before
        fine &= hostile.leftovers(folder, [result]) == ["attest.toml", "drive.parquet"]
        good &= fine
        named[ended.err.partition(": cannot")[0].rpartition("/")[2] + ("" if fine else " WRONG")] += 1
    print(f"disk full at {sum(named.values())} sizes: {dict(named)}")
    return good


def together(folder: Path) -> bool:
    """Two runs on one output at once: with and without --overwrite one whole result is left."""
    log = sample_drive(ROOT / "sample_logs").span(0, 60).write(folder)
    good = True
    for more, codes in (((), [0, 1]), (("--overwrite",), [0, 0])):
        ended: list[hostile.Ended] = []

        def one(smoother: str, more: tuple[str, ...] = more, ended: list[hostile.Ended] = ended) -> None:
            ended.append(hostile.run("smooth", log, "--smoother", smoother, *more, cwd=folder))

        runs = [threading.Thread(target=one, args=(smoother,)) for smoother in ("rts", "two-filter")]
        for run in runs:
            run.start()
        for run in runs:
            run.join()
        clean = hostile.leftovers(folder, [folder / "drive.attest"]) == ["attest.toml", "drive.parquet"]
        fine = sorted(e.code for e in ended) == codes and clean
        good &= fine
        print(f"two at once {more}: exit {[e.code for e in ended]}{'' if fine else ' WRONG'}")
    return good


def _module(name: str) -> ModuleType:
    """Load a file of tests by its place."""
    spec = importlib.util.spec_from_file_location(Path(name).stem, ROOT / name)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


SWEEPS: dict[str, Callable[[Path], bool]] = {
    "salvage": salvage, "bombs": bombs, "signals": signals, "disk": disk, "together": together,
}  # fmt: skip


def main() -> None:
    """Run the sweeps that are named, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sweeps", nargs="*", metavar="SWEEP", help=", ".join(SWEEPS))
    chosen = parser.parse_args().sweeps or list(SWEEPS)
    good = True
    for name in chosen:
        with tempfile.TemporaryDirectory() as folder:
            good &= SWEEPS[name](Path(folder))
    sys.exit(not good)


if __name__ == "__main__":
    main()
