"""What a drift does is told from what it does not do."""

import numpy as np

from bodylog.experiments.beliefs import Belief
from bodylog.experiments.e3_drift import effects, healed
from bodylog.experiments.lab import Heard
from bodylog.types import Features, Series

T = np.arange(0.0, 30.0, 0.5)


def test_the_drift_is_taken_out_again():
    drift = 0.3 * np.clip((T - 8.0) / 16.0, 0.0, 1.0)
    joints = Series(T, np.stack([drift, drift + 1.0], axis=1), ("elbow_joint", "shoulder_pan_joint"), "rad", T)
    sound = healed(Heard(Features(joints, {}, None, (), (), {}), joints)).features.joints
    assert np.allclose(sound.values[:, 0], drift) and np.allclose(sound.values[:, 1], 1.0)


def test_effects_are_relative_to_the_sound_log():
    x = np.tile([0.5, 0.2, 0.1], (len(T), 1))
    found = effects(Belief(T, x + np.array([0.15, -0.02, 0.03]), x), Belief(T, x, x))
    assert np.isclose(found["left"], 0.5) and np.isclose(found["second"], 0.02) and np.isclose(found["others"], 0.03)
