"""Touch: a synchronous touch locates the arm, an asynchronous one has hardly any weight."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.errors import UsageError
from bodylog.estimation import estimate_from_features
from bodylog.estimation.measurements import touch
from bodylog.settings import EstimationSettings

BLIND = EstimationSettings(senses=("encoders", "touch"), precision="model", bias="on")


def biased(drawn, stroked, weight):
    """Encoders 0.03 rad off in one joint, no effector in view, strokes on the effector with the given weight."""
    features = stroked(drawn, weight)
    joints = features.joints
    values = joints.values + 0.03 * (np.array(joints.names) == "pan")
    return replace(features, joints=replace(joints, values=values))


def test_variance_and_times_are_the_likelihoods(world, stroked):
    features, body = stroked(world(0), 0.5), world(0).body
    found, count = touch.read_touch_sighting(features, body)
    during = np.zeros(len(features.hand.t), bool)
    for felt in features.touches:
        during |= (features.hand.t >= felt.onset) & (features.hand.t <= felt.offset)
    np.testing.assert_array_equal(found.t, features.hand.t[during])
    np.testing.assert_array_equal(found.values, features.hand.values[during])
    assert len(found.source_ns) == len(found.t) > count == len(features.touches)
    # all frames of a touch count as one sighting
    np.testing.assert_allclose((1.0 / found.var).sum(axis=0), count * 2.0 * 0.005 * 0.5)


def test_touch_uses_a_cell_at_its_known_position(world, stroked):
    features, body = stroked(world(0), 1.0, (30.0, -8.0)), world(0).body
    body = replace(body, cells={1: (30.0, -8.0, 3.0)})
    found, count = touch.read_touch_sighting(features, body)
    effector = features.tracks["effector"]
    np.testing.assert_allclose(found.values, effector.values[np.isin(effector.t, found.t)])
    np.testing.assert_allclose((1.0 / found.var).sum(axis=0), count / 9.0)


def test_synchronous_touch_corrects_and_asynchronous_does_not(world, stroked):
    gain = {}
    for weight in (1.0, 1e-6):
        drawn = world(1, encoder_std=0.005)
        features = biased(drawn, stroked, weight)
        errors = []
        for settings in (replace(BLIND, senses=("encoders",)), BLIND):
            found = estimate_from_features(features, drawn.body, settings)
            late = found.joints.t > 10.0
            errors.append(np.sqrt(np.mean((found.joints.values - drawn.truth.values)[late, 0] ** 2)))
        gain[weight] = errors[0] - errors[1]
    assert gain[1.0] > 0.0015
    assert abs(gain[1e-6]) < 0.1 * gain[1.0]


def test_rubber_hand_pulls_only_when_synchronous(world, stroked):
    drift = {}
    for weight in (1.0, 1e-3):
        drawn = world(2, encoder_std=0.005)
        features = stroked(drawn, weight, (15.0, 0.0))
        with_touch, without = (
            estimate_from_features(features, drawn.body, replace(BLIND, senses=senses)) for senses in (BLIND.senses, ("encoders",))
        )
        drift[weight] = np.abs(with_touch.joints.values - without.joints.values)[-1].max()
    assert drift[1.0] > 20 * drift[1e-3]


def test_literal_touch_is_limited_to_the_papers_descent(world, stroked):
    drawn = world(0, duration=10.0)
    features = stroked(drawn, 1.0, (10.0, 0.0))
    with pytest.raises(UsageError, match="literal"):
        estimate_from_features(features, drawn.body, replace(BLIND, touch="literal"))
    descent = EstimationSettings(method="predictive-coding", preset="paper", senses=("encoders", "touch"))
    both = [
        estimate_from_features(features, drawn.body, replace(descent, preset=preset, precision="fixed", touch=form)).joints.values
        for preset, form in (("default", "literal"), ("default", "likelihood"))
    ]
    assert np.abs(both[0] - both[1]).max() > 1e-4
