"""A result folder appears whole, replaces only what is one, and its faults name the place that was asked for."""

from __future__ import annotations

from pathlib import Path

import pytest

from attest_cli.errors import AttestError
from attest_cli.writers.files import atomic_write
from attest_cli.writers.folder import result_folder

REPORT = '{\n "attest_version": "0.1.0"\n}\n'


def names(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def filled(folder: Path, *more: str) -> None:
    for name in ("report.json", *more):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(REPORT if name == "report.json" else name)


def test_it_appears_when_all_is_written(tmp_path: Path) -> None:
    output = tmp_path / "deep" / "drive.attest"
    with result_folder(output) as folder:
        filled(folder, "report/01-overview.png")
        assert not output.exists()
    assert names(tmp_path) == {"deep/drive.attest/report.json", "deep/drive.attest/report/01-overview.png"}


def test_an_older_result_is_replaced_and_what_is_not_ours_stays(tmp_path: Path) -> None:
    filled(tmp_path / "r", "track.csv", "report/09-old.png", "notes.txt", "report/mine.png")
    with result_folder(tmp_path / "r", overwrite=True) as folder:
        filled(folder, "track.parquet")
    assert names(tmp_path / "r") == {"report.json", "track.parquet", "notes.txt", "report/mine.png"}
    assert [path.name for path in tmp_path.iterdir()] == ["r"]


@pytest.mark.parametrize("content", [None, "{}", '{"test": "report of another tool"}'])
def test_a_folder_that_is_no_result_is_not_written_to(tmp_path: Path, content: str | None) -> None:
    (tmp_path / "src").mkdir()
    (tmp_path / "src" / "track.csv").write_text("precious")
    if content is not None:
        (tmp_path / "src" / "report.json").write_text(content)
    before = names(tmp_path)
    with (
        pytest.raises(AttestError, match=r"src: holds files, but no report\.json of attest"),
        result_folder(tmp_path / "src", overwrite=True),
    ):
        pytest.fail("nothing may be written")
    assert names(tmp_path) == before


@pytest.mark.parametrize("overwrite", [False, True])
def test_faults_name_the_place_that_was_asked_for(tmp_path: Path, overwrite: bool) -> None:
    output = tmp_path / "drive.attest"
    if overwrite:
        filled(output)
    with (
        pytest.raises(AttestError, match="cannot be written: No space left") as fault,
        result_folder(output, overwrite=overwrite) as folder,
        atomic_write(folder / "track.parquet"),
    ):
        raise OSError(28, "No space left on device")
    assert fault.value.message.startswith(f"{output}/track.parquet: ")
    assert "tmp" not in fault.value.message.removeprefix(str(tmp_path))
    assert names(tmp_path) == ({"drive.attest/report.json"} if overwrite else set())


def test_a_result_that_appears_meanwhile_is_kept(tmp_path: Path) -> None:
    output = tmp_path / "r"
    slow, fast = result_folder(output), result_folder(output)
    for run in (slow, fast):
        filled(run.__enter__(), f"track.{'csv' if run is slow else 'parquet'}")
    fast.__exit__(None, None, None)
    with pytest.raises(AttestError, match="exists already"):
        slow.__exit__(None, None, None)
    assert names(tmp_path) == {"r/report.json", "r/track.parquet"}


def test_a_link_within_a_result_leads_nowhere(tmp_path: Path) -> None:
    filled(tmp_path / "r", "track.csv")
    elsewhere, victim = tmp_path / "elsewhere", tmp_path / "victim"
    filled(elsewhere, "01-overview.png")
    victim.write_text("precious")
    (tmp_path / "r" / "report").symlink_to(elsewhere)
    (tmp_path / "r" / "segments.csv").symlink_to(victim)
    with result_folder(tmp_path / "r", overwrite=True) as folder:
        filled(folder, "report/01-overview.png", "segments.csv")
    assert (elsewhere / "01-overview.png").read_text() == "01-overview.png"
    assert victim.read_text() == "precious"
    assert (tmp_path / "r" / "report" / "01-overview.png").read_text() == "report/01-overview.png"


def test_folders_made_on_the_way_go_with_a_result_that_failed(tmp_path: Path) -> None:
    (tmp_path / "kept").mkdir()
    with pytest.raises(ZeroDivisionError), result_folder(tmp_path / "kept" / "new" / "deep" / "r"):
        _ = 1 / 0
    assert [path.name for path in tmp_path.rglob("*")] == ["kept"]
