"""Bodies learned from images with late timestamps: as good as with correct ones, with the delay known."""

from functools import cache

import numpy as np
import pytest

from bodylog import body
from bodylog.delays import camera_delay
from bodylog.errors import UsageError
from bodylog.estimation import estimate_from_features
from bodylog.settings import EstimationSettings, Settings, TimeSettings
from tests.body.conftest import run
from tests.estimation.spoilt_logs import delayed


@cache
def explored(seed):
    """The features of a sound exploration, and the body learned from them."""
    features = run(seed, 0.003).features
    return features, learned(features)


def learned(*features, delay="auto", known=None):
    return camera_delay.learn_with_delays(features, Settings(time=TimeSettings(delay=delay)), {"version": "0"}, known)


def findings_of(found, severity="warning"):
    return [f.text for f in found.findings if f.severity == severity and "image timestamps" in f.text]


def off(model, seed=9):
    """Root mean square error (px) of a body on another motion."""
    other = run(seed, 0.0)
    truth = other.features.joints.values[5:-5:10][:, [run(0, 0.0).features.joints.names.index(n) for n in model.joints]]
    return float(np.sqrt(np.mean(np.square(model.senses["effector"].predict(truth)[0] - other.pixels[: len(truth)]))))


@pytest.mark.soak
def test_learn_does_not_change_a_sound_exploration():
    features, found = explored(0)
    plain = body.learn_body([features], Settings(), {"version": "0"})
    plain = body.with_kinematics([features], Settings(), plain, None)
    assert not findings_of(found) and found.model.provenance == plain.model.provenance and found.scores == plain.scores
    ours, theirs = found.model.senses["effector"], plain.model.senses["effector"]
    assert all(np.array_equal(getattr(ours, part), getattr(theirs, part)) for part in ("weights", "centres", "spread"))


@pytest.mark.parametrize("seed", [5, 11])
def test_learn_does_not_change_a_short_sound_exploration(seed):
    features = run(seed, 0.003, 15.0).features
    found = learned(features)
    assert not findings_of(found) and "delay" not in found.model.provenance


@pytest.mark.soak
def test_delays_measured_without_a_body_are_as_sure_as_they_state():
    off = []
    for seed, seconds in enumerate((0.0, 0.0, 0.06, -0.1, 0.0, 0.15, 0.0, 0.08, 0.0, -0.06, 0.0, 0.1)):
        found, unclear = camera_delay.measure_log_delays(delayed(run(seed, 0.003).features, seconds), Settings())
        assert not unclear
        off += [(delay.seconds - seconds) / delay.std_error for delay in found.values()]
    assert len(off) > 10 and 0.6 < np.sqrt(np.mean(np.square(off))) < 1.4 and np.abs(off).max() < 3.0, off


LATE = ((0, -0.1), *(pytest.param(*case, marks=pytest.mark.soak) for case in ((1, 0.05), (2, 0.02))))


@pytest.mark.parametrize("seed, seconds", LATE)
def test_learn_corrects_a_late_exploration(seed, seconds):
    features, sound = explored(seed)
    late = learned(delayed(features, seconds))
    (text,) = findings_of(late)
    assert text.startswith("camera: ") and (" timestamps lag the encoders" in text) == (seconds > 0)
    assert late.model.provenance["delay"]["camera"] == pytest.approx(seconds, abs=2e-3)
    assert off(late.model) < 1.1 * off(sound.model)
    again = estimate_from_features(delayed(run(5, 0.003).features, seconds), late.model, EstimationSettings())
    assert not [f for f in again.findings if f.severity == "warning" and "timestamps" in f.text]
    assert again.settings["delay"] == late.model.provenance["delay"]


@pytest.mark.soak
@pytest.mark.parametrize("seed, seconds", [(0, -0.1), (1, 0.05), (2, 0.02)])
def test_learn_leaves_a_late_exploration_where_asked_to(seed, seconds):
    features, sound = explored(seed)
    left = learned(delayed(features, seconds), delay="off")
    (text,) = findings_of(left)
    assert "not corrected" in text and "delay" not in left.model.provenance
    assert 1.1 * off(sound.model) < 0.8 * off(left.model)


@pytest.mark.soak
def test_learn_gives_each_log_its_delay():
    first, other, short = (run(seed, 0.003, duration).features for seed, duration in ((0, 40.0), (1, 40.0), (2, 2.0)))
    found = learned(delayed(first, 0.05), delayed(other, -0.04), delayed(short, 0.05))
    texts = findings_of(found)
    assert texts[0].startswith("log 1: camera: ") and texts[1].startswith("log 2: camera: ")
    assert abs(found.model.provenance["delay"]["camera"]) == pytest.approx(0.045, abs=0.007)


@pytest.mark.soak
def test_learn_corrects_and_stores_a_configured_delay():
    features, plain = explored(0)
    found = learned(delayed(features, 0.05), delay={"camera": 0.05})
    assert not findings_of(found) and found.model.provenance["delay"] == {"camera": 0.05}
    assert off(found.model) == pytest.approx(off(plain.model), rel=1e-6)
    more = learned(delayed(run(4, 0.003).features, 0.05), known=found.model)
    assert not findings_of(more) and more.model.provenance["delay"] == {"camera": 0.05}
    with pytest.raises(UsageError, match=r"'left' found, possible: joints, camera"):
        learned(features, delay={"left": 0.05})
