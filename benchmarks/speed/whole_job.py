"""CPU time and memory of the whole job: ``attest smooth`` as a process on a simulated drive, several runs.

    python benchmarks/speed/whole_job.py --hours 1 --rate 200 --format mcap --runs 3 [--stages]

Machines differ and are shared: quote the least of the runs, and compare only figures of one machine.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

SENSORS = "sun,magnetometer,odometry"
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # what pip installs is compiled; this tree is from its second run on


def spawned(arguments: list[str]) -> tuple[float, float]:
    """Run Python, silent; return its CPU seconds (user + system) and its largest memory, MB."""
    silent = [(os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)]
    pid = os.posix_spawn(sys.executable, [sys.executable, *arguments], os.environ, file_actions=silent)
    _, status, used = os.wait4(pid, 0)
    if os.waitstatus_to_exitcode(status) not in {0, 3}:
        sys.exit(f"python {' '.join(arguments)} failed")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def run(command: list[str]) -> tuple[float, float]:
    """Run attest; return its CPU seconds and its largest memory, MB."""
    return spawned(["-m", "attest_cli", *command])


def stages(log: Path, output: Path, runs: int) -> dict[str, float]:
    """Return the CPU seconds of every stage, the least of the runs."""
    least: dict[str, float] = {}
    for _ in range(runs):
        command = [sys.executable, str(Path(__file__).with_name("stages.py")), str(log), str(output)]
        made = subprocess.run(command, check=True, capture_output=True, text=True)
        for name, seconds in json.loads(made.stdout).items():
            least[name] = min(seconds, least.get(name, seconds))
    return least


def main() -> None:
    """Make the log, run the job, print a line per run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--rate", type=float, default=200.0)
    parser.add_argument("--format", default="mcap", choices=("csv", "mcap", "parquet"))
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--stages", action="store_true", help="a line per stage")
    wanted = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / f"drive.{wanted.format}"
        made = ["simulate", "rover", "-q", "-o", str(log), "--sensors", SENSORS]
        run([*made, "--duration", str(3600 * wanted.hours), "--rate", str(wanted.rate)])
        size = log.stat().st_size / 1e6
        print(f"{wanted.hours:g} h at {wanted.rate:g} Hz, {wanted.format}, {size:.0f} MB, sensors: imu,{SENSORS}")
        found = []
        for k in range(wanted.runs):
            cpu, memory = run(["smooth", str(log), "-q", "-o", str(Path(folder) / f"{k}.attest")])
            found.append(cpu)
            print(f"run {k + 1}: {cpu:.2f} s CPU, {memory:.0f} MB")
        print(f"least of {wanted.runs}: {min(found):.2f} s CPU")
        if wanted.stages:
            for name, seconds in stages(log, Path(folder) / "stages.attest", wanted.runs).items():
                print(f"{name:32}{seconds:8.3f}")


if __name__ == "__main__":
    main()
