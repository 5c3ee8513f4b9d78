"""Joints of further topics are learned only where a track shows their motion."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bodylog import body
from bodylog.body.data.exploration import select_joints
from bodylog.body.data.pairs import has_moved, smooth_all_joints
from bodylog.recording import recording
from bodylog.settings import BodySettings, Settings
from bodylog.types import Features, Series

WORLDS = Path(__file__).parents[2].parent / "shared" / "logs" / "worlds"


def _beside(features: Features, finger: np.ndarray, name: str) -> Features:
    """The features with one more joint, on a topic of its own: in rows between the others'."""
    t, old = features.joints.t, features.joints
    both = np.sort(np.concatenate([t, t[::2] + 0.003]))
    values = np.full((len(both), len(old.names) + 1), np.nan)
    values[np.searchsorted(both, t), :-1] = old.values
    values[np.searchsorted(both, t[::2] + 0.003), -1] = finger[::2]
    joints = Series(both, values, (*old.names, name), "rad", (both * 1e9).astype(np.int64))
    return replace(features, joints=joints, beside=(name,))


def test_learn_ignores_a_gripper_that_moves_unseen(explored):
    alone = explored(1, 0.002, 20.0).features
    finger = 0.04 * np.sin(1.3 * alone.joints.t)
    both = _beside(alone, finger, "finger")
    one, two = (body.learn_body([f], Settings(), {}) for f in (alone, both))
    assert one.model.joints == two.model.joints == ("pan", "lift", "elbow")
    x = one.model.senses["effector"].samples[:5]
    means = [learned.model.senses["effector"].predict(x)[0] for learned in (one, two)]
    np.testing.assert_array_equal(*means)
    (text,) = (f.text for f in two.findings if f.text.startswith("finger"))
    assert "left out: no track shows its motion" in text and "[body] joints" in text
    asked = body.learn_body([both], Settings(body=BodySettings(joints=("pan", "lift", "elbow", "finger"))), {})
    assert asked.model.joints == ("pan", "lift", "elbow", "finger")


def test_learn_includes_a_visible_joint_of_a_further_topic(explored):
    alone = explored(1, 0.002, 20.0).features
    kept = [0, 1, 3]
    old = alone.joints
    without = replace(alone, joints=replace(old, values=old.values[:, kept], names=tuple(old.names[k] for k in kept)))
    both = _beside(without, old.values[:, 2], "elbow")
    assert set(body.learn_body([both], Settings(), {}).model.joints) == {"pan", "lift", "elbow"}


def test_learn_omits_a_gripper_beside_a_nearly_noiseless_track():
    """A process fits the fingers' motion to its small residual, which exceeds a tag's noise."""
    if not WORLDS.is_dir():
        pytest.skip(f"{WORLDS} is not here")
    read, truth = recording.read_recording(WORLDS / "tag_explore", Settings()), np.load(WORLDS / "tag_explore.truth.npz")
    t = truth["t_frame"] + (float(truth["start"]) if truth["t_frame"][0] < 1e8 else 0.0) / 1e9 - read.start_ns / 1e9
    places = np.where(truth["seen"][:, None] > 0.5, truth["uv"], np.nan)
    track = Series(t, places, ("u", "v"), "px", np.rint(t * 1e9).astype(np.int64), np.full(places.shape, 0.01))
    found = Features(read.signals.joints, {"effector": track}, None, (), (), {}, beside=read.facts.beside)
    kept, text = select_joints([found], [j for j in smooth_all_joints([found], None) if has_moved(j)], Settings().fit)
    assert len(kept) == 6 and {f.text.split(":")[0] for f in text} == {"left_finger_joint", "right_finger_joint"}


@pytest.mark.parametrize("further", [True, False])
def test_learn_omits_a_wheel_that_turns_all_the_time(explored, further):
    """A wheel is a clock: it explains a track between neighbours in time, and nothing of held-out time."""
    alone = explored(1, 0.002, 20.0).features
    old = alone.joints
    wheel = 3.0 * old.t + 0.1 * np.sin(old.t)
    one_topic = replace(old, values=np.column_stack([old.values, wheel]), names=(*old.names, "wheel"))
    both = _beside(alone, wheel, "wheel") if further else replace(alone, joints=one_topic)
    learned = body.learn_body([both], Settings(), {})
    assert set(learned.model.joints) == {"pan", "lift", "elbow"}
    (left,) = (f for f in learned.findings if f.text.startswith("wheel"))
    assert left.severity == ("info" if further else "warning") and "[body] joints" in left.text


@pytest.mark.parametrize("turned", [("pan",), ("pan", "lift"), ("pan", "lift", "elbow")])
def test_learn_includes_joints_that_seem_to_turn(explored, turned):
    """A turntable, and an arm in degrees."""
    alone = explored(1, 0.002, 20.0).features
    old = alone.joints
    scaled = old.values * np.where(np.isin(old.names, turned), 57.3, 1.0)
    wide = body.learn_body([replace(alone, joints=replace(old, values=scaled))], Settings(), {})
    assert wide.model.joints == ("pan", "lift", "elbow")
