"""Shared by all streams of a recording: the arm
before its camera, the clocks, and random generators.

Every stream has its own clock and random generator. A header stamp is the instant of its values;
the log time is when a recorder would receive it, a few ms later.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..types import Array
from . import camera as cameras
from . import hand, scene
from .arms import Arm
from .camera import PinholeCamera
from .hardware import Hardware
from .head import Sway, gripper_sway, head_sway, turn_camera
from .joint_motion import DrivenMotion
from .options import Options
from .plan import ScenarioPlan
from .scene import Scene
from .world import World, matrix_from_quaternion, open_world
from .wrist import DISTANCE, Mount, camera_on_mount

START_NS = 1_767_225_600 * 1_000_000_000
"""2026-01-01T00:00:00Z: every recording starts here."""

FRAME = "camera_optical_frame"
SIDE_FRAME = "side_optical_frame"
_BLOCK = 1000
_ASIDE = np.array([0.017, 0.0, 0.03])
_CHANCES = {"head": 5, "scene": 6, "gripper": 7, "studs": 8}


@dataclass(frozen=True, eq=False)
class Item:
    """One message: topic, log time, stamp, content."""

    log_ns: int
    stamp_ns: int
    topic: str
    message: Any


@dataclass(frozen=True)
class Wish:
    """A recording's scenario and options, and the resulting arm, plan, duration s and noise rad.

    hardware: errors of joints and encoders · joints: the
    arm's motors and links; the plan's motion is the links'.
    """

    scenario: str
    options: Options
    arm: Arm
    plan: ScenarioPlan
    duration: float
    noise: float
    hardware: Hardware
    joints: DrivenMotion


@dataclass(frozen=True, eq=False)
class Stage:
    """Shared by all streams: `camera` with head and arm
    at rest, `column` of skin cells that the hand touches.

    `side` is the camera at the side, `head` turns `camera`, `mount` carries it on the arm, each or
    None; `gripper` is a joint that no image shows, or None.
    """

    wish: Wish
    world: World
    camera: PinholeCamera
    column: int
    side: PinholeCamera | None
    head: Sway | None
    mount: Mount | None
    gripper: Sway | None
    scene: Scene

    def seen_from(self, t: float) -> PinholeCamera:
        """The first camera at t s."""
        if self.mount is not None:
            return camera_on_mount(
                self.mount,
                self.camera,
                *self.world.pose(self.wish.plan.motion.position(np.array([t]))[0]),
            )
        return (
            self.camera
            if self.head is None
            else turn_camera(self.camera, float(self.head.angle(np.array([t]))[0]))
        )

    @property
    def moves(self) -> bool:
        """Whether the first camera moves."""
        return self.head is not None or self.mount is not None

    @property
    def image_topic(self) -> str:
        """The topic of the head's images."""
        return self.topic("/camera")

    def topic(self, under: str) -> str:
        """The image topic of the camera whose topics begin with `under`."""
        return (
            f"{under}/image/compressed" if self.wish.options.image == "jpeg" else f"{under}/image"
        )

    def chance(self, stream: int) -> np.random.Generator:
        """The random numbers of one stream; 0 is the scenario's."""
        return np.random.default_rng([self.wish.options.seed, stream])


@contextmanager
def open_stage(wish: Wish) -> Iterator[Stage]:
    """Load the arm, place the camera and build the scene; close all at the end."""
    options = wish.options
    chances = {
        name: np.random.default_rng([options.seed, stream]) for name, stream in _CHANCES.items()
    }
    with open_world(wish.arm) as world:
        places, turns = world.pose(np.array(wish.arm.home))
        link = world.links.index("skin")
        effector = world.links.index("effector")
        target = places[effector]
        rotation = matrix_from_quaternion(turns[effector])
        camera, side = (
            cameras.look_at(target + place, target + _ASIDE, options.size)
            for place in (wish.arm.camera, wish.arm.side)
        )
        mount = Mount(effector) if options.camera == "wrist" else None
        if mount is not None:
            camera = camera_on_mount(mount, cameras.wide_camera(options.size), places, turns)
            around = scene.before_the_wrist(options, camera, DISTANCE, chances["scene"])
        else:
            around = scene.on_the_arm(options, camera, target, rotation, chances["scene"])
        if options.scene == "bare":
            around = replace(around, studs=scene.studs(world.cylinders(), chances["studs"]))
        world.furnish(around.boxes)
        column = hand.column_facing_camera(
            matrix_from_quaternion(turns[link]).T @ (camera.position - places[link])
        )
        turn = head_sway(chances["head"]) if options.turning else None
        grip = gripper_sway(chances["gripper"]) if options.split_joints else None
        yield Stage(
            wish,
            world,
            camera,
            column,
            side if options.cameras > 1 else None,
            turn,
            mount,
            grip,
            around,
        )


def stamps_of(duration: float, rate: float, offset_ns: int) -> Iterator[Array]:
    """Stamps (n,) ns since the start, block by block."""
    count = int(np.ceil(duration * rate))
    for first in range(0, count, _BLOCK):
        yield (
            np.rint(np.arange(first, min(first + _BLOCK, count)) * (1e9 / rate)).astype(np.int64)
            + offset_ns
        )


def log_times(stamps: Array, least_ms: float, most_ms: float, rng: np.random.Generator) -> Array:
    """Log times (ns since the epoch) of stamps (ns since the start): least to most ms later."""
    return (
        START_NS + stamps + rng.uniform(least_ms * 1e6, most_ms * 1e6, len(stamps)).astype(np.int64)
    )


def seen_hand(stage: Stage, t: Array) -> Array:
    """The hand's centre (N,3) m as the image shows it, base frame; NaN when away."""
    places, turns = stage.world.pose(stage.wish.plan.motion.position(t[:1])[0])
    link = stage.world.links.index("skin")
    place = (
        hand.hand_path(stage.wish.plan.contacts, stage.column, t, seen=True)
        @ matrix_from_quaternion(turns[link]).T
        + places[link]
    )
    ahead = (place - stage.camera.position) @ stage.camera.rotation[2]
    shift = stage.wish.plan.aside * stage.camera.width / stage.camera.focal * ahead
    return np.asarray(place + shift[:, None] * stage.camera.rotation[0])
