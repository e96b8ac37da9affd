"""Tables that are refused for what is wrong with them: header and rows, names, the unit of time; Latin-1 units."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from attest_cli.errors import AttestError
from attest_cli.pipeline import read
from attest_cli.readers.dialect import HEAD_BYTES, head_lines, sniff
from attest_cli.settings import Settings

NAMES = "gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z"
STEP_NS = 10_000_000


def rows(n: int = 400, step: float = STEP_NS) -> list[str]:
    table = np.random.default_rng(1).normal([0.1, 0.2, 0.3, 1.5, 2.5, 9.4], 0.01, (n, 6))
    return [f"{k * step:.0f}," + ",".join(f"{x:.5f}" for x in row) for k, row in enumerate(table)]


def written(folder: Path, header: str, lines: list[str], encoding: str = "utf-8") -> Path:
    path = folder / "log.csv"
    path.write_bytes(("\n".join([header, *lines]) + "\n").encode(encoding))
    return path


@pytest.mark.parametrize(("header", "lines", "told", "hint"), [
    (f"timestamp_ns,{NAMES},{','.join(f'c{k}' for k in range(3000))}", rows(), "names 3007 columns", "one name"),
    (f"timestamp_ns,{NAMES}", [line.replace(".", ",") for line in rows()], "but line 2 has 13 cells", "decimal commas"),
    ("timestamp_ns,x,y,z,x,y,z", rows(), "'x' appears more than once", "gyro_x"),
    (f"timestamp_ns,{NAMES}", rows(step=10), "over 4e-06 s", "--time-unit"),
    (f"timestamp_ns,{NAMES}", rows(100), "only 100 usable IMU rows over 0.99 s", "2 s"),
])  # fmt: skip
def test_the_reason_is_told(tmp_path: Path, header: str, lines: list[str], told: str, hint: str) -> None:
    with pytest.raises(AttestError) as refused:
        read([written(tmp_path, header, lines)], Settings())
    assert told in refused.value.message
    assert hint in refused.value.hint
    assert ("--time-unit" in refused.value.hint) == (hint == "--time-unit")


@pytest.mark.parametrize("count", [50, 3000])
@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
def test_micro_is_micro_in_either_encoding_however_long_the_file(tmp_path: Path, encoding: str, count: int) -> None:
    path = written(
        tmp_path, "timestamp_ns,gyro_x,gyro_y,gyro_z,mag_x [µT],mag_y [µT],mag_z [µT]", rows(count), encoding
    )
    assert sniff(path).names[4] == "mag_x [µT]"


@pytest.mark.parametrize("before", range(3))
def test_a_character_cut_at_the_end_of_the_head_is_no_latin(tmp_path: Path, before: int) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(b"x" * before + "µ\n".encode() * HEAD_BYTES)
    assert set(head_lines(path)[1:]) == {"µ"}


def test_repeated_axes_beside_named_sensors_are_read(tmp_path: Path) -> None:
    path = written(tmp_path, f"timestamp_ns,{NAMES},x,y,z,x,y,z", [f"{line},1,2,3,4,5,6" for line in rows()])
    assert read([path], Settings())[1].imu.t.size == 400
