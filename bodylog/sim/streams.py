"""Encoders, skin and events: streams of messages, each in the order of log time."""

from collections.abc import Iterator

import numpy as np

from ..types import Array
from . import hand, messages, skin
from .camera import ellipse_centre
from .head import JOINT
from .plan import Contact, Plan
from .stage import FRAME, START_NS, Item, Stage, log_times, seen_hand, stamps_of
from .world import HAND_RADIUS

_JOINT_HZ, _SKIN_HZ = 100.0, 100.0
_RATE_NOISE = 0.01


def encoder_items(stage: Stage) -> Iterator[Item]:
    """/joint_states in alphabetical order as the UR driver publishes, and /truth/joint_states."""
    yield Item(START_NS, START_NS, "/robot_description", messages.text(stage.wish.arm.urdf.read_text()))
    rng = stage.chance(1)
    true_names = [*stage.wish.arm.joints, *([JOINT] if stage.head else [])]
    order = np.argsort(true_names)
    names = [true_names[joint] for joint in order]
    for stamps in stamps_of(stage.wish.duration, _JOINT_HZ, 0):
        t = stamps / 1e9
        q, rate = stage.wish.plan.motion.position(t), stage.wish.plan.motion.rate(t)
        read, speed = _encoders(stage.wish.plan, t, q, stage.wish.noise, rng)
        if stage.head is not None:
            angle, turn = stage.head.angle(t)[:, None], stage.head.rate(t)[:, None]
            q, rate, speed = np.hstack([q, angle]), np.hstack([rate, turn]), np.hstack([speed, turn])
            read = np.hstack([read, angle + rng.normal(0.0, 1.0, angle.shape) * stage.wish.noise])
        for row, (stamp, log) in enumerate(zip(stamps + START_NS, log_times(stamps, 4.0, 6.0, rng), strict=True)):
            seen = messages.joint_state(int(stamp), names, read[row, order], speed[row, order])
            yield Item(int(log), int(stamp), "/joint_states", seen)
            truth = messages.joint_state(int(stamp), true_names, q[row], rate[row])
            yield Item(int(log), int(stamp), "/truth/joint_states", truth)


def _encoders(plan: Plan, t: Array, q: Array, noise: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """What the encoders read and the speed (N,M) they make of it."""
    read = plan.encoders(t, q, rng.normal(0.0, 1.0, q.shape) * noise)
    before, after = (plan.encoders(t + h, plan.motion.position(t + h), np.zeros(q.shape)) for h in (-1e-4, 1e-4))
    return read, (after - before) / 2e-4 + rng.normal(0.0, _RATE_NOISE, q.shape)


def skin_items(stage: Stage) -> Iterator[Item]:
    """/skin: the cells' readings."""
    rng = stage.chance(2)
    base = skin.rest(rng)
    for stamps in stamps_of(stage.wish.duration, _SKIN_HZ, 2_000_000):
        place = hand.path(stage.wish.plan.contacts, stage.column, stamps / 1e9, seen=False)
        data = skin.read(skin.proximity(place, HAND_RADIUS, base), rng)
        for row, (stamp, log) in enumerate(zip(stamps + START_NS, log_times(stamps, 2.0, 4.0, rng), strict=True)):
            yield Item(int(log), int(stamp), "/skin", messages.skin_array(int(stamp), data[row]))


def event_items(stage: Stage) -> Iterator[Item]:
    """/truth/touch and /truth/stroke, each logged when it is over."""
    base = skin.rest(stage.chance(2))
    items = [item for contact in stage.wish.plan.contacts for item in _events(stage, contact, base)]
    yield from sorted(items, key=lambda item: item.log_ns)


def _events(stage: Stage, contact: Contact, base: Array) -> Iterator[Item]:
    t = np.arange(contact.onset - 0.2, contact.onset + contact.length + 0.2, 1e-3)
    signal = skin.proximity(hand.path([contact], stage.column, t, seen=False), HAND_RADIUS, base)
    onset, offset = skin.crossings(t, signal)
    cells = np.flatnonzero(signal.max(axis=0) > skin.THRESHOLD)
    stamp = START_NS + round(onset * 1e9)
    touch = messages.touch(stamp, offset - onset, cells, float(signal.max()))
    yield Item(START_NS + round(offset * 1e9) + 3_000_000, stamp, "/truth/touch", touch)
    begin, end = contact.onset + contact.delay, contact.onset + contact.length + contact.delay
    places = seen_hand(stage, np.array([begin, end]))
    views = stage.seen_from(begin), stage.seen_from(end)
    pixels = [ellipse_centre(view, place[None], HAND_RADIUS)[0] for view, place in zip(views, places, strict=True)]
    stamp = START_NS + round(begin * 1e9)
    stroke = messages.stroke(stamp, FRAME, end - begin, pixels[0], pixels[1], begin - onset)
    yield Item(START_NS + round(end * 1e9) + 3_000_000, stamp, "/truth/stroke", stroke)
