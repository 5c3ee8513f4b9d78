"""Cameras and markers that moved between logs: found
by evidence, with a placement before and one after.

A move must win nats with the residuals' process, the joints' errors
over a turn and all other unknowns marginalised; a process that every
pose pays for would otherwise absorb it, and the zeros with it.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...kinematics.calibration import Calibrated, Sighted, calibrate_rig
from ...kinematics.links import FoundLinks
from ...kinematics.rig import Rig, Sight
from ...kinematics.rotations import (
    invert_transform,
    make_transform,
    nearest_rotation,
    vector_from_rotation,
)
from ...kinematics.starts import board_poses, find_starts
from ...types import Array
from ..data.pairs import SmoothedJoint
from ..data.subsampling import choose_spaced_rows
from .change import CHANGE_MARGIN_NATS, CHANGE_NATS
from .explicit import shared_evidence
from .residuals import fit_residual_kernel, with_periodic_errors
from .sightings import ThingSightings

_SCREENED = 80
"""Most images of a thing with which moves are compared before the best ones are judged."""
_STEP = 1e-6
"""m, rad: step of numerical derivatives of a pose."""
_FAR_OFF = 0.05
"""Residual share of the sightings' motion beyond which a
calibration is no start for another; a real NAO's is 0.03.
"""
_UNKNOWN_RAD = 1.0
"""A board with a larger prior std of its turn starts where its corners place it."""


@dataclass(frozen=True)
class RigThing:
    """A camera or a marker by its index in the rig in which nothing moves."""

    kind: str
    index: int


@dataclass(frozen=True)
class Move:
    """Things, moved together between log − 1 and log (0-based)
    · nats won · alternatives: explanations as likely.
    """

    things: tuple[RigThing, ...]
    log: int
    nats: float = 0.0
    alternatives: tuple[tuple[RigThing, ...], ...] = ()


def find_moves(
    links: FoundLinks,
    parts: Mapping[str, ThingSightings],
    joints: Sequence[SmoothedJoint],
    seed: int,
) -> tuple[FoundLinks, tuple[Move, ...]]:
    """Add moves to a calibration, one after the other, while each wins CHANGE_NATS; return both."""
    still = links.calibrated
    seen = list(parts.values())
    moves = tuple[Move, ...]()
    logs = 1 + max((int(one.whole.log.max()) for one in seen), default=0)
    rig = still.rig
    current = still
    while tried := [*_screen_moves(rig, current, seen, moves, logs)]:
        judged = [
            _judge_move(rig, current, moves, move, seen, joints, seed, logs) for move in tried
        ]
        nats, move, found, current = max(judged, key=lambda one: one[0])
        if nats < CHANGE_NATS:
            break
        indistinct_things = [
            other.things
            for gain, other, *_ in judged
            if gain > nats - CHANGE_MARGIN_NATS and other.things != move.things
        ]
        moves = (
            *moves,
            replace(move, nats=nats, alternatives=tuple(dict.fromkeys(indistinct_things))),
        )
        current = found
    return replace(links, calibrated=current), moves


def _screen_moves(
    rig: Rig,
    current: Calibrated,
    seen: Sequence[ThingSightings],
    moves: tuple[Move, ...],
    logs: int,
) -> Iterator[Move]:
    """Yield the likeliest log of each set of things that
    may have moved, if it wins nats with white noise alone.

    White noise takes every corner for a measurement of its
    own, so what does not win here does not win at all.
    """
    few = [one.rows(choose_spaced_rows(len(one.whole.x), _SCREENED)) for one in seen]
    before = _calibrate_with_moves(rig, moves, few, logs, current)
    for things in _sets_that_may_move(rig, seen):
        ways = [
            Move(things, log)
            for log in range(1, logs)
            if _both_sides(rig, things, seen, log, moves)
        ]
        found = [
            (_calibrate_with_moves(rig, (*moves, way), few, logs, current).evidence, way)
            for way in ways
        ]
        if found and max(found, key=lambda one: one[0])[0] > before.evidence + CHANGE_NATS:
            yield max(found, key=lambda one: one[0])[1]


def _sets_that_may_move(rig: Rig, seen: Sequence[ThingSightings]) -> Iterator[tuple[RigThing, ...]]:
    """Yield what may move: each marker, each camera, and all markers of one link together."""
    yield from ((RigThing("marker", k),) for k in range(len(rig.carriers)))
    yield from ((RigThing("camera", k),) for k in range(len(rig.cameras)))
    for link in dict.fromkeys(one.link for one in rig.carriers):
        together = tuple(
            RigThing("marker", k) for k, one in enumerate(rig.carriers) if one.link == link
        )
        if len(together) > 1:
            yield together


def _both_sides(
    rig: Rig,
    things: tuple[RigThing, ...],
    seen: Sequence[ThingSightings],
    log: int,
    moves: tuple[Move, ...],
) -> bool:
    """Whether things are seen before and since a log,
    in logs next to it that no other move separates.
    """
    known = {move.log for move in moves if set(move.things) & set(things)}
    if log in known:
        return False
    for thing in things:
        of = [sight.carrier if thing.kind == "marker" else sight.camera for sight in rig.sights]
        shown = [one.whole.log for k, one in zip(of, seen, strict=True) if k == thing.index]
        numbers = np.concatenate([*shown, np.zeros(0, np.int64)])
        cuts = np.array(sorted({*known, log}))
        if len(np.unique(np.searchsorted(cuts, np.unique(numbers), side="right"))) < len(cuts) + 1:
            return False
    return True


def _judge_move(
    rig: Rig,
    current: Calibrated,
    moves: tuple[Move, ...],
    move: Move,
    seen: Sequence[ThingSightings],
    joints: Sequence[SmoothedJoint],
    seed: int,
    logs: int,
) -> tuple[float, Move, Calibrated, Calibrated]:
    """Nats that a move wins, the calibration with it,
    and the one without it, on the same sightings.
    """
    after = _calibrate_with_moves(rig, (*moves, move), seen, logs, current)
    before = _calibrate_with_moves(rig, moves, seen, logs, after)
    before = max((before, current), key=lambda one: one.evidence)
    # what only one of them explains looked like false sightings to the other
    weights = [np.maximum(a, b) for a, b in zip(after.weights, before.weights, strict=True)]
    with_it, without = (
        _evidence_with_residuals(one, seen, weights, joints, seed) for one in (after, before)
    )
    return with_it - without, move, after, before


def _evidence_with_residuals(
    found: Calibrated,
    seen: Sequence[ThingSightings],
    weights: Sequence[Array],
    joints: Sequence[SmoothedJoint],
    seed: int,
) -> float:
    """Evidence (nats) of sightings, each thing with a residual process of its own."""
    rig = found.rig
    theta = found.theta
    each = enumerate(zip(seen, weights, strict=True))
    parts = [
        fit_residual_kernel(rig, k, theta, one, weight, joints, seed) for k, (one, weight) in each
    ]
    return shared_evidence(
        [(part.chol, with_periodic_errors(rig, part.rows, part)) for part in parts]
    )


def _calibrate_with_moves(
    rig: Rig, moves: Sequence[Move], seen: Sequence[ThingSightings], logs: int, near: Calibrated
) -> Calibrated:
    """The calibration of a rig in which things moved, started
    from another one, and from images if that is far off.
    """
    whole = with_moves(rig, moves, logs)
    apart, data, rows = _split_by_placement(whole, seen)
    open_hypotheses = [(apart, [_transfer_unknowns(apart, near)])]
    if any(
        near.noise[kind] ** 0.5 > _FAR_OFF * max(seen[k].sighted.spread for k in rows)
        for kind, _, rows in rig.split_by_kind()
    ):
        open_hypotheses.append(find_starts(apart, data))
    found = []
    for anchored, first in open_hypotheses:
        found.append(
            calibrate_rig(anchored, data, [_on_boards(anchored, data, theta) for theta in first])
        )
    best = max(found, key=lambda one: one.evidence)
    whole = replace(whole, cameras=best.rig.cameras, carriers=best.rig.carriers)
    weights = [np.zeros(one.seen.shape) for one in seen]
    for (k, chosen), weight in zip(rows, best.weights, strict=True):
        weights[k][chosen] = weight
    return replace(best, rig=whole, weights=tuple(weights))


def with_moves(rig: Rig, moves: Sequence[Move], logs: int) -> Rig:
    """The rig with one more camera or marker for
    each placement but the last, which keeps its own.
    """
    cuts: dict[RigThing, list[int]] = {}
    for move in moves:
        for thing in move.things:
            cuts[thing] = sorted([*cuts.get(thing, []), move.log])
    cameras = list(rig.cameras)
    carriers = list(rig.carriers)
    lenses = [*range(len(cameras))]
    places = dict[tuple[RigThing, int], int]()
    for thing, since in cuts.items():
        for group in range(len(since)):
            if thing.kind == "camera":
                cameras.append(cameras[thing.index])
                lenses.append(thing.index)
                places[thing, group] = len(cameras) - 1
            else:
                carriers.append(carriers[thing.index])
                places[thing, group] = len(carriers) - 1

    def place(kind: str, index: int, log: int) -> int:
        thing = RigThing(kind, index)
        return places.get(
            (thing, int(np.searchsorted(cuts.get(thing, []), log, side="right"))), index
        )

    sights = []
    for one in rig.sights:
        pairs = [
            (place("camera", one.camera, log), place("marker", one.carrier, log))
            for log in range(logs)
        ]
        moved = len(set(pairs)) > 1
        sights.append(replace(one, by_log=tuple(pairs) if moved else ()))
    return replace(
        rig,
        cameras=tuple(cameras),
        carriers=tuple(carriers),
        sights=tuple(sights),
        lenses=tuple(lenses),
    )


def _split_by_placement(
    rig: Rig, seen: Sequence[ThingSightings]
) -> tuple[Rig, list[Sighted], list[tuple[int, Array]]]:
    """The rig with a sight of its own for each placement, most images first, with its sightings.

    Also each sight's index in `rig`, and the rows of its sightings.
    """
    found = list[tuple[Sight, Sighted, tuple[int, Array]]]()
    for k, (sight, one) in enumerate(zip(rig.sights, seen, strict=True)):
        logs = one.whole.log
        places = sight.by_log or ((sight.camera, sight.carrier),)
        of = np.array(
            [places.index(places[log] if sight.by_log else places[0]) for log in logs], np.int64
        )
        for number in np.unique(of):
            chosen = np.flatnonzero(of == number)
            camera, carrier = places[number]
            apart = replace(sight, camera=camera, carrier=carrier, by_log=())
            found.append((apart, one.rows(chosen).sighted, (k, chosen)))
    found.sort(key=lambda one: -len(one[1].q))
    return (
        replace(rig, sights=tuple(one for one, _, _ in found)),
        [one for _, one, _ in found],
        [one for _, _, one in found],
    )


def _transfer_unknowns(rig: Rig, near: Calibrated) -> Array:
    """θ (P,) of a rig with the poses, lenses and joints of another one, by their names."""
    theta = rig.prior[0].copy()
    cameras = [one.name for one in near.rig.cameras]
    carriers = [one.name for one in near.rig.carriers]
    for k, camera in enumerate(rig.cameras):
        known = cameras.index(camera.name)
        theta[rig.of_camera(k)][:6] = _step_between_poses(
            near.rig.camera_pose(known, near.theta), camera.anchor
        )
        theta[rig.of_lens(k)] = near.theta[near.rig.of_lens(known)]
    for k, carrier in enumerate(rig.carriers):
        pose = near.rig.carrier_pose(carriers.index(carrier.name), near.theta)
        turned = _step_between_poses(pose, carrier.anchor)
        theta[rig.of_carrier(k)] = turned if carrier.turns else pose[:3, 3] - carrier.anchor[:3, 3]
    theta[rig.of_joints.start :] = near.theta[near.rig.of_joints.start :]
    return theta


def _step_between_poses(pose: Array, anchor: Array) -> Array:
    """The unknowns (6,), m and rad, that move an anchor (4,4) to a pose (4,4)."""
    step = pose @ invert_transform(anchor)
    return np.concatenate([step[:3, 3], vector_from_rotation(step[:3, :3])])


def _on_boards(rig: Rig, data: Sequence[Sighted], theta: Array) -> Array:
    """θ (P,) with each board of unknown place where
    its corners place it, seen from the cameras of θ.
    """
    theta = theta.copy()
    for index, carrier in enumerate(rig.carriers):
        sights = [k for k, one in enumerate(rig.sights) if one.carrier == index]
        if not sights or not carrier.turns or carrier.doubt[3:].max() < _UNKNOWN_RAD:
            continue
        camera = rig.camera_pose(rig.sights[sights[0]].camera, theta)
        seen, links = board_poses(rig, data, sights[0])
        poses = [
            invert_transform(camera @ link) @ one for one, link in zip(seen, links, strict=True)
        ]
        if poses:
            turn = nearest_rotation(np.sum([one[:3, :3] for one in poses], axis=0))
            place = np.median([one[:3, 3] for one in poses], axis=0)
            theta[rig.of_carrier(index)] = _step_between_poses(
                make_transform(turn, place), carrier.anchor
            )
    return theta


@dataclass(frozen=True, eq=False)
class CentreDisplacement:
    """How far a thing's own centre moved and how far it
    turned: m and rad, each with its std; turn None of a point.
    """

    name: str
    shift: float
    shift_std: float
    turn: float | None
    turn_std: float | None


def measure_displacement(
    rig: Rig, theta: Array, covariance: Array, thing: RigThing, log: int, centre: Array
) -> CentreDisplacement:
    """How far a thing moved between log − 1 and log, for
    θ (P,) ± covariance (P,P); centre (3,) m in the thing.
    """
    camera = thing.kind == "camera"
    own = next(one for one in rig.sights if (one.camera if camera else one.carrier) == thing.index)
    places = [pair[0] if camera else pair[1] for pair in (own.by_log[log - 1], own.by_log[log])]

    def pose(index: int, at: Array) -> Array:
        return (
            invert_transform(rig.camera_pose(index, at)) if camera else rig.carrier_pose(index, at)
        )

    first = [pose(index, theta) for index in places]

    def moved(at: Array) -> Array:
        before, after = (pose(index, at) for index in places)
        turned = vector_from_rotation(after[:3, :3] @ before[:3, :3].T) - vector_from_rotation(
            first[1][:3, :3] @ first[0][:3, :3].T
        )
        return np.concatenate([(after - before)[:3, :3] @ centre + (after - before)[:3, 3], turned])

    parts = [rig.of_camera(index) if camera else rig.of_carrier(index) for index in places]
    rows = np.concatenate(
        [np.arange(part.start, part.start + 6 if camera else part.stop) for part in parts]
    )
    slopes = np.zeros((6, len(rows)))
    for column, row in enumerate(rows):
        step = _STEP * (np.arange(len(theta)) == row)
        slopes[:, column] = (moved(theta + step) - moved(theta - step)) / (2.0 * _STEP)
    cov = slopes @ covariance[np.ix_(rows, rows)] @ slopes.T
    name = (rig.cameras if camera else rig.carriers)[thing.index].name
    shift, shift_std = _length_with_std(moved(theta)[:3], cov[:3, :3])
    if not camera and not rig.carriers[thing.index].turns:
        return CentreDisplacement(name, shift, shift_std, None, None)
    return CentreDisplacement(
        name,
        shift,
        shift_std,
        *_length_with_std(vector_from_rotation(first[1][:3, :3] @ first[0][:3, :3].T), cov[3:, 3:]),
    )


def _length_with_std(vector: Array, cov: Array) -> tuple[float, float]:
    """The length of a vector (3,) with covariance (3,3), and its standard deviation."""
    length = float(np.linalg.norm(vector))
    along = vector / max(length, 1e-12)
    return length, max(float(along @ cov @ along), 0.0) ** 0.5
