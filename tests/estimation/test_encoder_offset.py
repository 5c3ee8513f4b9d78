"""The score test for offsets, against the evidence of the filter with an offset."""

from dataclasses import replace
from functools import cache, partial
from types import SimpleNamespace

import numpy as np
import pytest

from bodylog import body
from bodylog.estimation import estimate_from_features
from bodylog.estimation.faults import encoder_offset, offset_changes
from bodylog.estimation.faults.offset_scores import _score_offsets, score_encoder_offsets
from bodylog.estimation.inference.filter_log import solve_by_gauss_newton
from bodylog.estimation.measurements.records import Encoders
from bodylog.estimation.methods import filtering
from bodylog.settings import EstimationSettings, Settings
from bodylog.sim.hardware import Hardware
from bodylog.sim.scenarios import SCENARIOS
from bodylog.types import FaultKind
from tests.estimation import mechanisms
from tests.estimation.conftest import draw
from tests.estimation.mechanisms import Mechanism, errors_and_nees
from tests.seeds import first_of, seeds
from tests.validation import logs

WALK = offset_changes.RANDOM_WALKS[0]


def lying(drawn, size, joint="pan", since=8.0):
    joints = drawn.features.joints
    values = joints.values + size * np.outer(joints.t >= since, np.array(joints.names) == joint)
    return replace(drawn.features, joints=replace(joints, values=values))


def error(found, drawn, since=0.0):
    """Root mean square error (rad) of an estimate from `since` s on."""
    t, truth = found.joints.t, drawn.truth
    x = np.column_stack(
        [
            np.interp(t, truth.t, truth.values[:, truth.names.index(name)])
            for name in found.joints.names
        ]
    )
    return np.sqrt(np.mean((found.joints.values - x)[t >= since] ** 2))


def solved(features, body, **settings):
    problem = filtering.build_filter_problem(features, body, EstimationSettings(**settings))
    problem, warm = filtering.tune_noise(problem, EstimationSettings(**settings))
    return problem, solve_by_gauss_newton(problem, warm)


@pytest.mark.parametrize("size", [0.0, 0.03, 0.05, 0.1])
@pytest.mark.parametrize("seed", range(2))
def test_offset_score_is_the_evidence_with_an_offset(world, seed, size):
    drawn = world(seed, duration=14.0, encoder_std=0.02, pixel_std=0.5, camera_hz=20.0)
    problem, found = solved(lying(drawn, size), drawn.body)
    cost = partial(offset_changes.measure_free_energy, warm=found)
    wins = [
        cost(problem) - cost(offset_changes.with_drift(problem, WALK * row)) for row in np.eye(3)
    ]
    np.testing.assert_allclose(score_encoder_offsets(problem, found, WALK)[0], wins, atol=20.0, rtol=0.3)
    assert (max(wins) > encoder_offset.EVIDENCE_THRESHOLD_NATS) is (size > 0)


def test_offset_score_without_images_is_zero(world):
    drawn = world(0, duration=6.0)
    problem, found = solved(replace(drawn.features, tracks={}), drawn.body)
    assert not score_encoder_offsets(problem, found, WALK)[0].any()


@cache
def body_of_images(seed):
    """A body learned from images, with model error."""
    explored = draw(seed, duration=40.0, camera_hz=8.0, encoder_hz=50.0, encoder_std=0.003, pixel_std=0.3)
    return body.learn_body([explored.features], Settings(), {}).model


@pytest.fixture
def learned():
    return body_of_images(1)


def _never(*_, **__):
    raise AssertionError("an offset was tried")


def test_offset_search_skips_sound_logs(world, monkeypatch):
    monkeypatch.setattr(encoder_offset, "choose_encoder_offsets", _never)
    for seed in range(3):
        drawn = world(seed, duration=12.0, hidden=(6.0, 8.0), blunder=0.02)
        assert not estimate_from_features(drawn.features, drawn.body, EstimationSettings()).faults


def test_offset_search_ignores_the_smoothers_forward_lag(world, learned, monkeypatch):
    monkeypatch.setattr(encoder_offset, "choose_encoder_offsets", _never)
    for seed in (7, 8):
        drawn = world(
            seed, duration=60.0, encoder_hz=500.0, camera_hz=30.0, encoder_std=0.01, pixel_std=0.3
        )
        assert not estimate_from_features(
            drawn.features, learned, EstimationSettings(method="smoother")
        ).faults


def test_offset_score_decreases_with_a_smoothers_lag(
    world, learned, monkeypatch, white_acceleration
):
    scored, named = [], "score_encoder_offsets"
    monkeypatch.setattr(
        encoder_offset, named, lambda *given: scored.append(score_encoder_offsets(*given)) or scored[-1]
    )
    for seed in (2, 3):
        drawn = world(
            seed, duration=120.0, encoder_hz=100.0, encoder_std=0.01, pixel_std=0.3, camera_hz=30.0
        )
        estimate_from_features(drawn.features, learned, EstimationSettings(method="smoother"))
    assert len(scored) == 2
    # a nat per eight half-second spans, so a log of ten minutes stays far from NATS
    assert max(gain.max() for gain, _, _ in scored) < -30.0


def test_model_error_gives_no_encoder_fault(world, learned):
    for seed in range(2, 5):
        drawn = world(seed, duration=120.0, encoder_std=0.01, pixel_std=0.3, camera_hz=30.0)
        gain, _, _ = score_encoder_offsets(*solved(drawn.features, learned), WALK)
        assert (gain < encoder_offset.EVIDENCE_THRESHOLD_NATS).all()


@pytest.mark.parametrize("seed", seeds(2, 12))
def test_body_of_a_short_exploration_gives_no_encoder_fault(world, seed):
    explored = world(
        seed, duration=5.0, camera_hz=8.0, encoder_hz=50.0, encoder_std=0.003, pixel_std=0.3
    )
    drawn = world(1000 + seed, duration=20.0, encoder_std=0.02, pixel_std=0.3, camera_hz=20.0)
    found = estimate_from_features(
        drawn.features,
        body.learn_body([explored.features], Settings(), {}).model,
        EstimationSettings(),
    )
    assert not found.faults and error(found, drawn) < 0.012


@pytest.mark.parametrize("joint", ["lift", "elbow"])
@pytest.mark.parametrize("seed", seeds(1, 2))
def test_encoder_step_near_the_noise_is_named(world, seed, joint):
    drawn = world(seed, duration=16.0, encoder_std=0.02, pixel_std=0.5, camera_hz=20.0)
    found = estimate_from_features(lying(drawn, 0.04, joint), drawn.body, EstimationSettings())
    assert [fault.name for fault in found.faults] == [joint]
    assert found.faults[0].size == pytest.approx(0.04, abs=0.02)


@pytest.mark.parametrize(("joint", "size"), [("pan", 0.1), ("elbow", -0.05)])
@pytest.mark.parametrize("seed", seeds(1, 20))
def test_encoder_step_has_its_time_and_its_size_within_its_error(world, seed, joint, size):
    drawn = world(seed, duration=16.0, encoder_std=0.01, camera_hz=20.0)
    (fault,) = estimate_from_features(
        lying(drawn, size, joint), drawn.body, EstimationSettings()
    ).faults
    assert (fault.name, fault.kind) == (joint, "jumping") and abs(fault.since - 8.0) < 0.1
    assert abs(fault.size - size) < 4.0 * fault.std < 0.03


@pytest.mark.parametrize("seed", seeds(1, 10))
def test_encoder_step_leaves_the_filters_error_as_it_is_without(world, seed):
    drawn = world(seed, duration=16.0, encoder_std=0.01, camera_hz=20.0)
    features = (drawn.features, lying(drawn, 0.1, "elbow"))
    sound, stepped = (
        error(estimate_from_features(each, drawn.body, EstimationSettings()), drawn, since=8.0)
        for each in features
    )
    assert stepped < 1.06 * sound


@pytest.mark.parametrize(
    "seed", first_of(1, range(1, 12))
)
@pytest.mark.parametrize("method", ["filter", "smoother"])
def test_large_encoder_step_is_a_step_and_no_drift(world, seed, method):
    model, drawn = body_of_images(5000 + seed), world(7000 + seed)
    found = estimate_from_features(lying(drawn, 0.3), model, EstimationSettings(method=method))
    assert [(fault.name, fault.kind) for fault in found.faults] == [("pan", "jumping")]
    assert error(found, drawn) < {"filter": 0.0075, "smoother": 0.004}[method]


@pytest.mark.parametrize(
    ("size", "silence"),
    [(0.1, 2.0), pytest.param(0.1, 5.0, marks=pytest.mark.soak), (1.0, 0.2)],
)
@pytest.mark.parametrize("seed", seeds(1, 6))
def test_step_after_a_silence_of_all_encoders_is_named(world, seed, size, silence):
    drawn = world(9000 + seed, encoder_std=0.005)
    features = lying(drawn, size)
    read = (features.joints.t < 8.0) | (features.joints.t >= 8.0 + silence)
    t, values, source_ns = (
        part[read]
        for part in (features.joints.t, features.joints.values, features.joints.source_ns)
    )
    features = replace(
        features, joints=replace(features.joints, t=t, values=values, source_ns=source_ns)
    )
    found = estimate_from_features(features, body_of_images(5000), EstimationSettings())
    assert [fault.name for fault in found.faults] == ["pan"]
    assert found.faults[0].size == pytest.approx(size, abs=0.01)
    assert error(found, drawn, since=8.0 + silence) < 0.006


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(4))
def test_large_step_in_a_gap_of_precise_encoders_is_a_step_from_the_first_reading_on(world, seed):
    """A filter shows it late, and a parabola that was followed too far found no size: a drift."""
    drawn = world(seed, duration=12.0, encoder_std=0.003, camera_hz=20.0)
    joints = drawn.features.joints
    values = joints.values.copy()
    values[joints.t >= 7.0, joints.names.index("pan")] += 0.5
    values[(joints.t >= 6.0) & (joints.t < 7.0)] = np.nan
    features = replace(drawn.features, joints=replace(joints, values=values))
    found = estimate_from_features(features, drawn.body, EstimationSettings())
    (fault,) = found.faults
    assert (fault.name, fault.kind) == ("pan", "jumping")
    assert fault.since == pytest.approx(7.0, abs=0.03)
    assert abs(fault.size - 0.5) < 4.0 * fault.std < 0.01
    assert error(found, drawn) < 0.003


@pytest.mark.parametrize(
    ("seed", "joint", "size"), first_of(1, [(3, "elbow", 0.02), (4, "elbow", 0.05), (0, "pan", 0.02)])
)
def test_encoder_step_that_a_filter_takes_for_motion_is_a_step(world, seed, joint, size):
    drawn = world(seed, duration=16.0, encoder_std=0.01, camera_hz=20.0)
    (fault,) = estimate_from_features(
        lying(drawn, size, joint), drawn.body, EstimationSettings()
    ).faults
    assert (fault.name, fault.kind) == (joint, "jumping") and abs(fault.since - 8.0) < 0.25
    assert abs(fault.size - size) < 4.0 * fault.std < 0.02


def test_drift_has_a_size_with_its_error(world):
    drawn = world(1, duration=16.0, encoder_std=0.01, camera_hz=20.0)
    joints = drawn.features.joints
    values = joints.values + np.outer(
        0.02 * np.clip(joints.t - 8.0, 0.0, None), np.array(joints.names) == "pan"
    )
    (fault,) = estimate_from_features(
        replace(drawn.features, joints=replace(joints, values=values)),
        drawn.body,
        EstimationSettings(),
    ).faults
    assert fault.kind == "drifting" and abs(fault.size - 0.16) < 4.0 * fault.std < 0.05


@pytest.mark.parametrize("seed", first_of(1, [20, 21]))
def test_a_steady_drift_is_not_trailed_and_error_bars_hold(world, seed):
    drawn = world(seed, duration=16.0, encoder_std=0.01, camera_hz=20.0)
    joints = drawn.features.joints
    pan = np.array(joints.names) == "pan"
    values = joints.values + np.outer(0.02 * np.clip(joints.t - 8.0, 0.0, None), pan)
    found = estimate_from_features(
        replace(drawn.features, joints=replace(joints, values=values)),
        drawn.body,
        EstimationSettings(),
    )
    (fault,) = found.faults
    assert abs(fault.since - 8.0) < 0.5 and abs(fault.size - 0.16) < 0.01
    # a random walk alone errs by 1.35 times as much as on a sound log
    assert error(found, drawn, 8.0) < 1.2 * error(
        estimate_from_features(drawn.features, drawn.body, EstimationSettings()), drawn, 8.0
    )


def test_offset_score_of_encoders_far_surer_than_images_is_not_rounding():
    pull, weight = np.array([[2e16, 0.0]]), np.array([[1e16, 0.0]])
    seen = np.zeros((1, 2, 3))
    seen[0, 0, 0] = 3.0
    seen[0, 0, 2] = 5.0
    slope, curvature = _score_offsets(pull, weight, seen)
    # (A + W)^-1 W is 1 but for 4e-16: of an offset of 2 rad, what the images say is left
    np.testing.assert_allclose(slope, [[2.0 * 4.0 - 5.0, 0.0]], rtol=1e-9)
    np.testing.assert_allclose(curvature, [[4.0, 0.0]], rtol=1e-9)


def test_a_change_is_worth_no_more_than_the_log_with_it(monkeypatch, world):
    """Far from a minimum that is no parabola, one through three costs lies far below it."""
    drawn = world(0, duration=4.0)
    problem = filtering.build_filter_problem(drawn.features, drawn.body, EstimationSettings())
    read = problem.evidence.encoders.values

    def find_cost(posed):
        size = (read - posed.evidence.encoders.values)[-1, 1]
        return 1e3 * np.hypot(1.0, (size - 0.03) / 5e-3)

    monkeypatch.setattr(offset_changes, "filter_roughly", lambda posed, warm: posed)
    monkeypatch.setattr(offset_changes, "sum_free_energy", find_cost)
    for first in (0.0, 0.028, 0.032, 0.1):
        found = offset_changes._size_likeliest_change(problem, 1, None, {2.0: first}, grows=False)
        assert found is None or found.nats - found.prior >= 1e3 - 1.0
    # from the others a parabola leads too far, and the search goes back
    for first in (0.02, 0.028, 0.04, 0.05):
        near = offset_changes._size_likeliest_change(problem, 1, None, {2.0: first}, grows=False)
        assert near.fault.size == pytest.approx(0.03, abs=1e-3)


@pytest.mark.parametrize("method", ["filter", "smoother"])
@pytest.mark.soak
def test_a_drift_of_hundreds_of_times_the_noise_is_named(method):
    """Innovations are cut at 4 σ, so that the first score shows an offset smaller than a fault."""
    quiet = logs.drawn(
        "drift", 1002, 20.0, plan=lambda request: replace(SCENARIOS["drift"].plan(request), noise=3e-4)
    )
    found = estimate_from_features(
        quiet.features, logs.learned(2), EstimationSettings(method=method)
    )
    (fault,) = found.faults
    assert fault.name == "shoulder_pan_joint" and fault.kind == FaultKind.DRIFTING
    errors, nees = errors_and_nees(found, quiet.truth)
    assert 0.5 < nees < 2.0 and np.sqrt(np.mean(errors**2)) < 0.4e-3


@pytest.mark.parametrize(
    ("method", "joint", "size"),
    [
        ("filter", 0, -0.3),
        ("smoother", 1, 0.02),
        *(pytest.param("filter", *one, marks=pytest.mark.soak) for one in [(1, 0.02), (1, 0.1), (2, 0.17)]),
        *(pytest.param("smoother", *one, marks=pytest.mark.soak) for one in [(0, -0.3), (1, 0.1), (2, 0.17)]),
    ],
)
@pytest.mark.soak
def test_an_encoder_that_is_off_far_beyond_precise_images_is_named_on_an_arm_with_play(method, joint, size):
    """Images that tell a joint ten times as well as a reading were rejected, or taken for a payload: 66 mrad."""
    arm = Mechanism(5e-4, Hardware(play=4e-3), pixel_std=0.05)
    features = mechanisms.replayed(22, arm, mechanisms.Fault())
    values = features.joints.values.copy()
    values[:, joint] += size
    features = replace(features, joints=replace(features.joints, values=values))
    found = estimate_from_features(features, mechanisms.fitted(arm), EstimationSettings(method=method))
    (fault,) = found.faults
    assert (fault.name, fault.kind) == (found.joints.names[joint], FaultKind.DRIFTING)
    assert fault.since < 0.05 and abs(fault.size - size) < 4.0 * fault.std < 2e-3
    error = found.joints.values - mechanisms.links_of(22, arm, mechanisms.Fault()).values
    assert np.sqrt(np.mean(error**2)) < 0.35e-3
    assert 0.3 < np.mean(error**2 / np.einsum("nii->ni", found.cov)) < 2.0


def test_readings_out_of_which_a_drift_was_taken_have_no_fault_below_a_count():
    t = np.arange(0.0, 10.0, 0.01)
    drift = 0.02 * t
    counted = Encoders(t, np.round((np.sin(t) + drift)[:, None] / 0.02) * 0.02, t.astype(np.int64))
    corrected = counted.with_corrected_readings(counted.values - drift[:, None])
    evidence = SimpleNamespace(encoders=corrected, rad_per_unit=1.0)
    np.testing.assert_allclose(encoder_offset.find_smallest_fault(evidence), 0.02)
