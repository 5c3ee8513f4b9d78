import cv2
import numpy as np
import pytest

from bodylog.errors import UsageError
from bodylog.sim import record

from . import reading

pytest.importorskip("pybullet", reason="recording needs PyBullet, which has no wheels for this Python")


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
    "scenario, topic, channel", [("babble", "effector", 1), ("touch", "hand", 2), ("reach", "marker", 0)]
)
def test_truth_is_where_a_tracker_finds_the_blob(tmp_path, image, scenario, topic, channel):
    errors, options = [], {"size": (320, 240), "image": image, "marker": topic == "marker"}
    for seed in range(2):
        record(scenario, tmp_path / "a.mcap", seed=seed, duration=4.0, **options)
        topics = reading.read(tmp_path / "a.mcap")
        truth = reading.pixels(topics, f"/truth/{topic}_pixel")
        errors += [centroid(picture, channel) - truth[t] for t, picture in reading.pictures(topics) if t in truth]
    size = np.linalg.norm(errors, axis=1)
    assert len(size) > 40
    assert np.median(size) < 0.1 and np.quantile(size, 0.99) < 0.3
    assert np.abs(np.mean(errors, axis=0)).max() < 0.02


@pytest.mark.parametrize("arm", ["ur5", "seven"])
def test_a_camera_at_the_side_sees_the_same_arm_at_instants_of_its_own(tmp_path, arm):
    record("reach", tmp_path / "a.mcap", seed=3, duration=6.0, size=(160, 120), arm=arm, cameras=2)
    topics = reading.read(tmp_path / "a.mcap")
    truth = reading.pixels(topics, "/truth/side/effector_pixel")
    shown = dict(reading.pictures(topics, "/side"))
    errors = [centroid(picture, 1) - truth[t] for t, picture in shown.items() if t in truth]
    assert len(shown) == 120 and len(errors) == 120  # the card hides it from the head's camera alone
    assert len(reading.pixels(topics, "/truth/effector_pixel")) < 100
    assert np.median(np.linalg.norm(errors, axis=1)) < 0.2
    assert not set(shown) & {t for t, _ in reading.pictures(topics)}


def test_a_second_camera_changes_nothing_of_the_first(tmp_path):
    logs = []
    for cameras in (1, 2):
        record("touch", tmp_path / "a.mcap", seed=3, duration=2.0, size=(96, 64), cameras=cameras)
        logs.append(reading.read(tmp_path / "a.mcap"))
    for topic in ("/camera/image/compressed", "/truth/effector_pixel", "/joint_states", "/skin"):
        assert [str(row) for row in logs[0][topic]] == [str(row) for row in logs[1][topic]]
    assert not any("side" in topic for topic in logs[0])
    with pytest.raises(UsageError, match="cameras is 3; possible: 1 to 2; type: --cameras"):
        record("touch", tmp_path / "a.mcap", cameras=3)


def test_hand_is_whole_in_the_picture_exactly_when_the_truth_says_so(tmp_path):
    record("touch", tmp_path / "a.mcap", duration=6.0, size=(320, 240))
    topics = reading.read(tmp_path / "a.mcap")
    truth = reading.pixels(topics, "/truth/hand_pixel")
    for t, picture in reading.pictures(topics):
        red = (picture[..., 2].astype(int) - np.delete(picture, 2, axis=2).max(axis=2)) > 60
        whole = red.sum() > 150
        cut = red[[0, -1]].any() or red[:, [0, -1]].any()
        assert whole if t in truth else cut or not whole
