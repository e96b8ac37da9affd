"""The README says what is so: its commands, options and links exist, and ``.ci/run`` runs its test command."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from attest_cli.__main__ import run
from attest_cli.app import app
from attest_cli.records import COLUMNS


@pytest.fixture(scope="module")
def readme(root: Path) -> str:
    return (root / "README.md").read_text(encoding="utf-8")


def blocks(readme: str) -> list[str]:
    return [block.strip() for block in re.findall(r"```sh\n(.*?)```", readme, re.DOTALL)]


def test_ci_runs_the_test_command_of_the_readme(root: Path, readme: str) -> None:
    command = next(block for block in blocks(readme) if "pytest" in block)
    assert "\n" not in command
    assert command in (root / ".ci" / "run").read_text(encoding="utf-8").splitlines()


def test_the_first_command_of_the_readme_smooths_a_shipped_log(root: Path, readme: str) -> None:
    command = blocks(readme)[0]
    assert command.startswith("python3 -m venv .venv && ")
    log = re.search(r"attest smooth (\S+)", command)
    assert log is not None
    assert (root / log[1]).is_file()


def commands() -> set[str]:
    """Names of the commands of the tool."""
    return {command.name or command.callback.__name__ for command in app.registered_commands if command.callback}


def test_every_command_of_the_tool_stands_in_the_readme_and_no_other(readme: str) -> None:
    table = {match[1] for match in re.finditer(r"^\| `attest ([a-z-]+)", readme, re.MULTILINE)}
    assert table == commands()


def test_every_option_of_the_readme_exists(readme: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert [run([command, "--help"]) for command in sorted(commands())] == [0] * len(commands())
    helps = capsys.readouterr().out
    named = set(re.findall(r"`(--[a-z-]+)", readme)) - {"--version"}
    assert named
    assert {option for option in named if option not in helps} == set()


def test_links_of_the_readme_lead_somewhere(root: Path, readme: str) -> None:
    links = [link for link in re.findall(r"\]\(([^)#]+)\)", readme) if "://" not in link]
    assert links
    assert [link for link in links if not (root / link).exists()] == []


def test_the_config_of_the_readme_is_valid(root: Path, readme: str, tmp_path: Path) -> None:
    from attest_cli.settings import load_settings

    config = tmp_path / "attest.toml"
    config.write_text(re.findall(r"```toml\n(.*?)```", readme, re.DOTALL)[0], encoding="utf-8")
    assert load_settings(config, None, {}).sources


def test_the_changelog_knows_this_version(root: Path) -> None:
    from attest_cli import __version__

    assert f"## [{__version__}]" in (root / "CHANGELOG.md").read_text(encoding="utf-8")


def test_the_columns_of_the_readme_are_those_of_every_role(readme: str) -> None:
    table = re.search(r"### Columns\n(.*?)\n## ", readme, re.DOTALL)
    assert table is not None
    rows = re.findall(r"^\| (\w+) \| (.*?) \|", table[1], re.MULTILINE)
    named = {role: re.findall(r"`(\w+)`", columns) for role, columns in rows if role not in {"role", "time"}}
    assert {"gyro", "accel"} | named.keys() == COLUMNS.keys()
    assert all(columns[: len(COLUMNS[role])] == list(COLUMNS[role]) for role, columns in named.items())
