"""The factor problem against dense Gaussian algebra, and against the filter and smoother without lasting errors."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import block_diag

from bodylog.estimation.factors import robust
from bodylog.estimation.factors.columns import Column, Delay, EncoderShift, ImageShift, Path
from bodylog.estimation.factors.elimination import filter_knots, predict_knots
from bodylog.estimation.factors.encoder_error import MOTION_ORDER, JointNoise
from bodylog.estimation.factors.factor_problem import FactorProblem, Noise, linearise_problem
from bodylog.estimation.factors.gauss_newton import guess_path, solve_problem
from bodylog.estimation.factors.hypotheses import (
    SILENT_STD,
    _fit_noise,
    _list_plays,
    mix_silent_groups,
)
from bodylog.estimation.factors.images import correlate_model_errors
from bodylog.estimation.factors.noise_search import (
    LEAST_PROCESS,
    Learned,
    _tabulate_parameters,
    _weigh_log,
)
from bodylog.estimation.measurements.arm_errors import PLAY_STD, follow_slack
from bodylog.estimation.measurements.records import Sighting
from bodylog.motion import motion_covariance
from bodylog.sim.hardware import add_play
from tests.estimation.conftest import Arm, motion
from tests.estimation.factor_problems import ENCODER_S, JOINTS, drawn, noise


class Tilt(Column):
    """A link that is bent by a share of its rate."""

    def moves_links(self, path):
        return 0.1 * path.rates


def dense(problem, noise, linear, until):
    """Mean and covariance of the joints' states at knots and the columns' sizes, and −ln p, by full matrices.

    All states at all instants are one normal vector; measurements up to `until` s condition it. The model of images has
    no error of its own.
    """
    joints = noise.joints
    times = np.unique(np.concatenate([problem.knots, problem.t[problem.t >= problem.knots[0]]]))
    p, m = joints.state_count, len(problem.start)
    start = block_diag(*np.linalg.inv(joints.start_precision))
    mean = np.zeros(m * p)
    mean[::p] = problem.start
    covs, moves = [start], []
    for gap in np.diff(times):
        move = block_diag(*[transition(joints, gap, j) for j in range(m)])
        unit = motion_covariance(MOTION_ORDER, np.array([gap])).transpose(1, 2, 0)
        grown = joints.compute_gained_covariance(np.array([gap]), unit)[:, :, 0]
        covs.append(move @ covs[-1] @ move.T + block_diag(*np.moveaxis(grown, -1, 0)))
        moves.append(move)
    size = m * p
    cov = np.zeros((len(times) * size, len(times) * size))
    means = [mean]
    for move in moves:
        means.append(move @ means[-1])
    for i in range(len(times)):
        block = covs[i]
        for k in range(i, len(times)):
            cov[k * size : (k + 1) * size, i * size : (i + 1) * size] = block
            cov[i * size : (i + 1) * size, k * size : (k + 1) * size] = block.T
            if k < len(moves):
                block = moves[k] @ block
    sizes = np.array([column.std**2 for column in problem.columns])
    cov = block_diag(cov, np.diag(sizes)) if len(sizes) else cov
    mean = np.concatenate([*means, [column.mean for column in problem.columns]])
    rows, read, var = [], [], []
    moved = [column.changes_readings(problem.t, linear.path) for column in problem.columns]
    for k, at in enumerate(problem.t):
        for j in range(m):
            if not np.isfinite(problem.values[k, j]) or at < problem.knots[0] or at > until + 1e-12:
                continue
            row = np.zeros(len(mean))
            first = np.searchsorted(times, at) * size + j * p
            row[first : first + p] = joints.build_reading_rows(np.zeros(1))[0, j]
            row[len(times) * size :] = [one[k, j] for one in moved]
            rows.append(row)
            read.append(problem.values[k, j])
            var.append(joints.white[j] * problem.relative[k, j])
    (images,), (linearised,) = problem.images, linear.rows
    for f, knot in enumerate(images.knots):
        if problem.knots[knot] > until + 1e-12:
            continue
        for d in range(2):
            row = np.zeros(len(mean))
            first = np.searchsorted(times, problem.knots[knot]) * size
            row[first : first + size] = linearised.slopes[f, d, :size]
            row[len(times) * size :] = linearised.right[f, d, 1:]
            rows.append(row)
            read.append(linearised.right[f, d, 0])
            var.append(noise.scales[0] * linearised.var[f, d])
    rows, read = np.array(rows), np.array(read)
    total = rows @ cov @ rows.T + np.diag(var)
    gain = np.linalg.solve(total, rows @ cov).T
    off = read - rows @ mean
    nats = 0.5 * (off @ np.linalg.solve(total, off) + np.linalg.slogdet(2.0 * np.pi * total)[1])
    after, spread = mean + gain @ off, cov - gain @ rows @ cov
    at_knots = [np.arange(size) + size * np.searchsorted(times, one) for one in problem.knots]
    return (
        np.array([after[one] for one in at_knots]), np.array([spread[np.ix_(one, one)] for one in at_knots]),
        after[len(times) * size :], nats,
    )  # fmt: skip


def transition(joints, gap, joint):
    """The transition (p,p) of one joint's state."""
    move = np.eye(joints.state_count)
    for i in range(MOTION_ORDER):
        for k in range(i + 1, MOTION_ORDER):
            move[i, k] = gap ** (k - i) / (k - i)
    if joints.error is not None:
        move[-1, -1] = np.exp(-gap / joints.seconds[joint])
    return move


ERRORS = ((False, False), (True, False), (True, True))


@pytest.mark.parametrize(("lasting", "at_link"), ERRORS)
def test_filter_and_smoother_of_a_linear_body_are_those_of_dense_matrices(lasting, at_link):
    for seed in range(2):
        rng = np.random.default_rng([seed, 3])
        columns = (EncoderShift("step", 0.01, joint=1, since=0.2), Tilt("bent", 0.02, mean=0.01))
        problem, assumed = drawn(rng, columns), noise(rng, lasting, at_link)
        solution = solve_problem(problem, assumed, rounds=1)
        forward = filter_knots(solution.system, solution.eliminated)
        size = JOINTS * assumed.joints.state_count
        mean, cov, sizes, nats = dense(problem, assumed, solution.linear, problem.knots[-1])
        whole = solution.beliefs
        own = whole.cov + whole.shared @ whole.sizes_cov @ whole.shared.swapaxes(1, 2)
        unit = np.sqrt(np.einsum("kss->ks", cov))
        assert np.abs((whole.mean[:, :size] - mean) / unit).max() < 1e-6
        assert np.abs(own[:, :size, :size] - cov).max() <= 1e-6 * np.abs(cov).max()
        assert np.allclose(whole.sizes[0], sizes, atol=1e-9, rtol=0.0)
        assert solution.nats == pytest.approx(nats, abs=1e-6)
        for k in (2, 5, 8):
            mean, cov, sizes, nats = dense(problem, assumed, solution.linear, problem.knots[k])
            unit = np.sqrt(np.einsum("kss->ks", cov))
            assert np.abs((forward.mean[k, :size] - mean[k]) / unit[k]).max() < 1e-6
            own = forward.cov[k] + forward.shared[k] @ forward.sizes_cov[k] @ forward.shared[k].T
            assert np.abs(own[:size, :size] - cov[k]).max() <= 1e-6 * np.abs(cov[k]).max()
            assert np.allclose(forward.sizes[k], sizes, atol=1e-8, rtol=0.0)
            assert forward.nats[k] == pytest.approx(nats, abs=1e-6)


def test_angles_of_a_linear_body_are_those_of_dense_matrices_to_the_ninth_digit():
    for seed in range(5):
        rng = np.random.default_rng(seed)
        problem, assumed = drawn(rng), noise(rng)
        solution = solve_problem(problem, assumed, rounds=1)
        mean, cov, _, _ = dense(problem, assumed, solution.linear, problem.knots[-1])
        p = assumed.joints.state_count
        assert np.abs(solution.beliefs.mean[:, 0 : 2 * p : p] - mean[:, ::p]).max() < 1e-9
        assert np.abs(solution.beliefs.cov[:, 0, 0] - cov[:, 0, 0]).max() < 1e-9


def test_a_filter_that_knows_the_sizes_ends_where_the_whole_log_does():
    rng = np.random.default_rng(3)
    columns = (EncoderShift("step", 0.01, joint=1, since=0.2), Tilt("bent", 0.02))
    problem, assumed = drawn(rng, columns), noise(rng)
    whole = solve_problem(problem, assumed, rounds=1).beliefs
    about = tuple(replace(one, mean=size) for one, size in zip(columns, whole.sizes[0], strict=True))
    settled = replace(problem, columns=about, settled=whole.sizes_cov[0])
    rows = np.eye(whole.mean.shape[1])[None]
    none = np.zeros((1, rows.shape[1], len(columns)))
    last = np.array([len(problem.knots) - 1])
    mean, cov = whole.project_rows(rows, last, none)
    for causal in (False, True):
        again = solve_problem(settled, assumed, causal=causal, rounds=1).beliefs
        assert np.allclose(again.sizes, whole.sizes, atol=1e-9)
        other_mean, other_cov = again.project_rows(rows, last, none)
        assert np.allclose(other_mean, mean, atol=1e-6)
        assert np.abs(other_cov - cov).max() <= 1e-5 * np.abs(cov).max()


def test_sizes_hold_what_follows_if_a_joint_does_not_bend():
    columns = tuple(Column("bend", 1.0, group=j) for j in range(2))
    groups = (0.01, 0.02)
    # images tell the sum of both sizes to 1 mrad: .02
    shown = 1e6 * np.outer([0.02, 1.0, 1.0], [0.02, 1.0, 1.0])
    assumed = replace(noise(np.random.default_rng(0)), groups=groups)
    found = mix_silent_groups(
        Learned(assumed, None, 0.0, np.zeros(2), np.zeros((2, 2)), shown), columns
    )
    assert found.sizes.sum() == pytest.approx(0.02, abs=2e-3)
    parts, weights = [], []
    for stds in (groups, (SILENT_STD, 0.02), (0.01, SILENT_STD)):
        prior = np.diag(np.square(stds))
        spread = prior.sum() + 1e-6
        parts.append(prior.sum(axis=1) / spread * 0.02)
        weights.append(np.exp(-0.5 * 0.02**2 / spread) / np.sqrt(spread))
    expected = np.average(parts, axis=0, weights=weights)
    assert np.allclose(found.sizes, expected, atol=1e-6)
    # either joint alone is within two standard deviations
    assert np.abs(found.sizes - [0.0, 0.02])[0] < 2.0 * np.sqrt(found.sizes_cov[0, 0])
    assert np.abs(found.sizes - [0.02, 0.0])[0] < 3.0 * np.sqrt(found.sizes_cov[0, 0])


def test_what_is_predicted_is_what_was_known_before_the_knot():
    rng = np.random.default_rng(3)
    problem, assumed = drawn(rng), noise(rng)
    solution = solve_problem(problem, assumed, rounds=1)
    before = predict_knots(solution.system, solution.eliminated)
    mean, cov, _, _ = dense(problem, assumed, solution.linear, problem.knots[5] - 1e-6)
    size = JOINTS * assumed.joints.state_count
    unit = np.sqrt(np.diag(cov[5]))
    assert np.abs((before.mean[5, :size] - mean[5]) / unit).max() < 1e-6


@pytest.mark.parametrize("at_link", [False, True])
def test_the_slope_of_the_evidence_is_that_of_differences(at_link):
    for seed in range(2):
        rng = np.random.default_rng(seed)
        columns = (Delay("late", 0.05, camera="camera"), Tilt("bent", 2.0, group=0))
        problem = drawn(rng, columns)
        assumed = replace(noise(rng, True, at_link), groups=(0.01,))
        linear = linearise_problem(problem, guess_path(problem), assumed)
        at = _tabulate_parameters(problem, assumed, 0.01)[1][:, 0]
        _, slope = _weigh_log(linear, at)
        for k, own in enumerate(slope):
            step = np.zeros(len(at))
            step[k] = 1e-3
            difference = (_weigh_log(linear, at + step)[0] - _weigh_log(linear, at - step)[0]) / 2e-3
            assert own == pytest.approx(difference, abs=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_noise_by_evidence_does_not_amplify_rounding(seed):
    rng = np.random.default_rng(seed)
    problem = drawn(rng, images=60)
    assumed = noise(rng)
    found = []
    for moved in (0.0, 1e-14, -1e-14):
        off = moved * np.random.default_rng(seed).standard_normal(problem.values.shape)
        learned = _fit_noise(replace(problem, values=problem.values + off), assumed, ENCODER_S, rounds=2)
        joints = learned.noise.joints
        variances = [joints.white, joints.process, joints.error**2, joints.seconds, learned.noise.scales]
        found.append(np.log(np.concatenate(variances)))
    assert np.ptp(found, axis=0).max() < 1e-2


def test_links_follow_their_motors_through_the_play():
    for seed in range(2):
        t = np.linspace(0.0, 10.0, 2001)
        motors = motion(t, np.random.default_rng(seed))
        half = np.full(3, 4e-3)
        slack = follow_slack(motors, half, np.zeros(3))
        assert np.allclose(motors + slack * half, add_play(motors, 8e-3), atol=1e-12)


def test_play_of_the_exploration_is_expected_to_half_of_its_size():
    known, unknown = _list_plays(np.array([2e-3, 0.0]))
    assert (known.mean, known.std, known.joint) == (2e-3, 1e-3, 0)
    assert (unknown.mean, unknown.std, unknown.joint) == (0.0, PLAY_STD, 1)


def test_noise_of_an_angle_does_not_drag_the_link():
    rng = np.random.default_rng(0)
    rise = np.concatenate([np.linspace(0.0, 0.1, 100), np.full(400, 0.1)])[:, None]
    read = rise + 5e-4 * rng.standard_normal(rise.shape)
    half = np.array([4e-3])
    still = follow_slack(read, half, np.array([1.5e-3]))
    assert (still[100:] < -0.5).all()
    assert (follow_slack(read, half, np.zeros(1))[100:] > -0.4).any()


def test_an_outlier_costs_more_the_farther_it_is_and_at_most_its_range():
    away = np.linspace(0.0, 1.0, 200)[:, None]
    cov = np.full((200, 1, 1), 1e-4)
    span = np.array([6.0])
    share = robust.compute_believed_shares(away, cov, span)
    assert (np.diff(share) <= 0.0).all() and share[0] > 0.99 and share[-1] < 1e-5
    assert robust.compute_outlier_nats(share[-1:], span) == pytest.approx(np.log(6.0 / robust.OUTLIER_SHARE), rel=1e-4)


@pytest.mark.parametrize("settled", [False, True])
def test_measurements_left_out_are_those_of_a_solve_without_them(settled):
    rng = np.random.default_rng(4)
    shifts = (
        ImageShift("displaced", 3.0, axis=0, camera="camera", since=0.1, until=0.3),
        ImageShift("displaced", 3.0, axis=1, camera="camera", since=0.1, until=0.3),
    )
    problem, assumed = drawn(rng, shifts if settled else ()), noise(rng, lasting=False)
    if settled:  # to more than the noise of an image
        problem = replace(problem, settled=np.array([[4.0, 1.0], [1.0, 2.0]]))
    solution = solve_problem(problem, assumed, rounds=1)
    (images,), (rows,) = problem.images, solution.linear.rows
    mean, *parts = solution.beliefs.split_rows(rows.slopes, images.knots, rows.right[..., 1:])
    used = (1.3 * rows.var)[..., None] * np.eye(2)
    rest, spread = robust.leave_out_measurement(rows.right[..., 0] - mean, used, *parts)
    sighting = problem.sightings[0]
    values = sighting.values.copy()
    values[4] = np.nan
    without = replace(problem, sightings=(replace(sighting, values=values),))
    alone = solve_problem(without, assumed, rounds=1)
    expected, own = alone.beliefs.project_rows(rows.slopes[4:5], np.array([4]), rows.right[4:5, :, 1:])
    assert np.allclose(rest[4], rows.right[4, :, 0] - expected[0], atol=1e-6)
    assert np.allclose(spread[4], own[0] + used[4], rtol=1e-6)


def test_a_smoothed_arm_without_lasting_errors_is_that_of_the_textbook_iteration():
    """Gauss–Newton on a nonlinear arm ends where the gradient of −ln p vanishes: no step from there gains anything."""
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 1.0, ENCODER_S)
    angles = motion(t, rng)
    knots = t[::5]
    arm = Arm()
    seen = arm.place(angles[::5]) + 0.3 * rng.standard_normal((len(knots), 2))
    stamps = (knots * 1e9).astype(np.int64)
    sighting = Sighting("effector", arm, knots, seen, np.full(seen.shape, 0.09), stamps)
    read = angles + 1e-3 * rng.standard_normal(angles.shape)
    problem = FactorProblem(knots, t, read, np.ones(read.shape), read[0], (sighting,))
    joints = JointNoise(np.full(3, 1e-6), np.full(3, 5.0), None, np.ones(3), np.zeros(3, bool), np.ones(3, bool))
    assumed = Noise(joints, (1.0,))
    solution = solve_problem(problem, assumed)
    again = solve_problem(problem, assumed, solution.linear.path, rounds=1)
    unit = np.sqrt(np.einsum("kss->ks", solution.beliefs.cov))
    assert np.abs((again.beliefs.mean - solution.beliefs.mean) / unit).max() < 5e-3
    far = Path(knots, angles[::5] + 0.05, solution.linear.path.rates, angles[::5] + 0.05, solution.linear.path.slack)
    other = solve_problem(problem, assumed, far)
    assert np.abs((other.beliefs.mean - solution.beliefs.mean) / unit).max() < 5e-3


def test_a_models_error_is_forgotten_by_the_way_and_not_by_the_number_of_steps():
    model = SimpleNamespace(reach=np.array([0.3, 0.2, 0.5]))
    t = np.zeros(0)
    sighting = Sighting("effector", model, t, np.zeros((0, 2)), np.zeros((0, 2)), t)
    ends = np.array([[0.0, 0.0, 0.0], [0.3, -0.2, 0.1]])
    few, many = (np.linspace(*ends, count) for count in (2, 50))
    kept = [correlate_model_errors((sighting,), path).prod(axis=0) for path in (few, many)]
    np.testing.assert_allclose(kept[0], kept[1], rtol=1e-9)
    np.testing.assert_allclose(kept[0], np.exp(-0.5 * np.sqrt(1.0 + 1.0 + 0.04)), rtol=1e-9)


def test_a_filter_of_a_resting_joint_ends_where_the_smoother_does():
    """Where knots are 4 ms apart: with less motion, rounding hides what readings say of the joint."""
    rng = np.random.default_rng(3)
    problem = drawn(rng, images=64)
    knots = np.arange(problem.knots[0], problem.knots[-1], 4e-3)
    values = problem.values.copy()
    values[:, 1] = 1e-3 * rng.standard_normal(len(values))
    problem = replace(problem, knots=knots, values=values)
    joints = replace(noise(rng, lasting=False).joints, process=np.array([1.0, LEAST_PROCESS]))
    found = [solve_problem(problem, Noise(joints, (1.3,)), causal=causal, rounds=1).beliefs for causal in (True, False)]
    apart = found[0].mean[-1] - found[1].mean[-1]
    assert (np.abs(apart) < 1e-2 * np.sqrt(np.diag(found[1].cov[-1]))).all()
