"""Memory of long logs: what the C library and Arrow keep of what was freed."""

from __future__ import annotations

import ctypes
import sys
from contextlib import suppress

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, KEPT_BYTES = -1, -3, 1 << 23  # malloc.h; what is larger is a column of a long log


def keep_memory() -> None:
    """Ask the C library to keep freed arrays for the next ones: page faults cost a tenth of a long log's time."""
    with suppress(OSError, AttributeError):  # not glibc
        libc = ctypes.CDLL(None)
        libc.mallopt(M_MMAP_THRESHOLD, KEPT_BYTES)
        libc.mallopt(M_TRIM_THRESHOLD, 2 * KEPT_BYTES)


def give_back() -> None:
    """Let Arrow's pool and the C library give back what was read into; freed, it is up to a quarter of a long log."""
    arrow = sys.modules.get("pyarrow")
    if arrow is not None:
        arrow.default_memory_pool().release_unused()
    with suppress(OSError, AttributeError):  # not glibc
        ctypes.CDLL(None).malloc_trim(0)
