"""Changes since a body was learned: joint zeros, camera and marker, by evidence."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog import body
from bodylog.body.kinematic import change
from bodylog.body.kinematic.model import can_show_changes
from bodylog.findings import log_estimate as change_findings
from bodylog.findings.faults import fault_warnings
from bodylog.settings import EstimationSettings, Settings
from bodylog.sim.hardware import Hardware, encoder_noise
from bodylog.types import Fault, FaultKind
from tests.body.changed_arms import DEGREE, explored, run
from tests.kinematics.robots import JOINTS


@pytest.fixture(scope="module")
def known():
    return explored()


def test_change_is_absent_in_a_sound_log(known):
    for seed in (50, 51):
        assert change.find_changes(run(seed), known) == ()


@pytest.mark.parametrize(("joint", "degrees"), [("pan", 1.0), ("lift", -2.0), ("elbow", 5.0)])
def test_change_detects_a_moved_zero_with_its_size(known, joint, degrees):
    (one,) = change.find_changes(run(offset={joint: degrees * DEGREE}), known)
    assert (one.kind, one.name, one.since, one.alternatives) == ("joint", joint, None, ())
    assert abs(one.value[0] - degrees * DEGREE) < 3 * one.std[0] < 0.5 * DEGREE and one.nats > change.CHANGE_NATS


def test_change_detects_a_slipped_gear_with_its_time(known):
    (one,) = change.find_changes(run(offset={"lift": 2 * DEGREE}, since=6.0), known)
    assert one.name == "lift" and abs(one.since - 6.0) < 0.3 and abs(one.value[0] - 2 * DEGREE) < 3 * one.std[0]


def test_change_names_two_faulty_joints_with_their_sizes(known):
    found = change.find_changes(run(offset={"lift": 2 * DEGREE, "elbow": -3 * DEGREE}), known)
    assert {one.name: round(float(np.degrees(one.value[0]))) for one in found} == {"lift": 2, "elbow": -3}


def test_change_of_a_pushed_camera_names_no_joint(known):
    (one,) = change.find_changes(run(camera=np.array([0.01, 0.0, 0.0, 0.0, 0.03, 0.01])), known)
    assert (one.kind, one.name) == ("camera", "camera") and abs(one.value[4] - 0.03) < 3 * one.std[4]


def test_false_sightings_do_not_count(known):
    features = run(offset={"elbow": 2 * DEGREE})
    track = features.tracks["effector"]
    wrong = track.values.copy()
    wrong[::15] += 80.0
    (one,) = change.find_changes(replace(features, tracks={"effector": replace(track, values=wrong)}), known)
    assert one.name == "elbow" and abs(one.value[0] - 2 * DEGREE) < 3 * one.std[0]


@pytest.mark.parametrize("seed", [53, 54, 55])
def test_errors_of_encoders_that_last_are_no_change_and_hide_none(known, seed):
    hardware = Hardware(correlated=4e-3, correlation_s=2.0)
    lasting = dict.fromkeys(known.joints, (hardware.correlated, hardware.correlation_s))

    def err(features):
        joints = features.joints
        off = encoder_noise(hardware, 0.0, joints.values.shape, 100.0, np.random.default_rng(seed))
        return replace(features, joints=replace(joints, values=joints.values + off))

    sound = err(run(seed, encoder=2e-3))
    assert change.find_changes(sound, known) and not change.find_changes(sound, known, lasting)
    (one,) = change.find_changes(err(run(seed, encoder=2e-3, offset={"lift": 3 * DEGREE})), known, lasting)
    assert one.name == "lift" and abs(one.value[0] - 3 * DEGREE) < 3 * one.std[0]


def test_change_needs_a_urdf_and_sightings(known):
    features = run(offset={"elbow": 2 * DEGREE})
    plain = replace(known, senses={"effector": body.learn_body([run(3, 10.0)], Settings(), {}).model.senses["effector"]})
    assert not can_show_changes(plain) and change.find_changes(features, plain) == ()
    assert change.find_changes(replace(features, tracks={}), known) == ()
    few = replace(features, joints=replace(features.joints, names=("a", "b", "c", "d")))
    assert change.find_changes(few, known) == ()


def _estimate(features, known, **settings):
    from bodylog import pipeline

    chosen = Settings(estimate=EstimationSettings(**settings))
    found = pipeline.infer(features, known, chosen)
    return found, change_findings.compare_changes_with_faults(features, known, found, chosen.estimate)


def test_change_findings_name_a_change_once_with_its_std(known):
    found, estimated = _estimate(run(offset={"elbow": 3 * DEGREE}), known)
    assert [fault.kind for fault in found.faults] == ["drifting"]
    (fault,) = estimated.faults
    assert (fault.sense, fault.name, fault.kind) == ("encoders", "elbow", "offset")
    assert abs(fault.size + 3 * DEGREE) < 3 * fault.std
    (text,) = fault_warnings(estimated.faults)
    assert f"± {fault.std:.2g} rad (" in text.text and text.text.endswith("°); relative to the body")
    assert any(f.text.startswith("elbow: reads -") and "nats likelier" in f.text for f in estimated.findings)


def test_change_leaves_a_slip_to_the_filters_fault(known):
    found, estimated = _estimate(run(offset={"lift": 3 * DEGREE}, since=6.0), known)
    assert estimated.faults == found.faults and len(found.faults) == 1


def test_change_findings_attribute_no_pushed_camera_to_joints(known):
    features = run(duration=14.0)
    found, _ = _estimate(features, known)
    track = features.tracks["effector"]
    pushed = replace(track, values=track.values + 12.0 * (track.t >= 7.0)[:, None])
    features = replace(features, tracks={"effector": pushed})
    assert change.find_changes(features, known)
    displaced = replace(found, faults=(Fault("vision", "camera", FaultKind.DISPLACED, 7.0, 17.0, "px", 0.2),))
    assert change_findings.compare_changes_with_faults(features, known, displaced, EstimationSettings()).faults == displaced.faults


def test_bias_off_reports_no_offset(known):
    found, estimated = _estimate(run(offset={"elbow": 3 * DEGREE}), known, bias="off")
    assert estimated is found and not estimated.faults


def test_sizes_that_differ_are_both_reported(known):
    found, _ = _estimate(run(), known)
    (one,) = change.find_changes(run(offset={"elbow": 3 * DEGREE}), known)
    other = replace(found, faults=(Fault("encoders", "elbow", FaultKind.DRIFTING, 0.1, 0.2, "rad"),))
    faults, findings = change_findings.merge_changes_and_faults([one], other)
    assert [fault.kind for fault in faults] == ["offset"]
    assert any("by the filter its offset is 0.2 rad" in finding.text for finding in findings)


def test_ambiguous_changes_are_named_together(known):
    found, _ = _estimate(run(), known)
    (one,) = change.find_changes(run(offset={"elbow": 3 * DEGREE}), known)
    (fault,), _ = change_findings.merge_changes_and_faults([replace(one, alternatives=("camera",))], found)
    assert fault.name == "elbow or camera" and fault.size != fault.size and fault.std is None


@pytest.mark.soak
def test_change_has_true_error_bars_over_many_draws():
    draw, within, count, false = np.random.default_rng(7), 0, 0, 0
    for seed in range(10):
        one = explored(seed)
        false += sum(bool(change.find_changes(run(1000 + 10 * seed + k), one)) for k in range(2))
        for k in range(4):
            joint, size = JOINTS[draw.integers(4)], draw.uniform(1, 5) * draw.choice([-1, 1]) * DEGREE
            found = [c for c in change.find_changes(run(2000 + 10 * seed + k, offset={joint: size}), one) if c.name == joint]
            count += len(found)
            within += sum(abs(c.value[0] - size) < 2 * c.std[0] for c in found)
    assert false == 0 and count >= 38 and within >= 0.9 * count
