"""Rehbinder & Hu, Drift-free attitude estimation using quasi-linear observers: theorem, remarks, filters."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from support.walking import passes, riccati, rms_deg, tilt, walk

from attest_cli.filters.vertical import Method, Turns, law, observe, towards, up
from attest_cli.maths import kalman, rotation
from attest_cli.maths.sequential import Pass

Array = NDArray[np.float64]
EYE = np.eye(3)
T = 0.005
STARTS = np.radians(np.append(np.arange(1.0, 180.0, 2.0), [179.9, 179.99, 179.999]))


def tumbling(n: int) -> tuple[Array, Array]:
    """Steps (n - 1, 3, 3) of a body that turns over and over, and its vertical (n, 3)."""
    t = T * np.arange(n - 1)
    rate = np.stack([2.0 * np.sin(0.7 * t), 1.5 * np.cos(1.1 * t), 1.0 + 0.5 * np.sin(0.3 * t)], axis=1)
    Phi = rotation.matrix(rotation.exp_quaternion(-rate * T))
    x = [EYE[2]]
    for step in Phi:
        x.append(step @ x[-1])
    return Phi, np.array(x)


def error(start: float, gain: Array) -> Array:
    """xi = 1 - x'x^ of the geometric observer (1.42) on a tumbling body, ``start`` rad off at first; l (n - 1,) 1/s."""
    Phi, x = tumbling(len(gain) + 1)
    seen = np.array([np.sin(start), 0.0, np.cos(start)])
    xi = [1.0 - x[0] @ seen]
    for k, step in enumerate(Phi):
        seen = towards(step @ seen, x[k + 1], float(gain[k]) * T)
        xi.append(1.0 - x[k + 1] @ seen)
    return np.array(xi)


@pytest.mark.parametrize("start", STARTS, ids=lambda a: f"{np.degrees(a):g}")
def test_theorem_1_the_error_follows_its_law_from_any_start_but_the_antipode(start: float) -> None:
    gain = np.full(800, 2.0)
    area = T * np.concatenate([[0.0], np.cumsum(gain)])
    xi, xi0 = error(start, gain), 1.0 - np.cos(start)
    assert np.abs(xi - law(xi0, area)).max() < 1e-6  # (1.31)
    bound = xi0 / (1.0 - 0.5 * xi0) * np.exp(-2.0 * area)
    assert (xi <= bound * (1 + 1e-9) + 1e-12).all()  # (1.32)
    assert xi[-1] < 0.05 * xi0 or start > np.radians(178.0)


def test_theorem_1_the_domain_of_attraction_ends_at_the_antipode() -> None:
    """[0, 2), where the paper prints [0, 2]: xi = 2 is an equilibrium."""
    xi = error(np.pi, np.full(400, 2.0))
    assert np.abs(xi - 2.0).max() < 1e-9


def test_remark_2_the_gain_may_be_zero_on_intervals() -> None:
    gain = np.where((np.arange(2000) // 200) % 2, 0.0, 3.0)
    xi, xi0 = error(np.radians(150.0), gain), 1.0 - np.cos(np.radians(150.0))
    area = T * np.concatenate([[0.0], np.cumsum(gain)])
    assert np.abs(xi - law(xi0, area)).max() < 1e-6
    quiet = np.flatnonzero(gain == 0.0)
    assert np.abs(xi[quiet + 1] - xi[quiet]).max() < 1e-12


def steady(y: Array, gain: float, turns: Array, bias_state: bool = False, method: Method = "pseudo-linear") -> Pass:
    """A run whose scalar gain stands at l = ``gain``: q2 of one, q1 = l^2, p0 = sqrt(q1 q2)."""
    m, states = len(y) - 1, 6 if bias_state else 3
    q1 = gain**2
    steps = Turns(turns, np.full(m, T), np.tile(q1 * T * EYE, (m, 1, 1)), np.zeros(m), np.zeros((m, 3)), across=False)
    x0, P0 = np.zeros(states), gain * np.eye(states)
    x0[2] = 1.0
    return observe(steps, y, np.tile(EYE / T, (m + 1, 1, 1)), x0, P0, method)


@pytest.mark.parametrize("method", ["pseudo-linear", "geometric"])
def test_a_constant_gyro_bias_tilts_the_filter_and_not_the_smoother(method: Method) -> None:
    """At rest, gyro bias b: the forward pass lags by atan(b/l) (pseudo-linear) or asin(b/l) (geometric), whereas
    forward and backward lags cancel in the middle.
    """
    bias, gain, n = np.radians(0.5), 1.0, 12_000  # thirty time constants to the middle
    forward = steady(np.tile(EYE[2], (n, 1)), gain, np.tile([bias * T, 0.0, 0.0], (n - 1, 1)), method=method)
    u, _ = up(forward.x)
    lag = np.arccos(np.clip(u[-1, 2], -1, 1))
    wanted = np.arctan(bias / gain) if method == "pseudo-linear" else np.arcsin(bias / gain)
    smoothed = up(forward.x + kalman.rts(forward.chain).d)[0][n // 2]
    middle = np.degrees(np.linalg.norm(smoothed[:2]))
    print(f"{method}: lag {np.degrees(lag):.4f} deg, {np.degrees(wanted):.4f} wanted; smoothed {middle:.1e} deg")
    assert lag == pytest.approx(wanted, rel=0.01)
    if method == "pseudo-linear":  # linear: exact
        assert middle < 1e-6


def test_the_pseudo_linear_filter_is_not_slowed_near_the_antipode() -> None:
    """From 179.9 deg to 1 deg at l = 2: straight through space, where the geometric observer creeps around."""
    start, gain, n = np.radians(179.9), 2.0, 1600
    x0 = np.array([np.sin(start), 0.0, np.cos(start)])
    turns = Turns(np.zeros((n - 1, 3)), np.zeros(n - 1), np.tile(gain**2 * T * EYE, (n - 1, 1, 1)), np.zeros(n - 1),
                  np.zeros((n - 1, 3)), across=False)  # fmt: skip
    R, y = np.tile(EYE / T, (n, 1, 1)), np.tile(EYE[2], (n, 1))
    seconds = {}
    for method in ("pseudo-linear", "geometric"):
        u, _ = up(observe(turns, y, R, x0, gain * EYE, method).x)  # type: ignore[arg-type]
        inside = np.arccos(np.clip(u[:, 2], -1.0, 1.0)) < np.radians(1.0)
        seconds[method] = T * np.argmax(inside)
    print(seconds)
    assert seconds["pseudo-linear"] == pytest.approx(0.37, abs=0.03)
    assert seconds["geometric"] == pytest.approx(5.9, abs=0.1)


def test_remark_3_both_filters_agree_where_the_force_lies_along_the_estimate() -> None:
    """Its proof reads l (1 - |z|) [...] where the paper prints l (1 + |z|)."""
    u = np.array([0.6, 0.0, 0.8])
    along = 1.7 * u
    one, other = (
        observe(Turns(np.zeros((1, 3)), np.zeros(1), np.zeros((1, 3, 3)), np.zeros(1), np.zeros((1, 3)), across=False),
                np.tile(along, (2, 1)), np.tile(10 * EYE, (2, 1, 1)), u, EYE, method)
        for method in ("pseudo-linear", "projected")
    )  # fmt: skip
    assert np.abs(up(one.x)[0] - other.x).max() < 1e-12


def test_corollary_1_the_gain_of_constant_noise_converges() -> None:
    q1, q2 = 1e-4, 4e-3
    for p0 in (1e-6, 1.0):
        p = riccati(np.array([0.0, 60.0]), p0, q1, q2)
        assert p[0] == pytest.approx(p0)
        assert p[1] / q2 == pytest.approx(np.sqrt(q1 / q2), rel=1e-6)


# ------------------------------------------------------------------------------------ a walking robot, simulated

PAPER = {"gyro_bias": False, "gain": "scalar"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "rule", "ratio"), [("A", "constant", 0.5), ("B", "switching", 0.6), ("C", "switching", 0.7)]
)
def test_smoothing_pays(case: str, rule: str, ratio: float) -> None:
    """The paper's filter: scalar gain, no bias state, stops unknown to it. The page has the medians of many walks."""
    work = walk(case, 0.05, 100, 60.0).without_stops().with_settings(vertical={**PAPER, "acceleration": rule})
    errors = [rms_deg(tilt(p, work.up_b)[0]) for p in passes(work.run())]
    print(f"{case} {rule}: forward {errors[0]:.3f} deg, smoothed {errors[1]:.3f}, ratio {errors[1] / errors[0]:.2f}")
    assert errors[1] <= ratio * errors[0]


@pytest.mark.slow
@pytest.mark.parametrize(("case", "best"), [("A", 0.066), ("B", 0.205), ("C", 0.046)])
def test_projected_does_alike_and_the_rule_chosen_is_near_the_best(case: str, best: float) -> None:
    """A third of a walk, bias 0.5 deg/s: the page has the medians over whole ones, held to 1.1 times the best."""
    work = walk(case, 0.5, 101, 40.0)
    found = {}
    for method in ("pseudo-linear", "projected"):
        _, smoothed = passes(work.run(method))
        found[method], nees = tilt(smoothed, work.up_b)
        assert nees.mean() < 6.0
    one, other = (rms_deg(e) for e in found.values())
    print(f"{case}: {one:.4f} and {other:.4f} deg")
    assert other == pytest.approx(one, abs=0.01)
    assert one < 1.5 * best
