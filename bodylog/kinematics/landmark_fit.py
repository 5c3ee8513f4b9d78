"""Calibrate a camera, its delays and the joints' zeros by landmarks on the links, in stages."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..types import Array
from .chain import chain_between
from .joint_motion import JointCurve
from .landmark_adjustment import (
    RESIDUAL_STD_PX,
    Assignment,
    Landmarks,
    Reduced,
    adjust_landmarks,
    assign_pieces,
)
from .landmarks import LandmarkBody, LandmarkModel, LandmarkSightings
from .links import Space
from .rig import Rig, RigCamera, Sight

BODY_RADIUS_M = 0.1
"""What stands out beyond the origins of a link: half the prior size of a link of no length."""
WORLD_SIZE_M = 2.0
"""Prior size of the scene around the robot's base."""
_DELAY_GRID_S = np.arange(-0.1, 0.3001, 0.05)
_SEARCH_CAP_PX = 12.0
THRESHOLDS_PX = (12.0, 6.0, 3.0, 2.0)
"""A piece is used while its error on its best body is below; the camera is known ever better."""
STDS_PX = (3.0, 2.0, 1.2, RESIDUAL_STD_PX)
"""Deviations of errors that each stage expects."""
MOST_PIECES = 300
LEAST_PIECES = 15
_EXPLAINED_SHARE = 0.35
"""Largest error of a piece on a moving body, as a share of its motion in the image."""
_TRIED_AGAIN = 4.0
"""Thresholds within which a body stays a candidate for a piece."""


def build_model(
    robot_space: Space, camera: RigCamera, motions: Sequence[JointCurve], zero_std: float
) -> LandmarkModel:
    """The model of one camera and every rigid part of the robot that moves before it, and the base.

    robot_space: the robot with its joints that move ·
    zero_std: prior std of joint zeros, rad (m: a tenth).
    """
    space = robot_space
    bodies = tuple(_landmark_bodies(space, camera.link))
    sights = tuple(Sight(body.link, 0, 0, body.chain) for body in bodies)
    doubt = np.array(
        [
            zero_std * (0.1 if space.robot.by_name[name].kind == "prismatic" else 1.0)
            for name in space.joints
        ]
    )
    rig = Rig((camera,), (), sights, space.joints, np.maximum(doubt, 1e-9))
    return LandmarkModel(rig, bodies, tuple(motions))


def _landmark_bodies(space: Space, camera_link: str) -> Iterator[LandmarkBody]:
    groups = space.groups
    uppermost = {link: _uppermost_link(space, link, groups) for link in space.robot.links}
    for group in groups:
        origins = []
        for link in space.robot.links:
            parent = space.robot.above[link].parent if link in space.robot.above else link
            if uppermost[link] == group or uppermost[parent] == group:
                origins.append(_link_origin(space, group, link))
        places = np.array(origins or [np.zeros(3)])
        low = places.min(axis=0)
        high = places.max(axis=0)
        size = 0.5 * float(np.linalg.norm(high - low)) + BODY_RADIUS_M
        base = group == groups[0]
        yield LandmarkBody(
            group,
            space.chain(camera_link, group),
            np.zeros(3) if base else 0.5 * (low + high),
            WORLD_SIZE_M if base else size,
        )


def _uppermost_link(space: Space, link: str, groups: Sequence[str]) -> str:
    while link not in groups and link in space.robot.above:
        link = space.robot.above[link].parent
    return link


def _link_origin(space: Space, start: str, link: str) -> Array:
    """The origin (3,) m of a link in another with all joints at zero."""
    chain = chain_between(space.robot, start, link)
    held = chain.holding({joint: space.still.get(joint, 0.0) for joint in chain.joints})
    return np.asarray(held.fixed[0][:3, 3])


@dataclass(frozen=True, eq=False)
class LandmarkFit:
    """The unknowns φ (P,) after the last stage, the pieces
    in use with their landmarks, and their normal equations.

    free (P,): which unknowns were estimated · used (k,):
    numbers of the pieces in use among those given.
    """

    model: LandmarkModel
    phi: Array
    free: Array
    seen: LandmarkSightings
    used: Array
    landmarks: Landmarks
    reduced: Reduced

    @property
    def error_px(self) -> float:
        """Root mean square residual per axis, px."""
        weight = self.reduced.weight
        return float(
            np.sqrt(
                (weight[:, None] * np.square(self.reduced.residual)).sum() / (2.0 * weight.sum())
            )
        )


def search_costs(model: LandmarkModel, phi: Array, seen: LandmarkSightings) -> Array:
    """Square errors (K,), px², of the pieces on their
    best bodies, each at most _SEARCH_CAP_PX squared.
    """
    error = assign_pieces(model, phi, seen).error
    return np.asarray(np.square(np.minimum(error, _SEARCH_CAP_PX)))


def search_delay(model: LandmarkModel, phi: Array, seen: LandmarkSightings) -> tuple[Array, float]:
    """φ with each log's delay of least cost on a coarse
    grid, and the mean cost of all pieces with these.
    """
    logs = seen.log[seen.begins]
    sums = np.empty((len(_DELAY_GRID_S), len(model.motions)))
    for number, delay in enumerate(_DELAY_GRID_S):
        there = phi.copy()
        there[model.of_delays] = delay
        sums[number] = np.bincount(logs, search_costs(model, there, seen), len(model.motions))
    found = phi.copy()
    found[model.of_delays] = _DELAY_GRID_S[np.argmin(sums, axis=0)]
    return found, float(sums.min(axis=0).sum() / seen.count)


def choose_pieces(seen: LandmarkSightings, most: int) -> Array:
    """At most `most` pieces of each log, evenly spread over its time: numbers, ascending."""
    logs = seen.log[seen.begins]
    chosen = []
    for log in np.unique(logs):
        own = np.flatnonzero(logs == log)
        chosen.append(
            own[np.unique(np.linspace(0, len(own) - 1, min(len(own), most)).round().astype(int))]
        )
    return np.concatenate(chosen)


def staged_fit(
    model: LandmarkModel,
    phi: Array,
    seen: LandmarkSightings,
    row_time: bool = True,
    wide: bool = False,
) -> LandmarkFit | None:
    """Adjust in stages from φ: delay, pose and focal
    length, then zeros, then the lens, then the row time.

    wide: the camera is not even known roughly. None where
    fewer than LEAST_PIECES moving pieces fit any body.
    """
    pose, focal, lens, zeros, delays, row = _masks_of_unknowns(model)
    found: LandmarkFit | None = None
    tried: Array | None = None
    stages = [(-1, 40.0, 8.0), (-1, 24.0, 5.0)] if wide else []
    stages += [
        (number, threshold, STDS_PX[number]) for number, threshold in enumerate(THRESHOLDS_PX)
    ]
    for stage, threshold, std_px in stages:
        # the links are chosen twice at each threshold: a better camera changes them
        for _ in range(2):
            free = pose | focal | delays
            free |= zeros if stage >= 1 else False
            free |= lens if stage >= 2 else False
            free |= row if row_time and stage >= 3 else False
            chosen = assign_pieces(model, phi, seen, tried)
            tried = chosen.errors < _TRIED_AGAIN * threshold
            used = np.flatnonzero((chosen.error < threshold) & explained_pieces(model, chosen))
            if not has_enough_pieces(model, chosen, used):
                return found if stage > 2 else None
            part = seen.take(used)
            start = Landmarks(chosen.body[used], chosen.places[used])
            phi, landmarks, reduced = adjust_landmarks(model, phi, part, start, free, std_px)
            found = LandmarkFit(model, phi, free, part, used, landmarks, reduced)
    return found


def explained_pieces(model: LandmarkModel, chosen: Assignment) -> Array:
    """Which pieces (K,) a body explains much better than
    rest in the image does: a swaying picture moves no link.
    """
    moves = np.array([len(body.chain.column) > 0 for body in model.bodies])[chosen.body]
    return np.asarray(~moves | (chosen.error < _EXPLAINED_SHARE * chosen.still))


def has_enough_pieces(model: LandmarkModel, chosen: Assignment, used: Array) -> bool:
    """Whether enough of the used pieces lie on bodies that move before the camera."""
    moving = np.array([len(body.chain.column) > 0 for body in model.bodies])
    return int(moving[chosen.body[used]].sum()) >= LEAST_PIECES


def _masks_of_unknowns(model: LandmarkModel) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Masks (P,) of φ: camera pose, focal length, rest of the lens, zeros, delays, row time."""
    count = len(model.prior[0])
    parts = [slice(0, 6), slice(6, 7), slice(8, 11), model.rig.of_joints, model.of_delays]
    masks = []
    for part in [*parts, slice(model.of_row_time, count)]:
        mask = np.zeros(count, bool)
        mask[part] = True
        masks.append(mask)
    pose, focal, lens, zeros, delays, row = masks
    pose[model.of_moves] = True
    row[model.of_moves] = False
    return pose, focal, lens, zeros, delays, row
