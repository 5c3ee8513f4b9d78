"""Tags: every dictionary, corners against the drawn truth, stated deviations, tracking, and false detections."""

import cv2
import numpy as np
import pytest

from bodylog.perception import tracking
from bodylog.perception.tags import search, unknown
from bodylog.perception.tags.codes import load_codes
from bodylog.perception.tags.tags import TagTracker
from bodylog.perception.tracking.frame_search import FrameSearcher
from bodylog.sources import DICTIONARIES, TagSource
from bodylog.types import Array, ConsumedFrames, LazyImage
from tests.perception import tag_scenes
from tests.perception.tag_scenes import Look

PLAIN = Look()
APRIL = "APRILTAG_36h11"
NOISY = (Look(noise=2.0), Look(noise=6.0), Look(noise=2.0, blur=1.2), Look(noise=1.0, quality=0, slope=0.0))


def opencv(name: str) -> str:
    return f"ARUCO_{name.upper()}" if name.startswith("mip") else name.upper()


@pytest.mark.parametrize("dictionary", DICTIONARIES)
def test_tags_of_every_dictionary_are_read_with_their_corners_in_order(dictionary: str) -> None:
    rng = np.random.default_rng(len(dictionary))
    for number in (0, DICTIONARIES[dictionary] - 1):
        image, corners, centre = tag_scenes.scene(rng, opencv(dictionary), number, 56.0, PLAIN)
        found = search.search_whole_image(image, load_codes(dictionary), np.array([number]))
        assert found.number.tolist() == [number]
        assert np.abs(found.quads[0] - corners).max() < 0.15
        assert np.abs(found.centres[0] - centre).max() < 0.1


@pytest.mark.parametrize("name", ["apriltag_16h5", "apriltag_25h9", "apriltag_36h10", "apriltag_36h11", "mip_36h12"])
def test_codes_limit_corrected_bits_by_their_distance(name: str) -> None:
    patterns, side = load_codes(name).patterns, load_codes(name).side
    one, all_ = patterns[0, 0], patterns.reshape(-1, side * side)
    least = np.sort((all_ != one).sum(axis=1))[1]  # the first is the pattern itself
    assert load_codes(name).correctable == int(0.6 * ((int(name.rpartition("h")[2]) - 1) // 2)) < least / 2


@pytest.mark.parametrize("side", [24.0, 40.0, 70.0])
def test_stated_deviations_are_those_from_the_truth(side: float) -> None:
    apart, stated = [], []
    for seed in range(32):
        rng = np.random.default_rng(seed)
        image, _, centre = tag_scenes.scene(rng, APRIL, 7, side, NOISY[seed % 4])
        found = search.search_whole_image(image, load_codes("apriltag_36h11"), np.array([7]))
        if found.number.size:
            apart.append(found.centres[0] - centre)
            stated.append(np.sqrt(np.diag(found.centre_cov[0])))
    true, text = np.sqrt(np.mean(np.square(apart))), np.sqrt(np.mean(np.square(stated)))
    assert len(apart) >= 28 and true < 0.15 and 0.5 < text / true < 2.0
    near = np.abs(apart) < 2 * np.array(stated)
    assert near.mean() > 0.85


def _film(count: int, look: Look, size: tuple[int, int] = (320, 240)) -> tuple[list[Array], Array]:
    """Images of a tag that turns on its way round, and where its centre is (N,2) px."""
    wall = tag_scenes.wall(np.random.default_rng(5), *size).astype(float)
    rng, print_, images, places = np.random.default_rng(6), tag_scenes.tag(APRIL, 7), [], []
    for k in range(count):
        u, v = size[0] / 2 + 60 * np.cos(k / 8), size[1] / 2 + 40 * np.sin(k / 8)
        at = tag_scenes.pose(np.random.default_rng(9), (u, v), 34.0)
        images.append(tag_scenes.take(tag_scenes.paste(wall, print_, (10 / 8, 10 / 8), at), look, rng))
        places.append(tag_scenes.project(at, np.zeros((1, 2)))[0])
    return images, np.array(places)


def test_tag_is_followed_and_missing_frames_are_counted() -> None:
    images, places = _film(20, PLAIN)
    wall = tag_scenes.wall(np.random.default_rng(5), 320, 240).astype(float)
    empty = tag_scenes.take(wall, PLAIN, np.random.default_rng(1))
    given: list[Array | None] = [*images[:8], empty, None, *images[10:]]
    (tracker,) = tracking.make_trackers({"wrist": TagSource(7), "rim": TagSource(7, corners=True), "none": TagSource(8)})
    for image in given:
        tracker.add(image)
    found = tracker.tracked()
    assert found.names == ("wrist", "rim.0", "rim.1", "rim.2", "rim.3", "none")
    t = np.arange(20) / 10.0
    tracks, health, _ = tracking.series_of_tracked([found], t, np.arange(20), np.arange(20))
    seen = np.isfinite(tracks["wrist"].values[:, 0])
    assert np.flatnonzero(~seen).tolist() == [8, 9]
    assert np.abs(tracks["wrist"].values[seen] - places[seen]).max() < 0.15
    assert health["wrist"].rejected == {"hidden": 1, "undecodable picture": 1}
    assert health["none"].used == 0 and health["none"].rejected == {"hidden": 19, "undecodable picture": 1}
    assert health["rim.3"].used == 18 and health["wrist"].largest_gap_s == pytest.approx(0.3)


def test_blurred_tag_is_followed_where_opencv_misses_it() -> None:
    images, places = _film(12, PLAIN)
    detector = cv2.aruco.ArucoDetector(tag_scenes.dictionary(APRIL), cv2.aruco.DetectorParameters())
    tracker = TagTracker({"it": TagSource(7)})
    missed = 0
    for k, image in enumerate(images):
        image = cv2.GaussianBlur(image, (0, 0), 2.0) if k in (5, 6, 7) else image
        missed += detector.detectMarkers(image)[1] is None
        tracker.add(image)
    values = tracker.tracked().values[:, 0]
    assert missed and np.isfinite(values).all()
    assert np.abs(values[:, :2] - places).max() < 0.5


def test_unknown_tags_are_named_without_false_detections() -> None:
    rng = np.random.default_rng(3)
    walls = [tag_scenes.take(tag_scenes.wall(rng, 640, 480).astype(float), PLAIN, rng) for _ in range(4)]
    assert unknown.find_unknown_tags([cv2.cvtColor(wall, cv2.COLOR_GRAY2BGR) for wall in walls]) == []
    images, places = [], []
    for _ in range(4):
        image, _, centre = tag_scenes.scene(rng, "6X6_250", 23, 40.0, PLAIN)
        images.append(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
        places.append(centre)
    (found,) = unknown.find_unknown_tags([*images, cv2.cvtColor(walls[0], cv2.COLOR_GRAY2BGR)])
    assert found.source == TagSource(23, "6x6_250") and found.seen == 4
    assert np.abs(found.uv[:4] - places).max() < 0.2 and np.isnan(found.uv[4]).all()


@pytest.mark.parametrize("shape", [(0, 0), (1, 1), (3, 500), (16, 16)])
def test_images_too_small_for_a_tag_show_none(shape: tuple[int, int]) -> None:
    tracker = TagTracker({"it": TagSource(7)})
    tracker.add(np.zeros(shape, np.uint8))
    assert np.isnan(tracker.tracked().values).all()


def test_tag_search_does_not_depend_on_thread_count() -> None:
    images, _ = _film(41, PLAIN, (160, 120))

    def looked(threads: int) -> bytes:
        with FrameSearcher([], None, False, threads, tracking.make_trackers({"it": TagSource(7)})) as looks:
            for image in images:
                looks(LazyImage(0.0, 0, lambda k, image=image: cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)))
        seen = looks.seen(ConsumedFrames(np.arange(41.0), np.arange(41), np.arange(41)[::-1], looks))
        return tracking.series_of_tracked(seen.tracked, seen.t, seen.source_ns, seen.number)[0]["it"].values.tobytes()

    alone = looked(1)
    assert looked(2) == alone and looked(3) == alone
