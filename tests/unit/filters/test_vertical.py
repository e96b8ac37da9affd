"""The observers on arrays: reference vectors, dense oracles, identities."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from support.still import vectors
from support.walking import riccati

from attest_cli.filters import vertical
from attest_cli.filters.acceleration import Rule
from attest_cli.filters.vertical import Method, Turns, law, observe, towards, up
from attest_cli.maths import kalman, rotation
from attest_cli.maths.sequential import Pass

Array = NDArray[np.float64]
EYE = np.eye(3)
METHODS: tuple[Method, ...] = ("pseudo-linear", "projected", "geometric")


def added(turn_b: Array, Q: Array) -> Turns:
    """Steps whose noise is added to the vertical, as in the paper; no bias."""
    m = len(turn_b)
    return Turns(turn_b, np.zeros(m), np.broadcast_to(Q, (m, 3, 3)), np.zeros(m), np.zeros((m, 3)), across=False)


class Scalar:
    """The vectors of the scalar filter: they predict before the first sample."""

    def __init__(self) -> None:
        v = self.v = vectors("rehbinder")
        self.T, self.q1, self.q2, self.p0 = (float(v[name]) for name in ("T", "q1", "q2", "p0"))
        self.Phi = rotation.matrix(rotation.exp_quaternion(-v["phi"]))
        self.x0, self.P0 = self.Phi[0] @ v["z0"], (self.p0 + self.q1 * self.T) * EYE
        self.turns = added(v["phi"][1:], self.q1 * self.T * EYE)
        self.R = np.tile(self.q2 / self.T * EYE, (len(v["y"]), 1, 1))

    def run(self, method: Method = "pseudo-linear", rule: Rule | None = None) -> Pass:
        weigh = None if rule is None else rule.causal(self.T)
        return observe(self.turns, self.v["y"], self.R, self.x0, self.P0, method, weigh)


@pytest.fixture(scope="module")
def scalar() -> Scalar:
    return Scalar()


def close(found: Array, wanted: Array) -> None:
    """To 1e-9, of each number or of the unit vectors' length."""
    assert np.abs(found - wanted).max() < 1e-9 * max(1.0, float(np.abs(wanted).max()))


def test_scalar_filters_are_the_vectors(scalar: Scalar) -> None:
    v, forward = scalar.v, scalar.run()
    close(forward.x, v["pl_z"])
    close(up(forward.x)[0], v["pl_xhat"])
    assert forward.chain.P[:, 0, 0] == pytest.approx(v["pl_p"], rel=1e-9)
    assert np.abs(forward.chain.P - v["pl_p"][:, None, None] * EYE).max() < 1e-15  # Corollary 1: P stays p I
    close(scalar.run("projected").x, v["proj"])


def test_smoothed_pseudo_linear_filter_is_the_vector(scalar: Scalar) -> None:
    v, forward = scalar.v, scalar.run()
    for errors in (kalman.rts(forward.chain), kalman.fuse(forward.chain, *kalman.information(forward.chain))):
        close(forward.x + errors.d, v["rts_z"])
        close(up(forward.x + errors.d)[0], v["rts_xhat"])
        assert errors.P[:, 0, 0] == pytest.approx(v["rts_p"], rel=1e-9)


@pytest.mark.parametrize(("kind", "limit"), [("continuous", 1 / 20), ("switching", 0.1)])
def test_variable_noise_is_the_vectors(scalar: Scalar, kind: str, limit: float) -> None:
    short = {"continuous": "cont", "switching": "switch"}[kind]
    rule = Rule(kind, scalar.q2, limit, 5 * scalar.T)  # type: ignore[arg-type]
    forward = scalar.run(rule=rule)
    close(forward.x, scalar.v[f"{short}_z"])
    q2 = scalar.T * (forward.S - forward.chain.P_pred)[:, 0, 0]
    assert q2 == pytest.approx(scalar.v[f"{short}_q2"], rel=1e-9)


def test_matrix_gain_is_the_vectors(scalar: Scalar) -> None:
    v, T = scalar.v, scalar.T
    Q = 0.5 * T * (v["Q1"] + scalar.Phi @ v["Q1"] @ scalar.Phi.swapaxes(1, 2))
    turns = added(v["phi"][1:], Q[1:])
    R, P0 = np.tile(v["Q2"] / T, (len(v["y"]), 1, 1)), scalar.p0 * EYE + Q[0]
    forward = observe(turns, v["y"], R, scalar.x0, P0)
    close(forward.x, v["mat_z"])
    assert np.abs(forward.chain.P - v["mat_P"]).max() < 1e-9 * np.abs(v["mat_P"]).max()
    close(observe(turns, v["y"], R, scalar.x0, P0, "projected").x, v["matproj_z"])


def test_exact_step_of_the_geometric_observer_is_the_vector(scalar: Scalar) -> None:
    x, found = scalar.v["z0"], []
    for Phi, y in zip(scalar.Phi, scalar.v["y"], strict=True):
        x = towards(Phi @ x, y, 0.02)
        found.append(x)
    close(np.array(found), scalar.v["geom"])


def test_closed_forms_are_the_vectors(scalar: Scalar) -> None:
    v = scalar.v
    for i, xi0 in enumerate(v["xi0"]):
        assert law(float(xi0), v["I"][:, 0]) == pytest.approx(v["xi_law"][:, i], rel=1e-9)
        assert (v["xi_law"][:, i] <= v["xi_bound"][:, i] * (1 + 1e-12)).all()
    assert riccati(v["riccati_t"], scalar.p0, scalar.q1, scalar.q2) == pytest.approx(v["riccati_p"], rel=1e-9)


def test_bias_state_is_the_vectors() -> None:
    v = vectors("rehbinder_bias")
    n, T = len(v["y"]), float(v["T"])
    steps = np.full(n, T)
    turns = Turns(v["phi"], steps, float(v["sg"]) ** 2 * T * np.tile(EYE, (n, 1, 1)), float(v["sb"]) ** 2 * steps,
                  np.zeros((n, 3)))  # fmt: skip
    y, R = np.concatenate([EYE[2:], v["y"]]), np.concatenate([[1e30], v["q2"] / T])[:, None, None] * EYE
    forward = observe(turns, y, R, np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), v["P0"])  # a first sample that is nothing
    close(forward.x[1:], v["xf"])
    assert np.abs(forward.chain.P[1:] - v["Pf"]).max() < 1e-9 * np.abs(v["Pf"]).max()
    close(forward.x[1:] + kalman.rts(forward.chain).d[1:], v["xs"])


def noisy(n: int, seed: int, biased: bool) -> tuple[Turns, Array, Array, Array]:
    """Steps, measurements, the vertical (n, 3) and a gyro bias of a tumbling body."""
    rng = np.random.default_rng(seed)
    T, bias = 0.01, np.array([0.02, -0.03, 0.01]) if biased else np.zeros(3)
    rate = np.stack([np.sin(0.03 * np.arange(n - 1)), np.cos(0.05 * np.arange(n - 1)), np.ones(n - 1)], axis=1)
    Phi = rotation.matrix(rotation.exp_quaternion(-rate * T))
    x = [np.array([0.1, -0.2, 0.97])]
    x[0] /= np.linalg.norm(x[0])
    for step in Phi:
        x.append(step @ x[-1])
    truth = np.array(x)
    turn = (rate + bias) * T + rng.normal(0.0, 1e-3 * np.sqrt(T), (n - 1, 3))
    steps = np.full(n - 1, T)
    turns = Turns(turn, steps, 1e-6 * T * np.tile(EYE, (n - 1, 1, 1)), 1e-12 * steps, np.zeros((n - 1, 3)))
    return turns, truth + rng.normal(0.0, 0.02, (n, 3)), truth, bias


def test_smoothed_pseudo_linear_filter_is_the_joint_posterior() -> None:
    """All states at once by dense least squares: mean and covariance of every sample."""
    turns, y, _, _ = noisy(12, 1, biased=False)
    turns = added(turns.turn_b, 1e-6 * EYE)
    n, R, x0, P0 = len(y), 4e-4, np.array([0.0, 0.0, 1.0]), 0.04 * EYE
    Phi = rotation.matrix(rotation.exp_quaternion(-turns.turn_b))
    rows, right = [np.eye(3, 3 * n) / 0.2], [x0 / 0.2]
    for k in range(n):
        H = np.zeros((3, 3 * n))
        H[:, 3 * k : 3 * k + 3] = EYE / np.sqrt(R)
        rows.append(H)
        right.append(y[k] / np.sqrt(R))
        if k:
            F = np.zeros((3, 3 * n))
            F[:, 3 * k : 3 * k + 3], F[:, 3 * k - 3 : 3 * k] = EYE / 1e-3, -Phi[k - 1] / 1e-3
            rows.append(F)
            right.append(np.zeros(3))
    A = np.concatenate(rows)
    mean = np.linalg.lstsq(A, np.concatenate(right))[0].reshape(n, 3)
    P = np.linalg.inv(A.T @ A).reshape(n, 3, n, 3)
    forward = observe(turns, y, np.tile(R * EYE, (n, 1, 1)), x0, P0)
    errors = kalman.rts(forward.chain)
    assert np.abs(forward.x + errors.d - mean).max() < 1e-10
    assert max(np.abs(errors.P[k] - P[k, :, k]).max() for k in range(n)) < 1e-12
    assert max(np.abs(errors.cross[k] - P[k, :, k + 1]).max() for k in range(n - 1)) < 1e-12


@pytest.mark.parametrize("biased", [False, True])
@pytest.mark.parametrize("method", METHODS)
def test_every_method_finds_vertical_and_bias(method: Method, biased: bool) -> None:
    turns, y, truth, bias = noisy(3000, 2, biased)
    R = np.tile(4e-4 * EYE, (3000, 1, 1))
    x0, P0 = np.array([0.0, 0.0, 1.0]), 0.1 * EYE
    if biased:
        x0, P0 = np.append(x0, np.zeros(3)), np.diag([0.1] * 3 + [1e-3] * 3)
    forward = observe(turns, y, R, x0, P0, method)
    errors = kalman.rts(forward.chain)
    u, slope = up(forward.x + errors.d)
    off = np.linalg.norm(u - truth, axis=1)
    sigma = np.sqrt(np.einsum("kia,kab,kib->k", slope, errors.P, slope))
    print(f"{method}: {np.degrees(np.sqrt(np.mean(off**2))):.4f} deg, over sigma {np.mean((off / sigma) ** 2):.2f}")
    assert 0.4 < np.mean((off / sigma) ** 2) < 2.5  # a few dozen independent errors, two of each
    if biased:
        e = forward.x[-1, 3:] - bias
        assert e @ np.linalg.solve(forward.chain.P[-1, 3:, 3:], e) < 21.1  # chi-square of 3 at 99.99 %


def test_jacobian_of_the_bias_by_finite_differences() -> None:
    turns = Turns(np.array([[3e-3, -2e-3, 4e-3]]), np.array([0.01]), np.zeros((1, 3, 3)), np.zeros(1),
                  np.array([[1e-3, 0.0, 0.0]]))  # fmt: skip
    predict = vertical._predict_biased(turns)
    x = np.array([0.2, 0.3, 0.9, 0.01, -0.02, 0.03])
    new, F, _ = predict(0, x)
    assert new[3:] - x[3:] == pytest.approx([1e-3, 0.0, 0.0])  # what is known of the bias's change
    for i in range(6):
        step = 1e-4 * np.eye(6)[i]
        slope = (predict(0, x + step)[0] - predict(0, x - step)[0]) / 2e-4
        scale = 1.0 if i < 3 else 0.01 * np.linalg.norm(turns.turn_b)  # half of the turn is left out, times T
        assert np.abs(slope - F[:, i]).max() < (1e-9 if i < 3 else 0.6) * scale


def test_a_rest_measures_the_bias_instead() -> None:
    turns, y, _, bias = noisy(50, 3, biased=True)
    R, P0 = np.tile(4e-4 * EYE, (50, 1, 1)), np.diag([0.1] * 3 + [1e-3] * 3)
    x0 = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    plain = observe(turns, y, R, x0, P0)
    told = observe(turns, y, R, x0, P0, rests={20: (bias, 1e-12)})
    assert (told.x[:20] == plain.x[:20]).all()
    assert np.abs(told.x[20, 3:] - bias).max() < 1e-6
    assert np.abs(told.nu[20] - (bias - told.x_pred[20, 3:])).max() == 0.0
    for method in METHODS:
        assert np.abs(observe(turns, y, R, x0, P0, method, rests={20: (bias, 1e-12)}).x[20, 3:] - bias).max() < 1e-6


def test_up_of_a_vanished_state_is_the_one_before() -> None:
    x = np.array([[0.0, 0.0, 2.0], [1e-12, 0.0, 0.0], [0.0, 3.0, 0.0]])
    u, slope = up(x)
    assert u.tolist() == [[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]
    assert np.abs(slope[2] - (EYE - np.outer(u[2], u[2])) / 3.0).max() < 1e-15


angles = st.floats(0.0, np.pi - 1e-6)


@settings(deadline=None, max_examples=200)
@given(angle=angles, gain=st.floats(0.0, 30.0), size=st.floats(0.01, 4.0), about=st.floats(0.0, 6.28))
def test_the_exact_step_follows_the_law_and_never_overshoots(
    angle: float, gain: float, size: float, about: float
) -> None:
    x, y = np.array([np.sin(angle) * np.cos(about), np.sin(angle) * np.sin(about), np.cos(angle)]), size * EYE[2]
    new = towards(x, y, gain)
    wanted = 2.0 * np.arctan(np.tan(angle / 2) * np.exp(-gain * size))
    left = np.arctan2(np.hypot(new[0], new[1]), new[2])
    assert left == pytest.approx(wanted, abs=1e-9)
    assert np.linalg.norm(new) == pytest.approx(1.0, abs=1e-15)
    if left > 1e-6:  # along the great circle to y
        assert new[0] * x[1] == pytest.approx(new[1] * x[0], abs=1e-9)


def test_the_antipode_and_no_force_leave_the_vertical_where_it_is() -> None:
    assert towards(EYE[2], -EYE[2], 5.0).tolist() == EYE[2].tolist()
    assert towards(EYE[2], np.zeros(3), 5.0).tolist() == EYE[2].tolist()
    assert np.abs(towards(EYE[0], EYE[0], 5.0) - EYE[0]).max() == 0.0


def test_the_riccati_is_the_filters_covariance_at_a_fine_step() -> None:
    T, q1, q2, p0, n = 1e-3, 2e-4, 3e-3, 0.5, 3000
    forward = observe(added(np.zeros((n - 1, 3)), q1 * T * EYE), np.tile(EYE[2], (n, 1)),
                      np.tile(q2 / T * EYE, (n, 1, 1)), EYE[2], p0 * EYE)  # fmt: skip
    p = riccati(T * np.arange(1, n + 1), p0, q1, q2)
    assert forward.chain.P[100:, 0, 0] == pytest.approx(p[100:], rel=5e-3)  # first order in the step
    assert riccati(np.array([1e3]), p0, q1, q2)[0] == pytest.approx(np.sqrt(q1 * q2), rel=1e-12)
