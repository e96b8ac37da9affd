"""Position errors are those of evo (test-only) on the same TUM files: absolute and relative, aligned or not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from evo.core import metrics, sync
from evo.core.units import Unit
from evo.tools import file_interface
from support.tracks import Motion, noisy, random_rotation

from attest_cli.evaluate import Options, evaluate
from attest_cli.maths import rotation
from attest_cli.readers.reference import read_poses

EXACT = 1e-9
STEP_S = 0.05
T = np.arange(0.0, 40.0, STEP_S)


def write_tum(path: Path, t: np.ndarray, p: np.ndarray, q: np.ndarray) -> None:
    rows = np.column_stack([p, q[:, 1:], q[:, :1]])
    lines = (f"{s:.9f} " + " ".join(f"{v:.17g}" for v in row) for s, row in zip(t.tolist(), rows.tolist(), strict=True))
    path.write_text("# timestamp tx ty tz qx qy qz qw\n" + "\n".join(lines) + "\n")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A reference that stands still for a while, and a noisy, drifting estimate of it in another world."""
    rng, motion, folder = np.random.default_rng(4), Motion(4), tmp_path_factory.mktemp("tum")
    course = np.where(T < 10.0, T, np.where(T < 14.0, 10.0, T - 4.0))
    p, q = motion.p(course), motion.q(course)
    q_world = random_rotation(rng)
    p_est = rotation.rotate(q_world, p + rng.normal(0.0, 0.02, p.shape) + 0.01 * T[:, None]) + np.array(
        [5.0, -3.0, 2.0]
    )
    q_est = noisy(rotation.multiply(q_world, q), 0.01, rng)
    write_tum(folder / "reference.tum", T, p, q)
    write_tum(folder / "estimate.tum", T, p_est, q_est)
    return folder / "reference.tum", folder / "estimate.tum"


def by_evo(files: tuple[Path, Path], metric: metrics.PE, *, align: bool) -> dict[str, float]:
    reference, estimate = (file_interface.read_tum_trajectory_file(str(path)) for path in files)
    reference, estimate = sync.associate_trajectories(reference, estimate)
    if align:
        estimate.align(reference)
    metric.process_data((reference, estimate))
    return {**metric.get_all_statistics(), "count": float(len(metric.error))}


def by_attest(files: tuple[Path, Path], **options: object) -> dict[str, float]:
    found = evaluate(read_poses(files[1]), read_poses(files[0]), Options(**options))  # type: ignore[arg-type]
    assert found.position is not None
    name = "relative" if "delta" in options else "absolute"
    stats = found.position.stats[name]
    return {"rmse": stats.rms, "median": stats.median, "max": stats.max, "count": float(stats.count)}


@pytest.mark.parametrize("align", [False, True])
def test_absolute_position_error_is_evos_ape(files: tuple[Path, Path], align: bool) -> None:
    theirs = by_evo(files, metrics.APE(metrics.PoseRelation.translation_part), align=align)
    ours = by_attest(files, align="full" if align else "none")
    assert ours == pytest.approx({key: theirs[key] for key in ours}, abs=EXACT)
    assert theirs["rmse"] > 0.02


@pytest.mark.parametrize("align", ["none", "full"])
@pytest.mark.parametrize("seconds", [1.0, 10.0])
def test_relative_position_error_over_time_is_evos_rpe_over_frames(
    files: tuple[Path, Path], align: str, seconds: float
) -> None:
    rpe = metrics.RPE(
        metrics.PoseRelation.translation_part, delta=round(seconds / STEP_S), delta_unit=Unit.frames, all_pairs=True
    )
    theirs = by_evo(files, rpe, align=align == "full")
    ours = by_attest(files, align=align, delta=seconds, delta_unit="s")
    assert ours == pytest.approx({key: theirs[key] for key in ours}, abs=EXACT)


@pytest.mark.parametrize("metres", [2.0, 15.0])
def test_relative_position_error_over_path_is_evos_rpe_over_metres(files: tuple[Path, Path], metres: float) -> None:
    rpe = metrics.RPE(
        metrics.PoseRelation.translation_part, delta=metres, delta_unit=Unit.meters, rel_delta_tol=0.1, all_pairs=True,
        pairs_from_reference=True,
    )  # fmt: skip
    theirs = by_evo(files, rpe, align=False)
    ours = by_attest(files, align="none", delta=metres, delta_unit="m")
    assert ours == pytest.approx({key: theirs[key] for key in ours}, abs=EXACT)


def test_total_attitude_error_is_evos_rotation_angle(files: tuple[Path, Path]) -> None:
    theirs = by_evo(files, metrics.APE(metrics.PoseRelation.rotation_angle_rad), align=False)
    found = evaluate(read_poses(files[1]), read_poses(files[0]), Options(align="none"))
    assert found.attitude is not None
    ours = found.attitude.stats["total"]
    assert [ours.rms, ours.median, ours.max] == pytest.approx(
        [theirs["rmse"], theirs["median"], theirs["max"]], abs=1e-7
    )
