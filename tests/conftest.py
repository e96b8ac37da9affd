"""What all tests share: fixed seeds, the folder of real data, a clean terminal."""

from __future__ import annotations

import gc
import os
import random
from collections.abc import Generator
from pathlib import Path

import hypothesis
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]

hypothesis.settings.register_profile("attest", derandomize=True, deadline=None, max_examples=60)
hypothesis.settings.load_profile("attest")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Keep the thousands of tests and modules out of every later garbage collection: none of them is garbage."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.fixture(autouse=True)
def _seeded() -> None:
    random.seed(1999)
    np.random.seed(1999)  # noqa: NPY002 (libraries that still use the global state)


@pytest.fixture(scope="session")
def root() -> Path:
    """Root of the repository."""
    return ROOT


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real logs: ``../shared/data``, or ``ATTEST_SHARED``. Tests skip where it is absent."""
    folder = Path(os.environ.get("ATTEST_SHARED", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip("no real data here: ../shared/data is absent and ATTEST_SHARED is not set")
    return folder


@pytest.fixture
def rng() -> np.random.Generator:
    """A seeded generator of its own for each test."""
    return np.random.default_rng(1999)
