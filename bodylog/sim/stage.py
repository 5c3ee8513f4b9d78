"""What all streams of a recording share: the arm before its camera, the clocks, and chance.

Every stream has its own clock and its own chance. A header stamp is the instant its values are true for; the log
time is when a recorder would have received it, a few ms later.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..types import Array
from . import camera as cameras
from . import hand
from .arms import Arm
from .camera import Camera
from .head import Head, turned
from .plan import Plan
from .world import World, open_world

START_NS = 1_767_225_600 * 1_000_000_000
"""2026-01-01T00:00:00Z: every recording starts here."""

FRAME, SIDE_FRAME = "camera_optical_frame", "side_optical_frame"
_BLOCK = 1000
_ASIDE = np.array([0.017, 0.0, 0.03])


@dataclass(frozen=True, eq=False)
class Item:
    """One message on its way: topic, log time, stamp, message."""

    log_ns: int
    stamp_ns: int
    topic: str
    message: Any


@dataclass(frozen=True)
class Wish:
    """What is to be recorded: scenario and its plan, duration s, picture size px, encoder noise rad, marker or not.

    `cameras` is 1 for the head's alone, 2 for one at the side as well; `turning`: the head turns.
    """

    scenario: str
    arm: Arm
    plan: Plan
    duration: float
    seed: int
    size: tuple[int, int]
    noise: float
    image: str
    marker: bool
    cameras: int
    turning: bool


@dataclass(frozen=True, eq=False)
class Stage:
    """All that the streams share: `camera` with the head at rest, `column` of skin cells the hand touches.

    `side` is the camera at the side, `head` what turns `camera`, or None.
    """

    wish: Wish
    world: World
    camera: Camera
    column: int
    side: Camera | None
    head: Head | None

    def seen_from(self, t: float) -> Camera:
        """The head's camera as it stands at t s."""
        return self.camera if self.head is None else turned(self.camera, float(self.head.angle(np.array([t]))[0]))

    @property
    def image_topic(self) -> str:
        """The topic of the head's pictures."""
        return self.topic("/camera")

    def topic(self, under: str) -> str:
        """The topic of the pictures of the camera whose topics are `under` that."""
        return f"{under}/image/compressed" if self.wish.image == "jpeg" else f"{under}/image"

    def chance(self, stream: int) -> np.random.Generator:
        """The random numbers of one stream; 0 is the scenario's."""
        return np.random.default_rng([self.wish.seed, stream])


@contextmanager
def open_stage(wish: Wish) -> Iterator[Stage]:
    """The arm loaded and the camera placed; closed afterwards."""
    with open_world(wish.arm) as world:
        places, turns = world.pose(np.array(wish.arm.home))
        target = places[world.links.index("effector")]
        camera, side = (
            cameras.look(target + place, target + _ASIDE, wish.size) for place in (wish.arm.camera, wish.arm.side)
        )
        link = world.links.index("skin")
        column = hand.facing(matrix(turns[link]).T @ (camera.position - places[link]))
        head = Head(np.random.default_rng([wish.seed, 5]).uniform(0.0, 2 * np.pi, 2)) if wish.turning else None
        yield Stage(wish, world, camera, column, side if wish.cameras > 1 else None, head)


def matrix(xyzw: Array) -> Array:
    """Rotation matrix (3,3) of a unit quaternion (4,)."""
    x, y, z, w = xyzw
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + 2 * w * cross + 2 * cross @ cross)


def stamps_of(duration: float, rate: float, offset_ns: int) -> Iterator[Array]:
    """Stamps (n,) ns since the start, block by block."""
    count = int(np.ceil(duration * rate))
    for first in range(0, count, _BLOCK):
        yield np.rint(np.arange(first, min(first + _BLOCK, count)) * (1e9 / rate)).astype(np.int64) + offset_ns


def log_times(stamps: Array, least_ms: float, most_ms: float, rng: np.random.Generator) -> Array:
    """When a recorder got what is stamped so (ns since the start): ns since the epoch, least to most ms later."""
    return START_NS + stamps + rng.uniform(least_ms * 1e6, most_ms * 1e6, len(stamps)).astype(np.int64)


def seen_hand(stage: Stage, t: Array) -> Array:
    """Where the picture shows the hand's centre (N,3) m, base frame; NaN when away."""
    places, turns = stage.world.pose(stage.wish.plan.motion.position(t[:1])[0])
    link = stage.world.links.index("skin")
    place = hand.path(stage.wish.plan.contacts, stage.column, t, seen=True) @ matrix(turns[link]).T + places[link]
    ahead = (place - stage.camera.position) @ stage.camera.rotation[2]
    shift = stage.wish.plan.aside * stage.camera.width / stage.camera.focal * ahead
    return np.asarray(place + shift[:, None] * stage.camera.rotation[0])
