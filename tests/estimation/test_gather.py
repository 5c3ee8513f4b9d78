"""Selection of senses, and one-line errors for impossible selections."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.errors import EvidenceError, LogError, ModelError, UsageError
from bodylog.estimation import METHODS, estimate_from_features
from bodylog.estimation.faults.screening import screen_measurements
from bodylog.settings import EstimationSettings


def unseen(drawn):
    track = drawn.features.tracks["effector"]
    return replace(
        drawn.features,
        tracks={"effector": replace(track, values=np.full_like(track.values, np.nan))},
    )


def test_joints_are_matched_by_name_whatever_their_order(world):
    drawn = world(0, duration=3.0)
    joints = drawn.features.joints
    turned = replace(joints, names=joints.names[::-1], values=joints.values[:, ::-1])
    one = estimate_from_features(drawn.features, drawn.body, EstimationSettings())
    two = estimate_from_features(
        replace(drawn.features, joints=turned), drawn.body, EstimationSettings()
    )
    np.testing.assert_array_equal(one.joints.values, two.joints.values)
    assert one.joints.names == ("pan", "lift", "elbow")


@pytest.mark.parametrize("method", METHODS)
def test_estimate_of_another_robots_log_names_both_robots(world, method):
    drawn = world(0, duration=2.0)
    with pytest.raises(ModelError, match=r"(?s)gripper.*elbow, pan, lift") as caught:
        estimate_from_features(
            drawn.features,
            replace(drawn.body, joints=("pan", "lift", "gripper")),
            EstimationSettings(method=method),
        )
    assert caught.value.exit_code == 65 and "\n" not in str(caught.value)


def test_sense_without_sightings_is_refused_only_if_named(world):
    drawn = world(0, duration=3.0)
    with pytest.raises(EvidenceError, match=r"vision: requested.*0 of 36 used, 36 out of view"):
        estimate_from_features(
            unseen(drawn), drawn.body, EstimationSettings(senses=("encoders", "vision"))
        )
    found = estimate_from_features(unseen(drawn), drawn.body, EstimationSettings())
    assert any("effector: nothing usable" in finding.text for finding in found.findings)


def test_selecting_touch_without_skin_is_an_error(world):
    drawn = world(0, duration=2.0)
    with pytest.raises(EvidenceError, match="touch: requested"):
        estimate_from_features(
            drawn.features, drawn.body, EstimationSettings(senses=("encoders", "touch"))
        )


def test_unknown_sense_error_lists_the_available(world):
    drawn = world(0, duration=2.0)
    possible = "encoders, vision, touch, effector, elbow, lift, pan"
    with pytest.raises(UsageError, match=f"'sonar' found, possible: {possible}"):
        estimate_from_features(drawn.features, drawn.body, EstimationSettings(senses=("sonar",)))


def test_estimate_refuses_a_log_without_any_sense(world):
    drawn = world(0, duration=2.0)
    with pytest.raises(EvidenceError, match="no sense has measurements"):
        estimate_from_features(
            replace(unseen(drawn), joints=None), drawn.body, EstimationSettings()
        )


def test_vision_alone_needs_a_start(world):
    drawn = world(0, duration=2.0)
    features = replace(drawn.features, joints=None)
    with pytest.raises(LogError, match=r"type in robot.toml \[estimate\] start = "):
        estimate_from_features(features, drawn.body, EstimationSettings())
    found = estimate_from_features(
        features, drawn.body, EstimationSettings(start=tuple(drawn.truth.values[0]))
    )
    assert np.isfinite(found.joints.values).all()
    with pytest.raises(UsageError, match="2 angles given, the body has 3"):
        estimate_from_features(features, drawn.body, EstimationSettings(start=(0.0, 0.0)))


@pytest.mark.parametrize(("field", "value"), [("method", "oracle"), ("rate", -1.0)])
def test_invalid_settings_are_refused(world, field, value):
    drawn = world(0, duration=2.0)
    with pytest.raises(UsageError, match=field):
        estimate_from_features(
            drawn.features, drawn.body, replace(EstimationSettings(), **{field: value})
        )


@pytest.mark.parametrize(
    "without, warned", [((), False), (("lift",), False), (("encoders",), True)]
)
def test_more_unobserved_joints_than_image_numbers_give_a_warning(world, without, warned):
    drawn = world(0, duration=2.0)
    found = estimate_from_features(drawn.features, drawn.body, EstimationSettings(without=without))
    texts = [
        finding.text for finding in found.findings if finding.text.startswith("vision: 2 numbers")
    ]
    assert bool(texts) == warned
    assert not warned or "3 joints without an encoder (pan, lift, elbow)" in texts[0]
    assert not any(
        finding.text.startswith("encoders: nothing usable") for finding in found.findings
    )


@pytest.mark.parametrize("asked", [("vision",), ("encoders", "effector")])
def test_baseline_refuses_senses_it_does_not_use(world, asked):
    drawn = world(0, duration=2.0)
    with pytest.raises(
        UsageError, match=f"kalman hears encoders alone, but {asked[-1]} is asked for"
    ):
        estimate_from_features(
            drawn.features, drawn.body, EstimationSettings(method="kalman", senses=asked)
        )


def test_senses_refuse_a_track_missing_in_the_log(world):
    drawn = world(0, duration=2.0)
    with pytest.raises(EvidenceError, match=r"effector: requested, but without measurements"):
        estimate_from_features(
            replace(drawn.features, tracks={}),
            drawn.body,
            EstimationSettings(senses=("encoders", "effector")),
        )


def test_joint_without_readings_is_counted_and_needs_a_start(world):
    drawn = world(0, duration=2.0)
    joints = drawn.features.joints
    values = joints.values.copy()
    values[:, joints.names.index("lift")] = np.nan
    mute = replace(drawn.features, joints=replace(joints, values=values))
    with pytest.raises(LogError, match=r"no reading of lift; type in robot.toml \[estim"):
        estimate_from_features(mute, drawn.body, EstimationSettings())
    with pytest.raises(EvidenceError, match="lift: requested"):
        estimate_from_features(
            mute, drawn.body, EstimationSettings(senses=("lift", "effector"), start=(0.0, 0.0, 0.0))
        )
    found = estimate_from_features(
        mute, drawn.body, EstimationSettings(start=tuple(drawn.truth.values[0][[0, 1, 2]]))
    )
    assert found.used["encoders"].rejected == {"without lift": len(values)}


def test_tracks_are_gathered_in_the_logs_order(world):
    """Otherwise the same log gives other bytes in another process, with other hashes of names."""
    drawn = world(0, duration=2.0)
    names = ("side/effector", "effector", "tip", "wrist", "back", "arm")
    body = replace(drawn.body, senses=dict.fromkeys(names, drawn.body.senses["effector"]))
    features = replace(
        drawn.features, tracks=dict.fromkeys(names, drawn.features.tracks["effector"])
    )
    assert [
        s.name for s in screen_measurements(features, body, EstimationSettings()).sightings
    ] == list(names)


def _quiet(drawn, begin, end, joints=(0, 1, 2)):
    """The features with some encoders silent from begin to end, and the remark on it."""
    read = drawn.features.joints
    values, rows = read.values.copy(), (read.t > begin) & (read.t < end)
    values[np.ix_(rows, joints)] = np.nan
    found = estimate_from_features(
        replace(drawn.features, joints=replace(read, values=values)),
        drawn.body,
        EstimationSettings(bias="off"),
    )
    return [finding.text for finding in found.findings if " silent from " in finding.text]


@pytest.mark.parametrize(
    ("begin", "end", "text_part"),
    [
        (4.01, 6.49, "from 4.000 to 6.500 s"),
        (7.01, 99.0, "from 7.000 s on"),
        (-1.0, 2.49, "first image to 2.500 s"),
    ],
)
def test_silence_warning_names_gap_and_consequence(world, begin, end, text_part):
    (text,) = _quiet(world(0, duration=9.0), begin, end)
    assert text_part in text and "2 numbers per image do not determine 3 joints" in text


def test_silence_warning_says_that_as_many_numbers_as_joints_may_fit_a_mirrored_posture(world):
    (text,) = _quiet(world(0, duration=9.0), 4.0, 7.0, joints=(0, 1))
    assert "2 numbers per image may fit a mirrored posture of 2 joints" in text


def test_silence_warning_is_absent_for_short_or_covered_gaps(world):
    assert not _quiet(world(0, duration=9.0), 4.0, 4.9)
    assert not _quiet(world(0, duration=9.0), 4.0, 7.0, joints=(1,))
