"""Synchronous touch corrects a wrong start, asynchronous touch does not, in both forms; the rubber hand; ten seeds."""

from dataclasses import replace

import numpy as np
import pytest

from bodylog import body, pipeline, sim
from bodylog.estimation import estimate_from_features
from bodylog.evaluation.scores import truth_at_times
from bodylog.settings import BodySettings, EstimationSettings, Settings

SEEDS = range(10)
ELSEWHERE = 1000
UR5 = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")
SHIFT = 0.1
FELT = EstimationSettings(without=("encoders", "vision"))
FORMS = {"likelihood": FELT, "literal": replace(FELT, method="predictive-coding", precision="fixed", touch="literal")}
FAINT = 0.001
"""px: lower bound on drift."""
pytestmark = pytest.mark.soak


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'bodylog[sim]'")
    path = tmp_path_factory.mktemp("touched") / "log.mcap"

    def look(scenario, seed, **options):
        sim.record_scenario(scenario, path, seed=seed, size=(320, 240), **options)
        return pipeline.observe(path, Settings())

    return look


@pytest.fixture(scope="module")
def bodies(seen):
    """A body for each seed, learned from an exploration and from touches of another log."""
    logs = [(seen("babble", seed)[1], seen("touch", seed + ELSEWHERE)[1]) for seed in SEEDS]
    return [body.learn_body(both, Settings(body=BodySettings(joints=UR5)), {}).model for both in logs]


def gained(read, features, learned, settings):
    """Improvement by touch of the effector (px RMS while touched) and the joints (rad RMS)."""
    model = learned.senses["effector"]
    start = truth_at_times(read.signals.truth, list(UR5), np.zeros(1))[0] + SHIFT
    found = estimate_from_features(features, learned, replace(settings, start=tuple(start)))
    t, true = found.joints.t, truth_at_times(read.signals.truth, list(UR5), found.joints.t)
    during = np.any([(t > touch.onset + 0.2) & (t < touch.offset) for touch in features.touches], axis=0)

    def apart(x):
        pixels = model.predict(x[during])[0] - model.predict(true[during])[0]
        return np.array([np.sqrt(np.mean(pixels**2)), np.sqrt(np.mean((x - true) ** 2))])

    return apart(true + SHIFT) - apart(found.joints.values)


@pytest.mark.parametrize("form", FORMS)
def test_touch_corrects_a_wrong_start_only_when_synchronous(seen, bodies, form):
    for seed, learned in zip(SEEDS, bodies, strict=True):
        timely, late = (
            gained(*seen("touch", seed, variant=variant), learned, FORMS[form]) for variant in ("synchronous", "late")
        )
        print(f"{form} {seed}: in time {timely.round(4)}, late {late.round(4)}")
        assert np.all(timely > 0.0)
        assert np.all(np.abs(late) < 0.1 * timely)


def test_rubber_hand_pulls_twenty_times_more_when_synchronous(seen, bodies):
    for seed, learned in zip(SEEDS, bodies, strict=True):
        drift = {}
        for rhythm in ("synchronous", "asynchronous"):
            _, features = seen("rubber-hand", seed, duration=20.0, variant=rhythm, place="right")
            touched, alone = (
                estimate_from_features(features, learned, EstimationSettings(without=without)).joints.values
                for without in (("vision",), ("vision", "touch"))
            )
            pulled = learned.senses["effector"].predict(touched)[0] - learned.senses["effector"].predict(alone)[0]
            drift[rhythm] = float(pulled[np.abs(pulled[:, 0]).argmax(), 0])
        ratio = drift["synchronous"] / max(abs(drift["asynchronous"]), FAINT)
        print(f"rubber hand {seed}: {drift}, {ratio:.0f} times")
        assert ratio >= 20.0
