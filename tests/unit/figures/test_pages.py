"""Every page, for a usual drive and every odd log: it is drawn, its title is true, its panels get the right data."""

from __future__ import annotations

import dataclasses
import io
import sys

import numpy as np
import pytest
from PIL import Image

from attest_cli import figures
from attest_cli.figures import (
    gyro_bias,
    innovations,
    overview,
    plan,
    plan_view,
    rows,
    separation,
    sigma,
    stops,
    style,
)
from attest_cli.figures.drive import Drive
from attest_cli.figures.page import Marks, Page, Shape

USUAL = [
    "01-overview.png", "02-separation.png", "03-gyro-bias.png", "04-sigma.png", "05-innovations-gravity.png",
    "05-innovations-sun.png", "05-innovations-zero-rate.png", "06-plan.png", "07-stops.png",
]  # fmt: skip
SHORT = (15.0, 90.0, 12.0)
ODD = {
    "two minutes": {"durations": SHORT, "position": "none"},
    "no heading": {"durations": SHORT, "heading": "relative"},
    "no stop": {"durations": (200.0,), "starts_with_stop": False, "position": "none"},
    "no stop, one pass": {"durations": (200.0,), "starts_with_stop": False, "backward": False, "position": "unusable"},
    "one stop": {"durations": (100.0,)},
    "gap": {"gap": (620.0, 760.0), "step": 0.5},
    "all rejected": {"durations": SHORT, "rejected": 1.0},
    "sigma zero": {"durations": SHORT, "zero_sigma": True},
    "one node": {"durations": (0.04,)},
    "starts in motion": {"durations": (50.0, 20.0, 60.0), "starts_with_stop": False},
    "sigma too small": {"growth": 0.25, "step": 0.5},
    "long name": {"durations": SHORT, "name": "\u202e$x_1$ \\frac{" + "n" * 140},
}


def texts(page: Page) -> list[str]:
    return [t.text for t in page.texts]


def test_pages_of_a_usual_drive(make):
    found = dict(figures.pages(make()))
    assert list(found) == USUAL
    for page in found.values():
        image = Image.open(io.BytesIO(page.png()))
        assert image.size == (1280, round(page.height * style.DPI))
        image = image.convert("RGB")
        colours = {colour: count for count, colour in image.getcolors(1 << 20) or []}
        assert colours[style.rgb("#FFFFFF")] > 0.5 * image.width * image.height
        assert page.alt.startswith(page.title)
        assert style.text_width(page.title, style.TITLE, bold=True) <= 7.3


@pytest.mark.parametrize(
    ("name", "colours"),
    [
        ("01-overview.png", ["forward", "backward", "ink", "band", "stop", "pass", "gap"]),
        ("02-separation.png", ["band1", "band2", "stop", "ink"]),
        ("03-gyro-bias.png", ["forward", "backward", "ink", "band", "stop"]),
        ("04-sigma.png", ["forward", "backward", "ink", "limit"]),
        ("05-innovations-sun.png", ["ink", "measurement", "limit", "band2"]),
        ("07-stops.png", ["ink", "limit", "stop"]),
    ],
)
def test_style_colours_are_exact_in_the_file(make, name, colours):
    page = dict(figures.pages(make()))[name]
    found = {c for _, c in Image.open(io.BytesIO(page.png())).convert("RGB").getcolors(1 << 20) or []}
    assert {style.rgb(style.THEMES["light"][c]) for c in colours} <= found


def test_pages_are_the_same_twice(make):
    for (_, a), (_, b) in zip(figures.pages(make(durations=SHORT)), figures.pages(make(durations=SHORT)), strict=True):
        assert a.png() == b.png()


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("odd", ODD)
def test_every_page_survives_every_odd_log(make, odd, theme):
    found = dict(figures.pages(make(**ODD[odd]), theme))
    assert "01-overview.png" in found
    for page in found.values():
        assert page.title
        assert len(page.title) <= 90
        assert np.isfinite(
            [v for i in page.items if isinstance(i, Shape) for r in i.runs for v in (r.min(), r.max())]
        ).all()
        assert all("nan" not in t.lower().split() for t in texts(page))
        assert all(0.0 < t.y < page.height and -0.1 < t.x < page.width for t in page.texts)
    if theme == "light":
        assert found["01-overview.png"].png()[:4] == b"\x89PNG"


def test_words_stay_on_the_page(make, long_durations):
    logs = [{}, *ODD.values(), {"durations": long_durations, "step": 5.0, "heading": "relative", "position": "none"}]
    for options in logs:
        for name, page in figures.pages(make(**options)):
            for t in page.texts:
                width = style.text_width(t.text, t.size, t.bold)
                left = t.x - {"left": 0.0, "middle": 0.5, "right": 1.0}[t.align] * width
                assert left > 0.02, (name, t.text)
                assert left + width < page.width - 0.02, (name, t.text)


def test_a_day_is_drawn_by_motion(make, long_durations):
    result = make(durations=long_durations, step=2.0, heading="relative", position="none", gap=(61200.0, 62940.0))
    found = dict(figures.pages(result))
    page = found["01-overview.png"]
    drive = Drive(result)
    assert drive.long
    checks = separation.checks_of(drive)
    dots = sum(i.centres.shape[0] for i in page.items if isinstance(i, Marks) and i.size == 2.6)
    crosses = sum(
        i.centres.shape[0] for i in page.items if isinstance(i, Marks) and i.kind == "heavy-cross" and i.size == 3.6
    )
    assert dots == separation.checks_inside(drive)[0]
    assert dots + crosses == len(checks)
    assert len(separation.every_check(drive)) == 2 * 76  # one motion lies in the gap
    assert "none" in texts(page)
    assert "gap 29 min" in texts(page)
    assert "heading is relative only" in page.title
    assert sum(i.runs[0].shape[0] for i in page.items if isinstance(i, Shape)) < 20_000


def test_overview_titles_tell_what_is_known(make):
    title = overview.titles(Drive(make()))[0]
    report = make().report["statistics"]
    assert title == (
        f"Heading known to {report['sigma_heading_median_deg']:.2g}°, tilt to {report['sigma_tilt_median_deg']:.2g}°, "
        "position to 0.40 m"
    )
    alone = overview.titles(Drive(make(**ODD["no stop, one pass"])))[0]
    assert alone.startswith("No stop found: heading known to ")
    assert overview.titles(Drive(make(**ODD["sigma zero"])))[0].endswith("σ of heading is zero; σ of tilt is zero")


def test_a_lost_heading_is_not_called_known(make):
    base = make()
    report = dict(base.report) | {"statistics": dict(base.report["statistics"]) | {"sigma_heading_median_deg": 104.0}}
    title = overview.titles(Drive(dataclasses.replace(base, report=report)))[0]
    assert title.startswith("Tilt known to")
    assert title.endswith("; heading not known")


def test_why_there_is_no_track(make):
    words = texts(overview.draw(make(position="unusable", step=0.5)))
    assert any(w.startswith("No track is drawn: position σ reaches") for w in words)
    assert plan.draw(make(position="unusable", step=0.5)) is None
    assert plan.draw(make(**ODD["two minutes"])) is None


def test_separation_is_omitted_without_stop_or_second_pass(make):
    assert separation.draw(make(**ODD["no stop"])) is None
    assert separation.draw(make(backward=False, durations=SHORT)) is None


def test_separation_judges_by_count_and_by_the_worst(make):
    drive = Drive(make())
    inside, checks = separation.checks_inside(drive)
    assert checks == 18
    assert separation.status_of(drive) == "PASS"
    page = separation.draw(make())
    assert page.title == f"Forward and backward passes agree: {inside} of 18 segment checks inside 2σ"
    wrong = separation.draw(make(growth=0.25, step=0.5))
    assert wrong.title.startswith("Forward and backward passes disagree: ")


def test_separation_dots_are_the_checks(make):
    page = separation.draw(make())
    every = [i for i in page.items if isinstance(i, Marks) and (i.fill, i.size) in (("ink", 4.2), ("limit", 4.2))]
    assert sum(i.centres.shape[0] for i in every) == 18


def test_limits_ignore_the_start_transient(make):
    result = make()
    drive = Drive(result)
    start = np.abs(drive.difference("forward", "yaw"))[:10].max()
    page = Page(3.0, "light", "t")
    panel = rows.difference_strip(page, drive, (1.05, 0.5, 5.9, 0.78), "yaw")
    moving = np.abs(drive.difference("forward", "yaw"))[drive.moving]
    assert panel.y_limits[1] == -panel.y_limits[0]
    assert panel.y_limits[1] >= 2.0 * np.quantile(drive.column("smoothed_sigma_yaw_deg")[drive.moving], 0.99)
    assert panel.y_limits[1] <= 1.1 * max(moving.max(), 2.2 * drive.column("smoothed_sigma_yaw_deg").max())
    assert start > 0.1  # there is a transient to ignore
    low, high = gyro_bias.limits(drive, "x")
    forward = drive.column("forward_gyro_bias_x_rad_s") * gyro_bias.TO_DEG
    assert forward[0] > high + 0.01
    assert high - low < 0.1


def test_what_leaves_the_panel_gets_one_triangle_with_its_value(make):
    page = Page(3.0, "light", "t")
    drive = Drive(make())
    panel = rows.difference_strip(page, drive, (1.05, 0.5, 5.9, 0.78), "roll")
    triangles = [i for i in page.items if isinstance(i, Marks) and i.kind in ("up", "down")]
    values = {w: np.where(drive.settled(w), drive.difference(w, "roll"), np.nan) for w in ("forward", "backward")}
    leaving = sum(np.nanmax(s * v) > panel.y_limits[1] for v in values.values() for s in (1, -1))
    assert len(triangles) == leaving > 0
    worst = max(values.values(), key=lambda v: np.nanmax(np.abs(v)))
    assert any(t.endswith("°") and f"{np.nanmax(np.abs(worst)):.2g}" in t for t in texts(page))


def test_gap_is_shaded_named_and_not_drawn_over(make):
    page = sigma.draw(make(gap=(620.0, 760.0)))
    assert "gap 2 min 20 s" in texts(page)
    left, right = (float(page.panels[0].x(v)) for v in (620.2, 759.8))
    lines = [r for i in page.items if isinstance(i, Shape) and i.colour == "ink" and not i.fill for r in i.runs]
    assert len(lines) == 4  # two panels, before and after
    for run in lines:
        assert not ((run[:, 0] > left) & (run[:, 0] < right)).any()
        assert run[:, 0].max() <= left or run[:, 0].min() >= right


def test_sigma_title_is_true_and_the_advice_stands_at_its_time(make):
    result = make()
    drive, page = Drive(result), sigma.draw(result)
    assert page.title.startswith("Smoothing keeps heading σ below ")
    stated = float(page.title.split("below ")[1].split("°")[0])
    assert drive.column("smoothed_sigma_att_z_deg").max() <= stated
    due = [p for p in drive.motions if np.isfinite(p.value("stop_advised_after_s"))]
    (mark,) = [i for i in page.items if isinstance(i, Marks) and i.kind == "down"]
    np.testing.assert_allclose(
        mark.centres[:, 0], [float(page.panels[1].x(p.start + p.value("stop_advised_after_s"))) for p in due]
    )
    assert any(w.startswith("after ") for w in texts(page))
    assert "the smoothed σ is never above either pass" in " ".join(texts(page))


def test_innovations_page_has_every_measurement(make):
    result = make()
    data = innovations.found(result, "sun")
    page = innovations.draw(result, "light", "sun")
    shown = [i for i in page.items if isinstance(i, Marks) and i.size == 2.6]
    assert [i.centres.shape[0] for i in shown] == [int(data.used.sum())] * 2
    (crosses,) = [
        i for i in page.items if isinstance(i, Marks) and i.kind == "cross" and i.centres.shape[0] == data.rejected
    ]
    assert (crosses.edge, data.rejected > 1) == ("limit", True)
    assert f"{data.rejected} of {data.nis.size} rejected" in page.title
    assert data.rejected > 0.01 * data.nis.size
    assert innovations.status(data) == "WARN"  # as the report says of more than a hundredth


def test_rejected_sensor_fails_its_page(make):
    result = make(**ODD["all rejected"])
    page = innovations.draw(result, "light", "sun")
    count = innovations.found(result, "sun").nis.size
    assert page.title == f"Sun sensor: all {count} measurements rejected"
    assert "no measurement was used" in texts(page)
    assert any(isinstance(i, Marks) and i.kind == "heavy-cross" and i.fill == "fail" for i in page.items)


def test_too_few_measurements_make_no_page(make):
    result = make(durations=SHORT)
    few = {k: v[:4] for k, v in result.innovations.items()}
    assert innovations.draw(dataclasses.replace(result, innovations=few)) is None


def test_sensor_names_cannot_make_paths(make):
    result = make(durations=SHORT)
    table = dict(result.innovations) | {
        "sensor": np.array(["../../Etc/x"] * result.innovations["t_s"].size, dtype=object)
    }
    names = [name for name, _ in figures.pages(dataclasses.replace(result, innovations=table)) if "innovations" in name]
    assert names == ["05-innovations-etc-x.png"]


def test_white_noise_has_no_autocorrelation_and_a_ramp_has():
    rng = np.random.default_rng(2)
    white = innovations.autocorrelation(rng.standard_normal(4000), 25)
    assert np.abs(white).max() < 4.0 / np.sqrt(4000)
    assert innovations.autocorrelation(np.arange(100.0), 3)[0] > 0.9
    assert (innovations.autocorrelation(np.ones(10), 3) == 0.0).all()


def test_plan_has_equal_scales_and_north_is_up(make):
    result = make()
    page = plan.draw(result)
    panel = page.panels[0]
    across = (panel.x_limits[1] - panel.x_limits[0]) / panel.width
    up = (panel.y_limits[1] - panel.y_limits[0]) / panel.height
    assert across == pytest.approx(up)
    drive = Drive(result)
    assert len(plan_view.stop_places(drive, plan_view.plan_of(drive))) == 7
    assert "N" in texts(page)
    assert "N" not in texts(plan.draw(make(**ODD["no heading"])))
    np.testing.assert_array_equal(plan_view.plan_of(drive).up, drive.column("position_y_m"))


def test_ellipse_is_the_95_percent_contour(make):
    result = make()
    page = Page(6.9, "light", "t")
    panel = plan_view.draw_plan(page, Drive(result), (0.45, 0.98, 4.55, 4.15))
    (rings,) = [i for i in page.items if isinstance(i, Shape) and i.colour == "measurement"]
    drive = Drive(result)
    view = plan_view.plan_of(drive)
    first = plan_view.ellipse_nodes(drive, view, panel.x_limits[1] - panel.x_limits[0])[0]
    ring = rings.runs[0] - [float(panel.x(view.right[first])), float(panel.y(view.up[first]))]
    metres = ring * (panel.x_limits[1] - panel.x_limits[0]) / panel.width * [1.0, -1.0]
    cov = np.array(
        [[view.sigma_right[first] ** 2, view.covariance[first]], [view.covariance[first], view.sigma_up[first] ** 2]]
    )
    np.testing.assert_allclose(np.einsum("ij,jk,ik->i", metres, np.linalg.inv(cov), metres), 2.448**2, rtol=1e-6)


def test_stops_page_shows_each_stop(make, long_durations):
    page = stops.draw(make())
    assert page.title == "Seven stops found; motion stands 174 times above the threshold"
    assert len(page.panels) == 2 + 7
    many = Drive(make(durations=long_durations, step=5.0, heading="relative", position="none"))
    chosen = stops.closest(many)
    assert len(chosen) == stops.MOST
    assert min(many.stops, key=lambda p: p.length) in chosen
    assert stops.draw(make(**ODD["no stop"])).title.startswith("No stop found")
    assert stops.draw(make(**ODD["one stop"])).title == "The whole log is one stop"


def test_segments_read_back_from_text_are_the_same(make):
    result = make(durations=SHORT)
    text = tuple({k: "" if v == "" else str(v) for k, v in row.items()} for row in result.segments)
    for (_, a), (_, b) in zip(
        figures.pages(result), figures.pages(dataclasses.replace(result, segments=text)), strict=True
    ):
        assert a.title == b.title
        assert texts(a) == texts(b)


def test_drawing_needs_no_pyplot(make):
    dict(figures.pages(make(durations=SHORT)))["01-overview.png"].png()
    assert "matplotlib.pyplot" not in sys.modules
