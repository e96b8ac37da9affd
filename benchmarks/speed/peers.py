"""attest and its peers on the same logs in the same run: a table with the ratio to each peer, a picture of both costs.

    python benchmarks/speed/peers.py [--long] [--runs 3] [--logs DIR] [--output docs]

Makes simulated drives of 1 min, 10 min and 1 h (``--long``: 6 h and 24 h too; making them takes longer than all else),
runs each job in a process of its own and takes the least CPU time (user + system) of the runs. Peers that are not
installed are left out (``pip install attest-cli[benchmarks]``). What a peer needs is the same for every sample, so a
slow one gets a short log. Writes ``speed.md`` and ``pictures/speed.png``.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from itertools import pairwise
from pathlib import Path

from whole_job import SENSORS, run, spawned, stages

RATE_HZ, LENGTHS_S = 200, (60, 600, 3600)  # in MCAP
WHOLE_RUNS = 2  # times as many of the whole job, before the peers and after them: a shared machine has slow minutes
LONG_HZ, LONG_S = 100, (3600, 21600, 86400)  # in Parquet: what writes MCAP takes a quarter of an hour for a day
SMOOTHER = ("observe", "nodes", "forward", "backward", "full rate")
"""Stages from preintegration to full-rate attitude, sigma included."""


@dataclass(frozen=True)
class Peer:
    """A peer: its job, its module and distribution, the longest log it gets, what it gives."""

    job: str
    module: str
    distribution: str
    most_s: int
    gives: str
    reads: bool = False


PEERS = (
    Peer("vqf", "vqf", "vqf", 3600, "offlineVQF 9D (C++), smoothed, no sigma"),
    Peer("imufusion", "imufusion", "imufusion", 3600, "complementary filter (C), causal, no sigma"),
    Peer("gtsam", "gtsam", "gtsam", 3600, "batch, Rot3 at 10 Hz (C++), sigma"),
    Peer("filterpy", "filterpy", "filterpy", 3600, "Kalman filter + RTS, sigma"),
    Peer("simdkalman", "simdkalman", "simdkalman", 3600, "Kalman filter + smoother, constant matrices, sigma"),
    Peer("ahrs", "ahrs", "ahrs", 600, "EKF, causal, no sigma"),
    Peer("rosbags", "rosbags", "rosbags", 3600, "an object a message", reads=True),
    Peer("mcap-ros2-support", "mcap_ros2", "mcap-ros2-support", 3600, "an object a message", reads=True),
    Peer("roboto-mcap-codec", "mcap_codec", "roboto-mcap-codec", 3600, "Arrow batches (Rust)", reads=True),
    Peer("zstandard", "zstandard", "zstandard", 3600, "the chunks unpacked, nothing read in them", reads=True),
)


@dataclass(frozen=True)
class Row:
    """One line of the table: CPU seconds for so many samples (messages for readers), attest's for the same."""

    name: str
    length_s: int
    seconds: float
    attest_seconds: float
    rows: int
    inclination_deg: float | None
    gives: str
    reads: bool

    def cost(self) -> tuple[str, str, str]:
        """Return microseconds of both and their ratio."""
        each = 1e6 / self.rows
        ratio = f"{self.seconds / self.attest_seconds:.2g}"
        return f"{self.seconds * each:.3g}", f"{self.attest_seconds * each:.3g}", ratio


Whole = dict[int, tuple[float, float]]
"""Length of the log, s -> CPU seconds, MB."""
Spent = dict[int, dict[str, float]]
"""Length of the log, s -> CPU seconds of each stage."""


def made(folder: Path, length_s: int, suffix: str = ".mcap", rate_hz: int = RATE_HZ) -> Path:
    """Return the simulated drive of a length, made where it is not there yet."""
    log = folder / str(length_s) / f"drive{suffix}"
    if not log.exists():
        log.parent.mkdir(parents=True, exist_ok=True)
        drive = ["simulate", "rover", "-q", "-o", str(log), "--sensors", SENSORS, "--overwrite"]
        run([*drive, "--duration", str(length_s), "--rate", str(rate_hz)])
    return log


def whole_job(log: Path, out: Path, runs: int) -> tuple[float, float]:
    """Return the least CPU seconds and the most memory, MB, of runs of the whole job."""
    found = [run(["smooth", str(log), "-q", "--overwrite", "-o", str(out)]) for _ in range(runs)]
    return min(found)[0], max(memory for _, memory in found)


def job(name: str, log: Path, runs: int) -> dict[str, float]:
    """Return what a peer's job prints, of the run with the least CPU seconds."""
    command = [sys.executable, str(Path(__file__).with_name("peer_jobs.py")), name, str(log)]
    found = [
        json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout) for _ in range(runs)
    ]
    best: dict[str, float] = min(found, key=lambda spent: spent["seconds"])
    return best


def ours(log: Path, out: Path, runs: int) -> tuple[dict[str, float], tuple[float, float]]:
    """Return the stages and the whole job of attest."""
    return stages(log, out, runs), whole_job(log, out, WHOLE_RUNS * runs)


def against(peer: Peer, length: int, found: dict[str, float], spent: Spent) -> Row:
    """Hold what a peer's job printed of the longest log it gets against the same part of attest's."""
    mine = spent[length]["read"] if peer.reads else sum(spent[length].get(name, 0.0) for name in SMOOTHER)
    name = f"{peer.distribution} {version(peer.distribution)}"
    inclination = found.get("inclination_deg")
    return Row(name, length, found["seconds"], mine, int(found["rows"]), inclination, peer.gives, peer.reads)


def starts(log: Path, runs: int) -> list[tuple[str, float]]:
    """Return what starting costs: a bare typer program with one option, ``attest --help``, ``attest info``."""
    bare = "import typer; app = typer.Typer(); app.command()(lambda: None); app(['--help'])"
    jobs = {"bare typer program, `--help`": ["-c", bare], "`attest --help`": ["-m", "attest_cli", "--help"]}
    jobs[f"`attest info`, {span(int(log.parent.name))}"] = ["-m", "attest_cli", "info", str(log)]
    return [(name, min(spawned(command)[0] for _ in range(runs))) for name, command in jobs.items()]


def span(length_s: int) -> str:
    """Return a length in words."""
    return f"{length_s // 3600} h" if length_s >= 3600 else f"{length_s // 60} min"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table, numbers to the right."""
    marks = ["--:" if cell[:1].isdigit() else "---" for cell in next(iter(rows))]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, marks, *rows)) + "\n"


def long_table(jobs: Whole) -> str:
    """Return the table of long logs: CPU, what each hour more costs, memory."""
    more = ["", *(f"{(jobs[b][0] - jobs[a][0]) / (b - a) * 3600:.2f}" for a, b in pairwise(jobs))]
    lines = [
        ("CPU, s", *(f"{cpu:.1f}" for cpu, _ in jobs.values())),
        ("each hour more, s", *more),
        ("memory, MB", *(f"{used:.0f}" for _, used in jobs.values())),
    ]
    return table((f"whole job, {LONG_HZ} Hz, Parquet", *map(span, jobs)), lines)


def page(rows: Sequence[Row], whole: Whole, spent: Spent, started: Sequence[tuple[str, float]], long: Whole) -> str:
    """Return the page with all tables."""
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    head = f"""# Speed

`python benchmarks/speed/peers.py{" --long" * bool(long)}` makes this page ({machine}; CPU time, user + system,
the least of the runs; attest runs before the peers and after them, {WHOLE_RUNS} times as often in the whole job;
ratios below 1.3 are undecided). The log: `attest simulate rover`, {RATE_HZ} Hz IMU, {SENSORS.replace(",", ", ")};
ROS 2 MCAP in zstd. (The log states that its gyro has no scale error. Where nothing is
stated the filter runs once more to look for one: 0.2 s an hour.) Smoothers get arrays,
and only their own work counts; attest's is from preintegration to full-rate attitude with its sigma. Readers make
objects or arrays of all messages; attest's is its read stage, the first in the process. `ratio` is the peer's cost over
attest's.

![cost and memory against length](pictures/speed.png)
"""
    smoothers = [
        (r.name, span(r.length_s), *r.cost(), f"{r.inclination_deg:.2g}", r.gives) for r in rows if not r.reads
    ]
    readers = [(r.name, span(r.length_s), *r.cost(), r.gives) for r in rows if r.reads]
    spans, jobs = list(map(span, whole)), list(whole.values())
    names = [name for name in next(iter(spent.values())) if not name.startswith("page") and name != "whole"]
    parts = [
        table(("smoother", "log", "µs a sample", "attest", "ratio", "inclination, ° rms", "gives"), smoothers),
        table(("reader", "log", "µs a message", "attest", "ratio", "gives"), readers),
        table(
            ("whole job", *spans),
            [("CPU, s", *(f"{cpu:.2f}" for cpu, _ in jobs)), ("memory, MB", *(f"{used:.0f}" for _, used in jobs))],
        ),
        *([long_table(long)] if long else []),
        table(("start", "CPU, s"), [(name, f"{cpu:.2f}") for name, cpu in started]),
        table(("stage, CPU s", *spans), [(n, *(f"{s.get(n, 0.0):.3f}" for s in spent.values())) for n in names]),
    ]
    return "\n".join([head, *parts])


def draw(path: Path, rows: Sequence[Row], whole: Whole, spent: Spent, long: Whole) -> None:
    """Draw cost and memory against length, peers as what their cost a sample comes to, and the ratio to each."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from attest_cli.figures.style import THEMES

    ink = THEMES["light"]
    figure = Figure(figsize=(8.0, 8.4), layout="constrained", dpi=130)
    FigureCanvasAgg(figure)
    cost, memory, ratio = figure.subplots(3, 1, height_ratios=(2, 1, 1.3))
    hours = [length / 3600 for length in whole]
    jobs = (whole, "o-", "attest, whole job"), (long, "s-", f"the same, {LONG_HZ} Hz, Parquet")
    for found, mark, name in jobs:
        at = [length / 3600 for length in found]
        cost.plot(at, [cpu for cpu, _ in found.values()], mark, color=ink["text"], lw=2, ms=4, label=name)
        memory.plot(at, [used for _, used in found.values()], mark, color=ink["text"], lw=2, ms=4)
    for name, names, mark in (("smoothing", SMOOTHER, "-"), ("reading", ("read",), "--")):
        of_stages = [sum(found.get(stage, 0.0) for stage in names) for found in spent.values()]
        cost.plot(hours, of_stages, mark, color=ink["text"], lw=1.5, label=f"attest, {name}")
    for k, row in enumerate(rows):
        per_hour = row.seconds / row.length_s * 3600
        label = f"{row.name}{', reading' if row.reads else ''}"
        colour = mpl.colormaps["tab10"](k)
        cost.plot(hours, [per_hour * h for h in hours], "--" if row.reads else "-", color=colour, lw=1, label=label)
    named = {f"{row.name}{', reading' if row.reads else ''}": row.seconds / row.attest_seconds for row in rows}
    ratio.barh(list(named), list(named.values()), color=mpl.colormaps["tab10"](range(len(named))))
    ratio.axvline(1.0, color=ink["text"], lw=1)
    ratio.invert_yaxis()
    ratio.set(xscale="log", xlabel="CPU of the peer over that of attest for the same part of the job")
    cost.set(xscale="log", yscale="log", ylabel="CPU, s", title="cost (peers: reading or smoothing alone)")
    memory.set(xscale="log", xlabel="log, h", ylabel="peak memory, MB", ylim=(0.0, None))
    cost.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, fontsize=8)
    cost.sharex(memory)
    for axes in (cost, memory, ratio):
        axes.grid(color=ink["grid"], lw=0.6)
        axes.set_axisbelow(True)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, facecolor=ink["paper"], metadata={"Software": None})


def measured(folder: Path, lengths: Sequence[int], runs: int) -> tuple[list[Row], Whole, Spent]:
    """Run everything: attest, the peers, and attest again, for a shared machine has slow minutes."""
    logs = {length: made(folder, length) for length in lengths}
    out = folder / "speed.attest"
    before = {length: ours(log, out, runs) for length, log in logs.items()}
    found = {}
    for peer in PEERS:
        try:
            version(peer.distribution)
        except PackageNotFoundError:
            print(f"{peer.distribution}: not installed, left out")
            continue
        length = max(length for length in logs if length <= peer.most_s)
        found[peer] = length, job(peer.job, logs[length], runs)
        print(peer.distribution, found[peer], flush=True)
    whole: Whole = {}
    spent: Spent = {}
    for length, log in logs.items():
        (spent[length], first), (again, last) = before[length], ours(log, out, runs)
        spent[length] = {name: min(seconds, again.get(name, seconds)) for name, seconds in spent[length].items()}
        whole[length] = min(first[0], last[0]), max(first[1], last[1])
    return [against(peer, *ran, spent) for peer, ran in found.items()], whole, spent


def main() -> None:
    """Run the benchmark and write its page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--long", action="store_true", help="6 h and 24 h too, in Parquet")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--logs", type=Path, help="folder that keeps the logs")
    parser.add_argument("--output", type=Path, default=Path("docs"))
    wanted = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = wanted.logs or Path(scratch)
        rows, whole, spent = measured(folder, LENGTHS_S, wanted.runs)
        started = starts(made(folder, LENGTHS_S[-1]), 2 * wanted.runs)
        long = {
            length: whole_job(made(folder / "long", length, ".parquet", LONG_HZ), folder / "speed.attest", wanted.runs)
            for length in (LONG_S if wanted.long else ())
        }
    wanted.output.mkdir(parents=True, exist_ok=True)
    (wanted.output / "speed.md").write_text(page(rows, whole, spent, started, long), encoding="utf-8")
    draw(wanted.output / "pictures" / "speed.png", rows, whole, spent, long)


if __name__ == "__main__":
    main()
