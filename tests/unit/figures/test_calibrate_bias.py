"""The page of a calibration: what it says is so, what it draws is the data, and every odd record has one."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from support.calibrations import rest

from attest_cli.calibration.records import Calibration
from attest_cli.figures import calibrate_bias as page8
from attest_cli.figures import style
from attest_cli.figures.page import Page, Shape
from attest_cli.records import Array, Result

HOSTILE = "\u202e$x_1$ \\frac{\x1b]0;evil\x07" + "n" * 140 + ".csv"


def warm_up(t: Array) -> Array:
    return np.asarray(5e-3 * np.exp(-t / 60.0))


@pytest.fixture(scope="module")
def records() -> dict[str, Calibration]:
    """A short record at rest, a warm-up, a drive of short stops, and a curve that does not fit."""
    warm = rest(400.0, curve=warm_up)
    wrong = [replace(a, whiteness=replace(a.whiteness, white=False, rho=0.9 + 0 * a.whiteness.rho)) for a in warm.axes]
    return {
        "short": rest(20.0),
        "warm-up": warm,
        "drive": rest(400.0, every=60.0),
        "not white": replace(warm, axes=(wrong[0], wrong[1], warm.axes[2])),
    }


def drawn(found: Calibration, theme: str = "light", name: str = "static.csv") -> Page:
    report: dict[str, Any] = {
        "attest_version": "0.1.0",
        "input": {"files": [{"name": name, "sha256": "ab" * 32}], "duration_s": found.duration, "samples": 20_000},
    }
    return page8.draw(found, Result(Path("x"), report, {"t_s": np.array([])}, {}, ()), theme)


def words(page: Page) -> list[str]:
    return [text.text for text in page.texts]


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("kind", ["short", "warm-up", "drive", "not white"])
def test_every_record_has_a_page_whose_words_stay_on_it(
    records: dict[str, Calibration], kind: str, theme: str
) -> None:  # fmt: skip
    page = drawn(records[kind], theme)
    assert all(np.isfinite(run).all() for item in page.items if isinstance(item, Shape) for run in item.runs)
    assert not [word for word in words(page) if "nan" in word.lower().split()]
    for t in page.texts:
        width = style.text_width(t.text, t.size, t.bold)
        left = t.x - {"left": 0.0, "middle": 0.5, "right": 1.0}[t.align] * width
        assert left > 0.02, t.text
        assert left + width < page.width - 0.02, t.text
        assert 0.0 < t.y < page.height
    image = Image.open(io.BytesIO(page.png())).convert("RGB")
    assert image.size == (1280, round(page8.HEIGHT * style.DPI))
    found = {colour for _, colour in image.getcolors(1 << 20) or []}
    assert {style.rgb(style.THEMES[theme][name]) for name in ("x", "y", "z", "band2", "ink")} <= found


def test_the_title_is_the_finding_of_the_worst_axis(records: dict[str, Calibration]) -> None:
    found = records["warm-up"]
    noise = max(axis.noise.N for axis in found.axes) * np.degrees(1.0)
    assert drawn(found).title.startswith(f"Noise {noise:.4f} °/s/√Hz")
    assert drawn(found).title.endswith("the residual is white")
    deg_h = zip(found.axes, (1.0, 1.8, 0.5), strict=True)
    seen = [replace(axis, noise=replace(axis.noise, B=B / page8.DEG_H)) for axis, B in deg_h]
    page = drawn(replace(found, axes=(seen[0], seen[1], seen[2])))
    assert "bias instability 1.8 °/h" in page.title
    assert any("B" in word and "1.8 °/h" in word for word in words(page))


def test_a_residual_that_is_not_white_is_marked_where_it_is(records: dict[str, Calibration]) -> None:
    page = drawn(records["not white"])
    assert page8.status(records["not white"]) == "WARN"
    assert "not yet white" in page.title
    assert words(page).count("not white") == 2
    assert page8.status(records["warm-up"]) == "PASS"
    assert "not white" not in words(drawn(records["warm-up"]))


def test_the_warm_up_is_told_by_its_end_and_its_time(records: dict[str, Calibration]) -> None:
    axis = records["warm-up"].axes[0]
    assert axis.model.name == "exponential"
    T = float(axis.model.values[2])
    assert abs(T - 60.0) < 12.0
    told = page8.model_words(axis)
    assert "starts +0.2" in told or "starts +0.3" in told
    assert ("τ 1.0 min" in told) or (f"τ {T:.0f} s" in told) or (f"τ {T / 60.0:.1f} min" in told)
    assert any("warm-up over after" in word for word in words(drawn(records["warm-up"])))


def test_an_unseen_walk_is_said_and_a_seen_one_stands_on_its_line(records: dict[str, Calibration]) -> None:
    unseen = [replace(a, noise=replace(a.noise, K=None)) for a in records["short"].axes]
    found = replace(records["short"], axes=(unseen[0], unseen[1], unseen[2]))
    assert words(drawn(found)).count("K not seen") == 3
    seen = [replace(a, noise=replace(a.noise, K=1e-4)) for a in found.axes]
    page = drawn(replace(found, axes=(seen[0], seen[1], seen[2])))
    K = 1e-4 * np.degrees(1.0) * 3600.0 * 60.0
    assert sum(word.startswith("K") and f"{K:,.0f}"[:1] in word for word in words(page)) == 3


def test_means_part_at_stops_and_share_out_their_blocks(records: dict[str, Calibration]) -> None:
    rest_ = records["drive"].axes[0].rest
    found = page8.means(rest_, rest_.rate, 10.0)
    stops = len(np.unique(rest_.stop))
    assert found.t.size == stops  # 12 s at rest, less what is shrunk: one mean a stop
    assert found.parted[:-1].all()
    for k, stop in enumerate(np.unique(rest_.stop)):
        mine = rest_.stop == stop
        assert found.mean[k] == pytest.approx(rest_.rate[mine].mean())
        assert found.sigma[k] == pytest.approx(np.sqrt(np.sum((rest_.sigma[mine] * page8.DEG) ** 2)) / mine.sum())
    long = records["warm-up"].axes[0].rest
    assert page8.means(long, long.rate, 10.0).t.size == pytest.approx(40, abs=2)
    assert not page8.means(long, long.rate, 10.0).parted.any()


def test_a_hostile_file_name_is_drawn_safely(records: dict[str, Calibration]) -> None:
    page = drawn(records["short"], name=HOSTILE)
    assert all(word.isprintable() or "\u00a0" in word for word in words(page))
    assert not any("\x1b" in word or "\u202e" in word for word in words(page))
    page.png()


def test_a_record_is_drawn_the_same_twice(records: dict[str, Calibration]) -> None:
    assert drawn(records["drive"]).png() == drawn(records["drive"]).png()
