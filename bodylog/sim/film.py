"""The cameras' streams: images, and the ground truth at their stamps."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..types import Array
from . import camera as cameras
from . import messages
from .head import SWING
from .scene import Ball, SceneThing
from .stage import FRAME, SIDE_FRAME, START_NS, Item, Stage, log_times, seen_hand, stamps_of
from .tag import Plate
from .world import (
    EFFECTOR_RADIUS,
    HAND_RADIUS,
    MARKER_RADIUS,
    matrix_from_quaternion,
    quaternion_from_matrix,
)
from .wrist import LINK

_CAMERA_HZ = 20.0
_QUALITY = 90
_WHOLE = 0.99
_SLIDE = 0.25
_ROUNDS = 2
"""The feature moves less than a row in the time that the second round adds."""
_BAND = 16
"""Rows that are drawn as of one instant: a shutter of 0.1 s at 640×480
reads them in 3 ms, and they are off by half of that at most.
"""
_MARGIN = 2
"""Rows drawn beside a band and cut off, as the picture is drawn at half its size and enlarged."""


@dataclass(frozen=True, eq=False)
class _View:
    """One camera: its topics begin with `under`, those of
    its truth with `truth`; its clock and random numbers.
    """

    camera: cameras.PinholeCamera
    under: str
    truth: str
    frame: str
    offset_ns: int
    stream: int


@dataclass(frozen=True, eq=False)
class _Shot:
    """The arm without hand and card: pose, link positions and orientations, image and depth."""

    q: Array
    places: Array
    turns: Array
    picture: Array
    depth: Array


@dataclass(frozen=True, eq=False)
class _Card:
    """A card over columns and rows `box` at `depth` m, in
    place from `start` to `end` s, sliding in from below.
    """

    box: tuple[int, int, int, int]
    depth: float
    start: float
    end: float


def camera_items(stage: Stage) -> Iterator[Item]:
    """The first camera's streams: images, CameraInfo,
    /tf; truth: effector pose, pixels of visible things.
    """
    if stage.mount is not None:
        yield _camera_place()
    yield from _film_camera(
        stage,
        _View(stage.camera, "/camera", "/truth", FRAME, 7_000_000, 3),
        _card_over_effector(stage),
    )


def _camera_place() -> Item:
    """/tf_static: the pose of a camera on its link of the arm."""
    place = messages.transforms_message(
        START_NS, [(FRAME, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))], parent=LINK
    )
    return Item(START_NS, START_NS, "/tf_static", place)


def side_items(stage: Stage) -> Iterator[Item]:
    """The same streams of the camera at the side, if there
    is one, at other instants; the card does not hide it.
    """
    if stage.side is None:
        return iter(())
    return _film_camera(
        stage, _View(stage.side, "/side", "/truth/side", SIDE_FRAME, 29_000_000, 4), None
    )


def _film_camera(stage: Stage, view: _View, card: _Card | None) -> Iterator[Item]:
    rng = stage.chance(view.stream)
    # a wall that turns with the camera would be no texture of the scene
    textured = stage.wish.options.scene == "bare" and stage.mount is None
    wall = cameras.draw_background(view.camera, rng, textured)
    noise = cameras.sensor_noise(view.camera, rng)
    shot: _Shot | None = None
    by_rows = stage.wish.options.scene == "bare" and stage.wish.hardware.rolling > 0.0
    for stamps in stamps_of(stage.wish.duration, _CAMERA_HZ, view.offset_ns):
        t = stamps / 1e9
        if not by_rows:
            t = t + _exposure_delays(stage, view, t)
        q = stage.wish.plan.motion.position(t)
        hands = seen_hand(stage, t)
        for row, log in enumerate(log_times(stamps, 8.0, 14.0, rng)):
            if stage.moves and view.frame == FRAME:
                view = replace(view, camera=stage.seen_from(t[row]))
                shot = None
            # the poses at its stamp stand for it where rows are drawn
            if shot is None or not (by_rows or np.array_equal(shot.q, q[row])):
                shot = _shoot_arm(stage, view.camera, q[row], wall)
            if by_rows:
                picture, shown = _compose_rows(stage, view, wall, card, t[row])
            else:
                picture, shown = _compose_image(stage, view, shot, hands[row], card, t[row])
            seen = {topic: pixel for topic, (share, pixel) in shown.items() if share > _WHOLE}
            picture = cameras.expose_image(picture, noise, rng)
            stated = _at_stamp(stage, view, shot, float(stamps[row]) / 1e9)
            yield from _items_of_image(
                stage, *stated, int(stamps[row]) + START_NS, int(log), picture, seen
            )


def _exposure_delays(stage: Stage, view: _View, t: Array) -> Array:
    """Time (N,) s from the stamps t (N,) s of pictures, at
    their first row, to the exposure of the feature's row.

    With a rolling shutter every row is exposed later than the one above
    it. A whole picture is drawn as of the instant at which the row of
    its feature is exposed, or the middle row where there is nothing.
    """
    delay = np.zeros(len(t))
    if not stage.wish.hardware.rolling:
        return delay
    for row, instant in enumerate(t):
        for _ in range(_ROUNDS):
            height = _feature_height(stage, view, float(instant + delay[row]))
            delay[row] = stage.wish.hardware.rolling * height
    return delay


def _feature_height(stage: Stage, view: _View, t: float) -> float:
    """Where the feature's row is at t s, from 0 for the picture's first row to 1 for its last."""
    camera = stage.seen_from(t) if view.frame == FRAME else view.camera
    poses = stage.world.pose(stage.wish.plan.motion.position(np.array([t]))[0])
    feature = _feature_in_base(stage, *poses)
    if feature is None:
        return 0.5
    return float(np.clip(feature.pixel(camera)[1] / (camera.height - 1), 0.0, 1.0))


def _at_stamp(stage: Stage, view: _View, shot: _Shot, t: float) -> tuple[_View, _Shot]:
    """The view and the shot with the poses at the picture's
    stamp t s, which a rolling shutter exposes later.
    """
    if not stage.wish.hardware.rolling:
        return view, shot
    q = stage.wish.plan.motion.position(np.array([t]))[0]
    places, turns = stage.world.pose(q)
    camera = stage.seen_from(t) if view.frame == FRAME else view.camera
    return replace(view, camera=camera), replace(shot, q=q, places=places, turns=turns)


def _shoot_arm(stage: Stage, camera: cameras.PinholeCamera, q: Array, wall: Array) -> _Shot:
    places, turns = stage.world.pose(q)
    return _Shot(q, places, turns, *stage.world.picture(camera, wall))


def _compose_image(
    stage: Stage, view: _View, shot: _Shot, place: Array, card: _Card | None, t: float
) -> tuple[Array, dict[str, tuple[float, Array]]]:
    """The image at t; of each thing the share of it that is visible, and its pixel (2,)."""
    picture = shot.picture.copy()
    depth = shot.depth.copy()
    if card is not None:
        _cover_with_card(picture, depth, card, view.camera, t)
    shown = {}
    for topic, thing in _things_to_draw(stage, view, shot, place):
        share = thing.draw(picture, depth, view.camera)
        if topic:
            shown[topic] = share, thing.pixel(view.camera)
    return picture, shown


def _compose_rows(
    stage: Stage, view: _View, wall: Array, card: _Card | None, t: float
) -> tuple[Array, dict[str, tuple[float, Array]]]:
    """The image whose first row is exposed at t s, each band of rows as of its own instant, and
    what it shows as `_compose_image` returns it, at the instant of the row that shows it.
    """
    bands = list[Array]()
    shown = dict[str, tuple[float, Array]]()
    height = view.camera.height
    for first in range(0, height, _BAND):
        end = min(first + _BAND, height)
        middle = 0.5 * (first + end - 1)
        exposed = t + stage.wish.hardware.rolling * middle / (height - 1)
        camera = stage.seen_from(exposed) if view.frame == FRAME else view.camera
        q = stage.wish.plan.motion.position(np.array([exposed]))[0]
        begin = max(first - _MARGIN, 0)
        drawn = slice(begin, min(end + _MARGIN, height))
        shot = _shoot_arm(stage, camera.take_rows(drawn.start, drawn.stop), q, wall[drawn])
        inner = slice(first - begin, end - begin)
        shot = replace(shot, picture=shot.picture[inner], depth=shot.depth[inner])
        band = replace(view, camera=camera.take_rows(first, end))
        hand = seen_hand(stage, np.array([exposed]))[0]
        picture, parts = _compose_image(stage, band, shot, hand, card, exposed)
        bands.append(picture)
        for topic, (share, pixel) in parts.items():
            in_whole = pixel + np.array([0.0, first])
            before, known = shown.get(topic, (0.0, in_whole))
            here = first - 0.5 <= in_whole[1] < end - 0.5
            shown[topic] = before + share, in_whole if here else known
    return np.concatenate(bands), shown


def _things_to_draw(
    stage: Stage, view: _View, shot: _Shot, place: Array
) -> list[tuple[str, SceneThing]]:
    """The things to draw with their truth's topics ("" for clutter), nearest first."""
    links = stage.world.links
    things: list[tuple[str, SceneThing]] = [("", thing) for thing in stage.scene.things]
    for link, stud in stage.scene.studs:
        number = links.index(link)
        things.append(
            ("", stud.moved(shot.places[number], matrix_from_quaternion(shot.turns[number])))
        )
    feature = _feature_in_base(stage, shot.places, shot.turns)
    if feature is not None:
        things.append((f"{view.truth}/effector_pixel", feature))
    if stage.wish.options.marker:
        ball = Ball(shot.places[links.index(stage.wish.arm.marker)], MARKER_RADIUS, cameras.BLUE)
        things.append((f"{view.truth}/marker_pixel", ball))
    if not np.isnan(place).any():
        things.append((f"{view.truth}/hand_pixel", Ball(place, HAND_RADIUS, cameras.RED)))
    return sorted(
        things, key=lambda thing: float(np.linalg.norm(thing[1].place - view.camera.position))
    )


def _feature_in_base(stage: Stage, places: Array, turns: Array) -> Ball | Plate | None:
    """The feature in the base frame, for positions and orientations of the links."""
    feature = stage.scene.feature
    link = stage.scene.link
    if feature is None or link is None:
        return feature
    number = stage.world.links.index(link)
    return feature.moved(places[number], matrix_from_quaternion(turns[number]))


def _items_of_image(
    stage: Stage,
    view: _View,
    shot: _Shot,
    stamp: int,
    log: int,
    picture: Array,
    seen: dict[str, Array],
) -> Iterator[Item]:
    camera = view.camera
    yield Item(
        log,
        stamp,
        stage.topic(view.under),
        _image_message(stage.wish.options.image, view.frame, stamp, picture),
    )
    info = messages.camera_info_message(
        stamp, view.frame, camera.width, camera.height, camera.focal, camera.centre
    )
    yield Item(log, stamp, f"{view.under}/camera_info", info)
    frames = list(zip(stage.world.links, shot.places, shot.turns, strict=True))
    if stage.mount is None:  # else /tf_static holds it
        frames.append((view.frame, camera.position, quaternion_from_matrix(camera.rotation.T)))
    yield Item(log, stamp, "/tf", messages.transforms_message(stamp, frames))
    link = stage.world.links.index("effector")
    yield Item(
        log,
        stamp,
        "/truth/effector_pose",
        messages.pose_message(stamp, shot.places[link], shot.turns[link]),
    )
    yield from _feature_pose(stage, shot, stamp, log)
    for topic, uv in seen.items():
        yield Item(log, stamp, topic, messages.pixel_message(stamp, view.frame, uv))


def _feature_pose(stage: Stage, shot: _Shot, stamp: int, log: int) -> Iterator[Item]:
    """/truth/feature_pose, where the feature is not simply the effector."""
    feature = _feature_in_base(stage, shot.places, shot.turns)
    if isinstance(feature, Plate) or (feature is not None and stage.mount is not None):
        rotation = feature.rotation if isinstance(feature, Plate) else np.eye(3)
        pose = messages.pose_message(stamp, feature.place, quaternion_from_matrix(rotation))
        yield Item(log, stamp, "/truth/feature_pose", pose)


def _image_message(form: str, frame: str, stamp: int, picture: Array) -> object:
    import cv2

    if form == "raw":
        return messages.raw_image(stamp, frame, picture)
    options = [cv2.IMWRITE_JPEG_QUALITY, _QUALITY]
    jpeg = cv2.imencode(".jpg", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), options)[1]
    return messages.compressed_image(stamp, frame, jpeg.ravel())


def _card_over_effector(stage: Stage) -> _Card | None:
    """The card that hides the end effector's whole path
    from the head's camera while the plan covers it.
    """
    if stage.wish.plan.covered is None or stage.mount is not None:
        return None
    start, end = stage.wish.plan.covered
    t = np.arange(max(start, 0.0), min(end, stage.wish.duration) + 0.05, 0.05)
    link = stage.world.links.index("effector")
    path = np.array([stage.world.pose(q)[0][link] for q in stage.wish.plan.motion.position(t)])
    pixels = cameras.ellipse_centre(stage.camera, path, EFFECTOR_RADIUS)
    ahead = (path - stage.camera.position) @ stage.camera.rotation[2]
    margin = stage.wish.plan.margin * stage.camera.width + (
        SWING * stage.camera.focal if stage.head else 0.0
    )
    left, top = np.maximum(pixels.min(0) - margin, 0).astype(int)
    right, bottom = np.minimum(
        pixels.max(0) + margin, [stage.camera.width, stage.camera.height]
    ).astype(int)
    return _Card((left, top, right, bottom), float(ahead.min()) - 2.4 * EFFECTOR_RADIUS, start, end)


def _cover_with_card(
    picture: Array, depth: Array, card: _Card, camera: cameras.PinholeCamera, t: float
) -> None:
    """Draw the card at t, if it is in the image of the camera."""
    left, top, right, bottom = card.box
    out = max(card.start - t, t - card.end, 0.0) / _SLIDE
    down = round(out * ((camera.whole_height or camera.height) - top))
    if out < 1.0:
        upper, lower = (
            min(max(row + down - camera.first_row, 0), camera.height) for row in (top, bottom)
        )
        cameras.draw_card(picture, depth, (left, upper, right, lower), card.depth)
