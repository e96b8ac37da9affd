"""What the main job may not load: each costs a tenth of a second or more at every start."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from attest_cli import pipeline

FORBIDDEN = ("pandas", "scipy.signal", "scipy.optimize", "scipy.stats", "matplotlib.pyplot", "pyarrow.dataset")


@pytest.mark.parametrize("suffix", [".parquet", ".mcap"])
def test_the_main_job_loads_only_what_it_needs(tmp_path: Path, suffix: str) -> None:
    log = tmp_path / f"log{suffix}"
    pipeline.simulate("rover", log, {"duration_s": 60.0, "rate_hz": 20.0, "odometry": True})
    code = (
        "import sys\n"
        "from attest_cli.__main__ import run\n"
        f"code = run(['smooth', {str(log)!r}, '-q', '-o', {str(tmp_path / 'result')!r}])\n"
        f"print(code, sorted(set({FORBIDDEN!r}) & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "0 []", done.stderr
