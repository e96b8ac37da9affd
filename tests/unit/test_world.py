"""Reference directions against published almanacs, and refusals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from attest_cli.errors import AttestError
from attest_cli.records import Fixes, Imu, Log
from attest_cli.settings import Settings
from attest_cli.world import find_world

NREL_NS = 1_066_419_030 * 10**9  # 2003-10-17 12:30:30 -07:00, the example of Reda & Andreas 2008 (NREL/TP-560-34302)
NREL = {"latitude_deg": 39.742476, "longitude_deg": -105.1786, "altitude_m": 1830.14}
Y2026_NS = 1_780_308_000 * 10**9


def log(t0_ns: int, *roles: str, t: tuple[float, ...] = (0.0,)) -> Log:
    imu = Imu(np.array([0.0, 1.0]), np.zeros((2, 3)), np.zeros((2, 3)))
    fixes = {role: Fixes(role, role, np.array(t), np.zeros((len(t), 3))) for role in roles}
    return Log((Path("x"),), t0_ns, t0_ns + np.array([0, 10**9]), imu, fixes, np.zeros((0, 2)), {})


def settings(**world: Any) -> Settings:
    return Settings.model_validate({"world": world})


def test_the_sun_is_where_the_almanac_has_it() -> None:
    found = find_world(log(NREL_NS, "sun"), settings(**NREL)).sun_n
    assert found is not None
    east, north, up = found[0]
    assert np.degrees(np.arctan2(east, north)) % 360 == pytest.approx(194.34024, abs=2e-3)
    assert np.degrees(np.arcsin(up)) == pytest.approx(39.88838, abs=0.02)  # with or without refraction (0.0163 deg)


def test_the_sun_moves_with_the_fixes() -> None:
    found = find_world(log(NREL_NS, "sun", t=(0.0, 3600.0)), settings(**NREL)).sun_n
    assert found is not None
    assert found.shape == (2, 3)
    assert np.allclose(np.linalg.norm(found, axis=1), 1.0)
    turned = np.degrees(np.arccos(found[0] @ found[1]))
    assert turned == pytest.approx(15.0 * np.cos(np.radians(9.3)), abs=0.05)  # an hour at the sun's declination


@pytest.mark.parametrize(
    ("place", "declination", "dip"),
    [((46.5, 6.6), 3.3, 62.5), ((-42.9, 147.3), 15.0, -72.0), ((64.1, -21.9), -11.0, 76.0)],
    ids=["Lausanne", "Hobart", "Reykjavik"],
)
def test_the_magnetic_field_has_the_signs_of_the_chart(
    place: tuple[float, float], declination: float, dip: float
) -> None:
    """Isogonic and isoclinic charts of 2025, to two degrees."""
    wanted = settings(latitude_deg=place[0], longitude_deg=place[1])
    field = find_world(log(Y2026_NS, "magnetometer"), wanted).field_n
    assert field is not None
    east, north, up = field
    assert np.degrees(np.arctan2(east, north)) == pytest.approx(declination, abs=2.0)
    assert np.degrees(np.arctan2(-up, np.hypot(east, north))) == pytest.approx(dip, abs=2.0)
    assert 4e-5 < np.linalg.norm(field) < 7e-5


def test_the_settings_come_first() -> None:
    wanted = settings(sun_direction=[0.0, 3.0, 4.0], magnetic_field_ut=[1.0, 20.0, -40.0], **NREL)
    found = find_world(log(Y2026_NS, "sun", "magnetometer"), wanted)
    assert found.sun_n is not None
    assert found.field_n is not None
    assert np.allclose(found.sun_n, [0.0, 0.6, 0.8])
    assert np.allclose(found.field_n, [1e-6, 2e-5, -4e-5])
    assert not found.notes


def test_without_a_place_nothing_is_known_and_nothing_computed() -> None:
    found = find_world(log(Y2026_NS, "sun", "magnetometer"), settings())
    assert found.sun_n is None
    assert found.field_n is None
    assert found.gravity == 9.80665


def test_mars_has_its_gravity_and_no_computed_sun() -> None:
    assert find_world(log(Y2026_NS), settings(body="mars")).gravity == pytest.approx(3.72076)
    with pytest.raises(AttestError, match="Earth only"):
        find_world(log(Y2026_NS, "sun"), settings(body="mars", **NREL))
    assert find_world(log(Y2026_NS, "magnetometer"), settings(body="mars", **NREL)).field_n is None


def test_a_clock_that_counts_from_zero_has_no_sun() -> None:
    with pytest.raises(AttestError, match="not absolute"):
        find_world(log(0, "sun"), settings(**NREL))
