"""Encoders, skin and events: streams of messages, each in the order of log time."""

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..types import Array
from . import hand, messages, skin
from .camera import ellipse_centre
from .hardware import encoder_noise, rounded_to_counts
from .head import Sway
from .plan import Contact
from .stage import FRAME, START_NS, Item, Stage, Wish, log_times, seen_hand, stamps_of
from .world import HAND_RADIUS

_JOINT_HZ = 100.0
_SKIN_HZ = 100.0
_RATE_NOISE = 0.01
_HARDWARE = 10
"""Number of the random generator of errors of the hardware."""


@dataclass(frozen=True)
class _JointPart:
    """A part's topic and rate Hz, first instant and clock offset in ns, and random generator."""

    topic: str
    rate: float
    first_ns: int
    ahead_ns: int
    stream: int


_HEAD = _JointPart("/head/joint_states", 30.0, 11_000_000, 20_000_000, 8)
_GRIPPER = _JointPart("/gripper/joint_states", 50.0, 3_000_000, -7_000_000, 9)


def encoder_items(stage: Stage) -> Iterator[Item]:
    """The arm's joint states in alphabetical order as the UR driver publishes, and
    /truth/joint_states of all joints.

    Head and gripper are in the same messages, unless each part has its own topic.
    """
    yield Item(
        START_NS,
        START_NS,
        "/robot_description",
        messages.text_message(stage.wish.arm.urdf.read_text()),
    )
    rng = stage.chance(1)
    split = stage.wish.options.split_joints
    others = [sway for sway in (stage.head, stage.gripper) if sway is not None]
    true_names = [*stage.wish.arm.joints, *(sway.joint for sway in others)]
    names, order = _alphabetical_order(stage.wish.arm.joints if split else true_names)
    lasting, late = _hardware_errors(stage)
    first = 0
    for stamps in stamps_of(stage.wish.duration, _JOINT_HZ, 0):
        t = stamps / 1e9
        q = stage.wish.joints.truth.position(t)
        rate = stage.wish.joints.truth.rate(t)
        rows = slice(first, first + len(t))
        first += len(t)
        read, speed = _encoder_readings(
            stage.wish, t, rng, None if lasting is None else lasting[rows]
        )
        for sway in others:
            angle = sway.angle(t)[:, None]
            turn = sway.rate(t)[:, None]
            q = np.hstack([q, angle])
            rate = np.hstack([rate, turn])
            if not split:
                speed = np.hstack([speed, turn])
                read = np.hstack(
                    [read, angle + rng.normal(0.0, 1.0, angle.shape) * stage.wish.noise]
                )
        stated = stamps + START_NS if late is None else stamps + START_NS + late[rows]
        for row, (stamp, log) in enumerate(
            zip(stamps + START_NS, log_times(stamps, 4.0, 6.0, rng), strict=True)
        ):
            seen = messages.joint_state(
                int(stated[row]), names, read[row, order], speed[row, order]
            )
            yield Item(
                int(log), int(stated[row]), "/arm/joint_states" if split else "/joint_states", seen
            )
            truth = messages.joint_state(int(stamp), true_names, q[row], rate[row])
            yield Item(int(log), int(stamp), "/truth/joint_states", truth)


def _hardware_errors(stage: Stage) -> tuple[Array | None, Array | None]:
    """Errors (N,M) rad of the arm's encoders and of their
    stamps (N,) ns; None where its hardware has none.
    """
    hardware = stage.wish.hardware
    rng = stage.chance(_HARDWARE)
    shape = (
        sum(len(block) for block in stamps_of(stage.wish.duration, _JOINT_HZ, 0)),
        len(stage.wish.arm.joints),
    )
    errors = (
        encoder_noise(hardware, stage.wish.noise, shape, _JOINT_HZ, rng)
        if hardware.replaces_noise
        else None
    )
    if not hardware.jitter:
        return errors, None
    stamps = np.arange(shape[0]) / _JOINT_HZ
    # stamps of one topic do not go back
    jittered = np.maximum.accumulate(stamps + hardware.jitter * rng.standard_normal(shape[0]))
    return errors, np.rint((jittered - stamps) * 1e9).astype(np.int64)


def _alphabetical_order(names: Sequence[str]) -> tuple[list[str], Array]:
    """The names in order, and the index of each among `names`."""
    order = np.argsort(names)
    return [names[joint] for joint in order], order


def other_items(stage: Stage) -> Iterator[Item]:
    """/head/joint_states and /gripper/joint_states
    where each part has its own topic, rate and clock.
    """
    if not stage.wish.options.split_joints:
        return iter(())
    parts = [(stage.head, _HEAD), (stage.gripper, _GRIPPER)]
    streams = [_other_joint_items(stage, sway, part) for sway, part in parts if sway is not None]
    return heapq.merge(*streams, key=lambda item: item.log_ns)


def _other_joint_items(stage: Stage, sway: Sway, part: _JointPart) -> Iterator[Item]:
    rng = stage.chance(part.stream)
    for instants in stamps_of(stage.wish.duration, part.rate, part.first_ns):
        t = instants / 1e9
        read = sway.angle(t) + rng.normal(0.0, 1.0, len(t)) * stage.wish.noise
        speed = sway.rate(t) + rng.normal(0.0, _RATE_NOISE, len(t))
        for row, log in enumerate(log_times(instants, 4.0, 6.0, rng)):
            stamp = int(instants[row]) + START_NS + part.ahead_ns
            seen = messages.joint_state(
                stamp, [sway.joint], read[row : row + 1], speed[row : row + 1]
            )
            yield Item(int(log), stamp, part.topic, seen)


def _encoder_readings(
    wish: Wish, t: Array, rng: np.random.Generator, errors: Array | None
) -> tuple[Array, Array]:
    """The encoders' readings and their speeds (N,M);
    `errors` (N,M) rad in place of independent noise.
    """
    motors = wish.joints.motors
    plan = wish.plan
    q = motors.position(t)
    independent = rng.normal(0.0, 1.0, q.shape) * wish.noise
    read = plan.encoders(t, q, independent if errors is None else errors)
    before, after = (
        plan.encoders(t + h, motors.position(t + h), np.zeros(q.shape)) for h in (-1e-4, 1e-4)
    )
    speed = (after - before) / 2e-4 + rng.normal(0.0, _RATE_NOISE, q.shape)
    return rounded_to_counts(wish.hardware, read), speed


def skin_items(stage: Stage) -> Iterator[Item]:
    """/skin: the cells' readings."""
    rng = stage.chance(2)
    base = skin.rest_readings(rng)
    for stamps in stamps_of(stage.wish.duration, _SKIN_HZ, 2_000_000):
        place = hand.hand_path(stage.wish.plan.contacts, stage.column, stamps / 1e9, seen=False)
        data = skin.add_skin_noise(skin.proximity_readings(place, HAND_RADIUS, base), rng)
        for row, (stamp, log) in enumerate(
            zip(stamps + START_NS, log_times(stamps, 2.0, 4.0, rng), strict=True)
        ):
            yield Item(int(log), int(stamp), "/skin", messages.skin_array(int(stamp), data[row]))


def event_items(stage: Stage) -> Iterator[Item]:
    """/truth/touch and /truth/stroke, each logged at its end."""
    base = skin.rest_readings(stage.chance(2))
    items = [
        item
        for contact in stage.wish.plan.contacts
        for item in _events_of_contact(stage, contact, base)
    ]
    yield from sorted(items, key=lambda item: item.log_ns)


def _events_of_contact(stage: Stage, contact: Contact, base: Array) -> Iterator[Item]:
    t = np.arange(contact.onset - 0.2, contact.onset + contact.length + 0.2, 1e-3)
    signal = skin.proximity_readings(
        hand.hand_path([contact], stage.column, t, seen=False), HAND_RADIUS, base
    )
    onset, offset = skin.threshold_crossings(t, signal)
    cells = np.flatnonzero(signal.max(axis=0) > skin.THRESHOLD)
    stamp = START_NS + round(onset * 1e9)
    touch = messages.touch_message(stamp, offset - onset, cells, float(signal.max()))
    yield Item(START_NS + round(offset * 1e9) + 3_000_000, stamp, "/truth/touch", touch)
    begin = contact.onset + contact.delay
    end = contact.onset + contact.length + contact.delay
    places = seen_hand(stage, np.array([begin, end]))
    views = stage.seen_from(begin), stage.seen_from(end)
    pixels = [
        ellipse_centre(view, place[None], HAND_RADIUS)[0]
        for view, place in zip(views, places, strict=True)
    ]
    stamp = START_NS + round(begin * 1e9)
    stroke = messages.stroke_message(stamp, FRAME, end - begin, pixels[0], pixels[1], begin - onset)
    yield Item(START_NS + round(end * 1e9) + 3_000_000, stamp, "/truth/stroke", stroke)
