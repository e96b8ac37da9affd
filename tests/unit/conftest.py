"""Lets the tests below import the shared helpers of ``tests/support``."""

from __future__ import annotations

import sys
from pathlib import Path

TESTS = str(next(p for p in Path(__file__).resolve().parents if p.name == "tests"))
if TESTS not in sys.path:
    sys.path.append(TESTS)
