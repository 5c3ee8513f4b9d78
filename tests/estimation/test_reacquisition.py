"""A belief that lost the arm finds it again as soon as encoders say where it is; one that did not is left alone."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.errors import UsageError
from bodylog.estimation import estimate_from_features
from bodylog.estimation.inference import filter_log, sequential
from bodylog.estimation.methods import filtering, smoother
from bodylog.settings import EstimationSettings
from bodylog.types import FaultKind
from tests.estimation import resting
from tests.estimation.conftest import Explored
from tests.estimation.spoilt_logs import ALL, muted
from tests.seeds import first_of, seeds


def shifted(features, size, rows, name):
    joints = features.joints
    values = joints.values + size * np.outer(rows, np.isin(joints.names, name))
    return replace(features, joints=replace(joints, values=values))


def judged(features, drawn, since, **settings):
    """From `since` (s) on: RMSE (rad), squared error over stated variance, faults, findings about a lost belief."""
    found = estimate_from_features(features, drawn.body, EstimationSettings(**settings))
    late = found.joints.t >= since
    truth = np.stack(
        [np.interp(found.joints.t, drawn.truth.t, column) for column in drawn.truth.values.T],
        axis=1,
    )
    error = (found.joints.values - truth)[late]
    nees = float(np.mean(error**2 / np.einsum("nii->ni", found.cov[late])))
    lost = [finding.text for finding in found.findings if finding.text.startswith("belief: lost")]
    return float(np.sqrt(np.mean(error**2))), nees, found.faults, lost


@pytest.mark.parametrize(("seed", "silent"), [(0, "elbow"), (4, "lift"), (4, "elbow")])
def test_belief_survives_a_second_of_encoder_silence(world, seed, silent):
    """The others, which never fell silent, speak against starting again from where this one reads."""
    drawn = world(seed, duration=12.0)
    *_, lost = judged(
        muted(drawn.features, 6.0, 7.0, (silent,)), drawn, 6.0, precision="model", bias="off"
    )
    assert not lost


@pytest.mark.soak
@pytest.mark.parametrize("length", [1.0, 3.0])
@pytest.mark.parametrize("seed", range(6))
def test_belief_is_not_lost_when_one_encoder_pauses(world, seed, length):
    drawn = world(seed, duration=12.0)
    for silent in ALL:
        muffled = muted(drawn.features, 6.0, 6.0 + length, (silent,))
        assert not judged(muffled, drawn, 6.0, precision="model", bias="off")[3]


@pytest.mark.parametrize("method", ["filter", "ekf"])
@pytest.mark.parametrize("seed", seeds(1, 3))
def test_lost_belief_recovers_at_the_first_reading(world, seed, method):
    drawn = world(seed, duration=15.0)
    rmse, nees, faults, lost = judged(muted(drawn.features, 6.0, 11.0), drawn, 11.0, method=method)
    assert rmse < 0.01 and nees < 1.5 and not faults
    assert all("pan, lift, elbow until 11.000 s" in text for text in lost)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.soak
def test_smoothed_path_recovers_after_a_silence(world, seed):
    drawn = world(seed, duration=15.0)
    rmse, nees, faults, _ = judged(muted(drawn.features, 6.0, 11.0), drawn, 11.0, method="smoother")
    assert rmse < 0.005 and nees < 1.5 and not faults


def silent(world, seed, silence, method, names=ALL):
    """In a silence from 6 s on, of a body that knows where the arm was explored: RMSE (rad), NEES, share within 2 σ."""
    drawn = world(seed, duration=7.0 + silence, model=Explored())
    found = estimate_from_features(
        muted(drawn.features, 6.0, 6.0 + silence, names),
        drawn.body,
        EstimationSettings(method=method, rate=25.0),
    )
    inside = (found.joints.t > 6.0) & (found.joints.t < 6.0 + silence)
    truth = np.stack(
        [np.interp(found.joints.t, drawn.truth.t, column) for column in drawn.truth.values.T],
        axis=1,
    )
    error, var = (found.joints.values - truth)[inside], np.einsum("nii->ni", found.cov)[inside]
    return (
        float(np.sqrt(np.mean(error**2))),
        float(np.mean(error**2 / var)),
        float(np.mean(error**2 < 4.0 * var)),
    )


@pytest.mark.parametrize(
    ("method", "most", "least"), [("filter", 0.2, 0.8), ("smoother", 0.085, 0.7)]
)
def test_error_bars_hold_while_no_encoder_speaks(world, method, most, least):
    rmse, nees, within = np.transpose([silent(world, seed, 4.0, method) for seed in range(4)])
    # a posture passes for another now and then
    assert (
        np.sqrt(np.mean(rmse**2)) < most and 0.4 < np.median(nees) < 1.6 and np.mean(within) > least
    )


def test_smoother_bridges_a_silence_in_which_the_filter_takes_another_posture(world):
    """A smoother knows the readings on both sides."""
    drawn = world(21, duration=12.0, model=Explored())
    features = muted(drawn.features, 6.0, 8.0)
    assert judged(features, drawn, 6.0, rate=25.0)[0] > 0.1
    rmse, nees, _, lost = judged(features, drawn, 6.0, method="smoother", rate=25.0)
    assert rmse < 0.01 and nees < 2.5 and not lost


@pytest.mark.parametrize("seed", seeds(1, 6))
def test_smoother_knows_that_two_long_silent_joints_may_have_another_posture(world, seed):
    """Two numbers for two joints: a path that started without the images was sure of a mirrored posture, NEES 5,000 and 5,900."""
    assert silent(world, seed, 8.0, "smoother", ("pan", "lift"))[1] < 6.0


@pytest.mark.parametrize(
    ("method", "names"),
    first_of(
        1,
        [
            ("smoother", ("pan", "lift")),
            ("smoother", ("lift", "elbow")),
            ("filter", ("pan", "lift")),
            ("filter", ("lift", "elbow")),
        ],
    ),
)
def test_joints_that_first_reach_while_two_are_silent_are_followed(method, names):
    """The process variance of a joint that rested so far would leave it behind, and its images outliers: NEES 60."""
    nees = []
    for seed in (42, 43, 44):
        sound = resting.drawn(seed, resting.Drawn("reach", 1.5e-3, 1e-3, camera_hz=30.0))
        found = estimate_from_features(
            muted(sound.features, 4.0, 7.0, names), sound.body, EstimationSettings(method=method)
        )
        nees.append(resting.judged(sound, found.joints, found.cov)[1])
    assert np.median(nees) < 1.5 and max(nees) < 3.0


@pytest.mark.parametrize(
    ("names", "settings"),
    first_of(1, [(ALL, {"senses": ("vision",)}), (("pan", "lift"), {}), (("pan", "elbow"), {})]),
)
def test_error_bars_hold_where_joints_are_never_read(world, names, settings):
    """A filter drew tangents of such joints, and took the noise from images that fit any posture: NEES up to 5,500."""
    nees = []
    for seed in range(4):
        drawn = world(seed, duration=12.0, model=Explored())
        joints = drawn.features.joints
        start = tuple(drawn.truth.values[0, [drawn.truth.names.index(n) for n in drawn.body.joints]])
        unread = np.where(np.isin(joints.names, names), np.nan, joints.values)
        known = replace(drawn.features, joints=replace(joints, values=unread))
        features = drawn.features if settings else known
        nees.append(judged(features, drawn, 2.0, rate=25.0, start=start, **settings)[1])
    assert np.median(nees) < 1.5 and max(nees) < 4.0


@pytest.mark.parametrize("method", ["filter", "smoother"])
def test_images_are_where_they_are_expected_though_no_joint_is_read(world, method):
    """A smoother left lines over beliefs out as tangents: each image seemed to be an outlier."""
    drawn = world(1, duration=10.0, model=Explored())
    settings = EstimationSettings(method=method, senses=("vision",), rate=25.0)
    found = estimate_from_features(drawn.features, drawn.body, settings)
    assert np.mean(np.abs(found.errors["effector"].values) > 3.0) < 0.05
    assert not [one.text for one in found.findings if "from what was expected" in one.text]


@pytest.mark.soak
def test_smoother_by_images_alone_draws_lines_over_its_belief(world):
    """Two numbers for three joints: tangents were sure of a wrong posture, with NEES of 14 to 2,400."""
    nees = []
    for seed in range(2):
        drawn = world(seed, duration=10.0, model=Explored())
        found = estimate_from_features(
            drawn.features,
            drawn.body,
            EstimationSettings(method="smoother", senses=("vision",), rate=25.0),
        )
        truth = np.stack(
            [np.interp(found.joints.t, drawn.truth.t, column) for column in drawn.truth.values.T],
            axis=1,
        )
        nees.append(np.mean((found.joints.values - truth) ** 2 / np.einsum("nii->ni", found.cov)))
    assert max(nees) < 25.0


@pytest.mark.soak
@pytest.mark.parametrize("silence", [1.0, 2.0, 5.0])
def test_error_bars_hold_while_encoders_are_silent(world, silence):
    rmse, nees, within = np.transpose(
        [silent(world, seed, silence, "filter") for seed in range(20)]
    )
    # one posture in twenty passes for another for a while
    assert (
        np.sqrt(np.mean(rmse**2)) < 0.06 * silence
        and 0.2 < np.median(nees) < 1.2
        and np.mean(within) > 0.9
    )


@pytest.mark.parametrize("solve", [filter_log.solve_by_gauss_newton, smoother.solve_map_path])
def test_full_reset_separates_what_precedes_and_follows(world, linear_model, solve):
    drawn = world(0, duration=9.0, model=linear_model)
    joints, track = drawn.features.joints, drawn.features.tracks["effector"]

    def solved(begin, end, resets=None):
        rows, frames = ((t >= begin) & (t < end) for t in (joints.t, track.t))
        part = replace(
            joints, t=joints.t[rows], values=joints.values[rows], source_ns=joints.source_ns[rows]
        )
        seen = replace(track, t=track.t[frames], values=track.values[frames], std=track.std[frames],
                       source_ns=track.source_ns[frames])  # fmt: skip
        features = replace(drawn.features, joints=part, tracks={"effector": seen})
        problem = filtering.build_filter_problem(
            features, drawn.body, EstimationSettings(precision="model", bias="off")
        )
        found = solve(replace(problem, resets=resets))
        z, cov = (
            (found.z, found.cov)
            if solve is smoother.solve_map_path
            else (found.trace.z, found.trace.cov[:, :3, :3])
        )
        return problem.timeline.t, z[:, :3], cov

    middle = joints.t[223]
    t, *whole = solved(0.0, 9.0, (np.array([middle]), np.ones((1, 3), bool)))
    for begin, end in ((0.0, middle), (middle, 9.0)):
        part, some = solved(begin, end)[1:], (t >= begin) & (t < end)
        for ours, alone in zip(whole, part, strict=True):
            np.testing.assert_allclose(ours[some], alone, atol=1e-9)


@pytest.mark.parametrize("precision", ["auto", "model"])
def test_wrong_start_is_corrected_by_the_first_reading(world, precision):
    for seed, size in enumerate((0.5, -1.0, 2.0)):
        drawn = world(seed, duration=8.0)
        start = tuple(drawn.truth.values[0] + size)
        features = muted(drawn.features, 0.0, 2.0)
        rmse, nees, _, _ = judged(
            features, drawn, 2.2, start=start, precision=precision, bias="off"
        )
        assert rmse < 0.01 and nees < 1.5


@pytest.mark.parametrize("row", [0, 1, 2])
def test_mistaken_first_reading_is_corrected_by_the_next(world, row):
    for seed, joint in enumerate(ALL):
        drawn = world(seed, duration=6.0, encoder_std=0.01)
        features = shifted(drawn.features, 1.0, np.arange(len(drawn.truth.t)) == row, joint)
        rmse, nees, faults, _ = judged(features, drawn, 0.1)
        # before the first reading there is none that shows it to be false
        named = [(joint, FaultKind.GLITCH)] if row == 0 else []
        assert rmse < 0.006 and nees < 1.3 and [(one.name, one.kind) for one in faults] == named


@pytest.mark.parametrize("method", ["filter", "smoother"])
@pytest.mark.parametrize(
    ("rows", "size"), [((1,), 0.05), ((0, 1), 0.5), ((0, 1, 2), 0.5), ((0, 1, 2, 3), 1.5)]
)
@pytest.mark.parametrize(
    "seed", first_of(1, [1, 3, 2, 4, 5, 6, 7, 8])
)
def test_belief_that_rejects_an_encoder_from_the_start_recovers(world, rows, size, method, seed):
    """False readings that differ are not found beforehand."""
    drawn = world(seed, duration=8.0, encoder_std=0.002)
    k = np.arange(len(drawn.truth.t))
    features = shifted(drawn.features, size, np.isin(k, rows) & (k % 2 == 0), "lift")
    features = shifted(features, -size, np.isin(k, rows) & (k % 2 == 1), "lift")
    rmse, nees, faults, _ = judged(features, drawn, 1.2, method=method)
    assert rmse < 0.002 and nees < 1.4 and not faults


@pytest.mark.parametrize("size", [0.1, 1.0, pytest.param(0.3, marks=pytest.mark.soak)])
@pytest.mark.parametrize("seed", seeds(1, 2))
def test_belief_rejects_a_faulty_encoder_after_a_silence(world, size, seed):
    drawn = world(seed, duration=14.0, encoder_std=0.01)
    features = muted(drawn.features, 6.0, 9.0, ("pan",))
    features = shifted(features, size, features.joints.t >= 9.0, "pan")
    rmse, nees, faults, _ = judged(features, drawn, 0.0)
    assert rmse < 0.02 and nees < 2.0
    assert [fault.name for fault in faults] == ["pan"]


@pytest.mark.parametrize("seed", seeds(1, 3))
def test_pictures_of_something_else_lose_the_arm_only_until_they_are_right(world, seed):
    drawn = world(seed, duration=14.0, encoder_std=0.01)
    track = drawn.features.tracks["effector"]
    other = np.array([60.0, 180.0]) + np.random.default_rng(seed).normal(
        0.0, 0.4, track.values.shape
    )
    wrong = np.where(((track.t >= 6.0) & (track.t < 8.0))[:, None], other, track.values)
    features = muted(
        replace(drawn.features, tracks={"effector": replace(track, values=wrong)}), 6.0, 8.0
    )
    rmse, nees, _, (lost,) = judged(features, drawn, 8.4, bias="off")
    assert rmse < 0.006 and nees < 1.3
    assert "until 8." in lost


@pytest.mark.parametrize(
    "encoder_hz", [50.0, *(pytest.param(hz, marks=pytest.mark.soak) for hz in (10.0, 400.0))]
)
@pytest.mark.parametrize("seed", seeds(1, 3))
def test_belief_that_is_not_lost_is_unchanged(world, encoder_hz, seed):
    drawn = world(seed, duration=8.0, encoder_hz=encoder_hz, hidden=(3.0, 4.5), blunder=0.05)
    assert not judged(drawn.features, drawn, 0.0)[3]
    assert not judged(muted(drawn.features, 4.0, 4.8), drawn, 0.0)[3]
    assert not judged(drawn.features, drawn, 0.0, start=tuple(drawn.truth.values[0] + 1.0))[3]


@pytest.mark.soak
@pytest.mark.parametrize("names", [ALL, ("pan", "lift"), ("pan",)])
@pytest.mark.parametrize("silence", [1.0, 2.0, 5.0, 10.0])
@pytest.mark.parametrize("encoder_std", [0.001, 0.006, 0.02])
def test_lost_belief_recovers_in_all_worlds(world, names, silence, encoder_std):
    worst, ratios = [], []
    for seed in range(10):
        drawn = world(seed, duration=10.0 + silence, encoder_std=encoder_std)
        rmse, nees, faults, _ = judged(
            muted(drawn.features, 6.0, 6.0 + silence, names), drawn, 6.0 + silence
        )
        worst, ratios = [*worst, rmse / encoder_std], [*ratios, nees]
        assert not faults
    print(
        f"{'+'.join(names):15s} {silence:4.0f} s, {encoder_std} rad: {np.sort(worst)[-2:]}, {np.mean(ratios):.2f}"
    )
    # a posture's other solution may last until a picture tells
    assert np.sort(worst)[-2] < 1.2 and max(worst) < 10.0 and 0.8 < np.mean(ratios) < 1.3


def test_pixel_factor_below_one_keeps_variances_positive(world):
    drawn = world(9, duration=11.0, encoder_std=0.006)
    rmse, _, faults, _ = judged(muted(drawn.features, 6.0, 7.0, ("pan", "lift")), drawn, 7.0)
    assert rmse < 0.006 and not faults


def paused(features, since, gap):
    """The same log, all that comes after `since` (s) a `gap` (s) later."""

    def later(series):
        return replace(series, t=series.t + gap * (series.t > since))

    return replace(
        features, joints=later(features.joints),
        tracks={name: later(track) for name, track in features.tracks.items()},
    )  # fmt: skip


@pytest.mark.parametrize("gap", [3600.0, 1e7, 1.7e9])
@pytest.mark.parametrize("method", ["filter", "ekf", "smoother"])
def test_pause_of_any_length_separates_its_sides(world, white_acceleration, method, gap):
    drawn = world(3, duration=8.0)
    t = drawn.features.joints.t
    found = estimate_from_features(
        paused(drawn.features, 4.0, gap), drawn.body, EstimationSettings(method=method)
    )
    whole = estimate_from_features(drawn.features, drawn.body, EstimationSettings(method=method))
    after = t > 4.5
    assert np.isfinite(found.cov).all() and (np.einsum("nii->ni", found.cov) > 0.0).all()
    truth = np.stack(
        [np.interp(t, drawn.truth.t, column) for column in drawn.truth.values.T], axis=1
    )
    rms, usual = (
        np.sqrt(np.square(one.joints.values - truth)[after].mean()) for one in (found, whole)
    )
    assert rms < 1.2 * usual


@pytest.mark.parametrize("gap", [1e3, 1e5])
def test_joint_that_is_first_read_after_a_long_pause_starts_there(world, gap):
    """Unless it is reset, its variance has grown so far that rounding swallows the reading's."""
    drawn = world(3, duration=8.0)
    features = paused(muted(drawn.features, 0.0, 4.001, ("pan",)), 4.0, gap)
    found = estimate_from_features(
        features, drawn.body, EstimationSettings(start=tuple(drawn.truth.values[0]))
    )
    after = found.joints.t > gap
    truth = [
        np.interp(found.joints.t[after] - gap, drawn.truth.t, column)
        for column in drawn.truth.values.T
    ]
    assert np.sqrt(np.square(found.joints.values[after] - np.stack(truth, axis=1)).mean()) < 0.01


def test_estimate_refuses_a_grid_of_mostly_silence(world):
    drawn = world(3, duration=8.0)
    with pytest.raises(
        UsageError, match=r"rate: 50 Hz found, 5e\+08 instants for .* stamps, none .*; type --rate"
    ):
        estimate_from_features(
            paused(drawn.features, 4.0, 1e7), drawn.body, EstimationSettings(rate=50.0)
        )


def test_belief_whose_rates_rounding_broke_is_refused():
    with pytest.raises(np.linalg.LinAlgError, match="rates have the variance -1e-14"):
        sequential.fit_statistical_lines(1, np.zeros(2), np.diag([1.0, -1e-14]), [])
