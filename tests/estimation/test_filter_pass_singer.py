"""A motion model that the compiled filter does not know, added to the table alone: Singer's."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog.errors import UsageError
from bodylog.estimation import estimate_from_features
from bodylog.estimation.live import LiveEstimator
from bodylog.motion import MOTION_MODELS
from bodylog.settings import EstimationSettings
from bodylog.types import HARDWARE_ERRORS
from tests.estimation import mechanisms
from tests.estimation.conftest import JOINTS, Explored, draw
from tests.estimation.singer import Singer
from tests.estimation.spoilt_logs import muted

PROCESS = (9.0, 15.0, 30.0)
"""rad²/s⁵ of each joint."""
LASTS_S = 0.4
TYPED = EstimationSettings(
    precision="model", bias="off", rate=None, motion="singer", process=dict(zip(JOINTS, PROCESS, strict=True))
)


@pytest.fixture
def singer(monkeypatch):
    monkeypatch.setitem(MOTION_MODELS, "singer", Singer(LASTS_S))


@pytest.fixture
def endless(monkeypatch):
    """Singer's model with accelerations that do not fade: white jerk, by the way of other models."""
    monkeypatch.setitem(MOTION_MODELS, "endless", Singer(1e7))


@pytest.mark.parametrize(("encoder_hz", "duration"), [(50.0, 8.0), (400.0, 6.0)])
@pytest.mark.usefixtures("singer")
def test_filter_and_smoother_under_singers_model_are_the_textbooks(reference, linear_model, encoder_hz, duration):
    drawn = draw(1, duration=duration, encoder_hz=encoder_hz, model=linear_model, hidden=(2.0, 3.0))
    expected = reference(drawn, np.array(PROCESS), np.full(3, 0.02**2), 0.4**2, 3, 1.0 / LASTS_S)
    filtered = estimate_from_features(drawn.features, drawn.body, TYPED)
    at = np.searchsorted(expected.t, filtered.joints.t)
    np.testing.assert_allclose(filtered.joints.values, expected.mean[at, :3], atol=1e-8, rtol=0)
    np.testing.assert_allclose(filtered.rate.values, expected.mean[at, 3:6], atol=1e-7, rtol=0)
    np.testing.assert_allclose(filtered.cov, expected.cov[at, :3, :3], atol=1e-9, rtol=0)
    assert filtered.free_energy.sum() == pytest.approx(expected.nats[: at[-1] + 1].sum(), abs=1e-6)
    smoothed = estimate_from_features(drawn.features, drawn.body, replace(TYPED, method="smoother"))
    np.testing.assert_allclose(smoothed.joints.values, expected.smooth[at, :3], atol=1e-8, rtol=0)
    np.testing.assert_allclose(smoothed.rate.values, expected.smooth[at, 3:6], atol=1e-7, rtol=0)
    np.testing.assert_allclose(smoothed.cov, expected.smooth_cov[at, :3, :3], atol=1e-9, rtol=0)
    # accelerations that fade are not those that do not
    jerk = estimate_from_features(drawn.features, drawn.body, replace(TYPED, motion="white-jerk"))
    assert np.abs(jerk.joints.values - filtered.joints.values).max() > 1e-3


@pytest.mark.parametrize("method", ["filter", "smoother"])
@pytest.mark.usefixtures("endless")
def test_both_ways_learn_the_same_noise(method):
    settings = EstimationSettings(method=method)
    drawn = draw(2, duration=6.0, model=Explored())
    features = muted(drawn.features, 2.0, 3.5, ("lift",)) if method == "filter" else drawn.features
    found, expected = (
        estimate_from_features(features, drawn.body, replace(settings, motion=name)) for name in ("endless", "white-jerk")
    )
    assert found.settings["motion"] == "endless" and expected.settings["motion"] == "white-jerk"
    np.testing.assert_allclose(found.settings["process"], expected.settings["process"], rtol=1e-5)
    np.testing.assert_allclose(found.joints.values, expected.joints.values, atol=1e-6)
    np.testing.assert_allclose(found.cov, expected.cov, atol=1e-8)


@pytest.mark.usefixtures("singer")
def test_live_filter_moves_as_the_log_did():
    drawn = draw(3, duration=4.0)
    batch = estimate_from_features(drawn.features, drawn.body, TYPED)
    live = LiveEstimator(drawn.body, learned=batch.settings)
    joints, track = drawn.features.joints, drawn.features.tracks["effector"]
    events = [(t, {"joints": dict(zip(joints.names, row, strict=True))}) for t, row in zip(joints.t, joints.values, strict=True)]
    events += [(t, {"effector": tuple(row)}) for t, row in zip(track.t, track.values, strict=True)]
    beliefs = [live.step(t, **reading) for t, reading in sorted(events, key=lambda event: event[0])]
    angles = {belief.t: belief.x for belief in beliefs}
    live_angles = np.array([angles[t] for t in batch.joints.t])
    np.testing.assert_allclose(live_angles, batch.joints.values, atol=1e-7)


@pytest.mark.usefixtures("singer")
def test_errors_that_last_widen_bars_as_they_are_explained_under_white_jerk_alone():
    body = mechanisms.learned(1000, mechanisms.SOUND)
    features = mechanisms.replayed(4, mechanisms.LASTING, mechanisms.Fault(), 10.0)
    found = estimate_from_features(features, body, EstimationSettings(motion="singer"), "off")
    assert found.settings["motion"] == "singer" and HARDWARE_ERRORS not in found.settings
    (warning,) = (one.text for one in found.findings if "errors last" in one.text)
    assert "motion is set to singer" in warning


def test_motion_without_noise_or_outside_the_table_or_of_another_order_is_refused(monkeypatch):
    drawn = draw(0, duration=2.0)
    monkeypatch.setitem(MOTION_MODELS, "long", Singer(1.0, order=4))
    with pytest.raises(UsageError, match="motion 'long' has 4 states a joint, possible: 2 or 3"):
        estimate_from_features(drawn.features, drawn.body, replace(TYPED, motion="long"))
    with pytest.raises(UsageError, match="motion is 'constant'; possible: auto, white-acceleration, white-jerk"):
        estimate_from_features(drawn.features, drawn.body, replace(TYPED, motion="constant"))
    with pytest.raises(UsageError, match="needs process noise in rad²/s⁵"):
        estimate_from_features(drawn.features, drawn.body, replace(TYPED, motion="white-jerk", process=None))
