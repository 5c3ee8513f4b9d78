"""Things in the scene: the feature that the arm carries or looks at, and clutter."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ..types import Array
from .camera import GREEN, Colour, PinholeCamera, draw_sphere, ellipse_centre
from .options import Options
from .tag import Plate

TAG = 7
FOREIGN_TAG = 3
_LIME: Colour = (150.0, 200.0, 40.0)
_STUDS = 14
"""Studs on a cylinder of a link."""
_STUD_M = (0.004, 0.009)
_STUD_GREY = ((25.0, 60.0), (190.0, 230.0))
"""Dark and light ones, as grey levels: no colour of a feature."""
_STONES = 160
_STONE_M = (0.004, 0.014)
"""Stones before a camera on the wrist, where a bare scene has no other texture."""
_POST = 0.05
_POST_OF_SIDE = 0.35
"""Length of the post that holds a plate clear of the limb: m, and in sides of the tag."""


class SceneThing(Protocol):
    """A thing drawn into the image: its centre, and its visible share."""

    @property
    def place(self) -> Array:
        """The centre (3,) m."""

    def pixel(self, camera: PinholeCamera) -> Array:
        """The centre of the thing's image (2,) px."""

    def draw(self, picture: Array, depth: Array, camera: PinholeCamera) -> float:
        """Draw it; return the visible share of its outline, 0..1."""


@dataclass(frozen=True, eq=False)
class Ball:
    """A lit sphere: centre (3,) m, radius m, colour RGB."""

    place: Array
    radius: float
    colour: Colour

    def moved(self, place: Array, rotation: Array) -> "Ball":
        """The same ball, given in a frame at `place` (3,) m turned by `rotation` (3,3)."""
        return replace(self, place=rotation @ self.place + place)

    def pixel(self, camera: PinholeCamera) -> Array:
        """The centroid (2,) px of its outline."""
        return np.asarray(ellipse_centre(camera, self.place[None], self.radius)[0])

    def draw(self, picture: Array, depth: Array, camera: PinholeCamera) -> float:
        """Draw it into an image (H,W,3) uint8 and depth (H,W)
        m; return the visible share of its outline, 0..1.
        """
        return draw_sphere(picture, depth, camera, self.place, self.radius, np.array(self.colour))


@dataclass(frozen=True, eq=False)
class Box:
    """A piece of furniture: centre (3,) m, rotation
    (3,3), half its lengths (3,) m, colour RGB in 0..1.
    """

    place: Array
    rotation: Array
    half: tuple[float, float, float]
    colour: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Scene:
    """The feature, in the frame of the `link` that carries
    it or in the base frame (None), and the clutter.

    studs: (link, ball in its frame), the texture of a bare arm.
    """

    feature: Ball | Plate | None
    link: str | None
    things: tuple[Ball | Plate, ...]
    boxes: tuple[Box, ...]
    studs: tuple[tuple[str, Ball], ...] = ()


@dataclass(frozen=True, eq=False)
class Cylinder:
    """A cylinder of a link: its centre (3,) m and rotation
    (3,3) in the link's frame, along z; radius and length m.
    """

    link: str
    place: Array
    rotation: Array
    radius: float
    length: float


def on_the_arm(
    options: Options, camera: PinholeCamera, place: Array, rotation: Array, rng: np.random.Generator
) -> Scene:
    """The scene before the head's camera; the effector at
    home is at `place` (3,) m, turned by `rotation` (3,3).
    """
    towards = (camera.position - place) / np.linalg.norm(camera.position - place)
    forward = (
        (_POST + _POST_OF_SIDE * options.side) * towards
        if options.feature == "tag"
        else np.zeros(3)
    )
    seen = _make_feature(options, place + forward, camera.rotation.T)
    carried = None if seen is None else seen.moved(-rotation.T @ place, rotation.T)
    return Scene(carried, "effector", *_make_clutter(options, camera, rng))


def before_the_wrist(
    options: Options, camera: PinholeCamera, distance: float, rng: np.random.Generator
) -> Scene:
    """The scene that the camera on the wrist sees when
    the arm is at home: the feature `distance` m ahead.
    """
    place = camera.position + distance * camera.rotation[2]
    feature = _make_feature(options, place, camera.rotation.T)
    things, boxes = _make_clutter(options, camera, rng)
    stones = _scatter_stones(place, distance, rng) if options.scene == "bare" else ()
    return Scene(feature, None, (*things, *stones), boxes)


def studs(cylinders: Iterable[Cylinder], rng: np.random.Generator) -> tuple[tuple[str, Ball], ...]:
    """Studs at random places on the links' cylinders, half sunk: (link, ball in its frame)."""
    found = []
    for one in cylinders:
        for number in range(_STUDS):
            angle = rng.uniform(0.0, 2.0 * np.pi)
            along = rng.uniform(-0.45, 0.45) * one.length
            local = np.array([one.radius * np.cos(angle), one.radius * np.sin(angle), along])
            grey = rng.uniform(*_STUD_GREY[number % 2])
            ball = Ball(one.rotation @ local + one.place, rng.uniform(*_STUD_M), (grey, grey, grey))
            found.append((one.link, ball))
    return tuple(found)


def _scatter_stones(place: Array, distance: float, rng: np.random.Generator) -> tuple[Ball, ...]:
    """Stones at rest, as far around `place` (3,) m as the camera is from it (m)."""
    found = []
    for number in range(_STONES):
        grey = rng.uniform(*_STUD_GREY[number % 2])
        aside = rng.uniform(-0.8, 0.8, 3) * distance
        found.append(Ball(place + aside, rng.uniform(*_STONE_M), (grey, grey, grey)))
    return tuple(found)


def _make_feature(options: Options, place: Array, rotation: Array) -> Ball | Plate | None:
    """The tracked thing, in the base frame."""
    if options.feature == "none" or options.scene == "bare":
        return None
    if options.feature == "ball":
        return Ball(place, options.side / 2, GREEN)
    return Plate(place, rotation, options.side, TAG)


# Places: (right, down) in focal lengths from the middle of the image,
# ahead in m, each with a random shift. The arm's feature is about 1.1
# m ahead, within 0.3 of the middle; the image ends at 0.55 and 0.41.
_BALLS = (
    (0.40, 0.28, 0.80, 0.055, GREEN),
    (-0.42, 0.30, 1.00, 0.035, GREEN),
    (-0.45, -0.27, 1.40, 0.070, _LIME),
    (0.44, -0.02, 1.70, 0.040, GREEN),
)
_BOXES = (
    (0.20, -0.33, 2.30, (0.30, 0.18, 0.02), (0.10, 0.74, 0.16)),
    (-0.30, 0.10, 2.40, (0.25, 0.60, 0.10), (0.80, 0.12, 0.10)),
    (0.48, 0.30, 2.00, (0.20, 0.30, 0.10), (0.10, 0.25, 0.85)),
    (0.00, 0.50, 1.90, (1.20, 0.08, 0.40), (0.85, 0.45, 0.08)),
    (-0.05, -0.36, 2.60, (0.15, 0.15, 0.05), (0.55, 0.10, 0.60)),
)
_TAG_AT = (-0.20, -0.30, 1.90, 0.16)
_MOVED = 0.02


def _make_clutter(
    options: Options, camera: PinholeCamera, rng: np.random.Generator
) -> tuple[tuple[Ball | Plate, ...], tuple[Box, ...]]:
    """Balls of the feature's colour, one of them bigger
    and nearer; a foreign tag; saturated furniture.
    """
    if not options.clutter:
        return (), ()
    balls = tuple(
        Ball(_place_before_camera(camera, at, rng), radius, colour)
        for *at, radius, colour in _BALLS
    )
    *at, side = _TAG_AT
    tag = Plate(_place_before_camera(camera, at, rng), camera.rotation.T, side, FOREIGN_TAG)
    boxes = tuple(
        Box(_place_before_camera(camera, at, rng), camera.rotation.T, half, colour)
        for *at, half, colour in _BOXES
    )
    return (*balls, tag), boxes


def _place_before_camera(camera: PinholeCamera, at: list[float], rng: np.random.Generator) -> Array:
    right, down, ahead = at
    across = np.array([right, down]) + rng.uniform(-_MOVED, _MOVED, 2)
    return np.asarray(camera.position + np.array([*across * ahead, ahead]) @ camera.rotation)
