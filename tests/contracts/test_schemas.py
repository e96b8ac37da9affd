"""The schemas in ``schemas/`` are what the models say, and are schemas."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import pytest

from attest_cli.commands.schemas import SCHEMAS, text


@pytest.mark.parametrize("name", sorted(SCHEMAS))
def test_a_schema_file_is_current(name: str, root: Path) -> None:
    file = root / "schemas" / f"{name}.schema.json"
    assert file.read_text(encoding="utf-8") == text(SCHEMAS[name]), "run: python -m attest_cli.commands.schemas"


def test_no_schema_file_is_left_over(root: Path) -> None:
    assert {file.name for file in (root / "schemas").iterdir()} == {f"{name}.schema.json" for name in SCHEMAS}


@pytest.mark.parametrize("name", sorted(SCHEMAS))
def test_a_schema_is_one(name: str) -> None:
    jsonschema.Draft202012Validator.check_schema(json.loads(text(SCHEMAS[name])))


def test_the_config_schema_takes_numbers_and_quantities_and_refuses_unknown_keys() -> None:
    validator = jsonschema.Draft202012Validator(json.loads(text(SCHEMAS["config"])))
    assert validator.is_valid(
        {"imu": {"gyro_noise_density": "0.3 deg/sqrt(hr)", "mounting": "auto"}, "map": {"sun": "/sun"}}
    )
    assert validator.is_valid({"imu": {"gyro_noise_density": 1e-4, "mounting": [1, 0, 0, 0]}})
    assert not validator.is_valid({"imu": {"gyro_noise": 1e-4}})
    assert not validator.is_valid({"imu": {"gyro_noise_density": -1e-4}})
    assert not validator.is_valid({"map": {"moon": "/moon"}})
