"""The graded table of faulty logs: ``benchmarks/faulty_logs.py [PATTERN] [--seeds 1,2,3]``; exit 1 on any bad grade."""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from faults.catalogue import FAULTS
from support.faults import GRADES_BAD, grade


def main() -> int:
    """Grade every fault on every seed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pattern", nargs="?", default="", help="regular expression of the names")
    parser.add_argument("--seeds", default="1,2,3")
    chosen = parser.parse_args()
    counts = Counter[str]()
    print(f"{'fault':42s} seed {'grade':14s} {'verdict':7s} {'ratio':>6s}  said")
    for name in (n for n in FAULTS if re.search(chosen.pattern, n)):
        for seed in map(int, chosen.seeds.split(",")):
            with tempfile.TemporaryDirectory() as folder:
                found = grade(FAULTS[name], seed, Path(folder) / "log")
            counts[found.grade] += 1
            said = ", ".join(found.said) or found.line[:120]
            print(
                f"{name:42s} {seed:4d} {found.grade:14s} {found.verdict:7s} {found.ratio:6.2f}  {said}",
                flush=True,
            )
    print(", ".join(f"{count} {name}" for name, count in counts.most_common()))
    return int(any(counts[name] for name in GRADES_BAD))


if __name__ == "__main__":
    sys.exit(main())
