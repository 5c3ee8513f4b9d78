"""Logs of which a camera films only a part."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.estimation import estimate_from_features
from bodylog.estimation.noise import evidence_search
from bodylog.settings import EstimationSettings


def with_images(features, first, last):
    """The features with only the images taken between two times."""
    track = features.tracks["effector"]
    kept = (track.t >= first) & (track.t <= last)
    parts = {name: getattr(track, name)[kept] for name in ("t", "values", "source_ns", "std")}
    return replace(features, tracks={"effector": replace(track, **parts)})


@pytest.mark.parametrize("last", [0.05, 0.2, 3.0])
@pytest.mark.parametrize("first", [0.0, 150.0])
def test_few_images_at_one_end_do_not_spoil_a_long_log(world, monkeypatch, first, last):
    monkeypatch.setattr(evidence_search, "MAX_INSTANTS", 4000)
    drawn = world(0, duration=200.0)
    some, none = (
        estimate_from_features(
            with_images(drawn.features, first, end),
            drawn.body,
            EstimationSettings(method="smoother"),
        ).joints.values
        for end in (first + last, -1.0)
    )
    error, alone = (np.sqrt(np.square(path - drawn.truth.values).mean()) for path in (some, none))
    assert error < 1.05 * alone


def test_noise_is_tuned_where_many_images_come_before_all_readings(world, monkeypatch):
    monkeypatch.setattr(evidence_search, "MAX_INSTANTS", 250)
    drawn = world(0, duration=20.0)
    joints = drawn.features.joints
    late = joints.t > 10.0
    parts = {name: getattr(joints, name)[late] for name in ("t", "values", "source_ns")}
    features = replace(with_images(drawn.features, 0.0, 9.0), joints=replace(joints, **parts))
    found = estimate_from_features(features, drawn.body, EstimationSettings())
    assert np.square(found.joints.values - drawn.truth.values[late]).mean() < 0.012**2
