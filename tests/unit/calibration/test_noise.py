from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, lfilter
from support import still

from attest_cli.calibration.allan import allan_deviation
from attest_cli.calibration.noise import MOST_BLOCKS, fit_noise, low_pass_note, read_instability
from attest_cli.calibration.records import Allan
from attest_cli.calibration.spectrum import band_density, ordinates, white_samples


def test_the_reference_vector() -> None:
    v = still.vectors("allan")
    period = 1.0 / float(v["fs"])
    found = fit_noise([still.piece(len(v["rate"]), period)], [v["rate"]], 1, across=True)
    np.testing.assert_allclose([found.N, found.K], v["ml"], rtol=2e-6)  # the vector's own search stopped at 1e-6
    assert pytest.approx(v["truth"][0], rel=0.01) == found.N
    assert pytest.approx(v["truth"][1], rel=0.35) == found.K


def test_two_hours_at_20_hz() -> None:
    rate = still.walking(np.random.default_rng(11), 144_000, 0.05, 0.01, 2e-4)
    found = fit_noise([still.piece(len(rate), 0.05)], [rate], 1, across=True)
    assert pytest.approx(0.01, rel=0.01) == found.N
    assert found.K is not None
    assert pytest.approx(2e-4, rel=0.35) == found.K
    assert found.notes == ("144000 samples, averaged by 2 before the fit",)
    assert len(rate) > MOST_BLOCKS


def test_a_walk_that_is_not_seen_is_none_with_a_bound() -> None:
    rate = still.walking(np.random.default_rng(1), 6000, 0.05, 0.01, 0.0)
    found = fit_noise([still.piece(6000, 0.05)], [rate], 1, across=True)
    assert found.K is None
    assert found.K_interval is not None
    assert found.K_interval[0] == 0.0
    assert 0.0 < found.K_interval[1] < 1e-3
    assert "no random walk seen in 300 s" in found.notes[0]


def test_a_drive_shows_its_walk_between_stops() -> None:
    drive = still.stops(np.random.default_rng(3), "random walk", minutes=60.0)
    between = fit_noise(drive.pieces, drive.rates, 1, across=True)
    inside = fit_noise(drive.pieces, drive.rates, 1, across=False)
    assert pytest.approx(5e-4, rel=0.35) == between.K
    assert between.K_interval is not None
    assert inside.K_interval is not None
    assert between.K_interval[1] < 0.2 * inside.K_interval[1]
    assert pytest.approx(0.01, rel=0.02) == inside.N


def test_levels_that_differ_from_stop_to_stop_do_not_count_as_a_walk_of_the_accelerometer() -> None:
    rng = np.random.default_rng(4)
    pieces = [still.piece(500, 0.02, 60.0 * k, k) for k in range(10)]
    values = [rng.normal(3.0 * rng.normal(), 0.01 / np.sqrt(0.02), 500) for _ in pieces]
    found = fit_noise(pieces, values, 1, across=False)
    assert found.K is None
    assert pytest.approx(0.01, rel=0.05) == found.N


def test_the_ordinates_are_white_noise_and_walk() -> None:
    rate = still.walking(np.random.default_rng(5), 40_000, 0.1, 0.01, 2e-3)
    share, s, power = ordinates([rate])
    expected = 0.01**2 / 0.1 * s + 2e-3**2 * 0.1
    for low, high in ((0.0, 0.01), (0.01, 0.1), (0.1, 1.0)):
        inside = (share > low) & (share <= high)
        assert np.mean(power[inside] / expected[inside]) == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / inside.sum()))
    N, terms = band_density([rate], 0.1, 4, 2e-3)
    assert pytest.approx(0.01, rel=4.0 * np.sqrt(0.5 / terms)) == N


def test_white_noise_is_white_at_one_sample() -> None:
    rng = np.random.default_rng(6)
    axes = [[rng.normal(size=3000), rng.normal(size=500)] for _ in range(3)]
    assert white_samples(axes, 0.01) == (1, 1.0)


@pytest.mark.parametrize("corner", [5.0, 10.0, 20.0])
def test_a_low_pass_of_the_sensor_does_not_make_it_look_quieter(corner: float) -> None:
    b, a = butter(2, corner, fs=100.0)
    rates = [
        lfilter(b, a, still.walking(np.random.default_rng([seed, 7]), 30_000, 0.01, 0.01, 0.0)) for seed in range(4)
    ]
    pieces = [still.piece(30_000, 0.01)]
    samples, share = white_samples([[rate] for rate in rates], 0.01)
    assert samples >= 50.0 / corner
    assert share < 0.8
    found = [fit_noise(pieces, [rate], samples, across=True) for rate in rates]
    assert np.mean([f.N for f in found]) == pytest.approx(0.01, rel=0.03)
    single = fit_noise(pieces, [rates[0]], 1, across=True)
    assert single.N < 0.007
    assert "% quieter than its noise density (its own low-pass)" in low_pass_note("gyro", 50.0 / samples, share)


def curve(deviation: list[float], width: float = 0.05) -> Allan:
    d = np.array(deviation)
    return Allan(np.arange(1.0, len(d) + 1.0), d, d * (1 - width), d * (1 + width), np.full(len(d), 100.0))


def test_bias_instability_is_read_off_the_lowest_known_point() -> None:
    assert read_instability(curve([4, 2, 1, 2]), 1.0) == (pytest.approx(1 / 0.664), 3.0, "")
    assert read_instability(curve([4, 3, 2, 1]), 1.0)[:2] == (None, None)
    assert "still falls" in read_instability(curve([4, 3, 2, 1]), 1.0)[2]
    assert "too short" in read_instability(curve([4, 1, 2], width=0.9), 1.0)[2]
    assert "white noise explains" in read_instability(curve([4, 2, 1, 2]), 2.0)[2]
    seen = allan_deviation([still.walking(np.random.default_rng(8), 40_000, 0.1, 0.01, 1e-3)], 0.1, walk_ratio=1e-2)
    B, tau, _ = read_instability(seen, 0.01)
    assert pytest.approx(np.sqrt(2 * 0.01 * 1e-3 / np.sqrt(3)) / 0.664, rel=0.15) == B
    assert tau is not None
    assert 5.0 < tau < 60.0


@pytest.mark.parametrize(("stops", "seconds", "hz"), [(1, 240.0, 20.0), (3, 2.0, 20.0), (15, 6.0, 20.0)])
def test_white_noise_has_no_bias_instability(stops: int, seconds: float, hz: float) -> None:
    """An interval of 95 %: few of sixty records may seem to have one."""
    found = 0
    for seed in range(60):
        rng = np.random.default_rng([seed, stops])
        rates = [rng.normal(0.0, 1e-3 * np.sqrt(hz), round(seconds * hz)) for _ in range(stops)]
        pieces = [still.piece(len(x), 1.0 / hz, 60.0 * k, k) for k, x in enumerate(rates)]
        N = fit_noise(pieces, rates, 1, across=True).N
        found += read_instability(allan_deviation(rates, 1.0 / hz), N)[0] is not None
    assert found <= 5
