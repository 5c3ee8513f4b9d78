"""The tag of a rendered robot in a furnished room, which nobody here drew: found, how well, and said so."""

from itertools import islice
from pathlib import Path
from typing import NamedTuple
from unittest.mock import Mock

import cv2
import numpy as np
import pytest

from bodylog.perception.tags import search, unknown
from bodylog.perception.tags.quads import centres_of_quads
from bodylog.perception.tags.tags import TagTracker
from bodylog.recording import recording
from bodylog.settings import Settings
from bodylog.sources import TagSource
from bodylog.types import Array

WORLDS = Path(__file__).parents[3] / "shared" / "logs" / "worlds"
FOCAL, MIDDLE = 717.28439106, (319.5, 239.5)
SIDE, BEHIND = 0.08, 0.002
"""m: the tag's side; the true points are those of the middle of its plate, so far behind its face."""
SOME = (180, 480)
"""Frames: in some of them the tag leaves the image, or dips into the table."""


class World(NamedTuple):
    images: list[Array]
    values: Array
    searched: int
    uv: Array
    seen: Array


@pytest.fixture(scope="module")
def world() -> World:
    """Some images of a log, what following gives in them, and the truth."""
    if not WORLDS.is_dir():
        pytest.skip("the rendered worlds (../shared/logs/worlds) are not at hand")
    frames = recording.read_recording(WORLDS / "tag_explore", Settings()).cameras.frames
    assert frames is not None
    images = [cv2.cvtColor(frame.image, cv2.COLOR_BGR2GRAY) for frame in islice(frames(), *SOME)]
    tracker = TagTracker({"tag": TagSource(7), "rim": TagSource(7, corners=True)})
    with pytest.MonkeyPatch.context() as patch:
        whole = Mock(wraps=search.search_whole_image)
        patch.setattr(search, "search_whole_image", whole)
        for image in images:
            tracker.add(image)
    with np.load(WORLDS / "tag_explore.truth.npz") as truth:
        uv, seen = truth["uv"][slice(*SOME)], truth["seen"][slice(*SOME)] > 0
    return World(images, tracker.tracked().values, whole.call_count, uv, seen)


def _behind(corners: Array) -> Array:
    """What lies `BEHIND` the face's centre, less that centre: px."""
    camera = np.array([[FOCAL, 0, MIDDLE[0]], [0, FOCAL, MIDDLE[1]], [0, 0, 1]])
    half = SIDE / 2
    square = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]])
    _, turn, place = cv2.solvePnP(square, corners, camera, None, flags=cv2.SOLVEPNP_IPPE)
    points = cv2.projectPoints(np.array([[0.0, 0, 0], [0, 0, BEHIND]]), turn, place, camera, None)[0][:, 0]
    return np.asarray(points[1] - points[0])


def test_tag_is_found_with_its_stated_precision(world) -> None:
    values, found = world.values, np.isfinite(world.values[:, 0, 0])
    assert found[world.seen].mean() > 0.95 and not found[~world.seen].any()
    apart = values[found, 0, :2] - world.uv[found]
    assert np.hypot(*apart.T).max() < 1.2 and np.median(np.hypot(*apart.T)) < 0.6
    rest = apart + np.array([_behind(corners) for corners in values[found, 1:, :2]])
    true = 1.4826 * np.median(np.abs(rest))
    assert true < 0.025 and 0.5 < np.median(values[found, 0, 2:]) / true < 1.5


def test_following_searches_few_images_and_misses_nothing_that_opencv_finds(world) -> None:
    known = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    detector, some = cv2.aruco.ArucoDetector(known, cv2.aruco.DetectorParameters()), range(0, len(world.images), 20)
    theirs = [detector.detectMarkers(world.images[k])[:2] for k in some]
    assert world.searched <= (~world.seen).sum() + 0.1 * len(world.images)  # all of an image only where no tag was
    for k, (corners, numbers) in zip(some, theirs, strict=True):
        if numbers is not None:
            assert np.hypot(*(world.values[k, 0, :2] - centres_of_quads(corners[0].astype(float))[0])) < 2.0


def test_tag_is_named_without_a_configuration(world) -> None:
    (found,) = unknown.find_unknown_tags([cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) for image in world.images[::40]])
    assert found.source == TagSource(7) and found.seen >= 5
