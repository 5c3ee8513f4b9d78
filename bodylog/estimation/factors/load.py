"""What links bend by as the posture alone decides: under a weight at the hand, or otherwise."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations_with_replacement
from typing import Any, ClassVar, TypeGuard

import numpy as np

from ...body_model import BodyModel
from ...kinematics.hand import (
    COMPLIANCE_SPREAD,
    Hand,
    find_hands,
    find_same_hand,
    list_carrying_joints,
    list_hands,
)
from ...kinematics.pose import LEAST_LEVER
from ...types import Array
from ..faults.threshold import EVIDENCE_THRESHOLD_NATS
from ..measurements.long_arrays import find_finite_rows
from .columns import Column, Path
from .images import Images

FIRST_BEND = 5e-3
"""rad of what a joint bends by, with which the search begins."""
WIDE_BEND = 0.02
"""rad of what a joint bends by before any load is known, 1.1°."""
TAKEN_S = 0.2
"""s in which a hand takes up a load, or puts it down. Against a step, 12 drawn logs lost at most 5
nats where it was 0.02 s, and won 4 to 10 and 0 to 8 where it was 0.2 and 0.5 s.
"""
MOST_COLUMNS = 64
"""Columns of a log to which curvature is added, of four joints that turn: 168 of six joints took
107 CPU s for 36 of 16 s of a drawn log, and left 2.3 mrad for 2.1.
"""
UPRIGHT = (1.0,)
"""A pull along the one direction of levers that are known to be upright."""
_NO_PULL = (0.0, 0.0, 0.0)
PULLS = [(1.0, 0.0, 0.0, *_NO_PULL), (0.0, 1.0, 0.0, *_NO_PULL), (0.0, 0.0, 1.0, *_NO_PULL)]
"""Pulls along each of three directions, by the levers of joints, and not by those of links."""


@dataclass(frozen=True)
class Load(Column):
    """What links bend by as the posture alone decides, rad, while the load is carried.

    moments: s, when half of it is taken, put down, taken, … in turn; −∞ for what is there from the
    start.
    """

    bends: ClassVar[bool] = True
    moments: tuple[float, ...] = (-np.inf,)

    def moves_links(self, path: Path) -> Array:
        """What a unit bends the links by while the load is carried."""
        return self.bends_links(path) * self._share_carried(path.knots)[:, None]

    def bends_links(self, path: Path) -> Array:
        """What a unit bends links by (K,M) rad at a path's angles."""
        return np.zeros(path.angles.shape)

    def _share_carried(self, t: Array) -> Array:
        """The share of the load that is carried at times t (N,) s: a hand takes it up steadily."""
        taken = np.clip((t[:, None] - self.moments) / TAKEN_S + 0.5, 0.0, 1.0)
        return np.asarray(taken[:, ::2].sum(axis=1) - taken[:, 1::2].sum(axis=1))


LoadColumns = tuple[Load, ...]
"""The columns of one load."""


@dataclass(frozen=True)
class PostureLoad(Load):
    """What a joint bends by as a polynomial of the posture: a product of angles, from the middle
    (M,) rad of the log, times the size.

    factors: the joints whose angles are multiplied; none for what is the same in all postures.
    """

    joint: int = 0
    middle: tuple[float, ...] = ()
    factors: tuple[int, ...] = ()

    def bends_links(self, path: Path) -> Array:
        """The product at the angles, for this joint."""
        own = np.zeros(path.angles.shape)
        each = [path.angles[:, j] - self.middle[j] for j in self.factors]
        own[:, self.joint] = np.prod(each, axis=0)
        return own


@dataclass(frozen=True)
class Payload(Load):
    """What these joints sink by under a weight at the hand, rad (or m), each by its lever over the
    longest of all, m.

    pull: of the weight along each direction of the hand's levers · joints: of the log · still:
    names of others, which stood still in the exploration and may carry the hand: images show what
    these sink by, but no angle of the log tells it.
    """

    hand: Hand = field(kw_only=True)
    pull: tuple[float, ...] = UPRIGHT
    longest: float = 1.0
    joints: tuple[int, ...] = ()
    still: tuple[str, ...] = ()

    def bends_links(self, path: Path) -> Array:
        """Minus the levers at the angles, for these joints."""
        own = np.zeros(path.angles.shape)
        if self.joints:
            carrying = list(self.joints)
            levers = path.measure_levers(self.hand)[:, carrying]
            own[:, carrying] = -levers @ np.array(self.pull) / self.longest
        return own

    def displaces_images(self, images: Images, seen: Path) -> Array:
        """What images of the hand show of the others."""
        hand = find_same_hand(images.sighting.model, self.hand) if self.still else None
        if hand is None:
            return super().displaces_images(images, seen)
        shown, moves = hand.show_still_joints(seen.links)
        sinks = np.array([name in self.still for name in hand.still_joints])
        levers = moves @ np.array(self.pull[: moves.shape[2]])
        sunk = -(shown * levers[:, None] * sinks).sum(axis=-1) / self.longest
        return np.asarray(sunk * self._share_carried(seen.knots)[:, None])


def bend_under_load(columns: Sequence[Column], sizes: Array, t: Array, angles: Array) -> Array:
    """How far joints bend (N,M) rad at times t (N,) s and angles (N,M), by those of the columns
    that are a load.
    """
    rest = np.zeros(angles.shape)
    path = Path(t, angles, rest, angles, rest)
    loads = ((c, size) for c, size in zip(columns, sizes, strict=True) if isinstance(c, Load))
    return sum((size * column.moves_links(path) for column, size in loads), rest)


def build_load_columns(body: BodyModel, readings: Array) -> tuple[LoadColumns, ...]:
    """Loads of which one may be carried, each by its columns, for readings (N,M) rad: by the levers
    of what the arm holds where joints' axes are known, else any linear function of the posture.
    """
    known = readings[find_finite_rows(readings)]
    if not len(known):
        return ()
    hands = find_hands(list(body.senses.values()), known)
    if not hands:
        return (tuple(_bend_linearly(known)),)
    return tuple(tuple(_bend_by_levers(hand, body, known)) for hand in hands)


def count_groups(loads: Sequence[Column]) -> int:
    """Number of groups of a load's columns."""
    return 1 + max((one.group for one in loads if one.group is not None), default=-1)


def _bend_by_levers(hand: Hand, body: BodyModel, known: Array) -> Iterator[Payload]:
    """Yield, for each direction in which a weight may pull, how all joints that carry the hand sink
    together, and how each does more than that; where it is known which way that is, also those
    that stood still.
    """
    still = _measure_still_levers(body, known) if hand.is_upright else {}
    pulls = [UPRIGHT] if hand.is_upright else PULLS
    longest = max(float(np.abs(hand.measure_levers(known)).max()), *still.values(), 0.0)
    joints = tuple(list_carrying_joints(hand, known))
    others = tuple(name for name, lever in still.items() if lever > LEAST_LEVER)
    name = "payload" if hand.is_upright else "pull"
    for group, pull in enumerate(pulls):
        common = Payload(name, 1.0, group=group, hand=hand, pull=pull, longest=longest)
        yield replace(common, joints=joints, still=others)
        for j in joints:
            yield replace(common, std=COMPLIANCE_SPREAD, joints=(j,))
        for one in others:
            yield replace(common, std=COMPLIANCE_SPREAD, still=(one,))


def _measure_still_levers(body: BodyModel, known: Array) -> dict[str, float]:
    """The longest lever, m, of each joint that stood still and may carry an upright hand."""
    longest = dict[str, float]()
    for sense in body.senses.values():
        for hand in (one for one in list_hands(sense) if one.is_upright):
            most = np.abs(hand.show_still_joints(known)[1]).max(axis=(0, 2)).tolist()
            for name, lever in zip(hand.still_joints, most, strict=True):
                longest[name] = max(longest.get(name, 0.0), lever)
    return longest


def _bend_linearly(known: Array) -> Iterator[PostureLoad]:
    """Yield how each joint is off at the middle of the log,
    and by the angle of each: as much more a radian away.
    """
    middle = tuple(known.mean(axis=0).tolist())
    for j in range(known.shape[1]):
        constant = PostureLoad("posture", 1.0, group=j, joint=j, middle=middle)
        yield constant
        for other in range(known.shape[1]):
            yield replace(constant, factors=(other,))


def refine_loads(columns: Sequence[Column], sizes: Array, turning: Array) -> tuple[Column, ...]:
    """The columns, of these sizes (C,), and those that a load needs for angles, but not to be
    found.

    A posture's load goes to the second order in joints that turn (M,) bool. One that pulls the hand
    any way has one direction for all joints, and more of it for each joint and each link; and the
    hand gives way, as soft as a joint.
    """
    leads = dict[int | None, tuple[Payload, float]]()
    for one, size in zip(columns, sizes.tolist(), strict=True):
        if _pulls_any_way(one):
            leads.setdefault(one.group, (one, size))
    if not leads:
        return _curve_loads(columns, turning)
    common = [one for one, _ in leads.values()]
    first = common[0]
    force = np.sum([size * np.array(one.pull[:3]) for one, size in leads.values()], axis=0)
    by_joint = (*force.tolist(), *_NO_PULL)
    by_link = (*_NO_PULL, *force.tolist())
    own = replace(first, std=COMPLIANCE_SPREAD, group=None, pull=by_joint)
    aimed: list[Column] = [*common]
    for j in first.joints:
        aimed.append(replace(own, joints=(j,)))
        aimed.append(replace(own, joints=(j,), pull=by_link))
    aimed += [replace(own, joints=(), still=(name,)) for name in first.hand.still_joints]
    return (*(one for one in columns if not _pulls_any_way(one)), *aimed)


def _pulls_any_way(column: Column) -> TypeGuard[Payload]:
    """Whether it is a load that pulls the hand any way."""
    return isinstance(column, Payload) and not column.hand.is_upright


def _curve_loads(columns: Sequence[Column], turning: Array) -> tuple[Column, ...]:
    """The columns, a posture's load to the second order in angles of joints that turn (M,) bool,
    unless these are more than MOST_COLUMNS.

    A bend of A cos(q₁ + q₂ + φ) has slopes of up to A, ½A for squares, and A for products.
    """
    pairs = list(combinations_with_replacement(np.flatnonzero(turning).tolist(), 2))
    constants = [one for one in columns if isinstance(one, PostureLoad) and not one.factors]
    curved = [
        replace(one, factors=(j, k), std=0.5 if j == k else 1.0)
        for one in constants
        for j, k in pairs
    ]
    every = (*columns, *curved)
    return every if len(every) <= MOST_COLUMNS else tuple(columns)


def describe_load(load: Mapping[str, Any]) -> str:
    """A load in words: `weight`, whether it is as under a weight at the hand, `moments` (s) when it
    is taken and put down in turn, `nats`, and `rad` {joint: how far it bends at most}.
    """
    each = ", ".join(f"{name} {np.rad2deg(size):.2g}°" for name, size in load["rad"].items())
    cause = "payload" if load["weight"] else "payload, or another error of the posture"
    sure = load["nats"] > EVIDENCE_THRESHOLD_NATS
    weighed = f"{load['nats']:.0f} nats" if sure else "or errors that last, as likely"
    bent = f"joints bend by up to {each} more than in the exploration ({weighed})"
    return f"{cause}{_describe_moments(load.get('moments', [None]))}: {bent}"


def _describe_moments(moments: Sequence[float | None]) -> str:
    """When a load is carried, in words: nothing where it is all the time."""
    words = list[str]()
    for i in range(0, len(moments), 2):
        begin, *end = moments[i : i + 2]
        if begin is not None:
            words.append(f"from {begin:.1f}" + (f" to {end[0]:.1f} s" if end else " s on"))
        elif end:
            words.append(f"until {end[0]:.1f} s")
    return " " + ", ".join(words) if words else ""
