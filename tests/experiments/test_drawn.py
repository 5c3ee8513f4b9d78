"""Drawn logs: the camera is the simulator's, the motion has the period asked for."""

import numpy as np
import pytest

from bodylog import pipeline
from bodylog.experiments import drawn
from bodylog.experiments.lab import JOINTS, ObservedLog
from bodylog.settings import Settings


def test_place_equals_the_simulators_track(robot):
    read, features = pipeline.observe(robot / "reach.mcap", Settings())
    track, truth = features.effector, ObservedLog(features, read.signals.truth)
    seen = np.isfinite(track.values).all(axis=1)
    apart = (drawn.place_in_image(truth.true(JOINTS, track.t), (160, 120)) - track.values)[seen]
    assert seen.sum() > 30 and np.abs(np.median(apart, axis=0)).max() < 0.1 and np.abs(apart).max() < 0.6


@pytest.mark.parametrize("period", [4.0, 15.0])
def test_swinging_keeps_its_period_and_explored_range(period):
    t, x = drawn.draw_swing(period, 3, (True, True, False), t=np.arange(0.0, 3 * period, 0.01))
    again = drawn.draw_swing(period, 3, (True, True, False), t=t + period)[1]
    assert np.allclose(x[:, 0], again[:, 0]) and np.ptp(x[:, 0]) > 0.5 and np.ptp(x[:, 2]) == 0.0
    assert np.all(np.abs(x - drawn.ARM.home[:3]) <= 0.7 * np.array(drawn.ARM.swing[:3]) + 1e-12)


def test_log_rests_until_its_begin_and_squares_encoders():
    log = drawn.draw_log(4.0, 0.0, 1, begins=5.0, square=True)
    t, x = log.truth.t, log.truth.values
    assert np.ptp(x[t < 5.0], axis=0).max() == 0.0 < np.ptp(x[t > 5.0], axis=0).min()
    assert np.array_equal(log.features.joints.values, x**2)
    assert np.array_equal(drawn.draw_log(4.0, 0.1, 1).features.joints.values, drawn.draw_log(4.0, 0.1, 1).features.joints.values)
