"""Fuzz a reader: damaged and odd logs made from small whole ones, read in a child with limits on memory and time.

    python benchmarks/fuzz.py csv --minutes 60        also: parquet, mcap, bag, db3, ulog
    python benchmarks/fuzz.py mcap --case 1234        one case again, with its traceback

A case follows from reader, seed and number alone. Every end of reading (and of preparing what was read) other than
success or AttestError is a crash: it is cut down to a small file and written to --save, of which tests make a corpus.
"""

from __future__ import annotations

import argparse
import mmap
import os
import resource
import signal
import struct
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from support.mutations import case, seeds  # noqa: E402

CORPUS = ROOT / "tests" / "unit" / "readers" / "corpus"
MEMORY_BYTES, SECONDS = 4 << 30, 30


def outcome(path: Path, *, prepared: bool = True) -> str:
    """Read a log, and prepare it; return "read", "refused", or the signature of a crash."""
    from attest_cli.errors import AttestError
    from attest_cli.prepare import prepare
    from attest_cli.readers import read
    from attest_cli.settings import Settings

    stage = "read"
    try:
        recording = read(path, Settings())
        if prepared:
            stage = "prepare"
            prepare([recording], Settings())
    except AttestError:
        return "refused"
    except BaseException as fault:  # noqa: BLE001 (whatever it is, it is what is looked for)
        where = [f"{Path(f.filename).name}:{f.name}" for f in traceback.extract_tb(fault.__traceback__)
                 if "attest_cli" in f.filename]  # fmt: skip
        return f"crash: {stage}: {type(fault).__name__} in {where[-1] if where else '?'}"
    return "read"


def minimised(data: bytes, suffix: str, signature: str, folder: Path, tries: int = 150) -> bytes:
    """Cut pieces out of a case as long as it ends in the same way."""
    path, size = folder / f"small{suffix}", max(len(data) // 2, 1)
    while size >= 1 and tries > 0:
        at = 0
        while at < len(data) and tries > 0:
            shorter = data[:at] + data[at + size :]
            path.write_bytes(shorter)
            tries -= 1
            if outcome(path) == signature:
                data = shorter
            else:
                at += size
        size //= 2
    return data


SUFFIX = {"csv": ".csv", "parquet": ".parquet", "mcap": ".mcap", "bag": ".bag", "db3": ".db3", "ulog": ".ulg"}


class Child:
    """A process that runs cases, says in shared memory which and how they ended, and may die of one."""

    def __init__(self, reader: str, whole: Sequence[bytes], seed: int, start: int, until: float, folder: Path) -> None:
        self.shared = mmap.mmap(-1, 4096)
        self.pid = os.fork()
        if self.pid == 0:
            try:
                self._work(reader, whole, seed, start, until, folder)
            finally:
                os._exit(0)

    def _work(self, reader: str, whole: Sequence[bytes], seed: int, start: int, until: float, folder: Path) -> None:
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        counts, crashes, number = Counter[str](), dict[str, int](), start
        path = folder / f"case{SUFFIX[reader]}"
        while time.monotonic() < until:
            self._say(number, counts, crashes)
            path.write_bytes(case(reader, whole, seed, number))
            ended = outcome(path)
            counts[ended.partition(":")[0]] += 1
            if ended.startswith("crash"):
                crashes.setdefault(ended, number)
            number += 1
        self._say(-1, counts, crashes)

    def _say(self, number: int, counts: Counter[str], crashes: dict[str, int]) -> None:
        text = repr((number, dict(counts), dict(list(crashes.items())[:20]))).encode()[:4088]
        self.shared[:8], self.shared[8 : 8 + len(text)] = struct.pack("<Q", len(text)), text

    def said(self) -> tuple[int, dict[str, int], dict[str, int]]:
        """Return the case it is at (-1: done), how many ended how, and the crashes."""
        import ast

        size = struct.unpack("<Q", self.shared[:8])[0]
        if not size:
            return 0, {}, {}
        try:
            found: tuple[int, dict[str, int], dict[str, int]] = ast.literal_eval(self.shared[8 : 8 + size].decode())
        except (SyntaxError, ValueError):  # read while it was written
            return 0, {}, {}
        return found


def run(reader: str, minutes: float, seed: int, save: Path) -> int:
    """Fuzz for a time; print what ended how, keep what crashed, return how many crashes there are."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        whole = seeds(reader, folder)
        outcome(_written(folder / f"warm{SUFFIX[reader]}", whole[0]))  # imports, before children are made
        until, start = time.monotonic() + 60.0 * minutes, 0
        counts, crashes = Counter[str](), dict[str, int]()
        while time.monotonic() < until:
            number, ended, found, how = _watched(Child(reader, whole, seed, start, until, folder))
            counts.update(ended)
            crashes |= {key: value for key, value in found.items() if key not in crashes}
            if number >= 0:
                crashes.setdefault(f"crash: read: {how}", number)
                counts["crash"] += 1
            start = number + 1
        print(f"{reader}: {minutes:g} min, seed {seed}: {sum(counts.values())} cases, {dict(counts)}")
        for signature, number in crashes.items():
            data = case(reader, whole, seed, number)
            small = data if "child" in signature else minimised(data, SUFFIX[reader], signature, folder)
            save.mkdir(parents=True, exist_ok=True)
            kept = save / f"{reader}-{seed}-{number}{SUFFIX[reader]}"
            kept.write_bytes(small)
            print(f"  case {number}: {signature}; {len(small)} bytes in {kept}")
    return len(crashes)


def _watched(child: Child) -> tuple[int, dict[str, int], dict[str, int], str]:
    """Wait for a child; kill it where a case takes too long. Return the case it ended at (-1: none), and how."""
    last, since = -2, time.monotonic()
    while True:
        pid, status = os.waitpid(child.pid, os.WNOHANG)
        number, counts, crashes = child.said()
        if pid:
            died = "" if number == -1 else f"child ended with status {status}"
            return number, counts, crashes, died
        if number != last:
            last, since = number, time.monotonic()
        elif time.monotonic() - since > SECONDS:
            os.kill(child.pid, signal.SIGKILL)
            os.waitpid(child.pid, 0)
            return number, counts, crashes, f"child still busy after {SECONDS} s"
        time.sleep(0.05)


def _written(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def main() -> None:
    """Fuzz, or run one case again."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("reader", choices=sorted(SUFFIX))
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--case", type=int)
    parser.add_argument("--save", type=Path, default=CORPUS)
    told = parser.parse_args()
    if told.case is None:
        sys.exit(run(told.reader, told.minutes, told.seed, told.save) > 0)
    from attest_cli.readers import read
    from attest_cli.settings import Settings

    with tempfile.TemporaryDirectory() as name:
        whole = seeds(told.reader, Path(name))
        path = _written(Path(name) / f"case{SUFFIX[told.reader]}", case(told.reader, whole, told.seed, told.case))
        print(outcome(path))
        print(read(path, Settings()))


if __name__ == "__main__":
    main()
