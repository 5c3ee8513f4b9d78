"""A touch and a stroke have one cause where the hand is seen near where the skin is touched."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.errors import UsageError
from bodylog.estimation import common_cause, estimate_from_features
from bodylog.settings import EstimationSettings

BLIND = EstimationSettings(senses=("encoders", "touch"), precision="model", bias="off")
SIZE = (320, 240)


def stroked_aside(drawn, stroked, aside):
    return replace(stroked(drawn, 1.0, (aside, 0.0)), picture_size=SIZE)


def drift(drawn, features, prior):
    """How far touch moves the belief at most, rad."""
    with_touch = estimate_from_features(features, drawn.body, replace(BLIND, common_cause=prior))
    without = estimate_from_features(features, drawn.body, replace(BLIND, senses=("encoders",)))
    return float(np.abs(with_touch.joints.values - without.joints.values).max())


def test_posterior_is_bayes_rule():
    assert common_cause.compute_common_cause_posterior(0.5, 3.0, 1.0) == pytest.approx(0.75)
    assert common_cause.compute_common_cause_posterior(0.2, 3.0, 1.0) == pytest.approx(0.6 / 1.4)
    assert (
        common_cause.compute_common_cause_posterior(0.0, 3.0, 1.0) == 0.0
        and common_cause.compute_common_cause_posterior(1.0, 3.0, 1.0) == 1.0
    )


@pytest.mark.parametrize("seed", range(2))
def test_drift_fades_with_displacement_where_the_cause_is_inferred(world, stroked, seed):
    drawn = world(seed, encoder_std=0.02)
    near, far = (stroked_aside(drawn, stroked, aside) for aside in (10.0, 80.0))
    taken, inferred = (
        [drift(drawn, features, prior) for features in (near, far)] for prior in (None, 0.5)
    )
    assert inferred[0] == pytest.approx(taken[0], rel=0.1)
    assert inferred[1] < 0.05 * taken[1]


def test_prior_of_one_takes_the_cause_for_granted(world, stroked):
    drawn = world(0, encoder_std=0.02)
    features = stroked_aside(drawn, stroked, 80.0)
    assert drift(drawn, features, 1.0) == pytest.approx(drift(drawn, features, None))


def test_touch_of_another_cause_is_reported_and_kept_out(world, stroked):
    drawn = world(0, encoder_std=0.02)
    features = stroked_aside(drawn, stroked, 80.0)
    found = estimate_from_features(features, drawn.body, replace(BLIND, common_cause=0.5))
    health = found.used["touch"]
    assert health.used == 0 and health.rejected == {"no common cause": len(features.touches)}


def test_size_of_the_image_and_another_sense_are_needed(world, stroked):
    drawn = world(0)
    features = stroked_aside(drawn, stroked, 0.0)
    with pytest.raises(UsageError, match="common_cause: the log has no images"):
        estimate_from_features(
            replace(features, picture_size=None), drawn.body, replace(BLIND, common_cause=0.5)
        )
    with pytest.raises(UsageError, match="common_cause: touch is the only sense"):
        estimate_from_features(
            features, drawn.body, replace(BLIND, senses=("touch",), common_cause=0.5)
        )


def test_method_without_touch_says_that_it_ignores_the_prior(world):
    drawn = world(0, duration=5.0)
    found = estimate_from_features(
        drawn.features, drawn.body, EstimationSettings(method="kalman", common_cause=0.5)
    )
    assert any("common_cause" in one.text and "ignored" in one.text for one in found.findings)
