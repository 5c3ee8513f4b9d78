"""The effect of a drift, separated from all else."""

import numpy as np

from bodylog.experiments.e3_drift import add_drift, measure_drift_effects
from bodylog.experiments.lab import JOINTS, ObservedLog
from bodylog.types import Features, Series

T = np.arange(0.0, 30.0, 0.5)


def test_drifted_changes_only_the_first_encoder():
    joints = Series(T, np.ones((len(T), 3)), JOINTS, "rad", T)
    found = add_drift(ObservedLog(Features(joints, {}, None, (), (), {}), joints)).features.joints.values
    assert np.allclose(found[:, 0], 1.0 + 0.3 * np.clip((T - 8.0) / 16.0, 0.0, 1.0)) and np.all(found[:, 1:] == 1.0)


def test_effects_are_relative_to_the_sound_log():
    x = np.tile([0.5, 0.2, 0.1], (len(T), 1))
    found = measure_drift_effects(T, x + np.array([0.15, -0.02, 0.03]), x)
    assert np.isclose(found["left"], 0.5) and np.isclose(found["second"], 0.02) and np.isclose(found["others"], 0.03)
