import cv2
import numpy as np
import pytest

from bodylog.errors import UsageError
from bodylog.sim import record_scenario
from tests.seeds import first_of, seeds

from . import reading

pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'bodylog[sim]'")


def centroid(picture, channel):
    """Centroid (u, v) of the largest blob that is more `channel` than anything else, weighted by how much more."""
    others = np.delete(picture, channel, axis=2).max(axis=2)
    weight = np.maximum(picture[..., channel].astype(float) - others - 25, 0)
    _, labels, stats, _ = cv2.connectedComponentsWithStats((weight > 0).astype(np.uint8))
    weight *= labels == 1 + stats[1:, cv2.CC_STAT_AREA].argmax()
    rows, columns = np.indices(weight.shape)
    return np.array([(weight * columns).sum(), (weight * rows).sum()]) / weight.sum()


@pytest.mark.parametrize("image", ["jpeg", "raw"])
@pytest.mark.parametrize(
    "scenario, topic, channel", first_of(1, [("touch", "hand", 2), ("babble", "effector", 1), ("reach", "marker", 0)])
)
@pytest.mark.parametrize("seed", seeds(1, 3))
def test_truth_is_where_a_tracker_finds_the_blob(tmp_path, image, scenario, topic, channel, seed):
    options = {"size": (320, 240), "image": image, "marker": topic == "marker"}
    record_scenario(scenario, tmp_path / "a.mcap", seed=seed, duration=4.0, **options)
    topics = reading.read(tmp_path / "a.mcap")
    truth = reading.pixels(topics, f"/truth/{topic}_pixel")
    errors = [centroid(picture, channel) - truth[t] for t, picture in reading.pictures(topics) if t in truth]
    size = np.linalg.norm(errors, axis=1)
    assert len(size) > 30
    assert np.median(size) < 0.1 and np.quantile(size, 0.99) < 0.3
    assert np.abs(np.mean(errors, axis=0)).max() < 0.02


@pytest.mark.parametrize("arm", ["ur5", "seven"])
def test_side_camera_shows_the_same_arm_at_other_instants(tmp_path, arm):
    record_scenario("reach", tmp_path / "a.mcap", seed=3, duration=6.0, size=(160, 120), arm=arm, cameras=2)
    topics = reading.read(tmp_path / "a.mcap")
    truth = reading.pixels(topics, "/truth/side/effector_pixel")
    shown = dict(reading.pictures(topics, "/side"))
    errors = [centroid(picture, 1) - truth[t] for t, picture in shown.items() if t in truth]
    assert len(shown) == 120 and len(errors) == 120  # the card hides it from the head's camera alone
    assert len(reading.pixels(topics, "/truth/effector_pixel")) < 100
    assert np.median(np.linalg.norm(errors, axis=1)) < 0.2
    assert not set(shown) & {t for t, _ in reading.pictures(topics)}


def test_turning_head_adds_a_joint_and_turns_its_camera(tmp_path):
    record_scenario("touch", tmp_path / "a.mcap", seed=3, duration=6.0, size=(320, 240), turning=True)
    topics = reading.read(tmp_path / "a.mcap")
    _, angles, names = reading.positions(topics, "/truth/joint_states")
    turn = angles[:, names.index("head_pan_joint")]
    assert 0.1 < np.ptp(turn) <= 0.2 and names[-1] == "head_pan_joint"
    _, read, read_names = reading.positions(topics, "/joint_states")
    off = read[:, read_names.index("head_pan_joint")] - turn
    assert read_names == sorted(read_names) and off.std() == pytest.approx(0.01, rel=0.15)
    truth = reading.pixels(topics, "/truth/effector_pixel")
    errors = [np.linalg.norm(centroid(p, 1) - truth[t]) for t, p in reading.pictures(topics) if t in truth]
    assert len(errors) > 100 and np.median(errors) < 0.1
    u = np.array(list(truth.values()))[:, 0]  # the arm is still: only the head moves it, by 288 px per rad
    expected = np.interp(list(truth), np.arange(len(turn)) / 100, turn) * 288
    assert np.corrcoef(u, expected)[0, 1] > 0.999 and np.ptp(u) == pytest.approx(np.ptp(expected), rel=0.1)
    stroke = next(row for row in topics["/truth/stroke"])
    hand = reading.pixels(topics, "/truth/hand_pixel")
    nearest = min(hand, key=lambda t: abs(t - stroke.t))
    assert np.linalg.norm(hand[nearest] - [stroke.message.start.x, stroke.message.start.y]) < 5


def test_second_camera_does_not_change_the_first(tmp_path):
    logs = []
    for cameras in (1, 2):
        record_scenario("touch", tmp_path / "a.mcap", seed=3, duration=2.0, size=(96, 64), cameras=cameras)
        logs.append(reading.read(tmp_path / "a.mcap"))
    for topic in ("/camera/image/compressed", "/truth/effector_pixel", "/joint_states", "/skin"):
        assert [str(row) for row in logs[0][topic]] == [str(row) for row in logs[1][topic]]
    assert not any("side" in topic for topic in logs[0])
    with pytest.raises(UsageError, match="cameras is 3; possible: 1 to 2; type: --cameras"):
        record_scenario("touch", tmp_path / "a.mcap", cameras=3)


def test_hand_is_whole_in_the_picture_exactly_when_the_truth_says_so(tmp_path):
    record_scenario("touch", tmp_path / "a.mcap", duration=6.0, size=(320, 240))
    topics = reading.read(tmp_path / "a.mcap")
    truth = reading.pixels(topics, "/truth/hand_pixel")
    for t, picture in reading.pictures(topics):
        red = (picture[..., 2].astype(int) - np.delete(picture, 2, axis=2).max(axis=2)) > 60
        whole = red.sum() > 150
        cut = red[[0, -1]].any() or red[:, [0, -1]].any()
        assert whole if t in truth else cut or not whole
