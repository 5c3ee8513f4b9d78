"""ChArUco boards: corners against the drawn truth, both patterns, following, and a board of another shape."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from bodylog.perception import tracking
from bodylog.perception.tags import unknown
from bodylog.perception.tags.board_shape import recognise_board
from bodylog.perception.tags.charuco import CharucoTracker, lay_out_board
from bodylog.perception.tags.search import Tags
from bodylog.sources import CharucoSource
from bodylog.types import Array
from tests.perception import tag_scenes
from tests.perception.tag_scenes import Look

SHIFTED = 0.0 if tuple(map(int, cv2.__version__.split(".")[:2])) >= (4, 14) else 0.5
"""px: OpenCV before 4.14 gives corners that much too far right and down (its issue 25539)."""
PANDA = Path(__file__).parents[3] / "shared" / "real" / "panda" / "real_new"
SIX, FIVE = (CharucoSource(shape, 0.07, 0.04, "4x4_1000") for shape in ("6x5", "5x6"))


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("shape", ["6x5", "5x6", "10x14"])
def test_markers_and_corners_lie_where_opencv_puts_them(shape: str, legacy: bool) -> None:
    source = CharucoSource(shape, 0.07, 0.04, "4x4_1000")
    board = cv2.aruco.CharucoBoard(source.shape, 0.07, 0.04, tag_scenes.dictionary("4X4_1000"))
    board.setLegacyPattern(legacy)
    ours = lay_out_board(source, legacy)
    np.testing.assert_allclose(ours.markers, np.array(board.getObjPoints())[:, :, :2] / 0.07, atol=1e-5)
    np.testing.assert_allclose(ours.corners, np.array(board.getChessboardCorners())[:, :2] / 0.07, atol=1e-5)
    assert (ours.white.sum(axis=1) == 2).all()


def _values(source: CharucoSource, images: list[Array | None]) -> tuple[Array, tracking.Tracked]:
    (tracker,) = tracking.make_trackers({"board": source})
    for image in images:
        tracker.add(image)
    found = tracker.tracked()
    count = (source.shape[0] - 1) * (source.shape[1] - 1)
    values = np.full((len(images), count, 4), np.nan)
    values[:, [int(name.partition(".")[2]) for name in found.names]] = found.values
    return values, found


@pytest.mark.parametrize("legacy", [False, True])
def test_corners_of_either_pattern_are_as_exact_as_stated(legacy: bool) -> None:
    apart, stated = [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        image, corners = tag_scenes.board_scene(rng, (5, 6), 36.0, Look(noise=2.0 + seed), legacy)
        values, found = _values(FIVE, [image])
        assert np.isfinite(values).all() and f"legacy = {str(legacy).lower()}" in found.findings[0].text
        apart.append(values[0, :, :2] - corners)
        stated.append(values[0, :, 2:])
    true, reported = (np.sqrt(np.mean(np.square(one))) for one in (apart, stated))
    assert true < 0.06 and 0.6 < reported / true < 1.6


def test_charuco_follows_a_moving_board_without_hidden_corners() -> None:
    wall, rng = tag_scenes.wall(np.random.default_rng(1), 480, 360).astype(float), np.random.default_rng(2)
    board = cv2.aruco.CharucoBoard((6, 5), 0.07, 0.04, tag_scenes.dictionary("4X4_1000"))
    sheet = np.pad(board.generateImage((336, 280)), 28, constant_values=255)
    plane = np.asarray(board.getChessboardCorners())[:, :2] / 0.07 - (3.0, 2.5)
    images, places = [], []
    for k in range(6):
        at = tag_scenes.pose(np.random.default_rng(3), (220.0 + 7 * k, 170.0 + 2 * k * k), 34.0, 0.4)
        image = tag_scenes.paste(wall, sheet, (7, 6), at)
        places.append(tag_scenes.project(at, plane))
        if k == 4:
            u, v = np.rint(places[-1][0]).astype(int)
            image[v - 14 : v + 14, u - 14 : u + 14] = 90
        images.append(tag_scenes.take(image, Look(), rng))
    values, found = _values(SIX, [*images, None])
    seen = np.isfinite(values[..., 0])
    assert seen[:4].all() and not seen[4, 0] and seen[4].sum() >= 15 and seen[5].all() and not seen[6].any()
    assert np.nanmax(np.abs(values[:6, :, :2] - places)) < 0.3
    assert found.reasons.tolist() == ["", "", "", "", "", "", "undecodable picture"]


def test_charuco_names_a_board_of_another_shape() -> None:
    image, _ = tag_scenes.board_scene(np.random.default_rng(0), (6, 5), 36.0, Look())
    values, found = _values(CharucoSource("5x6", 0.07, 0.04, "4x4_1000", legacy=False), [image])
    assert not np.isfinite(values).any() and 'type: charuco = "6x5"' in found.findings[0].text
    empty, nothing = _values(SIX, [np.full((90, 90), 128, np.uint8), np.zeros((0, 0), np.uint8)])
    assert not np.isfinite(empty).any() and nothing.findings == () and nothing.names == ("board.0",)


def test_charuco_finds_every_corner_opencv_finds() -> None:
    if not PANDA.is_dir():
        pytest.skip("the real Panda's images (../shared/real/panda) are not at hand")
    source = CharucoSource("10x14", 0.07, 0.04, "4x4_1000")
    images = [cv2.imread(str(path), 0) for path in sorted(PANDA.glob("*.jpg"))[::14]]
    board = cv2.aruco.CharucoBoard((10, 14), 0.07, 0.04, tag_scenes.dictionary("4X4_1000"))
    board.setLegacyPattern(True)
    tracker = CharucoTracker("board", source)
    theirs = np.full((len(images), 117, 2), np.nan)
    for row, image in enumerate(images):
        tracker.add(image)
        corners, numbers, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(image)
        theirs[row, numbers.ravel()] = corners.reshape(-1, 2)
    found = tracker.tracked()
    ours = np.full((len(images), 117, 2), np.nan)
    ours[:, [int(name.partition(".")[2]) for name in found.names]] = found.values[..., :2]
    both = np.isfinite(theirs[..., 0])
    assert np.isfinite(ours[both]).all() and np.isfinite(ours[..., 0]).sum() > both.sum() > 200
    assert np.median(np.linalg.norm(ours - (theirs - SHIFTED), axis=2)[both]) < 0.1


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("shape", [(5, 6), (6, 5), (4, 9)])
def test_board_is_recognised_by_the_numbers_of_its_markers(shape: tuple[int, int], legacy: bool) -> None:
    seen = []
    for seed in range(3):
        image, _ = tag_scenes.board_scene(np.random.default_rng(seed), shape, 36.0, Look(noise=2.0), legacy)
        seen.append(unknown.tags_by_dictionary(image, ["4x4_100"])["4x4_100"])
    found = recognise_board(seen)
    assert found is not None and (found.columns, found.rows) == shape
    assert found.marker == pytest.approx(0.04 / 0.07, abs=0.03)


def test_grid_of_tags_that_is_no_chessboard_is_not_taken_for_a_board() -> None:
    middles = np.stack(np.meshgrid(np.arange(4.0), np.arange(3.0)), axis=-1).reshape(-1, 2) * 60.0 + 60.0
    square = 20.0 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    zero = np.zeros((12, 4, 2, 2))
    tags = Tags(np.arange(12), middles[:, None] + square, middles, zero, zero[:, 0], np.ones(12))
    assert recognise_board([tags]) is None


@pytest.mark.parametrize(("typed", "true"), [("6x5", (5, 6)), ("4x7", (5, 6))])
def test_wrong_counts_of_a_board_are_answered_with_the_right_ones(typed: str, true: tuple[int, int]) -> None:
    images = [tag_scenes.board_scene(np.random.default_rng(k), true, 36.0, Look(), False)[0] for k in range(3)]
    _, found = _values(CharucoSource(typed, 0.07, 0.04, "4x4_1000", legacy=False), images)
    (finding,) = found.findings
    assert f'type: charuco = "{true[0]}x{true[1]}"' in finding.text
