"""Errors of the hardware: explained without truth, and angles and error bars that allow for them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bodylog.estimation import estimate_from_features
from bodylog.estimation.factors.encoder_error import JointNoise
from bodylog.estimation.factors.factor_problem import ANY_ERRORS, CHANGE, LastingPrior, Noise
from bodylog.estimation.factors.load import build_load_columns
from bodylog.estimation.factors.whole_log import explain_by_white_noise, explain_log, solve_log
from bodylog.estimation.faults.moved_camera import restore_displacements
from bodylog.estimation.faults.threshold import EVIDENCE_THRESHOLD_NATS
from bodylog.estimation.measurements.arm_errors import ArmErrors
from bodylog.estimation.methods import explained, filtering
from bodylog.estimation.methods.filtering import build_filter_problem
from bodylog.estimation.methods.results import Beliefs
from bodylog.fault_kinds import Fault as FoundFault
from bodylog.findings import verdict
from bodylog.settings import EstimationSettings
from bodylog.sim.hardware import Hardware
from bodylog.types import HARDWARE_ERRORS, LASTING_ERROR, FaultKind, Finding
from tests.estimation import mechanisms
from tests.estimation.conftest import Explored
from tests.estimation.mechanisms import LASTING, LOOSE, Fault, errors_and_nees, true_angles


def test_encoder_errors_that_last_are_taken_out_as_far_as_images_show_them():
    body = mechanisms.learned(1000, mechanisms.SOUND)
    features, true = mechanisms.replayed(4, LASTING, Fault()), true_angles(4, LASTING)
    found = estimate_from_features(features, body, EstimationSettings(method="smoother"), "off")
    reported = found.settings[HARDWARE_ERRORS]
    assert (
        reported["lasting"]["std"] == pytest.approx(2e-3, rel=0.5)
        and reported["lasting"]["at"] == "encoder"
    )
    assert 0.5 < reported["lasting"]["seconds"] < 8.0
    assert not reported["play"]
    error, nees = errors_and_nees(found, true)
    raw = features.joints.values - true.values
    assert np.sqrt(np.mean(error**2)) < np.sqrt(np.mean(raw**2))
    assert 0.4 < nees < 2.5
    (warning,) = (one for one in found.findings if "errors last" in one.text)
    assert warning.severity == "warning" and "mrad" in warning.text
    assert any("errors last" in line for line in verdict.verdict_of_estimate(found, ()))


@pytest.mark.soak
def test_images_that_are_displaced_for_a_while_are_no_load():
    body = mechanisms.learned(1000, mechanisms.SOUND)
    features = mechanisms.replayed(4, mechanisms.SOUND, Fault())
    track = features.tracks["effector"]
    away = np.outer((track.t >= 7.0) & (track.t < 9.5), (4.0, -3.0))
    moved = {"effector": replace(track, values=track.values + away)}
    found = estimate_from_features(replace(features, tracks=moved), body, EstimationSettings())
    reported = found.settings[HARDWARE_ERRORS]
    assert reported["load"] is None and not found.faults
    (one,) = reported["displaced"]
    assert one["camera"] == "camera" and one["size"] == pytest.approx([4.0, -3.0], abs=0.5)
    assert [one["since"], one["until"]] == pytest.approx([7.0, 9.5], abs=0.06)
    _, nees = errors_and_nees(found, true_angles(4, mechanisms.SOUND))
    assert 0.4 < nees < 1.5
    lines = verdict.verdict_of_estimate(found, ())
    assert "camera: images from 7.0 s to 9.5 s are displaced by 5 px; angles allow for it" in lines
    assert "no fault found in 3 encoders" in lines  # not in the track


@pytest.mark.soak
def test_an_offset_that_is_no_fault_goes_where_what_lasts_explains_the_log_as_well():
    # pan's encoder seems to walk here, by less than counts as a fault
    body = mechanisms.learned(1000, mechanisms.SOUND)
    lasting = ArmErrors(lasting=dict.fromkeys(body.joints, (2e-3, 2.0))).as_provenance()
    seen = Explored(samples=body.senses["effector"].samples)
    known = replace(body, senses={"effector": seen}, provenance=lasting)
    features = mechanisms.replayed(9112, mechanisms.CORRELATED, Fault())
    found = estimate_from_features(features, known, EstimationSettings())
    true = mechanisms.links_of(9112, mechanisms.CORRELATED, Fault())
    error, nees = errors_and_nees(found, true)
    raw = features.joints.values - true.values
    # with the walk 0.86 of it
    assert np.sqrt(np.mean(error**2)) < 0.7 * np.sqrt(np.mean(raw**2))
    assert 0.4 < nees < 2.0
    assert not found.faults


def test_play_is_measured_and_taken_out_and_no_delay_stands_for_it():
    body = mechanisms.learned(1000, mechanisms.SOUND)
    features, true = mechanisms.replayed(4, LOOSE, Fault(), 10.0), true_angles(4, LOOSE, 10.0)
    found = estimate_from_features(features, body, EstimationSettings())
    play = found.settings[HARDWARE_ERRORS]["play"]
    assert set(play) == set(found.joints.names)
    for one in play.values():
        assert one["rad"] == pytest.approx(8e-3, abs=max(4.0 * one["std"], 8e-4))
    error, nees = errors_and_nees(found, true)
    # the readings err by 4 mrad
    assert np.sqrt(np.mean(error**2)) < 1e-3
    assert 0.2 < nees < 2.5
    assert "delay" not in found.settings and not found.faults
    lines = verdict.verdict_of_estimate(found, ())
    assert sum("° of play; corrected" in line for line in lines) == 3
    assert not any("timestamps" in line for line in lines)


@pytest.mark.soak
def test_play_that_came_after_the_exploration_is_found_where_joints_rest_for_long():
    # errors of images at one place stood for it, and the rest for a delay of 5 ms
    arm = mechanisms.Mechanism(5e-4, Hardware(play=4e-3))
    features = mechanisms.replayed(7703, arm, Fault(), reaches=True)
    found = estimate_from_features(
        features, mechanisms.learned(1000, mechanisms.SOUND), EstimationSettings()
    )
    error, nees = errors_and_nees(found, mechanisms.links_of(7703, arm, Fault(), reaches=True))
    assert nees < 1.5 and np.sqrt(np.mean(error**2)) < 1e-3
    assert not found.faults and "delay" not in found.settings
    assert found.settings[HARDWARE_ERRORS]["play"].keys() == set(found.joints.names)


def test_what_was_taken_out_of_readings_is_expected_of_them():
    body = mechanisms.learned(1000, mechanisms.SOUND)
    features = mechanisms.replayed(4, mechanisms.SOUND, Fault(), 10.0)
    problem = build_filter_problem(features, body, EstimationSettings(bias="off"))
    after = features.joints.t >= 4.0
    # ten times the noise of a reading are left of a step in lift
    values = problem.evidence.encoders.values + 1e-2 * after[:, None] * np.array([0.0, 1.0, 0.0])
    step = FoundFault("encoders", "lift", FaultKind.JUMPING, 4.0, 0.1, "rad", std=1e-2)
    encoders = replace(problem.evidence.encoders, values=values)
    evidence = replace(problem.evidence, encoders=encoders, faults=(step,))
    problem = replace(problem, evidence=evidence)
    white = explain_by_white_noise(problem)
    for causal in (True, False):
        solved = solve_log(problem, white, causal)
        errors = solved.instants.encoder_errors
        # a filter learns the step from the first images after it
        known = problem.timeline.t > 5.0
        assert ((np.abs(errors[known]) > 3.0).mean(axis=0) < 0.02).all()
        assert (np.nanmean(np.square(errors[known]), axis=0) > 0.8).all()
        # a filter that lost the arm is not the one that is reported
        lost = Beliefs(*[errors] * 6, {}, {}, findings=(Finding("warning", "belief: lost lift"),))
        assert not explained._with_explanation(problem, lost, white, solved).findings


def test_an_encoder_that_drifts_is_named_and_no_error_that_lasts_stands_for_it():
    body = mechanisms.learned(1000, mechanisms.SOUND)
    found = estimate_from_features(
        mechanisms.replayed(4, mechanisms.SOUND, Fault(drift=5e-3)), body, EstimationSettings()
    )
    (fault,) = found.faults
    assert (fault.name, fault.kind) == ("lift", "drifting")
    assert HARDWARE_ERRORS not in found.settings


def test_a_payload_is_named_as_no_encoder_that_drifts():
    seed = 23
    body = mechanisms.learned(1000, mechanisms.SOUND)
    fault = Fault(payload=1.75e-2)
    features = mechanisms.replayed(seed, mechanisms.SOUND, fault, 8.0)
    found = estimate_from_features(features, body, EstimationSettings(), "off")
    assert not found.faults
    load = found.settings[HARDWARE_ERRORS]["load"]
    assert load["rad"]["lift"] == pytest.approx(1.75e-2, rel=0.3)
    true = true_angles(seed, mechanisms.SOUND, 8.0)
    sag = fault.payload * mechanisms.sink(true.values)
    error, nees = errors_and_nees(found, replace(true, values=true.values + sag))
    assert np.sqrt(np.mean(error**2)) < 0.4 * np.sqrt(np.mean(sag**2))
    assert nees < 4.0


def test_cameras_that_moved_are_put_back():
    body = mechanisms.learned(1000, mechanisms.SOUND)
    features = mechanisms.replayed(4, mechanisms.SOUND, Fault(), 10.0)
    track = features.tracks["effector"]
    off = track.values + 5.0 * (track.t > 5.0)[:, None]
    moved = replace(features, tracks={"effector": replace(track, values=off)})
    problem = build_filter_problem(moved, body, EstimationSettings())
    assert [fault.kind for fault in problem.evidence.faults] == [FaultKind.DISPLACED]
    found = restore_displacements(problem.evidence)
    assert not found.faults
    assert not any(one.chosen for one in found.hypotheses if one.name == "camera moved")
    (sighting,) = (one for one in found.sightings if one.name == "effector")
    np.testing.assert_allclose(sighting.values, off, atol=1e-9)
    assert sighting.displaced is None and sighting.model is body.senses["effector"]


@pytest.mark.parametrize(
    ("setting", "reason"),
    [({"hardware_errors": "widen"}, 'type hardware_errors = "explain"'), ({"bias": "off"}, "offsets are set to off")],
)
def test_error_bars_are_wider_and_angles_stay_where_settings_keep_them(setting, reason):
    body = mechanisms.learned(1000, mechanisms.SOUND)
    found = estimate_from_features(mechanisms.replayed(4, LOOSE, Fault()), body, EstimationSettings(**setting))
    assert HARDWARE_ERRORS not in found.settings
    assert LASTING_ERROR in found.settings
    (warning,) = (one for one in found.findings if "errors last" in one.text)
    assert reason in warning.text


def test_a_log_whose_explanation_has_no_solution_gets_wider_error_bars_and_the_reason(monkeypatch):
    def fail(*_given):
        raise np.linalg.LinAlgError("singular matrix")

    monkeypatch.setattr(explained, "explain_log", fail)
    body = mechanisms.learned(1000, mechanisms.SOUND)
    found = estimate_from_features(mechanisms.replayed(4, LOOSE, Fault()), body, EstimationSettings())
    assert HARDWARE_ERRORS not in found.settings
    assert LASTING_ERROR in found.settings
    assert any("no solution (singular matrix)" in one.text for one in found.findings)


@pytest.mark.parametrize(
    ("std", "seconds", "usual"), [(3e-3, 2.0, True), (6e-3, 2.0, False), (1e-3, 9.0, False)]
)
def test_errors_many_times_the_explorations_stand_for_no_offset(std, seconds, usual):
    prior = LastingPrior((float(np.log(1e-3)), CHANGE), (0.0, CHANGE), True)
    all_of_them = np.ones(3, bool)
    error = np.array([1e-3, std, 1e-3])
    joints = JointNoise(np.full(3, 1e-6), np.ones(3), error, np.full(3, seconds), ~all_of_them, all_of_them)
    assert explained._is_usual(Noise(joints, (1.0,), prior=prior)) is usual
    assert explained._is_usual(Noise(joints, (1.0,), prior=ANY_ERRORS)) is (seconds < 5.0)


def test_encoders_without_errors_that_last_are_usual():
    white = JointNoise(np.full(3, 1e-6), np.ones(3), None, np.ones(3), np.zeros(3, bool), np.zeros(3, bool))
    assert explained._is_usual(Noise(white, (1.0,), prior=ANY_ERRORS))


@pytest.mark.parametrize("beside, least", [({"load": 7.0}, 0.0), ({}, -EVIDENCE_THRESHOLD_NATS)])
def test_an_offset_beside_a_load_is_a_fault_only_where_the_load_alone_explains_less(beside, least):
    """The load explains as much as errors that last. An offset beside the load is then a fault only by evidence."""
    sound = SimpleNamespace(joints=SimpleNamespace(error=None))
    alone = SimpleNamespace(noise=sound, explanation=SimpleNamespace(gains={"load": 9.0}, columns=()))
    both = SimpleNamespace(explanation=SimpleNamespace(gains=beside))
    problem = SimpleNamespace(
        timeline=SimpleNamespace(t=np.zeros(1)), precision=SimpleNamespace(drift=np.array([0.0, 1e-7]))
    )
    offset = FoundFault("encoders", "elbow", FaultKind.DRIFTING, 0.0, -0.014, "rad", 5e-4)
    assert explained._choose_fault_allowance(alone, both, problem, (offset,), 0) == least


@pytest.mark.soak
def test_noise_beside_play_is_searched_from_what_a_load_would_leave_too():
    """From the noise without a load alone the search ends elsewhere: 2.5 mrad, with a NEES of 4.1."""
    arm = mechanisms.Mechanism(1e-3, Hardware(play=17.5e-3))
    found = estimate_from_features(mechanisms.replayed(7762, arm, Fault()), mechanisms.fitted(arm), EstimationSettings())
    assert set(found.settings[HARDWARE_ERRORS]["gains"]) == {"play"}
    error, nees = errors_and_nees(found, mechanisms.links_of(7762, arm, Fault()))
    assert np.sqrt(np.mean(error**2)) < 2e-3 and nees < 2.0


@pytest.mark.parametrize("axes", [True, False])
@pytest.mark.soak
def test_a_load_that_is_found_is_refined(monkeypatch, axes):
    """It gets one direction for all joints on found axes, and the second order in the posture without them."""
    body = mechanisms.fitted(mechanisms.SOUND)
    features = mechanisms.replayed(8, mechanisms.SOUND, Fault(payload=1.75e-2))
    problem = filtering.build_filter_problem(features, body, EstimationSettings())
    problem = filtering.tune_noise(problem, EstimationSettings())[0]
    loads = build_load_columns(body if axes else SimpleNamespace(senses={}), features.joints.values)
    found = explain_log(problem, np.zeros(3), ANY_ERRORS, loads)
    assert "load" in found.explanation.gains
    columns = found.explanation.columns
    assert len(found.explanation.learned.sizes) == len(columns)
    if axes:
        assert len({one.hand for one in columns}) == 1
        assert len(columns) == 3 + 3 + 3 + len(columns[0].hand.still_joints)
    else:
        orders = [len(one.factors) for one in columns]
        assert [orders.count(order) for order in range(3)] == [3, 9, 18]


PRECISE = 0.04
"""px: noise of rendered images, whose track tells a joint ten times as well as a reading does."""


@pytest.mark.soak
def test_play_beside_precise_images_leads_no_filter_away():
    """Its rounds diverge: a link elsewhere within its play moves the motor, which moves the link."""
    arm = mechanisms.Mechanism(1e-3, Hardware(play=8.7e-3), pixel_std=PRECISE)
    features = mechanisms.replayed(4, arm, Fault(), reaches=True)
    found = estimate_from_features(features, mechanisms.fitted(arm), EstimationSettings())
    assert HARDWARE_ERRORS in found.settings
    error, nees = errors_and_nees(found, mechanisms.links_of(4, arm, Fault(), reaches=True))
    assert 0.5 < nees < 1.6 and np.sqrt(np.mean(error**2)) < 0.75e-3


@pytest.mark.soak
def test_errors_that_last_beside_precise_images_are_taken_out():
    """White noise has error bars so small that two ways to find outliers differ by as much."""
    arm = mechanisms.Mechanism(
        1e-3, Hardware(correlated=1e-3, correlation_s=0.2), pixel_std=PRECISE
    )
    features = mechanisms.replayed(5, arm, Fault(), reaches=True)
    settings = EstimationSettings(method="smoother")
    found = estimate_from_features(features, mechanisms.fitted(arm), settings)
    assert HARDWARE_ERRORS in found.settings
    error, nees = errors_and_nees(found, mechanisms.links_of(5, arm, Fault(), reaches=True))
    assert 0.5 < nees < 1.6 and np.sqrt(np.mean(error**2)) < 0.8e-3
