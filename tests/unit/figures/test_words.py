"""Numbers and names as written: what a log calls itself is drawn, never obeyed."""

from __future__ import annotations

import math
import unicodedata

import pytest

from attest_cli.figures import style, words

HOSTILE = [
    "a\u202egnp.exe", "x\x1b]0;evil\x07y", "\u200f\u2066abc\u2069", "e\u0301\u0301\u0301\u0301",
    "\ue000\uf8ff", "line\r\nbreak\ttab",
    "$x_1$ \\frac{", "[red]bold[/red]", "\ud800", "z" * 140,
]  # fmt: skip


@pytest.mark.parametrize("text", HOSTILE)
def test_clean_leaves_nothing_that_hides(text):
    out = words.clean(text)
    assert len(out) <= 61
    assert not any(unicodedata.category(c) in ("Cc", "Cf", "Cs", "Co", "Mn", "Me") for c in out)
    assert words.clean(out, 61) == out


def test_clean_says_where_something_was():
    assert words.clean("a\u202e\u202eb") == "a\ufffdb"
    assert words.clean("e\u0301") == "é"
    assert words.clean("x\n y") == "x y"
    assert words.clean("$x_1$ \\frac{") == "$x_1$ \\frac{"
    assert words.clean("z" * 140) == "z" * 60 + "…"


def test_signs_without_a_glyph_are_replaced_before_drawing():
    assert style.drawable("a中\ufffdσ°²√±−×≤·…χτ") == "a??σ°²√±−×≤·…χτ"


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.186, "0.19"), (0.4, "0.40"), (0.0996, "0.10"), (12.34, "12"), (123.4, "120"),
     (0.0, "0"), (-2.71, "−2.7"), (9.96, "10")],
)  # fmt: skip
def test_two_digits(value, text):
    assert words.two_digits(value) == text


@pytest.mark.parametrize("value", [0.3301, 0.3299, 1.0, 0.0996, 45.2, 101.0])
def test_rounded_up_keeps_below_true(value):
    shown = float(words.two_digits(value, up=True))
    assert value <= shown <= value * 1.1


def test_not_a_number_is_a_dash():
    assert [words.two_digits(math.nan), words.number(math.inf), words.percent(math.nan)] == ["–"] * 3


@pytest.mark.parametrize(
    ("share", "text"),
    [(1.0, "100"), (0.9998, "99.98"), (0.996, "99.6"), (0.204, "20"), (0.0, "0"), (0.0004, "0.04"), (1e-9, "< 0.001")],
)
def test_percent_is_hundred_only_when_it_is_all(share, text):
    assert words.percent(share) == f"{text}{words.THIN}%"


def test_times():
    assert words.duration(1284.0) == "21 min 24 s"
    assert words.duration(86400.0) == "24 h 0 min"
    assert words.duration(0.4) == "0.4 s"
    assert words.clock(168.0) == "2:48"
    assert words.clock(29560.0) == "8:12:40"
    assert words.clock(3725.0, hours=True) == "1:02:05"
    assert words.date("2026-11-21T14:03:12Z") == "21 Nov 2026 14:03:12 UTC"
    assert words.date("2026-11-21T16:03:12+02:00") == "21 Nov 2026 14:03:12 UTC"
    assert words.date(None) == ""
    assert words.date("\x1b[31mno date") == "\ufffd[31mno date"


def test_first_fit_takes_the_longest_that_fits():
    assert words.first_fit(["a" * 95, "b" * 80, "c"]) == "b" * 80
    assert len(words.first_fit(["a" * 200])) <= 90
    assert words.counted(7, "stop") == "Seven stops"
    assert words.counted(1, "stop") == "One stop"
    assert words.counted(78, "stop") == "78 stops"
