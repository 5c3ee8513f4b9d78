"""What links bend by as the posture alone decides: under a weight at the hand, or otherwise."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from ...body_model import BodyModel
from ...types import Array
from ..faults.threshold import EVIDENCE_THRESHOLD_NATS
from .columns import Column, Path
from .images import Images

FIRST_BEND = 5e-3
"""rad of what a joint bends by, with which the search begins."""
LEAST_LEVER = 1e-3
"""Share of the longest lever below which a joint carries nothing."""


@dataclass(frozen=True)
class Load(Column):
    """What a joint bends by, rad: a shape of the posture, (K,M) rad -> (K,), times the size."""

    joint: int = 0
    shape: Callable[[Array], Array] = np.ones_like
    bends: bool = True

    def moves_links(self, path: Path) -> Array:
        """The shape at the angles, for this joint."""
        own = np.zeros(path.angles.shape)
        own[:, self.joint] = self.shape(path.angles)
        return own


@runtime_checkable
class _Carried(Protocol):
    """A model of a marker that joints may carry which stood still in the exploration."""

    @property
    def still_joints(self) -> tuple[str, ...]: ...

    def show_still_joints(self, x: Array) -> tuple[Array, Array]: ...


@dataclass(frozen=True)
class StillLoad(Column):
    """What a joint bends by that stood still in the exploration, rad (or m) where it bends most:
    it carries the marker, so images show it, but no angle of the log tells it.
    """

    joint_name: str = ""
    longest: float = 1.0

    def displaces(self, images: Images, path: Path) -> Array:
        """By what the joint sinks, of a marker that it may carry."""
        model = images.sighting.model
        if not isinstance(model, _Carried) or self.joint_name not in model.still_joints:
            return super().displaces(images, path)
        shown, levers = model.show_still_joints(path.at_images(images).links)
        r = model.still_joints.index(self.joint_name)
        return np.asarray(-shown[..., r] * levers[:, r, None] / self.longest)


def bend_under_load(columns: Sequence[Column], sizes: Array, angles: Array) -> Array:
    """How far joints bend (N,M) rad at angles (N,M), by those of the columns that are a load."""
    rest = np.zeros(angles.shape)
    path = Path(np.arange(len(angles)), angles, rest, angles, rest)
    loads = ((c, size) for c, size in zip(columns, sizes, strict=True) if isinstance(c, Load))
    return sum((size * column.moves_links(path) for column, size in loads), rest)


def load_columns(body: BodyModel, readings: Array) -> tuple[Column, ...]:
    """A load's columns for readings (N,M) rad: by the levers of the
    hand where a URDF tells them, else any linear function of the posture.
    """
    known = readings[np.isfinite(readings).all(axis=1)]
    if not len(known):
        return ()
    levers = find_hand_levers(body, known)
    if levers is None:
        return tuple(_bend_linearly(known))
    return (*_bend_by_levers(levers, known), *_bend_still_joints(body, known))


def count_groups(loads: Sequence[Column]) -> int:
    """Number of groups of a load's columns."""
    return 1 + max((one.group for one in loads if one.group is not None), default=-1)


def find_hand_levers(body: BodyModel, known: Array) -> Callable[[Array], Array] | None:
    """How far the hand rises with each joint (N,M), m per rad, at
    angles (N,M); None where no sense has a URDF that tells it at known (N,M).
    """
    for sense in body.senses.values():
        levers: Callable[[Array], Array] | None = getattr(sense, "hand_levers", None)
        if levers is not None and levers(known[:1]) is not None:
            return levers
    return None


def _bend_by_levers(levers: Callable[[Array], Array], known: Array) -> Iterator[Load]:
    """Yield how each joint that carries the hand sinks: by its size where the lever is longest."""
    longest = np.abs(levers(known)).max(axis=0)
    for j in np.flatnonzero(longest > LEAST_LEVER * longest.max()).tolist():

        def sink(angles: Array, j: int = j) -> Array:
            return np.asarray(-levers(angles)[:, j] / longest[j])

        yield Load("payload", 1.0, group=j, joint=j, shape=sink)


def _bend_still_joints(body: BodyModel, known: Array) -> Iterator[StillLoad]:
    """Yield how each joint that stood still and may carry the hand sinks."""
    longest = dict[str, float]()
    for sense in body.senses.values():
        if isinstance(sense, _Carried):
            most = np.abs(sense.show_still_joints(known)[1]).max(axis=0).tolist()
            for name, lever in zip(sense.still_joints, most, strict=True):
                longest[name] = max(longest.get(name, 0.0), lever)
    far = LEAST_LEVER * max(longest.values(), default=0.0)
    carrying = [(name, lever) for name, lever in longest.items() if lever > far]
    for g, (name, lever) in enumerate(carrying, known.shape[1]):
        yield StillLoad("payload", 1.0, group=g, joint_name=name, longest=lever)


def _bend_linearly(known: Array) -> Iterator[Load]:
    """Yield how each joint is off at the middle of the log,
    and by the angle of each: as much more a radian away.
    """
    middle = known.mean(axis=0)
    for j in range(known.shape[1]):
        yield Load("posture", 1.0, group=j, joint=j, shape=_keep_constant)
        for other in range(known.shape[1]):

            def lean(angles: Array, other: int = other) -> Array:
                return np.asarray(angles[:, other] - middle[other])

            yield Load("posture", 1.0, group=j, joint=j, shape=lean)


def _keep_constant(angles: Array) -> Array:
    """1 at all angles (K,M)."""
    return np.ones(len(angles))


def load_sentence(load: Mapping[str, Any]) -> str:
    """A load in words: `weight`, whether it is as under a weight at the
    hand, `nats`, and `rad` {joint: how far it bends at most}.
    """
    each = ", ".join(f"{name} {np.rad2deg(size):.2g}°" for name, size in load["rad"].items())
    cause = "payload" if load["weight"] else "payload, or another error of the posture"
    sure = load["nats"] > EVIDENCE_THRESHOLD_NATS
    weighed = f"{load['nats']:.0f} nats" if sure else "or errors that last, as likely"
    return f"{cause}: joints bend by up to {each} more than in the exploration ({weighed})"
