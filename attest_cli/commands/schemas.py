"""``python -m attest_cli.commands.schemas FOLDER``: write the JSON Schemas of the settings, of files and reports."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path

from pydantic import BaseModel

from ..report.evaluation import EvaluationReport
from ..report.model import Report, TrackRow
from ..settings import Settings
from ..settings.calibration import CalibrationFile

SCHEMAS: Mapping[str, type[BaseModel]] = {
    "calibration": CalibrationFile,
    "config": Settings,
    "evaluation": EvaluationReport,
    "report": Report,
    "track": TrackRow,
}


def text(model: type[BaseModel]) -> str:
    """The schema of a model as it stands in its file."""
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **model.model_json_schema()}
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"


def write(folder: Path) -> list[Path]:
    """Write every schema into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for name, model in SCHEMAS.items():
        files.append(folder / f"{name}.schema.json")
        files[-1].write_text(text(model), encoding="utf-8")
    return files


if __name__ == "__main__":
    write(Path(sys.argv[1] if len(sys.argv) > 1 else "schemas"))
