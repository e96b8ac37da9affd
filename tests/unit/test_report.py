"""The report room: the model of report.json, the pages in their folder, the page of HTML."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from attest_cli import figures
from attest_cli.errors import AttestError
from attest_cli.position import Position
from attest_cli.records import Fixes, Imu, Log, Result, Warn
from attest_cli.report import Report, TrackRow, html
from attest_cli.report.build import _median, _position_check, _position_numbers
from attest_cli.report.pages import write_pages

EVIL = '<script>alert(1)</script>"\x1b]0;\u202e'


@dataclass
class Drawn:
    title: str = "Heading known to 0.19°"
    alt: str = f"what is drawn {EVIL}"
    data: bytes = b"\x89PNG"

    def png(self) -> bytes:
        return self.data


def facts(**changes: Any) -> dict[str, Any]:
    report: dict[str, Any] = {
        "attest_version": "0.1.0",
        "created_utc": "2026-11-21T14:03:12Z",
        "verdict": "WARN",
        "input": {
            "files": [{"name": EVIL, "path": EVIL, "bytes": 1, "sha256": "3f9a", "format": "csv"}],
            "start_utc": "2026-11-21T14:03:12Z",
            "duration_s": 60.0,
            "samples": 6000,
            "rate_hz": 100.0,
            "sensors": ["sun sensor"],
        },
        "channels": [],
        "coverage": {
            "rows_in": 6000, "rows_used": 6000, "rows_dropped": 0, "seconds_in": 60, "seconds_used": 60, "share": 1
        },
        "settings": {
            "smoothing.filter": {"value": "auto", "source": "default"},
            "sun.channel": {"value": EVIL, "source": "command line"},
        },
        "methods": {"filter": "indirect", "smoother": "two-filter", "iterations": 1, "position": "none"},
        "heading": "absolute",
        "body": {"axes": "imu", "q_body_sensor": [1, 0, 0, 0], "how": "the IMU's own"},
        "statistics": {"motions": 1, "stops": 1, "sigma_heading_median_deg": float("nan")},
        "warnings": [{"code": "gap", "message": f"gap {EVIL}", "hint": "see there"}],
        "checks": [{"name": "gaps", "status": "WARN", "fact": "A gap of 2 s", "detail": "at 0:30"}],
        "advice": {"threshold_deg": 2.0, "axis": "heading", "lines": ["stop every 5 min"]},
    }  # fmt: skip
    return Report.model_validate({**report, **changes}).model_dump(mode="json")


def result(folder: Path, **changes: Any) -> Result:
    segments = (
        {"index": 1, "kind": "stop", "start_s": 0.0, "end_s": 20.0, "duration_s": 20.0, "checks": "ok"},
        {
            "index": 2, "kind": "motion", "start_s": 20.0, "end_s": 60.0, "duration_s": 40.0, "checks": EVIL,
            "sigma_attitude_forward_deg": 1.234, "sigma_attitude_smoothed_deg": float("nan"),
        },
    )  # fmt: skip
    t = np.linspace(0.0, 60.0, 7)
    return Result(folder, facts(**changes), {"t_s": t, "moving": t > 20.0}, {}, segments)


class Tags(HTMLParser):
    """Tags and what refers to elsewhere."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.names: list[str] = []
        self.links: list[str] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.names.append(tag)
        self.links += [value or "" for name, value in attrs if name in {"src", "href"}]

    def handle_data(self, data: str) -> None:
        self.text += data + "\n"


def test_no_number_is_null_and_nothing_unnamed_passes() -> None:
    assert facts()["statistics"]["sigma_heading_median_deg"] is None
    with pytest.raises(ValidationError, match="sigma_headin_median_deg"):
        facts(statistics={"motions": 1, "stops": 1, "sigma_headin_median_deg": 1.0})
    with pytest.raises(ValidationError, match="verdict"):
        facts(verdict="FINE")


def test_a_row_of_the_track_has_the_columns_of_the_interface() -> None:
    columns = list(TrackRow.model_fields)
    assert columns[:9] == ["timestamp_ns", "t_s", "q_w", "q_x", "q_y", "q_z", "roll_deg", "pitch_deg", "yaw_deg"]
    assert {"sigma_att_z_deg", "gyro_bias_x_rad_s", "position_z_m", "velocity_y_m_s", "segment", "moving"} <= set(
        columns
    )


def test_html_is_one_page_with_nothing_from_elsewhere_and_nothing_of_the_log_unescaped(tmp_path: Path) -> None:
    page = html.page(
        result(tmp_path), [({"file": "01-overview.png", "title": f"Known {EVIL}", "alt": EVIL}, b"\x89PNG")]
    )
    found = Tags(page)
    assert "script" not in found.names
    assert not set(page) & {"\x1b", "\u202e"}
    assert [link[:22] for link in found.links] == ["data:image/png;base64,"]
    assert "http" not in page
    assert "@import" not in page
    for words in (
        "A gap of 2 s",
        "at 0:30",
        "stop every 5 min",
        "1.2°",
        "two-filter" if "two-filter" in page else "command line",
    ):
        assert words in found.text
    assert found.names.count("tr") == 1 + 2 + 1 + 2  # segments and settings, each with a head


def test_html_bears_what_the_drive_does_not_show(tmp_path: Path) -> None:
    unknown = {"name": "odometry noise", "values": [None], "sigma": [], "unit": "m/s"}
    assert "<td>odometry noise</td><td>–</td>" in html.page(result(tmp_path, shown=[unknown]), [])


def test_html_tells_no_time_of_writing(tmp_path: Path) -> None:
    pages = [html.page(result(tmp_path, created_utc=when), []) for when in ("2026-11-21T14:03:12Z", "2027-01-01")]
    assert pages[0] == pages[1]


def test_html_has_both_themes(tmp_path: Path) -> None:
    page = html.page(result(tmp_path), [])
    dark = re.search(r"prefers-color-scheme:dark\)\{:root\{([^}]*)\}", page)
    assert dark is not None
    assert "--paper:#0F1318" in dark[1]
    assert "--paper:#FFFFFF" in page


def test_pages_are_put_in_place_and_stale_ones_taken_away(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = iter([("01-overview.png", Drawn()), ("05-innovations-sun.png", Drawn(data=b"\x89PNG2"))])
    monkeypatch.setattr(figures, "pages", lambda *_: drawn)
    (tmp_path / "report").mkdir()
    for name in ("02-separation.png", "mine.png"):
        (tmp_path / "report" / name).write_bytes(b"old")
    told: list[tuple[str, float]] = []
    entries = write_pages(result(tmp_path), tmp_path, "light", lambda stage, share: told.append((stage, share)))
    assert [entry["file"] for entry in entries] == ["01-overview.png", "05-innovations-sun.png"]
    assert {file.name for file in (tmp_path / "report").iterdir()} == {
        "01-overview.png", "05-innovations-sun.png", "report.html", "mine.png"
    }  # fmt: skip
    assert (tmp_path / "report" / "05-innovations-sun.png").read_bytes() == b"\x89PNG2"
    assert len(told) == 2


def test_a_page_never_leaves_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(figures, "pages", lambda *_: iter([("05-innovations-../../x.png", Drawn())]))
    with pytest.raises(AttestError, match="is no name of a page"):
        write_pages(result(tmp_path), tmp_path, "light")
    assert list(tmp_path.iterdir()) == []


def test_a_median_over_time_does_not_count_nodes() -> None:
    t = np.concatenate([np.arange(0.0, 10.0, 0.01), np.arange(10.0, 101.0)])  # dense where the sigma is small
    assert _median(np.where(t < 10.0, 1.0, t), t) == pytest.approx(50.0, abs=1.0)
    assert _median(np.array([3.0, np.nan, np.nan]), np.array([0.0, 1.0, 2.0])) == 3.0
    assert _median(np.array([4.0]), np.array([7.0])) == 4.0


@pytest.mark.parametrize(
    ("method", "roles", "codes", "said"),
    [("strapdown", (), (), "no sensor aids it"), ("strapdown", ("odometry",), ("odometry-contradicts",), "was refused"),
     ("navigation", ("odometry",), ("odometry-not-used",), "was refused"), ("odometry", ("odometry",), (), "usable")],
)  # fmt: skip
def test_an_unusable_position_names_its_cause(
    method: str, roles: tuple[str, ...], codes: tuple[str, ...], said: str
) -> None:
    run = SimpleNamespace(
        position=SimpleNamespace(method=method), segmentation=SimpleNamespace(motions=(1,)),
        log=SimpleNamespace(fixes=dict.fromkeys(roles)), warnings=[Warn(code, "") for code in codes],
    )  # fmt: skip
    told = _position_check(run, {"position_sigma_max_m": 99.0, "position_usable": False})  # type: ignore[arg-type]
    assert told is not None
    assert said in told["fact"]
    assert ("odometry would hold it" in told["detail"]) == (not roles)


@pytest.mark.parametrize(("sigma", "method", "usable"), [
    (0.9, "navigation", True), (1.2, "navigation", False), (0.9, "odometry", False)])  # fmt: skip
def test_a_place_as_sure_as_its_fixes_is_usable_however_short_the_drive(
    sigma: float, method: str, usable: bool
) -> None:
    t, zero = np.arange(5.0), np.zeros((5, 3))
    fixes = Fixes("gps", "fix", t, zero, np.full((5, 3), 1.0))
    log = Log((), 0, (1e9 * t).astype(np.int64), Imu(t, zero, zero), {"gps": fixes}, np.zeros((0, 2)), {})
    P = np.tile(sigma**2 * np.eye(3), (5, 1, 1))
    position = Position(zero, zero, P, {}, {2: 5.0}, False, method, lambda: iter(()))
    assert _position_numbers(position, t, log)["position_usable"] == usable
    assert _position_numbers(position, t, replace(log, fixes={}))["position_usable"] is False
