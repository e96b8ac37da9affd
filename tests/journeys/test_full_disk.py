"""A full disk at each output file in turn: one line, exit 1, an older result whole, nothing half-written."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from journeys.odd_logs import Drive
from support.full_disk import TOLD

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="twins of a run need fork")


def twins(folder: Path, *arguments: str) -> list[dict[str, Any]]:
    """How a run ended at each file it writes, were the disk full there."""
    (folder.parent / TOLD).write_text("")
    done = subprocess.run(
        [sys.executable, ROOT / "tests" / "support" / "full_disk.py", folder, *arguments, "-q"],
        env={**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in (folder.parent / TOLD).read_text().splitlines()]


def held(found: list[dict[str, Any]], *names: str) -> None:
    """Each twin ended as it must, and there was one at each of these files."""
    assert {ended["file"] for ended in found} >= set(names)
    for ended in found:
        assert ended["code"] == 1, ended
        assert ended["said"].startswith("attest: "), ended
        assert ended["said"].count("\n") == 1, ended
        assert f"{ended['file']}: cannot be written: File too large; is there room" in ended["said"], ended
        assert ended["same"], ended
        assert ended["left"] == [], ended


def test_a_full_disk_leaves_the_older_result_whole(whole: Drive, tmp_path: Path) -> None:
    folder = tmp_path / "w"
    folder.mkdir()
    log = whole.span(0, 50).write(folder)
    formats = ("smooth", log.name, "--format", "parquet,csv,tum,mcap")
    tables = ("passes.parquet", "innovations.parquet", "segments.csv", "report.json")
    held(twins(folder, *formats), *tables)  # where there was none
    found = twins(folder, *formats, "--overwrite")
    held(
        found,
        *(f"track.{kind}" for kind in ("parquet", "csv", "tum", "mcap")),
        *tables,
        "report.html",
        "01-overview.png",
    )
    pages = {path.name for path in (folder / f"{log.stem}.attest").rglob("*.png")}
    assert pages == {ended["file"] for ended in found if ended["file"].endswith(".png")}
    held(twins(folder, "convert", log.name, "-o", "log.mcap"), "log.mcap")


def test_a_simulation_is_written_whole(tmp_path: Path) -> None:
    (tmp_path / "w").mkdir()
    found = twins(tmp_path / "w", "simulate", "rover", "-o", "sim", "--duration", "60")
    held(found, "sim.csv", "sim.mcap", "sim.parquet", "sim.truth.parquet", "attest.toml")


def test_an_evaluation_and_its_page_come_together(whole: Drive, tmp_path: Path, smooth: Callable[..., Any]) -> None:
    folder, result = tmp_path / "w", "drive.attest"
    folder.mkdir()
    smooth(whole.span(0, 50).write(folder), output=f"w/{result}")
    reference = ("evaluate", result, "--reference", f"{result}/track.parquet")
    held(twins(folder, *reference), "evaluation.json", "09-evaluate.png")
