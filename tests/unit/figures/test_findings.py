"""What the pages say of odd results: robust ranges, words clear of lines, titles that hold, no green claim on FAIL."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from attest_cli import figures
from attest_cli.figures import (
    frame,
    gyro_bias,
    innovations,
    lists,
    overview,
    plan,
    plan_view,
    rows,
    separation,
    sigma,
    style,
)
from attest_cli.figures.drive import Drive
from attest_cli.figures.page import Marks, Page, Shape
from attest_cli.records import Innovations
from attest_cli.report.build import _innovation_checks

SHORT = (15.0, 90.0, 12.0)
ONE_STOP = {"durations": (100.0,)}
LONG_NAME = {"durations": SHORT, "name": "n" * 140}
NO_HEADING = {"durations": SHORT, "heading": "relative"}
NO_STOP = {"durations": (200.0,), "starts_with_stop": False, "position": "none"}


def texts(page):
    return [t.text for t in page.texts]


def changed(result, report=None, **columns):
    """The result with other facts in its report and other columns in its passes."""
    passes = {**result.passes, **columns}
    return dataclasses.replace(result, report={**result.report, **(report or {})}, passes=passes)


def wild(result, seconds=1.0):
    """The forward pass knows nothing for a while in the first motion."""
    t = result.passes["t_s"]
    lost = (t > 60.0) & (t < 60.0 + seconds)
    names = ("forward_sigma_att_{}_deg", "sigma_separation_{}_deg", "separation_{}_deg")
    columns = {n.format(a): np.where(lost, 150.0, result.passes[n.format(a)]) for n in names for a in "xyz"}
    return changed(result, **columns)


@pytest.mark.parametrize("seconds", [1.0, 60.0])
def test_a_lost_pass_does_not_flatten_the_rest(make, seconds):
    usual, page = separation.draw(make()), separation.draw(wild(make(), seconds))
    heights = [p.y_limits[1] for p in page.panels if p.width > 5.0]
    assert heights == pytest.approx([p.y_limits[1] for p in usual.panels if p.width > 5.0], rel=0.2)
    assert texts(page).count("150°") == 3
    assert sum(i.kind == "up" for i in page.items if isinstance(i, Marks)) >= 3


def test_sigma_panels_hold_every_smoothed_node(make):
    for options in ({}, ONE_STOP, NO_HEADING, NO_STOP):
        result = wild(make(**options))
        page, drive = sigma.draw(result), Drive(result)
        for panel, name in zip(page.panels, ("tilt", "heading"), strict=True):
            values = drive.tilt_sigma("smoothed") if name == "tilt" else drive.column("smoothed_sigma_att_z_deg")
            assert panel.inside(values[values > 0.0]).all()


def test_sigma_title_holds_for_nodes_above_the_report(make):
    result = make()
    heading = result.passes["smoothed_sigma_att_z_deg"].copy()
    heading[700] = 7.77
    page = sigma.draw(changed(result, smoothed_sigma_att_z_deg=heading))
    assert "heading σ below 7.8°" in page.title
    assert any(isinstance(i, Marks) and i.fill == "warn" for i in page.items)


def test_share_of_the_log_is_of_time_and_without_the_start(make):
    drive = Drive(make())
    t, over = drive.t, drive.column("forward_sigma_att_z_deg") > 1.0
    moving = t >= drive.motions[0].start
    assert sigma.share_over(drive, "heading", 1.0) == pytest.approx(np.mean(over & moving), abs=2e-3)
    resting = Drive(make(**ONE_STOP))
    assert (resting.column("forward_sigma_att_z_deg") > 1.0).any()
    assert sigma.share_over(resting, "heading", 1.0) == 0.0
    assert "exceeds" not in sigma.draw(make(**ONE_STOP)).title


@pytest.mark.parametrize("draw", [sigma.draw, overview.draw])
def test_words_in_a_panel_do_not_strike_its_lines(make, draw):
    page = draw(make())
    lines = [r for i in page.items if isinstance(i, Shape) and i.colour in ("forward", "backward") for r in i.runs]
    words = [w for w in page.texts if w.text.startswith("after ") or (w.halo and w.text.endswith("°"))]
    assert words
    for w in words:
        left, top, right, bottom = frame.text_box(w.text, w.size, w.x, w.y, w.align)
        for run in lines:
            inside = (run[:, 0] > left) & (run[:, 0] < right) & (run[:, 1] > top) & (run[:, 1] < bottom)
            assert not inside.any(), w.text


def test_passes_that_know_nothing_are_not_said_to_agree(make):
    result = make()
    wide = {f"sigma_separation_{a}_deg": np.full_like(result.passes["t_s"], 40.0) for a in "xyz"}
    page = separation.draw(changed(result, **wide))
    assert page.title == "Passes are too uncertain to be compared: predicted ±2σ of ±80° and more"
    assert any(isinstance(i, Marks) and i.fill == "warn" for i in page.items)
    assert sum(i.centres.shape[0] for i in page.items if isinstance(i, Marks) and i.size == 4.2 and not i.fill) == 18
    one = {"sigma_separation_x_deg": wide["sigma_separation_x_deg"]}
    assert ", 6 too uncertain" in separation.draw(changed(result, **one)).title
    assert "separations in 2σ" not in texts(overview.draw(changed(result, **wide)))
    assert len(separation.every_check(Drive(result))) == len(separation.checks_of(Drive(result))) == 18


def measured(nis, dof=3):
    nis = np.asarray(nis, dtype=float)
    z = np.sqrt(nis / dof)[:, None] * np.ones(dof)
    return innovations.Found("sun", z, nis, np.ones(nis.size, dtype=bool), np.ones(nis.size, dtype=int), dof)


def test_innovations_are_judged_by_their_mean():
    rng = np.random.default_rng(5)
    for count in (8, 60, 1000, 40000):
        assert innovations.status(measured(rng.chisquare(3, count))) == "PASS"
    assert innovations.status(measured(1.5 * rng.chisquare(3, 1000))) == "WARN"
    assert innovations.status(measured(5.0 * rng.chisquare(3, 1000))) == "FAIL"
    careful = measured(0.3 * rng.chisquare(3, 1000))
    assert innovations.status(careful) == "PASS"  # claimed too large: sigma is careful
    assert "smaller than claimed" in innovations.titles(careful)[0]
    assert innovations.status(measured(1.1 * rng.chisquare(3, 40000))) == "PASS"  # sure, but slight
    tails = measured([0.01] * 60 + [3.0] * 60 + [8.0] * 20)
    assert "inside the 95 % interval" in innovations.titles(tails)[0]


@pytest.mark.parametrize("factor", [0.2, 0.63, 1.0, 1.3, 2.0, 5.0])
@pytest.mark.parametrize("rejected", [0, 5, 300])
def test_the_page_of_a_sensor_and_the_report_say_the_same(factor, rejected):
    """Of the same innovations: the worst of the report's checks is the mark on the page."""
    rng, n = np.random.default_rng(7), 400
    used = np.arange(n) >= rejected
    nis = np.where(used, factor * rng.chisquare(2, n), 40.0)
    z = np.sqrt(nis / 2)[:, None] * rng.choice([-1.0, 1.0], (n, 1)) * np.ones(2)  # errors that do not last
    page = innovations.status(innovations.Found("sun", z, nis, used, np.ones(n, dtype=int), 2))
    role, t = np.full(n, "sun"), np.arange(float(n))
    checks = _innovation_checks(
        Innovations(role, t, t.astype(int), np.full(n, 2), nis, used, np.pad(z, ((0, 0), (0, 1))))
    )
    statuses = [check["status"] for check in checks]
    assert page == next(s for s in ("FAIL", "WARN", "PASS") if s in statuses)


@pytest.mark.parametrize(
    ("factor", "far", "status"),
    [(0.01, 0, "PASS"), (2.0, 0, "WARN"), (0.01, 2, "PASS"), (0.01, 40, "WARN"), (0.01, 200, "FAIL")],
)
def test_what_is_only_assumed_is_no_sensor(make, factor, far, status):
    n = 400
    role, t, z = np.full(n, "speed"), np.arange(float(n)), np.zeros((n, 3))
    nis = factor * np.random.default_rng(1).chisquare(3, n)
    (check,) = _innovation_checks(Innovations(role, t, t.astype(int), np.full(n, 3), nis, t >= far, z))
    assert (check["name"], check["status"]) == ("bound-speed", status)
    says = "keeps to" if status == "PASS" else "goes beyond"
    assert check["fact"] == f"The motion {says} the bound on its speed"
    assert f"{far} of 400 times" in check["detail"]
    result = make()
    names = np.where(result.innovations["sensor"] == "sun", "speed", result.innovations["sensor"])
    sensors = innovations.sensors(dataclasses.replace(result, innovations={**result.innovations, "sensor": names}))
    assert sensors == [name for name in innovations.sensors(result) if name != "sun"] != []


def test_innovations_shade_stops_only(make):
    result = make()
    table = {k: v.copy() for k, v in result.innovations.items()}
    rows_of_sun = np.flatnonzero(table["sensor"] == "sun")
    table["segment"][rows_of_sun[20:40]] = 2  # measured in a motion
    result = dataclasses.replace(result, innovations=table)
    page = innovations.draw(result, "light", "sun")
    shaded = [i.runs[0] for i in page.items if isinstance(i, Shape) and i.fill and i.colour == "stop"]
    at = page.panels[0].x(np.arange(rows_of_sun.size))
    inside = np.any([(at > run[:, 0].min()) & (at < run[:, 0].max()) for run in shaded], axis=0)
    np.testing.assert_array_equal(inside, table["segment"][rows_of_sun] != 2)
    assert "2" not in [w.text for w in page.texts if w.size == style.NUMBER]
    assert not any("2.5 %" in w for w in texts(innovations.draw(one_degree(result), "light", "sun")))


def one_degree(result):
    return dataclasses.replace(
        result, innovations={**result.innovations, "dof": np.ones_like(result.innovations["dof"])}
    )


def test_a_bias_that_does_not_move_is_constant(make):
    result = make()
    for drift in (2e-7, 1e-9):
        report = {"statistics": {**result.report["statistics"], "gyro_bias_drift_deg_s": drift}}
        assert gyro_bias.draw(changed(result, report)).title.startswith("Gyro bias is constant over 21 min")
    assert gyro_bias.draw(result).title.startswith("Gyro bias drifts 0.039 °/s")


def test_footer_is_clear_of_the_axis_label(make):
    for options in (LONG_NAME, {}):
        for name, page in figures.pages(make(**options)):
            foot = next(w for w in page.texts if w.size == style.FOOTER)
            box = frame.text_box(foot.text, foot.size, foot.x, foot.y, foot.align)
            for w in page.texts:
                if w is not foot:
                    assert not frame.overlap(box, frame.text_box(w.text, w.size, w.x, w.y, w.align)), (name, w.text)


FAILED = {
    "verdict": "FAIL",
    "checks": [
        {"name": "a", "status": "WARN", "fact": "A gap", "detail": ""},
        {"name": "b", "status": "PASS", "fact": "Passes agree", "detail": ""},
        {"name": "c", "status": "FAIL", "fact": "63 of 63 sun measurements rejected", "detail": "see there"},
    ],
}


def test_a_failed_check_is_the_title_and_no_claim_is_green(make):
    result = changed(make(), FAILED)
    page = overview.draw(result)
    assert page.title == "63 of 63 sun measurements rejected: the sigma does not hold"
    assert ("1 | 1", "failed | warnings", "fail") in overview.key_numbers(Drive(result))
    listed = [i for i in page.items if isinstance(i, Marks) and i.fill in ("fail", "warn", "pass")][1:]
    assert [(i.kind, i.fill) for i in listed] == [("heavy-cross", "fail"), ("up", "warn"), ("circle", "pass")]
    for draw in (plan.draw, sigma.draw):
        marks = [i.fill for i in draw(result).items if isinstance(i, Marks)]
        assert "fail" in marks
        assert "pass" not in marks
    assert "does not hold" in plan.draw(result).title


def test_a_long_title_is_cut_to_the_page(make):
    fact = {**FAILED, "checks": [{"status": "FAIL", "fact": "W" * 110, "detail": ""}]}
    title = overview.draw(changed(make(), fact)).title
    assert title.endswith("…")
    assert style.text_width(title, style.TITLE, bold=True) < 7.3


def test_a_drive_that_never_moved_has_no_plan(make):
    result = make(durations=SHORT)
    still = {f"position_{a}_m": 0.1 * np.sin(result.passes["t_s"]) for a in "xy"}
    still |= {f"sigma_position_{a}_m": np.full_like(result.passes["t_s"], 0.01) for a in "xy"}
    rested = changed(result, **still)
    assert plan.draw(rested) is None
    assert not any(w.endswith(" m") and w[0].isdigit() for w in texts(overview.draw(rested)))
    assert "position" not in overview.draw(rested).title
    lost = {f"sigma_position_{a}_m": np.full_like(result.passes["t_s"], 1e3) for a in "xy"}
    assert plan.draw(result) is not None
    assert plan.draw(changed(result, **lost)) is None


def test_a_number_is_not_parted_from_its_unit():
    text = "tilt comes from the accelerometer over 10 s windows of 1.2 deg and 3 stops"
    for width in np.linspace(0.8, 4.0, 60):
        found = lists.wrapped(text, float(width), style.LABEL, most=9)
        assert not any(line.split("\u00a0")[0].startswith(("s ", "deg")) for line in found)
        assert " ".join(found).replace("\u00a0", " ") == text


def test_labels_of_neighbouring_strips_are_apart():
    for inset, apart in ((rows.INSET, True), (0.0, False)):
        page = Page(3.0, "light", "t")
        for top in (0.5, 0.5 + rows.STRIP + rows.WITHIN):
            panel = page.panel((1.05, top, 5.9, rows.STRIP), (0.0, 1.0), (-10.0, 10.0))
            panel.y_axis(([-10.0, 10.0], ["−10°", "+10°"]), inset=inset)
        boxes = [frame.text_box(w.text, w.size, w.x, w.y, w.align) for w in page.texts]
        assert frame.overlap(boxes[0], boxes[3]) is not apart


@pytest.mark.parametrize("key", ["statistics", "advice", "checks", "coverage", "settings", "methods", "gaps", "input"])
def test_pages_of_a_result_without_a_part_of_its_report(make, key):
    result = make(durations=SHORT)
    report = {k: v for k, v in result.report.items() if k != key}
    assert len(dict(figures.pages(dataclasses.replace(result, report=report)))) >= 5


def test_a_filter_that_takes_the_vehicle_as_level_speaks_of_heading(make):
    result = make(durations=SHORT, heading="relative")
    methods = {"filter": "heading", "smoother": "rts", "not_estimated": ["roll", "pitch"]}
    drive = Drive(changed(result, {"methods": methods}))
    title = overview.titles(drive)[0]
    assert title.startswith("Relative heading known to ")
    assert "roll and pitch taken as level" in title
    assert "tilt" not in title.lower()
    words = [name for _, name, _ in overview.key_numbers(drive)]
    assert "heading σ, median" in words
    assert "tilt σ, median" not in words
    page = overview.draw(changed(make(heading="relative", position="none"), {"methods": methods}))
    assert "heading σ" in texts(page)
    assert "tilt σ" not in texts(page)
    usual = overview.titles(Drive(result))[0]
    assert usual.startswith("Tilt known to ")


def test_a_place_that_fixes_gave_is_in_their_axes_though_heading_is_relative(make):
    result = make(**NO_HEADING)
    told = [{"code": "north-not-shown", "message": "the fixes do not show where north is", "hint": "", "fatal": False}]
    assert plan_view.axes_words(Drive(result)) == "m, turned by an unknown heading"
    assert plan_view.axes_words(Drive(changed(result, {"warnings": told}))) == "m, axes of the fixes"
