"""Fixes in other units, in the wrong place, without digits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from attest_cli.prepare import places
from attest_cli.records import Channel, Warn
from attest_cli.settings.models import World

LAUSANNE = np.array([46.5, 6.6])


def channel(factor: float = 1.0, unit: str = "deg") -> Channel:
    track = np.round((LAUSANNE + np.arange(20)[:, None] * [1e-5, 2e-5]) * factor, 9)
    values = {"latitude": track[:, 0], "longitude": track[:, 1]}
    return Channel("gps", "columns", "gps", np.arange(20), values, dict.fromkeys(values, unit))


@pytest.mark.parametrize(
    ("factor", "codes"), [(1.0, []), (1e7, ["unit-contradicted"]), (np.pi / 180, ["unit-contradicted"])]
)
def test_every_unit_becomes_degrees(factor: float, codes: list[str]) -> None:
    told: list[Warn] = []
    found = places.degrees(channel(factor), told)
    np.testing.assert_allclose(found[0], LAUSANNE, rtol=1e-6)
    assert [w.code for w in told] == codes


def test_radians_that_are_stated_need_no_word() -> None:
    told: list[Warn] = []
    np.testing.assert_allclose(places.degrees(channel(np.pi / 180, "rad"), told)[0], LAUSANNE, rtol=1e-6)
    assert not told


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("longitude", [6.6, 0.4, 106.6])
def test_degrees_and_minutes_of_nmea_are_told_from_counts(sign: float, longitude: float) -> None:
    true = sign * (np.array([46.5, longitude]) + np.arange(20)[:, None] * [1e-5, 2e-5])
    whole = np.trunc(true)
    written = np.round(100.0 * whole + 60.0 * (true - whole), 6)
    told: list[Warn] = []
    c = channel()
    c = replace(c, values={"latitude": written[:, 0], "longitude": written[:, 1]})
    np.testing.assert_allclose(places.degrees(c, told), true, atol=2e-8)
    (warning,) = told
    assert warning.code == "unit-contradicted"
    assert "ddmm.mmmm" in warning.message


def test_zero_zero_is_no_fix() -> None:
    c = channel()
    c.values["latitude"][:3] = c.values["longitude"][:3] = 0.0
    assert np.isnan(places.degrees(c, [])[:3]).all()


def test_a_place_far_from_the_stated_one_is_told_and_swapped_axes_are_named() -> None:
    place = places.degrees(channel(), [])
    here, elsewhere = World(latitude_deg=46.6, longitude_deg=6.5), World(latitude_deg=6.6, longitude_deg=46.5)
    assert places.doubts(channel(), place, here) == []
    assert places.doubts(channel(), place, World()) == []
    (told,) = places.doubts(channel(), place, elsewhere)
    assert told.fatal
    assert "swapped" in told.message


def test_missing_digits_are_told() -> None:
    assert places.coarse(channel(), places.degrees(channel(), []), 3.0) == []
    rough = channel()
    for name, step in (("latitude", 1.1e-3), ("longitude", 2.3e-3)):
        rough.values[name][:] = np.round(rough.values[name] + step * np.arange(20), 3)
    (told,) = places.coarse(rough, places.degrees(rough, []), 3.0)
    assert "rounded to 111 m" in told.message
