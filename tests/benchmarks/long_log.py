"""Logs of any length of a two-joint arm before a small camera: time is measured as they grow.

Joints at 100 Hz with their truth, 10 images a second of 160×120 px, a skin, and a hand that touches
every 4 s. Among things of the marker's colour one stands still, one wanders, and one passes every
9 s: candidates, runs and touches grow with the log as they do on a robot.
"""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from mcap.writer import CompressionType

from bodylog.annotating import messages
from bodylog.logs.encode import cdr
from bodylog.logs.encode.cdr import CdrField
from bodylog.types import Array, Series
from tests.benchmarks.chain_log import START_NS, Row, compressed, rows, write
from tests.perception import scenes

WIDTH, HEIGHT = 160, 120
_CAMERA_HZ, _ENCODER_HZ, _SKIN_HZ, _CELLS = 10.0, 100.0, 50.0, 12
_ENCODER_STD = 0.01
_TOUCH_EVERY, _STROKE = 4.0, 1.0
_PASSES_EVERY = 9.0
_WALLS = 8
"""Different noisy walls, drawn once and used in turn: new noise would take most of the time."""
_SIXTEENTHS = 4
"""Bits of a pixel's fraction in OpenCV's coordinates: discs are drawn to 1/16 px."""

Waves = tuple[Array, Array]
"""Frequencies (rad/s) and phases (rad) of the sines that a joint's motion sums: (2,4) each."""


def record(path: Path, seconds: float, seed: int = 0) -> None:
    """Write a log of so many seconds."""
    rng = np.random.default_rng(seed)
    waves = rng.uniform(0.4, 1.6, (2, 4)), rng.uniform(0.0, 2 * np.pi, (2, 4))
    types = {
        "/joint_states": "sensor_msgs/msg/JointState",
        "/truth/joint_states": "sensor_msgs/msg/JointState",
        "/skin": "std_msgs/msg/Float32MultiArray",
        "/camera": "sensor_msgs/msg/CompressedImage",
    }
    t = np.arange(0.0, seconds, 1 / _ENCODER_HZ)
    angles = _angles(t, *waves)
    read = angles + rng.normal(0.0, _ENCODER_STD, angles.shape)
    streams = (
        _joints("/joint_states", t, read),
        _joints("/truth/joint_states", t, angles),
        _skin(seconds, rng),
        _pictures(seconds, waves, rng),
    )
    write(path, types, streams, CompressionType.ZSTD)


def _angles(t: Array, speed: Array, phase: Array) -> Array:
    """Smooth angles (n,2) rad at t (n,) s: sums of slow sines."""
    moments = t[:, None, None]
    swings = 0.25 / speed * np.sin(speed * moments + phase)
    return np.asarray(swings.sum(axis=2) + np.array([0.3, 0.9]))


def _place(angles: Array) -> Array:
    """The marker's place (n,2) px: the tip of two links seen from the side."""
    shoulder, elbow = angles[:, 0], angles[:, 0] + angles[:, 1]
    along = 38.0 * np.cos(shoulder) + 32.0 * np.cos(elbow)
    up = 38.0 * np.sin(shoulder) + 32.0 * np.sin(elbow)
    return np.column_stack([45.0 + along, 105.0 - up])


def _joints(topic: str, t: Array, values: Array) -> Iterator[Row]:
    ns = messages.stamps_ns(t, START_NS)
    series = Series(t, values, ("elbow", "shoulder"), "rad", ns)
    made = messages.from_joints(topic, series, START_NS, np.gradient(values, t, axis=0))
    return rows(topic, made.log_ns, made)


def _skin(seconds: float, rng: np.random.Generator) -> Iterator[Row]:
    """The skin's cells: one is touched while the hand strokes."""
    t = np.arange(0.001, seconds, 1 / _SKIN_HZ)
    values = np.abs(rng.normal(0.0, 0.02, (len(t), _CELLS)))
    touched = np.abs(t % _TOUCH_EVERY - _TOUCH_EVERY / 2) < _STROKE / 2
    values[touched, 3] += 0.9
    fields: list[CdrField] = [("uint32", 0), ("uint32", 0), ("float32[]", values)]
    return rows("/skin", messages.stamps_ns(t, START_NS), cdr.serialise_messages(len(t), fields))


def _pictures(seconds: float, waves: Waves, rng: np.random.Generator) -> Iterator[Row]:
    walls = [scenes.draw(scenes.wall(rng, WIDTH, HEIGHT, 5.0), [], rng) for _ in range(_WALLS)]
    moments = np.arange(0.003, seconds, 1 / _CAMERA_HZ)
    places = _place(_angles(moments, *waves)).tolist()
    for number, (t, place) in enumerate(zip(moments.tolist(), places, strict=True)):
        discs = [*_foreign(t), _hand(t), scenes.Disc(place[0], place[1], 6.0)]
        picture = walls[number % _WALLS].copy()
        for disc in discs:
            _paint(picture, disc)
        ns = int(messages.stamps_ns(np.array(t), START_NS))
        yield ns, "/camera", compressed(ns, scenes.jpeg(picture))


def _paint(picture: Array, disc: scenes.Disc) -> None:
    scale = 2**_SIXTEENTHS
    middle = (round(disc.u * scale), round(disc.v * scale))
    radius = round(disc.radius * scale)
    cv2.circle(picture, middle, radius, disc.colour, cv2.FILLED, cv2.LINE_AA, _SIXTEENTHS)


def _foreign(t: float) -> list[scenes.Disc]:
    """Things of the marker's colour that are not the arm's."""
    still = scenes.Disc(20.0, 20.0, 6.0)
    wandering = scenes.Disc(60.0 + 30.0 * np.sin(0.31 * t), 22.0 + 8.0 * np.cos(0.47 * t), 6.0)
    share = t % _PASSES_EVERY / 3.0
    passing = [scenes.Disc(15.0 + 130.0 * share, 112.0, 5.5)] if share < 1 else []
    return [still, wandering, *passing]


def _hand(t: float) -> scenes.Disc:
    """A red hand that comes, strokes slowly, and leaves."""
    since = t % _TOUCH_EVERY - _TOUCH_EVERY / 2
    before, after = max(0.0, -since - _STROKE / 2), max(0.0, since - _STROKE / 2)
    slow = 8.0 * min(max(since, -_STROKE / 2), _STROKE / 2)
    return scenes.Disc(130.0 + 12.0 * after, 60.0 - 25.0 * before + slow, 8.0, scenes.RED)
