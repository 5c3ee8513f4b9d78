"""While encoders are silent, joints move as a stationary process with the log's own variances."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_lyapunov

from bodylog.errors import UsageError
from bodylog.estimation.inference import filter_log, reacquisition
from bodylog.estimation.inference.filter_log import filter_sequentially
from bodylog.estimation.inference.silence import smooth_across_silence
from bodylog.estimation.live import LiveEstimator
from bodylog.estimation.methods import filtering, smoother
from bodylog.motion import START_STD, Stationary
from bodylog.settings import EstimationSettings
from tests.estimation.conftest import WHITE_MOTIONS, discretised
from tests.estimation.spoilt_logs import muted

VAR = {2: np.array([[0.3, 1.2], [0.5, 0.1]]), 3: np.array([[0.3, 1.2], [0.5, 0.1], [2.0, 0.4]])}
PROCESS = np.array([0.7, 20.0])


def rates(var, process):
    """The companion matrix of one joint's stationary motion, from its variances."""
    a = np.eye(len(var), k=1)
    if len(var) == 2:
        a[-1] = -var[1] / var[0], -process / (2.0 * var[1])
    else:
        damping = process / (2.0 * (var[2] - var[1] ** 2 / var[0]))
        a[-1] = -damping * var[1] / var[0], -var[2] / var[1], -damping
    return a


def within(a, process, dt):
    """Transition and noise within dt of x' = a x + w, whose noise enters the last row."""
    noise, f = np.zeros_like(a), expm(dt * a)
    noise[-1, -1] = process
    lasting = solve_continuous_lyapunov(a, -noise)
    return f, lasting - f @ lasting @ f.T


@pytest.mark.parametrize("order", [2, 3])
def test_steps_are_those_of_a_matrix_exponential(order):
    mean, dt = np.array([0.4, -1.0]), np.array([1e-3, 0.05, 1.0])
    move, shift, noise = Stationary(mean, VAR[order], PROCESS).step(dt)
    for joint, process in enumerate(PROCESS):
        a = rates(VAR[order][:, joint], process)
        for k, one in enumerate(dt):
            f, q = within(a, process, one)
            np.testing.assert_allclose(move[..., joint, k], f, atol=1e-10)
            np.testing.assert_allclose(noise[..., joint, k], q, atol=1e-10)
            np.testing.assert_allclose(shift[:, joint, k], (np.eye(order) - f)[:, 0] * mean[joint], atol=1e-10)


@pytest.mark.parametrize("order", [2, 3])
def test_variances_end_at_the_usual_ones_and_begin_as_white_noise(order):
    steps = Stationary(np.zeros(2), VAR[order], PROCESS)
    _, shift, noise = steps.step(np.array([1e6, 1e9]))
    np.testing.assert_allclose(np.einsum("aajb->baj", noise), np.tile(VAR[order], (2, 1, 1)), rtol=1e-9)
    np.testing.assert_allclose(shift, 0.0, atol=1e-12)
    steps = Stationary(np.zeros(2), VAR[order], 0.01 * PROCESS)
    move, _, noise = (part[..., 0] for part in steps.step(np.array([1e-2])))
    free, q = discretised(0.01 * np.append(PROCESS, 1.0), 1e-2, order)
    for joint in range(2):
        np.testing.assert_allclose(move[..., joint], free[joint::3, joint::3], atol=0.06)
        np.testing.assert_allclose(noise[..., joint], q[joint::3, joint::3], rtol=0.03)


def textbook(problem, world, order, stationary):
    """Filter and smoother of a linear body in full matrices, by instants; angles and covariances of both."""
    line, process, encoders = problem.timeline.t, problem.precision.process, problem.evidence.encoders
    track, model, k = world.features.tracks["effector"], world.body.senses["effector"], 3 * order
    z, p = np.concatenate([problem.start, np.zeros(k - 3)]), np.diag(np.repeat([1.0, 1.0, 9.0][:order], 3))
    last, before, rows = line[0], line[0], []
    for now in line:
        dt, before = now - before, now
        f, q = discretised(process, dt, order)
        shift = np.zeros(k)
        if now - last > reacquisition.LONG_SILENCE_S:
            for joint in range(3):
                own = np.ix_(range(joint, k, 3), range(joint, k, 3))
                var = np.square(START_STD[:order])
                f[own], q[own] = within(rates(var, process[joint]), process[joint], dt)
                shift[joint::3] = (np.eye(order) - f[own])[:, 0] * stationary.mean[joint]
        zp, pp = f @ z + shift, f @ p @ f.T + q
        z, p = zp, pp
        angles, seen = encoders.values[encoders.t == now], track.values[track.t == now]
        last = now if len(angles) else last
        pairs = [(np.eye(3, k), values, problem.precision.encoder) for values in angles]
        pairs += [(np.pad(model.a, ((0, 0), (0, k - 3))), values - model.b, np.full(2, 0.16)) for values in seen]
        for h, y, var in pairs:
            gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + np.diag(var))
            z, p = z + gain @ (y - h @ z), p - gain @ h @ p
        rows.append((f, zp, pp, z, p))
    smooth, cov = [rows[-1][3]], [rows[-1][4]]
    for (_, _, _, z, p), (f, zp, pp, _, _) in zip(rows[-2::-1], rows[:0:-1], strict=True):
        gain = p @ f.T @ np.linalg.inv(pp)
        smooth.append(z + gain @ (smooth[-1] - zp))
        cov.append(p + gain @ (cov[-1] - pp) @ gain.T)
    filtered = [np.array([row[part] for row in rows]) for part in (3, 4)]
    return *filtered, np.array(smooth[::-1]), np.array(cov[::-1])


@pytest.mark.parametrize("order", [2, 3])
def test_silence_of_a_linear_body_is_that_of_full_matrices(world, linear_model, order):
    drawn = world(3, duration=7.0, model=linear_model)
    features = muted(drawn.features, 3.0, 4.0)
    problem = filtering.build_filter_problem(features, drawn.body, EstimationSettings(precision="model", bias="off"))
    precision = replace(problem.precision, motion=WHITE_MOTIONS[order], correlation_px={})
    problem = replace(problem, precision=precision)
    problem = replace(problem, stationary=Stationary(problem.start, np.square(
        np.repeat(np.array(START_STD[:order])[:, None], 3, axis=1)), precision.process))  # fmt: skip
    assert problem.stepwise and problem.left_open.any()
    z, p, smooth, cov = textbook(problem, drawn, order, problem.stationary)
    for found in (filter_sequentially(problem), filter_log.solve_by_gauss_newton(problem)):
        np.testing.assert_allclose(found.trace.z, z, atol=1e-7)
        np.testing.assert_allclose(found.trace.cov, p[:, :3, :3], atol=1e-7)
    for found in (smooth_across_silence(problem), smoother.solve_map_path(problem)):
        np.testing.assert_allclose(found.z, smooth, atol=1e-6)
        np.testing.assert_allclose(found.cov, cov[:, :3, :3], atol=1e-6)


def test_own_mean_squares_are_carried_to_a_live_filter(world):
    drawn = world(0, duration=9.0)
    found = filtering.estimate_by_filter(muted(drawn.features, 4.0, 6.0), drawn.body, EstimationSettings()).settings
    rms = np.sqrt(np.square(np.gradient(drawn.truth.values, drawn.truth.t, axis=0)).mean(axis=0))
    np.testing.assert_allclose(np.sqrt(found["moments"][1]), rms, rtol=0.4)
    assert "moments" not in filtering.estimate_by_filter(drawn.features, drawn.body, EstimationSettings()).settings
    LiveEstimator(drawn.body, learned=found)
    with pytest.raises(UsageError, match=r"learned: moments is .* numbers above 0"):
        LiveEstimator(drawn.body, learned={**found, "moments": found["moments"][0]})
