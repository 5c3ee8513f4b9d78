"""Corners by the links that they follow: foreign ones are counted, joints at rest stay unnamed, views agree with tracks."""

import json
from dataclasses import replace

import numpy as np

from bodylog.kinematics import urdf
from bodylog.kinematics.joint_motion import curve_through_samples
from bodylog.kinematics.landmark_postures import UNTOLD_STD
from bodylog.kinematics.landmarks import join_landmark_tracks
from bodylog.kinematics.links import Space
from bodylog.surface.tracks import (
    FOREIGN,
    describe_foreign,
    describe_postures,
    link_tracks,
    read_postures,
    views_as_values,
)
from tests.kinematics.landmark_arm import ARM, JOINTS, model, motion, seen, truth


def linked_tracks(still: int | None = None, pieces: int = 40):
    """Pieces on links, then ten that move otherwise; `still`: a still joint."""
    curve = motion(6)
    if still is not None:
        angles = curve.q.copy()
        angles[:, still] = 0.1
        curve = curve_through_samples(curve.t, angles)
    built = model([curve])
    phi = truth(built, 0.03)
    part, body = seen(built, phi, 5, pieces=pieces)
    rng = np.random.default_rng(1)
    rows = 10 * 24
    walk = np.cumsum(rng.normal(0.0, 9.0, (10, 24, 2)), axis=1) + np.array([300.0, 200.0])
    foreign = (np.repeat(np.arange(10), 24), np.tile(part.t[:24], 10), walk.reshape(rows, 2))
    whole = join_landmark_tracks([(part.piece, part.t, part.uv)], 480.0)
    number = np.concatenate([whole.piece, foreign[0] + pieces])
    joined = replace(
        whole, piece=number, log=np.zeros(len(number), int), t=np.concatenate([whole.t, foreign[1]]),
        uv=np.concatenate([whole.uv, foreign[2]]),
    )  # fmt: skip
    return link_tracks(built, phi, joined), body


def test_corners_that_follow_no_link_are_counted_in_words():
    linked, _ = linked_tracks()
    assert (linked.body[40:] == FOREIGN).all()
    assert (linked.body[:40] != FOREIGN).mean() > 0.9
    share = float((linked.body == FOREIGN).mean())
    assert linked.foreign_share == share and 0.2 <= share <= 0.26
    assert f"{share:.0%} of the moving corners are foreign" in describe_foreign("camera", share)


def test_joint_at_rest_is_named():
    linked, _ = linked_tracks(still=3, pieces=200)
    found = read_postures(linked, JOINTS, 5, 0.002)
    assert found is not None and found.names == JOINTS
    assert (found.cov[:, 3, 3] >= UNTOLD_STD**2).all()
    assert np.median(found.cov[:, 0, 0]) < 0.03
    text = describe_postures("camera", found)
    shown, unnamed = text.split("; nothing of ")
    assert "wrist" in unnamed and "pan" in shown and "pan" not in unnamed
    np.testing.assert_array_equal(found.source_ns, 5 + np.rint(1e9 * (found.t + 0.03)).astype(np.int64))


def test_views_are_plain_values_and_the_skeleton_is_the_urdf_s():
    linked, _ = linked_tracks()
    space = Space(urdf.parse_urdf(ARM, "arm.urdf"), JOINTS, {}, np.radians(5.0))
    views = json.loads(json.dumps(views_as_values(linked, space)))
    assert 1 <= len(views["images"]) <= 6 and views["foreign"] == linked.foreign_share
    for view in views["images"]:
        corners = np.array(view["corners"])
        assert np.sqrt(np.square(corners[:, :2] - corners[:, 2:4]).mean()) < 3.0
        assert set(corners[:, 4].astype(int)) <= set(range(1, 5))
        assert np.array(view["bones"]).shape == (4, 4)
        # the end of each bone is the begin of the next: one chain
        bones = np.array(view["bones"])
        np.testing.assert_allclose(bones[1:, :2], bones[:-1, 2:], atol=0.11)
