"""Page 9: the finding is true, the band is the claimed one, both verdicts, and every odd evaluation is drawn."""

from __future__ import annotations

import io
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support.tracks import Motion, poses

from attest_cli.evaluate import Claims, Evaluation, Options, Poses, evaluate
from attest_cli.figures import style
from attest_cli.figures.evaluate import draw, size
from attest_cli.figures.page import Marks, Page, Shape
from attest_cli.figures.words import THIN, percent
from attest_cli.maths import rotation
from attest_cli.records import Result

T = np.arange(0.0, 120.0, 0.05)
TRUTH = poses(Motion(3), T, heading="absolute", shared_world=True, moving=(T > 20.0) & (T < 90.0))
SIGMA = np.radians([0.1, 0.1, 0.3])


def result(position: bool = True, attitude: bool = True, claim: float = 1.0, told: bool = True) -> Poses:
    """White errors with a sigma of their own, claimed ``claim`` times as large."""
    rng = np.random.default_rng(3)
    q = rotation.multiply(rotation.exp_quaternion(rng.normal(0.0, SIGMA, (T.size, 3))), TRUTH.q)
    p = TRUTH.position + rng.normal(0.0, 0.5, (T.size, 3))
    none = [np.full_like(q, np.nan), np.full_like(p, np.nan)]
    P, Q = (np.tile(claim**2 * np.diag(s), (T.size, 1, 1)) for s in (SIGMA**2, np.full(3, 0.25)))
    claims = Claims(TRUTH.stamps_ns, P, Q, np.full(T.size, np.nan), full=True) if told else None
    return replace(TRUTH, q=q if attitude else none[0], position=p if position else none[1], claims=claims)


def header(segments: bool = True, name: str = "rover.mcap") -> Result:
    """What the page needs of a result folder."""
    rows = [(1, "stop", 0.0, 20.0), (2, "motion", 20.0, 90.0), (3, "stop", 90.0, 120.0)] if segments else []
    parts = tuple({"index": i, "kind": k, "start_s": a, "end_s": b} for i, k, a, b in rows)
    report = {"input": {"files": [{"name": name}], "duration_s": 120.0}, "heading": "absolute"}
    return Result(Path(), report, {"t_s": T}, {}, parts)


def judged(found: Poses, reference: Poses = TRUTH, **options: object) -> Evaluation:
    return evaluate(found, reference, Options(**options))  # type: ignore[arg-type]


def texts(page: Page) -> list[str]:
    return [t.text for t in page.texts]


def kinds(page: Page) -> set[str]:
    return {item.kind for item in page.items if isinstance(item, Marks)}


def test_the_finding_and_its_numbers_are_those_of_the_evaluation() -> None:
    found = judged(result(), moving_only=True)
    page = draw(found, header(), "truth.tum")
    assert found.attitude is not None
    heading, tilt = (np.degrees(found.attitude.stats[k].rms) for k in ("heading", "inclination"))
    head = f"Heading error {size(heading)}° rms, tilt {size(tilt)}°"
    assert page.title == f"{head}; {percent(found.band_share or 0.0)} of errors lie in the 95{THIN}% band"
    assert heading == pytest.approx(0.3, rel=0.1)
    assert "circle" in kinds(page)  # PASS
    words = texts(page)
    assert any("smoothed" not in w and "result minus reference in world axes, in motion; reference truth.tum" in w
               for w in words)  # fmt: skip
    assert "Error over all motion" in words
    for field in ("rms", "median", "p95", "max"):
        assert f"{size(np.degrees(getattr(found.attitude.stats['inclination'], field)))}°" in words
    assert [w for w in words if w.endswith("in band")] == [
        f"{percent(found.attitude.coverage[a].band)} in band" for a in "xyz"
    ]
    assert page.alt.startswith(page.title)


def test_a_sigma_that_does_not_hold_is_warn() -> None:
    found = judged(result(claim=0.5))
    page = draw(found, header(), "truth.tum")
    assert found.band_share == pytest.approx(0.673, abs=0.02)
    assert f"{percent(found.band_share or 0.0)} of errors" in page.title
    assert "up" in kinds(page)
    assert "Error over all samples" in texts(page)


def test_the_band_is_95_percent_of_what_is_claimed() -> None:
    found = judged(result())
    page = draw(found, header(), "truth.tum")
    panels = [p for p in page.panels if p.width > 4.0]
    assert len(panels) == 3
    bands = [i for i in page.items if isinstance(i, Shape) and i.colour == "band"]
    for panel, band, sigma in zip(panels, bands, np.degrees(SIGMA), strict=True):
        expected = panel.y([1.959964 * sigma, -1.959964 * sigma])
        reach = band.runs[0][:, 1].min(), band.runs[0][:, 1].max()
        assert reach == pytest.approx(tuple(expected), abs=1e-5)
        assert panel.inside(np.array([1.959964 * sigma])).all()


def test_stops_are_shaded_and_numbered() -> None:
    page = draw(judged(result()), header(), "truth.tum")
    assert {"1", "3", "segment"} <= set(texts(page))
    assert "segment" not in texts(draw(judged(result()), header(segments=False), "truth.tum"))


def test_colours_are_exact_and_the_page_has_its_size() -> None:
    image = Image.open(io.BytesIO(draw(judged(result()), header(), "truth.tum").png()))
    assert image.size == (1280, 848)
    found = {c for _, c in image.convert("RGB").getcolors(1 << 20) or []}
    wanted = ("truth", "band", "stop", "x", "y", "z", "pass")
    assert {style.rgb(style.THEMES["light"][c]) for c in wanted} <= found


def gapped() -> Poses:
    keep = (T < 40.0) | (T > 60.0)
    assert TRUTH.moving is not None
    return replace(
        TRUTH, stamps_ns=TRUTH.stamps_ns[keep], q=TRUTH.q[keep], position=TRUTH.position[keep],
        moving=TRUTH.moving[keep],
    )  # fmt: skip


ODD = {
    "no sigma": lambda: judged(result(told=False)),
    "no position": lambda: judged(result(position=False)),
    "position only": lambda: judged(result(attitude=False)),
    "position only, no sigma": lambda: judged(result(attitude=False, told=False), align="yaw"),
    "itself": lambda: judged(result(), result()),
    "gap": lambda: judged(result(), gapped()),
    "yaw": lambda: judged(result(), align="yaw"),
    "full, body, offset": lambda: judged(result(), align="full", align_body=True, time_offset="auto"),
    "offset given": lambda: judged(result(), time_offset=0.01),
    "one sample": lambda: judged(result(), replace(
        TRUTH, stamps_ns=TRUTH.stamps_ns[5:6], q=TRUTH.q[5:6], position=TRUTH.position[5:6], moving=None,
    )),
}  # fmt: skip


@cache
def odd_one(name: str) -> Evaluation:
    return ODD[name]()


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("odd", ODD)
def test_every_odd_evaluation_is_drawn(odd: str, theme: str) -> None:
    page = draw(odd_one(odd), header(name="n" * 140), "\u202e$x_1$" + "r" * 90, theme)
    assert page.png()[:4] == b"\x89PNG"
    assert "nan" not in " ".join(texts(page)).lower().split()
    for t in page.texts:
        width = style.text_width(t.text, t.size, t.bold)
        left = t.x - {"left": 0.0, "middle": 0.5, "right": 1.0}[t.align] * width
        assert left > 0.02, t.text
        assert left + width < page.width - 0.02, t.text
        assert 0.0 < t.y < page.height


def test_what_is_not_there_is_said() -> None:
    page = draw(odd_one("no sigma"), header(), "truth.tum")
    assert "no sigma to hold it against" in page.title
    assert "the track claims no sigma" in texts(page)
    assert "grey: 95 % band claimed" not in texts(page)
    page = draw(odd_one("position only"), header(), "truth.tum")
    assert page.title.startswith("Position error")
    assert "error, m" in texts(page)
    assert any(w.startswith(("No time offset", "Time offset")) for w in texts(page))
