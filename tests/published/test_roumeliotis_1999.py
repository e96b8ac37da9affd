"""Roumeliotis, Sukhatme & Bekey 1999: the core against reference runs of the paper's equations (vectors v5, v6, v7).

``v6_run`` holds the forward filter with iterated updates, the literal backward pass and both positions;
``v7_frozen_gn`` the filter frozen at stops with zero rate, and the maximum a posteriori track. The runs of a filter
that carries its covariance across an update without the reset Jacobian (``ekf_*``, ``*_qs`` by RTS) are another
variant and are not compared.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from support.vectors import Vector6, apart, load, run_exact, vector6, wxyz

from attest_cli import smoothers
from attest_cli.filters import indirect
from attest_cli.maths import kalman, rotation
from attest_cli.maths.kalman import Chain, Errors
from attest_cli.position import strapdown
from attest_cli.records import FilterRun
from attest_cli.smoothers import gauss_newton, paper

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def plain() -> Vector6:
    return vector6()


@pytest.fixture(scope="module")
def forward(plain: Vector6) -> FilterRun:
    return run_exact(plain)


def fusion_case() -> tuple[Chain, Array, dict[str, Array]]:
    v = load("v5_fusion")
    one = np.zeros((1, 6, 6))
    chain = Chain(v["Pf"][None], v["Pf"][None], one[:0], one[:0], np.zeros((1, 6)), one, np.zeros((1, 6)), 3)
    turn = rotation.log_quaternion(rotation.multiply(rotation.conjugate(wxyz(v["qf"])), wxyz(v["qb"])))
    return chain, np.concatenate([turn, v["bb"] - v["bf"]]), v


@pytest.mark.parametrize("method", ["paper", "information"])
def test_fusion_is_vector_v5(method: str) -> None:
    chain, behind, v = fusion_case()
    if method == "paper":
        run = SimpleNamespace(chain=chain, q=wxyz(v["qf"])[None], bias=v["bf"][None])
        d, P = paper._fuse(run, 0, wxyz(v["qb"]), v["bb"], v["Pb"])  # type: ignore[arg-type]
    else:
        Y = np.linalg.inv(v["Pb"])
        fused = kalman.fuse(chain, Y[None], (Y @ behind)[None])
        d, P = fused.d[0], fused.P[0]
    assert np.abs(P - v["P"]).max() < 1e-12 * np.abs(v["P"]).max()
    assert np.abs(P[3:, 3:] - v["P"][3:, 3:]).max() < 1e-12 * np.abs(v["P"][3:, 3:]).max()
    q = rotation.multiply(wxyz(v["qf"]), rotation.exp_quaternion(d[:3]))
    assert np.abs(q - wxyz(v["q"])).max() < 1e-12
    assert np.abs(v["bf"] + d[3:] - v["b"]).max() < 1e-12 * np.abs(v["b"]).max()


def test_forward_filter_is_v6(plain: Vector6, forward: FilterRun) -> None:
    v, sub = plain.data, plain.data["sub"]
    after = apart(forward.q[sub], forward.bias[sub], forward.chain.P[sub], v["iekf_qu"], v["iekf_bu"], v["iekf_Pu"])
    print("iterated filter against v6, sigma:", after)
    assert max(after) < 1e-6
    sigma = np.sqrt(np.einsum("kii->ki", v["iekf_Pp"]))
    assert np.abs((forward.chain.P_pred[sub] - v["iekf_Pp"]) / (sigma[:, :, None] * sigma[:, None])).max() < 1e-6


def test_forward_filter_with_frozen_stops_and_zero_rate_is_v7() -> None:
    case, g = vector6(frozen=True), load("v7_frozen_gn")
    run, sub = run_exact(case), g["sub"]
    found = apart(run.q[sub], run.bias[sub], run.chain.P[sub], g["iekfF_qu"], g["iekfF_bu"], g["iekfF_Pu"])
    print("frozen filter against v7, sigma:", found)
    assert max(found) < 1e-6


def test_preintegration_at_a_poor_bias_costs_less_than_a_hundredth_of_a_sigma(plain: Vector6) -> None:
    run, v = indirect.run(plain.nodes, plain.start, gate_probability=1.0), plain.data
    sub = v["sub"]
    found = apart(run.q[sub], run.bias[sub], run.chain.P[sub], v["iekf_qu"], v["iekf_bu"], v["iekf_Pu"])
    print("preintegrated 0.6 deg/s off the bias, sigma:", found)
    assert max(found) < 1e-2


@pytest.mark.parametrize("smoother", ["two-filter", "none"])
def test_gauss_newton_is_the_map_of_v7_from_any_smoother(plain: Vector6, smoother: str) -> None:
    g, run = load("v7_frozen_gn"), indirect.run(plain.nodes, plain.start, gate_probability=1.0)
    smoothed = smoothers.SMOOTHERS[smoother](run)
    for _ in range(2):
        nodes = plain.nodes.rebuild(smoothed.bias)
        smoothed = gauss_newton.refine(nodes, plain.start, smoothed, None, 3)
    sub = g["sub"]
    found = apart(smoothed.q[sub], smoothed.bias[sub], smoothed.P[sub], g["gn_q"], g["gn_b"], g["gn_P"])
    print(f"Gauss-Newton from {smoother} against v7, sigma:", found)
    assert max(found) < 1e-4  # its Phi is of mean rates, that of the nodes of the turn itself


def test_the_smoothers_differ_from_the_map_by_their_linearisation_only(plain: Vector6, forward: FilterRun) -> None:
    """0.27 sigma in the note's table for its own RTS: the test of the test above, and its limit."""
    g, found = load("v7_frozen_gn"), smoothers.rts(forward)
    sub = g["sub"]
    distance = apart(found.q[sub], found.bias[sub], found.P[sub], g["gn_q"], g["gn_b"], g["gn_P"])
    print("RTS against the MAP, sigma:", distance)
    assert 1e-3 < max(distance) < 0.3


def test_two_filter_is_rts_on_the_whole_log(forward: FilterRun) -> None:
    two, one = smoothers.two_filter(forward), smoothers.rts(forward)
    sigma = np.sqrt(np.einsum("kii->ki", one.P))
    turn = rotation.log_quaternion(rotation.multiply(rotation.conjugate(one.q), two.q))
    assert np.abs(turn / sigma[:, :3]).max() < 1e-8
    assert np.abs((two.bias - one.bias) / sigma[:, 3:]).max() < 1e-8
    assert np.abs((two.P - one.P) / (sigma[:, :, None] * sigma[:, None])).max() < 1e-8


@pytest.fixture(scope="module")
def literal_errors(forward: FilterRun) -> Errors:
    return paper.errors(forward)


def test_literal_backward_and_fusion_are_v6(plain: Vector6, forward: FilterRun, literal_errors: Errors) -> None:
    v, found = plain.data, smoothers.apply(forward, literal_errors)
    at = v["lit_idx"]
    P = literal_errors.P[at]  # the vector keeps its covariance about the forward attitude
    distance = apart(found.q[at], found.bias[at], P, v["lit_q"], v["lit_b"], v["lit_P"])
    print("literal procedure against v6, sigma:", distance)
    assert max(distance) < 2e-6


def test_the_total_variance_lies_below_both_passes(plain: Vector6, forward: FilterRun, literal_errors: Errors) -> None:
    """What figures 3 and 4 of the paper show."""
    v = plain.data
    at = v["lit_idx"]
    total, ahead, behind = (np.einsum("kii->ki", P) for P in (literal_errors.P[at], forward.chain.P[at], v["lit_Pb"]))
    assert np.all(total <= ahead * (1 + 1e-9))
    assert np.all(total <= behind * (1 + 1e-9))
    assert total[-1, :3].sum() < 0.25 * ahead[-1, :3].sum()  # the forward pass has drifted by then


@pytest.mark.parametrize("literal", [True, False])
def test_integrated_position_is_v6(plain: Vector6, literal: bool) -> None:
    v = plain.data
    rows = slice(int(v["pos_i0"]), int(v["pos_i1"]) + 1)
    found = strapdown.Strapdown(v["t"], v["accel"], wxyz(v["qs_full_iekf"]), float(v["gI"][2]), literal)
    _, velocity, place, _, _ = next(found.run(rows))
    p, vel = (v["pos_lit"], v["vel_lit"]) if literal else (v["pos_trap"], v["vel_trap"])
    step = (rows.stop - rows.start) // (len(p) - 1)
    assert np.abs(place[::step][: len(p)] - p).max() < 1e-8 * np.abs(p).max()
    assert np.abs(velocity[::step][: len(p)] - vel).max() < 1e-8 * np.abs(vel).max()
