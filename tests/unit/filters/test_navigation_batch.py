"""The navigation smoother against a batch solution by another program: gtsam's maximum a posteriori of the same log."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from attest_cli.filters.navigation import solve
from attest_cli.filters.navigation.aids import Place
from attest_cli.filters.navigation.model import Inertial, Trajectory
from attest_cli.filters.navigation.states import CORE, State, layout
from attest_cli.maths import rotation
from attest_cli.maths.propagation import Steps

Array = NDArray[np.float64]
RATE_HZ, PER_NODE, NODES, EVERY = 200, 40, 101, 5  # 20 s; a fix each second
GYRO, ACCEL, GYRO_WALK, ACCEL_WALK, FIX_M = 2e-3, 2e-2, 2e-5, 2e-4, 0.05
PRIOR = np.repeat([0.1, 2.0, 1.0, 0.01, 0.05], 3)
G = 9.80665


def motion() -> tuple[Steps, Array, Array, Trajectory, Array]:
    """Return the noisy IMU (steps, forces), the true trajectory at the nodes, and noisy fixes (k, 3)."""
    rng = np.random.default_rng(5)
    n, dt = (NODES - 1) * PER_NODE, 1.0 / RATE_HZ
    t = dt * np.arange(n + 1)
    rate = np.stack([0.3 * np.sin(0.9 * t), 0.2 * np.cos(1.3 * t), 0.4 * np.sin(0.4 * t + 1)], axis=1)
    accel = np.stack([1.5 * np.sin(0.8 * t), 1.2 * np.cos(0.6 * t), 0.4 * np.sin(1.1 * t)], axis=1)
    turns = rotation.exp_quaternion(0.5 * (rate[1:] + rate[:-1]) * dt)
    q = np.concatenate([[[1.0, 0.0, 0.0, 0.0]], rotation.chain(turns)])
    v = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (accel[1:] + accel[:-1]) * dt, axis=0)])
    p = np.concatenate([np.zeros((1, 3)), np.cumsum(v[:-1] * dt + dt**2 / 6 * (2 * accel[:-1] + accel[1:]), axis=0)])
    force = rotation.rotate(rotation.conjugate(q), accel + np.array([0.0, 0.0, G]))
    bias = np.array([0.004, -0.003, 0.002]), np.array([0.03, -0.02, 0.04])
    gyro = rate + bias[0] + GYRO * np.sqrt(RATE_HZ) * rng.standard_normal(rate.shape)
    felt = force + bias[1] + ACCEL * np.sqrt(RATE_HZ) * rng.standard_normal(rate.shape)
    steps = Steps(np.full(n, dt), gyro[:-1], gyro[1:], PER_NODE * np.arange(NODES))
    at = np.arange(0, n + 1, PER_NODE)
    x = np.zeros((NODES, 15))
    x[:, 3:6], x[:, 6:9], x[:, 9:12], x[:, 12:15] = v[at], p[at], *bias
    fixes = p[at[EVERY::EVERY]] + FIX_M * rng.standard_normal((len(at[EVERY::EVERY]), 3))
    return steps, felt[:-1], felt[1:], Trajectory(q[at], x), fixes


def ours(steps: Steps, force0: Array, force1: Array, start: Trajectory, fixes: Array) -> solve.Solution:
    form = layout(State(name, 3, sigma) for name, sigma in zip(CORE, PRIOR[::3], strict=True))
    held = np.zeros(NODES - 1, dtype=np.bool_)
    inertial = Inertial(steps, force0, force1, held, held, np.full(NODES - 1, GYRO**2), np.full(NODES - 1, ACCEL**2),
                        GYRO_WALK**2, ACCEL_WALK**2, G)  # fmt: skip
    node = np.arange(EVERY, NODES, EVERY)
    place = Place(node, node * PER_NODE / RATE_HZ, fixes, np.full(fixes.shape, FIX_M), np.zeros(3), robust=False)
    begin = Trajectory(start.q.copy(), start.x * [*np.ones(9), *np.zeros(6)])
    prior = Trajectory(begin.q[:1], begin.x[:1]), np.diag(PRIOR**2)
    return solve.solve(form, prior, inertial, [place], begin, 15)


def batch(gtsam: Any, steps: Steps, force0: Array, force1: Array, start: Trajectory, fixes: Array) -> Any:
    X, V, B = (lambda k, c=c: gtsam.symbol(c, k) for c in "xvb")
    params = gtsam.PreintegrationParams.MakeSharedU(G)
    params.setGyroscopeCovariance(GYRO**2 * np.eye(3))
    params.setAccelerometerCovariance(ACCEL**2 * np.eye(3))
    params.setIntegrationCovariance(1e-16 * np.eye(3))
    graph, values, zero = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.imuBias.ConstantBias()

    def diagonal(sigmas: Array) -> Any:
        return gtsam.noiseModel.Diagonal.Sigmas(sigmas)

    pose = gtsam.Pose3(gtsam.Rot3(*start.q[0]), start.p[0])
    graph.add(gtsam.PriorFactorPose3(X(0), pose, diagonal(PRIOR[[0, 1, 2, 6, 7, 8]])))
    graph.add(gtsam.PriorFactorVector(V(0), start.v[0], diagonal(PRIOR[3:6])))
    graph.add(gtsam.PriorFactorConstantBias(B(0), zero, diagonal(PRIOR[[12, 13, 14, 9, 10, 11]])))
    span = PER_NODE / RATE_HZ
    walk = diagonal(np.sqrt(span) * np.repeat([ACCEL_WALK, GYRO_WALK], 3))
    about = gtsam.imuBias.ConstantBias(np.array([0.03, -0.02, 0.04]), np.array([0.004, -0.003, 0.002]))
    for k in range(NODES - 1):
        pim = gtsam.PreintegratedImuMeasurements(params, about)
        for i in range(k * PER_NODE, (k + 1) * PER_NODE):
            rate = 0.5 * (steps.rate0[i] + steps.rate1[i])
            turned = rotation.exp_quaternion(0.5 * rate[None] * steps.dt[i])  # gtsam holds the force in the first axes
            pim.integrateMeasurement(rotation.rotate(turned, 0.5 * (force0[i] + force1[i])[None])[0], rate, steps.dt[i])
        graph.add(gtsam.ImuFactor(X(k), V(k), X(k + 1), V(k + 1), B(k), pim))
        graph.add(gtsam.BetweenFactorConstantBias(B(k), B(k + 1), zero, walk))
    for node, fix in zip(range(EVERY, NODES, EVERY), fixes, strict=True):
        graph.add(gtsam.GPSFactor(X(node), fix, diagonal(np.full(3, FIX_M))))
    for k in range(NODES):
        values.insert(X(k), gtsam.Pose3(gtsam.Rot3(*start.q[k]), start.p[k]))
        values.insert(V(k), start.v[k])
        values.insert(B(k), zero)
    found = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    return graph, found, X


@pytest.mark.skipif(sys.platform != "linux", reason="gtsam has wheels for Linux")
def test_the_smoother_is_the_batch_maximum_a_posteriori() -> None:
    gtsam = pytest.importorskip("gtsam")
    log = motion()
    found = ours(*log)
    graph, values, X = batch(gtsam, *log)
    marginals = gtsam.Marginals(graph, values)
    turn, apart, ratio = [], [], []
    for k in range(0, NODES, 4):
        pose = values.atPose3(X(k))
        q = pose.rotation().toQuaternion()
        other = np.array([[q.w(), q.x(), q.y(), q.z()]])
        turn.append(rotation.log_quaternion(rotation.multiply(rotation.conjugate(other), found.smoothed.q[k : k + 1])))
        apart.append(found.smoothed.p[k] - pose.translation())
        cov, P = marginals.marginalCovariance(X(k)), found.errors.P[k]
        R = pose.rotation().matrix()
        ratio.append(np.sqrt(np.diag(P[:3, :3]) / np.diag(cov[:3, :3])))
        ratio.append(np.sqrt(np.diag(P[6:9, 6:9]) / np.diag(R @ cov[3:, 3:] @ R.T)))
    print(f"attitude {np.abs(turn).max():.1e} rad, position {np.abs(apart).max():.1e} m, "
          f"sigma ratio {np.min(ratio):.4f} to {np.max(ratio):.4f}")  # fmt: skip
    assert found.settled
    assert np.abs(turn).max() < 1e-4
    assert np.abs(apart).max() < 1e-3
    assert np.abs(np.array(ratio) - 1.0).max() < 5e-3
