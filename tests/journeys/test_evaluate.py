"""A user holds a result against its truth: numbers, files, formats, options, and what is refused."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr
from io import StringIO
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from journeys.conftest import Outcome
from journeys.odd_logs import judged, quaternions, read_track, sample_drive
from PIL import Image

from attest_cli.__main__ import run
from attest_cli.figures.words import percent

Attest = Callable[..., Outcome]


@pytest.fixture(scope="module")
def result(samples: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The shipped drive, smoothed once, with its track in every format."""
    folder = tmp_path_factory.mktemp("evaluate") / "rover.attest"
    with redirect_stderr(StringIO()), pytest.MonkeyPatch.context() as patch:
        patch.setattr("attest_cli.pipeline.write_pages", lambda *_: [])
        arguments = ["smooth", str(samples / "rover.parquet"), "-o", str(folder), "--format", "parquet,csv,tum,mcap"]
        assert run(arguments) == 0
    yield folder
    shutil.rmtree(folder.parent)


@pytest.fixture
def evaluate(
    attest: Attest, samples: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., dict[str, Any]]:
    """Evaluate into a folder of this test, its page undrawn; what ``--json`` prints."""
    monkeypatch.setattr("attest_cli.figures.page.Page.png", lambda _: b"")

    def command(track: Path, *options: object, reference: Path = samples / "rover.truth.parquet") -> dict[str, Any]:
        done = attest("evaluate", track, "--reference", reference, "-o", tmp_path / "out", "--overwrite", "--json",
                      *options)  # fmt: skip
        assert done.code == 0, done.err
        found: dict[str, Any] = json.loads(done.out)
        assert found == json.loads((tmp_path / "out" / "evaluation.json").read_text(encoding="utf-8"))
        return found

    return command


def rms(found: dict[str, Any], kind: str = "attitude") -> dict[str, float]:
    return {name: stats["rms"] for name, stats in found[kind]["errors"].items()}


def test_the_numbers_are_those_of_another_way_to_count(
    result: Path, samples: Path, evaluate: Callable[..., dict[str, Any]]
) -> None:
    found, other = evaluate(result), judged(result, sample_drive(samples))
    assert rms(found)["inclination"] == pytest.approx(np.sqrt(np.mean(other.tilt**2)), rel=1e-4)
    assert rms(found)["heading"] == pytest.approx(np.sqrt(np.mean(other.heading**2)), rel=1e-4)
    inside = np.mean(other.heading <= 2.0 * other.sigma_heading)
    assert found["attitude"]["coverage"]["z"]["sigma_2"] == pytest.approx(inside, abs=0.002)
    assert found["attitude"]["compared"] == {"at": "result", "used": 12000, "outside": 0, "in_gaps": 0, "still": 0}
    assert found["alignment"]["mode"] == "none"
    assert found["covariance"] == "full"
    assert found["verdict"] == "PASS"
    assert abs(found["time_offset"]["fitted_s"]) < 4 * found["time_offset"]["sigma_s"]
    assert found["time_offset"]["applied_s"] == 0.0


def test_files_words_and_schema(result: Path, samples: Path, root: Path, attest: Attest, tmp_path: Path) -> None:
    folder = tmp_path / "rover.attest"
    shutil.copytree(result, folder)
    done = attest("evaluate", folder, "--reference", samples / "rover.truth.parquet", "--moving-only")
    assert (done.code, done.out) == (0, "")
    found = json.loads((folder / "evaluation.json").read_text(encoding="utf-8"))
    schema = json.loads((root / "schemas" / "evaluation.schema.json").read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator(schema).validate(found)
    with Image.open(folder / "09-evaluate.png") as picture:
        assert picture.size == (1280, 848)
    assert found["page"]["title"] in done.err
    assert found["result"]["name"] == "track.parquet"
    told = ("tilt", "heading, offset removed", "position over 10 s", "NEES", "motion only, as the reference tells")
    for words in (*told, "time offset", "aligned", percent(found["attitude"]["nees"]["attitude"]["inside_95"])):
        assert words in done.err, words
    again = attest("evaluate", folder, "--reference", samples / "rover.truth.parquet")
    again.refused("exists already", "--overwrite")
    attest("evaluate", folder, "--reference", tmp_path / "none.tum").refused("none.tum", "no such file")
    of_log = attest("evaluate", samples / "rover.mcap", "--reference", samples / "rover.truth.parquet")
    of_log.refused("rover.mcap", "the result is the folder that attest smooth wrote")
    quiet = attest("evaluate", folder, "--reference", samples / "rover.truth.parquet", "--overwrite", "-q")
    assert (quiet.code, quiet.out, quiet.err) == (0, "", "")


def test_a_bare_track_of_any_format_gives_the_same_errors(
    result: Path, evaluate: Callable[..., dict[str, Any]]
) -> None:
    whole = evaluate(result, "--align", "none")
    for name, covariance in {"csv": "diagonal", "tum": None, "mcap": None}.items():
        bare = evaluate(result / f"track.{name}", "--align", "none")
        assert rms(bare) == pytest.approx(rms(whole), abs=1e-9), name
        assert rms(bare, "position") == pytest.approx(rms(whole, "position"), abs=1e-9), name
        assert bare["covariance"] == covariance
        for axis, inside in bare["attitude"]["coverage"].items():
            assert inside["band_95"] == pytest.approx(whole["attitude"]["coverage"][axis]["band_95"], abs=1e-3)


def test_a_result_against_its_own_track_has_no_error(result: Path, evaluate: Callable[..., dict[str, Any]]) -> None:
    found = evaluate(result, reference=result / "track.tum")
    assert max(rms(found).values()) < 1e-12
    assert max(rms(found, "position").values()) < 1e-12


def test_a_result_in_ned_is_judged_alike(
    result: Path, samples: Path, attest: Attest, evaluate: Callable[..., dict[str, Any]], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr("attest_cli.pipeline.write_pages", lambda *_: [])
    assert attest("smooth", samples / "rover.parquet", "-o", tmp_path / "ned", "--frame", "ned").code == 0
    assert rms(evaluate(tmp_path / "ned")) == pytest.approx(rms(evaluate(result)), rel=1e-9)


def turned_late(samples: Path, path: Path, offset_s: float) -> Path:
    """The truth in another body's axes, on another datum, with other stamps, as a table of another maker."""
    from attest_cli.maths import rotation

    truth = pq.read_table(samples / "rover.truth.parquet")
    q = quaternions({name: truth[name].to_numpy() for name in ("q_w", "q_x", "q_y", "q_z")})
    q_world, q_body = rotation.exp_quaternion(np.array([[0.0, 0.0, 2.0], [0.5, -0.3, 1.0]]))
    q = rotation.multiply(rotation.multiply(q_world, q), q_body)
    stamps = truth["timestamp_ns"].to_numpy() + round(offset_s * 1e9)
    names = {f"truth_q{part}": q[:, k] for k, part in enumerate("wxyz")}
    pq.write_table(pa.table({"timestamp_ns": stamps, **names}), path)
    return path


def test_other_axes_another_datum_and_a_late_clock_are_found(
    result: Path, samples: Path, evaluate: Callable[..., dict[str, Any]], tmp_path: Path
) -> None:
    reference = turned_late(samples, tmp_path / "mocap.parquet", 0.0421)
    found = evaluate(result, "--align", "yaw", "--align-body", "--time-offset", "auto", reference=reference)
    offset = found["time_offset"]
    assert abs(offset["fitted_s"] - 0.0421) < 4 * offset["sigma_s"]
    assert offset["applied_s"] == offset["fitted_s"]
    assert found["alignment"]["yaw_deg"] == pytest.approx(-np.degrees(2.0), abs=0.3)
    assert rms(found)["total"] < rms(evaluate(result))["total"]
    assert found["position"] is None
    wild = evaluate(result, reference=reference)
    assert [w["code"] for w in wild["warnings"]] == ["other-axes"]


def test_what_cannot_be_judged_is_one_line(result: Path, samples: Path, attest: Attest, tmp_path: Path) -> None:
    def refused(reference: object, *words: str, track: Path = result, options: tuple[str, ...] = ()) -> None:
        attest("evaluate", track, "--reference", reference, "-o", tmp_path / "x", *options).refused(*words)
        assert not (tmp_path / "x").exists()

    late = turned_late(samples, tmp_path / "late.parquet", 3600.0)
    refused(late, "no overlap in time", "--time-offset")
    refused(samples / "rover.parquet", "no attitude and no position among 'timestamp_ns', 'gyro_x'")
    refused(samples / "nothing.tum", "no such file")
    refused(samples / "rover.mcap", "no channel of odometry, poses or orientations")
    refused(samples / "rover.truth.parquet", "no such file", track=tmp_path / "none.attest")
    refused(samples / "rover.truth.parquet", "--channel is for MCAP", options=("--channel", "/x"))
    (tmp_path / "other").mkdir()
    refused(samples / "rover.truth.parquet", "report.json", track=tmp_path / "other")
    assert attest("evaluate", result).code == 2
    assert attest("evaluate", result, "--reference", late, "--delta", "-3s").code == 2
    assert attest("evaluate", result, "--reference", late, "--time-offset", "soon").code == 2


def test_a_real_trial_is_judged_by_the_truth_in_its_own_file(
    attest: Attest, shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A cut of a BROAD trial: the clock offset of the data set is found (README: the IMU lags by 2 to 5 ms)."""
    log = shared_data / "broad" / "03_undisturbed_slow_rotation_C.parquet"
    if not log.is_file():
        pytest.skip(f"no {log}")
    monkeypatch.setattr("attest_cli.pipeline.write_pages", lambda *_: [])
    folder = tmp_path / "trial.attest"
    assert attest("smooth", log, "-o", folder, "--end", "60").code == 0
    done = attest("evaluate", folder, "--reference", log, "--json", "--moving-only")
    assert done.code == 0, done.err
    found = json.loads(done.out)
    assert -0.006 < found["time_offset"]["fitted_s"] < -0.002
    assert found["time_offset"]["sigma_s"] < 1e-3
    assert found["moving_from"] == "reference"
    assert rms(found)["inclination"] < 3.0
    assert read_track(folder)["q_w"].size == pytest.approx(60 * 285.7, abs=10)
