"""Logs of which a camera films only a part."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bodylog.estimation import estimate_from_features
from bodylog.estimation.noise import evidence_search
from bodylog.settings import EstimationSettings
from tests.estimation.conftest import draw


def with_images(features, first, last):
    """The features with only the images taken between two times."""
    track = features.tracks["effector"]
    kept = (track.t >= first) & (track.t <= last)
    parts = {name: getattr(track, name)[kept] for name in ("t", "values", "source_ns", "std")}
    return replace(features, tracks={"effector": replace(track, **parts)})


@pytest.fixture(scope="module")
def error_of_long_log():
    """A function: the error (rad) with only the images taken between two times, of a log that is
    two and a half times as long as what noise is tuned on.
    """
    drawn = draw(0, duration=100.0)

    def estimated(first, last):
        features = with_images(drawn.features, first, last)
        settings = EstimationSettings(method="smoother")
        path = estimate_from_features(features, drawn.body, settings).joints.values
        return np.sqrt(np.square(path - drawn.truth.values).mean())

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(evidence_search, "MAX_INSTANTS", 2000)
        yield cache(estimated)


@pytest.mark.parametrize("last", [0.05, 0.2, 3.0])
@pytest.mark.parametrize("first", [0.0, 75.0])
def test_few_images_at_one_end_do_not_spoil_a_long_log(error_of_long_log, first, last):
    assert error_of_long_log(first, first + last) < 1.05 * error_of_long_log(0.0, -1.0)


def test_noise_is_tuned_where_many_images_come_before_all_readings(world, monkeypatch):
    monkeypatch.setattr(evidence_search, "MAX_INSTANTS", 250)
    drawn = world(0, duration=20.0)
    joints = drawn.features.joints
    late = joints.t > 10.0
    parts = {name: getattr(joints, name)[late] for name in ("t", "values", "source_ns")}
    features = replace(with_images(drawn.features, 0.0, 9.0), joints=replace(joints, **parts))
    found = estimate_from_features(features, drawn.body, EstimationSettings())
    assert np.square(found.joints.values - drawn.truth.values[late]).mean() < 0.012**2
