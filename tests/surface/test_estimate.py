"""Judging a log by the robot's own surface: where landmarks are looked for, and which offsets a log shows."""

from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np
import pytest

from bodylog.kinematics.landmark_hypotheses import CAMERA, OFFSET_STD, SOUND, ChangeHypothesis
from bodylog.kinematics.landmarks import LandmarkBelief
from bodylog.surface import estimate as surface_estimate
from bodylog.surface import findings as surface_findings
from tests.kinematics.landmark_arm import JOINTS, model, motion, truth
from tests.surface import humanoid_faults

FAULT = np.radians(5.0)


def joint_change(joint, std):
    return ChangeHypothesis(joint, 0.0, 0.01, std, OFFSET_STD)


def test_landmarks_are_looked_for_under_offsets_that_tracks_leave_possible():
    plain = model([motion(1)])
    phi = truth(plain, delay=0.03)
    belief = LandmarkBelief(phi, np.eye(len(phi)))
    built = replace(plain, changes=True)
    built = replace(built, belief=surface_estimate._belief_of_changes(built, belief))
    changes = [ChangeHypothesis(SOUND, 0.0), joint_change(JOINTS[0], 0.003), joint_change(JOINTS[3], 0.08),
               ChangeHypothesis(CAMERA, 0.0)]  # fmt: skip
    starts = list(surface_estimate._starts(built, SimpleNamespace(model=plain, phi=phi), belief, changes))
    offsets = np.array([start[built.of_changes] for start in starts])
    assert sorted(offsets[offsets[:, 0] != 0.0, 0]) == pytest.approx([0.01])
    tried = np.sort(offsets[offsets[:, 3] != 0.0, 3])
    assert tried.min() < -FAULT and tried.max() > FAULT
    assert np.diff(tried).max() == pytest.approx(surface_estimate._SEARCH_STEP)
    assert all(start[built.of_delays] == pytest.approx(0.03) for start in starts)


def test_joint_is_identifiable_where_a_common_fault_would_be_found():
    least = surface_estimate._least_offset
    assert least(joint_change("wrist", np.radians(0.54))) < FAULT
    assert least(joint_change("wrist", np.radians(1.72))) > OFFSET_STD


@pytest.mark.parametrize("shift, faults", [(None, []), (8.0, ["moved"])])
def test_camera_is_not_judged_by_another_scene(shift, faults):
    changes = [ChangeHypothesis(SOUND, 0.0), joint_change(JOINTS[0], 0.003), ChangeHypothesis(CAMERA, 20.0)]
    judged = surface_estimate.CameraChanges("camera", changes, (JOINTS[0],), shift)
    learned = SimpleNamespace(surface=SimpleNamespace(joint_of={name: name for name in JOINTS}))
    fault = surface_estimate._winning_fault(judged, 0.0, learned)
    assert [one.kind for one in [fault] if one is not None] == faults
    if shift is None:
        finding = surface_estimate._describe_other_scene(judged)
        assert finding.severity == "warning"
        assert "whether the camera moved is not judged" in finding.text and "20 nats" in finding.text
        quiet = replace(judged, changes=[ChangeHypothesis(SOUND, 0.0), ChangeHypothesis(CAMERA, 2.0)])
        assert surface_estimate._describe_other_scene(quiet).severity == "info"


def changes_of_log(elbow, shift=0.2):
    """What an estimate's settings hold of a log that tells the elbow's offset to 1°, and of the pan nothing."""
    std = 1.0 / np.sqrt(np.radians(1.0) ** -2.0 + OFFSET_STD**-2.0)
    value = -elbow * (std / np.radians(1.0)) ** 2
    nats = float(np.log(std / OFFSET_STD) + 0.5 * (value / std) ** 2)
    changes = [ChangeHypothesis(SOUND, 0.0), ChangeHypothesis("pan", -0.2, 0.0, 0.099, OFFSET_STD),
               ChangeHypothesis("elbow", nats, value, std, OFFSET_STD), ChangeHypothesis(CAMERA, -5.0)]  # fmt: skip
    return {"camera": {"shift_px": shift, "changes": [asdict(one) for one in changes]}}


def test_logs_tell_together_what_none_of_them_tells_alone():
    camera = SimpleNamespace(name="camera", delays=np.zeros(8))
    surface = SimpleNamespace(joint_of={"pan": "pan", "elbow": "elbow"}, cameras=(camera,))
    learned = SimpleNamespace(surface=surface, joints=("pan", "elbow"))
    logs = [changes_of_log(np.radians(size)) for size in (2.6, 3.1, 2.9, 3.4)]
    for one in logs:
        (shown,) = [change for change in one["camera"]["changes"] if change["name"] == "elbow"]
        assert abs(shown["value"]) < surface_estimate._least_offset(ChangeHypothesis(**shown))
    (text,), (fault,) = surface_findings.examine_together(logs, learned)
    assert fault.name == "elbow" and np.degrees(fault.size) == pytest.approx(3.0, abs=0.1)
    assert 0.5 < np.degrees(fault.std) < 0.65
    assert text.severity == "warning" and "camera: 4 logs together: encoders elbow" in text.text
    (text,), faults = surface_findings.examine_together([changes_of_log(0.0)] * 3, learned)
    assert not faults and text.severity == "info"
    assert "no fault in common" in text.text and "elbow" in text.text and "of pan none would be found" in text.text
    assert surface_findings.examine_together(logs[:1], learned) == ((), ())


def test_an_offset_that_no_log_tells_alone_is_found_from_its_first_log_on():
    camera = SimpleNamespace(name="camera", delays=np.zeros(8))
    surface = SimpleNamespace(joint_of={"pan": "pan", "elbow": "elbow"}, cameras=(camera,))
    learned = SimpleNamespace(surface=surface, joints=("pan", "elbow"))
    rng = np.random.default_rng(4)
    for first in (0, 3):
        sizes = rng.normal(0.0, 0.5, 8) + np.where(np.arange(8) < first, 0.0, 3.0)
        logs = [changes_of_log(np.radians(size)) for size in sizes]
        logs[5] = {}
        ((number, fault),) = surface_estimate.find_lasting_faults(logs, learned)
        assert number == first and fault.name == "elbow"
        assert abs(np.degrees(fault.size) - 3.0) < 2.0 * np.degrees(fault.std)
    sound = [changes_of_log(np.radians(size)) for size in rng.normal(0.0, 1.0, 8)]
    assert not list(surface_estimate.find_lasting_faults(sound, learned))


@pytest.mark.soak
def test_offsets_of_a_real_humanoid_are_named_with_their_sizes():
    if not humanoid_faults.G1.is_dir():
        pytest.skip("the real G1 (../shared/real/g1) is not at hand")
    named = 0
    for pair in humanoid_faults.PAIRS:
        sound = humanoid_faults.judge_pair(pair, "")
        assert not sound.found[0] and not any(alone[0] for alone in sound.alone), sound
        for joint in humanoid_faults.JOINTS[:6]:
            name, size, _ = humanoid_faults.judge_pair(pair, joint).found
            named += name == joint and abs(size - 5.0) < 1.0
    assert named >= 16


@pytest.mark.soak
def test_held_out_episodes_of_a_real_humanoid_are_foretold():
    if not humanoid_faults.G1.is_dir():
        pytest.skip("the real G1 (../shared/real/g1) is not at hand")
    apart = []
    for pair in humanoid_faults.PAIRS:
        learned = humanoid_faults.body_without(pair)
        for number in pair:
            assert humanoid_faults.held_out_error(number, learned)[0] < 1.2
            (first, one), (second, other) = humanoid_faults.half_delays(number, learned)
            apart.append((first - second) ** 2 / (one**2 + other**2))
    assert np.isnan(apart).sum() <= 1  # the later half of episode 11: 27 of 129 moving corners
    assert np.nanmean(apart) < 2.0
