"""Ticks: decimals from the step, true minus, 1-2-5 on log axes, min:s and hours on time axes."""

from __future__ import annotations

import math

import pytest

from attest_cli.figures import ticks
from attest_cli.figures.words import THIN


def test_decimals_come_from_the_step():
    at, words = ticks.linear(0.05, 0.26, 5)
    assert words == ["0.05", "0.10", "0.15", "0.20", "0.25"]
    assert at == pytest.approx([0.05, 0.1, 0.15, 0.2, 0.25])
    assert ticks.linear(0.0, 0.1, 4)[1] == ["0.000", "0.025", "0.050", "0.075", "0.100"]


def test_minus_is_a_minus_and_thousands_are_apart():
    assert ticks.linear(-2000.0, 2000.0, 4)[1] == [f"−2{THIN}000", f"−1{THIN}000", "0", f"1{THIN}000", f"2{THIN}000"]


@pytest.mark.parametrize(
    ("limit", "words"),
    [
        (1.4, ["−1°", "0", "+1°"]),
        (2.6, ["−2.5°", "0", "+2.5°"]),
        (0.17, ["−0.1°", "0", "+0.1°"]),
        (0.029, ["−0.025°", "0", "+0.025°"]),
        (10.0, ["−10°", "0", "+10°"]),
    ],
)
def test_symmetric_ticks(limit, words):
    assert ticks.symmetric(limit, "°")[1] == words


def test_log_ticks_are_one_two_five_or_decades():
    assert ticks.log(0.02, 2.5, 8, "°")[1] == ["0.02°", "0.05°", "0.1°", "0.2°", "0.5°", "1°", "2°"]
    assert ticks.log(3.0, 30000.0, 6)[1] == ["10", "100", f"1{THIN}000", f"10{THIN}000"]
    assert ticks.log(2e4, 3e8, 5)[1] == ["10⁵", "10⁶", "10⁷", "10⁸"]
    assert ticks.log(1.9, 2.2, 8, "°")[1] == ["1.9°", "2.0°", "2.1°", "2.2°"]
    assert len(ticks.log(1e-6, 1e9, 7)[0]) <= 7


@pytest.mark.parametrize(
    ("span", "words", "label"),
    [
        (1284.0, ["0:00", "3:00", "6:00", "9:00", "12:00", "15:00", "18:00", "21:00"], "time since start, min:s"),
        (117.0, ["0:00", "0:15", "0:30", "0:45", "1:00", "1:15", "1:30", "1:45"], "time since start, min:s"),
        (86400.0, [str(h) for h in range(0, 25, 2)], "time since start, h"),
        (0.4, ["0:00.00", "0:00.05", "0:00.10", "0:00.15", "0:00.20", "0:00.25", "0:00.30", "0:00.35", "0:00.40"],
         "time since start, min:s"),
    ],
)  # fmt: skip
def test_time_ticks(span, words, label):
    assert ticks.time(0.0, span)[1] == words
    assert ticks.time_label(0.0, span) == label


@pytest.mark.parametrize("span", [1e-3, 1.0, 17.0, 3600.0, 90_000.0, 4e6, 3e8])
def test_time_ticks_are_few_and_inside(span):
    at, words = ticks.time(5.0, 5.0 + span)
    assert len(at) == len(words) == len(set(words)) <= 13
    assert all(5.0 - 1e-9 <= v <= 5.0 + span + 1e-9 for v in at)


@pytest.mark.parametrize("value", [1e-9, 0.0123, 1.0, 1.01, 99.5, 12345.6])
def test_rounded_up_is_up_and_close(value):
    assert value <= ticks.rounded_up(value) * (1 + 1e-12) <= value * 1.1 + 1e-12


@pytest.mark.parametrize("value", [0.0, math.nan, math.inf, -1.0])
def test_a_panel_without_data_still_has_limits(value):
    assert ticks.rounded_up(value) == 1.0


def test_angle_ticks_use_whole_parts_of_a_turn():
    assert ticks.angle(-12.0, 13.0)[1] == ["−10°", "0°", "10°"]
    assert ticks.angle(0.0, 480.0)[1] == ["0°", "180°", "360°"]
