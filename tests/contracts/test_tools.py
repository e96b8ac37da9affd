"""The tree passes its own tools: lint, types, and the order of imports."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

TOOLS = {
    "ruff": [sys.executable, "-m", "ruff", "check", "--quiet", "--output-format=concise", "."],
    "mypy": [sys.executable, "-m", "mypy", "--no-error-summary"],
    "import-linter": [
        sys.executable,
        "-c",
        "from importlinter.cli import lint_imports_command; lint_imports_command()",
    ],
}


@pytest.mark.tools
@pytest.mark.parametrize("name", sorted(TOOLS))
def test_tool(name: str, root: Path) -> None:
    done = subprocess.run(TOOLS[name], capture_output=True, text=True, cwd=root, check=False)
    assert done.returncode == 0, f"{done.stdout}{done.stderr}"
