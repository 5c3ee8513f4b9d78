"""Kinematic results of an estimate: effector poses in metres,
predictions without the residual process, joint zeros.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..body_model import BodyModel
from ..sources import group_of
from ..types import Array, Estimate, Features, Poses, Series

if TYPE_CHECKING:
    from ..body.kinematic.model import KinematicGP

FIRST = "effector"
CALIBRATED = "calibrated"
"""Name in an estimate's settings: {board or marker: {mm_per_px, and of still poses px and mm: RMS
per axis of what was seen minus what the calibration alone predicts at the readings}}.
"""


def add_kinematic_results(body: BodyModel, found: Estimate, features: Features) -> Estimate:
    """Add kinematic results to an estimate; unchanged for a body learned without a URDF.

    Of still poses every point of a board is predicted, by the calibration alone at the readings.
    """
    from ..body.kinematic.model import KinematicGP
    from ..body.kinematic.offsets import learned_zeros, offsets_as_values

    senses = {name: s for name, s in body.senses.items() if isinstance(s, KinematicGP)}
    if not senses or not len(found.joints.t):
        return found
    seen = {name: sense for name, sense in senses.items() if name in found.predicted}
    kinematic = (
        dict(_predict_still_poses(body, seen, features))
        if features.poses
        else {name: _predict_by_kinematics(sense, found, name) for name, sense in seen.items()}
    )
    used = {
        **found.settings,
        "offsets": offsets_as_values(learned_zeros(body)),
        CALIBRATED: _errors_of_calibration(seen, found, features, kinematic),
    }
    return replace(
        found, effector=_effector_poses(senses, found), kinematic=kinematic, settings=used
    )


def _predict_still_poses(
    body: BodyModel, senses: "Mapping[str, KinematicGP]", features: Features
) -> Iterator[tuple[str, Series]]:
    """Yield each track of a thing with a sense, px, by the calibration at the readings."""
    joints = features.joints
    if joints is None or not set(body.joints) <= set(joints.names):
        return
    x = joints.values[:, [joints.names.index(name) for name in body.joints]]
    for group, name in {group_of(name): name for name in senses}.items():
        sense = senses[name]
        names, points = features.boards.get(group, ((name,), sense.rig.sights[0].points))
        image = sense.kinematics_of_points(x, points)
        for k, track in enumerate(names):
            if track in features.tracks:
                yield track, Series(joints.t, image[:, k], ("u", "v"), "px", joints.source_ns)


def _errors_of_calibration(
    senses: "Mapping[str, KinematicGP]",
    found: Estimate,
    features: Features,
    kinematic: Mapping[str, Series],
) -> dict[str, dict[str, float]]:
    """The mapping CALIBRATED of an estimate."""
    errors = dict[str, dict[str, float]]()
    for group, name in {group_of(name): name for name in senses}.items():
        scale = _millimetres_per_pixel(senses[name], found.joints.values)
        errors[group] = {"mm_per_px": scale}
        off = [
            features.tracks[track].values - _values_at_times(series, features.tracks[track].t)
            for track, series in kinematic.items()
            if features.poses and group_of(track) == group
        ]
        square = np.concatenate([np.square(one).sum(axis=1) for one in off] or [np.zeros(0)])
        if np.isfinite(square).any():
            error = float(np.sqrt(np.nanmean(square) / 2.0))
            errors[group] |= {"px": error, "mm": error * scale}
    return errors


def _values_at_times(series: Series, t: Array) -> Array:
    """The rows of a series nearest to times t (N,)."""
    rows = np.abs(series.t[None] - t[:, None]).argmin(axis=1)
    return np.asarray(series.values[rows])


def _millimetres_per_pixel(sense: "KinematicGP", x: Array) -> float:
    """mm of the marker across the line of sight that move its image by one px, at x (N,M) rad."""
    design = sense.design(x[:: max(1, len(x) // 200)])
    moved = design[..., sense.rig.of_carrier(0)][..., :3]
    # px per m along the image's two axes: the marker's distance over the focal length, inverted
    per_metre = np.sqrt(np.square(moved).sum(axis=(1, 2)) / 2.0)
    return float(1e3 / np.median(per_metre))


def _effector_poses(senses: "dict[str, KinematicGP]", found: Estimate) -> Poses | None:
    """Poses of the effector, or of the first track by name."""
    from ..kinematics.pose import pose_in_base
    from ..kinematics.rotations import quaternions_from_rotations

    first = senses.get(FIRST, senses[min(senses)])
    if first.base is None:
        return None
    joints = found.joints
    chain = first.base.chain
    place, rotation, cov = pose_in_base(
        first.base, first.rig, first.printed, first.root, joints.values, found.cov
    )
    return Poses(
        joints.t, place, quaternions_from_rotations(rotation), chain.start, joints.source_ns, cov
    )


def _predict_by_kinematics(sense: "KinematicGP", found: Estimate, name: str) -> Series:
    """A track's predictions by kinematics alone, px: without the residual process."""
    predicted = found.predicted[name]
    joints = found.joints
    x = np.column_stack([np.interp(predicted.t, joints.t, column) for column in joints.values.T])
    process: Array = sense.means(x)[0] - sense.kinematics(x)
    return replace(predicted, values=predicted.values - process, std=None)
