"""A file is whole or absent, whatever happens while it is written."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from attest_cli.errors import AttestError
from attest_cli.writers.files import atomic_write, check_output, write_csv_rows, write_table


def test_the_name_appears_only_when_all_is_written(tmp_path: Path) -> None:
    path = tmp_path / "track.csv"
    with atomic_write(path) as temporary:
        temporary.write_text("whole")
        assert not path.exists()
        assert temporary.parent == tmp_path
    assert path.read_text() == "whole"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_an_interrupt_leaves_the_old_file_and_nothing_else(tmp_path: Path, error: type[BaseException]) -> None:
    path = tmp_path / "track.csv"
    path.write_text("old")

    def interrupted() -> None:
        with atomic_write(path) as temporary:
            temporary.write_text("half")
            raise error

    with pytest.raises(error):
        interrupted()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_is_replaced_and_its_target_kept(tmp_path: Path) -> None:
    target, link = tmp_path / "target", tmp_path / "link"
    target.write_text("precious")
    link.symlink_to(target)
    with atomic_write(link) as temporary:
        temporary.write_text("new")
    assert target.read_text() == "precious"
    assert link.read_text() == "new"
    assert not link.is_symlink()


def test_a_folder_that_cannot_be_written_to_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(AttestError, match="cannot be written"), atomic_write(tmp_path / "absent" / "x") as temporary:
        temporary.write_text("x")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs a limit on file sizes")
def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path: Path) -> None:
    script = f"""
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
import numpy as np
from pathlib import Path
from attest_cli.errors import AttestError
from attest_cli.writers.files import write_table
resource.setrlimit(resource.RLIMIT_FSIZE, (65536, 65536))
try:
    write_table({{"x": np.random.default_rng(0).normal(size=100_000)}}, Path({str(tmp_path / "x.parquet")!r}))
except AttestError as error:
    print(error)
    sys.exit(1)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr
    assert "cannot be written" in done.stdout
    assert list(tmp_path.iterdir()) == []


def test_existing_outputs_and_inputs_are_refused(tmp_path: Path) -> None:
    path, log = tmp_path / "out.csv", tmp_path / "log.csv"
    check_output(path, inputs=[log])
    path.write_text("x")
    with pytest.raises(AttestError, match="exists already") as refused:
        check_output(path)
    assert "--overwrite" in refused.value.hint
    check_output(path, overwrite=True)
    with pytest.raises(AttestError, match="same file"):
        check_output(path, overwrite=True, inputs=[tmp_path / "." / "out.csv"])
    with pytest.raises(AttestError, match="is not a folder"):
        check_output(path / "inside")


def test_a_link_to_nowhere_is_no_output(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("nowhere")
    with pytest.raises(AttestError, match="link: a link to nowhere, which does not exist"):
        check_output(tmp_path / "link", overwrite=True)


def test_an_empty_folder_is_free_and_a_filled_one_is_not(tmp_path: Path) -> None:
    folder = tmp_path / "log.attest"
    folder.mkdir()
    check_output(folder)
    (folder / "report.json").write_text("{}")
    with pytest.raises(AttestError, match="exists already"):
        check_output(folder)


def test_a_folder_without_permission_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda path, _: Path(path) != tmp_path)  # root may write anywhere
    with pytest.raises(AttestError, match="cannot be written to"):
        check_output(tmp_path / "new" / "deep")


def test_tables_hold_numbers_lists_text_and_metadata(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    columns = {
        "n": np.arange(3),
        "f": np.array([0.1, np.nan, 3e-300]),
        "c": np.arange(6.0).reshape(3, 2),
        "s": np.array(["a", "ü", ""]),
    }
    write_table(columns, path, {"frame": "enu"})
    table = pq.read_table(path)
    assert table.column("n").to_pylist() == [0, 1, 2]
    assert table.column("c").to_pylist() == [[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]]
    assert table.column("s").to_pylist() == ["a", "ü", ""]
    assert table.column("f")[2].as_py() == 3e-300
    assert table.schema.metadata[b"frame"] == b"enu"
    again = tmp_path / "again.parquet"
    write_table(columns, again, {"frame": "enu"})
    assert again.read_bytes() == path.read_bytes()


def test_cells_are_exact_blank_or_harmless(tmp_path: Path) -> None:
    path = tmp_path / "s.csv"
    rows = [
        {"a": 0.1 + 0.2, "b": None, "c": "=1+1", "d": np.int64(7)},
        {"a": float("nan"), "b": -1.5, "c": "a,b", "d": True},
    ]
    write_csv_rows(rows, path)
    assert path.read_text() == 'a,b,c,d\n0.30000000000000004,,\'=1+1,7\n,-1.5,"a,b",true\n'
    write_csv_rows([], path, columns=["a", "b"])
    assert path.read_text() == "a,b\n"
