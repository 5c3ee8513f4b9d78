"""Films of discs and a tag, of which some move with the joints."""


import cv2
import numpy as np

from bodylog.types import Array, Recording, Series
from tests.changed_recordings import change_recording
from tests.perception import scenes
from tests.perception.scenes import Disc

T = np.arange(120) / 5.0
ANGLES = np.column_stack([np.sin(1.7 * T), np.cos(1.3 * T)])


def _paste(image: Array, number: int, left: int, top: int) -> None:
    """An AprilTag 36h11 with its white rim."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    printed = cv2.aruco.generateImageMarker(dictionary, number, 48)
    rim = cv2.copyMakeBorder(printed, 6, 6, 6, 6, cv2.BORDER_CONSTANT, value=255)
    image[top : top + 60, left : left + 60] = rim[..., None]


def film(tag: int | None = None, arm: bool = True) -> Recording:
    """A green disc that moves with the joints, a red one that moves without them, a yellow one that stays.

    With a `tag` of that number, which moves with the joints as well; then the green one need not (`arm`).
    """
    rng = np.random.default_rng(0)
    wall = scenes.wall(rng, contrast=3.0)
    things = []
    for moment, (a, b) in zip(T, ANGLES, strict=True):
        red = Disc(160.0 + 90.0 * np.sin(0.83 * moment + 2 * np.sin(0.37 * moment)), 40.0, 7.0, scenes.RED)
        own = (a, b) if arm else (np.sin(0.7 * moment + 2), np.cos(0.9 * moment + np.sin(0.31 * moment)))
        green = Disc(160.0 + 60.0 * own[0], 150.0 + 40.0 * own[1], 6.0)
        things.append([green, red, Disc(30.0, 210.0, 9.0, scenes.YELLOW)])
    drawn = [scenes.draw(wall, discs, rng) for discs in things]
    if tag is not None:
        for image, (a, b) in zip(drawn, ANGLES, strict=True):
            _paste(image, tag, round(220 + 30 * b), round(60 + 20 * a))
    pictures = [scenes.jpeg(image) for image in drawn]
    joints = Series(T, ANGLES, ("a", "b"), "rad", (T * 1e9).astype(np.int64))
    return change_recording(scenes.recording(scenes.frames(T, pictures)), joints=joints)
