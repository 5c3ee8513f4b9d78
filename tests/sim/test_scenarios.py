from pathlib import Path

import numpy as np
import pytest

import bodylog.sim.scenarios
from bodylog.sim import SCENARIOS, record_scenario
from bodylog.sim.arms import ARMS
from tests.seeds import seeds

from . import reading

pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'bodylog[sim]'")

SMALL = {"size": (160, 120)}
EVERY = [(name, variant) for name, entry in SCENARIOS.items() for variant in entry.variants]


def played(tmp_path, scenario, **options):
    record_scenario(scenario, tmp_path / "log.mcap", **{**SMALL, **options})
    return reading.read(tmp_path / "log.mcap")


def encoders(topics):
    """t, what was read minus the truth (N,M), the truth (N,M), in the arm's order."""
    t, read, names = reading.positions(topics, "/joint_states")
    _, truth, true_names = reading.positions(topics, "/truth/joint_states")
    return t, read[:, [names.index(name) for name in true_names]] - truth, truth


def test_scenario_table_lists_all_files():
    files = {path.stem.replace("_", "-") for path in Path(bodylog.sim.scenarios.__file__).parent.glob("[a-z]*.py")}
    assert files == set(SCENARIOS)


@pytest.mark.parametrize("scenario, variant", EVERY)
@pytest.mark.parametrize("arm", ARMS)
def test_scenarios_and_variants_run_on_all_arms(tmp_path, scenario, variant, arm):
    topics = played(tmp_path, scenario, variant=variant or None, arm=arm, duration=0.3)
    assert len(topics["/joint_states"]) == 30 and len(topics["/camera/image/compressed"]) == 6
    assert topics["/joint_states"][0].message.position.shape == (len(ARMS[arm].joints),)


@pytest.mark.parametrize("seed", seeds(1, 3))
def test_babble_moves_three_joints_mostly_sideways(tmp_path, seed):
    topics = played(tmp_path, "babble", seed=seed, duration=12.0)
    _, errors, truth = encoders(topics)
    spans = np.ptp(truth, axis=0)
    assert spans[0] == spans.max() > 0.7 and np.all(spans[1:3] > 0.4) and np.all(spans[3:] == 0)
    np.testing.assert_allclose(errors.std(0), 0.003, rtol=0.1)
    assert len(topics["/truth/effector_pixel"]) >= 0.99 * len(topics["/camera/image/compressed"])
    seen = np.array(list(reading.pixels(topics, "/truth/effector_pixel").values()))
    assert np.ptp(seen[:, 0]) > 60


def test_full_moves_all_joints_and_four_moves_four(tmp_path):
    assert np.all(np.ptp(encoders(played(tmp_path, "babble", full=True, duration=3.0))[2], axis=0) > 0.1)
    four = np.ptp(encoders(played(tmp_path, "babble", variant="four", duration=3.0))[2], axis=0)
    assert np.all(four[:4] > 0.1) and np.all(four[4:] == 0)


@pytest.mark.parametrize("arm", ARMS)
def test_horizontal_leaves_the_elbow_alone(tmp_path, arm):
    spans = np.ptp(encoders(played(tmp_path, "horizontal", arm=arm, duration=4.0))[2], axis=0)
    assert spans[ARMS[arm].elbow] == 0 and spans[0] > 0.1


@pytest.mark.parametrize("seed", seeds(1, 3))
def test_reach_hides_the_effector_for_two_seconds(tmp_path, seed):
    topics = played(tmp_path, "reach", seed=seed, duration=8.0)
    assert encoders(topics)[1].std() == pytest.approx(0.02, rel=0.1)
    frames, seen = reading.pictures(topics), reading.pixels(topics, "/truth/effector_pixel")
    for t, picture in frames:
        green = (picture[..., 1].astype(int) - picture.max(axis=2, where=np.array([1, 0, 1], bool), initial=0)) > 40
        if 3.0 <= t <= 5.0:
            assert t not in seen and not green.any()
        elif t < 2.7 or t > 5.3:
            assert t in seen and green.any()


def test_square_encoders_read_the_square(tmp_path):
    topics = played(tmp_path, "square-encoders", duration=3.0)
    _, errors, truth = encoders(topics)
    read = errors + truth
    np.testing.assert_allclose(read.mean(0)[:3], truth[0, :3] ** 2, atol=0.01)
    np.testing.assert_allclose(read.mean(0)[3:], truth[0, 3:], atol=0.01)


def test_drift_is_on_the_first_joint_alone(tmp_path):
    t, errors, _ = encoders(played(tmp_path, "drift", duration=25.0))
    np.testing.assert_allclose(errors[:, 0], 0.3 * np.clip((t - 8) / 16, 0, 1), atol=0.06)
    assert np.abs(errors[:, 1:].mean(0)).max() < 0.002


@pytest.mark.parametrize("variant, joint", [("elbow", 2), ("first", 0)])
def test_frozen_encoder_repeats_one_value(tmp_path, variant, joint):
    topics = played(tmp_path, "frozen", variant=variant, duration=10.0)
    t, errors, truth = encoders(topics)
    read = errors + truth
    assert np.ptp(read[t >= 8.0, joint]) < 1e-12 and np.ptp(truth[t >= 8.0, joint]) > 0.01
    assert np.abs(errors[t < 8.0, joint]).max() < 0.06
    assert read[t >= 8.0, joint][0] == pytest.approx(read[t < 8.0, joint][-1], abs=0.06)


@pytest.mark.parametrize("variant, later", [("settling", 0.0), ("constant", 0.1)])
def test_biased_start(tmp_path, variant, later):
    t, errors, _ = encoders(played(tmp_path, "biased-start", variant=variant, duration=2.0))
    first, last = np.abs(errors[t < 0.5].mean(0)), np.abs(errors[t >= 0.5].mean(0))
    assert np.all(first[:3] > 0.08) and np.all(first[3:] < 0.02)
    assert np.all(last[:3] > 0.08 if later else last < 0.02)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("variant, wrong", [("one", 1), ("all", 4), ("elsewhere", 4)])
def test_wrong_start(tmp_path, variant, wrong, seed):
    _, errors, truth = encoders(played(tmp_path, "wrong-start", variant=variant, seed=seed, duration=0.5))
    degrees = np.rad2deg(np.abs(errors.mean(0)))
    assert np.all(np.ptp(truth, axis=0) == 0) and np.all(degrees[4:] < 0.5)
    assert np.sum(degrees > 0.5) == wrong
    if variant != "elsewhere":
        assert np.all((degrees < 0.5) | ((degrees > 4.8) & (degrees < 10.2)))


@pytest.mark.parametrize(
    "variant, low, high",
    [("synchronous", 0.0, 0.0), ("late", 0.6, 0.6), ("jitter", 0.0, 0.1), ("wide-jitter", 0.0, 1.0)],
)
@pytest.mark.parametrize("seed", seeds(1, 2))
def test_touch_delays_and_times(tmp_path, variant, low, high, seed):
    topics = played(tmp_path, "touch", variant=variant, seed=seed, duration=18.0)
    touches, strokes = topics["/truth/touch"], topics["/truth/stroke"]
    assert len(touches) == len(strokes) >= 3
    t = np.array([row.t for row in topics["/skin"]])
    strongest = np.array([row.message.data for row in topics["/skin"]]).max(1)
    active = np.zeros(len(t), bool)
    for touch, stroke in zip(touches, strokes, strict=True):
        length = touch.message.duration.sec + touch.message.duration.nanosec / 1e9
        assert low - 0.005 <= stroke.message.delay <= high + 0.005
        assert stroke.t - touch.t == pytest.approx(stroke.message.delay, abs=1e-6)
        during = (t > touch.t + 0.02) & (t < touch.t + length - 0.02)
        assert np.all(strongest[during] > 0.7)
        active |= (t > touch.t - 0.02) & (t < touch.t + length + 0.02)
        assert 10 / 320 < abs(stroke.message.end.y - stroke.message.start.y) / 160 < 22 / 320
    assert np.all(strongest[~active] < 0.7)
    assert len(topics["/truth/effector_pixel"]) == len(topics["/camera/image/compressed"])


def test_rubber_hand_strokes_another_place(tmp_path):
    sides = {}
    for place in SCENARIOS["rubber-hand"].places:
        topics = played(tmp_path, "rubber-hand", place=place, duration=9.0)
        assert "/truth/effector_pixel" not in topics
        assert topics["/truth/touch"][0].t > 5.5 and min(row.t for row in topics["/truth/hand_pixel"]) > 4.9
        sides[place] = topics["/truth/stroke"][0].message.start.x / 160
    assert sides["right"] - sides["centre"] == pytest.approx(0.12, abs=0.01)
    assert sides["centre"] - sides["left"] == pytest.approx(0.12, abs=0.01)


@pytest.mark.parametrize("seed", seeds(1, 3))
def test_asynchronous_rubber_hand_is_late(tmp_path, seed):
    topics = played(tmp_path, "rubber-hand", variant="asynchronous", seed=seed, duration=20.0)
    delays = [row.message.delay for row in topics["/truth/stroke"]]
    assert len(delays) >= 3 and min(delays) > 0.39 and max(delays) < 1.01
