"""Beside a robot whose encoders read a function of the angle: fed raw readings, the log's belief."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog import Estimator, body
from bodylog.body.senses.encoder_function import Polynomial, convert_readings_to_angles
from bodylog.errors import LogError, UsageError
from bodylog.estimation import estimate_from_features
from bodylog.settings import EstimationSettings, Settings
from tests.body.conftest import run
from tests.estimation.conftest import draw

READINGS = {"square": lambda x: np.square(x + 1.2), "falling": lambda x: 0.3 - 1.5 * x + 0.1 * x**3}


def read(reading, seed, noise, duration, reference):
    """Features whose encoders read `reading` of the angles, with a reference of these or without."""
    joints, rng = run(seed, 0.0, duration).features.joints, np.random.default_rng(seed)
    noisy = reading(joints.values) + rng.normal(0.0, noise, joints.values.shape)
    text = replace(joints, values=noisy)
    return replace(run(seed, 0.0, duration).features, joints=text, reference=joints if reference else None)


@pytest.fixture(scope="module")
def learned():
    """A body by each kind of encoder."""
    logs = {name: read(reading, 0, 0.003, 20.0, True) for name, reading in READINGS.items()}
    return {name: body.learn_body([features], Settings(), {}).model for name, features in logs.items()}


@pytest.mark.parametrize("name", READINGS)
@pytest.mark.parametrize("bias", ["off", "on"])
@pytest.mark.parametrize("seed", [0, 3])
def test_raw_readings_as_they_come_give_the_belief_of_the_log(learned, name, bias, seed):
    model, settings = learned[name], EstimationSettings(precision="model", bias=bias)
    assert isinstance(model.senses["encoders"], Polynomial)
    features = read(READINGS[name], seed, 0.003, 6.0, False)
    joints, track = features.joints, features.tracks["effector"]
    batch = estimate_from_features(*convert_readings_to_angles(features, model, settings))
    rows = [dict(zip(joints.names, row, strict=True)) for row in joints.values]
    messages = [(t, {"joints": row}) for t, row in zip(joints.t, rows, strict=True)]
    places = np.hstack([track.values, track.std])
    messages += [(t, {"effector": place}) for t, place in zip(track.t, places, strict=True)]
    live = Estimator(model, settings)
    beliefs = {t: live.step(t, **readings) for t, readings in sorted(messages, key=lambda message: message[0])}
    ours = [beliefs[t] for t in batch.joints.t]
    np.testing.assert_allclose([b.x for b in ours], batch.joints.values, atol=1e-9, rtol=0)
    std = np.sqrt(np.einsum("nii->ni", batch.cov))
    apart = (np.array([b.cov for b in ours]) - batch.cov) / (std[:, :, None] * std[:, None])
    np.testing.assert_allclose(apart, 0.0, atol=2e-7)
    if bias == "on":
        np.testing.assert_allclose([b.bias for b in ours], batch.bias.values, atol=1e-9, rtol=0)


def test_readings_taken_for_angles_would_be_far_off(learned):
    """What the tests above hold is the map: without it the same readings give another posture."""
    features = read(READINGS["square"], 0, 0.003, 0.5, False)
    first = dict(zip(features.joints.names, features.joints.values[0], strict=True))
    readings = Estimator(learned["square"]).step(0.0, joints=first).x
    plain = replace(learned["square"], senses={"effector": learned["square"].senses["effector"]})
    assert np.abs(readings - Estimator(plain).step(0.0, joints=first).x).max() > 0.3
    true = dict(zip(features.joints.names, run(0, 0.0, 0.5).features.joints.values[0], strict=True))
    assert np.abs(readings - [true[joint] for joint in learned["square"].joints]).max() < 0.02


def test_online_refuses_a_body_with_ambiguous_readings(learned):
    model = learned["square"]
    middle = np.median(model.senses["effector"].samples, axis=0)
    turning = Polynomial(model.joints, np.column_stack([middle**2, -2.0 * middle, np.ones(len(middle))]))
    with pytest.raises(UsageError, match="encoders: readings turn or flatten over the explored angles"):
        Estimator(replace(model, senses={**model.senses, "encoders": turning}))


@pytest.mark.parametrize("seed", range(2))
def test_estimator_uses_late_images_at_their_capture_time(seed):
    """As given, or as the body was learned with: the belief of the log, whose pictures are dated as late."""
    drawn, settings = draw(seed, duration=6.0), EstimationSettings(precision="model", bias="off")
    joints, track = drawn.features.joints, drawn.features.tracks["effector"]
    late = replace(track, t=track.t + 0.05)
    batch = estimate_from_features(replace(drawn.features, tracks={"effector": late}), drawn.body, settings, {"camera": 0.05})
    rows = [dict(zip(joints.names, row, strict=True)) for row in joints.values]
    messages = [(t, {"joints": row}) for t, row in zip(joints.t, rows, strict=True)]
    places = np.hstack([track.values, track.std])
    messages += [(t, {"effector": place}) for t, place in zip(late.t, places, strict=True)]
    messages.sort(key=lambda message: message[0])
    readings = replace(drawn.body, provenance={"delay": {"camera": 0.05}})
    for live in (Estimator(drawn.body, settings, delay={"camera": 0.05}), Estimator(readings, settings)):
        for t, one in messages:
            belief = live.step(t, **one)
        np.testing.assert_allclose(belief.x, batch.joints.values[-1], atol=1e-9, rtol=0)
        np.testing.assert_allclose(belief.cov, batch.cov[-1], atol=1e-11, rtol=0)
        assert live.used["effector"].used == len(track.t)
    with pytest.raises(UsageError, match=r"'left' found, possible: joints, camera"):
        Estimator(drawn.body, settings, delay={"left": 0.05})


def test_estimator_answers_each_step_even_with_a_late_part():
    drawn = draw(0)
    x, place = drawn.truth.values, drawn.features.tracks["effector"].values
    late, timely = Estimator(drawn.body, delay={"camera": 0.05}), Estimator(drawn.body)
    for robot in (late, timely):
        robot.step(0.0, x[0])
    belief = late.step(0.06, x[3], effector=place[0])
    first, last = timely.step(0.06, x[3]), timely.step(0.01, effector=place[0])
    assert belief.t == 0.06 and set(belief.errors) == {"encoders", "effector"}
    assert belief.free_energy == pytest.approx(first.free_energy + last.free_energy, abs=1e-12)
    np.testing.assert_array_equal(belief.x, last.x)


def test_online_uses_a_late_image_with_the_first_joints():
    """All of a call is taken, or none of it: the image was dropped where its own time asked for a step of its own."""
    drawn = draw(2, duration=1.0)
    pan, lift, elbow = ({name: value} for name, value in zip(drawn.body.joints, (-0.9, -0.9, 1.0), strict=True))
    place = drawn.body.senses["effector"].predict(np.array([[-0.9, -0.9, 1.0]]))[0][0]
    live = Estimator(drawn.body, delay={"camera": 0.05})
    with pytest.raises(LogError, match="no reading of lift, elbow"):
        live.step(0.1, joints=pan, effector=place)
    belief = live.step(0.12, joints=lift | elbow)
    assert live.used["effector"].used == 1 and live.used["encoders"].used == 2
    timely = Estimator(drawn.body)
    with pytest.raises(LogError):
        timely.step(0.05, effector=place)
    with pytest.raises(LogError):
        timely.step(0.1, joints=pan)
    np.testing.assert_allclose(belief.x, timely.step(0.12, joints=lift | elbow).x, atol=1e-12, rtol=0)
