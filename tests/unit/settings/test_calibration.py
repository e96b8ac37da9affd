"""The calibration file as it is read: what is refused, and in which words."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.calibrations import bias, calibration

from attest_cli.errors import AttestError
from attest_cli.settings.calibration import read_calibration, rms
from attest_cli.writers.calibration import write_calibration

THREE = [bias("constant", [0.001])] * 3


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "calibration.toml"
    write_calibration(calibration(THREE), path)
    return path


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("rate_hz = 100.0", "rate_hz = -1.0", "source.rate_hz: input should be greater than 0"),
        ("noise_density = 0.00015", "noise_density = nan", "gyro.x.noise.noise_density"),
        ("noise_density = 0.00015", 'noise_density = "loud"', "gyro.x.noise.noise_density: input should be a valid"),
        ('model = "constant"', 'model = "cubic"', "gyro.x.bias.model: input should be 'constant', 'ramp'"),
        ("values = [0.001]", "values = [0.001, 2.0]", "1 names need 1 values and a covariance of 1 rows and columns"),
        ("static = true", "statik = true", "source.static: field required (and 1 more)"),
        ("[gyro.z.bias]", "[gyro.w.bias]", "gyro.z.bias: field required (and 1 more)"),
        ("static = true", "static = ", "is not TOML"),
    ],
)
def test_a_file_that_is_not_right_is_one_line(file: Path, old: str, new: str, says: str) -> None:
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(AttestError) as fault:
        read_calibration(file)
    assert str(fault.value).startswith(f"{file}")
    assert says in str(fault.value)
    assert "\n" not in str(fault.value)


def test_other_toml_is_no_calibration(tmp_path: Path) -> None:
    path = tmp_path / "attest.toml"
    path.write_text('[imu]\nchannel = "/imu"\n', encoding="utf-8")
    with pytest.raises(AttestError, match="not a calibration: source: field required"):
        read_calibration(path)
    with pytest.raises(AttestError, match="no such file"):
        read_calibration(tmp_path / "none.toml")


@pytest.mark.parametrize(
    "wrong",
    [
        {"matrix": ((-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), "bias": (0.0, 0.0, 0.0)},
        {"matrix": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))},
    ],
)
def test_a_correction_no_sensor_needs_or_half_of_one_is_refused(wrong: dict[str, object]) -> None:
    noise = calibration(THREE).gyro.x.noise.model_dump()
    with pytest.raises(ValueError, match=r"within 0\.5 of the identity|belong together"):
        calibration(THREE, accelerometer={"x": noise, "y": noise, "z": noise, **wrong})


def test_the_rms_of_one_value_is_it() -> None:
    assert rms([3.0]) == 3.0
    assert rms([3.0, 4.0, 0.0]) == pytest.approx(5.0 / 3.0**0.5)
